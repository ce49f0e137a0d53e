"""Obstacles that can be dragged: their handles, where new ones are placed, and requests that change them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import fields, replace
from itertools import count
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import Matrix, Vector, require_known
from pinposture.arm import Arm
from pinposture.collision import Box, Capsule, Cylinder, HalfSpace, Mesh, Obstacle, Scan, Scene, Sphere
from pinposture.collision.obstacles import DIRECTIONS, OBSTACLE_TYPES, PLACES
from pinposture.collision.scene import obstacles_around, obstacles_near
from pinposture.collision.shapes import MeshShape
from pinposture.editor.edits import Edit, with_obstacle
from pinposture.editor.session import Proposal, Session
from pinposture.errors import InvalidValue, PostureError, TaskError
from pinposture.task import Task

Array = NDArray[np.float64]
Change: TypeAlias = Callable[[Obstacle], Obstacle]

COORDINATE_DIGITS = 6  # of places and sizes that come from the mouse [m]

# Relative to the length of the arm:
HANDLE_GAP = 0.025  # between an obstacle and the handles that change its size
MIN_SIZE = 2e-3  # of an obstacle that is resized
HALF_SPACE_OFFSET = 0.3  # of the handle of a half-space from its middle
CLEAR_ROOM = 0.05  # between a new obstacle and the arm or other obstacles
FLOOR_DEPTH = 0.1  # of a new half-space below the arm
OFFSETS = (0.2, 0.3, 0.45, 0.65, 0.9, 1.3)  # of a new obstacle sideways from the arm, tried in turn

DRAG_PAUSE = 0.15  # after the last move, for a dragged obstacle to count as at rest [s]
DRAG_FILTER_TIME = 0.03  # time constant of the filter of its velocity [s]

FRACTIONS = (0.6, 0.4, 0.8, 1.0, 0.25)  # places along the arm beside which a new obstacle is tried, in turn
ARM_SAMPLES = 200  # points of the arm that a new obstacle keeps away from


class ArmScale(NamedTuple):
    """The size of an arm, for handles."""

    middle: Array  # half-spaces have their handles at their point nearest to this, (3,) [m], world frame
    length: float  # of the arm [m]

    @classmethod
    def of(cls, arm: Arm) -> ArmScale:
        """Return the scale of an arm, with the middle half way along the straight arm."""
        state = arm.at(arm.straight())
        return cls(0.5 * (arm.chain.base + state.points[-1]), arm.length)

    @property
    def gap(self) -> float:
        """Distance of handles from an obstacle [m]."""
        return HANDLE_GAP * self.length

    @property
    def least(self) -> float:
        """Smallest size of an obstacle [m]."""
        return MIN_SIZE * self.length


class Pose(NamedTuple):
    """The pose of an obstacle."""

    position: Array  # of its middle, (3,) [m], world frame
    rotation: Array  # from its axes to the world's, (3, 3). The third is the axis of obstacles with only one


class SizeHandle(NamedTuple):
    """A handle that changes the size of an obstacle."""

    name: str  # "x", "y", "z", "radius", "start", "end" or "height"
    place: Array  # where it is, (3,) [m], world frame


def pose_of(obstacle: Obstacle, scale: ArmScale) -> Pose:
    """Return the pose of an obstacle."""
    if isinstance(obstacle, Sphere):
        return Pose(np.array(obstacle.center), np.eye(3))
    if isinstance(obstacle, Box | MeshShape):
        return Pose(np.array(obstacle.center), np.array(obstacle.rotation))
    if isinstance(obstacle, Mesh | Scan):
        rotation = np.array(obstacle.rotation)
        return Pose(obstacle.center + rotation @ _center(obstacle), rotation)
    if isinstance(obstacle, HalfSpace):
        normal = np.array(obstacle.normal)
        height = normal @ (scale.middle - obstacle.point)
        return Pose(scale.middle - height * normal, rotation_to(normal))
    start = np.array(obstacle.start)
    end = np.array(obstacle.end)
    return Pose(0.5 * (start + end), rotation_to(end - start))


def at_pose(obstacle: Obstacle, pose: Pose) -> Obstacle:
    """Return an obstacle at another pose.

    Raises:
        InvalidValue: coordinates out of bounds.
    """
    position, rotation = pose
    if isinstance(obstacle, Sphere):
        return replace(obstacle, center=_rounded(position))
    if isinstance(obstacle, Box | MeshShape):
        changes: dict[str, Any] = {"center": _rounded(position), "rotation": _matrix(rotation)}
        return replace(obstacle, **changes)
    if isinstance(obstacle, Mesh | Scan):
        return obstacle.placed(_rounded(position - rotation @ _center(obstacle)), _matrix(rotation))
    if isinstance(obstacle, HalfSpace):
        return replace(obstacle, point=_rounded(position), normal=_vector(rotation[:, 2]))
    half = 0.5 * float(np.linalg.norm(np.subtract(obstacle.end, obstacle.start))) * rotation[:, 2]
    return replace(obstacle, start=_rounded(position - half), end=_rounded(position + half))


def own_shape(obstacle: Obstacle) -> tuple[object, ...]:
    """Return what the surface of an obstacle depends on in its own frame: its type, and its size."""
    if isinstance(obstacle, Mesh | Scan):
        return obstacle.type, obstacle.placed((0.0, 0.0, 0.0))
    if isinstance(obstacle, Capsule | Cylinder):
        length = float(np.linalg.norm(np.subtract(obstacle.end, obstacle.start)))
        return obstacle.type, obstacle.radius, round(length, COORDINATE_DIGITS - 1)
    names = (each.name for each in fields(obstacle) if each.name not in (*PLACES, *DIRECTIONS))
    return obstacle.type, *(getattr(obstacle, name) for name in names)


def moved(obstacle: Obstacle, shift: ArrayLike) -> Obstacle:
    """Return an obstacle moved without being turned.

    Args:
        obstacle: the obstacle.
        shift: the displacement, (3,) [m], world frame.

    Raises:
        InvalidValue: coordinates out of bounds.
    """
    by = np.asarray(shift, dtype=np.float64)
    if isinstance(obstacle, Mesh | Scan):
        return obstacle.placed(_rounded(obstacle.center + by), obstacle.rotation)
    places = (name for name in PLACES if hasattr(obstacle, name))
    changes: dict[str, Any] = {name: _rounded(getattr(obstacle, name) + by) for name in places}
    return replace(obstacle, **changes)


def size_handles(obstacle: Obstacle, scale: ArmScale) -> tuple[SizeHandle, ...]:
    """Return the handles that change the size of an obstacle, just outside of it.

    A box has them on three faces that meet; those across stay where they are. A ball has one. A cylinder and
    a capsule have one at each end, and one for the radius. A half-space has one above its surface. Meshes,
    scans and types that a mesh represents have none.
    """
    pose = pose_of(obstacle, scale)
    gap = scale.gap
    if isinstance(obstacle, Box):
        half = 0.5 * np.array(obstacle.size)
        places = (pose.position - (half[k] + gap) * pose.rotation[:, k] for k in range(3))
        return tuple(SizeHandle(name, place) for name, place in zip("xyz", places, strict=True))
    if isinstance(obstacle, HalfSpace):
        foot = pose.position - HALF_SPACE_OFFSET * scale.length * pose.rotation[:, 0]
        return (SizeHandle("height", foot + gap * pose.rotation[:, 2]),)
    if isinstance(obstacle, Mesh | Scan | MeshShape):
        return ()
    radius = SizeHandle("radius", pose.position - (obstacle.radius + gap) * pose.rotation[:, 0])
    if isinstance(obstacle, Sphere):
        return (radius,)
    beyond = (gap + _cap_length(obstacle)) * pose.rotation[:, 2]
    return SizeHandle("start", obstacle.start - beyond), SizeHandle("end", obstacle.end + beyond), radius


def resized(obstacle: Obstacle, handle: str, place: ArrayLike, scale: ArmScale) -> Obstacle:
    """Return an obstacle with one of its handles at another place, or as near to it as possible.

    Args:
        obstacle: the obstacle.
        handle: name of the handle.
        place: where it is dragged, (3,) [m], world frame.
        scale: that of the arm.

    Raises:
        InvalidValue: coordinates out of bounds.
    """
    pose = pose_of(obstacle, scale)
    gap = scale.gap
    least = scale.least
    off = np.asarray(place, dtype=np.float64) - pose.position
    if isinstance(obstacle, Box):
        axis = "xyz".index(handle)
        direction = pose.rotation[:, axis]
        half = 0.5 * obstacle.size[axis]
        edge = max(float(half - off @ direction) - gap, least)
        size = list(obstacle.size)
        size[axis] = round(edge, COORDINATE_DIGITS)
        center = pose.position + (half - 0.5 * edge) * direction  # the face across stays where it is
        return replace(obstacle, center=_rounded(center), size=_vector(np.array(size)))
    if isinstance(obstacle, HalfSpace):
        height = float(off @ pose.rotation[:, 2]) - gap
        return replace(obstacle, point=_rounded(pose.position + height * pose.rotation[:, 2]))
    if isinstance(obstacle, Mesh | Scan | MeshShape):
        return obstacle
    if isinstance(obstacle, Sphere) or handle == "radius":
        radius = max(float(-off @ pose.rotation[:, 0]) - gap, least)
        return replace(obstacle, radius=round(radius, COORDINATE_DIGITS))
    fixed = np.array(obstacle.end if handle == "start" else obstacle.start)
    axis_vector = np.asarray(place, dtype=np.float64) - fixed
    length = float(np.linalg.norm(axis_vector))
    sign = -1.0 if handle == "start" else 1.0
    direction = axis_vector / length if length > least else sign * pose.rotation[:, 2]
    end = _rounded(fixed + max(length - gap - _cap_length(obstacle), least) * direction)
    return replace(obstacle, start=end) if handle == "start" else replace(obstacle, end=end)


def rotation_to(axis: ArrayLike) -> Array:
    """Return the smallest rotation that turns the third axis to another, (3, 3)."""
    x, y, z = np.asarray(axis, dtype=np.float64) / np.linalg.norm(np.asarray(axis, dtype=np.float64))
    if z < -1.0 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    share = 1.0 / (1.0 + z)
    return np.array(
        [[1.0 - share * x * x, -share * x * y, x], [-share * x * y, 1.0 - share * y * y, y], [-x, -y, z]]
    )


def bounding_radius(obstacle: Obstacle) -> float:
    """Return the radius of an obstacle about its middle [m]; 0 for a half-space."""
    if isinstance(obstacle, Sphere):
        return obstacle.radius
    if isinstance(obstacle, Box):
        return 0.5 * float(np.linalg.norm(obstacle.size))
    if isinstance(obstacle, HalfSpace):
        return 0.0
    if isinstance(obstacle, MeshShape):
        return float(np.linalg.norm(obstacle.mesh.vertices, axis=1).max())
    if isinstance(obstacle, Mesh | Scan):
        low, high = obstacle.bounds
        return float(np.linalg.norm(0.5 * (high - low)))
    half = 0.5 * float(np.linalg.norm(np.subtract(obstacle.end, obstacle.start)))
    return half + obstacle.radius if isinstance(obstacle, Capsule) else float(np.hypot(half, obstacle.radius))


def _cap_length(obstacle: Capsule | Cylinder) -> float:
    return obstacle.radius if isinstance(obstacle, Capsule) else 0.0


def _center(surface: Mesh | Scan) -> Array:
    """Return the middle of a mesh or a scan in its own frame, (3,) [m]."""
    low, high = surface.bounds
    return np.asarray(0.5 * (low + high))


def _rounded(place: Array) -> Vector:
    return _vector(np.round(place, COORDINATE_DIGITS))


def _vector(numbers: Array) -> Vector:
    x, y, z = (float(each) + 0.0 for each in numbers)  # 0 rather than -0
    return x, y, z


def _matrix(rotation: Array) -> Matrix:
    x, y, z = (_vector(row) for row in np.where(np.abs(rotation) < 1e-12, 0.0, rotation))
    return x, y, z


def new_obstacle_kinds() -> tuple[str, ...]:
    """Return the types of obstacles that need no file: all but meshes and scans."""
    return tuple(name for name, kind in OBSTACLE_TYPES.items() if not issubclass(kind, Mesh | Scan))


def new_obstacle(kind: str, arm: Arm, points: Array, scene: Scene | None) -> Obstacle:
    """Return an obstacle of suitable size, where neither the arm nor another obstacle is.

    Where there is no such place it is put as far from the arm as was tried.

    Args:
        kind: one of `new_obstacle_kinds()`.
        arm: the arm.
        points: where it is, from base to tip, and perhaps where it is to be, from tip to base, (n, 3) [m],
            world frame.
        scene: the obstacles that are there; None if there are none.

    Raises:
        UnknownName: there is no such kind.
    """
    require_known("kind of obstacle", kind, new_obstacle_kinds())
    path = _resampled(np.vstack([arm.chain.base, points]))
    up = arm.plane[np.abs(arm.plane[:, 2]).argmax()] if arm.dimension == 2 else np.array([0.0, 0.0, 1.0])
    up = -up if up[2] < 0.0 else up
    if kind == "half_space":
        low = float((path @ up).min()) - FLOOR_DEPTH * arm.length
        return HalfSpace(_as_vector(arm.chain.base + (low - arm.chain.base @ up) * up), _as_vector(up))
    axis = np.cross(*arm.plane) if arm.dimension == 2 else up
    tried: list[tuple[float, Obstacle]] = []
    for center in _candidate_places(arm, path, up):
        obstacle = _new_solid(kind, center, axis, arm.length)
        radius = bounding_radius(obstacle)
        room = float(np.linalg.norm(path - center, axis=1).min()) - radius
        if room >= CLEAR_ROOM * arm.length and _is_free(scene, center, radius + CLEAR_ROOM * arm.length):
            return obstacle
        tried.append((room, obstacle))
    return max(tried, key=lambda each: each[0])[1]


def _new_solid(kind: str, center: Array, axis: Array, length: float) -> Obstacle:
    """Return an obstacle about a centre, along an axis, for an arm of some length [m]."""
    if kind == "sphere":
        return Sphere(_as_vector(center), round(0.06 * length, COORDINATE_DIGITS))
    if kind == "box":
        edge = round(0.12 * length, COORDINATE_DIGITS)
        return Box(_as_vector(center), (edge, edge, edge))
    own = OBSTACLE_TYPES[kind]
    if issubclass(own, MeshShape):
        return own.of_size(_as_vector(center), round(0.06 * length, COORDINATE_DIGITS))
    half = (0.12 if kind == "cylinder" else 0.1) * length * axis
    ends = _as_vector(center - half), _as_vector(center + half)
    return (Cylinder if kind == "cylinder" else Capsule)(*ends, round(0.03 * length, COORDINATE_DIGITS))


def _candidate_places(arm: Arm, path: Array, up: Array) -> Iterator[Array]:
    """Yield places beside the arm, near ones first."""
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
    for offset in OFFSETS:
        for fraction in FRACTIONS:
            for side in sides:
                size = float(np.linalg.norm(side))
                if size > 0.0:
                    yield path[round(fraction * (ARM_SAMPLES - 1))] + offset * arm.length * side / size


def _resampled(points: Array) -> Array:
    """Return points evenly along the line through others, (ARM_SAMPLES, 3)."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], ARM_SAMPLES)
    return np.stack([np.interp(at, along, points[:, k]) for k in range(3)], axis=1)


