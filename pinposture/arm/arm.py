"""The arm: a Pinocchio model with control points at its module boundaries."""

from __future__ import annotations

from collections.abc import Sequence
from functools import cached_property
from numbers import Real
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import finite_vector
from pinposture.arm.chain import Chain, frame_ids, read_chain
from pinposture.arm.configurations import carry_base, check_joint_positions, full_reach, without_limits
from pinposture.arm.feasibility import CurveShape, Feasibility, adequacy
from pinposture.arm.kinematics import MOST_IN_DATA, FrameReader, Kinematics
from pinposture.arm.loading import LoadReport
from pinposture.arm.segmentation import Segmentation
from pinposture.arm.specification import ArmSpec, Blueprint
from pinposture.arm.state import ArmState
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

ROUNDING = 1e-9
"""Share of a turn that is none."""


class Arm(Blueprint):
    """A serial arm with posture control points at its module boundaries.

    Make one with `from_template`, `from_modules`, `from_urdf` or `from_model`. An arm is immutable and
    pickles; it may be shared between threads. Configurations are Pinocchio's: `q` has `nq` entries and
    moves only by `integrate`, because a continuous joint takes two of them.

    Attributes:
        model: the arm's own `pin.Model`, base placement included. Do not change it.
        control_points: names of the control points from base to tip, (m,).
        base_placement: where the base link stands in the world.
        chain: the kinematic chain at the neutral configuration.
        urdf: the description it was loaded from, or None.
        report: what was decided while it was loaded (base, tip, warnings, ...); None if it was not.
        spec: what it was made from; None if that was a Pinocchio model.
        segmentation: how its joints are grouped into modules, and why.
        kinematics: the chain as kernels see it.
        frames: reads the control points from Pinocchio; None if the arm is too long for that.
        moved: 1 where a degree of freedom belongs to the chain, else 0, (nv,).
        characteristic_length: the slide that weighs as much as a turn of one radian, where both are compared
            [m]: the mean module length, unless told otherwise by `with_characteristic_length`.
        joint_units: the motion of each joint that counts as one, (nv,): one radian, or
            `characteristic_length` metres.
        cache: what other packages derive from the arm and remember as long as it lives, such as its collision
            models, by class or function; neither copied nor pickled.
    """

    def __init__(
        self,
        model: pin.Model,
        control_points: Sequence[str],
        base_placement: pin.SE3 | None = None,
        urdf: str | None = None,
        report: LoadReport | None = None,
        characteristic_length: float | None = None,
        spec: ArmSpec | None = None,
    ) -> None:
        super().__init__(model, control_points, base_placement, urdf, report, characteristic_length, spec)
        self.cache: dict[object, Any] = {}
        if not self.control_points:
            raise InvalidValue("control_points", list(control_points), "at least one frame name")
        self.chain: Chain = read_chain(model, self.control_points)
        sizes = tuple(joints.stop - joints.start for joints in self.chain.module_slices)
        self.segmentation = report.segmentation if report else Segmentation(sizes, "control points as given")
        frames = frame_ids(model, self.control_points)
        self.kinematics = Kinematics(model, self.chain.joints, frames)
        self.frames = FrameReader(model, frames) if self.nv <= MOST_IN_DATA else None
        self.moved = np.zeros(self.nv)
        self.moved[self.chain.columns] = 1.0
        self.moved.flags.writeable = False
        if characteristic_length is None:
            self.characteristic_length = float(self.chain.module_lengths.mean())
        self.joint_units = np.where(self.slides, self.characteristic_length, 1.0)
        self.joint_units.flags.writeable = False

    @property
    def n_modules(self) -> int:
        """Number of modules m, which is the number of control points."""
        return len(self.control_points)

    @property
    def columns(self) -> NDArray[np.intp]:
        """Index in the tangent space of each joint of the chain, from base to tip, (n,)."""
        return self.chain.columns

    @property
    def module_starts(self) -> NDArray[np.intp]:
        """Index into the chain of the first joint of each module, (m,)."""
        return self.chain.module_starts

    @property
    def module_joints(self) -> tuple[tuple[str, ...], ...]:
        """Names of the joints of each module, from base to tip."""
        return tuple(self.chain.joints[joints] for joints in self.chain.module_slices)

    @cached_property
    def support(self) -> Array:
        """1 where a degree of freedom moves a control point, else 0, (m, nv)."""
        support = np.zeros((self.n_modules, self.nv))
        for row, end in zip(support, self.kinematics.ends, strict=True):
            row[self.columns[:end]] = 1.0
        support.flags.writeable = False
        return support

    @cached_property
    def plane(self) -> Array:
        """Orthonormal basis of the directions in which the arm can move, (2, 3) or (3, 3), world frame."""
        return self.chain.plane

    @property
    def dimension(self) -> int:
        """2 if every joint axis is parallel (a planar arm), else 3."""
        return len(self.plane)

    @cached_property
    def length(self) -> float:
        """Length from the first joint to the tip, along the arm [m]."""
        return self.chain.length

    def can_follow(self, curve: CurveShape) -> Feasibility:
        """Tell whether the modules can follow a curve within their joint limits (Section 4.1).

        Args:
            curve: the curve to follow.

        Returns:
            The largest curvature and torsion that the modules can follow, and the stretches of the curve
            that exceed them; truthy if there are none.
        """
        return adequacy(self.chain, self.limits.lower, self.limits.upper, curve)

    def straight(self) -> Array:
        """The configuration that stretches the arm farthest, (nq,); the neutral one for our templates.

        A base that slides without real limits (`roaming`) stays at zero.
        """
        return self.configuration(self._stretched)

    @cached_property
    def _stretched(self) -> Array:
        return full_reach(self)

    @cached_property
    def slides(self) -> NDArray[np.bool_]:
        """True for a degree of freedom of the chain that slides, (nv,)."""
        slides = np.zeros(self.nv, dtype=np.bool_)
        slides[self.columns[~self.chain.revolute]] = True
        return slides

    def checked_start(self, q: ArrayLike, name: str = "q") -> Array:
        """A configuration that somebody gave to start from, or to go to; see `checked`.

        A `PostureWarning` tells of joints outside of their limits.

        Args:
            q: configuration, (nq,).
            name: what to call it in the error.

        Returns:
            Copy of q, (nq,).

        Raises:
            InvalidValue: as `checked`; or joints are so far outside that degrees may have been meant.
        """
        checked = self.checked(q, name)
        self.check_positions(self.difference(self.origin, checked), name)
        return checked

    def check_positions(self, positions: ArrayLike, name: str = "positions") -> None:
        """Look whether joint positions (nv,) [rad or m] are within the limits, as `checked_start` does.

        Raises:
            InvalidValue: not (nv,) finite numbers, or so far outside that degrees may have been meant.
        """
        given = finite_vector(name, positions, self.nv)
        check_joint_positions(name, given, self.limits, self.slides, self.joint_names)

    @cached_property
    def unlimited(self) -> NDArray[np.bool_]:
        """True for a degree of freedom without real limits, (nv,): none, or so wide that they mean none.

        They leave it more than 100 arm lengths to slide, or more than 100 rad to turn. Limits that it has are
        kept all the same; it only is not sent out to them.
        """
        unlimited = without_limits(self.limits.lower, self.limits.upper, self.slides, self.length)
        unlimited.flags.writeable = False
        return unlimited

    @cached_property
    def roaming(self) -> NDArray[np.bool_]:
        """True for the slides without real limits on which the base stands, (nv,), as of a mobile robot.

        They come before the first joint that turns. The straight arm has them at zero, and they stay where
        they are when the arm takes the shape of a curve that begins at its base.
        """
        roaming = np.zeros(self.nv, dtype=np.bool_)
        roaming[self.columns] = carry_base(self.unlimited[self.columns], self.chain.revolute)
        roaming.flags.writeable = False
        return roaming

    @cached_property
    def usual_positions(self) -> tuple[Array, Array]:
        """Smallest and largest joint positions to draw from or to search, (nv,) each [rad or m].

        The limits; where those are none (`unlimited`), a half turn either way of the position nearest zero,
        or as far as the arm is long if the joint slides, cut at the limits that there are.
        """
        lower, upper = self.limits.lower, self.limits.upper
        middle, far = np.clip(0.0, lower, upper), np.where(self.slides, self.length, np.pi)
        low = np.where(self.unlimited, np.maximum(lower, middle - far), lower)
        high = np.where(self.unlimited, np.minimum(upper, middle + far), upper)
        low.flags.writeable = high.flags.writeable = False
        return low, high

    def random(self, rng: np.random.Generator) -> Array:
        """A configuration drawn uniformly from `usual_positions`, (nq,): within limits and within reach."""
        return self.configuration(rng.uniform(*self.usual_positions))

    def within_limits(self, q: ArrayLike, tolerance: float = 1e-9) -> bool:
        """True if no joint of q is outside its limits by more than the tolerance, in `joint_units`."""
        positions, slack = self.positions(q), tolerance * self.joint_units
        low, high = self.limits.lower - slack, self.limits.upper + slack
        return bool(np.all((positions >= low) & (positions <= high)))

    def at(self, q: ArrayLike) -> ArmState:
        """The state of the arm at a configuration.

        Args:
            q: configuration, (nq,).

        Returns:
            Placements of all control points, world frame; whatever else it knows is worked out when it is
            first asked for.

        Raises:
            InvalidValue: q has the wrong size or is not finite.
        """
        checked = self.checked(q)
        return ArmState(self, checked)

    @cached_property
    def _winding(self) -> NDArray[np.bool_]:
        """Degrees of freedom that can be more than a turn away from where the posture is the same, (nv,)."""
        room = self.limits.upper - self.limits.lower > 2.0 * np.pi
        return np.asarray(room & (self.moved > 0.0) & ~self.slides & ~self.kinematics.endless)

    def nearest_turns(
        self, q: ArrayLike, near: ArrayLike | None = None, edges: ArrayLike | None = None
    ) -> Array:
        """The same posture, with every joint within half a turn of where it is to be near.

        Joints that turn take the same place again after each turn. Where limits forbid the turn that is
        nearest, the nearest that they allow is taken.

        Args:
            q: configuration, (nq,).
            near: configuration to be near, (nq,); the straight one if None.
            edges: joint positions to stay between, (2, nv) [rad or m]; the limits of the arm if None.

        Returns:
            Configuration (nq,).

        Raises:
            InvalidValue: a configuration has the wrong size or is not finite.
        """
        checked, which = self.checked(q), self._winding
        if not np.any(which):
            return checked
        positions, turn = self.positions(checked), 2.0 * np.pi
        preferred = self._stretched if near is None else self.positions(self.checked(near, "near"))
        lower, upper = (self.limits.lower, self.limits.upper) if edges is None else np.asarray(edges)
        away = (preferred - positions) / turn
        turns = np.sign(away) * np.ceil(np.abs(away) - 0.5 - ROUNDING)
        least = np.ceil((lower - positions) / turn - ROUNDING)
        most = np.floor((upper - positions) / turn + ROUNDING)
        turns = np.where(which & (least <= most), np.maximum(np.minimum(turns, most), least), 0.0)
        if not np.any(turns):
            return checked
        return self.integrate(
            checked, np.where(turns == 0.0, 0.0, np.clip(positions + turn * turns, lower, upper) - positions)
        )

    def with_characteristic_length(self, characteristic_length: float) -> Arm:
        """The same arm, with another slide that weighs as much as a turn of one radian [m].

        Manipulability conditions, the smallest joint motions that controllers look for, and singular values
        compare motions of all joints; for slides and turns there is no natural scale between them.

        Raises:
            InvalidValue: not a finite length above 0.
        """
        if not (
            isinstance(characteristic_length, Real)
            and np.isfinite(characteristic_length)
            and characteristic_length > 0.0
        ):
            raise InvalidValue("characteristic_length", characteristic_length, "a finite length above 0 [m]")
        unit = float(characteristic_length)
        spec = None if self.spec is None else self.spec.model_copy(update={"characteristic_length": unit})
        parts = (self.model, self.control_points, self.base_placement, self.urdf, self.report)
        return Arm(*parts, unit, spec)

    def __reduce__(self) -> tuple[Any, ...]:
        parts = (self.model, self.control_points, self.base_placement, self.urdf, self.report)
        return Arm, (*parts, self.characteristic_length, self.spec)

    def __repr__(self) -> str:
        kind = "planar" if self.dimension == 2 else "spatial"
        return (
            f"Arm({self.model.name!r}, {kind}, {self.n_modules} modules, {self.nv} DOF, {self.length:.4g} m)"
        )
