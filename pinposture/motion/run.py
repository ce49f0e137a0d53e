"""Results of runs: configurations, status, and faults such as exceeded limits."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from pinposture._validation import is_usable, make_read_only, require_instance
from pinposture.arm import Arm, JointLoad
from pinposture.collision import Closest, CollisionModel, Scene
from pinposture.collision.bodies import scene_at
from pinposture.collision.model import Pair, arm_alone
from pinposture.control import Limits
from pinposture.control.controller import CONSTRAINTS
from pinposture.errors import InvalidValue, MotionError, NoEquilibrium
from pinposture.motion.held import HeldObject, Stages
from pinposture.motion.joint_trajectory import JointTrajectory, step_duration
from pinposture.placement import Target
from pinposture.placement.target import distance_from_curve
from pinposture.units import CONVERGED, ROUNDING, length_text

# Velocities and accelerations relative to limits, computed from the configurations of a motion.

Array = NDArray[np.float64]


class LimitViolation(NamedTuple):
    """Violations of velocity, acceleration and jerk limits in a motion.

    Attributes:
        steps: the violating steps, 0-based. The stop at the end belongs to the last step.
        words: message on the limit that is exceeded most in each of them.
        worst: the step with the largest ratio of a value to its limit.
        ratio: that ratio.
        text: summary of the violations.
    """

    steps: tuple[int, ...]
    words: tuple[str, ...]
    worst: int
    ratio: float
    text: str


def limit_shares(run: Run) -> tuple[Array | None, Array | None]:
    """Return the largest velocities, (steps,), and accelerations, (steps + 1,), relative to their limits.

    The arm is at rest before and after. None if no joint has a limit.
    """
    speeds, accelerations, _ = joint_shares(run)
    bounds = run.limits.for_arm(run.arm)
    limited = bool(np.any(np.isfinite(bounds.bound)))
    largest = None if bounds.acceleration is None else accelerations.max(axis=1)
    return speeds.max(axis=1) if limited else None, largest


def largest_shares(run: Run) -> dict[str, float | None]:
    """Return the largest speed, acceleration and jerk relative to their limits; None without a limit."""
    bounds = run.limits.for_arm(run.arm)
    limits = {"speed": bounds.bound, "acceleration": bounds.acceleration, "jerk": bounds.jerk}
    return {
        kind: None if limit is None or np.all(np.isinf(limit)) else float(shares.max(initial=0.0))
        for (kind, limit), shares in zip(limits.items(), joint_shares(run), strict=True)
    }


def find_limit_violation(run: Run) -> LimitViolation | None:
    """Return the violations of velocity, acceleration and jerk limits in a run, from and to rest."""
    if not run.steps:
        return None
    bounds = run.limits.for_arm(run.arm)
    kinds = ("velocity", "acceleration", "jerk", "torque")
    shares = (*joint_shares(run), torque_shares(run.arm, run.q, run.limits))
    for share in shares[1:]:
        share[run.steps - 1] = share[run.steps - 1 :].max(axis=0)
    ends = np.abs([run.arm.positions(q) for q in run.q[[0, -1]]]).max(axis=0)
    rounding = 8.0 * float(np.finfo(np.float64).eps) * (1.0 + ends)  # of a difference of positions
    largest = (bounds.bound, bounds.acceleration, bounds.jerk, None)
    over = np.stack(
        [
            each[: run.steps] - (0.0 if most is None else 2.0**order * rounding / most)
            for order, (each, most) in enumerate(zip(shares, largest, strict=True))
        ]
    )
    steps = np.flatnonzero(over.max(axis=(0, 2)) > 1.0 + ROUNDING)
    if not len(steps):
        return None
    words = []
    ratios = []
    for step in steps:
        at_step = over[:, step]
        most_exceeded = int(at_step.argmax())
        kind, joint = divmod(most_exceeded, at_step.shape[1])
        ratios.append(float(shares[kind][step, joint]))
        name = run.arm.joint_names[joint]
        words.append(f"{kinds[kind]} limit: joint {name!r} exceeds it by a factor of {ratios[-1]:.4g}")
    most = int(np.argmax(ratios))
    number = len(steps)
    worst = int(steps[most])
    count = f"{number} step" + ("s" if number > 1 else "")
    text = f"limits are exceeded in {count}, most in step {worst + 1} (of {run.steps}): {words[most]}"
    return LimitViolation(tuple(int(step) for step in steps), tuple(words), worst, ratios[most], text)


def joint_shares(run: Run) -> tuple[Array, Array, Array]:
    """Return joint speeds, accelerations and jerks, (steps + 0, 1 and 2, nv), relative to their limits.

    The arm is at rest before and after. Without a limit, the ratio is zero.
    """
    bounds = run.limits.for_arm(run.arm)
    values = run.displacements
    shares = []
    for most in (bounds.bound, bounds.acceleration, bounds.jerk):
        shares.append(np.abs(values) / (np.inf if most is None else most))
        values = np.diff(np.pad(values, ((1, 1), (0, 0))), axis=0)
    return shares[0], shares[1], shares[2]


def torque_shares(arm: Arm, q: Array, limits: Limits) -> Array:
    """Return the torques at the configurations of a motion, (N, nq), relative to their limits, (N, nv).

    With a cycle time those of the motion, from and to rest; else those that hold the arm. Zeros without.
    """
    bounds = limits.for_arm(arm)
    if bounds.effort is None:
        return np.zeros((len(q), arm.nv))
    rest = np.zeros((1, arm.nv))
    if bounds.dt is None:
        steps = np.zeros((len(q) + 1, arm.nv))
    else:
        steps = np.concatenate([rest, arm.difference(q[:-1], q[1:]) / bounds.dt, rest])
    dt = 1.0 if bounds.dt is None else bounds.dt
    torques = arm.inverse_dynamics(q, (steps[1:] + steps[:-1]) / 2.0, np.diff(steps, axis=0) / dt)
    return np.asarray(np.abs(torques) / bounds.effort)


# How runs, motions and simulations end, and whether a motion may be sent to a robot.

ENDINGS: Mapping[str, str] = MappingProxyType(
    {
        "converged": "converged",
        "stalled": "stalled",
        "no_control_points": "found no control point that it may move",
        "max_steps": "ran out of steps",
        "stopped": "was stopped",
        "missed": "missed a target",
        "unstable": "became unstable",
        "failed": "failed",
    }
)
"""Statuses of motions, and their descriptions in messages.

