"""The scene in the page: what its controls and nodes show of a session, what they ask of it. No browser."""

from __future__ import annotations

import asyncio
import logging
import socket
import time
from types import SimpleNamespace
from typing import NamedTuple

import numpy as np
import pytest

pytest.importorskip("viser", reason="viser is not installed")

import pinocchio as pin
import viser
from collision.test_obstacle_types import NEW
from editor.edited_tasks import six_modules, task

import pinposture as pp
from pinposture.collision import Scan
from pinposture.collision.obstacles import OBSTACLE_TYPES
from pinposture.editor import edits
from pinposture.editor.obstacles import (
    ArmScale,
    at_pose,
    change_obstacle,
    insert_obstacle,
    obstacles_of,
    select_obstacle,
)
from pinposture.editor.postures import hold_tip
from pinposture.editor.session import NearestObstacle, Session
from pinposture.editor.surroundings import ScanShelf
from pinposture.editor.ui import parts
from pinposture.editor.ui.arm import MeasuredArm
from pinposture.editor.ui.curve import ShapeTab
from pinposture.editor.ui.keyframes import KeyframesTab
from pinposture.editor.ui.parts import color
from pinposture.editor.ui.scene import (
    VECTOR_LABELS,
    ClearanceLine,
    Obstacles,
    ScanControls,
    Scans,
    SceneTab,
    clearance_text,
)
from pinposture.viz.palette import THEME

BALL = pp.Sphere((0.3, 0.2, 0.1), 0.05)
BOX = pp.Box((0.2, -0.3, 0.1), (0.1, 0.2, 0.3), (0.0, 0.0, np.pi / 2))
FLOOR = pp.HalfSpace((0, 0, -0.2), (0, 0, 1))
ROD = pp.Cylinder((0.1, 0.4, 0.0), (0.1, 0.4, 0.3), 0.02)


@pytest.fixture(scope="module")
def arm():
    return six_modules()


@pytest.fixture(scope="module")
def live(arm):
    return SimpleNamespace(arm=arm, state=arm.at(arm.straight()), target=None)


@pytest.fixture(scope="module")
def server():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    logging.getLogger("websockets.server").setLevel(logging.WARNING)
    made = viser.ViserServer(host="127.0.0.1", port=port, verbose=False)
    yield made
    made.stop()


@pytest.fixture
def desk(server):
    """A session with obstacles, and requests that are done at once."""
    scene = pp.Scene({"ball": BALL, "box": BOX, "floor": FLOOR, "rod": ROD})
    session = Session(task(scene=scene))
    yield session, lambda request, key="": request(session)
    server.gui.reset()
    server.scene.reset()


def event(**values):
    return SimpleNamespace(client_id=1, **values)


def test_every_obstacle_is_drawn_where_it_is(arm, live, server, desk):
    session, post = desk
    drawing = Obstacles(server, arm, post)
    drawing.show(session, live)
    assert set(drawing._drawn) == {"ball", "box", "floor", "rod"}
    handle = drawing._drawn["box"].handle
    np.testing.assert_allclose(handle.position, BOX.center)
    np.testing.assert_allclose(np.abs(handle.wxyz), np.sqrt([0.5, 0, 0, 0.5]), atol=1e-9)
    np.testing.assert_allclose(np.ptp(handle.vertices, axis=0), BOX.size, atol=1e-6)
    floor = drawing._drawn["floor"].handle
    assert floor.position[2] == pytest.approx(-0.2)
    assert floor.vertices[:, 2].max() == pytest.approx(0.0, abs=1e-9)  # all of the plate is below its surface
    assert tuple(handle.color) == color(THEME.obstacle)
    assert handle.opacity == THEME.see_through


@pytest.mark.parametrize("name", NEW)
def test_a_new_type_is_drawn_and_has_a_field_for_each_number(name, arm, live, server, desk, monkeypatch):
    session, post = desk
    monkeypatch.setitem(OBSTACLE_TYPES, name, type(NEW[name]))
    insert_obstacle("new", NEW[name], session)
    assert "new" in obstacles_of(session.task), session.notice.text
    drawing = Obstacles(server, arm, post)
    drawing.show(session, live)
    handle = drawing._drawn["new"].handle
    np.testing.assert_allclose(handle.position, NEW[name].center)
    np.testing.assert_allclose(
        np.ptp(handle.vertices, axis=0), np.ptp(NEW[name].build().vertices, axis=0), atol=1e-6
    )
    tab = SceneTab(server, arm, ScanShelf(post), post)
    tab.show(session, live)
    # In millimetres, but for an angle.
    shown_fields = {key: field.control for key, field in tab._values.items() if field.control.visible}
    numbers = {key: field.value for key, field in shown_fields.items() if key not in VECTOR_LABELS}
    own = {key: value for key, value in vars(NEW[name]).items() if isinstance(value, float)}
    shown = {key: value if key == "bend" else 1e3 * value for key, value in own.items()}
    assert numbers == pytest.approx(shown)
    assert shown_fields.keys() - numbers.keys() == {"center", "rotation"}
    tab._values["radius"]._choose(50.0)
    drawing.show(session, live)
    changed = obstacles_of(session.task)["new"]
    assert changed.radius == 0.05
    np.testing.assert_allclose(
        np.ptp(drawing._drawn["new"].handle.vertices, axis=0),
        np.ptp(changed.build().vertices, axis=0),
        atol=1e-6,
    )


