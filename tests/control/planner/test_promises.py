"""What the controller promises of every run, as properties."""

from __future__ import annotations

import daqp
import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from planner_runs import ARMS, KINDS, Case, arm_called, check_limits, drawn, steps_of
from sampling import examples

import pinposture as pp

SEEDS = st.integers(0, 2**32 - 1)
NAMES = st.sampled_from(sorted(ARMS))


@given(seed=SEEDS, name=NAMES, kind=st.sampled_from(KINDS))
@examples(20)
def test_limits_hold_and_errors_rise_only_in_escapes(seed: int, name: str, kind: str) -> None:
    case = drawn(seed, name, kind)
    run = case.track(max_steps=60)
    check_limits(case.arm, case.limits, run.q)
    assert np.all(np.isfinite(run.point_errors))
    assert not any(run.violated_constraints)
    rise = np.diff(run.posture_error)
    assert np.all(rise[~run.error_increasing] <= 1e-11 * case.arm.length)


def most_steps(case: Case, first: pp.ArmState) -> float:
    """Steps that the way of a case takes: the length of its pieces in units of the slowest joint.

    Each step but the last has a joint at its bound. No joint goes farther in a step than on the way between
    its ends, so each takes at least one unit off the way.
    """
    step = pp.Geodesic().step(first, case.target, case.limits)
    largest = np.minimum(case.limits.for_arm(case.arm).bound, 10.0 * case.arm.joint_units)
    pieces = np.abs(np.diff(step.memory.progress.path.offsets, axis=0)) / largest
    return float(pieces.max(axis=1).sum())


def check_arrival(case: Case) -> None:
    """It is there, at the very configuration, within the steps that its way takes; and kept its limits."""
    arm = case.arm
    bound = int(np.ceil(most_steps(case, arm.at(case.start)))) + 1
    run = case.track(max_steps=bound, tolerance=1e-6 * arm.length)
    assert run.converged, (run.steps, bound, run.reason)
    check_limits(arm, case.limits, run.q)
    assert np.linalg.norm(arm.at(run.q[-1]).points - case.target.points, axis=1).mean() <= 1e-6 * arm.length


FEWER = 4000
"""Steps that a case of drawn speeds takes at most: where it would take more, all joints are faster."""


def drawn_arm(rng: np.random.Generator) -> pp.Arm:
    """A chain of joints of all types, whose ranges are up to 40 rad and 400 m wide, or nothing at all."""

    def joint() -> pp.JointSpec:
        axis = str(rng.choice(["x", "y", "z"]))
        kind = rng.choice(["hinge", "slide", "continuous"], p=[0.7, 0.2, 0.1])
        if kind == "continuous":
            return pp.JointSpec(axis, type="continuous")
        widest = 10.0 ** (rng.uniform(-2.0, 2.6) if kind == "slide" else rng.uniform(0.0, 1.6))
        revolute = "prismatic" if kind == "slide" else "revolute"
        return pp.JointSpec(axis, type=revolute, lower=-widest * rng.uniform(0.3, 1.0), upper=widest)

    counts = rng.integers(1, 4, rng.integers(1, 7))
    lengths = [rng.uniform(0.02, 0.1, count) for count in counts]
    return pp.Arm.from_modules(
        [pp.ModuleTemplate(f"kind{k}", [joint() for _ in each], list(each)) for k, each in enumerate(lengths)]
    )


@given(seed=SEEDS, decades=st.sampled_from([0.0, 3.0, 4.0]))
@examples(20)
@pytest.mark.filterwarnings("ignore:limits of joint.* are they in degrees")
def test_any_arm_arrives_with_joints_of_any_speed_from_any_winding(seed: int, decades: float) -> None:
    rng = np.random.default_rng(seed)
    arm = drawn_arm(rng)
    position_limits = np.clip([arm.limits.lower, arm.limits.upper], -1e6, 1e6)
    position_limits = np.where(
        np.array(arm.kinematics.endless), np.pi * np.array([[-1.0], [1.0]]), position_limits
    )
    start, goal = (arm.configuration(rng.uniform(*position_limits)) for _ in range(2))
    slow = rng.random(arm.nv) < rng.random()
    step = arm.joint_units * 10.0 ** -np.where(slow, rng.uniform(0.0, decades, arm.nv), rng.random(arm.nv))
    case = Case(arm, start, pp.Target.from_configuration(arm, goal), pp.Limits(step=step))
    often = most_steps(case, arm.at(start)) / FEWER
    check_arrival(case._replace(limits=pp.Limits(step=step * max(often, 1.0))))


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.filterwarnings("ignore:limits of joint.* are they in degrees")
def test_an_arm_without_limits_unwinds(seed: int) -> None:
    arm = pp.Arm.from_modules([pp.template("RyRz").with_limits(-200.0, 200.0)] * 8)
    goal = np.random.default_rng(seed).uniform(-31.0, 31.0, arm.nv)
    check_arrival(Case(arm, np.zeros(arm.nv), pp.Target.from_configuration(arm, goal), pp.Limits()))


