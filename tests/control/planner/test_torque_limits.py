"""Paths that are timed within torque limits: closed forms, and torques of the steps by Pinocchio alone."""

from __future__ import annotations

import re
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest
from arm.test_inverse_dynamics import SLIDE
from arms import template_arm
from sampling import seeds
from scipy.interpolate import CubicSpline

import pinposture as pp
from benchmarks.studies import torque_limits
from pinposture.arm import smooth_configuration
from pinposture.arm.dynamics import Dynamics
from pinposture.control.torque_limits import TORQUE_LIMIT, StepTorques
from pinposture.errors import InvalidValue, WeightUnknown
from pinposture.kernels.path_following import PATH_SPEED

HINGE = """<robot name="door">
  <link name="frame"/>
  <link name="leaf"><inertial><mass value="3"/><origin xyz="0.4 0 0"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.16" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="frame"/><child link="leaf"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="2" velocity="100"/></joint>
  <link name="edge"/>
  <joint name="end" type="fixed"><parent link="leaf"/><child link="edge"/><origin xyz="0.8 0 0"/></joint>
</robot>"""


def timed_between(arm: pp.Arm, start: np.ndarray, goal: np.ndarray, limits: pp.Limits) -> pp.TimedPath:
    path = pp.plan(arm.at(start), pp.Target.from_configuration(arm, goal), limits=limits)
    return pp.retime(path, limits, effort=True)


def largest_share(arm: pp.Arm, start: np.ndarray, offsets: np.ndarray, dt: float) -> float:
    """Largest torque of a motion given by its rows, from and to rest, relative to the limit."""
    moves = np.diff(np.pad(offsets, ((1, 1), (0, 0)), mode="edge"), axis=0)
    return share_of_steps(arm, pin.integrate(arm.model, start, offsets[0]), moves, dt)


def share_of_steps(arm: pp.Arm, q: np.ndarray, moves: np.ndarray, dt: float) -> float:
    """Largest torque where steps meet, the first two of them at q, relative to the limit."""
    data = arm.model.createData()
    share = 0.0
    for before, after in zip(moves[:-1] / dt, moves[1:] / dt, strict=True):
        torques = pin.rnea(arm.model, data, q, (before + after) / 2.0, (after - before) / dt)
        share = max(share, float((np.abs(torques) / arm.effort).max()))
        q = pin.integrate(arm.model, q, after * dt)
    return share


@pytest.mark.parametrize("angle", (0.3, 2.0))
def test_a_door_is_opened_in_the_shortest_time(angle: float) -> None:
    arm = pp.Arm.load(HINGE)
    timed = timed_between(arm, [0.0], [angle], pp.Limits(step=None, velocity=100.0, dt=1e-3))
    acceleration = PATH_SPEED.effort_share * 2.0 / (0.16 + 3.0 * 0.4**2)
    assert timed.duration == pytest.approx(2.0 * np.sqrt(angle / acceleration), rel=0.01, abs=0.002)


@pytest.mark.parametrize("distance", (0.5, -0.5))
def test_a_lift_rises_and_sinks_in_the_shortest_time(distance: float) -> None:
    """It brakes with gravity as it rises, and against it as it sinks."""
    arm = pp.Arm.load(SLIDE, split=1)
    timed = timed_between(arm, [0.0], [distance], pp.Limits(step=None, velocity=100.0, dt=1e-3))
    reserve = (1.0 - PATH_SPEED.effort_share) * (40.0 / 2.5 - 9.81)  # of what holding it leaves
    least = 40.0 / 2.5 - reserve - 9.81
    most = 40.0 / 2.5 - reserve + 9.81
    shortest = np.sqrt(2.0 * abs(distance) * (least + most) / (least * most))
    assert timed.duration == pytest.approx(shortest, rel=0.01, abs=0.002)


