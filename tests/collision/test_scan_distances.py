"""Distances of an arm from scans and meshes, against brute force over all points and triangles."""

from __future__ import annotations

import pickle
import threading

import coal
import numpy as np
import pinocchio as pin
import pytest
import trimesh
from collision.arms_with_bodies import ARMS, described, geometry, single, spatial
from collision.scans_by_hand import brute_force, hull_distance, local_bodies, point_distance
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

import pinposture as pp
from pinposture.collision import Box, Capsule, CollisionModel, Mesh, Scan, Scene, Sphere
from pinposture.collision.distances import JointFrames, PairDistances
from pinposture.collision.scene import obstacles_around

BALL = geometry('<sphere radius="0.04"/>', "0.1 0 0.01")
HERE = JointFrames(np.eye(3)[None, None], np.zeros((1, 1, 3)))


def hulls(folder):
    """An arm whose links are wedges from a file, and balls."""
    wedge = trimesh.Trimesh([[0, 0, 0], [0.15, 0, 0], [0.1, 0.06, 0], [0.05, 0.01, 0.05], [0.12, 0, -0.04]])
    wedge.convex_hull.export(folder / "wedge.stl")
    text = described([geometry(f'<mesh filename="{folder / "wedge.stl"}"/>'), BALL] * 3)
    return pp.Arm.load(text, split=2)


@pytest.fixture(params=[*ARMS, "hulls"])
def arm(request, tmp_path):
    return hulls(tmp_path) if request.param == "hulls" else ARMS[request.param]()


def model_of(arm, obstacle, radius=None):
    """No margin: nothing is left out but what the arm is mounted on."""
    model = CollisionModel(arm, Scene({"it": obstacle}, self_collision=False, margin=0.0, arm_radius=radius))
    assert not any(each.second == "it" for each in model.excluded_pairs)
    return model


def far_from_base(arm, points, share=0.3):
    return points[np.linalg.norm(points - arm.chain.base, axis=1) > share * arm.length]


def cloud(arm, rng, count=150, spread=0.5):
    return Scan(far_from_base(arm, arm.chain.base + rng.normal(size=(count, 3)) * spread * arm.length))


def shards(arm, rng, count=40, size=0.1):
    """Triangles here and there, large ones and small ones, none at the base."""
    places = arm.chain.base + rng.normal(size=(count, 1, 3)) * 0.6 * arm.length
    sizes = size * arm.length * 10.0 ** rng.uniform(-1.5, 0.5, (count, 1, 1))
    corners = places + rng.normal(size=(count, 3, 3)) * sizes
    near = [hull_distance(each, arm.chain.base[None]) < 0.3 * arm.length for each in corners]
    points = corners[~np.array(near)].reshape(-1, 3)
    return Scan(points, np.arange(len(points)).reshape(-1, 3))


def check_where(arm, state, near, scan, radius=None):
    """What is said of where agrees with the distance: on the body's surface, and on the scan."""
    for distance, (name, _), on_arm, normal in zip(
        near.distances, near.pairs, near.points, near.normals, strict=True
    ):
        if distance <= 0.0:
            continue
        named = [(b.shape, place) for b, place in local_bodies(arm, state.q, radius) if b.name == name]
        on_scan = on_arm - distance * normal
        assert min(abs(point_distance(p.actInv(on_arm), shape)) for shape, p in named) < 1e-6
        here = [point_distance(p.actInv(on_scan), shape) for shape, p in named]
        assert min(abs(each - distance) for each in here) < 1e-6
        if scan.faces is None:
            assert np.linalg.norm(scan.points - on_scan, axis=1).min() < 1e-6
        else:
            assert min(hull_distance(scan.points[face], on_scan[None]) for face in scan.faces) < 1e-6


@pytest.mark.long
def test_the_nearest_of_all_points_is_found(arm):
    rng = np.random.default_rng(0)
    apart = 0
    inside = 0
    for spread in (0.5, 1.0, 3.0):
        scan = cloud(arm, rng, spread=spread)
        model = model_of(arm, scan)
        for _ in range(3):
            state = arm.at(arm.random(rng))
            distance, _ = brute_force(arm, state.q, scan)
            near = model.nearest(state, max(distance, 0.0) + 0.02 * arm.length)
            for found in (model.minimum(state.q).distance, near.minimum):
                if distance > 0.0:
                    assert found == pytest.approx(distance, abs=1e-7)
                else:
                    assert found < 0.0
            check_where(arm, state, near, scan)
            apart = apart + (distance > 0.0)
            inside = inside + (distance < 0.0)
    assert apart >= 2


