"""Controllers by name."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import cast

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

Add your own: `CONTROLLERS["mine"] = Mine`. `pinposture.study.register_baselines` adds those that exist to be
compared with."""

ENTRY_POINTS = "pinposture.controllers"
"""Group of the entry points by which installed packages offer controllers under names of theirs."""


def controller_named(controller: str | Controller) -> Controller:
    """The controller of that name with its defaults, or the controller itself.

    Args:
        controller: a name of CONTROLLERS or of an entry point in the group ENTRY_POINTS; or where a class or
            function is that makes one, as "package.module:Class". Modules are found in the working directory,
            too.

    Raises:
        UnknownName: no controller has that name, or nothing of that name is in the module.
        InvalidValue: neither a name nor a controller; or what was named cannot be imported, or makes none.
    """
    if isinstance(controller, str):
        make = CONTROLLERS.get(controller) or _found(controller)
        try:
            made = make()
        except TypeError as error:
            raise InvalidValue(
                "controller", controller, f"what can be called without arguments ({error})"
            ) from error
        return _checked(made, controller)
    return _checked(controller, controller)


def _checked(made: object, told: object) -> Controller:
    if isinstance(made, type) or not callable(getattr(made, "step", None)):
        raise InvalidValue(
            "controller", told, "a name, package.module:Class, or an object with a method `step`"
        )
    return cast(Controller, made)


def _found(name: str) -> Callable[[], object]:
    """What makes a controller that is not among those of the library."""
    offered = {each.name: each for each in entry_points(group=ENTRY_POINTS)}
    if name in offered:
        return cast(Callable[[], object], offered[name].load())
    home, _, attribute = name.partition(":")
    if not (home and attribute):
        raise UnknownName("controller", name, (*CONTROLLERS, *offered))
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    try:
        module = import_module(home)
    except ImportError as error:
        raise InvalidValue("controller", name, f"a module that can be imported ({error})") from error
    if not callable(getattr(module, attribute, None)):
        raise UnknownName(
            f"controller of {home}", attribute, [each for each in vars(module) if each[0] != "_"]
        )
    return cast(Callable[[], object], getattr(module, attribute))
