"""The clearance of an arm from a scan against brute force over all points and triangles."""

from __future__ import annotations

import gc
import threading
import weakref

import numpy as np
import pinocchio as pin
import pytest
import trimesh
from collision.arms_with_bodies import ARMS, described, geometry, single, spatial
from collision.scans_by_hand import brute_force, hull_distance, local_bodies, point_distance

import pinposture as pp
from pinposture.collision import Box, Scan, ScanClearance
from pinposture.errors import InvalidValue

BALL = geometry('<sphere radius="0.04"/>', "0.1 0 0.01")


def hulls(folder):
    """An arm whose links are wedges from a file, and balls."""
    wedge = trimesh.Trimesh([[0, 0, 0], [0.15, 0, 0], [0.1, 0.06, 0], [0.05, 0.01, 0.05], [0.12, 0, -0.04]])
    wedge.convex_hull.export(folder / "wedge.stl")
    text = described([geometry(f'<mesh filename="{folder / "wedge.stl"}"/>'), BALL] * 3)
    return pp.Arm.from_urdf(text, modules=2)


@pytest.fixture(params=[*ARMS, "hulls"])
def arm(request, tmp_path):
    return hulls(tmp_path) if request.param == "hulls" else ARMS[request.param]()


def cloud(arm, rng, count=150, spread=0.5):
    return Scan(arm.chain.base + rng.normal(size=(count, 3)) * spread * arm.length)


def shards(arm, rng, count=40, size=0.1):
    """Triangles here and there, large ones and small ones."""
    places = arm.chain.base + rng.normal(size=(count, 1, 3)) * 0.6 * arm.length
    sizes = size * arm.length * 10.0 ** rng.uniform(-1.5, 0.5, (count, 1, 1))
    points = (places + rng.normal(size=(count, 3, 3)) * sizes).reshape(-1, 3)
    return Scan(points, np.arange(3 * count).reshape(-1, 3))


def check_points(arm, q, gap, arm_radius=None):
    """What is said of where agrees with the distance: on the body's surface, and on the scan."""
    if gap.distance == 0.0:  # how deep they overlap is not told
        assert np.all(np.isfinite([gap.on_arm, gap.on_scan]))
        return
    apart = np.linalg.norm(gap.on_arm - gap.on_scan)
    assert apart == pytest.approx(abs(gap.distance), abs=1e-7)
    named = [(b.shape, place) for b, place in local_bodies(arm, q, arm_radius) if b.name == gap.body]
    on_arm = [point_distance(place.actInv(gap.on_arm), shape) for shape, place in named]
    on_scan = [point_distance(place.actInv(gap.on_scan), shape) for shape, place in named]
    assert min(np.abs(on_arm)) < 1e-7
    assert min(on_scan) == pytest.approx(gap.distance, abs=1e-7)


def test_the_nearest_of_all_points_is_found(arm):
    rng = np.random.default_rng(0)
    inside = 0
    for spread in (0.3, 0.5, 3.0):
        scan = cloud(arm, rng, spread=spread)
        clearance = ScanClearance(arm, scan)
        for _ in range(3):
            q = arm.random(rng)
            gap = clearance.minimum(q)
            distance, _ = brute_force(arm, q, scan, without=[each.first for each in clearance.excluded_pairs])
            assert gap.distance == pytest.approx(max(distance, 0.0), abs=1e-7)
            assert np.linalg.norm(scan.points - gap.on_scan, axis=1).min() < 1e-9
            check_points(arm, q, gap)
            if gap.distance == 0.0:
                named = [(b.shape, place) for b, place in local_bodies(arm, q) if b.name == gap.body]
                assert min(point_distance(p.actInv(gap.on_scan), shape) for shape, p in named) <= 1e-7
            inside += gap.distance == 0.0
    assert inside < 9


def test_the_nearest_of_all_triangles_is_found(arm):
    rng, apart = np.random.default_rng(1), 0
    # Capsules stand in for what has cylinders: of these more below.
    kinds = {body.shape.type for body, _ in local_bodies(arm, arm.neutral())}
    radius = 0.01 if "cylinder" in kinds else None
    for _ in range(4):
        scan = shards(arm, rng)
        clearance = ScanClearance(arm, scan, radius)
        for _ in range(3):
            q = arm.random(rng)
            gap = clearance.minimum(q)
            without = [each.first for each in clearance.excluded_pairs]
            distance, _ = brute_force(arm, q, scan, radius, without)
            assert gap.distance == pytest.approx(max(distance, 0.0), abs=1e-6)
            apart += gap.distance > 0.0
            check_points(arm, q, gap, radius)
    assert apart >= 3


