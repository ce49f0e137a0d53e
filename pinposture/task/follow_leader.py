"""Follow the leader: an arm on a feed moves along a path; deviation of the arm from the path of its tip."""

from __future__ import annotations

from collections.abc import Callable
from copy import copy
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Annotated, Any, Literal, NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from pydantic import ValidationInfo, model_validator
from scipy.interpolate import BSpline
from scipy.spatial import cKDTree

from pinposture._validation import (
    LARGEST_COORDINATE,
    finite_array,
    require_function,
    require_instance,
    require_known,
    require_positive,
)
from pinposture.arm import Arm
from pinposture.arm.kinematics import neutral_placements
from pinposture.collision import Capsule, Cylinder, Scene, Sphere
from pinposture.collision.bodies import bodies_of
from pinposture.collision.scene import USUAL_MARGIN
from pinposture.curve import Curve
from pinposture.curve.curve import CurveField
from pinposture.errors import (
    CurveBendsTooMuch,
    InvalidValue,
    PostureError,
    TargetError,
    UnsupportedModule,
    gather,
    raise_together,
)
from pinposture.placement import Target
from pinposture.placement.resolve import place_in_turn
from pinposture.placement.target import arm_axis, place_curve
from pinposture.quadratic_program import solve
from pinposture.schema import (
    Declared,
    Flag,
    Length,
    OutputFile,
    Refusal,
    Speed,
    declared,
    in_file,
    one_of,
)
from pinposture.task.keyframe import usual_placement
from pinposture.task.reference import Reference, Waypoint
from pinposture.toml import Usual
from pinposture.units import CONVERGED, ROUNDING, length_text

# An arm on a feed: a slide that pushes the whole arm along its axis.

Array = NDArray[np.float64]

FEED_REQUIREMENT = (
    "an arm whose first joint is prismatic, along the straight arm, and whose second is revolute, "
    "such as Arm.from_modules([feed, *modules]) with a feed of one prismatic joint along x"
)


class FeedTolerances(NamedTuple):
    """Which arms and starts count as an arm on a feed."""

    axis: float = 1e-6
    """Largest sine of the angle between the axis of the feed and that of the straight arm."""

    tip_lead: float = 0.1
    """Largest lead or lag of the tip relative to the feed, in arm lengths: links that cut bends short gain
    a share of (kappa l)^2 / 24, which is this much for a quarter turn in each."""


FEED = FeedTolerances()


class FedArm:
    """An arm on a feed, split into the feed and the body that it carries.

    Args:
        arm: the arm.
        start: the initial, straight configuration, (nq,); if None, the feed is fully retracted and the arm
            is straight.

    Attributes:
        arm: the whole arm.
        start: the initial configuration, (nq,).
        column: index of the feed in the tangent space of the arm.
        sense: 1 if larger positions of the feed push the arm out, -1 if smaller ones do.
        travel: remaining travel of the feed from the start [m].
        body: the arm without its feed, placed as at the start; its control points are those of the arm that
            bending moves.
        links: the body with a control point at the end of each link, so at each joint and at the tip.
        columns: index in the tangent space of the arm of each degree of freedom of the body, (nv - 1,).
        straight: joint positions of the body at the start, (nv - 1,) [rad or m].
        axis: direction of the feed, unit vector (3,), world frame.
        tip: position of the tip at the start, (3,) [m], world frame.
        length: length of the body, from its first joint to the tip [m].
        run_up: length of the straight line from the first joint of the body to the tip at the start [m].
        max_tip_lead: largest lead or lag of the tip relative to the feed along the route, plus a link [m].
        misfits: why it cannot follow a path: a feed that is not along the axis, a start that is not straight.

    Raises:
        InvalidValue: not an arm on a feed, a feed without limits, or coupled joints.
    """

    def __init__(self, arm: Arm, start: ArrayLike | None = None) -> None:
        require_instance("arm", arm, Arm, FEED_REQUIREMENT)
        raise_together(_not_fed(arm))
        chain = arm.chain
        column = int(chain.columns[0])
        feed = repr(chain.joints[0])
        lower = float(arm.limits.lower[column])
        upper = float(arm.limits.upper[column])
        columns = np.delete(np.arange(arm.nv), column)
        rest = arm.positions(arm.neutral() if start is None else arm.checked(start, "start"))
        body, links = _without_feed(arm, rest)
        axis = arm_axis(body)
        stretched = body.positions(body.straight())
        along = float(chain.axes[0] @ axis)
        self.misfits: list[PostureError] = []
        if float(np.linalg.norm(np.cross(chain.axes[0], axis))) > FEED.axis:
            angle = float(np.degrees(np.arccos(np.clip(abs(along), 0.0, 1.0))))
            beside = np.linalg.norm(np.cross(chain.axes[0], body.at(body.straight()).points[-1] - chain.base))
            text = f"{angle:.3g} degrees off the straight arm, whose tip is {1e3 * beside:.3g} mm beside it"
            tolerance = f"{np.degrees(FEED.axis):.2g} degrees"
            allowed = f"{FEED_REQUIREMENT}, to within {tolerance}; choose a tip on the axis"
            self.misfits.append(InvalidValue(f"axis of the feed {feed}", text, allowed))
        if start is None:
            rest[column] = lower if along > 0.0 else upper
            rest[columns] = stretched
            body, links = _without_feed(arm, rest)
        else:
            self.misfits += _not_straight(arm, rest, columns, stretched)
        self.arm = arm
        self.body = body
        self.links = links
        self.start: Array = arm.configuration(rest)
        self.column = column
        self.columns = columns
        self.axis = axis
        self.sense = 1.0 if along > 0.0 else -1.0
        self.travel = upper - float(rest[column]) if along > 0.0 else float(rest[column]) - lower
        self.straight: Array = rest[columns]
        self.tip: Array = body.chain_at(body.configuration(rest[columns])).points[-1]
        self.length = body.length
        self.run_up = float((self.tip - body.chain.base) @ axis)
        self.max_tip_lead = FEED.tip_lead * body.length + float(links.chain.module_lengths.max())


