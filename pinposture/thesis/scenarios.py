"""The spatial tracking scenarios of Sections 6.1.2 to 6.1.4, as data."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from pinposture.curve import Curve
from pinposture.thesis.curves import HELIX, LINE


@dataclass(frozen=True)
class Scenario:
    """What the 20-module RyRz arm starts from and what it should become.

    Attributes:
        name: short name.
        title: what happens, in words.
        section: where the thesis describes it.
        start: "smooth" for an arbitrary non-singular posture, drawn from a seed, or "straight".
        curve: the target curve, to be aligned with the arm.
    """

    name: str
    title: str
    section: str
    start: Literal["smooth", "straight"]
    curve: Curve


SPATIAL_SCENARIOS = (
    Scenario("helix", "random -> helix", "6.1.2", "smooth", HELIX),
    Scenario("line", "random -> line", "6.1.3", "smooth", LINE),
    Scenario("from-straight", "straight -> helix", "6.1.4", "straight", HELIX),
)