@pytest.mark.parametrize("shape", ['<box size="0.3 0.2 0.1"/>', '<cylinder radius="0.07" length="0.3"/>'])
def test_triangles_in_and_around_a_body_that_is_not_round(shape):
    arm, rng, sides = single(shape, xyz="0.1 0.05 0", rpy="0.3 0.2 0.1"), np.random.default_rng(2), [0, 0]
    share = np.array([(u, v) for u in np.linspace(0, 1, 33) for v in np.linspace(0, 1, 33) if u + v <= 1])
    (body, place) = next((b, p) for b, p in local_bodies(arm, arm.neutral()))
    for _ in range(20):
        size = rng.uniform(0.02, 0.4)
        triangle = np.array([0.1, 0.05, 0]) + rng.normal(size=3) * 0.15 + rng.normal(size=(3, 3)) * size
        gap = ScanClearance(arm, Scan(triangle, [[0, 1, 2]])).minimum(arm.neutral())
        sampled = triangle[0] + share @ (triangle[1:] - triangle[0])
        least = min(point_distance(place.actInv(point), body.shape) for point in sampled)
        spacing = np.ptp(triangle, axis=0).max() / 32 * 1.5
        assert max(least - spacing, 0.0) <= gap.distance <= max(least, 0.0) + 1e-9
        sides[int(gap.distance == 0.0)] += 1
        check_points(arm, arm.neutral(), gap)
    assert min(sides) >= 3


def test_points_all_around_a_hull_that_are_almost_equally_far(tmp_path):
    corners = np.array([[0, 0, 0], [0.3, 0, 0], [0.2, 0.12, 0], [0.1, 0.02, 0.1], [0.24, 0, -0.08]])
    trimesh.Trimesh(corners).convex_hull.export(tmp_path / "wedge.stl")
    arm, rng = single(f'<mesh filename="{tmp_path / "wedge.stl"}"/>', xyz="0 0 0"), np.random.default_rng(8)
    (body, place) = local_bodies(arm, arm.neutral())[0]
    for distance in (1e-3, 0.01, 0.1):
        ways = rng.normal(size=(200, 3))
        ways /= np.linalg.norm(ways, axis=1)[:, None]
        starts = corners[np.argmax(ways @ corners.T, axis=1)]  # the corner that is farthest that way
        points = starts + ways * distance * rng.uniform(1.0, 1.02, (200, 1))
        least = min(point_distance(place.actInv(point), body.shape) for point in points)
        gap = ScanClearance(arm, Scan(points)).minimum(arm.neutral())
        assert gap.distance == pytest.approx(least, abs=1e-8)
        corners_of = points[:, None] + rng.normal(size=(200, 3, 3)) * 0.3 * distance
        least = min(hull_distance(each, corners) for each in corners_of)
        triangles = ScanClearance(arm, Scan(corners_of.reshape(-1, 3), np.arange(600).reshape(-1, 3)))
        assert least > 0.0 and triangles.minimum(arm.neutral()).distance == pytest.approx(least, abs=1e-7)


@pytest.mark.parametrize(
    "shape",
    [
        '<box size="0.2 0.4 0.6"/>',
        '<capsule radius="0.1" length="0.3"/>',
        '<cylinder radius="0.1" length="0.5"/>',
    ],
)
def test_a_floor_through_a_body_is_at_no_distance_and_one_beside_it_at_its_own(shape):
    arm = single(shape)  # with its middle at (0.5, 0, 0), its axis along z
    for height in (0.0, 0.1, -0.24):
        gap = ScanClearance(arm, Scan([(-9, -9, height), (9, -9, height), (0, 9, height)], [[0, 1, 2]]))
        found = gap.minimum(arm.neutral())
        assert found.distance == 0.0 and found.on_scan[2] == pytest.approx(height, abs=1e-9)
        (body, place) = local_bodies(arm, arm.neutral())[0]
        assert point_distance(place.actInv(found.on_arm), body.shape) == pytest.approx(0.0, abs=1e-9)
        dot = ScanClearance(arm, Scan([(0.5, 0.03, height), (0.5, 3.0, 0)])).minimum(arm.neutral())
        assert dot.distance == 0.0 and dot.on_scan == pytest.approx([0.5, 0.03, height], abs=0.0)
    beside = ScanClearance(arm, Scan([(0.65, -9, -9), (0.65, 9, -9), (0.65, 0, 9)], [[0, 1, 2]]))
    assert beside.minimum(arm.neutral()).distance == pytest.approx(0.05, abs=1e-9)


