"""The chain of an arm: its joints, and the placements and Jacobians of its control points.

`read_chain` reads the joints from a Pinocchio model. `FrameReader` reads the control points at a
configuration from Pinocchio, for `PinocchioState` and the methods of the thesis. `Kinematics` computes the
same values on plain arrays, for `ChainState`: for kernels, and for arms that are too long for `pin.Data`,
whose memory grows with the cube of the number of joints. A test compares the two.
"""

from __future__ import annotations

import threading
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture import kernels
from pinposture._validation import require_known
from pinposture.arm.couplings import is_coupled, joint_axes, joint_placements, joint_ratios
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import JOINT, ArmArrays, Joints

Array = NDArray[np.float64]
BoolArray = NDArray[np.bool_]

PARALLEL = 1e-3
"""Largest angle between parallel axes [rad]; files round a quarter turn to 1.571 or even 1.57."""
ON_AXIS = 1e-6
"""Distance from a joint axis below which the joint does not move a point, relative to the arm length."""


def neutral_placements(model: pin.Model) -> list[pin.SE3]:
    """Compute the placements of all joints at the neutral configuration, world frame.

    `pin.Data` holds the same placements, but does not fit into memory for an arm of 1,000 joints.
    """
    placements = [pin.SE3.Identity()]
    local = joint_placements(model)
    for joint in range(1, model.njoints):  # at the neutral configuration a joint moves nothing
        placements.append(placements[model.parents[joint]] * local[joint])
    return placements


def read_joints(
    model: pin.Model, placements: Sequence[pin.SE3], chain: Sequence[int] | None = None
) -> Joints:
    """Read joints of a model as kernels take them.

    Args:
        model: the model; its first joint is the world.
        placements: those of its joints at the neutral configuration, from `neutral_placements`.
        chain: the joints of a chain, from the world on; None: all, so that joint u carries frame u.
    """
    listed = list(model.joints)
    numbers = list(range(1, model.njoints) if chain is None else chain)
    parents = np.array([model.parents[number] for number in numbers], dtype=np.int64)
    kinds = np.full(len(numbers), JOINT.other, dtype=np.int64)
    axes = np.zeros((len(numbers), 3))
    ratios = np.ones(len(numbers))
    names = [listed[number].shortname().removeprefix("JointModel") for number in numbers]
    simple = [u for u, name in enumerate(names) if name == "Mimic" or (name[0] in "RP" and name != "Planar")]
    if simple:
        which = [numbers[u] for u in simple]
        own_axes, revolute = joint_axes(model, which)
        kinds[simple] = np.where(revolute, JOINT.revolute, JOINT.prismatic)
        rotations = np.array([placements[number].rotation for number in which])
        axes[simple] = np.einsum("nij,nj->ni", rotations, own_axes)
        ratios[simple] = joint_ratios(model, which)
    local = joint_placements(model)
    shifts = [placements[model.parents[number]].rotation @ local[number].translation for number in numbers]
    return Joints(
        parents=parents if chain is None else np.arange(len(numbers), dtype=np.int64),
        kinds=kinds,
        axes=axes,
        offsets=np.array(shifts).reshape(-1, 3),
        columns=np.array([listed[number].idx_v for number in numbers], dtype=np.int64),
        ratios=ratios,
    )


def chain_arrays(joints: Joints, ends: NDArray[np.int64], levers: Array, turns: Array) -> ArmArrays:
    """Return a chain as kernels take it; its degrees of freedom are those of its joints, from the base on.

    Args:
        joints: the joints.
        ends: as in `ArmArrays`, (m,).
        levers: as in `ArmArrays`, (m, 3) [m].
        turns: as in `ArmArrays`, (m, 3, 3).
    """
    columns = joints.columns.tolist()
    inputs = {column: number for number, column in enumerate(dict.fromkeys(columns))}
    numbers = np.array([inputs[column] for column in columns])
    return ArmArrays(
        joints=joints,
        ends=np.array(ends, dtype=np.int64),
        levers=np.ascontiguousarray(levers),
        turns=np.ascontiguousarray(turns),
        inputs=np.array(list(inputs), dtype=np.int64),
        driven=np.argsort(numbers, kind="stable").astype(np.int64),
        starts=np.searchsorted(np.sort(numbers), np.arange(len(inputs) + 1)).astype(np.int64),
    )


