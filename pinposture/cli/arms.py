"""`pinposture study arms`: try every arm of a directory, or those of awkward shapes."""

from __future__ import annotations

from itertools import groupby
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinposture.cli.inputs import ARM, MOTION, JobsOption, JsonOption
from pinposture.cli.output import print_json, print_note, print_table, print_warning
from pinposture.errors import InvalidValue

if TYPE_CHECKING:
    from pinposture.study import ArmSurvey

EXAMPLES = (
    "pinposture study arms urdf",
    "pinposture study arms urdf --least-joints 8 --seed 1 --jobs 4",
    "pinposture study arms urdf --json",
    "pinposture study arms",
)

CLOSE = 1.05
"""How much farther from the curve than the reference a placement may be to count as good."""

ROUNDING = 1e-6
"""Distance from the curve, relative to the arm length, that is no fault: sampling of the curve, rounding."""

_PLACED = ("placed by", "residual", "reference", "ratio", "farthest")
_HEADINGS = (
    "file",
    "joints",
    "modules",
    "kind",
    "length [m]",
    *_PLACED,
    "joint",
    "Switching",
    "qp",
    "qp steps",
    "qp paths",
    "limits held",
)


def run(
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
    interpolation, Switching and qp, the default controller, drive the arm from a random start; how many steps
    qp took, and how far the control points went with it, relative to straight lines; and whether all three
    kept within the joint limits.
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
    rows = [_row(result) for result in results if not result.refused]
    if rows:
        print_table(_HEADINGS, rows)
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
    return result.residual <= CLOSE * result.reference + ROUNDING


def _ratio(result: ArmSurvey) -> float | None:
    """Residual relative to the reference, where both are more than rounding."""
    if result.residual is None or result.reference is None:
        return None
    return max(result.residual, ROUNDING) / max(result.reference, ROUNDING)


def _row(result: ArmSurvey) -> tuple[str | float | None, ...]:
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
        _short(result.qp),
        result.qp_steps if result.qp is not None else None,
        _short(result.path_excess),
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
