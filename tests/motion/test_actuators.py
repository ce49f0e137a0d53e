"""Tendons and gears: against lengths measured along the bent arm, and against hand-made matrices."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from scipy.linalg import null_space

import pinposture as pp
from pinposture.arm import continuum_section
from pinposture.errors import InvalidValue, UnknownName
from pinposture.motion.actuators import Actuators, Tendon

RADIUS = 0.008
DISKS = 10
LENGTH = 0.25
PLACEMENT = pin.SE3(pin.rpy.rpyToMatrix(0.4, -0.9, 1.3), np.array([0.2, -0.1, 0.5]))
ANGLES = {"a": 0.0, "b": 2.0 * np.pi / 3.0, "c": 4.0 * np.pi / 3.0}


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_modules([continuum_section(DISKS, LENGTH)] * 3, base_placement=PLACEMENT)


@pytest.fixture(scope="module")
def tendons() -> dict[str, Tendon]:
    """Three for each section; those of the second and third run through the sections before."""
    return {
        f"{section + 1}{letter}": Tendon((RADIUS * np.cos(angle), RADIUS * np.sin(angle)), end=section)
        for section in range(3)
        for letter, angle in ANGLES.items()
    }


def tendon_length(arm: pp.Arm, q: np.ndarray, tendon: Tendon) -> float:
    """Length of a tendon from hole to hole, [m]: one hole in the middle of each link that has a length.

    Links are placed by Pinocchio; the holes are where the tendon is at the straight arm.
    """
    model = arm.model
    data = model.createData()
    straight = model.createData()
    pin.framesForwardKinematics(model, data, q)
    pin.framesForwardKinematics(model, straight, pin.neutral(model))
    joints = arm.chain.module_slices[tendon.end].stop
    axis, y, z = PLACEMENT.rotation.T
    line = PLACEMENT.translation + tendon.offset[0] * y + tendon.offset[1] * z
    along = [float((origin - PLACEMENT.translation) @ axis) for origin in arm.chain.origins[:joints]]
    along.append(float((arm.chain.points[tendon.end] - PLACEMENT.translation) @ axis))
    bodies = [0, *[model.getJointId(name) for name in arm.chain.joints[:joints]]]
    holes = [line]
    for body, start, stop in zip(bodies, [0.0, *along[:-1]], along, strict=True):
        if stop - start > 1e-9:  # not between the crossed hinges of a universal joint
            hole = straight.oMi[body].actInv(line + 0.5 * (start + stop) * axis)
            holes.append(data.oMi[body].act(hole))
    body = bodies[-1]
    holes.append(data.oMi[body].act(straight.oMi[body].actInv(line + along[-1] * axis)))
    return float(np.linalg.norm(np.diff(holes, axis=0), axis=1).sum())


def test_moment_arms_are_those_of_lengths_measured_along_the_arm(
    arm: pp.Arm, tendons: dict[str, Tendon]
) -> None:
    actuators = Actuators.from_tendons(arm, tendons)
    h = 1e-5
    for row, tendon in zip(actuators.matrix, tendons.values(), strict=True):
        for column, step in enumerate(h * np.eye(arm.nv)):
            ahead, behind = (
                tendon_length(arm, arm.integrate(arm.neutral(), sign * step), tendon) for sign in (1.0, -1.0)
            )
            assert row[column] == pytest.approx((ahead - behind) / (2.0 * h), abs=1e-9)


def test_lengths_are_linear_but_for_the_square_of_small_bends(
    arm: pp.Arm, tendons: dict[str, Tendon]
) -> None:
    actuators = Actuators.from_tendons(arm, tendons)
    apart = []
    for scale in (1.0, 0.1):
        q = arm.configuration(scale * np.array([0.1, -0.05, 0.08, 0.1, -0.1, 0.03]))
        lengths = [
            tendon_length(arm, q, each) - tendon_length(arm, arm.neutral(), each) for each in tendons.values()
        ]
        apart.append(np.abs(actuators.positions(q) - lengths).max())
    # A straight piece between holes half a pitch from the joint is shorter by pitch q^2 / 8.
    largest = sum(LENGTH / DISKS * DISKS * bend**2 / 8.0 for bend in (0.1, 0.05, 0.08, 0.1, 0.1, 0.03))
    assert 0.5 * largest < apart[0] < 1.1 * largest
    assert apart[1] == pytest.approx(0.01 * apart[0], rel=0.1)


def test_tendons_run_through_the_sections_before_and_not_beyond_their_own(
    arm: pp.Arm, tendons: dict[str, Tendon]
) -> None:
    matrix = Actuators.from_tendons(arm, tendons).matrix
    # Each section has two degrees of freedom of ten disks; a tendon at (y, z) bends by y about z, z about y.
    moments = np.array([[RADIUS * np.sin(angle), -RADIUS * np.cos(angle)] for angle in ANGLES.values()])
    for section in range(3):
        for before in range(3):
            block = matrix[3 * section : 3 * section + 3, 2 * before : 2 * before + 2]
            expected = DISKS * moments if before <= section else np.zeros((3, 2))
            np.testing.assert_allclose(block, expected, atol=1e-12)
    later = Actuators.from_tendons(arm, {"t": Tendon((RADIUS, 0.0), end=2, start=0)})
    np.testing.assert_allclose(later.matrix[0, :2], 0.0)
    np.testing.assert_allclose(later.matrix[0, 2:], matrix[6, 2:], atol=1e-12)


@given(st.lists(st.floats(-1.0, 1.0), min_size=6, max_size=6))
def test_measured_tendons_give_the_configuration_back(
    arm: pp.Arm, tendons: dict[str, Tendon], positions: list[float]
) -> None:
    actuators = Actuators.from_tendons(arm, tendons)
    q = arm.configuration(positions)
    found, apart = actuators.configuration(actuators.positions(q))
    np.testing.assert_allclose(found, q, atol=1e-12)
    assert apart <= 1e-12
    stretched = actuators.positions(q) + 1e-4 * np.ones(9)  # no bending makes all tendons longer
    found, apart = actuators.configuration(stretched)
    np.testing.assert_allclose(found, q, atol=1e-9)
    assert apart == pytest.approx(1e-4)


def test_what_no_actuator_determines_is_named(arm: pp.Arm, tendons: dict[str, Tendon]) -> None:
    # Tendons of the third section alone cannot tell its bending from that of the second.
    some = {name: tendon for name, tendon in tendons.items() if name[0] != "2"}
    with pytest.raises(InvalidValue, match="rank of the matrix is 4; allowed: 6 independent rows"):
        Actuators.from_tendons(arm, some).configuration(np.zeros(6))
    pulled = Actuators.from_tendons(arm, {name: tendons[name] for name in ("1a", "1b", "1c")})
    with pytest.raises(InvalidValue, match=r"'m0[23]_j0[12]_[yz]' is not determined"):
        pulled.configuration(np.zeros(3))


@pytest.mark.long
@examples(12)
@given(st.integers(0, 1000))
def test_limits_of_actuators_hold_on_runs(arm: pp.Arm, tendons: dict[str, Tendon], seed: int) -> None:
    rng = np.random.default_rng(seed)
    actuators = Actuators.from_tendons(
        arm, tendons, velocity=rng.uniform(0.005, 0.05, 9), acceleration=rng.uniform(0.02, 0.2)
    )
    limits = actuators.limits(pp.Limits(step=None, velocity=1.0, acceleration=4.0, dt=0.02))
    goal = pp.Target.from_configuration(
        arm, arm.configuration(0.9 * rng.uniform(arm.limits.lower, arm.limits.upper))
    )
    run = pp.track(arm, goal, arm.straight(), limits=limits, max_steps=5000)
    assert run.status == "converged"
    peaks = actuators.trajectory(run.joint_trajectory(force=True)).peaks  # it may pass through itself
    assert np.all(peaks.speeds <= actuators.velocity * (1.0 + 1e-9))
    assert np.all(peaks.accelerations <= actuators.acceleration * (1.0 + 1e-9))


def test_motions_of_actuators_are_written_like_those_of_joints(
    arm: pp.Arm, tendons: dict[str, Tendon], tmp_path
) -> None:
    actuators = Actuators.from_tendons(arm, tendons)
    q = np.random.default_rng(0).uniform(-0.3, 0.3, (5, arm.nv))
    moved = actuators.trajectory(pp.JointTrajectory.from_configurations(arm, q, 0.1))
    np.testing.assert_allclose(moved.positions, actuators.positions(q), atol=1e-15)
    again = pp.load(pp.save(moved, tmp_path / "tendons.csv"))
    assert again.joint_names == tuple(tendons)
    assert again.units == ("m",) * 9
    np.testing.assert_array_equal(again.positions, moved.positions)


def test_a_differential_drive_is_a_matrix() -> None:
    arm = pp.Arm.from_template("RyRz", modules=1)
    drive = Actuators.from_matrix(arm, ["left", "right"], [[2.0, 2.0], [2.0, -2.0]], ["rad", "rad"], 3.0)
    np.testing.assert_allclose(drive.positions(arm.configuration([0.3, 0.1])), [0.8, 0.4])
    found, apart = drive.configuration([0.8, 0.4])
    np.testing.assert_allclose(found, [0.3, 0.1])
    assert apart < 1e-15
    limits = drive.limits(pp.Limits(step=None, velocity=1.0, dt=0.01))
    np.testing.assert_allclose(limits.velocity, 0.75)  # both joints at 0.75 turn one motor at 3
    assert limits.acceleration is None


def test_bad_actuators_are_refused(arm: pp.Arm, tendons: dict[str, Tendon]) -> None:
    bent = pp.Arm.from_model(arm.model, arm.control_points)
    assert Actuators.from_tendons(bent, tendons).matrix.shape == (9, 6)
    for made, words in (
        (lambda: Actuators(arm, ("u",), np.full((1, 6), np.nan), ("m",)), r"matrix\[0, 0\] is nan"),
        (lambda: Actuators(arm, ("u",), np.ones((1, 6)), 7), "'rad' or 'm' for each of 1"),
        (lambda: Actuators("arm", ("u",), np.ones((1, 6)), ("m",)), "an Arm"),
        (lambda: Actuators.from_matrix(arm, ["u"], [[1.0] * 5], ["m"]), r"of shape \(1, 6\)"),
        (lambda: Actuators.from_matrix(arm, ["u"], [[1.0] * 6], ["deg"]), "'rad' or 'm' for each of 1"),
        (lambda: Actuators.from_matrix(arm, ["u"], [[1.0] * 6], ["m"], velocity=0.0), "velocity is 0"),
        (lambda: Actuators.from_matrix(arm, ["u"], [[1.0] * 6], ["m"], [1.0, 2.0]), r"one number or \(1,\)"),
        (lambda: Actuators.from_tendons(arm, {"t": Tendon((0.01, 0.0), end=3)}), "an index of 3 points"),
        (lambda: Actuators.from_tendons(arm, {"t": Tendon((0.01, 0.0), 1, 1)}), "an end farther along"),
        (lambda: Actuators.from_tendons(arm, {"t": Tendon((0.01, np.nan))}), "offset of tendon 't'"),
        (lambda: Actuators.from_tendons(arm, tendons).limits(pp.Limits()), "the duration of a step"),
    ):
        with pytest.raises(InvalidValue, match=words):
            made()
    with pytest.raises(UnknownName, match="module_02"):
        Actuators.from_tendons(arm, {"t": Tendon((0.01, 0.0), "module_2")})
    free = Actuators.from_tendons(arm, tendons, velocity=0.01)
    with pytest.raises(InvalidValue, match="a finite velocity of joint 'm01_j01_y', which actuator '1a'"):
        free.limits(pp.Limits(step=None, velocity=np.inf, dt=0.02))


# Tensions.


def held_by(arm: pp.Arm, q: np.ndarray) -> np.ndarray:
    return pin.rnea(arm.model, arm.model.createData(), q, np.zeros(arm.nv), np.zeros(arm.nv))


@pytest.mark.parametrize("least", [0.0, 2.0])
def test_tensions_hold_the_arm_and_are_the_smallest_that_do(
    arm: pp.Arm, tendons: dict[str, Tendon], least: float
) -> None:
    actuators = Actuators.from_tendons(arm, tendons)
    for seed in range(5):
        q = arm.configuration(0.3 * arm.positions(arm.random(seed)))
        torques = arm.at(q).gravity_torques
        found = actuators.tensions(torques, least)
        assert np.all(found >= least)
        step = 1e-6  # virtual work: what the tendons do as they shorten is what the weight takes
        for d in step * np.eye(arm.nv):
            shorter = actuators.positions(arm.integrate(q, -d)) - actuators.positions(arm.integrate(q, d))
            assert found @ shorter / (2 * step) == pytest.approx(held_by(arm, q) @ d / step, abs=1e-7)
        free = null_space(actuators.matrix.T)  # changes of tensions that leave the torques as they are
        assert free.shape == (9, 3)
        for direction in np.random.default_rng(seed).normal(size=(300, 3)) @ free.T:
            room = np.where(direction < 0.0, (found - least) / np.maximum(-direction, 1e-300), np.inf)
            other = found + min(float(room.min()), 1e-3) * direction
            assert found @ found <= other @ other + 1e-9 * (found @ found)


def test_two_tendons_about_a_hinge_pull_one_or_both() -> None:
    module = pp.ModuleTemplate("Hinge", [pp.JointSpec("z")], [0.1])
    arm = pp.Arm.from_modules([module])
    pair = {"left": Tendon((0.02, 0.0)), "right": Tendon((-0.02, 0.0))}
    actuators = Actuators.from_tendons(arm, pair)
    np.testing.assert_allclose(actuators.tensions([1.0]), [50.0, 0.0], atol=1e-6)  # it turns to the left, +y
    np.testing.assert_allclose(actuators.tensions([-1.0]), [0.0, 50.0], atol=1e-6)
    np.testing.assert_allclose(actuators.tensions([1.0], least=[1.0, 4.0]), [54.0, 4.0], atol=1e-6)
    np.testing.assert_allclose(actuators.tensions([0.0], 3.0, 3.0), [3.0, 3.0], atol=1e-6)
    np.testing.assert_allclose(actuators.tensions([1e-9]), [5e-8, 0.0], atol=1e-14)
    with pytest.raises(InvalidValue, match=r"lacks 0\.2 N m with 'left' at the largest tension"):
        actuators.tensions([1.0], most=40.0)


def test_torques_without_tendons_are_refused(arm: pp.Arm, tendons: dict[str, Tendon]) -> None:
    first = {name: tendon for name, tendon in tendons.items() if name[0] == "1"}
    some = Actuators.from_tendons(arm, first)
    torques = np.zeros(arm.nv)
    torques[0] = 0.1
    assert np.all(some.tensions(torques) >= 0.0)
    torques[4] = 0.3
    with pytest.raises(InvalidValue, match=f"joint '{arm.joint_names[4]}' lacks 0.3 N m"):
        some.tensions(torques)
    gears = Actuators.from_matrix(arm, ["gear"], np.ones((1, arm.nv)), ["rad"])
    with pytest.raises(InvalidValue, match="'gear' is none"):
        gears.tensions(torques)
    limits = [(-1.0, 5.0), (5.0, 4.0), (np.inf, np.inf), (0.0, np.nan), ([1.0], 5.0), (0.0, [5.0])]
    for least, most in limits:
        with pytest.raises(InvalidValue):
            some.tensions(np.zeros(arm.nv), least, most)
    with pytest.raises(InvalidValue, match="torques"):
        some.tensions([1.0, 2.0])
