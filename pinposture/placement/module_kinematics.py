"""Kinematics of modules (Section 6.1.1): closed forms, a numeric one, and the choice between them."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import astuple, dataclass
from functools import cached_property
from itertools import pairwise
from typing import ClassVar, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.optimize import brentq

from pinposture import kernels
from pinposture._validation import require_positive
from pinposture.arm import Arm
from pinposture.arm.kinematics import Chain
from pinposture.arm.module_kinematics import (
    ModuleJoints,
    ModuleKinematics,
    joints_in_base_frame,
    registered_kinematics,
    registry_state,
)
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, UnsupportedModule
from pinposture.kernels.arrays import CurveModule, ModuleSearch
from pinposture.kernels.modules import FORM
from pinposture.units import CONVERGED, ROUNDING

# The RyRz module of the thesis rotates by q0 about y, translates by l1 along x, rotates by q1 about z and
# translates by l2 along x. Its end lies on a torus around the y axis with radii l1 and l2. RzRy, and any
# other pair of perpendicular hinges across the arm, is the same module in another frame. If l1 = 0 it is a
# universal joint and the torus a sphere. The roll-pitch module rotates by q0 about x, translates by l1 along
# x, rotates by q1 about y and translates by l2 along x: its end lies on a sphere around the hinge.

Array = NDArray[np.float64]
Level = Callable[[Array], Array]


class NumericModuleSettings(NamedTuple):
    """Settings of the numeric search for joint positions of a module without a closed form."""

    grid: int = 21
    """Number of start postures per degree of freedom, with one or two."""

    samples: int = 512
    """Number of start postures with more degrees of freedom."""

    visits: int = 40
    """Largest number of visits of the module by its inverse kinematics."""

    exact: float = 1e-10
    """Distance from the wanted point that counts as zero, relative to the reach."""


NUMERIC_MODULE = NumericModuleSettings()


def curve_crossings(
    curve: Curve, base: pin.SE3, start: float, level: Level, reach: float
) -> Iterator[tuple[float, Array]]:
    """Find where a curve crosses the surface reachable by the end of a module: TP of any such module.

    Args:
        curve: the curve.
        base: placement of the base frame of the module in the frame of the curve.
        start: arc length of the base on the curve [m].
        level: a continuous function of points (n, 3) [m] in the base frame that is zero on the surface and
            changes sign across it, (n,).
        reach: largest distance of the end from the base [m].

    Yields:
        Arc length of each crossing [m], increasing, and its point in the base frame (3,) [m]. Stops where
        the curve leaves the reach. Points where the curve only touches the surface are not found.
    """

    def inside(s: float) -> Array:
        return np.asarray(base.rotation.T @ (np.asarray(curve.at(s)) - base.translation))

    samples = 200  # of the curve, per reach
    step = reach / samples
    s = start + CONVERGED * reach  # the base is no crossing
    value = np.nan
    while s < curve.length:
        block = np.minimum(s + step * np.arange(samples + 1), curve.length)
        points = (curve.at(block) - base.translation) @ base.rotation
        values = np.asarray(level(points))
        out = np.linalg.norm(points, axis=1) > reach * (1.0 + 1e-9)
        for i, (low, high) in enumerate(pairwise(block.tolist())):
            value = float(values[i])
            if high > low and (value > 0.0) != (float(values[i + 1]) > 0.0):
                edge = 1e-15 * max(curve.length, reach)
                crossing = brentq(
                    lambda at: float(level(inside(at)[None])[0]), low, high, xtol=edge, rtol=1e-15
                )
                yield float(crossing), inside(float(crossing))
            if out[i + 1]:
                return
        s = float(block[-1])


def first_facing(crossings: Iterator[tuple[float, Array]], faces: Callable[[Array], bool]) -> float | None:
    """Return the first crossing that faces the module, else the first one, else None."""
    first = None
    for s, point in crossings:
        if faces(point):
            return s
        first = s if first is None else first
    return first


@dataclass(frozen=True)
class ClosedForm:
    """FK, IK and TP of a module in closed form, in the frame at its base (x along it, y a hinge across it).

    Attributes:
        form: number of the closed form in the kernels.
    """

    form: ClassVar[int]

    @property
    def dof(self) -> int:
        """Number of degrees of freedom."""
        return 1 if self.form == FORM.circle else 2

    @cached_property
    def shape(self) -> Array:
        """Lengths l1 and l2 [m] and sense, (3,), as the kernels take them; l1 is the link of a circle."""
        return np.array([*astuple(self), 0.0, 1.0][:3])

    @property
    def reach(self) -> float:
        """Largest distance of the end from the base [m]."""
        return float(self.shape[0] + self.shape[1])

    def forward(self, q: Array) -> tuple[Array, Array]:
        """FK, for a torus (6.1) with the sign of (6.1b) corrected.

        Args:
            q: joint positions (k,) [rad].

        Returns:
            Position (3,) [m] and orientation (3, 3) of the end, both in the base frame.
        """
        end = kernels.module_forward(self.form, self.shape, np.array(q, dtype=float))
        return np.array(end[:3]), np.array(end[3:]).reshape(3, 3)

    def inverse(self, p: Array) -> list[Array]:
        """IK, for a torus (6.2) for the whole of it: all joint positions that put the end at p.

        Args:
            p: a point in reach, (3,) [m], base frame.

        Returns:
            Joint positions (k,) [rad], of a torus the branch that faces p first, of a roll and a hinge the
            smaller roll; a roll that does not move the end is 0. Empty if the end cannot be at p.
        """
        out = np.empty((2, 2))
        x, y, z = map(float, p)
        return list(out[: kernels.module_inverse(self.form, self.shape, x, y, z, out), : self.dof])

    def faces(self, p: Array) -> bool:
        """Return whether the last hinge bends by less than 90 degrees at p, (3,) [m]; a single one always."""
        x, y, z = map(float, p)
        return bool(kernels.module_faces(self.form, self.shape, x, y, z))

    def target_point(self, base: pin.SE3, curve: Curve, start: float) -> float | None:
        """TP, as `ModuleKinematics.target_point`; points that face the module come first."""
        crossings = curve_crossings(curve, base, start, self._level, self.reach)
        return first_facing((crossing for crossing in crossings if self.inverse(crossing[1])), self.faces)

    def _level(self, p: Array) -> Array:
        """Return a function of points (n, 3) [m] that changes sign across the reachable surface, (n,)."""
        raise NotImplementedError

    def crossings(self, points: Array) -> Iterator[tuple[int, float]]:
        """TP: where a polyline crosses the reachable surface; of a torus by (6.13)-(6.15) corrected.

        Args:
            points: vertices (n + 1, 3) [m], base frame.

        Yields:
            Segment index i and t in (0, 1] of each crossing points[i] + t (points[i + 1] - points[i]),
            in order along the polyline. The base, where a torus touches itself if l1 = l2, is excluded. Of a
            circle the sphere around it is crossed; check with `inverse` that the crossing is in its plane.
        """
        out = np.empty(4)
        for i, (a, b) in enumerate(pairwise(np.asarray(points, dtype=float).tolist())):
            for t in out[: kernels.module_crossings(self.form, self.shape, tuple(a), tuple(b), out)]:
                yield i, float(t)


@dataclass(frozen=True)
class Torus(ClosedForm):
    """FK, IK and TP of a RyRz module, in the frame at its base (x along the module, y the first hinge).

    Attributes:
        l1: distance between the hinges [m]; 0 for a universal joint.
        l2: distance from the second hinge to the end [m].
        sense: +1 if the second hinge turns about +z, -1 if about -z.
    """

    form = FORM.torus
    l1: float
    l2: float
    sense: float = 1.0

    def _level(self, p: Array) -> Array:
        l1 = self.l1
        l2 = self.l2
        rho = np.hypot(p[:, 0], p[:, 2])
        outer = np.hypot(rho - l1, p[:, 1]) - l2
        return np.asarray(outer * (np.hypot(rho + l1, p[:, 1]) - l2) if l2 > l1 > 0.0 else outer)


@dataclass(frozen=True)
class Circle(ClosedForm):
    """FK, IK and TP of a module with one hinge (Section 4.6), in the frame at its base (y is the hinge).

    Attributes:
        link: distance from the hinge to the end [m].
    """

    form = FORM.circle
    link: float

    def _level(self, p: Array) -> Array:
        return np.asarray(np.linalg.norm(p, axis=1) - self.link)


@dataclass(frozen=True)
class RollPitch(ClosedForm):
    """FK, IK and TP of a module with a roll and a hinge across it, in the frame at its base (y is the hinge).

    Attributes:
        l1: distance from the base to the second hinge, along the roll axis [m]; may be 0.
        l2: distance from the second hinge to the end [m].
        sense: +1 if the first joint turns about +x, -1 if about -x.
    """

    form = FORM.roll_pitch
    l1: float
    l2: float
    sense: float = 1.0

    def _level(self, p: Array) -> Array:
        return np.asarray(np.linalg.norm(p - [self.l1, 0.0, 0.0], axis=1) - self.l2)


@dataclass(frozen=True, eq=False)
class NumericModule:
    """FK, IK and TP of a module with any joints, by numeric search; used where there is no closed form.

    Redundant joints stay near the preferred positions.

    Attributes:
        joints: joints of the module, in its base frame.
        preferred: positions to stay near, (k,) [rad or m].
    """

    joints: ModuleJoints
    preferred: Array

    @property
    def dof(self) -> int:
        """Number of degrees of freedom, k."""
        return self.joints.dof

    @cached_property
    def reach(self) -> float:
        """Upper bound of the distance of the end from the base: lengths of links and extended slides [m]."""
        joints = self.joints
        line = np.vstack([np.zeros(3), joints.origins, joints.end])
        farthest = np.abs(self._range).max(axis=0)[joints.inputs]
        slides = np.abs(joints.ratios[~joints.revolute]) * farthest[~joints.revolute]
        return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum() + slides.sum())

    @property
    def _turning(self) -> NDArray[np.bool_]:
        """True for degrees of freedom that turn joints, (k,)."""
        return np.bincount(self.joints.inputs, self.joints.revolute, minlength=self.dof) > 0.0

    @cached_property
    def _range(self) -> tuple[Array, Array]:
        """Limits of the search, (k,) each; if there are none, half a turn or a length from preferred."""
        joints = self.joints
        far = np.where(self._turning, np.pi, max(float(np.linalg.norm(joints.end)), 1e-9))
        wide = joints.upper - joints.lower > np.where(self._turning, 100.0, 200.0 * far)
        low = np.where(wide, self.preferred - far, joints.lower)
        return low, np.where(wide, self.preferred + far, joints.upper)

    @cached_property
    def _arrays(self) -> CurveModule:
        joints = self.joints
        turned = np.bincount(joints.inputs, np.abs(joints.ratios) * joints.revolute, minlength=self.dof)
        slid = np.bincount(joints.inputs, np.abs(joints.ratios) * ~joints.revolute, minlength=self.dof)
        length = float(np.linalg.norm(joints.end)) or 1.0
        units = np.where(turned > 0.0, 1.0 / np.maximum(turned, 1e-300), length / np.maximum(slid, 1e-300))
        return CurveModule(
            chain=joints.chain,
            units=units,
            turning=turned > 0.0,
            reach=np.array([self.reach]),
        )

    @cached_property
    def _samples(self) -> tuple[Array, Array]:
        """Start postures, (s, k), the preferred one first, and their end positions, (s, 3) [m]."""
        k = self.dof
        low, high = self._range
        if k <= 2:
            along = np.linspace(0.0, 1.0, NUMERIC_MODULE.grid)
            shares = np.stack(np.meshgrid(*[along] * k), axis=-1).reshape(-1, k)
        else:
            from scipy.stats import qmc  # as slow to import as a quarter of the library

            shares = qmc.Sobol(k, scramble=False).random(NUMERIC_MODULE.samples)
        inside = np.clip(self.preferred, low, high)
        samples = np.ascontiguousarray(np.vstack([inside, low + shares * (high - low)]))
        ends = np.empty((len(samples), 1, 3))
        kernels.trace_points(self.joints.chain, samples, ends)
        return samples, ends.reshape(-1, 3)

    def forward(self, q: Array) -> tuple[Array, Array]:
        """FK: position (3,) [m] and orientation (3, 3) of the end at q, (k,), base frame."""
        return self.joints.forward(q)

    def inverse(self, p: Array) -> list[Array]:
        """IK: positions (k,) within the limits that put the end at p, (3,) [m]; one or none."""
        from scipy.stats import qmc  # slow to import

        joints = self.joints
        k = self.dof
        preferred = np.clip(self.preferred, *self._range)
        chain = ModuleSearch(
            joints=joints.chain.joints,
            levers=joints.chain.levers,
            starts=np.array([0, len(joints.names)]),
            begins=np.array([0, k]),
            sliding=~self._turning,
            lower=np.array(joints.lower),
            upper=np.array(joints.upper),
            near=preferred.copy(),
        )
        goals = np.array(p, dtype=float).reshape(1, 3)
        shares = np.ascontiguousarray(qmc.Sobol(k, scramble=False).random(32))
        exact = NUMERIC_MODULE.exact * self.reach
        visits = NUMERIC_MODULE.visits
        reached = kernels.search_branches(chain, goals, self.reach, exact, 1, visits, shares, preferred)
        return [preferred] if reached == 1 else []

    def target_point(self, base: pin.SE3, curve: Curve, start: float) -> float | None:
        """TP, as `ModuleKinematics.target_point`, within the limits and near the preferred positions."""
        s, _ = self.place(base, curve, start)
        return s if s >= 0.0 else None

    def place(
        self, base: pin.SE3, curve: Curve, start: float, near: Array | None = None
    ) -> tuple[float, Array]:
        """Find the next point of a curve and the posture that puts the end there.

        Args:
            base: as in `target_point`.
            curve: as in `target_point`.
            start: as in `target_point`.
            near: positions to stay near, (k,); the preferred ones if None.

        Returns:
            Its arc length [m] and the joint positions (k,). The arc length is NaN if the curve leaves the
            reach without such a point, -1 if it ends without one.
        """
        placed = np.ascontiguousarray(np.column_stack([base.rotation, base.translation]))
        preferred = self.preferred if near is None else near
        positions = np.empty(self.dof)
        inside = np.clip(preferred, self.joints.lower, self.joints.upper)
        samples, ends = self._samples
        if near is not None:
            samples = samples.copy()
            ends = ends.copy()
            samples[0] = inside
            ends[0] = self.forward(inside)[0]
        spline, length = curve.measured
        s = kernels.next_target_point(
            self._arrays,
            spline,
            length,
            placed,
            start,
            self.joints.lower,
            self.joints.upper,
            inside,
            samples,
            ends,
            positions,
        )
        return float(s), positions


@dataclass(frozen=True, eq=False)
class JointGroup:
    """Consecutive joints of an arm that are placed together.

    Attributes:
        module: index of the module they belong to, 0-based.
        joints: indices into the chain.
        first: index into `Arm.columns` of their first degree of freedom.
        base: base of the group at the neutral configuration, (3,) [m], world frame.
        frame: axes of its base frame as columns, (3, 3), world frame.
        kinematics: its kinematics.
        reason: why these are numeric; empty if they are not.
    """

    module: int
    joints: slice
    first: int
    base: Array
    frame: Array
    kinematics: ModuleKinematics
    reason: str = ""

    @property
    def inputs(self) -> slice:
        """Degrees of freedom as a range into `Arm.columns`."""
        return slice(self.first, self.first + self.kinematics.dof)


def joint_groups(arm: Arm) -> tuple[JointGroup, ...]:
    """Return the kinematics that place the modules of an arm one by one, from base to tip.

    Registered kinematics take precedence. A module with two perpendicular hinges is a `Torus`, one with a
    roll and a hinge a `RollPitch`; parallel hinges are placed one by one as `Circle`s; others are
    `NumericModule`s. Trailing joints that do not move the end of their module belong to the next one if it
    needs them, else they are not moved. `Arm.base_slides` are excluded.

    Raises:
        UnsupportedModule: no joint of a module moves its end.
    """
    return _joint_groups(arm).groups


class GroupRun(NamedTuple):
    """Groups that one call places: consecutive ones with closed forms in the library, or any other one.

    Attributes:
        groups: the groups.
        numbers: the closed form, first joint and module of each, (n, 3); empty without closed forms.
        shapes: its lengths, sense and base frame as `kernels.place_modules` takes them, (n, 12); empty too.
    """

    groups: tuple[JointGroup, ...]
    numbers: NDArray[np.int64]
    shapes: Array

    @property
    def in_closed_form(self) -> bool:
        """Whether these are groups with closed forms."""
        return len(self.numbers) > 0

    @property
    def inputs(self) -> slice:
        """Degrees of freedom from the first group to the last as a range into `Arm.columns`."""
        return slice(self.groups[0].first, self.groups[-1].inputs.stop)

    def shapes_in(self, turn: Array) -> Array:
        """Return the shapes with all base frames turned by a rotation (3, 3), (n, 12)."""
        turned: Array = self.shapes.copy()
        turned[:, 3:] = (turn @ self.shapes[:, 3:].reshape(-1, 3, 3)).reshape(-1, 9)
        return turned


class _JointGroups(NamedTuple):
    """The groups of an arm, and data derived from them."""

    registry: int  # state of the registry for which they are valid
    groups: tuple[JointGroup, ...]
    names: tuple[str, ...]  # kinematics of each module
    runs: tuple[GroupRun, ...]


def _joint_groups(arm: Arm) -> _JointGroups:
    known: _JointGroups | None = arm.cache.get(joint_groups)
    if known is None or known.registry != registry_state():
        groups = _find_groups(arm)
        named = {group.module: type(group.kinematics).__name__ for group in groups}
        names = tuple(named[module] for module in range(arm.n_modules))
        runs = tuple(_run_of(tuple(run)) for run in _divide(arm, groups))
        known = arm.cache[joint_groups] = _JointGroups(registry_state(), groups, names, runs)
    return known


def _divide(arm: Arm, groups: Sequence[JointGroup]) -> list[list[JointGroup]]:
    """Divide groups into runs; joints between those of a run, which move no end, can be at zero."""
    lower = arm.limits.lower[arm.columns]
    upper = arm.limits.upper[arm.columns]
    runs: list[list[JointGroup]] = []
    stop = 0
    for group in groups:
        between = slice(stop, group.first)
        at_zero = np.all((lower[between] <= 0.0) & (upper[between] >= 0.0))
        before = runs[-1][-1] if runs else group
        both = isinstance(before.kinematics, ClosedForm) and isinstance(group.kinematics, ClosedForm)
        if runs and both and at_zero:
            runs[-1].append(group)
        else:
            runs.append([group])
        stop = group.inputs.stop
    return runs


def _run_of(groups: tuple[JointGroup, ...]) -> GroupRun:
    """Return groups as a run."""
    closed = [(group, group.kinematics) for group in groups if isinstance(group.kinematics, ClosedForm)]
    rows = [(form.form, group.first, group.module) for group, form in closed]
    shapes = [np.concatenate([form.shape, group.frame.ravel()]) for group, form in closed]
    return GroupRun(groups, np.array(rows, dtype=np.int64).reshape(-1, 3), np.array(shapes).reshape(-1, 12))


def kinematics_names(arm: Arm) -> tuple[str, ...]:
    """Return the name of the kinematics of each module of an arm, (m,).

    Raises:
        UnsupportedModule: as `joint_groups`.
    """
    return _joint_groups(arm).names


def group_runs(arm: Arm) -> tuple[GroupRun, ...]:
    """Return the groups of an arm by the calls that place them.

    Raises:
        UnsupportedModule: as `joint_groups`.
    """
    return _joint_groups(arm).runs


def is_compiled(arm: Arm) -> bool:
    """Return whether the library's closed forms place all modules, so that a single kernel call suffices."""
    runs = _joint_groups(arm).runs
    return len(runs) == 1 and runs[0].in_closed_form


