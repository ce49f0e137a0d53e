"""Ways are planned, shown, driven while they are held, and driven back; a joint that sticks is led around."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from operate.test_operation import Desk, bent_arm, fed_arm

import pinposture as pp
from pinposture.errors import TaskError, UnknownName
from pinposture.operate import SimulatedArm
from pinposture.operate.ways import CurveAlong, read_steps

pytestmark = pytest.mark.long


def along(desk: Desk, share: float, number: int | None = None) -> None:
    shown = desk.operation.shown.planned.number if number is None else number
    desk.tell(do="hold", ahead=0, left=0, up=0, override=1, along=share, way=shown)


def planned(desk: Desk) -> None:
    """Wait until a way that was asked for is there."""
    desk.run(0.04, lambda: desk.tell(do="release"))
    assert desk.operation.ways._finder.finish(60.0)
    desk.run(0.04, lambda: desk.tell(do="release"))
    assert desk.operation.shown.planned.goal is not None, desk.operation.shown.planned.text


def drive(desk: Desk, share: float, most: float = 30.0) -> str:
    """Drive along a way to its end, and say why it ended."""
    for _ in range(round(most / 0.02)):
        desk.run(0.02, lambda: along(desk, share))
        shown = desk.operation.shown
        if shown.mode == "stands":
            desk.run(0.8, lambda: along(desk, share))  # it comes to rest there
            return shown.reason
    raise AssertionError("it does not end")


def dragged(desk: Desk, shift: tuple[float, float, float]) -> CurveAlong:
    led = desk.operation.shown.led
    assert led is not None
    curve = CurveAlong.of(desk.arm, led)
    points = curve.points.copy()
    points[-1] += shift
    return curve._replace(points=points)


def test_a_curve_that_is_dragged_is_driven_while_it_is_held_and_back_again() -> None:
    desk = Desk(*bent_arm())
    desk.run(0.1, lambda: desk.tell(do="release"))
    start = desk.q
    curve = dragged(desk, (-0.02, 0.03, 0.02))
    desk.operation.reshape(curve)
    planned(desk)
    assert max(desk.speeds) == 0.0  # it is a ghost
    desk.run(0.5, lambda: along(desk, 1.0, number=99))
    assert max(desk.speeds) == 0.0
    assert "another way" in desk.operation.shown.reason
    desk.run(0.06, lambda: desk.tell(do="release"))
    desk.run(0.3, lambda: along(desk, 1.0))
    assert desk.operation.shown.mode == "runs"
    desk.run(0.8, lambda: desk.tell(do="release"))
    assert desk.speeds[-1] == 0.0
    assert 0.0 < desk.operation.ways.way.at < desk.operation.ways.way.end
    assert drive(desk, 1.0) == "the arm is at the end of the way"
    desk.run(1.0, lambda: desk.tell(do="release"))
    target = curve.target(desk.arm)
    tip = target.points[-1]
    assert np.linalg.norm(desk.tip - tip) < 0.2 * np.linalg.norm(desk.arm.at(start).points[-1] - tip)
    bound = desk.limits.for_arm(desk.arm).bound / desk.arm.joint_units / 0.02
    assert max(desk.speeds) <= bound.max() * (1.0 + 1e-9)
    assert drive(desk, -1.0) == "nothing more can be driven back"
    desk.run(1.0, lambda: desk.tell(do="release"))
    np.testing.assert_allclose(desk.q, start, atol=1e-4)


def with_ball(desk: Desk, center: np.ndarray) -> pp.CollisionModel:
    """Put a ball into the scene of an arm, which is clear of it, and return the distances from it."""
    ball = pp.Sphere(tuple(center), 0.01)
    desk.scene = pp.Scene({"ball": ball}, margin=0.005, self_collision=False)
    model = pp.CollisionModel(desk.arm, desk.scene)
    assert model.minimum(desk.q).distance > 0.005
    return model


def test_a_way_on_which_something_appears_is_planned_anew_and_driven_on_while_it_is_held() -> None:
    desk = Desk(*bent_arm())
    desk.run(0.1, lambda: desk.tell(do="release"))
    start = desk.q
    desk.operation.reshape(dragged(desk, (-0.03, 0.05, 0.03)))
    planned(desk)
    number, _, goal, _ = desk.operation.shown.planned
    desk.run(0.3, lambda: along(desk, 1.0, number))
    assert desk.speeds[-1] > 0.0
    middle = 0.5 * (desk.tip + desk.arm.at(goal).points[-1])
    model = with_ball(desk, middle + [0.03, 0.0, 0.0])
    gaps: list[float] = []

    def held(share: float = 1.0) -> None:
        along(desk, share, number)
        gaps.append(model.minimum(desk.q).distance)

    way = desk.operation.ways.way
    while way.rate > 0.0:
        desk.run(0.02, held)
        assert desk.operation.shown.mode == "waits"
        assert "ball" in desk.operation.shown.reason
        assert "looked for" in desk.operation.shown.reason
    assert desk.now < 1.0
    desk.run(0.02, held)
    assert desk.operation.ways._finder.finish(60.0)
    desk.run(0.06, held)
    assert desk.operation.shown.mode == "runs"
    assert desk.operation.shown.planned.number == number
    desk.run(6.0, held)
    assert desk.operation.shown.reason == "the arm is at the end of the way"
    np.testing.assert_allclose(desk.q, goal, atol=1e-4)
    desk.run(8.0, lambda: held(-1.0))  # around the ball again, and along what was driven before it
    np.testing.assert_allclose(desk.q, start, atol=1e-4)
    assert min(gaps) > 0.005 * (1.0 - 1e-6)


def test_a_way_whose_end_is_blocked_by_now_is_looked_at_again_before_it_is_driven_elsewhere() -> None:
    desk = Desk(*bent_arm())
    desk.run(0.1, lambda: desk.tell(do="release"))
    desk.operation.reshape(dragged(desk, (-0.03, 0.05, 0.03)))
    planned(desk)
    number, _, goal, _ = desk.operation.shown.planned
    model = with_ball(desk, desk.arm.at(goal).points[-1])
    desk.run(0.04, lambda: along(desk, 1.0, number))
    assert desk.operation.ways._finder.finish(60.0)
    desk.run(1.0, lambda: along(desk, 1.0, number))
    shown = desk.operation.shown
    assert shown.planned.number == number + 1
    assert "another way is planned" in shown.reason
    assert max(desk.speeds) == 0.0
    assert 0.005 * (1.0 - 1e-6) < model.minimum(shown.planned.goal).distance < 0.01
    desk.run(5.0, lambda: along(desk, 1.0))
    np.testing.assert_allclose(desk.q, shown.planned.goal, atol=1e-4)


def test_a_way_without_another_one_around_what_has_appeared_is_driven_as_far_as_it_is_clear(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    asked = []

    def find(q: np.ndarray, scene: pp.Scene) -> pp.control.JointPath:
        asked.append(scene)
        raise TaskError("the curve", "the ball is everywhere")

    monkeypatch.setattr("pinposture.operate.ways.around", lambda way, limits: find)
    desk = Desk(*bent_arm())
    desk.run(0.1, lambda: desk.tell(do="release"))
    desk.operation.reshape(dragged(desk, (-0.03, 0.05, 0.03)))
    planned(desk)
    number, _, goal, _ = desk.operation.shown.planned
    free = desk.scene
    model = with_ball(desk, 0.5 * (desk.tip + desk.arm.at(goal).points[-1]) + [0.03, 0.0, 0.0])
    for times in (1, 2):
        desk.run(0.04, lambda: along(desk, 1.0, number))
        assert desk.operation.ways._finder.finish(60.0)
        desk.run(3.0, lambda: along(desk, 1.0, number))
        shown = desk.operation.shown
        assert shown.mode == "stands"
        assert "ball" in shown.reason
        assert "no way: the curve: the ball is everywhere" in shown.planned.text
        assert 0.005 * (1.0 - 1e-6) < model.minimum(desk.q).distance < 0.006
        assert len(asked) == times  # once for each scene
        desk.scene = replace(desk.scene)
    desk.scene = free
    desk.run(3.0, lambda: along(desk, 1.0, number))
    np.testing.assert_allclose(desk.q, goal, atol=1e-4)


def test_kept_postures_are_the_steps_and_the_way_of_the_tip_is_undone() -> None:
    desk = Desk(*bent_arm())
    desk.run(0.1, lambda: desk.tell(do="release"))
    start = desk.q
    desk.tell(do="keep")
    desk.run(0.5, lambda: desk.hold((-1.0, 0.0, 0.0)))
    desk.run(0.5, lambda: desk.tell(do="release"))
    desk.tell(do="keep")
    desk.tell(do="next")
    planned(desk)
    assert [step.name for step in desk.operation.steps] == ["posture 1", "posture 2"]
    drive(desk, 1.0)
    desk.run(0.8, lambda: desk.tell(do="release"))
    np.testing.assert_allclose(desk.q, start, atol=1e-4)
    desk.tell(do="next")
    planned(desk)
    drive(desk, 1.0)
    desk.run(0.8, lambda: desk.tell(do="release"))
    np.testing.assert_allclose(desk.q, desk.operation.steps[1].target.q, atol=1e-4)
    drive(desk, -1.0)  # both steps, and what the tip was led
    desk.run(0.8, lambda: desk.tell(do="release"))
    np.testing.assert_allclose(desk.q, start, atol=1e-4)


def test_an_arm_off_the_path_of_its_tip_is_not_steered_before_it_is_back() -> None:
    desk = Desk(fed_arm())
    desk.run(2.0, lambda: desk.hold((1.0, 0.5, 0.0)))
    desk.run(1.0, lambda: desk.tell(do="release"))
    on_path = desk.q
    desk.operation.reshape(dragged(desk, (0.0, 0.02, 0.02)))
    planned(desk)
    drive(desk, 1.0)
    desk.run(0.2, lambda: desk.hold((-1.0, 0.0, 0.0)))
    assert "off the path" in desk.operation.shown.reason
    drive(desk, -1.0)
    desk.run(0.6, lambda: desk.tell(do="release"))
    np.testing.assert_allclose(desk.q, on_path, atol=1e-4)
    desk.run(2.5, lambda: desk.hold((-1.0, 0.0, 0.0)))
    np.testing.assert_allclose(desk.q, desk.arm.neutral(), atol=1e-3)


def test_an_arm_with_a_joint_that_sticks_is_led_out_with_that_joint_locked() -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    desk = Desk(fed_arm())
    simulated = SimulatedArm(desk.arm, desk.operation, desk.limits)

    def cycles(count: int, tell: Callable[[], object]) -> None:
        for _ in range(count):
            desk.now += 0.02
            tell()
            assert simulated.cycle()

    cycles(120, lambda: desk.hold((1.0, 1.0, 0.0)))
    cycles(60, lambda: desk.tell(do="release"))
    led = desk.operation.shown.led
    assert led is not None and led[0] > 0.02
    joint = desk.arm.joint_names[1 + int(np.abs(desk.arm.positions(led)[1:]).argmax())]
    simulated.fail(joint)
    cycles(150, lambda: desk.hold((-1.0, 0.0, 0.0)))
    assert desk.operation.ways._finder.finish(60.0)
    cycles(5, lambda: desk.hold((-1.0, 0.0, 0.0)))
    assert desk.operation.shown.reason == "a joint is stuck; release, and hold again"
    assert simulated.tracker.arm is not desk.arm
    inside = desk.operation.shown.measured
    assert inside is not None and inside[0] > 0.005
    cycles(5, lambda: desk.tell(do="release"))
    cycles(400, lambda: along(desk, 1.0))
    out = desk.operation.shown.measured
    assert out is not None
    column = desk.arm.joint_names.index(joint)
    others = np.delete(np.abs(desk.arm.positions(out)), column)
    assert others.max() < 0.005
    assert desk.arm.positions(out)[column] == pytest.approx(desk.arm.positions(inside)[column], abs=0.005)
    simulated.close()


@pytest.mark.filterwarnings("ignore:.*outside the limits")  # end stops give way a little
@pytest.mark.parametrize("kind", ["limp", "weak"])
def test_an_arm_with_a_joint_that_falls_is_led_out_while_that_joint_lies_at_its_end_stop(kind: str) -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is not installed")
    hinges = tuple(pp.JointSpec(axis, lower=-0.8, upper=0.8) for axis in "yz")
    arm = pp.Arm.from_modules([pp.ModuleTemplate("m", hinges, (0.05, 0.05))] * 4)
    start = np.array([-0.3, 0.2, 0.2, 0.1, 0.4, -0.2, 0.3, 0.2])
    desk = Desk(arm, start)
    simulated = SimulatedArm(arm, desk.operation, desk.limits, pp.Scene(margin=0.005), q0=start)

    def cycles(count: int, tell: Callable[[], object]) -> None:
        for _ in range(count):
            desk.now += 0.02
            tell()
            assert simulated.cycle()

    cycles(100, lambda: desk.hold((0.0, 0.0, 1.0)))
    assert np.abs(desk.operation.shown.led - start).max() > 0.02
    with pytest.raises(UnknownName, match="kind of failure"):
        simulated.fail("m01_j1_y", kind="hot")
    simulated.fail("m01_j1_y", kind=kind)
    cycles(100, lambda: desk.hold((0.0, 0.0, 1.0)))
    cycles(100, lambda: desk.tell(do="release"))
    assert desk.operation.shown.stuck.startswith("m01_j1_y has fallen, as limp or weak")
    assert desk.operation.ways._finder.finish(60.0)
    cycles(5, lambda: desk.tell(do="release"))
    assert desk.operation.shown.planned.text == "out, with m01_j1_y limp: 0 % driven"
    cycles(5, lambda: desk.hold((0.0, 0.0, 1.0)))
    assert desk.operation.shown.mode == "holds"
    assert "only the way that is planned can be driven" in desk.operation.shown.reason
    cycles(5, lambda: desk.tell(do="release"))
    cycles(150, lambda: along(desk, 1.0))
    assert desk.operation.shown.reason == "the arm is at the end of the way"
    measured = desk.operation.shown.measured
    assert measured is not None
    assert np.abs(measured - start)[1:].max() < 0.005
    assert measured[0] == pytest.approx(0.8, abs=0.06)
    simulated.close()


def test_a_joint_that_was_pushed_works_again_once_it_has_followed_its_command() -> None:
    desk = Desk(*bent_arm())
    operation = desk.operation
    operation.goes_on = True
    desk.run(0.2, lambda: desk.hold((0.0, 0.0, 1.0)))
    begin = desk.q
    desk.run(0.2, lambda: desk.hold((0.0, 0.0, 1.0)))
    column = int(np.abs(desk.q - begin).argmax())
    name = desk.arm.joint_names[column]
    there = desk.q
    desk.q = there.copy()
    desk.q[column] += 0.5
    desk.run(0.02, lambda: desk.hold((0.0, 0.0, 1.0)))
    desk.run(0.02, lambda: desk.hold((0.0, 0.0, 1.0)))
    assert operation.shown.stuck.startswith(f"{name} is astray at ")
    desk.q = there
    desk.run(0.04, lambda: desk.hold((0.0, 0.0, 1.0)))
    words = (
        f"{name} was astray, and has not followed its command since; if it has fallen, look for the way out"
    )
    assert operation.shown.stuck == words
    moved = 0.0
    while moved < 0.1:
        assert operation.shown.stuck == words
        desk.run(0.02, lambda: desk.hold((0.0, 0.0, 1.0)))
        moved = abs(desk.q[column] - there[column])
        assert operation.shown.mode == "runs", operation.shown
    desk.run(0.1, lambda: desk.hold((0.0, 0.0, 1.0)))
    assert operation.shown.stuck == ""
    desk.tell(do="out")
    desk.run(0.1, lambda: desk.tell(do="release"))
    assert operation.shown.planned.text == "no joint fails"


def test_no_way_out_is_looked_for_while_all_joints_work() -> None:
    desk = Desk(*bent_arm())
    desk.operation.goes_on = True
    desk.run(0.1, lambda: desk.hold((1.0, 0.0, 0.0)))
    desk.tell(do="out")
    desk.run(0.1, lambda: desk.tell(do="release"))
    assert desk.operation.shown.planned.text == "no joint fails"


def test_steps_are_the_keyframes_of_a_task_for_the_same_arm(tmp_path: Path) -> None:
    arm, q = bent_arm()
    keyframes = [
        pp.Keyframe(joints=arm.positions(each), name=name, **when)
        for each, name, when in ((arm.neutral(), "straight", {}), (q, "bent", {"duration": 3.0}))
    ]
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0)
    file = pp.Task(arm, keyframes, limits=limits).save(tmp_path / "task.toml")
    steps = read_steps(arm, str(file))
    np.testing.assert_allclose(steps[1].target.q, q, atol=1e-9)
    with pytest.raises(pp.errors.FileError, match="other names"):
        read_steps(fed_arm(), str(file))
