"""`pinposture batch`: drive an arm from many starts or to many curves, on all cores."""

from __future__ import annotations

import csv
from dataclasses import dataclass
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
    DegreesOption,
    JsonOption,
    StartOptions,
    TrackOptions,
    UrdfArgument,
    as_configuration,
    numbers_in,
    read_array,
    read_option,
)
from pinposture.cli.output import (
    FILES,
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
    starts_options: StartsOptions,
    track_options: TrackOptions,
    jobs: Annotated[
        int | None,
        MOTION(
            "Number of processes; -1 for all cores. Default: all cores for a long batch.", "N", max=MOST_JOBS
        ),
    ] = None,
    output_options: BatchOutput,
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

    track_options.controller_options.check()
    output = output_options.output
    if output_options.ends_only and output is None:
        raise InvalidValue("--ends-only", output_options.ends_only, "only with --output")
    change_options = track_options.change_options
    change_options.check("arm", "limits", "scene")
    arm = change_options.apply("arm", arm_options.read(urdf))
    limits = change_options.apply("limits", track_options.limit_options.read(arm), arm)
    surroundings = change_options.apply("scene", track_options.scene_options.read(arm))
    configurations = starts_options.read(arm, surroundings)
    targets = [track_options.placement_options.place(arm, form, surroundings) for form in curve]
    check_directory(output)
    with count_progress("run") as progress:
        batch = track_many(
            arm,
            targets,
            configurations,
            track_options.controller_options.build(),
            limits=limits,
            scene=surroundings,
            max_steps=track_options.steps,
            tolerance=read_option("--tolerance", track_options.tolerance, Length),
            jobs=jobs,
            keep="ends" if output_options.ends_only or output is None else "motions",
            progress=progress,
        )
    saved = [] if output is None else [("file", output / FILES.batch, partial(save, batch))]
    files, failure = write_files(saved)
    starts = starts_options.starts
    seed = starts_options.seed
    asked = {"urdf": urdf, "curves": curve, "starts": starts, "seed": seed}
    words = {
        name: text.replace("raise max_steps", "raise --steps") for name, text in batch.in_words().items()
    }
    drawn = starts in ("smooth", "random")
    words["starts"] = f"{starts}, seeds {seed} to {seed + len(configurations) - 1}" if drawn else starts
    blocked = _starts_in_collision(batch)
    if blocked:
        where = f"in collision in {len(blocked)} of {len(batch)} runs, run {blocked[0]} first"
        words["starts"] += f"; {where}; choose others by --starts or --seed"
    results = {"scene": track_options.scene_options.scene, **batch.summary(), "starts_in_collision": blocked}
    told = {**asked, **results, "file": files.get("file")}
    print_result(output_options.as_json, told, words, files.values(), failure)
    end_with(batch.faults)


@dataclass(frozen=True)
class StartsOptions:
    """The starts of the runs."""

    starts: Annotated[
        str,
        MOTION(
            "straight, smooth or random, or a .csv or .npy file of joint positions with a row for each "
            "start.",
            "STARTS",
        ),
    ] = "smooth"
    degrees: DegreesOption = False
    count: Annotated[
        int | None,
        MOTION("Number of starts to draw, as in track with seeds from --seed on. Default: 10.", "N"),
    ] = None
    seed: Annotated[int, MOTION("Seed of the first start.")] = 0

    def read(self, arm: Arm, scene: Scene) -> list[NDArray[np.float64]]:
        """Return the configurations; those that are drawn are clear of the scene, if possible.

        Raises:
            UnknownName: neither a kind of start nor a file.
            FileError: a file without numbers.
            InvalidValue: a count out of range, a count for a file, or a row that is invalid for the arm.
        """
        count = self.count
        if self.starts in STARTS:
            if count is not None and not 1 <= count <= MOST_RUNS:
                raise InvalidValue("--count", count, f"a whole number from 1 to {MOST_RUNS}")
            seeds = range(self.seed, self.seed + (10 if count is None else count))
            return [StartOptions(self.starts, self.degrees, seed).read(arm, scene).q for seed in seeds]
        path = Path(self.starts)
        if path.suffix.lower() not in (".csv", ".npy"):
            raise UnknownName("kind of starts", self.starts, (*STARTS, "a .csv file", "a .npy file"))
        if count is not None:
            raise InvalidValue("--count", count, "nothing if --starts is a file")
        rows = enumerate(_read_rows(path))
        return [as_configuration(arm, row, f"start {k}", self.degrees) for k, row in rows]


@dataclass(frozen=True)
class BatchOutput:
    """What is done with the batch."""

    output: Annotated[
        Path | None,
        OUTPUT(
            f"Save all runs here, in {FILES.batch}; otherwise nothing is saved.", "DIR", flags="--output -o"
        ),
    ] = None
    ends_only: Annotated[
        bool, OUTPUT("Save only how each run ended, not the motions.", flags="--ends-only")
    ] = False
    as_json: JsonOption = False


def _starts_in_collision(batch: Batch) -> list[int]:
    """Return the numbers of the runs that begin in collision, counted from 0."""
    from pinposture.collision import CollisionModel

    if batch.scene is None:
        return []
    distances = CollisionModel(batch.arm, batch.scene)
    return [k for k, q in enumerate(batch.q_start) if distances.minimum(q).distance < 0.0]


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
