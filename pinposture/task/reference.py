"""The planned motion of a task over time, its feasibility, and the interpolation of curves."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple, Protocol, cast

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linprog
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm, ArmState
from pinposture.collision import Closest, CollisionModel, Scene
from pinposture.collision.bodies import bodies_of
from pinposture.collision.model import Distances
from pinposture.control import EndEffector, Limits
from pinposture.control.torque_limits import Overload, find_overload, require_held
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, TaskError, warn_caller
from pinposture.kernels.arrays import FULL_TURN
from pinposture.motion.held import HeldObject, Stages
from pinposture.placement import Target
from pinposture.placement.least_squares import CURVE_FIT, Samples, transported_turns
from pinposture.placement.target import Moved, arm_axis
from pinposture.units import length_text

Array = NDArray[np.float64]


class Way(Protocol):
    """A path that the whole arm has to follow."""

    @property
    def planned(self) -> float:
        """Largest distance of the planned postures from the path [m]."""

    def distance(self, q: Array) -> float:
        """Return the largest distance of any part of the arm in configurations (n, nq) from the path [m]."""


class Waypoint(NamedTuple):
    """A named row of a reference.

    Attributes:
        name: its name.
        row: its row in the reference.
        target: its target, in place of that of the row; the residual is the distance from the curve.
        tip: its tip task; None without one.
        speed: largest share of the velocity limits for the motion to it from the previous waypoint.
        way: the path that the arm has to follow on the way to it; None if only the posture counts.
        end_off: distance of the tip from the end of the curve [m]; 0 if it does not have to be there.
    """

    name: str
    row: int
    target: Target
    tip: EndEffector | None = None
    speed: float = 1.0
    way: Way | None = None
    end_off: float = 0.0


@dataclass(frozen=True, eq=False)
class Reference:
    """Postures at equal time intervals, as configurations.

    It begins and ends at rest. Rows are close enough for smooth interpolation.

    Attributes:
        arm: the arm.
        interval: time from one row to the next, if nothing slows the motion [s].
        start: the configuration of the first row, (nq,).
        offsets: joint displacement of each row from the first, in the direction of motion, (N + 1, nv)
            [rad or m]; the first is zero.
        weights: whether each control point has a target, as in `Target`, (N + 1, m).
        waypoints: the named rows, in order; one for each keyframe.
        durations: time from each row to the next, (N,) [s]; None if it is the interval. The interval is then
            the shortest of them.
        numbered: whether the waypoints are numbered keyframes, the first of them in the first row.
        held: the obstacles that the arm holds on the way.
    """

    arm: Arm
    interval: float
    start: Array
    offsets: Array
    weights: Array
    waypoints: tuple[Waypoint, ...] = ()
    durations: Array | None = None
    numbered: bool = False
    held: tuple[HeldObject, ...] = ()

    def __post_init__(self) -> None:
        rows = len(self.offsets)
        arm = self.arm
        if self.offsets.shape != (rows, arm.nv) or rows < 2:
            raise InvalidValue("offsets (shape)", self.offsets.shape, f"(2 or more, {arm.nv})")
        if self.weights.shape != (rows, arm.n_modules):
            raise InvalidValue("weights (shape)", self.weights.shape, f"({rows}, {arm.n_modules})")
        if not np.all(np.isfinite(self.offsets)):
            raise InvalidValue("offsets", self.offsets, "finite numbers")

    def __repr__(self) -> str:
        waypoints = f"{len(self.waypoints)} waypoints"
        return f"Reference({self.arm}, {self.rows} rows, {self.duration:.4g} s, {waypoints})"

    @property
    def rows(self) -> int:
        """Number of rows, N + 1."""
        return len(self.offsets)

    @property
    def duration(self) -> float:
        """Duration if nothing slows the motion [s]."""
        return float(self.times[-1])

    @cached_property
    def times(self) -> Array:
        """Time of each row if nothing slows the motion, (N + 1,) [s]."""
        if self.durations is not None:
            return np.append(0.0, np.cumsum(self.durations))
        return np.asarray(self.interval * np.arange(self.rows, dtype=np.float64))

    def configuration(self, row: int) -> Array:
        """Return the configuration of a row, (nq,)."""
        return self.arm.integrate(self.start, self.offsets[row])

    @cached_property
    def stages(self) -> Stages:
        """The scenes on the way: what the arm holds moves with it."""
        return Stages(self.arm, self.held, self.configuration, self.rows)


def off_curve(waypoint: Waypoint) -> float | None:
    """Return the largest distance of the targets of a waypoint from its curve [m]; None without a curve.

    It is that on the way to it if the arm has to follow the curve all the way, and includes the distance of
    the tip from the end of the curve if it has to be there.
    """
    if waypoint.way is not None:
        return waypoint.way.planned
    residual = waypoint.target.residual
    if residual is None:
        return None
    return max(float(residual[waypoint.target.has_target].max()), waypoint.end_off)


def tip_off(tip: EndEffector | None, target: Target, state: ArmState) -> float | None:
    """Return the error of the tip task [m], with rotations times their lever arm; None without a task."""
    return None if tip is None else float(np.linalg.norm(tip.rows(state, target).error))


# How well the arm can reach its postures, predicted before it moves.


class PostureFeasibility(NamedTuple):
    """How well the arm can reach a posture.

    Attributes:
        name: name of the posture.
        planned: its planned time [s].
        off_curve: largest distance of a target from its curve, or of the tip from the end of a curve that is
            not to be trimmed [m]; None without a curve.
        tip_off: error of the tip task [m]; None without one.
        clearance: smallest distance to an obstacle [m], negative in penetration; that between parts of the
            arm if there are no obstacles, or if it is less than the margin. None without a scene.
        pair: the two that are that close; None without a scene.
        moved: how its curve was moved from its position as drawn; None without a curve.
        overload: what the motors lack to hold it within torque limits; None if they can, or without limits.
    """

    name: str
    planned: float
    off_curve: float | None
    tip_off: float | None
    clearance: float | None
    pair: tuple[str, str] | None
    moved: Moved | None
    overload: Overload | None = None

    def crowding(self, margin: float) -> str:
        """Name the two that are closer than a margin [m], by more than a thousandth of it; else empty."""
        if self.clearance is None or self.pair is None or self.clearance >= 0.999 * margin:
            return ""
        millimetres = f"{1e3 * abs(self.clearance):.3g} mm"
        if self.clearance < 0.0:
            return f"{' and '.join(self.pair)} would penetrate by {millimetres}"
        return f"{' and '.join(self.pair)} would be {millimetres} apart; the margin is {1e3 * margin:.3g} mm"


def posture_feasibility(
    reference: Reference, scene: Scene | None, limits: Limits | None = None
) -> list[PostureFeasibility]:
    """Predict how well the arm can reach the named postures of a reference, and the first.

    Args:
        reference: the reference.
        scene: the obstacles to avoid; clearances are those at these postures only.
        limits: limits whose torque limits the motors keep; None: none.
    """
    arm = reference.arm
    postures = []
    for waypoint in _named(reference):
        q = reference.configuration(waypoint.row)
        stage = reference.stages.number(waypoint.row)
        around = None if scene is None else reference.stages.scene(stage, scene)
        room, pair = (None, None) if around is None else _closest(arm, q, around)
        tip = tip_off(waypoint.tip, waypoint.target, arm.at(q))
        planned = float(reference.times[waypoint.row])
        moved = waypoint.target.moved
        lack = None if limits is None else find_overload(arm, q, limits)
        off = off_curve(waypoint)
        postures.append(PostureFeasibility(waypoint.name, planned, off, tip, room, pair, moved, lack))
    return postures


def _closest(arm: Arm, q: Array, scene: Scene) -> Closest:
    """Return the smallest distance, of obstacles if the arm keeps the margin to itself: it is always near."""
    closest = CollisionModel(arm, scene).minimum(q)
    if not scene.obstacles or closest.distance < scene.margin:
        return closest
    return CollisionModel(arm, scene.without_self_collision()).minimum(q)


def find_crowded(reference: Reference, scene: Scene | None) -> dict[str, PostureFeasibility]:
    """Return the named postures that do not keep the margin of a scene, by their names in messages."""
    if scene is None:
        return {}
    titles = [title for title, _ in _titled(reference)]
    postures = dict(zip(titles, posture_feasibility(reference, scene), strict=True))
    return {where: posture for where, posture in postures.items() if posture.crowding(scene.margin)}


def require_held_postures(reference: Reference, limits: Limits) -> None:
    """Refuse a motion through a named posture that the motors cannot hold within torque limits of `limits`.

    Raises:
        InvalidValue: a posture cannot be held; names it, and the joint that needs most.
    """
    for where, waypoint in _titled(reference):
        require_held(reference.arm, reference.configuration(waypoint.row), limits, where)


def require_room(reference: Reference, scene: Scene | None) -> None:
    """Refuse a motion that begins in collision; warn of other named postures in collision.

    Raises:
        TaskError: the motion begins in collision.
    """
    for where, posture in find_crowded(reference, scene).items():
        inside = posture.crowding(0.0)
        if inside and posture.planned == 0.0:
            raise TaskError(where, f"{inside}; move one of them, or change the start")
        if inside:
            warn_caller(f"{where}: {inside}")


def _named(reference: Reference) -> list[Waypoint]:
    """Return the named waypoints of the first lap, and the beginning if it has no name."""
    first_lap = {id(waypoint.target): waypoint for waypoint in reversed(reference.waypoints)}
    waypoints = list(first_lap.values())[::-1]
    if not waypoints or waypoints[0].row > 0:
        target = Target.from_configuration(reference.arm, reference.start)
        waypoints.insert(0, Waypoint("the beginning", 0, target))
    return waypoints


def _titled(reference: Reference) -> list[tuple[str, Waypoint]]:
    """Return the same with their titles in messages."""
    named = enumerate(_named(reference), start=1)
    return [
        (f"keyframe {k} {waypoint.name!r}" if reference.numbered else waypoint.name, waypoint)
        for k, waypoint in named
    ]


# Curves as vectors: start, initial direction, and bending.
#
# Bending is the rotation per arc length of a frame that is carried along without twist (parallel transport).
# Interpolating it preserves the length of curves while they coil up. Curves through interpolated points would
# be shorter in between, and could not distinguish whole turns.


class BentCurve(Samples):
    """A piecewise cubic curve through points at equal arc lengths, with given tangents.

    Args:
        cell: arc length from one point to the next [m].
        points: the points, (n + 1, 3) [m], world frame.
        tangents: unit tangents, (n + 1, 3).
    """

    def __init__(self, cell: float, points: Array, tangents: Array) -> None:
        super().__init__(np.asarray(cell * np.arange(len(points), dtype=np.float64)), points, tangents)
        self.cell = cell

    @property
    def spline(self) -> Array:
        """Coefficients (2n + 2, 3) of the curve as a cubic B-spline; its inner knots are `s`, each twice."""
        inner = np.stack([self.points, self.points], axis=1)
        handles = self.cell / 3.0 * self.tangents
        inner[:, 0] -= handles
        inner[:, 1] += handles
        coefficients = inner.reshape(-1, 3)
        coefficients[0] = self.points[0]
        coefficients[-1] = self.points[-1]
        return coefficients

    def at(self, s: Array) -> Array:
        """Return points (k, 3) [m] at arc lengths (k,) from 0 to the length."""
        i, x = self._located(s)
        a = self.points[i]
        b = self.points[i + 1]
        u = self.cell * self.tangents[i]
        v = self.cell * self.tangents[i + 1]
        return np.asarray(a + x * (u + x * (3.0 * (b - a) - 2.0 * u - v + x * (2.0 * (a - b) + u + v))))

    def tangent(self, s: Array) -> Array:
        """Return derivatives by arc length, (k, 3): unit vectors, except for interpolation errors."""
        i, x = self._located(s)
        rise = (self.points[i + 1] - self.points[i]) / self.cell
        u = self.tangents[i]
        v = self.tangents[i + 1]
        return np.asarray(u + x * (6.0 * rise - 4.0 * u - 2.0 * v + 3.0 * x * (u + v - 2.0 * rise)))

    def _located(self, s: Array) -> tuple[NDArray[np.intp], Array]:
        cells = s / self.cell
        i = np.minimum(cells.astype(np.intp), len(self.points) - 2)
        return i, (cells - i)[:, None]


class AnchoredCurve(NamedTuple):
    """A curve and the position of the arm on it.

    Attributes:
        curve: the curve, placed in the world.
        parameter: arc length of the base of the arm [m].
    """

    curve: Curve
    parameter: float


class Bending:
    """Converts curves of an arm into vectors, and back.

    A vector holds the start of a curve relative to the arm's base (3) [m]; the rotation vector from the arm's
    axis to the first tangent (3) [rad]; the rotation in each cell of arc length, about the two transverse
    axes (n, 2) [rad]; and the small deviations from arcs with these rotations (n, 3) [m]. Rotations and
    deviations are in the carried frame, so that curves of a planar arm stay in its plane.

    Args:
        arm: the arm.
        length: relevant length of each curve [m].

    Attributes:
        cell: arc length of a cell [m].
        cells: number of cells, n.
    """

    def __init__(self, arm: Arm, length: float) -> None:
        per_cell = arm.length / (CURVE_FIT.samples_per_module * arm.n_modules)
        self.cells = int(np.ceil(length / per_cell))
        self.cell = length / self.cells
        self._base = np.array(arm.chain.base)
        axis = arm_axis(arm)
        # The third axis is the normal of a planar arm: all turns are then about that one.
        across = np.cross(*arm.plane) if arm.dimension == 2 else np.eye(3)[np.argmin(np.abs(axis))]
        third = across - (across @ axis) * axis
        third /= np.linalg.norm(third)
        self._axes = np.column_stack([axis, np.cross(third, axis), third])

    def vector(self, anchored: AnchoredCurve, before: Array | None = None) -> Array:
        """Return the vector (d,) of a curve; it continues straight beyond its end.

        Args:
            anchored: the curve.
            before: the vector of the previous curve, whose direction is continued without whole turns.
        """
        curve = anchored.curve
        s = anchored.parameter + self.cell * np.arange(self.cells + 1)
        inside = np.minimum(s, curve.length)
        tangents = curve.tangent(inside)
        points = curve.at(inside) + (s - inside)[:, None] * tangents
        direction = self._direction(tangents[0], np.zeros(3) if before is None else before[3:6])
        frame = Rotation.from_rotvec(direction).as_matrix() @ self._axes
        turns = (transported_turns(tangents) @ frame)[:, 1:]
        frames, chords = self._frames(frame[None], turns[None])
        seen = np.einsum("nji,nj->ni", frames[0, :-1], np.diff(points, axis=0))
        start = points[0] - self._base
        return np.concatenate([start, direction, turns.ravel(), (seen - chords[0]).ravel()])

    def curves(self, vectors: Array) -> list[BentCurve]:
        """Return the curves of vectors, (r, d)."""
        n = self.cells
        turns = vectors[:, 6 : 6 + 2 * n].reshape(-1, n, 2)
        misses = vectors[:, 6 + 2 * n :].reshape(-1, n, 3)
        first = Rotation.from_rotvec(vectors[:, 3:6]).as_matrix() @ self._axes
        frames, chords = self._frames(first, turns)
        chords += misses
        steps = np.einsum("rnij,rnj->rni", frames[:, :-1], chords)
        points = np.empty((len(vectors), n + 1, 3))
        points[:, 0] = self._base + vectors[:, :3]
        points[:, 1:] = points[:, :1] + np.cumsum(steps, axis=1)
        return [BentCurve(self.cell, *parts) for parts in zip(points, frames[..., 0].copy(), strict=True)]

    def _direction(self, tangent: Array, before: Array) -> Array:
        """Return the rotation vector (3,) [rad] from the arm's axis to a tangent, nearest to another vector.

        It is the smallest rotation, plus whole turns.
        """
        axis, _, third = self._axes.T
        across = np.cross(axis, tangent)
        sine = float(np.linalg.norm(across))
        cosine = float(axis @ tangent)
        turned = float(np.linalg.norm(before))
        about = across / sine if sine > 1e-12 else before / turned if turned > 0.0 else third
        angle = float(np.arctan2(sine, cosine))
        rounds = np.round((about @ before - angle) / FULL_TURN)
        return np.asarray((angle + FULL_TURN * rounds) * about)

    def _frames(self, first: Array, turns: Array) -> tuple[Array, Array]:
        """Return carried frames (r, n + 1, 3, 3), axes as columns, and chords between them, (r, n, 3)."""
        a = turns[..., 0]
        b = turns[..., 1]
        angle = np.hypot(a, b)
        small = angle < 1e-4  # where the series are exact to the last digit
        safe = np.where(small, 1.0, angle)
        sine = np.where(small, 1.0 - angle**2 / 6.0, np.sin(safe) / safe)
        cosine = np.where(small, 0.5 - angle**2 / 24.0, (1.0 - np.cos(safe)) / safe**2)
        rows = [
            [1.0 - cosine * angle**2, -sine * b, sine * a],
            [sine * b, 1.0 - cosine * b**2, cosine * a * b],
            [-sine * a, cosine * a * b, 1.0 - cosine * a**2],
        ]
        rotations = np.moveaxis(np.array(rows), (0, 1), (-2, -1))
        frames = np.empty((len(turns), self.cells + 1, 3, 3))
        frames[:, 0] = first
        for i in range(self.cells):
            np.matmul(frames[:, i], rotations[:, i], out=frames[:, i + 1])
        return frames, self.cell * np.stack([sine, cosine * b, -cosine * a], axis=-1)


# Smooth transitions between motions.


def smooth_step(x: Array) -> Array:
    """Rise from 0 at x = 0 to 1 at x = 1, constant outside, with zero velocity and acceleration at both."""
    t = np.clip(x, 0.0, 1.0)
    return np.asarray(t**3 * (10.0 - 15.0 * t + 6.0 * t**2))


def window(rows: int) -> int:
    """Return the number of rows of a transition, of those from one keyframe to the next."""
    return max(int(0.25 * (rows - 1)), 1)  # of the time between two keyframes


def ramp(rows: int, first: Array, last: Array) -> Array:
    """Return offsets (rows, n) that change smoothly from one to another, each (n,)."""
    share = smooth_step(np.linspace(0.0, 1.0, rows))[:, None]
    return np.asarray((1.0 - share) * first + share * last)


def crossfade(before: Array, after: Array, start: int) -> Array:
    """Return rows (r, n) that change from `before` to `after` within the window that begins at a row."""
    share = smooth_step((np.arange(len(before)) - start) / window(len(before)))[:, None]
    return np.asarray((1.0 - share) * before + share * after)


class PassageSettings(NamedTuple):
    """Which postures on the way are checked for clearance, and moved."""

    max_checked_rows: int = 500
    """Largest number of postures on the way whose clearance is computed."""

    max_tried_rows: int = 60
    """Largest number of postures, those that intrude most, for which one with more room is sought."""

    margin_share: float = 0.999
    """Share of the margin that counts as kept."""


PASSAGE = PassageSettings()


class Gap(NamedTuple):
    """The room of a body between the obstacles around it.

    Attributes:
        body: name of the body.
        obstacles: names of the nearest obstacles.
        room: largest clearance that a small motion of the body can give it [m], at most the margin.
    """

    body: str
    obstacles: tuple[str, ...]
    room: float


def require_passage(reference: Reference, scene: Scene | None, max_lag: float) -> None:
    """Refuse a way on which no posture near the path is clear; warn of one that intrudes into the margin.

    Only ways that the arm has to follow count (`Waypoint.way`).

    Args:
        reference: the planned motion.
        scene: the obstacles, of which those that move do not count; None without any.
        max_lag: largest accepted distance of the arm from the path, beyond that of the plan [m].

    Raises:
        TaskError: the gap between obstacles is too narrow for a body and the margin; names the amounts.
    """
    if scene is None:
        return
    still = {name: obstacle for name, obstacle in scene.obstacles.items() if name not in scene.moving}
    scene = scene.with_obstacles(still).without_self_collision()
    for waypoint, rows, distances in _ways(reference, scene):
        model = CollisionModel(reference.arm, scene)
        where = f"the way to {waypoint.name!r}"
        shift = 2.0 * cast(Way, waypoint.way).planned + max_lag
        intruding = np.flatnonzero(distances < _least_kept(reference, scene))
        intruding = intruding[np.argsort(distances[intruding], kind="stable")]
        for row in rows[intruding[: PASSAGE.max_tried_rows]].tolist():
            state = reference.arm.chain_at(reference.configuration(row))
            gap = _narrowest(model.nearest(state, scene.margin + 2.0 * shift), scene, shift)
            if gap is not None and gap.room < _least_kept(reference, scene):
                raise TaskError(where, _in_words(gap, reference, scene, shift, row))
        if len(intruding):
            warn_caller(
                f"{where}: {_closest_pair(reference, scene, rows, distances)}; the arm has to leave its path"
            )


def require_wide_pipe(reference: Reference, scene: Scene, radius: float) -> None:
    """Refuse a pipe around the path whose walls the planned postures touch, or come too close to.

    Args:
        reference: the planned motion.
        scene: the pipe and its margin.
        radius: radius of the pipe [m].

    Raises:
        InvalidValue: the pipe is too narrow; names the amounts.
    """
    scene = replace(scene, self_collision=False)
    for waypoint, rows, distances in _ways(reference, scene):
        missing = scene.margin - float(distances.min())
        if distances.min() < _least_kept(reference, scene):
            needed = f"{radius + missing:.4g} m or more: {_closest_pair(reference, scene, rows, distances)}"
            planned = length_text(cast(Way, waypoint.way).planned)
            off = f"the planned postures are up to {planned} off the path"
            raise InvalidValue("pipe", radius, f"{needed}; {off}; {length_text(missing)} are missing")


def _ways(reference: Reference, scene: Scene) -> Iterator[tuple[Waypoint, NDArray[np.int64], Array]]:
    """Yield the end of each way that the arm has to follow, rows on it, and the clearance at each [m]."""
    first = 0
    for waypoint in reference.waypoints:
        if waypoint.way is not None:
            model = CollisionModel(reference.arm, scene)  # made on first use, which takes long
            count = min(waypoint.row - first + 1, PASSAGE.max_checked_rows)
            rows = np.unique(np.linspace(first, waypoint.row, count).astype(np.int64))
            configurations = [reference.configuration(row) for row in rows.tolist()]
            yield waypoint, rows, np.array([model.minimum(q).distance for q in configurations])
        first = waypoint.row


def _least_kept(reference: Reference, scene: Scene) -> float:
    """Return the clearance from which on the margin counts as kept [m]."""
    return PASSAGE.margin_share * scene.margin - 1e-9 * reference.arm.length


def _closest_pair(reference: Reference, scene: Scene, rows: NDArray[np.int64], distances: Array) -> str:
    """Say which two come closest, where, and what the margin is."""
    row = int(rows[np.argmin(distances)])
    closest = CollisionModel(reference.arm, scene).minimum(reference.configuration(row))
    pair = " and ".join(closest.pair or ())
    apart = f"{pair} come within {1e3 * closest.distance:.3g} mm at {reference.times[row]:.4g} s of the plan"
    return f"{apart}; the margin is {1e3 * scene.margin:.3g} mm"


def _narrowest(near: Distances, scene: Scene, shift: float) -> Gap | None:
    """Return the gap with the least room; None if no obstacle is near."""
    bodies: dict[str, list[int]] = {}
    for index, (body, other) in enumerate(near.pairs):
        if other in scene.obstacles:
            bodies.setdefault(body, []).append(index)
    gaps = [_gap(body, near, np.array(chosen), scene.margin, shift) for body, chosen in bodies.items()]
    return min(gaps, key=lambda gap: gap.room, default=None)


def _gap(body: str, near: Distances, chosen: NDArray[np.int64], margin: float, shift: float) -> Gap:
    """Return the room of a body: a linear program over small translations and rotations.

    Both move its nearest points by at most `shift` [m] along each axis.
    """
    normals = near.normals[chosen]
    points = near.points[chosen]
    distances = near.distances[chosen]
    arms = points - points.mean(axis=0)
    size = max(float(np.linalg.norm(arms, axis=1).max()), 1e-9)
    turning = np.cross(arms, normals) / size
    rows = np.hstack([-normals, -turning, np.ones((len(chosen), 1))])
    bounds = [(-shift, shift)] * 6 + [(None, margin)]
    solution = linprog(np.append(np.zeros(6), -1.0), A_ub=rows, b_ub=distances, bounds=bounds)
    room = float(solution.x[6]) if solution.success else margin
    names = dict.fromkeys(near.pairs[index][1] for index in chosen[np.argsort(distances, kind="stable")])
    return Gap(body, tuple(names)[:2], room)


def _in_words(gap: Gap, reference: Reference, scene: Scene, shift: float, row: int) -> str:
    bodies = bodies_of(reference.arm, scene.arm_radius)
    radius = max(body.shape.solid().radius for body in bodies if body.name == gap.body)
    return (
        f"the gap at {' and '.join(gap.obstacles)} is too narrow for {gap.body} "
        f"at {reference.times[row]:.4g} s of the plan: "
        f"its radius is {1e3 * radius:.4g} mm and the margin {1e3 * scene.margin:.4g} mm, but "
        f"{1e3 * gap.room:.4g} mm are left within {1e3 * shift:.3g} mm of the path: "
        f"{1e3 * (scene.margin - gap.room):.4g} mm are missing"
    )
