"""`pinposture batch`: drive an arm from many starts or to many curves, on all cores."""

from __future__ import annotations

import csv
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pinposture.cli.inputs import (
    CURVE_HELP,
    MOST_JOBS,
    MOST_RUNS,
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
    read_array,
    read_option,
    read_start,
)
from pinposture.cli.output import (
    BATCH,
    check_directory,
    count_progress,
    end_with,
    examples,
    print_result,
    write_files,
)
from pinposture.errors import InvalidValue, UnknownName
from pinposture.storage import read_text

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

    from pinposture.arm import Arm
    from pinposture.collision import Scene
    from pinposture.motion import Batch


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
        TARGET(f"{CURVE_HELP} One or more.", "CURVE"),
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
        MOTION("Number of starts to draw, as in track with seeds from --seed on. Default: 10.", "N"),
    ] = None,
    seed: Annotated[int, MOTION("Seed of the first start.")] = 0,
    steps: Annotated[
        int | None,
        MOTION(
            "Steps after which a run stops. Default: 300; with --dt, if that is more, ten times those "
            "of the straight path in joint space.",
            "N",
        ),
    ] = None,
    tolerance: ToleranceOption = None,
    limit_options: LimitOptions,
    scene_options: SceneOptions,
    jobs: Annotated[
        int | None,
        MOTION(
            "Number of processes; -1 for all cores. Default: all cores for a long batch.", "N", max=MOST_JOBS
        ),
    ] = None,
    output: Annotated[
        Path | None,
        OUTPUT(f"Save all runs here, in {BATCH}; otherwise nothing is saved.", "DIR", flags="--output -o"),
    ] = None,
    ends_only: Annotated[
        bool, OUTPUT("Save only how each run ended, not the motions.", flags="--ends-only")
    ] = False,
    as_json: JsonOption = False,
) -> None:
    """Drive an arm from many starts to the shape of one or more curves, and report the results.

    There is one run per start; several curves need as many starts, or one. Each run is the same as that of
    track with this start and curve, for any number of processes. Runs are counted from 0.

    With -o all runs are saved in a directory, in batch.npz, which pp.load of the Python package and NumPy can
    read. The exit code is 0 if every run converged without penetration, 1 if not, 2 if it could not start or
    be saved.
    """
    from pinposture.motion import save, track_many
    from pinposture.schema import Length

    controller_options.check()
    if ends_only and output is None:
        raise InvalidValue("--ends-only", ends_only, "only with --output")
    arm = arm_options.read(urdf)
    limits = limit_options.read(arm)
    surroundings = scene_options.read(arm)
    configurations = _read_starts(arm, starts, count, seed, degrees, surroundings)
    targets = [placement_options.place(arm, each, surroundings) for each in curve]
    check_directory(output)
    with count_progress("run") as progress:
        batch = track_many(
            arm,
            targets,
            configurations,
            controller_options.build(),
            limits=limits,
            scene=surroundings,
            max_steps=steps,
            tolerance=read_option("--tolerance", tolerance, Length),
            jobs=jobs,
            keep="ends" if ends_only or output is None else "motions",
            progress=progress,
        )
    files, failure = write_files([] if output is None else [("file", output / BATCH, partial(save, batch))])
    asked = {"urdf": urdf, "curves": curve, "starts": starts, "seed": seed, "scene": scene_options.file}
    words = {
        name: text.replace("raise max_steps", "raise --steps") for name, text in batch.in_words().items()
    }
    drawn = starts in ("smooth", "random")
    words["starts"] = f"{starts}, seeds {seed} to {seed + len(configurations) - 1}" if drawn else starts
    blocked = _starts_in_collision(batch)
    if blocked:
        where = f"in collision in {len(blocked)} of {len(batch)} runs, run {blocked[0]} first"
        words["starts"] += f"; {where}; choose others by --starts or --seed"
    results = {**batch.summary(), "starts_in_collision": blocked, "file": files.get("file")}
    print_result(as_json, {**asked, **results}, words, files.values(), failure)
    end_with(batch.faults)


def _starts_in_collision(batch: Batch) -> list[int]:
    """Return the numbers of the runs that begin in collision, counted from 0."""
    from pinposture.collision import CollisionModel

    if batch.scene is None:
        return []
    distances = CollisionModel(batch.arm, batch.scene)
    return [k for k, q in enumerate(batch.q_start) if distances.minimum(q).distance < 0.0]


def _read_starts(
    arm: Arm, text: str, count: int | None, seed: int, degrees: bool, scene: Scene
) -> list[NDArray[np.float64]]:
    """Return the start configurations.

    Args:
        arm: the arm.
        text: a kind of start, of which `count` are drawn, or the path of a file with a row per start.
        count: number of starts to draw; None: 10, or all rows of a file.
        seed: seed of the first start.
        degrees: whether numbers for revolute joints are in degrees.
        scene: what drawn starts must be clear of, if possible.

    Raises:
        UnknownName: neither a kind of start nor a file.
        FileError: a file without numbers.
        InvalidValue: a count out of range, a count for a file, or a row that is invalid for the arm.
    """
    if text in STARTS:
        if count is not None and not 1 <= count <= MOST_RUNS:
            raise InvalidValue("--count", count, f"a whole number from 1 to {MOST_RUNS}")
        seeds = range(seed, seed + (10 if count is None else count))
        return [read_start(arm, text, each, degrees, scene).q for each in seeds]
    if Path(text).suffix.lower() not in (".csv", ".npy"):
        raise UnknownName("kind of starts", text, (*STARTS, "a .csv file", "a .npy file"))
    if count is not None:
        raise InvalidValue("--count", count, "nothing if --starts is a file")
    rows = _read_rows(Path(text))
    return [as_configuration(arm, row, f"start {k}", degrees) for k, row in enumerate(rows)]


def _read_rows(path: Path) -> list[list[float]]:
    """Return the rows of numbers in a file; empty lines of text are skipped."""
    import numpy as np

    with numbers_in(path, "table"):
        if path.suffix.lower() == ".npy":
            rows = [[float(value) for value in row] for row in np.atleast_2d(read_array(path))]
        else:
            lines = csv.reader(read_text(path).splitlines())
            rows = [[float(field) for field in row] for row in lines if any(row)]
        if not rows:
            raise ValueError("it is empty")
    return rows
