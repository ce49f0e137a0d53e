"""Obstacles as hands take hold of them: edits, handles, and where a new one is put."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from copy import copy
from dataclasses import replace
from itertools import count
from typing import NamedTuple, TypeAlias

import coal
import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import Matrix, Vector
from pinposture._validation import point as checked_point
from pinposture.arm import Arm
from pinposture.collision import Box, Capsule, Cylinder, HalfSpace, Mesh, Obstacle, Scene, Sphere
from pinposture.collision.distances import Narrow
from pinposture.collision.obstacles import solid
from pinposture.collision.scene import obstacles_around
from pinposture.editor.edits import Edit, with_obstacle
from pinposture.editor.session import Proposal, Session
from pinposture.errors import InvalidValue, PostureError, TaskError, UnknownName
from pinposture.task import Task

# Taking hold of obstacles: where they are, how they are turned, and what becomes of them when pulled.

Array = NDArray[np.float64]

GAP = 0.025
"""How far outside of an obstacle the handles are that change its size, relative to the arm."""

LEAST = 2e-3
"""How small an obstacle can be pulled, relative to the arm."""

ASIDE = 0.3
"""How far beside the middle of a half-space its handle is, relative to the arm."""

DIGITS = 6
"""Digits behind the point to which places and sizes that come from the mouse are rounded [m]."""


class Measures(NamedTuple):
    """What is large and what is small around an arm.

    Attributes:
        middle: where half-spaces, which have no end, are taken hold of: the point of theirs nearest to it,
            (3,) [m], world frame.
        length: of the arm [m].
    """

    middle: Array
    length: float

    @classmethod
    def of(cls, arm: Arm) -> Measures:
        """Those of an arm: the middle is half way along it where it is straight."""
        state = arm.at(arm.straight())
        return cls(0.5 * (arm.chain.base + state.points[-1]), arm.length)

    @property
    def gap(self) -> float:
        """How far outside of an obstacle handles are [m]."""
        return GAP * self.length

    @property
    def least(self) -> float:
        """How small obstacles can be pulled [m]."""
        return LEAST * self.length


class Pose(NamedTuple):
    """Where an obstacle is.

    Attributes:
        position: of its middle, (3,) [m], world frame.
        rotation: from its axes to the world's, (3, 3). The third is the axis of what has but one.
    """

    position: Array
    rotation: Array


class Grip(NamedTuple):
    """A handle that changes the size of an obstacle.

    Attributes:
        name: "x", "y", "z", "radius", "start", "end" or "height".
        place: where it is, (3,) [m], world frame.
    """

    name: str
    place: Array


def pose_of(obstacle: Obstacle, measures: Measures) -> Pose:
    """Where an obstacle is."""
    if isinstance(obstacle, Sphere):
        return Pose(np.array(obstacle.center), np.eye(3))
    if isinstance(obstacle, Box):
        return Pose(np.array(obstacle.center), np.array(obstacle.rotation))
    if isinstance(obstacle, Mesh):
        turn = np.array(obstacle.rotation)
        return Pose(obstacle.center + turn @ _center(obstacle), turn)
    if isinstance(obstacle, HalfSpace):
        normal = np.array(obstacle.normal)
        height = normal @ (measures.middle - obstacle.point)
        return Pose(measures.middle - height * normal, turn_to(normal))
    start, end = np.array(obstacle.start), np.array(obstacle.end)
    return Pose(0.5 * (start + end), turn_to(end - start))


def at_pose(obstacle: Obstacle, pose: Pose) -> Obstacle:
    """An obstacle elsewhere, otherwise turned.

    Raises:
        InvalidValue: a place beyond all bounds.
    """
    position, turn = pose
    if isinstance(obstacle, Sphere):
        return replace(obstacle, center=_rounded(position))
    if isinstance(obstacle, Box):
        return replace(obstacle, center=_rounded(position), rotation=_matrix(turn))
    if isinstance(obstacle, Mesh):
        return _placed(obstacle, position - turn @ _center(obstacle), turn)
    if isinstance(obstacle, HalfSpace):
        return replace(obstacle, point=_rounded(position), normal=_vector(turn[:, 2]))
    half = 0.5 * float(np.linalg.norm(np.subtract(obstacle.end, obstacle.start))) * turn[:, 2]
    return replace(obstacle, start=_rounded(position - half), end=_rounded(position + half))


def moved(obstacle: Obstacle, shift: ArrayLike) -> Obstacle:
    """An obstacle elsewhere, turned as it was.

    Args:
        obstacle: the obstacle.
        shift: how far, (3,) [m], world axes.

    Raises:
        InvalidValue: a place beyond all bounds.
    """
    by = np.asarray(shift, dtype=np.float64)
    if isinstance(obstacle, Mesh):
        return _placed(obstacle, obstacle.center + by, np.array(obstacle.rotation))
    if isinstance(obstacle, HalfSpace):
        return replace(obstacle, point=_rounded(obstacle.point + by))
    if isinstance(obstacle, (Capsule, Cylinder)):
        return replace(obstacle, start=_rounded(obstacle.start + by), end=_rounded(obstacle.end + by))
    return replace(obstacle, center=_rounded(obstacle.center + by))


def grips(obstacle: Obstacle, measures: Measures) -> tuple[Grip, ...]:
    """The handles that change the size of an obstacle, just outside of it.

    A box has them on three faces that meet; those across stay where they are. A ball has one. A cylinder and
    a capsule have one at each end, and one for the radius. A half-space has one above its surface, and a mesh
    has none.
    """
    pose, gap = pose_of(obstacle, measures), measures.gap
    if isinstance(obstacle, Box):
        half = 0.5 * np.array(obstacle.size)
        return tuple(
            Grip(name, pose.position - (half[k] + gap) * pose.rotation[:, k]) for k, name in enumerate("xyz")
        )
    if isinstance(obstacle, Sphere):
        return (Grip("radius", pose.position - (obstacle.radius + gap) * pose.rotation[:, 0]),)
    if isinstance(obstacle, HalfSpace):
        foot = pose.position - ASIDE * measures.length * pose.rotation[:, 0]
        return (Grip("height", foot + gap * pose.rotation[:, 2]),)
    if isinstance(obstacle, Mesh):
        return ()
    beyond = (gap + _cap(obstacle)) * pose.rotation[:, 2]
    return (
        Grip("start", obstacle.start - beyond),
        Grip("end", obstacle.end + beyond),
        Grip("radius", pose.position - (obstacle.radius + gap) * pose.rotation[:, 0]),
    )


def pulled(obstacle: Obstacle, grip: str, place: ArrayLike, measures: Measures) -> Obstacle:
    """An obstacle with one of its handles elsewhere, or as near to there as it can be.

    Args:
        obstacle: the obstacle.
        grip: name of the handle.
        place: where it is put, (3,) [m], world frame.
        measures: those of the arm.

    Raises:
        InvalidValue: a place beyond all bounds.
    """
    pose, gap, least = pose_of(obstacle, measures), measures.gap, measures.least
    off = np.asarray(place, dtype=np.float64) - pose.position
    if isinstance(obstacle, Box):
        axis = "xyz".index(grip)
        direction, half = pose.rotation[:, axis], 0.5 * obstacle.size[axis]
        edge = max(float(half - off @ direction) - gap, least)
        size = list(obstacle.size)
        size[axis] = round(edge, DIGITS)
        center = pose.position + (half - 0.5 * edge) * direction  # the face across stays where it is
        return replace(obstacle, center=_rounded(center), size=_vector(np.array(size)))
    if isinstance(obstacle, HalfSpace):
        height = float(off @ pose.rotation[:, 2]) - gap
        return replace(obstacle, point=_rounded(pose.position + height * pose.rotation[:, 2]))
    if isinstance(obstacle, Mesh):
        return obstacle
    if grip == "radius":
        radius = max(float(-off @ pose.rotation[:, 0]) - gap, least)
        return replace(obstacle, radius=round(radius, DIGITS))
    assert not isinstance(obstacle, Sphere)
    fixed = np.array(obstacle.end if grip == "start" else obstacle.start)
    way = np.asarray(place, dtype=np.float64) - fixed
    length = float(np.linalg.norm(way))
    sign = -1.0 if grip == "start" else 1.0
    direction = way / length if length > least else sign * pose.rotation[:, 2]
    end = fixed + max(length - gap - _cap(obstacle), least) * direction
    return replace(obstacle, start=_rounded(end)) if grip == "start" else replace(obstacle, end=_rounded(end))


def turn_to(axis: ArrayLike) -> Array:
    """The shortest turn that lays the third axis along another, (3, 3)."""
    x, y, z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(np.asarray(axis, dtype=np.float64))
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    share = 1.0 / (1.0 + z)
    return np.array(
        [[1.0 - share * x * x, -share * x * y, x], [-share * x * y, 1.0 - share * y * y, y], [-x, -y, z]]
    )


def reach(obstacle: Obstacle) -> float:
    """How far from its middle an obstacle goes [m]; 0 for a half-space."""
    if isinstance(obstacle, Sphere):
        return obstacle.radius
    if isinstance(obstacle, Box):
        return 0.5 * float(np.linalg.norm(obstacle.size))
    if isinstance(obstacle, HalfSpace):
        return 0.0
    if isinstance(obstacle, Mesh):
        return float(np.linalg.norm(np.array(obstacle.vertices) - _center(obstacle), axis=1).max())
    half = 0.5 * float(np.linalg.norm(np.subtract(obstacle.end, obstacle.start)))
    return half + obstacle.radius if isinstance(obstacle, Capsule) else float(np.hypot(half, obstacle.radius))


def _cap(obstacle: Capsule | Cylinder) -> float:
    """How far it goes on beyond its ends [m]."""
    return obstacle.radius if isinstance(obstacle, Capsule) else 0.0


def _center(mesh: Mesh) -> Array:
    """The middle of a mesh, in its own frame (3,) [m]."""
    corners = np.array(mesh.vertices)
    return np.asarray(0.5 * (corners.min(axis=0) + corners.max(axis=0)))


def _placed(mesh: Mesh, center: Array, turn: Array) -> Mesh:
    """A mesh elsewhere, without its hull being worked out again."""
    other = copy(mesh)
    object.__setattr__(other, "center", checked_point("center", _rounded(center)))
    object.__setattr__(other, "rotation", _matrix(turn))
    return other


def _rounded(place: Array) -> Vector:
    return _vector(np.round(place, DIGITS))


def _vector(numbers: Array) -> Vector:
    x, y, z = (float(each) + 0.0 for each in numbers)  # 0 rather than -0
    return x, y, z


def _matrix(turn: Array) -> Matrix:
    x, y, z = (_vector(row) for row in np.where(np.abs(turn) < 1e-12, 0.0, turn))
    return x, y, z


# Where a new obstacle is put: near the arm, so that it is seen, and clear of it.

ROOM = 0.05
"""How far from the arm, and from other obstacles, it is at least, relative to the arm."""

BELOW = 0.1
"""How far below the arm a new floor is, relative to the arm."""

ALONG = (0.6, 0.4, 0.8, 1.0, 0.25)
"""Where along the arm it is tried, in turn."""

SIDEWAYS = (0.2, 0.3, 0.45, 0.65, 0.9, 1.3)
"""How far from there, relative to the arm."""

SAMPLES = 200
"""Points of the arm that are looked at."""


def _sphere(center: Array, axis: Array, length: float) -> Obstacle:
    del axis
    return Sphere(_as_vector(center), round(0.06 * length, DIGITS))


def _box(center: Array, axis: Array, length: float) -> Obstacle:
    del axis
    edge = round(0.12 * length, DIGITS)
    return Box(_as_vector(center), (edge, edge, edge))


def _cylinder(center: Array, axis: Array, length: float) -> Obstacle:
    half = 0.12 * length * axis
    return Cylinder(_as_vector(center - half), _as_vector(center + half), round(0.03 * length, DIGITS))


def _capsule(center: Array, axis: Array, length: float) -> Obstacle:
    half = 0.1 * length * axis
    return Capsule(_as_vector(center - half), _as_vector(center + half), round(0.03 * length, DIGITS))


SOLIDS: dict[str, Callable[[Array, Array, float], Obstacle]] = {
    "sphere": _sphere,
    "box": _box,
    "cylinder": _cylinder,
    "capsule": _capsule,
}
"""Makes an obstacle of each kind about a centre, along an axis, for an arm of some length."""

KINDS = (*SOLIDS, "half_space")
"""Kinds of obstacles that can be made new."""


def new_obstacle(kind: str, arm: Arm, points: Array, scene: Scene | None) -> Obstacle:
    """An obstacle of a kind, as large as suits the arm, where neither the arm nor another obstacle is.

    Where there is no such place it is put as far from the arm as was tried.

    Args:
        kind: of `KINDS`.
        arm: the arm.
        points: where it is, from base to tip, and perhaps where it is to be, from tip to base, (n, 3) [m],
            world frame.
        scene: what is there already; None if there is nothing.

    Raises:
        UnknownName: there is no such kind.
    """
    if kind not in KINDS:
        raise UnknownName("kind of obstacle", kind, KINDS)
    path = _finer(np.vstack([arm.chain.base, points]))
    up = arm.plane[np.abs(arm.plane[:, 2]).argmax()] if arm.dimension == 2 else np.array([0.0, 0.0, 1.0])
    up = -up if up[2] < 0.0 else up
    if kind == "half_space":
        low = float((path @ up).min()) - BELOW * arm.length
        return HalfSpace(_as_vector(arm.chain.base + (low - arm.chain.base @ up) * up), _as_vector(up))
    axis = np.cross(*arm.plane) if arm.dimension == 2 else up
    tried: list[tuple[float, Obstacle]] = []
    for center in _places(arm, path, up):
        obstacle = SOLIDS[kind](center, axis, arm.length)
        room = float(np.linalg.norm(path - center, axis=1).min()) - reach(obstacle)
        if room >= ROOM * arm.length and _free(scene, center, reach(obstacle) + ROOM * arm.length):
            return obstacle
        tried.append((room, obstacle))
    return max(tried, key=lambda each: each[0])[1]


def _places(arm: Arm, path: Array, up: Array) -> Iterator[Array]:
    """Places beside the arm, near ones first."""
    ahead = path[-1] - path[0]
    if float(np.linalg.norm(ahead)) < 1e-3 * arm.length:  # it is closed to a ring
        ahead = arm.plane[0]
    if arm.dimension == 2:
        across = arm.plane.T @ np.array([[0.0, -1.0], [1.0, 0.0]]) @ (arm.plane @ ahead)
        sides = [across, -across]
    else:
        across = np.cross(up, ahead)
        across = across if np.linalg.norm(across) > 1e-3 * arm.length else np.array([0.0, 1.0, 0.0])
        sides = [-across, across, np.cross(ahead, across)]
    for aside in SIDEWAYS:
        for along in ALONG:
            for side in sides:
                size = float(np.linalg.norm(side))
                if size > 0.0:
                    yield path[round(along * (SAMPLES - 1))] + aside * arm.length * side / size


def _finer(points: Array) -> Array:
    """Points evenly along the line through others, (SAMPLES, 3)."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], SAMPLES)
    return np.stack([np.interp(at, along, points[:, k]) for k in range(3)], axis=1)


