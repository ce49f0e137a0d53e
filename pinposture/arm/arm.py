"""The arm: a Pinocchio model with control points at its module boundaries."""

from __future__ import annotations

import threading
import warnings
from collections.abc import Iterable, Mapping, Sequence
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture.arm.adequacy import Adequacy, CurveShape, adequacy
from pinposture.arm.chain import Chain, frame_id, read_chain
from pinposture.arm.configurations import ConfigurationSpace
from pinposture.arm.loading import Modules, load_model, place_base
from pinposture.arm.report import LoadReport
from pinposture.arm.segmentation import Segmentation
from pinposture.arm.state import ArmState, ControlFrames, sweep
from pinposture.arm.stretch import farthest_stretch
from pinposture.arm.template import ModuleTemplate, template
from pinposture.arm.urdf import modules_to_urdf
from pinposture.errors import InvalidValue, PostureWarning

Array = NDArray[np.float64]


class _Scratch(threading.local):
    """One `pin.Data` per thread: Pinocchio writes into it during every computation."""

    def __init__(self, model: pin.Model) -> None:
        self.data = model.createData()


class Arm(ConfigurationSpace):
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
        segmentation: how its joints are grouped into modules, and why.
        own_joints: 1 where a degree of freedom belongs to a module, else 0, (m, nv).
        frames: the control points as Pinocchio sees them.
        sliding_unit: the slide that weighs as much as a turn of one radian, where both are compared [m]: the
            mean module length, unless told otherwise by `with_sliding_unit`.
        joint_units: the motion of each joint that counts as one, (nv,): one radian, or `sliding_unit` metres.
    """

    def __init__(
        self,
        model: pin.Model,
        control_points: Sequence[str],
        base_placement: pin.SE3 | None = None,
        urdf: str | None = None,
        report: LoadReport | None = None,
        sliding_unit: float | None = None,
    ) -> None:
        super().__init__(model)
        self.control_points = tuple(control_points)
        self.base_placement = pin.SE3.Identity() if base_placement is None else base_placement
        self.urdf, self.report = urdf, report
        frames = [model.frames[frame_id(model, name)] for name in self.control_points]
        if not frames:
            raise InvalidValue("control_points", list(control_points), "at least one frame name")
        self._scratch = _Scratch(model)
        self.chain: Chain = read_chain(model, self._scratch.data, self.control_points)
        sizes = tuple(joints.stop - joints.start for joints in self.chain.module_slices)
        self.segmentation = report.segmentation if report else Segmentation(sizes, "control points as given")
        self.own_joints = np.zeros((len(frames), model.nv))
        for own, joints in zip(self.own_joints, self.chain.module_slices, strict=True):
            own[self.chain.columns[joints]] = 1.0
        self.own_joints.flags.writeable = False
        self.frames = ControlFrames(
            parents=tuple(int(frame.parentJoint) for frame in frames),
            offsets=np.array([frame.placement.translation for frame in frames]),
            turns=np.array([frame.placement.rotation for frame in frames]),
            support=np.cumsum(self.own_joints, axis=0)[:, None, :],
        )
        self.sliding_unit = float(self.chain.module_lengths.mean()) if sliding_unit is None else sliding_unit
        self.joint_units = np.where(self.slides, self.sliding_unit, 1.0)
        self.joint_units.flags.writeable = False

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was settled while loading in a way that the user may not expect."""
        return self.report.warnings if self.report else ()

    @property
    def package_dirs(self) -> tuple[str, ...]:
        """Folders in which viewers look for meshes."""
        return self.report.package_dirs if self.report else ()

    @classmethod
    def from_template(
        cls,
        name: str,
        modules: int,
        link_lengths: Sequence[float] | None = None,
        base_placement: pin.SE3 | None = None,
    ) -> Arm:
        """Build an arm of equal modules from a shipped template.

        Args:
            name: template name, for instance "RyRz".
            modules: number of modules, at least 1.
            link_lengths: length of the link after each joint of the module [m]; the template's own if None.
            base_placement: where the base stands in the world; the origin if None.

        Returns:
            The arm, stretched along x at its neutral configuration.

        Raises:
            UnknownName: no such template.
            InvalidValue: a number of modules or link lengths that make no arm.
        """
        if isinstance(modules, bool) or not isinstance(modules, int) or modules < 1:
            raise InvalidValue("modules", modules, "a whole number of at least 1")
        module = template(name)
        if link_lengths is not None:
            module = module.with_lengths(link_lengths)
        return cls.from_modules([module] * modules, base_placement=base_placement, name=f"{name}_{modules}")

    @classmethod
    def from_modules(
        cls,
        modules: Iterable[ModuleTemplate],
        base_placement: pin.SE3 | None = None,
        name: str = "arm",
    ) -> Arm:
        """Build an arm by chaining module templates from base to tip; they may differ.

        Args:
            modules: the templates in order.
            base_placement: where the base stands in the world; the origin if None.
            name: robot name written into the URDF.

        Returns:
            The arm, stretched along x at its neutral configuration.
        """
        listed = list(modules)
        text = modules_to_urdf(listed, name)
        return cls.from_urdf(text, modules=[len(m.joints) for m in listed], base_placement=base_placement)

    @classmethod
    def from_urdf(
        cls,
        source: str | Path,
        base: str | None = None,
        tip: str | None = None,
        modules: Modules = None,
        locked: Mapping[str, float] | None = None,
        package_dirs: Sequence[str | Path] | None = None,
        base_placement: pin.SE3 | None = None,
    ) -> Arm:
        """Load an arm from a URDF file or from URDF text; meshes are not needed.

        Args:
            source: path of the file, or the XML text itself.
            base: link at which the arm begins; the root if None.
            tip: link at which it ends; if None, the last of the links in `modules`, or the end of the longest
                moving chain (`pinposture.arm.default_tip`).
            modules: joints per module: one number for all, or one for each module; or names of the links at
                whose origins modules end. If None, the smallest modules that can follow any curve
                (`pinposture.arm.segmentation`).
            locked: joints to hold still and their positions [rad or m]. Joints off the chain are locked
                anyway, where the joint that they mimic puts them or at the position nearest zero within their
                limits.
            package_dirs: folders in which viewers look for meshes; loading needs none.
            base_placement: where the root link stands in the world; the origin if None.

        Returns:
            The arm, with control points named "module_01", "module_02", ... at the ends of its modules. What
            was settled in a way that may surprise is in `warnings`, and each is a `PostureWarning`.

        Raises:
            FileError: the file is missing or unreadable.
            URDFError: the description cannot be used; names the link or joint and the reason.
            UnknownName: `base`, `tip` or a locked joint does not exist.
            InvalidValue: `modules` does not fit the chain, or a value that is none.
        """
        placement = pin.SE3.Identity() if base_placement is None else pin.SE3(base_placement)
        loaded = load_model(source, base, tip, modules, dict(locked or {}), placement, package_dirs)
        for message in loaded.report.warnings:
            warnings.warn(message, PostureWarning, stacklevel=2)
        return cls(loaded.model, loaded.control_points, placement, loaded.text, loaded.report)

    @classmethod
    def from_model(
        cls, model: pin.Model, control_points: Sequence[str], base_placement: pin.SE3 | None = None
    ) -> Arm:
        """Use a Pinocchio model that exists already; it is copied and never written to.

        Args:
            model: the model; each joint on the chain has one degree of freedom.
            control_points: names of existing frames from base to tip, the ends of the modules.
            base_placement: moves the whole model in the world; not at all if None.

        Returns:
            The arm. Joints that move none of the control points stay in `q` and are never moved.

        Raises:
            UnknownName: a frame that does not exist.
            InvalidValue: frames that are not in order along one chain.
        """
        own = pin.Model(model)
        placement = pin.SE3.Identity() if base_placement is None else pin.SE3(base_placement)
        place_base(own, placement)
        return cls(own, control_points, placement)

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

    def adequate(self, curve: CurveShape) -> Adequacy:
        """Tell whether the modules can follow a curve within their joint limits (Section 4.1).

        Args:
            curve: the curve to follow.

        Returns:
            The largest curvature and torsion that the modules can follow, and the stretches of the curve
            that exceed them; truthy if there are none.
        """
        return adequacy(self.chain, self.limits.lower, self.limits.upper, curve)

    def straight(self) -> Array:
        """The configuration that stretches the arm farthest, (nq,); the neutral one for our templates."""
        return self.configuration(farthest_stretch(self))

    @cached_property
    def slides(self) -> NDArray[np.bool_]:
        """True for a degree of freedom of the chain that slides, (nv,)."""
        slides = np.zeros(self.nv, dtype=np.bool_)
        slides[self.columns[~self.chain.revolute]] = True
        return slides

    def random(self, rng: np.random.Generator) -> Array:
        """A configuration drawn uniformly within the limits, (nq,).

        Where there is none, within +-pi, or within the arm's length either way if the joint slides.
        """
        free = np.where(self.slides, self.length, np.pi)
        lower = np.where(np.isfinite(self.limits.lower), self.limits.lower, -free)
        upper = np.where(np.isfinite(self.limits.upper), self.limits.upper, free)
        return self.configuration(rng.uniform(lower, upper))

    def within_limits(self, q: ArrayLike, tolerance: float = 1e-9) -> bool:
        """True if no joint of q is outside its limits by more than the tolerance, in `joint_units`."""
        positions, slack = self.positions(q), tolerance * self.joint_units
        low, high = self.limits.lower - slack, self.limits.upper + slack
        return bool(np.all((positions >= low) & (positions <= high)))

    def at(self, q: ArrayLike) -> ArmState:
        """The state of the arm at a configuration; Pinocchio is read once.

        Args:
            q: configuration, (nq,).

        Returns:
            Placements and Jacobians of all control points, world frame.

        Raises:
            InvalidValue: q has the wrong size or is not finite.
        """
        return sweep(self, self._scratch.data, self.checked(q))

    def with_sliding_unit(self, sliding_unit: float) -> Arm:
        """The same arm, with another slide that weighs as much as a turn of one radian [m].

        Manipulability conditions, the smallest joint motions that controllers look for, and singular values
        compare motions of all joints; for slides and turns there is no natural scale between them.

        Raises:
            InvalidValue: not a finite length above 0.
        """
        if not (np.isfinite(sliding_unit) and sliding_unit > 0.0):
            raise InvalidValue("sliding_unit", sliding_unit, "a finite length above 0 [m]")
        return Arm(
            self.model, self.control_points, self.base_placement, self.urdf, self.report, float(sliding_unit)
        )

    def to_dict(self) -> dict[str, Any]:
        """What is needed to build this arm again, as data that JSON can hold."""
        described: dict[str, Any] = {"control_points": list(self.control_points)}
        described["base_placement"] = np.asarray(self.base_placement.homogeneous).tolist()
        described["urdf"] = self.urdf
        described["report"] = self.report.to_dict() if self.report else None
        described["sliding_unit"] = self.sliding_unit
        described["model"] = self.model.saveToString()
        return described

    @classmethod
    def from_dict(cls, described: Mapping[str, Any]) -> Arm:
        """Build the arm that `to_dict` described."""
        model = pin.Model()
        model.loadFromString(described["model"])
        placement = pin.SE3(np.array(described["base_placement"]))
        report = LoadReport.from_dict(described["report"]) if described.get("report") else None
        points, urdf, unit = (described[key] for key in ("control_points", "urdf", "sliding_unit"))
        return cls(model, points, placement, urdf, report, unit)

    def __reduce__(self) -> tuple[Any, ...]:
        parts = (self.model, self.control_points, self.base_placement, self.urdf, self.report)
        return Arm, (*parts, self.sliding_unit)

    def __repr__(self) -> str:
        kind = "planar" if self.dimension == 2 else "spatial"
        return (
            f"Arm({self.model.name!r}, {kind}, {self.n_modules} modules, {self.nv} DOF, {self.length:.4g} m)"
        )