def _is_free(scene: Scene | None, center: Array, radius: float) -> bool:
    """Return whether no obstacle of a scene touches a ball."""
    return scene is None or not obstacles_near(scene, center, radius, within=0.0)


def _as_vector(place: Array) -> Vector:
    x, y, z = (round(float(each), COORDINATE_DIGITS) for each in place)
    return x, y, z


# Requests for the editor's loop.


def obstacles_of(task: Task) -> dict[str, Obstacle]:
    """Return the obstacles of a task, by name."""
    return {} if task.scene is None else dict(task.scene.obstacles)


def free_name(kind: str, taken: dict[str, Obstacle]) -> str:
    """Return a name that no obstacle has: the kind with a number."""
    return next(name for k in count(1) if (name := f"{kind}_{k}") not in taken)


def with_checked_obstacle(name: str, obstacle: Obstacle, instead: str | None = None) -> Edit:
    """Edit as `with_obstacle`; the edit raises TaskError for an obstacle around the base of the arm."""
    put = with_obstacle(name, obstacle, instead)

    def edit(task: Task) -> Task:
        base = task.arm.chain.base
        if obstacles_around(Scene({name: obstacle}), base):
            at = ", ".join(f"{value:.4g}" for value in base)
            raise TaskError(f"obstacle {name!r}", f"it would stand where the base of the arm is, at ({at}) m")
        return put(task)

    return edit