@pytest.mark.parametrize("seed", seeds(20))
def test_torques_keep_their_limits_on_timed_paths_and_where_they_are_followed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = template_arm("RyRz", int(rng.integers(2, 9)))
    start, goal = (smooth_configuration(arm, rng, 0.6) for _ in range(2))
    dt = float(rng.choice([0.005, 0.01]))
    acceleration = rng.choice([None, 20.0])
    limits = pp.Limits(step=None, velocity=float(rng.uniform(1.0, 2.0)), acceleration=acceleration, dt=dt)
    path = pp.plan(arm.at(start), pp.Target.from_configuration(arm, goal), limits=limits)
    held = [arm.at(path.configuration(place)).gravity_torques for place in np.linspace(0.0, path.end, 50)]
    arm = arm.with_effort(float(np.abs(held).max()) * rng.uniform(1.1, 3.0))
    timed = timed_between(arm, start, goal, limits)
    offsets = timed.path.smooth_offset(timed.s)
    assert largest_share(arm, start, offsets, dt) <= 1.0
    q = start
    memory = None
    followed = [np.zeros(arm.nv)]
    while np.abs(arm.difference(q, goal)).max() > 1e-9:
        step = pp.follow(timed, arm.at(q), memory=memory)
        q = arm.integrate(q, step.dq)
        memory = step.memory
        followed.append(followed[-1] + step.dq)
        assert len(followed) < 3000
    assert largest_share(arm, start, np.array(followed), dt) <= 1.0
    assert len(followed) <= 1.1 * len(timed.s) + 3


@pytest.mark.parametrize("seed", seeds(20))
def test_only_torques_that_come_near_their_limits_count(seed: int) -> None:
    """Against motions at random places of a path, within limits of speed and acceleration."""
    rng = np.random.default_rng(seed)
    arm = template_arm("RyRz", int(rng.integers(2, 9)))
    start, goal = (smooth_configuration(arm, rng, 0.8) for _ in range(2))
    dt = 0.01
    speed = 2.0
    acceleration = float(rng.choice([2.0, 20.0]))
    limits = pp.Limits(step=None, velocity=speed, acceleration=acceleration, dt=dt)
    path = pp.plan(arm.at(start), pp.Target.from_configuration(arm, goal), limits=limits)
    curve = CubicSpline(np.arange(path.end + 1.0), path.positions + path.offsets, bc_type="natural")
    data = arm.model.createData()
    largest = np.zeros(arm.nv)
    for place in rng.uniform(0.0, path.end, 100):
        q, slope, bend = (curve(place, order) for order in range(3))
        pace = rng.uniform(0.7, 1.0) * speed / np.abs(slope).max()  # [1/s]
        pace = min(pace, np.sqrt(acceleration / max(np.abs(bend).max(), 1e-9)))
        curved = bend * pace**2
        change = float(((acceleration - np.abs(curved)) / np.abs(slope)).min())
        for sign in (-1.0, 1.0):
            torques = pin.rnea(arm.model, data, q, slope * pace, curved + sign * change * slope)
            largest = np.maximum(largest, np.abs(torques))
    for effort in largest * rng.choice([0.5, 0.9, 10.0], (5, arm.nv)):
        timed = pp.retime(path, replace(limits, effort=effort))
        assert timed.profile is not None
        assert len(timed.profile.rows.limit) - arm.nv >= np.sum(effort < largest)
    strong = pp.retime(path, replace(limits, effort=100.0 * largest))
    unlimited = pp.retime(path, replace(limits, effort=np.full(arm.nv, np.inf)))
    assert strong.profile is not None and unlimited.profile is not None
    assert len(strong.profile.rows.limit) == arm.nv
    np.testing.assert_array_equal(strong.profile.top, unlimited.profile.top)


def test_friction_leaves_less_to_the_motor() -> None:
    rough = HINGE.replace('velocity="100"/>', 'velocity="100"/><dynamics damping="0" friction="1.5"/>')
    limits = pp.Limits(step=None, velocity=100.0, dt=1e-3)
    durations = []
    for text in (HINGE, rough):
        arm = pp.Arm.load(text)
        durations.append(timed_between(arm, [0.0], [1.0], limits).duration)
    assert durations[1] / durations[0] == pytest.approx(np.sqrt(2.0 / (2.0 - 1.5)), rel=0.01)


