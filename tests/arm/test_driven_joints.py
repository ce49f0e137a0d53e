"""What is exchanged with a robot by the names of the joints that its drives move."""

from __future__ import annotations

import pickle

import numpy as np
import pinocchio as pin
import pytest
from arm.describing import LINK, Y, Z, arm_text, limit
from arm.driven_arms import DRIVES, LEADERS, Robot, driven_arm, driven_text

import pinposture as pp
from pinposture.errors import InvalidValue, PostureWarning


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    with pytest.warns(PostureWarning, match="locked"):
        return driven_arm()


def drawn(seed: int) -> dict[str, float]:
    rng = np.random.default_rng(seed)
    turns = rng.uniform(-20.0, 20.0)
    return dict(zip(DRIVES, [*rng.uniform(-0.3, 0.3, 2), turns, *rng.uniform(-0.3, 0.3, 2)], strict=True))


@pytest.mark.parametrize("seed", range(5))
def test_a_joint_state_gives_the_configuration_of_the_robot(arm, seed):
    assert arm.joint_names == LEADERS
    assert arm.drives.names == DRIVES
    robot = Robot(drawn(seed))
    states = robot.states()
    positions = arm.drives.joint_positions(states)
    np.testing.assert_allclose(positions, [states[name] for name in LEADERS], atol=1e-12)
    np.testing.assert_allclose(arm.at(arm.configuration(positions)).points[-1], robot.tip(), atol=1e-12)
    np.testing.assert_allclose(arm.drives.positions(positions), list(robot.driven.values()), atol=1e-12)
    assert arm.drives.named(arm.drives.positions(positions)) == pytest.approx(robot.driven)
    for only in (robot.driven, {name: states[name] for name in LEADERS}):  # with and without the followers
        np.testing.assert_allclose(arm.drives.joint_positions(only), positions, atol=1e-12)
    rows = np.array([positions, positions + 1.0])
    np.testing.assert_allclose(arm.drives.joint_positions(arm.drives.positions(rows)), rows, atol=1e-12)


def test_the_drive_counts_more_than_the_joint_that_moves_with_it(arm):
    states = Robot(drawn(0)).states()
    states["a"] += 0.01  # its encoder is worse
    found = arm.drives.joint_positions(states)
    assert found[0] == pytest.approx(2.0 * states["c"] + 0.1)


def test_velocities_and_torques_are_those_of_the_drives_by_virtual_work(arm):
    rng = np.random.default_rng(3)
    robot = Robot(drawn(3))
    moved = Robot({name: position + 1e-3 for name, position in robot.driven.items()})
    before, after = (arm.drives.joint_positions(each.states()) for each in (robot, moved))
    np.testing.assert_allclose(arm.drives.velocities((after - before) / 1e-3), 1.0, atol=1e-9)
    np.testing.assert_allclose(arm.drives.joint_velocities(np.ones(5)), (after - before) / 1e-3, atol=1e-9)
    torques = rng.normal(size=5)
    speeds = rng.normal(size=5)
    work = arm.drives.torques(torques) @ arm.drives.velocities(speeds)
    assert work == pytest.approx(torques @ speeds)
    np.testing.assert_allclose(arm.drives.joint_torques(arm.drives.torques(torques)), torques, atol=1e-12)


def test_gravity_is_held_by_the_drives_with_the_torques_of_all_joints(arm):
    """The generalised gravity of Pinocchio's model of all joints; the motor turns about the vertical."""
    robot = Robot(drawn(1))
    model = robot.model
    every = pin.computeGeneralizedGravity(model, model.createData(), robot.configuration())
    states = robot.states()
    q = arm.configuration(arm.drives.joint_positions(states))
    expected = robot.motion().T @ every
    np.testing.assert_allclose(arm.drives.torques(arm.at(q).gravity_torques), expected, atol=1e-9)


def test_a_continuous_joint_that_an_actuator_beside_the_chain_drives_counts_turns():
    """Its position modulo a turn would not tell that of the actuator, and its limits would be lost."""
    text = driven_text().replace('name="f" type="revolute"', 'name="f" type="continuous"')
    with pytest.warns(PostureWarning, match="locked"):
        arm = pp.Arm.load(text.replace('name="g" type="revolute"', 'name="g" type="fixed"'), tip="tip")
    column = arm.joint_names.index("f")
    assert arm.nq == arm.nv + 1  # only the joint that is called so turns without end
    np.testing.assert_allclose(arm.limits.lower[column], 0.3 - 0.5 * 3.0)
    np.testing.assert_allclose(arm.limits.upper[column], 0.3 + 0.5 * 3.0)


def test_an_arm_without_couplings_has_its_own_joints_as_drives():
    arm = pp.Arm.load(arm_text([("revolute", Y, LINK, limit(-1, 1)), ("continuous", Z, LINK, "")]))
    assert arm.drives.names == arm.joint_names
    values = np.array([0.3, -9.0])
    for each in (arm.drives.positions, arm.drives.joint_positions, arm.drives.velocities, arm.drives.torques):
        np.testing.assert_array_equal(each(values), values)
    assert pp.Arm.from_model(arm.model, arm.control_points).drives == arm.drives


def test_drives_are_saved_with_the_arm(arm):
    for again in (pp.Arm.from_dict(arm.to_dict()), pickle.loads(pickle.dumps(arm))):
        assert again.drives == arm.drives
    lighter = arm.with_payload(0.1)
    assert lighter.drives == arm.drives


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"motor": None}, "position of joint 'motor' is not given; allowed: a finite number"),
        ({"d": float("nan")}, "position of joint 'd' is nan"),
        ({"c": "0.1"}, "position of joint 'c' is '0.1'"),
        ({"c": True}, "position of joint 'c' is True"),
        ({"turn": 1e12}, "position of joint 'turn' is"),
    ],
)
def test_positions_that_are_none_are_refused_by_name(arm, change, words):
    with pytest.raises(InvalidValue) as caught:
        arm.drives.joint_positions(Robot(drawn(0)).states() | change)
    assert words in str(caught.value)


def test_missing_joints_and_wrong_shapes_are_refused(arm):
    states = Robot(drawn(0)).driven
    del states["motor"], states["h"]
    with pytest.raises(InvalidValue, match=r"all 5 joints that drives move \(missing: 'motor', 'h'\)"):
        arm.drives.joint_positions(states)
    for call in (arm.drives.positions, arm.drives.joint_positions, arm.drives.torques, arm.drives.named):
        for wrong in (0.1, [0.1] * 4, [[0.1] * 4], [0.1, 0.2, 0.3, 0.4, np.inf], "abcde", None):
            with pytest.raises(InvalidValue):
                call(wrong)
    with pytest.raises(InvalidValue, match="by the names of joints"):
        arm.drives.find([0.1] * 5)
