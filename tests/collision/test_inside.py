"""Points inside obstacles, against what the obstacles are."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples

from pinposture.collision import Box, Capsule, Cylinder, HalfSpace, Scene, Sphere
from pinposture.collision.scene import obstacles_around
from pinposture.collision.shapes import Mesh

TURN = np.array([[0.6, -0.8, 0], [0.8, 0.6, 0], [0, 0, 1]])
CUBE = [(x, y, z) for x in (-1, 1) for y in (-1, 1) for z in (-1, 1)]
KINDS = {
    "ball": Sphere((0.1, 0, 0), 0.5),
    "capsule": Capsule((-0.5, 0, 0), (0.5, 0, 0.2), 0.3),
    "cylinder": Cylinder((0, 0, -0.5), (0, 0.1, 0.6), 0.4),
    "box": Box((0, 0.1, 0), (1.0, 0.5, 0.3), TURN),
    "floor": HalfSpace((0, 0, 0.2), (0, 0.6, 0.8)),
    "cube": Mesh(0.4 * np.array(CUBE)),
}
COORDINATE = st.floats(-1.0, 1.0)


def depth(name: str, p: np.ndarray) -> float:
    """How far a point is below the surface, from the equation of the solid; below 0 outside [m]."""
    solid = KINDS[name]
    if name == "ball":
        return 0.5 - float(np.linalg.norm(p - (0.1, 0, 0)))
    if name == "floor":
        return 0.16 - float(p @ (0, 0.6, 0.8))
    if name == "box":
        return float((np.array([0.5, 0.25, 0.15]) - np.abs(TURN.T @ (p - (0, 0.1, 0)))).min())
    if name == "cube":
        return float((0.4 - np.abs(p)).min())
    a = np.array(solid.start)
    b = np.array(solid.end)
    along = float((p - a) @ (b - a)) / np.linalg.norm(b - a)
    length = float(np.linalg.norm(b - a))
    if name == "capsule":
        return 0.3 - float(np.linalg.norm(p - a - np.clip(along, 0, length) * (b - a) / length))
    return min(0.4 - float(np.linalg.norm(p - a - along * (b - a) / length)), along, length - along)


@examples(40)
@given(point=st.tuples(COORDINATE, COORDINATE, COORDINATE))
def test_a_point_is_inside_where_the_equation_of_the_solid_says_so(point: tuple[float, float, float]) -> None:
    found = obstacles_around(Scene(KINDS, self_collision=False), point)
    for name in KINDS:
        below = depth(name, np.array(point))
        if abs(below - 1e-4) > 2e-5:  # what is measured is good to a few micrometres
            assert (name in found) == (below > 1e-4), (name, below)


def test_names_come_in_the_order_of_the_scene() -> None:
    assert obstacles_around(Scene(KINDS, self_collision=False), (0, 0, 0)) == tuple(KINDS)
    assert obstacles_around(Scene(dict(reversed(KINDS.items())), self_collision=False), (0, 0, 0)) == tuple(
        reversed(KINDS)
    )
    assert obstacles_around(Scene(KINDS, self_collision=False), (5, 5, 5)) == ()
    assert obstacles_around(Scene({}, self_collision=False), (0, 0, 0)) == ()


@pytest.mark.parametrize("sunk", [-1e-3, 0.0, 5e-5])
def test_standing_on_something_is_not_inside(sunk: float) -> None:
    floor = Scene(
        {"floor": HalfSpace((0, 0, sunk), (0, 0, 1)), "plate": Box((0, 0, sunk - 0.1), (1, 1, 0.2))},
        self_collision=False,
    )
    assert obstacles_around(floor, (0, 0, 0)) == ()
    assert obstacles_around(floor, (0, 0, -0.01)) == ("floor", "plate")


def test_how_deep_it_has_to_be_can_be_said() -> None:
    ball = Scene({"ball": Sphere((0, 0, 0), 0.1)}, self_collision=False)
    assert obstacles_around(ball, (0, 0, 0.05), depth=0.04) == ("ball",)
    assert obstacles_around(ball, (0, 0, 0.05), depth=0.06) == ()