def test_only_what_is_selected_has_axes_and_handles(arm, live, server, desk):
    session, post = desk
    drawing = Obstacles(server, arm, post)
    drawing.show(session, live)
    assert not drawing._axes.visible
    counts = {"ball": 1, "box": 3, "floor": 1, "rod": 3}
    for name, count in counts.items():
        asyncio.run(drawing._on_click(name, None))
        drawing.show(session, live)
        assert session.obstacle == name
        assert drawing._axes.visible
        assert [ball.visible for ball in drawing._balls] == [k < count for k in range(3)]
        assert drawing._axes.disable_rotations == (name == "ball")
        assert tuple(drawing._drawn[name].handle.color) != color(THEME.obstacle)
    session.handle = 1  # a hand at the curve
    drawing.show(session, live)
    assert not drawing._axes.visible
    assert not any(ball.visible for ball in drawing._balls)


def test_a_drag_moves_by_as_much_as_the_mouse_and_is_one_step(arm, live, server, desk):
    session, post = desk
    drawing = Obstacles(server, arm, post)
    drawing.show(session, live)
    grip = np.array(BALL.center) + (0.0, -0.05, 0.0)
    states = len(session.history._states)
    (dragged,) = [each.callback for each in drawing._drawn["ball"].handle._impl.drag_cb]
    for phase, by in (("start", 0.0), ("update", 0.01), ("update", 0.02), ("end", 0.03)):
        end = grip + np.array([by, 0.0, 0.0])
        asyncio.run(dragged(event(phase=phase, start_position=grip, end_position=end)))
        drawing.show(session, live)
        np.testing.assert_allclose(drawing._drawn["ball"].handle.position, BALL.center + np.array([by, 0, 0]))
    assert len(session.history._states) == states + 1
    assert obstacles_of(session.task)["ball"].center == pytest.approx((0.33, 0.2, 0.1))
    assert not dragged.__self__.held


def test_axes_move_and_turn_in_one_step(arm, live, server, desk):
    session, post = desk
    drawing = Obstacles(server, arm, post)
    select_obstacle("rod", session)
    drawing.show(session, live)
    drawing._axes.position = (0.1, 0.4, 0.25)
    drawing._axes.wxyz = np.sqrt([0.5, 0.5, 0, 0])  # by a quarter about x: the axis goes to -y
    for phase in ("start", "update", "end"):
        asyncio.run(drawing._axes_drag.by_axes(event(phase=phase)))
    rod = obstacles_of(session.task)["rod"]
    np.testing.assert_allclose([rod.start, rod.end], [(0.1, 0.55, 0.25), (0.1, 0.25, 0.25)], atol=1e-6)
    assert session.history.undoable == "moved rod"
    session.undo()
    assert obstacles_of(session.task)["rod"] == ROD


def test_values_of_ours_at_the_axes_ask_for_nothing(arm, live, server, desk):
    session, post = desk
    drawing = Obstacles(server, arm, post)
    select_obstacle("box", session)
    drawing.show(session, live)
    before = session.task
    asyncio.run(drawing._axes_drag.by_axes(SimpleNamespace(client_id=None, phase="update")))
    asyncio.run(drawing._axes_drag.by_axes(event(phase="update")))  # nobody has taken hold of them
    assert session.task is before
    assert session.proposal is None


def test_another_kind_under_the_same_name_is_drawn_anew(arm, live, server, desk):
    session, post = desk
    drawing = Obstacles(server, arm, post)
    drawing.show(session, live)
    session.edit(lambda t: t.edited(scene=pp.Scene({"ball": FLOOR})), "another")
    drawing.show(session, live)
    assert set(drawing._drawn) == {"ball"}
    assert drawing._drawn["ball"].look.type == "half_space"


