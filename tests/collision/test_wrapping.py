"""Curves around obstacles: distances by coal, windings by angles, and arms that take them."""

from __future__ import annotations

import coal
import numpy as np
import pytest
from arms import template_arm
from hypothesis import assume, given
from hypothesis import strategies as st

import pinposture as pp
from pinposture.collision import Scene, curve_around
from pinposture.collision.shapes import Described
from pinposture.errors import CurveError, InvalidValue

START = (0.0, 0.0, 0.0)
KEPT = 2e-3
"""Share of the gap by which a curve through closely spaced points may come nearer."""

CAN = pp.Cylinder((0.4, 0.1, -0.2), (0.4, 0.1, 0.2), 0.08)
BRICK = pp.Box((0.4, 0.1, 0.0), (0.1, 0.15, 0.3), rotation=(0.3, 0.2, 0.5))
CORNERS = np.random.default_rng(1).uniform(-0.1, 0.1, (30, 3))


def distances(obstacle: Described, points: np.ndarray) -> np.ndarray:
    """Distances of points from a convex obstacle, by coal."""
    solid = obstacle.geometry.solid()
    pose = coal.Transform3s(solid.rotation, solid.position)
    found = []
    for point in points:
        at = coal.Transform3s(np.eye(3), point)
        request = coal.DistanceRequest()
        found.append(
            coal.distance(coal.Sphere(1e-9), at, solid.geometry, pose, request, coal.DistanceResult())
        )
    return np.array(found)


def winding(curve: pp.Curve, axis: np.ndarray, center: np.ndarray) -> float:
    """Turns of a curve about an axis, counterclockwise seen from its tip."""
    points = curve.resample(4000) - center
    side = np.cross(axis, [0.3, 0.5, 0.8])
    side /= np.linalg.norm(side)
    angles = np.unwrap(np.arctan2(points @ np.cross(axis, side), points @ side))
    return float(angles[-1] - angles[0]) / (2.0 * np.pi)


@pytest.mark.parametrize(
    "obstacle",
    [
        CAN,
        BRICK,
        pp.Sphere((0.4, 0.1, 0.0), 0.1),
        pp.Capsule((0.3, 0.2, 0.0), (0.5, 0.2, 0.1), 0.05),
        pp.Mesh(CORNERS, center=(0.4, 0.0, 0.1)),
    ],
    ids=lambda obstacle: obstacle.type,
)
@pytest.mark.parametrize("turns", [0.7, -1.5])
@pytest.mark.parametrize("direction", [None, (1.0, 0.0, 0.0)])
def test_a_curve_keeps_the_gap_and_winds_as_often_as_it_should(
    obstacle: Described, turns: float, direction: tuple[float, ...] | None
) -> None:
    axis = np.array([0.0, 0.3, 1.0]) / np.hypot(0.3, 1.0)
    gap = 0.03
    curve = curve_around(obstacle, START, gap, turns, axis=axis, direction=direction)
    near = distances(obstacle, curve.resample(500))
    assert near.min() > (1.0 - KEPT) * gap
    np.testing.assert_allclose(curve.start, START, atol=1e-15)
    if direction is not None:
        np.testing.assert_allclose(curve.tangent(0.0), direction, atol=1e-3)
    center = np.asarray(obstacle.geometry.solid().center)
    wound = winding(curve, axis, center)
    assert abs(turns) < np.sign(turns) * wound < abs(turns) + 0.5  # the approach is less than half a turn


def test_around_a_cylinder_it_is_a_helix_and_the_line_that_touches_it() -> None:
    radius, gap, pitch, turns = 0.08, 0.03, 0.05, 2.0
    can = pp.Cylinder((0.5, 0.0, -0.3), (0.5, 0.0, 0.3), radius)
    level = -0.5 * turns * pitch
    curve = curve_around(can, (0.0, 0.0, level), gap, turns, pitch=pitch)
    reach = radius + gap
    screw = turns * np.hypot(2.0 * np.pi * reach, pitch)
    line = np.sqrt(0.5**2 - reach**2)
    assert curve.length == pytest.approx(screw + line, rel=2e-3)
    on_screw = curve.at(np.linspace(curve.length - screw + 0.01, curve.length, 300))
    np.testing.assert_allclose(np.hypot(on_screw[:, 0] - 0.5, on_screw[:, 1]), reach, rtol=KEPT * gap / reach)
    bends = curve.curvature(np.linspace(curve.length - screw + 0.05, curve.length - 0.01, 50))
    np.testing.assert_allclose(bends, reach / (reach**2 + (pitch / (2.0 * np.pi)) ** 2), rtol=0.01)
    assert curve.end[2] == pytest.approx(-level)


