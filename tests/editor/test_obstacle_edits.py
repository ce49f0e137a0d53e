"""Obstacles in a session: each drag one step, refusals that change nothing, new ones where there is room."""

from __future__ import annotations

from dataclasses import replace
from functools import partial
from itertools import pairwise
from types import SimpleNamespace

import numpy as np
import pytest
from editor.solid_distances import signed_distance

import pinposture as pp
from pinposture.editor.obstacles import (
    NEW,
    add_obstacle,
    change_obstacle,
    delete_obstacle,
    edit_obstacle,
    moved,
    new_obstacle,
    new_obstacle_kinds,
    obstacles_of,
    rename_obstacle,
    select_obstacle,
)
from pinposture.editor.session import Session
from pinposture.errors import UnknownName


def session_of(arm: pp.Arm, scene: pp.Scene | None = None) -> Session:
    length = arm.length
    straight = pp.Curve.line([0, 0, 0], [length, 0, 0])
    bent = pp.Curve.spline(np.array([[0, 0, 0], [0.4, 0, 0], [0.8, 0.2, 0], [1.2, 0.3, 0]]) * length)
    keyframes = (pp.Keyframe(straight), pp.Keyframe(bent, time=2.0, trim=True))
    return Session(pp.Task(arm=arm, motion=keyframes, limits=pp.Limits(dt=0.02), scene=scene))


@pytest.fixture
def session() -> Session:
    return session_of(pp.Arm.from_template("RyRz", modules=6))


def test_a_drag_is_one_step_and_counts_at_its_end(session):
    points = session.arm.at(session.arm.straight()).points
    add_obstacle("sphere", points, session)
    first = session.task
    center = np.array(obstacles_of(first)["sphere_1"].center)
    for step in range(1, 5):
        shift = np.array([0.0, 0.0, 0.01 * step])
        change_obstacle("sphere_1", partial(_shift, shift), "moved sphere_1", False, session)
        assert session.task is first
        shown = obstacles_of(session.shown)["sphere_1"].center
        np.testing.assert_allclose(shown, center + shift, atol=1e-9)  # not one on top of the other
    change_obstacle("sphere_1", partial(_shift, np.array([0.0, 0.0, 0.05])), "moved sphere_1", True, session)
    assert session.proposal is None
    np.testing.assert_allclose(
        obstacles_of(session.task)["sphere_1"].center, center + [0, 0, 0.05], atol=1e-9
    )
    assert not session.task.scene.velocities
    session.undo()
    assert session.task is first
    session.redo()
    np.testing.assert_allclose(
        obstacles_of(session.task)["sphere_1"].center, center + [0, 0, 0.05], atol=1e-9
    )


def test_the_solver_is_told_of_each_move(session):
    add_obstacle("box", session.arm.at(session.arm.straight()).points, session)
    number = session.number
    for final in (False, False, True):
        change_obstacle("box_1", partial(_shift, np.array([0.0, 0.01, 0.0])), "moved", final, session)
        assert session.number > number
        number = session.number


@pytest.mark.parametrize("final", [False, True])
def test_an_obstacle_around_the_base_is_refused_and_changes_nothing(session, final):
    add_obstacle("sphere", session.arm.at(session.arm.straight()).points, session)
    before = session.task
    edit_obstacle("sphere_1", "center", tuple(session.arm.chain.base), final, session)
    assert session.task is before
    assert session.shown is before
    assert "base" in session.notice.text
    assert "sphere_1" in session.notice.text


def test_what_was_proposed_is_gone_when_its_end_is_refused(session):
    add_obstacle("sphere", session.arm.at(session.arm.straight()).points, session)
    before = session.task
    number = session.number
    change_obstacle("sphere_1", partial(_shift, np.array([0.0, 0.1, 0.0])), "moved", False, session)
    edit_obstacle("sphere_1", "radius", -1.0, True, session)
    assert session.shown is before
    assert session.number > number  # so that the solver goes back to it
    assert "radius" in session.notice.text


@pytest.mark.parametrize("kind", new_obstacle_kinds())
def test_a_dragged_obstacle_has_the_velocity_of_the_hand_and_a_resized_one_has_none(kind, monkeypatch):
    session = session_of(pp.Arm.from_template("RyRz", modules=6))
    clock = [100.0]
    for module in ("obstacles", "session"):
        monkeypatch.setattr(f"pinposture.editor.{module}.time", SimpleNamespace(monotonic=lambda: clock[0]))
    add_obstacle(kind, session.arm.at(session.arm.straight()).points, session)
    name = f"{kind}_1"
    hand = np.array([0.0, 0.0, -0.2])
    for step in range(12):
        clock[0] += 0.05
        change_obstacle(name, partial(_shift, hand * 0.05 * step), "moved it", False, session)
    scene = session.problem.scene
    assert scene.first is session.task.scene  # so that what was prepared for its distances is kept
    assert session.problem.dragging_obstacle
    np.testing.assert_allclose(scene.velocities[name], hand, rtol=0.01)
    expected = _shift(hand * 0.05 * 11, obstacles_of(session.task)[name])
    later = _shift(hand * (0.05 * 11 + 0.03), obstacles_of(session.task)[name])
    for moment, wanted in ((scene, expected), (scene.after(0.03), later)):
        for key in ("center", "start", "end", "point", "size", "radius", "normal"):
            if hasattr(wanted, key):
                found = getattr(moment.obstacles[name], key)
                np.testing.assert_allclose(found, getattr(wanted, key), atol=1e-4)
    clock[0] += 1.0  # the hand stood still
    change_obstacle(name, partial(_shift, hand * 0.6), "moved it", False, session)
    np.testing.assert_array_equal(session.problem.scene.velocities[name], 0.0)
    if kind == "sphere":
        clock[0] += 0.05
        change_obstacle(name, lambda ball: replace(ball, radius=0.1), "resized it", False, session)
        assert session.problem.scene.velocities == {name: (0.0, 0.0, 0.0)}
        assert session.problem.scene.obstacles[name].radius == 0.1


