"""Wrapping around an object: where the arm touches, motions within limits, carrying, and refusals."""

from __future__ import annotations

import json
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.errors import FileError, InvalidValue, TaskError, UnknownName, WeightUnknown

LIMITS = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=2.0)
CAN = pp.Cylinder((0.42, 0.12, -0.12), (0.42, 0.12, 0.12), 0.06)
BOX = pp.Box((0.42, 0.12, 0.0), (0.06, 0.06, 0.24), (0.0, 0.0, 0.3))
BALL = pp.Sphere((0.42, 0.12, 0.0), 0.07)


def arm() -> pp.Arm:
    return template_arm("RyRz", 20).with_effort(5.0)


def scene(obstacle) -> pp.Scene:
    return pp.Scene({"it": obstacle, "floor": pp.HalfSpace((0, 0, -0.12), (0, 0, 1))}, touchable=["it"])


@cache
def grip(obstacle=CAN, turns=0.9) -> pp.Grip:
    return pp.wrap(
        arm(), "it", scene(obstacle), arm().straight(), LIMITS, turns=turns, friction=0.5, squeeze=0.1
    )


def overlap(held: pp.Grip, q: np.ndarray) -> float:
    """How deep the arm is inside the object: the distance of a scene that does not know what is touchable."""
    alone = pp.Scene({"it": held.scene.obstacles["it"]}, self_collision=False)
    return -pp.CollisionModel(held.arm, alone).minimum(q).distance


@pytest.mark.long
@pytest.mark.parametrize(("obstacle", "turns"), [(CAN, 0.9), (CAN, -0.9), (BALL, 0.7)])
def test_the_arm_closes_around_the_object_from_outside(obstacle, turns):
    held = grip(obstacle, turns)
    a = held.arm
    assert abs(overlap(held, held.touching)) <= 1e-4 * a.length
    # It comes no nearer than the margin until it winds, and then no deeper inside than where it touches.
    ways = {name: held.phases[name].configurations(a) for name in ("approach", "wind")}
    assert max(overlap(held, row) for row in ways["approach"]) <= -held.scene.margin + 1e-6
    assert max(overlap(held, row) for row in ways["wind"]) <= 1e-4 * a.length + 1e-9
    assert overlap(held, held.held) > 1e-3 * a.length  # the command is inside
    # It winds by the turns that it should: the angle about the axis that the wrapped points sweep.
    points = a.at(held.touching).points[held.first :]
    middle = np.array([0.42, 0.12])
    angles = np.unwrap(np.arctan2(*(points[:, :2] - middle).T[::-1]))
    swept = (angles[-1] - angles[0]) / (2.0 * np.pi)
    assert np.sign(swept) == np.sign(turns)
    assert abs(turns) - 0.06 <= abs(swept) <= abs(turns) + 0.2
    assert held.hold.closed
    assert len(held.hold.bodies) > 5


@pytest.mark.long
def test_motions_join_and_keep_the_limits():
    held = grip()
    lifted = pp.carry(held, (0.0, 0.0, 0.1))
    motions = [*held.phases.values(), *lifted.phases.values(), pp.unwrap(lifted, held.arm.straight())]
    ends = [(each.positions[0], each.positions[-1]) for each in motions]
    for (_, end), (start, _) in pairwise(ends):
        np.testing.assert_allclose(start, end, atol=1e-9)
    whole = pp.JointTrajectory.joined(motions)
    resting = 0.02 * (len(motions) - 1)
    assert whole.duration == pytest.approx(sum(each.duration for each in motions) + resting)
    steps = np.diff(whole.positions, axis=0) / 0.02
    assert np.abs(steps).max() <= 1.0 + 1e-6
    assert np.abs(np.diff(steps, axis=0) / 0.02).max() <= 2.0 + 1e-6
    np.testing.assert_allclose(whole.positions[-1], held.arm.positions(held.arm.straight()), atol=1e-6)


