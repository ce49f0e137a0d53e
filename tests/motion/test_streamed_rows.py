"""Targets given anew in each cycle, one cycle ahead, as the rows of a motion: followed without lag."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pytest
from scipy.interpolate import CubicSpline

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.errors import InvalidValue

DT = 0.01
SPEED = 1.0
ACCELERATION = 5.0
SHARE = 0.84
LIMITS = pp.Limits(step=None, velocity=SPEED, acceleration=ACCELERATION, dt=DT)


def arm_of(modules: int = 8) -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules, (0.5 / modules, 0.5 / modules))


class Rows(NamedTuple):
    q: np.ndarray  # joint positions at the end of each cycle, (k, n)
    velocities: np.ndarray  # (k, n)


def motion(arm: pp.Arm, seed: int) -> Rows:
    """A motion from rest to rest at a share of the limits, on a spline through four postures."""
    rng = np.random.default_rng(seed)
    postures = np.array([smooth_configuration(arm, rng, 0.8) for _ in range(4)])
    spline = CubicSpline(np.linspace(0.0, 1.0, 4), postures, bc_type="clamped")
    places = np.linspace(0.0, 1.0, 2001)
    fastest = np.abs(spline(places, 1)).max()
    hardest = np.abs(spline(places, 2)).max()
    duration = max(fastest / (SHARE * SPEED), np.sqrt(hardest / (SHARE * ACCELERATION)))
    shares = np.arange(int(np.ceil(duration / DT)) + 1) * DT / duration
    ended = shares >= 1.0
    return Rows(spline(np.minimum(shares, 1.0)), np.where(ended[:, None], 0.0, spline(shares, 1) / duration))


def streamed(
    arm: pp.Arm, rows: Rows, kind: str, start: np.ndarray, more: int = 0
) -> tuple[np.ndarray, np.ndarray, str]:
    """Joint positions, distances of the control points from the targets, and the status at the end."""
    tracker = pp.Tracker(arm, limits=LIMITS)
    tracker.restart(start)
    q = [start]
    missed = []
    for k in [*range(1, len(rows.q)), *[len(rows.q) - 1] * more]:
        target = pp.Target.from_configuration(arm, rows.q[k])
        if kind == "points":
            target = pp.Target.from_points(arm, target.points)
        tracker.update(target, rows.velocities[k] if kind == "velocity" else None)
        q.append(q[-1] + tracker.step(q[-1]))
        missed.append(np.linalg.norm(arm.at(q[-1]).points - target.points, axis=1).max())
    return np.array(q), np.array(missed), tracker.report.status


def assert_within_limits(q: np.ndarray) -> None:
    speeds = np.diff(q, axis=0) / DT
    changes = np.diff(np.concatenate([np.zeros((1, q.shape[1])), speeds]), axis=0) / DT
    assert np.abs(speeds).max() <= SPEED * (1.0 + 1e-9)
    assert np.abs(changes).max() <= ACCELERATION * (1.0 + 1e-9)


@pytest.mark.long
@pytest.mark.parametrize("kind", ["configuration", "velocity", "points"])
@pytest.mark.parametrize("seed", range(2))
def test_rows_are_followed_exactly(kind: str, seed: int) -> None:
    arm = arm_of()
    rows = motion(arm, seed)
    q, missed, status = streamed(arm, rows, kind, rows.q[0], more=2)
    assert_within_limits(q)
    assert missed.max() < 1e-6 * arm.length
    assert status == "converged"


@pytest.mark.long
@pytest.mark.parametrize("kind", ["configuration", "velocity"])
def test_an_arm_that_begins_beside_the_motion_catches_up(kind: str) -> None:
    arm = arm_of()
    rows = motion(arm, 3)
    q, missed, _ = streamed(arm, rows, kind, rows.q[0] + 0.2)
    assert_within_limits(q)
    assert missed[0] > 1e-2
    assert missed[-20:].max() < 1e-6 * arm.length


@pytest.mark.long
@pytest.mark.parametrize("kind", ["configuration", "velocity"])
def test_after_a_target_that_stops_at_once_the_arm_brakes_and_comes_back(kind: str) -> None:
    arm = arm_of()
    rows = motion(arm, 1)
    half = int(np.abs(rows.velocities).max(axis=1).argmax()) + 1
    stopped = Rows(rows.q[:half], rows.velocities[:half])
    q, _, _ = streamed(arm, stopped, kind, rows.q[0])
    tracker = pp.Tracker(arm, limits=LIMITS)
    tracker.restart(q[-1], q[-1] - q[-2])
    tracker.update(pp.Target.from_configuration(arm, q[-1]))
    after = [q[-2], q[-1]]
    for _ in range(200):
        after.append(after[-1] + tracker.step(after[-1]))
    steps = np.diff(np.array(after), axis=0) / DT
    assert np.abs(np.diff(steps, axis=0) / DT).max() <= ACCELERATION * (1.0 + 1e-9)
    assert np.abs(after[-1] - rows.q[half - 1]).max() < 1e-6
    assert tracker.report.status == "converged"


@pytest.mark.long
def test_a_configuration_that_does_not_take_the_points_is_not_gone_to() -> None:
    arm = arm_of()
    rows = motion(arm, 2).q[:60]
    tracker = pp.Tracker(arm, limits=LIMITS)
    q = rows[0]
    tracker.restart(q)
    for row in [*rows[1:], *[rows[-1]] * 200]:
        points = arm.at(row).points
        tracker.update(pp.Target(points, np.ones(arm.n_modules), q=row + 0.05))
        q = q + tracker.step(q)
    assert np.linalg.norm(arm.at(q).points - points, axis=1).max() < 1e-5 * arm.length


def test_a_velocity_is_checked() -> None:
    arm = arm_of(3)
    tracker = pp.Tracker(arm, limits=LIMITS)
    known = pp.Target.from_configuration(arm, arm.straight())
    for velocity in (np.zeros(arm.nv - 1), np.full(arm.nv, np.nan)):
        with pytest.raises(InvalidValue, match="velocity"):
            tracker.update(known, velocity)
    far = pp.Target.from_points(arm, known.points + 1.0)
    with pytest.raises(InvalidValue, match="velocity"):
        tracker.update(far, np.zeros(arm.nv))
    assert tracker.target is None
