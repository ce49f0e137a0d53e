"""Follow the leader: an arm on a feed goes in along a path, every part of it where the tip has been."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm
from pinposture.control.checks import require_positive
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, TargetError, UnknownName
from pinposture.target import Target
from pinposture.task.passage import Passage, passage
from pinposture.task.reference import Mark, Reference
from pinposture.task.sliding_window import METHODS, Closest, Row, Sequential

Array = NDArray[np.float64]

RAMP = 0.1
"""Share of the depth on which the feed gets up to speed, and of that on which it comes to rest."""

STRIDE = 0.5
"""How far the feed goes from one row to the next at most, in lengths of the shortest link."""

MOST_ROWS = 1_000_000
"""The longest motion."""


def follow_leader(
    arm: Arm,
    path: Curve,
    interval: float,
    speed: float,
    placement: Literal["align", "as_is"] = "align",
    depth: float | None = None,
    start: ArrayLike | None = None,
    method: Literal["closest", "sequential"] = "closest",
    and_back: bool = False,
    progress: Callable[[int, int], object] | None = None,
) -> Reference:
    """Push an arm along a path, so that all of it goes where its tip has been.

    The first joint of the arm is its feed: a slide along the axis of the straight arm. The path begins at
    the entry, where the tip of the straight arm is at the start; behind the entry the way is the straight
    line of the feed. At depth d the feed has moved by d, and the arm lies in the window of the way that
    reaches from the end of the feed to its own tip. The feed is what is given; the tip is at arc length d of
    the path but for what links gain where they cut bends short: about (kappa l)^2 / 24 of the bent part, for
    links of length l from joint to joint and curvature kappa. Beyond its end the path goes straight on.

    The modules are placed in the window "closest" to it, all ends of all links by least squares, whatever the
    arm is made of; or in "sequential" order as in Algorithm 1, control points exactly on the path. The latter
    is for arms whose modules have closed forms; it leaves joints between control points farther off the path,
    and where curvature begins or ends it makes modules of two hinges zigzag (see `resolve_targets`).

    The feed is at rest at both ends; its acceleration is continuous. It has its full speed but for the first
    and the last tenth of the depth.

    Args:
        arm: the arm, on a feed, for instance `Arm.from_modules([feed, *modules])`.
        path: where the tip goes.
        interval: time between rows [s]; shortened to a whole fraction if the feed went farther than half a
            link between two rows.
        speed: largest speed of the feed [m/s].
        placement: "align" moves the beginning of the path to the tip of the arm at the start, turns its first
            tangent to the arm's axis by the least rotation, and a plane path into the plane of a planar arm;
            "as_is" takes the path where it is, which must begin there.
        depth: how far to go in [m]; if None, to the end of the path.
        start: the configuration to begin in, (nq,): straight, the feed anywhere; if None, the feed is pulled
            back as far as it goes.
        method: "closest" or "sequential".
        and_back: whether to come out again, by the same postures in reverse.
        progress: called with the number of postures found so far, and that of all.

    Returns:
        The motion asked for, with a mark "inside" where the arm is deepest and, if it comes back, a mark
        "outside" at the end; both targets know the path as it was placed.

    Raises:
        InvalidValue: an arm without a feed, a path that does not begin at its tip, is too short for the
            depth or longer than the feed can push, an interval or speed that is not above 0, or a start that
            is not straight.
        UnknownName: no such placement or method.
        CurveBendsTooMuch: the path bends more than the modules can.
        TargetError: another reason why a module has no place; all name the arc length of the path.
        UnsupportedModule: sequential placement of a module for which no solver exists.
    """
    require_positive("interval", interval)
    require_positive("speed", speed)
    if method not in METHODS:
        raise UnknownName("method", method, METHODS)
    laid = passage(arm, path, placement, start)
    deepest = _depth(laid, depth)
    fed = laid.fed
    stride = STRIDE * float(fed.links.chain.module_lengths.min())
    depths, interval = advance(deepest, speed, interval, stride)
    window: Closest | Sequential = Closest(laid) if method == "closest" else Sequential(laid)
    offsets = np.zeros((len(depths), arm.nv))
    for row, at in enumerate(depths):
        found = window.place(float(at))
        if found.failure is not None:
            raise _failure(laid, found, found.failure, float(at))
        offsets[row, fed.column] = fed.sense * at
        offsets[row, fed.columns] = found.positions - fed.straight
        if progress is not None:
            progress(row + 1, len(depths))
    # The first posture is straight, but where that is found by a search, perhaps straighter than the start.
    begin, offsets = arm.integrate(fed.start, offsets[0]), offsets - offsets[0]
    marks = [_mark(laid, begin, "inside", offsets)]
    if and_back:
        offsets = np.vstack([offsets, offsets[-2::-1]])
        marks.append(_mark(laid, begin, "outside", offsets))
    weights = np.ones((len(offsets), arm.n_modules))
    return Reference(arm, interval, begin, offsets, weights, tuple(marks))


def advance(depth: float, speed: float, interval: float, stride: float) -> tuple[Array, float]:
    """How deep the arm is at equal distances in time.

    Args:
        depth: at the end [m].
        speed: largest speed [m/s].
        interval: time between two of them [s].
        stride: how far it may go from one to the next [m].

    Returns:
        Depths from 0 on, (N + 1,) [m], and the time between two of them [s]: the interval, or a whole
        fraction of it.

    Raises:
        InvalidValue: more than `MOST_ROWS` of them.
    """
    full = 1.0 + 2.0 * RAMP  # the time that it takes, in that at full speed
    rows = full * depth / min(speed * interval, stride)
    if not rows <= MOST_ROWS:
        allowed = f"at most {MOST_ROWS} rows; {rows:.3g} are {interval:g} s or {stride:.3g} m apart"
        raise InvalidValue("speed", speed, allowed)
    interval = interval / max(int(np.ceil(speed * interval / stride)), 1)
    steps = max(int(np.ceil(full * depth / speed / interval)), 2)
    ramp = 2.0 * RAMP / full  # in all of the time, on which half as far is gone as at full speed
    t = np.linspace(0.0, 1.0, steps + 1)
    x = np.minimum(np.minimum(t, 1.0 - t) / ramp, 1.0)
    rising = ramp * (x**3 - 0.5 * x**4) + np.maximum(np.minimum(t, 1.0 - t) - ramp, 0.0)
    gone = full * np.where(t <= 0.5, rising, 1.0 / full - rising)
    return depth * gone, interval


def _depth(laid: Passage, depth: float | None) -> float:
    """How far to go in, or an error that says why not."""
    fed, path = laid.fed, laid.path
    slack = 1.0 + 1e-9
    reasons = (
        (path.length, f"the path is {path.length:.6g} m long"),
        (fed.travel, f"the feed can push by {fed.travel:.6g} m from the start"),
        (laid.straight_on, "the feed goes straight, and its end would leave the path beyond"),
    )
    most, why = min(reasons, key=lambda reason: reason[0])
    if depth is None and path.length <= most * slack:
        return most
    if depth is None:
        allowed = f"at most {most:.6g} m: {why}; depth= goes part of the way"
        raise InvalidValue("length of the path [m]", path.length, allowed)
    require_positive("depth", depth)
    if depth > most * slack:
        raise InvalidValue("depth", depth, f"at most {most:.6g} m: {why}")
    return min(float(depth), most)


def _failure(laid: Passage, found: Row, failure: TargetError, depth: float) -> TargetError:
    """The same failure, counted in modules of the whole arm and in arc length of the path."""
    fed = laid.fed
    run_up = float((fed.tip - fed.body.chain.base) @ fed.axis)
    module = failure.module + fed.arm.n_modules - fed.body.n_modules
    reason = f"{failure.reason} (at a depth of {depth:.4g} m)"
    return type(failure)(module, failure.parameter - run_up, reason)


def _mark(laid: Passage, begin: Array, name: str, offsets: Array) -> Mark:
    """The last row, with a name."""
    arm = laid.fed.arm
    q = arm.integrate(begin, offsets[-1])
    target = Target(arm.at(q).points, np.ones(arm.n_modules), q=q, curve=laid.path, moved=laid.moved)
    return Mark(name, len(offsets) - 1, target)
