"""Phases in which an arm wraps around an object, carries it, and lets go of it."""

from __future__ import annotations

from functools import cache
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp
from pinposture.collision import CollisionModel
from pinposture.editor.edits import with_obstacle
from pinposture.editor.phases import editable, phase_label
from pinposture.errors import FileError, TaskError
from pinposture.motion.held import HeldObject
from pinposture.motion.run import closest

FILE = Path(__file__).parents[2] / "examples" / "tasks" / "wrap.toml"


@cache
def performed() -> tuple[pp.Task, pp.Trajectory]:
    task = pp.Task.load(FILE)
    return task, task.perform()


def frame(arm: pp.Arm, q: np.ndarray, name: str) -> pin.SE3:
    state = arm.at(q)
    index = arm.control_points.index(name)
    return pin.SE3(np.array(state.rotations[index]), np.array(state.points[index]))


@pytest.mark.soak
def test_the_can_moves_with_the_arm_from_where_it_stood_to_where_it_is_put():
    task, motion = performed()
    arm = motion.arm
    run = motion.run
    assert not motion.faults
    assert not motion.deviations
    assert [each.name for each in motion.waypoints] == [
        "grasp: approach",
        "grasp",
        "lift",
        "aside",
        "down",
        "let go",
    ]
    assert {each.obstacle for each in run.held} == {"can"}
    assert all(one.end == other.begin for one, other in zip(run.held[:-1], run.held[1:], strict=True))
    start = pin.SE3(np.eye(3), np.array([0.42, 0.12, 0.0]))
    begin = run.held[0].begin
    end = run.held[-1].end
    name = run.held[0].frame
    for row in range(0, len(run.q), 10):
        # The frame that holds it has moved as the can has.
        held = run.q[min(max(row, begin), end)]
        moved = frame(arm, held, name) * frame(arm, run.q[begin], name).inverse()
        scene = run.scene_in(row, task.scene)
        carried = scene.carried.get("can")
        can = scene.obstacles["can"].pose(np.zeros(3))
        if carried is not None:
            can = frame(arm, run.q[row], name) * carried.placement.inverse() * can
        np.testing.assert_allclose(can.translation, (moved * start).translation, atol=1e-9)
        assert (carried is not None) == (begin <= row < end)
    np.testing.assert_allclose(
        run.final_scene.obstacles["can"].pose(np.zeros(3)).translation, (0.32, 0.27, 0.0), atol=2e-4
    )
    # Before it winds and after it has let go, the arm keeps the margin to the can.
    for rows in (range(begin), range(end, len(run.q))):
        for row in rows:
            alone = pp.Scene({"can": run.scene_in(row, task.scene).obstacles["can"]}, self_collision=False)
            assert CollisionModel(arm, alone).minimum(run.q[row]).distance >= task.scene.margin - 1e-6


@pytest.mark.soak
def test_the_motion_is_judged_saved_and_loaded_with_what_the_arm_holds(tmp_path):
    _, motion = performed()
    again = pp.load(pp.save(motion, tmp_path / "motion"))
    assert again.run.held == motion.run.held
    assert again.faults == ()
    assert closest(again.run) == closest(motion.run)
    assert closest(again.run)["smallest"] >= 0.0
    file = tmp_path / "damaged.npz"
    stored = dict(np.load(tmp_path / "motion.npz"))
    about = str(stored.pop("about")).replace('"begin": ', '"begin": 9')
    np.savez(file, about=np.array(about), **stored)
    with pytest.raises(FileError, match="held"):
        pp.load(file)


@pytest.mark.long
def test_postures_are_checked_with_the_can_where_it_then_is():
    task = pp.Task.load(FILE)
    # A ball where the can is carried: the arm would miss it, the can does not.
    hit = with_obstacle("ball", pp.Sphere((0.32, 0.27, 0.33), 0.02))(task)
    with pytest.raises(
        TaskError, match=r"phase 3 'aside': carry 'can': .* % of the way: can comes within the margin of ball"
    ):
        hit.reference()
    reference = task.reference()
    found = {each.name: each for each in task.feasibility(reference)}
    assert all(not each.crowding(task.scene.margin) for each in found.values())
    assert reference.held[0].begin > 0
    assert reference.held[-1].end == reference.rows - 1
    held = pp.Task(task.arm, task.motion[:2], task.limits, scene=task.scene).reference()
    assert held.held[-1].end == held.rows  # to the end