def select_obstacle(name: str | None, session: Session) -> None:
    """Select an obstacle, instead of a control point of the curve."""
    if name is not None and name not in obstacles_of(session.shown):
        return
    if session.obstacle != name or (name is not None and (session.handle is not None or session.tip)):
        session.obstacle = name
        if name is not None:
            session.handle = None
            session.tip = False


def add_obstacle(kind: str, points: Array, session: Session) -> None:
    """Add a new obstacle; arguments as for `new_obstacle`."""
    obstacle = new_obstacle(kind, session.arm, points, session.task.scene)
    insert_obstacle(free_name(kind, obstacles_of(session.task)), obstacle, session)


def insert_obstacle(name: str, obstacle: Obstacle, session: Session) -> None:
    """Add an existing obstacle, and select it."""
    if session.edit(with_checked_obstacle(name, obstacle), f"added {name}"):
        select_obstacle(name, session)


def delete_obstacle(session: Session) -> None:
    """Delete the selected obstacle."""
    name = session.obstacle
    if name is None:
        session.say("no obstacle is selected: click on one first", "warning")
        return
    session.proposal = None
    session.edit(with_obstacle(name, None), f"deleted {name}")


def rename_obstacle(name: str, to: str, session: Session) -> None:
    """Rename an obstacle; it keeps its place in the order."""
    obstacle = obstacles_of(session.task).get(name)
    to = to.strip()
    if obstacle is None or to == name:
        return
    session.proposal = None
    if session.edit(with_obstacle(to, obstacle, instead=name), f"renamed {name} to {to}"):
        session.obstacle = to