def test_the_outline_of_a_box_has_its_sides_and_a_full_arc() -> None:
    gap = 0.02
    curve = curve_around(pp.Box((0.5, 0.0, 0.0), (0.1, 0.2, 0.6)), START, gap, 1.0, pitch=0.0)
    far = curve_around(pp.Box((0.5, 0.0, 0.0), (0.1, 0.2, 0.6)), START, gap, 2.0, pitch=0.0)
    assert far.length - curve.length == pytest.approx(2.0 * (0.1 + 0.2) + 2.0 * np.pi * gap, rel=1e-3)


@given(
    size=st.tuples(*[st.floats(0.05, 0.3)] * 3),
    turn=st.tuples(*[st.floats(-3.0, 3.0)] * 3),
    axis=st.tuples(*[st.floats(-1.0, 1.0)] * 3).filter(lambda x: np.linalg.norm(x) > 0.2),
    turns=st.floats(0.2, 2.5),
    left=st.booleans(),
)
def test_no_box_is_touched(
    size: tuple[float, ...], turn: tuple[float, ...], axis: tuple[float, ...], turns: float, left: bool
) -> None:
    box = pp.Box((0.6, 0.0, 0.0), size, rotation=turn)
    signed = -turns if left else turns
    try:
        curve = curve_around(box, START, 0.04, signed, axis=axis)
    except CurveError:
        assume(False)  # it begins above the box, seen along the axis
    assert distances(box, curve.resample(200)).min() > (1.0 - 0.011) * 0.04


def test_an_arm_takes_the_curve_and_stays_clear() -> None:
    arm = template_arm("RyRz", 40)
    can = pp.Cylinder((0.8, 0.2, -0.5), (0.8, 0.2, 0.5), 0.15)
    radius = 0.015
    curve = curve_around(can, START, 2.0 * radius, 1.25, direction=(1.0, 0.0, 0.0))
    q = pp.resolve_targets(arm, curve, placement="as_is").q
    assert q is not None
    model = pp.CollisionModel(arm, Scene({"can": can}, self_collision=False, arm_radius=radius))
    module = arm.length / arm.n_modules
    dip = 0.15 + 2.0 * radius - np.sqrt((0.15 + 2.0 * radius) ** 2 - (0.5 * module) ** 2)  # of a module
    assert radius - dip - 1e-4 < model.minimum(q).distance < radius
    points = arm.at(q).points
    close = np.hypot(points[:, 0] - 0.8, points[:, 1] - 0.2) < 0.15 + 2.5 * radius
    assert close.sum() >= 20


@pytest.mark.parametrize(
    ("given", "error", "words"),
    [
        ({"obstacle": pp.HalfSpace((0, 0, 0), (0, 0, 1))}, InvalidValue, "Cylinder"),
        ({"obstacle": None}, InvalidValue, "Cylinder"),
        ({"gap": -0.01}, InvalidValue, "gap"),
        ({"gap": 0.0}, InvalidValue, "edges"),
        ({"gap": 1e-9}, InvalidValue, "rounds the edges"),
        ({"turns": 0.0}, InvalidValue, "turns"),
        ({"turns": np.nan}, InvalidValue, "turns"),
        ({"pitch": np.inf}, InvalidValue, "pitch"),
        ({"axis": (0.0, 0.0, 0.0)}, InvalidValue, "axis"),
        ({"direction": (0.0, 0.0)}, InvalidValue, "direction"),
        ({"start": (0.4, 0.1, 0.0)}, CurveError, "less than the gap"),
        ({"start": (0.4, 0.1, 0.25), "direction": (0.0, 0.0, -1.0)}, CurveError, "the way"),
    ],
)
def test_what_cannot_be_wrapped_is_named(given: dict, error: type[Exception], words: str) -> None:
    arguments = {"obstacle": BRICK, "start": START, "gap": 0.03, **given}
    with pytest.raises(error, match=words):
        curve_around(**arguments)