def frame_position(frame: pin.Frame, placements: Sequence[pin.SE3]) -> Array:
    """Return the position of a frame, (3,) [m], given the placements of all joints."""
    return np.array((placements[frame.parentJoint] * frame.placement).translation)


def plane_normal(axes: Array, origins: Array, revolute: BoolArray, tip: Array, length: float) -> Array | None:
    """Return the normal of the plane in which joints move an arm, (3,), or None if there is no such plane.

    Revolute joints turn about the normal, slides are perpendicular to it. Revolute joints at the end may have
    any axis through the tip, because they do not move it.
    """
    n = len(axes)
    while n and revolute[n - 1]:
        if np.linalg.norm(np.cross(axes[n - 1], tip - origins[n - 1])) > ON_AXIS * length:
            break
        n -= 1
    if not n:  # nothing moves the tip
        return None
    turns = axes[:n][revolute[:n]]
    slides = axes[:n][~revolute[:n]]
    if len(turns):
        signs = np.where(turns @ turns[0] < 0.0, -1.0, 1.0)
        normal = signs @ turns
    else:
        crosses = np.cross(slides, slides[0])
        normal = crosses[np.argmax(np.linalg.norm(crosses, axis=1))]
    size = np.linalg.norm(normal)
    if size < PARALLEL:  # slides along one line
        return None
    normal = normal / size
    parallel = np.all(np.linalg.norm(np.cross(turns, normal), axis=1) < PARALLEL)
    return normal if parallel and np.all(np.abs(slides @ normal) < PARALLEL) else None


def find_unlimited(lower: Array, upper: Array, slides: BoolArray, length: float) -> BoolArray:
    """Find the joints without position limits, or with limits so wide that they mean none, (n,).

    These allow more than 100 arm lengths of sliding, or more than 100 rad of rotation.
    """
    return np.asarray(upper - lower > 100.0 * np.where(slides, length, 1.0))  # files use +-1e6 for none


def find_base_slides(unlimited: BoolArray, revolute: BoolArray) -> BoolArray:
    """Find the slides without real limits that carry the base, as in a mobile robot, (n,).

    They come before the first revolute joint; an arm without revolute joints has none.
    """
    return np.asarray(unlimited & ~np.logical_or.accumulate(revolute) & np.any(revolute))


@dataclass(frozen=True, eq=False)
class Skeleton:
    """Joints of a serial arm at its neutral configuration, before it is cut into modules; world frame."""

    names: tuple[str, ...]  # names of the joints from base to tip, (n,)
    axes: Array  # unit joint axes, (n, 3)
    revolute: BoolArray  # True for a joint that turns, (n,)
    stations: Array  # origins of the joints, and the tip after them, (n + 1, 3) [m]
    lower: Array  # smallest joint positions, (n,) [rad or m]
    upper: Array  # largest joint positions, (n,) [rad or m]
    columns: NDArray[np.intp]  # degree of freedom of each joint, (n,); the same for coupled joints
    ratios: Array  # motion of each joint relative to its degree of freedom, (n,)

    @cached_property
    def length(self) -> float:
        """Length from the first joint through the others to the tip [m]; inf or NaN if out of range."""
        with np.errstate(over="ignore", invalid="ignore"):
            return _polyline_length(self.stations)

    @cached_property
    def normal(self) -> Array | None:
        """Normal of the plane in which the arm moves, (3,), or None if it is spatial."""
        return plane_normal(self.axes, self.stations[:-1], self.revolute, self.stations[-1], self.length)

    @cached_property
    def base_slides(self) -> BoolArray:
        """Which joints are slides without real limits that carry the base, (n,)."""
        unlimited = find_unlimited(self.lower, self.upper, ~self.revolute, self.length)
        return find_base_slides(unlimited, self.revolute)