def _free(scene: Scene | None, center: Array, radius: float) -> bool:
    """Whether nothing of a scene is within a distance of a place."""
    if scene is None:
        return True
    ball, narrow = coal.Sphere(radius), Narrow()
    at = coal.Transform3s(np.eye(3), center)
    for obstacle in scene.obstacles.values():
        shape = solid(obstacle)
        posed = (ball, at, shape.geometry, coal.Transform3s(shape.rotation, shape.position))
        if not narrow.distance(posed) > 0.0:
            return False
    return True


def _as_vector(place: Array) -> tuple[float, float, float]:
    x, y, z = (round(float(each), DIGITS) for each in place)
    return x, y, z


# What hands do to the obstacles of a task: each of these is a request for the editor's loop.

Change: TypeAlias = Callable[[Obstacle], Obstacle]


def obstacles_of(task: Task) -> dict[str, Obstacle]:
    """The obstacles of a task, by name."""
    return {} if task.scene is None else dict(task.scene.obstacles)


def with_sound_obstacle(name: str, obstacle: Obstacle, instead: str | None = None) -> Edit:
    """As `with_obstacle`; refused if the obstacle stands where the base of the arm is."""
    put = with_obstacle(name, obstacle, instead)

    def edit(task: Task) -> Task:
        base = task.arm.chain.base
        if obstacles_around(Scene({name: obstacle}), base):
            at = ", ".join(f"{value:.4g}" for value in base)
            raise TaskError(f"obstacle {name!r}", f"it would stand where the base of the arm is, at ({at}) m")
        return put(task)

    return edit