@pytest.mark.long
def test_the_nearest_of_all_triangles_is_found(arm):
    rng = np.random.default_rng(1)
    apart = 0
    # Capsules stand in for what has cylinders: of these more below.
    kinds = {body.shape.type for body, _ in local_bodies(arm, arm.neutral())}
    radius = 0.01 if "cylinder" in kinds else None
    for _ in range(4):
        scan = shards(arm, rng)
        model = model_of(arm, scan, radius)
        for _ in range(3):
            state = arm.at(arm.random(rng))
            distance, _ = brute_force(arm, state.q, scan, radius)
            near = model.nearest(state, max(distance, 0.0) + 0.02 * arm.length)
            for found in (model.minimum(state.q).distance, near.minimum):
                if distance > 0.0:
                    assert found == pytest.approx(distance, abs=1e-6)
                else:
                    assert found <= distance + 1e-6
            check_where(arm, state, near, scan, radius)
            apart += distance > 0.0
    assert apart >= 3


def test_where_a_distance_is_asked_for_bounds_do_not_hide_any(arm):
    """Least distances of many configurations, as of each alone."""
    rng = np.random.default_rng(2)
    for scan in (cloud(arm, rng, spread=1.0), shards(arm, rng)):
        model = model_of(arm, scan)
        q0 = arm.checked(arm.random(rng))
        offsets = rng.normal(size=(6, arm.nv)) * 0.2
        each = [model.minimum(pin.integrate(arm.model, q0, dq)) for dq in offsets]
        least = min(one.distance for one in each)
        assert model.minimum_along(q0, offsets).distance == pytest.approx(least, abs=1e-9)
        below = model.minimum_along(q0, offsets, below=least + 1e-3).distance
        assert below == pytest.approx(least, abs=1e-9)
        assert model.minimum_along(q0, offsets, below=least - 1e-3).distance >= least - 1e-9


@pytest.mark.long
@pytest.mark.parametrize("shape", ['<box size="0.3 0.2 0.1"/>', '<cylinder radius="0.07" length="0.3"/>'])
def test_triangles_in_and_around_a_body_that_is_not_round(shape):
    arm = single(shape, xyz="0.1 0.05 0", rpy="0.3 0.2 0.1")
    rng = np.random.default_rng(2)
    sides = [0, 0]
    share = np.array([(u, v) for u in np.linspace(0, 1, 33) for v in np.linspace(0, 1, 33) if u + v <= 1])
    (body, place) = next((b, p) for b, p in local_bodies(arm, arm.neutral()))
    for _ in range(20):
        size = rng.uniform(0.02, 0.4)
        triangle = np.array([0.1, 0.05, 0]) + rng.normal(size=3) * 0.15 + rng.normal(size=(3, 3)) * size
        model = CollisionModel(
            arm, Scene({"it": Scan(triangle, [[0, 1, 2]])}, self_collision=False, margin=0.0)
        )
        if model.excluded_pairs:
            continue
        found = model.minimum(arm.neutral()).distance
        sampled = triangle[0] + share @ (triangle[1:] - triangle[0])
        least = min(point_distance(place.actInv(point), body.shape) for point in sampled)
        spacing = np.ptp(triangle, axis=0).max() / 32 * 1.5
        assert max(least - spacing, 0.0) <= max(found, 0.0) <= max(least, 0.0) + 1e-9
        sides[int(found <= 0.0)] += 1
    assert min(sides) >= 2