def has_custom_kinematics(arm: Arm) -> bool:
    """Return whether registered kinematics place a module."""
    return any(_registered(arm, module) is not None for module in range(arm.n_modules))


def _find_groups(arm: Arm) -> tuple[JointGroup, ...]:
    chain = arm.chain
    groups = list[JointGroup]()
    registered = [_registered(arm, k) for k in range(arm.n_modules)]
    waiting = int(np.count_nonzero(arm.base_slides[chain.columns]))  # the first free joint
    base = chain.base
    for k, (joints, end) in enumerate(zip(chain.module_slices, chain.points, strict=True)):
        claimed = registered[k]
        if claimed is not None:
            groups.append(claimed)
        else:
            start = max(waiting, joints.start)
            stop = after_last_mover(chain, k, joints.start)
            if waiting < joints.start and stop - joints.start < (1 if arm.dimension == 2 else 2):
                start = waiting
            if stop <= start:
                raise UnsupportedModule(k + 1, chain.joints[joints], "none of its joints moves its end")
            groups.extend(_groups_of(arm, k, slice(start, stop), base, end))
        waiting = groups[-1].joints.stop
        base = end
    return tuple(groups)


def _registered(arm: Arm, module: int) -> JointGroup | None:
    """Return the group of a module that has registered kinematics, or None."""
    chain = arm.chain
    joints = chain.module_slices[module]
    base = chain.base if module == 0 else chain.points[module - 1]
    described = module_joints(arm, joints, base, chain.points[module])
    kinematics = registered_kinematics(described)
    if kinematics is None:
        return None
    first = int(chain.input_numbers[joints.start])
    return JointGroup(module, joints, first, described.base, described.frame, kinematics)