def test_the_tab_shows_what_the_selected_obstacle_has(arm, live, server, desk, tmp_path):
    session, post = desk
    tab = SceneTab(server, arm, ScanShelf(post), post)
    shown = {
        "ball": {"center", "radius"},
        "box": {"center", "size", "rotation"},
        "floor": {"point", "normal"},
        "rod": {"start", "end", "radius"},
    }
    for name, keys in shown.items():
        select_obstacle(name, session)
        tab.show(session, live)
        assert {key for key, field in tab._values.items() if field.control.visible} == keys
        assert tab._called.control.value == name
    select_obstacle("box", session)
    tab.show(session, live)
    assert tab._values["rotation"].control.value == pytest.approx((0, 0, 90))
    assert tab._values["center"].control.value == pytest.approx(1e3 * np.array(BOX.center))
    select_obstacle(None, session)
    tab.show(session, live)
    assert not tab._delete.visible
    assert tuple(tab._chosen.control.options) == ("none", "ball", "box", "floor", "rod")


@pytest.mark.parametrize(("length", "step"), [(0.009, 1e-3), (1.0, 1.0), (80.0, 1.0)])  # [m], [mm]
def test_decimals_follow_the_size_of_the_arm(live, server, desk, length, step):
    _, post = desk
    module = pp.arm.template("RyRz").with_lengths([length / 12] * 2)
    arm = pp.Arm.from_modules([module] * 6)
    center = np.array([0.41287, 0.20731, -0.11929]) * length
    radius = 0.031247 * length
    session = Session(task(arm=arm, scene=pp.Scene({"ball": pp.Sphere(center, radius)})))
    tab = SceneTab(server, arm, ScanShelf(post), post)
    select_obstacle("ball", session)
    tab.show(session, live)
    for field, own, error in (
        (tab._values["center"].control, center, 1e-3),
        (tab._values["radius"].control, radius, 1e-6),
    ):
        np.testing.assert_allclose(1e-3 * np.array(field.value), own, rtol=0.0, atol=error * length)
        np.testing.assert_allclose(np.round(field.value, field.precision), field.value, rtol=1e-15)
        assert field.step == pytest.approx(step)
    grid = ShapeTab(server, arm, post)._step
    assert 1e-3 * np.round(grid.value, grid.precision) == pytest.approx(0.02 * length, rel=0.3)


@pytest.fixture
def clock(monkeypatch):
    """The time by which what is typed is over [s], in a list."""
    now = [100.0]
    monkeypatch.setattr(parts.time, "monotonic", lambda: now[0])
    return now


@pytest.fixture
def tab(arm, live, server, desk):
    """The tab with the ball selected."""
    session, post = desk
    made = SceneTab(server, arm, ScanShelf(post), post)
    select_obstacle("ball", session)
    made.show(session, live)
    return made


def test_what_is_typed_is_seen_at_once_and_counts_when_it_is_over(live, desk, tab, clock):
    session, _ = desk
    states = len(session.history._states)
    for radius in (0.0, 3.0, 35.0):  # "35" [mm], key by key
        tab._values["radius"]._type(radius)
        clock[0] += 0.2
        tab.show(session, live)
    assert len(session.history._states) == states
    assert obstacles_of(session.shown)["ball"].radius == pytest.approx(0.035)
    clock[0] += parts.TYPING_PAUSE
    tab.show(session, live)
    assert obstacles_of(session.task)["ball"].radius == pytest.approx(0.035)
    assert len(session.history._states) == states + 1


def test_what_is_refused_returns_to_what_it_was(live, desk, tab, clock):
    session, _ = desk
    tab._values["center"].control.value = (0.0, 0.0, 0.0)
    tab._values["center"]._type((0.0, 0.0, 0.0))  # where the base is
    clock[0] += 2.0
    tab.show(session, live)
    tab.show(session, live)
    assert tab._values["center"].control.value == pytest.approx(1e3 * np.array(BALL.center))
    assert "base" in session.notice.text


def test_margin_self_collision_and_thickness(arm, live, server, desk, monkeypatch):
    session, post = desk
    tab = SceneTab(server, arm, ScanShelf(post), post)
    tab._margin._choose(20.0)
    tab._arm_radius._choose(15.0)
    tab._self_collision._choose(True)
    scene = session.task.scene
    assert (scene.margin, scene.arm_radius, scene.self_collision) == (0.02, 0.015, True)
    assert obstacles_of(session.task)["rod"] == ROD
    tab._arm_radius._choose(0.0)
    assert session.task.scene.arm_radius is None
    before = session.task
    tab._margin._choose(-1000.0)
    assert session.task is before
    tab.show(session, live)
    assert tab._margin.control.value == pytest.approx(20.0)


