"""Switching: which method has control when, and that together they get there."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby, pairwise

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.control import CONTROLLERS, GeodesicMemory, controller_named
from pinposture.curve import HELIX, LINE
from pinposture.errors import InvalidValue, UnknownName


@pytest.fixture(scope="session")
def spatial() -> pp.Arm:
    return template_arm("RyRz", 12)


@pytest.fixture(scope="session")
def long() -> pp.Arm:
    return template_arm("RyRz", 20)


@pytest.fixture(scope="session")
def planar() -> pp.Arm:
    return template_arm("Rz", 20)


def posture(arm: pp.Arm, seed: int, amplitude: float = 0.6) -> np.ndarray:
    return smooth_configuration(arm, np.random.default_rng(seed), amplitude)


def stints(run: pp.Run) -> list[tuple[str, int]]:
    return [(name, len(list(steps))) for name, steps in groupby(run.info["method"].tolist())]


@pytest.fixture(scope="module")
def hard(long: pp.Arm) -> pp.Run:
    """A run from which Selection alone and Projection alone do not get to the helix."""
    return pp.track(long, pp.resolve_targets(long, HELIX), posture(long, 10, 0.9), "switching", max_steps=400)


def test_it_gets_where_neither_part_gets_alone(long: pp.Arm, hard: pp.Run) -> None:
    alone = [
        pp.track(long, hard.target, hard.q[0], name, max_steps=400) for name in ("selection", "projection")
    ]
    assert hard.converged
    assert all(run.point_errors[-1].mean() > 1e-3 * long.length for run in alone)


def test_each_step_is_one_of_the_method_that_it_names(long: pp.Arm, hard: pp.Run) -> None:
    """Selection's steps are Selection's; Projection's are those towards the target or towards a waypoint."""
    method = pp.Switching()
    aims = []
    for k in range(hard.steps):
        state = long.at(hard.q[k])
        moved = hard.q[k + 1] - hard.q[k]
        if hard.info["method"][k] == "selection":
            expected = method.selection.step(state, hard.target)
            np.testing.assert_allclose(moved, expected.dq, atol=1e-12)
            continue
        straight = method.projection.step(state, hard.target).dq
        way = hard.target.q - hard.q[k]
        ahead = long.at(hard.q[k] + way * min(1.0, method.reach / np.abs(way).max())).points
        waypoint = method.projection.step(state, replace(hard.target, points=ahead)).dq
        fits = [bool(np.allclose(moved, dq, atol=1e-12)) for dq in (straight, waypoint)]
        assert any(fits)
        aims.append(fits[0])
    assert aims[0]  # the first failover aims at the target itself, as in Figure 4.8
    assert not all(aims)


def test_every_change_of_method_is_recorded_with_its_reason(hard: pp.Run) -> None:
    changes = [k + 1 for k, (a, b) in enumerate(pairwise(hard.info["method"])) if a != b]
    assert [switch.step for switch in hard.switches] == changes
    assert len(changes) > 2
    for switch in hard.switches:
        expected = "Selection has control points" if switch.method == "selection" else "did not fall by 10 %"
        assert expected in switch.reason


def test_the_stints_of_projection_double_so_that_it_cannot_chatter(hard: pp.Run) -> None:
    # Some last longer, because Selection finds no control points when they are over; the last one may be cut.
    lengths = [length for name, length in stints(hard) if name == "projection"]
    assert len(lengths) > 2
    for turn, length in enumerate(lengths[:-1]):
        assert length >= 5 * 2**turn
    waits = [length for name, length in stints(hard) if name == "selection"]
    assert all(wait >= 3 for wait in waits)


def test_from_the_straight_arm_projection_begins_and_says_why(spatial: pp.Arm) -> None:
    run = pp.track(spatial, pp.resolve_targets(spatial, HELIX), spatial.straight(), "switching")
    assert run.info["method"][0] == "projection"
    assert "absolute manipulability condition" in run.info["switched"][0]
    assert "selection" in run.info["method"]
    assert run.converged


def test_near_the_straight_line_projection_takes_over_and_stays(spatial: pp.Arm) -> None:
    run = pp.track(spatial, pp.resolve_targets(spatial, LINE), posture(spatial, 1), "switching")
    assert run.converged
    assert run.info["method"][-1] == "projection"
    assert pp.track(spatial, run.target, run.q[0], "selection").status == "no_control_points"