def test_phases_read_back_the_same_and_the_editor_keeps_them(tmp_path):
    task = pp.Task.load(FILE)
    turned = pp.Phase(pp.Carrying((0.4, 0.1, 0.2), turn=(0.0, 0.1, 0.2), onto=["floor"]), "turn")
    changed = task.edited(motion=(*task.motion[:2], turned, pp.Phase(pp.Release())))
    for suffix in (".toml", ".json"):
        assert pp.Task.load(changed.save(tmp_path / f"task{suffix}")).motion == changed.motion
    kinds = [phase_label(task.motion, index) for index in range(5)]
    assert kinds[0] == "1 grasp  ·  around an object"
    assert kinds[1] == "2 lift  ·  carries it"
    assert kinds[4] == "5 let go  ·  lets go of it"


@pytest.mark.long
def test_the_editor_shows_where_phases_begin_and_end_and_saves_them_as_they_were(tmp_path):
    task = pp.Task.load(FILE)
    lift = editable(task, 1)
    assert lift.begin is not None
    assert lift.end is not None
    points = [
        task.arm.at(task.arm.configuration(np.array(each.joints))).points for each in (lift.begin, lift.end)
    ]
    np.testing.assert_allclose(points[1][-1] - points[0][-1], (0.0, 0.0, 0.2), atol=2e-3)
    kept = lift.save(tmp_path / "wrap.toml")
    assert kept.read_text() == FILE.read_text()


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('obstacle = "can"', 'obstacle = "tin"', "line 31: phase 1 'grasp': .*tin"),
        (
            'touchable = ["can"]',
            "touchable = []",
            "line 31: phase 1 'grasp': obstacle is 'can'; allowed: one that may be touched",
        ),
        ("turns = 0.9", "turns = 0", "phase 1, wrap.turns: is 0"),
        ("turns = 0.9", "turn = 0.9", "phase 1, wrap.turn: there is no such key (did you mean 'turns'?)"),
        ("friction = 0.5", "friction = -1", "phase 1, wrap.friction: is -1"),
        (
            'wrap = { obstacle = "can", turns = 0.9, friction = 0.5 }',
            "release = {}",
            "phase 1 'grasp': release is",
        ),
        (
            "carry = { position = [0.42, 0.12, 0.2] }",
            "reach = { position = [0.42, 0.12, 0.2] }",
            "phase 2 'lift': motion is .*holds 'can'",
        ),
        (
            "position = [0.42, 0.12, 0.2]",
            "place = [0.42, 0.12, 0.2]",
            "phase 2, carry.place: there is no such key",
        ),
        (
            "[0.32, 0.27, 0.2]",
            "[0.32, 0.27]",
            "phase 3, carry.position: is [0.32, 0.27]; allowed: a list of 3",
        ),
        ('onto = ["floor"]', 'onto = ["table"]', "phase 4 'down': .*table"),
        ("release = {}", "release = { speed = 1 }", "phase 5, release.speed: there is no such key"),
    ],
)
def test_mistakes_in_a_file_are_named_with_the_phase(old, new, words, tmp_path):
    text = FILE.read_text()
    assert old in text
    file = tmp_path / "task.toml"
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(FileError) as caught:
        pp.Task.load(file)
    for part in words.split(".*"):
        assert part in str(caught.value)


@pytest.mark.long
def test_what_the_arm_cannot_do_is_named_with_the_line_of_the_file(tmp_path):
    file = tmp_path / "task.toml"
    file.write_text(FILE.read_text().replace(', onto = ["floor"]', ""))
    with pytest.raises(FileError, match=r"line 43: phase 4 'down': carry 'can': .*can comes within .*floor"):
        pp.Task.load(file).reference()


def test_a_part_of_a_motion_in_which_something_is_held_is_moved_with_it():
    assert HeldObject("can", "tip", 2, 5).shifted(3) == HeldObject("can", "tip", 5, 8)