def _not_fed(arm: Arm) -> list[PostureError]:
    """Return why an arm is not one on a feed; empty if it is."""
    chain = arm.chain
    problems = list[PostureError]()
    if arm.couplings:
        name, leader, *_ = arm.couplings[0]
        problems.append(
            InvalidValue(f"joint {name!r}", f"follows {leader!r}", "an arm without coupled joints")
        )
    if len(chain.joints) < 2 or chain.revolute[0] or not chain.revolute[1]:
        kinds = ["revolute" if turns else "prismatic" for turns in chain.revolute[:2]]
        first = ", ".join(f"{name} ({kind})" for name, kind in zip(chain.joints, kinds, strict=False))
        return [*problems, InvalidValue("first joints of the arm", first, FEED_REQUIREMENT)]
    column = int(chain.columns[0])
    edges = float(arm.limits.lower[column]), float(arm.limits.upper[column])
    if not np.all(np.isfinite(edges)):
        problems.append(
            InvalidValue(f"limits of the feed {chain.joints[0]!r}", edges, "finite positions [m]")
        )
    return problems


def _not_straight(arm: Arm, start: Array, columns: NDArray[np.intp], straight: Array) -> list[PostureError]:
    """Return why joint positions (nv,) are not a start: bent joints, and joints beyond their limits."""
    problems = list[PostureError]()
    bent = np.abs(start[columns] - straight) / arm.joint_units[columns]
    if bent.max() > CONVERGED:
        worst = int(columns[np.argmax(bent)])
        number = int(np.sum(bent > CONVERGED))
        text = f"{number} of {len(bent)} joints bent, most {arm.joint_names[worst]}, by {bent.max():.4g}"
        allowed = f"the straight arm, to within {CONVERGED:g} (rad or module lengths)"
        problems.append(InvalidValue("start", text, f"{allowed}, at any position of the feed"))
    over = np.maximum(start - arm.limits.upper, arm.limits.lower - start)
    if not arm.within_limits(arm.configuration(start)):
        worst = int(np.argmax(over))
        text = f"{arm.joint_names[worst]} at {start[worst]:.4g}, {over[worst]:.4g} beyond its limit"
        low = arm.limits.lower[worst]
        high = arm.limits.upper[worst]
        problems.append(InvalidValue("start", text, f"from {low:.4g} to {high:.4g}"))
    return problems


def _without_feed(arm: Arm, positions: Array) -> tuple[Arm, Arm]:
    """Lock the feed; return the arm with its own control points, and with one at the end of each link."""
    chain = arm.chain
    feed = arm.model.getJointId(chain.joints[0])
    model = pin.buildReducedModel(arm.model, [feed], arm.configuration(positions))
    # No joint is left that moves the control point of a first module that is the feed alone.
    first = 1 if len(chain.module_starts) > 1 and chain.module_starts[1] == 1 else 0
    body = Arm.from_model(model, arm.control_points[first:])
    placements = neutral_placements(model)
    ends = [*body.chain.origins[1:], body.chain.points[-1]]
    names = []
    for name, begin, end in zip(body.chain.joints, body.chain.origins, ends, strict=True):
        if np.linalg.norm(end - begin) > ROUNDING * body.length:
            joint = model.getJointId(name)
            there = placements[joint].inverse() * pin.SE3(np.eye(3), np.asarray(end))
            names.append(f"end of the link after {name}")
            model.addFrame(pin.Frame(names[-1], joint, there, pin.FrameType.OP_FRAME))
    return body, Arm.from_model(model, names)


# The route of an arm on a feed: the path ahead of its tip, extended straight at both ends.

PATH_PLACEMENTS = ("align", "as_is")
"""Placements of a path relative to the tip of the arm."""


class RouteSettings(NamedTuple):
    """Where a path has to begin, and how it is sampled."""

    curvature_samples: int = 2001
    """Number of samples of a path for its largest curvature."""

    line: float = 1e-5
    """Largest distance of the path from the axis of the feed where it has to follow it, in arm lengths."""

    max_entry_angle: float = 1e-3
    """Largest angle between the path and the axis of the arm at the entry [rad]."""


ROUTE = RouteSettings()


