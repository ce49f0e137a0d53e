"""A pipe of boxes: free inside, closed all around, and its axis made of runs and bends."""

from __future__ import annotations

import numpy as np
import pytest
from sampling import cases

from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scene, Sphere
from pinposture.collision.pipe import Bend, pipe, pipe_axis, pipe_walls
from pinposture.curve import Curve
from pinposture.errors import InvalidValue

RADIUS = 0.045
QUARTER = np.pi / 2
AXES = {
    "straight": lambda: Curve.line((0, 0, 0), (0.3, 0.2, 0.1)),
    "two bends": lambda: pipe_axis((0.1, 0.1, 0.05), [(0.25, QUARTER), (0.25, QUARTER, QUARTER)]),
    "tight": lambda: pipe_axis((0.02, 0.02), [(0.08, 2.0, 0.3)]),
    "helix": lambda: Curve.helix(0.1, 0.2, 1.5),
}


@pytest.fixture(params=AXES, scope="module")
def axis(request):
    return AXES[request.param]()


def distances(walls, points):
    """Of points from the nearest box, (n,); negative inside of one. By the definition of a box."""
    nearest = np.full(len(points), np.inf)
    for box in walls.values():
        inside = np.abs((points - box.center) @ np.array(box.rotation)) - np.array(box.size) / 2
        away = np.linalg.norm(np.maximum(inside, 0.0), axis=1) + np.minimum(inside.max(axis=1), 0.0)
        nearest = np.minimum(nearest, away)
    return nearest


def hits(walls, points, directions, reach):
    """Whether rays of that length hit a box, by the slab method."""
    hit = np.zeros(len(points), dtype=bool)
    for box in walls.values():
        turn = np.array(box.rotation)
        half = np.array(box.size) / 2
        origin = (points - box.center) @ turn
        along = directions @ turn
        with np.errstate(divide="ignore"):
            sides = np.sort(np.stack([(-half - origin) / along, (half - origin) / along]), axis=0)
        first = sides[0].max(axis=1)
        last = sides[1].min(axis=1)
        hit |= (first <= last) & (last >= 0.0) & (first <= reach)
    return hit


@pytest.mark.parametrize("sides", [6, 9])
def test_walls_are_a_radius_away(axis, sides):
    walls = pipe_walls(axis, RADIUS, sides)
    found = distances(walls, axis.resample(1500))
    assert found.min() > 0.99 * RADIUS
    assert found.max() < 1.01 * RADIUS


@pytest.mark.long
@pytest.mark.parametrize("sides", cases([7, 6], quick=1))
def test_no_ray_gets_out(axis, sides):
    walls = pipe_walls(axis, RADIUS, sides)
    rng = np.random.default_rng(0)
    s = rng.uniform(0.0, axis.length, 8_000)
    tangents = axis.tangent(s)
    across = np.cross(tangents, rng.normal(size=(len(s), 3)))
    across /= np.linalg.norm(across, axis=1)[:, None]
    corner = RADIUS / np.cos(np.pi / sides)
    assert np.all(hits(walls, axis.at(s), across, 1.05 * corner))


def test_a_straight_run_is_one_ring_and_bends_are_few():
    assert len(pipe_walls(AXES["straight"](), RADIUS, 6)) == 6
    names = list(pipe_walls(AXES["two bends"](), RADIUS, 6))
    assert len(names) <= 150
    assert names[:2] == ["pipe 1.1", "pipe 1.2"]


def test_the_axis_is_made_of_runs_and_arcs():
    axis = pipe_axis((0.1, 0.2, 0.05), [Bend(0.25, QUARTER), Bend(0.1, np.pi / 3, -QUARTER)])
    assert axis.length == pytest.approx(0.35 + 0.25 * QUARTER + 0.1 * np.pi / 3, abs=1e-5)
    # To the left about (0.1, 0.25), along +y, then down about the point 0.1 below.
    assert axis.at(0.05) == pytest.approx((0.05, 0, 0), abs=1e-5)
    first = axis.at(np.linspace(0.13, 0.1 + 0.25 * QUARTER - 0.03, 50))
    assert np.linalg.norm(first - (0.1, 0.25, 0), axis=1) == pytest.approx(0.25, abs=1e-6)
    assert axis.tangent(0.6) == pytest.approx((0, 1, 0), abs=1e-4)
    begin = 0.3 + 0.25 * QUARTER
    second = axis.at(np.linspace(begin + 0.02, begin + 0.1 * np.pi / 3 - 0.02, 50))
    assert np.linalg.norm(second - (0.35, 0.45, -0.1), axis=1) == pytest.approx(0.1, abs=1e-6)
    assert axis.tangent(axis.length) == pytest.approx((0, 0.5, -np.sqrt(0.75)), abs=1e-4)


def test_an_arm_in_its_pipe_is_as_far_from_the_walls_as_radii_say():
    arm = Arm.from_template("RyRz", modules=6)
    walls = pipe_walls(Curve.line((0.05, 0, 0), (0.5, 0, 0)), RADIUS)
    scene = Scene({**walls, "stone": Sphere((1, 1, 1), 0.1)}, self_collision=False, arm_radius=0.012)
    assert CollisionModel(arm, scene).minimum(arm.neutral()).distance == pytest.approx(
        RADIUS - 0.012, abs=1e-9
    )
    alone = pipe(Curve.line((0.05, 0, 0), (0.5, 0, 0)), RADIUS, margin=0.002, arm_radius=0.012)
    assert alone == Scene(walls, margin=0.002, arm_radius=0.012)
    assert Scene.from_dict(alone.to_dict()) == alone


def unit_line():
    return Curve.line((0, 0, 0), (1, 0, 0))


@pytest.mark.parametrize(
    ("make", "words"),
    [
        (lambda: pipe("line", 0.1), "path is 'line'; allowed: a Curve"),
        (lambda: pipe(unit_line(), 0.0), "radius is 0.0"),
        (lambda: pipe(unit_line(), 0.1, sides=5), "sides is 5"),
        (lambda: pipe(unit_line(), 0.1, thickness=-1.0), "thickness is -1.0"),
        (
            lambda: pipe(Curve.helix(0.1, 0.0, 0.5), 0.095),
            "at most 0.09 m, where the axis bends with a radius",
        ),
        (lambda: pipe_axis((0.1,), [(0.2, 1.0)]), "one more than bends, 2"),
        (lambda: pipe_axis((0.1, -0.1), [(0.2, 1.0)]), "runs[1] is -0.1"),
        (lambda: pipe_axis((0.1, 0.1), [(0.0, 1.0)]), "bends[0].radius is 0.0"),
        (lambda: pipe_axis((0.1, 0.1), [(0.2, 90.0)]), "bends[0] is Bend(radius=0.2, angle=90.0"),
    ],
)
def test_what_makes_no_pipe_is_refused(make, words):
    with pytest.raises(InvalidValue) as caught:
        make()
    assert words in str(caught.value)
