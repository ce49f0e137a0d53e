"""The verbs `study ...`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinposture.cli.inputs import (
    ARM,
    MOST_RUNS,
    MOTION,
    OUTPUT,
    ArmOptions,
    ControllerOption,
    JobsOption,
    JsonOption,
    read_numbers,
)
from pinposture.cli.output import (
    Cell,
    check_directory,
    count_progress,
    examples,
    print_json,
    print_note,
    print_table,
    print_warning,
)
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from benchmarks.studies.arms import ArmSurvey, Subject
    from benchmarks.studies.record import Record, Spread
    from benchmarks.studies.scenes import SceneRun


ArmsOption = Annotated[str | None, ARM("Built-in arms: ryrz20, planar45.", "NAME,...")]
ControllersOption = Annotated[str | None, MOTION("Controllers to compare.", "NAME,...")]
SeedOption = Annotated[int, MOTION("First seed.", "N", flags="--seed0")]

Columns = Mapping[str, Callable[[Any], Cell]]
"""The headings of a table, and functions of a row that return the cells below them."""

Table = tuple[Sequence[str], Sequence[Sequence[Cell]]]


@dataclass(frozen=True)
class ShowOptions:
    """Options for running and showing a study."""

    jobs: JobsOption = 1
    as_json: JsonOption = False

    def run(self, noun: str, study: Callable[..., Any], *given: Any) -> Any:
        """Run a study with a progress bar that counts its runs under the given noun."""
        with count_progress(noun) as progress:
            return study(*given, jobs=self.jobs, progress=progress)

    def show(self, found: Mapping[str, Any], tables: Iterable[Table]) -> None:
        """Print the results, as one JSON object or as tables."""
        if self.as_json:
            print_json(found)
            return
        for headings, rows in tables:
            print_table(headings, rows)


@dataclass(frozen=True)
class KeepOptions(ShowOptions):
    """Options of a study whose runs can be saved."""

    output: Annotated[
        Path | None,
        OUTPUT(
            "Save a row for each run (cases.csv), the summary (summary.json) and any pictures here.",
            "DIR",
            flags="--output -o",
        ),
    ] = None

    def run(self, noun: str, study: Callable[..., Any], *given: Any) -> Any:
        """Check that the directory is writable, then run the study."""
        check_directory(self.output)
        return super().run(noun, study, *given)

    @contextmanager
    def keeping(
        self, runs: Sequence[Any], found: Mapping[str, Any], **pictures: Callable[[Any], Figure]
    ) -> Iterator[None]:
        """Save the runs, the results, and pictures of the runs in the directory, even if printing fails."""
        from benchmarks.studies.record import keep_study

        try:
            yield
        finally:
            if self.output is not None:
                figures = {f"{name}.png": draw(runs) for name, draw in pictures.items()}
                for file in keep_study(self.output, runs, found, figures, type(runs[0])._fields):
                    print_note(f"wrote {file}")


def _table(columns: Columns, rows: Iterable[Any]) -> Table:
    return tuple(columns), [[cell(row) for cell in columns.values()] for row in rows]


def _json_rows(rows: Iterable[Any]) -> list[dict[str, Any]]:
    """Return the rows of a table as JSON-compatible data."""
    return [
        {name: value._asdict() if hasattr(value, "_asdict") else value for name, value in each.items()}
        for each in (row._asdict() for row in rows)
    ]


def _spread(name: str, form: str) -> Callable[[Any], Cell]:
    """Return a function of a row that formats median (90th percentile) of a quantity, if present."""

    def cell(row: Any) -> Cell:
        spread: Spread | None = getattr(row, name)
        return None if spread is None else f"{spread.median:{form}} ({spread.high:{form}})"

    return cell


def _share(value: float) -> str:
    """Format a share in percent, rounded down, so that 100 % means all."""
    return f"{int(1000.0 * value + 1e-9) / 10.0:g} %"


def _short(value: float | None) -> str | None:
    return None if value is None else f"{value:.2g}"


def _split(option: str, text: str | None, usual: Iterable[str]) -> list[str]:
    """Return names separated by commas, each once, or the default ones; raise InvalidValue otherwise."""
    if text is None:
        return list(usual)
    names = [name.strip() for name in text.split(",")]
    if not all(names) or len(set(names)) < len(names):
        raise InvalidValue(option, text, "names separated by commas, each once")
    return names


def _built(names: str | None) -> list[Subject]:
    """Return the built-in arms of these names, or all."""
    from benchmarks.studies.arms import BUILT, built_subject

    return [built_subject(name) for name in _split("--arms", names, BUILT)]


def _warn_of_refusals(records: list[Record]) -> None:
    """Warn of controllers that refused to start, with the count and the first reason."""
    from benchmarks.studies.record import grouped

    refused = (record for record in records if record.status == "refused")
    for controller, those in grouped(refused, lambda record: record.controller).items():
        print_warning(f"{controller} refused {len(those)} of its runs: {those[0].reason}")


AS_CLOSE = 1.05
"""Maximum ratio of the residual of a good placement to that of the reference."""

RESIDUAL_ROUNDING = 1e-6
"""Tolerance of residuals, relative to the arm length: sampling of the curve, rounding errors."""

_ARM_COLUMNS: Columns = {
    "file": lambda row: row.file,
    "joints": lambda row: row.joints,
    "modules": lambda row: compressed(row.modules),
    "kind": lambda row: "planar" if row.dimension == 2 else "spatial",
    "length [m]": lambda row: row.length,
    "placed by": lambda row: row.method.partition(":")[0] + (" (partial)" if ":" in row.method else ""),
    "residual": lambda row: _short(row.residual),
    "reference": lambda row: _short(row.reference),
    "ratio": lambda row: "ok" if _is_close(row) else _short(_ratio(row)),
    "farthest": lambda row: _short(row.farthest),
    "joint": lambda row: _short(row.reached),
    "Switching": lambda row: _short(row.switching),
    "geodesic": lambda row: _short(row.geodesic),
    "geodesic steps": lambda row: row.geodesic_steps if row.geodesic is not None else None,
    "geodesic paths": lambda row: _short(row.path_length_ratio),
    "limits held": lambda row: "yes" if row.within_limits else "no",
}
_REFUSED_COLUMNS: Columns = {"file": lambda row: row.file, "outcome": lambda row: f"refused: {row.refused}"}


@examples(
    "make study STUDY=arms -- urdf/",
    "make study STUDY=arms -- urdf/ --least-joints 8 --seed 1 --jobs 4",
    "make study STUDY=arms -- urdf/ --json",
    "make study STUDY=arms",
)
def run_arms(
    *,
    directory: Annotated[
        Path | None,
        typer.Argument(
            metavar="[DIRECTORY]",
            help="Where to search for .urdf files, at any depth; default: built-in arms of unusual shapes.",
        ),
    ] = None,
    least_joints: Annotated[int, ARM("Skip arms with fewer moving joints.", "N")] = 5,
    seed: Annotated[int, MOTION("Seed of the starts.")] = 0,
    options: ShowOptions,
) -> None:
    """Test every arm of a directory: place it on a gentle curve, and drive it there.

    Without a directory, arms of unusual shapes are tested: joints that do not repeat, long rows of parallel
    axes, a tip beside the plane of the arm, no limits, a base that slides within limits of 1e6 m.

    Distances are relative to the arm length. The residual is the distance of the placed control points from
    the curve (root mean square), the reference that of the best of several independent fits; their ratio is
    ok up to 1.05 (plus 1e-6). Farthest is the largest distance of the whole arm, including its links, from
    the curve. The next columns are the mean point errors that joint interpolation, Switching and geodesic,
    the default controller, reach from a random start; the number of steps of geodesic, and its path length of
    control points relative to straight lines; and whether all three kept the joint limits.
    """
    from benchmarks.studies.arms import survey_arms

    if seed < 0:
        raise InvalidValue("--seed", seed, "a whole number of at least 0")
    results = survey_arms(directory, least_joints, seed, options.jobs, _report)
    found = {
        "directory": None if directory is None else str(directory),
        "least_joints": least_joints,
        "seed": seed,
        "arms": [{**each._asdict(), "ratio": _ratio(each), "ok": _is_close(each)} for each in results],
    }
    tried = [each for each in results if not each.refused]
    refused = [each for each in results if each.refused]
    tables = ((_ARM_COLUMNS, tried), (_REFUSED_COLUMNS, refused))
    options.show(found, [_table(columns, rows) for columns, rows in tables if rows])
    if not results and not options.as_json:
        print_note(f"no arm of at least {least_joints} moving joints")


def _report(result: ArmSurvey) -> None:
    """Report a finished file on stderr, with the warnings of loading and the reason for unplaced modules."""
    print_note(f"{result.file}: {'refused' if result.refused else 'done'}")
    unplaced = result.method.partition(": ")[2]
    for note in (*result.notes, *filter(None, [unplaced])):
        print_warning(f"{result.file}: {note}")


def _is_close(result: ArmSurvey) -> bool | None:
    """Return whether an arm is placed about as close to the curve as possible; None if it was not placed."""
    if result.residual is None or result.reference is None:
        return None
    return result.residual <= AS_CLOSE * result.reference + RESIDUAL_ROUNDING


def _ratio(result: ArmSurvey) -> float | None:
    """Return the residual relative to the reference, both at least the rounding tolerance."""
    if result.residual is None or result.reference is None:
        return None
    return max(result.residual, RESIDUAL_ROUNDING) / max(result.reference, RESIDUAL_ROUNDING)


def compressed(sizes: tuple[int, ...]) -> str:
    """Format numbers of joints, with repetitions combined: "2 x 8", "2, 2, 3", "1 x 18, 2"."""
    runs = [[str(size) for size in same] for _, same in groupby(sizes)]
    return ", ".join(f"{run[0]} x {len(run)}" if len(run) > 2 else ", ".join(run) for run in runs)


_METHOD_COLUMNS: Columns = {
    "method": lambda row: row.controller,
    "posture error": lambda row: _short(row.posture_error),
    "tip error": lambda row: _short(row.end_effector_error),
    "reached": lambda row: f"{100 * row.reached:.0f} %",
    "returned [rad]": lambda row: _short(row.returned),
}


def _peak(place: int) -> Callable[[Any], Cell]:
    return lambda row: _short(row.peaks[place])


@examples(
    "make study STUDY=methods -- --seeds 5",
    "make study STUDY=methods -- arm.urdf --controllers switching,lm,dls --jobs 2",
    "make study STUDY=methods -- --seeds 5 --json",
)
def run_methods(
    *,
    urdf: Annotated[
        str | None,
        typer.Argument(metavar="[URDF]", help="URDF file of an arm, or -; default: 20 RyRz modules, 1 m."),
    ] = None,
    arm_options: ArmOptions,
    controllers: Annotated[str | None, ARM("Methods to compare; default: all.", "NAME,...")] = None,
    seeds: Annotated[int, MOTION("Number of cases for each method.", "N", max=MOST_RUNS)] = 20,
    steps: Annotated[int, MOTION("Steps of each way.", "N")] = 200,
    options: ShowOptions,
) -> None:
    """Compare every method on the same arm: errors, peak joint motions, and repeatability.

    Runs go from smooth random starts to smooth random targets and back; values are medians over the cases.
    Errors are relative to the arm length; reached is the share of cases with a final mean point error below
    1e-3 of it. Returned is the largest distance of a joint from its start after the return. The peaks are the
    largest joint motion that a step without limits requests for an error of one arm length, at a distance of
    0.1 to 1e-5 rad from the straight arm: unbounded growth means instability near singular postures.
    """
    from benchmarks.baselines import register_baselines
    from benchmarks.studies.arms import built_subject
    from benchmarks.studies.methods import DISTANCES, compare_methods
    from pinposture.control import CONTROLLERS

    for option, value in (("--seeds", seeds), ("--steps", steps)):
        if value < 1:
            raise InvalidValue(option, value, "a whole number of at least 1")
    register_baselines()
    names = list(CONTROLLERS) if controllers is None else [name.strip() for name in controllers.split(",")]
    arm = built_subject("ryrz20").arm if urdf is None else arm_options.read(urdf)
    results = compare_methods(
        arm, names, range(seeds), steps, options.jobs, lambda result: print_note(f"{result.controller}: done")
    )
    asked = {"arm": arm.model.name, "seeds": seeds, "steps": steps, "distances": list(DISTANCES)}
    peaks = {f"peak at {DISTANCES[k]:g}": _peak(k) for k in range(0, len(DISTANCES), 2)}
    columns = {**_METHOD_COLUMNS, **peaks}
    options.show({**asked, "methods": [each._asdict() for each in results]}, [_table(columns, results)])


_POSTURE_COLUMNS: Columns = {
    "runs": lambda row: row.runs,
    "controller": lambda row: row.controller,
    "< 1e-6": lambda row: _share(row.arrived),
    "< 1e-3": lambda row: _share(row.near),
    "steps": _spread("steps", ".0f"),
    "rising": _spread("rising", ".1%"),
    "escaping": _spread("escaping", ".1%"),
    "peak": _spread("peak", ".2f"),
    "path": _spread("path", ".2f"),
    "limits held": lambda row: "yes" if row.lawful else "no",
}


@examples(
    "make study STUDY=postures -- --cases 38 --arms ryrz20",
    "make study STUDY=postures -- --controllers switching,lm --families --jobs 2",
    "make study STUDY=postures -- --urdf arm.urdf --cases 20 --json",
    "make study STUDY=postures -- --jobs -1 -o out/postures",
)
def run_postures(
    *,
    arms: ArmsOption = None,
    urdf: Annotated[str | None, ARM("URDF file of another arm, or -.", "FILE")] = None,
    arm_options: ArmOptions,
    controllers: ControllersOption = None,
    cases: Annotated[int, MOTION("Number of cases for each arm.", "N", max=MOST_RUNS)] = 1000,
    seed0: SeedOption = 0,
    families: Annotated[bool, OUTPUT("A row for each family.", flags="--families")] = False,
    options: KeepOptions,
) -> None:
    """Drive arms from every kind of start to every kind of target, and compare how controllers reach them.

    The arms are 20 RyRz modules, 1 m, and 45 joints in a plane with a control point at every second. Starts
    are smooth, harsh (each joint independently within 0.6 or 1.5 rad), straight, or 1e-3 off straight;
    targets are the helix and the line of the thesis, the straight arm folded back on itself, and random
    postures. Loaded arms go to a gentle curve and random postures. At most 400 steps of 0.1 rad per joint.

    The first two columns are the shares of runs with a final mean point error below 1e-6 and 1e-3 of the arm
    length. The others cover the runs that moved and came below 1e-3: median (90th percentile) of the number
    of steps, the share of steps in which the posture error rises, the share in which the controller allows
    it to rise, the highest posture error relative to the first, and the path length of the control points
    relative to straight lines. 1000 cases with six controllers take five minutes per arm on two processes.
    """
    from benchmarks.studies.arms import loaded_subject
    from benchmarks.studies.pictures import draw_postures
    from benchmarks.studies.postures import COMPARED, study_postures
    from benchmarks.studies.record import summarise

    if urdf is None:
        arm_options.refuse("only together with --urdf")
        subjects = _built(arms)
    elif arms is not None:
        raise InvalidValue("--arms", arms, "nothing if --urdf is given")
    else:
        subjects = [loaded_subject(arm_options.read(urdf))]
    names = _split("--controllers", controllers, COMPARED)
    records = options.run("case", study_postures, subjects, names, cases, seed0)
    rows = summarise(records, families)
    asked = {"study": "postures", "cases": cases, "seed0": seed0, "controllers": names}
    found = {**asked, "rows": _json_rows(rows)}
    tables = []
    for subject in subjects:
        own = [row for row in rows if row.arm == subject.name]
        headings, lines = _table(_POSTURE_COLUMNS, own)
        before = ["", *(row.group for row in own)]
        named = ["" if row.group == last else row.group for row, last in zip(own, before, strict=False)]
        tables.append(((subject.name, *headings), [(n, *line) for n, line in zip(named, lines, strict=True)]))
    with options.keeping(records, found, postures=draw_postures):
        options.show(found, tables)
        _warn_of_refusals(records)


@examples(
    "make study STUDY=headings -- --pairs 50 --arms planar45",
    "make study STUDY=headings -- --controllers switching,lm --target curve",
    "make study STUDY=headings -- --pairs 20 --json",
    "make study STUDY=headings -- --jobs -1 -o out/headings",
)
def run_headings(
    *,
    arms: ArmsOption = None,
    controllers: ControllersOption = None,
    target: Annotated[
        str,
        MOTION("Definition of the target: its configuration, or the curve through its points.", "KIND"),
    ] = "configuration",
    pairs: Annotated[int, MOTION("Number of pairs for each arm.", "N", max=MOST_RUNS)] = 300,
    seed0: SeedOption = 0,
    options: KeepOptions,
) -> None:
    """Drive arms between random smooth postures, and count successes by how far the arm must turn.

    The change of heading of a link accumulates from the base along the arm, including full turns; for a
    module of a spatial arm likewise, from the rotations between the changes of neighbours. Bins are of its
    largest value along the arm: beyond pi, a controller that knows only the control points turns the short
    way round, and kinks the arm. Counted, out of all, are the runs with a final mean point error below 1e-3
    of the arm length that never left the limits; then follows the median path length of the control points
    relative to straight lines, of the runs that moved and came near. At most 400 steps of 0.1 rad per joint.
    """
    from benchmarks.studies.pictures import draw_headings
    from benchmarks.studies.postures import BINS, COMPARED, Bin, by_heading, study_headings
    from benchmarks.studies.record import grouped

    subjects, names = _built(arms), _split("--controllers", controllers, COMPARED)
    records = options.run("pair", study_headings, subjects, names, pairs, seed0, target)
    bins = by_heading(records)
    asked = {"study": "headings", "target": target, "pairs": pairs, "seed0": seed0, "controllers": names}
    found = {**asked, "bins": _json_rows(bins)}

    def cell(each: Bin) -> str:
        counted = f"{each.reached}/{each.runs}"
        return counted if each.path is None else f"{counted}, path {each.path.median:.2f}"

    tables = []
    for arm, own in grouped(bins, lambda each: each.arm).items():
        lines = grouped(own, lambda each: each.controller).items()
        rows = [(controller, *map(cell, those)) for controller, those in lines]
        tables.append(((arm, *(f"{name} rad" for name in BINS)), rows))
    with options.keeping(records, found, headings=draw_headings):
        options.show(found, tables)
        _warn_of_refusals(records)


_SCENE_COLUMNS: Columns = {
    "scene": lambda row: row.scene,
    "runs": lambda row: row.runs,
    "reached": lambda row: f"{row.reached} of {row.reachable}",
    "margin kept": lambda row: f"{row.kept} of {row.runs}",
    "room [mm]": lambda row: f"{1e3 * row.room:.2f}",
    "steps": _spread("steps", ".0f"),
    "path": _spread("path", ".2f"),
    "escaping": _spread("escaping", ".0%"),
    "time [s]": _spread("seconds", ".1f"),
}


@examples(
    "make study STUDY=scenes -- --scenes post,wall,inside",
    "make study STUDY=scenes -- --seeds 2 --json",
    "make study STUDY=scenes -- --jobs -1 -o out/scenes",
)
def run_scenes(
    *,
    scenes: Annotated[
        str | None,
        MOTION("Some of: post, slot, narrow, wall, pipe, inside, coil, out; else all.", "NAME,..."),
    ] = None,
    seeds: Annotated[int, MOTION("Number of runs in each scene.", "N", max=MOST_RUNS)] = 10,
    seed0: SeedOption = 0,
    options: KeepOptions,
) -> None:
    """Drive 20 RyRz modules, 1 m, among obstacles, and report clearance and success.

    The arm goes round a post; threads a slot of 20 cm in a wall, and a narrow one of 12 cm; unfolds close to
    a wall; reaches through a pipe and hooks back beside it; is sent into a ball, before which it must stop;
    turns a coil into its mirror image without touching itself; and leaves a ball in which it starts. Each
    seed slightly varies start and target; draws without the required clearance are rejected. At most 0.1 rad
    per step and joint, and 400 steps.

    Room is the smallest distance, checked at ten points of every step, minus the margin, in the worst run;
    negative if the arm starts in collision. Such a run keeps its margin if the arm never goes deeper, gets
    out, and keeps the margin from then on. The last four columns are median (90th percentile) of the number
    of steps, the path length of the control points relative to straight lines, the share of steps in which
    the error may rise, and the run time. Runs with faults are listed individually. The study takes about ten
    minutes on two processes.
    """
    from benchmarks.studies.scenes import SITUATIONS, by_scene, study_scenes

    names = _split("--scenes", scenes, SITUATIONS)
    runs = options.run("run", study_scenes, names, seeds, seed0)
    rows = by_scene(runs)
    found = {"study": "scenes", "scenes": names, "seeds": seeds, "seed0": seed0, "rows": _json_rows(rows)}
    refused = [f"{row.scene} {row.refused}" for row in rows if row.refused]
    with options.keeping(runs, found):
        options.show(found, [_table(_SCENE_COLUMNS, rows)])
        if refused:
            print_note(f"starts and targets drawn and rejected: {', '.join(refused)}")
        for each in runs:
            if not each.as_it_should:
                print_warning(f"{each.scene}, seed {each.seed}: {_fault(each)}")


def _fault(run: SceneRun) -> str:
    """Describe the faults of a run."""
    faults = []
    if run.loss > 0.0 and not run.kept:
        faults.append(f"came {1e3 * run.loss:.3g} mm closer than it may")
    elif not run.kept:
        faults.append(f"ended {1e3 * run.end:.3g} mm apart, within the margin")
    if run.reached != run.reachable:
        faults.append(f"{'did not reach' if run.reachable else 'reached'} its target ({run.status})")
    if not run.explained:
        faults.append(f"names nothing that was in the way ({run.reason})")
    return "; ".join(faults)


_CLUTTER_COLUMNS: Columns = {
    "kind": lambda row: row.kind,
    "planned": lambda row: f"{row.planned} of {row.problems}",
    "reached": lambda row: f"{row.reached} of {row.problems}",
    "room [mm]": lambda row: f"{1e3 * row.clearance:.2f}",
    "planning [s]": _spread("plan_time", ".2f"),
    "path": _spread("path_length_ratio", ".2f"),
    "found by": lambda row: ", ".join(f"{name} {count}" for name, count in row.found_by.items()),
}


@examples(
    "make study STUDY=clutter -- --kinds hole,shelf --seeds 3",
    "make study STUDY=clutter -- --seeds 50 --jobs -1 -o out/clutter",
)
def run_clutter(
    *,
    kinds: Annotated[
        str | None,
        MOTION(
            "Some of: balls, posts, hole, two-walls, shelf, corner, pipe, machine, coil; else all.",
            "NAME,...",
        ),
    ] = None,
    seeds: Annotated[int, MOTION("Number of problems of each kind.", "N", max=MOST_RUNS)] = 10,
    seed0: SeedOption = 0,
    options: KeepOptions,
) -> None:
    """Plan and run motions of 20 RyRz modules, 1 m, past obstacles.

    40 balls; 30 posts; a hole of 15 cm in a wall; two walls with offset holes; a shelf with 16 bays; a narrow
    corner; a pipe with two bends; a scanned machine with a hole in front; the arm itself, coiled. Start and
    goal are drawn until they are clear, by code that does not plan. A third of the starts are inside the
    hole, the pipe or the machine.

    Room is the smallest distance in runs that reached the goal, every 0.01 rad, minus the margin. Planning
    time and path length ratio of the plans are median (90th percentile). Unsolved problems are listed. With
    -o, an animation of the first problem of each kind is also saved.
    """
    from benchmarks.studies.clutter import KINDS_OF_CLUTTER, by_kind, draw_problem, run_problem, study_clutter
    from benchmarks.studies.pictures import draw_clutter
    from benchmarks.studies.scenes import situation_arm
    from pinposture.viz import save_html

    names = _split("--kinds", kinds, KINDS_OF_CLUTTER)
    runs = options.run("problem", study_clutter, names, seeds, seed0)
    rows = by_kind(runs)
    asked = {"study": "clutter", "kinds": names, "seeds": seeds, "seed0": seed0}
    found = {**asked, "rows": [row._asdict() for row in rows]}
    arm, folder = situation_arm(), options.output
    shown = (
        {} if folder is None else {each: run_problem(arm, draw_problem(arm, each, seed0)) for each in names}
    )
    with options.keeping(runs, found, clutter=lambda _: draw_clutter(shown)):
        options.show(found, [_table(_CLUTTER_COLUMNS, rows)])
        for each in runs:
            if not each.reached:
                print_warning(f"{each.kind}, seed {each.seed}: {each.hindrance or each.reason}")
    for name, run in shown.items():
        print_note(f"wrote {save_html(arm, run, (folder or Path()) / f'{name}.html')}")


@examples(
    "make study STUDY=cycles -- --arms ryrz20 --cycles 3",
    "make study STUDY=cycles -- --rounds 10 --jobs 2",
    "make study STUDY=cycles -- --cycles 2 --json",
)
def run_cycles(
    *,
    arms: ArmsOption = None,
    controller: ControllerOption = "geodesic",
    cycles: Annotated[int, MOTION("Number of cycles for each arm and knowledge.", "N", max=MOST_RUNS)] = 10,
    rounds: Annotated[int, MOTION("Rounds of each cycle.", "N", max=MOST_RUNS)] = 5,
    seed0: SeedOption = 0,
    options: ShowOptions,
) -> None:
    """Repeat closed cycles of four random smooth postures, and report the drift of the joints.

    The first round begins in the last posture. Drift is the largest distance of a joint from its start after
    each round [rad], in the worst cycle. Postures are defined by their configurations, or only by their
    control points. At most 0.1 rad per step and joint, and 400 steps from one posture to the next, until the
    mean point error is below 1e-9 of the arm length.
    """
    from benchmarks.studies.cycles import CLOSE, CYCLE_KNOWLEDGE, study_cycles
    from benchmarks.studies.record import grouped

    given = _built(arms), CYCLE_KNOWLEDGE, controller, cycles, rounds, seed0
    found = options.run("cycle", study_cycles, *given)
    lines = []
    for (arm, known), own in grouped(found, lambda each: (each.arm, each.target)).items():
        taken = f"all in {sum(each.error <= CLOSE for each in own)} of {len(own)}"
        worst = [max(drifts) for drifts in zip(*(each.drift for each in own), strict=True)]
        lines.append((arm, known, len(own), taken, *map(_short, worst)))
    headings = [f"round {number + 1}" for number in range(rounds)]
    asked = {"study": "cycles", "controller": controller, "cycles": cycles, "rounds": rounds, "seed0": seed0}
    options.show(
        {**asked, "runs": [each._asdict() for each in found]},
        [(("arm", "known", "cycles", "postures taken", *headings), lines)],
    )


@examples(
    "make study STUDY=leader -- --arms ryrz --bendings 0.1,0.2,0.5",
    "make study STUDY=leader -- --json",
    "make study STUDY=leader -- --jobs -1 -o out/leader",
)
def run_leader(
    *,
    arms: Annotated[str | None, ARM("Arms: ryrz, universal, hinge.", "NAME,...")] = None,
    bendings: Annotated[str | None, MOTION("Curvature times module length of the paths.", "RAD,...")] = None,
    options: KeepOptions,
) -> None:
    """Push arms on a feed along paths of constant curvature, and report their distance from the path.

    The arms are 1 m long, with 20 modules: two crossed hinges half a module apart (ryrz), two in one place
    (universal), or a single one (hinge, which stays in its plane). The paths are arcs of up to three quarters
    of a turn, and helices whose torsion is half their curvature; they begin to bend at the entry. Modules
    are placed closest to the path, the whole arm by least squares, or in sequential order as in Algorithm 1.
    Numbers are in percent of the arm length: the largest distance of any part of the arm from the path in any
    posture, then that of the control points. The sagitta is the distance of the middle of a straight module
    from an arc that passes through both its ends.
    """
    from benchmarks.studies.leader import ARMS, BENDINGS, Following, study_leader
    from benchmarks.studies.pictures import draw_leader
    from benchmarks.studies.record import grouped
    from pinposture.task.follow_leader import PATH_METHODS

    names = _split("--arms", arms, ARMS)
    bent = list(BENDINGS) if bendings is None else read_numbers("--bendings", bendings)
    runs = options.run("path", study_leader, names, bent, PATH_METHODS)
    found = {"study": "leader", "arms": names, "bendings": bent, "runs": [each._asdict() for each in runs]}

    def cell(each: Following) -> str:
        return "-" if each.body is None else f"{each.body:.3f}, points {each.points:.3f}"

    lines = grouped(runs, lambda each: (each.arm, each.shape, each.method))
    sagitta = {each.bending: f"{each.sagitta:.3f}" for each in runs}
    rows = [(*line, *map(cell, own)) for line, own in lines.items()]
    rows.append(("", "", "sagitta", *sagitta.values()))
    with options.keeping(runs, found, leader=draw_leader):
        options.show(found, [(("arm", "path", "placed", *(f"{bending:g} rad" for bending in bent)), rows)])
        for each in runs:
            if each.refused:
                print_warning(
                    f"{each.arm}, {each.shape}, {each.method}, {each.bending:g} rad: {each.refused}"
                )


STUDIES: dict[str, Callable[..., None]] = {
    "arms": run_arms,
    "methods": run_methods,
    "postures": run_postures,
    "headings": run_headings,
    "scenes": run_scenes,
    "clutter": run_clutter,
    "cycles": run_cycles,
    "leader": run_leader,
}
"""The verbs `study ...` by name, in help order."""
