"""The way of an arm on a feed: the path before its tip, and the straight line behind."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, UnknownName
from pinposture.target.placement import Moved
from pinposture.target.placement import laid as laid_at
from pinposture.task.feed import Fed, taken_apart

Array = NDArray[np.float64]

PLACEMENTS = ("align", "as_is")

BESIDE = 1e-5
"""How far from the straight line of the feed a path may begin, and go on while it has to follow that line, in
arm lengths."""

KINK = 1e-3
"""How far the path may leave the axis of the arm [rad]."""

AHEAD = 0.1
"""How far the tip may be ahead of the feed, or behind, in arm lengths: links that cut bends short gain a
share of (kappa l)^2 / 24, which is that for a quarter turn in each."""


@dataclass(frozen=True, eq=False)
class Passage:
    """An arm on a feed, and the way that it is to go.

    Attributes:
        fed: the arm.
        path: the path, where it lies in the world; it begins at the tip of the arm at the start.
        moved: how the path was moved there from where it was drawn.
        way: the path, with the straight line from the first joint that bends before it and one after it.
    """

    fed: Fed
    path: Curve
    way: Curve
    moved: Moved

    @property
    def deepest(self) -> float:
        """How far in the path and the feed let the arm go [m]."""
        return min(self.path.length, self.fed.travel, self.straight_on)

    @property
    def straight_on(self) -> float:
        """How far in the arm can go before its first joint, which moves straight, leaves the path [m]."""
        fed, s = self.fed, np.linspace(0.0, self.path.length, 2001)
        beside = np.linalg.norm(self.path.at(s) - (self.path.start + s[:, None] * fed.axis), axis=1)
        off = np.flatnonzero(beside > BESIDE * fed.length)
        return fed.length + float(s[max(int(off[0]) - 1, 0)] if len(off) else s[-1])


def passage(arm: Arm, path: Curve, placement: str = "align", start: ArrayLike | None = None) -> Passage:
    """Lay a path before the tip of an arm; see `follow_leader`.

    Raises:
        InvalidValue: not an arm on a feed, not a curve, or a path that does not begin at the tip.
        UnknownName: no such placement.
    """
    if not isinstance(path, Curve):
        raise InvalidValue("path", path, "a Curve")
    if placement not in PLACEMENTS:
        raise UnknownName("placement", placement, PLACEMENTS)
    fed = taken_apart(arm, start)
    if placement == "align":
        there, moved = laid_at(fed.body, path, "align", 0.0)
        laid = there.moved(np.eye(3), fed.tip - there.start)
        x, y, z = (fed.tip - path.start).tolist()
        moved = moved._replace(translation=(x, y, z))
    else:
        laid, moved = laid_at(fed.body, path, "as_is", 0.0)
        gap = float(np.linalg.norm(path.start - fed.tip))
        angle = float(np.arccos(np.clip(path.tangent(0.0) @ fed.axis, -1.0, 1.0)))
        if gap > BESIDE * fed.length or angle > KINK:
            x, y, z = fed.tip
            found = f"{gap:.4g} m from the tip, {np.degrees(angle):.3g} degrees off the axis of the arm"
            allowed = f"a path from ({x:.6g}, {y:.6g}, {z:.6g}) straight on; placement='align' moves it there"
            raise InvalidValue("start of the path", found, allowed)
    behind = led_in(laid, fed.axis, float((fed.tip - fed.body.chain.base) @ fed.axis))
    way = led_in(behind.reversed(), -laid.tangent(laid.length), ahead_of_feed(fed)).reversed()
    return Passage(fed, laid, way, moved)


def ahead_of_feed(fed: Fed) -> float:
    """How far on the way the tip may be ahead of the feed or behind, and a link more [m]."""
    return AHEAD * fed.length + float(fed.links.chain.module_lengths.max())


def led_in(curve: Curve, direction: Array, length: float) -> Curve:
    """The curve with a straight line before it.

    The line is one more span of the spline, so that the curve itself is what it was, to the last digit.

    Args:
        curve: the curve.
        direction: in which the line runs, towards the curve, unit vector (3,).
        length: of the line [m].
    """
    k = curve.degree
    spline = BSpline(curve.knots, curve.coefficients, k)
    begin = float(curve.knots[k])
    missing = k - int(np.sum(spline.t == begin))
    if missing > 0:  # a spline whose ends are not clamped: the knot is put in until it goes through a point
        spline = spline.insert_knot(begin, missing)
    last = int(np.searchsorted(spline.t, begin, side="right")) - 1
    coefficients = spline.c[last - k :]
    speed = k * np.linalg.norm(coefficients[1] - coefficients[0]) / (spline.t[last + 1] - begin)
    line = coefficients[0] - np.linspace(length, 0.0, k + 1)[:, None] * direction
    knots = np.concatenate([np.full(k + 1, begin - length / speed), spline.t[last - k + 1 :]])
    return Curve(knots, np.vstack([line, coefficients[1:]]), k)
