"""Joint motion in time against closed forms, limits and Pinocchio's manifold."""

from __future__ import annotations

from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from arm.describing import LINK, X, Y, Z, arm_text
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from numpy.polynomial import Polynomial
from sampling import examples

import pinposture as pp
from pinposture.errors import InvalidValue
from pinposture.motion.joint_trajectory import JointTrajectory

MOVES = examples(40)


@pytest.fixture(scope="session")
def hinges() -> pp.Arm:
    return template_arm("RyRz", 2)


@pytest.fixture(scope="session")
def varied() -> pp.Arm:
    return pp.Arm.load(
        arm_text(
            [("continuous", Y, LINK), ("prismatic", X, LINK), ("continuous", Z, LINK), ("revolute", Y, LINK)]
        )
    )


def with_gripper(joint: pin.JointModel) -> pp.Arm:
    """An arm of two hinges with one more joint beside its tip, which moves no control point."""
    model = pin.Model()
    link = pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    first = model.addJoint(0, pin.JointModelRY(), pin.SE3.Identity(), "shoulder")
    second = model.addJoint(first, pin.JointModelRZ(), link, "elbow")
    model.addJoint(second, joint, link, "finger")
    model.addFrame(pin.Frame("tip", second, 0, link, pin.FrameType.OP_FRAME))
    return pp.Arm.from_model(model, ["tip"])


def one_joint(positions: np.ndarray, time: object) -> JointTrajectory:
    return JointTrajectory.from_positions(["j"], np.reshape(positions, (-1, 1)), time)


@pytest.mark.parametrize("spacing", ["equal", "unequal"])
def test_rates_are_exact_under_constant_acceleration(spacing: str) -> None:
    time = np.linspace(0.0, 2.0, 9)
    if spacing == "unequal":
        time = time**1.5
    path = Polynomial([0.3, -0.7, 1.1])
    found = one_joint(path(time), time)
    np.testing.assert_allclose(found.velocities[1:-1, 0], path.deriv()(time[1:-1]), atol=1e-13)
    np.testing.assert_allclose(found.accelerations[1:-1, 0], path.deriv(2)(time[1:-1]), atol=1e-12)


def test_rates_come_closer_to_an_analytic_motion_with_the_square_of_the_interval() -> None:
    """From rest to rest by the polynomial of fifth degree; its first two derivatives vanish at both ends."""
    path = 2.5 * Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
    errors = []
    for count in (41, 81):
        found = one_joint(path(np.linspace(0.0, 1.0, count)), 1.0 / (count - 1))
        velocity = np.abs(found.velocities[:, 0] - path.deriv()(found.time)).max()
        acceleration = np.abs(found.accelerations[:, 0] - path.deriv(2)(found.time)).max()
        errors.append((velocity, acceleration))
    coarse, fine = np.array(errors)
    assert np.all(fine < 0.01 * np.array([path.deriv()(0.5), 15.0]))
    np.testing.assert_allclose(coarse / fine, 4.0, rtol=0.1)


@MOVES
@given(st.lists(st.floats(-1.0, 1.0), min_size=1, max_size=30), st.floats(0.001, 10.0))
def test_rows_keep_the_limits_that_steps_keep(pushes: list[float], dt: float) -> None:
    limits_of_speed = 0.7 / dt
    limit_of_acceleration = 1.0 / dt**2
    steps = []
    step = 0.0
    for push in pushes:
        step = float(np.clip(step + push, -0.7, 0.7))
        steps.append(step)
    while step:  # to rest
        step = float(np.sign(step) * max(abs(step) - 1.0, 0.0))
        steps.append(step)
    found = one_joint(np.cumsum([0.0, *steps]), dt)
    slack = 1.0 + 1e-9
    assert np.abs(found.velocities).max() <= limits_of_speed * slack
    assert np.abs(found.accelerations).max() <= limit_of_acceleration * slack
    padded = np.array([0.0, *steps, 0.0])
    np.testing.assert_allclose(found.peaks.speeds, np.abs(steps).max() / dt, rtol=1e-9, atol=1e-12)
    expected = np.abs(np.diff(padded)).max() / dt**2
    np.testing.assert_allclose(found.peaks.accelerations, expected, rtol=1e-9, atol=1e-9 / dt**2)