class Route:
    """The curve that an arm on a feed follows: the path from its tip on, extended straight at both ends.

    Args:
        arm: the arm.
        path: the path.
        placement: as for `follow_leader`.
        start: as for `follow_leader`.

    Attributes:
        fed: the arm.
        path: the path in the world, from the tip of the arm at the start.
        moved: how the path was moved from its position as drawn.
        whole: the path, with a straight line from the first joint that bends before it and one after it.
        misfits: why the arm cannot follow it: those of the arm, and a path that does not begin at the tip.

    Raises:
        InvalidValue: not an arm on a feed, or not a curve.
        UnknownName: no such placement.
    """

    def __init__(
        self, arm: Arm, path: Curve, placement: str = "align", start: ArrayLike | None = None
    ) -> None:
        require_instance("path", path, Curve, "a Curve")
        require_known("placement", placement, PATH_PLACEMENTS)
        self.fed = fed = FedArm(arm, start)
        self.misfits = list(fed.misfits)
        placed, moved = place_curve(fed.body, path, placement, 0.0)
        if placement == "align":
            placed = placed.moved(np.eye(3), fed.tip - placed.start)
            x, y, z = (fed.tip - path.start).tolist()
            moved = moved._replace(translation=(x, y, z))
        else:
            self.misfits += _off_the_entry(fed, path)
        self.path = placed
        self.moved = moved
        behind = _prepend_line(placed, fed.axis, fed.run_up)
        end = placed.tangent(placed.length)
        self.whole = _prepend_line(behind.reversed(), -end, fed.max_tip_lead).reversed()

    @property
    def max_straight_depth(self) -> float:
        """Depth at which the first joint of the body, which moves straight, leaves the path [m]."""
        fed = self.fed
        s = np.linspace(0.0, self.path.length, 2001)
        distances = np.linalg.norm(self.path.at(s) - (self.path.start + s[:, None] * fed.axis), axis=1)
        off = np.flatnonzero(distances > ROUTE.line * fed.length)
        return fed.length + float(s[max(int(off[0]) - 1, 0)] if len(off) else s[-1])


def _off_the_entry(fed: FedArm, path: Curve) -> list[PostureError]:
    """Return why a path does not begin at the tip, in the direction of the arm; empty if it does."""
    problems = list[PostureError]()
    aligned = "without obstacles, placement='align' moves the path there"
    ahead = np.asarray(fed.tip - path.start)
    most = ROUTE.line * fed.length
    gap = float(np.linalg.norm(ahead))
    if gap > most:
        shift = ", ".join(f"{x:.6g}" for x in ahead)
        tip = ", ".join(f"{x:.6g}" for x in fed.tip)
        allowed = (
            f"within {length_text(most)} of the tip, at ({tip}); move it by ({shift}) m, "
            f"or the base of the arm the other way if obstacles are where they are; {aligned}"
        )
        problems.append(InvalidValue("start of the path", f"{length_text(gap)} from the tip", allowed))
    angle = float(np.arccos(np.clip(path.tangent(0.0) @ fed.axis, -1.0, 1.0)))
    if angle > ROUTE.max_entry_angle:
        direction = ", ".join(f"{x:.6g}" for x in fed.axis)
        most = np.degrees(ROUTE.max_entry_angle)
        allowed = f"within {most:.2g} degrees of the arm, ({direction}); {aligned}"
        text = f"{np.degrees(angle):.3g} degrees off the axis of the arm"
        problems.append(InvalidValue("first direction of the path", text, allowed))
    return problems


def _prepend_line(curve: Curve, direction: Array, length: float) -> Curve:
    """Prepend a straight line to a curve, as one more span of the spline; the curve itself stays exact.

    Args:
        curve: the curve.
        direction: unit vector (3,) along the line, towards the curve.
        length: length of the line [m].
    """
    k = curve.degree
    spline = BSpline(curve.knots, curve.coefficients, k)
    begin = float(curve.knots[k])
    missing = k - int(np.sum(spline.t == begin))
    if missing > 0:  # not clamped: insert the knot until the spline passes through its first point
        spline = spline.insert_knot(begin, missing)
    last = int(np.searchsorted(spline.t, begin, side="right")) - 1
    coefficients = spline.c[last - k :]
    speed = k * np.linalg.norm(coefficients[1] - coefficients[0]) / (spline.t[last + 1] - begin)
    line = coefficients[0] - np.linspace(length, 0.0, k + 1)[:, None] * direction
    knots = np.concatenate([np.full(k + 1, begin - length / speed), spline.t[last - k + 1 :]])
    return Curve(knots, np.vstack([line, coefficients[1:]]), k)


# Postures along the route, depth by depth.

Method = Literal["closest", "sequential"]

PATH_METHODS: tuple[Method, ...] = ("closest", "sequential")


class RouteFollowingSettings(NamedTuple):
    """How a posture along the route is found, and how far from it parts of the arm may be."""

    bending_weight: float = 1e-3
    """Weight of bending against distance from the route, in mean link lengths [1/rad]: small, only to
    hold joints that do not change the distance."""

    max_steps: int = 20
    last_motion: float = 1e-8
    """Largest number of steps to find a posture, and largest joint motion in the last of them."""

    max_link_distance: float = 0.25
    """Largest distance of the end of a link from the route, in module lengths: that of the middle of a
    module with one hinge, bent by a quarter turn, whose ends are on the arc."""

    deviation_per_bending: float = 1.25
    min_deviation: float = 0.1
    max_deviation: float = 0.6
    """Largest distance of any part of the arm from the route, in lengths of its longest link l: the first
    times kappa l for the largest curvature kappa of the path, but not below the second, nor above the
    third. An arc over two links is kappa l / 2 high. Placements that keep to the path came to 97 % of this
    or less, on the paths of `make study STUDY=leader` and on six public robots; those that went astray to
    1.6 to 6 times as much."""

    samples_per_link: int = 80
    """Samples of the route per mean link length, for the sequential placement."""

    pieces_per_link: int = 8
    """Pieces into which each link is divided, at whose ends distances from the route are measured."""

    samples_per_arm: int = 4000
    """Samples of the path per arm length for these distances."""

    rows_per_chunk: int = 256
    """Number of configurations whose distances are measured at a time."""


ON_ROUTE = RouteFollowingSettings()


