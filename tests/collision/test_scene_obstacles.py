"""Obstacles and scenes as values: checked, compared, hashed, pickled, written down."""

from __future__ import annotations

import json
import pickle

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.collision import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    Mesh,
    Scan,
    Scene,
    Sphere,
    obstacle_from_dict,
)
from pinposture.errors import InvalidValue, PostureError, UnknownName

TETRA = ((0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1))
KINDS = {
    "sphere": Sphere((1, 2, 3), 0.5),
    "capsule": Capsule((0, 0, 0), (0, 0, 1), 0.1),
    "cylinder": Cylinder((0, 0, 0), (0, 0.5, 1), 0.1),
    "box": Box((0, 0, 1), (1, 2, 3), (0.1, 0.2, 0.3)),
    "half_space": HalfSpace((0, 0, -1), (0, 1, 2)),
    "mesh": Mesh(TETRA, (1, 2, 3), (0.1, 0.2, 0.3)),
    "scan": Scan(TETRA, center=(1, 2, 3), rotation=(0.1, 0.2, 0.3), point_radius=0.1),
}
OPEN = {  # surfaces that are not their hulls
    "mesh": Mesh(TETRA, faces=[(0, 1, 2), (0, 2, 3)]),
    "scan": Scan(TETRA, [(0, 1, 2), (0, 2, 3)]),
}


@pytest.mark.parametrize("name", KINDS)
def test_an_obstacle_survives_being_written_down(name):
    described = json.loads(json.dumps(KINDS[name].to_dict()))
    assert described["type"] == name
    assert obstacle_from_dict(described) == KINDS[name]
    assert hash(obstacle_from_dict(described)) == hash(KINDS[name])
    assert pickle.loads(pickle.dumps(KINDS[name])) == KINDS[name]


