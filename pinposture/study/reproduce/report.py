"""What was found, for programs (results.json) and for people (claims.md)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from pinposture.study.reproduce.evaluate import Evidence, JudgedClaim
from pinposture.study.reproduce.figures import FigureRuns, describe_figure
from pinposture.study.reproduce.reading import DEFAULT, label
from pinposture.study.reproduce.runs import NUDGE, STEP_LIMIT, MeasuredRun
from pinposture.study.reproduce.verdicts import RULES, Finding, Share, Verdict
from pinposture.thesis.scenarios import SCENARIOS

FORMAT = "pinposture-reproduction"
VERSION = 1


def describe(
    figures: Sequence[FigureRuns], judged: Sequence[JudgedClaim], evidence: Evidence | None, max_steps: int
) -> dict[str, Any]:
    """Everything that was found, as data that JSON can hold.

    Args:
        figures: the figures that were reproduced.
        judged: the claims that were judged.
        evidence: what they were judged by; None if none were.
        max_steps: steps after which a run ended.
    """
    return {
        "format": FORMAT,
        "version": VERSION,
        "parameters": {
            "seeds": evidence.seeds if evidence else 0,
            "max_steps": max_steps,
            "step_limit": STEP_LIMIT,
            "nudge": NUDGE,
            "rules": {name: rule._asdict() for name, rule in RULES.items()},
        },
        "figures": [describe_figure(figure) for figure in figures],
        "claims": [_claim(each) for each in judged],
        "runs": [_batch(*key, runs) for key, runs in evidence.pool.items()] if evidence else [],
    }


def _claim(judged: JudgedClaim) -> dict[str, Any]:
    claim = judged.claim
    return {
        "id": claim.id,
        "where": claim.where,
        "claim": claim.text,
        "measured": claim.measured,
        "rule": claim.rule,
        **_finding(judged.verdict, judged.finding),
        "readings": {name: _finding(*found) for name, found in judged.readings.items()},
    }


def _finding(verdict: Verdict, finding: Finding) -> dict[str, Any]:
    return {
        "verdict": verdict,
        "shares": {
            name: {"true": each.true, "cases": each.cases, "share": each.value}
            for name, each in finding.shares.items()
            if each.cases
        },
        "figures": dict(finding.figures),
        "by_nearness": [
            each._asdict() | {"high": each.high if np.isfinite(each.high) else None}
            for each in finding.by_nearness
        ],
        "instead": "" if verdict == "holds" else finding.instead,
    }


def _batch(scenario: str, variant: str, runs: Sequence[MeasuredRun]) -> dict[str, Any]:
    """The runs of one scenario by one variant in numbers, errors per arm length."""
    final = np.array([run.mean_errors[-1] for run in runs])
    endings = [run.outcome.status for run in runs]
    return {
        "scenario": scenario,
        "arm": SCENARIOS[scenario].arm,
        "title": label(scenario),
        "variant": variant,
        "runs": len(runs),
        "steps": float(np.median([run.outcome.steps for run in runs])),
        "ratio": float(np.median([run.outcome.ratio for run in runs])),
        "final_error": float(np.median(final)),
        "final_error_90": float(np.percentile(final, 90)),
        "rising": float(np.median([run.outcome.rising for run in runs])),
        "sweep": float(np.median([run.sweep for run in runs])),
        "endings": {status: endings.count(status) for status in sorted(set(endings))},
    }


def claims_as_markdown(judged: Sequence[JudgedClaim], seeds: int, max_steps: int) -> str:
    """The claims as a Markdown document: a table, then what was measured for each of them."""
    rows = [
        f"| {each.claim.text} | {each.claim.where} | {each.verdict} | {span(each.finding.shares)} "
        f"| {_otherwise(each)} |"
        for each in judged
    ]
    rules = [
        f"* {name}: {rule.words}. Holds from {rule.holds:.0%}, partly from {rule.partly:.0%}."
        for name, rule in RULES.items()
    ]
    parts = [
        "# The claims of the thesis, measured",
        f"Over {seeds} seed{'s' * (seeds != 1)}, at most {max_steps} steps a run. A claim holds if the share "
        "of cases in which it is true reaches the first threshold of its rule in everything that was tried, "
        "does not hold if the share stays below the second in all of it, and else holds partly. The rules "
        "are for claims that are",
        "\n".join(rules),
        "\n".join(["| claim | where | verdict | true in | read otherwise |", "|---|---|---|---|---|", *rows]),
        *(_section(each) for each in judged),
    ]
    return "\n\n".join(parts) + "\n"


def _otherwise(judged: JudgedClaim) -> str:
    """Verdicts of other readings where they differ, in words."""
    differ = {name: found[0] for name, found in judged.readings.items() if found[0] != judged.verdict}
    return "; ".join(f"{name}: {verdict}" for name, verdict in differ.items())


def _section(judged: JudgedClaim) -> str:
    claim = judged.claim
    lines = [
        f"## {claim.id}",
        f"{claim.text} ({claim.where})",
        f"Verdict: **{judged.verdict}**. Measured: {claim.measured}. Rule: {claim.rule}.",
        _table({DEFAULT: (judged.verdict, judged.finding), **judged.readings}),
    ]
    if judged.verdict != "holds" and judged.finding.instead:
        lines.append(f"What holds: {judged.finding.instead}")
    lines += _nearness_tables(judged.finding)
    return "\n\n".join(lines)


def _table(findings: Mapping[str, tuple[Verdict, Finding]]) -> str:
    rows = ["| read | tried | true in | share |", "|---|---|---|---|"]
    for reading, (verdict, finding) in findings.items():
        rows += [
            f"| {reading} ({verdict}) | {name} | {each.true} of {each.cases} | {each.value:.1%} |"
            for name, each in finding.shares.items()
            if each.cases
        ]
    return "\n".join(rows)


def _nearness_tables(finding: Finding) -> list[str]:
    """Medians and largest values by nearness, a table for each quantity."""
    tables = []
    for quantity in dict.fromkeys(each.quantity for each in finding.by_nearness):
        own = [each for each in finding.by_nearness if each.quantity == quantity]
        classes = sorted({(each.low, each.high) for each in own})
        heads = " | ".join(
            f"{low:g} to {high:g}" if np.isfinite(high) else f"above {low:g}" for low, high in classes
        )
        rows = [f"| {quantity}: median (largest), by nearness | {heads} |", "|---" * (len(classes) + 1) + "|"]
        for group in dict.fromkeys(each.group for each in own):
            cells = {
                (each.low, each.high): f"{each.median:.2g} ({each.largest:.2g})"
                for each in own
                if each.group == group
            }
            rows.append(f"| {group} | {' | '.join(cells.get(bounds, '') for bounds in classes)} |")
        tables.append("\n".join(rows))
    return tables


def span(shares: Mapping[str, Share]) -> str:
    """The smallest and the largest share, in words."""
    values = [each.value for each in shares.values() if each.cases]
    if not values:
        return "no case"
    low, high = f"{min(values):.0%}", f"{max(values):.0%}"
    return low if low == high else f"{low} to {high}"
