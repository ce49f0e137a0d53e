"""What is asked of the tip on the command line, besides the shape."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinposture.cli.inputs import read_numbers
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from pinposture.arm import ArmState
    from pinposture.control import EndEffector
    from pinposture.motion import Trajectory

TIP = "The tip"
"""Heading under which the help lists these options."""

TipPositionOption = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z",
        help="Bring the tip here, in metres, as the arm takes its shape.",
        rich_help_panel=TIP,
    ),
]
TipPoseOption = Annotated[
    str | None,
    typer.Option(
        metavar="X,Y,Z,ROLL,PITCH,YAW",
        help="Bring it here, turned from the axes of the world by roll about x, then pitch about y, then yaw "
        "about z, in rad.",
        rich_help_panel=TIP,
    ),
]
HoldTipOption = Annotated[
    str | None,
    typer.Option(
        metavar="WHAT",
        help="Keep the tip where the start has it: its position, or its pose.",
        rich_help_panel=TIP,
    ),
]
TipWeightOption = Annotated[
    float | None,
    typer.Option(
        help="What the tip counts, where a control point on the curve counts 1; else 1.", rich_help_panel=TIP
    ),
]
StrictTipOption = Annotated[
    bool,
    typer.Option("--strict-tip", help="The tip comes first, the shape after it.", rich_help_panel=TIP),
]


def read_tip(
    start: ArmState,
    position: str | None,
    pose: str | None,
    hold: str | None,
    weight: float | None,
    strict: bool,
) -> EndEffector | None:
    """The task of the tip that these options ask for; None if they ask for none.

    Args:
        start: where the arm begins.
        position: three numbers [m], or None.
        pose: three numbers [m] and three [rad], or None.
        hold: "position" or "pose", or None.
        weight: weight of the task; 1 if None.
        strict: whether it comes before the shape.

    Raises:
        InvalidValue: more than one place for the tip; a weight, or a priority, without any; other numbers.
        UnknownName: something else to hold.
    """
    from pinposture.control import EndEffector

    places = {"--tip-position": position, "--tip-pose": pose, "--hold-tip": hold}
    given = {option: text for option, text in places.items() if text is not None}
    if len(given) > 1:
        first, second, *_ = given
        raise InvalidValue(second, given[second], f"without {first}")
    options: dict[str, Any] = {"weight": 1.0 if weight is None else weight, "strict": strict}
    if position is not None:
        return EndEffector(position=_finite("--tip-position", position, "X,Y,Z"), **options)
    if pose is not None:
        return EndEffector(pose=_placement(_finite("--tip-pose", pose, "X,Y,Z,ROLL,PITCH,YAW")), **options)
    if hold is not None:
        return EndEffector.held(start, hold, **options)
    for option, value in (("--tip-weight", weight), ("--strict-tip", strict or None)):
        if value is not None:
            raise InvalidValue(option, value, f"together with one of {', '.join(places)}")
    return None


def _finite(option: str, text: str, names: str) -> list[float]:
    import numpy as np

    values = read_numbers(option, text)
    if len(values) != names.count(",") + 1 or not np.all(np.isfinite(values)):
        raise InvalidValue(option, text, f"finite numbers, {names}")
    return values


def _placement(values: list[float]) -> Any:
    import numpy as np
    import pinocchio as pin

    return pin.SE3(pin.rpy.rpyToMatrix(*values[3:]), np.array(values[:3]))


def tip_off(task: EndEffector, motion: Trajectory) -> dict[str, float | None]:
    """How far the tip is from what was asked of it, at the end of a run.

    Returns:
        "distance" [m], of a planar arm within its plane; and "turn" [rad], about axes about which the tip can
        turn, or None if no pose was asked for.
    """
    import numpy as np

    arm = motion.arm
    off = task.rows(arm.at(motion.q[-1]), motion.target).error
    turn = None if task.pose is None else float(np.linalg.norm(off[arm.dimension :])) / arm.sliding_unit
    return {"distance": float(np.linalg.norm(off[: arm.dimension])), "turn": turn}