@pytest.mark.parametrize(
    "distance, shade, words",
    [
        (0.02, THEME.regular, "20 mm from link to ball"),
        (0.004, THEME.active, "less than the margin of 5 mm"),
        (-0.003, THEME.mark, "3 mm inside ball"),
    ],
)
def test_the_line_is_coloured_by_how_near_it_is(arm, live, server, desk, distance, shade, words):
    session, _ = desk
    line = ClearanceLine(server, arm)
    ends = np.array([[0.1, 0.0, 0.0], [0.1, 0.0, 0.02]])
    session.nearest = NearestObstacle(distance, "link", "ball", *ends, 0.005)
    line.show(session, live)
    assert line._line.visible
    np.testing.assert_allclose(line._line.points[0], ends, atol=1e-6)
    assert tuple(line._line.colors[0, 0]) == color(shade)
    assert words in clearance_text(session.nearest)
    session.nearest = None
    line.show(session, live)
    assert not line._line.visible


def test_scans_are_drawn_as_points_or_as_a_surface(arm, live, server, desk, tmp_path):
    session, post = desk
    requests: list = []
    shelf = ScanShelf(lambda request, key="": requests.append(request))
    points = tmp_path / "points.npy"
    mesh = tmp_path / "surface.obj"
    np.save(points, np.random.default_rng(0).uniform(1, 2, (50, 3)))
    mesh.write_text("v 1 0 1\nv 2 0 1\nv 1 1 1\nf 1 2 3\n")
    session.edit(lambda t: t.edited(scans=(points, mesh)), "opened")
    drawing = Scans(server, arm, shelf)
    controls = ScanControls(server, shelf, post)
    end = time.monotonic() + 20.0
    while len(drawing._drawn) < 2 and time.monotonic() < end:
        drawing.show(session, live)
        time.sleep(0.01)
    assert isinstance(drawing._drawn[points][1], viser.PointCloudHandle)
    assert isinstance(drawing._drawn[mesh][1], viser.MeshHandle)
    controls.show(session)
    assert tuple(controls._listed.options) == ("points.npy", "surface.obj")
    controls._listed.value = "surface.obj"
    controls._remove_chosen("Remove")
    assert session.task.scans == (points,)
    drawing.show(session, live)
    assert list(drawing._drawn) == [points]
    shelf.close()


class Measured(NamedTuple):
    q: np.ndarray
    age: float
    count: int
    complaint: str


def test_a_measured_arm_stands_where_it_is_measured(arm, live, server, desk):
    session, _ = desk
    states = SimpleNamespace(arm=arm, latest=Measured(arm.straight(), 0.0, 0, ""))
    part = MeasuredArm(server, arm, states)
    part.show(session, live)
    assert "no joint states" in part._about.content
    assert not part._drawing._base.visible
    q = np.full(arm.nq, 0.1)
    states.latest = Measured(q, 3.0, 1, "line 7: nonsense")
    part.show(session, live)
    away = np.linalg.norm(arm.at(q).points - live.state.points, axis=1).mean()
    assert f"{1000 * away:.3g} mm from the plan" in part._about.content
    assert "3 s old" in part._about.content
    assert "line 7: nonsense" in part._about.content
    assert part._drawing._base.visible
    np.testing.assert_allclose(part._drawing.q, q)


def test_without_joint_states_nothing_is_shown(arm, live, server, desk):
    session, _ = desk
    MeasuredArm(server, arm, None).show(session, live)
    other = SimpleNamespace(arm=pp.Arm.from_template("RyRz", modules=2))  # and nothing else: it is not asked
    MeasuredArm(server, arm, other).show(session, live)
    assert not [name for name in server.scene._handle_from_node_name if name.startswith("/measured")]


def test_what_is_taught_is_measured_if_there_is_a_measured_arm(arm, live, server, desk):
    session, post = desk
    states = SimpleNamespace(arm=arm, latest=Measured(arm.neutral(), 0.0, 0, ""))
    tab = KeyframesTab(server, arm, states, post)
    shown = SimpleNamespace(state=arm.at(arm.configuration(np.full(arm.nv, 0.2))))
    measured = Measured(arm.configuration(np.full(arm.nv, 0.3)), 0.0, 1, "")
    for latest, joint in ((states.latest, 0.2), (measured, 0.3)):
        states.latest = latest
        tab.show(session, shown)
        tab._act_taught("Teach")
        assert session.keyframe.joints == pytest.approx(np.full(arm.nv, joint))


CORNERS = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]]) + 0.5
POSE = {"center": (0.1, 0.0, 0.0), "rotation": (0.3, 0.0, 0.0)}


