"""Path planning among obstacles: random problems of nine kinds, and their solutions."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from itertools import pairwise, product
from math import ceil
from time import perf_counter
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.studies.record import Spread, check_study, grouped, one_line, run_all
from benchmarks.studies.scenes import coiled, situation_arm
from pinposture._validation import Vector, require_known
from pinposture.arm import Arm, smooth_configuration
from pinposture.collision import Box, Capsule, CollisionModel, Obstacle, Scan, Scene, Sphere
from pinposture.collision.pipe import Bend, pipe_axis, pipe_walls
from pinposture.control import Limits, plan
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, PostureError, no_warnings
from pinposture.motion import Trajectory, track
from pinposture.motion.processes import Progress
from pinposture.motion.trajectory import path_length_ratio
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

DENSE_TURN = 0.01
"""Joint motion between samples at which the clearance of a path is checked [rad]."""

MAX_DRAWS, MAX_REACHES, MAX_RUN_STEPS = 5000, 200, 6000
"""Maximum number of draws of a problem, of goals tried in one machine, and of steps of a run."""

RUN_LIMITS = Limits(step=None, velocity=1.0, acceleration=5.0, dt=0.02)


class ClutterProblem(NamedTuple):
    """A scene and two collision-free configurations, (nq,)."""

    scene: Scene
    start: Array
    goal: Array


Drawn = tuple[dict[str, Obstacle], Array | None, Array | None]
"""Obstacles, start and goal; None if the arm cannot take a curve."""


def _balls(arm: Arm, rng: np.random.Generator) -> Drawn:
    places = _away_from_base(rng, 40, 3)
    return (
        {f"ball{k}": Sphere(tuple(place), 0.06) for k, place in enumerate(places)},
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
    }
)
"""Functions that draw a problem of each kind."""


def draw_problem(arm: Arm, kind: str, seed: int) -> ClutterProblem:
    """Draw problems for the arm of `situation_arm` until start and goal are clear, without planning.

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
        with no_warnings():
            model = CollisionModel(arm, scene)
        if min(model.minimum(q).distance for q in (start, goal)) > CLUTTER_MARGIN + SPARE_CLEARANCE:
            return ClutterProblem(scene, start, goal)
    raise InvalidValue("seed", seed, f"one with a clear start and goal in {MAX_DRAWS} draws")


def _away_from_base(rng: np.random.Generator, count: int, axes: int) -> list[Array]:
    places: list[Array] = []
    while len(places) < count:
        place = rng.uniform(-0.75, 0.75, axes)
        if np.linalg.norm(place) > 0.16:
            places.append(place)
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
    half, found = 0.5 * np.array(box.size), []
    for axis in range(3):
        others = [k for k in range(3) if k != axis]
        along = [np.linspace(-half[k], half[k], 2 + int(half[k] / (0.7 * POINT_RADIUS))) for k in others]
        first, second = (each.ravel() for each in np.meshgrid(*along))
        for side in (-half[axis], half[axis]):
            face = np.empty((len(first), 3))
            face[:, axis], face[:, others[0]], face[:, others[1]] = side, first, second
            found.append(face)
    return np.asarray(np.concatenate(found) @ np.array(box.rotation).T + np.array(box.center))


def _in_bay(column: int, row: int) -> list[tuple[float, float, float]]:
    y, z = -0.375 + 0.25 * column, -0.375 + 0.25 * row
    return [(0.35, 0.7 * y, 0.7 * z), (0.56, y, z), (1.1, y, z)]


def _posture_on(arm: Arm, points: Sequence[tuple[float, float, float]]) -> Array | None:
    """Return the configuration on a curve from the base through points; None if the arm cannot take it."""
    return _posture_along(arm, Curve.spline(np.array([(0.0, 0.0, 0.0), (0.12, 0.0, 0.0), *points])))


def _posture_along(arm: Arm, curve: Curve) -> Array | None:
    with no_warnings():
        try:
            return resolve_targets(arm, curve, placement="as_is").q
        except PostureError:
            return None


def _either_way(
    rng: np.random.Generator, outside: Array, inside: Array | None
) -> tuple[Array | None, Array | None]:
    """Return start and goal: in two of three problems the arm enters, in the third it comes out."""
    return (outside, inside) if rng.random() < 2.0 / 3.0 else (inside, outside)