def test_a_fine_surface_and_its_two_triangles_are_equally_far():
    arm, rng = spatial(5), np.random.default_rng(3)
    corner = arm.chain.base - [0.4, 0.4, 0.2]
    u, v = np.array([0.9, 0.1, 0.2]), np.array([0, 0.8, 0.1])
    grid = np.linspace(0, 1, 41)
    points = np.array([corner + x * u + y * v for x in grid for y in grid])
    at = np.arange(41 * 41).reshape(41, 41)
    faces = np.concatenate(
        [
            np.stack([at[:-1, :-1], at[1:, :-1], at[:-1, 1:]], axis=-1).reshape(-1, 3),
            np.stack([at[1:, 1:], at[:-1, 1:], at[1:, :-1]], axis=-1).reshape(-1, 3),
        ]
    )
    fine = ScanClearance(arm, Scan(points, faces))
    coarse = ScanClearance(
        arm, Scan([corner, corner + u, corner + v, corner + u + v], [[0, 1, 2], [3, 2, 1]])
    )
    dots = ScanClearance(arm, Scan(points))
    for _ in range(10):
        q = arm.random(rng)
        one, other, third = (each.minimum(q) for each in (fine, coarse, dots))
        assert one.distance == pytest.approx(other.distance, abs=2e-5)
        assert one.distance <= third.distance + 1e-12


def test_many_points_are_told_as_few_are():
    arm, rng = spatial(10), np.random.default_rng(4)
    scan = cloud(arm, rng, 20_000, 1.0)
    scan = Scan(scan.points[np.linalg.norm(scan.points - arm.chain.base, axis=1) > 0.03])
    clearance = ScanClearance(arm, scan, 0.01)
    for _ in range(5):
        q = arm.random(rng)
        least = np.inf
        for body, place in local_bodies(arm, q, 0.01):
            start, end = (place.act(np.array(each)) for each in (body.shape.start, body.shape.end))
            along = np.clip((scan.points - start) @ (end - start) / ((end - start) @ (end - start)), 0, 1)
            gaps = np.linalg.norm(scan.points - start - along[:, None] * (end - start), axis=1)
            least = min(least, max(gaps.min() - 0.01, 0.0))
        assert clearance.excluded_pairs == () and clearance.minimum(q).distance == pytest.approx(
            least, abs=1e-9
        )


@pytest.mark.parametrize("count", [1, 2, 5, 16, 17, 33, 129, 1000])
def test_scans_of_any_number_of_points(count):
    arm, rng = spatial(2), np.random.default_rng(count)
    scan = cloud(arm, rng, count, 1.0)
    q = arm.random(rng)
    clearance = ScanClearance(arm, scan)
    distance, _ = brute_force(arm, q, scan, without=[each.first for each in clearance.excluded_pairs])
    assert clearance.minimum(q).distance == pytest.approx(max(distance, 0.0), abs=1e-9)


def test_points_that_are_one_point_and_points_on_a_line():
    arm = spatial(3)
    far = arm.chain.base + [0.3, 0.3, 0.3]
    q = arm.random(np.random.default_rng(0))
    one = ScanClearance(arm, Scan([far])).minimum(q)
    assert ScanClearance(arm, Scan([far] * 100)).minimum(q).distance == pytest.approx(one.distance, abs=1e-12)
    line = Scan(far + np.linspace(0, 1, 500)[:, None] * [1, 2, 3])
    assert ScanClearance(arm, line).minimum(q).distance <= one.distance
    flat = Scan([far, far, far + [0, 0, 1]], [[0, 0, 0], [0, 1, 2]])  # triangles without an area
    distance = brute_force(arm, q, Scan([far + [0, 0, z] for z in np.linspace(0, 1, 2001)]))[0]
    assert ScanClearance(arm, flat).minimum(q).distance == pytest.approx(distance, abs=1e-5)


def test_the_radius_of_stand_ins_is_that_which_was_asked_for():
    arm, rng = ARMS["described"](), np.random.default_rng(5)
    scan, q = cloud(arm, rng), arm.random(rng)
    for radius in (0.003, 0.02):
        clearance = ScanClearance(arm, scan, radius)
        without = [each.first for each in clearance.excluded_pairs]
        distance, _ = brute_force(arm, q, scan, radius, without)
        assert clearance.minimum(q).distance == pytest.approx(max(distance, 0.0), abs=1e-9)
        assert ScanClearance(arm, scan, radius) is clearance
    for wrong in (0.0, -1.0, np.nan, "thin"):
        with pytest.raises(InvalidValue, match="arm_radius"):
            ScanClearance(arm, scan, wrong)