def select_obstacle(name: str | None, session: Session) -> None:
    """Select an obstacle, in place of a control point of the curve."""
    if name is not None and name not in obstacles_of(session.shown):
        return
    if session.obstacle != name or (name is not None and session.handle is not None):
        session.obstacle = name
        session.handle = None if name is not None else session.handle


def add_obstacle(kind: str, points: Array, session: Session) -> None:
    """Add an obstacle of a kind.

    Args:
        kind: of `new_obstacles.KINDS`.
        points: where the arm is, from base to tip, (n, 3) [m].
        session: what is edited.
    """
    obstacle = new_obstacle(kind, session.arm, points, session.task.scene)
    take_in(free_name(kind, obstacles_of(session.task)), obstacle, session)


def take_in(name: str, obstacle: Obstacle, session: Session) -> None:
    """Add an obstacle that is there, and select it."""
    if session.edit(with_sound_obstacle(name, obstacle), f"added {name}"):
        select_obstacle(name, session)


def delete_obstacle(session: Session) -> None:
    """Delete the obstacle that is selected."""
    name = session.obstacle
    if name is None:
        session.say("no obstacle is selected: click on one first", "warning")
        return
    session.proposal = None
    session.edit(with_obstacle(name, None), f"deleted {name}")


def rename_obstacle(name: str, to: str, session: Session) -> None:
    """Give an obstacle another name; it keeps its place in the order."""
    obstacle, to = obstacles_of(session.task).get(name), to.strip()
    if obstacle is None or to == name:
        return
    session.proposal = None
    if session.edit(with_obstacle(to, obstacle, instead=name), f"renamed {name} to {to}"):
        session.obstacle = to


