"""The named places of a motion, as pictures show them: which, and in what colour."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pinposture.motion import Motion
from pinposture.view import palette

MOST = 8
"""How many places a picture shows at most; of more, some are left out."""

LONGEST = 22
"""Characters of a name that there is room for."""

SAME = 1e-4
"""How far apart the control points of two postures may be that look the same, in lengths of the arm."""


class Place(NamedTuple):
    """A named place that the motion came to.

    Attributes:
        name: what it is called, not too long.
        row: the row of the motion at which the arm was there.
        color: pale for an early one, dark for a late one.
    """

    name: str
    row: int
    color: str


def shown_places(motion: Motion) -> list[Place]:
    """The places that a motion came to, in order; of very many the first, the last and some in between."""
    reached = [(place.name, place.row) for place in motion.passed if place.row is not None]
    if len(reached) > MOST:
        reached = [reached[k] for k in np.round(np.linspace(0, len(reached) - 1, MOST)).astype(int)]
    shares = np.linspace(1.0, 0.0, len(reached))[::-1]  # the only one is the last one
    colors = [palette.in_time(float(share)) for share in shares]
    return [Place(_short(name), row, color) for (name, row), color in zip(reached, colors, strict=True)]


def alike(motion: Motion, places: Sequence[Place]) -> list[list[Place]]:
    """The places in order, those together where the arm looked the same."""
    points, apart = motion.run.points, SAME * motion.arm.length
    groups: list[list[Place]] = []
    for place in places:
        for group in groups:
            if np.linalg.norm(points[place.row] - points[group[0].row], axis=1).max() < apart:
                group.append(place)
                break
        else:
            groups.append([place])
    return groups


def _short(name: str) -> str:
    """A name without its middle if it is long: what tells it from others may be at either end."""
    name = " ".join(name.split())
    return name if len(name) <= LONGEST else f"{name[: LONGEST - 11].rstrip()}...{name[-8:].lstrip()}"
