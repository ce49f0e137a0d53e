"""Obstacles that the arm may touch: their distances, planning to a touch, and scenes that say so."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.errors import InvalidValue, UnknownName

MARGIN = 0.01
CUBE = np.array(np.meshgrid(*3 * [[-0.05, 0.05]])).reshape(3, 8).T
OPEN_FACES = [(0, 1, 2), (1, 2, 3)]
SHAPES = {
    "sphere": pp.Sphere((0.2, 0.1, 0.0), 0.05),
    "capsule": pp.Capsule((0.2, 0.1, -0.1), (0.2, 0.1, 0.1), 0.004),  # thinner than the margin
    "cylinder": pp.Cylinder((0.2, 0.1, -0.1), (0.2, 0.1, 0.1), 0.05),
    "box": pp.Box((0.2, 0.1, 0.0), (0.1, 0.1, 0.1), (0.1, 0.2, 0.3)),
    "half_space": pp.HalfSpace((0.0, 0.0, -0.1), (0.0, 0.1, 1.0)),
    "mesh": pp.Mesh(CUBE, center=(0.2, 0.1, 0.0)),
    "surface": pp.Mesh(CUBE, center=(0.2, 0.1, 0.0), faces=OPEN_FACES),
    "scan": pp.Scan(CUBE, center=(0.2, 0.1, 0.0), point_radius=0.002),
}


def scenes(shape: str) -> tuple[pp.Scene, pp.Scene]:
    """The same obstacle, not touchable and touchable, for an arm that ignores itself."""
    plain = pp.Scene({"it": SHAPES[shape]}, margin=MARGIN, self_collision=False)
    return plain, pp.Scene({"it": SHAPES[shape]}, False, MARGIN, touchable=["it"])


@pytest.mark.parametrize("shape", SHAPES)
def test_distances_count_from_two_margins_beneath_the_surface(shape):
    arm = template_arm("RyRz", 4)
    plain, touchable = (pp.CollisionModel(arm, scene) for scene in scenes(shape))
    if shape != "half_space":  # the arm is mounted on it, which may differ
        assert plain.pairs == touchable.pairs
    rng = np.random.default_rng(3)
    for _ in range(20):
        q = arm.random(rng)
        offsets = np.stack([np.zeros(arm.nv), rng.uniform(-0.2, 0.2, arm.nv)])
        asked = [
            lambda model, q=q: model.minimum(q).distance,
            lambda model, q=q: model.nearest(arm.at(q), np.inf).minimum,
            lambda model, q=q, offsets=offsets: model.minimum_on_motions(q, offsets).distance,
        ]
        for each, tolerance in zip(asked, (1e-9, 1e-9, 2e-4), strict=True):
            assert each(touchable) - each(plain) == pytest.approx(2.0 * MARGIN, abs=tolerance)
    moved = [scene.moved({"it": (0.0, 0.0, 0.05)}) for scene in scenes(shape)]
    apart = [pp.CollisionModel(arm, scene).minimum(q).distance for scene in moved]
    assert apart[1] - apart[0] == pytest.approx(2.0 * MARGIN, abs=1e-9)


@pytest.mark.long
def test_the_arm_goes_where_it_touches_and_around_what_it_may_not_touch():
    arm = template_arm("RyRz", 8)
    goal = arm.configuration([0.0, 0.1] * 8)
    tip = arm.at(goal).points[-1]
    radius = pp.CollisionModel(arm, pp.Scene(arm_radius=0.01)).solids[0][1].radius
    outward = np.array([-tip[1], tip[0], 0.0]) / np.linalg.norm(tip)
    # The last link presses into the ball by half of the margin.
    ball = pp.Sphere(tuple(tip + (0.05 + radius - 0.5 * MARGIN) * outward), 0.05)
    post = pp.Cylinder((0.25, 0.02, -1.0), (0.25, 0.02, 1.0), 0.01)
    target = pp.Target.from_configuration(arm, goal)
    ended = {}
    for touchable in ((), ("ball",)):
        scene = pp.Scene({"ball": ball, "post": post}, margin=MARGIN, arm_radius=radius, touchable=touchable)
        start = arm.configuration([0.0, 0.25] * 8)
        ended[touchable] = pp.track(arm, target, start, scene=scene)
        kept = pp.CollisionModel(arm, pp.Scene({"post": post}, margin=MARGIN, arm_radius=radius))
        assert min(kept.minimum(q).distance for q in ended[touchable].q) >= MARGIN - 1e-9
    assert ended[()].status != "converged"
    assert ended["ball",].status == "converged"
    assert not ended["ball",].faults


@pytest.mark.long
def test_motions_task_files_and_saved_motions_respect_what_is_touchable(tmp_path):
    arm = template_arm("RyRz", 8)
    goal = arm.configuration([0.0, 0.1] * 8)
    tip = arm.at(goal).points[-1]
    outward = np.array([-tip[1], tip[0], 0.0]) / np.linalg.norm(tip)
    ball = pp.Sphere(tuple(tip + (0.05 + 0.01 - 0.5 * MARGIN) * outward), 0.05)
    keyframes = [pp.Keyframe(joints=(0.0, 0.05) * 8), pp.Keyframe(joints=(0.0, 0.1) * 8, duration=2.0)]
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=4.0)
    for touchable in (["ball"], []):
        scene = pp.Scene({"ball": ball}, margin=MARGIN, arm_radius=0.01, touchable=touchable)
        task = pp.Task(arm, keyframes, limits, scene=scene)
        read = pp.Task.load(task.save(tmp_path / "task.toml"))
        assert read.scene == scene
        motion = pp.move_through(arm, keyframes, limits=limits, scene=read.scene)
        kept = pp.load(pp.save(motion, tmp_path / "motion.npz"))
        assert tuple(kept.run.scene.touchable) == tuple(touchable)
        assert bool(kept.faults) == (not touchable)


def test_scenes_keep_what_is_touchable():
    obstacles = {"ball": SHAPES["sphere"], "box": SHAPES["box"]}
    scene = pp.Scene(obstacles, touchable=["box", "ball", "box"])
    assert scene.touchable == ("ball", "box")
    assert scene != pp.Scene(obstacles)
    again = pp.Scene.from_dict(json.loads(json.dumps(scene.to_dict())))
    assert again == scene and hash(again) == hash(scene)
    assert pickle.loads(pickle.dumps(scene.moved({"box": (0.0, 0.0, 1.0)}))).touchable == scene.touchable
    assert scene.moved({"box": (0.0, 0.0, 1.0)}).touchable == scene.touchable
    assert scene.without_self_collision().touchable == scene.touchable
    assert scene.without_obstacles().touchable == ()
    assert scene.with_obstacles({"box": SHAPES["box"]}).touchable == ("box",)
    assert "ball, box" in repr(scene)
    with pytest.raises(UnknownName, match="bal"):
        pp.Scene(obstacles, touchable=["bal"])
    with pytest.raises(InvalidValue, match="touchable"):
        pp.Scene(obstacles, touchable="ball")
