"""The claims as Markdown tables, and the update of a page that contains them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from pinposture.errors import FileError
from pinposture.storage import read_text, write_text

Results = Mapping[str, Any]
"""The content of `results.json`, from which all tables are written."""

PARTS = ("parameters", "verdicts", "nearness", "details")
"""Parts of a page, each between `<!-- NAME: begin -->` and `<!-- NAME: end -->`."""


def update_page(path: Path, results: Results) -> bool:
    """Write the tables of `results` of `reproduce` with claims into a Markdown page; return if it changed.

    Raises:
        FileError: the page cannot be read or written, or lacks a marker of one of PARTS.
    """
    before = read_text(path)
    after = with_tables(before, results, path)
    if after != before:
        write_text(path, after)
    return after != before


def with_tables(page: str, results: Results, path: Path) -> str:
    """Return a page with the tables of some results between its markers; `path` is for the error."""
    for name, text in tables(results).items():
        begin, end = f"<!-- {name}: begin -->", f"<!-- {name}: end -->"
        if page.count(begin) != 1 or page.count(end) != 1 or page.index(end) < page.index(begin):
            raise FileError(path, f"has no {begin} with an {end} after it")
        head, tail = page.split(begin, maxsplit=1)[0], page.split(end)[1]
        page = f"{head}{begin}\n{text}\n{end}{tail}"
    return page


def tables(results: Results) -> dict[str, str]:
    """Return the text between the markers of a page, by PARTS."""
    claims = results["claims"]
    return {
        "parameters": _parameters(results["parameters"]),
        "verdicts": _verdicts(claims),
        "nearness": "\n\n".join(table for claim in claims for table in _nearness(claim["by_nearness"])),
        "details": "\n\n".join(_details(claim) for claim in claims),
    }


def claims_as_markdown(results: Results) -> str:
    """Return the claims as a separate document with all tables."""
    return "# The claims of the thesis, measured\n\n" + "\n\n".join(tables(results).values()) + "\n"


def _parameters(parameters: Mapping[str, Any]) -> str:
    first, seeds = parameters["first_seed"], parameters["seeds"]
    rules = [
        f"* {name}: {rule['words']}. Holds from {rule['holds']:.0%}"
        + (f", partly from {rule['partly']:.0%}." if rule["partly"] else "; one counterexample refutes it.")
        for name, rule in parameters["rules"].items()
    ]
    return (
        f"Seeds {first} to {first + seeds - 1}; at most {parameters['max_steps']} steps a run, each of at "
        f"most {parameters['step_limit']:g} rad.\n\n" + "\n".join(rules)
    )


def _verdicts(claims: Sequence[Mapping[str, Any]]) -> str:
    own = list(dict.fromkeys(name for claim in claims for name in claim["own"]))
    rows = [("claim", "where", "verdict", "true in", "read otherwise", *own)]
    for claim in claims:
        differ = {name: each for name, each in claim["readings"].items() if _kind(each) != _kind(claim)}
        otherwise = "; ".join(f"{name}: {each['verdict']}" for name, each in differ.items())
        beside = [_judged(claim["own"][name]) if name in claim["own"] else "" for name in own]
        head = (
            f"[{claim['claim']}](#{claim['id']})",
            claim["where"],
            claim["verdict"],
            span(claim["shares"]),
        )
        rows.append((*head, otherwise, *beside))
    return _table(rows)


def _kind(found: Mapping[str, Any]) -> str:
    return str(found["verdict"]).removesuffix(" by construction")


def _judged(found: Mapping[str, Any]) -> str:
    return f"{found['verdict']}: {span(found['shares'])}"


def _details(claim: Mapping[str, Any]) -> str:
    """Return the counts for a claim: a row for each group of runs, a column for each reading."""
    lines = [
        f"### {claim['id']}",
        f"{claim['claim']} ({claim['where']}) **{claim['verdict'].capitalize()}**: {claim['rule']}. "
        f"Measured: {claim['measured']}.",
    ]
    if claim["construction"] and claim["verdict"] == "holds by construction":
        lines.append(f"It cannot fail: {claim['construction']}.")
    found = {"best reading": claim, **claim["readings"], **claim["own"]}
    tried = list(dict.fromkeys(name for each in found.values() for name in each["shares"]))
    if tried:
        rows = [("tried", *found)]
        for name in tried:
            cells = (each["shares"].get(name) for each in found.values())
            rows.append((name, *(f"{c['true']} of {c['cases']}" if c else "" for c in cells)))
        lines.append(_table(rows))
    if claim["instead"]:
        lines.append(claim["instead"])
    return "\n\n".join(lines)


def _nearness(classes: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return medians and largest values by nearness, in a table for each quantity."""
    found = []
    for quantity in dict.fromkeys(each["quantity"] for each in classes):
        own = [each for each in classes if each["quantity"] == quantity]
        bounds = sorted({(each["low"], each["high"] or float("inf")) for each in own})
        heads = [f"{low:g} to {high:g}" if high < float("inf") else f"above {low:g}" for low, high in bounds]
        rows = [(f"{quantity}: median (largest), by nearness", *heads)]
        for group in dict.fromkeys(each["group"] for each in own):
            cells = {
                each["low"]: f"{each['median']:.2g} ({each['largest']:.2g})"
                for each in own
                if each["group"] == group
            }
            rows.append((group, *(cells.get(low, "") for low, _ in bounds)))
        found.append(_table(rows))
    return found


def _table(rows: Sequence[Sequence[str]]) -> str:
    head, *rest = (f"| {' | '.join(row)} |" for row in rows)
    return "\n".join([head, "|---" * len(rows[0]) + "|", *rest])


def span(shares: Mapping[str, Mapping[str, Any]]) -> str:
    """Return the range of the shares, in words."""
    values = [each["share"] for each in shares.values()]
    if not values:
        return "no case"
    low, high = (_percent(value) for value in (min(values), max(values)))
    return low if low == high else f"{low} to {high}"


def _percent(share: float) -> str:
    """Return a share in per cent; nearly all and nearly none are not rounded to 100 % and 0 %."""
    return f"{share:.0%}" if share in (0.0, 1.0) or 0.005 <= share < 0.995 else f"{share:.2%}"