@pytest.mark.parametrize("name", OPEN)
def test_a_surface_survives_with_its_triangles(name):
    surface = OPEN[name]
    again = obstacle_from_dict(json.loads(json.dumps(surface.to_dict())))
    assert again == surface and hash(again) == hash(surface) and again != KINDS[name]
    assert len(again.faces) == 2
    assert surface != surface.placed((0, 0, 1)) and surface == surface.placed((0, 0, 1)).placed((0, 0, 0))
    assert surface != {"mesh": Mesh, "scan": Scan}[name](TETRA, faces=[(0, 1, 2), (0, 3, 2)])


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Sphere((1, 2), 1), "center is (1, 2); allowed: three finite numbers"),
        (lambda: Sphere(("0", "0", "0"), 1), "center[0] is '0'; allowed: a number in SI units"),
        (lambda: Sphere((True, False, True), 1), "center is"),
        (lambda: Sphere(None, 1), "center is not given"),
        (lambda: Sphere((0, np.nan, 0), 1), "center is"),
        (lambda: Sphere((0, 1e7, 0), 1), "center[1] is 10000000.0; allowed: at most 10000"),
        (lambda: Capsule((1, 1, 1), (1, 1, 1), 0.1), "end is (1.0, 1.0, 1.0); allowed: another point"),
        (lambda: Cylinder((1, 1, 1), (1, 1, 1), 0.1), "end is"),
        (lambda: Box((0, 0, 0), (1, 0, 1)), "size[1] is 0.0"),
        (lambda: Box((0, 0, 0), (1, 1, 1), (1, 2)), "rotation is (1, 2); allowed: a rotation matrix"),
        (lambda: Box((0, 0, 0), (1, 1, 1), (2 * np.eye(3)).tolist()), "rotation is"),
        (lambda: Box((0, 0, 0), (1, 1, 1), (-np.eye(3)).tolist()), "this matrix mirrors"),
        (lambda: HalfSpace((0, 0, 0), (0, 0, 0)), "normal is (0, 0, 0); allowed: three numbers, not all 0"),
        (lambda: Mesh(TETRA[:3]), "vertices is"),
        (lambda: Mesh([(0, 0, 0), (1, 0, 0), (0, 1, 0), (1, 1, 0)]), "these are flat"),
        (lambda: Mesh([]), "vertices is []"),
        (lambda: Mesh("file.stl"), "vertices is 'file.stl'; allowed: points (n, 3) [m]"),
        (lambda: Mesh([(0, 0, np.inf), *TETRA]), "vertices is"),
        (lambda: Mesh(np.array(TETRA) * 1e8), "vertices (largest) is 100000000.0"),
        (lambda: Mesh.load(3), "path is 3"),
        (lambda: Mesh.load("a.stl", scale=0), "scale is 0; allowed: a factor"),
        (lambda: Scene([Sphere((0, 0, 0), 1)]), "obstacles is"),
        (lambda: Scene({"a": "sphere"}), "obstacles.a is 'sphere'; allowed: Sphere, Capsule"),
        (lambda: Scene({" ": KINDS["box"]}), "name of an obstacle is ' '"),
        (lambda: Scene({3: KINDS["box"]}), "name of an obstacle is 3"),
        (lambda: Scene(KINDS).moved({"box": np.eye(4)}), "allowed: a pin.SE3 (of a matrix: pin.SE3(matrix))"),
        (lambda: obstacle_from_dict([1]), "description is [1]; allowed: a table with a 'type'"),
        (lambda: obstacle_from_dict({"radius": 1}), "the key 'type' is missing; allowed: sphere, capsule"),
        (
            lambda: obstacle_from_dict({"type": "sphere", "radius": 1}),
            "the key 'center' is missing",
        ),
        (
            lambda: obstacle_from_dict({"type": "sphere", "centre": (0, 0, 0), "radius": 1}),
            "centre: there is no such key (did you mean 'center'?); allowed: type, center, radius",
        ),
        (
            lambda: obstacle_from_dict({"type": "mesh"}),
            "path or vertices is not given; allowed: one",
        ),
        (lambda: obstacle_from_dict({"type": "mesh", "path": 3}), "path is 3"),
        (lambda: obstacle_from_dict({"type": "mesh", "vertices": TETRA, "path": "a"}), "is 'both'"),
        (lambda: obstacle_from_dict({"type": "mesh", "vertices": TETRA, "scale": 2}), "scale is 2"),
        (lambda: obstacle_from_dict({"type": "mesh", "verts": TETRA}), "did you mean 'vertices'"),
        (lambda: Mesh(TETRA, faces=[(0, 1, 4)]), "faces is 4; allowed: point indices, 0 to 3"),
        (lambda: Mesh(TETRA, faces=[(0.0, 1.0, 2.0)]), "faces is"),
        (
            lambda: obstacle_from_dict({"type": "mesh", "path": "a.stl", "faces": [(0, 1, 2)]}),
            "allowed: nothing: they are read from the file",
        ),
        (
            lambda: obstacle_from_dict({"type": "scan"}),
            "path or points is not given; allowed: one",
        ),
        (lambda: obstacle_from_dict({"type": "scan", "points": TETRA, "scale": 2}), "scale is 2"),
        (lambda: obstacle_from_dict({"type": "scan", "point": TETRA}), "did you mean 'points'"),
        (lambda: Scan(TETRA, [(0, 1, 2)], point_radius=0.1), "point_radius is 0.1; allowed: 0 for a surface"),
        (lambda: Scan(TETRA, center=(0, 0)), "center is (0, 0)"),
        (lambda: Scan(TETRA, rotation=(1, 2)), "rotation is (1, 2)"),
    ],
)
def test_what_makes_no_obstacle_is_refused_by_name(make, words):
    with pytest.raises(InvalidValue) as caught:
        make()
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("name", ["spere", 3, ["box"]])
def test_a_type_that_does_not_exist_is_refused(name):
    with pytest.raises(UnknownName, match="no type of obstacle is called"):
        obstacle_from_dict({"type": name})