@pytest.mark.parametrize(
    "mesh",
    [
        pp.Mesh(CORNERS, **POSE),
        pp.Mesh(CORNERS, **POSE, faces=[(0, 1, 2), (0, 2, 3)]),
        pp.Scan(CORNERS, [(0, 1, 2), (0, 2, 3)], **POSE),
        pp.Scan(CORNERS, **POSE, point_radius=1e-6),
    ],
)
def test_a_mesh_or_a_scan_is_drawn_where_its_corners_are(arm, live, server, desk, mesh):
    session, post = desk
    insert_obstacle("part", mesh, session)
    drawing = Obstacles(server, arm, post)
    drawing.show(session, live)
    handle = drawing._drawn["part"].handle
    w, x, y, z = handle.wxyz
    turn = pp.Box((0, 0, 0), (1, 1, 1), (0.3, 0, 0)).rotation
    assert (w, x, y, z) == pytest.approx((np.cos(0.15), np.sin(0.15), 0.0, 0.0))
    drawn = handle.vertices @ np.array(turn).T + handle.position
    expected = CORNERS @ np.array(turn).T + mesh.center
    gaps = np.linalg.norm(drawn[:, None] - expected[None], axis=2)
    dot = 2.1e-4 if isinstance(mesh, pp.Scan) and mesh.faces is None else 1e-5  # 0.002 of their width
    assert gaps.min(axis=1).max() < dot
    assert gaps.min(axis=0).max() < dot
    moved_there = at_pose(mesh, pin.SE3(np.eye(3), np.array((1.0, 0.0, 0.0))), ArmScale.of(arm))
    change_obstacle("part", lambda _: moved_there, "moved", True, session)
    drawing.show(session, live)
    assert drawing._drawn["part"].handle is handle  # moved, not sent again
    np.testing.assert_allclose(handle.position, (1.0, 0.0, 0.0), atol=1e-6)


def test_outliers_of_a_cloud_are_removed_and_taken_back(arm, live, server, desk, tmp_path):
    session, post = desk
    rng = np.random.default_rng(0)
    wall = np.column_stack([np.full(400, 0.5), rng.uniform(-0.1, 0.1, (400, 2))])
    flying = np.column_stack([np.full(3, 0.3), rng.uniform(-0.3, 0.3, (3, 2))])
    path = tmp_path / "cloud.npy"
    np.save(path, np.vstack([wall, flying]))
    insert_obstacle("cloud", Scan.load(path, center=(0.0, 0.0, 0.2)), session)
    shelf = ScanShelf(post)
    tab = SceneTab(server, arm, shelf, post)
    tab.show(session, live)
    assert tab._outliers.control.visible
    assert tab._outliers.control.value == 0.0
    tab._outliers._choose(50.0)
    shelf.close()
    cloud = obstacles_of(session.task)["cloud"]
    assert (len(cloud.points), cloud.outliers, cloud.center) == (400, 3, (0.0, 0.0, 0.2))
    assert "3 outliers removed" in session.notice.text
    assert session.whole.save(tmp_path / "task.toml").read_text().count("outlier_distance = 0.05") == 1
    tab.show(session, live)
    assert tab._outliers.control.value == 50.0
    for distance, points, words in ((0.0, 403, "all points kept"), (-0.1, 403, "outlier_distance is -0.1")):
        shelf = ScanShelf(post)
        shelf.remove_outliers("cloud", distance, session)
        shelf.close()
        assert len(obstacles_of(session.task)["cloud"].points) == points
        assert words in session.notice.text
    select_obstacle("ball", session)
    tab.show(session, live)
    assert not tab._outliers.control.visible


def test_the_tip_is_brought_to_a_place_that_is_typed(arm, server, desk):
    session, post = desk
    q = arm.integrate(arm.straight(), np.full(arm.nv, 0.1))
    here = SimpleNamespace(arm=arm, state=arm.at(q), target=None)
    tab = ShapeTab(server, arm, post)
    session.select(1)
    hold_tip(session)
    tab.show(session, here)
    place = tab._coordinates.control
    assert not place.disabled
    np.testing.assert_allclose(1e-3 * np.array(place.value), here.state.points[-1], atol=1e-4)
    goal = here.state.points[-1] + [0.0, 0.01, 0.005]
    tab._coordinates._type(tuple(1e3 * goal))
    assert session.proposal is None
    tab._coordinates.finish()
    taken = edits.configuration_of(arm, edits.keyframes_of(session.shown)[1])
    np.testing.assert_allclose(arm.at(taken).points[-1], goal, atol=1e-4)