@pytest.mark.long
def test_one_slow_joint_keeps_the_others_waiting_and_no_more() -> None:
    arm = pp.Arm.from_template("RyRz", 8)
    start, goal = np.random.default_rng(0).uniform(-1.5, 1.5, (2, arm.nv))
    start[0] = -1.5
    goal[0] = 1.5
    step = np.full(arm.nv, 0.1)
    step[0] = 5e-4
    check_arrival(Case(arm, start, pp.Target.from_configuration(arm, goal), pp.Limits(step=step)))


def test_a_base_slides_as_far_as_it_is_to() -> None:
    far = pp.JointSpec("x", type="prismatic", lower=-1000.0, upper=1000.0)
    arm = pp.Arm.from_modules([pp.ModuleTemplate("rail", [far], [0.05]), *[pp.template("RyRz")] * 4])
    goal = np.random.default_rng(0).uniform(-1.0, 1.0, arm.nv)
    goal[0] = 300.0
    check_arrival(Case(arm, np.zeros(arm.nv), pp.Target.from_configuration(arm, goal), pp.Limits()))


def test_a_slow_rail_among_obstacles_is_no_reason_to_give_up() -> None:
    """An obstacle far off: it goes on as fast as the rail can, which is little of the way at a time."""
    rail = pp.JointSpec("x", type="prismatic", lower=-2.0, upper=2.0)
    arm = pp.Arm.from_modules([pp.ModuleTemplate("rail", [rail], [0.05]), *[pp.template("RyRz")] * 4])
    goal = np.random.default_rng(0).uniform(-0.5, 0.5, arm.nv)
    goal[0] = 1.0
    limits = pp.Limits(step=np.where(arm.slides, 2e-4, 0.1))
    case = Case(arm, np.zeros(arm.nv), pp.Target.from_configuration(arm, goal), limits)
    following_path: list[bool] = []

    def note(_: int, __: pp.ArmState, step: pp.Step) -> None:
        following_path.append(step.following_path)

    run = case.track(
        scene=pp.Scene({"far": pp.Sphere((0.0, 0.0, 9.0), 0.1)}, self_collision=False),
        max_steps=200,
        callback=note,
    )
    assert run.status == "max_steps", run.reason
    assert all(following_path)
    assert run.q[-1, 0] == pytest.approx(200 * 2e-4)


@given(seed=SEEDS, name=NAMES, size=st.sampled_from([0.05, 0.1, 0.3]), margin=st.sampled_from([0.0, 0.02]))
@examples(10)
def test_a_known_configuration_is_reached_in_the_steps_that_its_way_takes(
    seed: int, name: str, size: float, margin: float
) -> None:
    arm = arm_called(name)
    case = drawn(seed, name, "known", pp.Limits(step=size * arm.joint_units, position_margin=margin))
    bound = int(np.ceil(most_steps(case, arm.at(case.start)))) + 1
    run = case.track(max_steps=bound, tolerance=1e-9 * arm.length)
    assert run.converged, run.reason
    goal = np.array([pin.difference(arm.model, run.q[-1], case.target.q)])
    assert np.abs(goal / arm.joint_units).max() < 1e-6


@given(seed=SEEDS, name=NAMES)
@examples(15)
def test_the_way_is_no_longer_than_a_bound_known_beforehand(seed: int, name: str) -> None:
    """mu |way of the joints| <= length of joint interpolation in the metric J^T J + mu^2 I, by its energy."""
    case = drawn(seed, name, "known", pp.Limits())
    arm = case.arm
    controller = pp.Geodesic()
    mu = controller.joint_weight * arm.length / np.sqrt(arm.n_modules)
    offsets = controller.step(arm.at(case.start), case.target).memory.progress.path.offsets / arm.joint_units
    line = np.linspace(0.0, 1.0, len(offsets))[:, None] * offsets[-1]
    points = [arm.at(arm.integrate(case.start, x * arm.joint_units)).points for x in line]
    energy = float((np.diff(points, axis=0) ** 2).sum() + mu**2 * (np.diff(line, axis=0) ** 2).sum())
    travel = np.linalg.norm(np.diff(offsets, axis=0), axis=1).sum()
    assert mu * travel <= np.sqrt((len(offsets) - 1) * energy) * (1.0 + 1e-9)


