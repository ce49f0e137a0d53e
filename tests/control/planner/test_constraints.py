"""Constraints that users write are kept by plans and steps, and runs say where they could not be."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.collision import CollisionModel
from pinposture.control import Geodesic
from pinposture.control.constraint import inequalities_of
from pinposture.errors import ControllerError, InvalidValue
from pinposture.motion import Tracker

MODULES = 10


def arm() -> pp.Arm:
    return template_arm("RyRz", MODULES)


@dataclass(frozen=True)
class LinkInCone:
    """The link before a control point stays within an angle of the x axis."""

    point: int = 5
    angle: float = 0.45
    name: str = "camera"

    def rows(self, state):
        axis = np.array([1.0, 0.0, 0.0])
        link = state.rotations[self.point][:, 0]
        size = state.arm.length
        matrix = size * np.cross(link, axis) @ state.angular_jacobians[self.point]
        return matrix[None], [size * (np.cos(self.angle) - link @ axis)], [np.inf]


@dataclass(frozen=True)
class Between:
    """All control points stay between two heights."""

    lowest: float = -0.04
    highest: float = 0.2

    def rows(self, state):
        height = state.points[:, 2]
        return state.jacobians[:, 2], self.lowest - height, self.highest - height


KINDS = {"cone": LinkInCone(), "heights": Between()}


def excess_by_pinocchio(kind: str, q: np.ndarray) -> float:
    """By how much a configuration violates a constraint [m]; shares no code with it."""
    model = arm().model
    data = model.createData()
    pin.framesForwardKinematics(model, data, q)
    placements = [data.oMf[model.getFrameId(name)] for name in arm().control_points]
    if kind == "cone":
        cosine = placements[5].rotation[0, 0]
        return float(arm().length * (np.cos(0.45) - cosine))
    heights = np.array([placement.translation[2] for placement in placements])
    return float(max(-0.04 - heights.min(), heights.max() - 0.2))


def draw(kind: str, rng: np.random.Generator, inside: bool) -> np.ndarray:
    while True:
        q = pp.arm.smooth_configuration(arm(), rng, 0.8)
        excess = excess_by_pinocchio(kind, q)
        if excess < -0.005 if inside else 0.01 < excess < 0.1:
            return q


def sweeping_pair(kind: str, seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Two configurations inside, between which the free way leads outside."""
    rng = np.random.default_rng(seed)
    while True:
        q0, q1 = draw(kind, rng, True), draw(kind, rng, True)
        free = pp.track(arm(), pp.Target.from_configuration(arm(), q1), q0)
        if max(excess_by_pinocchio(kind, q) for q in free.q) > 0.01:
            return q0, q1


def densely(run: pp.Run) -> np.ndarray:
    """Configurations of a run and five between each two, (k, nq)."""
    rows = [
        pin.interpolate(run.arm.model, a, b, share)
        for a, b in zip(run.q, run.q[1:], strict=False)
        for share in np.linspace(0.0, 1.0, 6)
    ]
    return np.array(rows)


LIMITS = {"step": pp.Limits(), "acceleration": pp.Limits(velocity=2.0, acceleration=10.0, dt=0.01)}


@pytest.mark.long
@pytest.mark.parametrize("limits", LIMITS)
@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("kind", KINDS)
def test_an_arm_reaches_its_target_within_a_constraint(kind: str, seed: int, limits: str) -> None:
    q0, q1 = sweeping_pair(kind, seed)
    controller = Geodesic(constraints=[KINDS[kind]])
    target = pp.Target.from_configuration(arm(), q1)
    run = pp.track(arm(), target, q0, controller, limits=LIMITS[limits], max_steps=1500)
    assert run.converged, run.verdict
    assert max(excess_by_pinocchio(kind, q) for q in densely(run)) <= 0.0
    assert "constraint" not in run.violated_steps
    assert run.excess is None


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_obstacles_and_a_constraint_are_kept_together(kind: str) -> None:
    q0, q1 = sweeping_pair(kind, 7)
    middle = arm().at(q1).points[-1] + np.array([0.0, 0.0, -0.06])
    scene = pp.Scene({"ball": pp.Sphere(middle, 0.03)}, margin=0.004)
    target = pp.Target.from_configuration(arm(), q1)
    run = pp.track(arm(), target, q0, Geodesic(constraints=[KINDS[kind]]), scene=scene, max_steps=1500)
    assert max(excess_by_pinocchio(kind, q) for q in densely(run)) <= 0.0
    model = CollisionModel(arm(), scene)
    began = model.minimum(q0).distance
    assert min(model.minimum(q).distance for q in run.q) >= min(0.004, began) - 1e-6
    assert run.converged, run.verdict


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_an_arm_that_begins_outside_returns_and_the_verdict_says_so(kind: str) -> None:
    rng = np.random.default_rng(3)
    q0, q1 = draw(kind, rng, False), draw(kind, rng, True)
    run = pp.track(arm(), pp.Target.from_configuration(arm(), q1), q0, Geodesic(constraints=[KINDS[kind]]))
    assert run.converged
    excess = np.array([excess_by_pinocchio(kind, q) for q in run.q])
    assert excess.max() == pytest.approx(excess[0])  # no farther out than at the start
    outside = np.flatnonzero(excess[:-1] > 1e-6 * arm().length)
    np.testing.assert_array_equal(run.violated_steps["constraint"], outside)
    name = "camera" if kind == "cone" else "Between"
    assert f"{name} is violated by {1e3 * excess[0]:.3g} mm in step 1" in run.verdict
    assert any(name in fault for fault in run.faults)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_a_target_outside_is_approached_as_far_as_the_constraint_allows(kind: str) -> None:
    rng = np.random.default_rng(4)
    q0, q1 = draw(kind, rng, True), draw(kind, rng, False)
    run = pp.track(arm(), pp.Target.from_configuration(arm(), q1), q0, Geodesic(constraints=[KINDS[kind]]))
    assert run.status == "stalled"
    assert f"constraint {'camera' if kind == 'cone' else 'Between'}" in run.reason
    excess = [excess_by_pinocchio(kind, q) for q in run.q]
    assert max(excess) <= 0.0
    assert excess[-1] > -0.005 * arm().length  # it is held there, not somewhere before
    assert run.mean_error[-1] < 0.5 * run.mean_error[0]


