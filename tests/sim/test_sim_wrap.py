"""An arm that wraps around a can in the simulation lifts it, up to about the mass that is told."""

from __future__ import annotations

from functools import cache

import pytest
from arms import template_arm

import pinposture as pp
from pinposture import sim

HEIGHT = 0.1


@cache
def lifted() -> tuple[pp.Grip, pp.Grip]:
    """A grip, and where it lifts the can to."""
    can = pp.Cylinder((0.3, 0.1, -0.1), (0.3, 0.1, 0.1), 0.05)
    scene = pp.Scene({"can": can, "floor": pp.HalfSpace((0, 0, -0.1), (0, 0, 1))}, touchable=["can"])
    limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=2.0)
    arm = template_arm("RyRz", 15).with_effort(2.0)
    grip = pp.wrap(arm, "can", scene, arm.straight(), limits, turns=0.9, friction=0.5)
    return grip, pp.carry(grip, (0.0, 0.0, HEIGHT))


@pytest.mark.soak
def test_contacts_press_with_the_force_that_was_asked_for():
    grip, _ = lifted()
    servos = sim.Servos(frequency=10.0, gravity_compensation=True)
    arm = grip.arm.with_stiffness(servos.stiffness(grip.arm))
    force = 2.0
    pressed = pp.wrap(
        arm, "can", grip.scene, arm.straight(), grip.limits, turns=0.9, friction=0.5, force=force
    )
    contact = sim.ContactModel(friction=0.5, time_constant=2e-3)  # hard surfaces; the can stands still
    motion = pp.JointTrajectory.joined([pressed.phases["wind"], pressed.phases["squeeze"]])
    ended = sim.simulate(grip.arm, motion, servos, scene=grip.scene, contact=contact, hold=1.0)
    normals = dict(zip(pressed.hold.bodies, pressed.hold.normals, strict=True))
    measured = dict.fromkeys(normals, 0.0)
    for (body, other), acting in zip(ended.contacts.pairs, ended.contacts.forces[-1], strict=True):
        if other == "can" and body in normals:
            measured[body] = -float(acting @ normals[body])
    found = list(measured.values())
    assert sum(found) / len(found) == pytest.approx(force, rel=0.2)
    assert min(found) > 0.2 * force


@pytest.mark.soak
@pytest.mark.parametrize(("share", "held"), [(0.5, True), (1.5, False)])
def test_the_can_is_lifted_up_to_about_the_mass_that_is_told(share, held):
    grip, high = lifted()
    contact = sim.ContactModel(friction=0.5, masses={"can": share * grip.hold.mass})
    motion = pp.JointTrajectory.joined([grip.phases["wind"], grip.phases["squeeze"], high.motion])
    ended = sim.simulate(grip.arm, motion, scene=grip.scene, contact=contact, hold=0.5)
    rise = ended.contacts.displacements[-1, 0, 2, 3]
    assert (rise > 0.9 * HEIGHT) == held
    if held:
        assert not ended.contacts.faults
        assert not ended.faults
