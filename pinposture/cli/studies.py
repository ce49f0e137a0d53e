"""The verbs `pinposture study ...`."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinposture.cli.inputs import (
    ARM,
    MOTION,
    OUTPUT,
    ArmOptions,
    ControllerOption,
    JobsOption,
    JsonOption,
    read_numbers,
)
from pinposture.cli.output import count_progress, examples, print_json, print_note, print_table, print_warning
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from pinposture.study import ArmSurvey, Bin, MethodResult, Record, SceneRow, Spread, Subject, SummaryRow
    from pinposture.study.clutter import ClutterRow
    from pinposture.study.cycles import PostureCycle
    from pinposture.study.leader import Following
    from pinposture.study.scenes import SceneRun


# What the verbs that drive many arms have in common: options, names, refusals.

ArmsOption = Annotated[
    str | None,
    typer.Option(metavar="NAME,...", help="Arms that are built in: ryrz20,planar45.", rich_help_panel=ARM),
]
ControllersOption = Annotated[
    str | None,
    typer.Option(metavar="NAME,...", help="Controllers to compare.", rich_help_panel=MOTION),
]
SeedOption = Annotated[int, typer.Option("--seed0", metavar="N", help="First seed.", rich_help_panel=MOTION)]


def _output_option(help: str) -> Any:
    return typer.Option("--output", "-o", metavar="DIR", help=help, rich_help_panel=OUTPUT)


_ROWS = "Leave a row for each {} (cases.csv)"
OutputOption = Annotated[
    Path | None, _output_option(f"{_ROWS.format('run')}, the summary (summary.json) and a picture here.")
]
RunRowsOption = Annotated[
    Path | None, _output_option(f"{_ROWS.format('run')} and the summary (summary.json) here.")
]
ProblemRowsOption = Annotated[
    Path | None,
    _output_option(
        f"{_ROWS.format('problem')}, the summary (summary.json), a picture and animations of the first "
        "problems here."
    ),
]


def built_subjects(names: str | None) -> list[Subject]:
    """The arms of these names, or all that are built in.

    Raises:
        InvalidValue: nothing between two of the commas.
        UnknownName: there is no such arm.
    """
    from pinposture.study import built_subject
    from pinposture.study.arms import BUILT

    listed = list(BUILT) if names is None else split_names("--arms", names)
    return [built_subject(name) for name in listed]


def split_names(option: str, text: str) -> list[str]:
    """Names separated by commas, each once; raises InvalidValue if there is nothing between two of them."""
    names = [name.strip() for name in text.split(",")]
    if not all(names) or len(set(names)) < len(names):
        raise InvalidValue(option, text, "names separated by commas, each once")
    return names


def check_output(directory: Path | None) -> None:
    """Refuse a directory in which no file can be made, before anybody waits for what goes there."""
    from pinposture.storage import check_writable

    if directory is not None:
        check_writable(directory)


def _keep(
    directory: Path | None,
    runs: Sequence[Any],
    summary: Mapping[str, Any],
    pictures: Mapping[str, Callable[[Any], Figure]],
    *columns: tuple[str, ...],
) -> None:
    """Write the runs, the summary and the pictures drawn of them into a directory, if one is given."""
    from pinposture.study.record import keep_study

    if directory is not None:
        figures = {name: draw(runs) for name, draw in pictures.items()}
        for file in keep_study(directory, runs, summary, figures, *columns):
            print_note(f"wrote {file}")


def described(row: SummaryRow | Bin | SceneRow) -> dict[str, Any]:
    """A row of a table as data that JSON can hold."""
    return {
        name: value._asdict() if hasattr(value, "_asdict") else value for name, value in row._asdict().items()
    }


def report_refusals(records: list[Record]) -> None:
    """Say on stderr which controllers would not begin, how often, and why at first."""
    refused: dict[str, list[Record]] = {}
    for record in records:
        if record.status == "refused":
            refused.setdefault(record.controller, []).append(record)
    for controller, those in refused.items():
        print_warning(f"{controller} refused {len(those)} of its runs: {those[0].reason}")


# `pinposture study arms`: try every arm of a directory, or those of awkward shapes.

AS_CLOSE = 1.05
"""How much farther from the curve than the reference a placement may be to count as good."""

RESIDUAL_ROUNDING = 1e-6
"""Distance from the curve, relative to the arm length, that is no fault: sampling of the curve, rounding."""

_PLACED = ("placed by", "residual", "reference", "ratio", "farthest")
_ARMS_COLUMNS = (
    "file",
    "joints",
    "modules",
    "kind",
    "length [m]",
    *_PLACED,
    "joint",
    "Switching",
    "geodesic",
    "geodesic steps",
    "geodesic paths",
    "limits held",
)


@examples(
    "pinposture study arms urdf",
    "pinposture study arms urdf --least-joints 8 --seed 1 --jobs 4",
    "pinposture study arms urdf --json",
    "pinposture study arms",
)
def run_arms(
    *,
    directory: Annotated[
        Path | None,
        typer.Argument(
            metavar="[DIRECTORY]",
            help="Where to look for .urdf files, at any depth; without it, arms of awkward shapes made here.",
        ),
    ] = None,
    least_joints: Annotated[
        int, typer.Option(metavar="N", help="Leave out arms of fewer moving joints.", rich_help_panel=ARM)
    ] = 5,
    seed: Annotated[int, typer.Option(help="What the starts are drawn from.", rich_help_panel=MOTION)] = 0,
    jobs: JobsOption = 1,
    as_json: JsonOption = False,
) -> None:
    """Try every arm of a directory: place it on a gentle curve, and drive it there.

    Without a directory it tries arms of awkward shapes: joints that do not repeat, long rows of parallel
    axes, a tip beside the plane of the arm, no limits, a base that slides within limits of 1e6 m.

    Each distance is relative to the length of the arm. The residual is how far off the curve the control
    points are placed (root mean square), the reference the same of the best of several independent fits; the
    ratio of the two is ok up to 1.05 (plus 1e-6). Farthest is the farthest of the whole arm from the curve,
    its links and all. After that come the mean point error to which joint
    interpolation, Switching and geodesic, the default controller, drive the arm from a random start; how
    many steps geodesic took, and how far the control points went with it, relative to straight lines; and
    whether all three kept within the joint limits.
    """
    from pinposture.study import survey_arms

    if seed < 0:
        raise InvalidValue("--seed", seed, "a whole number of at least 0")
    results = survey_arms(directory, least_joints, seed, jobs, _report)
    if as_json:
        asked = {
            "directory": None if directory is None else str(directory),
            "least_joints": least_joints,
            "seed": seed,
        }
        print_json({**asked, "arms": [_described(result) for result in results]})
        return
    rows = [_arms_row(result) for result in results if not result.refused]
    if rows:
        print_table(_ARMS_COLUMNS, rows)
    refused = [(result.file, f"refused: {result.refused}") for result in results if result.refused]
    if refused:
        print_table(("file", "outcome"), refused)
    if not results:
        print_note(f"no arm of at least {least_joints} moving joints")


def _report(result: ArmSurvey) -> None:
    """Say on stderr that one file is done, what loading it warned of, and why some module has no place."""
    print_note(f"{result.file}: {'refused' if result.refused else 'done'}")
    unplaced = result.method.partition(": ")[2]
    for note in (*result.notes, *filter(None, [unplaced])):
        print_warning(f"{result.file}: {note}")


def _described(result: ArmSurvey) -> dict[str, Any]:
    return {**result._asdict(), "ratio": _ratio(result), "ok": _is_close(result)}


def _is_close(result: ArmSurvey) -> bool | None:
    """Whether an arm is placed about as close to the curve as can be; None if it was not placed."""
    if result.residual is None or result.reference is None:
        return None
    return result.residual <= AS_CLOSE * result.reference + RESIDUAL_ROUNDING


def _ratio(result: ArmSurvey) -> float | None:
    """Residual relative to the reference, where both are more than rounding."""
    if result.residual is None or result.reference is None:
        return None
    return max(result.residual, RESIDUAL_ROUNDING) / max(result.reference, RESIDUAL_ROUNDING)


def _arms_row(result: ArmSurvey) -> tuple[str | float | None, ...]:
    return (
        result.file,
        result.joints,
        compressed(result.modules),
        "planar" if result.dimension == 2 else "spatial",
        result.length,
        result.method.partition(":")[0] + (" (partial)" if ":" in result.method else ""),
        _short(result.residual),
        _short(result.reference),
        "ok" if _is_close(result) else _short(_ratio(result)),
        _short(result.farthest),
        _short(result.reached),
        _short(result.switching),
        _short(result.geodesic),
        result.geodesic_steps if result.geodesic is not None else None,
        _short(result.path_length_ratio),
        "yes" if result.within_limits else "no",
    )


def _short(value: float | None) -> str | None:
    return None if value is None else f"{value:.2g}"


def compressed(sizes: tuple[int, ...]) -> str:
    """Numbers of joints, those that repeat written once: "2 x 8", "2, 2, 3", "1 x 18, 2"."""
    runs = [(size, len(list(same))) for size, same in groupby(sizes)]
    return ", ".join(
        f"{size} x {often}" if often > 2 else ", ".join([str(size)] * often) for size, often in runs
    )


# `pinposture study methods`: the methods side by side, as in Table 1.1 of the thesis, but measured.


@examples(
    "pinposture study methods --seeds 5",
    "pinposture study methods arm.urdf --controllers switching,lm,dls --jobs 2",
    "pinposture study methods --seeds 5 --json",
)
def run_methods(
    *,
    urdf: Annotated[
        str | None,
        typer.Argument(metavar="[URDF]", help="URDF file of an arm, or -; else 20 RyRz modules, 1 m."),
    ] = None,
    arm_options: ArmOptions,
    controllers: Annotated[
        str | None,
        typer.Option(metavar="NAME,...", help="Methods to compare; else all there are.", rich_help_panel=ARM),
    ] = None,
    seeds: Annotated[
        int, typer.Option(metavar="N", help="Number of cases for each method.", rich_help_panel=MOTION)
    ] = 20,
    steps: Annotated[int, typer.Option(metavar="N", help="Steps of each way.", rich_help_panel=MOTION)] = 200,
    jobs: JobsOption = 1,
    as_json: JsonOption = False,
) -> None:
    """Compare every method on the same arm: what it reaches, what it asks for, whether it comes back.

    From smooth random starts to smooth random targets and back, median over the cases. Errors are relative
    to the length of the arm; reached is the share of cases whose mean point error ends below 1e-3 of it.
    Returned is how far some joint is from its start once the arm is back. The peaks are the largest motion of
    a joint that a step without limits asks for, for an error of one arm length, at a distance of 0.1 to 1e-5
    rad from the straight arm: what grows without bound is not stable near singular postures.
    """
    from pinposture.control import CONTROLLERS
    from pinposture.study import compare_methods, register_baselines
    from pinposture.study.methods import DISTANCES
    from pinposture.study.thesis_arms import SPATIAL

    for option, value in (("--seeds", seeds), ("--steps", steps)):
        if value < 1:
            raise InvalidValue(option, value, "a whole number of at least 1")
    register_baselines()
    names = list(CONTROLLERS) if controllers is None else [name.strip() for name in controllers.split(",")]
    if urdf is None:
        from pinposture.arm import Arm

        arm = Arm.from_modules(SPATIAL, name="ryrz20")
    else:
        arm = arm_options.read(urdf)
    results = compare_methods(
        arm, names, range(seeds), steps, jobs, lambda result: print_note(f"{result.controller}: done")
    )
    if as_json:
        asked = {"arm": arm.model.name, "seeds": seeds, "steps": steps, "distances": list(DISTANCES)}
        print_json({**asked, "methods": [result._asdict() for result in results]})
        return
    peaks = [f"peak at {distance:g}" for distance in DISTANCES[::2]]
    headings = ("method", "posture error", "tip error", "reached", "returned [rad]", *peaks)
    print_table(headings, [_methods_row(result) for result in results])


def _methods_row(result: MethodResult) -> tuple[Any, ...]:
    return (
        result.controller,
        f"{result.posture_error:.2g}",
        f"{result.end_effector_error:.2g}",
        f"{100 * result.reached:.0f} %",
        f"{result.returned:.2g}",
        *(f"{peak:.2g}" for peak in result.peaks[::2]),
    )


# `pinposture study postures`: many starts, targets and controllers.

POSTURES_PICTURE = "postures.png"

_POSTURES_COLUMNS = (
    "controller",
    "< 1e-6",
    "< 1e-3",
    "steps",
    "rising",
    "escaping",
    "peak",
    "path",
    "limits held",
)


@examples(
    "pinposture study postures --cases 38 --arms ryrz20",
    "pinposture study postures --controllers switching,lm --families --jobs 2",
    "pinposture study postures --urdf arm.urdf --cases 20 --json",
    "pinposture study postures --jobs -1 -o out/postures",
)
def run_postures(
    *,
    arms: ArmsOption = None,
    urdf: Annotated[
        str | None,
        typer.Option(metavar="FILE", help="URDF file of another arm instead, or -.", rich_help_panel=ARM),
    ] = None,
    arm_options: ArmOptions,
    controllers: ControllersOption = None,
    cases: Annotated[
        int, typer.Option(metavar="N", help="Number of cases for each arm.", rich_help_panel=MOTION)
    ] = 1000,
    seed0: SeedOption = 0,
    jobs: JobsOption = 1,
    families: Annotated[
        bool, typer.Option("--families", help="A row for each family.", rich_help_panel=OUTPUT)
    ] = False,
    output: OutputOption = None,
    as_json: JsonOption = False,
) -> None:
    """Drive arms from every kind of start to every kind of target, and say who gets there, and how.

    The arms are 20 RyRz modules, 1 m, and 45 joints in a plane with a control point at every second. Starts
    are smooth, harsh (each joint for itself within 0.6 or 1.5 rad), straight, or 1e-3 off it; targets are the
    helix and the line of the thesis, the straight arm folded back on itself, and random postures. Arms that
    are loaded go to a gentle curve and to random postures. At most 0.1 rad per step and joint, and 400 steps.

    The first two columns are the share of runs whose mean point error ends below 1e-6 and 1e-3 of the arm
    length. The others tell of the runs that moved and came below 1e-3: median (90th percentile) of the number
    of steps, of the share of steps on which the posture error rises, of those of them that were flagged as an
    escape, of the highest posture error relative to the first one, and of the length of the paths of the
    control points relative to the straight ways. A thousand cases with six controllers take some five minutes
    on two processes for each arm.
    """
    from pinposture.study import loaded_subject, study_postures, summarise
    from pinposture.study.pictures import draw_postures
    from pinposture.study.postures import COMPARED

    check_output(output)
    if urdf is None:
        arm_options.refuse("only together with --urdf")
        subjects = built_subjects(arms)
    elif arms is not None:
        raise InvalidValue("--arms", arms, "nothing where --urdf names the arm")
    else:
        subjects = [loaded_subject(arm_options.read(urdf))]
    names = COMPARED if controllers is None else split_names("--controllers", controllers)
    with count_progress("case") as progress:
        records = study_postures(subjects, names, cases, seed0, jobs, progress)
    rows = summarise(records, families)
    asked = {"study": "postures", "cases": cases, "seed0": seed0, "controllers": list(names)}
    found = {**asked, "rows": [described(row) for row in rows]}
    if as_json:
        print_json(found)
    else:
        for subject in subjects:
            own = [row for row in rows if row.arm == subject.name]
            print_table((subject.name, "runs", *_POSTURES_COLUMNS), _table(own))
    report_refusals(records)
    _keep(output, records, found, {POSTURES_PICTURE: draw_postures})


def _table(rows: list[SummaryRow]) -> list[tuple[str | float | None, ...]]:
    """Lines of a table; a group is named in its first line."""
    lines: list[tuple[str | float | None, ...]] = []
    before = ""
    for row in rows:
        lines.append(
            (
                row.group if row.group != before else "",
                row.runs,
                row.controller,
                _percent(row.arrived),
                _percent(row.near),
                _spread_cell(row.steps, ".0f"),
                _spread_cell(row.rising, ".1%"),
                _spread_cell(row.escaping, ".1%"),
                _spread_cell(row.peak, ".2f"),
                _spread_cell(row.path, ".2f"),
                "yes" if row.lawful else "no",
            )
        )
        before = row.group
    return lines


def _percent(share: float) -> str:
    """A share in percent, rounded down, so that 100 % stands for all."""
    return f"{int(1000.0 * share + 1e-9) / 10.0:g} %"


def _spread_cell(spread: Spread | None, form: str) -> str | None:
    """Median (90th percentile)."""
    return None if spread is None else f"{spread.median:{form}} ({spread.high:{form}})"


# `pinposture study headings`: how far some part of the arm must turn, and who can.

HEADINGS_PICTURE = "headings.png"


@examples(
    "pinposture study headings --pairs 50 --arms planar45",
    "pinposture study headings --controllers switching,lm --target curve",
    "pinposture study headings --pairs 20 --json",
    "pinposture study headings --jobs -1 -o out/headings",
)
def run_headings(
    *,
    arms: ArmsOption = None,
    controllers: ControllersOption = None,
    target: Annotated[
        str,
        typer.Option(
            metavar="KIND",
            help="What is known of the target: its configuration, or the curve through its points.",
            rich_help_panel=MOTION,
        ),
    ] = "configuration",
    pairs: Annotated[
        int, typer.Option(metavar="N", help="Number of pairs for each arm.", rich_help_panel=MOTION)
    ] = 300,
    seed0: SeedOption = 0,
    jobs: JobsOption = 1,
    output: OutputOption = None,
    as_json: JsonOption = False,
) -> None:
    """Drive arms between random smooth postures, and count who gets there by how far the arm must turn.

    The change of heading of a link adds up from the base along the arm, full turns included; that of a module
    of a spatial arm likewise, from the rotations between the changes of neighbours. The bins are those of its
    largest value along the arm: past pi, what knows the control points alone turns the short way round, and
    kinks. Counted are the runs that end with a mean point error below 1e-3 of the arm length and never left
    the limits, of all; behind them is the median length of the paths of the control points relative to the
    straight ways, of those that moved and came near. At most 0.1 rad per step and joint, and 400 steps.
    """
    from pinposture.study import by_heading, study_headings
    from pinposture.study.pictures import draw_headings
    from pinposture.study.postures import BINS, COMPARED

    check_output(output)
    subjects = built_subjects(arms)
    names = COMPARED if controllers is None else split_names("--controllers", controllers)
    with count_progress("pair") as progress:
        records = study_headings(subjects, names, pairs, seed0, target, jobs, progress)
    bins = by_heading(records)
    asked = {
        "study": "headings",
        "target": target,
        "pairs": pairs,
        "seed0": seed0,
        "controllers": list(names),
    }
    found = {**asked, "bins": [described(each) for each in bins]}
    if as_json:
        print_json(found)
    else:
        for subject in subjects:
            own = [each for each in bins if each.arm == subject.name]
            lines = [
                (name, *(_headings_cell(each) for each in own if each.controller == name))
                for name in dict.fromkeys(each.controller for each in own)
            ]
            print_table((subject.name, *(f"{name} rad" for name in BINS)), lines)
    report_refusals(records)
    _keep(output, records, found, {HEADINGS_PICTURE: draw_headings})


def _headings_cell(each: Bin) -> str:
    counted = f"{each.reached}/{each.runs}"
    return counted if each.path is None else f"{counted}, path {each.path.median:.2f}"


# `pinposture study scenes`: an arm among obstacles, many times.

_SCENES_COLUMNS = (
    "scene",
    "runs",
    "reached",
    "margin kept",
    "room [mm]",
    "steps",
    "path",
    "escaping",
    "time [s]",
)


@examples(
    "pinposture study scenes --scenes post,wall,inside",
    "pinposture study scenes --seeds 2 --json",
    "pinposture study scenes --jobs -1 -o out/scenes",
)
def run_scenes(
    *,
    scenes: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="Some of: post,slot,narrow,wall,pipe,inside,coil,out; else all.",
            rich_help_panel=MOTION,
        ),
    ] = None,
    seeds: Annotated[
        int, typer.Option(metavar="N", help="Number of runs in each scene.", rich_help_panel=MOTION)
    ] = 10,
    seed0: SeedOption = 0,
    jobs: JobsOption = 1,
    output: RunRowsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Drive 20 RyRz modules, 1 m, among obstacles, and say who keeps clear, who gets there, and how.

    The arm goes round a post, threads a slot of 20 cm in a wall, and a narrow one of 12 cm; unfolds close
    before a wall; reaches through a pipe to hook back beside it; is sent inside a ball, where it must stop
    short; turns a coil into its mirror image without touching itself; and comes out of a ball in which it
    starts. Each seed varies start and target a little; draws that are not as clear as they should be are
    refused. At most 0.1 rad per step and joint, and 400 steps.

    Room is the smallest distance, looked up at ten places of every step, minus the margin, in the worst run;
    negative where the arm starts in collision. Such a run keeps its margin if the arm never goes deeper,
    comes out, and keeps it from there on. The last four columns are median (90th percentile) of the number
    of steps, of the length of the paths of the control points relative to the straight ways, of the share
    of steps flagged as an escape, and of the time of a run. Runs that did not do as they should are named
    one by one. All of it takes some ten minutes on two processes.
    """
    from pinposture.study.scenes import SITUATIONS, SceneRun, by_scene, study_scenes

    check_output(output)
    names = list(SITUATIONS) if scenes is None else split_names("--scenes", scenes)
    with count_progress("run") as progress:
        runs = study_scenes(names, seeds, seed0, jobs, progress)
    rows = by_scene(runs)
    asked = {"study": "scenes", "scenes": names, "seeds": seeds, "seed0": seed0}
    found = {**asked, "rows": [described(row) for row in rows]}
    if as_json:
        print_json(found)
    else:
        print_table(_SCENES_COLUMNS, [_scenes_line(row) for row in rows])
    refused = [f"{row.scene} {row.refused}" for row in rows if row.refused]
    if refused:
        print_note(f"starts and targets that were drawn and refused: {', '.join(refused)}")
    for each in runs:
        if not each.as_it_should:
            print_warning(f"{each.scene}, seed {each.seed}: {_fault(each)}")
    _keep(output, runs, found, {}, SceneRun._fields)