@pytest.mark.long
def test_points_all_around_a_hull_that_are_almost_equally_far(tmp_path):
    corners = np.array([[0, 0, 0], [0.3, 0, 0], [0.2, 0.12, 0], [0.1, 0.02, 0.1], [0.24, 0, -0.08]])
    trimesh.Trimesh(corners).convex_hull.export(tmp_path / "wedge.stl")
    arm = single(f'<mesh filename="{tmp_path / "wedge.stl"}"/>', xyz="0.2 0 0")
    rng = np.random.default_rng(8)
    (body, place) = local_bodies(arm, arm.neutral())[0]
    for distance in (1e-3, 0.01, 0.1):
        ways = rng.normal(size=(200, 3))
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        starts = [0.2, 0, 0] + corners[np.argmax(ways @ corners.T, axis=1)]  # the corner farthest that way
        points = starts + ways * distance * rng.uniform(1.0, 1.02, (200, 1))
        least = min(point_distance(place.actInv(point), body.shape) for point in points)
        assert model_of(arm, Scan(points)).minimum(arm.neutral()).distance == pytest.approx(least, abs=1e-8)
        thick = model_of(arm, Scan(points, point_radius=0.3 * distance)).minimum(arm.neutral()).distance
        assert thick == pytest.approx(least - 0.3 * distance, abs=1e-8)
        corners_of = points[:, None] + rng.normal(size=(200, 3, 3)) * 0.3 * distance
        least = min(hull_distance(each, corners + [0.2, 0, 0]) for each in corners_of)
        triangles = model_of(arm, Scan(corners_of.reshape(-1, 3), np.arange(600).reshape(-1, 3)))
        assert least > 0.0 and triangles.minimum(arm.neutral()).distance == pytest.approx(least, abs=1e-7)


# One body and one triangle or point, in any position.

coordinates = st.floats(-1.0, 1.0).map(lambda value: round(value, 3))
places = st.tuples(coordinates, coordinates, coordinates)


def contact(shape, obstacle):
    """Of a body with the piece, or pieces, of an obstacle: distances, points and normals, nearest first."""
    pieces = obstacle.geometry.solids()
    pairs = PairDistances([shape.solid()], [0], pieces, [(0, 1 + k) for k in range(len(pieces))])
    return pairs.near(HERE, np.inf)


def distance_by_faces(start, end, triangle):
    """Of a segment from a triangle: the smallest between all of their faces, ends and edges included.

    Between the affine hulls of two faces, least squares give the nearest points; they count if they are in
    the faces. If a hull has several nearest points, some of them are in a smaller face, too.
    """
    best = np.inf
    for line in map(np.array, ([start], [end], [start, end])):
        for corners in ([0], [1], [2], [0, 1], [0, 2], [1, 2], [0, 1, 2]):
            face = triangle[corners]
            matrix = np.concatenate([line[1:] - line[0], face[0] - face[1:]]).T
            gap = face[0] - line[0]
            shares = np.linalg.lstsq(matrix, gap, rcond=1e-12)[0] if matrix.size else np.zeros(0)
            weights = shares[len(line) - 1 :]
            if np.all(shares >= -1e-12) and np.all(shares <= 1 + 1e-12) and weights.sum() <= 1 + 1e-12:
                best = min(best, np.linalg.norm(matrix @ shares - gap))
    return best


@examples(60)
@given(places, places, st.lists(places, min_size=3, max_size=3), st.floats(0.01, 0.3))
def test_a_capsule_is_as_far_from_a_triangle_as_any_two_of_their_points(start, end, corners, radius):
    corners = np.array(corners)
    start = np.array(start)
    end = np.array(end)
    ball = np.linalg.norm(end - start) < 1e-3
    body = Sphere(start, radius) if ball else Capsule(start, end, radius)
    end = start if ball else end
    near = contact(body, Scan(corners, [[0, 1, 2]]))
    true = distance_by_faces(start, end, corners)
    assert near.distances[0] <= true - radius + 1e-9
    if not near.normals[0].any():  # they meet in a point of a triangle that is a line
        assert true < 1e-9 and np.linalg.norm(np.cross(*(corners[1:] - corners[0]))) < 1e-6
    elif near.distances[0] > -radius + 1e-7:
        assert near.distances[0] == pytest.approx(true - radius, abs=1e-6)
    else:  # the axis crosses it, and no longer does when it has been moved away as far as is told
        away = (-near.distances[0] - radius + 1e-6) * near.normals[0]
        assert true < 1e-4 and distance_by_faces(start + away, end + away, corners) > 1e-8
        assert np.linalg.norm(near.normals[0]) == pytest.approx(1.0)


