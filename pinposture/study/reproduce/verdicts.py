"""How a claim is judged: by the shares of cases in which it is true, against thresholds fixed beforehand."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from typing import Literal, NamedTuple

Verdict = Literal["holds", "holds partly", "does not hold", "not seen"]


class Rule(NamedTuple):
    """What share of cases a claim must be true in.

    Attributes:
        words: what kind of claim the rule is for.
        holds: least share at which the claim holds.
        partly: least share at which it holds partly.
    """

    words: str
    holds: float
    partly: float


RULES: Mapping[str, Rule] = {
    "always": Rule("guaranteed, or said of every case", 1.0, 0.5),
    "usually": Rule("said of how the method works in general", 0.9, 0.5),
    "rather": Rule("a comparison or a tendency", 0.75, 0.5),
}
"""The rules by name; the claims of `pinposture.thesis.claims` name theirs."""


class Share(NamedTuple):
    """In how many of the cases a claim is true.

    Attributes:
        true: number of cases in which it is.
        cases: number of cases.
    """

    true: int
    cases: int

    @property
    def value(self) -> float:
        """The share; 0 if there are no cases."""
        return self.true / self.cases if self.cases else 0.0


def share(truths: Iterable[bool]) -> Share:
    """The share of true ones."""
    listed = [bool(truth) for truth in truths]
    return Share(sum(listed), len(listed))


class Class(NamedTuple):
    """Something about the steps that lie within one class of nearness to a singular posture.

    Attributes:
        quantity: what it is, with its unit.
        group: what was tried.
        low: least nearness of the class: smallest singular value of the tip's Jacobian per arm length.
        high: where the class ends.
        steps: number of steps in it.
        median: median over them.
        largest: largest value.
    """

    quantity: str
    group: str
    low: float
    high: float
    steps: int
    median: float
    largest: float


class Finding(NamedTuple):
    """What was measured for a claim.

    Attributes:
        shares: in how many cases it is true, by what was tried; these decide.
        figures: further numbers that tell how it is, by name.
        instead: what holds, in words; said where the claim does not hold throughout.
        by_nearness: how it depends on the distance to the nearest singular posture, where that was measured.
    """

    shares: Mapping[str, Share]
    figures: Mapping[str, float]
    instead: str
    by_nearness: Sequence[Class] = ()


def judge(shares: Mapping[str, Share], rule: Rule) -> Verdict:
    """The verdict on a claim.

    It holds if it does in everything that was tried, does not if it does not even partly in any, and else
    holds partly. What no case was found for does not count; without any case at all it was not seen.
    """
    values = [each.value for each in shares.values() if each.cases]
    if not values:
        return "not seen"
    if min(values) >= rule.holds:
        return "holds"
    return "does not hold" if max(values) < rule.partly else "holds partly"
