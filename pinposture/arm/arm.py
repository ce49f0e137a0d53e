"""The arm, a Pinocchio model with control points at its module boundaries, and its states."""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterable, Mapping, Sequence
from dataclasses import asdict, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar, cast

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import minimize
from typing_extensions import Self, override

from pinposture import kernels
from pinposture._validation import (
    as_floats,
    as_generator,
    as_number,
    entries_beyond,
    finite_array,
    finite_vector,
    require_instance,
    require_known,
    require_whole,
    rigid_placement,
)
from pinposture.arm.configurations import (
    MOST_MOVING,
    NO_LIMIT,
    ConfigurationSpace,
    check_joint_positions,
    plausible_positions,
)
from pinposture.arm.couplings import Coupling, Drive, DrivenJoints, joint_axes, read_couplings
from pinposture.arm.dynamics import Dynamics, curvature, settle, spring_root, weakest_joint
from pinposture.arm.feasibility import Feasibility, check_feasibility
from pinposture.arm.kinematics import (
    MAX_PINOCCHIO_DOF,
    Chain,
    ForwardKinematics,
    FrameReader,
    Frames,
    Kinematics,
    find_base_slides,
    find_unlimited,
    frame_ids,
    read_chain,
)
from pinposture.arm.loading import (
    LoadedModel,
    LoadReport,
    load_model,
    place_base,
)
from pinposture.arm.manipulability import (
    ControlPoints,
    Ellipsoid,
    chosen_points,
    section_bases,
    section_ellipsoid,
)
from pinposture.arm.segmentation import Segmentation
from pinposture.arm.serialization import ModelData
from pinposture.arm.specification import ArmSpec, PoseSpec
from pinposture.arm.template import ModuleTemplate, modules_to_urdf, template
from pinposture.arm.urdf import is_urdf_text
from pinposture.arm.weight import (
    NOTHING,
    REMEDY,
    Added,
    Cable,
    HeldOut,
    JointLoad,
    Load,
    Weight,
    added_masses,
    check_masses,
    effort_limits,
    heaviest_load,
    largest_payload,
    links_without_mass,
    load_of,
    parts_without_mass,
    stiffness_matrix,
    weighted_model,
)
from pinposture.curve import Curve
from pinposture.errors import (
    InvalidValue,
    NoEquilibrium,
    PostureError,
    WeightUnknown,
    enumerated,
    warn_caller,
)
from pinposture.kernels.arrays import FULL_TURN, Screws
from pinposture.schema import as_plain, read_plain
from pinposture.storage import settled
from pinposture.units import CONVERGED, ROUNDING, length_text

Array = NDArray[np.float64]
Kept = TypeVar("Kept")

MAX_KEPT = 16
"""Most values of a kind that an arm keeps in its cache, such as collision models: those made last."""