def change_obstacle(name: str, change: Change, what: str, final: bool, session: Session) -> None:
    """Move, turn or resize an obstacle.

    During a drag each change is made to the obstacle from before the drag, and is only proposed; the whole
    drag is one step to undo.

    Args:
        name: of the obstacle.
        change: makes the changed obstacle.
        what: the change in words.
        final: whether it is to be accepted.
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
        if other == obstacle or not session.edit(with_checked_obstacle(name, other, instead=name), what):
            session.touch()  # the previous proposal is gone
        return
    try:
        other = change(obstacle)
        task = with_checked_obstacle(name, other, instead=name)(session.task)
        task = task.edited(scene=_dragged(name, other, task, session))
    except PostureError as error:
        if session.notice.text != " ".join(str(error).split()):
            session.say(str(error), "warning")
        return
    session.touch()
    session.proposal = Proposal(task, what, False, session.number)


def _dragged(name: str, obstacle: Obstacle, task: Task, session: Session) -> Scene:
    """Return the scene with a dragged obstacle, and its velocity.

    Args:
        name: of the obstacle.
        obstacle: as it is now.
        task: the task with this obstacle.
        session: what is edited; its proposal is from the last move.
    """
    before = obstacles_of(session.task)[name]
    here = _placement(obstacle, session.arm)
    scene = session.task.scene
    if scene is None or own_shape(obstacle) != own_shape(before):  # it is being resized
        return replace(task.effective_scene, velocities={name: (0.0, 0.0, 0.0)})
    velocity = np.zeros(3)
    passed = time.monotonic() - session.asked
    last = None if session.proposal is None else session.proposal.task.scene
    if last is not None and name in last.velocities and 0.0 < passed < DRAG_PAUSE:
        step = here.translation - _placement(last.obstacles[name], session.arm).translation
        velocity = np.array(last.velocities[name])
        velocity += passed / (passed + DRAG_FILTER_TIME) * (step / passed - velocity)
    motion = here * _placement(before, session.arm).inverse()
    return scene.moved({name: motion}, velocities={name: _as_vector(velocity)})


def _placement(obstacle: Obstacle, arm: Arm) -> pin.SE3:
    pose = pose_of(obstacle, ArmScale.of(arm))
    return pin.SE3(pose.rotation, pose.position)


def edit_obstacle(name: str, key: str, value: object, final: bool, session: Session) -> None:
    """Set a value of an obstacle: its centre, size, radius and so on, by the name of the attribute."""

    def change(obstacle: Obstacle) -> Obstacle:
        if not hasattr(obstacle, key):  # it has become another one since
            raise InvalidValue(f"{key} of {name}", value, f"nothing, of a {obstacle.type}")
        if isinstance(obstacle, Mesh | Scan) and key in ("center", "rotation"):
            pose: dict[str, Any] = {"center": obstacle.center, "rotation": obstacle.rotation, key: value}
            return obstacle.placed(pose["center"], pose["rotation"])
        return replace(obstacle, **{key: value})  # type: ignore[arg-type]

    change_obstacle(name, change, f"changed {name}", final, session)