def module_joints(arm: Arm, joints: slice, base: Array, end: Array) -> ModuleJoints:
    """Describe consecutive joints of an arm, from a base to an end, (3,) each [m], world frame."""
    chain = arm.chain
    columns = chain.columns[joints]
    columns_once = np.array(list(dict.fromkeys(columns.tolist())))
    return joints_in_base_frame(
        names=chain.joints[joints],
        revolute=chain.revolute[joints],
        axes=chain.axes[joints],
        stations=chain.flattened(np.vstack([base, chain.origins[joints], end])),
        columns=columns,
        ratios=chain.ratios[joints],
        limits=np.array([arm.limits.lower[columns_once], arm.limits.upper[columns_once]]),
    )


def after_last_mover(chain: Chain, module: int, start: int) -> int:
    """Return the index after the last joint, from `start` on, that moves the end of a module.

    A joint whose axis passes through the end does not move it, unless another joint is coupled to it.
    """
    alone = np.bincount(chain.columns)[chain.columns] == 1
    stop = int(chain.module_slices[module].stop)
    while stop > start and chain.revolute[stop - 1] and alone[stop - 1]:
        lever = chain.points[module] - chain.origins[stop - 1]
        if np.linalg.norm(np.cross(chain.axes[stop - 1], lever)) > ROUNDING * chain.length:
            break
        stop -= 1
    return stop


