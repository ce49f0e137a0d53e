"""The depth camera at the tip: rays against planes and spheres in closed form, and what it does not see."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp

pytest.importorskip("mujoco")
from pinposture.arm import smooth_configuration
from pinposture.errors import PostureError
from pinposture.sim.camera import DepthCamera, TipCamera


@pytest.fixture(scope="module")
def arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=4)


def in_world(arm: pp.Arm, q: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The points of the tip link in the world frame, and where the camera is."""
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, q)
    placement = data.oMf[arm.model.getFrameId(arm.tip)]
    return points @ placement.rotation.T + placement.translation, np.array(placement.translation)


def test_rays_pass_the_middles_of_square_pixels(arm: pp.Arm) -> None:
    camera = DepthCamera(width=4, height=2, field_of_view=np.pi / 2)
    rays = camera.rays().reshape(2, 4, 3)
    np.testing.assert_allclose(np.linalg.norm(rays, axis=2), 1.0)
    on_plane = rays / rays[..., 2:]
    # half the width of the image is as far as the focal length, for 90 degrees
    np.testing.assert_allclose(on_plane[0, :, 0], [-0.75, -0.25, 0.25, 0.75])
    np.testing.assert_allclose(on_plane[:, 0, 1], [-0.25, 0.25])


@pytest.mark.parametrize("seed", range(3))
def test_points_lie_on_the_walls_of_a_room(arm: pp.Arm, seed: int) -> None:
    q = smooth_configuration(arm, np.random.default_rng(seed), 0.5)
    sides = np.vstack([np.eye(3), -np.eye(3)])
    scene = pp.Scene({f"wall {k}": pp.HalfSpace(tuple(-side), tuple(side)) for k, side in enumerate(sides)})
    seen = TipCamera(arm, scene, DepthCamera(reach=5.0)).look(q)
    points, eye = in_world(arm, q, seen)
    off_walls = np.abs(np.abs(points).max(axis=1) - 1.0)
    on_arm = off_walls > 1e-6
    np.testing.assert_array_less(np.linalg.norm(points[on_arm] - eye, axis=1), 0.3)  # it may see itself
    assert (~on_arm).sum() > 1000


def test_a_sphere_is_seen_from_its_near_side(arm: pp.Arm) -> None:
    q = arm.straight()
    tip = arm.at(q).points[-1]
    ahead = (tip - arm.at(q).points[-2]) / np.linalg.norm(tip - arm.at(q).points[-2])
    center = tip + 0.4 * ahead
    camera = DepthCamera(width=41, height=31)
    seen = TipCamera(arm, pp.Scene({"ball": pp.Sphere(tuple(center), 0.1)}), camera).look(q)
    points, eye = in_world(arm, q, seen)
    np.testing.assert_allclose(np.linalg.norm(points - center, axis=1), 0.1, atol=1e-6)
    # A tangent from outside is as long as the theorem of Pythagoras says; nothing behind it is seen.
    assert np.linalg.norm(points - eye, axis=1).max() <= np.sqrt(0.4**2 - 0.1**2)
    np.testing.assert_allclose(np.linalg.norm(points - eye, axis=1).min(), 0.3, atol=1e-6)
    rays = camera.rays()
    hits = rays[:, 2] >= np.cos(np.arcsin(0.1 / 0.4))
    assert len(points) == hits.sum()


def test_an_open_mesh_is_seen_through_its_hole(arm: pp.Arm) -> None:
    """A square frame: its middle is open, although a convex hull would close it."""
    q = arm.straight()
    x = float(arm.at(q).points[-1, 0]) + 0.2
    inner = [(x, -0.05, -0.05), (x, 0.05, -0.05), (x, 0.05, 0.05), (x, -0.05, 0.05)]
    outer = [(x, 4 * y, 4 * z) for _, y, z in inner]
    faces = [(k, 4 + k, 4 + (k + 1) % 4) for k in range(4)] + [
        (k, 4 + (k + 1) % 4, (k + 1) % 4) for k in range(4)
    ]
    frame = pp.Scan(np.array(inner + outer), np.array(faces))
    points, _ = in_world(arm, q, TipCamera(arm, pp.Scene({"frame": frame}), DepthCamera()).look(q))
    np.testing.assert_allclose(points[:, 0], x, atol=1e-6)
    assert np.abs(points[:, 1:]).max(axis=1).min() >= 0.05 - 1e-6
    assert np.abs(points[:, 1:]).max(axis=1).max() > 0.1


def test_nothing_is_seen_beyond_reach_and_clouds_have_no_surface(arm: pp.Arm) -> None:
    q = arm.straight()
    wall = pp.HalfSpace((2.0, 0.0, 0.0), (-1.0, 0.0, 0.0))
    assert len(TipCamera(arm, pp.Scene({"wall": wall}), DepthCamera(reach=1.0)).look(q)) == 0
    cloud = pp.Scan(np.array([[0.5, 0.0, 0.0], [0.5, 0.1, 0.0]]), point_radius=0.1)
    assert len(TipCamera(arm, pp.Scene({"cloud": cloud}), DepthCamera()).look(q)) == 0


def test_noise_is_along_the_rays_and_as_large_as_asked(arm: pp.Arm) -> None:
    q = arm.straight()
    scene = pp.Scene({"wall": pp.HalfSpace((1.0, 0.0, 0.0), (-1.0, 0.0, 0.0))})
    clean, noisy = (TipCamera(arm, scene, DepthCamera(noise=noise)).look(q) for noise in (0.0, 0.01))
    lengths, far = (np.linalg.norm(each, axis=1) for each in (clean, noisy))
    np.testing.assert_allclose(noisy / far[:, None], clean / lengths[:, None], atol=1e-9)
    assert np.std(far - lengths) == pytest.approx(0.01, rel=0.05)  # of 3072 rays


@pytest.mark.parametrize("given", [{"width": 0}, {"field_of_view": 3.2}, {"reach": 0.0}, {"noise": -1.0}])
def test_a_camera_that_cannot_be_is_refused(given: dict[str, float]) -> None:
    with pytest.raises(PostureError, match=next(iter(given))):
        DepthCamera(**given)
