"""The box of a step: long runs along its edges, and starts that no box can save."""

from __future__ import annotations

import gc
import pickle
import warnings
import weakref
from functools import cache

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.control.controller import CONSTRAINTS
from pinposture.errors import InvalidValue

SLIDE = pp.JointSpec("x", type="prismatic", lower=-0.04, upper=0.05)
ENDLESS = pp.JointSpec("z", type="continuous")
SLIDING = pp.ModuleTemplate("slides", (pp.JointSpec("y"), SLIDE, ENDLESS), (0.03,) * 3)
LOADED = """<robot name="r"><link name="a"/><link name="b"/><link name="c"/><link name="d"/><link name="e"/>
<joint name="turn" type="revolute"><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
<origin xyz="0.1 0 0"/><limit effort="1" velocity="2.5" lower="-2.9" upper="0.1"/></joint>
<joint name="endless" type="continuous"><parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
<origin xyz="0.1 0 0"/><limit effort="1" velocity="inf"/></joint>
<joint name="slide" type="prismatic"><parent link="c"/><child link="d"/><axis xyz="1 0 0"/>
<origin xyz="0.1 0 0"/><limit effort="1" velocity="0.3" lower="0.2" upper="0.7"/></joint>
<joint name="wrist" type="revolute"><parent link="d"/><child link="e"/><axis xyz="0 1 0"/>
<origin xyz="0.1 0 0"/><limit effort="1" velocity="3.4028e+38" lower="-1" upper="1"/></joint></robot>"""
ARMS = {
    "spatial": lambda: pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.8, 0.3)] * 4),
    "planar": lambda: pp.Arm.from_template("Rz", 6),
    "sliding": lambda: pp.Arm.from_modules([SLIDING] * 3),
    "loaded": lambda: pp.Arm.load(LOADED, split=[2, 2]),
}
ALLOWED = 1e-9


@cache
def arm_called(name: str) -> pp.Arm:
    return ARMS[name]()


def limited() -> pp.Arm:
    return arm_called("spatial")


def edges_of(arm: pp.Arm, margin: float) -> tuple[np.ndarray, np.ndarray]:
    return arm.limits.lower + margin, arm.limits.upper - margin


def middle_of(arm: pp.Arm) -> np.ndarray:
    lower = np.maximum(arm.limits.lower, -1.0)
    upper = np.minimum(arm.limits.upper, 1.0)
    return (lower + upper) / 2.0


def choice(rng: np.random.Generator, policy: str, box: object) -> np.ndarray:
    """One dq out of a box: an edge of it, any of its points, or for each joint something else."""
    share = {"lower": 0.0, "upper": 1.0}.get(policy)
    if share is None:
        share = rng.uniform(size=len(box.lower)) if policy == "random" else rng.integers(0, 2, len(box.lower))
    return box.lower + share * (box.upper - box.lower)


