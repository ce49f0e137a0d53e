"""The solver's thread: the latest problem wins, whoever asks never waits, and limits hold throughout."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import cache, partial
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from edited_tasks import L, bent_spline, coil, six_modules, straight_line
from sampling import cases

import pinposture as pp
from pinposture.collision import CollisionModel
from pinposture.control import Geodesic, controller_named
from pinposture.control.registry import CONTROLLERS
from pinposture.editor.obstacles import change_obstacle, moved
from pinposture.editor.session import Session
from pinposture.editor.solver import LIVE_ARM, Live, Problem, Solver, Verdict, judge, limits_per_step
from pinposture.motion.tracker import Report
from pinposture.task import Keyframe

SOON = 20.0
"""How long something that has to happen is waited for [s]."""

SPEED = 3.0
LIMITS = pp.Limits(step=None, dt=0.02, velocity=SPEED)


@cache
def to_bent() -> Keyframe:
    return Keyframe(bent_spline(), trim=True)


@cache
def to_coil() -> Keyframe:
    return Keyframe(coil(), trim=True)


@cache
def short() -> Keyframe:
    return Keyframe(pp.Curve.line((0, 0, 0), (0.5 * L, 0, 0)))


def problem(number: int, keyframe: Keyframe | None = None, **values: object) -> Problem:
    """Of taking a shape, the bent one by default."""
    given = {"arm": six_modules(), "keyframe": keyframe or to_bent(), "controller": Geodesic()}
    given |= {"limits": LIMITS, "scene": None, "at_once": False} | values
    return Problem(number=number, asked=time.monotonic(), **given)  # type: ignore[arg-type]


@contextmanager
def started(first: Problem, start: np.ndarray | None = None) -> Iterator[Solver]:
    solver = Solver(first, first.arm.straight() if start is None else start)
    solver.start()
    try:
        yield solver
    finally:
        solver.close()
        assert "pinposture-solver" not in [each.name for each in threading.enumerate()]


def test_a_moment_without_a_step_is_not_called_a_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    solver = Solver(problem(1), six_modules().straight())
    begun = time.monotonic()
    for after, report, expected in (
        (0.1, Report("stalled", "no step", None, None, None), ("moving", "")),
        (0.4, Report("moving", "", None, None, None), ("moving", "")),
        (0.8, Report("stalled", "no step", None, None, None), ("moving", "")),
        (1.0, Report("stalled", "no step", None, None, None), ("stalled", "no step")),
        (1.1, Report("converged", "", None, None, None), ("converged", "")),
    ):
        monkeypatch.setattr(time, "monotonic", lambda now=begun + after: now)
        solver._tracker.report = report
        live = solver._look(six_modules().at(six_modules().straight()))
        assert (live.status, live.reason) == expected


def until(solver: Solver, met: Callable[[Live], bool]) -> Live:
    """The first of its states that meets something."""
    end = time.monotonic() + SOON
    while not met(live := solver.live):
        assert time.monotonic() < end, live
        time.sleep(0.005)
    return live


def arrived(number: int) -> Callable[[Live], bool]:
    return lambda live: live.number == number and live.steps > 1 and live.mean_error <= 1e-6 * live.arm.length


class Sleepy:
    """A controller that sleeps in each step, as one that plans would."""

    name = "sleepy"

    def __init__(self, seconds: float) -> None:
        self.seconds, self.own, self.asked = seconds, Geodesic(), 0

    def step(self, *given: object, **named: object) -> object:
        self.asked += 1
        time.sleep(self.seconds)
        return self.own.step(*given, **named)  # type: ignore[arg-type]


class Broken:
    name = "broken"

    def step(self, *given: object, **named: object) -> object:
        raise RuntimeError("a wire came off")


WAITING = ("selection", "pinv", "task-constraints", "extended")
"""Controllers that may stand still near an easy shape: they promise no more."""


@pytest.mark.parametrize("name", cases(CONTROLLERS, quick=4))
def test_every_controller_takes_an_easy_shape_or_at_least_comes_nearer(name: str) -> None:
    gentle = pp.Curve.spline(L * np.array([(0, 0, 0), (0.4, 0, 0), (0.8, 0.05, 0.05), (1.2, 0.2, 0.1)]))
    first = problem(1, Keyframe(gentle, placement="as_is", trim=True), controller=controller_named(name))
    arm = six_modules()
    bent = arm.integrate(arm.straight(), np.random.default_rng(0).uniform(-0.3, 0.3, arm.nv))
    with started(first, bent) as solver:
        if name in WAITING:
            began = until(solver, lambda live: live.target is not None).target
            before = float(np.linalg.norm(arm.at(bent).points - began.points, axis=1).mean())  # type: ignore
            until(solver, lambda live: live.mean_error < 0.5 * before)
        else:
            live = until(solver, arrived(1))
            goal = live.target.points  # type: ignore[union-attr]
            assert np.linalg.norm(live.state.points - goal, axis=1).mean() <= 1e-6 * L


def test_whoever_asks_does_not_wait_and_the_latest_wins() -> None:
    sleepy = Sleepy(1.0)
    with started(problem(1, controller=sleepy)) as solver:
        until(solver, lambda live: live.steps > 0 and sleepy.asked > 0)
        before = solver.live.steps
        for number in range(2, 200):
            solver.ask(problem(number, to_coil() if number % 2 else to_bent(), controller=sleepy))
        assert solver.live.steps - before <= 2  # nothing was waited for: no time for the steps of 200
        live = until(solver, lambda live: live.number == 199)
        assert live.verdict.target is not None
        assert abs(live.verdict.target.curve.length - coil().length) < 1e-6  # type: ignore[union-attr]
        solver.ask(problem(200))
        until(solver, arrived(200))


def test_what_cannot_be_taken_keeps_the_arm_where_it_was() -> None:
    with started(problem(1)) as solver:
        there = until(solver, arrived(1))
        solver.ask(problem(2, short()))
        live = until(solver, lambda live: live.number == 2 and live.steps > there.steps + 2)
        assert live.verdict.target is None
        assert "too short" in live.verdict.reason
        assert live.target is not None
        assert np.allclose(live.state.points, there.state.points, atol=1e-6 * L)
        solver.ask(problem(3, to_coil()))
        until(solver, arrived(3))


@pytest.mark.soak
def test_no_joint_is_too_fast_whatever_is_changed_on_the_way() -> None:
    ball = pp.Scene({"ball": pp.Sphere((0.5 * L, 0.5 * L, 0.5 * L), 0.05 * L)})
    changes: list[dict[str, object]] = [
        {"keyframe": to_coil()},
        {"controller": controller_named("lm")},
        {"scene": ball},
        {"limits": replace(LIMITS, acceleration=20.0)},
        {"keyframe": Keyframe(straight_line()), "controller": controller_named("projection")},
        {"controller": Geodesic(), "scene": None},
    ]
    states: list[Live] = []
    with started(problem(1)) as solver:
        now: dict[str, object] = {"keyframe": to_bent()}
        for number, change in enumerate(changes, start=2):
            now.update(change)
            solver.ask(problem(number, **now))  # type: ignore[arg-type]
            end = time.monotonic() + SOON
            while len(states) < 10 * number and time.monotonic() < end:
                live = solver.live
                if not states or live.steps > states[-1].steps:
                    states.append(live)
                time.sleep(0.002)
                if live.status == "converged":
                    break
        until(solver, arrived(len(changes) + 1))
    assert len(states) > 20
    for earlier, later in pairwise(states):
        moved = np.abs(later.state.positions - earlier.state.positions).max()
        assert moved <= SPEED * LIVE_ARM.step_time * (later.steps - earlier.steps) * (1.0 + 1e-9)


def test_speed_goes_on_where_a_new_scene_comes_in_between() -> None:
    most = 20.0
    slow = pp.Limits(step=None, dt=0.02, velocity=SPEED, acceleration=most)
    solver = Solver(problem(1, to_coil(), limits=slow), six_modules().straight())
    solver._take(solver._problem)
    places = [solver.live.state.positions]
    for step in range(40):
        if step % 5 == 4:
            ball = pp.Scene({"ball": pp.Sphere((2 * L, 0, 0.01 * step), 0.1)})
            solver._take(problem(step + 2, to_coil(), limits=slow, scene=ball))
        solver._step()
        places.append(solver.live.state.positions)
    speeds = np.diff(places, axis=0) / LIVE_ARM.step_time
    assert np.abs(speeds).max() > 0.5
    assert np.abs(np.diff(speeds, axis=0)).max() <= most * LIVE_ARM.step_time * (1.0 + 1e-6)


def test_at_once_is_at_once() -> None:
    with started(problem(1, at_once=True)) as solver:
        live = until(solver, lambda live: live.steps > 0)
        assert live.mean_error <= 1e-6 * L


def test_a_fault_in_a_controller_or_a_problem_ends_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    with started(problem(1, controller=Broken())) as solver:
        live = until(solver, lambda live: live.steps > 2)
        assert np.array_equal(live.state.q, six_modules().straight())
        solver.ask(problem(2, limits=pp.Limits(dt=0.02, velocity=np.ones(3))))  # the arm has 12 joints
        live = until(solver, lambda live: live.number == 2)
        assert live.verdict.target is None
        assert "velocity" in live.verdict.reason

        def fault(*given: object) -> None:
            raise KeyError("a fault")

        monkeypatch.setattr("pinposture.editor.solver.review", fault)  # the shape itself is known
        solver.ask(problem(3))
        live = until(solver, lambda live: live.number == 3)
        assert "a fault" in live.verdict.reason
        monkeypatch.undo()
        solver.ask(problem(4))
        until(solver, arrived(4))


def test_another_arm_begins_straight() -> None:
    other = pp.Arm.from_template("Rz", modules=4)
    line = Keyframe(pp.Curve.line((0, 0, 0), (other.length, 0, 0)))
    with started(problem(1)) as solver:
        until(solver, lambda live: live.steps > 3)
        solver.ask(problem(2, line, arm=other))
        live = until(solver, arrived(2))
        assert live.arm is other
        assert len(live.at_limit) == 4


def test_limits_of_a_step_are_those_of_as_long_a_time() -> None:
    limits = limits_per_step(pp.Limits(step=0.1, dt=0.1, velocity=2.0))
    assert (limits.dt, limits.velocity) == (LIVE_ARM.step_time, 2.0)
    assert limits.step == pytest.approx(0.1 * LIVE_ARM.step_time / 0.1)
    assert limits_per_step(pp.Limits(step=None, dt=0.1)).step is None


def test_no_thread_is_left() -> None:
    before = {thread.name for thread in threading.enumerate()}
    for _ in range(3):
        with started(problem(1)) as solver:
            until(solver, lambda live: live.steps > 2)
        solver.close()  # again
    end = time.monotonic() + SOON
    while {thread.name for thread in threading.enumerate()} - before and time.monotonic() < end:
        time.sleep(0.01)  # the last answer of the controller may be on its way
    assert not {thread.name for thread in threading.enumerate()} - before


@pytest.mark.soak
def test_a_shape_that_is_known_is_not_worked_out_again(monkeypatch: pytest.MonkeyPatch) -> None:
    judged: list[Keyframe] = []

    def counted(arm: pp.Arm, keyframe: Keyframe, *others: object) -> Verdict:
        judged.append(keyframe)
        return judge(arm, keyframe, *others)  # type: ignore[arg-type]

    monkeypatch.setattr("pinposture.editor.solver.judge", counted)
    with started(problem(1)) as solver:
        until(solver, arrived(1))
        for number, keyframe in enumerate((to_coil(), to_bent(), to_coil(), to_bent()), start=2):
            solver.ask(problem(number, keyframe))
            until(solver, arrived(number))
        assert judged == [to_bent(), to_coil()]
        passing = replace(to_coil(), name="passing")
        for number in (6, 7):  # what a hand only passed is not remembered
            solver.ask(problem(number, passing, shaping=True, passing=True))
            until(solver, arrived(number))
            solver.ask(problem(number + 2, to_bent()))
            until(solver, lambda live, number=number: live.number == number + 2)
        assert judged[2:] == [passing, passing]
        for number in (11, 12):  # nor is there need to look again at what could not be
            solver.ask(problem(number, short()))
            until(solver, lambda live, number=number: live.number == number)
            assert "too short" in solver.live.verdict.reason
        assert judged[4:] == [short()]


@pytest.mark.long
def test_the_arm_keeps_clear_of_an_obstacle_that_is_dragged_through_it(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    clock = [100.0]
    for module in ("obstacles", "session", "solver"):
        monkeypatch.setattr(f"pinposture.editor.{module}.time", SimpleNamespace(monotonic=lambda: clock[0]))
    monkeypatch.setattr(
        "pinposture.editor.solver.LIVE_ARM", LIVE_ARM._replace(deadline=np.inf)
    )  # not by the clock
    arm = six_modules()
    margin = 0.005
    speed = 0.2
    middle = arm.at(arm.straight()).points[3]
    start = np.array([0.0, 0.0, 0.3 * L])
    ball = pp.Sphere(tuple(middle + start), 0.06 * L)
    keyframes = (to_bent(), Keyframe(straight_line()))
    limits = pp.Limits(step=None, dt=LIVE_ARM.step_time, velocity=2.0, acceleration=20.0)
    scene = pp.Scene({"ball": ball}, margin=margin)
    session = Session(pp.Task(arm=arm, motion=keyframes, limits=limits, scene=scene))
    solver = Solver(session.problem, arm.straight())
    solver._take(session.problem)
    tracker = solver._tracker
    least = np.inf
    touched = np.inf
    for cycle in range(round(0.6 * L / speed / LIVE_ARM.step_time)):
        clock[0] += LIVE_ARM.step_time
        shift = -speed * cycle * LIVE_ARM.step_time * np.array([0.0, 0.0, 1.0])
        if cycle % 3 == 0:  # the hand is told of now and then
            change_obstacle("ball", partial(moved, shift=shift), "moved ball", False, session)
            solver._take(session.problem)
        solver._step()
        there = pp.Scene({"ball": moved(ball, shift)})
        least = min(least, CollisionModel(arm, there).minimum(solver.live.state.q).distance)
        touched = min(touched, CollisionModel(arm, there).minimum(arm.straight()).distance)
    assert solver._tracker is tracker  # nothing was prepared anew
    assert touched < -0.05 * L  # it went right through where the arm was
    assert least > 0.5 * margin
    change_obstacle("ball", partial(moved, shift=-2.0 * start), "moved ball", True, session)
    solver._take(session.problem)
    assert solver._tracker is not tracker
    for _ in range(400):
        clock[0] += LIVE_ARM.step_time
        solver._step()
    assert solver.live.status == "converged"


def test_an_arm_of_another_weight_goes_on_from_where_it_is() -> None:
    light = six_modules()
    solver = Solver(problem(1, at_once=True), light.straight())
    solver._take(problem(1, at_once=True))
    solver._step()
    bent = solver.live.state.q
    assert np.abs(bent).max() > 0.1
    heavy = light.with_payload(0.5).with_effort(3.0)
    solver._take(problem(2, arm=heavy, at_once=True))
    solver._step()
    assert solver.live.arm is heavy
    np.testing.assert_allclose(solver.live.state.q, bent, atol=1e-9)