def test_a_run_that_ends_outside_at_once_says_so() -> None:
    q = draw("cone", np.random.default_rng(5), False)
    run = pp.track(arm(), pp.Target.from_configuration(arm(), q), q, Geodesic(constraints=[LinkInCone()]))
    assert "camera is violated by" in run.verdict


@pytest.mark.long
def test_a_tracker_keeps_a_constraint() -> None:
    q0, q1 = sweeping_pair("cone", 1)
    tracker = Tracker(arm(), Geodesic(constraints=[LinkInCone()]), LIMITS["acceleration"])
    tracker.update(pp.Target.from_configuration(arm(), q1))
    q = q0
    worst = -np.inf
    for _ in range(600):
        q = arm().integrate(q, tracker.step(q))
        worst = max(worst, excess_by_pinocchio("cone", q))
        if tracker.report.status == "converged":
            break
    assert tracker.report.status == "converged"
    assert worst <= 0.0


@pytest.mark.long
def test_a_plan_keeps_a_constraint_and_says_if_it_cannot() -> None:
    q0, q1 = sweeping_pair("cone", 2)
    start = arm().at(q0)
    path = pp.control.plan(start, pp.Target.from_configuration(arm(), q1), constraints=[LinkInCone()])
    assert not path.blocked_by
    assert max(excess_by_pinocchio("cone", q) for q in path.configurations) <= 0.0
    free = pp.control.plan(start, pp.Target.from_configuration(arm(), q1))
    assert max(excess_by_pinocchio("cone", q) for q in free.configurations) > 0.01


@dataclass(frozen=True)
class Apart:
    """The first joint is not within 0.1 rad of zero."""

    def rows(self, state):
        first = state.positions[0]
        matrix = np.zeros((1, state.arm.nv))
        matrix[0, 0] = 1.0 if first > 0.0 else -1.0
        return matrix, [0.1 - abs(first)], [np.inf]


@pytest.mark.parametrize(("first", "last", "named"), ((0.0, -0.3, "start"), (-0.3, 0.05, "goal")))
def test_a_path_names_the_constraint_that_an_end_violates(first: float, last: float, named: str) -> None:
    short = template_arm("RyRz", 3)
    start = np.full(short.nq, first)
    goal = np.full(short.nq, last)
    path = pp.plan(short.at(start), pp.Target.from_configuration(short, goal), constraints=[Apart()])
    missing = 100.0 if named == "start" else 50.0
    assert f"at the {named}, constraint: Apart is violated by {missing:g} mm" in path.blocked_by
    kept = pp.plan(
        short.at(np.full(3 * 2, -0.3)),
        pp.Target.from_configuration(short, np.full(3 * 2, -0.2)),
        constraints=[Apart()],
    )
    assert kept.blocked_by == ""


@pytest.mark.long
def test_a_constraint_that_no_path_keeps_is_named_as_what_blocks_it() -> None:
    short = template_arm("RyRz", 3)
    start = np.full(short.nq, -0.3)
    target = pp.Target.from_configuration(short, np.full(short.nq, 0.3))
    path = pp.control.plan(short.at(start), target, constraints=[Apart()])
    assert "constraint: Apart is violated by" in path.blocked_by
    assert path.blocked_by in repr(path)


