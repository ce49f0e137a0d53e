"""What holds for the steps of every baseline, and within the limits for those of every controller."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from control.baseline_arms import PLACEMENT, SLIDING, state_of, target_of
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.control import CONTROLLERS, controller_named

BASELINES = ("pinv", "task-constraints", "extended", "augmented", "dls", "lm")
ARMS = {
    "spatial": lambda: pp.Arm.from_template("RyRz", 7),
    "planar": lambda: pp.Arm.from_template("Rz", 8, base_placement=PLACEMENT),
    "sliding": lambda: pp.Arm.from_modules([SLIDING] * 4),
    "limited": lambda: pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.8, 0.6)] * 5),
    "single": lambda: pp.Arm.from_template("RyRz", 1),
}


@cache
def arm_called(name: str) -> pp.Arm:
    return ARMS[name]()


@pytest.fixture(scope="session")
def spatial() -> pp.Arm:
    return arm_called("spatial")


@pytest.mark.parametrize("name", BASELINES)
def test_steps_do_not_depend_on_where_the_base_stands(spatial: pp.Arm, name: str) -> None:
    turned = pp.Arm.from_template("RyRz", 7, base_placement=PLACEMENT)
    for seed in range(4):
        q = state_of(spatial, seed).q
        goal = target_of(spatial, seed)
        moved = goal.points @ PLACEMENT.rotation.T + PLACEMENT.translation
        here = controller_named(name).step(spatial.at(q), goal)
        there = controller_named(name).step(turned.at(q), pp.Target.from_points(turned, moved))
        assert here.active == there.active
        assert here.info["sigma_max"] == pytest.approx(there.info["sigma_max"], rel=1e-9)
        np.testing.assert_allclose(here.dq, there.dq, atol=1e-6)


@given(
    name=st.sampled_from(sorted(CONTROLLERS)),
    kind=st.sampled_from(sorted(ARMS)),
    amplitude=st.sampled_from([0.0, 1e-15, 1e-12, 1e-7, 1e-3, 0.5, 3.0]),
    free=st.sampled_from(["none", "first", "last", "most"]),
    largest=st.sampled_from([None, 1e-3, 0.1]),
    seed=st.integers(0, 10**6),
)
@examples(40)
def test_every_step_is_finite_and_within_the_limits(
    name: str, kind: str, amplitude: float, free: str, largest: float | None, seed: int
) -> None:
    arm = arm_called(kind)
    rng = np.random.default_rng(seed)
    m = arm.n_modules
    weights = np.ones(m)
    if m > 1:
        none = {"none": [], "first": [0], "last": [m - 1], "most": rng.permutation(m)[: m - 1]}[free]
        weights[none] = 0.0
    start = np.clip(arm.positions(state_of(arm, seed, amplitude).q), arm.limits.lower, arm.limits.upper)
    target = target_of(arm, seed, weights)
    if name != "joint" and seed % 3 == 0:
        target = pp.Target.from_points(arm, rng.normal(0.0, 10.0 * arm.length, (m, 3)), weights)
    limits = pp.Limits(step=largest)
    q = arm.configuration(start)
    memory = None
    for _ in range(4):
        step = controller_named(name).step(arm.at(q), target, limits, memory)
        memory = step.memory
        assert np.all(np.isfinite(step.dq))
        numbers = [np.asarray(value) for value in step.info.values() if not isinstance(value, str)]
        assert all(np.isfinite(value).all() for value in numbers)
        assert set(step.active) <= set(np.flatnonzero(weights))
        assert np.all(np.abs(step.dq) <= (np.inf if largest is None else largest * (1 + 1e-12)))
        # geodesic has points to control even where it has no step to take.
        assert bool(step.reason) == (step.active == ()) or name == "geodesic"
        q = arm.integrate(q, step.dq)
        assert arm.within_limits(q)


@pytest.mark.parametrize("name", (*BASELINES, "joint"))
def test_joints_that_move_no_control_point_stay(name: str) -> None:
    # The joint "aside" hangs on the first one and comes second in the model: columns with a gap.
    model = pin.Model()
    link = pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    joints = [(0, "a"), (1, "aside"), (1, "b"), (3, "c"), (4, "d"), (5, "e")]
    for parent, joint in joints:
        turn = pin.JointModelRZ() if joint != "d" else pin.JointModelPX()
        model.addJoint(parent, turn, link, joint)
    for joint in ("b", "c", "e"):
        parent = model.getJointId(joint)
        model.addFrame(pin.Frame(f"end_{joint}", parent, 0, link, pin.FrameType.OP_FRAME))
    model.lowerPositionLimit = np.full(6, -1.0)
    model.upperPositionLimit = np.full(6, 1.0)
    arm = pp.Arm.from_model(model, ["end_b", "end_c", "end_e"])
    state, goal = (
        arm.at(arm.configuration(np.full(6, 0.5) * s))
        for s in ([1, 1, -1, 1, 0.2, 1], [0.8, 0.1, 0.7, 0.8, 0.8, 0.8])
    )
    controller = controller_named(name)
    if name in ("pinv", "augmented", "extended"):
        controller = replace(controller, objective="joint_limits")
    step = controller.step(state, pp.Target.from_configuration(arm, goal.q))
    assert np.all(step.dq[[0, 2, 3, 4, 5]] != 0.0)
    assert step.dq[1] == 0.0


@pytest.mark.parametrize("name", BASELINES)
def test_without_any_target_the_arm_stands_and_says_so(spatial: pp.Arm, name: str) -> None:
    target = pp.Target(spatial.at(spatial.straight()).points, np.zeros(7))
    step = controller_named(name).step(state_of(spatial, 0), target)
    assert not step.dq.any()
    assert step.active == ()
    assert "target" in step.reason


def test_every_name_makes_the_controller_of_that_name() -> None:
    assert set(BASELINES) < set(CONTROLLERS)
    for name in CONTROLLERS:
        assert controller_named(name).name == name
