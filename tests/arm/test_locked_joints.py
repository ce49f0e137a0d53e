"""Arms with joints that do not move."""

from __future__ import annotations

import pickle

import numpy as np
import pytest

import pinposture as pp
from pinposture.errors import InvalidValue, UnknownName


def test_controllers_and_targets_leave_a_locked_joint_where_it_is() -> None:
    arm = pp.Arm.from_template("RyRz", modules=6)
    locked = arm.with_locked({"m03_j1_y": 0.4})
    joint = arm.joint_names.index("m03_j1_y")
    q = np.zeros(arm.nv)
    q[joint] = 0.4
    bow = pp.Curve.points([(0.0, 0.0, 0.0), (0.1, 0.0, 0.0), (0.2, 0.06, 0.0), (0.3, 0.1, 0.1)])
    resolved = pp.resolve_targets(arm, bow)
    target = pp.Target.from_points(locked, resolved.points)
    run = pp.track(locked, target, q, limits=pp.Limits(position_margin=0.05))
    assert np.all(run.q[:, joint] == 0.4)
    assert np.ptp(run.q, axis=0).max() > 0.1
    healthy = pp.track(arm, resolved, q)
    assert np.ptp(healthy.q[:, joint]) > 1e-3


def test_a_locked_arm_is_the_same_but_for_its_limits() -> None:
    arm = pp.Arm.from_template("RyRz", modules=3).with_payload(0.1)
    locked = arm.with_locked({"m01_j2_z": -0.2}).with_locked({"m03_j1_y": 4.0})
    at = arm.random(np.random.default_rng(0))
    assert np.array_equal(locked.at(at).points, arm.at(at).points)
    assert locked.weight == arm.weight
    same = np.ones(arm.nv, dtype=bool)
    same[[1, 4]] = False
    for mine, before, there in zip(locked.limits, arm.limits, ([-0.2, 4.0], [-0.2, 4.0], None), strict=True):
        assert np.array_equal(mine[same], before[same])
        assert there is None or np.array_equal(mine[~same], there)
    again = pickle.loads(pickle.dumps(locked))
    assert np.array_equal(again.limits.lower, locked.limits.lower)
    assert arm.limits.lower[1] < -0.2


def test_joints_that_cannot_be_locked_are_refused() -> None:
    arm = pp.Arm.from_template("RyRz", modules=1)
    with pytest.raises(UnknownName, match="joint of the chain"):
        arm.with_locked({"elbow": 0.0})
    with pytest.raises(InvalidValue, match="a joint position"):
        arm.with_locked({"m01_j1_y": np.nan})
    with pytest.raises(InvalidValue, match="at least one joint that moves"):
        arm.with_locked({"m01_j1_y": 0.0, "m01_j2_z": 0.0})
    turning = pp.JointSpec("z", type="continuous")
    wheel = pp.Arm.from_modules([pp.ModuleTemplate("w", (turning,), (0.1,))] * 2)
    with pytest.raises(InvalidValue, match="continuous"):
        wheel.with_locked({wheel.joint_names[0]: 0.0})