class Arm(ConfigurationSpace):
    """A serial arm with posture control points at its module boundaries.

    Build one with `from_template`, `from_modules`, `load` or `from_model`. An arm is immutable, can be
    pickled and can be shared between threads. Configurations are Pinocchio's: `q` has `nq` entries, two for
    each continuous joint, and must be changed with `integrate`.

    Attributes:
        model: the arm's own `pin.Model`, base placement included. Do not modify it.
        control_points: names of the control points from base to tip, (m,).
        base_placement: placement of the base link in the world.
        chain: the kinematic chain at the neutral configuration.
        urdf: the description it was loaded from, or None.
        report: decisions made while loading (base, tip, warnings, ...); None if the arm was not loaded.
        spec: the specification it was built from; None if it was built from a Pinocchio model.
        segmentation: how its joints are grouped into modules, and why.
        kinematics: the chain as arrays for kernels.
        frames: reads the control points from Pinocchio; None if the arm is too long for that.
        moved: 1 where a degree of freedom belongs to the chain, else 0, (nv,).
        effort: largest torque or force along each degree of freedom, (nv,) [N m or N]; infinite where it is
            not known. An effort of 0 in the description counts as unknown.
        characteristic_length: the sliding distance equivalent to one radian, where both are compared [m]:
            the mean module length, unless set by `with_characteristic_length`.
        joint_units: unit motion of each joint, (nv,): one radian, or `characteristic_length` metres.
        weight: what is known of its weight beyond the description: payloads, cables, torque limits, gravity.
        cache: data that other packages derive from the arm, such as its collision models, keyed by class or
            function; neither copied nor pickled.
    """

    def __init__(
        self,
        model: pin.Model,
        control_points: Sequence[str],
        base_placement: pin.SE3 | None = None,
        *,
        urdf: str | None = None,
        report: LoadReport | None = None,
        characteristic_length: float | None = None,
        spec: ArmSpec | None = None,
        weight: Weight = NOTHING,
    ) -> None:
        super().__init__(model)
        self.control_points = tuple(control_points)
        self.base_placement = pin.SE3.Identity() if base_placement is None else base_placement
        self.urdf = urdf
        self.report = report
        self.spec = spec
        self.cache: dict[object, Any] = {}
        if not self.control_points:
            raise InvalidValue("control_points", list(control_points), "at least one frame name")
        self.chain: Chain = read_chain(model, self.control_points)
        self.weight = weight
        self._described = model
        self.added: tuple[Added, ...] = added_masses(weight, model, self.chain, self.control_points, self.tip)
        self._masses_checked = False
        self._warned: set[str] = set()  # shared with arms that are derived from this one
        drives = report.drives if report else ()
        self.effort = _read_only(effort_limits(model, weight, drives))
        self._springs: Array | None = None
        if weight.stiffness is not None:
            self._springs = stiffness_matrix(model, weight.stiffness, drives, self.in_metres)
        self.model = model = weighted_model(model, weight, self.added)
        lower = self.limits.lower
        upper = self.limits.upper
        for u in np.flatnonzero(lower > upper):
            ends = float(lower[u]), float(upper[u])
            raise InvalidValue(f"limits of joint {self.joint_names[u]!r}", ends, "lower <= upper")
        sizes = tuple(joints.stop - joints.start for joints in self.chain.module_slices)
        self.segmentation = report.segmentation if report else Segmentation(sizes, "control points as given")
        if characteristic_length is None:
            characteristic_length = float(self.chain.module_lengths.mean())
        self.characteristic_length = characteristic_length
        self.joint_units = _read_only(np.where(self.slides, characteristic_length, 1.0))
        frames = frame_ids(model, self.control_points)
        self.kinematics = Kinematics(model, self.chain, frames, self.joint_units)
        self.frames = FrameReader(model, self.chain, frames) if self.nv <= MAX_PINOCCHIO_DOF else None
        moved = np.zeros(self.nv)
        moved[self.chain.columns] = 1.0
        self.moved = _read_only(moved)

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
            base_placement: placement of the base in the world; the origin if None.

        Returns:
            The arm, stretched along x at its neutral configuration.

        Raises:
            UnknownName: there is no such template.
            InvalidValue: invalid number of modules or link lengths, or a template in place of its name.
        """
        require_whole("modules", modules, 1, MOST_MOVING)
        if isinstance(name, ModuleTemplate):
            allowed = "the name of a shipped template; Arm.from_modules([template] * 8) takes your own"
            raise InvalidValue("name", name, allowed)
        module = template(name)
        lengths = None
        if link_lengths is not None:
            module = module.with_lengths(link_lengths)
            lengths = tuple(module.link_lengths)
        spec = ArmSpec(template=name, modules=modules, link_lengths=lengths)
        return cls._from_templates(spec, [module] * modules, base_placement)

    @classmethod
    def from_spec(cls, spec: ArmSpec) -> Arm:
        """Build an arm from a specification, which it keeps as `spec`.

        Args:
            spec: a template or a URDF, and how to build an arm from it.

        Raises:
            PostureError: as `from_template` and `load`, or if neither a template nor a URDF is given.
        """
        placement = None if spec.placement is None else spec.placement.build()
        if spec.urdf is None:
            return cls._from_templates(spec, spec.module_templates(), placement)
        return cls._from_loaded(load_model(spec.urdf, spec, spec.split, placement), spec)

    @classmethod
    def _from_templates(
        cls, spec: ArmSpec, modules: Sequence[ModuleTemplate], base_placement: pin.SE3 | None
    ) -> Arm:
        text = modules_to_urdf(modules, f"{spec.template}_{spec.modules}")
        sizes = tuple(len(module.joints) for module in modules)
        return cls._from_loaded(load_model(text, spec, sizes, base_placement), spec)

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
            base_placement: placement of the base in the world; the origin if None.
            name: robot name written into the URDF.

        Returns:
            The arm, stretched along x at its neutral configuration, where slides are at zero; `straight` has
            them extended.
        """
        require_instance("modules", modules, Iterable, "a sequence of ModuleTemplate")
        listed = list(modules)
        text = modules_to_urdf(listed, name)
        return cls.load(text, split=[len(m.joints) for m in listed], base_placement=base_placement)

    @classmethod
    def load(
        cls,
        source: str | Path | pin.Model,
        base: str | None = None,
        tip: str | None = None,
        split: int | str | Sequence[int] | Sequence[str] | None = None,
        *,
        locked: Mapping[str, float] | None = None,
        package_dirs: Sequence[str | Path] | None = None,
        base_placement: pin.SE3 | None = None,
        couplings: Mapping[str, str | Sequence[Any]] | None = None,
        xacro_args: Mapping[str, object] | None = None,
        hard_limits: bool = False,
    ) -> Arm:
        """Load an arm from a robot description; meshes are not needed.

            pp.Arm.load("arm.urdf")
            pp.Arm.load("ur10e_description", split=2)
            pp.Arm.load("arm.xml", base="torso", tip="hand")
            pp.Arm.load("arm.urdf.xacro", xacro_args={"pitch": 0.2})

        Args:
            source: URDF, xacro or MJCF, as text or file path; the name of a description in the package
                robot_descriptions, which fetches it; or a Pinocchio model whose joints have one degree of
                freedom. Models are converted to URDF, without shapes; MJCF by MuJoCo, with shapes
                (`pinposture.arm.mjcf`).
            base: first link of the arm; the root if None.
            tip: last link of the arm; if None, the last of the links in `split`, or the end of the longest
                moving chain (`pinposture.arm.description`).
            split: joints per module, one number for all or one for each module; or names of the links at
                whose origins modules end. If None, the smallest modules that can follow any curve
                (`pinposture.arm.segmentation`).
            locked: joints to lock and their positions [rad or m]. Joints off the chain are always locked:
                mimic joints where their leader puts them, others at the position nearest zero within limits.
            package_dirs: folders in which viewers look for meshes, and xacro for packages (`$(find ...)`).
            base_placement: placement of the root link in the world; the origin if None.
            couplings: joints that follow others, in addition to <mimic>: joint name to the name of its
                leader, or to the leader's name, a ratio, and an offset [rad or m].
            xacro_args: values of the arguments of a xacro source by name: text, numbers or truth values.
            hard_limits: whether to ignore the soft position limits of <safety_controller>, which otherwise
                narrow those of <limit>, because the controller of the robot stops there.

        Returns:
            The arm, with control points named "module_01", "module_02", ... at the ends of its modules.
            Possibly unexpected decisions are listed in `warnings` and issued as `PostureWarning`.

        Raises:
            FileError: the source is missing, unreadable, or cannot be converted.
            MujocoMissing: the source is MJCF, and MuJoCo is not installed.
            URDFError: unusable description, or more than 5,000 moving joints or 10,001 links; names the link
                or joint and the reason.
            UnknownName: `base`, `tip`, a locked joint or an argument of xacro does not exist.
            InvalidValue: `split` does not fit the chain, or another argument is invalid.
        """
        options: dict[str, Any] = {
            "base": base,
            "tip": tip,
            "split": split,
            "locked": locked,
            "package_dirs": package_dirs,
            "couplings": couplings,
            "xacro_args": xacro_args,
        }
        chosen = {name: value for name, value in options.items() if value is not None}
        chain = ArmSpec(**chosen, hard_limits=hard_limits)
        loaded = load_model(source, chain, chain.split, base_placement)
        # A name does not identify the text.
        if not isinstance(source, pin.Model) and not is_urdf_text(source) and Path(source).exists():
            folders = tuple(settled(folder) for folder in chain.package_dirs)
            spec = replace(chain, urdf=settled(source), package_dirs=folders)
        else:
            folders = tuple(settled(folder) for folder in loaded.report.package_dirs)
            spec = replace(chain, urdf=loaded.text, package_dirs=folders, xacro_args={})
        if isinstance(source, pin.Model) and source.gravity != loaded.model.gravity:
            spec = replace(spec, weight=Weight(gravity=tuple(source.gravity.linear.tolist())))
        return cls._from_loaded(loaded, spec)

    @classmethod
    def _from_loaded(cls, loaded: LoadedModel, spec: ArmSpec) -> Arm:
        for message in loaded.report.warnings:
            warn_caller(message)
        if loaded.base_placement is not None and spec.placement is None:
            spec = replace(spec, placement=PoseSpec.of(loaded.base_placement))
        return cls(
            loaded.model,
            loaded.control_points,
            loaded.base_placement,
            urdf=loaded.text,
            report=loaded.report,
            characteristic_length=spec.characteristic_length,
            spec=spec,
            weight=spec.weight or NOTHING,
        )

    @classmethod
    def from_model(
        cls,
        model: pin.Model,
        control_points: Sequence[str],
        base_placement: pin.SE3 | None = None,
    ) -> Arm:
        """Build an arm from a copy of an existing Pinocchio model.

        Args:
            model: the model; each joint on the chain has one degree of freedom.
            control_points: names of existing frames from base to tip, the ends of the modules.
            base_placement: moves the whole model in the world; not moved if None.

        Returns:
            The arm. Joints that move no control point keep their entries in `q` but are never moved.

        Raises:
            UnknownName: a frame does not exist.
            InvalidValue: the frames are not in order along one chain, or a lower limit is above the upper.
        """
        require_instance("model", model, pin.Model, "a pin.Model")
        rebuilt = ModelData.of(model).build()  # as it would be loaded
        placement = rigid_placement("base_placement", base_placement)
        place_base(rebuilt, placement)
        return cls(rebuilt, control_points, placement)

    def to_dict(self) -> dict[str, Any]:
        """Return JSON-compatible data from which `from_dict` rebuilds this arm."""
        described: dict[str, Any] = {"control_points": list(self.control_points)}
        described["base_placement"] = np.asarray(self.base_placement.homogeneous).tolist()
        described["urdf"] = self.urdf
        described["report"] = asdict(self.report) if self.report else None
        described["characteristic_length"] = self.characteristic_length
        if self.spec is not None:
            described["spec"] = as_plain(self.spec)
            if isinstance(self.spec.urdf, str):  # the text is under "urdf" already
                del described["spec"]["urdf"]
        if self.weight != NOTHING:
            described.get("spec", {}).pop("weight", None)
            described["weight"] = as_plain(self.weight)
        described["model"] = as_plain(ModelData.of(self._described))
        return described

    @classmethod
    def from_dict(cls, described: Mapping[str, Any]) -> Arm:
        """Rebuild an arm from the data of `to_dict`: the same to the last bit.

        Raises:
            PostureError: the data are damaged.
        """
        try:
            model = read_plain(ModelData, described["model"], "model", folder=".").build()
            placement = rigid_placement("base_placement", described["base_placement"])
            report = read_plain(LoadReport | None, described.get("report"), "report")
            urdf = described["urdf"]
            spec = described.get("spec")
            weight = read_plain(Weight, described.get("weight", {}), "weight", folder=".")
            if spec is not None:
                spec = ArmSpec(**({} if "template" in spec else {"urdf": urdf}) | spec)
                spec = replace(spec, weight=weight if "weight" in described else None)
            return cls(
                model,
                described["control_points"],
                placement,
                urdf=urdf,
                report=report,
                characteristic_length=described["characteristic_length"],
                spec=spec,
                weight=weight,
            )
        except PostureError:
            raise
        except Exception as error:  # damaged data can raise anything
            detail = f"what `Arm.to_dict` returns ({type(error).__name__}: {error})"
            raise InvalidValue("description of an arm", type(described).__name__, detail) from error

    @property
    def warnings(self) -> tuple[str, ...]:
        """Decisions made while loading that the user may not expect."""
        return self.report.warnings if self.report else ()

    @property
    def package_dirs(self) -> tuple[str, ...]:
        """Folders in which viewers look for meshes."""
        return self.report.package_dirs if self.report else ()

    @property
    def name(self) -> str:
        """Name of the robot."""
        return str(self.model.name)

    @property
    def base(self) -> str:
        """First link of the arm; for a Pinocchio model, the world."""
        return self.report.base if self.report else str(self.model.frames[0].name)

    @property
    def tip(self) -> str:
        """Last link of the arm; for a Pinocchio model, the frame of the last control point."""
        return self.report.tip if self.report else self.control_points[-1]

    @cached_property
    def n_modules(self) -> int:
        """Number of modules and of control points, m."""
        return len(self.control_points)

    @cached_property
    def couplings(self) -> tuple[Coupling, ...]:
        """Joints that follow others and have no degree of freedom of their own."""
        return read_couplings(self.model)

    @cached_property
    def drives(self) -> DrivenJoints:
        """The joints that the drives of the robot move, one for each degree of freedom, in this order.

        They differ from `joint_names` where the first of coupled joints on the chain, which stands for all of
        them, follows another joint in the description. They map positions, velocities and torques both ways.
        """
        behind = {drive.leader: drive for drive in self.report.drives} if self.report else {}
        joints = zip(self.joint_names, self.in_metres, strict=True)
        alone = [Drive(name, name, 1.0, 0.0, not slides) for name, slides in joints]
        return DrivenJoints(behind.get(drive.leader, drive) for drive in alone)

    @cached_property
    def columns(self) -> NDArray[np.intp]:
        """Tangent-space index of each degree of freedom of the chain, from base to tip, (n,)."""
        return self.chain.inputs

    @property
    def module_starts(self) -> NDArray[np.intp]:
        """Index into `columns` of the first degree of freedom of each module, (m,)."""
        return np.concatenate([[0], self.chain.input_ends[:-1]])

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
        return _read_only(support)

    @property
    def plane(self) -> Array:
        """Orthonormal basis of the directions in which the arm can move, (2, 3) or (3, 3), world frame."""
        return self.chain.plane

    @cached_property
    def dimension(self) -> int:
        """2 if every joint axis is parallel (a planar arm), else 3."""
        return len(self.chain.plane)

    @cached_property
    def length(self) -> float:
        """Length along the arm from the first joint to the tip [m]."""
        return self.chain.length

    def require_near(self, name: str, points: Array) -> None:
        """Raise InvalidValue for a point that is not finite, or farther away than any unit would explain.

        Args:
            name: name of the points in the message.
            points: one point or many, (..., 3) [m], world frame; allowed are 1e6 arm lengths from the base.
        """
        away = points - self.chain.base
        farthest = 1e6 * self.length  # farther is a mistake
        for where in entries_beyond(away, farthest)[:1]:
            allowed = f"finite numbers within {farthest:.4g} m of the base, 1e6 times the length of the arm"
            raise InvalidValue(f"{name}{where.tolist()}", float(points[tuple(where)]), allowed)

    def can_follow(self, curve: Curve) -> Feasibility:
        """Check whether the modules can follow a curve within their joint limits (Section 4.1).

        Returns:
            The largest curvature and torsion that the modules can follow, and the stretches of the curve
            that exceed them; truthy if there are none.
        """
        require_instance("curve", curve, Curve, "a Curve")
        return check_feasibility(self.chain, self.limits.lower, self.limits.upper, curve)

    def from_degrees(self, positions: ArrayLike) -> Array:
        """Convert joint positions in degrees to a configuration; slides are given in metres.

        Args:
            positions: one number per degree of freedom, (nv,) [deg or m].

        Returns:
            Configuration (nq,).

        Raises:
            InvalidValue: wrong size or not finite.
        """
        checked = finite_vector("positions", positions, self.nv)
        return self.configuration(np.where(self.in_metres, checked, np.deg2rad(checked)))

    def to_degrees(self, q: ArrayLike) -> Array:
        """Return the joint positions of a configuration (nq,), (nv,), in degrees; slides in metres."""
        positions = self.positions(q)
        return np.asarray(np.where(self.in_metres, positions, np.rad2deg(positions)))

    def straight(self) -> Array:
        """Return the configuration of longest reach, (nq,); the neutral one for shipped templates.

        Slides without real limits that carry the base (`base_slides`) stay at zero.
        """
        return self.configuration(self._stretched)

    @cached_property
    def _stretched(self) -> Array:
        """Joint positions (nv,) [rad or m] that maximise the distance from base to tip, within the limits.

        Zero if the arm is straight there and has no slides. Otherwise the maximum is searched for from zero,
        and is a local one for arms that can stretch in several ways. A slide without real limits extends by
        the length of the arm, or stays at zero if it carries the base.
        """
        base = self.chain.base
        length = self.length
        units = self.joint_units
        straight = np.linalg.norm(self.chain.points[-1] - base) > (1.0 - 1e-9) * length
        if straight and np.all(self.chain.revolute) and self.within_limits(self.neutral()):
            return np.zeros(self.nv)

        def negative_reach(scaled: Array) -> tuple[float, Array]:
            state = self.chain_at(self.configuration(scaled * units))
            reach = (state.points[-1] - base) / length
            distance = max(float(np.linalg.norm(reach)), 1e-12)
            return -distance, -(reach / distance) @ state.jacobians[-1] * units / length

        lower, upper = np.array(self.usual_positions)
        # Revolute joints need no finite bounds: they are periodic.
        lower[~self.slides], upper[~self.slides] = np.array(self.limits[:2])[:, ~self.slides]
        fixed = np.clip(0.0, self.limits.lower, self.limits.upper)
        lower = np.where(self.base_slides, fixed, lower)
        upper = np.where(self.base_slides, fixed, upper)
        # Zero itself can be a stationary point, for instance if the arm is folded there.
        start = np.where(self.slides | (not straight), 1e-3 * units, 0.0)
        bounds = list(zip(lower / units, upper / units, strict=True))
        start = np.clip(start, lower, upper) / units
        farthest = minimize(negative_reach, start, jac=True, bounds=bounds, method="L-BFGS-B").x
        return np.asarray(np.clip(farthest * units, lower, upper))

    @cached_property
    def slides(self) -> NDArray[np.bool_]:
        """True for each sliding degree of freedom of the chain, (nv,)."""
        slides = np.zeros(self.nv, dtype=np.bool_)
        slides[self.columns] = ~self.chain.revolute[self.chain.leaders]
        return slides

    @property
    def travel(self) -> float:
        """How far slides can carry the tip from where it is with all of them at zero [m]; 0 without slides.

        Infinite if a slide has no limits.
        """
        slides = self.slides
        return float(np.maximum(np.abs(self.limits.lower[slides]), np.abs(self.limits.upper[slides])).sum())

    @cached_property
    def in_metres(self) -> NDArray[np.bool_]:
        """True for each sliding degree of freedom, on the chain or off it, (nv,)."""
        joints = [number for number in range(1, self.model.njoints) if self.model.joints[number].nv == 1]
        slides = np.zeros(self.nv, dtype=np.bool_)
        slides[[self.model.joints[joint].idx_v for joint in joints]] = ~joint_axes(self.model, joints)[1]
        return _read_only(slides)

    def checked_start(self, q: ArrayLike, name: str = "q") -> Array:
        """Check a configuration given as a start or a goal; see `checked`.

        A `PostureWarning` reports joints outside their limits.

        Args:
            q: configuration, (nq,).
            name: name of the value in error messages.

        Returns:
            Copy of q, (nq,).

        Raises:
            InvalidValue: as `checked`; or joints are so far outside that they may be in degrees.
        """
        checked = self.checked(q, name)
        check_range(self, checked, name)
        return checked

    @cached_property
    def _plausible_positions(self) -> tuple[Array, Array]:
        """Joint positions, (nv,) each, between which `check_positions` finds nothing."""
        return plausible_positions(self.limits, self.slides)

    def check_positions(self, positions: ArrayLike, name: str = "positions") -> None:
        """Check joint positions (nv,) [rad or m] against the limits, as `checked_start` does.

        Raises:
            InvalidValue: not (nv,) finite numbers, or so far outside that they may be in degrees.
        """
        checked = finite_vector(name, positions, self.nv)
        check_joint_positions(name, checked, self.limits, self.slides, self.joint_names)

    @cached_property
    def unlimited(self) -> NDArray[np.bool_]:
        """True for each degree of freedom without limits, or with limits so wide that they mean none, (nv,).

        Such limits allow more than 100 arm lengths of sliding or 100 rad of rotation. They are still
        enforced, but the joint is not driven towards them.
        """
        return _read_only(find_unlimited(self.limits.lower, self.limits.upper, self.slides, self.length))

    @cached_property
    def base_slides(self) -> NDArray[np.bool_]:
        """True for the slides without real limits that carry the base, as in a mobile robot, (nv,).

        They come before the first revolute joint. They are at zero in the straight arm, and keep their
        positions when the arm takes the shape of a curve that begins at its base.
        """
        slides = np.zeros(self.nv, dtype=np.bool_)
        revolute = ~self.slides[self.columns]
        slides[self.columns] = find_base_slides(self.unlimited[self.columns], revolute)
        return _read_only(slides)

    @cached_property
    def usual_positions(self) -> tuple[Array, Array]:
        """Smallest and largest joint positions for sampling and searching, (nv,) each [rad or m].

        The joint limits. For `unlimited` joints, half a turn to either side of the position nearest zero, or
        one arm length for a slide, clipped to the limits.
        """
        lower = self.limits.lower
        upper = self.limits.upper
        middle = np.clip(0.0, lower, upper)
        far = np.where(self.slides, self.length, np.pi)
        low = np.where(self.unlimited, np.maximum(lower, middle - far), lower)
        high = np.where(self.unlimited, np.minimum(upper, middle + far), upper)
        return _read_only(low), _read_only(high)

    def random(self, rng: np.random.Generator | int | None = None) -> Array:
        """Draw a configuration uniformly from `usual_positions`, (nq,).

        Args:
            rng: generator or seed; a fresh random seed if None.
        """
        return self.configuration(as_generator("rng", rng).uniform(*self.usual_positions))

    def within_limits(self, q: ArrayLike, tolerance: float = 1e-9) -> bool:
        """Check that no joint of q exceeds its limits by more than the tolerance, in `joint_units`."""
        slack = as_number("tolerance", tolerance, "a finite number", lambda x: True) * self.joint_units
        positions = self.positions(q)
        low = self.limits.lower - slack
        high = self.limits.upper + slack
        return bool(np.all((positions >= low) & (positions <= high)))

    def at(self, q: ArrayLike) -> ArmState:
        """Return the state of the arm at a configuration.

        Args:
            q: configuration, (nq,).

        Returns:
            The state, which reads placements and Jacobians from Pinocchio on first use. Those of an arm with
            more than `kinematics.MAX_PINOCCHIO_DOF` degrees of freedom are computed as in `chain_at`.

        Raises:
            InvalidValue: q has the wrong size or is not finite.
        """
        return state_at(self, self.checked(q))

    def chain_at(self, q: ArrayLike) -> ChainState:
        """Return the state of the arm at a configuration as solvers take it.

        Args:
            q: configuration, (nq,).

        Returns:
            The state, computed by the compiled pass along the chain on first use; equal to that of `at` up to
            rounding, and faster.

        Raises:
            InvalidValue: q has the wrong size or is not finite.
        """
        return ChainState(self, self.checked(q))

    @cached_property
    def multi_turn(self) -> NDArray[np.bool_]:
        """True for joints that can reach the same posture at positions a full turn apart, (nv,)."""
        room = self.limits.upper - self.limits.lower > FULL_TURN
        alone = np.bincount(self.chain.columns, minlength=self.nv) == 1
        return np.asarray(room & alone & ~self.slides & ~self.kinematics.endless)

    def nearest_turns(
        self, q: ArrayLike, near: ArrayLike | None = None, position_limits: ArrayLike | None = None
    ) -> Array:
        """Shift joints by full turns, which keeps the posture, to within half a turn of a reference.

        Where limits forbid the nearest turn, the nearest allowed one is used.

        Args:
            q: configuration, (nq,).
            near: reference configuration, (nq,); the straight one if None.
            position_limits: joint positions to stay between, (2, nv) [rad or m]; those of the arm if None.

        Returns:
            Configuration (nq,).

        Raises:
            InvalidValue: a configuration has the wrong size or is not finite.
        """
        checked = self.checked(q)
        preferred = None if near is None else self.checked(near, "near")
        return nearest_turns(
            self, checked, preferred, None if position_limits is None else np.asarray(position_limits)
        )

    def with_characteristic_length(self, characteristic_length: float) -> Arm:
        """Return the same arm with another sliding distance equivalent to one radian [m].

        Manipulability conditions, singular values and the minimal joint motions of controllers compare the
        motions of all joints, but there is no natural scale between slides and rotations.

        Raises:
            InvalidValue: not a finite length above 0.
        """
        allowed = "a finite length above 0 [m]"
        unit = as_number("characteristic_length", characteristic_length, allowed, lambda x: x > 0.0)
        spec = None if self.spec is None else replace(self.spec, characteristic_length=unit)
        return self._made_again(spec, unit, self.weight)

    def with_locked(self, positions: Mapping[str, float]) -> Arm:
        """Return the same arm with joints that do not move, such as those that are stuck.

        They keep their entries in configurations, but targets, plans and steps of the other arm leave them
        where they are, also where that is outside their limits. (`locked` of `load` takes joints out.)

        Args:
            positions: the position of each locked joint, by the names of `joint_names` [rad or m].

        Returns:
            The arm; without `spec`, which does not tell of locked joints.

        Raises:
            UnknownName: a joint that is not on the chain, or follows another one.
            InvalidValue: a position that is not a number, a continuous joint, or all joints.
        """
        require_instance("positions", positions, Mapping, "a mapping from joint names to positions")
        columns = {self.joint_names[u]: int(u) for u in self.columns}
        model = self._described.copy()
        lower = np.array(model.lowerPositionLimit)
        upper = np.array(model.upperPositionLimit)
        for name, value in positions.items():
            require_known("joint of the chain", name, tuple(columns))
            joint = model.joints[model.getJointId(name)]
            if joint.nq != 1:
                raise InvalidValue("locked joint", name, "a joint that is not continuous")
            allowed = f"a joint position within +-{NO_LIMIT:g}"
            at = as_number(f"positions[{name!r}]", value, allowed, lambda x: abs(x) < NO_LIMIT)
            lower[joint.idx_q] = upper[joint.idx_q] = at
        model.lowerPositionLimit = lower
        model.upperPositionLimit = upper
        locked = self._made_again(None, self.characteristic_length, self.weight, model)
        if np.all(locked.limits.lower[self.columns] == locked.limits.upper[self.columns]):
            raise InvalidValue("positions", list(positions), "at least one joint that moves")
        return locked

    def with_spec(self, spec: ArmSpec) -> Arm:
        """Return the same arm with another specification of it, such as one without a file.

        Raises:
            InvalidValue: not an `ArmSpec`.
        """
        require_instance("spec", spec, ArmSpec, "an ArmSpec")
        return self._made_again(spec, self.characteristic_length, self.weight)

    def _made_again(
        self, spec: ArmSpec | None, unit: float, weight: Weight, model: pin.Model | None = None
    ) -> Arm:
        again = Arm(
            self._described if model is None else model,
            self.control_points,
            self.base_placement,
            urdf=self.urdf,
            report=self.report,
            characteristic_length=unit,
            spec=spec,
            weight=weight,
        )
        again._warned = self._warned
        return again

    def _warn_once(self, message: str) -> None:
        """Warn the caller of this arm, or of one that it is derived from, for the first time."""
        if message not in self._warned:
            self._warned.add(message)
            warn_caller(message)

    def with_payload(
        self,
        mass: float,
        com: ArrayLike = (0.0, 0.0, 0.0),
        frame: str | None = None,
        inertia: ArrayLike = (0.0,) * 6,
    ) -> Arm:
        """Return the same arm with a payload in addition to what it carries.

        Args:
            mass: mass of the payload [kg].
            com: its centre of mass in the frame that carries it, (3,) [m].
            frame: the link, control point or joint that carries it, by name; the tip of the arm if None.
            inertia: its moments about the centre of mass, axes of the frame, xx, yy, zz, xy, xz, yz
                [kg m^2]; zeros for a point. Only simulations use them.

        Raises:
            UnknownName: there is no such frame.
            InvalidValue: an invalid number, or a frame that no joint moves.
        """
        load = Load(mass, com, frame, inertia)  # type: ignore[arg-type]
        return self.with_weight(replace(self.weight, payloads=(*self.weight.payloads, load)))

    def with_cable(self, mass_per_length: float, start: str | int | None = None, end: str | int = -1) -> Arm:
        """Return the same arm with a mass that is distributed evenly along it, as of a cable or a sleeve.

        Args:
            mass_per_length: mass per length of arm [kg/m].
            start: the control point at which it begins, by name or index, 0-based; the first joint if None.
            end: the control point at which it ends.

        Raises:
            UnknownName: there is no such control point.
            InvalidValue: an invalid number, or a cable that ends before it begins.
        """
        cable = Cable(mass_per_length, start, end)
        return self.with_weight(replace(self.weight, cables=(*self.weight.cables, cable)))

    def with_effort(self, effort: float | Mapping[str, float] | ArrayLike | None) -> Arm:
        """Return the same arm with other torque limits.

        Args:
            effort: largest torque or force of each drive [N m or N]: one number; numbers by the name of the
                joint; or one for each degree of freedom, (nv,). None: those of the description.

        Raises:
            UnknownName: there is no such joint.
            InvalidValue: not positive numbers.
        """
        if np.ndim(effort) == 1 and not isinstance(effort, Mapping):  # type: ignore[arg-type]
            listed = finite_vector("effort", effort, self.nv)  # type: ignore[arg-type]
            effort = dict(zip(self.joint_names, listed.tolist(), strict=True))
        return self.with_weight(replace(self.weight, effort=effort))  # type: ignore[arg-type]

    def with_stiffness(self, stiffness: float | Mapping[str, float] | ArrayLike | None) -> Arm:
        """Return the same arm with elastic joints, between their commands and their positions.

        Args:
            stiffness: torque or force of each drive per displacement from its command [N m/rad or N/m]: one
                number, if all joints turn or all slide; numbers by the name of the joint; one for each degree
                of freedom, (nv,); or a matrix of them, (nv, nv), as of `Actuators.stiffness`. None: unknown.

        Raises:
            UnknownName: there is no such joint.
            InvalidValue: not positive numbers, or a matrix that is not symmetric and positive definite.
        """
        if np.ndim(stiffness) == 1 and not isinstance(stiffness, Mapping):  # type: ignore[arg-type]
            listed = finite_vector("stiffness", stiffness, self.nv)  # type: ignore[arg-type]
            stiffness = dict(zip(self.joint_names, listed.tolist(), strict=True))
        return self.with_weight(replace(self.weight, stiffness=stiffness))  # type: ignore[arg-type]

    def with_gravity(self, gravity: ArrayLike | None) -> Arm:
        """Return the same arm in another gravity.

        For an arm on a wall or a ceiling, give `base_placement` instead: gravity acts along -z of the world.

        Args:
            gravity: gravitational acceleration, world frame, (3,) [m/s^2]. None: that of the model.

        Raises:
            InvalidValue: not three finite numbers.
        """
        vector = None if gravity is None else tuple(finite_vector("gravity", gravity, 3).tolist())
        return self.with_weight(replace(self.weight, gravity=vector))

    def with_weight(self, weight: Weight) -> Arm:
        """Return the same arm with another weight: all that is known of it beyond the description.

        Raises:
            InvalidValue: not a `Weight`, or as `with_payload` and `with_cable`.
            UnknownName: a frame, control point or joint does not exist.
        """
        require_instance("weight", weight, Weight, "a Weight")
        spec = None if self.spec is None else replace(self.spec, weight=weight)
        return self._made_again(spec, self.characteristic_length, weight)

    def require_masses(self, warns: bool = True) -> None:
        """Check that the masses of all links are known.

        Args:
            warns: whether a `PostureWarning` reports, once, numbers that cannot be right.

        Raises:
            WeightUnknown: a link that a joint moves has a shape or an extent, and no mass, nor has a link to
                which it is fixed; names the links.
            URDFError: an impossible number in the description; names the link.
            InvalidValue: an impossible mass in a model; names the joint.
        """
        if self._masses_checked:
            return
        warnings = check_masses(self._described, self.urdf, self.chain.length)
        parts = self.parts_without_mass
        lacking = [name for name in self.links_without_mass if name not in parts]
        if lacking:
            raise WeightUnknown("mass", lacking, REMEDY.masses)
        if parts:
            counted = "have shapes and no mass; they count with the links that carry them"
            warnings.append(f"{enumerated(map(repr, parts))} {counted}; {REMEDY.masses}")
        if warns:
            for message in warnings:
                self._warn_once(message)
            self._masses_checked = True

    @cached_property
    def links_without_mass(self) -> tuple[str, ...]:
        """Links that joints move and whose masses are not known; joints where links have no names.

        They have a shape or an extent, but no mass. `pp.weigh` gives them one. Torques are refused if one of
        them is not in `parts_without_mass`.
        """
        described = (self._described, self.urdf, self.weight)
        return tuple(links_without_mass(*described, self.chain, self.control_points))

    @property
    def parts_without_mass(self) -> tuple[str, ...]:
        """Those of `links_without_mass` that are fixed to links with mass, and count with them."""
        return tuple(parts_without_mass(self._described, self.weight, self.links_without_mass))

    def held_out(self) -> HeldOut | None:
        """Return how far the arm can be held straight out, with gravity from the worst direction.

        Returns:
            None if masses, or the torque limit of a joint of the chain, are not known.
        """
        columns = self.columns
        if not self.torques_known or np.any(np.isinf(self.effort[columns])):
            return None
        state = self.chain_at(self.straight())
        held = self._held_straight.T[columns]
        size = float(np.linalg.norm(self.model.gravity.linear))
        torques = self.outstretched_torques[columns]
        shares = torques / self.effort[columns]
        weak = np.flatnonzero(shares > 1.0 + ROUNDING)
        first = int(weak[-1]) if len(weak) else int(shares.argmax())
        load = load_of(self.drives[columns[first]], float(torques[first]), float(self.effort[columns[first]]))
        leaders = self.chain.leaders
        begin = 0 if not len(weak) else int([*leaders, len(self.chain.joints)][first + 1])
        line = np.vstack([state.origins, state.points[-1]])[begin:]
        length = self.length
        if len(weak):
            length = float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())
        payload = math.inf
        if size > 0.0:
            lever = -state.jacobians[-1].T[columns]
            payload = largest_payload(held, lever, self.effort[columns] / size)
        return HeldOut(length, load, payload)

    @cached_property
    def _held_straight(self) -> Array:
        """The torques that hold the straight arm in gravity of 1 m/s^2 along each axis, (3, nv)."""
        positions = self.chain_at(self.straight()).raw_positions
        return np.array([self.dynamics.gravity_torques(positions, axis) for axis in np.eye(3)])

    @property
    def outstretched_torques(self) -> Array:
        """The torques that hold the straight arm, for each joint in its worst direction, (nv,) [N m or N].

        They are how much the weight of the arm can load its joints, for thresholds and tolerances.

        Raises:
            WeightUnknown: masses that are not known.
        """
        self.require_masses()
        size = float(np.linalg.norm(self.model.gravity.linear))
        return np.asarray(size * np.linalg.norm(self._held_straight, axis=0))

    @cached_property
    def torques_known(self) -> bool:
        """Whether all masses are known, and the torque limit of a joint at least."""
        if not np.any(np.isfinite(self.effort)):
            return False
        try:
            self.require_masses(warns=False)
        except PostureError:
            return False
        return True

    def require_effort(self, warns: bool = True) -> None:
        """Check that torque limits are known.

        Args:
            warns: whether a `PostureWarning` names, once, joints without one.

        Raises:
            WeightUnknown: no torque limit is known.
        """
        unknown = [self.joint_names[u] for u in np.flatnonzero(np.isinf(self.effort))]
        if len(unknown) == self.nv:
            raise WeightUnknown("torque limit", unknown, REMEDY.effort)
        if unknown and warns:
            self._warn_once(str(WeightUnknown("torque limit", unknown, REMEDY.effort)))

    @property
    def stiffness(self) -> Array:
        """Torque or force per displacement of the joints from their commands, (nv, nv) [N m/rad or N/m].

        Raises:
            WeightUnknown: the stiffness of a joint is not known: an unknown one is not rigid. Names it.
        """
        springs = self._springs
        known = np.zeros(self.nv) if springs is None else np.diagonal(springs)
        if springs is None or np.any(known == 0.0):
            names = [self.joint_names[u] for u in np.flatnonzero(known == 0.0)]
            raise WeightUnknown("stiffness", names, REMEDY.stiffness)
        return _read_only(springs)

    @cached_property
    def _spring_root(self) -> Array:
        """A matrix A with A A^T = K^-1, (nv, nv)."""
        return spring_root(self.stiffness)

    @cached_property
    def sag_known(self) -> bool:
        """Whether all masses and the stiffness of all joints are known."""
        if self._springs is None or np.any(np.diagonal(self._springs) == 0.0):
            return False
        try:
            self.require_masses(warns=False)
        except PostureError:
            return False
        return True

    def sag(self, q_command: ArrayLike) -> Array:
        """Return the posture that the arm takes under load when it is commanded to another one.

        Its joints are springs: at rest K (q - c) + g(q) = 0, with the command c, `stiffness` K and
        `ArmState.gravity_torques` g. Of several such postures it is the one to which the unloaded arm moves
        when the load grows slowly. It is not stopped by joint limits, which are those of commands.

        Args:
            q_command: the configuration that is sent to the drives, (nq,), or several, (N, nq).

        Returns:
            The configuration of the loaded arm, (nq,), or (N, nq).

        Raises:
            NoEquilibrium: the arm buckles; names the joint that gives way, and at which share of the load.
            WeightUnknown: masses or a stiffness that are not known.
            InvalidValue: not a configuration.
        """
        self.require_masses()
        return self._for_rows("q_command", q_command, self._sagged)

    def compensate(self, q: ArrayLike) -> Array:
        """Return the command for which the loaded arm takes a posture: c = q + K^-1 g(q), see `sag`.

        Args:
            q: the configuration that the arm is to take, (nq,), or several, (N, nq).

        Returns:
            The configuration to send to the drives, (nq,), or (N, nq), within the joint limits: a joint that
            would go less than 1e-6 of its unit beyond stays at its limit.

        Raises:
            NoEquilibrium: a posture that is not stable; names the joint that gives way.
            WeightUnknown: masses or a stiffness that are not known.
            InvalidValue: not a configuration, or a joint whose command would be outside its limits; names it.
        """
        self.require_masses()
        return self._for_rows("q", q, self._compensated)

    def _for_rows(self, name: str, q: ArrayLike, change: Callable[[Array, str], Array]) -> Array:
        """Change a configuration, (nq,), or each of several, (N, nq), which are checked."""
        rows = as_floats(name, q)
        if rows.ndim != 2:
            return change(self.checked(q, name), name)
        named = [(row, f"{name}[{k}]") for k, row in enumerate(rows)]
        changed = [change(self.checked(row, where), where) for row, where in named]
        return np.array(changed).reshape(len(rows), self.nq)

    def _sagged(self, command: Array, name: str) -> Array:
        def loads(displacement: Array) -> tuple[Array, Array]:
            state = self.chain_at(self.integrate(command, displacement))
            return state._gravity_torques(), state._gravity_gradient()

        settled = settle(loads, self._spring_root, self.joint_units)
        if settled.share < 1.0:
            raise NoEquilibrium(name, self.joint_names[settled.weakest], settled.share)
        return self.integrate(command, settled.displacement)

    def _compensated(self, q: Array, name: str) -> Array:
        state = self.chain_at(q)
        bent = curvature(state._gravity_gradient(), self._spring_root)
        if np.linalg.eigvalsh(bent)[0] <= 0.0:
            raise NoEquilibrium(
                name, self.joint_names[weakest_joint(bent, self._spring_root, self.joint_units)]
            )
        command = self.integrate(q, -state.deflection)
        positions = state.raw_positions - state.deflection
        beyond = np.maximum(self.limits.lower - positions, positions - self.limits.upper) / self.joint_units
        worst = int(beyond.argmax())
        if beyond[worst] > CONVERGED:
            unit = "m" if self.in_metres[worst] else "rad"
            low = self.limits.lower[worst]
            high = self.limits.upper[worst]
            over = beyond[worst] * self.joint_units[worst]
            allowed = f"{low:.4g} to {high:.4g} {unit}; against the load it would go {over:.3g} {unit} beyond"
            joint = self.joint_names[worst]
            raise InvalidValue(f"command of joint {joint!r} for {name}", float(positions[worst]), allowed)
        reached = self.difference(q, self._sagged(command, name)) / self.joint_units
        if np.abs(reached).max() > CONVERGED:
            joint = self.joint_names[int(np.abs(reached).argmax())]
            raise NoEquilibrium(name, joint)
        within = np.clip(positions, self.limits.lower, self.limits.upper)
        return self.integrate(command, within - positions)

    def inverse_dynamics(self, q: ArrayLike, velocities: ArrayLike, accelerations: ArrayLike) -> Array:
        """Compute the torques and forces with which the motors move the arm.

        With what the arm carries and the armature of the description, without friction. Of coupled joints it
        is the torque along the leader, by virtual work.

        Args:
            q: configurations, (k, nq).
            velocities: joint velocities, (k, nv) [rad/s or m/s].
            accelerations: joint accelerations, (k, nv) [rad/s^2 or m/s^2].

        Returns:
            Array (k, nv) [N m or N].

        Raises:
            InvalidValue: arrays of other shapes or not finite, or an arm of over 100 degrees of freedom with
                a joint off its chain that neither turns about one axis nor slides along one.
            WeightUnknown: masses that are not known; names the links.
            URDFError: an impossible mass or inertia in the description; names the link.
        """
        at = finite_array("q", q, (None, self.nq))
        shape = (len(at), self.nv)
        moving = finite_array("velocities", velocities, shape)
        changing = finite_array("accelerations", accelerations, shape)
        self.require_masses()
        if not self.dynamics.whole:
            return self._frames_for_dynamics.inverse_dynamics(at, moving, changing)
        positions = at if self._flat else np.array([self.positions(row) for row in at]).reshape(shape)
        return self.dynamics.inverse_dynamics(positions, moving, changing)

    @property
    def _frames_for_dynamics(self) -> FrameReader:
        """Pinocchio's dynamics, for joints that no pass knows."""
        if self.frames is None:
            allowed = (
                f"at most {MAX_PINOCCHIO_DOF} degrees of freedom, as joints off the chain neither turn about "
                "one axis nor slide along one"
            )
            raise InvalidValue("arm", self, allowed)
        return self.frames

    @cached_property
    def dynamics(self) -> Dynamics:
        """Its joints and the bodies that they carry, as arrays for kernels."""
        return Dynamics(self.model, self.chain.joints)

    def __reduce__(self) -> tuple[Any, ...]:
        return Arm.from_dict, (self.to_dict(),)

    def __repr__(self) -> str:
        kind = "planar" if self.dimension == 2 else "spatial"
        size = f"{self.n_modules} modules, {self.nv} DOF, {length_text(self.length)}"
        return f"Arm({self.model.name!r}, {kind}, {size})"