@examples(60)
@given(st.integers(0, 2**31), st.booleans(), st.booleans())
def test_the_normal_is_the_derivative_of_the_distance(seed, ball, surface):
    """Moved by a little in any direction, the distance changes by that along the normal."""
    rng = np.random.default_rng(seed)
    points = rng.normal(size=(30, 3)) * 0.5
    scan = Scan(points, np.arange(30).reshape(-1, 3) if surface else None)
    start, end = rng.normal(size=(2, 3)) * 0.3

    def at(shift):
        shape = Sphere(start + shift, 0.05) if ball else Capsule(start + shift, end + shift, 0.05)
        return contact(shape, scan)

    here = at(np.zeros(3))
    small = 1e-6
    for direction in rng.normal(size=(3, 3)):
        ahead = at(small * direction).minimum
        behind = at(-small * direction).minimum
        slope = (ahead - behind) / (2.0 * small)
        expected = here.normals[0] @ direction
        bend = abs(ahead + behind - 2.0 * here.minimum) / small
        assert slope == pytest.approx(expected, abs=1e-4 + bend)


@examples(40)
@given(st.integers(0, 2**31), st.integers(1, 300), st.floats(0.001, 1.0))
def test_capsules_are_as_far_from_surfaces_as_coal_says(seed, count, size):
    """Of capsules of any length, among triangles of any size; the whole surface is one object for coal."""
    rng = np.random.default_rng(seed)
    corners = rng.normal(size=(count, 1, 3)) + size * rng.normal(size=(count, 3, 3))
    surface = coal.BVHModelOBBRSS()
    nowhere = coal.Transform3s(np.eye(3), np.zeros(3))
    surface.beginModel(count, 3 * count)
    surface.addVertices(corners.reshape(-1, 3))
    surface.addTriangles(np.arange(3 * count).reshape(-1, 3))
    surface.endModel()
    scan = Scan(corners.reshape(-1, 3), np.arange(3 * count).reshape(-1, 3))
    for length in (0.01, 0.3, 3.0):
        start = rng.normal(size=3)
        body = Capsule(start, start + length * rng.normal(size=3), 0.01).solid()
        pose = coal.Transform3s(body.rotation, body.position)
        request = coal.DistanceRequest()
        request.gjk_tolerance = 1e-9
        expected = coal.distance(body.geometry, pose, surface, nowhere, request, coal.DistanceResult())
        found = contact(Capsule(body.start, body.end, 0.01), scan).minimum
        if expected > 0.0:
            assert found == pytest.approx(expected, abs=1e-6)
        else:
            assert found <= 1e-6


def test_the_derivatives_are_those_of_the_distances(arm):
    rng = np.random.default_rng(5)
    kinds = {body.shape.type for body, _ in local_bodies(arm, arm.neutral())}
    radius = 0.01 if kinds - {"capsule", "sphere"} else None
    for scan in (cloud(arm, rng, spread=1.0), shards(arm, rng)):
        model = model_of(arm, scan, radius)
        checked = 0
        state = arm.at(arm.random(rng))
        near = model.nearest(state, np.inf)
        for column in range(arm.nv):
            dq = np.zeros(arm.nv)
            dq[column] = 1e-6
            ahead, behind = (arm.at(pin.integrate(arm.model, state.q, sign * dq)) for sign in (1, -1))
            ahead = model.minimum(ahead.q).distance
            behind = model.minimum(behind.q).distance
            bend = abs(ahead + behind - 2.0 * near.minimum) / 1e-6
            if bend < 1e-3:
                slope = (ahead - behind) / 2e-6
                assert near.jacobian[0, column] == pytest.approx(slope, abs=1e-5 + bend)
                checked += 1
        assert checked >= arm.nv // 2


# Solid meshes.


def ring(inner=0.2, outer=0.4, height=0.3, count=24):
    """A closed ring of a square section about the z axis: an arm may reach through it."""
    profile = [(inner, -height / 2), (outer, -height / 2), (outer, height / 2), (inner, height / 2)]
    angles = 2.0 * np.pi * np.arange(count) / count
    points = np.array([(r * np.cos(a), r * np.sin(a), z) for a in angles for r, z in profile])
    faces = []
    for k in range(count):
        for j in range(4):
            a = 4 * k + j
            b = 4 * k + (j + 1) % 4
            c = 4 * ((k + 1) % count) + j
            d = 4 * ((k + 1) % count) + (j + 1) % 4
            faces += [(a, c, b), (b, c, d)]
    return points, np.array(faces)