@pytest.mark.long
@pytest.mark.parametrize(
    "displacement",
    [(0.0, 0.0, 0.1), pin.SE3(pin.exp3(np.array([0.0, 0.0, 0.3])), np.array([0.05, -0.1, 0.1]))],
)
def test_what_is_wrapped_moves_with_the_object(displacement):
    held = grip()
    carried = pp.carry(held, displacement)
    motion = displacement
    if not isinstance(motion, pin.SE3):
        motion = pin.SE3(np.eye(3), np.array(motion))
    before = held.arm.at(held.held).points[held.first :]
    after = carried.arm.at(carried.held).points[held.first :]
    np.testing.assert_allclose(after, np.array([motion.act(each) for each in before]), atol=2e-5)
    np.testing.assert_allclose(
        carried.scene.obstacles["it"].pose(np.zeros(3)).translation,
        motion.act(held.scene.obstacles["it"].pose(np.zeros(3)).translation),
        atol=1e-12,
    )
    assert overlap(carried, carried.touching) == pytest.approx(overlap(held, held.touching), abs=2e-5)
    # All rows keep the shape of the wrap: distances between wrapped points do not change.
    for q in carried.motion.configurations(carried.arm)[::5]:
        points = carried.arm.at(q).points[held.first :]
        np.testing.assert_allclose(
            np.linalg.norm(points - points[0], axis=1), np.linalg.norm(before - before[0], axis=1), atol=2e-5
        )
    lower = pp.carry(carried, (0.0, 0.0, -0.05))
    assert lower.displacement[2, 3] == pytest.approx(carried.displacement[2, 3] - 0.05)


@pytest.mark.long
def test_an_arm_that_does_not_squeeze_or_carry_rests_for_a_cycle():
    held = pp.wrap(arm(), "it", scene(CAN), arm().straight(), LIMITS, turns=0.9, squeeze=0.0)
    np.testing.assert_array_equal(held.held, held.touching)
    assert held.phases["squeeze"].duration == pytest.approx(0.02)
    there = pp.carry(held, (0.0, 0.0, 0.0))
    np.testing.assert_allclose(there.held, held.held, atol=1e-6)
    assert there.motion.duration == pytest.approx(0.02, abs=0.021)


def lowest(held: pp.Grip, q: np.ndarray) -> float:
    """The height of the can above the floor at a configuration, by the pose of the frame that carries it."""
    a = held.arm
    before = a.at(held.touching)
    after = a.at(q)
    k = held.first
    turn = after.rotations[k] @ before.rotations[k].T
    ends = np.array([held.scene.obstacles["it"].start, held.scene.obstacles["it"].end])
    moved = (ends - before.points[k]) @ turn.T + after.points[k]
    tilt = np.hypot(*(moved[1] - moved[0])[:2]) / np.linalg.norm(moved[1] - moved[0])
    return float(moved[:, 2].min() - CAN.radius * tilt + 0.12)


@pytest.mark.long
def test_what_is_carried_keeps_clear_unless_it_stood_there_or_is_put_down():
    held = grip()
    assert held.carrying.carried["it"].beside == ("floor",)
    lifted = pp.carry(held, (0.0, 0.0, 0.1))
    assert lifted.carrying.carried["it"].beside == ()
    assert lowest(lifted, lifted.touching) == pytest.approx(0.1, abs=2e-5)
    near = pp.carry(lifted, (0.0, 0.0, -0.0945))
    assert lowest(near, near.touching) == pytest.approx(0.0055, abs=5e-5)
    for deeper in (-0.097, -0.1):
        with pytest.raises(TaskError, match="it comes within the margin of floor"):
            pp.carry(lifted, (0.0, 0.0, deeper))
    down = pp.carry(lifted, (0.0, 0.05, -0.1), onto=["floor"])
    assert lowest(down, down.touching) == pytest.approx(0.0, abs=5e-5)
    with pytest.raises(TaskError, match="it is pressed into floor"):
        pp.carry(lifted, (0.0, 0.0, -0.103), onto=["floor"])
    with pytest.raises(UnknownName, match="nothing"):
        pp.carry(lifted, (0.0, 0.0, 0.1), onto=["nothing"])
    # It may slide along the floor on which it stands, but not into it.
    assert lowest(held, pp.carry(held, (0.0, 0.02, 0.0)).touching) == pytest.approx(0.0, abs=5e-5)
    with pytest.raises(TaskError, match="it comes within the margin of floor"):
        pp.carry(held, (0.0, 0.0, -0.01))


