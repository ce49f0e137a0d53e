"""Follow the leader: an arm on a feed goes in along a path, every part of it where the tip has been."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.interpolate import BSpline

from pinposture._validation import require_positive
from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import CurveBendsTooMuch, InvalidValue, TargetError, UnknownName, UnsupportedModule
from pinposture.placement import Target
from pinposture.placement.curve_placement import Moved, arm_axis
from pinposture.placement.curve_placement import laid as laid_at
from pinposture.placement.resolve import place_in_turn
from pinposture.task.reference import Mark, Reference

# An arm on a feed: a slide that pushes the whole arm along its own axis, and the arm that it carries.

Array = NDArray[np.float64]

NEEDED = (
    "an arm whose first joint is a slide along the straight arm and whose second is not, as "
    "Arm.from_modules([feed, *modules]) makes it of a feed with one prismatic joint about x"
)
ALONG = 1e-6
"""How far the axis of the feed may be off that of the straight arm, sine of the angle between them."""

STRAIGHT = 1e-6
"""How far a joint may be from where the arm is straight to count as being there, in `Arm.joint_units`."""

WITHOUT_LENGTH = 1e-9
"""Links shorter than this count as none, relative to the arm."""


@dataclass(frozen=True, eq=False)
class Fed:
    """An arm on a feed, taken apart.

    Attributes:
        arm: the whole arm.
        start: the configuration to begin in, (nq,): straight.
        column: index of the feed in the tangent space of the arm.
        sense: 1 if larger positions of the feed push the arm out, -1 if smaller ones do.
        travel: how far the feed can push from the start [m].
        body: the arm without its feed, where the start puts it; its control points are those of the arm that
            bending moves.
        links: the same with a control point at the end of each link, so at each joint and at the tip.
        columns: index in the tangent space of the arm of each degree of freedom of the body, (nv - 1,).
        straight: joint positions of the body at the start, (nv - 1,) [rad or m].
        axis: direction in which the feed pushes, unit vector (3,), world frame.
        tip: where the tip is at the start, (3,) [m], world frame.
    """

    arm: Arm
    start: Array
    column: int
    sense: float
    travel: float
    body: Arm
    links: Arm
    columns: NDArray[np.intp]
    straight: Array
    axis: Array
    tip: Array

    @property
    def length(self) -> float:
        """Length of what the feed carries, from its first joint to the tip [m]."""
        return self.body.length


def taken_apart(arm: Arm, start: ArrayLike | None = None) -> Fed:
    """Find the feed of an arm.

    Args:
        arm: the arm.
        start: configuration to begin in, straight, (nq,); if None, the feed is pulled back as far as it goes
            and the arm is stretched.

    Raises:
        InvalidValue: not an arm on a feed, a feed without limits, or a start that is not straight.
    """
    if not isinstance(arm, Arm):
        raise InvalidValue("arm", arm, NEEDED)
    chain = arm.chain
    if len(chain.joints) < 2 or chain.revolute[0] or not chain.revolute[1]:
        kinds = ["revolute" if turns else "prismatic" for turns in chain.revolute[:2]]
        first = ", ".join(f"{name} ({kind})" for name, kind in zip(chain.joints, kinds, strict=False))
        raise InvalidValue("first joints of the arm", first, NEEDED)
    column = int(chain.columns[0])
    lower, upper = float(arm.limits.lower[column]), float(arm.limits.upper[column])
    if not (np.isfinite(lower) and np.isfinite(upper)):
        raise InvalidValue(f"limits of the feed {chain.joints[0]!r}", (lower, upper), "finite positions [m]")
    columns = np.delete(np.arange(arm.nv), column)
    rest = arm.positions(arm.neutral() if start is None else arm.checked(start, "start"))
    body, links = _carried(arm, rest)
    axis, stretched = arm_axis(body), body.positions(body.straight())
    along = float(chain.axes[0] @ axis)
    if float(np.linalg.norm(np.cross(chain.axes[0], axis))) > ALONG:
        angle = float(np.degrees(np.arccos(np.clip(abs(along), 0.0, 1.0))))
        text = f"{angle:.3g} degrees off the straight arm"
        raise InvalidValue(f"axis of the feed {chain.joints[0]!r}", text, NEEDED)
    if start is None:
        rest[column], rest[columns] = lower if along > 0.0 else upper, stretched
        body, links = _carried(arm, rest)
    else:
        bent = np.abs(rest[columns] - stretched) / body.joint_units
        if bent.max() > STRAIGHT or not arm.within_limits(arm.configuration(rest)):
            straight = "the straight arm, within its limits, wherever the feed is"
            raise InvalidValue("start", start, straight)
    return Fed(
        arm=arm,
        start=arm.configuration(rest),
        column=column,
        sense=1.0 if along > 0.0 else -1.0,
        travel=upper - float(rest[column]) if along > 0.0 else float(rest[column]) - lower,
        body=body,
        links=links,
        columns=columns,
        straight=rest[columns],
        axis=axis,
        tip=body.at(body.configuration(rest[columns])).compiled.points[-1],
    )


def _carried(arm: Arm, positions: Array) -> tuple[Arm, Arm]:
    """The arm with its feed locked: with its own control points, and with one at the end of each link."""
    chain = arm.chain
    feed = arm.model.getJointId(chain.joints[0])
    model = pin.buildReducedModel(arm.model, [feed], arm.configuration(positions))
    # A first module that is the feed alone has nothing left to move its control point.
    first = 1 if len(chain.module_starts) > 1 and chain.module_starts[1] == 1 else 0
    body = Arm.from_model(model, arm.control_points[first:])
    places = [pin.SE3.Identity()]
    for joint in range(1, model.njoints):
        places.append(places[model.parents[joint]] * model.jointPlacements[joint])
    ends, names = [*body.chain.origins[1:], body.chain.points[-1]], []
    for name, begin, end in zip(body.chain.joints, body.chain.origins, ends, strict=True):
        if np.linalg.norm(end - begin) > WITHOUT_LENGTH * body.length:
            joint = model.getJointId(name)
            there = places[joint].inverse() * pin.SE3(np.eye(3), np.asarray(end))
            names.append(f"end of the link after {name}")
            model.addFrame(pin.Frame(names[-1], joint, there, pin.FrameType.OP_FRAME))
    return body, Arm.from_model(model, names)


# The way of an arm on a feed: the path before its tip, and the straight line behind.

PATH_PLACEMENTS = ("align", "as_is")

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
    if placement not in PATH_PLACEMENTS:
        raise UnknownName("placement", placement, PATH_PLACEMENTS)
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


# Where an arm on a feed belongs on its way, depth by depth.

Method = Literal["closest", "sequential"]

PATH_METHODS: tuple[Method, ...] = ("closest", "sequential")

BENDING = 1e-3
"""What one radian of bending weighs against distance from the way, in mean link lengths [1/rad]: a trace, so
that joints that move nothing off the way stay where they are."""

ITERATIONS, SETTLED = 20, 1e-8
"""Most Gauss-Newton steps of a posture, and the largest motion of a joint at which it is found."""

OFF_THE_WAY = 0.25
"""How far off the way the end of a link may be, in module lengths: as far as the middle of a module of one
hinge whose ends are on an arc on which it turns by a quarter turn."""

SAMPLES = 80
"""How many samples of the way there are to a mean link length, for the sequential placement."""


class WindowRow(NamedTuple):
    """A posture on the way.

    Attributes:
        positions: joint positions of the body, (nv - 1,) [rad or m].
        failure: why there is none; None if there is.
    """

    positions: Array
    failure: TargetError | None


class Sequential:
    """Algorithm 1: each module where it first crosses the way, from the end of the feed on."""

    def __init__(self, laid: Passage) -> None:
        fed = laid.fed
        self._laid = laid
        self._samples = int(np.ceil(SAMPLES * laid.way.length * fed.links.n_modules / fed.length)) + 1

    def place(self, depth: float) -> WindowRow:
        """The posture at a depth [m]."""
        # The arm stays and the way moves, which is the same.
        fed = self._laid.fed
        shifted = self._laid.way.moved(np.eye(3), -depth * fed.axis)
        try:
            placed = place_in_turn(fed.body, shifted, self._samples)
        except UnsupportedModule as error:
            module = error.module + fed.arm.n_modules - fed.body.n_modules
            raise UnsupportedModule(module, error.joints, error.reason) from None
        return WindowRow(placed.positions, placed.failure)


class ClosestPlacement:
    """The whole arm as close to the way as it can be: least squares over the ends of all links.

    Minimised are the distances across the way, from one depth to the next by a few Gauss-Newton steps within
    the joint limits. Where along the way a link ends follows from the links and from where the feed is.
    """

    def __init__(self, laid: Passage) -> None:
        fed = laid.fed
        self._laid = laid
        ends = np.vstack([fed.links.chain.base, fed.links.chain.points])
        lengths = np.linalg.norm(np.diff(ends, axis=0), axis=1)
        self._s = np.cumsum(lengths)
        self._depth = 0.0
        self._positions = fed.straight.copy()
        self._bending = (BENDING * float(lengths.mean()) / fed.body.joint_units) ** 2
        self._lower, self._upper = fed.body.limits.lower, fed.body.limits.upper
        self._allowed = OFF_THE_WAY * fed.length / fed.body.n_modules

    def place(self, depth: float) -> WindowRow:
        """The posture at a depth [m], next to the one found last."""
        self._s = self._s + (depth - self._depth)
        self._depth = depth
        for _ in range(ITERATIONS):
            step = self._step()
            self._positions = self._positions + step
            if np.abs(step / self._laid.fed.body.joint_units).max() < SETTLED:
                break
        return WindowRow(self._positions, self._failure())

    def _step(self) -> Array:
        """The Gauss-Newton step from where the arm is."""
        fed, way, x = self._laid.fed, self._laid.way, self._positions
        state = fed.links.at(fed.links.configuration(x)).compiled
        points = state.points + self._depth * fed.axis
        for _ in range(2):  # the feet of the ends of the links on the way
            ahead = np.einsum("ij,ij->i", points - way.at(self._s), way.tangent(self._s))
            self._s = np.clip(self._s + ahead, 0.0, way.length)
        gaps, tangents = way.at(self._s) - points, way.tangent(self._s)
        along = np.einsum("ij,ijk->ik", tangents, state.jacobians)
        across = (state.jacobians - tangents[:, :, None] * along[:, None, :]).reshape(-1, len(x))
        error = (gaps - tangents * np.einsum("ij,ij->i", gaps, tangents)[:, None]).ravel()
        hessian = across.T @ across + np.diag(self._bending)
        gradient = across.T @ error - self._bending * (x - fed.straight)
        return _within(hessian, gradient, self._lower - x, self._upper - x)

    def _failure(self) -> TargetError | None:
        fed = self._laid.fed
        ends = fed.links.at(fed.links.configuration(self._positions)).compiled.points + self._depth * fed.axis
        off = np.linalg.norm(self._laid.way.at(self._s) - ends, axis=1)
        if off.max() <= self._allowed:
            return None
        link = int(np.argmax(off > self._allowed))
        joint = fed.links.chain.module_starts[link]
        module = int(np.searchsorted(fed.body.module_starts, joint, side="right"))
        advice = "use a gentler path, wider joint limits or shorter modules"
        text = f"the closest that it can come to the path is {off[link]:.4g} m; {advice}"
        return CurveBendsTooMuch(module, float(self._s[link]), text)


def _within(hessian: Array, gradient: Array, lower: Array, upper: Array) -> Array:
    """The step that a quadratic model asks for, joints that would leave their limits held there."""
    step, held = np.zeros(len(gradient)), np.zeros(len(gradient), dtype=np.bool_)
    while not held.all():
        free = ~held
        rest = gradient[free] - hessian[np.ix_(free, held)] @ step[held]
        step[free] = np.linalg.solve(hessian[np.ix_(free, free)], rest)
        over = free & ((step < lower) | (step > upper))
        step = np.clip(step, lower, upper)
        if not over.any():
            break
        held |= over
    return step


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
    if method not in PATH_METHODS:
        raise UnknownName("method", method, PATH_METHODS)
    laid = passage(arm, path, placement, start)
    deepest = _depth(laid, depth)
    fed = laid.fed
    stride = STRIDE * float(fed.links.chain.module_lengths.min())
    depths, interval = advance(deepest, speed, interval, stride)
    window: ClosestPlacement | Sequential = (
        ClosestPlacement(laid) if method == "closest" else Sequential(laid)
    )
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


def _failure(laid: Passage, found: WindowRow, failure: TargetError, depth: float) -> TargetError:
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
    target = Target(arm.at(q).compiled.points, np.ones(arm.n_modules), q=q, curve=laid.path, moved=laid.moved)
    return Mark(name, len(offsets) - 1, target)


# What following the leader is asked for.

PATH_PLACEMENTS = ("align", "as_is")
"""How a path may be put to the tip of the arm."""

MAX_SIZE_RATIO = 1000
"""How many arms long a path is at most, and how many pipe radii an arm."""


class Leader(NamedTuple):
    """What `follow_leader` is asked for.

    Attributes:
        path: where the tip goes.
        speed: largest speed of the feed [m/s].
        depth: how far to go in [m]; None: to the end.
        placement: as for `follow_leader`; None for what `usual_placement` says of the scene.
        method: as for `follow_leader`.
        and_back: whether to come out again.
        pipe: radius of the pipe around the path, in which the arm has to stay [m]; None: there is none.
    """

    path: Curve
    speed: float
    depth: float | None = None
    placement: Any = None
    method: Any = "closest"
    and_back: bool = False
    pipe: float | None = None


def check_leader(leader: Leader, arm: Arm) -> None:
    """Refuse what makes no motion, and sizes that are beside all reason for the arm.

    Raises:
        InvalidValue: names the attribute.
        UnknownName: a `placement` or `method` that does not exist.
    """
    if not isinstance(leader.path, Curve):
        raise InvalidValue("path", leader.path, "a Curve")
    require_positive("speed", leader.speed)
    for name in ("depth", "pipe"):
        if getattr(leader, name) is not None:
            require_positive(name, getattr(leader, name))
    for name, allowed in (("placement", PATH_PLACEMENTS), ("method", tuple(PATH_METHODS))):
        if getattr(leader, name) not in allowed and not (name == "placement" and leader.placement is None):
            raise UnknownName(name, getattr(leader, name), allowed)
    if not isinstance(leader.and_back, bool):
        raise InvalidValue("and_back", leader.and_back, "True or False")
    if leader.path.length > MAX_SIZE_RATIO * arm.length:
        longest = f"{MAX_SIZE_RATIO * arm.length:.4g} m, {MAX_SIZE_RATIO} times the arm"
        raise InvalidValue("length of the path [m]", leader.path.length, longest)
    if leader.pipe is not None and leader.pipe < arm.length / MAX_SIZE_RATIO:
        raise InvalidValue(
            "pipe", leader.pipe, f"{arm.length / MAX_SIZE_RATIO:.4g} m or more, 1/{MAX_SIZE_RATIO} of the arm"
        )
