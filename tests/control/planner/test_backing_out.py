"""An arm that finds itself inside an obstacle comes out at once, within its limits, and plans from there."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from sampling import seeds

import pinposture as pp
from pinposture.collision import CollisionModel
from pinposture.control.planner import geodesic

STEP = 0.02


def drawn(seed: int) -> tuple[pp.Arm, np.ndarray, pp.Scene]:
    """A bent arm, and a ball or a box that was put on it."""
    arm = template_arm("RyRz", 12)
    rng = np.random.default_rng(seed)
    q = arm.configuration(0.1 * rng.normal(size=arm.nv))
    place = arm.at(q).points[int(rng.integers(3, 12))] + 0.01 * rng.normal(size=3)
    size = float(rng.uniform(0.03, 0.08))
    kinds = pp.Sphere(tuple(place), size), pp.Box(tuple(place), (2 * size,) * 3)
    return arm, q, pp.Scene({"it": kinds[seed % 2]}, self_collision=False)


@pytest.mark.parametrize("seed", seeds(8))
def test_it_is_out_within_a_second_of_steps_and_plans_nothing_before(seed, monkeypatch):
    arm, q, scene = drawn(seed)
    distances = CollisionModel(arm, scene)
    planned = []
    plan = geodesic.find_path
    monkeypatch.setattr(geodesic, "find_path", lambda *a, **k: planned.append(True) or plan(*a, **k))
    controller = geodesic.Geodesic(scene=scene)
    target = pp.Target.from_configuration(arm, q)
    limits = pp.Limits(step=STEP)
    memory = None
    before = distances.minimum(q).distance
    assert before < 0.0
    for _ in range(50):
        step = controller.step(arm.at(q), target, limits, memory)
        if planned:
            break
        assert np.abs(step.dq).max() <= STEP + 1e-9
        assert any("margin" in words for words in step.violated_constraints)
        q = arm.integrate(q, step.dq)
        memory = step.memory
        now = distances.minimum(q).distance
        assert now > before  # by every step
        before = now
    assert planned
    assert before >= 0.0


@pytest.mark.long
def test_an_arm_that_an_obstacle_encloses_on_both_sides_stays_and_says_why():
    """A straight arm through the middle of a box: every small motion is along it, or turns within it."""
    arm = template_arm("RyRz", 20)
    box = pp.Scene({"box": pp.Box((0.5, 0.0, 0.0), (0.1, 0.2, 0.3))}, self_collision=False)
    q = arm.straight()
    goal = pp.Target.from_configuration(arm, arm.configuration(np.full(arm.nv, 0.1)))
    run = pp.track(arm, goal, q, scene=box)
    assert run.status == "stalled"
    assert run.steps == 0
    assert "in collision" in run.reason
    assert "to box: overlapping by" in run.reason
    tracker = pp.Tracker(arm, limits=pp.Limits(dt=0.02), scene=box)
    tracker.update(goal)
    assert not np.any(tracker.step(q))
    assert tracker.report.status == "stalled"
    assert "overlapping" in tracker.report.reason


@pytest.mark.long
def test_where_there_is_no_way_out_it_plans_and_says_why():
    arm = template_arm("RyRz", 3)
    q = arm.straight()
    walls = {f"wall{k}": pp.Box((0.07, 0.0, 0.0), (0.6, 0.6, 0.6)) for k in range(2)}
    scene = pp.Scene(walls, self_collision=False)
    run = pp.track(
        arm, pp.Target.from_configuration(arm, arm.configuration(np.full(arm.nv, 0.3))), q, scene=scene
    )
    assert run.status != "converged" or run.clearance.min() < 0.0
    assert run.reason
    assert np.all(np.isfinite(run.q))