def read_skeleton(model: pin.Model, names: Sequence[str], tip: str, lower: Array, upper: Array) -> Skeleton:
    """Read the named joints of a model, which form a chain that ends at link `tip`.

    `lower` and `upper` are the limits of the degrees of freedom, (nv,) [rad or m].
    """
    placements = neutral_placements(model)
    joints = [model.getJointId(name) for name in names]
    chain = read_joints(model, placements, joints)
    end = frame_position(model.frames[model.getFrameId(tip, pin.FrameType.BODY)], placements)
    stations = np.vstack([*(placements[joint].translation for joint in joints), end])
    columns = chain.columns
    low, high = np.sort([chain.ratios * lower[columns], chain.ratios * upper[columns]], axis=0)
    return Skeleton(
        names=tuple(names),
        axes=chain.axes,
        revolute=chain.kinds == JOINT.revolute,
        stations=stations,
        lower=low,
        upper=high,
        columns=columns,
        ratios=chain.ratios,
    )


def without_repeats(line: Array, tolerance: float = 1e-9) -> Array:
    """Return the points of a line, (n, 3) [m], that are farther than a tolerance from the previous one."""
    legs = np.linalg.norm(np.diff(line, axis=0), axis=1)
    return np.asarray(line[np.concatenate([[True], legs > tolerance])])


def _polyline_length(stations: Array) -> float:
    return float(np.linalg.norm(np.diff(stations, axis=0), axis=1).sum())


