"""Scans in files: every format there and back, and what is wrong with a file is said."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

from pinposture.collision import Mesh, Scan
from pinposture.errors import FileError, InvalidValue, PostureWarning

PLY = """ply
format ascii 1.0
comment by hand
element vertex 4
property float x
property float y
property float z
property uchar red
property uchar green
property uchar blue
element face 2
property list uchar int vertex_indices
end_header
0 0 0 1 2 3
1 0 0 4 5 6
0 1 0 7 8 9
nan 0 0 0 0 0
3 0 1 2
3 0 1 3
"""


@cache
def some_points():
    return np.random.default_rng(0).normal(size=(50, 3)).astype(np.float32).astype(np.float64)


@cache
def some_colors():
    return np.random.default_rng(0).integers(0, 256, (50, 3), dtype=np.uint8)


@cache
def box():
    return trimesh.creation.box((1.0, 2.0, 3.0))


def rows(points):
    return "".join(f"{x!r} {y!r} {z!r}\n" for x, y, z in np.asarray(points).tolist())


def turned_rows():
    """With a time in front, and z before x and y."""
    return "".join(f"0,{z!r},{x!r},{y!r}\n" for x, y, z in some_points().tolist())


def same_triangles(scan, mesh):
    """Whether two surfaces have the same triangles, in any order of them and of their corners."""

    def told(triangles):
        return sorted(sorted(map(tuple, np.round(each, 6).tolist())) for each in triangles)

    return told(scan.points[scan.faces]) == told(mesh.triangles)


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_ply_clouds_with_colors(tmp_path, encoding):
    cloud = trimesh.PointCloud(
        some_points(), colors=np.column_stack([some_colors(), np.full(50, 255)]).astype(np.uint8)
    )
    path = tmp_path / "a.ply"
    path.write_bytes(trimesh.exchange.ply.export_ply(cloud, encoding=encoding))
    scan = Scan.load(path)
    np.testing.assert_allclose(scan.points, some_points(), atol=1e-6)
    np.testing.assert_array_equal(scan.colors, some_colors())
    assert scan.faces is None and scan.name == "a.ply" and scan.path == path


def test_ply_surfaces_by_hand(tmp_path):
    path = tmp_path / "a.PLY"
    path.write_text(PLY)
    scan = Scan.load(path)
    np.testing.assert_array_equal(scan.points, [[0, 0, 0], [1, 0, 0], [0, 1, 0]])
    np.testing.assert_array_equal(scan.faces, [[0, 1, 2]])
    np.testing.assert_array_equal(scan.colors, [[1, 2, 3], [4, 5, 6], [7, 8, 9]])
    assert scan.dropped == 1


@pytest.mark.parametrize("suffix", ["ply", "stl", "obj", "off", "glb"])
def test_surfaces(tmp_path, suffix):
    path = tmp_path / f"box.{suffix}"
    box().export(path)
    scan = Scan.load(path)
    assert same_triangles(scan, box()) and len(scan.points) == 8
    assert same_triangles(Scan.load(path, scale=0.001), box().copy().apply_scale(0.001))


def test_parts_of_a_scene_are_where_the_scene_has_them(tmp_path):
    scene = trimesh.Scene()
    move = trimesh.transformations.translation_matrix([1, 2, 3])
    colored = box().copy()
    colored.visual.vertex_colors = np.tile([10, 20, 30, 255], (8, 1)).astype(np.uint8)
    scene.add_geometry(box())
    scene.add_geometry(colored, transform=move)
    scene.export(tmp_path / "two.glb")
    scan = Scan.load(tmp_path / "two.glb")
    assert same_triangles(scan, trimesh.util.concatenate([box(), box().copy().apply_translation([1, 2, 3])]))
    assert {tuple(color) for color in scan.colors[scan.points[:, 2] > 2.0].tolist()} == {(10, 20, 30)}
    scene.add_geometry(trimesh.PointCloud(some_points()))
    scene.export(tmp_path / "three.glb")
    with pytest.raises(FileError, match="both triangles and loose points"):
        Scan.load(tmp_path / "three.glb")


@pytest.mark.parametrize(
    ("suffix", "text"),
    [
        (".xyz", lambda: rows(some_points())),
        (".txt", lambda: "# scanned\n\n// by hand\n" + rows(some_points()).replace(" ", "\t")),
        (".txt", lambda: rows(some_points()).replace(" ", "   ").replace("\n", " \r\n")),
        (".xyz", lambda: "".join(f"{line} 255 0 7 extra\n" for line in rows(some_points()).splitlines())),
        (".csv", lambda: rows(some_points()).replace(" ", ",")),
        (".csv", lambda: rows(some_points()).replace(" ", " ; ")),
        (".csv", lambda: "x,y,z,label\n" + rows(some_points()).replace(" ", ",").replace("\n", ",wall\n")),
        (".csv", lambda: '"Time", "Z [m]", "X [m]", "Y(m)"\n' + turned_rows()),
        (".txt", lambda: "# t z x y\n" + turned_rows().replace(",", " ")),
        (".txt", lambda: "# from x y z to there\n# a b c\n" + rows(some_points())),
        (".csv", lambda: "\ufeffx;y;z\n" + rows(some_points()).replace(" ", ";")),
    ],
)
def test_lines_of_numbers(tmp_path, suffix, text):
    path = tmp_path / f"a{suffix}"
    path.write_text(text(), newline="", encoding="utf-8")
    np.testing.assert_array_equal(Scan.load(path).points, some_points())


def test_points_that_a_scanner_did_not_see_are_left_out(tmp_path):
    text = "1 2 3\nnan nan nan\n4 5 6\ninf 0 0\n1 -inf NaN\n"
    (tmp_path / "a.xyz").write_text(text)
    values = np.array([[1, 2, 3], [np.nan] * 3, [4, 5, 6], [np.inf, 0, 0], [1, -np.inf, np.nan]])
    np.save(tmp_path / "a.npy", values)
    for name in ("a.xyz", "a.npy"):
        scan = Scan.load(tmp_path / name)
        np.testing.assert_array_equal(scan.points, [[1, 2, 3], [4, 5, 6]])
        assert scan.dropped == 3
    (tmp_path / "b.xyz").write_text("nan nan nan\n")
    with pytest.raises(FileError, match=r"b\.xyz.*1 points, none of them finite"):
        Scan.load(tmp_path / "b.xyz")


def test_arrays(tmp_path):
    np.save(tmp_path / "a.npy", some_points().astype(np.float32))
    np.save(tmp_path / "image.npy", np.dstack([some_points().reshape(5, 10, 3), np.zeros((5, 10, 1))]))
    np.savez(tmp_path / "one.npz", cloud=some_points())
    faces = np.arange(48).reshape(16, 3)
    np.savez(tmp_path / "all.npz", points=some_points(), faces=faces, colors=some_colors(), other=np.zeros(3))
    for name in ("a.npy", "image.npy", "one.npz", "all.npz"):
        scan = Scan.load(tmp_path / name)
        np.testing.assert_array_equal(scan.points, some_points())
    np.testing.assert_array_equal(scan.faces, faces)
    np.testing.assert_array_equal(scan.colors, some_colors())


def test_the_scale_of_millimetres(tmp_path):
    (tmp_path / "mm.xyz").write_text(rows(np.round(some_points() * 1000)))
    with pytest.warns(PostureWarning, match=r"mm\.xyz is .* wide.*scale=0.001"):
        Scan.load(tmp_path / "mm.xyz")
    scan = Scan.load(tmp_path / "mm.xyz", scale=0.001)
    np.testing.assert_allclose(scan.points, some_points(), atol=6e-4)
    (tmp_path / "far.xyz").write_text("500000 5000000 0\n500001 5000000 0\n")
    with pytest.raises(FileError, match=r"5e\+06|5000000"):
        Scan.load(tmp_path / "far.xyz")
    for wrong in (0.0, -1.0, np.nan, "mm", True, 1e5):
        with pytest.raises(InvalidValue, match="scale"):
            Scan.load(tmp_path / "mm.xyz", scale=wrong)


def test_a_mesh_in_millimetres(tmp_path):
    trimesh.creation.box((400, 50, 50)).export(tmp_path / "beam.stl")
    with pytest.warns(PostureWarning, match=r"beam\.stl is 400 m wide; .* scale=0.001"):
        Mesh.load(tmp_path / "beam.stl")
    assert np.ptp(Mesh.load(tmp_path / "beam.stl", scale=0.001).vertices) < 0.5  # and no warning


def binary_ply():
    return trimesh.exchange.ply.export_ply(box(), encoding="binary")


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("a.las", b"", r"'\.las'; allowed: \.ply, \.xyz"),
        ("a", b"", r"''; allowed"),
        ("a.ply", b"", "not a PLY file"),
        ("a.ply", b"\x00\xff" * 100, "not a PLY file"),
        ("a.ply", PLY[:60].encode(), "not a PLY file"),
        ("a.ply", PLY[:-10].encode(), "6 lines of data, but has 5"),
        ("a.ply", PLY.replace("vertex 4", "vertex 400").encode(), "402 lines of data, but has 6"),
        ("a.ply", PLY.replace("vertex 4", "vertex four").encode(), "invalid count"),
        ("a.ply", PLY.replace("1 0 0 4", "1 x 0 4").encode(), "cannot be read"),
        ("a.ply", PLY.replace("3 0 1 2", "3 0 1 9").encode(), "do not exist|cannot be read"),
        ("a.ply", PLY.replace("3 0 1 2", "3 0 1 -2").encode(), "do not exist|cannot be read"),
        ("a.ply", lambda: binary_ply()[:-50], "cannot be read"),
        ("a.stl", lambda: box().export(file_type="stl")[:-60], "cut off"),
        ("a.stl", b"hello", "cut off|cannot be read"),
        ("a.obj", b"hello", "neither|cannot be read"),
        ("a.obj", b"v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 7\n", "cannot be read|do not exist"),
        ("a.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n", "cannot be read"),
        ("a.glb", lambda: box().export(file_type="glb")[:200], "cannot be read"),
        ("a.pcd", b"", r"'\.pcd'; allowed: .*convert it, as by: pcl_pcd2ply"),
        ("a.xyz", b"", "no points"),
        ("a.xyz", b"# nothing\n", "no points"),
        ("a.xyz", b"1 2 3\n4 5\n", "line 2 is '4 5'"),
        ("a.xyz", b"1 2 3\n\n# c\n4 5 z\n", "line 4 is '4 5 z'"),
        ("a.xyz", b"hello, world!\n1 2 3\n", "line 1 is 'hello, world!'"),
        ("a.xyz", b"\xff\xfe\x00", "UTF-8"),
        ("a.csv", b"1,5;2,5;3,5\n", "line 1"),
        ("a.csv", b"x,y\n1,2\n", "line 1 is 'x,y'"),
        ("a.csv", b"a,b,c\n1,2,3\n", "line 1 is 'a,b,c'"),
        ("a.csv", b"t,x,y,z\n1,2,3\n", "line 2 is '1,2,3'"),
        ("a.npy", b"hello", "not a readable array"),
        ("a.npz", b"hello", "not a readable archive"),
    ],
)  # fmt: skip
def test_files_that_are_no_scan_say_what_is_wrong(tmp_path, name, content, reason):
    path = tmp_path / name
    path.write_bytes(content() if callable(content) else content)
    with pytest.raises(FileError, match=reason) as caught:
        Scan.load(path)
    assert caught.value.path == path


def test_arrays_that_are_no_scan(tmp_path):
    for number, values in enumerate(
        (np.zeros((3, 2)), np.zeros(3), np.array(["a", "b", "c"]), np.zeros((2, 2, 2, 3)), np.eye(3) * 1j)
    ):
        np.save(tmp_path / f"{number}.npy", values)
        with pytest.raises(FileError, match="allowed: numbers"):
            Scan.load(tmp_path / f"{number}.npy")
    np.save(tmp_path / "o.npy", np.array([None, 1]), allow_pickle=True)
    with pytest.raises(FileError, match="not a readable array"):
        Scan.load(tmp_path / "o.npy")
    np.savez(tmp_path / "two.npz", a=some_points(), b=some_points())
    with pytest.raises(FileError, match="a, b; allowed: an array points"):
        Scan.load(tmp_path / "two.npz")
    np.savez(tmp_path / "bad.npz", points=some_points(), faces=[[0, 1, 99]])
    with pytest.raises(FileError, match="faces is 99"):
        Scan.load(tmp_path / "bad.npz")


def test_files_that_are_not_there(tmp_path, monkeypatch):
    with pytest.raises(FileError, match="no such file"):
        Scan.load(tmp_path / "a.ply")
    (tmp_path / "d.ply").mkdir()
    with pytest.raises(FileError, match="directory"):
        Scan.load(tmp_path / "d.ply")
    with pytest.raises(FileError, match=r"cannot be read|no such file"):
        Scan.load("a\0b.xyz")
    with pytest.raises(InvalidValue, match="path"):
        Scan.load(3)
    monkeypatch.chdir(tmp_path)
    (tmp_path / "r.xyz").write_text("1 2 3\n")
    assert len(Scan.load("r.xyz").points) == 1


@pytest.mark.filterwarnings("ignore::pinposture.errors.PostureWarning")
@examples(200)
@given(
    st.sampled_from([".ply", ".xyz", ".csv", ".npy", ".npz", ".stl", ".obj", ".off", ".glb"]),
    st.data(),
)
def test_broken_files_are_refused_or_read_but_nothing_else(tmp_path_factory, suffix, data):
    folder = tmp_path_factory.getbasetemp()
    good = folder / f"good{suffix}"
    if not good.exists():
        if suffix in (".xyz", ".csv"):
            good.write_text(rows(some_points()[:5]))
        elif suffix == ".npy":
            np.save(good, some_points()[:5])
        elif suffix == ".npz":
            np.savez(good, points=some_points()[:5])
        else:
            box().export(good)
    content = bytearray(good.read_bytes())
    for _ in range(data.draw(st.integers(1, 4))):
        at = data.draw(st.integers(0, len(content) - 1))
        content[at] = data.draw(st.integers(0, 255))
    content = content[: data.draw(st.integers(1, len(content)))] if data.draw(st.booleans()) else content
    path = folder / f"broken{suffix}"
    path.write_bytes(content)
    try:
        scan = Scan.load(path)
    except FileError:
        return
    assert len(scan.points) and np.all(np.isfinite(scan.points))