class ClutterRun(NamedTuple):
    """Result of one problem.

    Attributes:
        kind: the kind of the problem.
        seed: its seed.
        found_by: how the path was found, see `JointPath.found_by`.
        planned: whether the plan is reported as collision-free.
        hindrance: what it comes too close to, if not.
        plan_time: wall time for planning [s].
        path_length_ratio: path length of the control points on the plan relative to straight lines.
        plan_clearance: smallest distance on the plan, every 0.01 rad [m].
        reached: whether `track` reached the goal within its velocity and acceleration limits.
        reason: why the run ended.
        run_clearance: smallest distance in the run, every 0.01 rad [m].
        margin: the distance to keep [m].
    """

    kind: str
    seed: int
    found_by: str
    planned: bool
    hindrance: str
    plan_time: float
    path_length_ratio: float
    plan_clearance: float
    reached: bool
    reason: str
    run_clearance: float
    margin: float


def dense_clearance(arm: Arm, scene: Scene, q: Array) -> float:
    """Return the smallest distance on the straight motions between configurations, (N, nq) [m].

    Apart from the distance computation, this is independent of the checks during planning.
    """
    model, least = CollisionModel(arm, scene), np.inf
    for one, other in pairwise(q):
        change = np.asarray(arm.difference(one, other))
        count = max(ceil(float(np.abs(change).max()) / DENSE_TURN), 1)
        shares = np.arange(1, count + 1)[:, None] / count
        least = min(least, model.minimum_along(arm.checked(one), shares * change).distance)
    return float(least)


def run_problem(arm: Arm, problem: ClutterProblem) -> Trajectory:
    """Run a problem within velocity and acceleration limits."""
    target = Target.from_configuration(arm, problem.goal)
    return track(arm, target, problem.start, limits=RUN_LIMITS, scene=problem.scene, max_steps=MAX_RUN_STEPS)


def solve_problem(arm: Arm, kind: str, seed: int) -> ClutterRun:
    """Plan and run a problem, and evaluate both."""
    problem = draw_problem(arm, kind, seed)
    target, state = Target.from_configuration(arm, problem.goal), arm.at(problem.start)
    began = perf_counter()
    path = plan(state, target, problem.scene, RUN_LIMITS)
    took = perf_counter() - began
    run = run_problem(arm, problem)
    points = np.array([arm.at(q).compiled.points for q in path.configurations])
    return ClutterRun(
        kind=kind,
        seed=seed,
        found_by=path.found_by,
        planned=not path.hindrance,
        hindrance=path.hindrance,
        plan_time=took,
        path_length_ratio=path_length_ratio(points),
        plan_clearance=dense_clearance(arm, problem.scene, path.configurations),
        reached=run.converged and run.excess is None,
        reason=one_line(run.reason),
        run_clearance=dense_clearance(arm, problem.scene, run.q),
        margin=problem.scene.margin,
    )


class ClutterRow(NamedTuple):
    """Summary of the problems of a kind.

    Attributes:
        kind: the kind.
        problems: number of problems.
        planned: number of plans reported as collision-free.
        reached: number of runs that reached the goal.
        clearance: smallest distance in any run that reached the goal, minus the margin [m].
        plan_time, path_length_ratio: those of `ClutterRun`.
        found_by: number of plans found by each method.
    """

    kind: str
    problems: int
    planned: int
    reached: int
    clearance: float
    plan_time: Spread
    path_length_ratio: Spread
    found_by: dict[str, int]


def study_clutter(
    kinds: Sequence[str] = tuple(KINDS_OF_CLUTTER),
    seeds: int = 10,
    first_seed: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[ClutterRun]:
    """Solve problems of several kinds with an arm of 20 modules, 1 m.

    Args:
        kinds: some of `KINDS_OF_CLUTTER`.
        seeds: number of problems of each kind.
        first_seed: seed of the first.
        jobs: number of processes.
        progress: called with the numbers of finished and of all problems.

    Raises:
        InvalidValue: no kind, or invalid numbers.
        UnknownName: there is no such kind.
    """
    check_study(first_seed, seeds=seeds, kinds=kinds)
    for kind in kinds:
        require_known("kind of clutter", kind, KINDS_OF_CLUTTER)
    cases = product([situation_arm()], kinds, range(first_seed, first_seed + seeds))
    return run_all(solve_problem, cases, jobs, progress)


def by_kind(runs: Sequence[ClutterRun]) -> list[ClutterRow]:
    """Summarise runs by kind, in order of first appearance."""
    return [
        ClutterRow(
            kind=kind,
            problems=len(own),
            planned=sum(run.planned for run in own),
            reached=sum(run.reached for run in own),
            clearance=min((run.run_clearance - run.margin for run in own if run.reached), default=np.inf),
            plan_time=Spread.of([run.plan_time for run in own]),
            path_length_ratio=Spread.of([run.path_length_ratio for run in own]),
            found_by=dict(Counter(run.found_by for run in own)),
        )
        for kind, own in grouped(runs, lambda run: run.kind).items()
    ]
