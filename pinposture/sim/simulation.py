"""The recorded motion of a simulated arm: errors, torques, summary, and file format."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture._validation import make_read_only, require_finite, require_positive
from pinposture.arm import Arm
from pinposture.collision import Scene
from pinposture.collision.bodies import frame_pose
from pinposture.errors import InvalidValue
from pinposture.motion.files import Format, check_arrays, check_postures, register
from pinposture.motion.held import HeldObject
from pinposture.motion.run import Outcome, closest, ending
from pinposture.sim.contact import ContactHistory
from pinposture.sim.model import Servos
from pinposture.units import length_text

Array = NDArray[np.float64]

# Final mean distance of the control points from their goals that counts as arrived, in arm lengths. Servos
# without integral action sag under gravity by a few thousandths.
END_TOLERANCE = 0.01


class PathDeviation(NamedTuple):
    """The largest deviation of a simulated arm from its set points, if it is too large.

    Attributes:
        row: the row with the largest mean deviation.
        mean: mean distance of the control points from their set points in it [m].
        text: a clause on the point that is farthest off.
    """

    row: int
    mean: float
    text: str


class Slip(NamedTuple):
    """How far an object slid out of the arm that was to hold it.

    Attributes:
        obstacle: its name.
        time: when it was farthest from where it was taken [s].
        distance: how far its middle then was from there, in the frame that it should move with [m].
    """

    obstacle: str
    time: float
    distance: float


@dataclass(frozen=True, eq=False)
class Simulation(Outcome):
    """The motion of a simulated arm. The first row is the start, the others are the ends of control cycles.

    Attributes:
        arm: the arm.
        loop: "open" if the servos were sent a motion, "closed" if a feedback controller drove them.
        servos: the servos.
        gravity: gravitational acceleration, (3,) [m/s^2], world frame.
        dt: duration of a control cycle [s].
        timestep: physics step [s].
        status: "converged" if the arm is at its goal at the end, "missed" if not, "unstable" if a joint ran
            away; the rows end before that. See `pinposture.motion.run`.
        reason: explanation of the status.
        commanded: configurations of the set points of the servos, (N, nq).
        q: configurations of the arm, (N, nq).
        commanded_points: control points at `commanded`, (N, m, 3) [m], world frame.
        points: control points at `q`, (N, m, 3) [m], world frame.
        torques: torques of the servos, in the order of `Arm.drives`, (N, nv) [N m or N].
        torque_limits: torque limit of each servo, (nv,) [N m or N]; infinite without a limit.
        saturated: fraction of physics steps in which each servo was saturated, (nv,).
        clearance: smallest distance of the arm to an obstacle, or between its parts, (N,) [m]; negative for
            penetration, infinite without a scene.
        targets: targets of the control points, (N, m, 3) [m], world frame; None in open loop, unless sag is
            compensated.
        weights: 1 for each control point with a target, otherwise 0, (N, m); None as `targets`.
        measured: fraction of cycles in which a measurement arrived; 1 in open loop.
        warnings: messages about corrected inertias of the description.
        scene: the obstacles, as they were at the start, or None.
        tolerance: mean distance of the control points from their goal that counts as arrived [m].
        contacts: what touched; None if contact was not simulated.
        held: the obstacles that the arm was to hold on the way.
    """

    arm: Arm
    loop: str
    servos: Servos
    gravity: Array
    dt: float
    timestep: float
    status: str
    reason: str
    commanded: Array
    q: Array
    commanded_points: Array
    points: Array
    torques: Array
    torque_limits: Array
    saturated: Array
    clearance: Array
    targets: Array | None = None
    weights: Array | None = None
    measured: float = 1.0
    warnings: tuple[str, ...] = ()
    scene: Scene | None = None
    tolerance: float = 0.0
    contacts: ContactHistory | None = None
    held: tuple[HeldObject, ...] = ()

    def __post_init__(self) -> None:
        make_read_only(*vars(self).values())

    def __repr__(self) -> str:
        return f"Simulation({self.loop} loop, {self.status}, {self.time[-1]:.4g} s, {self.arm})"

    @property
    def finished(self) -> bool:
        """True if the simulation ran to its end, whether or not the arm arrived."""
        return self.status != "unstable"

    @property
    def heaviest(self) -> None:
        """None: the torques of its servos tell more."""
        return None

    @property
    def sagged(self) -> None:
        """None: the simulated arm sags."""
        return None

    def scene_in(self, row: int, scene: Scene) -> Scene:
        """Return a scene in a row, with free obstacles where they are, given that at the start."""
        return scene if self.contacts is None else self.contacts.scene_in(row, scene)

    @cached_property
    def touched(self) -> tuple[str, ...] | None:
        """Clauses on the first contact that was not allowed, and on each object that slipped.

        None if contact was not simulated.
        """
        if self.contacts is None:
            return None
        faults = self.contacts.faults
        others = f", and {len(faults) - 1} more pairs touch" if len(faults) > 1 else ""
        allowed = self._allowed_deviation
        slipped = tuple(
            f"{slip.obstacle} slips {length_text(slip.distance)} in the arm until {slip.time:.4g} s "
            f"(allowed {length_text(allowed)})"
            for slip in self.slipped
            if slip.distance > allowed
        )
        return tuple(f"{fault}{others}" for fault in faults[:1]) + slipped

    @cached_property
    def slipped(self) -> tuple[Slip, ...]:
        """How far the objects that the arm was to hold slid in it, one for each time that it held one.

        Empty if contact was not simulated, or the motion holds nothing that is free to move.
        """
        if self.contacts is None or self.scene is None:
            return ()
        free = list(self.contacts.model.masses)
        obstacles = self.scene.obstacles
        slips = []
        for held in self.held:
            if held.obstacle in free and held.begin < len(self.q):
                middle = obstacles[held.obstacle].pose(np.zeros(3)).translation
                placed = self.contacts.displacements[:, free.index(held.obstacle)]
                slips.append(self._slip(held, middle, placed))
        return tuple(slips)

    def _slip(self, held: HeldObject, middle: Array, placed: Array) -> Slip:
        """Return how far an object slid that began in the middle, (3,) [m], and was moved, (N, 4, 4)."""
        at = []
        for row in range(held.begin, min(held.end, len(self.q))):
            frame = frame_pose(self.arm, self.q[row], held.frame)
            at.append(frame.actInv(pin.SE3(placed[row]).act(middle)))
        away = np.linalg.norm(np.array(at) - at[0], axis=1)
        farthest = int(away.argmax())
        return Slip(held.obstacle, float(self.time[held.begin + farthest]), float(away[farthest]))

    @property
    def _allowed_deviation(self) -> float:
        """Deviation from the path, and slip, that counts as none [m]."""
        # Largest mean deviation from set points, and of what the arm holds from where it was taken.
        return 5.0 * max(self.tolerance, END_TOLERANCE * self.arm.length)

    @cached_property
    def excess(self) -> PathDeviation | None:
        """The deviation from the path if the arm arrived; None up to 5 tolerances or 5 % of its length.

        The limits of the motion are not checked, because servos slightly overshoot them.
        """
        errors = self.point_errors
        if self.loop == "open" and self.target_errors is not None:
            errors = self.target_errors
        mean = errors.mean(axis=1)
        row = int(mean.argmax())
        allowed = self._allowed_deviation
        if not self.converged or mean[row] <= allowed:
            return None
        time, point = np.unravel_index(int(errors.argmax()), errors.shape)
        farthest = (
            f"{self.arm.control_points[int(point)]} was {length_text(errors[time, point])} off its path"
        )
        text = (
            f"{farthest} at {self.time[time]:.4g} s (mean of all points up to {length_text(mean[row])}, "
            f"allowed {length_text(allowed)}){describe_saturation(self.saturated)}"
        )
        return PathDeviation(row, float(mean[row]), text)

    @cached_property
    def time(self) -> Array:
        """Time of each row, (N,) [s]."""
        return np.asarray(self.dt * np.arange(len(self.q), dtype=np.float64))

    @cached_property
    def joint_error(self) -> Array:
        """Distance of each joint from its set point, (N, nv) [rad or m]."""
        return np.abs(self.arm.difference(self.commanded, self.q))

    @cached_property
    def point_errors(self) -> Array:
        """Distance of each control point from its position at the set points, (N, m) [m]."""
        return np.asarray(np.linalg.norm(self.points - self.commanded_points, axis=2))

    @cached_property
    def posture_error(self) -> Array:
        """Sum of `point_errors` over the control points, (N,) [m]."""
        return np.asarray(self.point_errors.sum(axis=1))

    @cached_property
    def target_errors(self) -> Array | None:
        """Distance of each control point from its target, (N, m) [m]; 0 without one. None in open loop."""
        if self.targets is None or self.weights is None:
            return None
        return np.where(self.weights > 0.0, np.linalg.norm(self.points - self.targets, axis=2), 0.0)

    def summary(self) -> dict[str, Any]:
        """Return the results as JSON-compatible data [rad, m, s, N m]."""
        m = self.arm.n_modules
        mean = self.posture_error / m
        largest = np.unravel_index(int(self.point_errors.argmax()), self.point_errors.shape)
        results: dict[str, Any] = {
            "kind": "simulation",
            **ending(self),
            "loop": self.loop,
            "gravity": self.gravity.tolist(),
            "duration": float(self.time[-1]),
            "cycles": len(self.q) - 1,
            "dt": self.dt,
            "timestep": self.timestep,
            "arm_length": self.arm.length,
            "servos": vars(self.servos),
            "turning_joints": self._joint_summary(~self.arm.slides, "rad"),
            "sliding_joints": self._joint_summary(self.arm.slides, "m"),
            "mean_point_error": _statistics(mean),
            "largest_point_error": {
                "value": float(self.point_errors[largest]),
                "point": self.arm.control_points[int(largest[1])],
                "time": float(self.time[largest[0]]),
            },
            "target_error": None,
            "largest_torque": self._largest_effort(True, "N m"),
            "largest_force": self._largest_effort(False, "N"),
            "largest_share_of_limit": self._largest_share(),
            "saturated_share": float(self.saturated.max(initial=0.0)),
            "saturated_joints": [self.arm.drives.names[j] for j in np.flatnonzero(self.saturated > 0.0)],
            "measured_share": self.measured,
            "clearance": closest(self),
            "contact": None if self.contacts is None else self.contacts.summary(),
            "slipped": [slip._asdict() for slip in self.slipped],
            "warnings": list(self.warnings),
        }
        if self.target_errors is not None and self.weights is not None:
            to_target = self.target_errors.sum(axis=1) / np.maximum((self.weights > 0.0).sum(axis=1), 1)
            results["target_error"] = _statistics(to_target)
        return results

    def _joint_summary(self, which: NDArray[np.bool_], unit: str) -> dict[str, Any] | None:
        """Return the errors of the selected joints; None if none are selected."""
        columns = np.flatnonzero(which)
        if not len(columns):
            return None
        errors = self.joint_error[:, columns]
        row, column = np.unravel_index(int(errors.argmax()), errors.shape)
        return {
            "unit": unit,
            "rms": _rms(errors),
            "largest": float(errors.max()),
            "joint": self.arm.joint_names[columns[int(column)]],
            "time": float(self.time[int(row)]),
            "end": float(errors[-1].max()),
        }

    def _largest_effort(self, turning: bool, unit: str) -> dict[str, Any] | None:
        """Return the largest torque of the drives that turn joints, or force of the others; None if none."""
        which = np.array([drive.turns == turning for drive in self.arm.drives])
        if not np.any(which):
            return None
        sizes = np.where(which, np.abs(self.torques), -1.0)
        row = int(sizes.max(axis=1).argmax())
        return self._effort(row, int(sizes[row].argmax()), unit)

    def _largest_share(self) -> dict[str, Any] | None:
        """Return the torque or force with the largest share of its limit; None without limits."""
        if not np.any(np.isfinite(self.torque_limits)):
            return None
        shares = np.abs(self.torques) / self.torque_limits
        row = int(shares.max(axis=1).argmax())
        column = int(shares[row].argmax())
        unit = "N m" if self.arm.drives[column].turns else "N"
        return {"share": float(shares[row, column]), **self._effort(row, column, unit)}

    def _effort(self, row: int, column: int, unit: str) -> dict[str, Any]:
        """Return the torque or force of a joint in a row."""
        limit = float(self.torque_limits[column])
        return {
            "joint": self.arm.drives.names[column],
            "value": float(self.torques[row, column]),
            "unit": unit,
            "limit": limit if np.isfinite(limit) else None,
            "time": float(self.time[row]),
        }


def describe_saturation(saturated: Array) -> str:
    """Return a clause on how many servos were saturated, given the fraction of time of each, (nv,)."""
    limited = int(np.count_nonzero(saturated))
    return f"; {limited} of {len(saturated)} servos were at their limit" if limited else ""


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _statistics(values: Array) -> dict[str, float]:
    return {"rms": _rms(values), "largest": float(values.max()), "end": float(values[-1])}


def _check(simulation: Simulation) -> None:
    """Raise InvalidValue unless the parts of a simulation fit each other."""
    arm = simulation.arm
    rows = len(simulation.q)
    m = arm.n_modules
    shapes = {
        "gravity": (3,),
        "commanded": (rows, arm.nq),
        "q": (rows, arm.nq),
        "commanded_points": (rows, m, 3),
        "points": (rows, m, 3),
        "torques": (rows, arm.nv),
        "torque_limits": (arm.nv,),
        "saturated": (arm.nv,),
        "clearance": (rows,),
        "targets": (rows, m, 3),
        "weights": (rows, m),
    }
    arrays = {name: array for name, array in vars(simulation).items() if array is not None}
    check_arrays(arrays, {name: shape for name, shape in shapes.items() if name in arrays})
    check_postures(arm, arrays)
    check_postures(arm, arrays, "commanded", "commanded_points")
    for name in ("gravity", "torques", "saturated", "targets", "weights"):
        if name in arrays:
            require_finite(name, arrays[name])
    for name in ("torque_limits", "clearance"):  # which may be infinite
        if np.isnan(arrays[name]).any():
            raise InvalidValue(name, math.nan, "numbers")
    if simulation.contacts is not None:
        _check_contacts(simulation.contacts, rows)
    if not np.all(arrays["torque_limits"] > 0.0):
        raise InvalidValue("torque_limits", float(arrays["torque_limits"].min()), "numbers > 0, or infinity")
    for name in ("dt", "timestep"):
        require_positive(name, arrays[name])
    for name in ("tolerance", "measured"):
        require_positive(name, arrays[name], zero=True)


def _check_contacts(contacts: ContactHistory, rows: int) -> None:
    """Raise InvalidValue unless the contacts of a simulation fit its number of rows."""
    count = len(contacts.pairs)
    shapes = {
        "begins": (count,),
        "speeds": (count,),
        "peaks": (count,),
        "forces": (rows, count, 3),
        "slips": (rows, count),
        "displacements": (rows, len(contacts.model.masses), 4, 4),
    }
    arrays = {name: getattr(contacts, name) for name in shapes}
    check_arrays(arrays, shapes)
    for name, array in arrays.items():
        require_finite(name, array)


register(
    Format(
        "pinposture-simulation",
        6,
        Simulation,
        "simulation",
        _check,
        {
            f"pinposture-{kind}": f"contains a {kind}, not a simulation; "
            "simulate it with: pinposture simulate FILE"
            for kind in ("run", "motion")
        },
    )
)