class ArmState(ABC):
    """The arm at one configuration; everything in it is read-only and computed on first use.

    `Arm.at` returns a state that Pinocchio computes (`PinocchioState`), `Arm.chain_at` one that the compiled
    pass along the chain computes (`ChainState`). They are equal up to rounding; within an iteration, use only
    one of the two.

    Attributes:
        arm: the arm.
        q: configuration, (nq,) [rad or m].
    """

    def __init__(self, arm: Arm, q: Array) -> None:
        self.arm = arm
        self._q = q  # kernels take arrays that can be written to
        self.q: Array = q.view()
        self.q.flags.writeable = False

    @property
    @abstractmethod
    def chain_state(self) -> ChainState:
        """The same state as solvers take it, computed by the compiled pass along the chain."""

    @property
    @abstractmethod
    def placements(self) -> Frames | ForwardKinematics:
        """Placements of joints and control points, for kernels; do not write to them."""

    @property
    @abstractmethod
    def jacobians(self) -> Array:
        """Position Jacobians of the control points, (m, 3, nv) [m/rad], world axes.

        The column of a joint that carries the control point p is v + w x p, else zero, where v is the
        velocity at the world origin and w the angular velocity per unit of joint motion.
        """

    @property
    @abstractmethod
    def axes(self) -> Array:
        """Angular velocity per unit of joint motion, (3, nv) [rad/rad], world axes.

        The unit axis of a revolute joint; zero for a slide and for a joint off the chain. For coupled joints,
        the angular velocity of the body after the last of them.
        """

    @property
    @abstractmethod
    def screws(self) -> Screws:
        """The joint screws, for kernels; do not write to them."""

    @cached_property
    def points(self) -> Array:
        """Positions of the control points, (m, 3) [m], world frame."""
        return _read_only(self.placements.points)

    @cached_property
    def rotations(self) -> Array:
        """Orientations of the control points, (m, 3, 3), from control-point to world frame."""
        return _read_only(self.placements.rotations)

    @cached_property
    def origins(self) -> Array:
        """Origins of the joints of the chain, (k, 3) [m], world frame."""
        return _read_only(self.placements.origins)

    def moved(self, dq: Array) -> Self:
        """Return the state after a finite joint displacement, (nv,) [rad or m], which is not checked."""
        return type(self)(self.arm, self.arm.integrate(self._q, dq))

    @cached_property
    def raw_positions(self) -> Array:
        """Joint positions (nv,) [rad or m], for kernels; do not write to them."""
        return np.array(self._q) if self.arm._flat else self.arm.difference(self.arm.origin, self._q)

    @cached_property
    def positions(self) -> Array:
        """Joint positions (nv,) [rad or m]; continuous joints within +-pi."""
        return _read_only(self.raw_positions)

    @cached_property
    def links(self) -> Array:
        """Polyline from the base through joints and control points to the tip, (k, 3) [m], world frame.

        If slides without real limits carry the base, the line begins after those slides.
        """
        chain = self.arm.chain
        line = [chain.base]
        for joints, point in zip(chain.module_slices, self.points, strict=True):
            line.extend(self.origins[joints])
            line.append(point)
        count = int(self.arm.base_slides.sum())
        return _read_only(np.array(line[count + bool(count) :]))

    @cached_property
    def angular_jacobians(self) -> Array:
        """Angular Jacobians of the control points, (m, 3, nv) [rad/rad], world axes.

        A column is the angular velocity of the control point per unit joint motion, zero if not rotated.
        """
        return _read_only(self.axes * self.arm.support[:, None, :])

    def jacobian(self, frame: str) -> Array:
        """Return the Jacobian of any frame: a control point, a link or a joint.

        Args:
            frame: name of the frame.

        Returns:
            Array (6, nv), world axes: velocity of the frame's origin [m/rad], then angular velocity
            [rad/rad], per unit of joint motion.

        Raises:
            UnknownName: there is no such frame.
            InvalidValue: not a control point, and the arm is too long for `pin.Data`.
        """
        names = self.arm.control_points
        reader = self.arm.frames
        if frame in names:
            point = names.index(frame)
            return np.vstack([self.jacobians[point], self.angular_jacobians[point]])
        if reader is None:
            allowed = f"a control point, as the arm has more than {MAX_PINOCCHIO_DOF} degrees of freedom"
            raise InvalidValue("frame", frame, allowed)
        return reader.jacobian(self._q, frame)

    @cached_property
    def task_jacobians(self) -> Array:
        """Position Jacobians in comparable units, along the directions in which the arm can move.

        Returns:
            Array (m, d, nv) [m per unit of joint motion, see `Arm.joint_units`]: d = 3 in world axes, or
            d = 2 along the plane of a planar arm.
        """
        if self.arm.dimension == 3 and np.all(self.arm.chain.revolute):
            return self.jacobians
        return _read_only((self.arm.plane @ self.jacobians) * self.arm.joint_units)

    @cached_property
    def gravity_torques(self) -> Array:
        """Torques and forces with which the motors hold the arm still, (nv,) [N m or N].

        They balance gravity, payloads and cables included; forces where a joint slides. Of coupled joints it
        is the torque along the leader, by virtual work; see `Arm.drives`.

        Raises:
            WeightUnknown: masses that are not known; names the links.
            URDFError: an impossible mass or inertia in the description; names the link.
        """
        self.arm.require_masses()
        return _read_only(self._gravity_torques())

    @cached_property
    def gravity_gradient(self) -> Array:
        """Change of `gravity_torques` per joint motion, (nv, nv) [N m/rad, N or N/m]; symmetric.

        Raises:
            WeightUnknown: masses that are not known; names the links.
            URDFError: an impossible mass or inertia in the description; names the link.
        """
        self.arm.require_masses()
        return _read_only(self._gravity_gradient())

    @cached_property
    def deflection(self) -> Array:
        """Displacement of the loaded arm at this posture from its command, (nv,) [rad or m]: -K^-1 g.

        Whether the posture is stable is not checked; see `Arm.compensate`.

        Raises:
            WeightUnknown: masses or a stiffness that are not known; names the links or joints.
        """
        root = self.arm._spring_root
        return _read_only(-root @ (root.T @ self.gravity_torques))

    @property
    def torque_margin(self) -> Array:
        """Torque or force that each motor has left at rest, (nv,) [N m or N]; negative if it has not enough.

        The torque limit, `Arm.effort`, minus the size of the torque. It is infinite where no limit is known,
        which a `PostureWarning` says once for each arm.

        Raises:
            WeightUnknown: as `gravity_torques`, or no torque limit is known at all.
        """
        self.arm.require_effort()
        return _read_only(self.arm.effort - np.abs(self.gravity_torques))

    def most_loaded(self) -> JointLoad | None:
        """Return the joint with the largest torque in relation to its limit, at rest.

        Returns:
            Of coupled joints, the one that is driven. None if no torque limit or not all masses are known
            (`gravity_torques` says which): then nothing can be said.
        """
        arm = self.arm
        if not arm.torques_known:
            return None
        return heaviest_load(arm.drives, self._gravity_torques(), arm.effort)

    @abstractmethod
    def _gravity_torques(self) -> Array:
        """Return the torques that balance gravity, given that masses are known."""

    @abstractmethod
    def _gravity_gradient(self) -> Array:
        """Return their change per joint motion, given that masses are known."""

    def manipulability(self) -> Array:
        """Return the manipulability indices of all sections, (4.3) and (4.4); computed once per state.

        w = (product of sigma) / sigma_max^d, from the Gram matrices of the sections. Its resolution is about
        1e-8, because the determinant of a Gram matrix is only known to machine precision.

        Returns:
            Array (m + 1, m + 1): entry [s, i] is the index of control point i relative to control
            point s, in [0, 1], where 0 is the base; zero where s >= i.
        """
        return self._manipulability

    @cached_property
    def _manipulability(self) -> Array:
        indices = np.zeros((self.arm.n_modules + 1, self.arm.n_modules + 1))
        kernels.all_indices(self.screws, self.arm.kinematics.task_constants.plane, indices)
        return _read_only(indices)

    def ellipsoids(
        self, points: ControlPoints | None = None, relative_to: str = "base"
    ) -> tuple[Ellipsoid, ...]:
        """Compute manipulability ellipsoids, which show how close a singularity is (Section 3.3).

        Args:
            points: control points by index, 0-based or negative from the tip, or by name; all if None.
            relative_to: "base" to let all joints move; "previous" for only those after the previous chosen
                control point, as in the relative manipulability condition of a control set.

        Returns:
            One ellipsoid per point, in order. Radii and measures are in the units of `task_jacobians`.

        Raises:
            InvalidValue: an index out of range, or a control point chosen twice.
            UnknownName: no such control point, or another `relative_to`.
        """
        arm = self.arm
        chosen = chosen_points(arm.control_points, range(arm.n_modules) if points is None else points)
        ellipsoids = []
        for point, base in zip(chosen, section_bases(chosen, relative_to), strict=True):
            jacobian = self.task_jacobians[point][:, arm.columns[arm.module_starts[base] :]]
            ellipsoids.append(section_ellipsoid(jacobian, arm.plane, point, base, self.points[point]))
        return tuple(ellipsoids)

    def __repr__(self) -> str:
        return f"ArmState(q={np.array2string(self.q, precision=3, threshold=8)}, m={self.arm.n_modules})"


