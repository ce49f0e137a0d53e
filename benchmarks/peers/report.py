"""The tables of a run."""

from __future__ import annotations

from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from benchmarks.peers import METHODS, REFERENCE
from benchmarks.peers.problem import FAMILIES

Found = dict[str, Any]

LONG = 100
"""DOF from which on the growth exponent is fitted: below, what a call costs by itself counts most."""


BUSY = 1.3
"""Load of a machine on which something else than the benchmark runs."""


def show(console: Console, found: Found, before: Found | None = None) -> None:
    """Print everything that was found, with ratios to an earlier run."""
    machine = found["machine"]
    console.print(
        f"{machine['processor']}, {machine['cores']} cores, Python {machine['python']}, one thread; load "
        f"{machine['load_before']:.1f} before, {machine['load_after']:.1f} after"
    )
    sizes = sorted({each["dof"] for each in found["results"]})
    tables = [headline(found, sizes), *(whole_headline(found, sizes, family) for family in FAMILIES)]
    for size in sizes:
        tables += [step_times(found, size, before), runs(found, size)]
    tables += [streams(found), pieces(found, before), startups(found)]
    for table in tables:
        if table is not None and table.row_count:
            console.print(table)
    for line in remarks(found):
        console.print(line, markup=False, highlight=False)


def step_time(each: Found | None) -> float | None:
    """Median time of one step, or of one evaluation of a method without steps [us]; None if there is none."""
    if each is None:
        return None
    times = each.get("evaluation") or each.get("times", {}).get("step", {})
    return times.get("p50")


def result(found: Found | None, name: str, size: int) -> Found | None:
    """What was found of a method on a size."""
    listed = found["results"] if found else []
    return next((each for each in listed if (each["method"], each["dof"]) == (name, size)), None)


def growth(found: Found, name: str) -> float | None:
    """Exponent of the growth of the median step time with DOF, fitted from 100 DOF on; None with one size."""
    points = [(each["dof"], step_time(each)) for each in found["results"] if each["method"] == name]
    long = [(size, value) for size, value in points if value and size >= LONG]
    if len(long) < 2:
        return None
    sizes, values = np.log(np.array(long)).T
    return float(np.polyfit(sizes, values, 1)[0])


def headline(found: Found, sizes: list[int]) -> Table | None:
    """How many times as fast as each other method a step of the default controller is."""
    columns = [f"{size} DOF" for size in sizes]
    title = f"One step of {METHODS[REFERENCE].label}: times as fast as"
    table = Table("", *columns, "growth exponent", title=title)
    names = list(dict.fromkeys(each["method"] for each in found["results"]))
    for name in names:
        cells = []
        for size in sizes:
            own, other = (step_time(result(found, each, size)) for each in (REFERENCE, name))
            cells.append(f"{other / own:.2f}" if own and other else "-")
        exponent = growth(found, name)
        table.add_row(METHODS[name].label, *cells, "-" if exponent is None else f"{exponent:.2f}")
    return table if REFERENCE in names else None


def whole_headline(found: Found, sizes: list[int], family: str) -> Table | None:
    """The same for whole runs, the plan included: median over the cases in which both arrived."""
    label = METHODS[REFERENCE].label
    title = f"A whole run of {label}, plan included, {family}: times as fast as (cases in which both arrived)"
    table = Table("", *(f"{size} DOF" for size in sizes), title=title)
    names = list(dict.fromkeys(each["method"] for each in found["results"]))
    for name in names:
        cells = []
        for size in sizes:
            own, other = (_arrivals(result(found, each, size), family) for each in (REFERENCE, name))
            ratios = [other[case] / own[case] for case in own.keys() & other.keys()]
            cells.append(f"{np.median(ratios):.2f} ({len(ratios)})" if ratios else "-")
        table.add_row(METHODS[name].label, *cells)
    return table if REFERENCE in names else None


def _arrivals(each: Found | None, family: str) -> dict[int, float]:
    """Time of each whole run that arrived, by its case."""
    runs = (each or {}).get("runs", [])
    return {run["case"]: run["fine"][1] for run in runs if run["family"] == family and run["fine"]}


def step_times(found: Found, size: int, before: Found | None) -> Table:
    """Percentiles of the step, and the kinds of steps apart."""
    heads = ("p50", "p95", "p99", "first p50", "first max", "on the way p50", "closing in p50")
    columns = [f"{head} \\[us]" for head in heads]
    extra = ["p50 / before"] if before else []
    table = Table("", *columns, "memory \\[MB]", *extra, title=f"Time of one step, {size} DOF")
    for each in (each for each in found["results"] if each["dof"] == size):
        label = METHODS[each["method"]].label
        if each.get("reason"):
            continue  # told among the remarks
        if "evaluation" in each:
            note = "[dim]no steps"
            cells = [f"{number(step_time(each))} an evaluation", note, "", "", "", "", ""]
        else:
            times = each["times"]
            cells = [number(times["step"].get(which)) for which in ("p50", "p95", "p99")]
            cells += [number(times["first"].get(which)) for which in ("p50", "max")]
            cells += [number(times[kind].get("p50")) for kind in ("way", "closing")]
        old = step_time(result(before, each["method"], size))
        now = step_time(each)
        ratio = [f"{now / old:.2f}" if now and old else "-"] if before else []
        table.add_row(label, *cells, f"{each['memory_mb']:.0f}", *ratio)
    return table


