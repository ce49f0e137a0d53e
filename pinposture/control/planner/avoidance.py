"""Keeping clear of obstacles and of itself, by constraints of a quadratic program."""

from __future__ import annotations

from typing import NamedTuple

import daqp
import numpy as np
from numpy.typing import NDArray

from pinposture.arm import ArmState
from pinposture.collision import CollisionModel, Distances
from pinposture.control.limits import JointBounds, stopping_steps
from pinposture.control.planner.objective import LinearRows, Objective

# One convex quadratic program; the only place that knows which solver does the work.

Array = NDArray[np.float64]

TOLERANCE = 1e-9
"""By how much the solver may miss a constraint; its rows are scaled to length 1."""

SOLVED, SOLVED_SOFTLY = 1, 2
HARD, EQUAL, SOFT = 0, 5, 8
STIFF = 1e-7
"""How little rows yield that may: the inverse of what their violation costs."""

SHORT = 1e-12
"""Length of a row that counts as none."""

NONE = 1e30
"""What the solver takes for no bound."""


class ConstraintRows(NamedTuple):
    """Linear constraints least <= matrix @ x.

    Attributes:
        matrix: one row for each, (r, n).
        least: smallest value of each, (r,).
    """

    matrix: Array
    least: Array

    def normal(self) -> ConstraintRows:
        """The same constraints with rows of length 1."""
        lengths = np.maximum(np.linalg.norm(self.matrix, axis=1), SHORT)
        return ConstraintRows(self.matrix / lengths[:, None], self.least / lengths)

    def lowest(self, lower: Array, upper: Array) -> Array:
        """The smallest value of each row within a box, (r,)."""
        return np.asarray(np.minimum(self.matrix * lower, self.matrix * upper).sum(axis=1))


class Solution(NamedTuple):
    """What the solver found.

    Attributes:
        x: the minimiser, within its box, (n,); None if the solver failed.
        binding: which of the rows hold with equality, (r,).
        softened: whether rows had to be violated, because they contradict each other or the box.
    """

    x: Array | None
    binding: NDArray[np.bool_]
    softened: bool


def solve(
    hessian: Array,
    gradient: Array,
    lower: Array,
    upper: Array,
    rows: ConstraintRows | None = None,
    equal: tuple[Array, Array] | None = None,
) -> Solution:
    """Minimise x^T H x / 2 + g^T x within a box, subject to rows.

    If the rows cannot all hold, they are violated as little as possible; the box always holds, and so do the
    equations, which the caller has to know to be possible within the box.

    Args:
        hessian: H, symmetric positive definite, (n, n).
        gradient: g, (n,).
        lower: smallest x, (n,).
        upper: largest x, (n,).
        rows: inequalities; none if None.
        equal: matrix (e, n) and right-hand side (e,) of equations; none if None.
    """
    n = len(gradient)
    all_rows = ConstraintRows(np.zeros((0, n)), np.zeros(0)) if rows is None else rows.normal()
    binding = np.zeros(len(all_rows.least), dtype=np.bool_)
    # Most rows cannot bind within the box; the solver would pay for each.
    possible = np.flatnonzero(all_rows.lowest(lower, upper) < all_rows.least)
    matrix, least = all_rows.matrix[possible], all_rows.least[possible]
    equations = (np.zeros((0, n)), np.zeros(0)) if equal is None else equal

    def ask(hessian: Array, gradient: Array, least: Array, soft: bool) -> Array | None:
        size = max(float(np.trace(hessian)) / n, 1e-300)
        kinds = np.repeat([HARD, SOFT if soft else HARD, EQUAL], [n, len(least), len(equations[1])])
        x, _, flag, _ = daqp.solve(
            np.ascontiguousarray(hessian / size),
            gradient / size,
            np.ascontiguousarray(np.vstack([matrix, equations[0]])),
            np.concatenate([upper, np.full(len(least), NONE), equations[1]]),
            np.concatenate([lower, least, equations[1]]),
            kinds.astype(np.int32),
            primal_tol=TOLERANCE,
            eq_reduction=-1,
            rho_soft=STIFF,
        )
        return x if flag in (SOLVED, SOLVED_SOFTLY) and np.all(np.isfinite(x)) else None

    x, softened = ask(hessian, gradient, least, soft=False), False
    if x is None and len(least):
        softened, nearest = True, ask(np.eye(n), np.zeros(n), least, soft=True)
        if nearest is not None:  # what can be had of the rows, and then the best with that
            least = np.minimum(least, matrix @ nearest - TOLERANCE)
            x = ask(hessian, gradient, least, soft=False)
            x = nearest if x is None else x
    if x is None:
        return Solution(None, binding, softened)
    x = np.minimum(np.maximum(x, lower), upper)
    binding[possible] = matrix @ x <= least + 10.0 * TOLERANCE
    return Solution(x, binding, softened)