@pytest.mark.parametrize("kind", ["known", "points", "far"])
@pytest.mark.parametrize("name", ["planar", "spatial"])
def test_the_same_call_gives_the_same_bits(name: str, kind: str) -> None:
    case = drawn(11, name, kind)
    first, again = (case.track(max_steps=40) for _ in range(2))
    assert first.q.tobytes() == again.q.tobytes()
    assert (first.status, first.reason) == (again.status, again.reason)


@pytest.mark.parametrize("name", ARMS)
def test_an_acceleration_limit_does_not_keep_it_from_a_known_configuration(name: str) -> None:
    """Where a joint comes to full speed within ten steps."""
    arm = arm_called(name)
    limits = pp.Limits(step=None, dt=0.1, velocity=1.0, acceleration=1.0)
    for seed in range(2):
        case = drawn(seed, name, "known", limits)
        run = case.track(max_steps=1500)
        check_limits(arm, limits, run.q)
        assert run.converged, (seed, run.reason)


@pytest.mark.parametrize(("dt", "acceleration"), [(0.01, 3.0), (0.002, 3.0)])
def test_a_low_acceleration_limit_costs_little_more_than_joint_interpolation(
    dt: float, acceleration: float
) -> None:
    """From rest it takes 50 and 250 steps to full speed; six times the way joint by joint is allowed."""
    limits = pp.Limits(step=None, dt=dt, velocity=1.5, acceleration=acceleration)
    arm = pp.Arm.from_template("RyRz", 5)
    start, goal = np.random.default_rng(0).uniform(-0.7, 0.7, (2, arm.nv))
    target = pp.Target.from_configuration(arm, goal)
    each = pp.track(arm, target, start, "joint", limits, max_steps=1000)
    assert each.converged
    run = pp.track(arm, target, start, limits=limits, max_steps=6 * each.steps)
    assert run.converged
    assert run.error_increasing.mean() < 0.1


@pytest.mark.parametrize("poison", ["nan", "garbage", "flag", "huge", "sometimes"])
@pytest.mark.parametrize("kind", ["points", "far"])
def test_a_poisoned_solver_breaks_no_limit(poison: str, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(0)
    honest = daqp.solve

    def solve(hessian: np.ndarray, gradient: np.ndarray, *rest: object, **options: object) -> tuple:
        n = len(gradient)
        if poison == "sometimes" and rng.random() < 0.5:
            return honest(hessian, gradient, *rest, **options)
        if poison == "flag":
            return np.zeros(n), 0.0, int(rng.choice([-1, -2, -3, -4, -5, 0, 7])), {}
        x = {"nan": np.full(n, np.nan), "huge": np.full(n, 1e300)}.get(poison, rng.normal(size=n))
        return x, 0.0, 1, {}

    monkeypatch.setattr(daqp, "solve", solve)
    for seed, name in enumerate(ARMS):
        case = drawn(seed, name, kind)
        run = case.track(max_steps=15)
        check_limits(case.arm, case.limits, run.q)
        rise = np.diff(run.posture_error)
        assert np.all(rise[~run.error_increasing] <= 1e-11 * case.arm.length)


def test_a_poisoned_solver_does_not_keep_a_free_arm_from_a_known_configuration(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Its way needs no program."""
    monkeypatch.setattr(daqp, "solve", lambda _, g, *__, **___: (np.full(len(g), np.nan), 0.0, 1, {}))
    case = drawn(3, "planar", "known", pp.Limits())
    assert case.track().converged


def test_disturbed_steps_still_arrive() -> None:
    """Between steps the arm is pushed by more than it moves itself, at first."""
    for seed, name in enumerate(("planar", "spatial", "short")):
        case = drawn(seed, name, "known", pp.Limits(step=0.1))
        arm = case.arm
        controller = pp.Geodesic()
        memory = None
        rng = np.random.default_rng(seed)
        q = case.start
        steps = 0
        while steps < 400:
            state = arm.at(q)
            if np.linalg.norm(case.target.points - state.points, axis=1).mean() < 1e-6 * arm.length:
                break
            step = controller.step(state, case.target, case.limits, memory)
            assert np.all(np.abs(step.dq) <= 0.1 + 1e-12)
            push = 0.15 * rng.normal(size=arm.nv) if steps < 15 else np.zeros(arm.nv)
            pushed = arm.positions(arm.integrate(q, step.dq)) + push
            q = arm.configuration(np.clip(pushed, arm.limits.lower, arm.limits.upper))
            memory = step.memory
            steps = steps + 1
        assert steps < 400, name


def test_steps_are_what_the_record_says() -> None:
    case = drawn(5, "sliding", "known", pp.Limits(step=0.05))
    steps: list[np.ndarray] = []
    run = case.track(callback=lambda _, __, step: steps.append(step.dq) and None)
    np.testing.assert_allclose(steps_of(case.arm, run.q), steps, atol=1e-12)
