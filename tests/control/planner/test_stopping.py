"""Among obstacles the arm can always brake to a stop, clear of them, within its limits of acceleration."""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import pytest
from among_obstacles import accelerations, arm_number, check_output, drawn_course
from hypothesis import given
from hypothesis import strategies as st
from sampling import cases, examples

import pinposture as pp
from pinposture import kernels
from pinposture.control import Memory
from pinposture.control.limits import CYCLES, full_braking
from pinposture.control.planner.path import JointPath, retime
from pinposture.motion.loop import RecordedLoop

pytestmark = pytest.mark.filterwarnings("ignore:velocity .* is above")


@given(st.integers(0, 10**6))
@examples(60)
def test_an_arm_stops_straight_on_within_its_limits(seed: int) -> None:
    rng = np.random.default_rng(seed)
    n = int(rng.integers(1, 6))
    brake = 10.0 ** rng.uniform(-4, -1, n)
    bound = np.full(n, 0.3)
    dq = rng.uniform(-0.3, 0.3, n) * rng.integers(0, 2, n)
    # Room for braking as hard as may be, of each joint by itself, and for some of them not much more.
    needed = np.zeros(n)
    slowest = dq
    while np.any(slowest := full_braking(slowest, brake)):
        needed += slowest
    spare = np.where(rng.random(n) < 0.5, 10.0, 10.0 ** rng.uniform(-6, 0, n)) * np.abs(needed)
    rooms = np.array([np.minimum(needed, 0.0) - spare, np.maximum(needed, 0.0) + spare])
    steps = kernels.stopping_steps(rooms, dq, bound, brake, CYCLES.most_stopping)
    changes = np.diff(np.vstack([dq, steps, np.zeros(n)]), axis=0)
    assert np.all(np.abs(changes) <= brake * (1.0 + 1e-9))
    gone = steps.cumsum(axis=0)
    assert np.all(gone >= rooms[0] - 1e-11) and np.all(gone <= rooms[1] + 1e-11)
    assert len(steps) == max(int(np.ceil(np.max(np.abs(dq) / brake))) - 1, 0)
    if np.all(spare >= 5.0 * np.abs(needed)):
        free = np.array([[-np.inf], [np.inf]]) * np.ones(n)
        everywhere = kernels.stopping_steps(free, dq, bound, brake, CYCLES.most_stopping)
        crossed = np.abs(everywhere * np.linalg.norm(dq) - np.linalg.norm(everywhere, axis=1)[:, None] * dq)
        assert np.all(crossed <= 1e-9)  # on the straight line that it is on


@given(st.integers(0, 10**6))
@examples(30)
def test_no_run_exceeds_its_limits_or_comes_closer_than_the_margin(seed: int) -> None:
    check_run(seed, 20 if seed % 2 else 400)


@pytest.mark.long
@pytest.mark.parametrize("seed", cases([113, 70, 59, 90, 138, 144], 1))
def test_nor_does_one_that_comes_upon_obstacles_at_full_speed(seed: int) -> None:
    check_run(seed, 1000)  # on ways that are not clear


def check_run(seed: int, max_steps: int) -> None:
    progress = drawn_course(seed)
    how = {"limits": progress.limits, "scene": progress.scene, "max_steps": max_steps}
    run = pp.track(progress.arm, progress.goal, progress.stops[0], **how)
    check_output(run)
    assert run.excess is None and not np.any(run.violated_constraints != "")
    length = progress.arm.length
    assert run.clearance.min() >= progress.scene.margin - 1e-9 * length
    around = pp.CollisionModel(progress.arm, progress.scene)
    ways = [(q, run.arm.difference(q, after)) for q, after in pairwise(run.q)]
    between = [around.minimum_along(q, np.arange(1, 8)[:, None] / 7 * way).distance for q, way in ways]
    assert min(between) >= progress.scene.margin - 1e-3 * length