def test_limits_of_a_controller_hold_on_what_is_exported(hinges: pp.Arm) -> None:
    limits = pp.Limits(step=None, velocity=0.8, acceleration=2.0, dt=0.02)
    target = pp.Target.from_configuration(hinges, [0.5, -0.3, 0.4, 0.2])
    run = pp.track(hinges, target, hinges.neutral(), limits=limits, max_steps=120)
    found = run.joint_trajectory()
    assert found.time[-1] == pytest.approx(0.02 * run.steps)
    assert np.abs(found.velocities).max() <= 0.8 + 1e-9
    assert np.abs(found.accelerations).max() <= 2.0 + 1e-9
    assert found.peaks.speeds.max() <= 0.8 + 1e-9
    assert found.peaks.speeds.max() > 0.3
    assert "4 joints" in repr(found.peaks)
    # What a run does in its last step is told as well: it may end before the arm has stopped.
    moved = np.diff(np.pad(np.diff(run.q, axis=0), ((1, 1), (0, 0))), axis=0) / 0.02**2
    np.testing.assert_allclose(found.peaks.accelerations, np.abs(moved).max(axis=0), rtol=1e-9)


def test_a_motion_begins_and_ends_at_rest_and_says_so_to_the_last_bit() -> None:
    found = one_joint(np.array([0.0, 0.1, 0.2, 0.3]), 0.1)
    for rates in (found.velocities, found.accelerations):
        assert rates[0, 0] == rates[-1, 0] == 0.0
    np.testing.assert_allclose(found.velocities[1:-1, 0], 1.0)


def test_one_row_is_a_motion_that_stands_still(hinges: pp.Arm) -> None:
    found = JointTrajectory.from_configurations(hinges, [hinges.neutral()], 0.1)
    assert (found.duration, found.time.tolist()) == (0.0, [0.0])
    assert not found.velocities.any()
    assert not found.peaks.speeds.any()
    np.testing.assert_array_equal(found.at([-1.0, 0.0, 3.0]), np.zeros((3, 4)))
    assert len(found.sampled(0.5).time) == 1


@pytest.mark.parametrize("turn", [1.9, -2.7])
def test_a_continuous_joint_that_turned_twice_ends_at_4_pi(varied: pp.Arm, turn: float) -> None:
    dq = np.array([np.sign(turn) * 4 * np.pi, 0.02, 0.0, 0.3])
    count = int(np.ceil(4 * np.pi / abs(turn)))
    q = [varied.configuration(dq * k / count) for k in range(count + 1)]
    found = JointTrajectory.from_configurations(varied, q, 0.1)
    assert found.units == ("rad", "m", "rad", "rad")
    np.testing.assert_allclose(found.positions[-1], dq, atol=1e-12)
    np.testing.assert_allclose(found.positions, np.outer(np.linspace(0, 1, count + 1), dq), atol=1e-12)
    np.testing.assert_allclose(found.velocities[1:-1], np.tile(dq / count / 0.1, (count - 1, 1)), atol=1e-11)