def test_what_motors_cannot_hold_and_what_is_not_known_is_named() -> None:
    arm = template_arm("RyRz", 3)
    limits = pp.Limits(step=None, velocity=2.0, dt=0.01)
    target = pp.Target.from_configuration(arm, np.full(arm.nv, 0.1))
    weak = arm.with_effort(1e-3)
    path = pp.plan(weak.at(weak.straight()), target, limits=limits)
    with pytest.raises(InvalidValue, match=r"joint 'm01_j1_y' needs 0\.05008 of 0\.00098 N m.*98 %"):
        pp.retime(path, limits, effort=True)
    path = pp.plan(arm.at(arm.straight()), target, limits=limits)
    with pytest.raises(WeightUnknown, match="torque limit"):
        pp.retime(path, limits, effort=True)
    strong = arm.with_effort(10.0)
    path = pp.plan(strong.at(strong.straight()), target)
    with pytest.raises(InvalidValue, match="cycle time"):
        pp.retime(path, effort=True)


# Limits of torque in steps, plans and motions.


def judged(arm: pp.Arm, effort: float, q: np.ndarray, dt: float | None) -> tuple[float, float]:
    """Largest torques that hold and that move the arm in a motion, relative to the limit; by Pinocchio."""
    data = arm.model.createData()
    held = max(float(np.abs(pin.computeGeneralizedGravity(arm.model, data, row)).max()) for row in q)
    if dt is None:
        return held / effort, 0.0
    offsets = np.array([pin.difference(arm.model, q[0], row) for row in q])
    return held / effort, largest_share(arm.with_effort(effort), q[0], offsets, dt)


@pytest.mark.parametrize("seed", seeds(30))
def test_runs_keep_to_postures_that_the_motors_can_hold(seed: int) -> None:
    rng = np.random.default_rng(seed)
    mounting = pin.SE3(
        pin.rpy.rpyToMatrix(0.0, float(rng.choice([0.0, -np.pi / 2, np.pi])), 0.0), np.zeros(3)
    )
    arm = pp.Arm.from_template("RyRz", int(rng.integers(3, 10)), base_placement=mounting)
    arm = arm.with_payload(float(rng.uniform(0.0, 0.1)))
    start, goal = (smooth_configuration(arm, rng, 0.8) for _ in range(2))
    ends = float(np.abs([arm.at(q).gravity_torques for q in (start, goal)]).max())
    effort = ends * float(rng.uniform(1.02, 1.2))
    dt = rng.choice([None, 0.01])
    limits = pp.Limits(
        step=0.1 if dt is None else None,
        velocity=None if dt is None else 2.0,
        acceleration=None if dt is None else rng.choice([None, 20.0]),
        dt=dt,
        effort=effort,
    )
    run = pp.track(arm, pp.Target.from_configuration(arm, goal), start, limits=limits)
    assert run.converged
    held, moved = judged(arm, effort, run.q, dt)
    assert held <= 1.0 + 1e-9
    assert moved <= 1.0 + 1e-6
    assert "torque limit" not in "".join(run.violated_constraints)


def test_a_planned_path_goes_around_postures_that_cannot_be_held() -> None:
    rng = np.random.default_rng(31)
    arm = template_arm("RyRz", 4)
    more = 1.0
    while more < 1.05:
        start, goal = (smooth_configuration(arm, rng, 1.2) for _ in range(2))
        target = pp.Target.from_configuration(arm, goal)
        direct = pp.plan(arm.at(start), target)
        held = np.abs([arm.at(q).gravity_torques for q in direct.configurations]).max(axis=1)
        more = float(held.max() / max(held[0], held[-1]))
    effort = 1.02 * float(max(held[0], held[-1]))
    path = pp.plan(arm.at(start), target, limits=pp.Limits(effort=effort))
    between = [path.configuration(place) for place in np.linspace(0.0, path.end, 300)]
    assert judged(arm, effort, np.array(between), None)[0] <= 1.0
    assert not path.blocked_by and path.length > direct.length


