"""States show Pinocchio's placements and Jacobians; the pass along the chain gives the same numbers."""

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pinocchio as pin
import pytest
from sampling import seeds

import pinposture as pp
from pinposture.arm import ChainState
from pinposture.arm.arm import PinocchioState
from pinposture.errors import InvalidValue

KINDS = {
    "RX": pin.JointModelRX,
    "RZ": pin.JointModelRZ,
    "RUBY": pin.JointModelRUBY,
    "PX": pin.JointModelPX,
    "any turn": lambda: pin.JointModelRevoluteUnaligned(np.array([0.48, 0.6, 0.64])),
    "any slide": lambda: pin.JointModelPrismaticUnaligned(np.array([0.48, 0.6, 0.64])),
}


def odd_arm(seed: int, joints: int = 12) -> pp.Arm:
    """An arm of joints of all kinds in random places, with a joint off the chain before and after it."""
    rng = np.random.default_rng(seed)
    pin.seed(seed)
    model = pin.Model()
    names = list(KINDS)
    parent = 0
    for u in range(joints):
        if u in (2, 7):
            model.addJoint(parent, pin.JointModelSpherical(), pin.SE3.Random(), f"aside{u}")
        parent = model.addJoint(parent, KINDS[names[rng.integers(len(names))]](), pin.SE3.Random(), f"j{u}")
        if u % 3 == 2:
            model.addFrame(pin.Frame(f"p{u}", parent, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    points = [f"p{u}" for u in range(2, joints, 3)]
    base = pin.SE3.Random()
    return pp.Arm.from_model(model, points, base)


def by_pinocchio(arm: pp.Arm, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Points, rotations, and both Jacobians of all control points, read frame by frame."""
    model = arm.model
    data = arm.model.createData()
    pin.computeJointJacobians(model, data, q)
    pin.updateFramePlacements(model, data)
    frames = [model.getFrameId(name) for name in arm.control_points]
    full = [pin.getFrameJacobian(model, data, f, pin.LOCAL_WORLD_ALIGNED) for f in frames]
    points = np.array([data.oMf[f].translation for f in frames])
    rotations = np.array([data.oMf[f].rotation for f in frames])
    return points, rotations, np.array([j[:3] for j in full]), np.array([j[3:] for j in full])


@pytest.mark.parametrize("seed", seeds(12))
def test_placements_and_jacobians_are_those_of_pinocchio(seed):
    arm = odd_arm(seed)
    rng = np.random.default_rng(seed)
    for _ in range(5):
        q = pin.integrate(arm.model, arm.neutral(), rng.normal(size=arm.nv))
        state = arm.at(q)
        found = (state.points, state.rotations, state.jacobians, state.angular_jacobians)
        for ours, theirs in zip(found, by_pinocchio(arm, q), strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-12 * max(1.0, arm.length))


@pytest.mark.parametrize("seed", seeds(12))
def test_the_pass_along_the_chain_gives_what_pinocchio_does(seed):
    rng = np.random.default_rng(seed)
    name = ("RyRz", "RzRy", "Rz", "RzRz", "RzRzRz")[seed % 5]
    for arm in (odd_arm(seed), pp.Arm.from_template(name, int(rng.integers(1, 30)))):
        q = arm.integrate(arm.neutral(), rng.normal(size=arm.nv))
        state = arm.at(q)
        chain = arm.chain_at(q)
        assert isinstance(state, PinocchioState)
        size = 1e-12 * max(1.0, arm.length)
        for name in ("q", "positions", "points", "rotations", "origins", "links", "jacobians", "axes"):
            np.testing.assert_allclose(getattr(chain, name), getattr(state, name), atol=size, err_msg=name)
        units = arm.kinematics.task_constants.units.max()
        np.testing.assert_allclose(chain.screws.screws, state.screws.screws, atol=size * units)
        np.testing.assert_allclose(chain.manipulability(), state.manipulability(), atol=1e-7)
        step = 0.1 * rng.normal(size=arm.nv)
        assert type(state.moved(step)) is PinocchioState
        np.testing.assert_allclose(chain.moved(step).points, state.moved(step).points, atol=size)


def test_an_arm_too_long_for_pinocchio_is_computed_along_the_chain():
    arm = pp.Arm.from_template("RyRz", 51)
    state = arm.at(0.1 * np.ones(arm.nv))
    assert isinstance(state, ChainState)
    assert state.chain_state is state
    points, rotations, jacobians, angular = by_pinocchio(arm, state.q)
    np.testing.assert_allclose(state.points, points, atol=1e-12 * arm.length)
    np.testing.assert_allclose(state.rotations, rotations, atol=1e-12)
    np.testing.assert_allclose(state.jacobians, jacobians, atol=1e-12 * arm.length)
    np.testing.assert_allclose(state.angular_jacobians, angular, atol=1e-12)


def test_each_thread_reads_for_itself():
    arm = pp.Arm.from_template("RyRz", 20)
    rng = np.random.default_rng(0)
    configurations = [arm.random(rng) for _ in range(200)]
    expected = [arm.at(q).points for q in configurations]
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda q: arm.at(q).points, configurations))
    np.testing.assert_array_equal(found, expected)


def test_what_was_read_stays_when_more_is_read():
    arm = pp.Arm.from_template("RyRz", 5)
    state = arm.at(arm.neutral())
    points = state.points.copy()
    jacobians = state.jacobians.copy()
    _ = arm.at(np.full(arm.nq, 0.3)).jacobians
    np.testing.assert_array_equal(state.points, points)
    np.testing.assert_array_equal(state.jacobians, jacobians)


@pytest.mark.parametrize("seed", range(4))
def test_configurations_add_up_as_pinocchio_does(seed):
    for arm in (odd_arm(seed), pp.Arm.from_template("RyRz", 5)):
        rng = np.random.default_rng(seed)
        a = pin.integrate(arm.model, arm.neutral(), rng.normal(size=arm.nv))
        dq = rng.normal(size=arm.nv)
        b = arm.integrate(a, dq)
        np.testing.assert_allclose(b, pin.integrate(arm.model, a, dq), atol=1e-15)
        np.testing.assert_allclose(arm.difference(a, b), pin.difference(arm.model, a, b), atol=1e-15)
        rows = np.array([a, b, a])
        for start, end in ((rows[:-1], rows[1:]), (a, rows), (rows, b)):
            pairs = zip(*np.broadcast_arrays(start, end), strict=True)
            each = np.array([arm.difference(one, other) for one, other in pairs])
            np.testing.assert_array_equal(arm.difference(start, end), each)
        assert arm.difference(rows[:0], rows[:0]).shape == (0, arm.nv)
        np.testing.assert_allclose(arm.positions(b), pin.difference(arm.model, pin.neutral(arm.model), b))


@pytest.mark.parametrize("seed", seeds(4))
def test_a_base_far_away_costs_no_digits(seed):
    near = odd_arm(seed)
    far = pp.Arm.from_model(near.model, near.control_points, pin.SE3(np.eye(3), np.array([1e8, -3e8, 2e8])))
    ours = far.kinematics.constants
    theirs = near.kinematics.constants
    for name in ("axes", "offsets"):
        np.testing.assert_array_equal(getattr(ours.joints, name)[1:], getattr(theirs.joints, name)[1:])
    np.testing.assert_array_equal(ours.levers, theirs.levers)
    np.testing.assert_array_equal(ours.turns, theirs.turns)


@pytest.mark.long
def test_long_arms_load_and_agree_with_shorter_ones():
    # The first 60 modules of a long arm are an arm that Pinocchio has memory for.
    long = pp.Arm.from_template("RyRz", 600)
    short = pp.Arm.from_template("RyRz", 60)
    q = np.random.default_rng(0).normal(size=long.nv)
    np.testing.assert_array_equal(long.at(q).points[:60], short.at(q[:120]).points)
    points, *_ = by_pinocchio(short, q[:120])
    np.testing.assert_allclose(short.at(q[:120]).points, points, atol=1e-12)


def test_a_screw_joint_is_refused_by_name():
    model = pin.Model()
    joint = model.addJoint(0, pin.JointModelHX(0.1), pin.SE3.Random(), "screw")
    model.addFrame(pin.Frame("p", joint, pin.SE3.Random(), pin.FrameType.OP_FRAME))
    with pytest.raises(InvalidValue, match=r"screw.*turns about one axis"):
        pp.Arm.from_model(model, ["p"])
