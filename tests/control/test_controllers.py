"""Selection and Projection: what their steps promise, checked by other means."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from analytic import ryrz
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import seeds

import pinposture as pp
from pinposture.control import SectionTree, Step, active_set, controller_named, section_indices
from pinposture.control.controller import task_errors
from pinposture.errors import InvalidValue, UnknownName

FREE = pp.Limits(step=None)
THESIS = ("selection", "projection")
PLACEMENT = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -2.0, 0.7]))


@pytest.fixture(scope="session")
def spatial() -> pp.Arm:
    return template_arm("RyRz", 8)


@pytest.fixture(scope="session")
def planar() -> pp.Arm:
    return template_arm("Rz", 12)


@pytest.fixture(scope="session")
def narrow() -> pp.Arm:
    return pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.8, 0.8)] * 8)


def target_of(arm: pp.Arm, seed: int, amplitude: float = 0.5) -> pp.Target:
    rng = np.random.default_rng(seed + 10**6)
    return pp.Target.from_configuration(arm, arm.configuration(amplitude * rng.uniform(-1, 1, arm.nv)))


def state_of(arm: pp.Arm, seed: int, amplitude: float) -> pp.ArmState:
    return arm.at(arm.configuration(amplitude * np.random.default_rng(seed).uniform(-1, 1, arm.nv)))


def active_jacobian(state: pp.ArmState, step: Step) -> np.ndarray:
    return np.vstack([state.task_jacobians[k] for k in step.active])


def step_with(method: pp.Selection | pp.Projection) -> pp.Step:
    arm = pp.Arm.from_template("RyRz", 6)
    return method.step(state_of(arm, 0, 0.5), target_of(arm, 0))


@given(st.integers(0, 10**6), st.sampled_from([0.3, 1.0, 3.0]), st.sampled_from(["spatial", "planar"]))
def test_selection_moves_its_points_straight_to_their_targets(
    spatial: pp.Arm, planar: pp.Arm, seed: int, amplitude: float, kind: str
) -> None:
    arm = spatial if kind == "spatial" else planar
    state = state_of(arm, seed, amplitude)
    target = target_of(arm, seed)
    method = pp.Selection(gain=0.7, null_gain=0.3)
    step = method.step(state, target, pp.Limits(step=1e6))
    if not step.active:
        assert step.reason
        return
    matrix = active_jacobian(state, step)
    errors = task_errors(state, target)[list(step.active)].ravel()
    if not step.clipped.any():
        np.testing.assert_allclose(matrix @ step.dq, 0.7 * errors, atol=1e-8)
    sigma = np.linalg.svd(matrix, compute_uv=False)
    assert np.linalg.matrix_rank(matrix) == len(matrix) == step.info["rows"]
    assert step.info["sigma_min"] == pytest.approx(sigma[-1], rel=1e-6)
    assert sigma[-1] > method.conditioning * arm.length


@given(st.integers(0, 10**6), st.sampled_from(["spatial", "planar"]))
def test_each_point_has_a_gain_of_its_own(spatial: pp.Arm, planar: pp.Arm, seed: int, kind: str) -> None:
    arm = spatial if kind == "spatial" else planar
    state = state_of(arm, seed, 1.0)
    target = target_of(arm, seed)
    gains = np.random.default_rng(seed).uniform(0.1, 1.0, arm.n_modules)
    errors = gains[:, None] * task_errors(state, target)
    step = pp.Selection(gain=gains).step(state, target, pp.Limits(step=1e6))
    if step.active and not step.clipped.any():
        asked = errors[list(step.active)].ravel()
        np.testing.assert_allclose(active_jacobian(state, step) @ step.dq, asked, atol=1e-8)
    method = pp.Projection(gain=tuple(gains), null_gain=0.0)
    step = method.step(state, target, pp.Limits(step=1e6))
    matrix, velocity, *_ = method.posture_control_matrix(state, errors, target.has_target)
    if not step.clipped.any():
        np.testing.assert_allclose(matrix @ step.dq, velocity, atol=1e-8)


@given(st.integers(0, 10**6), st.sampled_from(["spatial", "planar"]))
def test_an_objective_is_followed_as_far_as_the_points_leave_room(
    spatial: pp.Arm, planar: pp.Arm, seed: int, kind: str
) -> None:
    arm = spatial if kind == "spatial" else planar
    state = state_of(arm, seed, 0.8)
    target = target_of(arm, seed)
    wish = 0.05 * np.random.default_rng(seed).normal(size=arm.nv)
    seen = []

    def objective(at: pp.ArmState, to: pp.Target) -> np.ndarray:
        seen.append((at, to))
        return wish

    for kind_of_method in (pp.Selection, pp.Projection):
        method = kind_of_method(null_gain=0.3, null_objective=objective)
        step = method.step(state, target, pp.Limits(step=1e6))
        if not step.active or step.clipped.any():
            continue
        if isinstance(method, pp.Selection):
            matrix = active_jacobian(state, step)
            asked = task_errors(state, target)[list(step.active)].ravel()
        else:
            given_errors = task_errors(state, target)
            matrix, asked, *_ = method.posture_control_matrix(state, given_errors, target.has_target)
        expected = 0.3 * wish + np.linalg.pinv(matrix, rcond=1e-13) @ (asked - 0.3 * matrix @ wish)
        np.testing.assert_allclose(step.dq, expected, atol=1e-7 * max(1.0, np.abs(expected).max()))
    assert seen[0] == (state, target)


@given(st.integers(0, 10**6))
def test_the_null_space_term_descends_and_leaves_the_active_points_alone(spatial: pp.Arm, seed: int) -> None:
    state = state_of(spatial, seed, 0.7)
    target = target_of(spatial, seed)
    without = pp.Selection(null_gain=0.0).step(state, target, FREE)
    with_it = pp.Selection(null_gain=0.5).step(state, target, FREE)
    if without.clipped.any() or with_it.clipped.any():
        return
    difference = with_it.dq - without.dq
    np.testing.assert_allclose(active_jacobian(state, with_it) @ difference, 0.0, atol=1e-10)
    # Along it, half the squared error of all points falls to first order: by central differences.
    h = 1e-6 / max(np.linalg.norm(difference), 1e-12)

    def squared(factor: float) -> float:
        points = spatial.at(spatial.integrate(state.q, factor * difference)).points
        return 0.5 * float(np.sum((target.points - points) ** 2))

    assert squared(h) - squared(-h) <= 1e-18


@given(st.integers(0, 10**6), st.sampled_from([0.0, 1e-9, 1e-3, 0.5, 3.1]))
def test_projection_has_full_row_rank_everywhere(
    spatial: pp.Arm, planar: pp.Arm, seed: int, amplitude: float
) -> None:
    for arm in (spatial, planar):
        state = state_of(arm, seed, amplitude)
        target = target_of(arm, seed)
        for coupling in ("full", "local"):
            method = pp.Projection(coupling=coupling)
            matrix, velocity, active, _ = method.posture_control_matrix(
                state, task_errors(state, target), target.has_target
            )
            assert len(matrix) == len(velocity)
            sigma = np.linalg.svd(matrix, compute_uv=False)
            assert sigma[-1] > 1e-9 * sigma[0]
            assert len(active) > 0


@given(st.integers(0, 10**6))
def test_projection_moves_each_point_as_asked_within_its_manipulability_space(
    spatial: pp.Arm, seed: int
) -> None:
    state = state_of(spatial, seed, 0.8)
    target = target_of(spatial, seed)
    projection = pp.Projection(coupling="full", gain=0.3, null_gain=0.0)
    step = projection.step(state, target, pp.Limits(step=1e6))
    if step.clipped.any():
        return
    moved = state.task_jacobians @ step.dq
    for k in range(spatial.n_modules):
        local = ryrz.section_jacobian(k + 1, k, state.q, 0.025, 0.025)
        frame = np.eye(3) if k == 0 else ryrz.rotations(state.q, 0.025, 0.025)[k - 1]
        u, sigma, _ = np.linalg.svd(local)
        kept = u[:, : np.count_nonzero(sigma > projection.threshold * 0.05)]
        asked = 0.3 * (target.points[k] - state.points[k])
        np.testing.assert_allclose(kept.T @ frame.T @ moved[k], kept.T @ frame.T @ asked, atol=1e-9)


def test_local_coupling_is_block_diagonal_and_full_is_block_triangular(spatial: pp.Arm) -> None:
    state = state_of(spatial, 3, 0.8)
    target = target_of(spatial, 3)
    errors = task_errors(state, target)
    full = pp.Projection(coupling="full").posture_control_matrix(state, errors, target.has_target)[0]
    local = pp.Projection(coupling="local").posture_control_matrix(state, errors, target.has_target)[0]
    assert full.shape == local.shape == (16, 16)
    for k in range(8):
        rows = slice(2 * k, 2 * k + 2)
        assert not full[rows, 2 * k + 2 :].any()
        outside = np.delete(local[rows], [2 * k, 2 * k + 1], axis=1)
        assert not outside.any()
        np.testing.assert_allclose(full[rows, rows], local[rows, rows], atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("name", THESIS)
def test_every_posture_control_matrix_of_long_runs_has_full_row_rank(name: str) -> None:
    arm = pp.Arm.from_template("RyRz", 10)
    method = controller_named(name)
    ranks = []

    def keep(_: int, state: pp.ArmState, step: Step) -> None:
        if isinstance(method, pp.Projection):
            errors = task_errors(state, target)
            matrix = method.posture_control_matrix(state, errors, target.has_target)[0]
        else:
            again = method.step(state, target)
            matrix = active_jacobian(state, again) if again.active else np.zeros((0, arm.nv))
        ranks.append((np.linalg.matrix_rank(matrix, tol=1e-10), len(matrix)))

    for seed in range(6):
        rng = np.random.default_rng(seed)
        target = pp.Target.from_configuration(arm, rng.uniform(-1.5, 1.5, 20) * (seed % 3 > 0))
        pp.track(arm, target, rng.uniform(-1.5, 1.5, 20), name, max_steps=150, callback=keep)
    assert len(ranks) > 200
    assert all(rank == rows for rank, rows in ranks)


def test_singular_values_and_steps_do_not_depend_on_the_frame(spatial: pp.Arm) -> None:
    turned = pp.Arm.from_template("RyRz", 8, base_placement=PLACEMENT)
    for seed in seeds(10):
        q = state_of(spatial, seed, 0.8).q
        goal = target_of(spatial, seed)
        moved = goal.points @ PLACEMENT.rotation.T + PLACEMENT.translation
        for name in THESIS:
            here = controller_named(name).step(spatial.at(q), goal)
            there = controller_named(name).step(turned.at(q), pp.Target.from_points(turned, moved))
            assert here.active == there.active
            assert here.info["sigma_min"] == pytest.approx(there.info["sigma_min"], rel=1e-6)
            np.testing.assert_allclose(here.dq, there.dq, atol=1e-8)
            sigma = [np.linalg.svd(arm.at(q).jacobians, compute_uv=False) for arm in (spatial, turned)]
            np.testing.assert_allclose(sigma[0], sigma[1], atol=1e-13)


def test_selection_says_that_it_cannot_leave_the_straight_arm(spatial: pp.Arm) -> None:
    step = pp.Selection().step(spatial.at(spatial.straight()), target_of(spatial, 0))
    assert step.active == ()
    assert not step.dq.any()
    assert "absolute manipulability condition" in step.reason
    assert pp.Projection().step(spatial.at(spatial.straight()), target_of(spatial, 0)).dq.any()


@given(
    st.integers(0, 10**6),
    st.sampled_from(THESIS),
    st.sampled_from([0.0, 1e-7, 0.5, 3.1]),
    st.floats(1e-3, 0.5),
)
@pytest.mark.filterwarnings("ignore:points.* is .* m from the base of the arm")
def test_every_output_is_finite_and_within_its_limits(
    narrow: pp.Arm, seed: int, name: str, amplitude: float, largest: float
) -> None:
    rng = np.random.default_rng(seed)
    arm = narrow
    q = np.clip(amplitude * rng.uniform(-1, 1, arm.nv), -0.8, 0.8)
    target = pp.Target.from_points(arm, rng.normal(0.0, rng.choice([1e-9, 0.1, 10.0]), (8, 3)))
    limits = pp.Limits(step=largest, velocity=rng.uniform(0.5, 2.0, arm.nv), dt=0.05, position_margin=0.01)
    state = arm.at(q)
    for _ in range(3):
        step = controller_named(name).step(state, target, limits)
        assert np.all(np.isfinite(step.dq))
        assert np.all(np.abs(step.dq) <= np.minimum(largest, limits.velocity * 0.05) + 1e-12)
        state = arm.at(arm.integrate(state.q, step.dq))
        inside = np.abs(q) <= 0.79
        assert np.all(np.abs(state.q[inside]) <= 0.79 + 1e-12)


def test_free_control_points_are_not_used(spatial: pp.Arm) -> None:
    weights = np.zeros(8)
    weights[[3, 7]] = 1.0
    points = spatial.at(spatial.straight()).points + [0.0, 0.05, 0.0]
    target = pp.Target.from_points(spatial, points, weights)
    state = state_of(spatial, 5, 0.7)
    for method in (pp.Selection(), pp.Projection()):
        assert set(method.step(state, target).active) <= {3, 7}
    # The first point never clears the absolute condition, however well the others do.
    first = pp.Selection().step(state, pp.Target.from_points(spatial, points, np.eye(8)[0]))
    assert first.active == ()
    assert "largest index is 0," in first.reason or "e-" in first.reason


def test_each_score_takes_the_best_of_its_own_sets(planar: pp.Arm) -> None:
    taken = set()
    for seed in range(20):
        state = state_of(planar, seed, 1.0)
        target = target_of(planar, seed)
        indices = state.manipulability()
        distances = np.linalg.norm(task_errors(state, target), axis=1)
        clear = indices[0, 1:] > 0.01
        tree = SectionTree(section_indices(state, (2, 3)), clear, 0.05, 0, 11)
        expected = {"error": active_set(indices, distances, 0.01, 0.05)}
        for score in ("thesis", "geometric"):
            branches = [tree.pruned(branch, score) for branch in tree.branches()]
            expected[score] = max(branches, key=lambda left: left.score).points
        for score, points in expected.items():
            step = pp.Selection(absolute=0.01, relative=0.05, score=score).step(state, target)
            assert tuple(sorted([*step.active, *np.flatnonzero(step.info["dropped"])])) == points
        taken.add(tuple(expected.values()))
    assert any(len(set(sets)) == 3 for sets in taken)  # no score is another by a different name


def test_sections_are_for_planar_arms_of_single_joints_and_unbroken_regions(
    spatial: pp.Arm, planar: pp.Arm
) -> None:
    two_joints = pp.Arm.from_template("RzRz", 6)
    holes = np.tile([1.0, 1.0, 0.0], 4)
    for seed in range(5):
        for arm, weights, expected in (
            (spatial, None, "error"),
            (two_joints, None, "error"),
            (planar, None, "geometric"),
            (planar, holes, "error"),
            (planar, np.r_[np.zeros(4), np.ones(7), 0.0], "geometric"),
        ):
            state = state_of(arm, seed, 1.0)
            target = pp.Target.from_points(arm, target_of(arm, seed).points, weights)
            auto, same = (pp.Selection(score=s).step(state, target) for s in ("auto", expected))
            assert auto.active == same.active
            np.testing.assert_array_equal(auto.dq, same.dq)
    assert pp.Selection() == pp.Selection(score="auto", section_sizes=[3, 2])


def test_selection_says_that_no_section_is_stable(planar: pp.Arm) -> None:
    state = state_of(planar, 0, 0.3)
    target = target_of(planar, 0)
    step = pp.Selection(relative=0.99).step(state, target)
    assert step.active == ()
    assert "no section of 2 or 3 modules" in step.reason
    assert "relative = 0.99" in step.reason
    assert pp.Selection(relative=0.99).step(state, target.region(5, 5)).active == (5,)


def test_joint_interpolation_goes_straight_and_exactly(narrow: pp.Arm) -> None:
    target = target_of(narrow, 4, 0.7)
    start = state_of(narrow, 5, 0.7)
    run = pp.track(narrow, target, start.q, "joint")
    assert run.converged
    assert run.steps == np.ceil(np.abs(target.q - start.q).max() / 0.1)
    np.testing.assert_allclose(run.q[-1], target.q, atol=1e-12)
    offsets = run.q - start.q
    shares = offsets @ offsets[-1] / (offsets[-1] @ offsets[-1])
    np.testing.assert_allclose(offsets, np.outer(shares, offsets[-1]), atol=1e-12)
    with pytest.raises(InvalidValue, match=r"target\.q"):
        pp.track(narrow, pp.Target.from_points(narrow, target.points), start.q, "joint")


def test_limits_flag_what_they_did(narrow: pp.Arm) -> None:
    state = narrow.at(np.full(16, 0.75))
    limited = pp.Limits(step=0.1).apply(state, np.r_[0.4, np.zeros(14), 0.2])
    assert limited.scale == pytest.approx(0.25)
    np.testing.assert_allclose(limited.dq[[0, 15]], [0.05, 0.05])
    assert not limited.clipped[:15].all()
    outside = narrow.at(np.full(16, 1.5))
    back = pp.Limits(step=0.1).apply(outside, np.zeros(16))
    np.testing.assert_allclose(back.dq, -0.1)
    own = pp.Limits(step=None, dt=0.01).bound(state)
    np.testing.assert_allclose(own, 0.01 * narrow.limits.velocity)


@pytest.mark.parametrize(
    ("make", "kind", "message"),
    [
        (lambda: pp.Limits(step=0.0), InvalidValue, "step is 0"),
        (lambda: pp.Limits(step=[0.1, float("nan")]), InvalidValue, "step"),
        (lambda: pp.Limits(velocity=1.0), InvalidValue, "dt"),
        (lambda: pp.Limits(dt=-1.0), InvalidValue, "dt is -1"),
        (lambda: pp.Limits(position_margin=-0.1), InvalidValue, "position_margin"),
        (lambda: pp.Selection(absolute=1.0), InvalidValue, "absolute"),
        (lambda: pp.Selection(gain=0.0), InvalidValue, "gain"),
        (lambda: pp.Selection(conditioning=float("inf")), InvalidValue, "conditioning"),
        (lambda: pp.Selection(score="errors"), UnknownName, "did you mean 'error'"),
        (lambda: pp.Selection(section_sizes=(2, 0)), InvalidValue, r"section_sizes is \(2, 0\)"),
        (lambda: pp.Selection(section_sizes=(2.0,)), InvalidValue, "whole numbers"),
        (lambda: pp.Projection(coupling="half"), UnknownName, "full, relative, local"),
        (lambda: pp.Projection(null_gain=-1.0), InvalidValue, "null_gain"),
        (lambda: pp.Selection(gain=(1.0, 0.0)), InvalidValue, r"gain\[1\]"),
        (lambda: step_with(pp.Projection(gain=(1.0, 0.5))), InvalidValue, "one for each control point"),
        (lambda: step_with(pp.Selection(null_objective=lambda *_: [1.0])), InvalidValue, "null_objective"),
        (lambda: controller_named("selektion"), UnknownName, "did you mean 'selection'"),
        (
            lambda: pp.Limits(step=np.ones(3)).bound(state_of(template_arm("RyRz", 8), 0, 0.0)),
            InvalidValue,
            r"\(16,\)",
        ),
    ],
)
def test_bad_parameters_are_named(make: object, kind: type, message: str) -> None:
    with pytest.raises(kind, match=message):
        make()


def test_a_controller_that_returns_an_array_is_told_what_to_return(spatial: pp.Arm) -> None:
    class Bare:
        name = "bare"

        def step(self, state: object, *_: object) -> np.ndarray:
            return np.zeros(spatial.nv)

    with pytest.raises(InvalidValue, match=r"Bare\.step\(\.\.\.\) \(returned\) is array.*allowed: a Step"):
        pp.track(spatial, target_of(spatial, 0), spatial.straight(), Bare())
