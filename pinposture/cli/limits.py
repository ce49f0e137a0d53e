"""The limits of a step on the command line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.inputs import read_numbers
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pinposture.control import Limits

LIMITS = "The limits"
"""Heading under which the help lists these options."""

StepLimitOption = Annotated[
    float,
    typer.Option(
        help="Largest motion of a joint in one step, in rad or metres; inf for none.", rich_help_panel=LIMITS
    ),
]
VelocityOption = Annotated[
    str | None,
    typer.Option(
        metavar="V,...",
        help="Largest speed of joints, in rad/s or m/s, one number for all or one for each; else the arm's "
        "own. Needs --dt.",
        rich_help_panel=LIMITS,
    ),
]
AccelerationOption = Annotated[
    str | None,
    typer.Option(
        metavar="A,...",
        help="Largest acceleration of joints, in rad/s^2 or m/s^2, one number or one for each; else there is "
        "no such limit. Needs --dt.",
        rich_help_panel=LIMITS,
    ),
]
DurationOption = Annotated[
    float | None,
    typer.Option(
        "--dt", help="Duration of a step, in s; else speeds are not limited.", rich_help_panel=LIMITS
    ),
]
PositionMarginOption = Annotated[
    float,
    typer.Option(
        help="Distance to keep from the limits of joint positions, in rad or metres.", rich_help_panel=LIMITS
    ),
]


def read_limits(
    step: float, velocity: str | None, acceleration: str | None, dt: float | None, position_margin: float
) -> Limits:
    """The limits that these options ask for, as `Limits` takes them.

    Raises:
        InvalidValue: text in place of numbers, a value that `Limits` does not take, or no `dt` where one is
            needed.
    """
    from pinposture.control import Limits

    for option, given in (("--velocity", velocity), ("--acceleration", acceleration)):
        if dt is None and given is not None:
            raise InvalidValue("--dt", dt, f"the duration of a step [s], needed with {option}")
    speed, change = _for_joints("--velocity", velocity), _for_joints("--acceleration", acceleration)
    return Limits(step=step, velocity=speed, dt=dt, position_margin=position_margin, acceleration=change)


def _for_joints(option: str, text: str | None) -> float | NDArray[np.float64] | None:
    import numpy as np

    if text is None:
        return None
    values = read_numbers(option, text)
    return values[0] if len(values) == 1 else np.array(values)
