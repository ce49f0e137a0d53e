"""Visual meshes of a description: found, read, placed on their bodies, and doing without."""

from __future__ import annotations

import base64
import json
import re
import struct
import warnings

import numpy as np
import pinocchio as pin
import pytest
import trimesh
import umsgpack
from sampling import seeds
from scipy.spatial import cKDTree

from pinposture import Arm, Target, save_html, track
from pinposture.collision.files import find_mesh, read_mesh
from pinposture.errors import FileError, PostureWarning
from pinposture.viz.body import body_meshes, body_poses

CORNERS = np.array([[0.0, 0.0, 0.0], [3.0, 0.0, 0.0], [0.0, 2.0, 0.0], [0.0, 0.0, 1.0]])
FACES = np.array([[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3]])  # counter-clockwise from outside
TILTED = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.8, 1.9), np.array([0.2, -0.1, 0.4]))

FOOT = '<visual><geometry><mesh filename="package://robot/meshes/wedge.stl"/></geometry></visual>'
UPPER = (
    '<visual><origin xyz="0.1 -0.2 0.3" rpy="0.4 -0.5 0.6"/><geometry>'
    '<mesh filename="package://robot/meshes/wedge.stl" scale="0.01 0.02 0.03"/></geometry></visual>'
)
TOOL = '<visual><geometry><mesh filename="../meshes/wedge.obj" scale="-0.1 0.1 0.1"/></geometry></visual>'
PLAIN = '<visual><geometry><sphere radius="0.02"/></geometry></visual>'


def urdf(foot: str = FOOT, upper: str = UPPER, lower: str = PLAIN, tool: str = TOOL) -> str:
    """Two joints; the foot is fixed to the world, the tool to the last link; frames are turned about."""
    limit = '<limit lower="-2" upper="2" velocity="1" effort="1"/>'
    return f"""<robot name="two"><link name="world"/><link name="foot">{foot}</link>
    <link name="upper">{upper}</link><link name="lower">{lower}</link><link name="tool">{tool}</link>
    <joint name="fix" type="fixed"><parent link="world"/><child link="foot"/>
      <origin xyz="0.01 0.02 0.03" rpy="0.2 0 0.1"/></joint>
    <joint name="a" type="revolute"><parent link="foot"/><child link="upper"/><axis xyz="0 1 0"/>
      <origin xyz="0 0.1 0.2" rpy="0.3 0.4 -0.2"/>{limit}</joint>
    <joint name="b" type="revolute"><parent link="upper"/><child link="lower"/><axis xyz="0 0 1"/>
      <origin xyz="0.5 0 0.1" rpy="-0.7 0.1 0.2"/>{limit}</joint>
    <joint name="hold" type="fixed"><parent link="lower"/><child link="tool"/>
      <origin xyz="0.4 0.1 0" rpy="0 1.1 0"/></joint></robot>"""


def binary_stl(corners: np.ndarray, faces: np.ndarray) -> bytes:
    triangles = [struct.pack("<12fH", 0, 0, 0, *corners[face].ravel(), 0) for face in faces]
    return bytes(80) + struct.pack("<I", len(faces)) + b"".join(triangles)


@pytest.fixture
def robot(tmp_path):
    """A package called "robot" with meshes; a description in its folder `urdf` is returned."""
    (tmp_path / "robot/meshes").mkdir(parents=True)
    (tmp_path / "robot/urdf").mkdir()
    (tmp_path / "robot/meshes/wedge.stl").write_bytes(binary_stl(CORNERS, FACES))
    lines = [f"v {x} {y} {z}" for x, y, z in CORNERS] + [f"f {a} {b} {c}" for a, b, c in FACES + 1]
    (tmp_path / "robot/meshes/wedge.obj").write_text("\n".join(lines))

    def load(text: str = "", **options) -> Arm:
        path = tmp_path / "robot/urdf/two.urdf"
        path.write_text(text or urdf())
        return Arm.load(path, tip="tool", split=1, base_placement=TILTED, **options)

    return load


def moved(link: pin.SE3, corners: np.ndarray) -> np.ndarray:
    return corners @ link.rotation.T + link.translation


def as_set(points: np.ndarray) -> np.ndarray:
    """The distinct points in an order of their own; readers may repeat and shuffle them."""
    return np.unique(np.round(points, 7) + 0.0, axis=0)