def _scenes_line(row: SceneRow) -> tuple[str | float | None, ...]:
    return (
        row.scene,
        row.runs,
        f"{row.reached} of {row.reachable}",
        f"{row.kept} of {row.runs}",
        f"{1e3 * row.room:.2f}",
        _spread_cell(row.steps, ".0f"),
        _spread_cell(row.path, ".2f"),
        _spread_cell(row.escaping, ".0%"),
        _spread_cell(row.seconds, ".1f"),
    )


def _fault(run: SceneRun) -> str:
    """What a run did not do as it should, in words."""
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


# `pinposture study clutter`: finding a path among obstacles.

_CLUTTER_COLUMNS = ("kind", "planned", "reached", "room [mm]", "planning [s]", "path", "found by")


@examples(
    "pinposture study clutter --kinds hole,shelf --seeds 3",
    "pinposture study clutter --seeds 50 --jobs -1 -o out/clutter",
)
def run_clutter(
    *,
    kinds: Annotated[
        str | None,
        typer.Option(
            metavar="NAME,...",
            help="Some of: balls,posts,hole,two-walls,shelf,corner,pipe,machine,coil; else all.",
            rich_help_panel=MOTION,
        ),
    ] = None,
    seeds: Annotated[
        int, typer.Option(metavar="N", help="Number of problems of each kind.", rich_help_panel=MOTION)
    ] = 10,
    seed0: SeedOption = 0,
    jobs: JobsOption = 1,
    output: ProblemRowsOption = None,
    as_json: JsonOption = False,
) -> None:
    """Plan and run with 20 RyRz modules, 1 m, among obstacles that have to be got past.

    40 balls; 30 posts; a hole of 15 cm in a wall; two walls with offset holes; a shelf with 16 bays; a narrow
    corner; a pipe with two bends; a scanned machine with a hole in front; the arm itself, coiled. Start and
    goal are drawn until they are clear, by code that plans nothing. A third of the starts are inside of the
    hole, the pipe or the machine.

    Room is the smallest distance in the runs that got there, every 0.01 rad, minus the margin. Planning time
    and path length ratio of the plans are median (90th percentile). Problems that were not solved are named.
    """
    from pinposture.study.clutter import KINDS_OF_CLUTTER, ClutterRun, by_kind, run_problem, study_clutter
    from pinposture.study.pictures import draw_clutter
    from pinposture.study.scenes import situation_arm
    from pinposture.viz import save_html

    check_output(output)
    names = list(KINDS_OF_CLUTTER) if kinds is None else split_names("--kinds", kinds)
    with count_progress("problem") as progress:
        runs = study_clutter(names, seeds, seed0, jobs, progress)
    rows = by_kind(runs)
    asked = {"study": "clutter", "kinds": names, "seeds": seeds, "seed0": seed0}
    found = {**asked, "rows": [row._asdict() for row in rows]}
    if as_json:
        print_json(found)
    else:
        print_table(_CLUTTER_COLUMNS, [_clutter_line(row) for row in rows])
    for each in runs:
        if not each.reached:
            print_warning(f"{each.kind}, seed {each.seed}: {each.hindrance or each.reason}")
    if output is not None:
        arm = situation_arm()
        shown = {name: run_problem(arm, name, seed0) for name in names}
        _keep(output, runs, found, {CLUTTER_PICTURE: lambda _: draw_clutter(shown)}, ClutterRun._fields)
        for name, run in shown.items():
            print_note(f"wrote {save_html(arm, run, output / f'{name}.html')}")


