"""Curves do not move silently: the target, the command line and the picture say how far, and which way."""

from __future__ import annotations

import json
import warnings
from dataclasses import replace
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from scipy.spatial.transform import Rotation

import pinposture as pp
from pinposture.placement.target import Moved
from pinposture.task.follow_leader import Leader

AWAY = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.5, 1.2), np.array([0.1, -0.2, 0.4]))
BALL = pp.Scene({"ball": pp.Sphere((0.0, 1.0, 0.0), 0.05)})


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return template_arm("RyRz", 6)


def line(*start: float) -> pp.Curve:
    """A line of 0.4 m along y."""
    return pp.Curve.line(start, np.add(start, (0.0, 0.4, 0.0)))


def bend() -> pp.Curve:
    points = [(0.5, 0.0, 0.5), (0.6, 0.05, 0.5), (0.7, 0.2, 0.55), (0.75, 0.4, 0.6)]
    return pp.Curve.spline(points)


@pytest.mark.parametrize("placement", ["as_is", "translate", "align"])
@pytest.mark.parametrize("where", [None, AWAY], ids=["at the origin", "elsewhere"])
def test_what_is_told_is_how_the_curve_was_moved(placement: str, where: pin.SE3 | None) -> None:
    arm = pp.Arm.from_template("RyRz", 6, base_placement=where)
    drawn = bend()
    if placement == "as_is":
        drawn = drawn.moved(np.eye(3), arm.chain.base - drawn.start)
    target = pp.resolve_targets(arm, drawn, placement=placement, roll=0.7, incomplete="partial")  # type: ignore
    turn = Rotation.from_rotvec(target.moved.rotation).as_matrix()
    s = np.linspace(0.0, drawn.length, 50)
    expected = (drawn.at(s) - drawn.start) @ turn.T + drawn.start + target.moved.translation
    np.testing.assert_allclose(target.curve.at(s), expected, atol=1e-9)
    assert target.moved.distance == pytest.approx(np.linalg.norm(arm.chain.base - drawn.start))
    assert (target.moved.angle > 1e-9) == (placement == "align")
    assert bool(target.moved) == (placement != "as_is")


def test_a_curve_that_is_taken_from_elsewhere_is_said(arm: pp.Arm) -> None:
    with pytest.warns(
        pp.PostureWarning, match=r"the curve was moved by 707 mm and turned by 1\.571 rad to the base"
    ) as told:
        target = pp.resolve_targets(arm, line(0.5, 0.0, 0.5))
    assert told[0].filename == __file__
    with pytest.warns(pp.PostureWarning, match=r"moved by 400 m .*; if it is in millimetres, load"):
        pp.resolve_targets(arm, line(400.0, 0.0, 0.0))
    np.testing.assert_allclose(target.moved, [(-0.5, 0.0, -0.5), (0.0, 0.0, -np.pi / 2)], atol=1e-12)
    with warnings.catch_warnings():
        warnings.simplefilter("error", pp.PostureWarning)
        pp.resolve_targets(arm, line(0.5, 0.0, 0.5), placement="align")  # whoever says so knows
        pp.resolve_targets(arm, line(0.0, 0.0, 0.0))
        pp.resolve_targets(arm, line(0.02, 0.0, 0.0))
        pp.resolve_targets(template_arm("RyRz", 20), pp.Curve.helix(radius=0.06, pitch=0.15, turns=4))


def test_it_stays_with_the_target_and_with_what_is_saved(arm: pp.Arm, tmp_path: Path) -> None:
    target = pp.resolve_targets(arm, line(0.5, 0.0, 0.5), placement="align")
    run = pp.track(arm, target.region(0, 3), arm.neutral(), max_steps=2)
    assert pp.load(pp.save(run, tmp_path / "run"), pp.Run).target.moved == target.moved
    other = pp.Target.from_points(arm, target.points)
    batch = pp.track_many(arm, [target, other], [arm.neutral()] * 2, max_steps=2)
    kept = pp.load(pp.save(batch, tmp_path / "batch"), pp.Batch)
    assert [each.moved for each in kept.targets] == [target.moved, None]
    said = "moved by 707 mm and turned by 1.571 rad to the base of the arm"
    assert batch.in_words()["curve"] == f"{said} at most"
    figure = pp.plot(run)
    assert f"curve {said}" in figure.get_supxlabel()
    page = pp.save_html(arm, run, tmp_path / "run").read_text(encoding="utf-8")
    assert f"curve {said}" in page


def frames(**told: object) -> list[pp.Keyframe]:
    """Two curves that begin at the base; the second leaves it to the side."""
    aside = pp.Curve.spline([(0, 0, 0), (0.08, 0.02, 0), (0.2, 0.1, 0), (0.3, 0.25, 0)])
    straight = pp.Curve.line((0, 0, 0), (0.35, 0, 0))
    return [pp.Keyframe(straight, trim=True), pp.Keyframe(aside, time=1.0, trim=True, name="aside", **told)]