def se3(xyz, rpy=(0.0, 0.0, 0.0)) -> pin.SE3:
    return pin.SE3(pin.rpy.rpyToMatrix(*rpy), np.array(xyz))


def turned(axis, angle) -> pin.SE3:
    return pin.SE3(pin.AngleAxis(angle, np.array(axis)).toRotationMatrix(), np.zeros(3))


@pytest.mark.parametrize("seed", seeds(5))
def test_meshes_are_where_the_description_puts_them(robot, seed):
    arm = robot()
    q = arm.random(np.random.default_rng(seed))
    foot = TILTED * se3([0.01, 0.02, 0.03], [0.2, 0, 0.1])
    upper = foot * se3([0, 0.1, 0.2], [0.3, 0.4, -0.2]) * turned([0.0, 1.0, 0.0], q[0])
    lower = upper * se3([0.5, 0, 0.1], [-0.7, 0.1, 0.2]) * turned([0.0, 0.0, 1.0], q[1])
    tool = lower * se3([0.4, 0.1, 0], [0, 1.1, 0])
    expected = [
        moved(upper * se3([0.1, -0.2, 0.3], [0.4, -0.5, 0.6]), CORNERS * [0.01, 0.02, 0.03]),
        moved(tool, CORNERS * [-0.1, 0.1, 0.1]),
    ]
    meshes = body_meshes(arm)
    np.testing.assert_allclose(as_set(meshes.base.vertices), as_set(moved(foot, CORNERS)), atol=2e-7)
    for mesh, pose, there in zip(meshes.bodies, body_poses(arm, q), expected, strict=True):
        world = mesh.vertices @ pose[:3, :3].T + pose[:3, 3]
        np.testing.assert_allclose(as_set(world), as_set(there), atol=2e-7)


def test_triangles_face_outward_even_if_the_scale_mirrors(robot):
    for mesh in body_meshes(robot()).bodies:
        a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
        assert np.einsum("ij,ij->i", a, np.cross(b, c)).sum() > 0.0  # six times the volume


def test_meshes_of_links_on_one_body_are_one_surface(robot):
    arm = robot(urdf(lower=UPPER + UPPER))
    assert [len(mesh.faces) for mesh in body_meshes(arm).bodies] == [4, 12]


def test_a_missing_mesh_warns_once_and_the_body_keeps_its_stand_in(robot):
    gone = TOOL.replace("wedge.obj", "gone.obj")
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # loading does not look at meshes
        arm = robot(urdf(tool=gone, upper=gone.replace("gone", "lost"), lower=gone))
    with pytest.warns(PostureWarning, match=r"lost\.obj.*gone\.obj") as caught:
        meshes = body_meshes(arm)
    assert len(caught) == 1
    assert str(caught[0].message).count("gone.obj") == 1
    assert meshes.bodies == (None, None)
    assert meshes.base is not None


@pytest.mark.parametrize(
    ("ending", "content"),
    [
        ("stl", b""),
        ("stl", binary_stl(CORNERS, FACES)[:-20]),
        ("stl", binary_stl(CORNERS * np.nan, FACES)),
        ("stl", b"solid nothing\nendsolid nothing\n"),
        ("obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 9\n"),
        ("obj", b"\x00\xff not a mesh"),
        ("dae", b"<COLLADA><broken"),
        ("blend", b"BLENDER"),
    ],
)
def test_a_corrupt_mesh_warns_once_and_the_body_keeps_its_stand_in(robot, tmp_path, ending, content):
    (tmp_path / f"robot/meshes/bad.{ending}").write_bytes(content)
    arm = robot(urdf(tool=TOOL.replace("wedge.obj", f"bad.{ending}")))
    with pytest.warns(PostureWarning, match=rf"bad\.{ending}") as caught:
        meshes = body_meshes(arm)
    assert len(caught) == 1
    assert meshes.bodies[1] is None
    assert meshes.bodies[0] is not None


