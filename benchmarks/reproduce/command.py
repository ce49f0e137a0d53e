"""`reproduce`: reproduce the experiments of the thesis."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from pinposture.cli.inputs import MOST_RUNS, MOTION, OUTPUT, JobsOption, JsonOption, Panel
from pinposture.cli.output import count_progress, examples, print_json, print_note, print_table
from pinposture.errors import InvalidValue
from pinposture.units import length_text

if TYPE_CHECKING:
    from benchmarks.reproduce import Reproduction
    from pinposture.control import Controller


SETTINGS = Panel("Methods and figures")


@examples(
    "make reproduce",
    "make reproduce -- 6.3 6.4",
    "make reproduce -- 6.4 --controller lm --controller dls",
    "make reproduce -- 6.4 --width 88 --format pdf --format svg",
    "make reproduce -- claims --seeds 10",
    "make reproduce -- all -o out/thesis",
)
def run(
    *,
    figures: Annotated[
        list[str] | None,
        typer.Argument(metavar="[FIGURE]...", help="6.3 to 6.12, claims, or all; without any, list them."),
    ] = None,
    controller: Annotated[
        list[str] | None,
        MOTION("An additional controller to show: a name, or module:Class. Repeatable.", "NAME"),
    ] = None,
    seeds: Annotated[int, MOTION("Number of seeds to judge claims over.", "N", max=MOST_RUNS)] = 100,
    seed: Annotated[
        int | None,
        MOTION(
            "Seed of figures (default: that of each) and first seed of claims (default: 0).",
            "N",
        ),
    ] = None,
    steps: Annotated[int, MOTION("Steps after which a run ends.", "N")] = 200,
    step_limit: Annotated[float, SETTINGS("Maximum |dq| of a joint in a step; figures only.", "RAD")] = 0.1,
    gain: Annotated[float | None, SETTINGS("Gain of both methods; figures only.", "K")] = None,
    null_gain: Annotated[float | None, SETTINGS("Weight of the null-space term; figures only.", "A")] = None,
    index: Annotated[
        float | None, SETTINGS("Threshold of Selection's manipulability conditions; figures only.", "W")
    ] = None,
    kappa: Annotated[float | None, SETTINGS("Threshold of Projection; figures only.", "S")] = None,
    form: Annotated[
        list[str] | None,
        OUTPUT("Format of pictures: png, pdf, svg. Repeatable.", "FORMAT", flags="--format"),
    ] = None,
    width: Annotated[
        float | None,
        OUTPUT(
            "Width of printed pictures: 88 is a column, 180 a page. Default: for the screen.",
            "MM",
            min=20.0,
            max=1000.0,
        ),
    ] = None,
    jobs: JobsOption = -1,
    output: Annotated[Path, OUTPUT("Directory of the files.", "DIR", flags="--output -o")] = Path(
        "out/reproduce"
    ),
    page: Annotated[
        Path | None,
        OUTPUT(
            "A Markdown page in which the tables of the claims are replaced, between markers; a JSON "
            "file beside it gets the results.",
            "FILE",
        ),
    ] = None,
    as_json: JsonOption = False,
) -> None:
    """Reproduce the experiments of chapter 6 of the thesis, and judge its claims.

    Each figure has the layout of the thesis; the numbers of its runs go to results.json and CSV files. The
    claims are measured over many seeds; results.json has all numbers and a verdict on each claim, claims.md
    a readable version. All of it takes some minutes.
    """
    if not figures:
        _list(as_json)
        return
    from benchmarks.reproduce import FigureSettings, reproduce

    settings = FigureSettings(
        seed, step_limit, _methods(gain, null_gain, index, kappa), tuple(form or ("png",)), width
    )
    with count_progress("run") as progress:
        done = reproduce(
            figures,
            output,
            seeds,
            steps,
            jobs,
            progress,
            controllers=controller or (),
            settings=settings,
            page=page,
        )
    if as_json:
        print_json(done.results)
    else:
        _print(done)
    for file in done.files:
        print_note(f"wrote {file}")


def _methods(
    gain: float | None, null_gain: float | None, index: float | None, kappa: float | None
) -> dict[str, Controller]:
    """Return the methods of the thesis with the given parameters; empty if none are given."""
    from pinposture.control import Projection, Selection, Switching

    def given(**values: float | None) -> dict[str, Any]:
        return {name: value for name, value in values.items() if value is not None}

    both = given(gain=gain, null_gain=null_gain)
    selection = Selection(**both, **given(absolute=index, relative=index))
    projection = Projection(**both, **given(threshold=kappa))
    if not (both or given(index=index, kappa=kappa)):
        return {}
    switching = Switching(selection=selection, projection=projection)
    return {"selection": selection, "projection": projection, "switching": switching}


def _list(as_json: bool) -> None:
    """List what can be reproduced."""
    from benchmarks.reproduce.claims import CLAIMS, FIGURES

    rows: list[tuple[str, str, str]] = [
        (number, each.title, f"Section {each.section}") for number, each in FIGURES.items()
    ]
    if as_json:
        shown = [{"figure": number, "title": title, "section": section} for number, title, section in rows]
        print_json({"figures": shown, "claims": len(CLAIMS)})
        return
    rows.append(("claims", f"verdicts on {len(CLAIMS)} claims", "all chapters"))
    rows.append(("all", "everything", ""))
    print_table(("figure", "shows", "thesis"), rows)


def _print(done: Reproduction) -> None:
    """Print the tables of results."""
    from benchmarks.reproduce.page import span

    runs = [
        (
            figure.about.number,
            name,
            " -> ".join(length_text(run.posture_error[row], run.arm.length) for row in (0, -1)),
            run.steps,
            run.status,
            figure.about.title,
        )
        for figure in done.figures
        for name, run in figure.runs.items()
    ]
    if runs:
        print_table(("figure", "controller", "posture error", "steps", "ending", "shows"), runs)
    claims = done.results["claims"]
    if claims:
        own = list(dict.fromkeys(name for claim in claims for name in claim["own"]))
        rows = [
            (
                claim["verdict"],
                span(claim["shares"]),
                *(claim["own"][name]["verdict"] if name in claim["own"] else "" for name in own),
                claim["claim"],
                claim["where"],
            )
            for claim in claims
        ]
        print_table(("verdict", "true in", *own, "claim", "where"), rows)


@examples("make score -- results.json --cases benchmarks/cases/postures-1.json")
def run_score(
    *,
    results: Annotated[
        Path, typer.Argument(metavar="RESULTS", help="Results of a program for the cases, JSON.")
    ],
    cases: Annotated[Path, typer.Option(metavar="FILE", help="The file of cases.")] = Path(
        "benchmarks/cases/postures-1.json"
    ),
    as_json: JsonOption = False,
) -> None:
    """Score the results of any program for the cases of the benchmark.

    A case is reached if it ends within 0.1 % of the arm length of the target (mean of the control points),
    within all limits and clear of all obstacles. Steps, path (path length of the control points relative to
    straight lines) and rising (share of steps in which the posture error rises) are medians over these cases.
    """
    from benchmarks.score import score

    if results.exists() and not cases.exists():
        raise InvalidValue(
            "--cases", str(cases), "the file of cases; the repository has it in benchmarks/cases"
        )
    program, scores = score(results, cases)
    if as_json:
        print_json({"program": program, "scores": scores})
        return
    heads = ("group", "reached", "of", "limits held", "clear", "error", "steps", "path", "rising")
    rows = [
        (
            each.group,
            each.reached,
            each.cases,
            each.limits_held,
            each["clear"],
            _short(each.error, ".2g"),
            _short(each.steps, ".0f"),
            _short(each.path, ".2f"),
            _short(each.rising, ".0%"),
        )
        for each in scores
    ]
    print_note(program)
    print_table(heads, rows)


def _short(value: float | None, form: str) -> str:
    return "" if value is None else f"{value:{form}}"