class PinocchioState(ArmState):
    """The arm at one configuration, computed by Pinocchio: one call of `computeJointJacobians` per state."""

    @cached_property
    @override
    def chain_state(self) -> ChainState:
        return ChainState(self.arm, self._q)

    @cached_property
    @override
    def placements(self) -> Frames:
        return cast(FrameReader, self.arm.frames).read(self._q)

    @cached_property
    @override
    def jacobians(self) -> Array:
        vx, vy, vz, wx, wy, wz = self.placements.motions.T
        support = self.arm.support
        x, y, z = self.placements.points.T[:, :, None]
        jacobians = np.empty((self.arm.n_modules, 3, self.arm.nv))
        jacobians[:, 0] = (vx + wy * z - wz * y) * support
        jacobians[:, 1] = (vy + wz * x - wx * z) * support
        jacobians[:, 2] = (vz + wx * y - wy * x) * support
        return _read_only(jacobians)

    @cached_property
    @override
    def axes(self) -> Array:
        return _read_only(self.placements.motions[:, 3:].T * self.arm.moved)

    @cached_property
    @override
    def screws(self) -> Screws:
        chain = self.arm.kinematics
        units = chain.task_constants.units
        frames = self.placements
        screws = np.empty((len(units), 6))
        kernels.carry_screws(frames.motions, chain.columns, units, chain.ends, frames.points, screws)
        return Screws(screws, chain.ends, frames.points)

    @override
    def _gravity_torques(self) -> Array:
        return cast(FrameReader, self.arm.frames).gravity_torques(self._q)

    @override
    def _gravity_gradient(self) -> Array:
        return self.chain_state._gravity_gradient()


