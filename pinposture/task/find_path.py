"""Find a smooth curve through free space for the tip, which the arm can follow."""

from __future__ import annotations

from math import inf
from time import perf_counter
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import as_vector, require_instance, require_positive, require_whole
from pinposture._validation import direction as unit_vector
from pinposture.arm import Arm
from pinposture.collision import Scene, Sphere
from pinposture.collision.bodies import bodies_of
from pinposture.collision.distances import PairDistances, TreeKinematics
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, OutOfReach, PostureError, ReachError, raise_together
from pinposture.placement.target import arm_axis
from pinposture.task.follow_leader import FedArm
from pinposture.units import ROUNDING, length_text

Array = NDArray[np.float64]


class PathTreeSettings(NamedTuple):
    """How trees of arcs are grown for a leader, and made into a path."""

    bend_shares: tuple[float, ...] = 0.7, 0.5, 0.35
    """Curvature of the arcs relative to the largest that the modules can follow; each tree draws one. The
    spline bends more where arcs meet."""

    enough_paths: int = 3
    max_tries: int = 2000
    max_shortenings: int = 200
    """Number of paths after which the shortest is taken, and attempts to grow a tree and to shorten a
    path."""

    goal_share: float = 0.15
    """Share of growth steps towards the goal."""

    room: float = 0.6
    """Search space around start and goal, relative to their distance, or to half the arm if that is
    more."""

    max_arc: float = 1.4
    """Largest angle between the initial direction of an arc and its chord [rad]."""

    points_per_radius: float = 6.0
    points_per_path: int = 12
    """Control points of the spline per smallest bending radius, and smallest total number."""

    excess: float = 1e-6
    """Relative excess of the curvature of an arc that is due to rounding: it is recomputed from its
    ends."""

    checked_places: int = 1000
    """Smallest number of points at which clearance and curvature of a path are checked."""


TREES = PathTreeSettings()


def find_path(
    scene: Scene,
    start: ArrayLike | None,
    goal: ArrayLike,
    arm: Arm,
    *,
    direction: ArrayLike | None = None,
    seed: int = 0,
    budget: float = 5.0,
) -> Curve:
    """Find a smooth collision-free curve to a goal that the arm can follow, tip first.

    A tree of arcs grows from the start in the given direction. A path to the goal is shortened and replaced
    by a spline, which is checked as a whole. Its distance from all obstacles exceeds the sum of the margin of
    the scene, the radius of the arm and the height of the arcs over its links. Its curvature is at most what
    all modules allow (`Arm.can_follow`). This is a search: it may miss a curve that exists, and the curve is
    not the shortest. The direction at the goal is free. Neither the part of the arm behind the start nor
    self-collision is checked.

    Args:
        scene: the obstacles.
        start: start of the curve, (3,) [m], world frame; None: the tip of an arm on a retracted feed (see
            `follow_leader`), the base of any other arm.
        goal: its end, (3,) [m], world frame.
        arm: the arm that has to follow it.
        direction: its direction at the start, (3,), world frame; that of the straight arm if None.
        seed: seed of the random numbers.
        budget: time limit [s]. If it ends the search, the curve depends on the machine; otherwise only on the
            seed.

    Returns:
        The curve, in the world: `follow_leader(arm, curve, ..., placement="as_is")` follows it.

    Raises:
        InvalidValue: an argument of the wrong type, or one that does not fit the arm.
        OutOfReach: start or goal are off the plane of a planar arm, or farther apart than the arm is long or
            the travel of its feed.
        ReachError: no curve was found; the message says why.
    """
    began = perf_counter()
    require_instance("arm", arm, Arm, "an Arm")
    require_instance("scene", scene, Scene, "a Scene(...)")
    require_positive("budget", budget)
    until = began + budget
    require_whole("seed", seed, 0)
    follower = _follower(arm)
    body = follower.body
    plane = follower.body.plane
    begin = follower.entry if start is None else as_vector("start", start)
    end = as_vector("goal", goal)
    ahead = follower.axis if direction is None else np.array(unit_vector("direction", direction))
    _check_ends(follower, begin, end, ahead)
    sharpest = body.can_follow(Curve.line(begin, end)).max_curvature
    if sharpest <= 0.0:
        raise InvalidValue("arm", arm, "an arm whose modules all bend")
    link = float(np.linalg.norm(np.diff(body.at(body.straight()).links, axis=0), axis=1).max())
    thickness = max((body.shape.solid().radius for body in bodies_of(arm, scene.arm_radius)), default=0.0)
    bulge = sharpest * link**2 / 8.0
    space = _FreeSpace(scene, scene.margin + thickness + bulge)
    needed = (
        f"a path needs {length_text(space.radius)} on all sides: "
        f"{length_text(thickness)} for the radius of the arm, "
        f"{length_text(scene.margin)} for the margin, {length_text(bulge)} for the arc over a link"
    )
    crowded = [
        f"the {name} is {text}"
        for name, position in (("start", begin), ("goal", end))
        if (text := space.crowding(position))
    ]
    if crowded:
        raise ReachError(end, f"{'; '.join(crowded)}; {needed}")
    rng = np.random.default_rng(seed)
    curves: list[Curve] = []
    why = "the tree did not reach the goal within the budget"
    while len(curves) < TREES.enough_paths:
        bend = sharpest * TREES.bend_shares[rng.integers(len(TREES.bend_shares))]
        tree = _ArcTree(begin, ahead, end, bend, plane, arm.length, space)
        nodes = tree.grow(rng, until)
        if nodes is not None:
            curve = tree.spline(tree.shorten(nodes, rng, until))
            fault = _fault(curve, body, space, sharpest, follower.longest)
            if not fault:
                curves.append(curve)
            why = fault or why
        if perf_counter() >= until:
            break
    if not curves:
        raise ReachError(end, f"no path was found: {why}; {needed}")
    return min(curves, key=lambda curve: curve.length)