CLUTTER_PICTURE = "clutter.png"


def _clutter_line(row: ClutterRow) -> tuple[str | float | None, ...]:
    return (
        row.kind,
        f"{row.planned} of {row.problems}",
        f"{row.reached} of {row.problems}",
        f"{1e3 * row.clearance:.2f}",
        "{:.2f} ({:.2f})".format(*row.plan_time),
        "{:.2f} ({:.2f})".format(*row.path_length_ratio),
        ", ".join(f"{name} {count}" for name, count in row.found_by.items()),
    )


# `pinposture study cycles`: closed cycles of postures, gone round again and again.


@examples(
    "pinposture study cycles --arms ryrz20 --cycles 3",
    "pinposture study cycles --rounds 10 --jobs 2",
    "pinposture study cycles --cycles 2 --json",
)
def run_cycles(
    *,
    arms: ArmsOption = None,
    controller: ControllerOption = "geodesic",
    cycles: Annotated[
        int,
        typer.Option(
            metavar="N", help="Number of cycles for each arm and knowledge.", rich_help_panel=MOTION
        ),
    ] = 10,
    rounds: Annotated[
        int, typer.Option(metavar="N", help="Rounds of each cycle.", rich_help_panel=MOTION)
    ] = 5,
    seed0: SeedOption = 0,
    jobs: JobsOption = 1,
    as_json: JsonOption = False,
) -> None:
    """Go round closed cycles of four random smooth postures, and say how far the joints drift.

    The first round begins in the last posture. After each round, drift is how far the joint that is farthest
    from where it began has moved [rad]; the table has that of the worst cycle. Postures are known by
    their configurations, or by their control points alone. At most 0.1 rad per step and joint, and 400 steps
    from one posture to the next, until the mean point error is below 1e-9 of the arm length.
    """
    from pinposture.study.cycles import study_cycles

    subjects = built_subjects(arms)
    with count_progress("cycle") as progress:
        found = study_cycles(
            subjects,
            controller=controller,
            cycles=cycles,
            rounds=rounds,
            first_seed=seed0,
            jobs=jobs,
            progress=progress,
        )
    if as_json:
        asked = {"study": "cycles", "controller": controller, "cycles": cycles, "rounds": rounds}
        print_json({**asked, "seed0": seed0, "runs": [each._asdict() for each in found]})
        return
    headings = [f"round {number + 1}" for number in range(rounds)]
    kinds = dict.fromkeys((each.arm, each.target) for each in found)
    lines = [_cycles_line([each for each in found if (each.arm, each.target) == kind]) for kind in kinds]
    print_table(("arm", "known", "cycles", "postures taken", *headings), lines)


