"""`pinposture identify`: what drives do with their commands, from a log."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from pinposture.cli.inputs import (
    OUTPUT,
    ArmOptions,
    JsonOption,
    Panel,
    UrdfArgument,
    read_numbers,
    read_option,
)
from pinposture.cli.output import (
    Cell,
    examples,
    print_facts,
    print_json,
    print_note,
    print_table,
    words_of,
)
from pinposture.storage import write_figure

if TYPE_CHECKING:
    from pinposture.motion import Log

LOG = Panel("The log")


@examples(
    "pinposture identify arm.urdf log.csv",
    "pinposture identify arm.urdf joint_states.csv --commands commands.csv --plot fit.png",
    "pinposture identify arm.urdf recorded.mcap --commands /joint_trajectory",
    "pinposture identify arm.urdf log.csv --gravity 0,0,-9.81 --carried 0.2 --json",
)
def run(
    *,
    urdf: UrdfArgument,
    path: Annotated[
        Path,
        typer.Argument(metavar="LOG", help="A table (.csv) of positions, or of both; or a ROS 2 bag."),
    ],
    arm_options: ArmOptions,
    log_options: LogOptions,
    plot: Annotated[Path | None, OUTPUT("Save a PNG picture of the fit here.", "FILE")] = None,
    as_json: JsonOption = False,
) -> None:
    """Tell from a log what the drives of an arm do with their commands: lag, delay, friction.

    A table has a heading for each column: the time ("time", "sec" and "nanosec", or "dt"), "NAME position",
    "NAME command" and "NAME effort". Times of both tables are on one clock. Without headings, the time is the
    first or the last column.

    If gravity is given, the masses of the arm tell stiffness and payload, too. Each number is followed by the
    interval that covers the truth in 95 of 100 cases. What the log cannot tell is named, with the reason.
    """
    from pinposture.motion import identify

    arm = arm_options.read(urdf)
    log = log_options.read(path)
    result = identify(arm, log)
    if plot is not None:
        from pinposture.viz.identification import plot_identification

        write_figure(plot, plot_identification(result))
    summary = result.summary()
    if as_json:
        print_json({"file": urdf, "log": str(path), **summary, "plot": None if plot is None else str(plot)})
    else:
        print_facts(words_of(summary))
        rows: list[list[Cell]] = []
        for name, drive in result.joints.items():
            numbers = (drive.lag, drive.delay, drive.friction, drive.stiffness, drive.gain)
            told = [None if number is None else number.value for number in numbers]
            rows.append([name, *told, drive.explained, drive.rest])
        if rows:
            headings = ("joint", "lag", "delay", "friction", "stiffness", "gain", "explained", "rest")
            print_table(headings, rows)
        for name, why in result.not_identified.items():
            print_note(f"not identified: {name}: {why}")
    if plot is not None:
        print_note(f"wrote {plot}")


@dataclass(frozen=True)
class LogOptions:
    """What a log is, and what is known of the arm in it."""

    commands: Annotated[
        str | None,
        LOG("The table of commands, if LOG has only positions; of a bag, their topic.", "FILE|TOPIC"),
    ] = None
    joints: Annotated[
        str | None,
        LOG("Joints of the columns of a table without headings; default: those of the arm.", "NAME,..."),
    ] = None
    degrees: Annotated[bool, LOG("Angles are in degrees.", flags="--degrees")] = False
    gravity: Annotated[
        str | None,
        LOG("Gravity in the world frame of the arm, in m/s2: 0,0,-9.81. Default: unknown.", "X,Y,Z"),
    ] = None
    carried: Annotated[
        str | None,
        LOG(
            "What the arm carried at its tip, in kg or with a unit; 0 for nothing. Default: unknown.", "MASS"
        ),
    ] = None
    in_contact: Annotated[
        bool, LOG("The arm touched something, such as the ground.", flags="--in-contact")
    ] = False

    def read(self, path: Path) -> Log:
        """Return the log.

        Raises:
            PostureError: as `Log.read`; or an option that is no number.
        """
        from pinposture.arm.weight import Mass
        from pinposture.motion import Log

        names = () if self.joints is None else [name.strip() for name in self.joints.split(",")]
        return Log.read(
            path,
            self.commands,
            names,
            gravity=None if self.gravity is None else read_numbers("--gravity", self.gravity),
            payload=read_option("--carried", self.carried, Mass),
            in_contact=self.in_contact,
            **({"degrees": True} if self.degrees else {}),
        )