@pytest.mark.parametrize(
    "wrong",
    [
        'scale="1 a 1"',
        'scale="2"',
        'scale="1 1 inf"',
        '/></geometry><origin rpy="0 0 nan"/></visual><visual><geometry><sphere radius="0"',
    ],
)
def test_numbers_that_are_none_warn_once_and_the_body_keeps_its_stand_in(robot, wrong):
    # Pinocchio complains and goes on without the shape.
    arm = robot(urdf(tool=TOOL.replace('scale="-0.1 0.1 0.1"', wrong)))
    with pytest.warns(PostureWarning, match=r"wedge\.obj .* allowed: 3 finite numbers") as caught:
        meshes = body_meshes(arm)
    assert len(caught) == 1
    assert meshes.bodies[1] is None
    assert meshes.bodies[0] is not None


def test_collada_without_its_reader_says_what_to_install(tmp_path, monkeypatch):
    (tmp_path / "a.dae").write_text("<COLLADA/>")
    monkeypatch.setattr("pinposture.collision.files.find_spec", lambda name: None)
    with pytest.raises(FileError, match="pycollada"):
        read_mesh(tmp_path / "a.dae")


def test_the_largest_bodies_are_drawn_coarser_when_there_are_too_many_triangles(robot):
    ball = trimesh.creation.icosphere(subdivisions=5, radius=2.0)  # 20480 triangles
    arm = robot(urdf(lower=UPPER))
    ball.export(find_mesh("../meshes/wedge.obj", arm.package_dirs))
    whole = body_meshes(arm)
    assert [len(mesh.faces) for mesh in whole.bodies] == [4, 20484]
    with pytest.warns(
        PostureWarning, match=r"wedge\.obj is drawn with \d+ triangles, because all meshes"
    ) as caught:
        meshes = body_meshes(arm, 5000)
    assert len(caught) == 1
    assert "have 20492 triangles, more than 5000" in str(caught[0].message)
    assert len(meshes.base.faces) == len(meshes.bodies[0].faces) == 4
    coarse = meshes.bodies[1]
    assert 1000 < len(coarse.faces) <= 4992
    # Its corners are corners of the whole one, and no corner of that is farther off than a few triangles.
    gaps, _ = cKDTree(coarse.vertices).query(whole.bodies[1].vertices)
    assert gaps.max() < 0.05
    assert cKDTree(whole.bodies[1].vertices).query(coarse.vertices)[0].max() == 0.0


def test_a_body_of_which_nothing_would_be_left_is_left_out(robot):
    arm = robot(urdf(lower=UPPER))
    assert [len(mesh.faces) for mesh in body_meshes(arm, 16).bodies] == [4, 8]
    with pytest.warns(PostureWarning, match=r"is left out, because all meshes together have 16 triangles"):
        meshes = body_meshes(arm, 6)
    assert meshes.bodies == (None, None)


def test_files_are_found_by_every_kind_of_name(tmp_path, monkeypatch):
    packages = tmp_path / "packages"
    package = tmp_path / "packages/robot"
    (package / "urdf").mkdir(parents=True)
    file = package / "a b.stl"
    file.write_bytes(b"")
    name = "package://robot/a b.stl"
    assert find_mesh(name, [str(packages)]) == file
    assert find_mesh(name, [str(package)]) == file
    assert find_mesh(name, [str(tmp_path), str(package / "urdf")]) == file
    assert find_mesh("../a b.stl", [str(tmp_path), str(package / "urdf")]).samefile(file)
    assert find_mesh(str(file)) == find_mesh(str(file), [str(tmp_path)]) == file
    assert find_mesh(file.as_uri()) == file
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    for missing in (name, "a b.stl", "package://robot", "", "x" * 5000):
        with pytest.raises(FileError):
            find_mesh(missing, [str(tmp_path)])
    monkeypatch.setenv("ROS_PACKAGE_PATH", f"/nowhere:{packages}")
    assert find_mesh(name) == file


