"""Scene files in TOML and JSON, and everything that can be wrong with one."""

from __future__ import annotations

import json

import numpy as np
import pytest

from pinposture.collision import Box, HalfSpace, Mesh, Scan, Scene, Sphere
from pinposture.errors import FileError, PostureWarning

TOML = """
version = 1
margin = 0.01
self_collision = true
arm_radius = 0.012

[obstacles.post]
type = "cylinder"
start = [0.3, 0.2, -1]
end = [0.3, 0.2, 1.0]
radius = 0.05

[obstacles."a wall"]
type = "half_space"
point = [0, 0.5, 0]
normal = [0, -1, 0]

[obstacles.part]
type = "mesh"
path = "parts/part.stl"
scale = 0.001
center = [1, 2, 3]
rotation = [0, 0, 1.5]

[obstacles.machine]
type = "scan"
path = "parts/cloud.xyz"
scale = 0.01
center = [0, 0, 1]
point_radius = 0.002
"""


@pytest.fixture
def folder(tmp_path):
    import trimesh

    (tmp_path / "parts").mkdir()
    trimesh.creation.box((100, 200, 300)).export(tmp_path / "parts" / "part.stl")
    np.savetxt(tmp_path / "parts" / "cloud.xyz", np.arange(12).reshape(4, 3))
    return tmp_path


def test_a_toml_file_and_the_json_file_of_the_same_scene(folder, monkeypatch):
    (folder / "scene.toml").write_text(TOML)
    monkeypatch.chdir("/")
    scene = Scene.load(folder / "scene.toml")
    assert (scene.margin, scene.self_collision, scene.arm_radius) == (0.01, True, 0.012)
    assert list(scene.obstacles) == ["post", "a wall", "part", "machine"]
    assert scene.obstacles["a wall"] == HalfSpace((0, 0.5, 0), (0, -1, 0))
    part = scene.obstacles["part"]
    np.testing.assert_allclose(np.ptp(part.vertices, axis=0), (0.1, 0.2, 0.3), rtol=1e-6)
    points = np.arange(12).reshape(4, 3) / 100
    assert scene.obstacles["machine"] == Scan(points, center=(0, 0, 1), point_radius=0.002)
    saved = scene.save(folder / "new" / "scene.json")
    said = json.loads(saved.read_text())["obstacles"]
    assert said["part"]["path"] == "../parts/part.stl" and said["machine"]["path"] == "../parts/cloud.xyz"
    assert "points" in scene.to_dict()["obstacles"]["machine"]  # what is kept elsewhere needs no file
    assert Scene.from_dict(json.loads(json.dumps(scene.to_dict()))) == scene
    assert Scene.load(saved) == scene == Scene.load(str(saved))
    assert [path.name for path in saved.parent.iterdir()] == ["scene.json"]


def test_everything_may_be_left_out(tmp_path):
    (tmp_path / "empty.toml").write_text("")
    (tmp_path / "empty.json").write_text("\ufeff{}", encoding="utf-8")
    for name in ("empty.toml", "empty.json"):
        with pytest.warns(PostureWarning, match=f"{name} contains no obstacles"):
            assert Scene.load(tmp_path / name) == Scene()