@dataclass(frozen=True, eq=False)
class Chain:
    """Joints and control points of a serial arm at its neutral configuration, world frame.

    Each joint u is a screw fixed to the body before it; at the neutral configuration its axis passes through
    `origins[u]` along `axes[u]`. Together with the control points this defines the kinematics (product of
    exponentials), whatever frames the file uses.

    Attributes:
        joints: names of the moving joints from base to tip, (n,).
        columns: index of each joint's velocity in the tangent space, (n,); the same for coupled joints.
        ratios: motion of each joint relative to its degree of freedom, (n,); 1 unless coupled.
        revolute: True for a joint that turns, False for one that slides, (n,).
        axes: unit joint axes, (n, 3).
        origins: a point on each axis, (n, 3) [m].
        base: position of control point 0, where the first module begins, (3,) [m].
        points: control points, (m, 3) [m].
        module_starts: index into `joints` of the first joint of each module, (m,).
    """

    joints: tuple[str, ...]
    columns: NDArray[np.intp]
    ratios: Array
    revolute: BoolArray
    axes: Array
    origins: Array
    base: Array
    points: Array
    module_starts: NDArray[np.intp]

    @cached_property
    def leaders(self) -> NDArray[np.intp]:
        """Index into `joints` of the first joint of each degree of freedom, (f,); increasing.

        Any other joints are coupled to one of these.
        """
        return np.sort(np.unique(self.columns, return_index=True)[1])

    @cached_property
    def inputs(self) -> NDArray[np.intp]:
        """Columns of the degrees of freedom from base to tip, (f,): `columns` without duplicates."""
        return self.columns[self.leaders]

    @cached_property
    def input_names(self) -> tuple[str, ...]:
        """Names of the leading joints, (f,)."""
        return tuple(self.joints[u] for u in self.leaders)

    @cached_property
    def input_numbers(self) -> NDArray[np.intp]:
        """Index into `inputs` of the degree of freedom of each joint, (n,)."""
        order = np.argsort(self.inputs)
        return order[np.searchsorted(self.inputs[order], self.columns)]

    @cached_property
    def input_ends(self) -> NDArray[np.intp]:
        """Number of degrees of freedom that carry each control point, (m,); increasing."""
        return np.searchsorted(self.leaders, [part.stop for part in self.module_slices])

    @cached_property
    def module_slices(self) -> tuple[slice, ...]:
        """Joints of each module as a range into `joints`."""
        ends = [*self.module_starts[1:], len(self.joints)]
        return tuple(slice(int(a), int(b)) for a, b in zip(self.module_starts, ends, strict=True))

    @cached_property
    def module_lengths(self) -> Array:
        """Distance from the base to the end of each module at the neutral configuration, (m,) [m]."""
        return np.asarray(np.linalg.norm(np.diff(np.vstack([self.base, self.points]), axis=0), axis=1))

    @cached_property
    def length(self) -> float:
        """Length from the first joint through joint origins and control points to the tip [m]."""
        stations = [self.base[None]]
        for joints, point in zip(self.module_slices, self.points, strict=True):
            stations += [self.origins[joints], point[None]]
        return _polyline_length(np.vstack(stations))

    @cached_property
    def plane(self) -> Array:
        """Orthonormal basis (2, 3) of the plane in which the arm moves, or (3, 3) if it is spatial."""
        normal = plane_normal(self.axes, self.origins, self.revolute, self.points[-1], self.length)
        if normal is None:
            return np.eye(3)
        reach = self.points[-1] - self.base
        along = reach - normal * (normal @ reach)
        if np.linalg.norm(along) <= 1e-9 * self.length:
            along = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
        along = along / np.linalg.norm(along)
        return np.array([along, np.cross(normal, along)])

    @cached_property
    def plane_bound(self) -> BoolArray:
        """Modules of a spatial arm that move their ends in one plane only, (m,).

        Their joint axes are parallel. All False for a planar arm.
        """
        bound = np.zeros(len(self.points), dtype=np.bool_)
        if len(self.plane) == 2:
            return bound
        for k, joints in enumerate(self.module_slices):
            hinges = self.axes[joints], self.origins[joints], self.revolute[joints]
            alone = joints.stop - joints.start == 1
            bound[k] = alone or plane_normal(*hinges, self.points[k], self.length) is not None
        return bound

    @cached_property
    def spans(self) -> Array:
        """Length of arm needed to bend in every direction normal to a curve, for each module, (m,) [m].

        Usually the length of the module. Consecutive modules bound to one plane bend together with the
        modules before and after them, which turn the plane.
        """
        spans = self.module_lengths.copy()
        m = len(self.points)
        edges = np.flatnonzero(np.diff(np.concatenate([[0], self.plane_bound.astype(int), [0]])))
        for start, stop in edges.reshape(-1, 2):
            together = slice(max(int(start) - 1, 0), min(int(stop) + 1, m))
            spans[together] = np.maximum(spans[together], self.module_lengths[together].sum())
        return np.asarray(spans)

    def flattened(self, points: Array) -> Array:
        """Project points of a planar arm into its plane, world frame.

        Args:
            points: points on the arm, at any configuration, (..., 3) [m].

        Returns:
            For a planar arm, the points projected along its normal onto the plane of its base; for a spatial
            one, the points unchanged.
        """
        if len(self.plane) == 3:
            return points
        normal = np.cross(*self.plane)
        return np.asarray(points - ((points - self.base) @ normal)[..., None] * normal)


