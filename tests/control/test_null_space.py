"""Objectives for the null space, sections for Projection, and the methods as printed."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.control import (
    JointSpeeds,
    ObstaclePotential,
    Projection,
    Selection,
    Switching,
    section_indices,
)
from pinposture.control.thesis.sections import best_chain
from pinposture.errors import ControllerError, InvalidValue


def case(name: str, modules: int, seed: int) -> tuple[pp.Arm, pp.ArmState, pp.Target]:
    rng = np.random.default_rng(seed)
    if name == "on a slide":
        slide = pp.JointSpec("x", type="prismatic", lower=-0.5, upper=0.5)
        feed = pp.ModuleTemplate("Feed", (slide,), (0.05,), 0.01)
        arm = pp.Arm.from_modules([feed, *[pp.template("RyRz")] * (modules - 1)])
    else:
        arm = template_arm(name, modules)
    q, goal = (smooth_configuration(arm, rng, 0.5) for _ in range(2))
    return arm, arm.at(q), pp.Target.from_configuration(arm, goal)


@pytest.mark.parametrize(("name", "modules"), [("RyRz", 6), ("Rz", 9), ("Continuum", 3), ("on a slide", 5)])
def test_joint_speeds_are_descended(name: str, modules: int) -> None:
    arm, state, target = case(name, modules, 0)
    objective = JointSpeeds()
    errors = (target.points - state.points) @ arm.plane.T

    def half_square(q: np.ndarray) -> float:
        jacobian = (arm.plane @ arm.at(q).jacobians * arm.joint_units).reshape(-1, arm.nv)
        damped = jacobian @ jacobian.T + (0.01 * arm.length) ** 2 * np.eye(len(jacobian))
        return 0.5 * float(errors.ravel() @ np.linalg.solve(damped, errors.ravel()))

    step = 1e-6
    gradient = [
        (half_square(arm.integrate(state.q, step * e)) - half_square(arm.integrate(state.q, -step * e)))
        / (2.0 * step)
        for e in np.eye(arm.nv) * arm.joint_units[:, None]
    ]
    found = objective(state, target)
    np.testing.assert_allclose(found, -np.array(gradient), atol=1e-5 * np.abs(gradient).max())
    np.testing.assert_allclose(JointSpeeds(weight=0.2)(state, target), 0.2 * found)


def test_no_error_calls_for_no_speed() -> None:
    arm, state, _ = case("RyRz", 6, 0)
    target = pp.Target.from_configuration(arm, state.q)
    np.testing.assert_allclose(JointSpeeds()(state, target), 0.0, atol=1e-12)


def test_an_obstacle_is_left_down_its_potential() -> None:
    arm, state, target = case("RyRz", 6, 1)
    beside = state.points[3] + np.array([0.0, 0.05, 0.02])
    scene = pp.Scene({"ball": pp.Sphere(tuple(beside), 0.02)})
    objective = ObstaclePotential(scene, within=0.1, weight=1e-6)
    model = pp.CollisionModel(arm, scene)

    def potential(q: np.ndarray) -> float:
        near = model.nearest(arm.at(q), 1.0).distances
        return float(0.5 * np.sum((0.1 / near[near < 0.1] - 1.0) ** 2))

    step = 1e-7
    gradient = [
        (potential(arm.integrate(state.q, step * e)) - potential(arm.integrate(state.q, -step * e)))
        / (2 * step)
        for e in np.eye(arm.nv)
    ]
    found = objective(state, target)
    assert np.abs(found).max() > 0.0
    np.testing.assert_allclose(found, -1e-6 * np.array(gradient), atol=1e-4 * np.abs(found).max())
    steep = ObstaclePotential(scene, within=0.1, weight=1e6)(state, target)
    assert np.abs(steep).max() == pytest.approx(0.1)
    far = ObstaclePotential(scene, within=1e-3)(state, target)
    np.testing.assert_array_equal(far, 0.0)


@pytest.mark.parametrize("method", [Selection, Projection])
def test_methods_take_them(method: type) -> None:
    _, state, target = case("RyRz", 8, 2)
    scene = pp.Scene({"ball": pp.Sphere((0.2, 0.1, 0.0), 0.03)})
    plain = method(null_gain=0.0).step(state, target)
    for objective in (JointSpeeds(), ObstaclePotential(scene, within=0.2)):
        step = method(null_objective=objective).step(state, target)
        assert np.all(np.isfinite(step.dq))
        assert np.abs(step.dq - plain.dq).max() > 0.0


def divided(state, target):
    return 1.0 / 0.0


@pytest.mark.parametrize("method", [Selection, Projection])
def test_mistakes_in_an_objective_of_the_user_name_it(method: type) -> None:
    arm, state, target = case("RyRz", 8, 2)
    with pytest.raises(ControllerError, match=r"^divided raised ZeroDivisionError: .*test_null_space\.py"):
        pp.track(arm, target, state.q, method(null_objective=divided))
    for wrong in (None, np.zeros(3), np.full(arm.nv, np.nan), "down"):
        objective = method(null_objective=lambda *_, given=wrong: given)
        with pytest.raises(InvalidValue, match=r"null_objective .*<lambda>\(state, target\)"):
            pp.track(arm, target, state.q, objective)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: JointSpeeds(weight=0.0), "weight"),
        (lambda: JointSpeeds(damping=-1.0), "damping"),
        (lambda: ObstaclePotential("scene", 0.1), "scene"),
        (lambda: ObstaclePotential(pp.Scene({}), 0.0), "within"),
        (lambda: Projection(section_sizes=()), "section_sizes"),
    ],
)
def test_bad_parameters_are_named(make: object, message: str) -> None:
    with pytest.raises(InvalidValue, match=message):
        make()  # type: ignore[operator]


def test_projection_by_sections_moves_the_ends_of_the_best_chain() -> None:
    arm, state, target = case("Rz", 11, 3)
    indices = section_indices(state, (2, 3))

    def chains(node: int) -> list[list[int]]:
        ends = [node + size for size in (2, 3) if node + size <= 11]
        return [[end, *rest] for end in ends for rest in chains(end)] if ends else [[]]

    def score(chain: list[int]) -> float:
        values = [max(indices[a, b], 1e-6) for a, b in zip([0, *chain[:-1]], chain, strict=True)]
        return (len(chain) + 1) * float(np.prod(values)) ** (1.0 / len(chain))

    best = [node - 1 for node in max(chains(0), key=score)]
    found = best_chain(arm, state.screws, target.has_target, (2, 3))
    assert np.flatnonzero(found).tolist() == best
    step = Projection(section_sizes=(2, 3)).step(state, target)
    assert list(step.active) == best
    assert len(Projection().step(state, target).active) > len(best)


def test_projection_by_sections_moves_a_straight_arm_and_a_region() -> None:
    arm = template_arm("Rz", 11)
    state = arm.at(arm.straight())
    target = case("Rz", 11, 3)[2]
    step = Projection(section_sizes=(2, 3)).step(state, target)
    assert len(step.active) == 5
    assert np.abs(step.dq).max() > 0.0
    ends = Projection(section_sizes=(2, 3)).step(state, target.region(3, 8)).active
    assert set(ends) <= set(range(3, 9))
    single = Projection(section_sizes=(2, 3)).step(state, target.region(0, 0)).active
    assert single == (0,)


def test_as_printed() -> None:
    assert Selection.as_printed().score == "error"
    assert Selection.as_printed(planar=True).score == "thesis"
    assert Projection.as_printed().coupling == "local"
    assert Switching.as_printed(planar=True).projection.section_sizes == (2, 3)
    assert Switching.as_printed().hand_back == "when_possible"
    for name, modules, planar in (("RyRz", 8, False), ("Rz", 12, True)):
        arm, state, target = case(name, modules, 4)
        for method in (Selection, Projection, Switching):
            run = pp.track(arm, target, state.q, method.as_printed(planar), max_steps=20)
            assert np.all(np.isfinite(run.q))
        # (4.6): active points go straight to their targets; dr is c - p.
        step = Selection.as_printed(planar).step(state, target)
        moved = state.task_jacobians[list(step.active)] @ step.dq
        wanted = ((target.points - state.points) @ arm.plane.T)[list(step.active)]
        cosine = np.vdot(moved, wanted) / np.linalg.norm(moved) / np.linalg.norm(wanted)
        assert cosine == pytest.approx(1.0, abs=1e-6) or step.clipped