# Keeping clear of obstacles and of itself: in one step, and on the way.

SIGHT = 0.15
"""Pairs nearer than this beyond the margin are constrained, in arm lengths: more than a step goes."""

APPROACH = 0.5
"""Share of the room that is left, which a pair may lose in one step."""

SPARE = 0.002
"""What steps keep beyond the margin, in arm lengths: room for the curvature of the way within a step."""

PATH_CLEARANCE = 0.01
"""What a way keeps beyond the margin where it can, in arm lengths."""

PUSH = 0.5
"""Share of the largest push that the limits allow, which is asked of a pair that is too close."""

MENTIONED = 3
"""How many pairs that are too close are listed."""

SAMPLES, SPACING = 10, 0.01
"""The most places in a step at which the distance is looked up, and the joint motion between two of them, in
`Arm.joint_units`; always at its end."""

HALVINGS = 6
"""How often a step after which the arm cannot stop clear is brought halfway to braking, before it brakes."""


class Kept(NamedTuple):
    """A step after which the arm can stop clear of everything, and how.

    Attributes:
        dq: the step, (nv,) [rad or m].
        share: the share of what was asked for beyond braking, 1, 1/2, 1/4, ... or 0.
        stopping: the steps that would follow to stop the arm, (k, nv) [rad or m].
        violated_constraints: what gave way, in words.
    """

    dq: Array
    share: float
    stopping: Array
    violated_constraints: tuple[str, ...] = ()