@pytest.mark.long
def test_what_is_carried_is_stopped_before_an_obstacle_that_the_arm_would_miss():
    held = grip()
    # A ceiling above the can, higher than any part of the arm is lifted to.
    ceiling = {**held.scene.obstacles, "shelf": pp.Box((0.42, 0.12, 0.2), (0.1, 0.1, 0.02))}
    under = replace(held, scene=held.scene.with_obstacles(ceiling))
    pp.carry(under, (0.0, 0.0, 0.06))  # up to 10 mm below
    with pytest.raises(TaskError, match="it comes within the margin of shelf"):
        pp.carry(under, (0.0, 0.0, 0.067))


@pytest.mark.long
def test_an_arm_lets_go_where_it_stands_off_and_goes_on_clear_of_what_it_left():
    held = pp.carry(pp.carry(grip(), (0.0, 0.0, 0.1)), (0.0, 0.05, -0.1), onto=["floor"])
    assert overlap(held, held.opened) == pytest.approx(-held.scene.margin - 4e-4, abs=1e-4)
    away = pp.unwrap(held, held.arm.straight()).configurations(held.arm)
    off = int(np.argmin([np.abs(held.arm.difference(held.opened, q)).max() for q in away]))
    assert max(overlap(held, q) for q in away[off:]) <= -held.scene.margin + 1e-6


@pytest.mark.long
def test_an_arm_does_not_open_into_an_obstacle():
    held = grip()
    tip = held.arm.at(held.opened).points[-1]
    wall = {**held.scene.obstacles, "post": pp.Sphere(tuple(tip), 0.03)}
    blocked = replace(held, scene=held.scene.with_obstacles(wall))
    with pytest.raises(TaskError, match="post"):
        pp.unwrap(blocked)


@pytest.mark.parametrize(
    ("changes", "error", "named"),
    [
        ({"obstacle": "nothing"}, UnknownName, "nothing"),
        ({"obstacle": "floor"}, InvalidValue, "touchable"),
        ({"limits": pp.Limits(dt=0.02)}, InvalidValue, "acceleration"),
        ({"limits": pp.Limits()}, InvalidValue, "dt"),
        ({"turns": 0.0}, InvalidValue, "turns"),
        ({"turns": 3.0}, TaskError, "all modules but one"),
        ({"scene": scene(BOX)}, TaskError, "cannot follow"),  # its edges are sharper than the arm bends
        ({"squeeze": 2.0}, InvalidValue, "squeeze"),
        ({"friction": -1.0}, InvalidValue, "friction"),
        *(({name: np.nan}, InvalidValue, name) for name in ("turns", "friction", "squeeze")),
        *(({name: "x"}, InvalidValue, name) for name in ("turns", "friction", "squeeze", "scene", "limits")),
        ({"turns": 1e200}, InvalidValue, "turns"),
        ({"obstacle": 3}, InvalidValue, "obstacle"),
        (
            {"scene": pp.Scene({"it": pp.Sphere((1.5, 0, 0), 0.05)}, touchable=["it"])},
            TaskError,
            "free modules",
        ),
    ],
)
def test_what_cannot_be_wrapped_is_refused_by_name(changes, error, named):
    given = {"obstacle": "it", "scene": scene(CAN), "limits": LIMITS, "turns": 0.9, **changes}
    with pytest.raises(error, match=named):
        pp.wrap(
            arm(),
            given.pop("obstacle"),
            given.pop("scene"),
            arm().straight(),
            given.pop("limits"),
            **given,
        )


