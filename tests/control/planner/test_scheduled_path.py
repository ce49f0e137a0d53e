"""Steps along a way that was given with its time, and where the arm leaves it."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from sampling import seeds

import pinposture as pp
from pinposture import kernels
from pinposture.arm import smooth_configuration
from pinposture.control import GeodesicMemory, PathProgress
from pinposture.control.planner.objective import Objective
from pinposture.control.planner.path import JointPath, retime
from pinposture.placement import Target


def arm() -> pp.Arm:
    return template_arm("RyRz", 5)


def one() -> pp.Arm:
    return template_arm("Rz", 1)


def quintic(rows: int) -> np.ndarray:
    """From 0 to 1, at rest at both ends, (rows, 1)."""
    s = np.linspace(0.0, 1.0, rows)[:, None]
    return np.asarray(s**3 * (10.0 - 15.0 * s + 6.0 * s**2))


def path_of(arm: pp.Arm, start: np.ndarray, offsets: np.ndarray) -> JointPath:
    return JointPath(Objective(arm, Target.from_configuration(arm, start)), start, offsets)


def smooth_path(arm: pp.Arm, seed: int, rows: int) -> JointPath:
    rng = np.random.default_rng(seed)
    start, end = (smooth_configuration(arm, rng, 1.0) for _ in range(2))
    return path_of(arm, start, quintic(rows) * arm.difference(start, end))


class Ride:
    """An arm that goes along a given way: its configurations, and the progresses it was on."""

    def __init__(self, path: JointPath, limits: pp.Limits, most: float) -> None:
        self.arm, self.path, self.limits, self.controller = path.arm, path, limits, pp.Geodesic()
        self.q, self.progresses = [path.start], list[PathProgress]()
        state = self.arm.at(path.start)
        self.memory = self.controller.start(retime(path, limits, most), state.chain_state)

    def target(self, place: float) -> Target:
        q = self.arm.integrate(self.path.start, self.path.smooth_offset(place))
        return Target.from_configuration(self.arm, q)

    def step(self, limits: pp.Limits | None = None) -> PathProgress:
        limits = self.limits if limits is None else limits
        place = self.progresses[-1].s if self.progresses else 0.0
        step = self.controller.step(self.arm.at(self.q[-1]), self.target(place), limits, self.memory)
        assert not step.violated_constraints
        self.memory = step.memory
        self.q.append(self.arm.integrate(self.q[-1], step.dq))
        self.progresses.append(step.memory.progress)
        return self.progresses[-1]

    def to_the_end(self, most_steps: int = 20_000) -> Ride:
        while not self.progresses or self.progresses[-1].s < self.path.end:
            assert self.step().timed.scheduled and len(self.progresses) < most_steps
        return self

    def off_the_way(self) -> np.ndarray:
        """How far each configuration is from the way, largest joint, (steps,)."""
        wanted = [self.arm.integrate(self.path.start, self.path.smooth_offset(c.s)) for c in self.progresses]
        pairs = zip(self.q[1:], wanted, strict=True)
        return np.array([np.abs(self.arm.difference(a, b)).max() for a, b in pairs])

    def changes(self) -> np.ndarray:
        """How steps change from one to the next, from and to rest, largest joint, (steps + 1,)."""
        steps = np.diff(self.q, axis=0)
        rest = np.zeros((1, self.arm.nv))
        return np.abs(np.diff(np.concatenate([rest, steps, rest]), axis=0)).max(axis=1)


@pytest.mark.long
@pytest.mark.parametrize("acceleration", [None, 10.0])
@pytest.mark.parametrize("rows", [6, 20, 100])
def test_the_arm_keeps_to_the_curve_however_far_apart_rows_are(rows: int, acceleration: float | None) -> None:
    # Between rows far apart the curve is farther from the straight line than a step is long.
    limits = pp.Limits(step=None, velocity=1.0, dt=0.004, acceleration=acceleration)
    ride = Ride(smooth_path(arm(), 1, rows), limits, most=(rows - 1) * 0.004 / 4.0).to_the_end()
    assert ride.off_the_way().max() < 1e-12
    assert np.abs(np.diff(ride.q, axis=0)).max() <= 0.004 * (1.0 + 1e-9)
    if acceleration is not None:
        assert ride.changes().max() <= 10.0 * 0.004**2 * (1.0 + 1e-9)


@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_time_is_kept_where_limits_allow_it() -> None:
    ride = Ride(
        smooth_path(arm(), 2, 80), pp.Limits(step=None, velocity=9.0, dt=0.02, acceleration=100.0), 0.5
    )
    ride.to_the_end()
    np.testing.assert_allclose(
        [progress.s for progress in ride.progresses], 0.5 * np.arange(1, 159), atol=1e-9
    )


@pytest.mark.parametrize("seed", seeds(8))
@pytest.mark.parametrize("given", [True, False])
def test_no_joint_goes_beyond_the_end(seed: int, given: bool) -> None:
    rng = np.random.default_rng(seed)
    way = float(rng.uniform(0.1, 2.0))
    dt = 0.05
    limits = pp.Limits(step=None, velocity=1.0, dt=dt, acceleration=float(10 ** rng.uniform(-0.3, 1.3)))
    path = path_of(one(), one().neutral(), way * np.linspace(0.0, 1.0, 41)[:, None])
    ride = Ride(path, limits, most=1.3)
    if not given:  # a way of its own to the same place
        ride.memory = None
    for _ in range(400):
        place = path.end if not given or (ride.progresses and ride.progresses[-1].s >= path.end) else 0.0
        step = ride.controller.step(one().at(ride.q[-1]), ride.target(place), limits, ride.memory)
        ride.memory = step.memory
        ride.q.append(one().integrate(ride.q[-1], step.dq))
        ride.progresses.append(step.memory.progress)
    assert np.max(ride.q) <= way + 1e-9
    assert ride.q[-1][0] == pytest.approx(way, abs=1e-9)
    assert ride.changes().max() <= limits.acceleration * dt**2 * (1.0 + 1e-9)


def test_an_arm_that_is_pushed_leaves_the_way() -> None:
    ride = Ride(smooth_path(arm(), 3, 50), pp.Limits(step=None, velocity=1.0, dt=0.02, acceleration=5.0), 0.5)
    assert all(ride.step().timed.scheduled for _ in range(20))
    ride.q[-1] = arm().integrate(ride.q[-1], 0.005 * np.ones(arm().nv))
    assert ride.step().timed.scheduled  # a little is made good on the way
    for _ in range(30):
        ride.step()
    assert ride.off_the_way()[-1] < 1e-9
    ride.q[-1] = arm().integrate(ride.q[-1], 0.2 * np.ones(arm().nv))
    assert not ride.step().timed.scheduled


def test_what_is_behind_is_waited_for() -> None:
    # Two joints are held back by as much as they move in a step: the place may not run ahead of them.
    ride = Ride(smooth_path(arm(), 4, 50), pp.Limits(step=None, velocity=1.0, dt=0.02), 0.5)
    for _ in range(30):
        ride.step()
    for _ in range(4):
        place = ride.progresses[-1].s
        back = np.zeros(arm().nv)
        back[[2, 5]] = np.diff(ride.q[-2:], axis=0)[0, [2, 5]]
        ride.q[-1] = ride.q[-1] - back
        assert ride.step().timed.scheduled
        assert np.abs(np.diff(ride.q[-2:], axis=0)).max() <= 0.02 * (1.0 + 1e-9)
        assert ride.off_the_way()[-1] < 1e-9 and ride.progresses[-1].s >= place


def test_limits_that_change_change_the_pace_and_nothing_else() -> None:
    path = smooth_path(arm(), 5, 40)
    ride = Ride(path, pp.Limits(step=None, velocity=2.0, dt=0.02, acceleration=20.0), 0.4)
    for _ in range(10):
        progress = ride.step()
    tight = pp.Limits(step=None, velocity=0.2, dt=0.02, acceleration=2.0)
    other = progress.retimed(progress.path, tight)
    assert other.path is progress.path and other.s == progress.s
    assert other.timed.max_rate == progress.timed.max_rate
    tops = other.timed.profile.top, progress.timed.profile.top
    assert np.all(tops[0] <= tops[1] + 1e-12) and tops[0][20] < tops[1][20]


@pytest.mark.parametrize("speed", [0.0, 0.005, -0.01])
def test_an_arm_that_moves_along_a_new_way_is_taken_to_be_under_way(speed: float) -> None:
    path = path_of(one(), one().neutral(), np.linspace(0.0, 1.0, 51)[:, None])
    limits = pp.Limits(step=None, velocity=1.0, dt=0.02, acceleration=1.0)
    # Rows are 0.02 rad apart.
    begun = PathProgress.begin(path, limits, np.array([speed]))
    assert begun.speed == pytest.approx(max(speed, 0.0) / 0.02)
    assert PathProgress.begin(path, limits, None).speed == 0.0
    free = PathProgress.begin(path, pp.Limits(step=0.1), np.array([speed]))
    assert free.timed.profile is None
    assert free.speed == 0.0


def test_an_arm_on_its_way_is_not_stopped_by_a_new_target_ahead() -> None:
    limits = pp.Limits(step=None, velocity=1.0, dt=0.02, acceleration=5.0)
    controller = pp.Geodesic()
    q = one().neutral()
    memory = None
    steps = []
    for k in range(80):
        # From step 30 on the arm is sent farther, by a target that is another way.
        target = Target.from_configuration(one(), np.array([0.8 if k < 30 else 2.0]))
        step = controller.step(one().at(q), target, limits, memory)
        memory = step.memory
        q = one().integrate(q, step.dq)
        steps.append(float(step.dq[0]))
    assert steps[29] > 0.9 * 0.019 and min(steps[30:80]) > 0.9 * 0.019


def test_a_new_path_of_a_moving_arm_is_timed_once(monkeypatch: pytest.MonkeyPatch) -> None:
    timed: list[float] = []
    find = kernels.find_speed_profile

    def counted(
        offsets: object, slopes: object, bound: object, initial_speed: float, *others: object
    ) -> None:
        timed.append(initial_speed)
        find(offsets, slopes, bound, initial_speed, *others)

    monkeypatch.setattr(kernels, "find_speed_profile", counted)
    limits = pp.Limits(step=None, velocity=1.0, dt=0.02, acceleration=5.0)
    controller = pp.Geodesic()
    q = arm().straight()
    memory = None
    for k in range(10):
        angle = 0.3 if k < 9 else -0.9
        target = Target.from_configuration(arm(), arm().configuration(np.full(arm().nv, angle)))
        step = controller.step(arm().at(q), target, limits, memory)
        memory = step.memory
        q = arm().integrate(q, step.dq)
    first, second = timed
    assert first == 0.0 < second


def test_a_way_begins_with_what_it_was_given() -> None:
    path = smooth_path(arm(), 6, 30)
    limits = pp.Limits(step=None, velocity=1.0, dt=0.02)
    memory = pp.Geodesic().start(retime(path, limits, 0.3), arm().chain_at(path.start))
    assert isinstance(memory, GeodesicMemory) and not np.any(memory.dq)
    progress = memory.progress
    assert progress.timed.scheduled and progress.path is path and progress.s == 0.0
    assert progress.timed.max_rate == 0.3 and not retime(path, limits).scheduled