"converged": the arm reached its target. "stalled": no step reduces the error. "no_control_points": the
controller found none that it can move. "max_steps": no steps or cycles are left. "stopped": by the user.
"missed": a simulation ended with the arm away from its target, or a motion passed a keyframe at a distance.
"unstable": the simulation diverged. "failed": an error ended the run.
"""

RAISE_STEPS = "raise max_steps to"
"""How advice on a run that ran out of steps begins; the number of steps that is enough follows."""


class Excess(Protocol):
    """What a motion exceeds."""

    @property
    def text(self) -> str:
        """A clause that says it."""


class Outcome:
    """How a motion ended, and whether it may be sent to a robot.

    Attributes:
        arm: the arm.
        status: how the motion ended, one of `ENDINGS`.
        reason: why it ended.
        q: configurations, (N, nq).
        clearance: smallest distance at each, (N,) [m]; negative in penetration, infinite without a scene.
        scene: the obstacles; None: none.
    """

    arm: Arm
    status: str
    reason: str
    q: Array
    clearance: Array
    scene: Scene | None

    @property
    def excess(self) -> Excess | None:
        """Limits that the motion exceeds; None if there are none."""
        raise NotImplementedError

    def scene_in(self, row: int, scene: Scene) -> Scene:
        """Return a scene in a row of the motion, given that at the start, in which obstacles may be free."""
        return scene

    @property
    def final_scene(self) -> Scene | None:
        """The obstacles where they are at the end; those that the arm carries stand where it has them."""
        if self.scene is None:
            return None
        return scene_at(self.arm, self.q[-1], self.scene_in(len(self.q) - 1, self.scene))

    @property
    def touched(self) -> tuple[str, ...] | None:
        """Clauses on contact that was not allowed; None if contact was not simulated."""
        return None

    @cached_property
    def heaviest(self) -> Heaviest | None:
        """The joint that is loaded most, in relation to its limit, if the arm held still on the way.

        None if masses or torque limits are not known.
        """
        if not self.arm.torques_known:
            return None
        loads = [self.arm.at(q).most_loaded() for q in self.q]
        known = [(load.share, -row, load) for row, load in enumerate(loads) if load is not None]
        if not known:
            return None
        _, row, load = max(known)
        return Heaviest(load, -row)

    @cached_property
    def sagged(self) -> Sagged | None:
        """Where the loaded arm is if it is sent this motion; None if masses or stiffness are not known."""
        return find_sag(self) if self.arm.sag_known else None

    @cached_property
    def sag_faults(self) -> tuple[str, ...]:
        """Those of the `faults` that commands against sag do not have."""
        return () if self.sagged is None else self.sagged.faults

    @property
    def converged(self) -> bool:
        """Whether the arm is at its target at the end, within the tolerance."""
        return self.status == "converged"

    @cached_property
    def faults(self) -> tuple[str, ...]:
        """Why the motion should not be sent to a robot; empty if it may be.

        It did not converge, it exceeds a velocity, acceleration or jerk limit, a simulated arm left its path,
        a joint has not the torque to hold the arm still on the way, or bodies penetrate each other. Without a
        scene, the parts of the arm must not penetrate each other either; with self-collision off in the
        scene, they may. Where contact is simulated, that which is not allowed counts instead. Torques count
        where masses and limits are known. Where masses and stiffness are, the arm must be clear and stable as
        it sags, too.
        """
        if self.converged:
            return self._faults_before_end
        others = (what for what in self._faults_before_end if what not in self.reason)
        return f"it {ENDINGS[self.status]}: {self.reason}", *others

    @property
    def verdict(self) -> str:
        """Whether it converged, its faults and why it ended, in one line."""
        there = "reached the target" if self.converged else "did not reach the target"
        faults = [what for what in self._faults_before_end if what not in self.reason]
        but = f", but {', and '.join(faults)}" if faults else ""
        load = "" if self.sagged is None or self.sagged.error is None else f"; {self.sagged}"
        return f"{there} ({self.status}){but}: {self.reason}{load}"

    @cached_property
    def _faults_before_end(self) -> tuple[str, ...]:
        """Clauses on exceeded limits and the deepest penetration."""
        faults = [] if self.excess is None else [self.excess.text]
        if self.heaviest is not None and self.heaviest.load.exceeded:
            faults.append(str(self.heaviest))
        if self.touched is not None:
            return (*faults, *self.touched)
        deepest = find_penetration(self)
        if deepest is not None:
            advice = "; in a scene, such as Scene(), the arm keeps clear of itself"
            faults.append(str(deepest) + (advice if self.scene is None else ""))
        return (*faults, *self.sag_faults)


class Heaviest(NamedTuple):
    """The joint that is loaded most, at rest, in a motion.

    Attributes:
        load: its torque and limit.
        row: the row of the motion.
    """

    load: JointLoad
    row: int

    def __str__(self) -> str:
        return f"{self.load} to hold the arm {_after(self.row)}"


def _after(row: int) -> str:
    return f"after {row} steps" if row else "at the start"


class Penetration(NamedTuple):
    """The deepest penetration in a motion.

    Attributes:
        pair: names of the two bodies, or of the body and the obstacle.
        depth: how deep they are inside each other [m].
        row: the row of the motion.
    """

    pair: Pair
    depth: float
    row: int

    def __str__(self) -> str:
        return f"{' and '.join(self.pair)} penetrate by {1e3 * self.depth:.3g} mm {_after(self.row)}"


def find_penetration(motion: Outcome) -> Penetration | None:
    """Return the deepest penetration in a motion, of an obstacle or of the arm itself; None if there is none.

    Verdicts, exports and the editor all judge collisions of a finished motion by it.
    """
    arm = motion.arm
    least = smallest_distance(motion)
    if least.pair is None or least.distance >= -CONVERGED * arm.length:
        return None
    clearance = motion.clearance
    if motion.scene is None:
        model = CollisionModel(arm, arm_alone(arm))
        clearance = np.array([model.minimum(q).distance for q in motion.q])
    return Penetration(least.pair, -least.distance, int(clearance.argmin()))


class Sagged(NamedTuple):
    """Where a loaded arm is that is sent a motion without compensation.

    Attributes:
        error: mean distance of its control points, at the end, from where the motion has them [m]; None if it
            has no stable rest on the way.
        clearance: its smallest distance to an obstacle, or to itself; negative in penetration [m]; None as
            `error`.
        row: the row of that, or in which it has no stable rest.
        faults: its deepest penetration, or why it has no stable rest.
    """

    error: float | None
    clearance: float | None
    row: int
    faults: tuple[str, ...]

    def __str__(self) -> str:
        off = "" if self.error is None else length_text(self.error)
        return f"under load the arm ends {off} from there, in the mean of its points"


def find_sag(motion: Outcome) -> Sagged:
    """Return where the loaded arm is in a motion; see `Outcome.sagged`."""
    arm = motion.arm
    q: list[Array] = []
    for row, command in enumerate(motion.q):
        try:
            q.append(arm.sag(command))
        except NoEquilibrium as error:
            gives_way = f"under load, joint {error.joint!r} gives way {_after(row)}"
            return Sagged(None, None, row, (gives_way,))
    moved = arm.at(q[-1]).points - arm.at(motion.q[-1]).points
    off = float(np.linalg.norm(moved, axis=1).mean())
    scene = arm_alone(arm) if motion.scene is None else motion.scene
    distances = [CollisionModel(arm, motion.scene_in(k, scene)).minimum(row) for k, row in enumerate(q)]
    row = min(range(len(q)), key=lambda k: distances[k].distance)
    closest = distances[row]
    faults: tuple[str, ...] = ()
    if closest.pair is not None and closest.distance < -CONVERGED * arm.length:
        faults = (f"under load, {Penetration(closest.pair, -closest.distance, row)}",)
    return Sagged(off, closest.distance, row, faults)


def sag_as_data(motion: Outcome) -> dict[str, Any] | None:
    """Return where the loaded arm is in a motion as data for JSON [m]; None if that is not known."""
    sagged = motion.sagged
    if sagged is None:
        return None
    known = sagged.clearance is not None and math.isfinite(sagged.clearance)
    clear = sagged.clearance if known else None
    return {"mean_error": sagged.error, "clearance": clear, "after_steps": sagged.row}


def smallest_distance(motion: Outcome) -> Closest:
    """Return the smallest distance in a motion and its pair; without a scene, of parts of the arm."""
    if motion.scene is None:
        return _minimum_in(motion, arm_alone(motion.arm))
    row = int(motion.clearance.argmin())
    pair = CollisionModel(motion.arm, motion.scene_in(row, motion.scene)).minimum(motion.q[row]).pair
    return Closest(float(motion.clearance[row]), pair)


def _minimum_in(motion: Outcome, scene: Scene) -> Closest:
    """Return the smallest distance in a scene at the rows of a motion."""
    arm = motion.arm
    scenes = [motion.scene_in(row, scene) for row in range(len(motion.q))]
    if scenes[-1] is not scene:
        distances = [CollisionModel(arm, at).minimum(q) for at, q in zip(scenes, motion.q, strict=True)]
        return min(distances, key=lambda closest: closest.distance)
    start = motion.q[0]
    return CollisionModel(arm, scene).minimum_along(start, arm.difference(start, motion.q))


def require_no_faults(motion: Outcome, force: bool, compensate: bool) -> None:
    """Raise MotionError if a motion has faults, unless `force` is True; `compensate`: other than of sag."""
    faults = [fault for fault in motion.faults if not (compensate and fault in motion.sag_faults)]
    if faults and not force:
        raise MotionError(faults)


def ending(motion: Outcome) -> dict[str, Any]:
    """Return how a motion ended, as data for JSON."""
    told = {name: getattr(motion, name) for name in ("verdict", "status", "converged", "reason")}
    return {**told, "faults": list(motion.faults)}


def closest(motion: Outcome) -> dict[str, Any] | None:
    """Return the smallest clearance of a motion, as data for JSON.

    Returns:
        None without a scene; else "smallest" and "final" [m], the names of the closest "pair" (None if there
        is none), "after_steps", the "margin" that had to be kept [m], and "smallest" and "pair" again, both
        "to_obstacles" and "to_itself" (None if the scene has no obstacles, or self-collision is off).
    """
    scene = motion.scene
    if scene is None:
        return None
    after = int(motion.clearance.argmin())
    obstacles = _minimum_in(motion, scene.without_self_collision()) if scene.obstacles else None
    itself = _minimum_in(motion, scene.without_obstacles()) if scene.self_collision else None
    return {
        **_closest_as_data(smallest_distance(motion)),
        "final": float(motion.clearance[-1]),
        "after_steps": after,
        "margin": scene.margin,
        "to_obstacles": None if obstacles is None else _closest_as_data(obstacles),
        "to_itself": None if itself is None else _closest_as_data(itself),
    }


def holding_torque(motion: Outcome) -> dict[str, Any] | None:
    """Return the joint that is loaded most, in relation to its limit, as data for JSON; None if not known."""
    if motion.heaviest is None:
        return None
    return {**motion.heaviest.load.as_data(), "after_steps": motion.heaviest.row}


def _closest_as_data(closest: Closest) -> dict[str, Any]:
    """Return a smallest distance and its pair as data for JSON."""
    return {"smallest": closest.distance, "pair": None if closest.pair is None else list(closest.pair)}


def path_length_ratio(points: NDArray[np.float64]) -> float:
    """Return the length of the paths of all control points relative to the direct distances.

    Args:
        points: control points of a motion, (steps + 1, m, 3) [m].

    Returns:
        1 for straight lines, more for detours; 1 also if all points end where they started.
    """
    paths = float(np.linalg.norm(np.diff(points, axis=0), axis=2).sum())
    direct = float(np.linalg.norm(points[-1] - points[0], axis=1).sum())
    return max(paths / direct, 1.0) if direct > 1e-12 * paths else 1.0


# The result of a run.


class Switch(NamedTuple):
    """A change of method.

    Attributes:
        step: the first step of the new method, 0-based.
        method: name of the new method.
        reason: why the controller switched to it.
    """

    step: int
    method: str
    reason: str


@dataclass(frozen=True, eq=False)
class Run(Outcome):
    """A run: the motion of an arm towards a target posture, step by step.

    Rows of the arrays over configurations begin with the start; rows over steps with the first step.

    Attributes:
        arm: the arm that moved.
        target: the target posture.
        controller: name and parameters of the controller.
        limits: the limits of each step.
        status: how it ended, such as "converged", "stalled" or "max_steps": one of `ENDINGS`; see
            `pinposture.motion.run`.
        reason: why the run ended.
        q: configurations, (steps + 1, nq).
        points: control points, (steps + 1, m, 3) [m], world frame.
        point_errors: distance of each control point from its target, (steps + 1, m) [m]; 0 if it has none.
        active: which control points were active, (steps, m).
        clipped: which joints were clipped at a position limit, (steps, nv).
        error_increasing: whether the posture error may rise in the step, to leave a local minimum, (steps,).
        violated_constraints: messages on constraints that the step violates because not all can be met, and
            on velocity and acceleration limits that the motion exceeds, (steps,) lines; usually empty. See
            `violated_steps`.
        clearance: smallest distance to an obstacle, or between parts of the arm, (steps + 1,) [m]; negative
            in penetration, infinite without a scene.
        info: what else the controller reported, by name, with a row per step; see `Step.info`. A step that
            does not report a value has 0, False or an empty text.
        scene: the obstacles, as they were at the start; None: none.
        held: the obstacles that the arm holds on the way.
    """

    arm: Arm
    target: Target
    controller: str
    limits: Limits
    status: str
    reason: str
    q: Array
    points: Array
    point_errors: Array
    active: NDArray[np.bool_]
    clipped: NDArray[np.bool_]
    error_increasing: NDArray[np.bool_]
    violated_constraints: NDArray[np.str_]
    clearance: Array
    info: Mapping[str, NDArray[Any]] = field(default_factory=dict)
    scene: Scene | None = None
    held: tuple[HeldObject, ...] = ()

    def __post_init__(self) -> None:
        make_read_only(*vars(self).values(), *self.info.values())

    @cached_property
    def _stages(self) -> Stages:
        return Stages(self.arm, self.held, lambda row: self.q[row], len(self.q))

    def scene_in(self, row: int, scene: Scene) -> Scene:
        """Return a scene in a row, with what the arm held where it is, given that at the start."""
        return self._stages.scene(self._stages.number(row % len(self.q)), scene)

    @property
    def steps(self) -> int:
        """Number of steps taken."""
        return len(self.active)

    @cached_property
    def displacements(self) -> Array:
        """Joint displacement of each step, (steps, nv) [rad or m]."""
        return self.arm.difference(self.q[:-1], self.q[1:])

    @cached_property
    def posture_error(self) -> Array:
        """Sum of the distances of the control points from their targets, (steps + 1,) [m]."""
        return np.asarray(self.point_errors.sum(axis=1))

    @cached_property
    def mean_error(self) -> Array:
        """Mean distance of the control points with a target from it, (steps + 1,) [m]."""
        return self.posture_error / max(int(np.count_nonzero(self.target.has_target)), 1)

    @cached_property
    def distance_from_curve(self) -> float | None:
        """Largest distance of the links from the curve of the target at the end [m]; None without a curve.

        `Target.distance_from_curve` is that of the target posture.
        """
        if self.target.curve is None:
            return None
        return distance_from_curve(self.arm, self.q[-1], self.target.curve)

    @cached_property
    def path_length_ratio(self) -> float:
        """Length of the paths of all control points relative to the direct distances from start to end."""
        return path_length_ratio(self.points)

    @cached_property
    def excess(self) -> LimitViolation | None:
        """Violations of velocity, acceleration and jerk limits; None if there are none."""
        return find_limit_violation(self)

    @cached_property
    def _faults_before_end(self) -> tuple[str, ...]:
        """Clauses on violated constraints too."""
        steps = self.violated_steps.get("constraint")
        if steps is None:
            return super()._faults_before_end
        lines = str(self.violated_constraints[steps[0]]).splitlines()
        first = next(line for line in lines if line.startswith("constraint: ")).partition(": ")[2]
        others = "" if len(steps) == 1 else f", the first of {len(steps)} steps that violate constraints"
        return (
            f"{first} in step {steps[0] + 1}{others}",
            *super()._faults_before_end,
        )

    @cached_property
    def violated_steps(self) -> dict[str, NDArray[np.intp]]:
        """Steps in which each violated constraint is violated, 0-based, by its name in `CONSTRAINTS`."""
        named = [
            {line.partition(":")[0] for line in lines.splitlines()} for lines in self.violated_constraints
        ]
        steps = {name: np.flatnonzero([name in names for names in named]) for name in CONSTRAINTS}
        return {name: numbers for name, numbers in steps.items() if len(numbers)}

    @cached_property
    def active_sets(self) -> tuple[tuple[int, ...], ...]:
        """Active control set of each step, indices of control points, 0-based."""
        return tuple(tuple(int(k) for k in np.flatnonzero(row)) for row in self.active)

    @cached_property
    def switches(self) -> tuple[Switch, ...]:
        """Switches between methods of the controller; empty if it has only one."""
        reasons = self.reported("switched", "")
        methods = self.reported("method", "")
        return tuple(Switch(int(k), str(methods[k]), str(reasons[k])) for k in np.flatnonzero(reasons != ""))

    def reported(self, name: str, default: float | str) -> NDArray[Any]:
        """Return a number or text that the controller reported of each step, (steps,).

        Args:
            name: its name in `info`.
            default: what there is in each step if the controller did not report it, or something else of
                that name.

        Raises:
            InvalidValue: a name that is not text, or a default that is neither a finite number nor text.
        """
        require_instance("name", name, str, "text")
        if not (isinstance(default, str) or is_usable(default)):
            raise InvalidValue("default", default, "a finite number, or text")
        column = self.info.get(name)
        alike = column is not None and (column.dtype.kind == "U") == isinstance(default, str)
        if column is None or not alike or column.shape != (self.steps,):
            return np.full(self.steps, default)
        return column

    def summary(self) -> dict[str, Any]:
        """Return the results as JSON-compatible data [m, s].

        The start, final and lowest errors are sums over the control points.
        """
        target = self.target
        errors = self.posture_error
        points = self.active.sum(axis=1)
        timed: dict[str, float | None] = {}
        if self.limits.dt is not None:
            timed = {f"largest_{kind}": share for kind, share in largest_shares(self).items()}
            timed["duration"] = self.steps * self.limits.dt
        placed = target.has_target
        off, covered = (
            None if values is None or not placed.any() else float(values[placed].max())
            for values in (target.residual, target.parameters)
        )
        return {
            "kind": "run",
            **ending(self),
            "steps": self.steps,
            "start_error": float(errors[0]),
            "final_error": float(errors[-1]),
            "lowest_error": float(errors.min()),
            "mean_start_error": float(self.mean_error[0]),
            "mean_error": float(self.mean_error[-1]),
            "largest_error": float(self.point_errors[-1].max()),
            **timed,
            "arm_length": self.arm.length,
            "control_points": self.arm.n_modules,
            "placed_points": int(placed.sum()),
            "placed_by": target.method,
            "largest_residual": off,
            "curve_length": None if target.curve is None else target.curve.length,
            "covered_to": covered,
            "distance_from_curve": self.distance_from_curve,
            "first_active_points": int(points[0]) if len(points) else 0,
            "last_active_points": int(points[-1]) if len(points) else 0,
            "switches": [switch._asdict() for switch in self.switches],
            "path_length_ratio": self.path_length_ratio,
            "escape_share": float(self.error_increasing.mean()) if self.steps else 0.0,
            "violated_constraints": [
                {"step": int(k), "what": str(self.violated_constraints[k]).splitlines()}
                for k in np.flatnonzero(self.violated_constraints != "")
            ],
            "violated_steps": {name: steps.tolist() for name, steps in self.violated_steps.items()},
            "clearance": closest(self),
            "holding_torque": holding_torque(self),
            "sag": sag_as_data(self),
            "start_clearance": None if self.scene is None else float(self.clearance[0]),
            "incomplete": target.incomplete,
            "moved": None if target.moved is None else target.moved._asdict(),
        }

    def joint_trajectory(
        self, dt: float | None = None, force: bool = False, compensate: bool = False
    ) -> JointTrajectory:
        """Return the run as a joint trajectory for export.

        Args:
            dt: duration of a step [s]; that of the limits if None.
            force: True to return it despite its `faults`.
            compensate: True for the commands for which the loaded arm makes this run: `Arm.compensate`. They
                move more than the arm; steps take as much longer as they need to keep its limits.

        Raises:
            MotionError: it has faults.
            InvalidValue: neither `dt` nor the limits give a duration, or they differ.
            PostureError: as `Arm.compensate`.
        """
        step = step_duration(dt, self.limits.dt)
        sent = rows_to_send(self, force, compensate)
        return JointTrajectory.from_configurations(self.arm, sent.q, sent.slowdown * step)

    def __repr__(self) -> str:
        texts = [length_text(error, self.arm.length) for error in self.mean_error[[0, -1]]]
        return f"Run({self.status}, {self.steps} steps, mean point error {' -> '.join(texts)})"


class SentRows(NamedTuple):
    """What is sent to drives for a run.

    Attributes:
        q: configurations, (N, nq).
        slowdown: duration of a step relative to that of the run, at least 1.
    """

    q: Array
    slowdown: float


def rows_to_send(run: Run, force: bool, compensate: bool) -> SentRows:
    """Return what is sent to drives for a run; see `Run.joint_trajectory`.

    Raises:
        MotionError: the run has faults, without `force`.
        PostureError: as `Arm.compensate`.
    """
    require_instance("compensate", compensate, bool, "True or False")
    require_no_faults(run, force, compensate)
    if not compensate:
        return SentRows(run.q, 1.0)
    commands = run.arm.compensate(run.q)
    sent = joint_shares(replace(run, q=commands))
    planned = joint_shares(run)
    needed = [
        (share.max(initial=0.0) / max(1.0, own.max(initial=0.0))) ** (1.0 / order)
        for order, (share, own) in enumerate(zip(sent, planned, strict=True), start=1)
    ]
    return SentRows(commands, max(1.0, *map(float, needed)))


# The arrays of a run, for files and batches.

Arrays = dict[str, NDArray[Any]]

CONFIGURATION_ARRAYS = ("q", "clearance")
STEP_ARRAYS = ("active", "clipped", "error_increasing", "violated_constraints")

INFO = "info_"
"""Prefix of the names of arrays of `Run.info`."""


def run_arrays(run: Run) -> Arrays:
    """Return the arrays of a run that its arm and target do not give."""
    arrays = {name: getattr(run, name) for name in CONFIGURATION_ARRAYS + STEP_ARRAYS}
    return arrays | {f"{INFO}{name}": column for name, column in run.info.items()}


def info_of(arrays: Mapping[str, NDArray[Any]]) -> Arrays:
    """Return `Run.info` from the arrays of a run."""
    return {name.removeprefix(INFO): array for name, array in arrays.items() if name.startswith(INFO)}