def read_chain(model: pin.Model, control_points: tuple[str, ...]) -> Chain:
    """Read the chain that leads to the last control point from a model, base placement applied.

    Raises:
        InvalidValue: a control point is not farther along the chain than the previous one, or lies between
            coupled joints; or a joint has several degrees of freedom.
    """
    frames = [model.frames[index] for index in frame_ids(model, control_points)]
    parents = [frame.parentJoint for frame in frames]
    support = [int(j) for j in model.supports[parents[-1]] if j > 0]
    for j in support:
        if model.joints[j].nv != 1 and not is_coupled(model.joints[j]):
            allowed = "joints with one degree of freedom"
            raise InvalidValue(f"joint {model.names[j]!r}", model.joints[j].shortname(), allowed)
    number = {joint: u + 1 for u, joint in enumerate(support)}
    starts = []
    count = 0
    for name, parent in zip(control_points, parents, strict=True):
        reached = number.get(parent, 0)
        if reached <= count:
            allowed = "frames with at least one more moving joint of the same chain each, from base to tip"
            raise InvalidValue(f"control point {name!r}", f"moved by {reached} joints of the chain", allowed)
        starts.append(count)
        count = reached
    names = tuple(str(model.names[j]) for j in support)
    columns = [model.joints[j].idx_v for j in support]
    last = {column: u for u, column in enumerate(columns)}  # joint of each degree of freedom
    for name, start, stop in zip(control_points, [0, *starts[1:]], [*starts[1:], count], strict=True):
        for u in range(start, stop):
            if last[columns[u]] >= stop:
                allowed = f"a place before or after all joints coupled to {names[u]!r}"
                raise InvalidValue(f"control point {name!r}", "between coupled joints", allowed)
    placements = neutral_placements(model)
    selected = read_joints(model, placements, support)
    origins = np.array([placements[joint].translation for joint in support])
    return Chain(
        joints=names,
        columns=selected.columns,
        ratios=selected.ratios,
        revolute=selected.kinds == JOINT.revolute,
        axes=selected.axes,
        origins=origins,
        base=origins[0].copy(),
        points=np.array([frame_position(frame, placements) for frame in frames]),
        module_starts=np.array(starts, dtype=np.intp),
    )


def frame_ids(model: pin.Model, names: Sequence[str]) -> list[int]:
    """Return the indices of frames; if a link and a joint share a name, the index of the link.

    Raises:
        UnknownName: there is no such frame.
    """
    kinds = (pin.FrameType.OP_FRAME, pin.FrameType.BODY)
    frames_by_name: dict[str, int] = {}
    preferred: set[str] = set()
    for index, frame in enumerate(model.frames):
        frames_by_name.setdefault(frame.name, index)
        if frame.type in kinds and frame.name not in preferred:
            preferred.add(frame.name)
            frames_by_name[frame.name] = index
    for name in names:
        require_known("frame", name, frames_by_name)
    return [frames_by_name[name] for name in names]


IntArray = NDArray[np.int64]

MAX_PINOCCHIO_DOF = 100
"""Most degrees of freedom for which Pinocchio is used; a `pin.Data` then takes 66 MB per thread."""


class Frames(NamedTuple):
    """Placements of a chain and motions of its joints at one configuration, by Pinocchio; world frame."""

    origins: Array  # origins of the joints, (k, 3) [m]: all joints, coupled ones too
    points: Array  # positions of the control points, (m, 3) [m]
    rotations: Array  # their orientations, (m, 3, 3), from control-point to world frame
    # motion of a body at the world origin per degree of freedom, (nv, 6): velocity [m/rad], then angular
    # velocity [rad/rad]; the columns of `data.J`, summed over coupled joints, which all carry the body
    motions: Array