def test_a_start_and_a_goal_that_cannot_be_held_are_refused_with_what_is_too_much() -> None:
    arm = template_arm("RyRz", 6)
    limits = pp.Limits(effort=1.05 * float(np.abs(arm.at(arm.straight()).gravity_torques).max()))
    loaded = arm.with_payload(0.1)
    bent = np.zeros(arm.nv)
    bent[0] = 1.2  # it hangs
    target = pp.Target.from_configuration(loaded, loaded.straight())
    with pytest.raises(
        InvalidValue, match=r"target.q is .joint 'm01_j1_y' needs .* N m.*could with 0\.0\d+ kg less"
    ) as caught:
        pp.track(loaded, target, bent, limits=limits)
    mass = float(str(caught.value).split("could with ")[1].split(" kg")[0])
    lighter = arm.with_payload(0.1 - 1.01 * mass)
    assert pp.track(
        lighter, pp.Target.from_configuration(lighter, lighter.straight()), bent, limits=limits
    ).steps
    with pytest.raises(InvalidValue, match=r"q0 is .joint"):
        pp.track(loaded, pp.Target.from_configuration(loaded, bent), loaded.straight(), limits=limits)
    run = pp.track(
        loaded, pp.Target.from_configuration(loaded, bent), loaded.straight(), limits=limits, strict=False
    )
    assert run.converged
    assert "torque limit: joint 'm01_j1_y'" in run.reason
    assert judged(loaded, float(limits.effort), run.q[-1:], None)[0] <= 1.0


def random_motion(seed: int) -> tuple[pp.Arm, np.ndarray, np.ndarray, np.ndarray]:
    """An arm with a slide, its posture, and two steps in a row."""
    rng = np.random.default_rng(seed)
    arm = template_arm("RyRz", 3).with_payload(0.2) if seed % 2 else pp.Arm.load(SLIDE, split=1)
    q = arm.integrate(arm.neutral(), rng.uniform(-0.3, 0.3, arm.nv))
    return arm, q, *(0.02 * rng.normal(size=(2, arm.nv)))


@pytest.mark.parametrize("seed", seeds(6))
def test_torques_of_a_step_are_those_of_pinocchio_and_their_rows_are_tangent_to_them(seed: int) -> None:
    arm, q, before, dq = random_motion(seed)
    effort = np.linspace(0.5, 1.0, arm.nv)
    dt = 0.01
    bounds = pp.Limits(dt=dt, effort=effort).for_arm(arm)
    torques = StepTorques(arm, bounds, arm.positions(q), before)
    data = arm.model.createData()
    expected = pin.rnea(arm.model, data, q, (before + dq) / (2 * dt), (dq - before) / dt**2)
    np.testing.assert_allclose(torques.of(dq), expected, atol=1e-9 * np.abs(expected).max())
    matrix, least = torques.rows(dq)
    room = matrix @ dq - least  # to the upper and to the lower limits, with a reserve of a thousandth
    shares = expected / ((1.0 - TORQUE_LIMIT.linearised) * effort)
    np.testing.assert_allclose(room, np.concatenate([1.0 + shares, 1.0 - shares]), rtol=1e-9)
    mass = np.tril(pin.crba(arm.model, data, q))
    mass = mass + np.tril(mass, -1).T
    slopes = mass / dt**2 / ((1.0 - TORQUE_LIMIT.linearised) * effort[:, None])
    np.testing.assert_allclose(
        matrix, np.vstack([slopes, -slopes]), rtol=1e-9, atol=1e-9 * np.abs(slopes).max()
    )
    assert torques.keep_limits(dq) == bool(np.all(np.abs(expected) <= effort))


@pytest.mark.long
@pytest.mark.parametrize("kind", (*torque_limits.KINDS, *torque_limits.FURTHER))
@pytest.mark.parametrize("seed", seeds(3))
def test_torques_keep_their_limits_where_a_tracker_is_disturbed(seed: int, kind: str) -> None:
    """By targets, obstacles, missing measurements, starts outside limits, limits of jerk; by `pin.rnea`."""
    found = torque_limits.run(seed, kind)
    assert found.named == found.cycles == 0
    assert found.share <= 1.0 + 1e-6
    assert found.error < torque_limits.ARRIVED


