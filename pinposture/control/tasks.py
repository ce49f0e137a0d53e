"""Tasks besides the target posture: end-effector pose, joint posture, link directions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, fields
from typing import Annotated, Any, NamedTuple, Protocol, cast

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from pydantic import ValidationInfo, model_validator

from pinposture._validation import (
    finite_array,
    is_whole,
    make_read_only,
    require_instance,
    require_known,
    require_positive,
    rigid_placement,
)
from pinposture.arm import Arm, ArmState, ControlPoints
from pinposture.arm.arm import arm_of
from pinposture.arm.kinematics import ON_AXIS, PARALLEL
from pinposture.arm.manipulability import chosen_points
from pinposture.arm.urdf import roll_pitch_yaw
from pinposture.control.controller import OWN, call_own
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import FULL_TURN
from pinposture.placement import Target
from pinposture.schema import (
    Declared,
    Flag,
    InputFile,
    Length,
    NotAllowed,
    OutputFile,
    PositiveNumber,
    Refusal,
    declared,
    in_file,
    read_by,
    read_quantities,
    read_within,
    refusing,
)
from pinposture.units import ROUNDING

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class LinkAxes(NamedTuple):
    """Properties of the orientations of control points that hold in every configuration.

    Attributes:
        links: direction of the link that ends at each control point, unit vectors, (m, 3), in the frame of
            the point.
        turns: number of rotation axes of each, (m,): 0 if all joints before it are prismatic, 1 if the
            revolute ones are parallel, else 3.
        axes: the rotation axis of each if there is only one, unit vectors, (m, 3), world frame; else zero.
    """

    links: Array
    turns: Indices
    axes: Array


def link_axes(arm: Arm) -> LinkAxes:
    """Return the link axes of an arm, cached with it.

    The link that ends at a control point starts at the last joint origin or control point before it that has
    a different position. Its direction in the neutral configuration is fixed in the frame of the control
    point: the x axis for template arms, and where no such position exists. It is the direction in every
    configuration unless the last joint is at the control point itself.
    """
    axes_of_links: LinkAxes | None = arm.cache.get(LinkAxes)
    if axes_of_links is None:
        turns, axes = _turning(arm)
        axes_of_links = arm.cache[LinkAxes] = LinkAxes(_links(arm), turns, axes)
    return axes_of_links


def _links(arm: Arm) -> Array:
    chain = arm.chain
    links = np.zeros((arm.n_modules, 3))
    stations = [chain.base]
    for k, (joints, turn) in enumerate(
        zip(chain.module_slices, arm.chain_at(arm.neutral()).rotations, strict=True)
    ):
        stations.extend(chain.origins[joints])
        spans = chain.points[k] - np.array(stations)
        elsewhere = np.flatnonzero(np.linalg.norm(spans, axis=1) > ON_AXIS * arm.length)
        link = turn.T @ spans[elsewhere[-1]] if len(elsewhere) else np.array([1.0, 0.0, 0.0])
        links[k] = link / np.linalg.norm(link)
        stations.append(chain.points[k])
    return links


def _turning(arm: Arm) -> tuple[Indices, Array]:
    chain = arm.chain
    turns = np.zeros(arm.n_modules, dtype=np.intp)
    axes = np.zeros((arm.n_modules, 3))
    for k, joints in enumerate(chain.module_slices):
        before = chain.axes[: joints.stop][chain.revolute[: joints.stop]]
        if len(before):
            mean = np.where(before @ before[0] < 0.0, -1.0, 1.0) @ before
            mean /= np.linalg.norm(mean)
            parallel = np.all(np.linalg.norm(np.cross(before, mean), axis=1) < PARALLEL)
            turns[k], axes[k] = (1, mean) if parallel else (3, axes[k])
    return turns, axes


# Orientation errors are rotation vectors in the world frame, and their rows are angular Jacobians. If all
# joints that move a point turn about one axis, as in a planar arm, the error is the rotation about that axis
# that comes closest.


def link_directions(state: ArmState, points: Indices) -> Array:
    """Return the directions of the links that end at control points, (k, 3), world frame."""
    return np.asarray(np.einsum("kij,kj->ki", state.rotations[points], link_axes(state.arm).links[points]))


def orientation_rows(state: ArmState, point: int, target: Array) -> tuple[Array, Array]:
    """Return the rows that turn a control point to an orientation.

    With M = R_wanted R^T and e = log M, a rotation w of the control point changes M to M exp(-w), and e to
    first order by -E w, where E is the derivative of the logarithm. The rows are hence E J_w for the error e.
    As E e = e, a step that covers the error turns the point directly to that orientation.

    Args:
        state: the state of the arm.
        point: index of the control point, 0-based.
        target: the orientation, from the frame of the control point to the world, (3, 3).

    Returns:
        Rows (r, nv) [rad/rad] and error (r,) [rad]: r = 3, 1 if the point turns about one axis, or 0 if it
        does not turn. For one axis, both are scaled by the cosine of half the remaining rotation, which no
        joint can change: 1 if the orientation is feasible.
    """
    known = link_axes(state.arm)
    jacobian = state.angular_jacobians[point]
    error, share = _remaining_rotation(state, point, target)
    if known.turns[point] == 0:
        return jacobian[:0], error
    if known.turns[point] == 1:
        return share * (known.axes[point] @ jacobian)[None], error
    return _logarithm_derivative(error) @ jacobian, error


def _remaining_rotation(state: ArmState, point: int, target: Array) -> tuple[Array, float]:
    """Return the error of `orientation_rows`, and by how much it is scaled."""
    known = link_axes(state.arm)
    if known.turns[point] == 0:
        return np.zeros(0), 1.0
    x, y, z, w = pin.Quaternion(target @ state.rotations[point].T).coeffs()
    if known.turns[point] == 1:
        half = np.array([known.axes[point] @ (x, y, z), w])
        half *= np.copysign(1.0, w)  # both signs are the same rotation
        share = float(np.linalg.norm(half))
        return share * _wrap(2.0 * np.arctan2(half[:1], half[1:])), share
    return _rotation_vector(np.array([x, y, z]), float(w)), 1.0


def direction_rows(state: ArmState, points: Indices, target: Array) -> tuple[Array, Array]:
    """Return the rows that turn the links that end at control points to given directions.

    A rotation w moves the direction t of a link by w x t. The error is the arc from t to the wanted direction
    along the great circle, in a basis (b, t x b) perpendicular to t; its length is the angle between the two,
    in [0, pi]. For the opposite direction, the direction of the half turn depends on t alone.

    Args:
        state: the state of the arm.
        points: indices of the control points, 0-based, (k,).
        target: unit vectors, (k, 3), world frame.

    Returns:
        Rows (r, nv) [rad/rad] and errors (r,) [rad]: two for each point, one if it turns about one axis, none
        if it does not turn. For one axis, the error is the angle between the projections perpendicular to it,
        and both are scaled by the geometric mean of the lengths of these projections.
    """
    known = link_axes(state.arm)
    turns = known.turns[points]
    axes = known.axes[points]
    link = link_directions(state, points)
    basis = _across(link)
    ahead, beside = _dot(basis, target)
    sine = np.hypot(ahead, beside)
    cosine = _dot(link, target)
    opposite = (sine < ROUNDING) & (cosine < 0.0)
    way = np.stack([np.where(opposite, 1.0, ahead), beside])
    way *= np.arctan2(sine, cosine) / np.maximum(np.hypot(way[0], way[1]), 1e-300)
    # b . (w x t) = w . (t x b): turning about t x b moves t along b.
    about = np.stack([basis[1], -basis[0]], axis=1)
    errors = way.T
    single = turns == 1
    if np.any(single):
        along, aside = _dot(basis, axes)
        sines = aside * ahead - along * beside  # of the projections: axis . (t x d)
        cosines = cosine - _dot(link, axes) * _dot(target, axes)
        share = np.sqrt(np.hypot(sines, cosines))
        apart = share * _wrap(np.arctan2(sines, cosines))
        about[single, 0] = (share[:, None] * axes)[single]
        errors[single, 0] = apart[single]
    used = np.stack([turns > 0, turns > 1], axis=1)
    rows = about @ state.angular_jacobians[points]
    return rows[used], errors[used]


def _wrap(angle: Array) -> Array:
    """Return angles wrapped to (-pi, pi]; half a turn is always positive."""
    return np.where(angle < ROUNDING - np.pi, angle + FULL_TURN, angle)


def _rotation_vector(vector: Array, scalar: float) -> Array:
    """Return the rotation vector (3,) [rad] of a unit quaternion; the sign of a half turn is fixed."""
    size = float(np.linalg.norm(vector))
    if size < 1e-150:
        return np.zeros(3)
    forward = scalar > 0.0
    if abs(scalar) < ROUNDING / 2.0:  # the first component that is not small decides
        forward = vector[np.argmax(np.abs(vector) > 0.4 * size)] > 0.0
    sign = 1.0 if forward else -1.0
    return np.asarray(2.0 * np.arctan2(size, sign * scalar) / size * sign * vector)


def _logarithm_derivative(error: Array) -> Array:
    """Return E (3, 3) with log(exp(e) exp(d)) = e + E d to first order, for |e| up to half a turn."""
    angle = float(np.linalg.norm(error))
    x, y, z = error
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    half = angle / 2.0
    second = 1.0 / 12.0 if angle < 1e-3 else (1.0 - half / np.tan(half)) / angle**2
    return np.asarray(np.eye(3) + cross / 2.0 + second * (cross @ cross))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=-1))


def _across(directions: Array) -> Array:
    """Return unit vectors b and t x b, (2, k, 3), perpendicular to unit vectors t, (k, 3), stable for all t.

    InputFile: Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6 (2017).
    """
    x, y, z = directions.T
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    return np.stack([first, np.stack([b, sign + y * y * a, -y], axis=1)])


# Rows are in metres, so that weights are comparable with those of control points: a rotation counts as the
# arc at a lever arm `length`, by default `Arm.characteristic_length`, the mean module length.


class TaskRows(NamedTuple):
    """Equations jacobian @ dq = error that a step should satisfy.

    Attributes:
        jacobian: rows, (r, nv) [m/rad, or m/m for prismatic joints]; zero for joints off the chain.
        error: error of each row, (r,) [m].
    """

    jacobian: Array
    error: Array


class ControlTask(Protocol):
    """Interface of tasks besides the target posture."""

    @property
    def weight(self) -> float:
        """Weight of the squared error of each row; that of a control point has weight 1."""

    @property
    def priority(self) -> bool:
        """Whether everything else is confined to the null space of the task."""

    def rows(self, state: ArmState, target: Target) -> TaskRows:
        """Return the rows of the task at a state.

        Args:
            state: the state of the arm.
            target: the target posture of the arm.

        Raises:
            InvalidValue: the task does not fit the arm.
            UnknownName: the task names a control point or joint that the arm does not have.
        """


@dataclass(frozen=True, eq=False)
class ComparableTask:
    """Base class of tasks, which are equal if all fields are, arrays included."""

    @property
    def priority(self) -> bool:
        """Whether everything else is confined to the null space of the task."""
        return False

    def __eq__(self, other: object) -> bool:
        return self._key() == other._key() if type(other) is type(self) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._key())

    def _key(self) -> tuple[object, ...]:
        values = (getattr(self, item.name) for item in fields(self))
        return tuple((v.shape, *v.ravel().tolist()) if isinstance(v, np.ndarray) else v for v in values)

    def _set(self, name: str, value: object) -> None:
        """Set a field of the frozen task during initialisation; arrays become read-only."""
        make_read_only(value)
        object.__setattr__(self, name, value)

    def _set_scales(self, weight: float, length: float | None) -> None:
        """Set weight and length; raise InvalidValue unless they are finite numbers above 0."""
        require_positive("weight", weight)
        self._set("weight", float(weight))
        if length is not None:
            require_positive("length", length)
            self._set("length", float(length))


def rows_of(task: ControlTask, state: ArmState, target: Target) -> TaskRows:
    """Return the rows of a task at a state; those of a task of the user are checked.

    Raises:
        InvalidValue: it does not return what `ControlTask.rows` should, or does not fit the arm.
        UnknownName: it names a control point or joint that the arm does not have.
        ControllerError: it raised an exception that is no `PostureError`.
    """
    if type(task).__module__.startswith(OWN):
        return task.rows(state, target)
    name = type(task).__name__
    rows = call_own(name, "rows(state, target)", task.rows, state, target)
    if not (isinstance(rows, tuple) and len(rows) == 2):
        raise InvalidValue(f"{name}.rows(...)", rows, "TaskRows(jacobian, error), (r, nv) and (r,)")
    jacobian = finite_array(f"{name}.rows(...), jacobian", rows[0], (None, state.arm.nv))
    return TaskRows(jacobian, finite_array(f"{name}.rows(...), error", rows[1], (len(jacobian),)))


def errors_of(task: ControlTask, state: ArmState, target: Target) -> Array:
    """Return the errors of `rows_of` alone, (r,) [m], which takes less time for poses than the rows."""
    if type(task).__module__.startswith(OWN):
        if isinstance(task, Displaced):
            return errors_of(task.task, state.moved(task.offset).chain_state, target)
        if isinstance(task, EndEffector):
            return task.errors(state)
    return rows_of(task, state, target).error


@dataclass(frozen=True, eq=False)
class Displaced(ComparableTask):
    """A task of an arm that is displaced from its state, as a measured arm that sags is from its command.

    Attributes:
        task: the task.
        offset: the displacement, (nv,) [rad or m].
    """

    task: ControlTask
    offset: Array

    @property
    def weight(self) -> float:
        """That of the task."""
        return self.task.weight

    @property
    def priority(self) -> bool:
        """That of the task."""
        return self.task.priority

    def rows(self, state: ArmState, target: Target) -> TaskRows:
        """Return the rows of the task at the displaced state; see `ControlTask`."""
        return rows_of(self.task, state.moved(self.offset).chain_state, target)


def lever(arm: Arm, length: float | None) -> float:
    """Return the lever arm of rotations: the length that one radian counts as [m/rad]."""
    return arm.characteristic_length if length is None else length


def _read_point_position(value: Any, _: ValidationInfo) -> Array:
    with refusing():
        position = finite_array("position", value, (3,))
    make_read_only(position)
    return position


def _read_pose(value: Any, _: ValidationInfo) -> Array:
    with refusing():
        matrix = np.array(rigid_placement("pose", value).homogeneous)
    left, _unused, right = np.linalg.svd(matrix[:3, :3])
    matrix[:3, :3] = left @ right  # orthonormal to machine precision
    make_read_only(matrix)
    return matrix


def _read_point(value: object, info: ValidationInfo) -> int | str:
    """Read the index or name of a control point; in a file, indices are counted from 1."""
    source = in_file(info)
    if isinstance(value, str):
        if source is not None and source.arm is not None:
            with refusing():
                _index(source.arm, value)
        return value
    if source is None:
        if not is_whole(value):
            raise NotAllowed(value, "the index or the name of one control point")
        return int(cast(int, value))
    if not is_whole(value) or value == 0:
        raise NotAllowed(
            value, "1 or more, counted from the base; -1 or less, counted from the tip; or a name"
        )
    number = cast(int, value)
    point = number - 1 if number > 0 else number
    m = math.inf if source.arm is None else source.arm.n_modules
    if not -m <= point < m:
        raise NotAllowed(value, f"1 to {m} from the base, -1 to -{m} from the tip, or a name")
    return point


_OF_A_POSE = ("position", "rotation")
"""Keys of a table in place of the attributes `position` and `pose`."""


def _in_si(values: Mapping[str, Any]) -> dict[str, tuple[float, ...]]:
    """Read position and rotation of a table."""
    kinds = {"position": "length", "rotation": "angle"}
    return {
        key: read_within(key, read_quantities, values[key], [kinds[key]] * 3)
        for key in _OF_A_POSE
        if key in values
    }


@declared(eq=False)
class EndEffector(ComparableTask, Declared):
    """Bring one control point, usually the tip, to a position or a pose, or hold it there.

    Tasks are immutable. `EndEffector.held` makes the task that holds the current pose. To track a moving
    goal, give each step a controller with a new task, for instance `dataclasses.replace(task, pose=...)`.

    Directions that no joint can change are left out: for a planar arm, positions off its plane and rotations
    about other axes than that of its joints.

    Attributes:
        position: position of the point, (3,) [m], world frame; or None if a pose is given.
        pose: pose of its frame, as a `pin.SE3` or a rigid transform (4, 4) from that frame to the world,
            stored as the latter; or None if a position is given.
        point: the control point, by its index, 0-based or from the tip as -1, or by its name.
        weight: weight of the squared error of each row; that of a control point has weight 1.
        priority: whether everything else is confined to the null space of the task.
        direction_only: whether to ignore the rotation of a pose about the link that ends at the point (see
            `link_axes`).
        length: lever arm of rotations [m/rad]; `Arm.characteristic_length` if None.

    Raises:
        InvalidValue: a value other than described.
    """

    position: Annotated[ArrayLike, read_by(_read_point_position)] | None = None
    pose: Annotated[Any, read_by(_read_pose)] | None = None
    point: Annotated[int | str, read_by(_read_point)] = -1
    weight: PositiveNumber = 1.0
    priority: Flag = False
    direction_only: Flag = False
    length: Length | None = None

    @model_validator(mode="after")
    def _one_place(self) -> EndEffector:
        if (self.position is None) == (self.pose is None):
            poses = {"position": self.position, "pose": self.pose}
            raise InvalidValue("position and pose", poses, "one of them, and None for the other")
        if self.direction_only and self.pose is None:
            raise InvalidValue("direction_only", True, "False, or a pose in place of the position")
        return self

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the keys of the table: position and rotation in place of position or pose."""
        return (*_OF_A_POSE, *(item.name for item in fields(cls) if item.name not in ("position", "pose")))

    @classmethod
    def from_table(cls, values: Mapping[str, Any], source: InputFile) -> dict[str, Any]:
        """Return the values of fields: a pose in place of a position if there is a rotation."""
        rest = {key: value for key, value in values.items() if key not in _OF_A_POSE}
        if "position" not in values:
            raise Refusal("the key 'position' is missing")
        pose = _in_si(values)
        if "rotation" not in values:
            return {"position": pose["position"], **rest}
        turned = pin.rpy.rpyToMatrix(*pose["rotation"])
        return {"pose": pin.SE3(turned, np.array(pose["position"])), **rest}

    def remember(self, values: Mapping[str, Any], source: InputFile) -> None:
        """Keep the angles of a rotation as they were given."""
        source.described[self] = {**values, **_in_si(values)}

    def to_table(self, file: OutputFile) -> dict[str, Any]:
        """Return the table, with a pose as position and rotation, and with points counted from 1."""
        known: dict[str, Any] | None = file.find(self, type(self))
        if known is not None:
            return known
        table = {key: value for key, value in self.written(file).items() if key not in ("position", "pose")}
        if isinstance(self.point, int) and self.point >= 0:
            table["point"] = self.point + 1
        if self.pose is None:
            return {"position": np.asarray(self.position).tolist(), **table}
        pose = pin.SE3(self.pose)
        written = {"position": pose.translation.tolist(), "rotation": roll_pitch_yaw(pose.rotation)}
        return {**written, **table}

    @classmethod
    def held(cls, state: ArmState, hold: str = "pose", point: int | str = -1, **options: Any) -> EndEffector:
        """Return the task of holding a control point at its current position or pose.

        Args:
            state: the state whose position or pose is kept.
            hold: "position" or "pose".
            point: the control point.
            options: `weight`, `priority`, `direction_only`, `length`.

        Raises:
            UnknownName: another value of `hold`, or a control point that the arm does not have.
            InvalidValue: as for `EndEffector`, or an index that no control point has.
        """
        require_instance("state", state, ArmState, "an ArmState, as `arm.at(q)` returns it")
        require_known("thing to hold", hold, ("position", "pose"))
        k = _index(state.arm, point)
        if hold == "position":
            return cls(position=state.points[k], point=point, **options)
        return cls(pose=pin.SE3(state.rotations[k], state.points[k]), point=point, **options)

    def rows(self, state: ArmState, target: Target) -> TaskRows:
        """Return the rows of the position, then those of the orientation; see `ControlTask.rows`."""
        arm = arm_of(state)
        k = _index(state.arm, self.point)
        jacobian = arm.plane @ state.jacobians[k]
        apart = self._apart(state, k)
        if self.pose is None:
            return TaskRows(jacobian, apart)
        rotation = self.pose[:3, :3]
        if self.direction_only:
            link = rotation @ link_axes(arm).links[k]
            turns, angles = direction_rows(state, np.array([k]), link[None])
        else:
            turns, angles = orientation_rows(state, k, rotation)
        arc = lever(arm, self.length)
        return TaskRows(np.vstack([jacobian, arc * turns]), np.concatenate([apart, arc * angles]))

    def errors(self, state: ArmState) -> Array:
        """Return the errors of the rows alone, (r,) [m]."""
        if self.direction_only:
            return self.rows(state, cast(Target, None)).error  # which does not depend on the target
        k = _index(state.arm, self.point)
        apart = self._apart(state, k)
        if self.pose is None:
            return apart
        angles, _ = _remaining_rotation(state, k, self.pose[:3, :3])
        return np.concatenate([apart, lever(state.arm, self.length) * angles])

    def _apart(self, state: ArmState, k: int) -> Array:
        """Return the error of the position of a control point, (dimension,) [m]."""
        position = self.position if self.pose is None else self.pose[:3, 3]
        return np.asarray(state.arm.plane @ (position - state.points[k]))