class ChainState(ArmState):
    """The arm at one configuration, computed by the compiled pass along the chain, for solvers.

    It needs no `pin.Data`, whose memory grows with the cube of the number of joints, so it is also the state
    of arms with more than `kinematics.MAX_PINOCCHIO_DOF` degrees of freedom.
    """

    @property
    @override
    def chain_state(self) -> ChainState:
        return self

    @cached_property
    @override
    def placements(self) -> ForwardKinematics:
        return self.arm.kinematics.forward(self.raw_positions)

    @cached_property
    @override
    def jacobians(self) -> Array:
        return _read_only(self.arm.kinematics.jacobians(self.placements))

    @cached_property
    @override
    def axes(self) -> Array:
        axes = np.zeros((self.arm.nv, 3))
        chain = self.arm.chain
        turns = np.where(chain.revolute, chain.ratios, 0.0)
        np.add.at(axes, chain.columns, turns[:, None] * self.placements.axes)
        return _read_only(axes.T)

    @cached_property
    @override
    def screws(self) -> Screws:
        chain = self.arm.kinematics
        constants = chain.task_constants
        placed = self.placements
        screws = np.empty((len(constants.units), 6))
        kernels.find_screws(
            chain.constants,
            constants.joints,
            constants.units,
            placed.axes,
            placed.origins,
            chain.ends,
            placed.points,
            screws,
        )
        return Screws(screws, chain.ends, placed.points)

    @override
    def _gravity_torques(self) -> Array:
        weighing, at = self._weighing
        return weighing.gravity_torques(at)

    @override
    def _gravity_gradient(self) -> Array:
        weighing, at = self._weighing
        return weighing.gravity_gradient(at)

    @property
    def _weighing(self) -> tuple[Dynamics | FrameReader, Array]:
        """What computes torques, and where: a compiled pass, unless it does not know a joint."""
        arm = self.arm
        if arm.dynamics.whole:
            return arm.dynamics, self.raw_positions
        return arm._frames_for_dynamics, self._q