@pytest.mark.parametrize("turns", [(2, -3), (0, 0), (-1, 5)])
def test_a_motion_starts_at_the_turns_of_the_robot(varied: pp.Arm, turns: tuple[int, int]) -> None:
    begin = np.array([np.pi - 0.05, 0.02, -np.pi + 0.1, 0.3])
    q = [varied.configuration(begin + k * np.array([0.1, 0.0, -0.2, 0.05])) for k in range(5)]
    plain = JointTrajectory.from_configurations(varied, q, 0.1)
    robot = begin + 2.0 * np.pi * np.array([turns[0], 0, turns[1], 0]) + [0.1, 0.5, -0.2, 0.1]
    found = plain.starting_at(varied, robot)
    assert np.abs(found.positions[0] - robot)[[0, 2]].max() < 0.25
    np.testing.assert_allclose(found.configurations(varied), plain.configurations(varied), atol=1e-12)
    np.testing.assert_allclose(np.diff(found.positions, axis=0), np.diff(plain.positions, axis=0), atol=1e-12)
    np.testing.assert_array_equal(found.velocities, plain.velocities)
    with pytest.raises(InvalidValue, match=r"positions\[0\].*move there first"):
        plain.starting_at(varied, robot + [2.0, 0.0, 0.0, 0.0])


@MOVES
@given(st.integers(0, 10**6), st.integers(1, 12))
def test_motions_on_the_manifold_come_back(varied: pp.Arm, seed: int, rows: int) -> None:
    """Steps are those of `Arm.difference`, and configurations those that were there."""
    rng = np.random.default_rng(seed)
    q = [varied.random(rng)]
    for _ in range(rows - 1):
        q.append(varied.integrate(q[-1], rng.uniform(-3.0, 3.0, 4) * [1.0, 0.01, 1.0, 0.1]))
    found = JointTrajectory.from_configurations(varied, q, 0.1)
    for k in range(1, rows):
        step = found.positions[k] - found.positions[k - 1]
        np.testing.assert_allclose(step, varied.difference(q[k - 1], q[k]), atol=1e-12)
    again = found.configurations(varied)
    np.testing.assert_allclose(again, q, atol=1e-14)


def test_positions_of_hinges_and_slides_are_the_numbers_of_q(hinges: pp.Arm, varied: pp.Arm) -> None:
    rng = np.random.default_rng(3)
    q = np.array([hinges.random(rng) for _ in range(20)])
    found = JointTrajectory.from_configurations(hinges, q, np.sort(rng.uniform(0, 1, 20)))
    np.testing.assert_array_equal(found.positions, q)
    np.testing.assert_array_equal(found.configurations(hinges), q)
    rows = np.array([varied.random(rng) for _ in range(20)])
    mixed = JointTrajectory.from_configurations(varied, rows, 1.0)
    np.testing.assert_array_equal(mixed.positions[:, 1], rows[:, 2])
    np.testing.assert_array_equal(mixed.positions[:, 3], rows[:, 5])


@pytest.mark.parametrize(
    ("joint", "unit"),
    [
        (pin.JointModelPX(), "m"),
        (pin.JointModelPrismaticUnaligned(np.array([1.0, 1.0, 0.0]) / np.sqrt(2)), "m"),
        (pin.JointModelRX(), "rad"),
        (pin.JointModelRUBX(), "rad"),
        (pin.JointModelRevoluteUnaligned(np.array([1.0, 1.0, 0.0]) / np.sqrt(2)), "rad"),
    ],
    ids=lambda value: value if isinstance(value, str) else value.shortname(),
)
def test_joints_off_the_chain_move_too(joint: pin.JointModel, unit: str) -> None:
    arm = with_gripper(joint)
    q = [arm.configuration([0.1 * k, 0.0, 2.0 * k]) for k in range(4)]
    found = JointTrajectory.from_configurations(arm, q, 1.0)
    assert found.joint_names == ("shoulder", "elbow", "finger")
    assert found.units == ("rad", "rad", unit)
    np.testing.assert_allclose(found.positions[:, 2], [0.0, 2.0, 4.0, 6.0], atol=1e-12)


def test_a_joint_whose_name_would_stand_for_several_numbers_is_refused() -> None:
    arm = with_gripper(pin.JointModelFreeFlyer())
    with pytest.raises(InvalidValue, match="joint 'finger' is 'JointModelFreeFlyer'"):
        JointTrajectory.from_configurations(arm, [arm.neutral()], 0.1)


