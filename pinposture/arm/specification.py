"""What an arm is made from, the ways to make one, and what was decided while it was loaded."""

from __future__ import annotations

import warnings
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any, TypeVar

import numpy as np
import pinocchio as pin

from pinposture._validation import rigid_placement
from pinposture.arm.configurations import ConfigurationSpace
from pinposture.arm.loading import LoadReport, Modules, load_model, place_base
from pinposture.arm.template import ModuleTemplate, modules_to_urdf, template
from pinposture.errors import InvalidValue, PostureWarning

Made = TypeVar("Made", bound="Blueprint")


class Blueprint(ConfigurationSpace):
    """A model with control points, and where both came from.

    Attributes:
        control_points: names of the control points from base to tip, (m,).
        base_placement: where the base link stands in the world.
        urdf: the description it was loaded from, or None.
        report: what was decided while it was loaded (base, tip, warnings, ...); None if it was not.
        sliding_unit: the slide that weighs as much as a turn of one radian [m].
    """

    sliding_unit: float

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
        if sliding_unit is not None:
            self.sliding_unit = sliding_unit

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
        return cls.from_modules([module] * modules, base_placement=base_placement, name=f"{name}_{modules}")

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
        placement = rigid_placement("base_placement", base_placement)
        loaded = load_model(source, base, tip, modules, dict(locked or {}), placement, package_dirs)
        for message in loaded.report.warnings:
            warnings.warn(message, PostureWarning, stacklevel=2)
        return cls(loaded.model, loaded.control_points, placement, loaded.text, loaded.report)

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
        described["sliding_unit"] = self.sliding_unit
        described["model"] = self.model.saveToString()
        return described

    @classmethod
    def from_dict(cls: type[Made], described: Mapping[str, Any]) -> Made:
        """Build the arm that `to_dict` described."""
        model = pin.Model()
        model.loadFromString(described["model"])
        placement = pin.SE3(np.array(described["base_placement"]))
        report = LoadReport.from_dict(described["report"]) if described.get("report") else None
        points, urdf, unit = (described[key] for key in ("control_points", "urdf", "sliding_unit"))
        return cls(model, points, placement, urdf, report, unit)