def kept(arm: Arm, kind: object, key: Hashable, make: Callable[[], Kept]) -> Kept:
    """Return a value of a kind that an arm keeps by a key; it is made if it is not there.

    Args:
        arm: the arm, whose `cache` has the latest `MAX_KEPT` values of each kind.
        kind: the key of the kind in the cache: the class of the values, or the function that makes them.
        key: what the value was made from, besides the arm.
        make: makes the value.
    """
    values: dict[Hashable, Kept] = arm.cache.setdefault(kind, {})
    kept = values.get(key)
    if kept is None:
        kept = values[key] = make()
        for oldest in list(values)[:-MAX_KEPT]:
            values.pop(oldest, None)  # another thread may have done so
    return kept


# Of configurations that are known to be some of the arm: checked before, or computed from such.


def state_at(arm: Arm, q: Array) -> ArmState:
    """Return the state at a configuration, (nq,); see `Arm.at`, which checks it."""
    return ChainState(arm, q) if arm.frames is None else PinocchioState(arm, q)


def check_range(arm: Arm, q: Array, name: str) -> None:
    """Check a configuration, (nq,), against the limits of the joints; see `Arm.checked_start`."""
    positions = arm.difference(arm.origin, q)
    low, high = arm._plausible_positions
    if np.less(positions, low).any() or np.greater(positions, high).any():
        arm.check_positions(positions, name)