class SequentialRouteFollower:
    """Algorithm 1: each module where it first intersects the route, starting from the end of the feed."""

    def __init__(self, route: Route) -> None:
        fed = route.fed
        self._route = route
        self._samples = (
            int(np.ceil(ON_ROUTE.samples_per_link * route.whole.length * fed.links.n_modules / fed.length))
            + 1
        )

    def place(self, depth: float) -> Array:
        """Return the joint positions of the body (nv - 1,) [rad or m] at a depth [m].

        Raises:
            TargetError: there are none; modules are those of the body, arc length is along the route.
            UnsupportedModule: a module without a solver, numbered in the whole arm.
        """
        fed = self._route.fed
        # Moving the route back is the same as moving the arm forward.
        shifted = self._route.whole.moved(np.eye(3), -depth * fed.axis)
        try:
            placed = place_in_turn(fed.body, shifted, self._samples)
        except UnsupportedModule as error:
            module = error.module + fed.arm.n_modules - fed.body.n_modules
            raise UnsupportedModule(module, error.joints, error.reason) from None
        if placed.failure is not None:
            raise placed.failure
        positions: Array = placed.positions
        return positions


class Followed(Protocol):
    """What the body of an arm on a feed can follow, from its first joint at the start on: a `Curve`, say."""

    @property
    def length(self) -> float:
        """Its length [m]."""

    def at(self, s: Array, /) -> Array:
        """Return the points at arc lengths (n,) [m], (n, 3) [m], world frame."""

    def tangent(self, s: Array, /) -> Array:
        """Return the unit tangents at arc lengths (n,) [m], (n, 3)."""


class ClosestRouteFollower:
    """The whole arm as close to a path as possible: least squares over the ends of all links.

    The distances across the path are minimised from one depth to the next by a few Gauss-Newton steps within
    the joint limits. The arc length at the end of a link follows from the links and the depth.

    Attributes:
        depth: how far the feed has moved [m].
        positions: the joint positions of the body there, (nv - 1,) [rad or m].

    Args:
        fed: the arm.
        path: the path.
    """

    def __init__(self, fed: FedArm, path: Followed) -> None:
        self._fed = fed
        self._path = path
        ends = np.vstack([fed.links.chain.base, fed.links.chain.points])
        lengths = np.linalg.norm(np.diff(ends, axis=0), axis=1)
        self._s = np.cumsum(lengths)
        self.depth = 0.0
        self.positions: Array = fed.straight.copy()
        self._bending = (ON_ROUTE.bending_weight * float(lengths.mean()) / fed.body.joint_units) ** 2

    def place(self, depth: float) -> Array:
        """Return the joint positions of the body (nv - 1,) [rad or m] at a depth [m], near those found last.

        Raises:
            CurveBendsTooMuch: a link is too far off; modules are those of the body, arc length is along the
                path.
        """
        self._s = self._s + (depth - self.depth)
        self.depth = depth
        for _ in range(ON_ROUTE.max_steps):
            step = self._step()
            self.positions = self.positions + step
            if np.abs(step / self._fed.body.joint_units).max() < ON_ROUTE.last_motion:
                break
        self._check_distances()
        return self.positions

    def on(self, path: Followed) -> ClosestRouteFollower:
        """Return a placement that goes on from this one, on a path that differs ahead of the arm."""
        other = copy(self)  # arrays are replaced, never written to
        other._path = path
        return other

    @property
    def tip(self) -> float:
        """Arc length of the path at the tip [m]."""
        return float(self._s[-1])

    @property
    def distances(self) -> Array:
        """Distances of the ends of links from the path, (n,) [m]."""
        fed = self._fed
        ends = fed.links.chain_at(fed.links.configuration(self.positions)).points + self.depth * fed.axis
        return np.asarray(np.linalg.norm(self._path.at(self._s) - ends, axis=1))

    def _step(self) -> Array:
        fed = self._fed
        path = self._path
        x = self.positions
        state = fed.links.chain_at(fed.links.configuration(x))
        points = state.points + self.depth * fed.axis
        for _ in range(2):  # the nearest points on the path
            ahead = np.einsum("ij,ij->i", points - path.at(self._s), path.tangent(self._s))
            self._s = np.clip(self._s + ahead, 0.0, path.length)
        gaps = path.at(self._s) - points
        tangents = path.tangent(self._s)
        along = np.einsum("ij,ijk->ik", tangents, state.jacobians)
        across = (state.jacobians - tangents[:, :, None] * along[:, None, :]).reshape(-1, len(x))
        error = (gaps - tangents * np.einsum("ij,ij->i", gaps, tangents)[:, None]).ravel()
        hessian = across.T @ across + np.diag(self._bending)
        gradient = self._bending * (x - fed.straight) - across.T @ error
        step = solve(hessian, gradient, fed.body.limits.lower - x, fed.body.limits.upper - x).x
        return np.zeros(len(x)) if step is None else step

    def _check_distances(self) -> None:
        fed = self._fed
        distances = self.distances
        allowed = ON_ROUTE.max_link_distance * fed.length / fed.body.n_modules
        if distances.max() <= allowed:
            return
        link = int(np.argmax(distances > allowed))
        joint = fed.links.chain.module_starts[link]
        module = int(np.searchsorted(fed.body.module_starts, joint, side="right"))
        advice = "use a gentler path, wider joint limits or shorter modules"
        text = f"it stays {length_text(distances[link])} or more off the path; {advice}"
        raise CurveBendsTooMuch(module, float(self._s[link]), text)


