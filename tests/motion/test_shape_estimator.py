"""The shape estimator against SciPy and Pinocchio: the most probable configuration, and its covariance."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest
from numpy.typing import NDArray
from scipy.optimize import least_squares

import pinposture as pp
from pinposture.errors import InvalidValue, UnknownName

Array = NDArray[np.float64]

BEFORE = 0.2
NOISE = 0.02
MOUNTING = (0.3, -0.4, 0.5)


def small_arm(modules: int = 4) -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=modules)


def heavy_arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=5, link_lengths=(0.05, 0.05)).with_stiffness(3.0)


def placements(arm: pp.Arm, q: Array) -> list[pin.SE3]:
    """Placements of the control points, by Pinocchio."""
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    return [data.oMf[arm.model.getFrameId(name)].copy() for name in arm.control_points]


def points(arm: pp.Arm, q: Array) -> Array:
    return np.array([each.translation for each in placements(arm, q)])


def rotations(arm: pp.Arm, q: Array) -> Array:
    mounting = pin.rpy.rpyToMatrix(*MOUNTING)
    return np.array([each.rotation @ mounting for each in placements(arm, q)])


def bends(arm: pp.Arm, q: Array) -> Array:
    turns = [np.eye(3), *(each.rotation for each in placements(arm, q))]
    pairs = zip(turns[:-1], turns[1:], arm.chain.module_lengths, strict=True)
    return np.array([pin.log3(start.T @ end) / length for start, end, length in pairs])


Sense = Callable[[pp.ShapeEstimator, Array], object]
Miss = Callable[[pp.Arm, Array, Array], Array]

SENSORS: dict[str, tuple[Sense, Miss]] = {
    "encoders": (
        lambda to, q: to.add_encoders(q, NOISE),
        lambda arm, q, true: q - true,
    ),
    "points": (
        lambda to, q: to.add_points(points(to.arm, q)[1:], NOISE, at=range(1, to.arm.n_modules)),
        lambda arm, q, true: (points(arm, q) - points(arm, true))[1:],
    ),
    "orientations": (
        lambda to, q: to.add_orientations(rotations(to.arm, q), NOISE, mounting=MOUNTING),
        lambda arm, q, true: np.array(
            [pin.log3(x.T @ y) for x, y in zip(rotations(arm, q), rotations(arm, true), strict=True)]
        ),
    ),
    "tilts": (
        lambda to, q: to.add_tilts(7.0 * rotations(to.arm, q)[:, 2], NOISE, mounting=MOUNTING),
        lambda arm, q, true: arc_to_z(rotations(arm, q), rotations(arm, true)[:, 2]),
    ),
    "curvatures": (
        lambda to, q: to.add_curvatures(bends(to.arm, q), NOISE),
        lambda arm, q, true: bends(arm, q) - bends(arm, true),
    ),
}


def arc_to_z(turns: Array, measured: Array) -> Array:
    """Angles between the vertical and where arms would see it, along x and y."""
    seen = np.einsum("kij,kj->ki", turns, measured)
    sines = np.linalg.norm(seen[:, :2], axis=1)
    angles = np.arctan2(sines, seen[:, 2])
    return seen[:, :2] * (angles / np.maximum(sines, 1e-300))[:, None]


@pytest.mark.parametrize("kind", SENSORS)
def test_the_estimate_is_the_most_probable_configuration(kind: str) -> None:
    arm = small_arm()
    sense, missed = SENSORS[kind]
    rng = np.random.default_rng(1)
    begun = pp.arm.smooth_configuration(arm, rng, 0.4)
    true = begun + 0.5 * BEFORE * rng.standard_normal(arm.nv)
    estimator = pp.ShapeEstimator(arm, begun, deviation=BEFORE)
    used = sense(estimator, true)
    assert np.all(used)

    def residuals(q: Array) -> Array:
        return np.concatenate([(q - begun) / BEFORE, missed(arm, q, true).ravel() / NOISE])

    best = least_squares(residuals, begun, xtol=1e-14, ftol=1e-14, gtol=1e-14)
    assert np.abs(estimator.q - best.x).max() < 1e-5
    covariance = np.linalg.inv(best.jac.T @ best.jac)
    assert np.abs(estimator.covariance - covariance).max() < 0.02 * covariance.max()


def test_encoders_alone_are_a_scalar_filter() -> None:
    arm = small_arm(2)
    estimator = pp.ShapeEstimator(arm, arm.neutral(), deviation=0.1, drift=0.3)
    variance = 0.1**2
    position = 0.0
    for k in range(20):
        read = 0.2 * np.sin(0.1 * k)
        variance += 0.3**2 * 0.02
        gain = variance / (variance + 0.05**2)
        position += gain * (read - position)
        variance *= 1.0 - gain
        estimator.predict(0.02)
        estimator.add_encoders(np.full(arm.nv, read), 0.05)
        assert np.abs(estimator.q - position).max() < 1e-12
        assert np.abs(estimator.deviations - np.sqrt(variance)).max() < 1e-12


def test_readings_that_are_missing_or_outliers_are_left_out() -> None:
    arm = small_arm()
    q = pp.arm.smooth_configuration(arm, np.random.default_rng(0), 0.5)
    seen = points(arm, q)
    seen[2] = np.nan
    one = pp.ShapeEstimator(arm, q)
    other = pp.ShapeEstimator(arm, q)
    used = one.add_points(seen, 0.001)
    assert used.tolist() == [True, True, False, True]
    seen[2] = points(arm, q)[2] + (0.0, 0.2, 0.0)
    assert other.add_points(seen, 0.001).tolist() == [True, True, False, True]
    assert np.array_equal(one.q, other.q)
    assert not pp.ShapeEstimator(arm, q, deviation=0.01).add_encoders(q + 1.0, 1e-3).any()
    assert not one.add_points(np.full((4, 3), np.nan), 0.001).any()


@pytest.mark.parametrize("explained", [True, False])
def test_what_cameras_tell_of_a_sagging_arm_stays_known(explained: bool) -> None:
    heavy = heavy_arm()
    command = np.full(heavy.nv, 0.1)
    true = heavy.sag(command)
    arm = heavy if explained else pp.Arm.from_template("RyRz", modules=5, link_lengths=(0.05, 0.05))
    estimator = pp.ShapeEstimator(arm, command, give=0.002 if explained else 0.1, give_time=100.0)
    for k in range(60):
        estimator.predict(0.02)
        estimator.add_encoders(command, 1e-3, side="motor")
        if 10 <= k < 20:
            estimator.add_points(points(heavy, true), 1e-3)
        missed = np.abs(points(heavy, estimator.q) - points(heavy, true)).max()
        if k == 9:
            sag = np.abs(points(heavy, command) - points(heavy, true)).max()
            assert missed < (1e-3 if explained else np.inf)
            assert missed > (0.0 if explained else 0.9 * sag)
    assert sag > 0.02
    assert missed < 1e-3


def test_sensors_of_a_base_that_has_moved_are_read_from_there() -> None:
    heavy = heavy_arm()
    moved = pin.SE3(pin.rpy.rpyToMatrix(0.5, -0.3, 1.0), np.array([0.2, -0.1, 0.4]))
    turned = heavy.with_gravity(moved.rotation.T @ heavy.model.gravity.linear)
    command = np.full(heavy.nv, 0.1)
    true = turned.sag(command)
    there = np.array([moved.act(each) for each in points(heavy, true)])
    turns = moved.rotation @ rotations(heavy, true)
    estimator = pp.ShapeEstimator(heavy, command)
    estimator.move_base(moved)
    assert estimator.add_encoders(command, 1e-4, side="motor").all()
    assert np.abs(points(heavy, estimator.q) - points(heavy, true)).max() < 1e-3
    assert estimator.add_points(there, 1e-4).all()
    assert estimator.add_orientations(turns, 1e-3, mounting=MOUNTING).all()
    assert estimator.add_tilts(turns[:, 2], 1e-3, mounting=MOUNTING).all()
    assert estimator.add_placement(moved * placements(heavy, true)[-1], 1e-4, 1e-3).all()
    assert np.abs(estimator.q - true).max() < 1e-3


def test_readings_far_from_the_state_before_are_taken_from_the_base_on() -> None:
    arm = small_arm(12)
    q = pp.arm.smooth_configuration(arm, np.random.default_rng(0), 0.8)
    estimator = pp.ShapeEstimator(arm, arm.neutral(), deviation=0.5)
    assert estimator.add_orientations(rotations(arm, q), 0.01, mounting=MOUNTING).all()
    assert np.abs(estimator.q - q).max() < 1e-3


def test_refusals_name_what_is_wrong() -> None:
    arm = small_arm()
    estimator = pp.ShapeEstimator(arm, arm.neutral())
    with pytest.raises(UnknownName, match="side of encoders"):
        estimator.add_encoders(arm.neutral(), 0.1, side="gear")
    with pytest.raises(InvalidValue, match="names of joints"):
        estimator.add_encoders({"elbow": 0.1}, 0.1)
    with pytest.raises(InvalidValue, match=r"rotations\[1\]"):
        estimator.add_orientations([np.eye(3), 2.0 * np.eye(3)], 0.1, at=[0, 1])
    with pytest.raises(InvalidValue, match=r"points\[0, 2\]"):
        estimator.add_points([[0.0, 0.0, np.inf]], 0.1, at=[0])
    with pytest.raises(InvalidValue, match="noise"):
        estimator.add_points([[0.0, 0.0, 0.0]], 0.0, at=[0])
    with pytest.raises(InvalidValue, match=r"up\[0\]"):
        estimator.add_tilts([[0.0, 0.0, 0.0]], 0.1, at=[0])
