"""The controller on the command line."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.inputs import MOTION
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from pinposture.control import Controller, ControlTask

ControllerOption = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="What moves the arm: qp (directly, within limits, around obstacles); selection or projection "
        "(those of the thesis) or switching (the two by turns); or, to compare with: joint (interpolation of "
        "joints), pinv (pseudo-inverse), task-constraints (points in its null space), extended or augmented "
        "(Jacobians), dls (damped least squares), lm (Levenberg-Marquardt).",
        rich_help_panel=MOTION,
    ),
]
HasteOption = Annotated[
    float | None,
    typer.Option(
        help="How far control points may go out of their way to spare joints theirs, in module lengths per "
        "rad; else 0.2. Large numbers lead to interpolation of joints. With qp only.",
        rich_help_panel=MOTION,
    ),
]


def check_controller(name: str, only_qp: Mapping[str, object]) -> None:
    """Refuse a controller that does not exist, or that does not know what is asked of it.

    Args:
        name: its name.
        only_qp: options that only the qp knows, with their values; None or False if not given.

    Raises:
        UnknownName: there is no such controller.
        InvalidValue: it is not the qp, and one of the options is given.
    """
    import pinposture.study.baselines  # noqa: F401  # so that they have names
    from pinposture.control import controller_named

    controller_named(name)
    given = [option for option, value in only_qp.items() if value is not None and value is not False]
    if given and name != "qp":
        raise InvalidValue("--controller", name, f"'qp', which alone knows {', '.join(given)}")


def build_controller(name: str, haste: float | None, task: ControlTask | None) -> Controller:
    """The controller of that name; the qp with its haste and a task besides the shape.

    Raises:
        UnknownName: there is no such controller.
        InvalidValue: a haste that is not a positive number.
    """
    import pinposture.study.baselines  # noqa: F401  # so that they have names
    from pinposture.control import ConstrainedQP, controller_named

    chosen = controller_named(name)
    if not isinstance(chosen, ConstrainedQP):
        return chosen
    tasks = () if task is None else (task,)
    return replace(chosen, haste=chosen.haste if haste is None else haste, tasks=tasks)
