"""One arm written in many ways is one arm; one arm in several sizes differs in nothing but its size."""

from __future__ import annotations

import warnings
from functools import cache

import numpy as np
import pytest
from arm.describing import HERE, LINK, X, Y, Z, arm_text, limit, pairs
from arm.rewriting import renamed, scaled, turned_frames, with_fixed_joints, with_sensors
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp

MIXED = [
    ("revolute", "0.3 1 0", LINK),
    ("continuous", Z, "0.08 0.01 0", ""),
    ("prismatic", X, "0.05 0 0", limit(0, 0.05)),
] * 3
ARMS = {
    "template": lambda: pp.Arm.from_template("RyRz", 6).urdf,
    "unequal": lambda: (
        pp.Arm.from_modules([pp.template(name) for name in ("RyRz", "RzRy", "Rz", "RyRz")]).urdf
    ),
    "planar": lambda: arm_text([("revolute", Z, LINK), ("prismatic", X, LINK, limit(0, 0.04))] * 3),
    "mixed": lambda: arm_text(MIXED),
    "no end": lambda: arm_text(pairs(4), tip=HERE),
    "roll at the tip": lambda: arm_text([*pairs(3), ("revolute", X, LINK)]),
    "nothing alike": lambda: arm_text(
        [
            ("revolute", Y, LINK),
            ("revolute", X, "0.03 0 0"),
            ("revolute", Z, "0.2 0 0.1"),
            ("revolute", Y, LINK),
        ]
    ),
}


@cache
def described(name):
    return ARMS[name]()


def load(text):
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        return pp.Arm.load(text)


@pytest.mark.parametrize("name", ARMS)
@given(st.integers(0, 10**6))
@examples(12)
def test_names_fixed_joints_sensors_and_frames_change_nothing(name, seed):
    rng = np.random.default_rng(seed)
    arm = load(described(name))
    text, new = renamed(described(name), rng)
    for change in (with_sensors, *rng.permutation([with_fixed_joints, turned_frames])):
        text = change(text, rng)
    other = load(text)
    assert other.module_joints == tuple(tuple(new[name] for name in names) for names in arm.module_joints)
    assert other.segmentation.sizes == arm.segmentation.sizes
    assert other.segmentation.period == arm.segmentation.period
    assert other.dimension == arm.dimension
    assert other.length == pytest.approx(arm.length, abs=1e-4)  # a sensor may be a little beyond the tip
    positions = rng.uniform(-1.0, 1.0, arm.nv)
    state, same = (a.at(a.configuration(positions)) for a in (arm, other))
    np.testing.assert_allclose(same.points[:-1], state.points[:-1], atol=1e-12)
    np.testing.assert_allclose(same.jacobians[:-1], state.jacobians[:-1], atol=1e-12)
    np.testing.assert_allclose(same.points[-1], state.points[-1], atol=1e-4)


@pytest.mark.parametrize("name", ARMS)
def test_every_part_of_the_last_link_comes_out_the_same_if_the_tip_is_named(name):
    rng = np.random.default_rng(5)
    arm = load(described(name))
    text = turned_frames(with_sensors(with_fixed_joints(described(name), rng), rng), rng)
    other = pp.Arm.load(text, tip="tip")
    positions = rng.uniform(-1.0, 1.0, arm.nv)
    state, same = (a.at(a.configuration(positions)) for a in (arm, other))
    np.testing.assert_allclose(same.points, state.points, atol=1e-12)
    np.testing.assert_allclose(same.jacobians, state.jacobians, atol=1e-12)


@pytest.mark.parametrize("factor", [1e-3, 1e2])
@pytest.mark.parametrize("name", ARMS)
def test_an_arm_of_any_size_behaves_alike(name, factor):
    arm = load(described(name))
    other = load(scaled(described(name), factor))
    assert other.module_joints == arm.module_joints
    assert other.segmentation == arm.segmentation
    assert (other.dimension, other.n_modules) == (arm.dimension, arm.n_modules)
    assert other.length == pytest.approx(arm.length * factor, rel=1e-12)
    np.testing.assert_allclose(other.chain.module_lengths, arm.chain.module_lengths * factor, rtol=1e-9)
    np.testing.assert_allclose(other.plane, arm.plane, atol=1e-9)
    turns = np.where(arm.slides, 1.0, factor)
    slides = np.where(arm.slides, factor, 1.0)
    for limit_, expected in zip(other.limits, arm.limits, strict=True):
        np.testing.assert_allclose(limit_, expected * slides, rtol=1e-12)
    for seed in range(3):
        q, p = (a.random(np.random.default_rng(seed)) for a in (arm, other))
        np.testing.assert_allclose(other.positions(p), arm.positions(q) * slides, rtol=1e-9)
        state = arm.at(q)
        same = other.at(p)
        np.testing.assert_allclose(same.points, state.points * factor, rtol=1e-9, atol=1e-12 * factor)
        np.testing.assert_allclose(same.jacobians, state.jacobians * turns, rtol=1e-9, atol=1e-12 * factor)
        if not np.any(arm.slides):  # metres and radians in one matrix have no common size
            np.testing.assert_allclose(same.manipulability(), state.manipulability(), atol=1e-6)
        assert arm.within_limits(q) and other.within_limits(p)
    far, away = (np.linalg.norm(a.at(a.straight()).points[-1] - a.chain.base) for a in (arm, other))
    assert away == pytest.approx(far * factor, rel=1e-4)
    curve = pp.Curve.helix(1.0, 1.0, 1.0)
    larger = pp.Curve.helix(factor, factor, 1.0)
    fit = arm.can_follow(curve)
    fits = other.can_follow(larger)
    assert fits.max_curvature * factor == pytest.approx(fit.max_curvature, rel=1e-6)
    assert bool(fits) == bool(fit)


def test_a_slide_without_limits_has_a_random_position_of_the_size_of_the_arm():
    text = arm_text([("prismatic", Y, LINK, limit()), *pairs(1)])
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        small = pp.Arm.load(scaled(text, 1e-3))
    drawn = [small.positions(small.random(np.random.default_rng(seed)))[0] for seed in range(50)]
    assert 0.5 * small.length < max(map(abs, drawn)) <= small.length
    assert np.all(np.isfinite(small.straight()))