@given(
    kind=st.sampled_from(sorted(ARMS)),
    policies=st.lists(st.sampled_from(["lower", "upper", "random", "edges"]), min_size=1, max_size=4),
    step=st.sampled_from([None, 0.02, 0.1]),
    acceleration=st.floats(0.3, 300.0),
    per_joint=st.booleans(),
    margin=st.sampled_from([0.0, 0.01]),
    seed=st.integers(0, 10**6),
)
@examples(40)
def test_from_a_viable_state_no_choice_ever_leads_out(
    kind: str,
    policies: list[str],
    step: float | None,
    acceleration: float,
    per_joint: bool,
    margin: float,
    seed: int,
) -> None:
    arm = arm_called(kind)
    rng = np.random.default_rng(seed)
    dt = 0.02
    largest = acceleration * (rng.uniform(0.2, 1.0, arm.nv) if per_joint else np.ones(arm.nv))
    limits = pp.Limits(
        step=step, dt=dt, position_margin=margin, acceleration=largest if per_joint else acceleration
    )
    lower, upper = edges_of(arm, margin)
    speed = arm.limits.velocity * dt if step is None else np.minimum(step, arm.limits.velocity * dt)
    q = arm.configuration(middle_of(arm))
    previous = None
    for k in range(120):
        state = arm.at(q)
        box = limits.step_bounds(state, previous)
        assert box.violated_constraints == ()
        assert np.all(box.lower <= box.upper)
        dq = choice(rng, policies[k // 30 % len(policies)], box)
        assert np.all(np.isfinite(dq))
        assert np.all(np.abs(dq) <= speed + ALLOWED)
        before = np.zeros(arm.nv) if previous is None else previous
        assert np.all(np.abs(dq - before) <= largest * dt**2 + ALLOWED)
        q = arm.integrate(q, dq)
        previous = dq
        positions = arm.positions(q)
        assert np.all(positions >= lower - ALLOWED)
        assert np.all(positions <= upper + ALLOWED)


@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_a_joint_that_always_takes_the_edge_stops_exactly_at_its_limit() -> None:
    limits = pp.Limits(step=0.07, velocity=9.0, dt=0.02, acceleration=20.0)  # dq changes by at most 0.008
    q = limited().configuration(np.full(8, -0.75))
    previous = None
    steps = []
    while previous is None or np.abs(previous).max() > 1e-12:
        previous = limits.step_bounds(limited().at(q), previous).upper
        q = limited().integrate(q, previous)
        steps.append(previous[0])
    np.testing.assert_allclose(limited().positions(q), 0.3, atol=1e-12)
    assert max(steps) == pytest.approx(0.07)
    assert np.abs(np.diff([0.0, *steps])).max() <= 0.008 + 1e-12
    assert len(steps) < 40


def test_a_start_outside_its_limits_is_named_and_brought_back() -> None:
    arm = arm_called("loaded")
    q = arm.configuration([0.5, 40.0, 0.1, 0.0])
    for limits in (pp.Limits(step=0.05), pp.Limits(step=0.05, dt=0.02, acceleration=10.0)):
        box = limits.step_bounds(arm.at(q))
        assert len(box.violated_constraints) == 2
        assert "joint 'turn' is at 0.5, outside -2.9 to 0.1 rad" in box.violated_constraints[0]
        assert "joint 'slide' is at 0.1, outside 0.2 to 0.7 m" in box.violated_constraints[1]
        here = q
        previous = None
        outside = [0.4]
        while not arm.within_limits(here):
            step = limits.apply(arm.at(here), np.array([1.0, 0.0, -1.0, 0.0]), previous)
            assert np.all(np.abs(step.dq) <= 0.05 + ALLOWED)
            if limits.acceleration is not None:
                before = np.zeros(4) if previous is None else previous
                assert np.all(np.abs(step.dq - before) <= 10.0 * 0.02**2 + ALLOWED)
            here = arm.integrate(here, step.dq)
            previous = step.dq
            outside.append(arm.positions(here)[0] - 0.1)
            assert len(outside) < 40
        assert np.all(np.diff(outside) < 0.0)
        assert limits.step_bounds(arm.at(here), previous).violated_constraints == ()
        # It comes to rest at the limit: nothing carries it past.
        assert outside[-1] == pytest.approx(0.0, abs=1e-9)


def test_a_margin_that_the_start_does_not_keep_is_named() -> None:
    state = limited().at(np.full(8, 0.295))
    assert pp.Limits().step_bounds(state).violated_constraints == ()
    relaxed = pp.Limits(position_margin=0.01).step_bounds(state).violated_constraints
    assert len(relaxed) == 8
    assert "outside -0.79 to 0.29 rad" in relaxed[0]


def test_a_joint_that_is_too_fast_brakes_as_hard_as_it_may_and_is_named() -> None:
    limits = pp.Limits(step=0.1, dt=0.1, acceleration=1.0)  # dq changes by at most 0.01
    state = limited().at(np.full(8, 0.28))
    fast = np.zeros(8)
    fast[2] = 0.05
    fast[3] = -0.05
    fast[4] = 0.02
    box = limits.step_bounds(state, fast)
    assert len(box.violated_constraints) == 1
    assert "position limit: joint 'm02_j1_y' at " in box.violated_constraints[0]
    assert box.lower[2] == box.upper[2] == pytest.approx(0.04)
    assert box.lower[3] == pytest.approx(-0.06)
    assert box.lower[4] == pytest.approx(0.01)


def test_a_joint_faster_than_its_bound_takes_the_bound_and_is_named() -> None:
    limits = pp.Limits(step=0.1, dt=0.1, acceleration=1.0)
    fast = np.zeros(8)
    fast[1] = -0.3
    fast[6] = 0.105
    box = limits.step_bounds(limited().at(np.r_[np.zeros(6), -0.6, 0.0]), fast)
    assert len(box.violated_constraints) == 1
    assert "acceleration limit: braking leaves joint 'm01_j2_z' a step" in box.violated_constraints[0]
    assert box.lower[1] == box.upper[1] == -0.1
    assert box.lower[6] == pytest.approx(0.095)
    assert box.upper[6] == 0.1


@given(st.integers(0, 10**6), st.sampled_from(sorted(ARMS)))
@examples(40)
def test_from_any_state_the_box_holds_the_bound_and_full_braking_at_least(seed: int, kind: str) -> None:
    arm = arm_called(kind)
    rng = np.random.default_rng(seed)
    limits = pp.Limits(step=0.1, dt=0.1, acceleration=rng.uniform(0.5, 5.0, arm.nv))
    state = arm.at(arm.configuration(rng.normal(0.0, 2.0, arm.nv)))
    previous = rng.normal(0.0, 0.1, arm.nv)
    positions = arm.positions(state.q)
    box = limits.step_bounds(state, previous)
    brake = limits.acceleration * 0.01
    assert np.all(box.lower <= box.upper)
    bound = np.minimum(0.1, 0.1 * arm.limits.velocity)
    assert np.all(np.abs([box.lower, box.upper]) <= bound)
    slower = np.abs(previous) <= bound
    for edge in (box.lower, box.upper):
        assert np.all(np.abs(edge - previous)[slower] <= brake[slower] + ALLOWED)
    # Who is outside and does not move outwards is not led farther out.
    below = positions < arm.limits.lower
    above = positions > arm.limits.upper
    assert np.all(box.upper[above & (previous <= 0.0)] <= 0.0)
    assert np.all(box.lower[below & (previous >= 0.0)] >= 0.0)
    named = " ".join(box.violated_constraints)
    assert {each.partition(":")[0] for each in box.violated_constraints} <= {*CONSTRAINTS}
    for joint in np.flatnonzero(below | above):
        assert f"position limit: joint {arm.chain.joints[joint]!r}" in named


def test_joints_off_the_chain_are_left_alone() -> None:
    model = pin.Model()
    link = pin.SE3(np.eye(3), np.array([0.1, 0.0, 0.0]))
    for parent, joint in ((0, "a"), (1, "aside"), (1, "b")):
        model.addJoint(parent, pin.JointModelRZ(), link, joint)
    model.addFrame(pin.Frame("end", 3, 0, link, pin.FrameType.OP_FRAME))
    model.lowerPositionLimit = np.full(3, -1.0)
    model.upperPositionLimit = np.full(3, 1.0)
    arm = pp.Arm.from_model(model, ["end"])
    state = arm.at([0.0, 2.0, 0.0])
    limits = pp.Limits(step=0.1, dt=0.1, acceleration=5.0)
    box = limits.step_bounds(state)
    assert box.violated_constraints == ()
    np.testing.assert_allclose([box.lower, box.upper], [[-0.05] * 3, [0.05] * 3])
    limited = limits.apply(state, np.array([1.0, 0.0, -1.0]))
    np.testing.assert_allclose(limited.dq, [0.05, 0.0, -0.05], atol=1e-15)
    assert limited.dq[1] == 0.0
    fast = limits.step_bounds(state, np.array([0.0, 0.4, 0.0]))
    assert "joint 'aside'" in fast.violated_constraints[0]


@given(st.integers(0, 10**6), st.sampled_from(sorted(ARMS)), st.sampled_from([None, 0.1]))
@examples(40)
def test_without_an_acceleration_limit_steps_are_scaled_and_cut(
    seed: int, kind: str, step: float | None
) -> None:
    arm = arm_called(kind)
    rng = np.random.default_rng(seed)
    limits = pp.Limits(step=step, dt=0.04, position_margin=0.005)
    state = arm.at(arm.configuration(rng.normal(0.0, 1.0, arm.nv)))
    asked = rng.normal(0.0, rng.choice([0.01, 0.1, 10.0]), arm.nv)
    limited = limits.apply(state, asked, rng.normal(size=arm.nv))
    box = limits.step_bounds(state)
    bounds = [min(np.inf if step is None else step, v * 0.04) for v in arm.limits.velocity]
    scale = min([1.0, *(b / abs(d) for b, d in zip(bounds, asked, strict=True) if d)])
    assert limited.scale == pytest.approx(scale, rel=1e-12)
    for joint, at in enumerate(arm.positions(state.q)):
        low, high = (edge[joint] - at for edge in edges_of(arm, 0.005))
        cut = min(max(limited.scale * asked[joint], low), high)
        cut = min(max(cut, -bounds[joint]), bounds[joint])
        assert limited.dq[joint] == cut
        assert limited.clipped[joint] == (cut != limited.scale * asked[joint])
        assert box.lower[joint] <= cut <= box.upper[joint]
    assert not limits.hold(state, asked).dq.any()


def test_limits_are_equal_and_travel_by_what_they_hold() -> None:
    limits = pp.Limits(step=None, dt=0.1, acceleration=[1.0, 2.0])
    assert limits == pp.Limits(None, None, 0.1, 0.0, np.array([1.0, 2.0]))
    assert hash(limits) == hash(pickle.loads(pickle.dumps(limits)))
    assert pickle.loads(pickle.dumps(limits)) == limits
    assert limits != pp.Limits(step=None, dt=0.1, acceleration=1.0)
    assert limits != pp.Limits(step=None, dt=0.1, velocity=[1.0, 2.0])
    assert limits != "limits"
    assert "acceleration=2.5" in repr(pp.Limits(dt=0.1, acceleration=2.5))
    assert not limits.acceleration.flags.writeable


def test_a_cycle_time_that_may_be_in_milliseconds_is_reported() -> None:
    text = r"dt is 20 s, long for a control cycle; is it in milliseconds\?"
    with pytest.warns(pp.PostureWarning, match=text) as told:
        assert pp.Limits(dt=20).dt == 20.0
    assert told[0].filename == __file__
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        pp.Limits(dt=1.0)


def test_what_is_remembered_of_an_arm_does_not_keep_it() -> None:
    arm = pp.Arm.from_template("Rz", 3)
    for step in np.linspace(0.01, 0.1, 40):
        assert pp.Limits(step=step).bound(arm.at(arm.neutral()))[0] == step
    gone = weakref.ref(arm)
    del arm
    gc.collect()
    assert gone() is None


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: pp.Limits(acceleration=1.0), "dt is not given.*needed to limit the acceleration"),
        (lambda: pp.Limits(acceleration=0.0, dt=0.1), "acceleration is 0"),
        (lambda: pp.Limits(acceleration=[1.0, -1.0], dt=0.1), "acceleration"),
        (lambda: pp.Limits(acceleration="x", dt=0.1), "acceleration is 'x'"),
        (
            lambda: pp.Limits(acceleration=np.ones(3), dt=0.1).step_bounds(limited().at(np.zeros(8))),
            r"acceleration \(sh",
        ),
        (
            lambda: pp.Limits(position_margin=0.6).step_bounds(limited().at(np.zeros(8))),
            "position_margin is 0.6",
        ),
        (lambda: BRAKING.step_bounds(limited().at(np.zeros(8)), np.zeros(7)), r"previous \(shape\)"),
        (lambda: BRAKING.apply(limited().at(np.zeros(8)), np.zeros(8), np.full(8, np.nan)), r"previous\[0\]"),
        (lambda: BRAKING.hold(limited().at(np.zeros(8)), "x"), "previous is 'x'"),
    ],
)
def test_bad_accelerations_are_named(make: object, message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        make()


BRAKING = pp.Limits(dt=0.1, acceleration=1.0)


@pytest.mark.parametrize("acceleration", [1e-250, 1e-12, 1e12, 1e300, np.inf])
@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_extreme_accelerations_give_finite_steps(acceleration: float) -> None:
    for kind in ARMS:
        arm = arm_called(kind)
        limits = pp.Limits(step=0.1, dt=1e-3, velocity=1e9, acceleration=acceleration)
        for q in (arm.configuration(middle_of(arm)), arm.configuration(np.full(arm.nv, 1.7))):
            box = limits.step_bounds(arm.at(q), np.zeros(arm.nv))
            assert np.all(np.isfinite(box.lower) & np.isfinite(box.upper))
            dq = limits.apply(arm.at(q), np.ones(arm.nv)).dq
            assert np.all(np.isfinite(dq))
            if acceleration >= 1e12:
                np.testing.assert_array_equal(dq, pp.Limits(step=0.1).apply(arm.at(q), np.ones(arm.nv)).dq)
