"""Curves as bendings against closed forms, SciPy's splines and the curves themselves."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from sampling import examples
from scipy.interpolate import BSpline, CubicHermiteSpline
from task.keyed_arms import S_CURVE, coil

import pinposture as pp
from pinposture.placement.target import place_curve
from pinposture.task.reference import AnchoredCurve, Bending

CURVES = {
    "line": lambda: pp.Curve.line((0, 0, 0), (2, 0, 0)),
    "helix": lambda: pp.Curve.helix(0.06, 0.15, 4, handedness="left"),
    "coil": lambda: coil(1.0),
    "spline": lambda: pp.Curve.spline(S_CURVE),
}


def spatial() -> pp.Arm:
    return template_arm("RyRz", 20)


@cache
def bendings() -> Bending:
    """Curves at that arm."""
    return Bending(spatial(), 1.2)


def vector(curve: pp.Curve, roll: float = 0.3) -> np.ndarray:
    return bendings().vector(AnchoredCurve(place_curve(spatial(), curve, "align", roll)[0], 0.0))


def turns(of: np.ndarray) -> np.ndarray:
    return of[6 : 6 + 2 * bendings().cells].reshape(-1, 2)


@pytest.mark.parametrize("name", CURVES)
def test_a_curve_comes_back_out_of_its_vector(name: str) -> None:
    placed = place_curve(spatial(), CURVES[name](), "align", 0.3)[0]
    back = bendings().curves(vector(CURVES[name]())[None])[0]
    s = np.linspace(0, min(1.2, placed.length - bendings().cell), 777)  # it ends within a cell
    assert np.abs(back.at(s) - placed.at(s)).max() < 1e-8
    assert np.abs(back.tangent(s) - placed.tangent(s)).max() < 1e-5


@pytest.mark.parametrize("name", CURVES)
def test_arcs_alone_miss_next_to_nothing(name: str) -> None:
    alone = vector(CURVES[name]())
    alone[6 + 2 * bendings().cells :] = 0.0
    placed = place_curve(spatial(), CURVES[name](), "align", 0.3)[0]
    back = bendings().curves(alone[None])[0]
    s = np.linspace(0, min(1.2, placed.length), 777)
    assert np.abs(back.at(s) - placed.at(s)).max() < 2e-4


def test_the_bending_of_a_helix_has_its_curvature_and_turns_by_its_torsion() -> None:
    # In a frame without twist the bending is curvature times exp(i torsion s) (Bishop, 1975).
    radius = 0.06
    rise = 0.15 / (2 * np.pi)
    curvature = radius / (radius**2 + rise**2)
    torsion = -rise / (radius**2 + rise**2)
    bent = turns(vector(CURVES["helix"]())) @ (1.0, 1.0j)
    assert np.allclose(np.abs(bent), curvature * bendings().cell, rtol=1e-3)
    phase = np.diff(np.unwrap(np.angle(bent)))
    assert np.allclose(phase, torsion * bendings().cell, rtol=1e-3)


@pytest.mark.parametrize("share", (0.0, 0.25, 0.5, 1.0))
def test_between_two_arcs_lies_the_arc_of_the_mean_curvature(share: float) -> None:
    first, last = (vector(pp.Curve.helix(r, 0, 1, axis=(0, 0, 1)), roll=0.0) for r in (1.0, 0.25))
    curve = bendings().curves(((1 - share) * first + share * last)[None])[0]
    kappa = (1 - share) * 1.0 + share * 4.0
    s = np.linspace(0, 1.2, 50)
    # In the plane of the two, from the base of the arm along x.
    points = curve.at(s) - spatial().chain.base
    along = points[:, 0]
    across = np.linalg.norm(points[:, 1:], axis=1)
    assert np.allclose(along, np.sin(kappa * s) / kappa, atol=1e-8)
    assert np.allclose(across, (1 - np.cos(kappa * s)) / kappa, atol=1e-8)


def test_beyond_its_end_a_curve_goes_straight_on() -> None:
    short = place_curve(spatial(), pp.Curve.spline(0.5 * S_CURVE), "align", 0.0)[0]
    back = bendings().curves(bendings().vector(AnchoredCurve(short, 0.0))[None])[0]
    s = np.array([0.02, 0.2, 0.4])
    end = short.end
    direction = short.tangent(short.length)
    assert np.allclose(back.at(short.length + s), end + s[:, None] * direction, atol=1e-5)


def test_a_curve_may_begin_beside_the_base_and_before_it() -> None:
    curve = pp.Curve.spline(S_CURVE + (-0.2, 0.003, 0.0))
    anchored = AnchoredCurve(curve, float(curve.nearest(spatial().chain.base)[0]))
    back = bendings().curves(bendings().vector(anchored)[None])[0]
    s = np.linspace(0, 1.0, 99)
    assert np.abs(back.at(s) - curve.at(anchored.parameter + s)).max() < 1e-7


def test_curves_of_a_planar_arm_stay_in_its_plane() -> None:
    arm = pp.Arm.from_template("RzRz", modules=6)
    bending = Bending(arm, 1.2 * arm.length)
    helices = (pp.Curve.helix(r * arm.length, 0, 1, axis=(1, 2, 3)) for r in (0.3, 0.9))
    laid = (place_curve(arm, helix, "align", 0.0)[0] for helix in helices)
    ring, bow = (bending.vector(AnchoredCurve(curve, 0.0)) for curve in laid)
    curve = bending.curves((0.4 * ring + 0.6 * bow)[None])[0]
    normal = np.cross(*arm.plane)
    assert np.abs((curve.points - arm.chain.base) @ normal).max() < 1e-9 * arm.length


@pytest.mark.parametrize("sign", (1.0, -1.0))
def test_directions_go_on_the_way_round_that_they_were_going(sign: float) -> None:
    def out(angle: float, before: np.ndarray | None) -> np.ndarray:
        line = pp.Curve.line((0, 0, 0), (np.cos(angle), np.sin(angle), 0))
        return bendings().vector(AnchoredCurve(line, 0.0), before)

    before = None
    for angle in sign * np.array([1.0, 2.5, np.pi, 4.0, 6.0, 8.0]):
        before = out(angle, before)
        assert np.allclose(before[3:6], (0, 0, angle), atol=1e-12)
    assert np.allclose(out(0.0, before)[3:6], (0, 0, sign * 2 * np.pi))


@given(
    # Control points 0.4 m apart that never turn back, so that no curve has a cusp.
    arrays(float, (2, 4, 3), elements=st.floats(-0.19, 0.19)),
    st.floats(0.0, 1.0),
)
@examples(25)
def test_lengths_are_kept_between_any_two_curves(noise: np.ndarray, share: float) -> None:
    even = np.linspace((0.3, 0, 0), (1.5, 0, 0), 4)
    first, last = (vector(pp.Curve.spline(np.vstack([[0, 0, 0], even + n]))) for n in noise)
    curve = bendings().curves(((1 - share) * first + share * last)[None])[0]
    places = curve.at(np.linspace(0, curve.length, 20_000))
    length = np.linalg.norm(np.diff(places, axis=0), axis=1).sum()
    assert length == pytest.approx(curve.length, rel=1e-4)


def test_the_cubics_are_those_of_scipy_and_of_their_own_b_spline() -> None:
    curve = bendings().curves(vector(CURVES["spline"]())[None])[0]
    theirs = CubicHermiteSpline(curve.s, curve.points, curve.tangents)
    s = np.sort(np.random.default_rng(0).uniform(0, curve.length, 200))
    assert np.allclose(curve.at(s), theirs(s), atol=1e-14)
    assert np.allclose(curve.tangent(s), theirs(s, 1), atol=1e-12)
    knots = np.concatenate([[0.0, 0.0], np.repeat(curve.s, 2), [curve.length] * 2])
    assert np.allclose(BSpline(knots, curve.spline, 3)(s), theirs(s), atol=1e-14)