def in_ring(point, inner=0.2, outer=0.4, height=0.3, count=24):
    """Whether a point is in that ring, by its distance from the middle of the sector of the polygon."""
    sector = 2.0 * np.pi / count
    angle = np.arctan2(point[1], point[0]) % sector - sector / 2.0
    across = np.hypot(*point[:2]) * np.cos(angle) / np.cos(sector / 2.0)
    return inner < across < outer and abs(point[2]) < height / 2


@examples(100)
@given(places)
def test_a_closed_mesh_is_solid_and_keeps_its_hollow(point):
    scene = Scene({"ring": Mesh(ring()[0], faces=ring()[1])}, self_collision=False)
    point = 0.5 * np.array(point)
    assert bool(obstacles_around(scene, point, depth=1e-9)) == in_ring(point)
    near = contact(Sphere(point, 1e-3), scene.obstacles["ring"])
    assert (near.minimum < -1e-3) == in_ring(point)


def cubes(filled, rng):
    """The faces between unit cubes that are filled and empty ones, as triangles that face either way."""
    points = []
    faces = []
    for cube in np.argwhere(filled):
        for axis, side in np.ndindex(3, 2):
            beyond = cube + (2 * side - 1) * np.eye(3, dtype=int)[axis]
            if filled[tuple(beyond)]:
                continue
            square = np.tile(cube.astype(float), (4, 1))
            square[:, axis] += side
            square[:, [(axis + 1) % 3, (axis + 2) % 3]] += [(0, 0), (1, 0), (1, 1), (0, 1)]
            faces += [rng.permutation(three) + len(points) for three in (DIAGONALS[rng.integers(2)])]
            points += [*square]
    return np.array(points), np.array(faces)


DIAGONALS = ((0, 1, 2), (0, 2, 3)), ((0, 1, 3), (1, 2, 3))


@examples(30)
@given(st.integers(0, 2**31))
def test_what_is_inside_is_told_also_above_edges_and_corners(seed):
    """Points whose vertical lines meet corners, edges and diagonals of triangles, or run within walls."""
    rng = np.random.default_rng(seed)
    filled = np.zeros((6, 6, 6), dtype=bool)
    filled[1:5, 1:5, 1:5] = rng.random((4, 4, 4)) < rng.uniform(0.2, 1.0)
    filled[2, 2, 2] = True
    points, faces = cubes(filled, rng)
    mesh = Mesh(points, faces=faces)
    assert mesh.closed
    for place in np.column_stack([rng.integers(2, 11, (60, 2)) / 2, rng.integers(1, 5, 60) + 0.25]):
        around = [
            filled[x, y, int(place[2])]
            for x in {int(place[0]), int(np.ceil(place[0])) - 1}
            for y in {int(place[1]), int(np.ceil(place[1])) - 1}
        ]
        if len(set(around)) == 1:  # else it is on the surface
            assert bool(obstacles_around(Scene({"it": mesh}, self_collision=False), place)) == around[0]


@pytest.mark.long
def test_a_body_inside_of_a_closed_mesh_is_never_clear_of_it():
    points, faces = ring()
    mesh = Mesh(points, faces=faces)
    rng = np.random.default_rng(0)
    found = 0
    for _ in range(200):
        start = rng.uniform(-0.4, 0.4, 3)
        end = start + rng.normal(size=3) * 0.03
        if all(in_ring(start + share * (end - start)) for share in np.linspace(0, 1, 9)):
            near = contact(Capsule(start, end, 1e-3), mesh)
            depth = min(hull_distance(points[face], np.array([start, end])) for face in faces)
            assert near.distances[0] == pytest.approx(-depth - 1e-3, abs=1e-6)
            out = start + np.linspace(0, 1, 999)[:, None] * (end - start) + (depth + 1e-4) * near.normals[0]
            assert not all(in_ring(each) for each in out)
            assert contact(Box(0.5 * (start + end), (1e-3, 2e-3, 1e-3)), mesh).distances[0] < -1e-3
            found += 1
    assert found > 20
    assert contact(Capsule((0, 0, -1), (0, 0, 1), 0.05), mesh).minimum == pytest.approx(
        0.2 * np.cos(np.pi / 24) - 0.05
    )


