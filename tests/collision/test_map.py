"""Maps: cells along rays, what they forget, the arm's own points, and distances from cells."""

from __future__ import annotations

import math
from itertools import product

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

import pinposture as pp
from pinposture.collision import Cells, CollisionModel
from pinposture.collision.bodies import bodies_of
from pinposture.collision.mapping import Intrinsics, Map, Mounting
from pinposture.errors import FileError, InvalidValue, UnknownName

SIZE = 0.1
COUNT = 16
"""Edge length of the cells, and their number along an edge of a map of two blocks."""

CENTERS = np.array(list(product((np.arange(COUNT) + 0.5) * SIZE - 0.8, repeat=3)))
CAMERA = Intrinsics(60.0, 70.0, 15.2, 11.7)
OCCUPIED, FREE, UNKNOWN = 1, -1, 0


def small_map(**values) -> Map:
    return Map(SIZE, reach=0.8, **values)


def lengths_within(origin: np.ndarray, end: np.ndarray) -> np.ndarray:
    """How much of a line from 0 to 1 is in each cell: the overlap of three intervals."""
    way = end - origin
    with np.errstate(divide="ignore", invalid="ignore"):
        one = (CENTERS - 0.5 * SIZE - origin) / way
        other = (CENTERS + 0.5 * SIZE - origin) / way
    low = np.maximum(np.minimum(one, other).max(axis=1), 0.0)
    high = np.minimum(np.maximum(one, other).min(axis=1), 1.0)
    return high - low


def cell_of(point: np.ndarray) -> int:
    x, y, z = np.floor((point + 0.8) / SIZE).astype(int)
    return int((x * COUNT + y) * COUNT + z)


