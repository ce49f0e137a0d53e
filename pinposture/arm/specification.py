"""What an arm is made from, the ways to make one, and what was decided while it was loaded."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeAlias, TypeVar

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import Field, PositiveFloat, PositiveInt, field_validator, model_validator

from pinposture._validation import rigid_placement
from pinposture.arm.configurations import ConfigurationSpace
from pinposture.arm.loading import LoadReport, Modules, load_model, place_base
from pinposture.arm.template import JointSpec, ModuleTemplate, modules_to_urdf, template
from pinposture.errors import InvalidValue, PostureWarning
from pinposture.specification import Specification
from pinposture.storage import settled

Made = TypeVar("Made", bound="Blueprint")

# What an arm is made from, as data.

Vector: TypeAlias = tuple[float, float, float]

ANGLE_ROUNDING = 1e-15
"""How far what three angles say may be from a rotation matrix, entry by entry."""


class PlacementSpec(Specification):
    """A placement in the world.

    Attributes:
        position: x, y, z [m].
        rotation: roll, pitch and yaw [rad].
    """

    position: Vector = (0.0, 0.0, 0.0)
    rotation: Vector = (0.0, 0.0, 0.0)

    def build(self) -> pin.SE3:
        """The placement."""
        return pin.SE3(pin.rpy.rpyToMatrix(*self.rotation), np.array(self.position))

    @classmethod
    def of(cls, placement: pin.SE3) -> PlacementSpec:
        """What says a placement, its rotation to 1e-15."""
        return cls(position=placement.translation.tolist(), rotation=roll_pitch_yaw(placement.rotation))


def roll_pitch_yaw(rotation: NDArray[np.float64]) -> Vector:
    """The angles of a rotation matrix (3, 3) [rad], with no more digits than it takes to find it again."""
    angles = np.asarray(pin.rpy.matrixToRpy(rotation))
    for digits in range(3, 17):
        rounded = np.round(angles, digits) + 0.0  # and no zero below zero
        if np.abs(pin.rpy.rpyToMatrix(*rounded) - rotation).max() <= ANGLE_ROUNDING:
            angles = rounded
            break
    roll, pitch, yaw = map(float, angles)
    return roll, pitch, yaw


class FeedSpec(Specification):
    """A slide along the axis of an arm, which pushes all of it.

    Attributes:
        stroke: how far [m].
        length: of the link that it pushes [m]; that of a module if None.
        speed: the largest [m/s].
    """

    stroke: PositiveFloat
    length: float | None = None
    speed: PositiveFloat = 0.1


OF_A_TEMPLATE = ("template", "modules", "link_lengths", "joint_limits", "feed")
OF_A_URDF = ("urdf", "base", "tip", "split", "locked", "package_dirs")


class ArmSpec(Specification):
    """What an arm is made from: modules of a template, or a URDF. `Arm.from_spec` makes the arm.

        spec = ArmSpec(template="RyRz", modules=20)
        spec = ArmSpec(urdf=Path("snake.urdf"), tip="head", split=2)

    Attributes:
        template: name of a module template.
        modules: how many of them.
        link_lengths: length of the link after each joint of a module [m]; the template's own if None.
        joint_limits: smallest and largest position of each revolute joint [rad]; the template's own if None.
        feed: a slide below the first module, if there is one.
        urdf: a URDF file, or the text of one.
        base: link at which the arm begins; the root if None.
        tip: link at which it ends, as for `Arm.from_urdf`.
        split: how the chain is cut into modules, as `modules` of `Arm.from_urdf`.
        locked: joints that are held still, and where [rad or m].
        package_dirs: folders in which viewers look for meshes.
        placement: where the base stands in the world; at the origin if None.
        characteristic_length: the slide that weighs as much as a turn of one radian [m]; the mean module
            length if None.
    """

    template: str | None = None
    modules: PositiveInt | None = None
    link_lengths: tuple[float, ...] | None = None
    joint_limits: tuple[float, float] | None = None
    feed: FeedSpec | None = None
    urdf: Path | str | None = None
    base: str | None = None
    tip: str | None = None
    split: int | tuple[int, ...] | tuple[str, ...] | None = None
    locked: dict[str, float] = Field(default_factory=dict)
    package_dirs: tuple[Path, ...] = ()
    placement: PlacementSpec | None = None
    characteristic_length: PositiveFloat | None = None

    @field_validator("urdf")
    @classmethod
    def _file_or_text(cls, source: Path | str | None) -> Path | str | None:
        return Path(source) if isinstance(source, str) and not is_urdf_text(source) else source

    @model_validator(mode="after")
    def _one_source(self) -> ArmSpec:
        kind, other = (OF_A_URDF, OF_A_TEMPLATE) if self.urdf is not None else (OF_A_TEMPLATE, OF_A_URDF)
        for key in other:
            if getattr(self, key) not in (None, {}, ()):
                raise ValueError(f"{key!r} does not go with {kind[0]!r}")
        return self

    def module_templates(self) -> list[ModuleTemplate]:
        """The modules from base to tip, those of a template with all that is said of them.

        Raises:
            UnknownName: no such template.
            InvalidValue: a value that makes no module; has its name here.
        """
        if self.template is None or self.modules is None:
            raise InvalidValue("template", self.template, "the name of a template, and a number of modules")
        module = template(self.template)
        if self.link_lengths is not None:
            with _naming("link_lengths"):
                module = module.with_lengths(self.link_lengths)
        if self.joint_limits is not None:
            with _naming("joint_limits"):
                module = module.with_limits(*self.joint_limits)
        modules = [module] * self.modules
        if self.feed is None:
            return modules
        length = module.length if self.feed.length is None else self.feed.length
        with _naming("feed"):
            slide = JointSpec("x", "prismatic", 0.0, self.feed.stroke, velocity=self.feed.speed)
            return [ModuleTemplate("Feed", (slide,), (length,), module.radius), *modules]


@contextmanager
def _naming(key: str) -> Iterator[None]:
    """Say of a wrong value which key of a specification it is in."""
    try:
        yield
    except InvalidValue as error:
        raise InvalidValue(key, error.value, error.allowed) from None


def is_urdf_text(source: object) -> bool:
    """Whether it is the text of a URDF, and not the path of a file."""
    return isinstance(source, str) and source.lstrip("\ufeff \t\r\n").startswith("<")


# The ways to make an arm.


class Blueprint(ConfigurationSpace):
    """A model with control points, and where both came from.

    Attributes:
        control_points: names of the control points from base to tip, (m,).
        base_placement: where the base link stands in the world.
        urdf: the description it was loaded from, or None.
        report: what was decided while it was loaded (base, tip, warnings, ...); None if it was not.
        spec: what it was made from; None if that was a Pinocchio model.
        characteristic_length: the slide that weighs as much as a turn of one radian [m].
    """

    characteristic_length: float

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
        super().__init__(model)
        self.control_points = tuple(control_points)
        self.base_placement = pin.SE3.Identity() if base_placement is None else base_placement
        self.urdf, self.report, self.spec = urdf, report, spec
        if characteristic_length is not None:
            self.characteristic_length = characteristic_length

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
        cls: type[Made],
        name: str,
        modules: int,
        link_lengths: Sequence[float] | None = None,
        base_placement: pin.SE3 | None = None,
    ) -> Made:
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
        lengths = None if link_lengths is None else tuple(module.link_lengths)
        spec = ArmSpec(template=name, modules=modules, link_lengths=lengths)
        return cls._from_templates(spec, spec.module_templates(), base_placement)

    @classmethod
    def from_spec(cls: type[Made], spec: ArmSpec) -> Made:
        """Build an arm of what it is said to be made from.

        Args:
            spec: a template or a URDF, and how to make an arm of it.

        Returns:
            The arm; what `spec` says of it is kept.

        Raises:
            PostureError: as `from_template` and `from_urdf`, or neither a template nor a URDF is named.
        """
        placement = None if spec.placement is None else spec.placement.build()
        if spec.urdf is None:
            return cls._from_templates(spec, spec.module_templates(), placement)
        given = (spec.urdf, spec.base, spec.tip, spec.split, spec.locked, spec.package_dirs)
        return cls._loaded(spec, *given, base_placement=placement)

    @classmethod
    def _from_templates(
        cls: type[Made], spec: ArmSpec, modules: Sequence[ModuleTemplate], base_placement: pin.SE3 | None
    ) -> Made:
        text = modules_to_urdf(modules, f"{spec.template}_{spec.modules}")
        sizes = [len(module.joints) for module in modules]
        return cls._loaded(spec, text, modules=sizes, base_placement=base_placement)

    @classmethod
    def from_modules(
        cls: type[Made],
        modules: Iterable[ModuleTemplate],
        base_placement: pin.SE3 | None = None,
        name: str = "arm",
    ) -> Made:
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
        cls: type[Made],
        source: str | Path,
        base: str | None = None,
        tip: str | None = None,
        modules: Modules = None,
        locked: Mapping[str, float] | None = None,
        package_dirs: Sequence[str | Path] | None = None,
        base_placement: pin.SE3 | None = None,
    ) -> Made:
        """Load an arm from a URDF file or from URDF text; meshes are not needed.

        Args:
            source: path of the file, or the XML text itself.
            base: link at which the arm begins; the root if None.
            tip: link at which it ends; if None, the last of the links in `modules`, or the end of the longest
                moving chain (`pinposture.arm.urdf_reader`).
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
        return cls._loaded(None, source, base, tip, modules, locked, package_dirs, base_placement)

    @classmethod
    def _loaded(
        cls: type[Made],
        spec: ArmSpec | None,
        source: str | Path,
        base: str | None = None,
        tip: str | None = None,
        modules: Modules = None,
        locked: Mapping[str, float] | None = None,
        package_dirs: Sequence[str | Path] | None = None,
        base_placement: pin.SE3 | None = None,
    ) -> Made:
        """The arm of a URDF; if `spec` is None, it is what the arguments say."""
        placement = rigid_placement("base_placement", base_placement)
        loaded = load_model(source, base, tip, modules, dict(locked or {}), placement, package_dirs)
        for message in loaded.report.warnings:
            warnings.warn(message, PostureWarning, stacklevel=3)
        if spec is None:
            if isinstance(package_dirs, str | Path):
                package_dirs = [package_dirs]
            spec = ArmSpec(
                urdf=loaded.text if is_urdf_text(source) else settled(source),
                base=base,
                tip=tip,
                split=_split(modules),
                locked={name: float(position) for name, position in (locked or {}).items()},
                package_dirs=tuple(settled(folder) for folder in package_dirs or ()),
            )
        if base_placement is not None and spec.placement is None:
            spec = spec.model_copy(update={"placement": PlacementSpec.of(placement)})
        parts = (loaded.model, loaded.control_points, placement, loaded.text, loaded.report)
        return cls(*parts, spec.characteristic_length, spec)

    @classmethod
    def from_model(
        cls: type[Made],
        model: pin.Model,
        control_points: Sequence[str],
        base_placement: pin.SE3 | None = None,
    ) -> Made:
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
        if not isinstance(model, pin.Model):
            raise InvalidValue("model", model, "a pin.Model")
        own = pin.Model(model)
        placement = rigid_placement("base_placement", base_placement)
        place_base(own, placement)
        return cls(own, control_points, placement)

    def to_dict(self) -> dict[str, Any]:
        """What is needed to build this arm again, as data that JSON can hold."""
        described: dict[str, Any] = {"control_points": list(self.control_points)}
        described["base_placement"] = np.asarray(self.base_placement.homogeneous).tolist()
        described["urdf"] = self.urdf
        described["report"] = self.report.to_dict() if self.report else None
        described["characteristic_length"] = self.characteristic_length
        if self.spec is not None:
            described["spec"] = self.spec.model_dump(mode="json", exclude_defaults=True)
            if isinstance(self.spec.urdf, str):  # which stands above
                del described["spec"]["urdf"]
        described["model"] = self.model.saveToString()
        return described

    @classmethod
    def from_dict(cls: type[Made], described: Mapping[str, Any]) -> Made:
        """Build the arm that `to_dict` described."""
        model = pin.Model()
        model.loadFromString(described["model"])
        placement = pin.SE3(np.array(described["base_placement"]))
        report = LoadReport.from_dict(described["report"]) if described.get("report") else None
        points, urdf, unit = (described[key] for key in ("control_points", "urdf", "characteristic_length"))
        spec = described.get("spec")
        if spec is not None:
            spec = ArmSpec(**({} if "template" in spec else {"urdf": urdf}) | spec)
        return cls(model, points, placement, urdf, report, unit, spec)


def _split(modules: Modules) -> Any:
    """How a chain was cut into modules, as plain data."""
    if modules is None:
        return None
    return (modules,) if isinstance(modules, str) else np.asarray(modules).tolist()
