"""Collision avoidance and constraints: rows of a quadratic program, and whether the arm can stop clear."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from functools import cache, cached_property, reduce
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm import ChainState
from pinposture.arm.dynamics import StepLoads
from pinposture.collision import CollisionModel, Distances, Scene
from pinposture.collision.model import MOTION_TOLERANCE, describe_distance
from pinposture.control.constraint import Inequalities, describe_violated, inequalities_of, violations_along
from pinposture.control.limits import JointBounds
from pinposture.control.planner.objective import LinearRows, Objective
from pinposture.control.torque_limits import StepTorques, Stop, TorqueLimits
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import Contacts
from pinposture.quadratic_program import ConstraintRows, Solution
from pinposture.units import CONVERGED, length_text

Array = NDArray[np.float64]


class AvoidanceSettings(NamedTuple):
    """How far obstacles are seen, and how much of its clearance a step may take."""

    constrained_distance: float = 0.15
    """Distance beyond the margin up to which pairs are constrained, in arm lengths: more than a step
    covers."""

    most_clearance_lost: float = 0.5
    """Share of its remaining clearance that a pair may lose in one step."""

    step_clearance: float = 0.002
    """Clearance that steps keep beyond the margin, in arm lengths, to allow for curvature within a
    step."""

    path_clearance: float = 0.01
    """Clearance that a planned path keeps beyond the margin where possible, in arm lengths."""

    path_sight: float = 0.025
    """Further distance up to which pairs are considered while a path is relaxed, in arm lengths. Of
    twice as much, `docs/design/relaxation.md` tells the cost; `make study STUDY=clutter` guards it and
    the clearance."""

    gain_share: float = 0.5
    """Share of the largest possible gain of clearance in a step that is required of a pair that is too
    close, for an obstacle at rest."""

    retreat_gain_share: float = 0.9
    """The same for an obstacle that moves or has been moved. With half of the gain, a joint comes to no
    more than the speed that it can brake in one step."""

    retreat_share: float = 0.2
    """Share of the largest acceleration away from an obstacle that a retreat relies on."""

    retreat_speed_share: float = 0.5
    """Share of the largest speed away from an obstacle that a retreat relies on."""

    named_pairs: int = 3
    """Largest number of pairs that a message lists."""

    sampled_turn: float = 0.05
    """Largest motion of a joint between two states of a motion at which constraints are checked, in
    `Arm.joint_units`."""

    halvings: int = 6
    """How often a step from which the arm cannot stop clear is moved halfway to braking, before it
    brakes."""


AVOIDANCE = AvoidanceSettings()


BRAKING_HARDER = "acceleration limit: braking within it would cause contact"


def describe_lost_margin(pair: Sequence[str], distance: float, margin: float) -> str:
    """Return the message on a pair that is closer than the margin [m]."""
    if distance < 0.0:
        return f"margin: {' and '.join(pair)} overlap by {length_text(-distance)}"
    return f"margin: {' and '.join(pair)} are {length_text(distance)} apart, less than {length_text(margin)}"


class PathClearance(NamedTuple):
    """Missing clearance of pairs of bodies at several configurations.

    Attributes:
        errors: missing clearance, negative for pairs with enough, (r,) [m].
        samples: index of the configuration of each pair, (r,); increasing.
        carried: number of columns of `Objective.columns` that move each body, (r, 2); 0 for an obstacle.
        points: closest points, (r, 3) [m], world frame.
        normals: unit vectors from the second to the first body, (r, 3), world frame.
        minima: smallest distance at each configuration, or any larger number, up to infinity, if it is large
            enough, (s,) [m].
        contacts: what these were computed from.
    """

    errors: Array
    samples: NDArray[np.int64]
    carried: NDArray[np.int64]
    points: Array
    normals: Array
    minima: Array
    contacts: Contacts


@cache
def _no_obstacles() -> Scene:
    return Scene(self_collision=False)


class ClearStep(NamedTuple):
    """A step after which the arm can stop clear of everything.

    Attributes:
        dq: the step, (nv,) [rad or m].
        share: position between braking, 0, and the wanted step, 1: 1, 1/2, 1/4, ... or 0.
        stopping: the steps that would stop the arm afterwards, (k, nv) [rad or m].
        violated_constraints: messages naming the constraints that were relaxed.
    """

    dq: Array
    share: float
    stopping: Array
    violated_constraints: tuple[str, ...] = ()


class Avoidance:
    """Constraints and checks that keep an arm clear of a scene and of itself, and within its constraints.

    A step is clear if the arm keeps its margin during the step and while it then brakes to a stop within all
    limits. From rest, staying is clear; after a clear step, braking is. So the arm never has to brake harder
    than it can. The constraints of the objective are kept in the same way, checked at states
    at most `AVOIDANCE.sampled_turn` apart; but the arm never brakes harder than its limits for them.

    Args:
        clearance: the collision model.
        objective: the objective.
        bounds: the limits of the joints.
        previous: the previous step, (nv,) [rad or m]; None: the arm was at rest.
        offset: displacement of the measured arm from the state of the arm, (nv,) [rad or m], where steps keep
            or restore the margin, too; None: none.
        stopping: steps known to stop the arm within its limits, (k, nv) [rad or m]; None: none.

    Attributes:
        margin: the distance to keep [m].
        moving: whether obstacles move.
        still: whether obstacles rest, and the measured arm is where steps begin.
        offset: as above.
        constraints: the constraints of the objective.
        torques: the torque limits of postures; None: none.
        constrained: whether there are constraints or torque limits.
        tolerated: violation of constraints that is accepted on a path, because its ends violate them [m].
    """

    tolerated: float = 0.0

    def __init__(
        self,
        clearance: CollisionModel,
        objective: Objective,
        bounds: JointBounds,
        previous: Array | None = None,
        offset: Array | None = None,
        stopping: Array | None = None,
    ) -> None:
        if offset is not None and offset.shape != (objective.arm.nv,):
            raise InvalidValue("offset (shape)", offset.shape, f"({objective.arm.nv},) for this arm")
        self.clearance = clearance
        self.margin = clearance.scene.margin
        self.offset = offset
        self.objective = objective
        self.constraints = objective.constraints
        self.torques = None if bounds.effort is None else TorqueLimits(objective.arm, bounds.effort)
        self.constrained = bool(self.constraints) or self.torques is not None
        self._length = objective.arm.length
        self._rounding = 1e-12 * self._length
        self._bounds = bounds
        self._previous = np.zeros(objective.arm.nv) if previous is None else previous
        self._known_stop = stopping
        self._step_torques: tuple[ChainState, StepTorques] | None = None
        self._held: tuple[ChainState, float] | None = None
        self._seen: tuple[ChainState, Distances] | None = None
        self._seen_inequalities: tuple[ChainState, Inequalities] | None = None
        self._seen_displaced: tuple[ChainState, Distances] | None = None
        self._stops: tuple[ChainState, Array, Array | None] | None = None
        brake = bounds.brake
        # The stopping distance, this step included, is the step times half the number of braking steps.
        steps = 0.0 if brake is None else float(np.max(np.abs(self._previous) / brake)) + 2.0
        if bounds.effort is not None and stopping is not None:
            steps = max(steps, len(stopping) + 2.0)
        self._approach = 2.0 / max(steps, 2.0 / AVOIDANCE.most_clearance_lost)
        self._dt = 0.0 if bounds.dt is None else bounds.dt
        self.moving = bool(clearance.scene.velocities)
        self.still = not self.moving and offset is None
        if self.moving and bounds.dt is None:
            allowed = "Limits(dt=...), with the duration of a step: obstacles in the scene have velocities"
            raise InvalidValue("limits", "Limits() without dt", allowed)

    @classmethod
    def of(
        cls,
        scene: Scene | None,
        objective: Objective,
        bounds: JointBounds,
        previous: Array | None = None,
        offset: Array | None = None,
        stopping: Array | None = None,
    ) -> Avoidance | None:
        """Return the avoidance of a scene, of constraints and of torque limits; None if there is none."""
        if scene is None and not objective.constraints and bounds.effort is None:
            return None
        scene = _no_obstacles() if scene is None else scene
        return cls(CollisionModel(objective.arm, scene), objective, bounds, previous, offset, stopping)

    def without_torques(self) -> Avoidance | None:
        """Return the avoidance of the scene and of the constraints alone; None if there are none."""
        if self.clearance.scene is _no_obstacles() and not self.constraints:
            return None
        other = copy(self)
        other.torques = None
        other.constrained = bool(self.constraints)
        other._seen_inequalities = None
        return other

    def tolerating(self, *states: ChainState) -> Avoidance:
        """Return the avoidance for a path that begins and ends at states, which may violate constraints."""
        if not self.constrained:
            return self
        other = copy(self)
        other.tolerated = max(self.violation(state) for state in states)
        return other

    def within(self, share: float) -> Avoidance:
        """Return the avoidance that keeps a share of the margin."""
        other = copy(self)
        other.margin = share * self.margin
        return other

    def inequalities(self, state: ChainState) -> Inequalities:
        """Return the constraints at a state; the last result is cached."""
        if self._seen_inequalities is None or self._seen_inequalities[0] is not state:
            inequalities = inequalities_of(self.constraints, state)
            if self.torques is not None:
                inequalities = inequalities.joined(self.torques.inequalities(state))
            self._seen_inequalities = state, inequalities
        return self._seen_inequalities[1]

    def violation(self, state: ChainState) -> float:
        """Return by how much the worst constraint is violated [m]; 0 if all are kept, up to rounding."""
        if not self.constrained:
            return 0.0
        violation = inequalities_of(self.constraints, state).violation if self.constraints else 0.0
        if self.torques is not None:
            violation = max(violation, self._overload(state))
        return violation if violation > CONVERGED * self._length else 0.0

    def _overload(self, state: ChainState) -> float:
        """Return the largest excess over a torque limit at a state [m]; 0 if all are kept. It is cached."""
        if self.torques is None:
            return 0.0
        if self._held is None or self._held[0] is not state:
            self._held = state, self.torques.violation(state)
        return self._held[1]

    def near(self, state: ChainState) -> Distances:
        """Return the pairs within the constrained distance; the last result is cached."""
        if self._seen is None or self._seen[0] is not state:
            self._seen = state, self.clearance.nearest(state, self._sight)
        return self._seen[1]

    def near_measured(self, state: ChainState) -> Distances | None:
        """Return the same of the measured arm; None without an offset. The last result is cached."""
        if self.offset is None:
            return None
        if self._seen_displaced is None or self._seen_displaced[0] is not state:
            displaced = state.moved(self.offset)
            self._seen_displaced = state, self.clearance.nearest(displaced, self._sight)
        return self._seen_displaced[1]

    @property
    def _sight(self) -> float:
        """Distance up to which pairs are constrained [m]."""
        return self.margin + AVOIDANCE.constrained_distance * self._length

    def rows(self, state: ChainState, lower: Array, upper: Array) -> ConstraintRows | None:
        """Return the velocity damper: no pair may lose more than a share of its clearance in one step.

        The share leaves room to brake from the current speed. A pair that is too close has to gain clearance,
        as far as the bounds of the step allow. From an approaching obstacle the arm retreats early enough to
        match its speed within the acceleration limits.

        The rows of the arm at its state come first, then those of the measured arm, then constraints. The
        measured arm has to gain as much as the other may lose: its offset follows the measurements slowly.

        Args:
            state: the state of the arm.
            lower: smallest step, (n,), in `Arm.joint_units`.
            upper: largest step, (n,).
        """
        parts = [self._damper(self.near(state), lower, upper)]
        measured = self.near_measured(state)
        if measured is not None:
            parts.append(self._damper(measured, lower, upper))
        if self.constrained:
            parts.append(self._constraint_rows(state, lower, upper))
        rows = [part for part in parts if part is not None]
        if not rows:
            return None
        return reduce(ConstraintRows.joined, rows)

    def _constraint_rows(self, state: ChainState, lower: Array, upper: Array) -> ConstraintRows:
        """Return the rows of constraints: none loses more than a share of its room, as pairs of clearance."""
        inequalities = self.inequalities(state)
        matrix = self.objective.restrict(inequalities.matrix)
        room = inequalities.room - AVOIDANCE.step_clearance * self._length
        most = np.maximum(matrix * lower, matrix * upper).sum(axis=1)
        return ConstraintRows(matrix, np.minimum(-self._approach * room, AVOIDANCE.gain_share * most))

    def _damper(self, near: Distances, lower: Array, upper: Array) -> ConstraintRows | None:
        """Return the rows of pairs that are near; None if there are none."""
        if not len(near.distances):
            return None
        matrix = self.objective.restrict(near.jacobian)
        room = near.distances - self.margin - AVOIDANCE.step_clearance * self._length
        most = np.maximum(matrix * lower, matrix * upper).sum(axis=1)
        share = np.full(len(room), AVOIDANCE.gain_share)
        moved = self.clearance.scene.moving
        if moved:  # such an obstacle may still approach
            share[[not moved.isdisjoint(pair) for pair in near.pairs]] = AVOIDANCE.retreat_gain_share
        if not self.moving:
            return ConstraintRows(matrix, np.minimum(-self._approach * room, share * most))
        # Retreating at c - a r, where c is the speed of the obstacle, takes an acceleration of at most a c.
        closing = -self._dt * near.rates
        approach = np.full(len(room), self._approach)
        if self._bounds.brake is not None:
            brake = self.objective.normalize(self._bounds.brake)
            able = AVOIDANCE.retreat_share * (np.abs(matrix) @ np.minimum(brake, 1e9))
            approach = np.minimum(approach, able / np.maximum(closing, 1e-12))
        # From an obstacle that is faster than the arm, it retreats the earlier, the faster the obstacle is.
        bound = self.objective.normalize(self._bounds.bound)
        speed = AVOIDANCE.retreat_speed_share * (np.abs(matrix) @ np.minimum(bound, 1e9))
        faster = closing > speed
        sight = (1.0 - speed[faster] / closing[faster]) * AVOIDANCE.constrained_distance * self._length
        approach[faster] = np.minimum(approach[faster], closing[faster] / sight)
        return ConstraintRows(matrix, np.minimum(closing - approach * room, share * most))

    def intrusion(self, state: ChainState) -> float:
        """Return by how much the nearest pair violates the margin [m]; 0 if all keep it."""
        seen = self._seen
        known = seen is not None and seen[0] is state
        nearest = self.near(state).minimum if known else self.clearance.minimum_at(state).distance
        return max(0.0, self.margin - nearest)

    def allows(self, state: ChainState) -> bool:
        """Whether all pairs keep the margin at a state, and all constraints are kept."""
        return self.clearance.minimum(state.q).distance >= self.margin and self.violation(state) == 0.0

    def lost(self, state: ChainState) -> bool:
        """Whether the margin is lost, by more than rounding, in a scene whose obstacles have been moved."""
        return bool(self.clearance.scene.moving) and self.intrusion(state) > MOTION_TOLERANCE * self._length

    def measure_clearance(self, q: Array, offsets: Array) -> PathClearance:
        """Return the missing clearance of pairs at several configurations of a planned path.

        Args:
            q: a configuration, (nq,).
            offsets: displacements from it, (s, nv) [rad or m].
        """
        sight = self.margin + AVOIDANCE.path_clearance * self._length
        within = sight + AVOIDANCE.path_sight * self._length
        contacts = self.clearance.contacts_along(q, offsets, within)
        return PathClearance(
            errors=sight - contacts.distances,
            samples=contacts.samples,
            carried=self._carried[contacts.carrying],
            points=contacts.points,
            normals=contacts.normals,
            minima=contacts.minima,
            contacts=contacts,
        )

    @cached_property
    def _carried(self) -> NDArray[np.int64]:
        """Number of columns that move the body of each joint of the model, (njoints,)."""
        return self.clearance.count_movers(self.objective.chain.columns)

    def keeps(self, q: Array, path: Array, least: float) -> bool:
        """Whether straight motions keep a distance, given that the first configuration does, and constraints.

        Args:
            q: a configuration, (nq,).
            path: displacements from it that the motions connect, (N + 1, nv) [rad or m].
            least: the distance [m].
        """
        if self.clearance.minimum_on_motions(q, path, least, least).distance < least:
            return False
        return bool(self.keeps_constraints(q, path).all())

    def keeps_constraints(self, q: Array, path: Array) -> NDArray[np.bool_]:
        """Whether each straight motion keeps the constraints, as far as the path may, (N,); see `keeps`."""
        return self._violations_along(q, path) <= self.tolerated + CONVERGED * self._length

    def _violations_along(self, q: Array, path: Array) -> Array:
        """Return the largest violation of a constraint on each straight motion, (N,) [m]; see `keeps`."""
        if not self.constrained:
            return np.zeros(len(path) - 1)
        offsets, ends = self._sampled(path)
        start = self.objective.arm.chain_at(q)
        violations = violations_along(self.constraints, start, offsets)
        if self.torques is not None:
            violations = np.maximum(violations, self.torques.violations(start.raw_positions + offsets))
        return np.asarray(np.maximum(np.maximum.reduceat(violations, ends[:-1]), violations[ends[1:]]))

    def _sampled(self, path: Array) -> tuple[Array, NDArray[np.int64]]:
        """Return displacements (s, nv) on straight motions, and the index of each waypoint among them."""
        longest = AVOIDANCE.sampled_turn * self.objective.arm.joint_units
        return kernels.divide_path(np.ascontiguousarray(path), longest)

    def lacks_room(self, q: Array, offsets: Array) -> NDArray[np.bool_]:
        """Whether `missing_room` may have rows at states displaced from a configuration, (s, nv), (s,)."""
        if self.constraints or self.torques is None:
            return np.full(len(offsets), self.constrained)
        least = self.torques.least_room(self.objective.arm.positions(q) + offsets)
        return least < AVOIDANCE.path_clearance * self._length

    def missing_room(self, state: ChainState, root: float) -> LinearRows:
        """Return rows that move a waypoint back within its constraints, times the root of their weight."""
        inequalities = self.inequalities(state)
        missing = AVOIDANCE.path_clearance * self._length - inequalities.room
        near = missing > 0.0
        matrix = self.objective.restrict(inequalities.matrix[near])
        return LinearRows(root * matrix, root * missing[near])

    def clear_stop(self, state: ChainState, dq: Array, stopping: Array | None = None) -> Array | None:
        """Return the steps that stop the arm after a step, (k, nv) [rad or m]; None if it loses its margin.

        The last result is cached.

        Args:
            state: the state of the arm.
            dq: the step, (nv,) [rad or m].
            stopping: steps that stop the arm within its limits, (k, nv) [rad or m]; None: on a straight line.
        """
        known = self._stops
        if stopping is not None or known is None or known[0] is not state or not np.array_equal(known[1], dq):
            stop = self._stop_after(state, dq) if stopping is None else Stop(stopping)
            least = self.margin - self._rounding
            steps = np.concatenate([dq[None], stop.steps])
            clear = stop.share <= 1.0 and self._lowest(state, steps, least) >= least
            if clear and self.constrained:
                clear = not self._violates(state, steps, self.violation(state), stop.loads)
            self._stops = known = state, dq, stop.steps if clear else None
        return known[2]

    def clear_step(self, state: ChainState, dq: Array) -> ClearStep:
        """Return the clear step closest to a wanted one, between it and braking.

        If even braking comes too close, because the arm was too close or too fast before, a step that comes
        no closer than braking is accepted. If braking would cause contact, the arm stops harder than its
        limits allow; but it evades moving obstacles within them as long as it could still stop a cycle later.
        In the same way, constraints are violated no more than now, or than braking would.

        Args:
            state: the state of the arm.
            dq: the wanted step, (nv,) [rad or m].
        """
        stopping = self.clear_stop(state, dq)
        if stopping is not None:
            return ClearStep(dq, 1.0, stopping)
        rest = np.zeros((1, len(dq)))
        known = self._brake_from(state)
        strongest = max(known.share, 1.0)
        braking = np.vstack([known.steps, rest])
        # Obstacles keep moving when the arm has stopped, so that all steps are compared at the same time.
        until = max(len(braking), len(self._stop_after(state, dq).steps) + 1) if self.moving else 0
        now = self.near(state).minimum
        lowest = min(now, self._lowest(state, braking, self.margin, until))
        touching = min(now, 0.0) - self._rounding
        # A repeated check may differ from the one in the previous step by the tolerance. Whether a margin to
        # moving obstacles is lost, which the arm may yet evade, is for `describe_violations` to say.
        loses = not self.moving and lowest < min(self.margin, now) - MOTION_TOLERANCE * self._length
        close = f"margin: braking comes as close as {1e3 * lowest:.3g} mm, not {1e3 * self.margin:.3g} mm"
        relaxed = (close,) if loses else ()
        due = lowest < touching
        if due and self.moving:
            due = self._lowest(state, np.vstack([braking[:1], rest]), touching) < touching
        possible = lowest if self.moving and not due else max(lowest, touching)
        least = min(self.margin, possible) - self._rounding
        worst = self._violation_in(state, braking) if self.constrained else 0.0
        accepted = max(worst, self.violation(state))
        closer: list[tuple[float, ClearStep]] = []
        for number in range(AVOIDANCE.halvings):
            share = 0.5**number
            step = braking[0] + share * (dq - braking[0])
            stop = self._stop_after(state, step)
            if stop.share > strongest:
                continue
            clear_step = ClearStep(step, share, stop.steps, relaxed)
            steps = np.vstack([step, clear_step.stopping])
            distance = self._lowest(state, steps, least, until)
            if self._violates(state, steps, accepted, stop.loads):
                continue
            if distance >= least:
                return clear_step
            closer.append((distance, clear_step))
        harder = self._brake_harder(state, braking, touching, until, strongest) if due else None
        if harder is not None:
            return harder
        for distance, clear_step in closer if self.moving else ():
            if distance >= lowest - self._rounding:
                return clear_step
        return ClearStep(braking[0], 0.0, braking[1:], relaxed)

    def _brake_harder(
        self, state: ChainState, braking: Array, touching: float, until: int, strongest: float
    ) -> ClearStep | None:
        """Return the gentlest step beyond the acceleration limits that prevents contact.

        None if a moving obstacle comes all the same, or the motors have not the torque: no more than
        `strongest`, relative to its limit.
        """
        for number in range(1, AVOIDANCE.halvings + 1):
            step = 0.5**number * braking[0] * (number < AVOIDANCE.halvings)
            stop = self._stop_after(state, step)
            if stop.share > strongest:
                return None
            if self._lowest(state, np.vstack([step, stop.steps]), touching, until) >= touching:
                break
        else:
            if self.moving:
                return None
        return ClearStep(step, 0.0, stop.steps, (BRAKING_HARDER,))

    def _stop_after(self, state: ChainState, dq: Array) -> Stop:
        """Return the steps that stop the arm after a step, and their torques and those of the step."""
        torques = None if self.torques is None else self.torques_at(state)
        if torques is not None and self.torques is not None:
            stop = torques.stop(dq)
            if stop.loads is not None:
                self._held = state, self.torques.excess_of(stop.loads.held_before)
            return stop
        return Stop(self._bounds.stopping_steps(state.raw_positions + dq, dq))

    def _brake_from(self, state: ChainState) -> Stop:
        """Return the steps that stop the arm at once, and their torques."""
        torques = self.torques_at(state)
        known = self._known_stop
        if torques is not None:
            return torques.stop() if known is None else torques.judged(known)
        if known is not None:
            return Stop(known)
        return Stop(self._bounds.stopping_steps(state.raw_positions, self._previous))

    def torques_at(self, state: ChainState) -> StepTorques | None:
        """Return the torques of steps at a state; None if they are not limited. The last ones are cached."""
        if self._bounds.effort is None or self._bounds.dt is None:
            return None
        if self._step_torques is None or self._step_torques[0] is not state:
            step_torques = StepTorques(self.objective.arm, self._bounds, state.raw_positions, self._previous)
            self._step_torques = state, step_torques
        return self._step_torques[1]

    def _lowest(self, state: ChainState, steps: Array, below: float, until: int = 0) -> float:
        """Return the smallest distance during steps (k, nv) [m]; exact only if it is smaller than `below`.

        The arm then rests until so many steps have passed.
        """
        path = np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
        if len(path) <= until:
            path = np.concatenate([path, path[-1:]])
        times = None
        if self.moving:
            times = self._dt * np.arange(float(len(path)))
            times[-1] = self._dt * max(len(path) - 1, until)
        return self.clearance.minimum_on_motions(state.q, path, below, times=times).distance

    def _violation_in(self, state: ChainState, steps: Array, loads: StepLoads | None = None) -> float:
        """Return the largest violation of a constraint during steps (k, nv) [m]; as for `_violates`."""
        alone = None if self.constraints else self.torques
        if loads is not None and alone is not None:
            near = np.abs(steps) <= AVOIDANCE.sampled_turn * self.objective.arm.joint_units
            if near.all():
                return alone.excess_of(loads.held)
        path = np.concatenate([np.zeros((1, steps.shape[1])), np.cumsum(steps, axis=0)])
        return float(self._violations_along(state.q, path).max())

    def _violates(
        self, state: ChainState, steps: Array, accepted: float, loads: StepLoads | None = None
    ) -> bool:
        """Whether steps violate a constraint by more than is accepted, and than rounding.

        Args:
            state: the state of the arm before them.
            steps: the steps, (k, nv) [rad or m].
            accepted: the largest violation that is accepted [m].
            loads: the largest torques in them, if they are known.
        """
        if not self.constrained:
            return False
        return self._violation_in(state, steps, loads) > accepted + CONVERGED * self._length

    def describe_violations(self, state: ChainState) -> tuple[str, ...]:
        """Describe the pairs that violate the margin, and the constraints that are violated."""
        words = []
        least = self.margin - 1e-9 * self._length
        if self.clearance.minimum_at(state).distance < least:
            near = self.near(state)
            close = np.flatnonzero(near.distances < least)
            words = [describe_lost_margin(near.pairs[k], near.distances[k], self.margin) for k in close]
        more = (
            (f"margin: {len(words) - AVOIDANCE.named_pairs} more pairs",)
            if len(words) > AVOIDANCE.named_pairs
            else ()
        )
        broken = self.describe_broken(state) if self.constrained else ()
        return (*words[: AVOIDANCE.named_pairs], *more, *broken)

    def describe_broken(self, state: ChainState) -> tuple[str, ...]:
        """Describe the constraints and the torque limit that are violated at a state."""
        broken: tuple[str, ...] = ()
        if self.constraints:
            broken = describe_violated(inequalities_of(self.constraints, state), self._length)
        if self.torques is None or self._overload(state) == 0.0:
            return broken
        return broken + self.torques.describe(state)

    def describe_worst_on(self, q: Array, path: Array) -> tuple[str, ...]:
        """Describe the constraints where they are violated most on straight motions; see `keeps`."""
        if not self.constrained:
            return ()
        start = self.objective.arm.chain_at(q)
        offsets, _ = self._sampled(path)
        messages: tuple[str, ...] = ()
        if self.constraints:
            worst_at = int(violations_along(self.constraints, start, offsets).argmax())
            there = inequalities_of(self.constraints, start.moved(offsets[worst_at]))
            messages = describe_violated(there, self._length)
        if self.torques is not None:
            worst_at = int(self.torques.violations(start.raw_positions + offsets).argmax())
            messages += self.torques.describe(start.moved(offsets[worst_at]))
        return messages

    def describe_closest(self, state: ChainState) -> str:
        """Describe the closest pair."""
        near = self.near(state)
        return self._describe(near, near.distances == near.minimum)[0]

    def describe_obstruction(
        self, state: ChainState, solution: Solution | None, stuck: bool
    ) -> tuple[str, ...]:
        """Describe what limits a step: pairs and constraints with active rows, or all close ones if stuck."""
        near = self.near(state)
        count = len(near.distances)
        binding = np.zeros(0, dtype=np.bool_) if solution is None else solution.binding
        words = self._describe(near, self._which(near, binding[:count], stuck))
        measured = self.near_measured(state)
        if measured is not None:
            more = len(measured.distances)
            which = self._which(measured, binding[count : count + more], stuck)
            words += tuple(f"the measured arm: {message}" for message in self._describe(measured, which))
            count += more
        return (
            words + self._describe_constraints(state, binding[count:], stuck) if self.constrained else words
        )

    def _describe_constraints(
        self, state: ChainState, binding: NDArray[np.bool_], stuck: bool
    ) -> tuple[str, ...]:
        """Return a message for each constraint that limits a step."""
        inequalities = self.inequalities(state)
        which = (inequalities.room <= 1.5 * AVOIDANCE.step_clearance * self._length) & stuck
        which = which | binding if len(binding) == len(which) else which
        names = {inequalities.names[k] for k in np.flatnonzero(which)}
        return tuple(f"constraint {name}" for name in sorted(names))

    def _which(self, near: Distances, binding: NDArray[np.bool_], stuck: bool) -> NDArray[np.bool_]:
        """Return which pairs limit a step."""
        which = near.distances <= self.margin + 1.5 * AVOIDANCE.step_clearance * self._length
        which &= stuck
        return which | binding if len(binding) == len(which) else which

    @staticmethod
    def _describe(near: Distances, which: NDArray[np.bool_]) -> tuple[str, ...]:
        chosen = np.flatnonzero(which)
        return tuple(describe_distance(near.pairs[k], near.distances[k]) for k in chosen)