# The motion of the feed, and its postures.


class FeedMotionSettings(NamedTuple):
    """How the feed moves, and in how many rows."""

    depth_rounding: float = 1.0 + 1e-9
    """Ratio of a depth to the largest allowed one that is due to rounding."""

    ramp_share: float = 0.1
    """Share of the depth over which the feed accelerates, and over which it decelerates."""

    max_step: float = 0.5
    """Largest motion of the feed from one row to the next, in lengths of the shortest link."""

    max_rows: int = 1_000_000
    """Largest number of rows of a motion."""


FEED_MOTION = FeedMotionSettings()


def follow_leader(
    arm: Arm,
    path: Curve,
    interval: float,
    speed: float,
    *,
    placement: Literal["align", "as_is"] = "align",
    depth: float | None = None,
    start: ArrayLike | None = None,
    method: Literal["closest", "sequential"] = "closest",
    and_back: bool = False,
    progress: Callable[[int, int], object] | None = None,
) -> Reference:
    """Push an arm along a path, so that every part of it follows its tip.

    The first joint of the arm is its feed: a slide along the axis of the straight arm. The path begins at the
    entry, the tip of the straight arm at the start; before the entry the arm is on the straight line of the
    feed. At depth d the feed has moved by d, and the arm is on the part of this route from the end of the
    feed to its tip. The motion of the feed is prescribed; the tip is at arc length d of the path, plus what
    links gain by cutting bends short: about (kappa l)^2 / 24 of the bent part, for links of length l from
    joint to joint and curvature kappa. Beyond its end the path continues straight.

    The method "closest" fits the ends of all links to the route by least squares, for any arm; "sequential"
    places the modules as in Algorithm 1, with control points exactly on the path. It requires modules with
    closed forms, leaves joints between control points farther off the path, and makes modules of two hinges
    zigzag where curvature begins or ends (see `resolve_targets`).

    The feed is at rest at both ends; its acceleration is continuous. It runs at full speed except in the
    first and the last tenth of the depth.

    Args:
        arm: the arm, on a feed, for instance `Arm.from_modules([feed, *modules])`.
        path: the path of the tip.
        interval: time between rows [s]; shortened to a whole fraction if the feed would move by more than
            half a link between two rows.
        speed: largest speed of the feed [m/s].
        placement: "align" moves the start of the path to the tip of the arm, rotates its first tangent to the
            arm's axis by the smallest rotation, and a plane path into the plane of a planar arm; "as_is"
            leaves the path in place, which must begin at the tip.
        depth: largest depth [m]; to the end of the path if None.
        start: the initial configuration, (nq,): straight, with any position of the feed; fully retracted if
            None.
        method: "closest" or "sequential".
        and_back: whether to return by the same postures in reverse.
        progress: called with the number of postures found so far, and the total number.

    Returns:
        The motion, with a waypoint "inside" at the largest depth and, if it returns, "outside" at the end;
        both targets have the path as placed.

    Raises:
        InvalidValue: an arm without a feed, a path that does not begin at its tip, is too short for the
            depth or longer than the travel of the feed, an interval or speed that is not positive, or a start
            that is not straight.
        UnknownName: no such placement or method.
        CurveBendsTooMuch: the path bends more than the modules can.
        TargetError: a module cannot be placed for another reason, or the arm would be farther from the path
            than its links require; all name the arc length of the path.
        UnsupportedModule: sequential placement of a module for which no solver exists.
    """
    misfits = gather(
        lambda: require_positive("interval", interval),
        lambda: require_positive("speed", speed),
        lambda: require_known("method", method, PATH_METHODS),
        lambda: require_function("progress", progress),
    )
    wrong_depth = gather(lambda: None if depth is None else require_positive("depth", depth))
    misfits += wrong_depth
    try:
        route = Route(arm, path, placement, start)
    except PostureError as error:
        raise_together([*misfits, error])
    raise_together([*misfits, *route.misfits, *([] if wrong_depth else _too_deep(route, depth))])
    fed = route.fed
    max_step = FEED_MOTION.max_step * float(fed.links.chain.module_lengths.min())
    deepest = _depth(route, depth)
    depths, interval = depths_in_time(deepest, speed, interval, max_step)
    follower: ClosestRouteFollower | SequentialRouteFollower
    follower = (
        ClosestRouteFollower(fed, route.whole) if method == "closest" else SequentialRouteFollower(route)
    )
    offsets = np.zeros((len(depths), arm.nv))
    for row, at in enumerate(depths):
        try:
            positions = follower.place(float(at))
        except TargetError as failure:
            module = failure.module + arm.n_modules - fed.body.n_modules
            reason = f"{failure.reason} (at a depth of {length_text(float(at))})"
            raise type(failure)(module, failure.parameter - fed.run_up, reason) from None
        offsets[row, fed.column] = fed.sense * at
        offsets[row, fed.columns] = positions - fed.straight
        if progress is not None:
            progress(row + 1, len(depths))
    # A search may find a first posture that is straighter than the start.
    begin = arm.integrate(fed.start, offsets[0])
    offsets = offsets - offsets[0]
    deviation = _deviation(route, np.array([arm.integrate(begin, offset) for offset in offsets]))
    _require_near(route, deviation, depths, method)
    way = FollowedPath(route, deviation.largest)
    waypoints = [_last_row(way, begin, "inside", offsets)]
    if and_back:
        offsets = np.vstack([offsets, offsets[-2::-1]])
        waypoints.append(_last_row(way, begin, "outside", offsets))
    weights = np.ones((len(offsets), arm.n_modules))
    return Reference(arm, interval, begin, offsets, weights, tuple(waypoints))