def test_a_package_has_the_name_that_its_description_gives(tmp_path, monkeypatch):
    monkeypatch.delenv("ROS_PACKAGE_PATH", raising=False)
    folder = tmp_path / "sources" / "robot-2.1"
    (folder / "urdf").mkdir(parents=True)
    file = folder / "a.stl"
    file.write_bytes(b"")
    name = "package://robot_description/a.stl"
    inside = folder / "package.xml"
    for text in ("", "<package", "<package/>", "<package><name>other</name></package>"):
        inside.write_text(text)
        with pytest.raises(FileError, match="not found"):
            find_mesh(name, [str(tmp_path / "sources"), str(folder)])
    inside.write_text(
        '<?xml version="1.0"?>\n<package format="3">\n  <name>\n robot_description </name>\n</package>\n'
    )
    for given in (tmp_path / "sources", folder, folder / "urdf"):
        assert find_mesh(name, [str(given)]) == file
    monkeypatch.setenv("ROS_PACKAGE_PATH", str(tmp_path / "sources"))
    assert find_mesh(name) == file


def test_ascii_and_binary_stl_are_the_same(tmp_path):
    facets = "".join(
        "facet normal 0 0 0\nouter loop\n"
        + "".join(f"vertex {x} {y} {z}\n" for x, y, z in CORNERS[face])
        + "endloop\nendfacet\n"
        for face in FACES
    )
    (tmp_path / "a.stl").write_text(f"solid wedge\n{facets}endsolid wedge\n")
    (tmp_path / "b.STL").write_bytes(binary_stl(CORNERS, FACES))
    for name in ("a.stl", "b.STL"):
        mesh = read_mesh(tmp_path / name)
        np.testing.assert_allclose(mesh.vertices[mesh.faces], CORNERS[FACES])


def test_arms_without_meshes_have_none_and_read_nothing():
    arm = Arm.from_template("RyRz", modules=3)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        assert body_meshes(arm) == (None, (None,) * 6)
        assert body_meshes(Arm.from_model(arm.model, arm.control_points)) == (None, (None,) * 6)


def drawn(path) -> dict[str, np.ndarray]:
    """The vertices of each object that a page draws."""
    packed = json.loads(re.search(r"^const commands = (.*);$", path.read_text(), re.MULTILINE)[1])
    commands = [umsgpack.unpackb(base64.b64decode(command)) for command in packed]
    shapes = {}
    for command in commands:
        if command["type"] == "set_object":
            (geometry,) = command["object"]["geometries"]
            if geometry["type"] == "SphereGeometry":
                shapes[command["path"]] = np.array([geometry["radius"]])
            else:
                position = geometry["data"]["attributes"]["position"]
                shapes[command["path"]] = np.frombuffer(position["array"].data, "<f4").reshape(-1, 3)
    return shapes


def test_a_page_draws_the_meshes_and_the_control_points(robot, tmp_path):
    def page(arm: Arm, name: str) -> dict[str, np.ndarray]:
        run = track(arm, Target.from_configuration(arm, [0.4, -0.3]), arm.neutral(), max_steps=3)
        return drawn(save_html(arm, run, tmp_path / name))

    arm = robot(urdf(tool=PLAIN))
    shapes = page(arm, "meshes")
    plain = page(robot(urdf(PLAIN, PLAIN, PLAIN, PLAIN)), "plain")
    meshes = body_meshes(arm)
    root = "/pinposture/arm"
    assert len(as_set(shapes[f"{root}/body_001/link"])) == 4
    assert len(shapes[f"{root}/body_001/link"]) == len(meshes.bodies[0].vertices)
    np.testing.assert_allclose(shapes[f"{root}/body_001/link"], meshes.bodies[0].vertices, atol=1e-6)
    np.testing.assert_allclose(shapes[f"{root}/base"], meshes.base.vertices, atol=1e-6)
    assert shapes.keys() == plain.keys()
    for path in plain.keys() - {f"{root}/body_001/link", f"{root}/base"}:
        np.testing.assert_array_equal(shapes[path], plain[path])


def test_a_page_is_written_with_one_warning_if_a_mesh_is_missing(robot, tmp_path):
    arm = robot(urdf(upper=UPPER.replace("wedge", "gone")))
    with warnings.catch_warnings():
        warnings.simplefilter("error")  # tracking does not look at meshes
        run = track(arm, Target.from_configuration(arm, [0.4, -0.3]), arm.neutral(), max_steps=3)
    with pytest.warns(PostureWarning, match=r"gone\.stl") as caught:
        path = save_html(arm, run, tmp_path / "run")
    assert len([entry for entry in caught if entry.category is PostureWarning]) == 1
    assert len(drawn(path)["/pinposture/arm/body_001/link"]) > 12