LIMITS = pp.Limits(step=None, dt=0.05)


@pytest.mark.long
def test_among_obstacles_curves_stay_where_they_are_drawn(arm: pp.Arm) -> None:
    drawn = frames()[1].curve
    free = pp.move_through(arm, frames(), limits=LIMITS)
    assert free.waypoints[1].moved.angle == pytest.approx(np.arctan2(0.02, 0.08))
    among = pp.move_through(arm, frames(), limits=LIMITS, scene=BALL)
    assert among.waypoints[1].moved == Moved((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    off = drawn.nearest(among.targets[-1])[1].max()
    assert off < 0.01 < drawn.nearest(free.targets[-1])[1].max()
    # Who says it explicitly has it.
    asked = pp.move_through(arm, frames(placement="align"), limits=LIMITS, scene=BALL)
    assert asked.waypoints[1].moved == free.waypoints[1].moved
    # A scene without obstacles is no place to be in.
    alone = pp.move_through(arm, frames(), limits=LIMITS, scene=pp.Scene())
    assert alone.waypoints[1].moved == free.waypoints[1].moved


def test_a_keyframe_that_is_taken_from_elsewhere_is_named(arm: pp.Arm) -> None:
    there = pp.Curve.line((0.5, 0, 0.5), (0.85, 0, 0.5))
    with pytest.warns(pp.PostureWarning, match=r"keyframe 2 'there': its curve was moved by 707 mm to"):
        pp.keyframe_reference(arm, [frames()[0], pp.Keyframe(there, time=1.0, name="there", trim=True)], 0.05)


@pytest.mark.parametrize("scene", [None, BALL], ids=["free", "among obstacles"])
def test_a_task_says_where_its_curves_lie_and_its_file_gives_it_back(
    arm: pp.Arm, scene: pp.Scene | None, tmp_path: Path
) -> None:
    task = pp.Task(arm, tuple(frames()), LIMITS, scene=scene)
    usual, other = ("align", "as_is") if scene is None else ("as_is", "align")
    assert [each.placement for each in task.motion] == [usual, usual]
    text = task.save(tmp_path / "usual.toml").read_text()
    assert "placement" not in text
    assert [each.placement for each in pp.Task.load(tmp_path / "usual.toml").motion] == [usual, usual]
    unusual = task.edited(motion=tuple(replace(each, placement=other) for each in task.motion))
    text = unusual.save(tmp_path / "unusual.toml").read_text()
    assert text.count(f'placement = "{other}"') == 2
    # An obstacle that comes later moves no curve.
    later = task.edited(scene=replace(BALL, margin=0.001))
    assert [each.placement for each in later.motion] == [usual, usual]
    assert later.save(tmp_path / "later.toml").read_text().count("placement") == (2 if scene is None else 0)


def test_a_path_among_obstacles_has_to_begin_at_the_tip() -> None:
    feed = pp.ModuleTemplate("Feed", (pp.JointSpec("x", "prismatic", 0.0, 0.5),), (0.05,), 0.01)
    arm = pp.Arm.from_modules([feed, *[pp.template("RyRz")] * 4])
    path = pp.Curve.line((0, 0, 0), (0.3, 0, 0))
    free = pp.Task(arm, Leader(path, 0.1), LIMITS)
    assert free.motion.placement == "align"
    reference = free.reference()
    tip = arm.at(reference.start).points[-1]
    np.testing.assert_allclose(reference.waypoints[0].target.moved.translation, tip, atol=1e-12)
    among = pp.Task(arm, Leader(path, 0.1), LIMITS, scene=BALL)
    assert among.motion.placement == "as_is"
    with pytest.raises(pp.PostureError, match="start of the path"):
        among.reference()


@pytest.mark.long
def test_the_command_line_says_it(tmp_path: Path) -> None:
    from typer.testing import CliRunner

    from pinposture.cli import app

    file = tmp_path / "arm.urdf"
    curve = tmp_path / "line.json"
    scene = tmp_path / "scene.toml"
    file.write_text(template_arm("RyRz", 6).urdf)
    line(0.5, 0.0, 0.5).save(curve)
    scene.write_text('obstacles.ball = {type = "sphere", center = [0, 1, 0], radius = 0.05}\n')

    def call(*more: object) -> tuple[int, str]:
        result = CliRunner().invoke(app, ["track", str(file), "--curve", str(curve), *map(str, more)])
        return result.exit_code, result.output

    assert "moved by 707 mm and turned by 1.571 rad to the base of the arm; --placement as_is" in call()[1]
    told = json.loads(call("--json")[1])
    assert told["moved"]["translation"] == [-0.5, 0.0, -0.5]
    assert told["moved"]["rotation"] == pytest.approx([0.0, 0.0, -np.pi / 2])
    code, said = call("--scene", scene)
    assert code == 2 and "m from the base; use --placement translate or align" in said
    code, said = call("--scene", scene, "--placement", "align")
    assert code == 0 and "moved by 707 mm" in said
