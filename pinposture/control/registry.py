"""Controllers by name."""

from __future__ import annotations

from collections.abc import Callable

from pinposture.control.controller import Controller
from pinposture.control.joint_interpolation import JointInterpolation
from pinposture.control.planner.geodesic import Geodesic
from pinposture.control.thesis.projection import Projection
from pinposture.control.thesis.selection import Selection
from pinposture.control.thesis.switching import Switching
from pinposture.errors import InvalidValue, UnknownName

CONTROLLERS: dict[str, Callable[[], Controller]] = {
    "geodesic": Geodesic,
    "selection": Selection,
    "projection": Projection,
    "switching": Switching,
    "joint": JointInterpolation,
}
"""Every controller with its default parameters, by the name that `track` and the command line take.

`pinposture.study.register_baselines` adds those that exist to be compared with."""


def controller_named(controller: str | Controller) -> Controller:
    """The controller of that name with its defaults, or the controller itself.

    Raises:
        UnknownName: no controller has that name.
        InvalidValue: neither a name nor a controller.
    """
    if not isinstance(controller, str):
        if isinstance(controller, type) or not callable(getattr(controller, "step", None)):
            raise InvalidValue("controller", controller, "a name, or an object with a method `step`")
        return controller
    if controller not in CONTROLLERS:
        raise UnknownName("controller", controller, CONTROLLERS)
    return CONTROLLERS[controller]()
