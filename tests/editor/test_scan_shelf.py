"""Scans and meshes that are brought into a task: read, kept beside it, or refused with nothing changed."""

from __future__ import annotations

import time
from pathlib import Path

import numpy as np
import pytest
from editor.edited_tasks import task

import pinposture as pp
from pinposture.editor.session import Session
from pinposture.editor.surroundings import ScanShelf, remove_scan


class Desk:
    """A session, and a shelf whose requests are done in turn, as the editor's loop would."""

    def __init__(self, path: Path | None) -> None:
        self.session = Session(task(), path)
        self._inbox: list = []
        self.shelf = ScanShelf(lambda request, key="": self._inbox.append(request))

    def until(self, holds, seconds: float = 30.0) -> bool:
        """Do requests until something holds."""
        end = time.monotonic() + seconds
        while time.monotonic() < end:
            while self._inbox:
                self._inbox.pop(0)(self.session)
            if holds():
                return True
            time.sleep(0.01)
        return False

    def said(self, text: str) -> bool:
        """Whether something is said in the end."""
        return self.until(lambda: text in self.session.notice.text)


@pytest.fixture
def desk(tmp_path):
    (tmp_path / "task").mkdir()
    made = Desk(tmp_path / "task" / "walk.toml")
    yield made
    made.shelf.close()


@pytest.fixture
def points() -> np.ndarray:
    return np.random.default_rng(1).uniform(0.5, 2.0, (300, 3))


@pytest.fixture
def cloud(tmp_path, points) -> Path:
    path = tmp_path / "room.xyz"
    np.savetxt(path, points)
    return path


def test_a_scan_that_can_be_read_is_added_in_one_step(desk, cloud, points):
    before = desk.session.task
    desk.shelf.add_scan(cloud)
    assert desk.until(lambda: desk.session.task.scans == (cloud,))
    np.testing.assert_allclose(desk.shelf.of(desk.session.task)[cloud].points, points)
    desk.session.undo()
    assert desk.session.task is before
    assert desk.shelf.of(desk.session.task) == {}


def test_the_same_scan_is_not_added_twice(desk, cloud):
    desk.shelf.add_scan(cloud)
    assert desk.until(lambda: desk.session.task.scans == (cloud,))
    desk.shelf.add_scan(cloud)
    assert desk.said("already been added")
    assert desk.session.task.scans == (cloud,)


@pytest.mark.parametrize("content", [b"", b"not a number in it\n", None])
def test_what_cannot_be_read_is_told_and_changes_nothing(desk, tmp_path, content):
    path = tmp_path / "broken.xyz"
    if content is not None:
        path.write_bytes(content)
    before = desk.session.task
    desk.shelf.add_scan(path)
    assert desk.said("broken.xyz")
    assert desk.session.notice.kind == "error"
    assert desk.session.task is before


def test_what_is_sent_is_kept_beside_the_task(desk, cloud):
    folder = desk.session.path.parent
    desk.shelf.upload("../../room.xyz", cloud.read_bytes(), folder, 1.0, avoided=False)
    kept = folder / "room.xyz"
    assert desk.until(lambda: desk.session.task.scans == (kept,))
    assert kept.read_bytes() == cloud.read_bytes()


def test_what_is_sent_replaces_no_other_file(desk, cloud):
    folder = desk.session.path.parent
    (folder / "room.xyz").write_text("something of mine")
    for _ in range(2):  # the second time it is there already, under the other name
        desk.shelf.upload("room.xyz", cloud.read_bytes(), folder, 1.0, avoided=False)
    assert desk.said("already been added")
    assert (folder / "room.xyz").read_text() == "something of mine"
    assert desk.session.task.scans == (folder / "room_2.xyz",)
    assert sorted(path.name for path in folder.iterdir()) == ["room.xyz", "room_2.xyz"]


def test_what_is_sent_is_not_written_through_a_link(desk, cloud, tmp_path):
    folder = desk.session.path.parent
    prey = tmp_path / "prey.xyz"
    (folder / "room.xyz").symlink_to(prey)
    desk.shelf.upload("room.xyz", cloud.read_bytes(), folder, 1.0, avoided=False)
    assert desk.until(lambda: desk.session.task.scans == (folder / "room_2.xyz",))
    assert not prey.exists()


