"""Figures 6.3 to 6.12 of the thesis, as data: which runs each shows, and how."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Literal


@dataclass(frozen=True)
class ThesisFigure:
    """One figure.

    Attributes:
        number: its number in the thesis.
        title: what it shows, in our words.
        section: where the thesis discusses it.
        layout: "postures" shows initial posture, target and final postures; "errors" shows errors and control
            points against steps; "planar" shows all of these.
        scenario: name of the scenario, one of `pinposture.thesis.scenarios.SCENARIOS`.
        controllers: names of the controllers, one run each.
        compared: names of controllers whose posture error is drawn beside for comparison.
        seed: what start and target are drawn from. The thesis does not give its own.
    """

    number: str
    title: str
    section: str
    layout: Literal["postures", "errors", "planar"]
    scenario: str
    controllers: tuple[str, ...]
    compared: tuple[str, ...] = ()
    seed: int = 0


BOTH = ("selection", "projection")
ALONE = ("projection",)

SPATIAL_SEED = 17
PLANAR_SEED = 84
"""Seeds whose runs end near the medians over 100 seeds."""

_LISTED = (
    ThesisFigure(
        "6.3", "Spatial arm, non-singular target", "6.1.2", "postures", "helix", BOTH, seed=SPATIAL_SEED
    ),
    ThesisFigure(
        "6.4", "Spatial arm, non-singular target", "6.1.2", "errors", "helix", BOTH, seed=SPATIAL_SEED
    ),
    ThesisFigure("6.5", "Spatial arm, singular target", "6.1.3", "postures", "line", BOTH, seed=SPATIAL_SEED),
    ThesisFigure("6.6", "Spatial arm, singular target", "6.1.3", "errors", "line", BOTH, seed=SPATIAL_SEED),
    ThesisFigure(
        "6.7", "Spatial arm, singular start", "6.1.4", "postures", "from-straight", ALONE, seed=SPATIAL_SEED
    ),
    ThesisFigure(
        "6.8", "Spatial arm, singular start", "6.1.4", "errors", "from-straight", ALONE, seed=SPATIAL_SEED
    ),
    ThesisFigure(
        "6.9", "Planar arm, non-singular target", "6.2.1", "planar", "planar-random", BOTH, seed=PLANAR_SEED
    ),
    ThesisFigure(
        "6.10",
        "Planar arm, nearly singular target",
        "6.2.2",
        "planar",
        "planar-near-line",
        BOTH,
        seed=PLANAR_SEED,
    ),
    ThesisFigure(
        "6.11",
        "Planar arm, singular start",
        "6.2.3",
        "planar",
        "planar-from-straight",
        ALONE,
        seed=PLANAR_SEED,
    ),
    ThesisFigure(
        "6.12",
        "Planar arm, nearly singular target, switching",
        "6.2.4",
        "planar",
        "planar-near-line",
        ("switching",),
        BOTH,
        PLANAR_SEED,
    ),
)

FIGURES: Mapping[str, ThesisFigure] = MappingProxyType({figure.number: figure for figure in _LISTED})
"""The figures by their numbers in the thesis."""
