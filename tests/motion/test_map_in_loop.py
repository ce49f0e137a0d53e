"""Maps that change while an arm moves: paths that they cut, the margin, and threads."""

from __future__ import annotations

from threading import Thread

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp
from pinposture.collision.bodies import bodies_of

LIMITS = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=5.0)
BALL = 0.04


def a_situation() -> tuple[pp.Arm, np.ndarray, np.ndarray]:
    arm = pp.Arm.from_template("RyRz", modules=8)
    start = np.tile([0.0, -0.12], 8)
    return arm, start, -start


def on_ball(center: np.ndarray) -> np.ndarray:
    """Points on a ball, (2000, 3)."""
    directions = np.random.default_rng(0).normal(size=(2000, 3))
    return center + BALL * directions / np.linalg.norm(directions, axis=1)[:, None]


def gap(arm: pp.Arm, q: np.ndarray, center: np.ndarray) -> float:
    """Distance of the capsules of the bodies from the ball, placed by Pinocchio."""
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    gaps = []
    for body in bodies_of(arm):
        solid = body.shape.solid()
        a, b = (data.oMi[body.joint].act(end) for end in (solid.start, solid.end))
        share = np.clip((center - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        gaps.append(np.linalg.norm(center - a - share * (b - a)) - solid.radius - BALL)
    return float(min(gaps))


def test_a_path_that_a_map_cuts_is_planned_anew_at_once_and_no_other() -> None:
    arm, start, goal = a_situation()
    target = pp.Target.from_configuration(arm, goal)
    mapped = pp.Map(0.01, arm, own_margin=0.0)
    scene = pp.Scene({"map": mapped.cells}, margin=0.01)
    controller = pp.Geodesic(scene=scene)
    q = start
    memory = None
    for _ in range(15):
        step = controller.step(arm.at(q), target, LIMITS, memory)
        q = arm.integrate(q, step.dq)
        memory = step.memory
    before = memory.progress.path

    def after(center: np.ndarray) -> pp.JointPath:
        """The path after a picture of a ball."""
        seen = pp.Map(0.01, arm, own_margin=0.0)
        seen.add_cloud(on_ball(center), None, 0.0, q)
        other = controller.with_scene(scene.updated({"map": seen.cells}))
        stepped = other.step(arm.at(q), target, LIMITS, memory)
        assert np.any(stepped.dq)
        return stepped.memory.progress.path

    behind = arm.at(start).points[-1] + (0.0, -0.15, 0.1)
    assert np.array_equal(after(behind).offsets, before.offsets)
    ahead = arm.at(arm.straight()).points[-2] + (0.0, 0.06, 0.0)
    planned = after(ahead)
    assert not np.array_equal(planned.offsets, before.offsets)
    offsets = np.linspace(0.0, planned.end, 200)
    assert min(gap(arm, planned.configuration(place), ahead) for place in offsets) > 0.01
    assert min(gap(arm, before.configuration(place), ahead) for place in offsets) < 0.0


def test_an_arm_keeps_clear_of_what_its_map_shows_on_the_way() -> None:
    arm, q, goal = a_situation()
    mapped = pp.Map(0.01, arm)
    scene = pp.Scene({"map": mapped.cells}, margin=0.01)
    tracker = pp.Tracker(arm, limits=LIMITS, scene=scene)
    tracker.update(pp.Target.from_configuration(arm, goal))
    ball = arm.at(arm.straight()).points[-2] + (0.0, 0.06, 0.02)
    lowest = np.inf
    for cycle in range(400):
        moment = None
        if cycle % 5 == 4:
            seen = on_ball(ball) if cycle > 10 else np.zeros((0, 3))
            mapped.add_cloud(seen, None, cycle * 0.02, q)
            moment = scene.updated({"map": mapped.cells})
        dq = tracker.step(q, scene=moment)
        for share in (0.5, 1.0):
            lowest = min(lowest, gap(arm, arm.integrate(q, share * dq), ball))
        q = tracker.command
        if tracker.report.status == "converged":
            break
    assert tracker.report.status == "converged"
    assert 0.01 < lowest < 0.05


@pytest.mark.long
def test_a_thread_maps_while_another_moves_the_arm() -> None:
    arm, q, goal = a_situation()
    mapped = pp.Map(0.01, arm, forget=0.5)
    scene = pp.Scene({"map": mapped.cells}, margin=0.01)
    tracker = pp.Tracker(arm, limits=LIMITS, scene=scene)
    tracker.update(pp.Target.from_configuration(arm, goal))
    mapped.measure(q, 0.0)
    ball = arm.at(arm.straight()).points[-2] + (0.0, 0.06, 0.02)
    failures = []
    running = [True]
    pictures = [0]

    def see() -> None:
        try:
            while running[0]:
                time = mapped._history[-1][0]
                origin = np.array([0.0, 0.0, 0.3])
                mapped.add_cloud(on_ball(ball) - origin, pin.SE3(np.eye(3), origin), time)
                pictures[0] += 1
        except Exception as error:
            failures.append(error)

    thread = Thread(target=see)
    thread.start()
    try:
        for cycle in range(1, 300):
            tracker.step(q, scene=scene.updated({"map": mapped.cells}))
            q = tracker.command
            mapped.measure(q, cycle * 0.02)
            assert gap(arm, q, ball) > 0.005
    finally:
        running[0] = False
        thread.join()
    assert not failures and pictures[0] > 20
