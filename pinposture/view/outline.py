"""The line that a target posture lies on."""

from __future__ import annotations

from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.target import Target
from pinposture.view.body import backbone, bodies

Array = NDArray[np.float64]
Number = TypeVar("Number", int, float)

SAMPLES = 400
BEYOND = 0.6
"""How much of a curve is shown beyond the last target point, relative to the length of the arm."""


class Outline(NamedTuple):
    """A target as lines, in pieces.

    Attributes:
        covered: what the arm should lie on: the curve between target points that follow each other, or
            without a curve the target posture if it is known, each (n, 3) [m], world frame; none if neither
            is. The base counts as such a point.
        rest: what there is of it before, between and after these, each (k, 3) [m], world frame.
    """

    covered: tuple[Array, ...]
    rest: tuple[Array, ...]


def outline(arm: Arm, target: Target) -> Outline:
    """The line that a target posture lies on, as far as it is known."""
    if target.curve is None:
        return Outline((), ()) if target.q is None else _posture(arm, target.q, target.placed)
    curve, length = target.curve, target.curve.length
    if target.parameters is None:
        return Outline((curve.at(np.linspace(0.0, length, SAMPLES)),), ())
    places = np.clip(np.append(0.0, target.parameters), 0.0, length)
    end = float(np.max(places[1:][target.placed], initial=0.0))
    spans = [(float(places[run].min()), float(places[run].max())) for run in _runs(target.placed)]
    covered = _merged(spans)
    edges = [0.0, *(edge for span in covered for edge in span), min(length, end + BEYOND * arm.length)]
    # Less than this of a line cannot be seen, and may not have a direction.
    least = 1e-6 * length
    lines = [
        tuple(curve.at(np.linspace(a, b, SAMPLES)) for a, b in parts if b - a > least)
        for parts in (covered, zip(edges[::2], edges[1::2], strict=True))
    ]
    return Outline(*lines)


def _posture(arm: Arm, q: Array, placed: NDArray[np.bool_]) -> Outline:
    """The posture at a configuration, in pieces from control point to control point."""
    line, ends, count = backbone(arm, q), [0], 1
    for body in bodies(arm):
        if body.point is not None:
            ends.append(count + int(np.linalg.norm(body.nodes - body.point, axis=1).argmin()))
        count += len(body.nodes)
    spans = _merged([(ends[run[0]], ends[run[-1]]) for run in _runs(placed)])
    edges = [0, *(edge for span in spans for edge in span), ends[-1]]
    pieces = [
        tuple(line[a : b + 1] for a, b in parts if b > a)
        for parts in (spans, zip(edges[::2], edges[1::2], strict=True))
    ]
    return Outline(*pieces)


def _runs(placed: NDArray[np.bool_]) -> list[NDArray[np.intp]]:
    """Points that have a target and follow each other; 0 is the base, which is where it should be."""
    here = np.flatnonzero(np.append(True, placed))
    return np.split(here, np.flatnonzero(np.diff(here) > 1) + 1)


def _merged(spans: list[tuple[Number, Number]]) -> list[tuple[Number, Number]]:
    """Spans in increasing order, those that overlap made one."""
    merged: list[tuple[Number, Number]] = []
    for low, high in sorted(spans):
        if merged and low <= merged[-1][1]:
            merged[-1] = (merged[-1][0], max(merged[-1][1], high))
        else:
            merged.append((low, high))
    return merged