def _cycles_line(cycles: list[PostureCycle]) -> tuple[str | float | None, ...]:
    """The worst drift after each round."""
    from pinposture.study.cycles import CLOSE

    taken = sum(each.error <= CLOSE for each in cycles)
    worst = [max(drifts) for drifts in zip(*(each.drift for each in cycles), strict=True)]
    first = cycles[0]
    counted = f"all in {taken} of {len(cycles)}"
    return first.arm, first.target, len(cycles), counted, *(f"{drift:.2g}" for drift in worst)


# `pinposture study leader`: how far an arm is from the path of its tip.

LEADER_PICTURE = "leader.png"


@examples(
    "pinposture study leader --arms ryrz --bendings 0.1,0.2,0.5",
    "pinposture study leader --json",
    "pinposture study leader --jobs -1 -o out/leader",
)
def run_leader(
    *,
    arms: Annotated[
        str | None,
        typer.Option(metavar="NAME,...", help="Arms: ryrz,universal,hinge.", rich_help_panel=ARM),
    ] = None,
    bendings: Annotated[
        str | None,
        typer.Option(
            metavar="RAD,...", help="Curvature times module length of the paths.", rich_help_panel=MOTION
        ),
    ] = None,
    jobs: JobsOption = 1,
    output: OutputOption = None,
    as_json: JsonOption = False,
) -> None:
    """Push arms on a feed along paths of constant curvature, and say how far off the path they are.

    The arms are 1 m long, of 20 modules: two crossed hinges half a module apart (ryrz), two in one place
    (universal), or one alone (hinge, which stays in its plane). The paths are arcs of up to three quarters
    of a turn, and helices whose torsion is half their curvature; they begin to bend at the entry. Modules
    are placed closest to the path, the whole arm by least squares, or in sequential order as in Algorithm 1.
    Numbers are percent of the arm length: the farthest that any part of the arm is from the path in any
    posture, and behind it the farthest control point. The sagitta is how far the middle of a straight module
    is from an arc if both its ends are on it.
    """
    from pinposture.study.leader import ARMS, BENDINGS, Following, study_leader
    from pinposture.study.pictures import draw_leader

    check_output(output)
    names = list(ARMS) if arms is None else split_names("--arms", arms)
    bent = list(BENDINGS) if bendings is None else read_numbers("--bendings", bendings)
    with count_progress("path") as progress:
        found = study_leader(names, bent, jobs=jobs, progress=progress)
    summary = {"study": "leader", "arms": names, "bendings": bent, "runs": [each._asdict() for each in found]}
    if as_json:
        print_json(summary)
    else:
        lines = dict.fromkeys((each.arm, each.shape, each.method) for each in found)
        rows = [
            (*line, *(_leader_cell(each) for each in found if (each.arm, each.shape, each.method) == line))
            for line in lines
        ]
        sagitta = {each.bending: f"{each.sagitta:.3f}" for each in found}
        rows.append(("", "", "sagitta", *sagitta.values()))
        print_table(("arm", "path", "placed", *(f"{bending:g} rad" for bending in bent)), rows)
    for each in found:
        if each.refused:
            print_warning(f"{each.arm}, {each.shape}, {each.method}, {each.bending:g} rad: {each.refused}")
    _keep(output, found, summary, {LEADER_PICTURE: draw_leader}, Following._fields)


def _leader_cell(each: Following) -> str:
    return "-" if each.body is None else f"{each.body:.3f}, points {each.points:.3f}"


VERBS: dict[str, Callable[..., None]] = {
    "arms": run_arms,
    "methods": run_methods,
    "postures": run_postures,
    "headings": run_headings,
    "scenes": run_scenes,
    "clutter": run_clutter,
    "cycles": run_cycles,
    "leader": run_leader,
}
"""The verbs by name, in the order of the help."""