def depths_in_time(depth: float, speed: float, interval: float, max_step: float) -> tuple[Array, float]:
    """Compute the depth of the arm at equal time intervals.

    Args:
        depth: final depth [m].
        speed: largest speed [m/s].
        interval: time between two depths [s].
        max_step: largest distance between two depths [m].

    Returns:
        Depths from 0, (N + 1,) [m], and the time between two of them [s]: the interval, or a whole fraction
        of it.

    Raises:
        InvalidValue: more than `FEED_MOTION.max_rows` of them.
    """
    full = 1.0 + 2.0 * FEED_MOTION.ramp_share  # duration, relative to that at full speed
    rows = full * depth / min(speed * interval, max_step)
    if not rows <= FEED_MOTION.max_rows:
        allowed = f"a speed for at most {FEED_MOTION.max_rows} rows; this one needs {rows:.3g}"
        raise InvalidValue("speed", speed, allowed)
    interval = interval / max(int(np.ceil(speed * interval / max_step)), 1)
    steps = max(int(np.ceil(full * depth / speed / interval)), 2)
    ramp = 2.0 * FEED_MOTION.ramp_share / full  # share of the duration, in which half the distance is covered
    t = np.linspace(0.0, 1.0, steps + 1)
    x = np.minimum(np.minimum(t, 1.0 - t) / ramp, 1.0)
    rising = ramp * (x**3 - 0.5 * x**4) + np.maximum(np.minimum(t, 1.0 - t) - ramp, 0.0)
    gone = full * np.where(t <= 0.5, rising, 1.0 / full - rising)
    return depth * gone, interval


def _too_deep(route: Route, depth: float | None) -> list[PostureError]:
    """Return why the arm cannot go to a depth [m], or to the end of the path; empty if it can."""
    path = route.path
    asked = route.path.length if depth is None else depth
    limits = [
        (path.length, f"the path is {path.length:.6g} m long"),
        (route.fed.travel, f"the feed has {route.fed.travel:.6g} m of travel from the start"),
    ]
    if not route.misfits:
        limits.append((route.max_straight_depth, "beyond, the end of the straight feed would leave the path"))
    exceeded = [(most, why) for most, why in limits if asked > most * FEED_MOTION.depth_rounding]
    if not exceeded:
        return []
    allowed = "; ".join(
        f"at most {most:.6g} m: {why}, {length_text(asked - most)} are missing" for most, why in exceeded
    )
    if depth is not None:
        return [InvalidValue("depth", depth, allowed)]
    return [InvalidValue("length of the path [m]", path.length, f"{allowed}; depth= follows a part of it")]


def _depth(route: Route, depth: float | None) -> float:
    """Return the depth to which the arm goes [m]."""
    most = min(route.path.length, route.fed.travel, route.max_straight_depth)
    return most if depth is None else min(float(depth), most)


@dataclass(frozen=True, eq=False)
class FollowedPath:
    """The path of a leader, from which the arm must not stray; a `Way`."""

    route: Route
    planned: float

    def distance(self, q: Array) -> float:
        """Return the largest distance of any part of the arm in configurations (n, nq) from the path [m]."""
        return _deviation(self.route, q).largest


def _last_row(way: FollowedPath, begin: Array, name: str, offsets: Array) -> Waypoint:
    route = way.route
    arm = way.route.fed.arm
    q = arm.integrate(begin, offsets[-1])
    points = arm.chain_at(q).points
    weights = np.ones(arm.n_modules)
    target = Target(points, weights, q=q, curve=route.path, moved=route.moved)
    return Waypoint(name, len(offsets) - 1, target, way=way)


def allowed_deviation(fed: FedArm, curvature: float) -> float:
    """Return how far a part of an arm may be from a path of some largest curvature [1/m], [m]."""
    link = float(fed.links.chain.module_lengths.max())
    share = ON_ROUTE.deviation_per_bending * curvature * link
    return link * float(np.clip(share, ON_ROUTE.min_deviation, ON_ROUTE.max_deviation))


def _require_near(route: Route, deviation: Deviation, depths: Array, method: str) -> None:
    """Refuse postures that are farther from the route than links that follow it have to be.

    Raises:
        TargetError: names the module that is farthest from the route.
    """
    fed = route.fed
    path = route.path
    bend = float(path.curvature(np.linspace(0.0, path.length, ROUTE.curvature_samples)).max())
    allowed = allowed_deviation(fed, bend)
    if deviation.largest <= allowed:
        return
    where = float(deviation.where[deviation.row])
    depth = float(depths[deviation.row])
    lengths = np.cumsum(fed.body.chain.module_lengths)
    module = min(int(np.searchsorted(lengths, where)), fed.body.n_modules - 1)
    number = module + 1 + fed.arm.n_modules - fed.body.n_modules
    off = f"{length_text(deviation.largest)} off the path, {deviation.percent:.3g} % of the arm"
    advice = "use method='closest'"
    if method == "closest":
        advice = "use a gentler path, wider joint limits or shorter links"
    at_depth = f"at a depth of {length_text(depth)}"
    reason = f"the arm is {off} ({at_depth}); allowed: {length_text(allowed)}; {advice}"
    raise TargetError(number, depth + where - fed.run_up, reason)


# The leader of a task.

MAX_SIZE_RATIO = 1000
"""Longest path in arm lengths, and longest arm in pipe radii; longer ones would take hours."""