@pytest.mark.long
@given(st.integers(0, 10**6))
@examples(40)
def test_what_gives_way_before_an_obstacle_that_is_put_in_the_way_is_named(seed: int) -> None:
    progress = drawn_course(seed)
    rng = np.random.default_rng(seed)
    arm = progress.arm
    length = progress.arm.length
    loop = RecordedLoop(arm, progress.stops[0], progress.goal, pp.Geodesic(), progress.limits)
    loop.run(progress.goal, 1e-6 * length, int(rng.integers(3, 30)))
    beside = loop.state.points[rng.integers(arm.n_modules)] + 0.08 * length * rng.normal(size=3)
    ball = pp.Scene({"ball": pp.Sphere(beside, 0.03 * length)}, self_collision=False, margin=0.01 * length)
    around = pp.CollisionModel(arm, ball)
    first = loop.record.steps
    loop.controller = loop.controller.with_scene(ball)
    loop.run(progress.goal, 1e-6 * length, first + 60)
    loop.brake_to_rest()
    run = loop.record.run(arm, loop.controller, progress.limits, "stopped", "enough")
    check_output(run)
    distances = np.array([around.minimum(q).distance for q in run.q[first:]])
    closer = np.flatnonzero(distances < min(ball.margin, distances[0]) - 1e-9 * length)
    if len(closer):  # then it was too fast to stop
        assert run.violated_constraints[first] != "" and np.all(
            run.violated_constraints[first : first + closer[0]] != ""
        )
    if run.excess is not None:
        worst = accelerations(arm, run.q, progress.limits).max()
        assert run.excess.ratio == pytest.approx(worst, rel=1e-6)
        assert "limits are exceeded in" in run.reason and "exceeds it by a factor of" in run.reason


def test_what_gives_way_first_is_the_margin_and_then_acceleration() -> None:
    """One hinge on its way to a wall: it comes closer than it may, or hits it if it is faster still."""
    arm = pp.Arm.from_template("Rz", 1)
    length = arm.length
    limits = pp.Limits(step=None, velocity=5.0, dt=0.1, acceleration=1.0)
    target = pp.Target.from_configuration(arm, np.array([1.5]))
    found = []
    for speed in (0.15, 0.17, 0.3):  # it stops in speed^2 / 2 A - speed / 2 [rad], A = 0.01
        room = speed**2 / 0.02 - speed / 2.0
        # The side of the link is 1 mm from the wall at 1 rad.
        wall = pp.HalfSpace((0.0, length * np.sin(1.0) + 0.002, 0.0), (0.0, -1.0, 0.0))
        controller = pp.Geodesic(
            scene=pp.Scene({"wall": wall}, self_collision=False, margin=0.002, arm_radius=0.001)
        )
        start = arm.at(np.array([1.0 - room + (0.3 if speed > 0.2 else 0.0005)]))
        step = controller.step(start, target, limits, Memory(np.array([speed])))
        found.append((float(speed - step.dq[0]), step.violated_constraints))
    for change, relaxed in found[:2]:
        assert change == pytest.approx(0.01) and any(words.startswith("margin: braking") for words in relaxed)
    change, relaxed = found[2]
    assert change > 0.01 and any("acceleration" in words for words in relaxed)