class _Follower(NamedTuple):
    """The body that follows a curve.

    Attributes:
        body: the arm, without its feed if it is on one.
        entry: default start of curves, (3,) [m].
        axis: their default initial direction, unit vector (3,).
        longest: longest curve that it can follow, for any shape [m]: the feed moves straight, and its end
            must not reach a bend.
    """

    body: Arm
    entry: Array
    axis: Array
    longest: float


def _follower(arm: Arm) -> _Follower:
    """Return the follower of an arm: on its feed, or fixed at its base."""
    if len(arm.chain.joints) > 1 and not arm.chain.revolute[0] and arm.chain.revolute[1]:
        fed = FedArm(arm)
        raise_together(fed.misfits)
        return _Follower(fed.body, fed.tip, fed.axis, min(fed.travel, fed.length))
    return _Follower(arm, arm.chain.base, arm_axis(arm), arm.length)


def _check_ends(follower: _Follower, begin: Array, end: Array, ahead: Array) -> None:
    """Refuse a start and a goal that no curve for the arm can connect."""
    body = follower.body
    plane = follower.body.plane
    ends = {"goal": end - follower.entry, "start": begin - follower.entry, "direction": ahead}
    misfits: list[PostureError] = []
    for name, vector in ends.items():
        across = float(np.linalg.norm(vector - plane.T @ (plane @ vector)))
        most = ROUNDING * max(body.length, 1.0)
        if across > most:
            reason = (
                f"the {name} is {length_text(across)} off the plane in which the arm moves; "
                f"allowed: {length_text(most)}"
            )
            misfits.append(OutOfReach(end, reason))
    apart = float(np.linalg.norm(end - begin))
    if apart <= ROUNDING * body.length:
        misfits.append(InvalidValue("goal", end.tolist(), "a position away from the start"))
    if apart > follower.longest:
        missing = f"{length_text(apart - follower.longest)} are missing"
        followed = f"the arm can follow {length_text(follower.longest)}"
        misfits.append(OutOfReach(end, f"it is {length_text(apart)} from the start; {followed}; {missing}"))
    raise_together(misfits)


def _fault(curve: Curve, body: Arm, space: _FreeSpace, sharpest: float, longest: float) -> str:
    """Return why an arm cannot follow a curve; empty if it can."""
    count = max(TREES.checked_places, int(np.ceil(curve.length / (0.1 * space.radius))))
    s = np.linspace(0.0, curve.length, count)
    if curve.length > longest:
        return f"the best is {length_text(curve.length)} long; the arm can follow {length_text(longest)}"
    if not space.is_free(curve.at(s)):
        return "the smooth curve comes too close to an obstacle"
    bend = float(np.asarray(curve.curvature(s)).max())
    if bend > sharpest:
        return f"the curvature of the best is {bend:.4g} /m; the modules allow {sharpest:.4g} /m"
    # Feasibility covers one arm length only.
    stretch = body.length
    for first in np.arange(0.0, curve.length, stretch):
        last = min(first + 1.5 * stretch, curve.length)
        if last - first > 1e-3 * stretch:
            excesses = body.can_follow(curve.trimmed(float(first), float(last))).excesses
            if excesses:
                return f"the modules cannot follow: {excesses[0]}"
    return ""


