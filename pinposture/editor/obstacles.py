"""Obstacles that can be dragged: their handles, where new ones are placed, and requests that change them."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import count
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import Vector, require_known
from pinposture.arm import Arm
from pinposture.collision import HalfSpace, Mesh, Obstacle, Scan, Scene
from pinposture.collision.obstacles import DIRECTIONS, OBSTACLE_TYPES, POSITIONS, displaced
from pinposture.collision.scene import obstacles_around, obstacles_near
from pinposture.editor.edits import Edit, with_obstacle
from pinposture.editor.session import Proposal, Session
from pinposture.errors import InvalidValue, PostureError, TaskError
from pinposture.task import Task
from pinposture.viz.body import surface

Array = NDArray[np.float64]
Change: TypeAlias = Callable[[Obstacle], Obstacle]


# Relative to the length of the arm:
class ObstacleHandling(NamedTuple):
    """How obstacles are changed and moved with the mouse; lengths are relative to the arm."""

    handle_gap: float = 0.025
    """Distance of the handles that change the size of an obstacle from it."""

    least_size: float = 2e-3
    """Smallest size of an obstacle that is resized."""

    half_space_offset: float = 0.3
    """Distance of the handle of a half-space from its middle."""

    drag_pause: float = 0.15
    """Time after the last move for a dragged obstacle to count as at rest [s]."""

    filter_time: float = 0.03
    """Time constant of the filter of its velocity [s]."""

    digits: int = 6
    """Digits of positions and sizes that come from the mouse [m]."""


HANDLING = ObstacleHandling()


class NewObstacle(NamedTuple):
    """Where a new obstacle is put, and its size, relative to the arm."""

    size: float = 0.06
    """Its size: see `Described.of_size`."""

    clear_room: float = 0.05
    """Distance of it from the arm and other obstacles."""

    floor_depth: float = 0.1
    """Depth of a new half-space below the arm."""

    fractions: tuple[float, ...] = (0.6, 0.4, 0.8, 1.0, 0.25)
    """Places along the arm beside which it is tried, in turn."""

    offsets: tuple[float, ...] = (0.2, 0.3, 0.45, 0.65, 0.9, 1.3)
    """Distances sideways from the arm, tried in turn."""

    arm_samples: int = 200
    """Number of points of the arm that it keeps away from."""


NEW = NewObstacle()


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
        return HANDLING.handle_gap * self.length

    @property
    def least(self) -> float:
        """Smallest size of an obstacle [m]."""
        return HANDLING.least_size * self.length


class SizeHandle(NamedTuple):
    """A handle that changes the size of an obstacle."""

    name: str  # "x", "y", "z", "radius", "start", "end" or "height"
    position: Array  # where it is, (3,) [m], world frame


def at_pose(obstacle: Obstacle, pose: pin.SE3, scale: ArmScale) -> Obstacle:
    """Return an obstacle at another pose.

    Raises:
        InvalidValue: coordinates out of bounds.
    """
    here = obstacle.pose(scale.middle)
    if not obstacle.bounded:
        obstacle = obstacle.changed(point=here.translation)
    return _rounded(displaced(obstacle, pose * here.inverse()))


def own_shape(obstacle: Obstacle, scale: ArmScale) -> Obstacle:
    """Return an obstacle in its own frame, in which it changes only with its size: middle at the origin."""
    return _rounded(at_pose(obstacle, pin.SE3.Identity(), scale), HANDLING.digits - 1)


def moved(obstacle: Obstacle, shift: ArrayLike) -> Obstacle:
    """Return an obstacle moved without being turned.

    Args:
        obstacle: the obstacle.
        shift: the displacement, (3,) [m], world frame.

    Raises:
        InvalidValue: coordinates out of bounds.
    """
    return _rounded(displaced(obstacle, pin.SE3(np.eye(3), np.asarray(shift, dtype=np.float64))))


def _rounded(obstacle: Obstacle, digits: int = HANDLING.digits) -> Obstacle:
    """Return an obstacle with rounded positions, and directions without traces of rounding."""
    changes: dict[str, Any] = {}
    for name in (*POSITIONS, *DIRECTIONS):
        if hasattr(obstacle, name):
            value = np.array(getattr(obstacle, name))
            whole = np.round(value, digits if name in POSITIONS else 0) + 0.0  # 0 rather than -0
            changes[name] = (
                whole if name in POSITIONS else np.where(np.abs(value - whole) < 1e-12, whole, value)
            )
    return obstacle.changed(**changes)


def size_handles(obstacle: Obstacle, scale: ArmScale) -> tuple[SizeHandle, ...]:
    """Return the handles that change the size of an obstacle, just outside of it: those that its type names.

    "x", "y" and "z" are on three faces of a box of a `size` that meet; those across stay where they are.
    "start" and "end" are at the ends of a line, and "radius" is beside it, or beside a `center`. "height" is
    above a plane with a `point`.
    """
    pose = obstacle.pose(scale.middle)
    own: Any = obstacle
    handles = []
    for name in obstacle.handles:
        if name == "height":
            foot = pose.translation - HANDLING.half_space_offset * scale.length * pose.rotation[:, 0]
            position = foot + scale.gap * pose.rotation[:, 2]
        elif name in ("start", "end"):
            sign = -1.0 if name == "start" else 1.0
            position = getattr(own, name) + sign * (scale.gap + own.cap) * pose.rotation[:, 2]
        else:
            axis = 0 if name == "radius" else "xyz".index(name)
            out = own.radius if name == "radius" else 0.5 * own.size[axis]
            position = pose.translation - (out + scale.gap) * pose.rotation[:, axis]
        handles.append(SizeHandle(name, position))
    return tuple(handles)


def resized(obstacle: Obstacle, handle: str, position: ArrayLike, scale: ArmScale) -> Obstacle:
    """Return an obstacle with one of its handles at another position, or as near to it as possible.

    Args:
        obstacle: the obstacle.
        handle: name of the handle.
        position: where it is dragged, (3,) [m], world frame.
        scale: that of the arm.

    Raises:
        InvalidValue: coordinates out of bounds.
    """
    pose = obstacle.pose(scale.middle)
    gap = scale.gap
    least = scale.least
    own: Any = obstacle
    off = np.asarray(position, dtype=np.float64) - pose.translation
    if handle == "height":
        height = float(off @ pose.rotation[:, 2]) - gap
        return _rounded(own.changed(point=pose.translation + height * pose.rotation[:, 2]))
    if handle == "radius":
        radius = max(float(-off @ pose.rotation[:, 0]) - gap, least)
        return own.changed(radius=round(radius, HANDLING.digits))  # type: ignore[no-any-return]
    if handle in ("start", "end"):
        fixed = np.array(own.end if handle == "start" else own.start)
        axis_vector = np.asarray(position, dtype=np.float64) - fixed
        length = float(np.linalg.norm(axis_vector))
        sign = -1.0 if handle == "start" else 1.0
        direction = axis_vector / length if length > least else sign * pose.rotation[:, 2]
        return _rounded(own.changed(**{handle: fixed + max(length - gap - own.cap, least) * direction}))
    axis = "xyz".index(handle)
    direction = pose.rotation[:, axis]
    half = 0.5 * own.size[axis]
    edge = max(float(half - off @ direction) - gap, least)
    size = np.array(own.size)
    size[axis] = round(edge, HANDLING.digits)
    center = pose.translation + (half - 0.5 * edge) * direction  # the face across stays where it is
    return _rounded(own.changed(center=center, size=size))


def bounding_radius(obstacle: Obstacle, scale: ArmScale) -> float:
    """Return the radius of the drawn surface of an obstacle about its middle [m]; 0 for a half-space."""
    if not obstacle.bounded:
        return 0.0
    vertices = surface(obstacle).vertices
    away = np.linalg.norm(vertices - obstacle.pose(scale.middle).translation, axis=1)
    return float(away.max())


def new_obstacle_kinds() -> tuple[str, ...]:
    """Return the types of obstacles that need no file: all but meshes and scans."""
    return tuple(name for name, kind in OBSTACLE_TYPES.items() if not issubclass(kind, Mesh | Scan))


def new_obstacle(kind: str, arm: Arm, points: Array, scene: Scene | None) -> Obstacle:
    """Return an obstacle of suitable size, where neither the arm nor another obstacle is.

    Where there is no such position it is put as far from the arm as was tried.

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
    if not OBSTACLE_TYPES[kind].bounded:
        low = float((path @ up).min()) - NEW.floor_depth * arm.length
        return HalfSpace(_as_vector(arm.chain.base + (low - arm.chain.base @ up) * up), _as_vector(up))
    axis = np.cross(*arm.plane) if arm.dimension == 2 else up
    size = round(NEW.size * arm.length, HANDLING.digits)
    tried: list[tuple[float, Obstacle]] = []
    for center in _candidate_positions(arm, path, up):
        obstacle: Obstacle = OBSTACLE_TYPES[kind].of_size(_as_vector(center), axis, size)
        radius = bounding_radius(obstacle, ArmScale.of(arm))
        room = float(np.linalg.norm(path - center, axis=1).min()) - radius
        least = NEW.clear_room * arm.length
        if room >= least and _is_free(scene, center, radius + least):
            return obstacle
        tried.append((room, obstacle))
    return max(tried, key=lambda option: option[0])[1]


