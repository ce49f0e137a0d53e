"""Where the joints of an arm repeat."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm.skeleton import Skeleton

Array = NDArray[np.float64]

ALIKE = 0.02
"""How far links that count as equal may differ, relative to the mean distance between joints."""
LONGEST_PERIOD = 12


class Repetition(NamedTuple):
    """A stretch of joints that repeats a shorter one at least twice.

    Attributes:
        period: number of joints after which it repeats.
        first: index of the first joint of the stretch.
        stop: index after its last joint.
    """

    period: int
    first: int
    stop: int


def repetitions(skeleton: Skeleton) -> list[Repetition]:
    """Every stretch of the arm that repeats, shortest period first.

    Two joints are alike if both turn or both slide and the links after them are alike up to a rigid motion
    or reflection. A link is described by quantities that no joint position and no choice of frames changes:
    its length, how far along either joint axis it reaches, the angle between the axes and their volume with
    the link. The link of the last joint of the stretch may differ, for what follows it may.
    """
    links, n = _links(skeleton), len(skeleton.names)
    found = []
    for period in range(1, min(n // 2, LONGEST_PERIOD) + 1):
        same_kind = skeleton.revolute[:-period] == skeleton.revolute[period:]
        difference = np.abs(links[:-period] - links[period:])
        same_link = np.all(~(difference > ALIKE), axis=1)  # the last joint has no axis after it: NaN
        u = 0
        while u < n - period:
            first = u
            while u < n - period and same_kind[u] and same_link[u]:
                u += 1
            stop = u + period + (1 if u < n - period and same_kind[u] else 0)
            if stop - first >= 2 * period:
                found.append(Repetition(period, first, stop))
            u += 1
    return found


def _links(skeleton: Skeleton) -> Array:
    """Invariants of the link after each joint, (n, 5), lengths relative to the mean."""
    spans = np.diff(skeleton.stations, axis=0) * (len(skeleton.names) / skeleton.length)
    before = skeleton.axes
    after = np.vstack([skeleton.axes[1:], np.full(3, np.nan)])
    along_before = np.einsum("ui,ui->u", before, spans)
    along_after = np.einsum("ui,ui->u", after, spans)
    angle = np.einsum("ui,ui->u", before, after)
    volume = np.einsum("ui,ui->u", np.cross(before, after), spans)
    invariants = np.stack([along_before, along_after, angle, volume], axis=1)
    return np.column_stack([np.linalg.norm(spans, axis=1), np.abs(invariants)])