@pytest.mark.parametrize("kind", KINDS)
def test_the_sides_are_those_of_differences(kind: str) -> None:
    rng = np.random.default_rng(6)
    state = arm().at(pp.arm.smooth_configuration(arm(), rng, 0.8))
    inequalities = inequalities_of([KINDS[kind]], state)
    assert max(0.0, excess_by_pinocchio(kind, state.q)) == pytest.approx(inequalities.violation, abs=1e-12)
    for unit in np.eye(arm().nv):
        ahead, behind = (inequalities_of([KINDS[kind]], state.moved(h * unit)).room for h in (1e-6, -1e-6))
        np.testing.assert_allclose(inequalities.matrix @ unit, (ahead - behind) / 2e-6, atol=1e-8)


class Given:
    """Returns what it is given."""

    def __init__(self, value) -> None:
        self.value = value

    def rows(self, state):
        return self.value


ONE = np.ones((1, 2 * MODULES))


@pytest.mark.parametrize(
    ("value", "what"),
    [
        (None, "three arrays"),
        ((ONE, [0.0]), "three arrays"),
        ((np.ones((1, 3)), [0.0], [1.0]), "shape"),
        ((np.nan * ONE, [0.0], [1.0]), "finite"),
        ((ONE, [0.0, 0.0], [1.0, 1.0]), "shape"),
        ((ONE, ["a"], [1.0]), "three arrays"),
        ((ONE, [np.nan], [1.0]), "lower <= upper"),
        ((ONE, [1.0], [0.0]), "lower <= upper"),
        ((ONE, [1.0 + 1.0j], [2.0]), "three arrays"),
        ((ONE * (1.0 + 1.0j), [-1.0], [2.0]), "finite numbers"),
        ((ONE, [np.inf], [np.inf]), "lower not inf"),
        ((ONE, [-np.inf], [-np.inf]), "upper not -inf"),
    ],
)
def test_what_is_no_constraint_is_refused(value, what: str) -> None:
    target = pp.Target.from_configuration(arm(), 0.2 * np.ones(arm().nv))
    with pytest.raises(InvalidValue, match=what) as refused:
        pp.track(arm(), target, arm().neutral(), Geodesic(constraints=[Given(value)]))
    assert "Given.rows(state)" in str(refused.value)


def test_an_exception_in_a_constraint_names_it_and_its_line() -> None:
    class Broken:
        name = "mine"

        def rows(self, state):
            raise ValueError("my bug")

    target = pp.Target.from_configuration(arm(), 0.2 * np.ones(arm().nv))
    with pytest.raises(ControllerError, match=r"mine\.rows\(state\) raised ValueError: my bug \(test_.*line"):
        pp.track(arm(), target, arm().neutral(), Geodesic(constraints=[Broken()]))


class AtOnce(LinkInCone):
    """The same cone, told for many states at once."""

    calls = 0

    def violations(self, start, offsets):
        type(self).calls += 1
        states = [start.arm.at(start.arm.integrate(start.q, offset)) for offset in offsets]
        links = np.array([state.rotations[self.point][0, 0] for state in states])
        return start.arm.length * np.maximum(np.cos(self.angle) - links, 0.0)


def test_a_constraint_that_tells_of_many_states_at_once_leads_to_the_same_path() -> None:
    q0, q1 = sweeping_pair("cone", 2)
    start = arm().at(q0)
    target = pp.Target.from_configuration(arm(), q1)
    paths = [pp.control.plan(start, target, constraints=[kind()]) for kind in (LinkInCone, AtOnce)]
    assert AtOnce.calls
    np.testing.assert_array_equal(paths[0].offsets, paths[1].offsets)
    outside = pp.Target.from_configuration(arm(), 0.5 * np.ones(arm().nv))
    names = [
        pp.control.plan(start, outside, constraints=[kind()]).blocked_by for kind in (LinkInCone, AtOnce)
    ]
    assert names[0] == names[1] != ""


@pytest.mark.parametrize("value", [None, [0.0], [[0.0, 0.0]], np.nan])
def test_violations_that_are_not_one_for_each_state_are_refused(value) -> None:
    class Wrong(LinkInCone):
        def violations(self, start, offsets):
            return value if np.ndim(value) else np.full(len(offsets), np.nan) if value else value

    target = pp.Target.from_configuration(arm(), 0.2 * np.ones(arm().nv))
    with pytest.raises(InvalidValue, match=r"camera\.violations\(start, offsets\)"):
        pp.control.plan(arm().at(arm().neutral()), target, constraints=[Wrong()])


@pytest.mark.parametrize("wrong", [[3], [LinkInCone], LinkInCone(), None, ["cone"]])
def test_only_constraints_are_taken(wrong) -> None:
    with pytest.raises(InvalidValue, match="constraints"):
        Geodesic(constraints=wrong)


@pytest.mark.long
def test_a_constraint_that_never_binds_changes_nothing() -> None:
    q0, q1 = sweeping_pair("cone", 3)
    target = pp.Target.from_configuration(arm(), q1)
    free = pp.track(arm(), target, q0, Geodesic(scene=pp.Scene(self_collision=False)))
    wide = Geodesic(constraints=[Between(-10.0, 10.0)])
    run = pp.track(arm(), target, q0, wide)
    np.testing.assert_allclose(run.q, free.q, atol=1e-12)