def _candidate_positions(arm: Arm, path: Array, up: Array) -> Iterator[Array]:
    """Yield positions beside the arm, near ones first."""
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
    for offset in NEW.offsets:
        for fraction in NEW.fractions:
            for side in sides:
                size = float(np.linalg.norm(side))
                if size > 0.0:
                    yield path[round(fraction * (NEW.arm_samples - 1))] + offset * arm.length * side / size


def _resampled(points: Array) -> Array:
    """Return points evenly along the line through others, (NEW.arm_samples, 3)."""
    along = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.linspace(0.0, along[-1], NEW.arm_samples)
    return np.stack([np.interp(at, along, points[:, k]) for k in range(3)], axis=1)


def _is_free(scene: Scene | None, center: Array, radius: float) -> bool:
    """Return whether no obstacle of a scene touches a ball."""
    return scene is None or not obstacles_near(scene, center, radius, within=0.0)


def _as_vector(position: Array) -> Vector:
    x, y, z = (round(float(coordinate), HANDLING.digits) for coordinate in position)
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
    """Rename an obstacle; it keeps its position in the order."""
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
    scale = ArmScale.of(session.arm)
    here = obstacle.pose(scale.middle)
    scene = session.task.scene
    if scene is None or own_shape(obstacle, scale) != own_shape(before, scale):  # it is being resized
        return replace(task.effective_scene, velocities={name: (0.0, 0.0, 0.0)})
    velocity = np.zeros(3)
    passed = time.monotonic() - session.asked
    last = None if session.proposal is None else session.proposal.task.scene
    if last is not None and name in last.velocities and 0.0 < passed < HANDLING.drag_pause:
        step = here.translation - last.obstacles[name].pose(scale.middle).translation
        velocity = np.array(last.velocities[name])
        velocity += passed / (passed + HANDLING.filter_time) * (step / passed - velocity)
    motion = here * before.pose(scale.middle).inverse()
    return scene.moved({name: motion}, velocities={name: _as_vector(velocity)})


def edit_obstacle(name: str, key: str, value: object, final: bool, session: Session) -> None:
    """Set a value of an obstacle: its centre, size, radius and so on, by the name of the attribute."""

    def change(obstacle: Obstacle) -> Obstacle:
        if not hasattr(obstacle, key):  # it has become another one since
            raise InvalidValue(f"{key} of {name}", value, f"nothing, of a {obstacle.type}")
        return obstacle.changed(**{key: value})

    change_obstacle(name, change, f"changed {name}", final, session)