def expected_states(origin: np.ndarray, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """States of all cells after one picture, and which cells a ray barely touches."""
    first = {}
    for point in points:
        first.setdefault(cell_of(point), point)
    states = np.full(len(CENTERS), UNKNOWN)
    touched = np.zeros(len(CENTERS), dtype=bool)
    for point in first.values():
        within = lengths_within(origin, point)
        states[within > 1e-9] = FREE
        touched |= np.abs(within) <= 1e-9
    states[list(first)] = OCCUPIED
    return states, touched


@pytest.mark.parametrize("inside", [True, False])
def test_rays_pass_the_cells_that_they_cross_and_end_in_one(inside):
    rng = np.random.default_rng(4)
    for _ in range(20):
        origin = (
            rng.uniform(-0.75, 0.75, 3) if inside else np.array([-1.3, 0.3, -0.2]) + rng.normal(size=3) / 9
        )
        points = rng.uniform(-0.79, 0.79, (12, 3))
        mapped = small_map()
        mapped.add_cloud(points - origin, pin.SE3(np.eye(3), origin), 0.0)
        states, touched = expected_states(origin, points)
        assert touched.mean() < 0.01
        assert np.array_equal(mapped.states(CENTERS)[~touched], states[~touched])


def test_rays_that_end_beyond_the_range_or_the_map_only_pass():
    mapped = small_map(sensor_range=(0.1, 0.5))
    beyond = np.array([[0.6, 0.02, 0.02], [0.02, 3.0, 0.02], [0.02, 0.02, 0.09]])
    mapped.add_cloud(beyond, pin.SE3.Identity(), 0.0)
    assert not len(mapped.cells.points)
    along_x = np.column_stack([np.arange(0.05, 0.8, SIZE), np.full((8, 2), 0.02)])
    assert mapped.states(along_x).tolist() == [FREE] * 5 + [UNKNOWN] * 3  # up to 0.5 m
    assert mapped.states([(0.02, 0.02, 0.15)]).tolist() == [UNKNOWN]  # nearer than the range
    unlimited = small_map()
    unlimited.add_cloud(beyond[1:2], pin.SE3.Identity(), 0.0)
    assert unlimited.states([(0.02, 0.75, 0.02)]).tolist() == [FREE]
    assert not len(unlimited.cells.points)


def test_a_depth_image_is_the_cloud_that_its_pixels_show():
    rng = np.random.default_rng(1)
    depth = rng.uniform(0.2, 0.7, (24, 32))
    depth[2:5, 3:9] = np.nan
    depth[7, 4] = 0.0
    depth[9, 9] = -np.inf
    placement = pin.SE3(pin.exp3(np.array([0.4, -1.0, 0.3])), np.array([0.1, -0.1, 0.0]))
    rows, columns = np.mgrid[0:24, 0:32]
    points = np.stack(
        [(columns - CAMERA.cx) / CAMERA.fx * depth, (rows - CAMERA.cy) / CAMERA.fy * depth, depth], axis=-1
    )
    seen = np.isfinite(depth) & (depth > 0.0)
    pictured = small_map()
    pictured.add_depth(depth, CAMERA, placement, 0.0)
    pointed = small_map()
    pointed.add_cloud(points[seen], placement, 0.0)
    assert np.array_equal(pictured.states(CENTERS), pointed.states(CENTERS))
    assert len(pictured.cells.points) > 20


def test_an_infinite_depth_makes_all_free_up_to_the_edge():
    mapped = small_map()
    depth = np.full((24, 32), np.nan)
    depth[12, 15] = np.inf  # along the axis but for some pixels of 60
    mapped.add_depth(depth, Intrinsics(60.0, 60.0, 15.0, 12.0), pin.SE3.Identity(), 0.0)
    along = np.column_stack([np.full((16, 2), 1e-3), CENTERS[:16, 2]])
    assert mapped.states(along).tolist() == [UNKNOWN] * 8 + [FREE] * 8


def test_a_cloud_from_nowhere_makes_nothing_free():
    mapped = small_map()
    mapped.add_cloud(CENTERS[100:140], None, 0.0)
    states = mapped.states(CENTERS)
    assert set(states[100:140]) == {OCCUPIED}
    assert not states[:100].any() and not states[140:].any()


# Within cells: which of two cells a point on their face belongs to is a matter of rounding.
coordinates = st.builds(
    lambda cell, share: (cell + share) * SIZE - 0.8, st.integers(0, 15), st.floats(0.01, 0.99)
)
points_within = st.lists(st.tuples(coordinates, coordinates, coordinates), min_size=1, max_size=12).map(
    np.array
)


@given(st.lists(points_within, min_size=1, max_size=5), st.randoms())
def test_clouds_from_nowhere_give_the_same_map_in_any_order(clouds, order):
    shuffled = list(clouds)
    order.shuffle(shuffled)
    maps = small_map(), small_map()
    for mapped, given_clouds in zip(maps, (clouds, shuffled), strict=True):
        for cloud in given_clouds:
            mapped.add_cloud(cloud, None, 0.0)
    assert np.array_equal(maps[0].states(CENTERS), maps[1].states(CENTERS))
    occupied = {cell_of(point) for cloud in clouds for point in cloud}
    assert set(np.flatnonzero(maps[0].states(CENTERS) == OCCUPIED)) == occupied


@given(
    st.lists(
        st.tuples(points_within, st.tuples(coordinates, coordinates, coordinates).map(np.array)),
        min_size=1,
        max_size=5,
    )
)
def test_a_cell_in_which_something_was_seen_last_is_occupied(pictures):
    mapped = small_map(forget=1.0)
    for number, (points, origin) in enumerate(pictures):
        mapped.add_cloud(points - origin, pin.SE3(np.eye(3), origin), 0.3 * number)
        assert set(mapped.states(points)) == {OCCUPIED}


@given(st.integers(1, 8), st.floats(0.05, 5.0), st.floats(0.0, 0.02), st.floats(1e-3, 1e6), st.booleans())
def test_evidence_decays_with_the_time_constant(count, forget, spacing, begins, later):
    mapped = small_map(forget=forget)
    point = np.array([[0.33, 0.21, -0.4]])
    evidence = 0.0
    for number in range(count):
        evidence = evidence * math.exp(-spacing / forget) if number else 0.0
        evidence = min((evidence if evidence > 0.5 else 0.0) + 1.0, 4.0)
        mapped.add_cloud(point, None, begins + number * spacing)
    lasts = forget * math.log(2.0 * evidence)
    seen = begins + (count - 1) * spacing
    mapped.advance(seen + lasts * (1.001 if later else 0.999))
    assert mapped.states(point).tolist() == [UNKNOWN if later else OCCUPIED]
    assert len(mapped.cells.points) == (0 if later else 1)


@pytest.mark.parametrize(("seen", "through"), [(1, 1), (2, 2), (3, 3), (4, 4), (9, 4)])
def test_what_has_gone_is_free_after_as_many_pictures_as_saw_it_but_four_at_most(seen, through):
    mapped = small_map()
    near = np.array([[0.35, 0.01, 0.01]])
    far = np.array([[0.75, 0.02, 0.02]])
    for _ in range(seen):
        mapped.add_cloud(near, pin.SE3.Identity(), 0.0)
    for number in range(through):
        assert mapped.states(near).tolist() == [OCCUPIED], number
        mapped.add_cloud(far, pin.SE3.Identity(), 0.0)
    assert mapped.states(near).tolist() == [FREE]
    assert np.allclose(mapped.cells.points, [(0.75, 0.05, 0.05)])


def test_memory_of_years_and_of_milliseconds_does_not_overflow():
    mapped = small_map(forget=1e-3)
    point = np.array([[0.33, 0.21, -0.4]])
    for time in (0.0, 1e-4, 1.0, 1e9):
        mapped.add_cloud(point, None, time)
        assert mapped.states(point).tolist() == [OCCUPIED]
    mapped.advance(2e9)
    assert mapped.states(point).tolist() == [UNKNOWN]


def neighbours(cell: int) -> list[int]:
    x, y, z = cell // COUNT**2, cell // COUNT % COUNT, cell % COUNT
    beside = [(x + 1, y, z), (x - 1, y, z), (x, y + 1, z), (x, y - 1, z), (x, y, z + 1), (x, y, z - 1)]
    return [(i * COUNT + j) * COUNT + k for i, j, k in beside if min(i, j, k) >= 0 and max(i, j, k) < COUNT]


def test_a_map_of_an_arm_on_a_feed_reaches_as_far_as_the_arm_does():
    slide = pp.JointSpec("x", type="prismatic", lower=-0.1, upper=0.8)
    feed = pp.ModuleTemplate("Feed", joints=(slide,), link_lengths=(0.05,))
    arm = pp.Arm.from_modules([feed, *[pp.template("RyRz")] * 2])
    assert Map(0.1, arm).reach == pytest.approx(1.2 * (0.15 + 0.8))


@pytest.mark.parametrize("unknown", ["free", "forbidden"])
def test_cells_to_keep_clear_of_are_those_with_a_face_that_can_be_reached(unknown):
    rng = np.random.default_rng(7)
    mapped = small_map(unknown=unknown)
    block = CENTERS[np.abs(CENTERS - (0.3, 0.0, 0.0)).max(axis=1) < 0.26]
    mapped.add_cloud(block, None, 0.0)  # solid: its inside cannot be reached
    for _ in range(3):
        origin = rng.uniform(-0.7, -0.3, 3)
        mapped.add_cloud(rng.uniform(-0.79, 0.79, (40, 3)) - origin, pin.SE3(np.eye(3), origin), 0.0)
    states = mapped.states(CENTERS)
    if unknown == "free":
        kept = states == OCCUPIED
        reachable = [any(not kept[k] for k in neighbours(c)) for c in range(len(CENTERS))]
    else:
        kept = states != FREE
        reachable = [any(states[k] == FREE for k in neighbours(c)) for c in range(len(CENTERS))]
    expected = CENTERS[kept & np.array(reachable)]
    found = mapped.cells.points
    found = found[np.abs(found).max(axis=1) < 0.8]  # without those just outside
    assert len(np.unique(found.round(6), axis=0)) == len(found)
    assert {tuple(each) for each in found.round(6)} == {tuple(each) for each in expected.round(6)}


@pytest.mark.parametrize("unknown", ["free", "forbidden"])
def test_cells_deep_inside_are_left_out_of_a_map_of_many_blocks(unknown):
    side = (np.arange(48) + 0.5) * SIZE - 2.4
    centers = np.stack(np.meshgrid(side, side, side, indexing="ij"), axis=-1).reshape(-1, 3)
    arm = pp.Arm.from_template("RyRz", modules=4, link_lengths=(0.25, 0.25))
    mapped = Map(SIZE, arm, center=(0.5, 0.0, 0.0), reach=2.4, unknown=unknown)
    centers = centers + (0.5, 0.0, 0.0)
    if unknown == "forbidden":
        mapped.clear(arm.straight(), 0.75)
        holes = centers[np.random.default_rng(0).integers(0, len(centers), 50)]
        mapped.add_cloud(holes, None, 0.0, arm.straight())
    else:
        mapped.add_cloud(centers[np.linalg.norm(centers - 0.6, axis=1) < 1.7], None, 0.0, arm.straight())
    states = mapped.states(centers).reshape(48, 48, 48)
    kept = states == OCCUPIED if unknown == "free" else states != FREE
    open_side = np.pad(~kept, 1, constant_values=unknown == "free")
    beside = [np.roll(open_side, step, axis)[1:-1, 1:-1, 1:-1] for step in (1, -1) for axis in range(3)]
    expected = centers[(kept & np.any(beside, axis=0)).ravel()]
    found = mapped.cells.points
    assert len(found) == len(expected) > 1000
    assert {tuple(each) for each in found.round(6)} == {tuple(each) for each in expected.round(6)}


def an_arm() -> pp.Arm:
    return pp.Arm.from_template("RyRz", modules=4)


def capsule_distances(arm: pp.Arm, q: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Distances of points from the capsules around the bodies, placed by Pinocchio."""
    data = arm.model.createData()
    pin.forwardKinematics(arm.model, data, q)
    nearest = np.full(len(points), np.inf)
    for body in bodies_of(arm):
        solid = body.shape.solid()
        a, b = (data.oMi[body.joint].act(end) for end in (solid.start, solid.end))
        share = np.clip((points - a) @ (b - a) / ((b - a) @ (b - a)), 0.0, 1.0)
        gaps = np.linalg.norm(points - a - share[:, None] * (b - a), axis=1) - solid.radius
        nearest = np.minimum(nearest, gaps)
    return nearest


def test_the_own_points_of_the_measured_arm_are_left_out():
    arm = an_arm()
    rng = np.random.default_rng(2)
    for _ in range(5):
        q = 0.2 * arm.random(rng)
        points = arm.at(q).points[rng.integers(0, 4, 4000)] + rng.normal(size=(4000, 3)) * 0.03
        points = points[np.abs(points).max(axis=1) < 0.24]
        away = capsule_distances(arm, q, points)
        mount = np.linalg.norm(points, axis=1) < 0.06
        mapped = Map(0.002, arm, own_margin=0.008)
        mapped.add_cloud(points, None, 0.0, q)
        occupied = mapped.states(points) == OCCUPIED
        # A point that is left out may share a cell with one that is not.
        assert np.all(occupied[(away > 0.008) & ~mount])
        assert not np.any(occupied[away < 0.008 - 0.002 * math.sqrt(3.0)])
        alone = Map(0.002, arm, own_margin=0.008)
        own = points[(away < 0.008 - 1e-9) & ~mount]
        assert alone.add_cloud(own, None, 0.0, q) == len(own) > 100
        assert not len(alone.cells.points)


def test_stale_cells_within_the_measured_arm_are_free():
    arm = an_arm()
    q = arm.straight()
    mapped = Map(0.004, arm)
    beside = np.array([[0.121, 0.101, 0.001]])
    mapped.add_cloud(np.vstack([arm.at(q).points[2:3], beside]), None, 0.0, arm.straight() + 1.0)
    assert len(mapped.cells.points) == 2
    mapped.add_cloud(np.zeros((0, 3)), None, 0.1, q)
    assert mapped.states(arm.at(q).points[2:3]).tolist() == [FREE]
    assert mapped.states(beside).tolist() == [OCCUPIED]


def test_a_mounted_sensor_moves_with_the_arm_as_measured_then():
    arm = an_arm()
    rng = np.random.default_rng(5)
    start, end = arm.random(rng), arm.random(rng)
    mounting = Mounting(arm.tip, pin.SE3(pin.exp3(np.array([0.2, 0.4, -1.0])), np.array([0.02, 0.0, 0.01])))
    mapped = Map(0.005, arm, reach=1.0)
    mapped.measure(start, 10.0)
    mapped.measure(end, 10.1)
    between = mapped.configuration_at(10.025)
    assert np.allclose(arm.difference(start, between), 0.25 * arm.difference(start, end))
    assert np.array_equal(mapped.configuration_at(10.1), end)
    data = arm.model.createData()
    pin.framesForwardKinematics(arm.model, data, between)
    expected = data.oMf[arm.model.getFrameId(arm.tip, pin.FrameType.BODY)] * mounting.placement
    assert mapped.sensor_placement(mounting, between).isApprox(expected, 1e-12)
    mapped.add_cloud([(0.0, 0.0, 0.3)], mounting, 10.025)
    there = expected.act(np.array([0.0, 0.0, 0.3]))
    assert np.abs(mapped.cells.points - there).max() <= 0.0025 + 1e-12
    for time in (9.99, 10.11):
        with pytest.raises(InvalidValue, match=r"a time at which the arm is measured: from 10\.0 to 10\.1"):
            mapped.add_cloud([(0.0, 0.0, 0.3)], mounting, time)
    with pytest.raises(InvalidValue, match=r"time is 10.1; allowed: more than 10.1"):
        mapped.measure(end, 10.1)
    with pytest.raises(UnknownName, match="frame"):
        mapped.add_cloud([(0.0, 0.0, 0.3)], Mounting("nowhere", pin.SE3.Identity()), 10.05)


def test_clearing_around_the_arm():
    arm = an_arm()
    q = arm.random(3)
    mapped = Map(0.01, arm, unknown="forbidden")
    points = arm.at(q).points[-1] + np.random.default_rng(0).uniform(-0.1, 0.1, (3000, 3))
    assert not mapped.states(points).any()
    mapped.clear(q, 0.04)
    away = capsule_distances(arm, q, points)
    states = mapped.states(points)
    assert np.all(states[away < 0.04 - 0.0087] == FREE)
    assert not np.any(states[away > 0.04 + 0.0087])
    scene = pp.Scene({"map": mapped.cells}, self_collision=False)
    assert CollisionModel(arm, scene).minimum(q).distance > 0.02


def test_distances_are_those_from_balls_around_cells():
    arm = an_arm()
    rng = np.random.default_rng(8)
    mapped = Map(0.01, arm)
    scene = pp.Scene({"map": mapped.cells}, self_collision=False)
    assert CollisionModel(arm, scene).minimum(arm.straight()).distance > 1e4
    for number in (1, 5, 90, 1500):
        mapped.add_cloud(rng.uniform(-0.24, 0.24, (number, 3)), None, 0.0, arm.straight())
        scene = scene.updated({"map": mapped.cells})
        model = CollisionModel(arm, scene)
        for _ in range(10):
            q = arm.random(rng)
            closest = model.minimum(q)
            expected = capsule_distances(arm, q, mapped.cells.points).min() - 0.005 * math.sqrt(3.0)
            assert closest.distance == pytest.approx(expected, abs=1e-12) or (
                closest.distance < 0.0 and expected < 0.0
            )
            state = arm.at(q)
            near = model.nearest(state, 0.05)
            for row in np.flatnonzero(near.distances > 1e-3)[:3]:
                step = 1e-6 * rng.normal(size=arm.nv)
                ends = [model.nearest(arm.at(arm.integrate(q, sign * step)), 1.0) for sign in (-1, 1)]
                pairs = [each.distances[each.numbers == near.numbers[row]][0] for each in ends]
                assert near.jacobian[row] @ step == pytest.approx((pairs[1] - pairs[0]) / 2.0, abs=1e-9)


def test_a_scene_takes_the_latest_cells_of_its_maps():
    mapped = small_map()
    ball = pp.Sphere((0.0, 0.0, 2.0), 0.1)
    scene = pp.Scene({"map": mapped.cells, "ball": ball}, margin=0.01)
    mapped.add_cloud([(0.31, 0.02, 0.03)], None, 0.0)
    later = scene.updated({"map": mapped.cells})
    assert later.obstacles["map"] is mapped.cells and later.obstacles["ball"] is ball
    assert later.first is scene and scene.moving == later.moving == {"map"}
    assert not later.has_maps_of(scene) and later.has_maps_of(later.moved({"ball": (0, 0, 1)}))
    assert later.displacement(scene, 1.0) == math.inf and later.displacement(later, 1.0) == 0.0
    again = later.moved({"ball": (0.0, 0.0, 0.5)}, {"ball": (0.0, 0.0, 0.1)})
    assert again.obstacles["map"] is mapped.cells
    assert again.after(1.0).obstacles["map"] is mapped.cells
    with pytest.raises(UnknownName, match="map"):
        scene.updated({"ball": mapped.cells})
    with pytest.raises(InvalidValue, match="the cells of a map"):
        scene.updated({"map": ball})
    with pytest.raises(InvalidValue, match=r"a radius of 86\.6 mm, as at first"):
        scene.updated({"map": Map(0.2, reach=1.0).cells})


def test_a_scene_with_a_map_is_written_as_one_with_a_scan():
    mapped = small_map()
    for points in ([], [(0.31, 0.02, 0.03)]):
        mapped.add_cloud(np.reshape(points, (-1, 3)), None, 0.0)
        scene = pp.Scene({"map": mapped.cells})
        read = pp.Scene.from_dict(scene.to_dict()).obstacles["map"]
        assert type(read) is pp.Scan and read.point_radius == mapped.cells.point_radius
        if len(points):
            assert np.array_equal(read.points, mapped.cells.points)
        assert np.abs(read.points).max() < (1.0 if len(points) else 1e5)


def test_a_map_goes_on_after_it_was_saved(tmp_path):
    arm = an_arm()
    rng = np.random.default_rng(3)
    mapped = Map(0.02, arm, forget=2.0, own_margin=0.004, unknown="forbidden", sensor_range=(0.1, 2.0))
    for number in range(4):
        origin = np.array([0.1 * number, 0.0, 0.2])
        points = rng.uniform(-0.25, 0.25, (50, 3))
        mapped.add_cloud(points - origin, pin.SE3(np.eye(3), origin), 0.2 * number, arm.straight())
    loaded = pp.load(pp.save(mapped, tmp_path / "room"), Map)
    where = rng.uniform(-0.3, 0.3, (5000, 3))
    points = rng.uniform(-0.25, 0.25, (50, 3))
    for time in (0.6, 0.9, 2.0, 20.0):
        for each in (mapped, loaded):
            each.add_cloud(points, pin.SE3.Identity(), time, arm.straight())
        assert np.array_equal(loaded.states(where), mapped.states(where))
        assert np.array_equal(loaded.cells.points, mapped.cells.points)
    for name in ("resolution", "center", "reach", "own_margin", "forget", "unknown", "sensor_range", "time"):
        assert getattr(loaded, name) == getattr(mapped, name)
    assert loaded.arm.name == arm.name
    with pytest.raises(FileError, match="allowed: 'pinposture-run' version"):
        pp.load(tmp_path / "room.npz", pp.Run)


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: Map(0.0, reach=1.0), "resolution is 0.0"),
        (lambda: Map(0.01), "reach is not given; allowed: half the width of the map"),
        (
            lambda: Map(1e-4, reach=2.0),
            "resolution is 0.0001; allowed: at least 0.0062 m with a reach of 2 m",
        ),
        (lambda: Map(1e-9, reach=1e3), "reach is 1000.0; allowed: less"),
        (lambda: Map(0.01, reach=1.0, unknown="open"), "unknown"),
        (lambda: Map(0.01, reach=1.0, forget=0.0), "forget is 0.0"),
        (lambda: Map(0.01, reach=1.0, sensor_range=(2.0, 1.0)), "sensor_range is (2.0, 1.0)"),
        (lambda: Map(0.01, reach=1.0, own_margin=-0.1), "own_margin is -0.1"),
        (lambda: Map(0.01, "arm"), "arm is 'arm'"),
        (lambda: small_map().measure([0.0], 0.0), "arm is not given; allowed: a map that knows the arm"),
        (lambda: small_map().add_cloud([(0, 0)], None, 0.0), "points (shape) is (1, 2)"),
        (lambda: small_map().add_cloud([(0, 0, 0)], None, math.nan), "time is nan"),
        (lambda: small_map().add_cloud([(0, 0, 0)], None, 0.0, [0.0]), "q is [0.0]; allowed: None"),
        (lambda: small_map().add_cloud([(0, 0, 0)], 3, 0.0), "sensor is 3"),
        (lambda: small_map().add_depth([1.0], CAMERA, pin.SE3.Identity(), 0.0), "depth (shape) is (1,)"),
        (lambda: small_map().add_depth([[1.0]], (1, 1, 0, 0), pin.SE3.Identity(), 0.0), "camera is"),
        (
            lambda: small_map().add_depth([[1.0]], Intrinsics(0, 1, 0, 0), pin.SE3.Identity(), 0.0),
            "allowed: focal lengths above 0",
        ),
        (lambda: small_map().states([(0.0, math.inf, 0.0)]), "points"),
        (
            lambda: Map(0.01, an_arm()).add_cloud([(0, 0, 0)], None, 0.0),
            "time is 0.0; allowed: a time at which",
        ),
    ],
)
def test_what_a_map_refuses(make, words):
    with pytest.raises(pp.PostureError) as caught:
        make()
    assert words in str(caught.value)


def test_what_is_not_finite_is_no_point():
    mapped = small_map()
    points = [(np.nan, 0.0, 0.0), (0.1, np.inf, 0.0), (0.31, 0.02, 0.03)]
    mapped.add_cloud(points, pin.SE3.Identity(), 0.0)
    assert np.allclose(mapped.cells.points, [(0.35, 0.05, 0.05)])
    assert isinstance(mapped.cells, Cells) and "1 cells" in repr(mapped.cells)
    assert "1.6 m in cells of 0.1 m, 1 on surfaces" in repr(mapped)