@pytest.mark.parametrize("seed", seeds(12))
def test_a_stop_keeps_torque_limits(seed: int) -> None:
    """On a straight line, to rest, within limits of position and acceleration; torques are Pinocchio's."""
    rng = np.random.default_rng(seed)
    arm = template_arm("RyRz", int(rng.integers(2, 8)))
    q = smooth_configuration(arm, rng, 0.6)
    effort = float(rng.uniform(1.3, 3.0) * np.abs(arm.at(q).gravity_torques).max())
    acceleration = rng.choice([None, 30.0])
    limits = pp.Limits(step=None, velocity=2.0, acceleration=acceleration, dt=0.01, effort=effort)
    way = rng.normal(size=arm.nv)
    before = 0.015 * way / np.abs(way).max()
    torques = StepTorques(arm, limits.for_arm(arm), arm.positions(q), before)
    stop = torques.stop(before)
    steps = np.vstack([before, stop.steps, np.zeros(arm.nv)])
    data = arm.model.createData()
    share = 0.0
    at = q
    for last, step in zip(np.vstack([before, steps[:-1]]), steps, strict=True):
        needed = pin.rnea(arm.model, data, at, (last + step) / 0.02, (step - last) / 0.01**2)
        share = max(share, float(np.abs(needed).max()) / effort)
        at = arm.integrate(at, step)
    held = float(np.abs(pin.computeGeneralizedGravity(arm.model, data, at)).max()) / effort
    assert stop.share == pytest.approx(max(share, held), rel=1e-9)
    assert stop.share <= 1.0
    along = steps @ before / (before @ before)
    np.testing.assert_allclose(steps, along[:, None] * before, atol=1e-12)
    assert np.all(np.diff(along) <= 0.0)
    if acceleration is not None:
        assert np.abs(np.diff(steps, axis=0)).max() <= acceleration * 0.01**2 + 1e-12


@pytest.mark.parametrize("acceleration", (None, 20.0))
def test_a_run_that_is_stopped_brakes_within_torque_limits(acceleration: float | None) -> None:
    rng = np.random.default_rng(5)
    arm = pp.Arm.from_template("RyRz", 8, link_lengths=(0.06, 0.06))
    start, goal = (smooth_configuration(arm, rng, 0.8) for _ in range(2))
    effort = 1.1 * float(np.abs([arm.at(q).gravity_torques for q in (start, goal)]).max())
    limits = pp.Limits(step=None, velocity=2.0, acceleration=acceleration, dt=0.01, effort=effort)
    target = pp.Target.from_configuration(arm, goal)
    run = pp.track(arm, target, start, limits=limits, callback=lambda number, *_: number == 25)
    assert run.status == "stopped" and run.steps > 25
    assert judged(arm, effort, run.q, 0.01)[1] <= 1.0 + 1e-6


def test_a_jump_back_goes_on_along_the_path_that_the_arm_has_not_left() -> None:
    """Nothing is planned anew: the path that is kept leads there."""
    rng = np.random.default_rng(6)
    arm = pp.Arm.from_template("RyRz", 8, link_lengths=(0.06, 0.06))
    start, goal, other = (smooth_configuration(arm, rng, 0.8) for _ in range(3))
    effort = 1.2 * float(np.abs([arm.at(q).gravity_torques for q in (start, goal, other)]).max())
    limits = pp.Limits(step=None, velocity=2.0, dt=0.01, effort=effort)
    tracker = pp.Tracker(arm, limits=limits)
    targets = [pp.Target.from_configuration(arm, q) for q in (goal, other)]
    q = start
    paths = []
    for cycle in range(40):
        tracker.update(targets[1 if 20 <= cycle < 22 else 0])
        q = arm.integrate(q, tracker.step(q))
        step = tracker.report.step
        assert step is not None and not tracker.report.violated_constraints
        paths.append(
            step.memory.progress.path.start is paths[0] if cycle else step.memory.progress.path.start
        )
    assert all(paths[1:])


