"""Whether two tasks are the same, by what can be seen of them from outside."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin

import pinposture as pp

CLOSE = {"rtol": 1e-12, "atol": 1e-12}


def assert_same_arms(one: pp.Arm, other: pp.Arm) -> None:
    """The same joints, limits and control points, wherever the arm is; the same masses and name."""
    assert one.model.name == other.model.name
    assert (one.nq, one.nv, one.joint_names) == (other.nq, other.nv, other.joint_names)
    assert (one.control_points, one.module_joints) == (other.control_points, other.module_joints)
    for mine, its in zip(one.limits, other.limits, strict=True):
        np.testing.assert_array_equal(mine, its)
    np.testing.assert_array_equal(one.model.effortLimit, other.model.effortLimit)
    np.testing.assert_allclose(one.base_placement.homogeneous, other.base_placement.homogeneous, **CLOSE)
    np.testing.assert_allclose(one.joint_units, other.joint_units, **CLOSE)
    rng = np.random.default_rng(0)
    for _ in range(3):
        q = one.random(rng)
        np.testing.assert_allclose(one.at(q).points, other.at(q).points, **CLOSE)
        np.testing.assert_allclose(one.at(q).rotations, other.at(q).rotations, **CLOSE)
        torques = [pin.crba(arm.model, arm.model.createData(), q) for arm in (one, other)]
        np.testing.assert_allclose(*torques, rtol=1e-9, atol=1e-9)


def assert_same(one: pp.Task, other: pp.Task) -> None:
    """Equal tasks: curves, times and other numbers to the last bit, rotations within rounding."""
    if one.arm is not other.arm:
        assert_same_arms(one.arm, other.arm)
    assert type(one.motion) is type(other.motion)
    if isinstance(one.motion, pp.Leader):
        assert one.motion == other.motion
    else:
        assert len(one.motion) == len(other.motion)
        for mine, its in zip(one.motion, other.motion, strict=True):
            if isinstance(mine, pp.Phase):
                assert mine == its
            else:
                assert_same_keyframes(mine, its)
    assert one.limits == other.limits
    assert one.controller == other.controller
    assert one.scene == other.scene
    if one.scene is not None:
        assert list(one.scene.obstacles) == list(other.scene.obstacles)
    assert (one.start is None) == (other.start is None)
    if one.start is not None:
        np.testing.assert_allclose(one.start, other.start, **CLOSE)
    for name in ("continuity", "formats", "name", "scans"):
        assert getattr(one, name) == getattr(other, name)


def assert_same_keyframes(one: pp.Keyframe, other: pp.Keyframe) -> None:
    """Equal keyframes; the tip's rotation within rounding."""
    assert replace(one, tip=None) == replace(other, tip=None)
    assert one.curve == other.curve
    if one.tip is None or one.tip.pose is None:
        assert one.tip == other.tip
        return
    np.testing.assert_allclose(one.tip.pose, other.tip.pose, **CLOSE)
    for name in ("point", "weight", "priority", "direction_only", "length"):
        assert getattr(one.tip, name) == getattr(other.tip, name)