def _groups_of(arm: Arm, module: int, joints: slice, base: Array, end: Array) -> list[JointGroup]:
    try:
        return _closed_forms(arm, module, joints, base, end)
    except UnsupportedModule as error:
        reason = error.reason
    described = module_joints(arm, joints, base, end)
    first = int(arm.chain.input_numbers[joints.start])
    columns = arm.columns[first : first + described.dof]
    kinematics = NumericModule(described, arm.positions(arm.straight())[columns])
    return [JointGroup(module, joints, first, described.base, described.frame, kinematics, reason)]


def _closed_forms(arm: Arm, module: int, joints: slice, start: Array, end: Array) -> list[JointGroup]:
    """Return the groups with closed forms that place the end of a module.

    Raises:
        UnsupportedModule: there are none; gives the reason.
    """
    chain = arm.chain
    axes = chain.axes[joints]
    origins = chain.origins[joints]
    stations = np.vstack([start, origins[1:], end])
    links = np.diff(stations, axis=0)
    lengths = np.linalg.norm(links, axis=1)

    def refuse(reason: str) -> UnsupportedModule:
        return UnsupportedModule(module + 1, chain.joints[joints], reason)

    if len(set(chain.columns[joints].tolist())) < len(axes):
        raise refuse("it has coupled joints")
    if not np.all(chain.revolute[joints]):
        raise refuse("it has a sliding joint")
    none = lengths <= ROUNDING * lengths.max()
    universal = len(axes) == 2 and none[0] and not none[1]
    if np.any(none) and not universal:
        raise refuse("it has a link without length")
    along = links[-1] / lengths[-1]
    if np.abs(links[~none] / lengths[~none, None] - along).max() > ROUNDING:
        raise refuse("it is not straight at its neutral configuration")
    if np.linalg.norm(np.cross(origins[0] - start, axes[0])) > ROUNDING * lengths.sum():
        raise refuse("its first joint does not sit at its base")

    def group(first: int, last: int, base: Array, frame: Array, form: ClosedForm) -> JointGroup:
        placed_joints = slice(joints.start + first, joints.start + last)
        column = int(chain.input_numbers[placed_joints.start])
        return JointGroup(module, placed_joints, column, base, frame, form)

    first_link = 0.0 if universal else float(lengths[0])
    perpendicular = len(axes) == 2 and abs(axes[0] @ axes[1]) < ROUNDING
    rolls = float(np.linalg.norm(np.cross(axes[0], along))) < ROUNDING
    if perpendicular and rolls:
        form = RollPitch(first_link, float(lengths[1]), sense=float(np.sign(along @ axes[0])))
        return [group(0, 2, start, _frame(along, axes[1]), form)]
    if np.abs(axes @ along).max() > ROUNDING:
        raise refuse("it has a joint axis that is neither along nor across it")
    parallel = np.linalg.norm(np.cross(axes, axes[0]), axis=1) < ROUNDING
    if np.all(parallel) and not universal:
        return [
            group(i, i + 1, stations[i], _frame(along, axes[i]), Circle(float(lengths[i])))
            for i in range(len(axes))
        ]
    if perpendicular:
        frame = _frame(along, axes[0])
        torus = Torus(first_link, float(lengths[1]), sense=float(np.sign(frame[:, 2] @ axes[1])))
        return [group(0, 2, start, frame, torus)]
    raise refuse("its joint axes are neither parallel nor a perpendicular pair")


