"""All types of obstacles, and new ones made from meshes: saved, read, moved, drawn and edited."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import field
from functools import partial
from typing import ClassVar

import numpy as np
import pinocchio as pin
import pytest
from collision.test_scene_obstacles import KINDS
from scipy.spatial.transform import Rotation

import pinposture as pp
from pinposture._validation import Vector
from pinposture.collision import CollisionModel, Obstacle
from pinposture.collision.distances import JointFrames, PairDistances
from pinposture.collision.obstacles import OBSTACLE_TYPES, displaced, obstacle_from_dict
from pinposture.collision.shapes import UNTURNED, MeshShape, Point, Size, Turn, number_fields
from pinposture.editor.obstacles import (
    ArmScale,
    add_obstacle,
    at_pose,
    change_obstacle,
    edit_obstacle,
    moved,
    new_obstacle,
    new_obstacle_kinds,
    obstacles_of,
    own_shape,
    resized,
    size_handles,
)
from pinposture.editor.session import Session
from pinposture.errors import InvalidValue
from pinposture.schema import Number, declared
from pinposture.viz.body import surface
from pinposture.viz.drawing import shown_obstacles

SIDES = 48


@declared()
class Cone(MeshShape):
    """A cone on the xy plane of its frame, with its apex on the z axis; convex."""

    type: ClassVar[str] = "cone"
    center: Point
    radius: Size
    height: Size
    rotation: Turn = UNTURNED

    def build(self) -> pp.Mesh:
        turn = np.linspace(0.0, 2.0 * np.pi, SIDES, endpoint=False)
        rim = np.column_stack([self.radius * np.cos(turn), self.radius * np.sin(turn), np.zeros(SIDES)])
        return pp.Mesh(np.vstack([rim, [0.0, 0.0, self.height]]))


@declared()
class Elbow(MeshShape):
    """A bent bar of square section about the z axis of its frame; not convex."""

    type: ClassVar[str] = "elbow"
    center: Point
    radius: Size
    width: Size
    bend: Number = field(default=90.0, metadata={"unit": "deg"})
    rotation: Turn = UNTURNED

    def build(self) -> pp.Mesh:
        half = 0.5 * self.width
        section = np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
        turns = np.radians(np.linspace(0.0, self.bend, SIDES))
        across = self.radius + section[:, 0]
        rings = [np.column_stack([across * np.cos(t), across * np.sin(t), section[:, 1]]) for t in turns]
        faces = [(0, 1, 2), (0, 2, 3)]
        for first in range(0, 4 * (SIDES - 1), 4):
            for k in range(4):
                a = first + k
                b = first + (k + 1) % 4
                faces += [(a, a + 4, b), (b, a + 4, b + 4)]
        last = 4 * (SIDES - 1)
        faces += [(last, last + 2, last + 1), (last, last + 3, last + 2)]
        return pp.Mesh(np.vstack(rings), faces=faces)

    @classmethod
    def of_size(cls, center: Vector, axis: np.ndarray, size: float) -> Elbow:
        return cls(center, radius=size, width=0.5 * size)


TURN = tuple(map(tuple, Rotation.from_euler("xyz", [0.3, -0.5, 1.1]).as_matrix().tolist()))
NEW = {
    "cone": Cone((0.3, 0.25, 0.1), 0.1, 0.2, TURN),
    "elbow": Elbow((0.3, 0.25, 0.1), 0.2, 0.06, rotation=TURN),
}
ALL = KINDS | NEW


@pytest.fixture(autouse=True)
def _registered(monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    for name, obstacle in NEW.items():
        monkeypatch.setitem(OBSTACLE_TYPES, name, type(obstacle))
    yield


def distances(obstacle: Obstacle, points: np.ndarray) -> np.ndarray:
    """Signed distances of points from an obstacle."""
    probe = pp.Sphere((0.0, 0.0, 0.0), 1e-6).solid()
    others = obstacle.geometry.solids()
    pairs = PairDistances([probe], [0], others, [(0, 1 + k) for k in range(len(others))])
    places = (JointFrames(np.eye(3)[None, None], point[None, None]) for point in np.array(points))
    return np.array([pairs.minimum(place)[0] for place in places]) + 1e-6


def around(obstacle: Obstacle, count: int = 60) -> np.ndarray:
    middle = np.array(obstacle.pose(np.zeros(3)).translation)
    return middle + np.random.default_rng(1).uniform(-0.4, 0.4, (count, 3))


def straight_task(arm: pp.Arm, scene: pp.Scene | None = None) -> pp.Task:
    line = pp.Curve.line([0, 0, 0], [arm.length, 0, 0])
    motion = (pp.Keyframe(line), pp.Keyframe(line, time=1.0))
    return pp.Task(arm=arm, motion=motion, limits=pp.Limits(dt=0.02), scene=scene)


def cone_distance(cone: Cone, points: np.ndarray) -> np.ndarray:
    """Distances of points from a cone, 0 inside: from a triangle in the plane of each point and the axis."""
    own = (points - cone.center) @ np.array(cone.rotation)
    flat = np.column_stack([np.hypot(own[:, 0], own[:, 1]), own[:, 2]])
    corners = np.array([[0.0, 0.0], [cone.radius, 0.0], [0.0, cone.height]])
    found = []
    for point in flat:
        inside = point[1] >= 0.0 and point[0] / cone.radius + point[1] / cone.height <= 1.0
        gaps = []
        for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True):
            share = np.clip((point - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
            gaps.append(float(np.linalg.norm(point - a - share * (b - a))))
        found.append(0.0 if inside else min(gaps))
    return np.array(found)


def elbow_distance(elbow: Elbow, points: np.ndarray) -> np.ndarray:
    """Distances of points from an elbow, 0 inside: from squares at many angles."""
    own = (points - elbow.center) @ np.array(elbow.rotation)
    turns = np.radians(np.linspace(0.0, elbow.bend, 4000))
    along = np.multiply.outer(own[:, 0], np.cos(turns)) + np.multiply.outer(own[:, 1], np.sin(turns))
    beside = np.multiply.outer(own[:, 1], np.cos(turns)) - np.multiply.outer(own[:, 0], np.sin(turns))
    half = 0.5 * elbow.width
    out = np.maximum(np.abs(along - elbow.radius) - half, 0.0)
    above = np.maximum(np.abs(own[:, 2]) - half, 0.0)[:, None]
    return np.sqrt(out**2 + above**2 + beside**2).min(axis=1)


def test_each_type_is_listed_under_its_name_and_tested_here():
    assert set(ALL) == set(OBSTACLE_TYPES)
    assert all(kind.type == name for name, kind in OBSTACLE_TYPES.items())


@pytest.mark.parametrize("name", ALL)
def test_each_type_is_read_as_it_was_written(name, tmp_path):
    scene = pp.Scene({"it": ALL[name]})
    assert obstacle_from_dict(json.loads(json.dumps(ALL[name].to_dict()))) == ALL[name]
    assert pp.Scene.load(scene.save(tmp_path / "scene.json")) == scene
    clear = pp.Scene({"it": moved(ALL[name], [5.0, 5.0, -5.0])})
    task = straight_task(pp.Arm.from_template("RyRz", modules=6), clear)
    assert pp.Task.load(task.save(tmp_path / "task.toml")).scene == clear


@pytest.mark.parametrize("name", ALL)
def test_each_type_moves_as_a_rigid_body(name):
    obstacle = ALL[name]
    motion = pin.SE3(np.array(TURN), np.array([0.2, -0.1, 0.3]))
    points = around(obstacle)
    there = points @ motion.rotation.T + motion.translation
    before = distances(obstacle, points)
    assert distances(displaced(obstacle, motion), there) == pytest.approx(before, abs=1e-9)
    assert distances(moved(obstacle, [0.1, 0.2, -0.3]), points + [0.1, 0.2, -0.3]) == pytest.approx(
        before, abs=1e-5
    )


@pytest.mark.parametrize("name", ALL)
def test_each_type_keeps_its_shape_where_the_editor_places_it(name):
    scale = ArmScale(np.zeros(3), 1.0)
    obstacle = ALL[name]
    placed = at_pose(obstacle, pin.SE3(np.array(TURN), np.array([0.1, 0.2, 0.3])), scale)
    assert type(placed) is type(obstacle)
    assert own_shape(placed, scale) == own_shape(obstacle, scale)
    if name != "half_space":
        assert placed.pose(scale.middle).translation == pytest.approx([0.1, 0.2, 0.3], abs=1e-5)
    for handle in size_handles(obstacle, scale):
        assert isinstance(resized(obstacle, handle.name, handle.position, scale), type(obstacle))


@pytest.mark.parametrize("name", ALL)
def test_each_type_is_drawn_where_it_is(name):
    scene = pp.Scene({"it": ALL[name]})
    points = np.array([[-4.0, -4.0, -4.0], [4.0, 4.0, 4.0]])
    (shown,) = shown_obstacles(scene, points)
    corners = shown.surface.vertices
    assert np.isfinite(corners).all() and len(shown.surface.faces) > 0
    if name == "half_space":
        assert distances(ALL[name], corners).max() < 1e-6
    elif name != "scan":  # the points of a cloud are drawn as octahedra
        assert np.abs(distances(ALL[name], corners)).max() < 1e-6


@pytest.mark.parametrize(("name", "exact"), [("cone", cone_distance), ("elbow", elbow_distance)])
def test_distances_from_new_types_are_those_of_their_solids(name, exact):
    points = around(NEW[name], 150)
    found = np.maximum(distances(NEW[name], points), 0.0)
    assert (exact(NEW[name], points) > 0.0).any()
    assert found == pytest.approx(exact(NEW[name], points), abs=5e-4)  # of 48 sides


@pytest.mark.parametrize("kind", [*NEW, "sphere", "box", "cylinder", "capsule", "half_space"])
def test_the_editor_adds_moves_changes_and_saves_each_type(kind, tmp_path):
    assert kind in new_obstacle_kinds()
    arm = pp.Arm.from_template("RyRz", modules=6)
    scale = ArmScale.of(arm)
    session = Session(straight_task(arm))
    points = arm.at(arm.straight()).points
    add_obstacle(kind, points, session)
    assert session.obstacle == f"{kind}_1", session.notice.text
    first = obstacles_of(session.task)[f"{kind}_1"]
    assert first == new_obstacle(kind, arm, points, None)
    change_obstacle(f"{kind}_1", partial(moved, shift=[0.0, 0.0, -0.05]), "moved", True, session)
    second = obstacles_of(session.task)[f"{kind}_1"]
    assert second != first and own_shape(second, scale) == own_shape(first, scale)
    for each in number_fields(type(second)):
        value = 1.1 * getattr(second, each.name)
        edit_obstacle(f"{kind}_1", each.name, value, True, session)
        assert getattr(obstacles_of(session.task)[f"{kind}_1"], each.name) == value
    last = obstacles_of(session.task)[f"{kind}_1"]
    read = pp.Task.load(session.task.save(tmp_path / "task.toml"))
    assert read.scene is not None and read.scene.obstacles[f"{kind}_1"] == last


@pytest.mark.parametrize("name", NEW)
def test_a_new_type_that_moves_has_the_clearance_of_one_that_was_there(name):
    arm = pp.Arm.from_template("RyRz", modules=6)
    scene = pp.Scene({"it": NEW[name]}, self_collision=False)
    motion = pin.SE3(np.array(TURN), np.array([0.05, 0.1, 0.0]))
    there = pp.Scene({"it": displaced(NEW[name], motion)}, self_collision=False)
    q = arm.straight()
    assert CollisionModel(arm, scene.moved({"it": motion})).minimum(q).distance == pytest.approx(
        CollisionModel(arm, there).minimum(q).distance, abs=1e-12
    )


def test_shapes_that_are_equal_share_a_tree():
    elbow = NEW["elbow"]
    assert displaced(elbow, pin.SE3(np.eye(3), np.ones(3))).geometry.tree is elbow.geometry.tree
    assert len(surface(elbow).faces) == len(elbow.geometry.faces)


def test_new_types_refuse_what_the_others_refuse():
    with pytest.raises(InvalidValue, match=r"radius is -1"):
        Cone((0, 0, 0), -1, 0.1)
    with pytest.raises(InvalidValue, match="the key 'height' is missing"):
        obstacle_from_dict({"type": "cone", "center": [0, 0, 0], "radius": 0.1})
    with pytest.raises(InvalidValue, match="width"):
        obstacle_from_dict({"type": "cone", "center": [0, 0, 0], "radius": 0.1, "height": 1, "width": 2})


def test_a_mesh_that_is_placed_already_is_refused():
    class Placed(Cone):
        def build(self) -> pp.Mesh:
            return super().build().placed((0.0, 0.0, 1.0))

    with pytest.raises(InvalidValue, match=r"Placed\.build\(\), center is"):
        _ = Placed((0, 0, 0), 0.1, 0.2).geometry


@pytest.mark.parametrize("built", [None, 3, np.zeros((4, 3)), pp.Sphere((0, 0, 0), 0.1)])
def test_what_is_built_is_a_mesh(built):
    kind = type("Odd", (Cone,), {"build": lambda self: built})
    with pytest.raises(InvalidValue, match=r"^Odd\.build\(\) is .*allowed: a Mesh"):
        _ = pp.Scene({"odd": kind((0, 0, 0), 0.1, 0.2)}).obstacles["odd"].geometry


def test_a_mesh_that_is_none_names_the_type_that_builds_it():
    kind = type("Odd", (Cone,), {"build": lambda self: pp.Mesh(np.full((4, 3), np.nan))})
    with pytest.raises(InvalidValue, match=r"^Odd\.build\(\), vertices is"):
        _ = kind((0, 0, 0), 0.1, 0.2).geometry
    flat = type("Flat", (Cone,), {"build": lambda self: pp.Mesh(np.eye(3))})
    with pytest.raises(InvalidValue, match=r"^Flat\.build\(\), vertices is .*flat"):
        _ = flat((0, 0, 0), 0.1, 0.2).geometry


def test_what_a_type_raises_is_raised():
    kind = type("Odd", (Cone,), {"build": lambda self: {}["height"]})
    with pytest.raises(KeyError, match="height"):
        _ = kind((0, 0, 0), 0.1, 0.2).geometry


def test_a_type_without_a_mesh_says_so():
    @declared()
    class Empty(MeshShape):
        type: ClassVar[str] = "empty"
        center: Point
        rotation: Turn = UNTURNED

    with pytest.raises(InvalidValue, match=r"Empty\.build is 'not defined'"):
        _ = Empty((0, 0, 0)).geometry