class FrameReader:
    """Reads the frames of the control points from Pinocchio, with one `pin.Data` per thread."""

    def __init__(self, model: pin.Model, chain: Chain, frames: Sequence[int]) -> None:
        """Store the model, base placement applied, its chain, and the indices of the control points."""
        self._model = model
        self._joints = [model.getJointId(name) for name in chain.joints]
        self._frames = tuple(frames)
        self._local = threading.local()
        # `data.J` has columns for all joints, coupled ones too; this is the degree of freedom of each.
        moving = [joint for joint in model.joints[1:] if joint.nvExtended]
        listed = [range(joint.idx_v, joint.idx_v + joint.nvExtended) for joint in moving]
        self._columns = np.array([column for columns in listed for column in columns])
        self._coupled = len(self._columns) > model.nv

    def _buffers(self) -> tuple[pin.Data, list[Array], list[Array], list[Array]]:
        """Return this thread's data, and views of origins, positions and orientations in it."""
        try:
            buffers: tuple[pin.Data, list[Array], list[Array], list[Array]] = self._local.buffers
        except AttributeError:
            data = self._model.createData()
            origins = [data.oMi[joint].translation for joint in self._joints]
            placements = [data.oMf[frame] for frame in self._frames]
            positions = [placement.translation for placement in placements]
            orientations = [placement.rotation for placement in placements]
            buffers = self._local.buffers = data, origins, positions, orientations
        return buffers

    def jacobian(self, q: Array, name: str) -> Array:
        """Compute the Jacobian of any frame at its origin, (6, nv), world axes: linear, then angular.

        Raises:
            UnknownName: there is no such frame.
        """
        [frame] = frame_ids(self._model, [name])
        aligned = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
        return np.array(pin.computeFrameJacobian(self._model, self._buffers()[0], q, frame, aligned))

    def gravity_torques(self, q: Array) -> Array:
        """Compute the torques and forces that balance gravity, (nv,) [N m or N]; a copy."""
        return np.array(pin.computeGeneralizedGravity(self._model, self._buffers()[0], q))

    def gravity_gradient(self, q: Array) -> Array:
        """Compute the change of the torques that balance gravity per joint motion, (nv, nv); a copy.

        Raises:
            InvalidValue: an arm with coupled joints, which Pinocchio does not derive.
        """
        if self._coupled:
            raise InvalidValue("arm", self._model.name, "coupled joints only if none moves off its chain")
        return np.array(pin.computeGeneralizedGravityDerivatives(self._model, self._buffers()[0], q))

    def inverse_dynamics(self, q: Array, velocities: Array, accelerations: Array) -> Array:
        """Compute the torques and forces of motions, (k, nv) each, at configurations (k, nq)."""
        data = self._buffers()[0]
        torques = np.empty_like(velocities)
        for k, motion in enumerate(zip(q, velocities, accelerations, strict=True)):
            torques[k] = pin.rnea(self._model, data, *motion)
        return torques

    def read(self, q: Array) -> Frames:
        """Compute the frames at a configuration (nq,); the arrays are copies."""
        data, placed, positions, orientations = self._buffers()
        pin.computeJointJacobians(self._model, data, q)
        pin.updateFramePlacements(self._model, data)
        m = len(positions)
        origins = np.concatenate(placed)
        points = np.concatenate(positions)
        rotations = np.concatenate(orientations)
        motions = np.array(data.J.reshape(6, -1).T, order="C")
        if self._coupled:
            joint_motions = motions
            motions = np.zeros((self._model.nv, 6))
            np.add.at(motions, self._columns, joint_motions)
        return Frames(origins.reshape(-1, 3), points.reshape(m, 3), rotations.reshape(m, 3, 3), motions)


class ForwardKinematics(NamedTuple):
    """Placements of a chain at one configuration, by the pass along it; world frame; do not write to them."""

    axes: Array  # unit joint axes, (k, 3): all joints, coupled ones too
    origins: Array  # origins of the joints, a point on each axis, (k, 3) [m]
    points: Array  # positions of the control points, (m, 3) [m]
    rotations: Array  # their orientations, (m, 3, 3), from control-point to world frame


class TaskConstants(NamedTuple):
    """Constant arguments of the task row kernels; do not write to the arrays."""

    joints: IntArray  # indices of the degrees of freedom along the chain, (n,)
    units: Array  # unit motion of each of them, (n,) [rad or m]
    plane: Array  # directions in which the arm can move, (2, 3) or (3, 3), world axes
    every: IntArray  # indices of the control points, (m,)
    dimensions: IntArray  # number of these directions, once for each control point, (m,)
    frames: Array  # these directions, and the normal of a planar arm, once for each control point, (m, 3, 3)