def test_torques_of_steps_on_a_path_are_computed_ahead(monkeypatch) -> None:
    """By the controller, with those of the stop after them; not again for the report."""
    arm = template_arm("RyRz", 4)
    goal = np.full(arm.nv, 0.3)
    effort = 2.0 * float(np.abs(arm.at(goal).gravity_torques).max())
    limits = pp.Limits(step=None, velocity=1.0, acceleration=5.0, dt=0.01, effort=effort)
    tracker = pp.Tracker(arm, limits=limits)
    tracker.update(pp.Target.from_configuration(arm, goal))
    q = np.zeros(arm.nv)
    computed = []
    for name in ("inverse_dynamics", "step_loads"):
        known = getattr(Dynamics, name)

        def compute(*arguments, name=name, known=known):
            computed.append(name)
            return known(*arguments)

        monkeypatch.setattr(Dynamics, name, compute)
    for cycle in range(42):
        if cycle == 10:
            computed.clear()
        q = q + tracker.step(q)
    assert tracker.report.status == "moving"
    assert computed == ["step_loads"] * 4


def test_an_arm_that_can_hardly_be_held_does_not_swing() -> None:
    """All torque is taken by holding it: its last steps cannot be stopped within a cycle."""
    arm = template_arm("RyRz", 4).with_payload(0.1)
    hanging = np.zeros(arm.nv)
    hanging[0] = 1.2
    effort = 0.66 * float(np.abs(arm.at(arm.straight()).gravity_torques).max())
    limits = pp.Limits(step=None, velocity=2.0, acceleration=10.0, dt=0.01, effort=effort)
    tracker = pp.Tracker(arm, limits=limits)
    tracker.update(pp.Target.from_configuration(arm, arm.straight()))
    q = hanging
    speeds = []
    for _ in range(900):
        dq = tracker.step(q)
        q = arm.integrate(q, dq)
        speeds.append(float(np.abs(dq).max()))
    assert tracker.report.status == "stalled" and max(speeds[800:]) == 0.0
    assert judged(arm, effort, np.array([q]), None)[0] <= 1.0


@pytest.fixture
def overloaded() -> tuple[pp.Arm, np.ndarray, np.ndarray, pp.Limits, str]:
    """An arm, a posture that it can hold, one that it cannot, limits, and what they lack by Pinocchio."""
    arm = template_arm("RyRz", 4).with_payload(0.1)
    hanging = np.zeros(arm.nv)
    hanging[0] = 1.2
    out = arm.straight()
    torques = np.abs(pin.computeGeneralizedGravity(arm.model, arm.model.createData(), out))
    effort = float(torques[0] - 0.05 * 9.81 * arm.at(out).points[-1][0])  # enough for half of the payload
    limits = pp.Limits(step=None, velocity=2.0, acceleration=10.0, dt=0.01, effort=effort)
    words = (
        rf"joint 'm01_j1_y' needs {torques[0]:.4g} of {effort:.4g} N m.*could with 0\.05 kg less at the tip"
    )
    return arm, hanging, out, limits, words


def test_a_plan_refuses_or_names_ends_that_cannot_be_held(overloaded) -> None:
    arm, hanging, out, limits, words = overloaded
    for start, goal, name in ((hanging, out, "target.q"), (out, hanging, "state")):
        target = pp.Target.from_configuration(arm, goal)
        with pytest.raises(InvalidValue, match=rf"{name} is .{words}"):
            pp.plan(arm.at(start), target, limits=limits)
        path = pp.plan(arm.at(start), target, limits=limits, strict=False)
        end = "goal" if name == "target.q" else "start"
        assert f"at the {end}, torque limit: joint 'm01_j1_y' needs" in path.blocked_by


