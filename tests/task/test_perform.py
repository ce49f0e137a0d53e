"""Performing a motion in time with the controller that looks ahead."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from among_obstacles import check_output, drawn_course
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from performed import (
    ARMS,
    arm_named,
    check_clock,
    check_motion,
    drawn,
    off_the_reference,
    random_reference,
    reference_through,
)
from sampling import cases, examples

import pinposture as pp
from pinposture.errors import InvalidValue, UnknownName
from pinposture.task import Reference, perform

USUAL = {"step": None, "velocity": 2.0, "dt": 0.02, "acceleration": 15.0}


def limits_of(arm: pp.Arm, **given: object) -> pp.Limits:
    """Speeds in radians, and as many units of joints that slide."""
    values = {**USUAL, **given}
    scaled = {
        name: None if values[name] is None else values[name] * arm.joint_units
        for name in ("velocity", "acceleration")
    }
    return pp.Limits(**{**values, **scaled})


@pytest.mark.parametrize("acceleration", [None, 15.0])
@pytest.mark.parametrize("name", ARMS)
def test_a_feasible_reference_is_followed_exactly_and_in_time(name: str, acceleration: float | None) -> None:
    arm = arm_named(name)
    reference = random_reference(arm, 1, seconds=6.0, rows=301)
    limits = limits_of(arm, acceleration=acceleration)
    motion = perform(reference, "geodesic", limits)
    check_motion(motion, limits)
    assert motion.converged and motion.run.status == "converged" and not motion.deviations
    assert motion.time_scale == pytest.approx(1.0, abs=1e-9) and motion.start_index == 0
    assert motion.duration == pytest.approx(12.0) == motion.planned
    assert motion.mean_error.max() < 1e-9 * arm.length
    assert off_the_reference(motion, reference).max() < 1e-9 * arm.length
    assert [place.row for place in motion.waypoints] == [0, 300, 600]
    np.testing.assert_allclose(motion.targets[300], reference.waypoints[1].target.points, atol=1e-12)
    assert "2 waypoints" not in repr(motion) and "3 waypoints" in repr(motion)
    assert "as long" not in repr(motion)


@pytest.mark.parametrize("name", ARMS)
def test_a_reference_ten_times_too_fast_is_slowed(name: str) -> None:
    arm = arm_named(name)
    reference = random_reference(arm, 2, seconds=0.15, rows=60)
    limits = limits_of(arm)
    motion = perform(reference, "geodesic", limits)
    check_motion(motion, limits)
    assert motion.converged and not motion.deviations
    # What it takes at least: the largest turn at full speed, and to reach and to leave that speed.
    bound = limits.velocity
    brake = limits.acceleration
    turns = (
        np.abs(reference.offsets[59] - reference.offsets[0]),
        np.abs(np.diff(reference.offsets[[59, -1]], axis=0)[0]),
    )
    long = [
        np.where(w > bound**2 / brake, w / bound + bound / brake, 2 * np.sqrt(w / brake)).max() for w in turns
    ]
    assert sum(long) < motion.duration < 2.2 * sum(long)
    assert motion.time_scale == pytest.approx(motion.duration / 0.3) and motion.time_scale > 3.0
    assert motion.mean_error.max() < 1e-6 * arm.length
    assert off_the_reference(motion, reference).max() < 5e-3 * arm.length
    assert f"{motion.time_scale:.3g} times as long as the 0.3 s planned: joint m" in repr(motion)


@pytest.mark.long
@given(st.integers(0, 10_000))
@examples(20)
@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_limits_hold_for_any_reference_and_any_cycle(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = arm_named(list(ARMS)[rng.integers(len(ARMS))])
    stops = [drawn(arm, rng, rng.choice([0.1, 0.5, 0.95])) for _ in range(rng.integers(2, 4))]
    weights = (rng.random(arm.n_modules) < 0.7).astype(float)
    weights[-1] = 1.0
    rows = int(rng.integers(6, 60))
    reference = reference_through(arm, stops, float(10 ** rng.uniform(-1, 0.3)), rows, weights)
    limits = limits_of(
        arm,
        velocity=float(10 ** rng.uniform(-0.2, 0.7)),
        dt=float(rng.choice([0.005, 0.013, 0.05])),
        acceleration=None if rng.random() < 0.3 else float(10 ** rng.uniform(0.0, 1.7)),
        step=None if rng.random() < 0.6 else float(rng.uniform(0.01, 0.2)),
        position_margin=0.0 if rng.random() < 0.7 else 1e-3,
    )
    motion = perform(reference, "geodesic", limits)
    check_motion(motion, limits)
    assert motion.converged and not motion.deviations
    assert motion.mean_error.max() < 2e-3 * arm.length and motion.mean_error[-1] < 1e-6 * arm.length


@pytest.mark.long
@pytest.mark.parametrize("dt", [0.002, 0.05])
def test_rows_may_be_far_apart_or_close_compared_to_cycles(dt: float) -> None:
    arm = arm_named("spatial")
    for rows in (5, 400):
        limits = limits_of(arm, dt=dt, velocity=1.0)
        motion = perform(random_reference(arm, 3, stops=2, seconds=2.0, rows=rows), "geodesic", limits)
        check_motion(motion, limits)
        assert motion.converged and not motion.deviations and motion.mean_error.max() < 1e-5 * arm.length


@pytest.mark.long
@pytest.mark.parametrize("name", ARMS)
@pytest.mark.parametrize("dt", [0.005, 0.05])
def test_an_arm_that_is_elsewhere_comes_to_the_first_posture_first(name: str, dt: float) -> None:
    arm = arm_named(name)
    reference = random_reference(arm, 4, seconds=3.0)
    limits = limits_of(arm, dt=dt, velocity=1.0)
    q0 = drawn(arm, np.random.default_rng(5))
    motion = perform(reference, "geodesic", limits, q0=q0)
    check_motion(motion, limits)
    np.testing.assert_array_equal(motion.q[0], q0)
    assert motion.converged and motion.start_index > 0
    # It is there, and at rest, when it sets out.
    assert motion.mean_error[motion.start_index] <= 1.001e-6 * arm.length
    assert np.abs(motion.velocities[motion.start_index - 1]).max() <= 15.0 * dt + 1e-9
    assert motion.waypoints[0].row == motion.start_index and motion.waypoints[0].reached == 0.0
    np.testing.assert_allclose(
        motion.targets[: motion.start_index + 1], motion.targets[:1].repeat(motion.start_index + 1, 0)
    )
    assert motion.mean_error[motion.start_index :].max() < 2e-6 * arm.length


@pytest.mark.long
def test_coming_to_the_first_posture_slowly_uses_up_no_patience_for_the_rest() -> None:
    # At a tenth of a degree per cycle that takes thousands of cycles, the motion itself few.
    arm = arm_named("planar")
    start = arm.configuration(np.full(arm.nv, 0.8))
    reference = reference_through(arm, [start, arm.configuration(np.full(arm.nv, 0.81))], 0.05, 11)
    motion = perform(
        reference, "geodesic", pp.Limits(step=4.5e-4, dt=0.01), q0=arm.configuration(np.full(arm.nv, -0.8))
    )
    assert motion.run.status == "converged" and motion.start_index > 3000


@pytest.mark.long
def test_another_limit_in_force_gives_another_time() -> None:
    arm = arm_named("spatial")
    reference = random_reference(arm, 6, seconds=0.5)
    given = [
        pp.Limits(step=None, velocity=2.0, dt=0.02, acceleration=20.0),
        pp.Limits(step=0.02, velocity=2.0, dt=0.02, acceleration=20.0),
        pp.Limits(step=np.linspace(0.002, 0.02, arm.nv), velocity=2.0, dt=0.02, acceleration=20.0),
        pp.Limits(
            step=np.linspace(0.002, 0.02, arm.nv),
            velocity=2.0,
            dt=0.02,
            acceleration=np.linspace(0.2, 2.0, arm.nv),
        ),
    ]
    motions = [perform(reference, "geodesic", limits) for limits in given]
    for motion, limits in zip(motions, given, strict=True):
        check_motion(motion, limits)
        assert motion.converged and not motion.deviations
    durations = [motion.duration for motion in motions]
    assert durations[0] < durations[1] < durations[2] < 1.005 * durations[3]


def test_a_reference_beyond_the_margin_is_followed_as_far_as_the_margin() -> None:
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.8, 0.8)] * 4)
    ends = [arm.configuration(np.full(arm.nv, 0.3)), arm.configuration(np.full(arm.nv, 0.79))]
    limits = pp.Limits(step=None, velocity=1.0, dt=0.01, acceleration=10.0, position_margin=0.05)
    motion = perform(reference_through(arm, ends, 2.0, 101), "geodesic", limits)
    check_motion(motion, limits)
    assert motion.run.status == "missed" and not motion.deviations
    assert [place.missed for place in motion.waypoints] == [False, True]
    np.testing.assert_allclose(arm.positions(motion.q[-1]), 0.75, atol=1e-6)
    assert motion.time_scale < 1.2
    # And one that begins there: the arm comes within first.
    motion = perform(reference_through(arm, ends[::-1], 2.0, 101), "geodesic", limits)
    check_motion(motion, limits, margin_from=motion.start_index)
    assert motion.run.status == "missed" and motion.start_index > 0 and not motion.deviations
    assert [place.missed for place in motion.waypoints] == [True, False]


def test_joints_that_move_nothing_stand_still() -> None:
    # A joint beside the chain, the first in the tangent space.
    chain = pp.Arm.from_template("RyRz", 4)
    model = pin.Model()
    side = model.addJoint(0, pin.JointModelRZ(), pin.SE3.Identity(), "a side joint")
    model.appendBodyToJoint(side, pin.Inertia.Random(), pin.SE3.Identity())
    joined = pin.appendModel(model, chain.model, 0, pin.SE3.Identity())
    joined = joined[0] if isinstance(joined, tuple) else joined
    arm = pp.Arm.from_model(joined, list(chain.control_points))
    rng = np.random.default_rng(7)
    reference = reference_through(arm, [rng.uniform(-1, 1, arm.nv) for _ in range(3)], 0.2, 31)
    limits = pp.Limits(step=None, velocity=1.5, dt=0.02, acceleration=10.0)
    motion = perform(reference, "geodesic", limits)
    check_motion(motion, limits)
    still = arm.moved == 0.0
    assert np.any(still) and not np.any(motion.velocities[:, still])
    assert motion.converged and not motion.deviations


SWING = pp.Limits(step=None, velocity=1.5, dt=0.05, acceleration=8.0)


def swing(seconds: float = 6.0) -> Reference:
    """A straight planar arm that turns from one side of a ball to the other, then bends."""
    ends = [[0.0] * 4, [1.3, 0.0, 0.0, 0.0], [1.3, 0.1, 0.1, 0.1]]
    arm = template_arm("Rz", 4)
    return reference_through(arm, [arm.configuration(end) for end in ends], seconds, 121)


def ball() -> pp.Scene:
    """In its way."""
    return pp.Scene({"ball": pp.Sphere((0.36, 0.3, 0.0), 0.024)}, arm_radius=0.006)


@pytest.mark.long
def test_an_obstacle_in_the_way_is_gone_round() -> None:
    reference = swing()
    scene = ball()
    motion = perform(reference, "geodesic", SWING, scene)
    assert motion.run.clearance.min() > 0.0 and motion.run.scene is scene
    check_motion(motion, SWING)
    assert motion.converged and len(motion.deviations) == 1
    assert "left the path" in motion.deviations[0] and "stop 1" in motion.deviations[0]
    assert motion.mean_error[motion.waypoints[1].row] < 1e-6 and motion.mean_error[-1] < 1e-6
    # The rest goes as planned, from when it was there.
    reached = [place.reached for place in motion.waypoints]
    assert reached[1] > 6.0 and reached[2] - reached[1] == pytest.approx(6.0, abs=0.1)
    free = perform(reference, "geodesic", SWING)
    assert not free.deviations and free.converged


@pytest.mark.long
def test_a_detour_that_is_early_waits_for_its_time() -> None:
    motion = perform(swing(24.0), "geodesic", replace(SWING, dt=0.15), ball())
    check_motion(motion, motion.run.limits)
    assert motion.converged and len(motion.deviations) == 1
    # Before it leaves the way it waits a little; by its own way it is there long before the time.
    standing = np.flatnonzero(~np.any(motion.velocities, axis=1))
    assert len(standing) * 0.15 > 3.0
    reached = [place.reached for place in motion.waypoints]
    assert 24.0 < reached[1] < 27.0 and reached[2] - reached[1] == pytest.approx(24.0, abs=0.31)


def test_a_target_inside_an_obstacle_ends_honestly() -> None:
    reference = swing()
    tip = reference.waypoints[1].target.points[-1]
    motion = perform(
        reference, "geodesic", SWING, pp.Scene({"ball": pp.Sphere(tuple(tip), 0.1)}, arm_radius=0.006)
    )
    assert motion.run.status in ("stalled", "max_steps") and not motion.converged
    assert "on the way to stop 1" in motion.run.reason and motion.run.clearance.min() > 0.0
    assert [place.row is None for place in motion.waypoints] == [False, True, True]
    check_clock(motion)


@pytest.mark.parametrize("controller", ["geodesic", "joint"])
@pytest.mark.parametrize("calls", [1, 7, 60])
def test_progress_is_told_and_can_stop_the_motion(controller: str, calls: int) -> None:
    arm = arm_named("spatial")
    reference = random_reference(arm, 8)
    limits = limits_of(arm)
    told: list[tuple[float, float]] = []

    def progress(time: float, of: float) -> bool:
        told.append((time, of))
        return len(told) >= calls

    motion = perform(reference, controller, limits, progress=progress)
    assert len(told) == calls and {of for _, of in told} == {reference.duration}
    times = [time for time, _ in told]
    assert times == sorted(times)
    assert motion.run.status == "stopped" and "callback" in motion.run.reason and not motion.converged
    check_motion(motion, limits)
    assert motion.waypoints[-1].row is None
    # It brakes to rest from there, and no longer than that takes: v / (a dt) cycles.
    assert motion.steps <= calls + 2.0 / (15.0 * 0.02) + 1
    assert motion.plan_time[-1] == pytest.approx(times[-1], abs=1e-9)


def test_a_motion_stopped_before_it_sets_out_passed_nothing() -> None:
    arm = arm_named("spatial")
    reference = random_reference(arm, 9)
    limits = limits_of(arm)
    q0 = drawn(arm, np.random.default_rng(1))
    motion = perform(reference, "geodesic", limits, q0=q0, progress=lambda *_: True)
    check_motion(motion, limits)
    assert motion.run.status == "stopped" and "first posture" in motion.run.reason
    assert all(place.row is None for place in motion.waypoints)
    assert motion.start_index == motion.steps and motion.duration == 0.0 and motion.time_scale == 1.0


def test_limits_of_none_and_a_progress_that_returns_nothing() -> None:
    arm = arm_named("planar")
    told: list[float] = []
    motion = perform(random_reference(arm, 10), progress=lambda time, of: told.append(time))
    assert motion.converged and len(told) == motion.steps and motion.dt == 0.02
    check_motion(motion, pp.Limits(step=None, dt=0.02))


def test_bad_input_is_named() -> None:
    arm = arm_named("planar")
    reference = random_reference(arm, 11)
    for limits in (pp.Limits(), "fast"):
        with pytest.raises(InvalidValue, match="dt"):
            perform(reference, "geodesic", limits)
    with pytest.raises(UnknownName, match="qq"):
        perform(reference, "qq")
    with pytest.raises(InvalidValue, match="tolerance"):
        perform(reference, tolerance=0.0)
    with pytest.raises(InvalidValue, match="q0"):
        perform(reference, q0=np.zeros(3))
    with pytest.raises(InvalidValue, match="q0"):
        perform(reference, q0=np.full(arm.nq, np.nan))
    with pytest.raises(InvalidValue, match="position_margin"):
        perform(reference, "geodesic", pp.Limits(dt=0.1, position_margin=9.0))


def test_references_that_make_no_sense_are_refused() -> None:
    arm = arm_named("planar")
    rows = np.zeros((4, arm.nv))
    m = arm.n_modules
    good = Reference(arm, 0.1, arm.neutral(), rows, np.ones((4, m)))
    assert good.rows == 4 and good.duration == pytest.approx(0.3)
    np.testing.assert_allclose(good.times, [0.0, 0.1, 0.2, 0.3])
    for offsets, weights in (
        (rows[:1], np.ones((1, m))),
        (rows[:, :-1], np.ones((4, m))),
        (rows, np.ones((3, m))),
        (rows * np.nan, np.ones((4, m))),
    ):
        with pytest.raises(InvalidValue):
            Reference(arm, 0.1, arm.neutral(), offsets, weights)


def test_a_reference_that_rests_takes_its_time() -> None:
    arm = arm_named("spatial")
    q = drawn(arm, np.random.default_rng(12))
    reference = Reference(arm, 0.05, q, np.zeros((21, arm.nv)), np.ones((21, arm.n_modules)))
    motion = perform(reference, "geodesic", limits_of(arm))
    assert motion.converged and motion.steps == 50 and not np.any(motion.velocities)
    assert motion.time_scale == pytest.approx(1.0)


def test_the_course_of_a_motion_is_the_given_one_to_its_end() -> None:
    # What the controller remembers last is the way of the reference, gone to its end.
    arm = arm_named("spatial")
    seen = []

    class Watched(pp.Geodesic):
        def step(self, *given: object, **named: object) -> object:
            step = super().step(*given, **named)
            seen.append(step.memory.progress)
            return step

    reference = random_reference(arm, 13)
    motion = perform(reference, Watched(), limits_of(arm))
    assert motion.converged and all(progress.timed.scheduled for progress in seen)
    assert seen[-1].s == seen[-1].path.end == reference.rows - 1


@pytest.mark.long
@pytest.mark.parametrize("seed", cases([2, 6, 21, *range(22, 32)], 2))
@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_among_obstacles_limits_hold_from_one_part_of_a_motion_to_the_next(seed: int) -> None:
    # Obstacles are in the way of some, which then leave it and come to the next stop by another.
    course = drawn_course(seed, stops=3)
    run = perform(
        reference_through(course.arm, course.stops, 2.0, 60), "geodesic", course.limits, course.scene
    ).run
    check_output(run)
    assert run.excess is None and not np.any(run.violated_constraints != "")
    assert run.clearance.min() >= course.scene.margin - 1e-9 * course.arm.length
