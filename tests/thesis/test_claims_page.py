"""docs/claims.md: its tables are those of the results kept beside it, and say what these say."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from benchmarks.reproduce.claims import CLAIMS
from benchmarks.reproduce.measures import RULES, Share, judge
from benchmarks.reproduce.page import PARTS, span, tables, with_tables
from benchmarks.reproduce.runs import READINGS

DOCS = Path(__file__).parents[2] / "docs"
PAGE = (DOCS / "claims.md").read_text()
RESULTS = json.loads((DOCS / "claims.json").read_text())
BY_ID = {claim["id"]: claim for claim in RESULTS["claims"]}


def part(name: str) -> str:
    return PAGE.split(f"<!-- {name}: begin -->")[1].split(f"<!-- {name}: end -->")[0].strip()


def rows(text: str) -> list[list[str]]:
    """The cells of the rows of a table, without its head."""
    return [[cell.strip() for cell in line.strip("|").split("|")] for line in text.splitlines()[2:]]


@pytest.mark.parametrize("name", PARTS)
def test_the_page_is_what_the_command_writes_from_the_results(name: str) -> None:
    assert part(name) == tables(RESULTS)[name]
    assert with_tables(PAGE, RESULTS, DOCS / "claims.md") == PAGE


def test_the_results_are_those_of_the_claims_as_they_are_stated() -> None:
    assert list(BY_ID) == list(CLAIMS)
    for claim in CLAIMS.values():
        kept = BY_ID[claim.id]
        told = (kept["claim"], kept["where"], kept["measured"], kept["rule"], kept["construction"])
        assert told == (claim.text, claim.where, claim.measured, claim.rule, claim.construction)
        assert set(kept["readings"]) <= set(READINGS)
        assert kept["own"] == {}
    rules = {name: rule._asdict() for name, rule in RULES.items()}
    assert RESULTS["parameters"]["rules"] == rules


def test_each_verdict_follows_from_the_counts_by_its_rule() -> None:
    for claim in RESULTS["claims"]:
        for found in (claim, *claim["readings"].values()):
            shares = {name: Share(each["true"], each["cases"]) for name, each in found["shares"].items()}
            judged = judge(shares, RULES[claim["rule"]])
            assert found["verdict"].removesuffix(" by construction") == judged
            assert judged == "holds" or not found["verdict"].endswith("construction")


def test_the_table_of_verdicts_has_every_claim_and_its_shares() -> None:
    found = rows(part("verdicts"))
    assert len(found) == len(CLAIMS)
    for row, claim in zip(found, RESULTS["claims"], strict=True):
        assert row[0] == f"[{claim['claim']}](#{claim['id']})"
        assert row[2:4] == [claim["verdict"], span(claim["shares"])]


def test_nothing_is_rounded_to_all_or_to_nothing() -> None:
    assert span({"": {"share": 0.9999}}) == "99.99%"
    assert span({"": {"share": 0.0001}, "b": {"share": 1.0}}) == "0.01% to 100%"
    assert span({"": {"share": 0.5}}) == "50%"
    assert span({}) == "no case"


def test_changed_verdicts_end_at_those_of_today() -> None:
    for name, was, now, why in rows(part("changed")):
        claim = BY_ID[re.fullmatch(r"\[([\w-]+)\]\(#\1\)", name)[1]]  # type: ignore[index]
        assert now == claim["verdict"] != was
        assert why.endswith(".")


def test_the_command_on_the_page_has_the_seeds_of_the_results() -> None:
    parameters = RESULTS["parameters"]
    command = f"--seeds {parameters['seeds']} --seed {parameters['first_seed']} --page docs/claims.md"
    assert f"make reproduce -- claims {command}\n" in PAGE


@pytest.mark.reproduction
def test_a_few_runs_of_the_results_come_out_again() -> None:
    from benchmarks.reproduce.evaluate import MEASURES
    from benchmarks.reproduce.runs import DEFAULT, Reading, RunSet, make_pool

    first, steps = RESULTS["parameters"]["first_seed"], RESULTS["parameters"]["max_steps"]
    batches = [RunSet("from-straight", "selection"), RunSet("from-straight", "projection")]
    reading = Reading(make_pool(batches, 3, steps, first=first), READINGS[DEFAULT])
    name = "spatial, straight -> helix, projection"
    for claim in ("projection-departs", "projection-converges-from-singular"):
        found, kept = MEASURES[claim](reading).shares[name], BY_ID[claim]["shares"][name]
        assert kept["share"] == found.value == 1.0
    ((_, found),) = MEASURES["selection-cannot-start"](reading).shares.items()
    assert found.true == found.cases == 3
