"""The compiled walk against Algorithm 1 as it reads, over random arms and curves, also where it fails."""

from __future__ import annotations

from functools import cache
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st
from reference_walk import walk
from sampling import examples

import pinposture as pp
from pinposture import kernels
from pinposture.placement.module_kinematics import group_runs

STANDS = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -0.2, 0.7]))
MIXED = [
    pp.template(name).with_lengths(lengths)
    for name, lengths in (("RyRz", (0.03, 0.02)), ("RzRy", (0.02, 0.02)), ("RyRz", (0.025, 0.035)))
] * 3
ARMS = {
    "equal": lambda: pp.Arm.from_template("RyRz", 10),
    "longer last": lambda: pp.Arm.from_template("RzRy", 8, (0.01, 0.04), base_placement=STANDS),
    "longer first": lambda: pp.Arm.from_template("RyRz", 8, (0.04, 0.01)),
    "mixed": lambda: pp.Arm.from_modules(MIXED),
    "narrow": lambda: pp.Arm.from_modules([pp.template("RyRz").with_limits(-0.3, 0.4)] * 8),
    "one side": lambda: pp.Arm.from_modules([pp.template("RyRz").with_limits(1.7, 3.0)] * 4),
    "planar": lambda: pp.Arm.from_template("Rz", 12, base_placement=STANDS),
    "planar pairs": lambda: pp.Arm.from_template("RzRz", 6),
}


@cache
def arm_called(name: str) -> pp.Arm:
    return ARMS[name]()


def both(arm: pp.Arm, curve: pp.Curve, samples: int, parameter: float = 0.0) -> int:
    """Compare the two; the index of the group without a place, or -1."""
    (run,) = group_runs(arm)
    groups = run.numbers
    shapes = run.shapes
    lower = arm.limits.lower[arm.columns]
    upper = arm.limits.upper[arm.columns]
    start = arm.chain.base if parameter == 0.0 else curve.at(parameter)
    state = np.concatenate([[parameter], arm.chain.base, start, [0.0, 0.0]])
    positions = np.zeros(len(lower))
    parameters = np.zeros(arm.n_modules)
    stopped = kernels.place_modules(
        *curve.measured, samples, groups, shapes, lower, upper, state, positions, parameters
    )
    expected = walk(arm, groups, shapes, curve, samples, parameter, start)
    assert stopped == expected.stopped
    # Modules that multiply angles by l1 / l2 multiply rounding too.
    # A link that is folded back is turned by half a turn, either way.
    apart = np.angle(np.exp(1j * (positions - expected.positions)))
    np.testing.assert_allclose(apart, 0.0, atol=1e-6)
    ends = np.zeros(arm.n_modules)
    placed = len(groups) if stopped < 0 else stopped
    ends[groups[:placed, 2]] = expected.parameters[:placed]
    np.testing.assert_allclose(parameters, ends, atol=1e-8 * curve.length)
    if stopped >= 0:
        assert bool(state[7]) == expected.beyond
        assert bool(state[8]) == bool(expected.found)
    return stopped


def laid(arm: pp.Arm, points: np.ndarray, degree: int) -> pp.Curve:
    """A curve from the base of the arm, with its first direction along x of the base placement."""
    placement = arm.base_placement
    try:
        return pp.Curve.spline(arm.length * points, degree).moved(placement.rotation, placement.translation)
    except pp.errors.CurveError:
        assume(False)
        raise


@examples(40)
@given(
    st.sampled_from(sorted(ARMS)),
    st.integers(0, 10**6),
    st.sampled_from([0.0, 1e-9, 1e-3, 0.05, 0.15, 0.5]),
    st.sampled_from([7, 50, 250]),
    st.sampled_from([1, 2, 3, 5]),
    st.sampled_from([0.6, 1.0, 1.6]),
)
def test_all_places_are_those_of_the_algorithm(
    name: str, seed: int, wild: float, samples: int, degree: int, length: float
) -> None:
    """From straight lines over gentle curves to harsh ones that end early or leave the reach."""
    rng = np.random.default_rng(seed)
    points = np.zeros((8, 3))
    points[:, 0] = length * np.arange(8) / 7
    points[2:] += wild * rng.normal(size=(6, 3))
    if name.startswith("planar"):
        points[:, 2] = 0.0
    arm = arm_called(name)
    both(arm, laid(arm, points, degree), samples)


def test_both_endings_are_met_by_every_arm() -> None:
    for name in ARMS:
        arm = arm_called(name)
        endings = set()
        for length, wild in ((1.4, 0.0), (1.4, 0.02), (1.4, 0.3), (0.8, 0.0)):
            points = np.zeros((6, 3))
            points[:, 0] = length * np.arange(6) / 5
            points[2:, :2] += wild * np.random.default_rng(5).normal(size=(4, 2))
            endings.add(both(arm, laid(arm, points, 3), 200) < 0)
        assert endings == ({False} if name == "one side" else {False, True})


@pytest.mark.parametrize("beside", [0.0, 0.01, 0.03, 0.2])
def test_a_walk_may_begin_beside_the_curve(beside: float) -> None:
    """Also so far beside that the first module does not reach it."""
    arm = arm_called("equal")
    curve = pp.Curve.spline([(-0.4, beside, 0), (0, beside, 0), (0.4, beside + 0.05, 0.02), (0.9, beside, 0)])
    parameter = float(curve.nearest(arm.chain.base).parameter)
    assert (both(arm, curve, 500, parameter) < 0) == (beside < 0.02)


@pytest.mark.parametrize("samples", [2, 3, 10, 10_000])
def test_any_number_of_samples_will_do(samples: int) -> None:
    curve = pp.Curve.helix(0.2, 0.5, 1.5)
    arm = pp.Arm.from_template("RyRz", 6)
    both(arm, curve.moved(np.eye(3), -curve.start), samples)


def test_curves_that_end_at_the_base_or_at_the_tip() -> None:
    arm = arm_called("equal")
    assert both(arm, pp.Curve.line((0, 0, 0), (arm.length, 0, 0)), 2000) == -1
    assert both(arm, pp.Curve.line((0, 0, 0), (0.999 * arm.length, 0, 0)), 2000) == 9
    assert both(arm, pp.Curve.line((-1, 0, 0), (0, 0, 0)), 50, 1.0) == 0


@pytest.mark.parametrize("sizes", [(2,) * 7, (1,) * 9, (1, 2, 2, 1, 1, 3, 3, 2), (4,)])
def test_neighbours_with_as_many_joints_are_compared(
    sizes: tuple[int, ...],
) -> None:
    starts = np.cumsum([0, *sizes])
    q = np.random.default_rng(len(sizes)).normal(size=starts[-1])
    modules = [q[a:b] for a, b in pairwise(starts)]
    pairs = [(a, b) for a, b in pairwise(modules) if len(a) == len(b)]
    products, norms = kernels.neighbours(q, starts)
    assert products == pytest.approx(sum(a @ b for a, b in pairs), abs=1e-12)
    assert norms == pytest.approx(sum(np.linalg.norm(a) * np.linalg.norm(b) for a, b in pairs), abs=1e-12)
