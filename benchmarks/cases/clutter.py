"""Path planning among obstacles: random problems of ten kinds."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from types import MappingProxyType
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.situations import coiled
from benchmarks.harness import Problem
from pinposture._validation import Vector, require_known
from pinposture.arm import Arm, smooth_configuration
from pinposture.collision import Box, Capsule, CollisionModel, Obstacle, Scan, Scene, Sphere
from pinposture.collision.pipe import Bend, pipe_axis, pipe_walls
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, PostureError, no_warnings
from pinposture.placement import Target, resolve_targets

Array = NDArray[np.float64]

CLUTTER_MARGIN = 0.005
"""Distance to keep from obstacles [m]."""

SPARE_CLEARANCE = 0.003
"""Clearance of start and goal beyond the margin [m]."""

HOLE = 0.15
"""Width of the holes [m]; the arm is 1 m long and 20 mm thick."""

PIPE_BEGINS, PIPE_RADIUS = 0.3, 0.05
"""Start of the pipe along x, and its radius [m]."""

POINT_RADIUS = 0.006
"""Radius of the points of the scanned machine [m]."""

GAP, THICKNESS = 0.032, 0.01
"""Half the width of the gap in the closed wall about the base, and radius of the arm there [m]."""

ONWARD = 0.25
"""How much farther than the tip of another arm a curve leads, relative to the length of the arm."""

MAX_DRAWS, MAX_REACHES = 5000, 200
"""Maximum number of draws of a problem, and of goals tried in one machine."""


Drawn = tuple[dict[str, Obstacle], Array | None, Array | None]
"""Obstacles, start and goal; None if the arm cannot take a curve."""


def _balls(arm: Arm, rng: np.random.Generator) -> Drawn:
    places = _away_from_base(rng, 40, 3)
    return (
        {f"ball{k}": Sphere(tuple(center), 0.06) for k, center in enumerate(places)},
        smooth_configuration(arm, rng, 1.0),
        smooth_configuration(arm, rng, 1.0),
    )


def _posts(arm: Arm, rng: np.random.Generator) -> Drawn:
    places = _away_from_base(rng, 30, 2)
    posts: dict[str, Obstacle] = {
        f"post{k}": Capsule((x, y, -1.0), (x, y, 1.0), 0.025) for k, (x, y) in enumerate(places)
    }
    return posts, smooth_configuration(arm, rng, 1.0), smooth_configuration(arm, rng, 1.0)


def _hole(arm: Arm, rng: np.random.Generator) -> Drawn:
    y, z = rng.uniform(-0.12, 0.12, 2)
    behind = [(0.65, y + rng.uniform(-0.15, 0.15), z), (1.0, y + rng.uniform(-0.3, 0.3), z)]
    goal = _posture_on(arm, [(0.3, 0.8 * y, 0.8 * z), (0.45, y, z), *behind])
    return _wall("wall", 0.45, y, z), *_either_way(rng, smooth_configuration(arm, rng, 1.2), goal)


def _two_walls(arm: Arm, rng: np.random.Generator) -> Drawn:
    y, z = rng.uniform(-0.12, 0.12, 2)
    other_y, other_z = (y, z) + rng.uniform(-0.12, 0.12, 2)
    middle = (0.6, 0.5 * (y + other_y), 0.5 * (z + other_z))
    behind = [middle, (0.75, other_y, other_z), (1.05, other_y + rng.uniform(-0.1, 0.1), other_z)]
    goal = _posture_on(arm, [(0.3, 0.8 * y, 0.8 * z), (0.45, y, z), *behind])
    walls = _wall("front", 0.45, y, z) | _wall("back", 0.75, other_y, other_z)
    return walls, *_either_way(rng, smooth_configuration(arm, rng, 1.2), goal)


def _shelf(arm: Arm, rng: np.random.Generator) -> Drawn:
    boards = (-0.5, -0.25, 0.0, 0.25, 0.5)
    shelf: dict[str, Obstacle] = {
        f"board{k}": Box((0.75, 0.0, z), (0.4, 1.0, 0.02)) for k, z in enumerate(boards)
    }
    shelf |= {f"side{k}": Box((0.75, y, 0.0), (0.4, 0.02, 1.0)) for k, y in enumerate(boards)}
    bays = rng.choice(16, 2, replace=False)
    start, goal = (_posture_on(arm, _in_bay(*divmod(int(bay), 4))) for bay in bays)
    return shelf, start, goal


def _corner(arm: Arm, rng: np.random.Generator) -> Drawn:
    walls: dict[str, Obstacle] = {
        "right": Box((0.45, -0.65, 0.0), (0.1, 1.1, 2.0)),
        "left": Box((0.45, 0.8, 0.0), (0.1, 1.0, 2.0)),
        "behind": Box((0.9, 0.0, 0.0), (0.1, 2.0, 2.0)),
    }
    side = rng.choice([-1.0, 1.0])
    beyond = [(0.5, 0.1, 0.0), (0.66, 0.1 + 0.1 * side, 0.0), (0.68, 0.1 + 0.45 * side, 0.0)]
    return walls, smooth_configuration(arm, rng, 1.2), _posture_on(arm, [(0.33, 0.1, 0.0), *beyond])


def _pipe(arm: Arm, rng: np.random.Generator) -> Drawn:
    """Draw a pipe with two bends that begins in front of the base and ends before the tip."""
    bends = [Bend(0.15, rng.uniform(0.5, 1.1), rng.uniform(0.0, 2.0 * np.pi)) for _ in range(2)]
    axis = pipe_axis((PIPE_BEGINS + 0.05, 0.08, 1.0), bends)
    ends = PIPE_BEGINS + 0.13 + 0.15 * sum(bend.angle for bend in bends) + 0.1
    walls: dict[str, Obstacle] = {**pipe_walls(axis.trimmed(PIPE_BEGINS, ends), PIPE_RADIUS)}
    return walls, *_either_way(rng, smooth_configuration(arm, rng, 1.2), _posture_along(arm, axis))


def _machine(arm: Arm, rng: np.random.Generator) -> Drawn:
    """Draw a scanned housing with a hole in front and parts inside: a point cloud on their surfaces."""
    y, z = rng.uniform(-0.1, 0.1, 2)
    walls = {
        "behind": Box((1.0, 0.0, 0.0), (0.02, 0.7, 0.7)),
        "left": Box((0.7, 0.35, 0.0), (0.6, 0.02, 0.7)),
        "right": Box((0.7, -0.35, 0.0), (0.6, 0.02, 0.7)),
        "above": Box((0.7, 0.0, 0.35), (0.6, 0.7, 0.02)),
        "below": Box((0.7, 0.0, -0.35), (0.6, 0.7, 0.02)),
        "front left": Box((0.4, 0.5 * (y + 0.5 * HOLE + 0.35), 0.0), (0.02, 0.35 - y - 0.5 * HOLE, 0.7)),
        "front right": Box((0.4, 0.5 * (y - 0.5 * HOLE - 0.35), 0.0), (0.02, 0.35 + y - 0.5 * HOLE, 0.7)),
        "front above": Box((0.4, y, 0.5 * (z + 0.5 * HOLE + 0.35)), (0.02, HOLE, 0.35 - z - 0.5 * HOLE)),
        "front below": Box((0.4, y, 0.5 * (z - 0.5 * HOLE - 0.35)), (0.02, HOLE, 0.35 + z - 0.5 * HOLE)),
    }
    parts = {
        f"part {k}": Box(_triple(rng, (0.5, -0.3, -0.3), (0.9, 0.3, 0.3)), _triple(rng, 0.04, 0.16))
        for k in range(8)
    }
    inside = None
    scene = Scene(walls | parts, self_collision=False, margin=CLUTTER_MARGIN + SPARE_CLEARANCE + POINT_RADIUS)
    with no_warnings():
        model = CollisionModel(arm, scene)
    for _ in range(MAX_REACHES):
        towards = _triple(rng, (0.7, -0.25, -0.25), (0.9, 0.25, 0.25))
        inside = _posture_on(arm, [(0.3, 0.8 * y, 0.8 * z), (0.4, y, z), towards])
        if inside is not None and model.minimum(inside).distance >= scene.margin:
            break
        inside = None
    points = np.concatenate([_on_surface(box) for box in scene.obstacles.values() if isinstance(box, Box)])
    scan: dict[str, Obstacle] = {"machine": Scan(points, point_radius=POINT_RADIUS)}
    return scan, *_either_way(rng, smooth_configuration(arm, rng, 1.2), inside)


def _coil(arm: Arm, rng: np.random.Generator) -> Drawn:
    """Draw a helix of more than a turn that becomes another one; the arm is its only obstacle."""
    starts, goals = (
        arm.configuration(coiled(rng.uniform(7.0, 9.0), sign * rng.uniform(1.5, 2.5)))
        for sign in (1.0, rng.choice([-1.0, 1.0]))
    )
    return {}, starts, goals


def _closed(arm: Arm, rng: np.random.Generator) -> Drawn:
    """Draw a wall through the base, closed but for the arm, with the start above and the goal below.

    There is no way. On one, the tip would pass through the plane of the wall, and only within the gap: there
    it is at most sqrt(2) (GAP - THICKNESS - CLUTTER_MARGIN) = 24.0 mm from the base, but the first link,
    which begins at the base, keeps the tip 2 THICKNESS + CLUTTER_MARGIN = 25 mm away.
    """
    wide = 1.2
    wall: dict[str, Obstacle] = {
        "ahead": Box((GAP + 0.5 * wide, 0.0, 0.0), (wide, 2.0 * wide, 0.02)),
        "behind": Box((-GAP - 0.5 * wide, 0.0, 0.0), (wide, 2.0 * wide, 0.02)),
        "left": Box((0.0, GAP + 0.5 * wide, 0.0), (2.0 * GAP, wide, 0.02)),
        "right": Box((0.0, -GAP - 0.5 * wide, 0.0), (2.0 * GAP, wide, 0.02)),
    }
    above, below = smooth_configuration(arm, rng, 1.0), smooth_configuration(arm, rng, 1.0)
    above[0] -= rng.uniform(1.2, 1.9)  # about y: up
    below[0] += rng.uniform(1.2, 1.9)
    return wall, above, below


KINDS_OF_CLUTTER: Mapping[str, Callable[[Arm, np.random.Generator], Drawn]] = MappingProxyType(
    {
        "balls": _balls,
        "posts": _posts,
        "hole": _hole,
        "two-walls": _two_walls,
        "shelf": _shelf,
        "corner": _corner,
        "pipe": _pipe,
        "machine": _machine,
        "coil": _coil,
        "closed": _closed,
    }
)
"""Functions that draw a problem of each kind."""

WITHOUT_A_WAY = ("closed",)
"""Kinds in which no path leads from the start to the goal, by proof."""

FOR_ANY_ARM = ("balls", "posts")
"""Kinds that an arm of any number of joints can meet."""

KINDS_WITH_A_WAY = tuple(kind for kind in KINDS_OF_CLUTTER if kind not in WITHOUT_A_WAY)
"""All others."""


def draw_problem(arm: Arm, kind: str, seed: int) -> Problem:
    """Draw problems for an arm of 1 m until start and goal are clear, without planning.

    For another arm than that of `situation_arm` only those of `FOR_ANY_ARM` are sure to be possible.

    Raises:
        UnknownName: there is no such kind.
        InvalidValue: no draw was clear.
    """
    require_known("kind of clutter", kind, KINDS_OF_CLUTTER)
    rng = np.random.default_rng(seed)
    for _ in range(MAX_DRAWS):
        obstacles, start, goal = KINDS_OF_CLUTTER[kind](arm, rng)
        if start is None or goal is None:
            continue
        scene = Scene(obstacles, self_collision=not obstacles, margin=CLUTTER_MARGIN)
        if kind in WITHOUT_A_WAY:
            scene = replace(scene, self_collision=True, arm_radius=THICKNESS)
        with no_warnings():
            model = CollisionModel(arm, scene)
        if min(model.minimum(q).distance for q in (start, goal)) > CLUTTER_MARGIN + SPARE_CLEARANCE:
            return Problem(arm, start, Target.from_configuration(arm, goal), scene)
    raise InvalidValue("seed", seed, f"one with a clear start and goal in {MAX_DRAWS} draws")


def with_joints(problem: Problem, joints: int) -> Problem | None:
    """Return a problem with an arm of more joints, an even number, in the same postures.

    An arm of more joints has fewer zigzags, so that its tip is farther along, straight on. None if a posture
    is impossible or too close.
    """
    if joints == problem.arm.nv:
        return problem
    arm = Arm.from_template("RyRz", joints // 2, (1.0 / joints, 1.0 / joints))
    goal = problem.target.q
    assert problem.scene is not None and goal is not None
    with no_warnings():
        model = CollisionModel(arm, problem.scene)
    postures = []
    for q in (problem.start, goal):
        state = problem.arm.chain_at(q)
        tip = state.points[-1]
        onward = tip - state.origins[-1]
        beyond = tip + ONWARD * arm.length * onward / np.linalg.norm(onward)
        curve = Curve.spline(np.vstack([state.origins[::2], tip, beyond]))
        posture = _posture_along(arm, curve, "sequential")
        if posture is None or model.minimum(posture).distance <= CLUTTER_MARGIN + SPARE_CLEARANCE / 2:
            return None
        postures.append(posture)
    return Problem(arm, postures[0], Target.from_configuration(arm, postures[1]), problem.scene)


def _away_from_base(rng: np.random.Generator, count: int, axes: int) -> list[Array]:
    places: list[Array] = []
    while len(places) < count:
        point = rng.uniform(-0.75, 0.75, axes)
        if np.linalg.norm(point) > 0.16:
            places.append(point)
    return places


def _wall(name: str, x: float, y: float, z: float) -> dict[str, Obstacle]:
    """Return four boxes around a square hole, perpendicular to x."""
    wide, side = 1.2, 0.5 * HOLE
    return {
        f"{name} left": Box((x, y - side - 0.5 * wide, z), (0.02, wide, 2.0 * wide)),
        f"{name} right": Box((x, y + side + 0.5 * wide, z), (0.02, wide, 2.0 * wide)),
        f"{name} below": Box((x, y, z - side - 0.5 * wide), (0.02, HOLE, wide)),
        f"{name} above": Box((x, y, z + side + 0.5 * wide), (0.02, HOLE, wide)),
    }


def _triple(rng: np.random.Generator, low: float | Vector, high: float | Vector) -> Vector:
    x, y, z = rng.uniform(low, high, 3).tolist()
    return x, y, z


def _on_surface(box: Box) -> Array:
    """Return points on the surface of a box, (n, 3), no farther apart than the diameter of their balls."""
    half, faces = 0.5 * np.array(box.size), []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        along = [np.linspace(-half[k], half[k], 2 + int(half[k] / (0.7 * POINT_RADIUS))) for k in others]
        first, second = (grid.ravel() for grid in np.meshgrid(*along))
        for side in (-half[axis], half[axis]):
            face = np.empty((len(first), 3))
            face[:, axis], face[:, others[0]], face[:, others[1]] = side, first, second
            faces.append(face)
    return np.asarray(np.concatenate(faces) @ np.array(box.rotation).T + np.array(box.center))


def _in_bay(column: int, row: int) -> list[tuple[float, float, float]]:
    y, z = -0.375 + 0.25 * column, -0.375 + 0.25 * row
    return [(0.35, 0.7 * y, 0.7 * z), (0.56, y, z), (1.1, y, z)]


def _posture_on(arm: Arm, points: Sequence[tuple[float, float, float]]) -> Array | None:
    """Return the configuration on a curve from the base through points; None if the arm cannot take it."""
    return _posture_along(arm, Curve.spline(np.array([(0.0, 0.0, 0.0), (0.12, 0.0, 0.0), *points])))


def _posture_along(arm: Arm, curve: Curve, method: Literal["auto", "sequential"] = "auto") -> Array | None:
    with no_warnings():
        try:
            return resolve_targets(arm, curve, placement="as_is", method=method).q
        except PostureError:
            return None


def _either_way(
    rng: np.random.Generator, outside: Array, inside: Array | None
) -> tuple[Array | None, Array | None]:
    """Return start and goal: in two of three problems the arm enters, in the third it comes out."""
    return (outside, inside) if rng.random() < 2.0 / 3.0 else (inside, outside)