def test_a_drag_that_ends_where_it_began_is_no_step(session):
    add_obstacle("capsule", session.arm.at(session.arm.straight()).points, session)
    before = session.task
    change_obstacle("capsule_1", partial(_shift, np.zeros(3)), "moved", True, session)
    assert session.task is before


def test_renaming_keeps_order_and_selection(session):
    points = session.arm.at(session.arm.straight()).points
    for kind in ("sphere", "box", "sphere"):
        add_obstacle(kind, points, session)
    assert list(obstacles_of(session.task)) == ["sphere_1", "box_1", "sphere_2"]
    select_obstacle("box_1", session)
    rename_obstacle("box_1", " crate ", session)
    assert list(obstacles_of(session.task)) == ["sphere_1", "crate", "sphere_2"]
    assert session.obstacle == "crate"
    before = session.task
    rename_obstacle("crate", "sphere_2", session)
    assert session.task is before
    rename_obstacle("crate", "  ", session)
    assert session.task is before


def test_deleting_deselects_and_can_be_undone(session):
    add_obstacle("box", session.arm.at(session.arm.straight()).points, session)
    box = obstacles_of(session.task)["box_1"]
    delete_obstacle(session)
    assert obstacles_of(session.task) == {}
    assert session.obstacle is None
    session.undo()
    assert obstacles_of(session.task) == {"box_1": box}
    session.obstacle = None
    delete_obstacle(session)
    assert obstacles_of(session.task) == {"box_1": box}


def test_an_obstacle_is_selected_in_place_of_a_control_point(session):
    add_obstacle("box", session.arm.at(session.arm.straight()).points, session)
    session.handle = 2
    select_obstacle("box_1", session)
    assert (session.handle, session.obstacle) == (None, "box_1")
    select_obstacle("nothing of that name", session)
    assert session.obstacle == "box_1"


@pytest.mark.parametrize("modules", [2, 20])
@pytest.mark.parametrize("template", ["RyRz", "Rz"])
@pytest.mark.parametrize("kind", new_obstacle_kinds())
def test_new_obstacles_are_clear_of_the_arm(template, modules, kind):
    arm = pp.Arm.from_template(template, modules=modules)
    rng = np.random.default_rng(3)
    for _ in range(5):
        state = arm.at(rng.uniform(-0.4, 0.4, arm.nq))
        points = np.vstack([arm.chain.base, state.points])
        obstacle = new_obstacle(kind, arm, state.points, None)
        dense = np.vstack([np.linspace(a, b, 40) for a, b in pairwise(points)])
        assert signed_distance(obstacle, dense).min() > 0.9 * NEW.clear_room * arm.length


def test_new_obstacles_are_clear_of_each_other():
    session = session_of(pp.Arm.from_template("RyRz", modules=8))
    points = session.arm.at(session.arm.straight()).points
    for _ in range(4):
        add_obstacle("sphere", points, session)
    balls = list(obstacles_of(session.task).values())
    assert len(balls) == 4
    for k, ball in enumerate(balls):
        for other in balls[:k]:
            apart = np.linalg.norm(np.subtract(ball.center, other.center)) - ball.radius - other.radius
            assert apart > 0.0


def test_a_new_obstacle_of_a_planar_arm_is_in_its_plane():
    arm = pp.Arm.from_template("Rz", modules=8)
    points = arm.at(arm.straight()).points
    normal = np.cross(*arm.plane)
    assert new_obstacle("sphere", arm, points, None).center @ normal == pytest.approx(0.0, abs=1e-6)
    floor = new_obstacle("half_space", arm, points, None)
    assert np.array(floor.normal) @ normal == pytest.approx(0.0, abs=1e-6)


def test_no_other_kinds_can_be_made_new():
    arm = pp.Arm.from_template("RyRz", modules=2)
    with pytest.raises(UnknownName, match="sphere"):
        new_obstacle("torus", arm, arm.at(arm.straight()).points, None)


def _shift(shift, obstacle):
    return moved(obstacle, shift)


@pytest.mark.parametrize("kind", new_obstacle_kinds())
def test_a_planar_arm_that_is_closed_to_a_ring_leaves_room_beside_it(kind):
    arm = pp.Arm.from_template("Rz", 12)
    ring = np.array([[np.sin(a), 1.0 - np.cos(a), 0.0] for a in np.linspace(0.0, 2.0 * np.pi, 13)[1:]])
    points = ring * arm.length / (2.0 * np.pi)
    points[-1] = arm.chain.base  # the tip is where the base is
    obstacle = new_obstacle(kind, arm, points, None)
    assert signed_distance(obstacle, points).min() > 0.0
