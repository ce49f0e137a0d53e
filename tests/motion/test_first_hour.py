"""What a new user runs into in the first hour, and is told about."""

import warnings

import numpy as np
import pytest

import pinposture as pp
from pinposture.errors import CurveEndsEarly, FileError, PostureWarning


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=6)


def test_a_velocity_above_that_of_the_description_is_reported_once(arm: pp.Arm) -> None:
    fastest = float(arm.limits.velocity[0])
    with pytest.warns(PostureWarning, match=r"velocity .* above .* joint .* and 11 others; is it in degrees"):
        pp.Limits(velocity=20.0 * fastest, dt=0.01).for_arm(arm)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pp.Limits(velocity=20.0 * fastest, dt=0.01).for_arm(arm)
        pp.Limits(velocity=fastest, dt=0.01).for_arm(arm)
        pp.Limits(velocity=np.inf, dt=0.01).for_arm(arm)
        pp.Limits(dt=0.01).for_arm(arm)


@pytest.mark.parametrize("share", [0.5, 0.7, 0.95, 0.999])
def test_a_straight_curve_that_is_too_short_is_called_short(share: float) -> None:
    hinges = (pp.JointSpec("y", lower=-1.7, upper=1.7), pp.JointSpec("z", lower=-1.7, upper=1.7))
    long, short = (pp.ModuleTemplate(f"own{k}", hinges, (0.1 - 0.04 * k, 0.08 + 0.02 * k)) for k in (0, 1))
    arm = pp.Arm.from_modules([long, short] * 3)
    with pytest.raises(CurveEndsEarly, match=r"ends .* the module is .* long"):
        pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (share * arm.length, 0, 0)), placement="as_is")


def test_a_target_posture_inside_an_obstacle_is_named(arm: pp.Arm) -> None:
    goal = np.full(arm.nv, 0.15)
    place = tuple(arm.at(goal).points[4])
    scene = pp.Scene({"post": pp.Sphere(place, 0.02)}, margin=0.01, arm_radius=0.005)
    run = pp.track(arm, pp.Target.from_configuration(arm, goal), arm.straight(), scene=scene, max_steps=600)
    assert run.status == "stalled"
    assert (
        "in the target posture" in run.reason and "post" in run.reason and "the margin is 10 mm" in run.reason
    )


def test_targets_reports_and_peaks_print_one_line(arm: pp.Arm) -> None:
    target = pp.resolve_targets(arm, pp.Curve.line((0, 0, 0), (1, 0, 0)))
    assert repr(target) == "Target(6 points, a configuration, sequential a curve of 1 m)"
    assert repr(target.region(1, 3)).startswith("Target(3 of 6 points, a configuration")
    assert repr(pp.Target.from_points(arm, target.points)) == "Target(6 points, no configuration)"
    tracker = pp.Tracker(arm, limits=pp.Limits(dt=0.01))
    tracker.step(None)
    assert repr(tracker.report) == f"Report(holding: {tracker.report.reason})" and tracker.report.reason
    tracker.update(target)
    tracker.step(np.full(arm.nq, 0.1))
    assert repr(tracker.report).startswith("Report(moving, mean error 0.")
    run = pp.track(arm, target, np.full(arm.nq, 0.1), limits=pp.Limits(dt=0.01))
    assert "12 joints" in repr(run.joint_trajectory().peaks)


def test_a_run_is_no_table_and_the_error_says_what_is(arm: pp.Arm, tmp_path) -> None:
    run = pp.track(arm, pp.Target.from_configuration(arm, np.full(12, 0.1)), arm.straight())
    with pytest.raises(FileError, match="joint_trajectory"):
        pp.save(run, tmp_path / "run.csv")