class Avoidance:
    """A scene around an arm, as rows of a program and as a judge of steps.

    A step is good if the arm keeps its margin on it and on the way on which it would then brake to a stop,
    within all limits. From rest there always is one, which is to stay; and after a good step there is one
    again, which is to brake. So the arm never has to stop harder than it can.

    Args:
        clearance: the distances.
        objective: what the arm is to achieve.
        bounds: what the limits mean for its joints.
        previous: the step before, (nv,) [rad or m]; None: the arm was at rest.

    Attributes:
        clearance: the distances.
        margin: the distance to keep [m].
    """

    def __init__(
        self,
        clearance: CollisionModel,
        objective: Objective,
        bounds: JointBounds,
        previous: Array | None = None,
    ) -> None:
        self.clearance, self.margin = clearance, clearance.scene.margin
        self._objective, self._length, self._bounds = objective, objective.arm.length, bounds
        self._previous = np.zeros(objective.arm.nv) if previous is None else previous
        self._seen: tuple[ArmState, Distances] | None = None
        self._approved: tuple[Array, Array] | None = None
        brake = bounds.brake
        # The way to stop, this step included, is half as many steps long as braking takes, of the longest.
        steps = 0.0 if brake is None else float(np.max(np.abs(self._previous) / brake)) + 2.0
        self._approach = 2.0 / max(steps, 2.0 / APPROACH)

    def near(self, state: ArmState) -> Distances:
        """The pairs in sight; the last answer is kept, because a step asks more than once."""
        if self._seen is None or self._seen[0] is not state:
            self._seen = (state, self.clearance.nearest(state, self.margin + SIGHT * self._length))
        return self._seen[1]

    def rows(self, state: ArmState, lower: Array, upper: Array) -> ConstraintRows | None:
        """The velocity damper: no pair may lose more than a share of its room in one step.

        That is the share that leaves room to brake, straight on and from the speed of now.

        A pair that is too close has to gain room, as far as the bounds of the step allow.

        Args:
            state: where the arm is.
            lower: smallest step, (n,), in `Arm.joint_units`.
            upper: largest step, (n,).
        """
        near = self.near(state)
        if not len(near.distances):
            return None
        matrix = near.jacobian[:, self._objective.columns] * self._objective.units
        least = -self._approach * (near.distances - self.margin - SPARE * self._length)
        most = np.maximum(matrix * lower, matrix * upper).sum(axis=1)
        return ConstraintRows(matrix, np.minimum(least, PUSH * most))

    def intrusion(self, state: ArmState) -> float:
        """By how much the nearest pair is closer than the margin [m]; 0 if all keep it."""
        return max(0.0, self.margin - self.near(state).minimum)

    def intrusions(self, state: ArmState) -> LinearRows:
        """How far pairs are closer than a way should come; the errors should vanish."""
        wanted = self.margin + PATH_CLEARANCE * self._length
        near = self.clearance.nearest(state, wanted)
        return LinearRows(
            near.jacobian[:, self._objective.columns] * self._objective.units, wanted - near.distances
        )

    def stops_clear(self, state: ArmState, dq: Array) -> bool:
        """Whether the arm keeps its margin on a step and while it then stops."""
        stopping = self._stopping(state, dq)
        if not self._keeps(state, dq, stopping, self.margin - self._rounding):
            return False
        self._approved = dq, stopping
        return True

    def kept(self, state: ArmState, dq: Array) -> Kept:
        """The step that is nearest to one asked for, on the way from braking to it, and good.

        Where even braking comes too close, because the arm was too close or too fast to begin with, a step is
        good that comes no closer than braking does. Braking itself is given up only where the arm would touch
        something on it: it then stops harder than its limits allow.

        Args:
            state: where the arm is.
            dq: the step asked for, (nv,) [rad or m].
        """
        if self._approved is not None and np.array_equal(self._approved[0], dq):
            return Kept(dq, 1.0, self._approved[1])
        if self.stops_clear(state, dq):
            return Kept(dq, 1.0, self._stopping(state, dq))
        bounds, rest = self._bounds, np.zeros((1, len(dq)))
        rooms = bounds.edges - state.forward.positions
        braking = np.vstack([stopping_steps(rooms, self._previous, bounds.bound, bounds.brake), rest])
        now = self.near(state).minimum
        lowest = min(now, self._lowest(state, braking, self.margin))
        least = min(self.margin, lowest) - self._rounding
        for number in range(HALVINGS):
            share = 0.5**number
            step = braking[0] + share * (dq - braking[0])
            stopping = self._stopping(state, step)
            if self._keeps(state, step, stopping, least):
                return Kept(step, share, stopping)
        touching = min(now, 0.0) - self._rounding
        if lowest >= touching:
            close = f"margin of {1e3 * self.margin:.3g} mm: braking comes as close as {1e3 * lowest:.3g} mm"
            return Kept(braking[0], 0.0, braking[1:], (close,) if lowest < min(self.margin, now) else ())
        for number in range(1, HALVINGS + 1):
            step = 0.5**number * braking[0] * (number < HALVINGS)
            stopping = self._stopping(state, step)
            if number == HALVINGS or self._keeps(state, step, stopping, touching):
                break
        words = "limits of acceleration: braking within them would touch something"
        return Kept(step, 0.0, stopping, (words,))

    def _stopping(self, state: ArmState, dq: Array) -> Array:
        """The steps that stop the arm after a step from a state, (k, nv)."""
        bounds = self._bounds
        return stopping_steps(bounds.edges - (state.forward.positions + dq), dq, bounds.bound, bounds.brake)

    def _keeps(self, state: ArmState, step: Array, stopping: Array, least: float) -> bool:
        """Whether nothing is nearer than that on a step, and while the arm then stops."""
        return self._lowest(state, np.vstack([step[None], stopping]), least) >= least

    def _lowest(self, state: ArmState, steps: Array, below: float) -> float:
        """The smallest distance on the way of steps (k, nv) [m], exact if smaller than another."""
        longest = np.abs(steps / self._objective.arm.joint_units).max(axis=1, initial=0.0)
        counts = np.clip(np.ceil(longest / SPACING), 1, SAMPLES).astype(np.int64)
        whole = np.repeat(np.cumsum(steps, axis=0) - steps, counts, axis=0)
        first = np.repeat(np.cumsum(counts) - counts, counts)
        shares = (np.arange(len(first)) - first + 1) / np.repeat(counts, counts)
        offsets = whole + shares[:, None] * np.repeat(steps, counts, axis=0)
        return self.clearance.minimum_along(state.q, offsets, below).distance

    @property
    def _rounding(self) -> float:
        return 1e-12 * self._length

    def too_close(self, state: ArmState) -> tuple[str, ...]:
        """The pairs that are closer than the margin, in words."""
        close = self.near(state).distances < self.margin - 1e-9 * self._length
        words = [f"margin of {1e3 * self.margin:.3g} mm: {pair}" for pair in self.named(state, close)]
        more = (f"and {len(words) - MENTIONED} more pairs",) if len(words) > MENTIONED else ()
        return (*words[:MENTIONED], *more)

    def holding(self, state: ArmState, solution: Solution | None, stuck: bool) -> tuple[str, ...]:
        """The pairs that hold a step back, in words: those whose rows bind, or all close ones if stuck."""
        near = self.near(state)
        which = near.distances <= self.margin + 1.5 * SPARE * self._length if stuck else None
        if solution is not None and len(solution.binding) == len(near.distances):
            which = solution.binding if which is None else which | solution.binding
        return () if which is None else self.named(state, which)

    def named(self, state: ArmState, which: NDArray[np.bool_]) -> tuple[str, ...]:
        """Some of the pairs in sight, in words."""
        near = self.near(state)
        chosen = np.flatnonzero(which)
        return tuple(f"{' to '.join(near.pairs[k])}: {1e3 * near.distances[k]:.3g} mm apart" for k in chosen)