def test_a_task_refuses_or_flags_postures_that_cannot_be_held(overloaded) -> None:
    arm, hanging, out, limits, words = overloaded
    places = [pp.Keyframe(joints=tuple(hanging)), pp.Keyframe(joints=tuple(out), time=1.0, name="out")]
    task = pp.Task(arm, tuple(places), limits)
    for move in (task.perform, lambda: pp.move_through(arm, places, limits=limits)):
        with pytest.raises(InvalidValue, match=rf"keyframe 2 'out' is .{words}"):
            move()
    with pytest.raises(InvalidValue, match=rf"start is .{words}"):
        task.edited(motion=(places[0], pp.Keyframe(joints=tuple(hanging), time=1.0)), start=out).perform()
    kept, refused = task.feasibility(task.reference())
    assert kept.overload is None and re.search(words, str(refused.overload))
    motion = task.perform(strict=False)
    assert not motion.run.converged
    assert judged(arm, float(limits.effort), motion.q, None)[0] <= 1.0


def test_a_tracker_names_a_target_that_cannot_be_held_and_goes_near_it(overloaded) -> None:
    arm, hanging, out, limits, words = overloaded
    tracker = pp.Tracker(arm, limits=limits)
    tracker.update(pp.Target.from_configuration(arm, out))
    q = hanging
    for _ in range(900):
        q = arm.integrate(q, tracker.step(q))
        named = "; ".join(tracker.report.violated_constraints)
        assert re.search(rf"torque limit at the target: {words}", named)
    assert tracker.report.status == "stalled"
    assert judged(arm, float(limits.effort), np.array([q]), None)[0] <= 1.0
    tracker.update(pp.Target.from_configuration(arm, hanging))
    tracker.step(q)
    assert not tracker.report.violated_constraints


def test_limits_of_the_arm_and_unknown_ones() -> None:
    arm = template_arm("RyRz", 3)
    target = pp.Target.from_configuration(arm, np.full(arm.nv, 0.1))
    with pytest.raises(WeightUnknown, match="torque limit"):
        pp.track(arm, target, arm.straight(), limits=pp.Limits(effort=True))
    weak = arm.with_effort(1e-3)
    target = pp.Target.from_configuration(weak, np.full(arm.nv, 0.1))
    with pytest.raises(InvalidValue, match="needs"):
        pp.track(weak, target, weak.straight(), limits=pp.Limits(effort=True))
    assert pp.track(weak, target, weak.straight(), limits=pp.Limits(effort=5.0)).converged
    with pytest.raises(InvalidValue, match="effort"):
        pp.Limits(effort=False)


def test_a_replanned_path_keeps_the_torque_limits_of_the_first() -> None:
    rng = np.random.default_rng(3)
    arm = template_arm("RyRz", 4).with_effort(0.6)
    limits = pp.Limits(step=None, velocity=2.0, dt=0.01)
    start, goal, other = (smooth_configuration(arm, rng, 0.5) for _ in range(3))
    timed = timed_between(arm, start, goal, limits)
    controller = pp.Geodesic()
    memory = controller.start(timed, arm.at(start))
    state = arm.at(start)
    for _ in range(3):
        step = controller.step(state, timed.path.objective.target, limits, memory)
        state = state.moved(step.dq)
        memory = step.memory
    away = arm.at(arm.integrate(state.q, np.full(arm.nv, 0.2)))
    step = controller.step(away, pp.Target.from_configuration(arm, other), limits, memory)
    assert step.memory.progress is not None
    assert step.memory.progress.timed.torques is not None


def test_an_arm_brakes_on_its_path_among_the_obstacles_that_there_are_now() -> None:
    """A scene that replaces the one of the plan counts: a brake asks the path for its obstacles."""
    rng = np.random.default_rng(5)
    arm = pp.Arm.from_template("RyRz", 8, link_lengths=(0.06, 0.06))
    start, goal = (smooth_configuration(arm, rng, 0.8) for _ in range(2))
    effort = 1.1 * float(np.abs([arm.at(q).gravity_torques for q in (start, goal)]).max())
    limits = pp.Limits(step=None, velocity=2.0, acceleration=20.0, dt=0.01, effort=effort)
    target = pp.Target.from_configuration(arm, goal)
    far, farther = (
        pp.Scene({"ball": pp.Sphere((0.0, 0.0, z), 0.02)}, self_collision=False) for z in (5.0, 6.0)
    )
    q = start
    memory = None
    for scene in [far] * 20 + [farther] * 2:
        step = pp.Geodesic(scene=scene).step(arm.at(q), target, limits, memory)
        q = arm.integrate(q, step.dq)
        memory = step.memory
        assert memory.progress.path.scene is scene
    assert memory.progress.can_stop(arm.chain_at(q))


