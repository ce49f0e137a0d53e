"""Triangle meshes: closed, the right way out, of the right size."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from pinposture.viz.body import FINENESS, TriangleMesh, ball, disc, merge, tube


def volume(mesh: TriangleMesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return float(np.einsum("ij,ij->i", a, np.cross(b, c)).sum() / 6.0)


def normals(mesh: TriangleMesh) -> tuple[np.ndarray, np.ndarray]:
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    return np.cross(b - a, c - a), (a + b + c) / 3.0


def test_a_ball_is_closed_and_faces_outwards():
    mesh = ball(np.array([1.0, -2.0, 3.0]), 0.5)
    np.testing.assert_allclose(np.linalg.norm(mesh.vertices - [1.0, -2.0, 3.0], axis=1), 0.5)
    edges = Counter((int(f[i]), int(f[(i + 1) % 3])) for f in mesh.faces for i in range(3))
    assert set(edges.values()) == {1}
    assert all((b, a) in edges for a, b in edges)
    assert len(mesh.vertices) - len(edges) / 2 + len(mesh.faces) == 2  # Euler: no holes, no handles
    assert 0.9 < volume(mesh) / (4.0 / 3.0 * np.pi * 0.5**3) < 1.0


def test_a_plate_holds_the_volume_of_a_prism():
    axis = np.array([2.0, -1.0, 2.0]) / 3.0
    mesh = disc(np.array([5.0, 0.0, 1.0]), axis, 0.4, 0.1)
    polygon = FINENESS.sides / 2.0 * 0.4**2 * np.sin(2.0 * np.pi / FINENESS.sides)
    assert volume(mesh) == pytest.approx(polygon * 0.1)
    np.testing.assert_allclose(np.abs((mesh.vertices - [5.0, 0.0, 1.0]) @ axis), 0.05)


def helix() -> np.ndarray:
    t = np.linspace(0.0, 12.0, 200)
    return np.stack([0.3 * t, np.cos(t), np.sin(t)], 1)


PATHS = {
    "straight": np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 0.0, 3.0]]),
    "helix": helix(),
    "corner": np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [1.0, 1.0, 0.0], [1.0, 1.0, 1.0]]),
    "there and back": np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.2, 0.0, 0.0]]),
}


@pytest.mark.parametrize("name", PATHS)
def test_a_bar_keeps_its_radius_along_its_path(name):
    path = PATHS[name]
    rings = tube(path, 0.05).vertices.reshape(len(path), FINENESS.sides, 3)
    np.testing.assert_allclose(np.linalg.norm(rings - path[:, None], axis=2), 0.05, rtol=1e-9)
    np.testing.assert_allclose(rings.mean(axis=1), path, atol=1e-12)


@pytest.mark.parametrize("name", ["straight", "helix", "corner"])
def test_a_bar_faces_outwards_and_does_not_twist(name):
    path = PATHS[name]
    mesh = tube(path, 0.05)
    across, middle = normals(mesh)
    ring = mesh.faces.min(axis=1) // FINENESS.sides
    legs = np.diff(path, axis=0)[ring]
    outwards = middle - path[ring]
    outwards -= legs * (np.einsum("ij,ij->i", outwards, legs) / np.einsum("ij,ij->i", legs, legs))[:, None]
    assert np.all(np.einsum("ij,ij->i", across, outwards) > 0.0)
    # A twisted bar has corners that run across it instead of along it.
    rings = mesh.vertices.reshape(len(path), FINENESS.sides, 3)
    lengths = np.linalg.norm(np.diff(rings, axis=0), axis=2)
    assert np.all(np.abs(lengths - np.linalg.norm(np.diff(path, axis=0), axis=1)[:, None]) <= 0.1001)


def test_merging_changes_no_surface():
    parts = [ball(np.zeros(3), 1.0), tube(PATHS["straight"], 0.1), ball(np.ones(3), 0.2)]
    whole = merge(parts)
    assert len(whole.faces) == sum(len(part.faces) for part in parts)
    corners = np.vstack([part.vertices[part.faces].reshape(-1, 9) for part in parts])
    np.testing.assert_array_equal(whole.vertices[whole.faces].reshape(-1, 9), corners)
