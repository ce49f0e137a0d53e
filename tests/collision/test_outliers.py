"""Outliers of point clouds are removed on request, counted, and only they."""

from __future__ import annotations

import pickle
from pathlib import Path

import numpy as np
import pytest

import pinposture as pp
from pinposture.collision.scan import find_outliers, suspect_distance
from pinposture.errors import FileError, InvalidValue


@pytest.mark.parametrize("seed", range(3))
def test_the_criterion_is_that_of_all_distances(seed: int) -> None:
    rng = np.random.default_rng(seed)
    points = np.vstack([rng.uniform(size=(300, 3)) * (1.0, 1.0, 0.0), rng.uniform(size=(12, 3))])
    distances = np.linalg.norm(points[:, None] - points, axis=2)
    for distance in (0.05, 0.1, 0.2):
        expected = (distances <= distance).sum(axis=1) < 9  # itself and eight others
        np.testing.assert_array_equal(find_outliers(points, distance), expected)
        np.testing.assert_array_equal(
            find_outliers(np.vstack([points, points[:20]]), distance)[:312], expected
        )


def test_the_suspect_distance_spares_surfaces_and_wires_and_not_flying_pixels() -> None:
    rng = np.random.default_rng(4)
    wall = rng.uniform(size=(20_000, 3)) * (1.0, 1.0, 0.0)
    wire = np.stack([np.linspace(0.0, 1.0, 300), np.full(300, 0.5), np.full(300, 0.3)], axis=1)
    flying = rng.uniform((0.0, 0.0, 0.5), (1.0, 1.0, 1.0), size=(20, 3))
    points = np.vstack([wall, wire, flying])
    found = find_outliers(points, suspect_distance(points))
    assert not found[:-20].any()
    assert found[-20:].all()


def test_few_points_have_no_suspect_distance() -> None:
    for count in (1, 2, 8):
        assert suspect_distance(np.arange(3.0 * count).reshape(count, 3)) == 0.0
    assert suspect_distance(np.zeros((50, 3))) == 0.0


@pytest.fixture
def scanned(tmp_path: Path) -> tuple[Path, np.ndarray]:
    """A file of a wall in front of the arm with points that fly before it."""
    rng = np.random.default_rng(5)
    wall = np.stack([np.full(20_000, 0.5), *rng.uniform(-0.4, 0.4, size=(2, 20_000))], axis=1)
    flying = rng.uniform((0.3, -0.1, -0.1), (0.4, 0.1, 0.1), size=(20, 3))
    points = np.vstack([wall, [[np.nan] * 3], flying])
    np.save(tmp_path / "wall.npy", points)
    return tmp_path / "wall.npy", points


def clearance(scan: pp.Scan) -> float:
    arm = pp.Arm.from_template("RyRz", 5)  # 0.25 m long
    return float(
        pp.CollisionModel(arm, pp.Scene({"wall": scan}, self_collision=False, arm_radius=0.01))
        .minimum(arm.straight())
        .distance
    )


def test_they_cost_no_clearance_once_they_are_removed(scanned: tuple[Path, np.ndarray]) -> None:
    file, points = scanned
    wall = pp.Scan(points[:20_000])
    assert clearance(pp.Scan.load(file)) < clearance(wall) - 0.05
    scan = pp.Scan.load(file, outlier_distance=0.03)
    assert (scan.outliers, scan.dropped, len(scan.points)) == (20, 1, 20_000)
    assert "20 outliers removed" in repr(scan)
    assert clearance(scan) == pytest.approx(clearance(wall))
    assert pp.Scan(points[:20_000]).without_outliers(0.03) == wall
    again = pickle.loads(pickle.dumps(scan.placed((0.1, 0.0, 0.0))))
    assert (again.outliers, again.outlier_distance) == (20, 0.03)


@pytest.mark.long
def test_a_scene_keeps_the_request(scanned: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    file, _ = scanned
    (tmp_path / "scene.toml").write_text(
        f'[obstacles]\nwall = {{ type = "scan", path = "{file.name}", outlier_distance = 0.03 }}\n'
    )
    scene = pp.Scene.load(tmp_path / "scene.toml")
    assert scene.obstacles["wall"].outliers == 20
    again = pp.Scene.load(scene.save(tmp_path / "again.json"))
    assert again == scene
    assert again.obstacles["wall"].outliers == 20
    embedded = pp.Scene.from_dict(scene.to_dict())
    assert embedded == scene
    twice = scene.obstacles["wall"].without_outliers(0.02)  # the file does not give these
    assert (twice.path, twice.outlier_distance) == (None, None)
    assert pp.Scan.load(file).without_outliers(0.03).outlier_distance == 0.03
    assert scene.obstacles["wall"].thinned(100).outlier_distance is None


def test_what_does_not_fit_is_refused(scanned: tuple[Path, np.ndarray], tmp_path: Path) -> None:
    file, points = scanned
    for distance in (0.0, -3.0, np.nan, np.inf, "3", True):
        with pytest.raises(InvalidValue, match="outlier_distance"):
            pp.Scan.load(file, outlier_distance=distance)
    with pytest.raises(InvalidValue, match="without_outliers"):
        pp.Scan(points, outlier_distance=0.03)
    with pytest.raises(InvalidValue, match="no point has eight others"):
        pp.Scan(points).without_outliers(1e-6)
    surface = pp.Scan(np.eye(3), [[0, 1, 2]])
    with pytest.raises(InvalidValue, match="surface"):
        surface.without_outliers(0.03)
    np.savez(tmp_path / "surface.npz", points=np.eye(3), faces=[[0, 1, 2]])
    with pytest.raises(FileError, match="surface"):
        pp.Scan.load(tmp_path / "surface.npz", outlier_distance=0.03)