class Kinematics:
    """The constants of a chain, in the order of its joints from base to tip.

    Attributes:
        chain: the chain as it was read.
        columns: tangent-space columns of the degrees of freedom from base to tip, (n,).
        ends: number of degrees of freedom that carry each control point, (m,).
        endless: True for periodic joint positions, (nv,).
        constants: the arguments of `kernels.placements` that do not depend on the configuration.
    """

    def __init__(self, model: pin.Model, chain: Chain, frames: Sequence[int], joint_units: Array) -> None:
        """Read the constants of a chain from a model, base placement applied.

        Args:
            model: the arm.
            chain: its chain.
            frames: indices of the control points.
            joint_units: unit motion of each degree of freedom, (nv,) [rad or m].

        Raises:
            InvalidValue: a joint neither turns about one axis nor slides along one.
        """
        joints = [model.getJointId(name) for name in chain.joints]
        placements = neutral_placements(model)
        joints_read = read_joints(model, placements, joints)
        self.endless = np.zeros(model.nv, dtype=np.bool_)
        for number, kind in zip(joints, joints_read.kinds, strict=True):
            joint = model.joints[number]
            if kind == JOINT.other:
                allowed = "a joint that turns about one axis, or slides along one"
                name = joint.shortname().removeprefix("JointModel")
                raise InvalidValue(f"joint {model.names[number]!r}", name, allowed)
            self.endless[joint.idx_v] |= joint.nq == 2
        self.columns = chain.inputs.astype(np.int64)
        self.ends = chain.input_ends.astype(np.int64)
        ends = np.array([part.stop for part in chain.module_slices])
        carriers = [placements[joints[end - 1]].rotation for end in ends]
        points = [model.frames[frame].placement for frame in frames]
        self.constants = chain_arrays(
            joints=joints_read,
            ends=ends,
            levers=np.array([r @ point.translation for r, point in zip(carriers, points, strict=True)]),
            turns=np.array([r @ point.rotation for r, point in zip(carriers, points, strict=True)]),
        )
        self._model = model
        self.chain = chain
        self._units = joint_units

    def forward(self, positions: Array) -> ForwardKinematics:
        """Compute all placements at joint positions (nv,) [rad or m]."""
        k = len(self.constants.joints.kinds)
        m = len(self.ends)
        axes = np.empty((k, 3))
        origins = np.empty((k, 3))
        points = np.empty((m, 3))
        rotations = np.empty((m, 3, 3))
        kernels.placements(self.constants, positions, axes, origins, points, rotations)
        return ForwardKinematics(axes, origins, points, rotations)

    def points(self, positions: Array) -> Array:
        """Compute the control points, (s, m, 3) [m], at several joint positions, (s, nv) [rad or m]."""
        points = np.empty((len(positions), len(self.ends), 3))
        kernels.trace_points(self.constants, positions, points)
        return points

    def jacobians(self, forward: ForwardKinematics) -> Array:
        """Compute the position Jacobians of the control points, (m, 3, nv) [m/rad], world axes."""
        jacobians = np.zeros((len(self.ends), 3, len(self.endless)))
        joints = self.constants.joints
        ends = self.constants.ends
        kernels.jacobians(joints, ends, forward.axes, forward.origins, forward.points, jacobians)
        return jacobians

    @cached_property
    def task_constants(self) -> TaskConstants:
        """The constants of joint screws and of task rows."""
        n = len(self.columns)
        m = len(self.ends)
        plane = np.array(self.chain.plane)
        frame = plane if len(plane) == 3 else np.vstack([plane, np.cross(plane[0], plane[1])])
        return TaskConstants(
            joints=np.arange(n, dtype=np.int64),
            units=np.array(self._units[self.columns]),
            plane=plane,
            every=np.arange(m, dtype=np.int64),
            dimensions=np.full(m, len(plane), dtype=np.int64),
            frames=np.repeat(frame[None], m, axis=0),
        )