def test_meshes_that_are_convex_are_told_from_others():
    box = trimesh.creation.box((1, 2, 3))
    assert Mesh(box.vertices, faces=box.faces).convex
    assert Mesh(box.vertices, faces=box.faces) == Mesh(box.vertices)
    mixed = box.faces.copy()
    mixed[::2] = mixed[::2, ::-1]
    assert Mesh(box.vertices, faces=mixed).closed and not Mesh(box.vertices, faces=mixed).convex
    assert not Mesh(box.vertices, faces=box.faces[1:]).convex  # open
    assert not Mesh(box.vertices, faces=box.faces[1:]).closed
    points, faces = ring()
    assert not Mesh(points, faces=faces).convex and Mesh(points, faces=faces).closed
    both = trimesh.util.concatenate([box, box.copy().apply_translation((5, 0, 0))])
    assert not Mesh(both.vertices, faces=both.faces).convex
    with pytest.raises(ValueError, match="read-only"):
        Mesh(points, faces=faces).faces[0, 0] = 1


# Whole scans.


def test_a_fine_surface_and_its_two_triangles_are_equally_far():
    arm = spatial(5)
    rng = np.random.default_rng(3)
    corner = arm.chain.base - [0.4, 0.4, 0.2]
    u = np.array([0.9, 0.1, 0.2])
    v = np.array([0, 0.8, 0.1])
    grid = np.linspace(0, 1, 41)
    points = np.array([corner + x * u + y * v for x in grid for y in grid])
    at = np.arange(41 * 41).reshape(41, 41)
    faces = np.concatenate(
        [
            np.stack([at[:-1, :-1], at[1:, :-1], at[:-1, 1:]], axis=-1).reshape(-1, 3),
            np.stack([at[1:, 1:], at[:-1, 1:], at[1:, :-1]], axis=-1).reshape(-1, 3),
        ]
    )
    fine = model_of(arm, Scan(points, faces))
    coarse = model_of(arm, Scan([corner, corner + u, corner + v, corner + u + v], [[0, 1, 2], [3, 2, 1]]))
    dots = model_of(arm, Scan(points))
    for _ in range(10):
        q = arm.random(rng)
        one, other, third = (each.minimum(q).distance for each in (fine, coarse, dots))
        assert one == pytest.approx(other, abs=1e-9)
        assert one <= third + 1e-12


@pytest.mark.long
def test_many_points_are_told_as_few_are():
    arm = spatial(10)
    rng = np.random.default_rng(4)
    scan = cloud(arm, rng, 20_000, 1.0)
    for radius in (0.0, 0.02):
        model = model_of(arm, Scan(scan.points, point_radius=radius), 0.01)
        for _ in range(5):
            q = arm.random(rng)
            least = np.inf
            for body, place in local_bodies(arm, q, 0.01):
                start, end = (place.act(np.array(each)) for each in (body.shape.start, body.shape.end))
                along = np.clip((scan.points - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
                gaps = np.linalg.norm(scan.points - start - along[:, None] * (end - start), axis=1)
                least = min(least, gaps.min() - 0.01 - radius)
            assert model.minimum(q).distance == pytest.approx(least, abs=1e-9)


@pytest.mark.parametrize("count", [1, 2, 5, 16, 17, 63, 64, 65, 129, 1000])
def test_scans_of_any_number_of_points(count):
    arm = spatial(2)
    rng = np.random.default_rng(count)
    points = arm.chain.base + [0.15, 0, 0] + rng.normal(size=(count, 3)) * 0.03
    scan = Scan(points)
    q = arm.random(rng)
    assert model_of(arm, scan).minimum(q).distance == pytest.approx(brute_force(arm, q, scan)[0], abs=1e-9)


def test_points_that_are_one_point_and_points_on_a_line():
    arm = spatial(3)
    far = arm.chain.base + [0.3, 0.3, 0.3]
    q = arm.random(np.random.default_rng(0))
    one = model_of(arm, Scan([far])).minimum(q)
    assert model_of(arm, Scan([far] * 100)).minimum(q).distance == pytest.approx(one.distance, abs=1e-12)
    line = Scan(far + np.linspace(0, 1, 500)[:, None] * [1, 2, 3])
    assert model_of(arm, line).minimum(q).distance <= one.distance
    flat = Scan([far, far, far + [0, 0, 1]], [[0, 0, 0], [0, 1, 2]])  # triangles without an area
    distance = brute_force(arm, q, Scan([far + [0, 0, z] for z in np.linspace(0, 1, 2001)]))[0]
    assert model_of(arm, flat).minimum(q).distance == pytest.approx(distance, abs=1e-5)


def test_a_scan_is_where_its_pose_says():
    rng = np.random.default_rng(6)
    move = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.0, 2.0), np.array([3.0, -2.0, 5.0]))
    arm = pp.Arm.from_template("RyRz", 6, (0.04, 0.05))
    moved = pp.Arm.from_template("RyRz", 6, (0.04, 0.05), base_placement=move)
    points, faces = ring()
    mesh = Mesh(points, (0.5, 0.1, 0.2), (0.1, 0.2, 0.3), faces)
    for obstacle in (cloud(arm, rng, 500), shards(arm, rng, 100), mesh):
        turn = move.rotation @ np.array(obstacle.rotation)
        tree = obstacle.tree
        there = obstacle.placed(move.rotation @ obstacle.center + move.translation, turn)
        assert there.tree is tree and obstacle.center != there.center
        one = model_of(arm, obstacle)
        other = model_of(moved, there)
        for _ in range(5):
            q = arm.random(rng)
            assert one.minimum(q).distance == pytest.approx(other.minimum(q).distance, abs=1e-9)
            first = one.nearest(arm.at(q), 0.1)
            second = other.nearest(moved.at(q), 0.1)
            np.testing.assert_allclose(first.jacobian, second.jacobian, atol=1e-9)


