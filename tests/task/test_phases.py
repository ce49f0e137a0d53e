"""Phases: one motion through insertion, goals of the tip, keyframes and withdrawal, at rest at every join."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np
import pytest

import pinposture as pp
from pinposture.errors import FileError, InvalidValue, TaskError
from pinposture.task import Leader, Phase, TipGoal, Withdrawal
from pinposture.task.reference import Reference

FILE = Path(__file__).parents[2] / "examples" / "tasks" / "inspection.toml"


@cache
def loaded() -> pp.Task:
    return pp.Task.load(FILE)


@cache
def performed() -> tuple[Reference, pp.Trajectory]:
    reference = loaded().reference()
    return reference, loaded().perform(reference)


@cache
def fed() -> pp.Arm:
    return loaded().arm.from_spec(loaded().arm.spec)  # type: ignore[arg-type]


def small(*phases: Phase, **changes: object) -> pp.Task:
    """A task without obstacles."""
    return pp.Task(fed(), phases, replace(loaded().limits, dt=0.1), **changes)  # type: ignore[arg-type]


def path() -> pp.Curve:
    return pp.Curve.spline([(0, 0, 0), (0.1, 0, 0), (0.2, 0, 0), (0.3, 0.05, 0), (0.35, 0.15, 0.05)])


def into(**options: object) -> Phase:
    return Phase(Leader(path(), **{"speed": 0.1, **options}), "in")  # type: ignore[arg-type]


@pytest.mark.long
def test_the_example_goes_in_looks_sweeps_and_comes_out_within_limits_and_clear() -> None:
    _, motion = performed()
    assert motion.faults == ()
    assert [each.name for each in motion.waypoints] == [
        "insert: inside",
        "look",
        "sweep: below",
        "out: back on the path",
        "out: outside",
    ]
    arm = loaded().arm
    scene = loaded().scene
    assert scene is not None
    clear = pp.CollisionModel(arm, scene)
    assert min(clear.minimum(q).distance for q in motion.q) >= scene.margin * (1 - 1e-6)
    # The tip is where it looks, the curve and the path where the file has them, and the arm where it began.
    rows = {each.name: each.row for each in motion.waypoints}
    tip = arm.at(motion.q[rows["look"]]).points[-1]
    assert tip == pytest.approx((1.3, 0.15, 0.2), abs=1e-4)
    there = pp.path_deviation(
        arm, motion.q[: rows["insert: inside"]], loaded().motion[0].motion.path, "as_is"
    )
    assert there.largest < 1e-3
    back = motion.q[rows["out: back on the path"] :]
    assert pp.path_deviation(arm, back, loaded().motion[0].motion.path, "as_is").largest < 1e-3
    assert motion.q[-1] == pytest.approx(arm.straight() * 0.0, abs=1e-5)
    # The limits hold across the joins, by differences of the joint positions.
    dt = motion.dt
    q = motion.q
    speed = np.diff(q, axis=0) / dt
    assert np.abs(speed[:, 1:]).max() <= 1.0 + 1e-9
    assert np.abs(speed[:, 0]).max() <= 0.1 + 1e-9
    bends = np.diff(np.vstack([0 * speed[:1], speed, 0 * speed[:1]]), axis=0) / dt
    assert np.abs(bends[:, 1:]).max() <= 4.0 * (1 + 1e-6)


def test_the_plan_is_at_rest_at_every_join() -> None:
    reference, _ = performed()
    speeds = np.abs(np.diff(reference.offsets, axis=0)).max(axis=1) / np.diff(reference.times)
    for waypoint in reference.waypoints:
        around = speeds[max(waypoint.row - 1, 0) : waypoint.row + 1]
        assert around.max() < 0.03 * speeds.max(), waypoint.name
    assert reference.duration == pytest.approx(reference.times[-1])
    assert np.abs(np.diff(reference.offsets, axis=0)).max() < 0.08  # no jump


@pytest.mark.long
def test_withdrawal_is_the_insertion_in_reverse() -> None:
    task = small(into(), Phase(Withdrawal(speed=0.05), "out"))
    there = small(into()).reference()
    both = task.reference()
    count = there.rows
    assert both.rows == 2 * count - 1
    assert both.offsets[count - 1 :] == pytest.approx(there.offsets[::-1], abs=1e-12)
    assert both.duration == pytest.approx(3 * there.duration)  # at half the speed


def test_keyframes_begin_where_the_phase_before_ended() -> None:
    bent = np.linspace(0.0, 0.2, fed().nv)
    taught = pp.Keyframe(joints=tuple(bent), duration=2.0, name="taught")
    reference = small(into(), Phase((taught,), "turn"), Phase(Withdrawal(), "out")).reference()
    waypoints = {waypoint.name: reference.configuration(waypoint.row) for waypoint in reference.waypoints}
    assert waypoints["turn: taught"] == pytest.approx(bent)
    assert waypoints["out: back on the path"] == pytest.approx(waypoints["in: inside"], abs=1e-9)
    assert waypoints["out: outside"] == pytest.approx(reference.start, abs=1e-9)


@pytest.mark.parametrize("aim", [{}, {"direction": (0.0, 0.0, 1.0)}, {"rotation": (0.1, -0.4, 0.5)}])
def test_the_tip_is_at_its_goal_and_moves_there_straight(aim: dict[str, tuple[float, ...]]) -> None:
    goal = TipGoal((0.95, 0.15, 0.2), duration=4.0, hold=0.5, **aim)  # type: ignore[arg-type]
    reference = small(into(depth=0.2), Phase(goal, "look")).reference()
    first = reference.waypoints[0].row
    last = reference.waypoints[1].row
    tips = np.array([fed().at(reference.configuration(row)).points[-1] for row in range(first, last + 1)])
    assert tips[-1] == pytest.approx(goal.position, abs=1e-5)
    ahead = (tips[-1] - tips[0]) / np.linalg.norm(tips[-1] - tips[0])
    aside = tips - tips[0] - ((tips - tips[0]) @ ahead)[:, None] * ahead
    assert np.linalg.norm(aside, axis=1).max() < 2e-3
    assert reference.times[last] - reference.times[first] == pytest.approx(4.5)
    turned = fed().at(reference.configuration(last)).rotations[-1]
    if "direction" in aim:
        assert turned[:, 0] == pytest.approx((0, 0, 1), abs=1e-4)
    if "rotation" in aim:
        import pinocchio as pin

        assert turned == pytest.approx(pin.rpy.rpyToMatrix(*aim["rotation"]), abs=1e-4)


@pytest.mark.long
def test_the_tip_goes_to_a_posture_of_low_torque() -> None:
    shares = {}
    arm = fed().with_effort(
        {name: 100.0 if slides else 1.0 for name, slides in zip(fed().joint_names, fed().slides, strict=True)}
    )
    for objective in ("dexterity", "torque"):
        goal = TipGoal((0.95, 0.15, 0.2), objective=objective)  # type: ignore[arg-type]
        task = replace(small(into(depth=0.2), Phase(goal, "look")), arm=arm)
        reference = task.reference()
        at = arm.at(reference.configuration(reference.waypoints[1].row))
        assert at.points[-1] == pytest.approx(goal.position, abs=1e-5)
        load = at.most_loaded()
        assert load is not None
        shares[objective] = load.share
    assert shares["torque"] < 0.8 * shares["dexterity"]


@pytest.mark.long
def test_one_verdict_names_the_phase_that_failed() -> None:
    sweep = pp.Keyframe(joints=tuple(np.r_[0.3, np.zeros(fed().nv - 1)]), duration=1.0, name="straight")
    curl = pp.Keyframe(joints=tuple(np.r_[0.0, np.full(fed().nv - 1, 0.05)]), name="curl")
    around = pp.Scene({"ball": pp.Sphere((1.15, 0.0, 0.0), 0.05)}, margin=0.005, arm_radius=0.01)
    phases = (Phase((curl, replace(curl, duration=1.0)), "wait"), Phase((sweep,), "sweep"))
    task = small(*phases, scene=around)
    with pytest.warns(pp.PostureWarning, match="sweep: straight: .* and ball would penetrate"):
        motion = task.perform()
    assert not motion.converged
    assert "on the way to sweep: straight" in motion.run.reason
    assert motion.waypoints[1].reached is not None
    assert motion.waypoints[2].reached is None


@pytest.mark.parametrize(
    ("phases", "words"),
    [
        (
            lambda: (Phase(Withdrawal(), "out"),),
            "phase 1 'out': withdrawal is .* one after a leader that does not return",
        ),
        (lambda: (into(), Phase(Withdrawal()), Phase(Withdrawal())), "phase 3: withdrawal is"),
        (lambda: (into(and_back=True), Phase(Withdrawal())), "phase 2: withdrawal is"),
        (
            lambda: (Phase((pp.Keyframe(path()),), "one"),),
            "phase 1 'one': keyframes is 1; allowed: two or more",
        ),
        (lambda: (into(pipe=0.012),), "phase 1 'in': pipe is 0.012; allowed: .* are missing"),
        (lambda: (into(speed=-1.0),), "speed is -1.0; allowed: more than 0"),
        (lambda: (into(), pp.Keyframe(path())), "allowed: only phases, or only keyframes"),
    ],
)
def test_phases_that_make_no_motion_are_refused(phases: Callable[[], tuple[Phase, ...]], words: str) -> None:
    with pytest.raises(pp.PostureError, match=words):
        small(*phases())


@pytest.mark.parametrize(
    ("phases", "words"),
    [
        (lambda: (into(), into()), "phase 2 'in': start is .*joints bent"),
        (lambda: (into(), Phase(TipGoal((9.0, 0, 0)), "far")), "phase 2 'far': .*from the base"),
        (lambda: (into(), Phase(TipGoal((1e8, 0, 0)))), "phase 2: the tip cannot reach .*millimetres"),
        (
            lambda: (into(), Phase((pp.Keyframe(path()),), "when")),
            "'when': keyframe 1.*: it has neither a time nor",
        ),
        (lambda: (into(depth=0.9),), "phase 1 'in': depth is 0.9"),
    ],
)
def test_a_phase_that_the_arm_cannot_perform_is_named(
    phases: Callable[[], tuple[Phase, ...]], words: str
) -> None:
    with pytest.raises(TaskError, match=words):
        small(*phases()).reference()


@pytest.mark.parametrize(
    "bad",
    [
        lambda: TipGoal((0, 0)),
        lambda: TipGoal((0, 0, np.nan)),
        lambda: TipGoal((0, 0, 0), direction=(0, 0, 0)),
        lambda: TipGoal((0, 0, 0), direction=(1, 0, 0), rotation=(0, 0, 0)),
        lambda: TipGoal((0, 0, 0), duration=0.0),
        lambda: TipGoal((0, 0, 0), hold=-1.0),
        lambda: TipGoal((0, 0, 0), budget=0.0),
        lambda: Withdrawal(0.0),
        lambda: Phase(()),
        lambda: Phase("leader"),  # type: ignore[arg-type]
        lambda: Phase(Withdrawal(), name=3),  # type: ignore[arg-type]
    ],
)
def test_bad_values_are_refused(bad: object) -> None:
    with pytest.raises(InvalidValue):
        bad()  # type: ignore[operator]


# Files.


def test_a_file_of_phases_is_saved_to_the_last_byte_and_edited_in_place(tmp_path: Path) -> None:
    file = tmp_path / "inspection.toml"
    loaded().save(file)
    assert file.read_text() == FILE.read_text()
    first, look, *rest = loaded().motion
    goal = replace(look.motion, hold=2.0)
    edited = loaded().edited(motion=(first, replace(look, motion=goal), *rest), continuity="acceleration")
    edited.save(file)
    again = pp.Task.load(file)
    assert again.motion == edited.motion
    before = FILE.read_text().splitlines()
    after = file.read_text().splitlines()
    assert 1 <= len(set(before) - set(after)) <= 2
    assert sum("#" in line for line in after) == sum("#" in line for line in before)


@pytest.mark.parametrize("suffix", [".toml", ".json"])
def test_phases_made_in_python_read_back_the_same(tmp_path: Path, suffix: str) -> None:
    frames = (pp.Keyframe(path(), duration=1.0, trim=True), pp.Keyframe(joints=(0.0,) * fed().nv, time=3.0))
    goals = (
        Phase(TipGoal((0.9, 0.1, 0.2), direction=(0, 0, 1), duration=2.0), "up"),
        Phase(TipGoal((0.9, 0.1, 0.2), rotation=(0.1, 0.2, 0.3), budget=1.0)),
    )
    task = small(
        into(depth=0.2, pipe=0.045), *goals, Phase(frames, "frames"), Phase(Withdrawal(0.03)), name="all"
    )
    again = pp.Task.load(task.save(tmp_path / f"all{suffix}"))
    assert again.motion == task.motion


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        (
            'name = "look"\nreach',
            'name = "look"\nreech',
            "line 56: phase 2, reech: there is no such key (did you mean",
        ),
        ("reach = {", "withdraw = {}\nreach = {", "phase 2, withdraw: does not go with 'reach'"),
        ("hold = ", "held = ", "phase 2, reach.held: there is no such key (did you mean 'hold'?)"),
        (
            'speed = "8 cm/s"',
            'speed = "8 cm"',
            "line 51: phase 1, leader.speed: is '8 cm', of the kind length",
        ),
        ('duration = "3 s"', 'duration = "3 m"', "phase 3, keyframe 1, duration: is '3 m'"),
        (
            'kind = "phases"',
            'kind = "keyframes"',
            "phases: goes with kind = 'phases'; the kind is 'keyframes'",
        ),
        ('depth = "0.5 m"', 'depth = "0.9 m"', "line 46: phase 1 'insert': depth is 0.9"),
        ("[1.3, 0.15, 0.2]", "[1.3, -0.05, 0.2]", "phase 2 'look': .*is inside post"),
        ("[1.3, 0.15, 0.2]", "[1.3, 0.15]", "phase 2, reach.position: is [1.3, 0.15]; allowed: a list of 3"),
    ],
)
def test_mistakes_in_a_file_are_named_with_the_phase(tmp_path: Path, old: str, new: str, words: str) -> None:
    file = tmp_path / "task.toml"
    text = FILE.read_text()
    assert old in text
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(FileError) as caught:
        pp.Task.load(file).reference()
    for part in words.split(".*"):
        assert part in str(caught.value)


def test_a_motion_in_phases_is_saved_exported_and_simulated_as_any_other(tmp_path: Path) -> None:
    _, motion = performed()
    file = tmp_path / "motion.npz"
    pp.save(motion, file)
    again = pp.load(file)
    assert again.waypoints == motion.waypoints
    assert np.array_equal(again.q, motion.q)
    assert motion.joint_trajectory().time[-1] >= motion.time[-1]  # and a row of rest