class _FreeSpace:
    """The space in which a ball is clear of all obstacles.

    Args:
        scene: the obstacles.
        radius: radius of the ball [m].
    """

    def __init__(self, scene: Scene, radius: float) -> None:
        self.radius = radius
        model = pin.Model()
        joint = 0
        for number, kind in enumerate((pin.JointModelPX(), pin.JointModelPY(), pin.JointModelPZ())):
            joint = model.addJoint(joint, kind, pin.SE3.Identity(), f"slide_{number}")
        self._kinematics = TreeKinematics(model)
        pieces = [
            (name, piece) for name, obstacle in scene.standing.items() for piece in obstacle.geometry.solids()
        ]
        fixed = [piece for _, piece in pieces]
        self._names = [name for name, _ in pieces]
        ball = Sphere((0.0, 0.0, 0.0), radius).solid()
        pairs = [(0, 1 + k) for k in range(len(fixed))]
        depths = [scene.depth(name) for name in self._names]
        self._distances = PairDistances([ball], [joint], fixed, pairs, depths)
        self._empty = not fixed

    def is_free(self, points: Array) -> bool:
        """Whether the ball is clear at all points, (s, 3) [m]."""
        if self._empty:
            return True
        placements = self._kinematics.place(np.zeros(3), np.ascontiguousarray(points))
        return self._distances.minimum(placements, 0.0)[0] >= 0.0

    def crowding(self, point: Array) -> str:
        """Say how close a point (3,) [m] is to an obstacle, and what is missing; empty if it is free."""
        if self.is_free(point[None]):
            return ""
        placements = self._kinematics.place(np.zeros(3), np.ascontiguousarray(point[None]))
        distance, pair = self._distances.minimum(placements)
        apart = distance + self.radius
        where = f"{length_text(apart)} from" if apart > 0.0 else f"{length_text(-apart)} inside"
        return f"{where} {self._names[pair]!r}, {length_text(-distance)} too close"


class _Arc(NamedTuple):
    """An arc, or a straight line.

    Attributes:
        begin: its start, (3,) [m].
        tangent: its initial direction, unit vector (3,).
        side: the direction in which it bends, unit vector (3,) normal to the tangent.
        curvature: its curvature [1/m].
        length: its length [m].
    """

    begin: Array
    tangent: Array
    side: Array
    curvature: float
    length: float

    def at(self, s: Array) -> Array:
        """Return the points at arc lengths (n,), (n, 3) [m]."""
        turn = self.curvature * s[:, None]
        ahead = s[:, None] * np.sinc(turn / np.pi)
        aside = 0.5 * s[:, None] * turn * np.sinc(0.5 * turn / np.pi) ** 2
        return np.asarray(self.begin + ahead * self.tangent + aside * self.side)

    @property
    def end(self) -> Array:
        return np.asarray(self.at(np.array([self.length]))[0])

    @property
    def end_tangent(self) -> Array:
        turn = self.curvature * self.length
        return np.asarray(np.cos(turn) * self.tangent + np.sin(turn) * self.side)