class Watched(pp.Geodesic):
    """Keeps the steps that it takes."""

    def step(self, state, target, limits, memory=None):
        found = super().step(state, target, limits, memory)
        self.__dict__.setdefault("taken", []).append((state.q, found))
        return found


def test_each_step_of_a_schedule_comes_with_a_stop_within_limits() -> None:
    arm = template_arm("RyRz", 5)
    rng = np.random.default_rng(2)
    places = [smooth_configuration(arm, rng, 0.4) for _ in range(3)]
    effort = 1.6 * float(np.abs([arm.at(q).gravity_torques for q in places]).max())
    limits = pp.Limits(step=None, velocity=2.0, dt=0.02, effort=effort)
    keyframes = [pp.Keyframe(joints=tuple(q), time=0.6 * k) for k, q in enumerate(places)]
    controller = Watched()
    assert pp.move_through(arm, keyframes, limits=limits, controller=controller).run.converged
    scheduled = [(q, step) for q, step in controller.taken if step.memory.progress.timed.scheduled]
    assert sum(step.memory.progress.ahead is not None for _, step in scheduled) > 20
    rest = np.zeros(arm.nv)
    before = rest
    for q, step in scheduled:
        ahead = step.memory.progress.ahead
        if ahead is not None:
            moves = np.vstack([before, step.dq, ahead.stopping, rest])
            assert share_of_steps(arm.with_effort(effort), q, moves, limits.dt) <= 1.0 + 1e-9
        before = step.dq


def among_balls(seed: int) -> tuple[pp.Arm, np.ndarray, np.ndarray, pp.Scene]:
    """An arm, two clear postures, and twelve balls around it."""
    arm = template_arm("RyRz", 10)
    rng = np.random.default_rng(seed)
    places = [place for place in rng.uniform(-0.4, 0.4, (12, 3)) if np.linalg.norm(place) > 0.15]
    scene = pp.Scene({f"ball {k}": pp.Sphere(place.tolist(), 0.03) for k, place in enumerate(places)})
    model = pp.CollisionModel(arm, scene)
    ends: list[np.ndarray] = []
    while len(ends) < 2:
        q = smooth_configuration(arm, rng, 0.5)
        if model.minimum(q).distance > scene.margin:
            ends.append(q)
    return arm, ends[0], ends[1], scene


def largest_torque(path: pp.JointPath) -> float:
    """The largest torque that holds the arm anywhere on a path, by Pinocchio alone [N m]."""
    arm = path.arm
    data = arm.model.createData()
    rows = [path.configuration(float(s)) for s in np.linspace(0.0, path.end, 1000)]
    return max(float(np.abs(pin.computeGeneralizedGravity(arm.model, data, q)).max()) for q in rows)


@pytest.mark.long
@pytest.mark.parametrize(("seed", "goes_around"), [(0, False), (1, False), (6, True), (8, True)])
def test_a_path_among_obstacles_is_the_usual_one_unless_the_motors_cannot_hold_the_arm_there(
    seed: int, goes_around: bool
) -> None:
    arm, start, goal, scene = among_balls(seed)
    target = pp.Target.from_configuration(arm, goal)
    usual = pp.plan(arm.at(start), target, scene)
    highest = largest_torque(usual)
    ends = max(float(np.abs(arm.at(q).gravity_torques).max()) for q in (start, goal))
    spare = pp.plan(arm.at(start), target, scene, pp.Limits(effort=1.01 * highest))
    np.testing.assert_array_equal(spare.offsets, usual.offsets)
    effort = max(1.02 * ends, 0.98 * highest)
    assert (highest > effort) is goes_around
    other = pp.plan(arm.at(start), target, scene, pp.Limits(effort=effort))
    assert not other.blocked_by
    assert largest_torque(other) <= effort * (1.0 + 1e-3)
