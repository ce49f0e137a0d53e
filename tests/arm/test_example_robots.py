"""Robots that others wrote: loaded with a sensible chain and modules, or refused for the true reason."""

from __future__ import annotations

import warnings
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp
from pinposture.errors import PostureError, PostureWarning

ROBOTS = Path(pin.__file__).resolve().parents[1] / "cmeel.prefix/share/example-robot-data/robots"
if not ROBOTS.is_dir():  # Pinocchio itself may lie under the prefix, too
    ROBOTS = next(
        (
            path / "share/example-robot-data/robots"
            for path in Path(pin.__file__).parents
            if path.name == "cmeel.prefix"
        ),
        ROBOTS,
    )
FILES = sorted(path.relative_to(ROBOTS).as_posix() for path in ROBOTS.rglob("*.urdf"))

LOADED = {
    # file: joints of each module, tip
    "panda_description/urdf/panda.urdf": ([2, 2, 3], "panda_hand_tcp"),
    "xarm_description/urdf/xarm7.urdf": ([2, 2, 3], None),
    "ur_description/urdf/ur5_robot.urdf": ([3, 3], None),
    "ur_description/urdf/ur10_robot.urdf": ([3, 3], None),
    "kinova_description/robots/kinova.urdf": ([3, 3], None),
    "talos_data/robots/talos_left_arm.urdf": ([3, 4], None),
    "b1_description/urdf/b1-z1.urdf": ([2, 5], "gripperMover"),
}
PLACED = [
    "kinova_description/robots/kinova.urdf",
    "panda_description/urdf/panda.urdf",
    *[f"ur_description/urdf/ur{size}_robot.urdf" for size in (3, 5, 10)],
]
REFUSED = {
    "double_pendulum_description/urdf/double_pendulum.urdf": "limits allow a single position",
    "ur_description/urdf/ur3.urdf": "<robot>: has no name",
    "baxter_description/urdf/baxter.urdf": "'left_gripper', 'right_gripper': are the ends of chains",
    "pr2_description/urdf/pr2.urdf": "pass tip= to choose",
    "hector_description/robots/quadrotor_base.urdf": "has no moving joint",
}


def load(name, **arguments):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        return pp.Arm.load(ROBOTS / name, **arguments)


def test_the_robots_are_installed():
    assert len(FILES) > 50


@pytest.mark.parametrize("name", LOADED)
def test_known_arms_are_cut_as_expected(name):
    sizes, tip = LOADED[name]
    arm = load(name)
    assert [len(names) for names in arm.module_joints] == sizes
    assert tip in (None, arm.report.tip)


@pytest.mark.parametrize("name", REFUSED)
def test_files_that_hold_no_single_arm_are_refused_for_the_true_reason(name):
    with pytest.raises(PostureError) as caught:
        load(name)
    assert REFUSED[name] in str(caught.value)


@pytest.mark.parametrize("name", FILES)
def test_every_file_makes_a_sound_arm_or_is_refused(name):
    try:
        arm = load(name)
    except PostureError as error:
        assert "pass tip= to choose" in str(error) or "has no" in str(error)
        return
    assert arm.chain.module_lengths.min() > 1e-3 * arm.length / arm.nv
    q = arm.random(np.random.default_rng(0))
    h = 1e-6
    state = arm.at(q)
    for u in range(arm.nv):
        step = h * np.eye(arm.nv)[u]
        slope = (arm.at(arm.integrate(q, step)).points - arm.at(arm.integrate(q, -step)).points) / (2 * h)
        np.testing.assert_allclose(state.jacobians[:, :, u], slope, atol=1e-7)
    assert arm.within_limits(q)


def test_each_arm_of_a_robot_with_two_can_be_had_by_its_tip():
    arms = [load("baxter_description/urdf/baxter.urdf", tip=f"{side}_gripper") for side in ("left", "right")]
    assert [arm.nv for arm in arms] == [7, 7]
    assert arms[0].length == pytest.approx(arms[1].length, rel=1e-3)
    assert "joints off the chain" in arms[0].warnings[0]


@pytest.mark.skipif(not FILES, reason="example-robot-data is not installed")
@pytest.mark.parametrize("file", PLACED)
def test_curves_are_taken_and_the_means_told(file: str) -> None:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", PostureWarning)
        arm = pp.Arm.load(ROBOTS / file)
        points = [(0, 0, 0), (0.25, 0, 0), (0.5, 0.05, 0.04), (0.75, 0.15, 0.05), (1, 0.2, 0), (1.5, 0.2, 0)]
        target = pp.resolve_targets(arm, pp.Curve.spline(arm.length * np.array(points)))
    assert target.residual.max() < 1e-6 * arm.length
    assert arm.within_limits(target.q)
    in_turn = target.method == "sequential"
    assert bool(target.fallback) != in_turn
    assert ("least squares" in target.placed_by) != in_turn