def _frame(x: Array, y: Array) -> Array:
    return np.column_stack([x, y, np.cross(x, y)])


@dataclass(frozen=True)
class ConstantCurvature:
    """FK, IK and TP of an arc, in the frame at its base (x along the straight section).

    Joint positions are the bending about y and about z [rad] and, if the section can stretch, its elongation
    [m]. The end turns by the rotation vector (0, q0, q1). The IK is limited to bends below a full turn.

    Attributes:
        length: length of the section [m].
        stretch: largest change of length in either direction [m]; 0 if it cannot stretch.

    Raises:
        InvalidValue: the length is not positive, or the stretch is negative or not below the length.
    """

    length: float
    stretch: float = 0.0

    def __post_init__(self) -> None:
        require_positive("length", self.length)
        require_positive("stretch", self.stretch, zero=True)
        if not self.stretch < self.length:
            raise InvalidValue("stretch", self.stretch, f"less than the length of {self.length:g} m")

    @property
    def dof(self) -> int:
        """Number of degrees of freedom: 2, or 3 if it can stretch."""
        return 3 if self.stretch else 2

    @property
    def reach(self) -> float:
        """Largest distance of the end from the base [m]."""
        return self.length + self.stretch

    def forward(self, q: Array) -> tuple[Array, Array]:
        """FK: position (3,) [m] and orientation (3, 3) of the end at q, (2,) or (3,), base frame."""
        bend_y = float(q[0])
        bend_z = float(q[1])
        length = self.length + (float(q[2]) if self.stretch else 0.0)
        bend = np.hypot(bend_y, bend_z)
        along = np.sinc(bend / np.pi)  # sin(bend) / bend
        across = 0.5 * np.sinc(0.5 * bend / np.pi) ** 2  # (1 - cos(bend)) / bend^2
        end = length * np.array([along, across * bend_z, -across * bend_y])
        return end, np.asarray(pin.exp3(np.array([0.0, bend_y, bend_z])))

    def inverse(self, p: Array) -> list[Array]:
        """IK: the positions that put the end at p, (3,) [m], base frame; empty if there are none.

        The angle between the chord and x is half the bending angle.
        """
        x, y, z = map(float, p)
        across = np.hypot(y, z)
        half = float(np.arctan2(np.hypot(y, z), x))
        length = float(self._lengths(np.array([[x, y, z]]))[0])
        slack = max(self.stretch, 0.0) + 1e-7 * self.length  # so far off the surface that the end reaches
        if not abs(length - self.length) <= slack or half >= np.pi:
            return []
        direction = np.array([-z, y]) / across if across > 0.0 else np.zeros(2)
        bends = 2.0 * half * direction
        if not self.stretch:
            return [bends]
        return [np.append(bends, np.clip(length - self.length, -self.stretch, self.stretch))]

    def target_point(self, base: pin.SE3, curve: Curve, start: float) -> float | None:
        """TP, as `ModuleKinematics.target_point`, with the least stretch; prefers bends up to half a turn."""
        crossings = curve_crossings(curve, base, start, self._level, self.reach)
        first = first_facing(crossings, lambda p: bool(p[0] >= 0.0))
        if first is not None or not self.stretch:
            return first
        ahead = np.linspace(start + CONVERGED * self.reach, start + self.reach * np.pi, 400)
        ahead = ahead[ahead < curve.length] if start < curve.length else ahead[:0]
        ahead = np.append(ahead, curve.length) if start < curve.length else ahead
        points = (np.asarray(curve.at(ahead)).reshape(-1, 3) - base.translation) @ base.rotation
        needed = np.abs(self._lengths(points) - self.length)
        if not len(ahead) or not needed.min() <= self.stretch:
            return None
        return float(ahead[np.argmin(needed)])

    def _lengths(self, p: Array) -> Array:
        """Return the lengths of the arcs that leave the base along x and end at points (n, 3), (n,) [m]."""
        half = np.arctan2(np.hypot(p[:, 1], p[:, 2]), p[:, 0])
        return np.asarray(np.linalg.norm(p, axis=1) / np.maximum(np.sinc(half / np.pi), 1e-300))

    def _level(self, p: Array) -> Array:
        half = np.arctan2(np.hypot(p[:, 1], p[:, 2]), p[:, 0])
        return np.asarray(np.linalg.norm(p, axis=1) - self.length * np.sinc(half / np.pi))
