"""Obstacles are where they are and as large as they are, in the browser, in the page and in figures."""

from __future__ import annotations

import base64
import io
import json
import re
from dataclasses import replace

import numpy as np
import pytest
import umsgpack
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d.art3d import Poly3DCollection
from sampling import examples
from viz.commands import server_commands
from viz.obstacle_scenes import QUARTER, SOLIDS

import pinposture as pp
from pinposture.viz import palette, plot_postures
from pinposture.viz.body import (
    FINENESS,
    box_corners,
    clip_to_box,
    cut_by_plane,
    facets,
    is_hidden,
    section,
    surface,
)
from pinposture.viz.drawing import shown_obstacles
from pinposture.viz.palette import THEME

STAGE = box_corners(np.array([0.0, -0.4, -0.3]), np.array([0.8, 0.4, 0.5]))
FLOOR = pp.HalfSpace((0.0, 0.0, -0.45), (0, 0, 1))
SAGITTA = 1.0 - np.cos(np.pi / FINENESS.obstacle_sides)  # how far a side of a polygon is inside of its circle


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 5, (0.1, 0.1))


@pytest.fixture
def scene() -> pp.Scene:
    """With an obstacle of every kind."""
    return pp.Scene({name: obstacle for name, (obstacle, *_) in SOLIDS.items()})


def still(arm: pp.Arm, scene: pp.Scene | None, angle: float = 0.1) -> pp.Run:
    """A short run as if it had been made in a scene."""
    target = pp.Target.from_configuration(arm, np.full(arm.nv, angle))
    run = pp.track(arm, target, np.zeros(arm.nv), "projection", max_steps=3)
    return run if scene is None else replace(run, scene=scene, clearance=np.full(run.steps + 1, 0.1))


def volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Enclosed volume by the divergence theorem, above 0 if all triangles face outwards."""
    a, b, c = vertices[faces].transpose(1, 0, 2)
    return float(np.einsum("ti,ti->", a, np.cross(b, c)) / 6.0)


def drawn_in(commands: list[dict]) -> list[tuple[np.ndarray, dict]]:
    """Vertices and material of each obstacle among commands, in their order."""
    listed = []
    for command in commands:
        if command["type"] == "set_object" and "/obstacles/" in command["path"]:
            data = command["object"]["geometries"][0]["data"]["attributes"]["position"]["array"].data
            listed.append((np.frombuffer(data, "<f4").reshape(-1, 3), command["object"]["materials"][0]))
    return listed


def page_commands(path) -> list[dict]:
    packed = re.search(r"^const commands = (.*);$", path.read_text(encoding="utf-8"), re.MULTILINE)[1]
    return [umsgpack.unpackb(base64.b64decode(each)) for each in json.loads(packed)]


def check_all(found: list[tuple[np.ndarray, dict]]) -> None:
    assert len(found) == len(SOLIDS)
    for (_, low, high, _), (vertices, material) in zip(SOLIDS.values(), found, strict=True):
        np.testing.assert_allclose(vertices.min(axis=0), low, atol=1e-6)
        np.testing.assert_allclose(vertices.max(axis=0), high, atol=1e-6)
        assert material["color"] == int(THEME.obstacle[1:], 16)
        assert material["transparent"] is True
        assert 0.2 < material["opacity"] < 0.8


@pytest.mark.parametrize("name", SOLIDS)
def test_a_surface_is_closed_faces_outwards_and_holds_the_volume(name):
    obstacle, low, high, expected = SOLIDS[name]
    vertices, faces = surface(obstacle)
    np.testing.assert_allclose(vertices.min(axis=0), low, atol=1e-12)
    np.testing.assert_allclose(vertices.max(axis=0), high, atol=1e-12)
    assert (1.0 - 4.0 * SAGITTA) * expected < volume(vertices, faces) <= expected * (1.0 + 1e-9)
    centers = vertices[faces].mean(axis=1)
    normals = np.cross(*(vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2)))
    middle = vertices[np.unique(faces)].mean(axis=0)
    assert np.all(np.einsum("ti,ti->t", normals, centers - middle) > 0.0)


def test_the_browser_is_told_of_every_kind_of_obstacle(scene, arm, running):
    with pp.view(arm, scene=scene, url=running.zmq_url):
        check_all(drawn_in(server_commands(running.zmq_url)))
    with pp.view(arm, still(arm, scene), url=running.zmq_url) as viewer:
        check_all(drawn_in(server_commands(running.zmq_url)))
        assert viewer.scene is scene
    with pp.view(arm, url=running.zmq_url):
        assert drawn_in(server_commands(running.zmq_url)) == []


def test_the_page_holds_every_kind_of_obstacle_and_says_how_near_they_are(scene, arm, tmp_path):
    path = pp.save_html(arm, still(arm, scene), tmp_path / "run.html")
    check_all(drawn_in(page_commands(path)))
    text = path.read_text(encoding="utf-8")
    assert "</span>obstacle" in text
    assert ", clearance 100 mm" in text
    plain = pp.save_html(arm, still(arm, None), tmp_path / "plain.html")
    assert drawn_in(page_commands(plain)) == []
    assert not re.search("obstacle<|clearance 0", plain.read_text(encoding="utf-8"))


@pytest.mark.parametrize("name", SOLIDS)
def test_a_figure_in_space_shows_an_obstacle_where_it_is(arm, name):
    obstacle, low, high, _ = SOLIDS[name]
    ax = Figure().add_subplot(projection="3d")
    plot_postures(still(arm, pp.Scene({name: obstacle})), ax)
    ax.figure.savefig(io.BytesIO(), dpi=20)
    (faces,) = (each for each in ax.collections if isinstance(each, Poly3DCollection))
    flat = np.vstack([path.vertices for path in faces.get_paths()])
    # The outermost points of the solid on the screen, by the support function of its defining points.
    ends, radius = defining_points(obstacle)
    project = ax.get_proj()
    for axis in (0, 1):
        way = project[axis, :3] / project[3, 3]
        across = radius * np.linalg.norm(way)
        if name == "cylinder":
            across = radius * np.linalg.norm(way[1:])  # its axis is along x
        expected = [(ends @ way).min() - across, (ends @ way).max() + across] + project[axis, 3] / project[
            3, 3
        ]
        found = [flat[:, axis].min(), flat[:, axis].max()]
        np.testing.assert_allclose(found, expected, atol=3.0 * SAGITTA * max(np.ptp(expected), 0.1))
    limits = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()])
    assert np.all(limits[:, 0] <= np.add(low, 1e-9))
    assert np.all(limits[:, 1] >= np.subtract(high, 1e-9))
    assert "obstacle" in [text.get_text() for text in ax.get_legend().get_texts()]


def defining_points(obstacle) -> tuple[np.ndarray, float]:
    if isinstance(obstacle, pp.Sphere):
        return np.array([obstacle.center]), obstacle.radius
    if isinstance(obstacle, (pp.Capsule, pp.Cylinder)):
        return np.array([obstacle.start, obstacle.end]), obstacle.radius
    if isinstance(obstacle, pp.Box):  # turned by a quarter turn
        half = np.array([obstacle.size[1], obstacle.size[0], obstacle.size[2]]) / 2.0
        return box_corners(obstacle.center - half, obstacle.center + half), 0.0
    turn = np.array(obstacle.rotation)
    return np.array([turn @ vertex + obstacle.center for vertex in obstacle.vertices]), 0.0


def test_a_planar_arm_sees_the_section_of_an_obstacle_and_the_outline_of_one_aside():
    scene = pp.Scene({"ball": pp.Sphere((0.2, 0.15, 0.03), 0.05), "aside": pp.Sphere((0.3, -0.2, 0.1), 0.05)})
    ax = Figure().add_subplot()
    plot_postures(still(template_arm("Rz", 5, (0.1,)), scene), ax)
    cross, aside = (patch.get_path().vertices for patch in ax.patches)
    reach = np.linalg.norm(cross - (0.2, 0.15), axis=1)
    np.testing.assert_allclose(reach, np.sqrt(0.05**2 - 0.03**2), rtol=0.02)
    np.testing.assert_allclose(np.linalg.norm(aside - (0.3, -0.2), axis=1), 0.05, rtol=0.01)
    assert [patch.get_fill() for patch in ax.patches] == [True, False]


CUBE = np.array(list(np.ndindex(2, 2, 2))) * 0.1
HOLLOWS = {  # a cube without its sides: two triangles, at its bottom and top
    "mesh": pp.Mesh(CUBE, (0.3, 0.1, 0.0), QUARTER, faces=[(0, 2, 4), (1, 5, 3)]),
    "surface": pp.Scan(CUBE, [(0, 2, 4), (1, 5, 3)], center=(0.3, 0.1, 0.0), rotation=QUARTER),
    "cloud": pp.Scan(CUBE, center=(0.3, 0.1, 0.0), rotation=QUARTER, point_radius=0.004),
}


@pytest.mark.long
@pytest.mark.parametrize("name", HOLLOWS)
def test_scans_and_hollow_meshes_are_drawn_as_they_are(name, arm, tmp_path):
    obstacle = HOLLOWS[name]
    thick = 0.004 if name == "cloud" else 0.0
    (vertices, _), *more = drawn_in(
        page_commands(pp.save_html(arm, still(arm, pp.Scene({name: obstacle})), tmp_path / "run.html"))
    )
    assert not more
    np.testing.assert_allclose(vertices.min(axis=0), np.array([0.2, 0.1, 0.0]) - thick, atol=1e-6)
    np.testing.assert_allclose(vertices.max(axis=0), np.array([0.3, 0.2, 0.1]) + thick, atol=1e-6)
    mesh = surface(obstacle)
    heights = mesh.vertices[mesh.faces].mean(axis=1)[:, 2]
    assert np.all(np.minimum(heights, 0.1 - heights) < 0.005)  # no triangles at the sides
    for ax, of in (
        (Figure().add_subplot(projection="3d"), arm),
        (Figure().add_subplot(), template_arm("Rz", 5)),
    ):
        plot_postures(still(of, pp.Scene({name: obstacle})), ax)
        ax.figure.savefig(io.BytesIO(), dpi=20)
        (dots,) = (line for line in ax.lines if line.get_marker() == ".")
        x, y = dots.get_data_3d()[:2] if of is arm else dots.get_data()
        np.testing.assert_allclose([min(x), max(x)], (0.2 - thick, 0.3 + thick), atol=1e-6)
        np.testing.assert_allclose([min(y), max(y)], (0.1 - thick, 0.2 + thick), atol=1e-6)
        assert "obstacle" in [text.get_text() for text in ax.get_legend().get_texts()]


def test_large_scans_are_thinned_before_they_are_drawn():
    points = np.random.default_rng(0).uniform(size=(3 * FINENESS.points, 3))
    assert len(surface(pp.Scan(points)).vertices) <= 24 * FINENESS.points
    grid = np.linspace(0, 1, 200)
    wave = np.array([(x, y, 0.1 * np.sin(9 * x)) for x in grid for y in grid])
    at = np.arange(200 * 200).reshape(200, 200)
    faces = np.stack([at[:-1, :-1], at[1:, :-1], at[:-1, 1:]], axis=-1).reshape(-1, 3)
    for large in (pp.Scan(wave, faces), pp.Mesh(wave, faces=faces)):
        shown = surface(large)
        assert len(shown.faces) > 100 and len(shown.vertices) <= FINENESS.points
        np.testing.assert_allclose(np.ptp(shown.vertices, axis=0), (1, 1, 0.2), atol=0.03)


def test_a_half_space_is_a_patch_under_its_plane_that_fits_the_picture():
    normal = np.array([0.6, 0.0, 0.8])
    scene = pp.Scene(
        {"floor": pp.HalfSpace((0.0, 0.0, -0.45), (0, 0, 1)), "slope": pp.HalfSpace((0.4, 0, 0), normal)}
    )
    floor, slope = shown_obstacles(scene, STAGE)
    heights = floor.near[:, 2]
    assert heights.max() == pytest.approx(-0.45)
    assert 0.0 < -0.45 - heights.min() < 0.05
    # Below all that is shown, and hardly wider: the slope may make it so.
    assert np.all(floor.near[:, :2].min(axis=0) <= (0.0, -0.4))
    assert np.all(floor.near[:, :2].max(axis=0) >= (0.8, 0.4))
    assert np.ptp(floor.near, axis=0).max() <= 2.0 * 0.8 + 0.1
    above = slope.near @ normal - 0.24
    assert above.max() == pytest.approx(0.0, abs=1e-12)
    assert 0.0 > above.min() > -0.05
    assert volume(*slope.surface) > 0.0


def test_a_half_space_that_ends_far_away_is_not_shown(arm):
    below = pp.Scene({"floor": pp.HalfSpace((0.0, 0.0, -5.0), (0, 0, 1))})
    assert shown_obstacles(below, STAGE) == []
    run = still(arm, below)
    assert "obstacle" not in [text.get_text() for text in pp.plot(run).axes[0].get_legend().get_texts()]


def test_half_spaces_reach_the_browser(arm, running):
    scene = pp.Scene({"wall": pp.HalfSpace((0.6, 0, 0), (-1, 0, 0))})
    with pp.view(arm, scene=scene, url=running.zmq_url):
        ((vertices, _),) = drawn_in(server_commands(running.zmq_url))
    assert vertices[:, 0].min() == pytest.approx(0.6)
    assert np.all(np.ptp(vertices, axis=0)[1:] > 0.3)


HUGE = {
    "ball": pp.Sphere((0.2, 0.0, -30.1), 30.0),
    "block": pp.Box((0.0, 0.0, -50.2), (100.0, 100.0, 100.0)),
    "post": pp.Cylinder((0.3, 0.2, -20.0), (0.3, 0.2, 20.0), 0.03),
    "floor": pp.HalfSpace((0.0, 0.0, -0.1), (0, 0, 1)),
    "far": pp.Sphere((40.0, 0.0, 0.0), 1.0),
}


@pytest.mark.parametrize("name", HUGE)
def test_nothing_huge_or_far_away_makes_the_arm_a_dot(arm, name):
    ax = Figure().add_subplot(projection="3d")
    run = still(arm, pp.Scene({name: HUGE[name]}))
    plot_postures(run, ax)
    ax.figure.savefig(io.BytesIO(), dpi=20)
    limits = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()])
    assert np.ptp(limits, axis=1).max() < 2.2 * arm.length
    for each in ax.collections:
        corners = np.vstack([path.vertices for path in each.get_paths()])
        assert np.all(np.isfinite(corners))
    far = "far off" in " ".join(text.get_text() for text in ax.get_legend().get_texts())
    assert far == (name == "far")


def test_the_camera_looks_at_what_is_near_and_stays_near_beside_what_is_huge(arm, tmp_path):
    def camera(scene: pp.Scene | None) -> tuple[float, np.ndarray]:
        commands = page_commands(pp.save_html(arm, still(arm, scene), tmp_path / "run.html"))
        (place,) = (each["value"] for each in commands if each.get("property") == "position")
        (shift,) = (each["matrix"] for each in commands if each["path"] == "/pinposture")
        return float(np.linalg.norm(place)), -np.array(shift[12:15])

    alone, middle = camera(None)
    far, same = camera(pp.Scene({"far": HUGE["far"]}))
    assert far == alone
    np.testing.assert_array_equal(middle, same)
    run = still(arm, None)
    lowest = min(run.points[..., 2].min(), run.target.points[:, 2].min(), 0.0)
    _, beside = camera(pp.Scene({"near": pp.Sphere((0.5, 0.0, 0.4), 0.06)}))
    assert beside[2] == pytest.approx((lowest + 0.46) / 2.0, abs=1e-3)
    assert camera(pp.Scene({"huge": HUGE["block"], "post": HUGE["post"]}))[0] < 3.0 * alone


@pytest.mark.long
def test_lines_behind_an_obstacle_are_veiled_and_others_are_not(arm):
    def veiled(place) -> bool:
        ax = Figure().add_subplot(projection="3d")
        run = still(arm, pp.Scene({"ball": pp.Sphere(place, 0.05)}))
        plot_postures(run, ax)
        color = palette.mixed(THEME.start, THEME.obstacle, 0.6)
        return any(line.get_color() == color for line in ax.get_lines())

    ax = Figure().add_subplot(projection="3d")
    plot_postures(still(arm, pp.Scene({"ball": pp.Sphere((0.1, 0.1, 0.0), 0.05)})), ax)
    elevation, azimuth = np.radians([ax.elev, ax.azim])
    eye = np.array(
        [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth), np.sin(elevation)]
    )
    middle = np.array([0.1, 0.0, 0.0])  # on the arm where it starts, straight along x
    assert veiled(middle + 0.1 * eye)
    assert not veiled(middle - 0.1 * eye)


@pytest.mark.long
def test_the_picture_of_an_arm_and_a_comparison_show_the_scene_once(scene, arm):
    figure = pp.plot_arm(arm, scene=scene)
    assert sum(isinstance(each, Poly3DCollection) for each in figure.axes[0].collections) == 1
    run = still(arm, scene)
    postures = pp.plot_comparison({"a": run, "b": run}).axes[0]
    labels = [text.get_text() for text in postures.get_legend().get_texts()]
    assert sum(label.startswith("obstacles") for label in labels) == 1
    figure.savefig(io.BytesIO(), dpi=20)


def test_without_a_scene_a_figure_is_what_it_was(arm):
    ax = Figure().add_subplot(projection="3d")
    plot_postures(still(arm, None), ax)
    assert len(ax.collections) == 0
    assert ax.computed_zorder
    labels = [text.get_text() for text in ax.get_legend().get_texts()]
    assert labels == ["target posture", "target points", "initial posture", "final posture", "base"]


CLOUDS = st.integers(0, 10**6).map(lambda seed: np.random.default_rng(seed).normal(size=(9, 3)))


@examples(30)
@given(points=CLOUDS, seed=st.integers(0, 10**6))
def test_cutting_keeps_what_is_below_the_plane_and_nothing_else(points, seed):
    rng = np.random.default_rng(seed)
    normal = rng.normal(size=3)
    normal /= np.linalg.norm(normal)
    offset = float(rng.uniform(-0.5, 0.5))
    part = cut_by_plane(points, normal, offset)
    assert np.all(part @ normal <= offset + 1e-9)
    inside = rng.dirichlet(np.ones(len(points)), 40) @ points  # points of the solid
    for point in inside[inside @ normal < offset - 1e-9]:
        assert is_inside(point, part)
    for point in part:
        assert is_inside(point, points)


def is_inside(point: np.ndarray, corners: np.ndarray) -> bool:
    from scipy.optimize import nnls

    system = np.vstack([corners.T, np.ones(len(corners))])
    return nnls(system, np.append(point, 1.0))[1] < 1e-7


@examples(15)
@given(points=CLOUDS, seed=st.integers(0, 10**6))
def test_what_a_solid_hides_is_behind_it(points, seed):
    rng = np.random.default_rng(seed)
    eye = rng.normal(size=3)
    eye /= np.linalg.norm(eye)
    asked = rng.normal(size=(10, 3)) * 2.0
    ways = np.linspace(0.0, 12.0, 400)
    for point, found in zip(asked, is_hidden(asked, points, eye), strict=True):
        met = any(is_inside(point + way * eye, points) for way in ways[::4])
        assert found or not met  # a graze between two samples may be found, never the other way round


def test_what_holds_a_point_or_stands_before_it_hides_it():
    cube = box_corners(np.zeros(3), np.ones(3))
    asked = np.array([[0.5, 0.5, -1.0], [0.5, 0.5, 0.5], [0.5, 0.5, 2.0], [1.5, 0.5, -1.0]])
    np.testing.assert_array_equal(
        is_hidden(asked, cube, np.array([0.0, 0.0, 1.0])), [True, True, False, False]
    )


def test_faces_of_a_box_are_six_squares():
    listed = facets(box_corners(np.zeros(3), np.ones(3)))
    assert sorted(tuple(normal.round(6) + 0.0) for _, normal in listed) == sorted(
        tuple(sign * row) for row in np.eye(3) + 0.0 for sign in (1.0, -1.0)
    )
    for face, normal in listed:
        assert len(face) == 4
        around = np.cross(
            np.roll(face, -1, axis=0) - face, np.roll(face, -2, axis=0) - np.roll(face, -1, axis=0)
        )
        np.testing.assert_allclose(around, np.tile(normal, (4, 1)), atol=1e-12)


def test_a_section_of_a_cube_across_its_diagonal_is_a_regular_hexagon():
    cube = box_corners(-np.ones(3), np.ones(3))
    plane = np.array([[1.0, -1.0, 0.0], [1.0, 1.0, -2.0]]) / np.sqrt([[2.0], [6.0]])
    corners = section(cube, np.zeros(3), plane)
    np.testing.assert_allclose(np.unique(np.linalg.norm(corners, axis=1).round(9)), np.sqrt(2.0))
    assert np.all(np.ptp(corners, axis=0) > 2.0)
    assert len(section(cube + 5.0, np.zeros(3), plane)) == 0


def test_what_lies_within_a_box_is_kept_as_it_is_and_the_rest_is_cut():
    cube = box_corners(np.zeros(3), np.ones(3))
    assert clip_to_box(cube, -np.ones(3), 2.0 * np.ones(3)) is cube
    part = clip_to_box(cube, np.array([0.5, -1.0, -1.0]), np.array([2.0, 0.25, 2.0]))
    np.testing.assert_allclose([part.min(axis=0), part.max(axis=0)], [[0.5, 0.0, 0.0], [1.0, 0.25, 1.0]])
    assert len(clip_to_box(cube, 2.0 * np.ones(3), 3.0 * np.ones(3))) == 0
