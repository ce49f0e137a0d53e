"""Steer an arm on a feed by its tip: the body follows the path that the tip lays, and withdraws along it."""

from __future__ import annotations

from copy import copy
from dataclasses import replace
from math import inf
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial.transform import Rotation

from pinposture._validation import as_number, finite_vector, require_instance
from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.model import describe_distance
from pinposture.control import Limits
from pinposture.control.limits import cycle_of, farthest
from pinposture.control.planner.geodesic import GEODESIC
from pinposture.curve import Curve
from pinposture.errors import TargetError, raise_together
from pinposture.placement.target import Target, target_at
from pinposture.task.follow_leader import ClosestRouteFollower, FedArm, allowed_deviation
from pinposture.units import ROUNDING, length_text

Array = NDArray[np.float64]


class SteeringSettings(NamedTuple):
    """What limits a step beside the arm and its surroundings."""

    speed_share: float = 0.8
    """Share of the velocity limits of joints that steering uses. A controller follows a moving target exactly
    if it uses at most 0.84 of them (tests/motion/test_streamed_rows.py)."""

    eased: tuple[float, ...] = (1.0, 0.75, 0.5, 0.25, 0.0)
    """Shares of the curvature that are tried, from that of the operator to straight ahead."""

    same_way: float = 0.9
    """Cosine of the angle between two curvatures above which they are in one direction. In another one the
    whole curvature is tried at once."""

    foreseen: float = 3.0
    """How far an arc must be possible before it is begun, in lengths of the longest module. Links may be off
    the path by more than a bend of one module, so that with 1 an arm with joint limits of 0.3 rad begins arcs
    that it cannot follow, and stands (tests/task/test_steering.py)."""

    attempts: int = 6
    """Reductions of the speed until joints are within their velocity limits."""

    straight: float = 1e-5
    """Distance of a path from the axis of the feed that still counts as straight, in arm lengths."""

    samples: int = 8
    """Points of `Steering.path` for each link of mean length."""


STEERING = SteeringSettings()


