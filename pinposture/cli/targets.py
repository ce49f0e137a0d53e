"""The target on the command line: a curve, how it is laid, and which control points are to follow it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Literal, cast

import typer

from pinposture.cli.inputs import TARGET, read_curve
from pinposture.cli.output import print_note
from pinposture.cli.points import read_region
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from pinposture.arm import Arm
    from pinposture.collision import Scene
    from pinposture.placement import Target

CurveOption = Annotated[
    str,
    typer.Option(
        metavar="CURVE",
        help="A .json, .csv or .txt file, or a preset: line (1.1 m), helix (1.62 m).",
        rich_help_panel=TARGET,
    ),
]
PlacementOption = Annotated[
    str | None,
    typer.Option(
        metavar="NAME",
        help="How the curve is laid: as_is, translate (to the base) or align (turned to the arm too); else "
        "as_is among obstacles, and align without.",
        rich_help_panel=TARGET,
    ),
]
RollOption = Annotated[
    float,
    typer.Option(help="Turn of an aligned curve about the axis of the arm, in rad.", rich_help_panel=TARGET),
]
MethodOption = Annotated[
    str,
    typer.Option(
        metavar="NAME",
        help="How modules are placed: sequential (one by one, exactly), smooth (all at once, bending "
        "little), closest (all at once), or auto.",
        rich_help_panel=TARGET,
    ),
]
PartialOption = Annotated[
    bool,
    typer.Option(
        "--partial", help="Leave points free that have no place on the curve.", rich_help_panel=TARGET
    ),
]
RegionOption = Annotated[
    str | None,
    typer.Option(
        metavar="FIRST-LAST",
        help="Control points that are to take the shape, as in 10-20; the others are free.",
        rich_help_panel=TARGET,
    ),
]


def read_target(
    arm: Arm,
    curve: str,
    placement: str | None,
    roll: float,
    method: str,
    partial: bool,
    region: str | None,
    scene: Scene | None,
) -> Target:
    """Place the control points on a curve as these options ask; say on stderr if some have no place.

    Raises:
        PostureError: as `read_curve`, `resolve_targets` and `read_region`.
        InvalidValue: a curve on which not even the first module has a place.
    """
    from pinposture.placement import resolve_targets
    from pinposture.task.keyframe import usual_placement

    placement = usual_placement(scene) if placement is None else placement
    target = resolve_targets(
        arm,
        read_curve(curve),
        placement=cast(Literal["as_is", "translate", "align"], placement),  # checked there
        roll=roll,
        incomplete="partial" if partial else "raise",
        method=cast(Literal["auto", "sequential", "smooth", "closest"], method),
    )
    if not target.placed.any():
        raise InvalidValue("--curve", curve, f"one with a place for the first module: {target.incomplete}")
    chosen = target if region is None else target.region(*read_region("--region", region, arm))
    if target.incomplete:
        print_note(f"only the first {target.placed.sum()} of {arm.n_modules} control points have a place")
    return chosen
