"""Controllers by name."""

from __future__ import annotations

import sys
from collections.abc import Callable
from importlib import import_module
from importlib.metadata import entry_points
from pathlib import Path
from typing import cast

from pinposture.control.controller import Controller, JointInterpolation
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
"""All controllers with their default parameters, by the names that `track` and the command line accept.

Add your own with `CONTROLLERS["mine"] = Mine`."""

ENTRY_POINTS = "pinposture.controllers"
"""Entry point group in which installed packages register their controllers."""


def controller_names() -> tuple[str, ...]:
    """Return the names of the controllers of the library and of installed packages."""
    return (*CONTROLLERS, *(entry.name for entry in entry_points(group=ENTRY_POINTS)))


def controller_named(controller: str | Controller) -> Controller:
    """Return the controller of a name with its defaults; a controller is returned as it is.

    Args:
        controller: a key of CONTROLLERS; the name of an entry point in the group ENTRY_POINTS; or the class
            or function that creates one, as "package.module:Class", from the working directory too.

    Raises:
        UnknownName: no controller has that name, or the module has no such attribute.
        InvalidValue: neither a name nor a controller; the import fails; or the call creates no controller.
    """
    made: object = controller
    if isinstance(controller, str):
        make = CONTROLLERS.get(controller) or _found(controller)
        try:
            made = make()
        except TypeError as error:
            allowed = f"a class or function that can be called without arguments ({error})"
            raise InvalidValue("controller", controller, allowed) from error
    allowed = "a name, package.module:Class, or an object with a `name` and a method `step`"
    if isinstance(made, type):
        raise InvalidValue("controller", controller, f"{allowed}, such as {made.__name__}()")
    if not (isinstance(getattr(made, "name", None), str) and callable(getattr(made, "step", None))):
        raise InvalidValue("controller", controller, allowed)
    return cast(Controller, made)


def _found(name: str) -> Callable[[], object]:
    """Return the class or function that creates a controller from outside the library."""
    offered = {entry.name: entry for entry in entry_points(group=ENTRY_POINTS)}
    if name in offered:
        return cast(Callable[[], object], offered[name].load())
    home, _, attribute = name.partition(":")
    if not (home and attribute):
        raise UnknownName("controller", name, ("package.module:Class", *controller_names()))
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)
    try:
        module = import_module(home)
    except ImportError as error:
        raise InvalidValue("controller", name, f"a module that can be imported ({error})") from error
    if not callable(getattr(module, attribute, None)):
        classes = [key for key, entry in vars(module).items() if getattr(entry, "__module__", None) == home]
        raise UnknownName(f"controller of {home}", attribute, [key for key in classes if key[0] != "_"])
    return cast(Callable[[], object], getattr(module, attribute))