def _index(arm: Arm, point: int | str) -> int:
    require_instance("point", point, int | str | np.integer, "the index or the name of a control point")
    try:
        return chosen_points(arm.control_points, point)[0]
    except InvalidValue as error:  # its message calls the argument "points"
        raise InvalidValue("point", error.value, error.allowed) from None


@dataclass(frozen=True, eq=False)
class JointPosture(ComparableTask):
    """Pull joints towards a configuration, for instance the straight one.

    Continuous joints turn the shorter way. Joints off the chain are unaffected.

    Attributes:
        q: the configuration, (nq,) [rad or m].
        weight: weight of the squared error of each joint; that of a control point has weight 1. The small
            default uses redundancy without moving control points noticeably.
        joints: name or names of joints of the chain; all of them if None.
        length: length that one of `Arm.joint_units` counts as [m]; `Arm.characteristic_length` if None, so
            that displacements of prismatic joints are unscaled.

    Raises:
        InvalidValue: a value other than described.
    """

    q: ArrayLike
    weight: float = 1e-3
    joints: str | Iterable[str] | None = None
    length: float | None = None

    def __post_init__(self) -> None:
        self._set("q", finite_array("q", self.q, (None,)))
        if self.joints is not None:
            self._set("joints", _names(self.joints))
        self._set_scales(self.weight, self.length)

    def rows(self, state: ArmState, target: Target) -> TaskRows:
        """Return one row for each joint; see `ControlTask.rows`."""
        arm = arm_of(state)
        columns = self._columns(arm)
        scale = lever(arm, self.length) / arm.joint_units[columns]
        jacobian = np.zeros((len(columns), arm.nv))
        jacobian[np.arange(len(columns)), columns] = scale
        apart = np.asarray(arm.difference(state.q, arm.checked(self.q)))
        return TaskRows(jacobian, scale * apart[columns])

    def _columns(self, arm: Arm) -> NDArray[np.intp]:
        if self.joints is None:
            return arm.columns
        known = arm.chain.input_names
        for name in self.joints:
            require_known("joint", name, known)
        return arm.columns[[known.index(name) for name in self.joints]]