@pytest.mark.parametrize("seed", cases(range(6), 2))
def test_without_a_measurement_a_tracker_brakes_clear(seed: int) -> None:
    progress = drawn_course(seed, stops=3)
    tracker = pp.Tracker(progress.arm, limits=progress.limits, scene=progress.scene)
    rng = np.random.default_rng(seed)
    q = [progress.stops[0]]
    around = pp.CollisionModel(progress.arm, progress.scene)
    for number in range(120):
        if number % 40 == 0:
            goal = progress.stops[1 + number // 40 % 2]
            tracker.update(pp.Target.from_configuration(progress.arm, goal))
        missing = number > 0 and rng.random() < 0.1
        q.append(progress.arm.integrate(q[-1], tracker.step(None if missing else q[-1])))
        assert not tracker.report.violated_constraints
    while np.any(dq := tracker.step(None)):
        q.append(progress.arm.integrate(q[-1], dq))
    assert accelerations(progress.arm, np.array(q), progress.limits).max() <= 1.0 + 1e-9
    assert min(around.minimum(each).distance for each in q) >= progress.scene.margin - 1e-9


@pytest.mark.parametrize("steps", range(4, 60, 5))
def test_a_step_that_was_asked_for_and_not_taken_is_none_to_brake_from(steps: int) -> None:
    arm = arm_number(1)
    start, end = (arm.configuration(np.full(arm.nv, value)) for value in (0.0, 0.4))
    goal = pp.Target.from_configuration(arm, end)
    limits = pp.Limits(dt=0.05, acceleration=1.0)
    loop = RecordedLoop(arm, start, goal, pp.Geodesic(), limits)
    for _ in range(min(steps, 24)):
        loop.take(loop.compute(goal))
    for _ in range(steps // 10):
        loop.compute(pp.Target.from_configuration(arm, start))
    loop.brake()
    loop.brake_to_rest()
    run = loop.record.run(arm, loop.controller, limits, "stopped", "enough")
    assert accelerations(arm, run.q, limits).max() <= 1.0 + 1e-9


def test_a_way_that_is_given_is_set_out_on_at_the_speed_of_now() -> None:
    arm = arm_number(1)
    limits = pp.Limits(dt=0.05, acceleration=1.0)
    state = arm.at(arm.neutral())
    controller = pp.Geodesic()
    moving = Memory(np.full(arm.nv, -0.0025))
    target = pp.Target.from_configuration(arm, state.q)
    offsets = np.linspace(0.0, 1.0, 30)[:, None] * np.ones(arm.nv)
    path = JointPath(controller.objective(arm, target), state.q, offsets)
    memory = controller.start(retime(path, limits, 1.0), state.chain_state, moving)
    change = controller.step(state, target, limits, memory).dq - moving.dq
    assert 0.0 < change.max() <= 0.0025 * (1.0 + 1e-9)


def test_a_run_that_is_over_comes_to_rest() -> None:
    progress = drawn_course(3)
    for steps in (5, 9):
        run = pp.track(
            progress.arm, progress.goal, progress.stops[0], limits=progress.limits, max_steps=steps
        )
        assert run.status == "max_steps" and run.steps > steps and run.excess is None
        check_output(run)
        called: list[int] = []
        stopped = pp.track(
            progress.arm,
            progress.goal,
            progress.stops[0],
            limits=progress.limits,
            callback=lambda number, *_: called.append(number) or number == steps,  # noqa: B023
        )
        assert stopped.status == "stopped" and called[-1] == steps and stopped.steps > steps
        np.testing.assert_allclose(stopped.q, run.q, atol=1e-12)


@dataclass(frozen=True)
class Counting(Memory):
    taken: int = 0


@pytest.mark.parametrize("number", [0, 4])
def test_a_step_that_exceeds_a_limit_is_named_whoever_took_it(number: int) -> None:
    class Reckless:
        name = "reckless"

        def step(self, state, target, limits=None, memory=None):
            taken = 0 if memory is None else memory.taken
            dq = np.zeros(state.arm.nv)
            dq[1] = (0.01, 0.02, 0.05, 0.04, 0.03, 0.02, 0.01)[taken]
            step = pp.Geodesic().step(state, target, replace(limits, acceleration=None))
            memory = Counting(dq, taken=taken + 1)
            return step._replace(dq=dq, reason="", violated_constraints=(), memory=memory)

    arm = arm_number(number)
    start = arm.configuration(np.full(arm.nv, 0.0))
    goal = pp.Target.from_configuration(arm, arm.configuration(np.full(arm.nv, 1.0)))
    limits = pp.Limits(step=0.04, dt=0.1, acceleration=1.0)
    run = pp.track(arm, goal, start, Reckless(), limits, max_steps=7)
    # It changes by 0.03 where 0.01 is the limit, in the third step, which is also 0.05 long where 0.04 is.
    assert run.excess is not None and run.excess.steps == (2,) and run.excess.worst == 2
    assert run.excess.ratio == pytest.approx(3.0)
    joint = repr(arm.joint_names[1])
    assert run.violated_constraints[2] == f"acceleration limit: joint {joint} exceeds it by a factor of 3"
    assert f"limits are exceeded in 1 step, most in step 3 (of {run.steps})" in run.reason
