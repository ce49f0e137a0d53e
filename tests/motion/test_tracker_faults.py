"""The streaming controller where things go wrong: every output finite, within limits, and explained."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.errors import InvalidValue
from pinposture.motion import Tracker
from pinposture.placement import Target

SLIDE = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.08)
SLIDING = pp.ModuleTemplate("slide", (pp.JointSpec("y"), pp.JointSpec("z"), SLIDE), (0.05, 0.0, 0.1))
ENDLESS = pp.ModuleTemplate(
    "endless", (pp.JointSpec("z", type="continuous"), pp.JointSpec("y")), (0.05, 0.05)
)
LIMITS = pp.Limits(step=None, velocity=2.0, dt=0.02, acceleration=10.0)
ROUNDING = 1e-9


@cache
def arms() -> list[pp.Arm]:
    return [
        pp.Arm.from_template("RyRz", 3),
        pp.Arm.from_template("Rz", 5),
        pp.Arm.from_modules([SLIDING] * 2),
        pp.Arm.from_modules([ENDLESS] * 2),
        pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.6, 0.8)] * 3),
    ]


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return arms()[0]


class Laboratory:
    """An arm, its tracker, and everything that goes wrong; each output is checked."""

    def __init__(self, seed: int, controller: str, interface: str, irregular: bool) -> None:
        rng = self.rng = np.random.default_rng(seed)
        self.arm = arm = arms()[rng.integers(len(arms()))]
        self.dt = dt = float(rng.choice([0.002, 0.01, 0.05]))
        acceleration = None if rng.random() < 0.3 else float(rng.choice([2.0, 10.0, 50.0])) * arm.joint_units
        velocity = float(rng.choice([0.5, 2.0, 5.0])) * arm.joint_units
        self.limits = pp.Limits(step=None, velocity=velocity, dt=dt, acceleration=acceleration)
        self.tracker = Tracker(
            arm,
            controller,
            self.limits,
            interface=interface,
            feedback_time_constant=float(rng.choice([0.05, 0.25, np.inf])),
            resync_time=float(rng.choice([0.1, np.inf])),
            timeout=float(rng.choice([0.3, np.inf])),
        )
        self.interface = interface
        self.irregular = irregular
        self.q = self.drawn()
        self.before = np.zeros(arm.nv)
        self.cycle = dt
        self.aimed = False
        self.tracker.step(self.q)  # the first measurement is believed
        self.last_command = self.tracker.command

    def drawn(self) -> np.ndarray:
        lower = np.maximum(self.arm.limits.lower, -3.0)
        upper = np.minimum(self.arm.limits.upper, 3.0)
        return self.arm.configuration(self.rng.uniform(lower, upper))

    def noise(self, size: float) -> np.ndarray:
        return size * self.rng.normal(size=self.arm.nv) * self.arm.joint_units

    def give_a_target(self) -> None:
        rng = self.rng
        arm = self.arm
        chance = self.rng.random()
        points = arm.at(self.drawn()).points
        if chance < 0.05:
            self.tracker.update(Target.from_configuration(arm, self.drawn()))
        elif chance < 0.07:
            self.tracker.update(Target.from_points(arm, rng.choice([1.0, 1.5]) * points))
        elif chance < 0.08:
            self.tracker.update(Target.from_points(arm, points, (np.arange(len(points)) > 0).astype(float)))
        else:
            return
        self.aimed = True

    def measured(self) -> np.ndarray | None:
        rng = self.rng
        arm = self.arm
        chance = self.rng.random()
        if chance < 0.03:
            return None
        measured = np.array(arm.integrate(self.q, self.noise(1e-4)))
        if chance < 0.06:
            measured[rng.integers(arm.nq)] = rng.choice([np.nan, np.inf, -np.inf])
        elif chance < 0.09:
            measured = arm.integrate(self.q, self.noise(1.0))
        return measured

    def seen(self) -> np.ndarray | None:
        if self.rng.random() > 0.2:
            return None
        points = np.array(self.arm.at(self.q).points) + 1e-3 * self.rng.normal(size=(self.arm.n_modules, 3))
        if self.rng.random() < 0.5:
            points[self.rng.integers(len(points))] = self.rng.choice([np.nan, np.inf, 1e3])
        return points

    def go_on(self) -> None:
        """A cycle, and what holds of it."""
        rng = self.rng
        arm = self.arm
        dt = self.dt
        tracker = self.tracker
        self.give_a_target()
        if rng.random() < 0.01:
            self.q = arm.integrate(self.q, self.noise(0.5))  # pushed
        fresh = rng.random() < 0.005
        if fresh:
            self.q = self.drawn()
            tracker.restart(self.q)
        late = dt
        if rng.random() < 0.05:
            late = dt * rng.choice([3.0, 0.3, 0.01, 1e-6] if self.irregular else [1.5, 3.0, 100.0])
        dq = tracker.step(self.measured(), late, self.seen())
        cycle = min(max(late, 1e-3 * dt), dt)
        self.check(dq, cycle, fresh)
        self.before = dq
        self.cycle = cycle
        self.last_command = tracker.command
        if self.interface == "velocity":
            self.q = arm.integrate(self.q, dq)
        else:
            self.q = arm.integrate(self.q, min(dt / 0.05, 1.0) * arm.difference(self.q, tracker.command))

    def check(self, dq: np.ndarray, cycle: float, fresh: bool) -> None:
        arm = self.arm
        limits = self.limits
        report = self.tracker.report
        assert dq.shape == (arm.nv,) and np.all(np.isfinite(dq))
        assert np.all(np.abs(dq) <= limits.velocity * cycle * (1.0 + ROUNDING))
        # Once a measurement elsewhere was believed, the arm begins anew, from rest.
        anew = np.abs(arm.difference(self.last_command, self.tracker.command) - dq).max() > 1e-9
        if limits.acceleration is not None and cycle == self.cycle and not fresh:
            change = np.abs(dq - self.before)
            assert np.all(change <= limits.acceleration * cycle**2 * (1.0 + 1e-7) + 1e-12)
        assert self.aimed or not np.any(dq)
        assert report.status in ("moving", "converged", "stalled", "holding")
        assert bool(report.reason) == (report.status in ("stalled", "holding"))
        if self.interface == "position" and not (anew or fresh):
            self.check_positions(dq)

    def check_positions(self, dq: np.ndarray) -> None:
        """A joint within its limits stays there, one that was measured outside goes no farther out."""
        arm = self.arm
        limits = self.limits
        before = arm.positions(self.last_command)
        after = arm.positions(self.tracker.command)
        # Braking is planned for cycles of the usual length: an odd one costs no more than one change of dq.
        most = np.zeros(arm.nv) if limits.acceleration is None else limits.acceleration * self.dt**2
        slack = ROUNDING + (most if self.irregular else 0.0)
        lower = np.minimum(arm.limits.lower, before)
        upper = np.maximum(arm.limits.upper, before)
        assert np.all(after >= lower - slack) and np.all(after <= upper + slack)


@pytest.mark.long
@pytest.mark.parametrize("irregular", [False, True])
@pytest.mark.parametrize("interface", ["position", "velocity"])
@pytest.mark.parametrize("controller", ["geodesic", "joint", "lm", "switching", "dls"])
@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_whatever_happens_outputs_keep_their_limits(controller: str, interface: str, irregular: bool) -> None:
    for seed in range(3):
        laboratory = Laboratory(seed, controller, interface, irregular)
        for _ in range(120):
            laboratory.go_on()


@pytest.mark.long
@given(st.integers(10, 100_000))
@examples(12)
@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_whatever_happens_to_the_best_of_them(seed: int) -> None:
    laboratory = Laboratory(seed, "geodesic", ["position", "velocity"][seed % 2], seed % 3 == 0)
    for _ in range(80):
        laboratory.go_on()


def moving(tracker: Tracker, steps: int = 10) -> np.ndarray:
    """Bring an arm into motion; its last step."""
    arm = tracker.arm
    tracker.update(Target.from_configuration(arm, np.linspace(0.5, 1.5, arm.nv)))
    dq = tracker.step(arm.neutral())
    for _ in range(steps):
        dq = tracker.step(tracker.command)
    assert np.abs(dq).max() > 0.015 and tracker.report.status == "moving"
    return dq


FAULTS = {
    "no measurement": (lambda q: None, "no measurement"),
    "not a number": (lambda q: np.where(np.arange(len(q)) == 2, np.nan, q), r"q_measured[2]"),
    "infinite": (lambda q: np.where(np.arange(len(q)) == 4, np.inf, q), r"q_measured[4]"),
    "elsewhere": (lambda q: q + 0.5 * (np.arange(len(q)) == 1), "m01_j2"),
}


@pytest.mark.parametrize("acceleration", [10.0, None])
@pytest.mark.parametrize("fault", FAULTS)
def test_it_brakes_in_the_fewest_cycles_and_says_why(
    arm: pp.Arm, fault: str, acceleration: float | None
) -> None:
    limits = pp.Limits(step=None, velocity=2.0, dt=0.02, acceleration=acceleration)
    tracker = Tracker(arm, "geodesic", limits, resync_time=np.inf)
    before = moving(tracker)
    spoil, reason = FAULTS[fault]
    brake = np.inf if acceleration is None else acceleration * 0.02**2
    for _ in range(20):
        dq = tracker.step(spoil(tracker.command))
        # Each joint loses as much of its step as it may, and no more.
        np.testing.assert_allclose(dq, np.sign(before) * np.maximum(np.abs(before) - brake, 0.0), atol=1e-15)
        assert tracker.report.status == "holding" and reason in tracker.report.reason
        before = dq
    assert not np.any(dq)
    assert np.any(tracker.step(tracker.command)) and tracker.report.status == "moving"


def test_a_target_that_is_too_old_counts_no_more(arm: pp.Arm) -> None:
    tracker = Tracker(arm, "geodesic", LIMITS, timeout=0.3)
    moving(tracker)
    statuses = []
    for _ in range(20):
        tracker.step(tracker.command)
        statuses.append(tracker.report.status)
    assert statuses[:3] == ["moving"] * 3 and statuses[-1] == "holding"
    assert statuses.index("holding") == pytest.approx(4, abs=1)
    assert "0.3 s" in tracker.report.reason and tracker.report.target_age > 0.3
    tracker.update(tracker.target)
    tracker.step(tracker.command)
    assert tracker.report.status == "moving" and tracker.report.target_age == pytest.approx(0.02)


def test_a_single_outlier_changes_nothing_afterwards(arm: pp.Arm) -> None:
    ends = {}
    for outlier in (False, True):
        tracker = Tracker(arm, "geodesic", LIMITS)
        target = Target.from_configuration(arm, np.linspace(-0.4, 0.4, arm.nv))
        tracker.update(target)
        q = arm.neutral()
        for k in range(300):
            measured = np.full(arm.nv, 1.5) if outlier and k == 12 else q
            tracker.step(measured)
            q = tracker.command
        ends[outlier] = q
        assert tracker.report.status == "converged"
    np.testing.assert_allclose(ends[True], ends[False], atol=1e-9)


def test_an_arm_found_elsewhere_is_believed_once_it_rests_and_goes_on_from_there(arm: pp.Arm) -> None:
    tracker = Tracker(arm, "geodesic", LIMITS, resync_time=0.3)
    moving(tracker)
    found = tracker.command + 0.6
    moved = []
    cycles = 0
    while tracker.report.status != "moving" or cycles == 0:
        moved.append(tracker.step(found))
        cycles += 1
        assert cycles < 50
    assert cycles == pytest.approx(0.3 / 0.02 + 1, abs=2)
    assert not np.any(moved[-2])  # it stood before it was believed
    np.testing.assert_allclose(tracker.command, found + moved[-1], atol=1e-12)
    assert np.abs(moved[-1]).max() <= 10.0 * 0.02**2 + 1e-12  # and begins from rest
    q = tracker.command
    for _ in range(300):
        tracker.step(q)
        q = tracker.command
    assert tracker.report.status == "converged"


def test_measurements_that_disagree_with_each_other_are_never_believed(arm: pp.Arm) -> None:
    tracker = Tracker(arm, "geodesic", LIMITS, resync_time=0.1)
    moving(tracker)
    rng = np.random.default_rng(1)
    for _ in range(60):
        tracker.step(tracker.command + rng.choice([-1.0, 1.0]) * (1.0 + rng.random(arm.nv)))
        assert tracker.report.status == "holding" and tracker.report.tracking_error >= 1.0
    at_rest = tracker.command
    tracker.step(at_rest)
    assert tracker.report.status == "moving"


def test_restart_begins_where_it_is_told_from_rest(arm: pp.Arm) -> None:
    tracker = Tracker(arm, "geodesic", LIMITS)
    moving(tracker)
    tracker.restart(np.full(arm.nv, -0.7))
    np.testing.assert_array_equal(tracker.command, np.full(arm.nv, -0.7))
    dq = tracker.step(np.full(arm.nv, -0.7))
    assert np.abs(dq).max() <= 10.0 * 0.02**2 + 1e-12 and tracker.report.status == "moving"


@pytest.mark.parametrize("dt", [0.002, 0.01, 0.05, 10.0])
def test_late_cycles_make_up_for_nothing_and_short_ones_move_less(arm: pp.Arm, dt: float) -> None:
    tracker = Tracker(arm, "geodesic", LIMITS)
    before = moving(tracker)
    dq = tracker.step(tracker.command, dt)
    cycle = min(dt, 0.02)
    assert np.all(np.abs(dq) <= 2.0 * cycle + ROUNDING)
    # Speeds change by no more than the acceleration allows in that time.
    assert np.all(np.abs(dq / cycle - before / 0.02) <= 10.0 * cycle + 1e-6)


@pytest.mark.filterwarnings("ignore:q_measured.* outside the limits")
def test_an_arm_that_was_measured_outside_its_limits_comes_back() -> None:
    arm = arms()[-1]
    tracker = Tracker(arm, "geodesic", LIMITS)
    q = arm.configuration(np.full(arm.nv, 0.75))
    q[2] = 0.95
    tracker.update(Target.from_configuration(arm, np.zeros(arm.nv)))
    for k in range(300):
        tracker.step(q)
        q = tracker.command
        assert q[2] <= 0.95 + ROUNDING
        if k == 0:
            assert tracker.report.violated_constraints
    assert tracker.report.status == "converged"


@pytest.mark.parametrize("interface", ["position", "velocity"])
def test_noise_at_a_limit_is_not_a_joint_outside_it(interface: str) -> None:
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(-1.5, 1.2)] * 3)
    limits = pp.Limits(step=None, dt=0.01, velocity=1.0, acceleration=5.0)
    tracker = pp.Tracker(arm, limits=limits, interface=interface)
    rng = np.random.default_rng(0)
    q = np.full(arm.nv, 1.2)
    for cycle in range(60):
        if cycle == 20:
            tracker.update(pp.Target.from_configuration(arm, np.full(arm.nv, 1.2)))
        dq = tracker.step(q + np.clip(2e-4 * rng.normal(size=arm.nv), -4e-4, 4e-4))
        q = q + dq if interface == "velocity" else tracker.command
        assert not tracker.report.violated_constraints
        assert np.all(tracker.positions <= 1.2 + 1e-9)


@pytest.mark.filterwarnings("ignore:q_measured")
@pytest.mark.parametrize("interface", ["position", "velocity"])
@pytest.mark.parametrize("excess", [2e-3, 0.2])
def test_a_joint_outside_its_limits_is_named_until_it_is_back(interface: str, excess: float) -> None:
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(-1.5, 1.2)] * 3)
    limits = pp.Limits(step=None, dt=0.01, velocity=1.0, acceleration=5.0)
    tracker = pp.Tracker(arm, limits=limits, interface=interface)
    q = np.zeros(arm.nv)
    q[2] = 1.2 + excess
    for cycle in range(120):
        before = q[2]
        if cycle == 5:
            tracker.update(pp.Target.from_configuration(arm, np.full(arm.nv, 0.3)))
        q = arm.integrate(q, tracker.step(q))
        named = [text for text in tracker.report.violated_constraints if arm.joint_names[2] in text]
        if q[2] > 1.201:
            assert named and named[0].startswith("position limit") and q[2] <= before + 1e-12
        elif before <= 1.2:
            assert not named
    assert q[2] < 1.0


@pytest.mark.parametrize("wrong", [None, "arm", 3])
def test_only_an_arm_can_be_tracked(wrong) -> None:
    with pytest.raises(InvalidValue, match="arm"):
        Tracker(wrong, limits=pp.Limits(velocity=1.0, acceleration=2.0, dt=0.01))