def runs(found: Found, size: int) -> Table:
    """Success, steps and time of whole runs, by family."""
    heads = [
        f"{family}: {head}"
        for family in ("near", "random")
        for head in ("arrived", "steps to 1e-3", "steps to 1e-6", "whole run \\[ms]")
    ]
    table = Table(
        "", *heads, title=f"Whole runs to 1e-6 of the arm length, {size} DOF; medians of those that arrived"
    )
    for each in (each for each in found["results"] if each["dof"] == size):
        if each.get("reason"):
            continue
        cells = []
        for family in ("near", "random"):
            mine = [run for run in each["runs"] if run["family"] == family]
            arrived = [run["fine"] for run in mine if run["fine"]]
            coarse = [run["coarse"][0] for run in mine if run["coarse"]]
            cells += [f"{len(arrived)} of {len(mine)}", number(_median(coarse))]
            cells += [number(_median([steps for steps, _ in arrived]))]
            cells += [number(_median([spent / 1e3 for _, spent in arrived]))]
        table.add_row(METHODS[each["method"]].label, *cells)
    return table


def streams(found: Found) -> Table:
    """Steps after a target that moves."""
    heads = ("steps", "p50 \\[us]", "p95 \\[us]", "p99 \\[us]", "max \\[us]", "p99 / p50")
    more = ("interrupted", "p99 of the others", f"{REFERENCE}: times as fast", "error / length")
    table = Table(
        "", *heads, *more, title="A target that moves a little each cycle: state, step, integration"
    )
    for each in found["results"]:
        stream = each.get("stream")
        if not (stream and stream["count"]):
            continue
        reference = (result(found, REFERENCE, each["dof"]) or {}).get("stream", {}).get("p50")
        table.add_row(
            f"{METHODS[each['method']].label}, {each['dof']} DOF",
            str(stream["count"]),
            *(number(stream[which]) for which in ("p50", "p95", "p99", "max")),
            f"{stream['p99'] / stream['p50']:.1f}",
            f"{stream['interrupted']}",
            number(stream["alone"].get("p99")),
            f"{stream['p50'] / reference:.2f}" if reference else "-",
            f"{stream['error']:.1e}",
        )
    return table


def pieces(found: Found, before: Found | None) -> Table:
    """Parts of a cycle of ours."""
    extra = ["p50 / before"] if before else []
    table = Table("", "DOF", "p50 \\[us]", "p95 \\[us]", "p99 \\[us]", *extra, title="Parts of a cycle")
    for size, parts in found["pieces"].items():
        if isinstance(parts.get("reason"), str):
            table.add_row(f"[dim]{parts['reason']}", size)
            continue
        for name, times in parts.items():
            if "p50" not in times:
                table.add_row(name, size, f"[dim]{times['reason']}")
                continue
            old = (before or {}).get("pieces", {}).get(size, {}).get(name, {}).get("p50")
            ratio = [f"{times['p50'] / old:.2f}" if old else "-"] if before else []
            table.add_row(name, size, *(number(times[which]) for which in ("p50", "p95", "p99")), *ratio)
    return table


def startups(found: Found) -> Table | None:
    """Imports and the first step of a process."""
    times = found["startup"]
    if not times or "reason" in times:
        return None
    table = Table("", "best \\[ms]", "median \\[ms]", title="Until something happens, in fresh interpreters")
    for name, each in times["imports"].items():
        label = "import pinocchio, scipy.optimize" if name == "peers of it" else name
        table.add_row(label, *(f"{1e3 * each[which]:.0f}" for which in ("best", "median")))
    table.add_row("ratio", *(f"{times['ratio'][which]:.2f}" for which in ("best", "median")))
    for name, each in times["first_step"].items():
        table.add_row(f"first step of a process, {name}", "", f"{1e3 * each['step']:.0f}")
    return table


def remarks(found: Found) -> list[str]:
    """What a reader has to know: what is missing, what was cut short, whose limits did not hold."""
    lines = []
    if found["machine"]["load_after"] > BUSY:
        lines.append(
            "The machine was not idle: long steps are interrupted more often, and ratios to them too high."
        )
    if found["machine"]["source_changed"]:
        lines.append("The source of this library changed during the run: its figures are not of one version.")
    lines += [f"{name}: {reason}" for name, reason in found["environments"].items() if reason]
    lacking: dict[str, list[str]] = {}
    for each in found["results"]:
        if each.get("reason"):
            lacking.setdefault(each["reason"], []).append(f"{METHODS[each['method']].label} {each['dof']}")
    lines += [f"{reason}: {', '.join(who)}" for reason, who in lacking.items()]
    for each in found["results"]:
        who = f"{METHODS[each['method']].label}, {each['dof']} DOF"
        if each.get("cut"):
            lines.append(
                f"{who}: {each['cut']} cases were cut short by the time limit and do not count as runs"
            )
        if each.get("excess", 0.0) > 1e-9:
            lines.append(f"{who}: a limit was exceeded by {each['excess']:.1e} rad")
        failures = [run["reason"] for run in each.get("runs", []) if run["reason"]]
        if failures:
            lines.append(f"{who}: {len(failures)} runs ended early: {failures[0]}")
    return lines


def number(value: float | None) -> str:
    """A figure for a cell: three digits, or all before the point."""
    if value is None:
        return "-"
    return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"


def _median(values: list[float]) -> float | None:
    return float(np.median(values)) if values else None
