"""The tracking scenarios of chapter 6, and the families that they belong to, as data."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal, get_args

StartKind = Literal["smooth", "near-straight", "straight"]
TargetKind = Literal["helix", "line", "near-line", "random", "opposite"]

STARTS: tuple[StartKind, ...] = get_args(StartKind)
TARGETS: tuple[TargetKind, ...] = get_args(TargetKind)


@dataclass(frozen=True)
class Scenario:
    """What an arm starts from and what it should become; a seed settles what is left open.

    Attributes:
        name: short name.
        title: what happens, in words.
        section: where the thesis describes it; empty if it does not.
        start: "smooth" for an arbitrary non-singular posture, "near-straight" for one that is almost
            singular, "straight" for the singular one.
        target: "helix" (6.17), "line" (6.16), "near-line" for a curve that is almost straight, "random" for
            an arbitrary non-singular posture, "opposite" for the start with all joints reversed, on the other
            side of the straight posture.
        arm: name of the arm, one of `pinposture.thesis.arms.ARMS`.
    """

    name: str
    title: str
    section: str
    start: StartKind
    target: TargetKind
    arm: str = "ryrz20"


SPATIAL_SCENARIOS = (
    Scenario("helix", "random -> helix", "6.1.2", "smooth", "helix"),
    Scenario("line", "random -> line", "6.1.3", "smooth", "line"),
    Scenario("from-straight", "straight -> helix", "6.1.4", "straight", "helix"),
)
"""The spatial arm; one seed gives the first two the same start, as Section 6.1.3 has it."""

PLANAR_SCENARIOS = (
    Scenario("planar-random", "random -> random", "6.2.1", "smooth", "random", "planar45"),
    Scenario("planar-near-line", "random -> near line", "6.2.2", "smooth", "near-line", "planar45"),
    Scenario("planar-from-straight", "straight -> random", "6.2.3", "straight", "random", "planar45"),
)
"""The planar arm; Section 6.2.4 takes the second once more."""

FURTHER_SCENARIOS = (
    Scenario("random", "random -> random", "", "smooth", "random"),
    Scenario("opposite", "random -> opposite", "", "smooth", "opposite"),
    Scenario("near-straight", "near-straight -> helix", "", "near-straight", "helix"),
    Scenario("planar-opposite", "random -> opposite", "", "smooth", "opposite", "planar45"),
    Scenario("planar-near-straight", "near-straight -> random", "", "near-straight", "random", "planar45"),
)
"""What the thesis speaks of and does not show: other targets, leaving and passing singular postures."""

SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {each.name: each for each in SPATIAL_SCENARIOS + PLANAR_SCENARIOS + FURTHER_SCENARIOS}
)
"""All of the above by name."""


def family(arm: str, start: StartKind, target: TargetKind) -> Scenario:
    """The scenario of an arm with that kind of start and of target, named after the three."""
    return Scenario(f"{arm}: {start} -> {target}", f"{start} -> {target}", "", start, target, arm)


_CHOICES: tuple[tuple[str, tuple[TargetKind, ...]], ...] = (
    ("ryrz20", ("helix", "line", "random")),
    ("planar45", ("line", "random")),
)

FAMILIES = tuple(
    family(arm, start, target)
    for arm, targets in _CHOICES
    for start in STARTS
    for target in targets
    if (start, target) != ("straight", "line")  # there is nothing to do
)
"""Every kind of start with every kind of target that the arm can take: a helix is not for a planar arm."""