def test_without_a_known_configuration_every_stint_is_short_and_aims_at_the_target(spatial: pp.Arm) -> None:
    start = posture(spatial, 4)
    goal = pp.Target.from_points(spatial, spatial.at(posture(spatial, 5)).points)
    run = pp.track(spatial, goal, start, "switching", max_steps=120)
    assert not any(run.info["method"][k] == "projection" and _is_escape(run, k) for k in range(run.steps))
    assert all(length <= 5 for name, length in stints(run)[:-1] if name == "projection")


def _is_escape(run: pp.Run, k: int) -> bool:
    step = pp.Switching().projection.step(run.arm.at(run.q[k]), run.target)
    return not np.allclose(step.dq, run.q[k + 1] - run.q[k], atol=1e-12)


@pytest.mark.parametrize("largest", [0.02, 0.1])
def test_its_course_does_not_depend_on_the_rate_of_control(long: pp.Arm, largest: float) -> None:
    """Durations are joint travel: with a fifth of the step limit, a stint has five times as many steps."""
    target = pp.resolve_targets(long, HELIX)
    run = pp.track(
        long, target, long.straight(), "switching", pp.Limits(step=largest), max_steps=round(40 / largest)
    )
    assert run.converged
    assert stints(run)[0] == ("projection", round(0.5 / largest))


@given(st.integers(0, 10**6), st.sampled_from(["spatial", "planar"]), st.sampled_from([0.0, 1e-6, 0.7, 3.0]))
@examples(30)
def test_its_steps_are_finite_and_within_limits(
    spatial: pp.Arm, planar: pp.Arm, seed: int, kind: str, amplitude: float
) -> None:
    arm = spatial if kind == "spatial" else planar
    rng = np.random.default_rng(seed)
    points = rng.normal(0.0, rng.choice([1e-9, 0.2, 10.0]), (arm.n_modules, 3))
    known = pp.Target.from_configuration(arm, arm.configuration(rng.uniform(-3.0, 3.0, arm.nv)))
    target = known if seed % 2 else pp.Target.from_points(arm, points)
    run = pp.track(arm, target, amplitude * rng.uniform(-1, 1, arm.nv), "switching", max_steps=40)
    assert np.all(np.isfinite(run.q))
    assert np.all(np.abs(np.diff(run.q, axis=0)) <= 0.1 + 1e-12)
    assert np.all(np.abs(run.q) <= np.pi + 1e-12)
    assert set(run.info["method"]) <= {"selection", "projection"}


def test_what_another_controller_remembers_is_not_its_own(spatial: pp.Arm) -> None:
    target = pp.resolve_targets(spatial, HELIX)
    state = spatial.at(posture(spatial, 2))
    method = controller_named("switching")
    fresh = method.step(state, target)
    foreign = method.step(state, target, memory=GeodesicMemory(np.ones(spatial.nv)))
    np.testing.assert_array_equal(fresh.dq, foreign.dq)


@pytest.mark.parametrize(
    ("parameters", "message"),
    [
        ({"patience": 0.0}, "patience"),
        ({"stay": -1.0}, "stay"),
        ({"reach": float("nan")}, "reach"),
        ({"progress": 1.0}, "progress"),
        ({"hand_back": "soon"}, "hand_back is called 'soon'"),
        ({"selection": "selection"}, r"Selection\(\.\.\.\)"),
        ({"projection": pp.Selection()}, r"Projection\(\.\.\.\)"),
    ],
)
def test_bad_parameters_are_named(parameters: dict, message: str) -> None:
    with pytest.raises((InvalidValue, UnknownName), match=message):
        pp.Switching(**parameters)


@pytest.mark.parametrize("seed", range(6))
def test_selection_takes_up_again_as_soon_as_it_can(long: pp.Arm, seed: int) -> None:
    """Section 4.6.2: what it is given control for is a step that does lower the posture error."""
    start = long.straight() if seed % 2 else posture(long, seed, 0.9)
    goal = posture(long, 50 + seed, 0.9)
    target = pp.Target.from_configuration(long, goal)
    after, soon = (
        pp.track(long, target, start, pp.Switching(hand_back=when), max_steps=400)
        for when in ("after_stay", "when_possible")
    )
    assert after.converged and soon.converged
    assert np.mean(soon.info["method"] == "selection") >= np.mean(after.info["method"] == "selection")
    error = soon.posture_error
    resumed = [k for k, why in enumerate(soon.info["switched"]) if "again" in why]
    assert resumed
    for k in resumed:
        assert soon.info["method"][k] == "selection"
        assert error[k + 1] < error[k]