@MOVES
@given(st.permutations(range(4)), st.integers(0, 10**6))
def test_joints_are_matched_by_name(varied: pp.Arm, order: list[int], seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = [varied.random(rng) for _ in range(5)]
    plain = JointTrajectory.from_configurations(varied, q, 0.1)
    mixed = JointTrajectory(
        [plain.joint_names[k] for k in order],
        plain.time,
        plain.positions[:, order],
        plain.velocities[:, order],
        plain.accelerations[:, order],
    )
    matched = mixed.matched(varied)
    assert (matched.joint_names, matched.units) == (plain.joint_names, plain.units)
    for name in ("time", "positions", "velocities", "accelerations"):
        np.testing.assert_array_equal(getattr(matched, name), getattr(plain, name))
    np.testing.assert_allclose(mixed.configurations(varied), q, atol=1e-14)


def test_joints_that_do_not_fit_are_named(hinges: pp.Arm) -> None:
    found = JointTrajectory.from_positions(["m01_j1_y", "m01_j2_z", "gripper"], np.zeros((2, 3)), 0.1)
    with pytest.raises(InvalidValue, match="missing: 'm02_j1_y', 'm02_j2_z'; unknown: 'gripper'"):
        found.configurations(hinges)
    slides = JointTrajectory.from_positions(hinges.joint_names, np.zeros((2, 4)), 0.1, ["rad", "m", "", ""])
    with pytest.raises(InvalidValue, match="unit of joint 'm01_j2_z' is 'm'; allowed: 'rad'"):
        slides.matched(hinges)


@MOVES
@given(st.integers(0, 10**6))
def test_a_cubic_motion_is_met_between_rows(seed: int) -> None:
    rng = np.random.default_rng(seed)
    paths = [Polynomial(rng.normal(size=4)) for _ in range(3)]
    time = np.cumsum(rng.uniform(0.05, 1.0, 6))

    def told(derivative: int, moments: np.ndarray) -> np.ndarray:
        return np.transpose(
            [path.deriv(derivative)(moments) if derivative else path(moments) for path in paths]
        )

    motion = JointTrajectory(list("abc"), time, told(0, time), told(1, time), told(2, time))
    moments = rng.uniform(time[0], time[-1], 20)
    np.testing.assert_allclose(motion.at(moments), told(0, moments), rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(motion.at(moments[0]), told(0, moments)[0], rtol=1e-9, atol=1e-9)
    np.testing.assert_array_equal(motion.at(time), motion.positions)
    np.testing.assert_array_equal(motion.at([-1.0, time[-1] + 1.0]), motion.positions[[0, -1]])


@pytest.mark.parametrize(("dt", "count"), [(0.1, 11), (0.05, 21), (0.3, 5), (2.0, 2)])
def test_sampled_anew_the_motion_is_the_same_and_ends_where_it_ended(dt: float, count: int) -> None:
    path = Polynomial([0.0, 0.0, 0.0, 10.0, -15.0, 6.0])
    time = np.linspace(0.0, 1.0, 101)
    motion = JointTrajectory.from_positions(["j"], path(time)[:, None], time + 3.0, ["m"], "robot")
    found = motion.sampled(dt)
    np.testing.assert_allclose(found.time, 3.0 + dt * np.arange(count))
    np.testing.assert_allclose(found.positions[:, 0], path(np.clip(found.time - 3.0, 0, 1)), atol=1e-6)
    np.testing.assert_allclose(found.positions[-1], motion.positions[-1], atol=1e-12)
    assert (found.units, found.name) == (("m",), "robot")


def test_rounding_adds_no_row_to_a_motion_that_is_a_multiple_of_the_interval_long() -> None:
    motion = one_joint(np.zeros(2), 2.1)
    assert motion.duration / 0.3 > 7.0
    assert len(motion.sampled(0.3).time) == 8


def test_between_rows_a_cubic_exceeds_limits_by_no_more_than_the_page_says() -> None:
    """Every course of accelerations at the limit over six cycles; docs/trajectories.md has these figures."""
    dt = 0.1
    limit = 2.0
    share = np.linspace(0.0, 1.0, 41)
    fast = hard = 0.0
    for signs in product((-1.0, 0.0, 1.0), repeat=6):
        steps = np.cumsum(np.array(signs) * limit * dt**2)
        motion = one_joint(np.cumsum([0.0, 0.0, *steps, steps[-1]]), dt)
        moments = np.concatenate([motion.time[k] + dt * share for k in range(1, 6)])
        course = motion.at(moments)[:, 0].reshape(5, -1)
        inner = dt * (share[1] - share[0])
        fast = max(fast, np.abs(np.diff(course, axis=1)).max() / inner - np.abs(steps).max() / dt)
        hard = max(hard, np.abs(np.diff(course, n=2, axis=1)).max() / inner**2)
    assert 0.9 * limit * dt / 4 < fast <= limit * dt / 4 + 1e-9
    assert 2.8 * limit < hard <= 3.0 * limit + 1e-6


@pytest.mark.parametrize(
    ("known", "given_", "expected"), [(0.02, None, 0.02), (None, 0.5, 0.5), (0.02, 0.02, 0.02)]
)
def test_steps_of_a_run_take_what_its_limits_say_or_what_is_given(
    hinges: pp.Arm, known, given_, expected
) -> None:
    run = short_run(hinges, known)
    found = run.joint_trajectory(given_, force=True)
    assert found.time.tolist() == [0.0, expected, 2 * expected]


@pytest.mark.parametrize(
    ("known", "given_", "message"),
    [
        (None, None, "dt is not given; allowed: the duration of a step"),
        (0.02, 0.03, "dt is 0.03; allowed: 0.02 s, from the limits of this run, or None"),
        (None, 0.0, "dt is 0.0"),
        (None, "x", "dt is 'x'"),
        (0.02, float("nan"), "dt is nan"),
    ],
)
def test_a_duration_that_is_missing_or_contradicts_is_refused(
    hinges: pp.Arm, known, given_, message: str
) -> None:
    with pytest.raises(InvalidValue, match=message):
        short_run(hinges, known).joint_trajectory(given_)


def short_run(hinges: pp.Arm, dt: float | None) -> pp.Run:
    target = pp.Target.from_configuration(hinges, np.full(4, 0.5))
    return pp.track(hinges, target, hinges.neutral(), limits=pp.Limits(dt=dt), max_steps=2)


PLAIN = {
    "joint_names": ["a", "b"],
    "time": [0.0, 1.0],
    "positions": np.zeros((2, 2)),
    "velocities": np.zeros((2, 2)),
    "accelerations": np.zeros((2, 2)),
}


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"joint_names": []}, "joint_names is"),
        ({"joint_names": "ab"}, "joint_names is 'ab'; allowed: a list"),
        (
            {"joint_names": ["a", "a"]},
            r"joint_names\[1\] is 'a'; allowed: a unique name; joint 0 has the same",
        ),
        ({"joint_names": ["a", ""]}, r"joint_names\[1\]"),
        ({"joint_names": ["a", 3]}, r"joint_names\[1\] is 3"),
        ({"joint_names": ["a", "b\n"]}, r"joint_names\[1\]"),
        ({"joint_names": [" a", "b"]}, r"joint_names\[0\]"),
        ({"joint_names": ["a", "b", "c"]}, r"positions \(shape\)"),
        ({"time": []}, "time is"),
        ({"time": 1.0}, "time is 1.0"),
        ({"time": [0.0, 0.0]}, r"time\[1\] is 0.0; allowed: more than time\[0\], 0.0 s"),
        ({"time": [1.0, 0.0]}, r"time\[1\]"),
        ({"time": [-1.0, 0.0]}, r"time\[0\] is -1.0; allowed: 0 or later"),
        ({"time": [0.0, np.nan]}, r"time\[1\] is nan"),
        ({"time": [0.0, 1.0, 2.0]}, r"positions \(shape\)"),
        ({"positions": np.array([[0.0, 1.0], [np.inf, 0.0]])}, r"positions\[1, 0\] is inf"),
        ({"positions": [["x", 1.0], [0.0, 0.0]]}, "positions is"),
        ({"velocities": np.zeros((2, 1))}, r"velocities \(shape\)"),
        ({"accelerations": np.full((2, 2), np.nan)}, r"accelerations\[0, 0\] is nan"),
        ({"units": ["rad"]}, "units"),
        ({"units": ["rad", "deg"]}, "units"),
    ],
)
def test_what_is_no_motion_is_refused(change: dict, message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        JointTrajectory(**(PLAIN | change))


@pytest.mark.parametrize(
    ("q", "time", "message"),
    [
        (np.zeros(4), 0.1, r"q \(shape\)"),
        (np.zeros((0, 4)), 0.1, r"q \(shape\)"),
        (np.zeros((2, 3)), 0.1, r"q \(shape\)"),
        ("x", 0.1, "q is 'x'"),
        ([[0, 0, 0, 0], [0, np.nan, 0, 0]], 0.1, r"q\[1, 1\] is nan"),
        (np.zeros((2, 4)), 0.0, "time is 0.0"),
        (np.zeros((2, 4)), True, "time"),
        (np.zeros((2, 4)), [0.0], r"positions \(shape\)"),
        ([[0, 0, 0, 0], [0, 1e8, 0, 0], [0, 0, 0, 0]], 1e-300, "time is 1e-300"),
        ([[0, 0, 0, 0], [0, 1e10, 0, 0], [0, 0, 0, 0]], 0.1, r"q\[1\]\[1\] is 10000000000"),
    ],
)
def test_configurations_that_are_none_are_refused(
    hinges: pp.Arm, q: object, time: object, message: str
) -> None:
    with pytest.raises(InvalidValue, match=message):
        JointTrajectory.from_configurations(hinges, q, time)


def test_a_continuous_joint_needs_a_rotation(varied: pp.Arm) -> None:
    q = np.array([varied.neutral(), np.zeros(varied.nq)])
    with pytest.raises(InvalidValue, match=r"q\[1\]"):
        JointTrajectory.from_configurations(varied, q, 0.1)


@pytest.mark.parametrize("positions", [[[0.0], [0.0, 1.0]], 3.0, []])
def test_positions_that_are_no_table_are_refused(positions: object) -> None:
    with pytest.raises(InvalidValue, match="positions"):
        JointTrajectory.from_positions(["a"], positions, 0.1)


@pytest.mark.parametrize("times", [np.nan, [[0.0]], "x", [0.0, np.inf]])
def test_moments_that_are_none_are_refused(times: object) -> None:
    with pytest.raises(InvalidValue, match="times"):
        JointTrajectory(**PLAIN).at(times)


def test_a_motion_cannot_be_changed_from_outside() -> None:
    positions = np.zeros((2, 2))
    motion = JointTrajectory(**(PLAIN | {"positions": positions}))
    positions[0, 0] = 1.0
    assert motion.positions[0, 0] == 0.0
    for name in ("time", "positions", "velocities", "accelerations"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(motion, name)[0] = 1.0


def test_without_coupled_joints_there_are_none_to_append() -> None:
    arm = template_arm("RyRz", 3)
    motion = pp.JointTrajectory.from_configurations(arm, [np.zeros(6), np.full(6, 0.1)], 0.1)
    assert motion.with_coupled(arm).joint_names == motion.joint_names


@pytest.mark.parametrize("name", ["driven", "with_coupled", "matched"])
def test_joints_are_matched_with_those_of_an_arm_alone(name: str) -> None:
    motion = pp.JointTrajectory.from_configurations(template_arm("RyRz", 3), np.zeros((2, 6)), 0.1)
    with pytest.raises(InvalidValue, match="arm"):
        getattr(motion, name)("arm")
