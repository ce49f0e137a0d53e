"""Runs of arms past scans: what was scanned is cleared by sampling, not by the distances of the package."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from sampling import cases, seeds
from scipy.spatial import cKDTree

import pinposture as pp
from pinposture.collision import pipe_axis
from pinposture.collision.bodies import bodies_of


def tube(axis, radius, rings=200, sides=32):
    """The wall of a pipe about a curve: points in rings, and the triangles between them."""
    middle = axis.resample(rings)
    along = np.gradient(middle, axis=0)
    along /= np.linalg.norm(along, axis=1)[:, None]
    angles = 2.0 * np.pi * np.arange(sides) / sides
    side = np.cross(along[0], np.eye(3)[np.argmin(np.abs(along[0]))])
    points = []
    for place, way in zip(middle, along, strict=True):
        side = side - way * (side @ way)
        side /= np.linalg.norm(side)
        other = np.cross(way, side)
        points.append(place + radius * (np.outer(np.cos(angles), side) + np.outer(np.sin(angles), other)))
    ring, corner = (each.ravel() for each in np.indices((rings - 1, sides)))
    a = ring * sides + corner
    b = ring * sides + (corner + 1) % sides
    return np.vstack(points), np.vstack(
        [np.stack([a, b, a + sides], 1), np.stack([b, b + sides, a + sides], 1)]
    )


def dense_points(points, faces, spacing):
    """Points on triangles, no farther apart than that."""
    corners = points[faces]
    count = int(np.ceil(np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max() / spacing)) + 1
    shares = [(u, v) for u in np.linspace(0, 1, count) for v in np.linspace(0, 1, count) if u + v <= 1 + 1e-9]
    edges = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    return np.vstack([corners[:, 0] + u * edges[0] + v * edges[1] for u, v in shares])


SEEN = 0.05
"""Farther than that, nothing is looked for [m]."""


def least_clearance(arm, q, tree, between=2):
    """Of an arm of capsules from points, on a run and between its steps, by points on the axes."""
    least = np.inf
    shares = np.linspace(0, 1, 25)[:, None]
    parts = np.arange(between) / between
    rows = [a + part * (b - a) for a, b in pairwise(q) for part in parts]
    bodies = [body for body in bodies_of(arm) if body.joint]
    ends = [np.array([body.shape.start, body.shape.end]) for body in bodies]
    radii = np.array([body.shape.radius for body in bodies])
    data = arm.model.createData()
    for row in [*rows, q[-1]]:
        pin.forwardKinematics(arm.model, data, row)
        places = [data.oMi[body.joint] for body in bodies]
        axes = np.array(
            [each @ place.rotation.T + place.translation for each, place in zip(ends, places, strict=True)]
        )
        samples = axes[:, :1] + shares * (axes[:, 1:] - axes[:, :1])
        least = min(least, (tree.query(samples, distance_upper_bound=SEEN)[0].min(axis=1) - radii).min())
    return least


PIPE = 0.024  # with an arm of 1 cm radius


@pytest.fixture(scope="module")
def crawl():
    """An arm on a feed, and how it follows the axis of a pipe with a bend."""
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=0.6, velocity=0.1)
    feed = pp.ModuleTemplate("Feed", joints=(slide,), link_lengths=(0.05,))
    arm = pp.Arm.from_modules([feed, *[pp.template("RyRz")] * 10])
    reference = pp.follow_leader(arm, pipe_axis((0.1, 0.1), [(0.2, np.pi / 2)]), interval=0.2, speed=0.05)
    return arm, reference, *tube(reference.waypoints[-1].target.curve, PIPE)


@pytest.mark.long
@pytest.mark.parametrize("kind", cases(["surface", "cloud", "mesh"], 2))
def test_an_arm_follows_a_curve_through_a_bent_pipe(crawl, kind):
    arm, reference, points, faces = crawl
    pipe = {
        "surface": lambda: pp.Scan(points, faces),
        "cloud": lambda: pp.Scan(points),
        "mesh": lambda: pp.Mesh(points, faces=faces),
    }[kind]()
    margin = 0.01
    scene = pp.Scene({"pipe": pipe}, margin=margin)
    limits = pp.Limits(dt=0.2, acceleration=2.0)
    motion = pp.perform(reference, "geodesic", limits, scene=scene)
    assert motion.run.status == "converged"
    assert not pp.CollisionModel(arm, scene.without_self_collision()).excluded_pairs
    spacing = 0.004
    wall = points if kind == "cloud" else dense_points(points, faces, spacing)
    least = least_clearance(arm, motion.run.q, cKDTree(wall), between=1)
    assert margin - 1e-6 <= least < PIPE - 0.01
    # As far as is told, but for the spacing of the samples.
    assert motion.run.clearance.min() - 1e-9 <= least < motion.run.clearance.min() + spacing**2 / margin


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:the way to 'inside'")  # it says that the arm has to leave its path
def test_an_arm_in_a_pipe_that_is_aside_keeps_off_the_wall(crawl):
    """The pipe is nearer to the path than the margin on one side, and so the arm goes through farther in."""
    arm, reference, points, faces = crawl
    shift = np.array([0.0, 0.0, 0.006])
    limits = pp.Limits(dt=0.2, acceleration=2.0)
    beyond = points[:, 0] > points[:, 0].min() + 0.2  # the arm is clear where it starts
    points = points + shift
    faces = faces[beyond[faces].all(axis=1)]
    margin = 0.0085
    freely = pp.perform(reference, "geodesic", limits).run.q
    for scan, seen in (
        (pp.Scan(points[beyond]), points[beyond]),
        (pp.Scan(points, faces), dense_points(points, faces, 0.004)),
    ):
        motion = pp.perform(reference, "geodesic", limits, scene=pp.Scene({"pipe": scan}, margin=margin))
        tree = cKDTree(seen)
        assert least_clearance(arm, motion.run.q, tree, between=2) >= margin - 1e-6
        assert least_clearance(arm, freely, tree, between=1) < margin - 1e-4


def machine(rng):
    """A column with an arm over a table, as a scanner sees them: points on all faces, with noise."""
    boxes = [
        ((0.35, 0.3, 0.0), (0.1, 0.1, 0.8)),
        ((0.35, 0.0, 0.25), (0.12, 0.5, 0.1)),
        ((0.5, 0, -0.4), (0.9, 0.9, 0.02)),
    ]
    points = []
    for center, size in boxes:
        on = rng.uniform(-0.5, 0.5, (8000, 3))
        axis = rng.integers(0, 3, 8000)
        on[np.arange(8000), axis] = np.sign(on[np.arange(8000), axis]) * 0.5
        points.append(center + on * size + rng.normal(size=(8000, 3)) * 3e-4)
    return np.vstack(points)


@pytest.mark.long
@pytest.mark.parametrize("seed", seeds(5))
def test_a_run_past_a_scanned_machine_keeps_the_margin(seed):
    arm = pp.Arm.from_template("RyRz", 10, (0.04, 0.04))
    rng = np.random.default_rng(seed)
    points = machine(rng)
    scene = pp.Scene({"machine": pp.Scan(points)}, margin=0.01)
    tree = cKDTree(points)
    model = pp.CollisionModel(arm, scene)
    # From below the arm of the machine to before it: bent upwards, or sideways, about so much in all.
    start, goal = (np.tile(bend, 10) / 10 for bend in rng.normal([(0.0, -0.3), (-3.0, 0.0)], 0.1))
    assert min(model.minimum(q).distance for q in (start, goal)) > 0.012
    target = pp.Target.from_configuration(arm, goal)
    limits = pp.Limits(step=0.1)
    run = pp.track(arm, target, start, scene=scene, limits=limits)
    assert run.status == "converged"
    assert least_clearance(arm, run.q, tree) >= 0.01 - 1e-6
    assert least_clearance(arm, pp.track(arm, target, start, limits=limits).q, tree) < 0.01
