"""Contact in the simulation against closed forms: weight, torque balance, friction cone, energy, slip."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import template_arm
from simple_arms import WEIGHT, pendulum

import pinposture as pp
from pinposture import sim
from pinposture.arm import continuum_section
from pinposture.errors import InvalidValue, UnknownName
from pinposture.motion.held import HeldObject
from pinposture.sim.plant import Plant

FLOOR = pp.HalfSpace((0, 0, -1), (0, 0, 1))
SIZE = 0.2
MASS = 2.0


def box(height: float = -1.0 + SIZE / 2.0, turn=None, x: float = 3.0) -> pp.Box:
    return pp.Box((x, 0, height), (SIZE,) * 3, turn)


def advanced(scene: pp.Scene, contact: sim.ContactModel, seconds: float, gravity=True) -> Plant:
    """A pendulum that is held far away, while other things move."""
    arm = pendulum()
    plant = Plant(
        sim.build_plant_model(arm, gravity=gravity, scene=scene, contact=contact), np.zeros(1), 0.01
    )
    for _ in range(round(seconds / 0.01)):
        assert plant.advance(np.zeros(1)), plant.failure
    return plant


def test_the_floor_carries_the_weight_of_a_box():
    scene = pp.Scene({"floor": FLOOR, "box": box()})
    history = advanced(scene, sim.ContactModel(masses={"box": MASS}), 1.0).contacts.history()
    assert history.pairs == (("floor", "box"),)
    np.testing.assert_allclose(history.forces[-1, 0], [0, 0, -9.81 * MASS], atol=1e-4)
    assert not history.of_arm
    assert not history.faults


@pytest.mark.parametrize(("friction", "slides"), [(0.35, False), (0.25, True)])
def test_a_box_slides_on_a_slope_if_it_is_steeper_than_the_friction_cone(friction, slides):
    # The slope is 0.3; instead of the floor, gravity is inclined.
    angle = math.atan(0.3)
    gravity = 9.81 * np.array([math.sin(angle), 0.0, -math.cos(angle)])
    scene = pp.Scene({"floor": FLOOR, "box": box()})
    contact = sim.ContactModel(friction=friction, masses={"box": MASS})
    history = advanced(scene, contact, 1.0, gravity).contacts.history()
    middle = np.array([*scene.obstacles["box"].center, 1.0])
    moved = (history.displacements[-1, 0] @ middle - middle)[0]
    along, _, across = history.forces[20:, 0].mean(axis=0)
    assert across == pytest.approx(gravity[2] * MASS, rel=0.01)
    if slides:
        assert along == pytest.approx(friction * -across, rel=0.02)
        way = 9.81 * (math.sin(angle) - friction * math.cos(angle)) / 2.0
        assert moved == pytest.approx(way, rel=0.03)
    else:
        assert along == pytest.approx(gravity[0] * MASS, rel=0.01)
        assert abs(moved) < 2e-4
    # A box that slides rocks, and does not touch all the time.
    assert 0.75 * abs(moved) - 1e-4 < history.slips[-1, 0] < 1.01 * abs(moved) + 1e-4


@pytest.mark.long
def test_a_ball_that_falls_touches_when_and_as_fast_as_it_should_and_never_gains_energy():
    height = 0.3
    ball = pp.Sphere((3, 0, -1 + 0.05 + height), 0.05)
    scene = pp.Scene({"floor": FLOOR, "ball": ball})
    plant = advanced(scene, sim.ContactModel(damping=0.2, masses={"ball": MASS}), 2.0)
    history = plant.contacts.history()
    (touch,) = history.all
    assert touch.time == pytest.approx(math.sqrt(2.0 * height / 9.81), abs=3e-3)
    assert touch.speed == pytest.approx(math.sqrt(2.0 * 9.81 * height), rel=0.01)
    assert touch.force > 10.0 * MASS * 9.81  # it stops within some milliseconds
    heights = history.displacements[:, 0, 2, 3]
    bounces = heights[60:].max()
    assert -height < bounces < -0.01  # it bounces, and not as high


@pytest.mark.long
def test_a_link_that_leans_on_a_box_divides_its_weight_between_the_two():
    """Torque balance: force of the box times its lever + torque of the servo = torque of the weight."""
    arm = pendulum()
    lever = 0.8
    scene = pp.Scene({"rest": pp.Sphere((lever, 0, -0.12), 0.02)}, arm_radius=0.02)
    ended = sim.simulate(
        arm,
        np.linspace([0.0], [0.15], 50),  # it ends below the ball
        servos=sim.Servos(2.0),
        dt=0.01,
        hold=3.0,
        scene=scene,
        contact=sim.ContactModel(),
    )
    (touch,) = ended.contacts.all
    assert touch.pair == ("swing", "rest")
    force = ended.contacts.forces[-1, 0]
    at = ended.q[-1, 0]
    # The force is normal to the link, at the place where the ball touches it, measured from the joint.
    normal = np.array([math.sin(at), 0.0, math.cos(at)])
    place = np.array([lever, 0.0, -0.12]) @ np.array([math.cos(at), 0.0, -math.sin(at)])
    assert np.linalg.norm(np.cross(force, normal)) < 0.05 * np.linalg.norm(force)
    balance = ended.torques[-1, 0] + WEIGHT * math.cos(at) - (force @ normal) * place
    assert balance == pytest.approx(0.0, abs=2e-3 * WEIGHT)
    assert ended.faults == (f"it missed a target: {ended.reason}", str(touch))


@cache
def reaching(touchable=(), **contact) -> sim.Simulation:
    """Four modules that bend down onto a can, which stands on the floor."""
    arm = template_arm("RyRz", 4)
    q = np.zeros((40, arm.nv))
    q[:, 2] = np.linspace(0.0, 0.3, 40)
    can = pp.Cylinder((0.16, 0, -0.08), (0.16, 0, -0.02), 0.02)
    floor = pp.HalfSpace((0, 0, -0.08), (0, 0, 1))
    scene = pp.Scene({"floor": floor, "can": can}, touchable=touchable)
    contact = sim.ContactModel(masses={"can": 0.02}, **contact)
    return sim.simulate(arm, q, servos=sim.Servos(5.0), dt=0.02, hold=0.2, scene=scene, contact=contact)


@pytest.mark.long
def test_the_verdict_names_the_first_contact_that_is_not_allowed():
    ended = reaching()
    first = ended.contacts.of_arm[0]
    assert first.pair[1] == "can"
    assert str(first) in ended.verdict
    assert first.pair[0] in ended.contacts.own
    assert any("can" in text for text in ended.faults)
    allowed = reaching(touchable=("can", "floor"))
    assert not allowed.contacts.faults
    assert not any("touches" in text for text in allowed.faults)
    assert ended.summary()["contact"]["first_touch"]["pair"] == list(first.pair)


@pytest.mark.long
def test_a_simulation_with_contacts_is_saved_and_read(tmp_path):
    ended = reaching(friction=0.5)
    again = pp.load(pp.save(ended, tmp_path / "simulation.npz"))
    assert again.contacts.all == ended.contacts.all
    assert again.contacts.model == ended.contacts.model
    assert again.verdict == ended.verdict
    np.testing.assert_array_equal(again.contacts.displacements, ended.contacts.displacements)


@pytest.mark.long
def test_free_obstacles_are_where_they_were_pushed():
    ended = reaching(friction=0.2)
    scene = ended.scene_in(-1, ended.scene)
    moved = np.array(scene.obstacles["can"].start) - ended.scene.obstacles["can"].start
    assert np.linalg.norm(moved) > 1e-4
    model = pp.CollisionModel(ended.arm, scene)
    assert ended.clearance[-1] == pytest.approx(model.minimum(ended.q[-1]).distance, abs=1e-12)
    told = ended.summary()["clearance"]
    assert told["to_obstacles"]["smallest"] == pytest.approx(ended.clearance.min(), abs=1e-12)


def test_contact_changes_nothing_where_nothing_touches():
    arm = template_arm("RyRz", 4)
    q = np.linspace(np.zeros(arm.nv), np.full(arm.nv, 0.2), 30)
    alone, with_contact = (
        sim.simulate(arm, q, dt=0.02, hold=0.1, scene=pp.Scene(), contact=contact)
        for contact in (None, sim.ContactModel())
    )
    assert with_contact.contacts.all == ()
    np.testing.assert_allclose(with_contact.q, alone.q, atol=1e-12)


@pytest.mark.parametrize(
    ("options", "error", "named"),
    [
        ({"friction": -1.0}, InvalidValue, "friction"),
        ({"time_constant": 0.0}, InvalidValue, "time_constant"),
        ({"masses": {"box": 0.0}}, InvalidValue, "box"),
        ({"masses": {"nothing": 1.0}}, UnknownName, "nothing"),
        ({"masses": {"floor": 1.0}}, InvalidValue, "floor"),
    ],
)
def test_what_cannot_touch_is_refused_by_name(options, error, named):
    scene = pp.Scene({"floor": FLOOR, "box": box()})
    with pytest.raises(error, match=named):
        sim.build_plant_model(pendulum(), scene=scene, contact=sim.ContactModel(**options))


def test_surfaces_and_coupled_arms_are_refused_by_name():
    scan = pp.Scan(np.random.default_rng(0).uniform(1.0, 2.0, (30, 3)))
    with pytest.raises(InvalidValue, match="cloud"):
        sim.build_plant_model(pendulum(), scene=pp.Scene({"cloud": scan}), contact=sim.ContactModel())
    coupled = pp.Arm.from_modules([continuum_section(4, 0.2)] * 2)
    with pytest.raises(InvalidValue, match="coupled"):
        sim.build_plant_model(coupled, contact=sim.ContactModel())


@pytest.mark.long
@pytest.mark.parametrize(("share", "held"), [(0.9, True), (1.1, False)])
def test_a_ball_between_two_jaws_is_held_up_to_the_mass_that_is_told(share, held):
    arm = pp.Arm.from_modules([pp.ModuleTemplate("Level", [pp.JointSpec("z")], [0.2])] * 3).with_effort(0.5)
    q = np.array([0.0, 0.5 * math.pi, 0.5 * math.pi])
    ball = pp.Sphere((0.05, 0.1, 0.0), 0.09)
    scene = pp.Scene({"ball": ball}, arm_radius=0.01, self_collision=False, touchable=["ball"])
    mass = pp.assess_hold(arm, q, scene, "ball", friction=0.5).mass
    squeezed = q + np.array([0.0, 0.0, 0.2])
    contact = sim.ContactModel(friction=0.5, masses={"ball": share * mass})
    ended = sim.simulate(
        arm, [q, squeezed], servos=sim.Servos(10.0), dt=0.01, hold=0.5, scene=scene, contact=contact
    )
    height = ended.contacts.displacements[-1, 0, 2, 3]
    assert (abs(height) < 0.02) == held
    if held:
        assert ended.contacts.forces[-1, :, 1] == pytest.approx([-0.5 / 0.15, 0.5 / 0.15], rel=0.02)
        assert not ended.contacts.faults


@pytest.mark.parametrize(("name", "falls"), [("ball", True), ("stone", False)])
def test_what_falls_out_of_the_arm_fails_the_verdict_and_what_stays_does_not(name, falls, tmp_path):
    arm = pendulum()
    scene = pp.Scene({"floor": FLOOR, "ball": pp.Sphere((3, 0, 0), 0.05), "stone": box()})
    q = arm.neutral()
    run = pp.track(arm, pp.Target.from_configuration(arm, q), q, limits=pp.Limits(dt=0.01), scene=scene)
    still = np.repeat(run.q[:1], 31, axis=0)
    names = ("points", "point_errors", "clearance")
    shown = {each: np.repeat(getattr(run, each)[:1], 31, axis=0) for each in names}
    steps = {each: np.zeros((30, arm.nv), dtype=bool) for each in ("clipped",)}
    steps |= {"active": np.zeros((30, 1), bool), "error_increasing": np.zeros(30, bool)}
    whole = replace(run, q=still, **shown, **steps, violated_constraints=np.full(30, ""), info={})
    frame = arm.control_points[-1]
    held = HeldObject(name, frame, begin=5, end=20), HeldObject(name, frame, begin=20, end=31)
    contact = sim.ContactModel(masses={"ball": 0.1, "stone": MASS})
    servos = sim.Servos(gravity_compensation=True)
    ended = sim.simulate(arm, replace(whole, held=held), servos, contact=contact, hold=0.0)
    (slip,) = ended.slipped
    begun, end = 0.05, 0.30
    way = 9.81 * (end**2 - begun**2) / 2.0 if falls else 0.0
    assert slip.obstacle == name
    assert slip.distance == pytest.approx(way, rel=0.01, abs=1e-3)
    assert any(f"{name} slips" in each for each in ended.faults) == falls
    assert (f"{name} slips" in ended.verdict) == falls
    again = pp.load(pp.save(ended, tmp_path / "simulation"))
    assert again.slipped == ended.slipped


@pytest.mark.long
def test_an_arm_that_leans_rests_with_the_torques_that_its_support_is_told_to_need():
    bar = pp.ModuleTemplate("Bar", [pp.JointSpec("y")], [0.3])
    arm = pp.Arm.from_modules([bar] * 2)
    weight = np.abs(arm.at(arm.straight()).gravity_torques)
    arm = arm.with_effort(weight[0] / 1.3)
    ball = pp.Sphere((0.5, 0.0, -0.04), 0.03)
    scene = pp.Scene({"ball": ball}, arm_radius=0.01, self_collision=False, touchable=["ball"])
    support = pp.assess_support(arm, arm.straight(), scene, friction=0.0)
    assert support.share < 0.2 < 1.0 < support.alone
    servos = sim.Servos(2.0)  # stiff ones would bear what the contact yields
    # The servos exert these torques where the arm is straight.
    sent = np.linspace(arm.straight(), support.torques / servos.stiffness(arm), 10)
    contact = sim.ContactModel(friction=0.0)
    leaning = sim.simulate(arm, sent, scene=scene, contact=contact, servos=servos, dt=0.01, hold=3.0)
    assert np.abs(leaning.q[-1]).max() < 0.01
    np.testing.assert_allclose(leaning.torques[-1], support.torques, atol=0.01 * weight[0])
    assert np.abs(leaning.torques[-1]).max() < arm.effort[0]
    force = (weight[0] + support.torques[0]) / 0.5
    np.testing.assert_allclose(np.abs(leaning.contacts.forces[-1, 0]), [0.0, 0.0, force], atol=0.01 * force)