@declared()
class Leader(Declared):
    """The path of a leader in a task, with arguments of `follow_leader`.

    Attributes:
        path: the path of the tip.
        speed: largest speed of the feed [m/s].
        depth: largest depth [m]; None: to the end.
        placement: as for `follow_leader`; None for `usual_placement`.
        method: as for `follow_leader`.
        and_back: whether to return.
        pipe: radius of the pipe around the path, in which the arm has to stay [m]; None: no pipe.

    Raises:
        InvalidValue: an invalid value.
        UnknownName: a `placement` or `method` that does not exist.
    """

    path: CurveField
    speed: Speed
    depth: Length | None = None
    placement: Annotated[Literal["as_is", "align"], one_of("placement", *PATH_PLACEMENTS)] | None = None
    method: Annotated[Literal["closest", "sequential"], one_of("method", *PATH_METHODS)] = "closest"
    and_back: Flag = False
    pipe: Length | None = None

    def arguments(self) -> dict[str, Any]:
        """Return the arguments of `follow_leader`."""
        return {item.name: getattr(self, item.name) for item in fields(self) if item.name != "pipe"}

    @model_validator(mode="after")
    def _check(self, info: ValidationInfo) -> Leader:
        source = in_file(info)
        if source is not None:
            allowed = _allowed_length(self.path, source.arm)
            if allowed:
                raise Refusal(f"is {length_text(self.path.length)} long; allowed: {allowed}", "path")
        return self

    def to_table(self, file: OutputFile) -> dict[str, Any]:
        """Return the table; the default of its placement depends on the scene."""
        default = usual_placement(file.scene, self.path)
        return {
            **self.written(file),
            "placement": Usual(default) if self.placement == default else self.placement,
        }


def _allowed_length(path: Curve, arm: Arm) -> str:
    """Return what is allowed for a path that is too long for an arm; empty if it is not."""
    longest = MAX_SIZE_RATIO * arm.length
    return "" if path.length <= longest else f"{length_text(longest)}, {MAX_SIZE_RATIO} times the arm"


def check_leader(leader: Leader, arm: Arm, scene: Scene | None = None) -> None:
    """Refuse sizes out of proportion to the arm, and a narrow pipe.

    Raises:
        InvalidValue: names the attribute.
    """
    narrowest = arm.length / MAX_SIZE_RATIO
    allowed = _allowed_length(leader.path, arm)
    if allowed:
        raise InvalidValue("length of the path [m]", leader.path.length, allowed)
    if leader.pipe is not None and leader.pipe < narrowest:
        raise InvalidValue("pipe", leader.pipe, f"{narrowest:.4g} m or more, 1/{MAX_SIZE_RATIO} of the arm")
    if leader.pipe is not None:
        _require_wider(leader.pipe, arm, scene)


def _require_wider(radius: float, arm: Arm, scene: Scene | None) -> None:
    """Refuse a pipe that is narrower than the thinnest round body of the arm and the margin."""
    margin = USUAL_MARGIN if scene is None else scene.margin
    bodies = bodies_of(arm, None if scene is None else scene.arm_radius)
    round_ones = [body.shape.radius for body in bodies if isinstance(body.shape, Sphere | Capsule | Cylinder)]
    thinnest = min(round_ones, default=0.0)
    missing = thinnest + margin - radius
    if missing > 1e-9 * arm.length:
        parts = f"the arm has a radius of {length_text(thinnest)} and needs a margin of {length_text(margin)}"
        allowed = f"{thinnest + margin:.4g} m or more: {parts}; {length_text(missing)} are missing"
        raise InvalidValue("pipe", radius, allowed)


@dataclass(frozen=True, eq=False)
class Deviation:
    """Distances of an arm from the path of its tip so far, including the straight line to the entry.

    Attributes:
        length: length of the arm from its first joint that bends to the tip, without the feed [m];
            percentages refer to it.
        points: distance of each control point, (N, m) [m].
        body: largest distance of any part of the axis of the arm, joints, links and control points, (N,) [m].
        where: arc length of that part along the arm, from the first joint that bends, (N,) [m].
    """

    length: float
    points: Array
    body: Array
    where: Array

    @cached_property
    def row(self) -> int:
        """The row in which the body is farthest from the path."""
        return int(np.argmax(self.body))

    @property
    def largest(self) -> float:
        """Largest distance of any part of the arm in any row [m]."""
        return float(self.body[self.row])

    @property
    def largest_point(self) -> float:
        """Largest distance of any control point in any row [m]."""
        return float(self.points.max())

    @property
    def percent(self) -> float:
        """Largest distance of any part of the arm [% of its length]."""
        return 100.0 * self.largest / self.length

    @property
    def percent_points(self) -> float:
        """Largest distance of any control point [% of the arm length]."""
        return 100.0 * self.largest_point / self.length

    def __repr__(self) -> str:
        where = f"{length_text(self.where[self.row])} along the arm in row {self.row}"
        return f"Deviation({self.percent:.3g} % of {length_text(self.length)}, {where})"


def path_deviation(
    arm: Arm, q: ArrayLike, path: Curve, placement: str = "align", start: ArrayLike | None = None
) -> Deviation:
    """Measure the distance of an arm from the path of its tip so far.

    The distance of a point is that from the nearest point of the route between the first joint at the start
    and the current tip; the route ahead does not count.

    Args:
        arm: an arm on a feed, as in `follow_leader`.
        q: configurations, (N, nq), in order.
        path: the path that was given to `follow_leader`.
        placement: likewise.
        start: likewise.

    Returns:
        Distances, row by row.

    Raises:
        InvalidValue: as `follow_leader`, or configurations of the wrong shape or not finite.
        UnknownName: no such placement.
    """
    route = Route(arm, path, placement, start)
    raise_together(route.misfits)
    return _deviation(route, finite_array("q", q, (None, arm.nq), LARGEST_COORDINATE))


