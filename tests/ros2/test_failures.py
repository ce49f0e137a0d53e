"""The way in that a driver remembers, and what it finds for an arm with a locked joint."""

from __future__ import annotations

from threading import Event

import numpy as np
import pytest

import pinposture as pp
from pinposture.motion.latest import Outdated
from pinposture.ros2.failures import FallbackSearch, Locked, find_fallback


@pytest.mark.long
def test_a_fallback_tells_how_near_the_target_is_and_gives_a_way_out_that_leaves_the_joint_alone() -> None:
    arm = pp.Arm.from_template("RyRz", modules=3)
    q = np.full(arm.nv, 0.3)
    rows = np.linspace(0.0, 1.0, 20)[:, None] * q
    name = arm.joint_names[1]
    locked = arm.with_locked({name: 0.3})
    target = pp.Target.from_configuration(arm, np.full(arm.nv, -0.3))
    limits = pp.Limits(dt=0.02, velocity=1.0, acceleration=2.0)
    scene = pp.Scene()
    given = Locked(arm, locked, {name: 0.3}, q, target, scene, limits, rows, False)
    found = find_fallback(given)
    assert found.way_out is not None and found.reason == ""
    motion = found.way_out
    np.testing.assert_allclose(motion.positions[0], q, atol=1e-9)
    np.testing.assert_allclose(motion.positions[:, 1], 0.3, atol=1e-9)
    others = np.arange(arm.nv) != 1
    np.testing.assert_allclose(motion.positions[-1, others], 0.0, atol=1e-6)
    assert np.abs(np.diff(motion.positions, axis=0)).max() <= 1.0 * 0.02 + 1e-9
    run = pp.track(locked, pp.Target.from_points(locked, target.points), q)
    assert found.error == pytest.approx(run.mean_error[-1], abs=1e-3 * arm.length)
    words = str(found)
    assert words.startswith("the target is reached to ") and "a way out of " in words

    # Where the arm overlaps an obstacle, there is none; and a question may become outdated.
    ball = pp.Scene({"ball": pp.Sphere(tuple(arm.at(q).points[-1]), 0.02)})
    blocked = find_fallback(given._replace(scene=ball, target=None))
    assert blocked.error is None and blocked.way_out is None
    assert "no way out was found: at the posture" in str(blocked)
    search = FallbackSearch()
    assert str(search.find(given._replace(leave=True), Event())).startswith("a way out of ")
    outdated = Event()
    outdated.set()
    with pytest.raises(Outdated):
        search.find(given, outdated)
