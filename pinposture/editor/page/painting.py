"""Colours of the bodies of the arm: which joints are at limits, which stretches are near singular."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.editor.live import Live
from pinposture.editor.page.part import color
from pinposture.viz import palette

Colors = NDArray[np.uint8]

WAYS = ("limits that bind", "nearness to singular", "modules only")
"""What the colours can say."""

NEAR = 0.02
"""Manipulability index below which a stretch is near singular."""

SHARE = 0.2
"""How much of the arm is a stretch that is looked at."""


def paint(way: str, live: Live, shades: Colors) -> Colors:
    """Colours of the bodies, (n, 3).

    Args:
        way: one of `WAYS`.
        live: the arm.
        shades: what they are if nothing is to be said.
    """
    if way == WAYS[0] and np.any(live.at_limit):
        colors: Colors = shades.copy()
        colors[live.at_limit] = color(palette.MARK)
        return colors
    if way == WAYS[1]:
        indices = stretch_indices(live.state)
        by_module: Colors = np.array(
            [color(palette.index_color(float(index))) for index in indices], dtype=np.uint8
        )
        sizes = [len(joints) for joints in live.arm.module_joints]
        return np.repeat(by_module, sizes, axis=0)
    return shades


def stretch_indices(state: ArmState) -> NDArray[np.float64]:
    """Manipulability index of a short stretch that ends at each control point, (m,).

    The stretch is a fifth of the arm, and as many modules at least as have joints enough to move its end in
    all directions; the index is small where these modules together are near singular, as where they lie
    straight.
    """
    arm = state.arm
    width, m = stretch_width(arm), arm.n_modules
    ends = np.arange(1, m + 1)
    own: NDArray[np.float64] = state.manipulability()[np.maximum(ends - width, 0), ends]
    if width > 1:
        own[: width - 1] = own[width - 1] if m >= width else 0.0
    return own


def stretch_width(arm: Arm) -> int:
    """How many modules such a stretch has."""
    sizes = [len(joints) for joints in arm.module_joints]
    for width in range(max(1, round(SHARE * arm.n_modules)), arm.n_modules + 1):
        if all(sum(sizes[k : k + width]) >= arm.dimension for k in range(len(sizes) - width + 1)):
            return width
    return arm.n_modules


def near_singular(state: ArmState) -> list[tuple[int, int]]:
    """First and last module of each stretch that is near singular, counted from 1."""
    near = stretch_indices(state) < NEAR
    edges = np.flatnonzero(np.diff(np.concatenate([[0], near.astype(int), [0]])))
    return [(int(first) + 1, int(last)) for first, last in zip(edges[::2], edges[1::2], strict=True)]