def test_what_the_arm_stands_on_is_left_out_and_said():
    place = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.7]))
    arm = pp.Arm.from_template("RyRz", 4, (0.1, 0.1), base_placement=place)
    table = Scan([(-1, -1, 0.695), (1, -1, 0.695), (1, 1, 0.695), (-1, 1, 0.695)], [[0, 1, 2], [0, 2, 3]])
    clearance = ScanClearance(arm, table)
    assert [(each.first, each.second) for each in clearance.excluded_pairs] == [("m01_l1", "scan")]
    assert "m01_l1" not in clearance.bodies and len(clearance.bodies) == 7
    bent = arm.configuration([0.0, 0.0, -1.2, 0.0, 0.0, 0.0, 0.0, 0.0])  # up, and so clear of the table
    assert clearance.minimum(bent).distance > -0.02
    radius = local_bodies(arm, bent)[0][0].shape.radius
    for below, left in ((0.009, ["m01_l1"]), (0.011, [])):
        corners = table.points * [1, 1, 0] + [0, 0, 0.7 - radius - below]
        there = ScanClearance(arm, Scan(corners, table.faces))
        assert [each.first for each in there.excluded_pairs] == left


def test_bodies_of_the_base_are_left_out():
    text = described(["", BALL], base=geometry('<box size="1 1 1"/>'))
    arm = pp.Arm.from_urdf(text, modules=2)
    clearance = ScanClearance(arm, Scan([(0.1, 0.0, 0.3)]))
    assert (
        clearance.excluded_pairs[0][:2] == ("l0", "scan") and "no joint" in clearance.excluded_pairs[0].reason
    )


def test_an_arm_of_which_nothing_is_left_is_infinitely_far():
    arm = pp.Arm.from_urdf(described([""]), modules=1)
    clearance = ScanClearance(arm, Scan([(0.0, 0.0, 0.005)]))
    assert clearance.bodies == () and len(clearance.excluded_pairs) == 1
    assert clearance.minimum(arm.neutral()) == (np.inf, None, None, None)


def test_moving_arm_and_scan_together_changes_nothing():
    rng = np.random.default_rng(6)
    move = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.0, 2.0), np.array([3.0, -2.0, 5.0]))
    arm = pp.Arm.from_template("RyRz", 6, (0.04, 0.05))
    moved = pp.Arm.from_template("RyRz", 6, (0.04, 0.05), base_placement=move)
    for scan in (cloud(arm, rng, 500), shards(arm, rng, 100)):
        there = Scan(scan.points @ move.rotation.T + move.translation, scan.faces)
        one, other = ScanClearance(arm, scan), ScanClearance(moved, there)
        for _ in range(5):
            q = arm.random(rng)
            assert one.minimum(q).distance == pytest.approx(other.minimum(q).distance, abs=1e-6)


def test_threads_may_share_one():
    arm, rng = spatial(8), np.random.default_rng(7)
    clearance = ScanClearance(arm, cloud(arm, rng, 5000, 1.0))
    configurations = [arm.random(rng) for _ in range(30)]
    alone = [clearance.minimum(q).distance for q in configurations]
    found = [[], [], []]

    def work(into):
        into += [clearance.minimum(q).distance for q in configurations]

    threads = [threading.Thread(target=work, args=(each,)) for each in found]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert found == [alone] * 3


def test_what_is_remembered_is_forgotten_with_the_scan_and_the_arm():
    arm, scan = spatial(2), Scan([(1.0, 1.0, 1.0)])
    assert ScanClearance(arm, scan) is ScanClearance(arm, scan)
    watched = weakref.ref(scan), weakref.ref(arm)
    del scan
    gc.collect()
    assert watched[0]() is None and watched[1]() is arm
    del arm
    gc.collect()
    assert watched[1]() is None


def test_wrong_input_is_named():
    arm, scan = spatial(2), Scan([(1.0, 1.0, 1.0)])
    with pytest.raises(InvalidValue, match="q"):
        ScanClearance(arm, scan).minimum([0.0])
    with pytest.raises(InvalidValue, match=r"q\[1\] is nan"):
        ScanClearance(arm, scan).minimum([0.0, np.nan, 0.0, 0.0])
    with pytest.raises(InvalidValue, match="an Arm"):
        ScanClearance("arm", scan)
    with pytest.raises(InvalidValue, match="a Scan"):
        ScanClearance(arm, Box((0, 0, 0), (1, 1, 1)))