def test_a_mesh_keeps_the_corners_of_its_hull_alone():
    rng = np.random.default_rng(0)
    cube = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    mesh = Mesh(np.vstack([rng.uniform(0.1, 0.9, (50, 3)), cube, cube]))
    np.testing.assert_array_equal(np.sort(np.array(mesh.vertices), axis=0), np.sort(cube, axis=0))
    assert mesh == Mesh(cube[::-1])
    points = mesh.vertices
    faces = mesh.faces
    a, b, c = (points[faces[:, k]] for k in range(3))
    assert np.einsum("ti,ti->", np.cross(b - a, c - a), a - 0.5) > 0.0
    # The volume under its triangles is that of the cube only if all are seen from outside.
    assert np.einsum("ti,ti->t", np.cross(a, b), c).sum() / 6 == pytest.approx(1.0)


def test_rotations_are_given_as_a_matrix_or_as_angles():
    angles = (0.3, -0.4, 2.0)
    assert Box((0, 0, 0), (1, 1, 1), angles) == Box((0, 0, 0), (1, 1, 1), pin.rpy.rpyToMatrix(*angles))
    assert np.array_equal(Box((0, 0, 0), (1, 1, 1)).rotation, np.eye(3))


def test_scenes_are_values():
    one = Scene(KINDS, self_collision=True, margin=0.01, arm_radius=0.02)
    same = Scene(dict(reversed(KINDS.items())), self_collision=True, margin=0.01, arm_radius=0.02)
    assert one == same and hash(one) == hash(same) and pickle.loads(pickle.dumps(one)) == one
    assert Scene.from_dict(json.loads(json.dumps(one.to_dict()))) == one
    moved = one.moved({"sphere": (0.1, 0.0, 0.0)}, velocities={"capsule": (0.0, 1.0, 0.0)})
    again = pickle.loads(pickle.dumps(moved))
    assert again == moved and again.moving == moved.moving == {"sphere", "capsule"}
    assert again.moved({"sphere": (0.0, 0.0, 0.0)}) == one and again.first == one
    assert one != Scene(KINDS) and one != "scene" and Scene() == Scene({})
    assert pp.Scene is Scene and pp.Sphere is Sphere and pp.Mesh is Mesh
    with pytest.raises(TypeError):
        one.obstacles["more"] = Sphere((0, 0, 0), 1)
    with pytest.raises(AttributeError):
        one.margin = 3
    two = Scene({name: KINDS[name] for name in ("sphere", "scan")}, margin=0.01)
    assert repr(two) == "Scene(sphere, scan, margin=0.01)"
    assert repr(Scene(self_collision=False)) == "Scene(no obstacles, self-collision off, margin=0.005)"
    assert [each.empty for each in (one, Scene(), Scene(self_collision=False))] == [False, False, True]
    assert one.without_obstacles() == Scene(margin=0.01, arm_radius=0.02)


def test_a_scene_does_not_change_with_the_mapping_it_was_made_of():
    given = {"a": KINDS["box"]}
    scene = Scene(given)
    given["b"] = KINDS["sphere"]
    assert list(scene.obstacles) == ["a"]


numbers = st.one_of(st.floats(), st.integers(), st.text(max_size=3), st.none(), st.booleans())
anything = st.recursive(
    numbers, lambda inner: st.one_of(st.lists(inner, max_size=3), st.dictionaries(st.text(max_size=5), inner))
)


@examples(40)
@given(st.sampled_from(sorted(KINDS)), st.data())
def test_no_description_breaks_in_another_way_than_by_name(kind, data):
    described = KINDS[kind].to_dict()
    key = data.draw(st.sampled_from(sorted(described)))
    described[key] = data.draw(anything)
    try:
        made = Scene.from_dict({"obstacles": {"it": described}})
    except PostureError as error:
        assert "it" in str(error)
    else:
        assert Scene.from_dict(json.loads(json.dumps(made.to_dict()))) == made


@pytest.mark.parametrize(("before", "reach"), [(None, 0.1), ("scene", 0.1), (..., -1.0), (..., None)])
def test_how_far_obstacles_moved_needs_a_scene_and_a_length(before, reach) -> None:
    with pytest.raises(InvalidValue):
        pp.Scene().displacement(pp.Scene() if before is ... else before, reach)