@pytest.mark.parametrize("region", [(19, 19), (10, 19), (0, 9), (5, 12)])
def test_a_region_of_the_arm_gets_there_too(long: pp.Arm, region: tuple[int, int]) -> None:
    """The joints before the region must bring its base into place, though no point of theirs has a target."""
    target = pp.Target.from_configuration(long, posture(long, 7, 0.8)).region(*region)
    run = pp.track(long, target, posture(long, 8, 0.8), "switching", max_steps=400)
    assert run.point_errors[-1].max() < 1e-3 * long.length


@pytest.mark.parametrize("largest", [0.01, 0.003])
def test_small_steps_get_there_as_well(largest: float) -> None:
    """Patience of the controller and of the loop are joint travel, not numbers of steps."""
    rng = np.random.default_rng(1)
    arm = pp.Arm.from_template("RyRz", 8)
    target = pp.Target.from_configuration(arm, arm.random(rng))
    run = pp.track(
        arm, target, arm.random(rng), limits=pp.Limits(step=largest), max_steps=round(60 / largest)
    )
    assert run.converged


@pytest.mark.parametrize("point", [0, 1, 2])
@pytest.mark.parametrize("seed", range(3))
def test_a_single_point_near_the_base_gets_there_though_selection_never_may_move_it(
    point: int, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    arm = pp.Arm.from_template("RyRz", 10)
    target = pp.Target.from_configuration(arm, arm.random(rng)).region(point, point)
    run = pp.track(arm, target, arm.random(rng))
    assert run.converged, run.reason


@pytest.mark.long
def test_joints_off_the_chain_stay_where_they_are(spatial: pp.Arm) -> None:
    model = pin.Model(spatial.model)
    camera = model.addJoint(4, pin.JointModelRX(), pin.SE3.Identity(), "camera")
    arm = pp.Arm.from_model(model, spatial.control_points)
    column = arm.model.joints[camera].idx_v
    rng = np.random.default_rng(0)
    start, goal = rng.uniform(-0.6, 0.6, (2, arm.nq))
    for name in CONTROLLERS:
        run = pp.track(arm, pp.Target.from_configuration(arm, goal), start, name, max_steps=60)
        assert np.all(run.q[:, column] == run.q[0, column]), name


@pytest.mark.parametrize("known", [True, False])
@pytest.mark.parametrize(
    "threshold", [0.4, 0.99]
)  # with the second, Projection hardly ever can move anything
@pytest.mark.parametrize("point", [0, 3, 11])
def test_a_switch_is_recorded_exactly_where_the_method_changes(
    spatial: pp.Arm, known: bool, threshold: float, point: int
) -> None:
    target = pp.Target.from_configuration(spatial, posture(spatial, 7, 0.9)).region(0, point)
    if not known:
        target = replace(target, q=None)
    method = pp.Switching(projection=pp.Projection(threshold=threshold, coupling="relative"))
    run = pp.track(spatial, target, posture(spatial, 8, 0.9), method, max_steps=80)
    before = np.concatenate([["selection"], run.info["method"][:-1]])
    assert [switch.step for switch in run.switches] == np.flatnonzero(run.info["method"] != before).tolist()


def test_selection_keeps_control_where_projection_cannot_move_and_no_way_is_known() -> None:
    arm = pp.Arm.from_template("Rz", 3)
    folded = np.array([0.0, 2.5, -2.6])
    goal = pp.Target.from_configuration(arm, folded + [0.3, 0.1, -0.2]).region(2, 2)
    method = pp.Switching(
        projection=pp.Projection(threshold=0.99, coupling="relative"), patience=0.1, progress=0.9
    )
    run = pp.track(arm, replace(goal, q=None), folded, method, pp.Limits(step=0.02), max_steps=30)
    assert run.steps > 5
    assert set(run.info["method"]) == {"selection"}
    assert run.switches == ()
    assert run.posture_error[-1] < run.posture_error[0]
    known = pp.track(arm, goal, folded, method, pp.Limits(step=0.02), max_steps=30)
    assert "projection" in known.info["method"]
    by_projection = np.flatnonzero(known.info["method"] == "projection")
    assert not known.active[by_projection].any()  # the joints went on by themselves
    assert np.all(np.abs(known.q[by_projection + 1] - known.q[by_projection]).max(axis=1) > 0.0)