def test_what_the_arm_stands_on_is_left_out_where_it_stands():
    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.7]))
    arm = pp.Arm.from_template("RyRz", 4, (0.1, 0.1), base_placement=place)
    table = Scan([(-1, -1, 0.695), (1, -1, 0.695), (1, 1, 0.695), (-1, 1, 0.695)], [[0, 1, 2], [0, 2, 3]])
    model = CollisionModel(arm, Scene({"table": table}, self_collision=False, margin=0.01))
    assert [(each.first, each.second) for each in model.excluded_pairs] == [("m01_l1", "table")]
    bent = arm.configuration([0.0, 0.0, -1.2, 0.0, 0.0, 0.0, 0.0, 0.0])  # up, and so clear of the table
    assert model.minimum(bent).distance > -0.02


def test_several_surfaces_are_as_near_as_the_nearest():
    arm = spatial(6)
    rng = np.random.default_rng(9)
    points, faces = ring()
    parts = {
        "cloud": cloud(arm, rng, 3000, 1.0),
        "dots": Scan(cloud(arm, rng, 10).points, point_radius=0.02),
        "shards": shards(arm, rng),
        "ring": Mesh(0.4 * points, arm.chain.base + [0.3, 0.1, 0.0], (0.3, 0.2, 0.1), faces),
        "again": Mesh(0.4 * points, arm.chain.base + [0.2, 0.4, 0.1], (0.0, 0.2, 0.1), faces),
    }
    together = CollisionModel(arm, Scene(parts, self_collision=False, margin=0.0))
    alone = {name: model_of(arm, each) for name, each in parts.items()}
    nearest = set()
    for _ in range(40):
        q = arm.random(rng)
        each = {name: model.minimum(q).distance for name, model in alone.items()}
        distance, pair = together.minimum(q)
        assert distance == pytest.approx(min(each.values()), abs=1e-12)
        assert each[pair[1]] == pytest.approx(distance, abs=1e-12)
        nearest.add(pair[1])
    assert len(nearest) >= 3


def test_threads_may_share_one_and_processes_make_their_own():
    arm = spatial(8)
    rng = np.random.default_rng(7)
    scene = Scene(
        {"cloud": cloud(arm, rng, 5000, 1.0), "rest": shards(arm, rng)}, self_collision=False, margin=0.0
    )
    model = CollisionModel(arm, scene)
    configurations = [arm.random(rng) for _ in range(30)]
    alone = [model.minimum(q).distance for q in configurations]
    found = [[], [], []]

    def work(into):
        into += [model.minimum(q).distance for q in configurations]

    threads = [threading.Thread(target=work, args=(each,)) for each in found]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [alone] * 3
    again = pickle.loads(pickle.dumps(scene))
    assert again == scene and hash(again) == hash(scene) and CollisionModel(arm, again) is model
    assert "tree" not in vars(again.obstacles["cloud"])