def rearrange(name: str, change: Change, what: str, final: bool, session: Session) -> None:
    """Move, turn or resize an obstacle.

    While the hand is at it each change is made to the obstacle from before, and nothing counts; all of it
    then is one step to undo.

    Args:
        name: of the obstacle.
        change: what to do to it.
        what: the same in words.
        final: whether it is to count.
        session: what is edited.
    """
    obstacle = obstacles_of(session.task).get(name)
    if obstacle is None:
        return
    select_obstacle(name, session)
    if final:
        session.proposal = None
        try:
            other = change(obstacle)
        except PostureError as error:
            session.say(str(error), "error")
            other = obstacle
        if other == obstacle or not session.edit(with_sound_obstacle(name, other, instead=name), what):
            session.touch()  # what was proposed before is gone
        return
    try:
        task = with_sound_obstacle(name, change(obstacle), instead=name)(session.task)
    except PostureError as error:
        if session.notice.text != " ".join(str(error).split()):
            session.say(str(error), "warning")
        return
    # The solver is told at its own pace: see `Surroundings`.
    session.proposal = Proposal(task, what, False, session.number + 1)


def edit_obstacle(name: str, key: str, value: object, final: bool, session: Session) -> None:
    """Give an obstacle another value: of its centre, size, radius and so on, by the name of the attribute."""

    def change(obstacle: Obstacle) -> Obstacle:
        if not hasattr(obstacle, key):  # it has become another one since
            raise InvalidValue(f"{key} of {name}", value, f"nothing, of a {obstacle.type}")
        return replace(obstacle, **{key: value})  # type: ignore[arg-type]

    rearrange(name, change, f"changed {name}", final, session)


def free_name(kind: str, taken: dict[str, Obstacle]) -> str:
    """A name that no obstacle has: of the kind, with a number."""
    return next(name for k in count(1) if (name := f"{kind}_{k}") not in taken)