class _ArcTree:
    """A tree of arcs of limited curvature, each tangent to the previous one."""

    def __init__(
        self,
        start: Array,
        direction: Array,
        goal: Array,
        bend: float,
        plane: Array,
        arm_length: float,
        space: _FreeSpace,
    ) -> None:
        self._start = start
        self._direction = direction
        self._goal = goal
        self._bend = bend
        self._plane = plane
        self._space = space
        distance = float(np.linalg.norm(goal - start))
        self._longest = min(max(1.0 / bend, arm_length / 25.0), 0.5 * distance)
        self._spacing = min(1.0 / (TREES.points_per_radius * bend), distance / TREES.points_per_path)
        room = TREES.room * max(distance, 0.5 * arm_length)
        self._low = np.minimum(start, goal) - room
        self._high = np.maximum(start, goal) + room

    def grow(self, rng: np.random.Generator, until: float) -> list[Array] | None:
        """Return the ends of arcs from the start to the goal; None if none were found."""
        first = self._line()
        if not self._is_free(first):
            return None
        nodes = np.empty((TREES.max_tries + 1, 3))
        tangents = np.empty((TREES.max_tries + 1, 3))
        parents = [-1]
        nodes[0] = first.end
        tangents[0] = first.end_tangent
        count = 1
        for _ in range(TREES.max_tries):
            if perf_counter() >= until:
                break
            to_goal = rng.random() < TREES.goal_share
            aim = self._goal if to_goal else rng.uniform(self._low, self._high)
            aim = self._start + self._plane.T @ (self._plane @ (aim - self._start))
            offsets = aim - nodes[:count]
            far = np.maximum((offsets**2).sum(axis=1), 1e-18)
            along = np.einsum("ij,ij->i", offsets, tangents[:count])
            bends = 2.0 * np.sqrt(np.maximum(far - along**2, 0.0)) / far
            behind = np.where(along < 0.0, 2.0, 0.0)
            node = int(np.argmin(np.sqrt(far) * (1.0 + np.maximum(bends / self._bend - 1.0, 0.0) + behind)))
            arc = self._towards(nodes[node], tangents[node], aim)
            if not self._is_free(arc):
                continue
            nodes[count] = arc.end
            tangents[count] = arc.end_tangent
            parents.append(node)
            count += 1
            last = _arc_to(arc.end, arc.end_tangent, self._goal, self._bend)
            if last is not None and self._is_free(last):
                path = [self._goal]
                at = count - 1
                while at >= 0:
                    path.append(nodes[at])
                    at = parents[at]
                if self._arcs(path[::-1]) is not None:  # otherwise lost to rounding, next to an obstacle
                    return path[::-1]
        return None

    def shorten(self, nodes: list[Array], rng: np.random.Generator, until: float) -> list[Array]:
        """Remove and move points as long as that shortens the path."""
        best = nodes
        length = self._length(self._arcs(nodes))
        for _ in range(TREES.max_shortenings):
            if len(best) < 3 or perf_counter() >= until:
                break
            k = int(rng.integers(1, len(best) - 1))
            tried = [*best]
            if rng.random() < 0.5:
                del tried[k : k + int(rng.integers(1, 4))]
                if not np.array_equal(tried[-1], self._goal):
                    tried.append(self._goal)
            else:
                middle = 0.5 * (best[k - 1] + best[k + 1])
                tried[k] = best[k] + rng.uniform(0.1, 0.8) * (middle - best[k])
            tried_length = self._length(self._arcs(tried))
            if tried_length < length:
                best = tried
                length = tried_length
        return best

    def spline(self, nodes: list[Array]) -> Curve:
        """Return the spline with control points at equal distances on the arcs through points."""
        arcs = self._arcs(nodes) or []
        points = [self._start[None]]
        for arc in arcs:
            count = max(int(np.ceil(arc.length / self._spacing)), 2)
            points.append(arc.at(arc.length * np.arange(1, count + 1) / count))
        return Curve.spline(np.concatenate(points))

    def _line(self) -> _Arc:
        """Return the initial line of every path, which gives the spline the exact direction."""
        return _Arc(self._start, self._direction, np.zeros(3), 0.0, 2.0 * self._spacing)

    def _arcs(self, nodes: list[Array]) -> list[_Arc] | None:
        """Return the arcs through points, the first at the end of the line; None if one is not feasible."""
        arcs = [self._line()]
        for point in nodes[1:]:
            arc = _arc_to(arcs[-1].end, arcs[-1].end_tangent, point, self._bend)
            if arc is None or not self._is_free(arc):
                return None
            arcs.append(arc)
        return arcs

    def _length(self, arcs: list[_Arc] | None) -> float:
        return inf if arcs is None else sum(arc.length for arc in arcs)

    def _towards(self, position: Array, tangent: Array, aim: Array) -> _Arc:
        """Return an arc, of a largest length, that comes as close to an aim as the curvature allows."""
        direct = _arc_to(position, tangent, aim, self._bend)
        if direct is not None:
            return direct._replace(length=min(direct.length, self._longest))
        offset = aim - position
        side = offset - tangent * (tangent @ offset)
        size = float(np.linalg.norm(side))
        if size < 1e-12:  # straight behind: any side will do
            across = self._plane - np.outer(self._plane @ tangent, tangent)
            side = across[int(np.argmax((across**2).sum(axis=1)))]
            size = float(np.linalg.norm(side))
        return _Arc(position, tangent, side / size, self._bend, self._longest)

    def _is_free(self, arc: _Arc) -> bool:
        count = max(int(np.ceil(arc.length / (0.5 * self._space.radius))), 2)
        return self._space.is_free(arc.at(arc.length * np.arange(1, count + 1) / count))


def _arc_to(position: Array, tangent: Array, aim: Array, bend: float) -> _Arc | None:
    """Return the arc from a point in a direction to an aim; None if it bends or turns too much."""
    offset = aim - position
    distance = float(np.linalg.norm(offset))
    if distance < 1e-9:
        return None
    ahead = float(tangent @ offset)
    side = offset - ahead * tangent
    aside = float(np.linalg.norm(side))
    angle = float(np.arctan2(aside, ahead))
    curvature = 2.0 * aside / distance**2
    if angle > TREES.max_arc or curvature > bend * (1.0 + TREES.excess):
        return None
    length = distance / float(np.sinc(angle / np.pi))
    return _Arc(position, tangent, side / max(aside, 1e-300), curvature, length)