def test_broken_things_that_are_sent_leave_no_file(desk):
    folder = desk.session.path.parent
    desk.shelf.upload("room.ply", b"ply of nothing", folder, 1.0, avoided=False)
    assert desk.said("room.ply")
    assert desk.session.notice.kind == "error"
    assert list(folder.iterdir()) == []
    assert desk.session.task.scans == ()


def test_without_a_task_file_there_is_nowhere_to_keep_them(cloud):
    desk = Desk(None)
    desk.shelf.upload("room.xyz", cloud.read_bytes(), None, 1.0, avoided=False)
    assert desk.said("save the task first")
    assert desk.session.task.scans == ()
    desk.shelf.close()


def test_a_mesh_becomes_an_obstacle(desk, tmp_path):
    import trimesh

    path = tmp_path / "part.stl"
    trimesh.creation.box((100.0, 200.0, 300.0)).apply_translation((900.0, 900.0, 900.0)).export(path)
    desk.shelf.add_obstacle(path, 0.001)
    assert desk.until(lambda: desk.session.task.scene is not None)
    mesh = desk.session.task.scene.obstacles["part"]
    assert isinstance(mesh, pp.Mesh)
    np.testing.assert_allclose(np.ptp(np.array(mesh.vertices), axis=0), (0.1, 0.2, 0.3), atol=1e-6)
    assert desk.session.obstacle == "part"
    desk.shelf.upload("part.stl", path.read_bytes(), None, 0.001, avoided=True)
    assert desk.said("save the task first")
    desk.shelf.upload("part.stl", path.read_bytes(), tmp_path / "task", 0.001, avoided=True)
    assert desk.until(lambda: len(desk.session.task.scene.obstacles) == 2)
    assert desk.session.task.scene.obstacles["part_1"].path == tmp_path / "task" / "part.stl"


def test_a_cloud_of_points_becomes_an_obstacle_as_it_is(desk, cloud):
    desk.shelf.add_obstacle(cloud, 1.0)
    assert desk.until(lambda: desk.session.task.scene is not None)
    (scan,) = desk.session.task.scene.obstacles.values()
    assert scan == pp.Scan.load(cloud) and scan.path == cloud


def test_a_mesh_around_the_base_is_refused(desk, tmp_path):
    import trimesh

    path = tmp_path / "room.stl"
    trimesh.creation.box((3.0, 3.0, 3.0)).export(path)
    before = desk.session.task
    desk.shelf.add_obstacle(path, 1.0)
    assert desk.said("base of the arm")
    assert desk.session.task is before


def test_scans_of_a_task_that_is_opened_are_read_and_missing_ones_told_once(desk, cloud, tmp_path):
    missing = tmp_path / "gone.ply"
    desk.session.edit(lambda task: task.edited(scans=(cloud, missing)), "opened")
    assert desk.until(lambda: list(desk.shelf.of(desk.session.task)) == [cloud])
    assert desk.said("gone.ply")
    told = desk.session.notice.number
    for _ in range(5):
        desk.shelf.of(desk.session.task)
    assert not desk.until(lambda: desk.session.notice.number > told, seconds=0.3)


def test_removing_a_scan_leaves_its_file(desk, cloud):
    desk.shelf.add_scan(cloud)
    assert desk.until(lambda: desk.session.task.scans == (cloud,))
    remove_scan(cloud, desk.session)
    assert desk.session.task.scans == ()
    assert cloud.exists()
    desk.session.undo()
    assert desk.session.task.scans == (cloud,)


def test_large_scans_are_thinned_for_the_eye(desk, points, tmp_path, monkeypatch):
    monkeypatch.setattr("pinposture.editor.surroundings.MAX_SHOWN", 100)
    path = tmp_path / "large.npy"
    np.save(path, points)
    desk.shelf.add_scan(path)
    assert desk.until(lambda: desk.session.task.scans == (path,))
    assert len(desk.shelf.of(desk.session.task)[path].points) == 300
    assert 0 < len(desk.shelf.shown(path).points) <= 100
