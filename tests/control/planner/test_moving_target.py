"""Targets that move in every step, and the usual step in one call against the long way round."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from arms import template_arm
from sampling import seeds

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.control.planner import geodesic, goal
from pinposture.control.planner.follow import PathProgress
from pinposture.placement import Target

LIMITS = pp.Limits(step=0.04)


def arm() -> pp.Arm:
    return template_arm("RyRz", 8)


def postures(seed: int, steps: int, speed: float) -> list[np.ndarray]:
    """Configurations of a target that goes round."""
    rng = np.random.default_rng(seed)
    one, two = (smooth_configuration(arm(), rng, 0.8) for _ in range(2))
    return [np.cos(speed * k) * one + np.sin(speed * k) * two for k in range(steps)]


def followed(targets: list[Target], q: np.ndarray) -> tuple[np.ndarray, list[PathProgress]]:
    """Configurations of an arm that takes one step towards each target, and the progresses that it was on."""
    controller = pp.Geodesic()
    memory = None
    configurations = [q]
    progresses = []
    for target in targets:
        step = controller.step(arm().at(q), target, LIMITS, memory)
        q = arm().integrate(q, step.dq)
        memory = step.memory
        configurations.append(q)
        progresses.append(memory.progress)
    return np.array(configurations), progresses


@pytest.mark.parametrize("known", [True, False])
def test_a_target_that_moves_slowly_is_caught_and_kept(known: bool) -> None:
    wanted = postures(0, 250, 0.01)
    targets = [Target.from_configuration(arm(), q) for q in wanted]
    if not known:
        targets = [Target.from_points(arm(), target.points) for target in targets]
    q, progresses = followed(targets, smooth_configuration(arm(), np.random.default_rng(9), 0.8))
    assert np.abs(np.diff(q, axis=0)).max() <= 0.04 + 1e-12
    off = [
        np.linalg.norm(arm().at(a).points - t.points, axis=1).mean()
        for a, t in zip(q[1:], targets, strict=True)
    ]
    assert max(off[100:]) < 1e-6 * arm().length
    # On the way to it the way was bent far more often than it was planned.
    planned = [progress for progress in progresses if progress is not None]  # none for one short step
    lengths = [len(progress.path.offsets) for progress in planned]
    bent = sum(a.path.start is b.path.start for a, b in pairwise(planned))
    assert progresses[-1] is None
    assert max(lengths) > 20 and bent > 5


def test_a_way_that_is_bent_ends_where_the_target_is_and_begins_where_the_arm_was() -> None:
    wanted = postures(1, 2, 0.02)
    first, second = (Target.from_configuration(arm(), q) for q in wanted)
    start = smooth_configuration(arm(), np.random.default_rng(3), 0.8)
    _, (before, after) = followed([first, second], start)
    assert after.path.start is before.path.start and after.bend is not None
    np.testing.assert_allclose(after.path.configuration(after.path.end), wanted[1], atol=1e-12)
    moved = after.path.offset(before.s) - before.path.offset(before.s)
    assert np.abs(moved).max() < 0.02 * np.abs(after.bend).max()


def test_a_target_that_jumps_gets_a_way_of_its_own() -> None:
    rng = np.random.default_rng(4)
    one, two = (smooth_configuration(arm(), rng, 1.0) for _ in range(2))
    targets = [Target.from_configuration(arm(), q) for q in (one, two)]
    _, (before, after) = followed(targets, arm().neutral())
    assert after.path.start is not before.path.start and after.bend is None
    np.testing.assert_allclose(after.path.configuration(after.path.end), two, atol=1e-12)


def test_points_that_cannot_be_had_do_not_start_the_search_anew_in_each_step(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = []
    original = goal.initial_guesses
    monkeypatch.setattr(goal, "initial_guesses", lambda *given: asked.append(1) or original(*given))
    rng = np.random.default_rng(5)
    points = arm().at(postures(2, 1, 0.0)[0]).points
    targets = [Target.from_points(arm(), points + 1e-3 * rng.normal(size=points.shape)) for _ in range(150)]
    q, _ = followed(targets, arm().neutral())
    assert len(asked) < 15  # noise now and then is twice as bad as before
    assert np.linalg.norm(arm().at(q[-1]).points - points, axis=1).mean() < 3e-3


@pytest.mark.parametrize("seed", seeds(12))
def test_points_that_can_be_had_are_found_after_points_that_could_not(seed: int) -> None:
    rng = np.random.default_rng(seed)
    one, two = (smooth_configuration(arm(), rng, 1.2) for _ in range(2))
    beyond = Target.from_points(arm(), 1.3 * arm().at(one).points)
    within = Target.from_points(arm(), arm().at(two).points)
    _, progresses = followed([beyond] * 3 + [within], arm().neutral())
    path = progresses[-1].path
    end = arm().at(path.configuration(path.end)).points
    assert np.linalg.norm(end - within.points, axis=1).mean() < 1e-6 * arm().length


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("acceleration", (None, 10.0))
@pytest.mark.parametrize("among_obstacles", (False, True))
def test_the_usual_step_in_one_call_is_that_of_the_long_way_round(
    seed: int, acceleration: float | None, among_obstacles: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = LIMITS if acceleration is None else pp.Limits(velocity=2.0, acceleration=acceleration, dt=0.02)
    rng = np.random.default_rng(seed)
    start, end = (smooth_configuration(arm(), rng, 1.0) for _ in range(2))
    target = Target.from_configuration(arm(), end)
    ball = pp.Sphere((0.1, 0.0, 0.9 * arm().length), 0.05)
    controller = pp.Geodesic(scene=pp.Scene({"ball": ball}) if among_obstacles else None)
    q = start
    memory = None
    quick = geodesic.fast_step
    taken = 0
    for _ in range(40):
        state = arm().at(q)
        step = controller.step(state, target, limits, memory)
        if step.reason:
            break
        monkeypatch.setattr(geodesic, "fast_step", lambda *_, **__: None)
        slow = controller.step(state, target, limits, memory)
        monkeypatch.setattr(geodesic, "fast_step", quick)
        bounds = limits.for_arm(arm())
        taken += memory is not None and quick(memory.progress, state, bounds, memory.dq) is not None
        np.testing.assert_allclose(step.dq, slow.dq, atol=1e-13)
        assert step.active == slow.active
        for name in set(step._fields) - {"dq", "memory"}:
            assert np.all(getattr(step, name) == getattr(slow, name)), name
        alone = step.memory.progress._replace(taken=0)
        for ours, theirs in zip(alone, slow.memory.progress, strict=True):
            if isinstance(ours, (float, int, bool)):
                assert ours == pytest.approx(theirs, abs=1e-12)
        q = arm().integrate(q, step.dq)
        memory = step.memory
    assert taken > 5


def test_an_arm_that_was_pushed_aside_begins_anew() -> None:
    target = Target.from_configuration(arm(), postures(6, 1, 0.0)[0])
    controller = pp.Geodesic()
    q = arm().neutral()
    first = controller.step(arm().at(q), target, LIMITS)
    pushed = arm().integrate(q, first.dq)
    pushed[3] += 0.2
    again = controller.step(arm().at(pushed), target, LIMITS, first.memory)
    np.testing.assert_array_equal(again.memory.progress.path.start, pushed)


@pytest.mark.parametrize("seed", range(4))
def test_steps_computed_ahead_are_those_of_one_call_each(seed: int) -> None:
    """On the path, and off it, where none ahead is taken; whatever is done to the array of a step."""
    rng = np.random.default_rng(seed)
    start, end = (smooth_configuration(arm(), rng, 1.0) for _ in range(2))
    target = Target.from_configuration(arm(), end)
    controller = pp.Geodesic()
    q = start
    memory = None
    ahead = 0
    for number in range(20):
        if number % 7 == 6:  # something pushes it
            q = arm().integrate(q, rng.uniform(-0.02, 0.02, arm().nv))
        state = arm().at(q)
        step = controller.step(state, target, LIMITS, memory)
        if memory is not None:
            alone = replace(memory, progress=memory.progress._replace(ahead=None))
            other = controller.step(state, target, LIMITS, alone)
            np.testing.assert_allclose(step.dq, other.dq, atol=1e-14)
            assert step.error_increasing == other.error_increasing
            ahead += step.memory.progress.taken > 1
        q = arm().integrate(q, step.dq)
        memory = step.memory
        again = controller.step(arm().at(q), target, LIMITS, memory).dq.copy()
        controller.step(arm().at(q), target, LIMITS, memory).dq[:] = 7.0
        np.testing.assert_array_equal(controller.step(arm().at(q), target, LIMITS, memory).dq, again)
    assert ahead > 5


def test_a_held_tip_follows_a_moving_target_without_a_joint_that_is_locked() -> None:
    arm = pp.Arm.from_template("RyRz", modules=6)
    bent = np.array([0.2, -0.1] * 6)
    arm = arm.with_locked({arm.joint_names[5]: -0.1})
    tip = replace(pp.EndEffector.held(arm.at(bent)), priority=True)
    controller = pp.Geodesic(tasks=(tip,))
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=4.0)
    q = bent
    memory = None
    ends = set()
    for k in range(20):
        aside = 0.002 * np.sin(0.2 * k) * np.eye(12)[0]
        target = pp.Target.from_points(arm, arm.at(bent + aside).points)
        step = controller.step(arm.at(q), target, limits, memory)
        q = arm.integrate(q, step.dq)
        memory = step.memory
        ends.add(memory.progress.path.end)
    assert 1.0 in ends  # it goes straight there, as it is near
    np.testing.assert_allclose(arm.at(q).points[-1], arm.at(bent).points[-1], atol=1e-6)