@pytest.mark.long
def test_a_force_is_pressed_by_the_stiffness_of_the_joints_within_their_torques():
    soft = arm().with_stiffness(20.0)
    options = {"turns": 0.9, "friction": 0.5}
    held = [
        pp.wrap(a, "it", scene(CAN), a.straight(), LIMITS, **options, force=force)
        for a, force in ((soft, 0.5), (soft, 1.0), (arm().with_stiffness(40.0), 1.0))
    ]
    once, twice, stiff = (each.arm.difference(each.touching, each.held) for each in held)
    np.testing.assert_allclose(twice, 2.0 * once, atol=1e-6)  # a force is a torque,
    np.testing.assert_allclose(stiff, once, atol=1e-6)  # and a torque is a stiffness times a displacement
    with pytest.raises(TaskError, match="times the torque of a joint"):
        pp.wrap(soft, "it", scene(CAN), soft.straight(), LIMITS, **options, force=50.0)
    with pytest.raises(TaskError, match="reach a limit"):
        pp.wrap(arm().with_stiffness(0.1), "it", scene(CAN), arm().straight(), LIMITS, **options, force=1.0)
    with pytest.raises(WeightUnknown, match="stiffness"):
        pp.wrap(arm(), "it", scene(CAN), arm().straight(), LIMITS, **options, force=1.0)


@pytest.mark.long
def test_a_place_that_is_not_reached_is_refused_with_how_far_the_arm_gets():
    with pytest.raises(TaskError, match="% of the way"):
        pp.carry(grip(), (0.0, 0.0, 2.0))


@pytest.mark.long
@pytest.mark.parametrize("bad", [None, "up", (0.0, 0.1), (0.0, 0.0, np.nan), (0.0, 0.0, 1e200), object()])
def test_displacements_and_ends_that_are_none_are_refused(bad):
    with pytest.raises(InvalidValue, match="displacement"):
        pp.carry(grip(), bad)
    with pytest.raises(InvalidValue, match="grip"):
        pp.carry(bad, (0.0, 0.0, 0.1))
    with pytest.raises(InvalidValue, match="grip"):
        pp.unwrap(bad)
    if bad is not None:
        with pytest.raises(InvalidValue, match="q_end"):
            pp.unwrap(grip(), bad)


@pytest.mark.long
def test_a_grip_is_saved_with_all_that_carrying_needs(tmp_path):
    held = pp.carry(grip(), (0.0, 0.0, 0.1))
    for each in (grip(), held):
        again = pp.load(pp.save(each, tmp_path / "grip"))
        assert isinstance(again, pp.Grip)
        assert again.scene == each.scene
        assert repr(again) == repr(each)
        assert json.dumps(again.summary()) == json.dumps(each.summary())
        for name, motion in each.phases.items():
            np.testing.assert_array_equal(again.phases[name].positions, motion.positions)
        ended = [pp.carry(g, (0.02, 0.0, 0.02)).motion.positions for g in (each, again)]
        np.testing.assert_array_equal(*ended)
        ended = [pp.unwrap(g).positions for g in (each, again)]
        np.testing.assert_array_equal(*ended)
    told = held.summary()
    assert told["modules"] == held.arm.n_modules - held.first - 1
    assert told["displacement"][2][3] == pytest.approx(0.1)
    assert told["mass"] == held.hold.mass
    with pytest.raises(FileError, match="pinposture-run"):
        pp.load(tmp_path / "grip.npz", pp.Run)


@pytest.mark.long
@pytest.mark.parametrize(
    ("changes", "named"),
    [
        ({"first": 19}, "first"),
        ({"obstacle": "nothing"}, "nothing"),
        ({"held": np.zeros(3)}, "held"),
        ({"ways": {"wind": np.full((2, 40), np.nan)}}, "way wind"),
        ({"friction": -1.0}, "friction"),
    ],
)
def test_a_damaged_grip_is_refused_by_name(changes, named, tmp_path):
    file = pp.save(replace(grip(), **changes), tmp_path / "grip.npz")
    with pytest.raises(FileError, match=named):
        pp.load(file)


def test_motions_that_do_not_meet_are_refused():
    a = template_arm("RyRz", 4)
    motion = pp.JointTrajectory.from_configurations(a, np.linspace(np.zeros(8), np.full(8, 0.2), 10), 0.02)
    with pytest.raises(InvalidValue, match="start"):
        pp.JointTrajectory.joined([motion, motion])
    with pytest.raises(InvalidValue, match="at least one"):
        pp.JointTrajectory.joined([])
