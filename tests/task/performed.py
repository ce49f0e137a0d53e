"""References made by hand, and what every motion along one has to keep."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pinocchio as pin

import pinposture as pp
from pinposture.motion.trajectory import Trajectory
from pinposture.task import Reference, Waypoint

ROUNDING = 1e-9

SLIDE = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.08)
SLIDING = pp.ModuleTemplate("slide", (pp.JointSpec("y"), pp.JointSpec("z"), SLIDE), (0.05, 0.0, 0.1))
ENDLESS = pp.ModuleTemplate(
    "endless", (pp.JointSpec("z", type="continuous"), pp.JointSpec("y")), (0.05, 0.05)
)
ARMS = {
    "spatial": lambda: pp.Arm.from_template("RyRz", 5),
    "planar": lambda: pp.Arm.from_template("Rz", 7),
    "sliding": lambda: pp.Arm.from_modules([SLIDING] * 3),
    "endless": lambda: pp.Arm.from_modules([ENDLESS] * 4),
}


@cache
def arm_named(name: str) -> pp.Arm:
    return ARMS[name]()


def quintic(rows: int) -> np.ndarray:
    """From 0 to 1, at rest at both ends, (rows, 1)."""
    s = np.linspace(0.0, 1.0, rows)[:, None]
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


def drawn(arm: pp.Arm, rng: np.random.Generator, share: float = 0.4) -> np.ndarray:
    """A configuration in the middle of what the limits of the arm allow."""
    lower = np.maximum(arm.limits.lower, -2.5)
    upper = np.minimum(arm.limits.upper, 2.5)
    return arm.configuration(
        (upper + lower) / 2.0 + share * (upper - lower) / 2.0 * rng.uniform(-1, 1, arm.nv)
    )


def reference_through(
    arm: pp.Arm,
    stops: list[np.ndarray],
    seconds: float = 1.0,
    rows: int = 51,
    weights: np.ndarray | None = None,
) -> Reference:
    """From stop to stop, at rest at each, with as many seconds and rows for each piece."""
    pieces = [np.zeros((1, arm.nv))]
    waypoints = [Waypoint("stop 0", 0, pp.Target.from_configuration(arm, stops[0]))]
    for k, (before, after) in enumerate(pairwise(stops), 1):
        pieces.append(pieces[-1][-1] + quintic(rows)[1:] * pin.difference(arm.model, before, after))
        waypoints.append(Waypoint(f"stop {k}", k * (rows - 1), pp.Target.from_configuration(arm, after)))
    offsets = np.concatenate(pieces)
    asked = np.ones(arm.n_modules) if weights is None else weights
    interval = seconds / (rows - 1)
    return Reference(arm, interval, stops[0], offsets, np.tile(asked, (len(offsets), 1)), tuple(waypoints))


def random_reference(
    arm: pp.Arm, seed: int, stops: int = 3, seconds: float = 1.0, rows: int = 51, share: float = 0.4
) -> Reference:
    rng = np.random.default_rng(seed)
    return reference_through(arm, [drawn(arm, rng, share) for _ in range(stops)], seconds, rows)


def check_motion(motion: Trajectory, limits: pp.Limits, margin_from: int = 0) -> None:
    """Limits on everything that leaves, from rest to rest, and a clock that never runs ahead.

    Args:
        motion: the motion.
        limits: the limits.
        margin_from: the row from which on position limits hold.
    """
    arm = motion.arm
    dt = limits.dt
    assert np.all(np.isfinite(motion.q))
    moved = [pin.difference(arm.model, a, b) for a, b in pairwise(motion.q)]
    velocities = np.reshape(moved, (-1, arm.nv)) / dt
    np.testing.assert_allclose(motion.velocities, velocities, atol=1e-12)
    speed = arm.limits.velocity if limits.velocity is None else limits.velocity
    assert np.all(np.abs(velocities) <= speed + ROUNDING)
    if limits.step is not None:
        assert np.all(np.abs(velocities) * dt <= limits.step + ROUNDING)
    rest = np.zeros((1, arm.nv))
    accelerations = np.diff(np.concatenate([rest, velocities, rest]), axis=0) / dt
    np.testing.assert_allclose(motion.accelerations, accelerations, atol=1e-9)
    if limits.acceleration is not None:
        assert np.all(np.abs(accelerations) <= limits.acceleration + 1e-7)
    if limits.jerk is not None:
        jerks = np.diff(np.concatenate([rest, accelerations, rest]), axis=0) / dt
        assert np.all(np.abs(jerks) <= limits.jerk + 1e-5)
    positions = np.array([arm.positions(q) for q in motion.q])[margin_from:]
    assert np.all(positions >= arm.limits.lower + limits.position_margin - ROUNDING)
    assert np.all(positions <= arm.limits.upper - limits.position_margin + ROUNDING)
    check_clock(motion)


def check_clock(motion: Trajectory) -> None:
    """The clock begins at zero, never goes back, and never ahead of time; places are passed in order."""
    dt = motion.dt
    clock = motion.plan_time
    assert clock.shape == motion.time.shape == (motion.steps + 1,)
    np.testing.assert_allclose(motion.time, dt * np.arange(motion.steps + 1), rtol=1e-12)
    assert np.all(clock[: motion.start_index + 1] == 0.0) and np.all(np.diff(clock) >= 0.0)
    assert np.all(clock <= np.maximum(motion.time - motion.time[motion.start_index], 0.0) + ROUNDING)
    assert clock[-1] <= motion.planned
    reached = [place.row for place in motion.waypoints]
    came = [row for row in reached if row is not None]
    assert came == sorted(came) and reached[: len(came)] == came
    for place in motion.waypoints:
        if place.row is None:
            assert place.reached is None and place.mean_error is None
        else:
            assert place.reached == (place.row - motion.start_index) * dt
            assert place.reached >= place.planned - dt
            assert 0.0 <= place.mean_error < motion.arm.length
            assert clock[place.row] >= place.planned - dt
            assert place.row == motion.start_index or clock[place.row - 1] < place.planned


def off_the_reference(motion: Trajectory, reference: Reference) -> np.ndarray:
    """Largest distance of a control point from where the plan has it by the clock, (steps + 1,) [m].

    Between rows the plan is taken to be straight, so that rows have to be close for this to be small.
    """
    arm = motion.arm
    places = motion.plan_time / reference.interval
    found = []
    for q, place in zip(motion.q, places, strict=True):
        low = min(int(place), reference.rows - 2)
        share = place - low
        offset = (1.0 - share) * reference.offsets[low] + share * reference.offsets[low + 1]
        wanted = arm.at(pin.integrate(arm.model, reference.start, offset)).points
        found.append(np.linalg.norm(arm.at(q).points - wanted, axis=1).max())
    return np.array(found)