def test_a_scene_without_stand_in_radius_survives_too(tmp_path):
    scene = Scene({"b": Box((0, 0, 1), (1, 1, 1), (0.1, 0.2, 0.3)), "s": Sphere((0.1, 0.2, 0.3), 0.4)})
    assert Scene.load(scene.save(tmp_path / "s.json")) == scene


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("version = 1\nmargin = x\n", "line 2"),
        (
            "marjin = 0.1",
            "line 1: marjin: there is no such key (did you mean 'margin'?); allowed",
        ),
        (
            "margin = 'wide'",
            "line 1: margin: is 'wide'; allowed: a number in SI units",
        ),
        ("margin = -1", "line 1: margin: is -1; allowed: a length of 0 to 10000 m"),
        ("margin = nan", "line 1: margin: is nan"),
        ("version = 2", "line 1: version: is 2; allowed: 1"),
        ("version = true", "line 1: version: is True"),
        ("self_collision = 1", "line 1: self_collision: is 1; allowed: true or false"),
        ("obstacles = 3", "line 1: obstacles: is 3; allowed: a table or mapping from names of obstacles"),
        (
            "[[obstacles]]\ntype = 'sphere'",
            "obstacles: is [{'type': 'sphere'}]; allowed: a table",
        ),
        ("obstacles.post = 3", "line 1: obstacles.post: is 3; allowed: a table with a 'type'"),
        (
            "[obstacles.post]\nradius = 1",
            "line 1: obstacles.post: the key 'type' is missing; allowed",
        ),
        ("[obstacles.post]\ntype = 'spere'", "line 2: obstacles.post.type: is 'spere'"),
        ("[obstacles.post]\ntype = 'spere'", "did you mean 'sphere'"),
        (
            "[obstacles.post]\ntype = 'sphere'\ncenter = [0, 0, 0]\nradius = -1",
            "line 4: obstacles.post.radius: is -1; allowed: a length of 1e-09",
        ),
        (
            "[obstacles.post]\ntype = 'sphere'\ncenter = [0, 0, 0]\nradus = 1",
            "line 4: obstacles.post.radus: there is no such key (did you mean 'radius'?)",
        ),
        ("[obstacles.m]\ntype = 'mesh'\npath = 'no.stl'", "line 3: obstacles.m.path: "),
        ("[obstacles.m]\ntype = 'scan'\npath = 'no.ply'", "no.ply: no such file"),
        ("[obstacles.m]\ntype = 'scan'\npath = 'a.toml'", "the name ends in '.toml'; allowed: .ply"),
        ("[obstacles.m]\ntype = 'mesh'\npath = 'a.toml'", "the name ends in '.toml'; allowed: .stl"),
        ("[obstacles.m]\ntype = 'mesh'\npath = 'bad.stl'", "bad.stl: "),
    ],
)
def test_what_is_wrong_with_a_file_is_said_in_one_line(tmp_path, text, words):
    path = tmp_path / "a.toml"
    path.write_text(text)
    (tmp_path / "bad.stl").write_text("solid nothing")
    with pytest.raises(FileError) as caught:
        Scene.load(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("name", "content", "words"),
    [
        ("a.json", b"{", "line 1, column 2"),
        ("a.json", b"[]", "contains no table"),
        ("a.json", b'{"margin": NaN}', "margin: is nan"),
        ("a.json", b"[" * 100_000, "nested too deep"),
        ("a.json", b"\xff\xfe", "is not UTF-8 text (byte 0)"),
        ("a.toml", b"a\x00", "line 1"),
        ("a.yaml", b"", "the name ends in '.yaml'; allowed: .toml, .json"),
    ],
)
def test_files_that_hold_no_scene(tmp_path, name, content, words):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(FileError) as caught:
        Scene.load(tmp_path / name)
    assert words in str(caught.value)


def test_a_file_without_obstacles_is_reported(tmp_path, recwarn):
    empty = tmp_path / "empty.toml"
    itself = tmp_path / "itself.toml"
    empty.write_text("margin = 0.01\n")
    for value in (True, False):
        itself.write_text(f"self_collision = {str(value).lower()}\n")
        assert Scene.load(itself) == Scene(self_collision=value)
    assert not recwarn.list
    with pytest.warns(PostureWarning, match=r"empty\.toml contains no obstacles"):
        assert Scene.load(empty) == Scene(margin=0.01)


def test_files_that_are_missing_or_folders(tmp_path):
    with pytest.raises(FileError, match="no such file"):
        Scene.load(tmp_path / "no.toml")
    (tmp_path / "folder.toml").mkdir()
    with pytest.raises(FileError, match="cannot be read"):
        Scene.load(tmp_path / "folder.toml")


def test_a_scene_is_saved_as_json_alone_and_whole_or_not_at_all(tmp_path):
    with pytest.raises(FileError, match=r"allowed: \.json"):
        Scene().save(tmp_path / "scene.toml")
    path = Scene().save(tmp_path / "scene.json")
    before = path.read_bytes()
    (tmp_path / "file").write_text("")
    with pytest.raises(FileError):
        Scene().save(tmp_path / "file" / "scene.json")
    assert path.read_bytes() == before and json.loads(before)["version"] == 1


def test_meshes_are_read_in_every_format(tmp_path):
    import trimesh

    box = trimesh.creation.box((1, 2, 3))
    for suffix in ("stl", "obj", "ply"):
        box.export(tmp_path / f"box.{suffix}")
        mesh = Mesh.load(tmp_path / f"box.{suffix}", 0.1, (0, 0, 1))
        np.testing.assert_allclose(np.ptp(mesh.vertices, axis=0), (0.1, 0.2, 0.3), rtol=1e-6)
        assert len(mesh.vertices) == 8
