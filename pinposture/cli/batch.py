"""`pinposture batch`: drive an arm from many starts, or to many curves, on all cores."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pinposture.cli.inputs import (
    MOTION,
    OUTPUT,
    STARTS,
    TARGET,
    ArmOptions,
    ControllerOptions,
    DegreesOption,
    JsonOption,
    LimitOptions,
    PlacementOptions,
    SceneOptions,
    ToleranceOption,
    UrdfArgument,
    as_configuration,
    numbers_in,
    read_start,
)
from pinposture.cli.output import BATCH, count_progress, end_with, examples, print_result
from pinposture.errors import InvalidValue, UnknownName

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pinposture.arm import Arm


@examples(
    "pinposture batch arm.urdf --curve helix --count 5",
    "pinposture batch arm.urdf --curve helix --starts random --count 5 --json",
    "pinposture batch arm.urdf --curve helix --curve line --count 1 -o out/2",
    "pinposture batch arm.urdf --curve line --jobs 2 --ends-only -o out/ends",
)
def run(
    *,
    urdf: UrdfArgument,
    arm_options: ArmOptions,
    curve: Annotated[
        list[str],
        TARGET(
            "A .json, .csv or .txt file, or a preset: line (1.1 m), helix (1.62 m). One or more.", "CURVE"
        ),
    ],
    placement_options: PlacementOptions,
    controller_options: ControllerOptions,
    starts: Annotated[
        str,
        MOTION(
            "straight, smooth or random, or a .csv or .npy file of joint positions with a row for each "
            "start.",
            "STARTS",
        ),
    ] = "smooth",
    degrees: DegreesOption = False,
    count: Annotated[
        int | None,
        MOTION("Number of starts to draw, else 10; they are those of track with seeds from --seed on.", "N"),
    ] = None,
    seed: Annotated[int, MOTION("What the first start is drawn from.")] = 0,
    steps: Annotated[int, MOTION("Number of steps after which a run stops.")] = 300,
    tolerance: ToleranceOption = None,
    limit_options: LimitOptions,
    scene_options: SceneOptions,
    jobs: Annotated[
        int | None,
        MOTION("Number of processes; -1 for all there can be, which is what a long batch gets anyway.", "N"),
    ] = None,
    output: Annotated[
        Path | None,
        OUTPUT(f"Leave all runs here, in {BATCH}; else nothing is kept.", "DIR", flags="--output -o"),
    ] = None,
    ends_only: Annotated[
        bool, OUTPUT("Leave how each run ended there, not the motions.", flags="--ends-only")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Drive an arm from many starts to the shape of a curve, or to several, and say how it went.

    There is a run for each start; several curves need as many starts, or one. Every run is the one that track
    makes of that start and curve, whatever the number of processes. Runs are counted from 0.

    With -o all runs are kept in a directory, in batch.npz: pp.load of the Python package reads it, as
    NumPy does. The exit code is 0 if the arm converged in every run without penetration, 1 if not, 2
    if it could not start.
    """
    from pinposture.motion import save, track_many
    from pinposture.storage import check_writable

    controller_options.check()
    limits = limit_options.read()
    surroundings = scene_options.read()
    arm = arm_options.read(urdf)
    configurations = _read_starts(arm, starts, count, seed, degrees)
    targets = [placement_options.place(arm, each, surroundings) for each in curve]
    if output is not None:
        if output.suffix.lower() == ".npz":
            raise InvalidValue("--output", str(output), f"a directory, in which {BATCH} is left")
        check_writable(output)
    with count_progress("run") as progress:
        batch = track_many(
            arm,
            targets,
            configurations,
            controller_options.build(),
            limits=limits,
            scene=surroundings,
            max_steps=steps,
            tolerance=tolerance,
            jobs=jobs,
            keep="ends" if ends_only or output is None else "motions",
            progress=progress,
        )
    file = None if output is None else str(save(batch, output / BATCH))
    asked = {"urdf": urdf, "curves": curve, "starts": starts, "seed": seed, "scene": scene_options.file}
    print_result(as_json, {**asked, **batch.to_dict(), "file": file}, batch.in_words(), filter(None, [file]))
    end_with(batch.faults)


def _read_starts(
    arm: Arm, text: str, count: int | None, seed: int, degrees: bool
) -> list[NDArray[np.float64]]:
    """The configurations to start from.

    Args:
        arm: the arm.
        text: a name, of which `count` are drawn, or the path of a file with a row for each.
        count: number of them to draw; None for 10, or for a file.
        seed: what to draw the first from.
        degrees: whether numbers are in degrees, where joints turn.

    Raises:
        UnknownName: neither a name nor a file.
        FileError: a file that holds no numbers.
        InvalidValue: a number of starts below 1, or for a file; a row that the arm cannot use.
    """
    if text in STARTS:
        if count is not None and count < 1:
            raise InvalidValue("--count", count, "a whole number of at least 1")
        return [read_start(arm, text, seed + k, degrees) for k in range(10 if count is None else count)]
    if Path(text).suffix.lower() not in (".csv", ".npy"):
        raise UnknownName("kind of starts", text, (*STARTS, "a .csv file", "a .npy file"))
    if count is not None:
        raise InvalidValue("--count", count, "nothing where --starts names a file")
    rows = _read_rows(Path(text))
    return [as_configuration(arm, row, f"start {k}", degrees) for k, row in enumerate(rows)]


def _read_rows(path: Path) -> list[list[float]]:
    """The rows of numbers in a file; empty lines of text do not count."""
    import numpy as np

    with numbers_in(path, "table"):
        if path.suffix.lower() == ".npy":
            stored = np.atleast_2d(np.load(path, allow_pickle=False))
            rows = [[float(value) for value in row] for row in stored]
        else:
            with path.open(encoding="utf-8-sig", newline="") as file:
                rows = [[float(field) for field in row] for row in csv.reader(file) if any(row)]
        if not rows:
            raise ValueError("it is empty")
    return rows