def _names(joints: Any) -> tuple[str, ...]:
    listed = [joints] if isinstance(joints, str) or not isinstance(joints, Iterable) else list(joints)
    if not listed or not all(isinstance(name, str) for name in listed) or len(set(listed)) < len(listed):
        raise InvalidValue("joints", joints, "one or more distinct names of joints")
    return tuple(listed)


@dataclass(frozen=True, eq=False)
class Tangents(ComparableTask):
    """Point the links that end at control points in given directions.

    `link_axes` defines the link; for template arms it is the x axis of the frame of the control point. For a
    planar arm, components of a direction off its plane are ignored. A link that points in the opposite
    direction turns in a direction that depends on the link alone.

    Attributes:
        directions: nonzero vector for each control point, (k, 3), or (3,) for one, world frame; stored as
            unit vectors (k, 3).
        points: index or name of one or more control points; all of them if None.
        weight: weight of the squared error of each row; that of a control point has weight 1.
        length: lever arm of rotations [m/rad]; `Arm.characteristic_length` if None.

    Raises:
        InvalidValue: a value other than described.
    """

    directions: ArrayLike
    points: ControlPoints | None = None
    weight: float = 1.0
    length: float | None = None

    def __post_init__(self) -> None:
        directions: Any = self.directions
        vectors = finite_array(
            "directions", directions, (3,) if _is_vector(directions) else (None, 3)
        ).reshape(-1, 3)
        largest = np.abs(vectors).max(axis=1, keepdims=True)
        for k in np.flatnonzero(largest == 0.0)[:1]:
            raise InvalidValue(f"directions[{k}]", vectors[k].tolist(), "a vector other than 0")
        vectors = vectors / largest  # or squares could overflow
        self._set("directions", vectors / np.linalg.norm(vectors, axis=1, keepdims=True))
        if self.points is not None:
            listed = _listed(self.points)
            if len(listed) != len(vectors):
                raise InvalidValue("points", self.points, f"as many as there are directions, {len(vectors)}")
            self._set("points", listed)
        self._set_scales(self.weight, self.length)

    @classmethod
    def of_curve(
        cls,
        target: Target,
        points: int | Iterable[int] | None = None,
        weight: float = 1.0,
        length: float | None = None,
    ) -> Tangents:
        """Return the task of pointing links along the curve of a target.

        A link between points on a curve is a chord, roughly parallel to the tangent at its middle. The
        tangent at its end differs by about half the length times the curvature, so the task competes with
        the positions of the preceding points.

        Args:
            target: a target that lies on a curve.
            points: indices of control points, 0-based or from the tip as -1; all with a target if None.
            weight: see `Tangents`.
            length: see `Tangents`.

        Raises:
            InvalidValue: a target without a curve, or an index that it does not have.
        """
        require_instance("target", target, Target, "a Target on a curve, from resolve_targets")
        if target.curve is None or target.parameters is None:
            raise InvalidValue("target.curve", None, "a target on a curve, from resolve_targets")
        m = len(target.parameters)
        listed = _listed(np.flatnonzero(target.has_target) if points is None else points)
        for k in listed:
            if isinstance(k, str) or not -m <= k < m:
                raise InvalidValue("points", k, f"whole numbers from {-m} to {m - 1}")
        indices = np.array([k % m for k in listed if not isinstance(k, str)], dtype=np.intp)
        return cls(target.curve.tangent(target.parameters[indices]), indices.tolist(), weight, length)

    def rows(self, state: ArmState, target: Target) -> TaskRows:
        """Return two rows for each point, one in a plane; see `ControlTask.rows`."""
        arm = arm_of(state)
        directions = np.asarray(self.directions)
        chosen = range(arm.n_modules) if self.points is None else self.points
        points = chosen_points(arm.control_points, chosen)
        if len(points) != len(directions):
            allowed = f"one direction for each of {len(points)} control points; points= selects some"
            raise InvalidValue("directions (shape)", directions.shape, allowed)
        turns, angles = direction_rows(state, np.array(points), directions)
        arc = lever(arm, self.length)
        return TaskRows(arc * turns, arc * angles)


def _listed(points: Any) -> tuple[int | str, ...]:
    """Return control points as indices or names, without checking them against an arm."""
    alone = isinstance(points, str) or not isinstance(points, Iterable)
    listed = [points] if alone else list(points)
    for point in listed:
        if not (isinstance(point, str) or is_whole(point)):
            raise InvalidValue("points", point, "indices or names of control points")
    return tuple(point if isinstance(point, str) else int(point) for point in listed)


def _is_vector(values: Any) -> bool:
    try:
        return bool(np.shape(values) == (3,))
    except ValueError:  # rows of different lengths
        return False


__all__ = ["ControlTask", "EndEffector", "JointPosture", "Tangents", "TaskRows"]