class Arcs(NamedTuple):
    """Circular arcs, each from where the one before ends.

    Attributes:
        begins: arc lengths at which they begin, (n,) [m].
        origins: where, (n, 3) [m].
        frames: their axes there, (n, 3, 3): columns are the tangent, and two across.
        curvatures: their curvatures towards these two, (n, 2) [1/m].
    """

    begins: Array
    origins: Array
    frames: Array
    curvatures: Array

    def first(self, count: int) -> Arcs:
        """Return the first of them."""
        return Arcs(*(arc[:count] for arc in self))

    def then(self, other: Arcs) -> Arcs:
        """Return these, and others behind them."""
        return Arcs(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    def points(self, arcs: NDArray[np.intp], along: Array) -> Array:
        """Return the points at distances along arcs (n,) [m], (n, 3) [m]."""
        curvatures = self.curvatures[arcs]
        angles = np.linalg.norm(curvatures, axis=1) * along
        # sin(a) / k along the tangent, and (1 - cos(a)) / k across, for angles a = k s.
        across = 0.5 * (along * np.sinc(0.5 * angles / np.pi)) ** 2
        local = np.column_stack([along * np.sinc(angles / np.pi), curvatures * across[:, None]])
        return np.asarray(self.origins[arcs] + np.einsum("nij,nj->ni", self.frames[arcs], local))

    def tangents(self, arcs: NDArray[np.intp], along: Array) -> Array:
        """Return the unit tangents at distances along arcs (n,) [m], (n, 3)."""
        curvatures = self.curvatures[arcs]
        angles = np.linalg.norm(curvatures, axis=1) * along
        across = along * np.sinc(angles / np.pi)
        local = np.column_stack([np.cos(angles), curvatures * across[:, None]])
        return np.asarray(np.einsum("nij,nj->ni", self.frames[arcs], local))

    def after(self, arc: int, along: float) -> Arcs:
        """Return the straight line that begins at a distance along an arc [m]."""
        towards_y, towards_z = along * self.curvatures[arc]
        turn = Rotation.from_rotvec([0.0, -towards_z, towards_y]).as_matrix()
        origin = self.points(np.array([arc]), np.array([along]))
        begin = np.array([self.begins[arc] + along])
        return Arcs(begin, origin, (self.frames[arc] @ turn)[None], np.zeros((1, 2)))


class LaidPath:
    """A path that grows at its end: circular arcs, one after another, extended straight at both ends.

    Its frame turns with the path and not about it, so that a curvature keeps its direction.

    Args:
        origin: where it begins, (3,) [m].
        frame: its axes there, (3, 3): columns are the tangent, and two across.
        length: length of the straight line with which it begins [m].
        ahead: length of the straight extension at its end [m].
    """

    def __init__(self, origin: Array, frame: Array, length: float, ahead: float) -> None:
        line = Arcs(np.zeros(1), origin[None], frame[None], np.zeros((1, 2)))
        self._arcs = line.then(line.after(0, length))  # the last one is the extension
        self._ahead = ahead

    @property
    def end(self) -> float:
        """Arc length at which the last arc ends [m]."""
        return float(self._arcs.begins[-1])

    @property
    def length(self) -> float:
        """Arc length up to which it is extended [m]."""
        return self.end + self._ahead

    @property
    def largest_curvature(self) -> float:
        """The largest curvature of its arcs [1/m]."""
        return float(np.linalg.norm(self._arcs.curvatures, axis=1).max())

    def at(self, s: ArrayLike, /) -> Array:
        """Return the points at arc lengths (n,) [m], (n, 3) [m]."""
        return self._arcs.points(*self._locate(s))

    def tangent(self, s: ArrayLike, /) -> Array:
        """Return the unit tangents at arc lengths (n,) [m], (n, 3)."""
        return self._arcs.tangents(*self._locate(s))

    def frame(self, s: float) -> Array:
        """Return the axes at an arc length [m], (3, 3): columns are the tangent, and two across."""
        arcs, along = self._locate([s])
        return np.asarray(self._arcs.after(int(arcs[0]), float(along[0])).frames[0])

    def extended(self, begin: float, length: float, curvature: Array) -> LaidPath:
        """Return the path with an arc in place of what lies beyond an arc length.

        Args:
            begin: where the arc begins; beyond the end, a straight line leads there [m].
            length: its length [m].
            curvature: its curvature towards the two axes across, (2,) [1/m].
        """
        arcs, along = self._locate([begin])
        last = int(arcs[0])
        kept = self._arcs.first(last + 1 if along[0] > 0.0 else last)
        line = self._arcs.after(last, float(along[0]))
        if len(kept.begins) and np.array_equal(kept.curvatures[-1], curvature):
            length = length + float(line.begins[0] - kept.begins[-1])
        else:
            kept = kept.then(line._replace(curvatures=np.array([curvature], dtype=float)))
        other = copy(self)
        other._arcs = kept.then(kept.after(len(kept.begins) - 1, length))
        return other

    def straight_up_to(self, tolerance: float) -> float:
        """Return the arc length up to which it is straight, to a tolerance [m]; infinite if all of it is."""
        curvatures = np.linalg.norm(self._arcs.curvatures, axis=1)
        bent = curvatures > 0.0
        # An arc leaves its tangent by k s^2 / 2.
        leaves = self._arcs.begins[bent] + np.sqrt(2.0 * tolerance / curvatures[bent])
        return float(leaves.min(initial=np.inf))

    def _locate(self, s: ArrayLike) -> tuple[NDArray[np.intp], Array]:
        """Return the arcs at arc lengths (n,), and the distances along them [m]."""
        lengths = np.asarray(s, dtype=float)
        arcs = np.searchsorted(self._arcs.begins, lengths, side="right") - 1
        arcs = np.maximum(arcs, 0)
        return arcs, lengths - self._arcs.begins[arcs]


class _Posture(NamedTuple):
    """A posture on a path.

    Attributes:
        follower: how the body lies on the path.
        path: the path.
        depth: how far the feed has moved from the start [m].
        q: the configuration, (nq,).
        reason: why the feed moved less than asked for; empty if it did not.
    """

    follower: ClosestRouteFollower
    path: LaidPath
    depth: float
    q: Array
    reason: str


class Steering:
    """Steers an arm on a feed with three numbers: how fast, and how much its tip bends to the left and up.

        steering = pp.Steering(arm, limits, scene)
        tracker.update(steering.step(0.02, (1.0, 0.0)))  # in each cycle: 2 cm/s, to the left
        tracker.update(steering.step(-0.02))  # back along the path

    The first joint of the arm is its feed, a slide along the axis of the straight arm, as for
    `follow_leader`. Wherever the tip goes, it lays a path, and the whole body follows it. Without a
    curvature, the arm moves along the path that was laid, straight on beyond its end; with one, it lays a new
    path from the tip on.

    A step is as long as speed and velocity limits allow. If joint limits, or the margin to obstacles, do not
    allow the curvature, the arm bends less; if they allow no step, it stands. `reason` says why. With a limit
    of acceleration, it slows down before, so that the feed can stop there. "Up" is opposite to gravity, at
    right angles to the arm at the entry; if the arm is vertical there, it is along x of the world. From there
    both directions turn with the path, but not about it.

    Attributes:
        arm: the arm.
        limits: limits of the joints, with the duration of a cycle.
        scene: the obstacles; may be replaced between steps.
        reason: why the last step was not as asked for; empty if it was.

    Args:
        arm: the arm.
        limits: limits of the joints; `dt` is required.
        scene: the obstacles; None: there are none, and the arm may touch itself.
        start: the initial configuration, (nq,): straight, with any position of the feed; fully retracted if
            None.

    Raises:
        InvalidValue: not an arm on a feed, limits without dt, or a start that is not straight.
    """

    def __init__(
        self, arm: Arm, limits: Limits, scene: Scene | None = None, start: ArrayLike | None = None
    ) -> None:
        self._dt = cycle_of(limits)
        require_instance("scene", scene, Scene | None, "a Scene(...), or None")
        self._fed = fed = FedArm(arm, start)
        raise_together(fed.misfits)
        self.arm = arm
        self.limits = limits
        self.scene = scene
        self.reason = ""
        frame = entry_frame(fed.axis, np.asarray(arm.model.gravity.linear))
        path = LaidPath(fed.tip - fed.run_up * fed.axis, frame, fed.run_up, fed.max_tip_lead)
        self._posture = _Posture(ClosestRouteFollower(fed, path), path, 0.0, fed.start, "")
        self._model: CollisionModel | None = None
        self._asked = np.zeros(2)
        self._eased = 0
        self._refused = ""
        self._moved = 0.0

    @property
    def q(self) -> Array:
        """The configuration of the last step, (nq,)."""
        return self._posture.q

    @property
    def depth(self) -> float:
        """How far the feed has moved from the start [m]."""
        return self._posture.depth

    @property
    def acceleration(self) -> float:
        """How fast the speed of the feed may change so that a tracker follows [m/s^2]; may be infinite."""
        most = self.limits.for_arm(self.arm).acceleration
        if most is None:
            return inf
        return STEERING.speed_share * float(most[self._fed.column]) / self._dt**2

    @property
    def frame(self) -> Array:
        """The axes of the path at the tip, world frame, (3, 3): columns are ahead, to the left, and up."""
        return self._posture.path.frame(self._posture.follower.tip)

    @property
    def path(self) -> Curve:
        """The path from the tip at the entry to just beyond the tip now, for `follow_leader` or a file.

        It passes through points of the path in its directions, and is within 1e-6 of a link of it in between.

        Raises:
            CurveError: the tip has not moved.
        """
        begin = self._fed.run_up
        end = max(self._posture.follower.tip, begin + self.depth)  # links that cut bends short lead or lag
        interval = float(self._fed.links.chain.module_lengths.mean()) / STEERING.samples
        count = max(int(np.ceil((end - begin) / interval)), 4)
        s = np.asarray(begin + (end - begin) / count * np.arange(count + 2), dtype=np.float64)
        return _through(s, self._posture.path.at(s), self._posture.path.tangent(s))

    def step(self, speed: float, curvature: ArrayLike | None = None) -> Target:
        """Move on by a cycle.

        Args:
            speed: speed of the feed [m/s]; negative: the arm withdraws along the path.
            curvature: curvature of the path that the tip lays, to the left and up, (2,) [1/m]; None: along
                the path that was laid. It does not count if the arm withdraws.

        Returns:
            The target of this cycle, with its velocity, for `Tracker.update`.

        Raises:
            InvalidValue: a number that is not finite.
        """
        speed = as_number("speed", speed, "a finite number [m/s]", lambda _: True)
        checked = None if curvature is None else finite_vector("curvature", curvature, 2)
        self.reason = ""
        before = self._posture
        distance = speed * self._dt
        if distance != 0.0:
            self._go(distance, checked)
        self._moved = self.depth - before.depth
        return moving_target(self.arm, before.q, self.q, self._dt)

    def _go(self, distance: float, curvature: Array | None) -> None:
        """Move on by a distance [m], or less, and say why if it is less."""
        step = self._step(distance, curvature, True)
        if isinstance(step, str):
            self.reason = f"stands: {step}"
            # The feed cannot stop at once: it goes on, slower, to where it was known before that it can stop.
            slower = float(np.copysign(abs(self._moved) - self._brake, distance))
            if self._moved * distance <= 0.0 or slower * distance <= 0.0:
                return
            why = step
            step = self._step(min(distance, slower, key=abs), curvature, False)
            if isinstance(step, str):
                return
            step = step._replace(reason=f"slower: {why}")
        self._posture = step
        self.reason = step.reason

    @property
    def _brake(self) -> float:
        """How much less the feed may move than in the cycle before [m]."""
        return self.acceleration * self._dt**2

    def _step(self, distance: float, curvature: Array | None, foresees: bool) -> _Posture | str:
        """Return the posture after a distance [m], or less, or why there is none.

        Args:
            distance: how far the feed is to move [m].
            curvature: curvature of the path that the tip lays, (2,) [1/m]; None: along the present one.
            foresees: whether the feed has to be able to stop ahead.
        """
        if distance > 0.0 and curvature is not None:
            return self._lay(distance, curvature, foresees)
        path = self._posture.path
        missing = self._posture.follower.tip + 2.0 * distance + self._stop(distance) - path.end
        path = path if missing <= 0.0 else path.extended(path.end, missing, np.zeros(2))
        return self._move(distance, path, foresees)

    def _stop(self, distance: float) -> float:
        """Return how far the feed moves until it stops after it moved by a distance, signed [m]."""
        return 0.5 * distance * max(abs(distance) / self._brake - 1.0, 0.0)

    def _lay(self, distance: float, curvature: Array, foresees: bool) -> _Posture | str:
        """Return the posture after a distance [m], or less, along a path that is laid from the tip on."""
        shares = STEERING.eased if np.any(curvature) else (1.0,)
        first = self._first_share(curvature)
        for index in range(first, len(shares)):
            step = self._move_on_arc(distance, shares[index] * curvature, foresees)
            if not isinstance(step, str):
                self._eased = index
                return step._replace(reason=f"bends less: {self._refused}") if index else step
            if index == 0:  # what is said is why not all of the curvature is possible
                self._refused = step
        self._eased = len(shares) - 1
        return self._refused

    def _first_share(self, curvature: Array) -> int:
        """Return which of `STEERING.eased` to try first.

        In the direction of the last step, it is the one above what was possible then: to try all of them in
        each step takes up to five times as long as to take a step.
        """
        before = self._asked
        self._asked = curvature
        sizes = float(np.linalg.norm(before) * np.linalg.norm(curvature))
        if before @ curvature <= STEERING.same_way * sizes:
            self._eased = 0
        return max(self._eased - 1, 0)

    def _move_on_arc(self, distance: float, curvature: Array, foresees: bool) -> _Posture | str:
        """Return the posture after a distance [m] along an arc from the tip on, or why there is none."""
        laid = self._posture.path
        tip = self._posture.follower.tip
        if np.any(curvature):  # an arc that the arm could not follow must not be begun
            ahead = STEERING.foreseen * float(self._fed.body.chain.module_lengths.max())
            arc = laid.extended(tip, ahead + distance, curvature)
            tried = self._place(min(self.depth + ahead, self._deepest(arc)), arc)
            if isinstance(tried, str):
                return f"the arm cannot follow a curvature of {np.linalg.norm(curvature):.3g} 1/m"
        length = 2.0 * distance + self._stop(distance)
        return self._move(distance, laid.extended(tip, length, curvature), foresees)

    def _move(self, distance: float, path: LaidPath, foresees: bool) -> _Posture | str:
        """Return the posture after the feed has moved, or why there is none.

        Args:
            distance: how far the feed is to move [m]; it may move less.
            path: the path ahead of the arm, and on which it lies.
            foresees: whether it has to be able to stop ahead.
        """
        most = self._deepest(path)
        room = most - self.depth if distance > 0.0 else -self.depth
        if room * distance <= 0.0:
            return self._describe_end(distance, most)
        asked = self.depth + min(distance, room, key=abs)
        if foresees and self._brake < inf:
            stoppable = float(farthest(np.array([room]), np.array([self._brake]))[0])
            asked = self.depth + min(distance, stoppable, key=abs)
        depth = asked
        for _ in range(STEERING.attempts):  # joints do not move quite in proportion to the feed
            placed = self._place(depth, path)
            if isinstance(placed, str):
                return placed
            follower = placed
            q = self._configuration(follower)
            joint, share = self._fastest(q)
            if share <= 1.0 + ROUNDING:
                break
            depth = self.depth + (depth - self.depth) * 0.95 / share
        name = self.arm.joint_names[joint]
        if share > 1.0 + ROUNDING:
            return f"joint {name!r} would have to be faster than its velocity limit"
        withdraws = distance < 0.0
        blocked = self._describe_contact(q, withdraws)
        if foresees and not blocked:
            blocked = self._foresee(depth, path, withdraws)
        if blocked:
            return blocked
        reason = ""
        if depth != asked:
            reason = f"slower: joint {name!r} is at its velocity limit"
        elif asked != self.depth + distance:
            how = "stands" if asked == self.depth + room else "slower"
            reason = f"{how}: {self._describe_end(distance, most)}"
        return _Posture(follower, path, depth, q, reason)

    def _foresee(self, depth: float, path: LaidPath, withdraws: bool) -> str:
        """Return what is in the way until the feed stops after a move to a depth [m]; empty if nothing is."""
        stop = self._stop(depth - self.depth)
        if stop == 0.0 or self.scene is None:
            return ""
        placed = self._place(min(max(depth + stop, 0.0), self._deepest(path)), path)
        if isinstance(placed, str):
            return placed
        return self._describe_contact(self._configuration(placed), withdraws)

    def _deepest(self, path: LaidPath) -> float:
        """Return the largest depth on a path [m]: the travel, or where the feed leaves the path."""
        return min(self._fed.travel, path.straight_up_to(STEERING.straight * self._fed.length))

    def _place(self, depth: float, path: LaidPath) -> ClosestRouteFollower | str:
        """Lay the body on a path at a depth [m]; return why it cannot follow the path, if it cannot."""
        follower = self._posture.follower.on(path)
        try:
            follower.place(depth)
        except TargetError:
            return "the arm cannot follow the path"
        off = float(follower.distances.max())
        allowed = allowed_deviation(self._fed, path.largest_curvature)
        if off > allowed and depth > self.depth:
            return f"a link would be more than {length_text(allowed)} off the path"
        return follower

    def _configuration(self, follower: ClosestRouteFollower) -> Array:
        """Return the configuration with the body on its path, (nq,)."""
        fed = self._fed
        offsets = np.zeros(self.arm.nv)
        offsets[fed.column] = fed.sense * follower.depth
        offsets[fed.columns] = follower.positions - fed.straight
        return self.arm.integrate(fed.start, offsets)

    def _fastest(self, q: Array) -> tuple[int, float]:
        """Return the joint that is fastest on the way to q, and its share of what steering may use."""
        step = np.abs(self.arm.difference(self.q, q))
        bounds = self.limits.for_arm(self.arm).bound
        shares = step / (STEERING.speed_share * bounds)
        joint = int(shares.argmax())
        return joint, float(shares[joint])

    def _describe_contact(self, q: Array, withdraws: bool) -> str:
        """Return which pair comes too close in a step to q, ahead or back; empty if none does."""
        scene = self.scene
        if scene is None:
            return ""
        if self._model is None or self._model.scene is not scene:
            self._model = CollisionModel(self.arm, scene)
        margin = margin_back(scene) if withdraws else scene.margin
        return describe_contact(self._model, self.q, q, margin)

    def _describe_end(self, distance: float, most: float) -> str:
        """Return why the feed cannot move on."""
        if distance < 0.0:
            return "the arm is back at the entry"
        if most >= self._fed.travel:
            return f"the feed is at the end of its travel, {length_text(self._fed.travel)}"
        return "the first joint of the arm is where the path begins to bend, and moves straight"


def _through(s: Array, points: Array, tangents: Array) -> Curve:
    """Return the cubic spline through points (n, 3) with unit tangents (n, 3) at arc lengths (n,) [m]."""
    third = (np.diff(s) / 3.0)[:, None]
    # Two control points on the tangents of each piece; where pieces meet, the spline is between two of them.
    inner = np.stack([points[:-1] + third * tangents[:-1], points[1:] - third * tangents[1:]], axis=1)
    coefficients = np.vstack([points[:1], inner.reshape(-1, 3), points[-1:]])
    knots = np.concatenate([np.repeat(s[:1], 4), np.repeat(s[1:-1], 2), np.repeat(s[-1:], 4)])
    return Curve(knots, coefficients, 3)


def margin_back(scene: Scene) -> float:
    """Return the margin of an arm that withdraws the way it came [m], as of one that is led.

    A map may have grown beside it, and where it could go neither on nor back, it would be caught.
    """
    return GEODESIC.led_margin * scene.margin


def describe_contact(model: CollisionModel, before: Array, q: Array, margin: float) -> str:
    """Return which pair comes closer than a margin [m] in a step to q, (nq,); empty if none does."""
    closest = model.minimum(q)
    if closest.pair is None or closest.distance >= margin:
        return ""
    if closest.distance >= model.minimum(before).distance:
        return ""  # it comes out of where it is too close
    return f"{describe_distance(closest.pair, closest.distance)}, less than {length_text(margin)}"


def moving_target(arm: Arm, before: Array, q: Array, dt: float) -> Target:
    """Return the target of a cycle of a duration [s], in which an arm is led on to a configuration (nq,)."""
    velocity = arm.difference(before, q) / dt
    return replace(target_at(arm.chain_at(q), np.ones(arm.n_modules)), velocity=velocity, led=True)


def entry_frame(axis: Array, gravity: Array) -> Array:
    """Return the axes at the entry, (3, 3): columns are ahead, to the left and up.

    Args:
        axis: the axis of the feed, unit vector, (3,).
        gravity: gravity, world frame, (3,) [m/s^2].
    """
    size = float(np.linalg.norm(gravity))
    up = -gravity / size if size > 0.0 else np.array([0.0, 0.0, 1.0])
    if np.linalg.norm(np.cross(axis, up)) < 1e-3:  # [rad]: no way is up
        up = np.array([1.0, 0.0, 0.0])
    left = np.cross(up, axis)
    left = left / np.linalg.norm(left)
    return np.column_stack([axis, left, np.cross(axis, left)])