def nearest_turns(arm: Arm, q: Array, near: Array | None, position_limits: Array | None) -> Array:
    """Return a configuration, (nq,), with joints shifted by full turns; see `Arm.nearest_turns`."""
    multi_turn = arm.multi_turn
    if not np.any(multi_turn):
        return q
    positions = arm.difference(arm.origin, q)
    preferred = arm._stretched if near is None else arm.difference(arm.origin, near)
    lower, upper = (arm.limits.lower, arm.limits.upper) if position_limits is None else position_limits
    away = (preferred - positions) / FULL_TURN
    turns = np.sign(away) * np.ceil(np.abs(away) - 0.5 - ROUNDING)
    least = np.ceil((lower - positions) / FULL_TURN - ROUNDING)
    most = np.floor((upper - positions) / FULL_TURN + ROUNDING)
    turns = np.where(multi_turn & (least <= most), np.maximum(np.minimum(turns, most), least), 0.0)
    if not np.any(turns):
        return q
    return arm.integrate(
        q, np.where(turns == 0.0, 0.0, np.clip(positions + FULL_TURN * turns, lower, upper) - positions)
    )


def arm_of(state: object) -> Arm:
    """Return the arm of a state; raise InvalidValue if it is none."""
    require_instance("state", state, ArmState, "an ArmState, as `arm.at(q)` returns it")
    arm: Arm = state.arm  # type: ignore[attr-defined]
    return arm