def _deviation(route: Route, rows: Array) -> Deviation:
    """Return the distances of configurations, (N, nq), from a route."""
    chunks = [
        _deviation_of_few(route, rows[first : first + ON_ROUTE.rows_per_chunk])
        for first in range(0, len(rows), ON_ROUTE.rows_per_chunk)
    ]
    points = np.concatenate([chunk.points for chunk in chunks])
    body = np.concatenate([chunk.body for chunk in chunks])
    where = np.concatenate([chunk.where for chunk in chunks])
    return Deviation(route.fed.length, points, body, where)


def _deviation_of_few(route: Route, rows: Array) -> Deviation:
    fed = route.fed
    arm = route.fed.arm
    points = []
    stations = []
    feeds = []
    order = _stations(arm)
    for row in rows:
        state = arm.at(row)
        points.append(state.points)
        stations.append(np.vstack([state.origins, state.points])[order])
        feeds.append(state.positions[fed.column])
    pieces, along = _cut_links(np.array(stations))  # (N, p, 3)
    begin = float(arm.positions(fed.start)[fed.column])
    depths = fed.sense * (np.array(feeds) - begin)
    whole = np.concatenate([pieces, np.array(points)], axis=1)
    distances = _distances(route, whole, _travelled(route, pieces[:, -1], depths))
    split = pieces.shape[1]
    worst = np.argmax(distances[:, :split], axis=1)
    body = np.take_along_axis(distances[:, :split], worst[:, None], axis=1)[:, 0]
    return Deviation(fed.length, distances[:, split:], body, along[worst])


def _stations(arm: Arm) -> list[int]:
    """Order joints that bend and control points from base to tip: indices into joints, then points."""
    joints = len(arm.chain.joints)
    order = []
    for k, module in enumerate(arm.chain.module_slices):
        order += [*range(module.start, module.stop), joints + k]
    return order[order.index(1) :]  # joint 0 is the feed


def _cut_links(stations: Array) -> tuple[Array, Array]:
    """Divide links into pieces: their ends (N, p, 3), and their arc lengths along the arm, (p,) [m]."""
    shares = np.arange(1, ON_ROUTE.pieces_per_link + 1) / ON_ROUTE.pieces_per_link
    begins = stations[:, :-1, None]
    links = np.diff(stations, axis=1)[:, :, None]
    inner = (begins + shares[:, None] * links).reshape(len(stations), -1, 3)
    lengths = np.linalg.norm(links[0, :, 0], axis=1)
    along = (np.cumsum(lengths) - lengths)[:, None] + shares * lengths[:, None]
    return np.concatenate([stations[:, :1], inner], axis=1), np.append(0.0, along.ravel())


def _travelled(route: Route, tips: Array, depths: Array) -> Array:
    """Return the arc length of the route at the tip in each row, (N,) [m], near the depth of the feed."""
    near = route.fed.max_tip_lead
    curve = route.whole
    shifts = np.linspace(-near, near, 101)
    s = np.clip(route.fed.run_up + depths[:, None] + shifts, 0.0, curve.length)
    gaps = curve.at(s.ravel()).reshape(*s.shape, 3) - tips[:, None]
    parameters = s[np.arange(len(s)), np.argmin(np.einsum("nij,nij->ni", gaps, gaps), axis=1)]
    for _ in range(4):  # refined by steps along the tangent
        ahead = np.einsum("ni,ni->n", tips - curve.at(parameters), curve.tangent(parameters))
        parameters = np.clip(parameters + ahead, 0.0, curve.length)
    return np.asarray(parameters)


def _distances(route: Route, points: Array, ends: Array) -> Array:
    """Return distances (N, p) [m] of points (N, p, 3) from the route up to an arc length, (N,) [m]."""
    curve = route.whole
    count = max(int(np.ceil(ON_ROUTE.samples_per_arm * curve.length / route.fed.length)), 2)
    s = np.linspace(0.0, curve.length, count)
    samples = curve.at(s)
    flat = points.reshape(-1, 3)
    limits = np.repeat(ends, points.shape[1])
    last = np.searchsorted(s, limits, side="right") - 1  # of the samples travelled
    nearest = np.asarray(cKDTree(samples).query(flat)[1])
    for i in np.flatnonzero(nearest > last):
        gaps = samples[: last[i] + 1] - flat[i]
        nearest[i] = int(np.argmin(np.einsum("ij,ij->i", gaps, gaps)))
    stops = curve.at(ends).repeat(points.shape[1], axis=0)
    distances = np.linalg.norm(flat - samples[nearest], axis=1)
    for other in (nearest - 1, nearest + 1):
        begin = samples[nearest]
        end = samples[np.clip(other, 0, count - 1)]
        chord = np.where((other > last)[:, None], stops, end) - begin
        square = np.maximum(np.einsum("ij,ij->i", chord, chord), 1e-300)
        share = np.clip(np.einsum("ij,ij->i", flat - begin, chord) / square, 0.0, 1.0)
        distances = np.minimum(distances, np.linalg.norm(begin + share[:, None] * chord - flat, axis=1))
    shaped: Array = distances.reshape(points.shape[:2])
    return shaped
