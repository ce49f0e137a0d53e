"""Paths that are timed within torque limits: closed forms, and torques of the steps by Pinocchio alone."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arm.test_inverse_dynamics import SLIDE
from arms import template_arm
from sampling import seeds

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.control.planner.path import EFFORT_SHARE
from pinposture.errors import InvalidValue, WeightUnknown

HINGE = """<robot name="door">
  <link name="frame"/>
  <link name="leaf"><inertial><mass value="3"/><origin xyz="0.4 0 0"/>
    <inertia ixx="0.1" iyy="0.1" izz="0.16" ixy="0" ixz="0" iyz="0"/></inertial></link>
  <joint name="hinge" type="revolute"><parent link="frame"/><child link="leaf"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="2" velocity="100"/></joint>
  <link name="edge"/>
  <joint name="end" type="fixed"><parent link="leaf"/><child link="edge"/><origin xyz="0.8 0 0"/></joint>
</robot>"""


def timed_between(arm: pp.Arm, start: np.ndarray, goal: np.ndarray, limits: pp.Limits) -> pp.TimedPath:
    path = pp.plan(arm.at(start), pp.Target.from_configuration(arm, goal), limits=limits)
    return pp.retime(path, limits, effort=True)


def largest_share(arm: pp.Arm, start: np.ndarray, offsets: np.ndarray, dt: float) -> float:
    """Largest torque of a motion given by its rows, from and to rest, relative to the limit."""
    rows = np.pad(offsets, ((1, 1), (0, 0)), mode="edge")
    steps = np.diff(rows, axis=0) / dt
    data = arm.model.createData()
    share = 0.0
    for row, before, after in zip(rows[1:-1], steps[:-1], steps[1:], strict=True):
        q = pin.integrate(arm.model, start, row)
        torques = pin.rnea(arm.model, data, q, (before + after) / 2.0, (after - before) / dt)
        share = max(share, float((np.abs(torques) / arm.effort).max()))
    return share


@pytest.mark.parametrize("angle", (0.3, 2.0))
def test_a_door_is_opened_in_the_shortest_time(angle: float) -> None:
    arm = pp.Arm.load(HINGE)
    timed = timed_between(arm, [0.0], [angle], pp.Limits(step=None, velocity=100.0, dt=1e-3))
    acceleration = EFFORT_SHARE * 2.0 / (0.16 + 3.0 * 0.4**2)
    assert timed.duration == pytest.approx(2.0 * np.sqrt(angle / acceleration), rel=0.01, abs=0.002)


@pytest.mark.parametrize("distance", (0.5, -0.5))
def test_a_lift_rises_and_sinks_in_the_shortest_time(distance: float) -> None:
    """It brakes with gravity as it rises, and against it as it sinks."""
    arm = pp.Arm.load(SLIDE, modules=1)
    timed = timed_between(arm, [0.0], [distance], pp.Limits(step=None, velocity=100.0, dt=1e-3))
    least = EFFORT_SHARE * 40.0 / 2.5 - 9.81
    most = EFFORT_SHARE * 40.0 / 2.5 + 9.81
    shortest = np.sqrt(2.0 * abs(distance) * (least + most) / (least * most))
    assert timed.duration == pytest.approx(shortest, rel=0.01, abs=0.002)


@pytest.mark.parametrize("seed", seeds(20))
def test_torques_keep_their_limits_on_timed_paths_and_where_they_are_followed(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = template_arm("RyRz", int(rng.integers(2, 9)))
    start, goal = (smooth_configuration(arm, rng, 0.6) for _ in range(2))
    dt = float(rng.choice([0.005, 0.01]))
    acceleration = rng.choice([None, 20.0])
    limits = pp.Limits(step=None, velocity=float(rng.uniform(1.0, 2.0)), acceleration=acceleration, dt=dt)
    path = pp.plan(arm.at(start), pp.Target.from_configuration(arm, goal), limits=limits)
    held = [arm.at(path.configuration(place)).gravity_torques for place in np.linspace(0.0, path.end, 50)]
    arm = arm.with_effort(float(np.abs(held).max()) * rng.uniform(1.1, 3.0))
    timed = timed_between(arm, start, goal, limits)
    offsets = timed.path.smooth_offset(timed.places)
    assert largest_share(arm, start, offsets, dt) <= 1.0
    q = start
    memory = None
    followed = [np.zeros(arm.nv)]
    while np.abs(arm.difference(q, goal)).max() > 1e-9:
        step = pp.follow(timed, arm.at(q), memory=memory)
        q = arm.integrate(q, step.dq)
        memory = step.memory
        followed.append(followed[-1] + step.dq)
        assert len(followed) < 3000
    assert largest_share(arm, start, np.array(followed), dt) <= 1.0
    assert len(followed) <= 1.1 * len(timed.places) + 3


def test_friction_leaves_less_to_the_motor() -> None:
    rough = HINGE.replace('velocity="100"/>', 'velocity="100"/><dynamics damping="0" friction="1.5"/>')
    limits = pp.Limits(step=None, velocity=100.0, dt=1e-3)
    durations = []
    for text in (HINGE, rough):
        arm = pp.Arm.load(text)
        durations.append(timed_between(arm, [0.0], [1.0], limits).duration)
    left = EFFORT_SHARE * 2.0
    assert durations[1] / durations[0] == pytest.approx(np.sqrt(left / (left - 1.5)), rel=0.01)


def test_what_motors_cannot_hold_and_what_is_not_known_is_named() -> None:
    arm = template_arm("RyRz", 3)
    limits = pp.Limits(step=None, velocity=2.0, dt=0.01)
    target = pp.Target.from_configuration(arm, np.full(arm.nv, 0.1))
    weak = arm.with_effort(1e-3)
    path = pp.plan(weak.at(weak.straight()), target, limits=limits)
    with pytest.raises(InvalidValue, match=r"joint 'm01_j1_y' needs 0\.05008 of 0\.00098 N m.*98 %"):
        pp.retime(path, limits, effort=True)
    path = pp.plan(arm.at(arm.straight()), target, limits=limits)
    with pytest.raises(WeightUnknown, match="torque limit"):
        pp.retime(path, limits, effort=True)
    strong = arm.with_effort(10.0)
    path = pp.plan(strong.at(strong.straight()), target)
    with pytest.raises(InvalidValue, match="cycle time"):
        pp.retime(path, effort=True)