def _read_only(array: NDArray[Any]) -> NDArray[Any]:
    """Return a read-only view."""
    view: NDArray[Any] = array.view()
    view.flags.writeable = False
    return view


def smooth_configuration(arm: Arm, rng: np.random.Generator, amplitude: float) -> Array:
    """Draw a configuration that varies smoothly along the arm, like an arm at rest.

    Joints with the same index in their modules follow a sum of three sine waves along the arm with random
    phases; the largest joint position is the amplitude.

    Args:
        arm: the arm.
        rng: source of randomness.
        amplitude: largest joint position [rad or m].

    Returns:
        Configuration within the limits of the arm, (nq,).

    Raises:
        InvalidValue: the amplitude is not a finite number >= 0.
    """
    if not (np.isfinite(amplitude) and amplitude >= 0.0):
        raise InvalidValue("amplitude", amplitude, "a finite number >= 0 [rad or m]")
    most = max(len(joints) for joints in arm.module_joints)
    drawn = np.array([(rng.normal(), rng.uniform(0, 2 * np.pi)) for _ in range(3 * most)])
    sizes, phases = drawn.reshape(1, most, 3, 2).transpose(3, 0, 1, 2)
    positions = smooth_positions(arm, sizes, phases, np.array([amplitude]))[0]
    return arm.configuration(np.clip(positions, arm.limits.lower, arm.limits.upper))


def smooth_positions(arm: Arm, sizes: Array, phases: Array, amplitudes: Array) -> Array:
    """Return joint positions that vary smoothly along the arm, (s, nv); see `smooth_configuration`.

    Args:
        arm: the arm.
        sizes: those of the three waves, times their numbers, for each joint of a module, (s, k, 3).
        phases: of the waves, (s, k, 3) [rad].
        amplitudes: largest joint positions, (s,) [rad or m].
    """
    along = np.linspace(0.0, 1.0, arm.n_modules)
    waves = np.zeros((*sizes.shape[:2], arm.n_modules))
    for k in range(3):
        turns = np.pi * (k + 1) * along + phases[:, :, k, None]
        waves += sizes[:, :, k, None] / (k + 1) * np.sin(turns)
    positions = np.zeros((len(sizes), arm.nv))
    for module, columns in enumerate(np.split(arm.columns, arm.module_starts[1:])):
        positions[:, columns] = waves[:, : len(columns), module]
    largest = np.abs(positions).max(axis=1, keepdims=True)
    return np.asarray(positions * (amplitudes[:, None] / np.maximum(largest, 1e-300)))


def bent_configuration(arm: Arm, rng: np.random.Generator, heading: float) -> Array:
    """Draw a smooth random configuration of a planar arm with a given largest heading of its links.

    A long arm that bends slightly at each of many joints rolls up, so the heading of its links describes a
    posture better than its joint angles, whatever the number of joints.

    Args:
        arm: a planar arm with revolute joints.
        rng: source of randomness.
        heading: largest angle between a link and the same link of the straight arm [rad].

    Returns:
        Configuration within the limits of the arm, (nq,).

    Raises:
        InvalidValue: the heading is not a finite number >= 0, or the arm is not planar.
    """
    if not (np.isfinite(heading) and heading >= 0.0):
        raise InvalidValue("heading", heading, "a finite number >= 0 [rad]")
    if arm.dimension != 2:
        raise InvalidValue("arm", arm, "a planar arm")
    positions = arm.positions(smooth_configuration(arm, rng, 1.0))
    largest = float(np.abs(link_headings(arm, positions)).max())
    positions = positions * (heading / max(largest, 1e-300))
    return arm.configuration(np.clip(positions, arm.limits.lower, arm.limits.upper))


def link_headings(arm: Arm, positions: Array) -> Array:
    """Return the rotation of each link of a planar arm about the normal of its plane, relative to the base.

    It is the sum of the positions, or displacements, (nv,) of the joints of the chain up to each link, full
    turns included, (n,) [rad].
    """
    senses = np.sign(arm.chain.axes @ np.cross(*arm.plane)) * arm.chain.revolute
    return np.asarray(np.cumsum(senses * positions[arm.columns]))
