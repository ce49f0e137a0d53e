"""A pipe: walls around a curve, made of boxes; and the axis of a pipe, made of straight runs and bends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture import _validation
from pinposture._validation import is_count, length
from pinposture.collision.obstacles import Box
from pinposture.collision.scene import Scene
from pinposture.curve import Curve
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

ROUGH = 0.008
"""How far a wall may be off its radius where the pipe bends, relative to that."""

SAMPLES_TO_A_RADIUS = 50
"""How finely the axis is looked at."""

FEWEST = 6
"""Fewest sides; with long sides, the overlap of rings at their corners would narrow a bend."""

TIGHTEST = 0.9
"""Largest radius of a pipe where it bends, relative to the radius of the bend."""

FINE = 50
"""How many points there are on a bend to a length of its radius."""


class Bend(NamedTuple):
    """A bend of a pipe.

    Attributes:
        radius: of its axis [m].
        angle: by which it turns [rad].
        roll: where to: about the pipe, from the plane and the side of the bend before; the first bends
            towards +y at 0 and towards +z at pi/2 [rad].
    """

    radius: float
    angle: float
    roll: float = 0.0


def pipe_axis(runs: Sequence[float], bends: Sequence[Bend | tuple[float, ...]]) -> Curve:
    """The axis of a pipe: straight runs with a bend between each two.

    It begins at the origin along +x, and is a spline through points that are close together: within 1e-4 of
    the radius of a bend where that begins or ends, and nearer elsewhere.

    Args:
        runs: lengths of the straight runs, one more than there are bends [m]; those at the ends may be 0.
        bends: the bends, or their attributes as tuples.

    Raises:
        InvalidValue: lengths, radii or angles that make no pipe.
    """
    if len(runs) != len(bends) + 1:
        raise InvalidValue("runs (how many)", len(runs), f"one more than bends, {len(bends) + 1}")
    lengths = [length(f"runs[{i}]", run, zero=True) for i, run in enumerate(runs)]
    listed = [Bend(*bend) for bend in bends]
    for i, bend in enumerate(listed):
        length(f"bends[{i}].radius", bend.radius)
        if not (0.0 < bend.angle <= 2.0 * np.pi and np.isfinite(bend.roll)):
            raise InvalidValue(f"bends[{i}]", bend, "an angle above 0, at most 2 pi, and a finite roll [rad]")
    step = min([bend.radius for bend in listed], default=sum(lengths)) / FINE
    place, turn, points = np.zeros(3), np.eye(3), [np.zeros((1, 3))]
    for run, after in zip(lengths, [*listed, None], strict=True):
        if run > 0.0:
            points.append(place + _shares(run, step) * run * turn[:, 0])
            place = points[-1][-1]
        if after is not None:
            turn = turn @ pin.exp3(np.array([after.roll, 0.0, 0.0]))
            angles = _shares(after.radius * after.angle, step) * after.angle
            way = after.radius * (np.sin(angles) * turn[:, 0] + (1.0 - np.cos(angles)) * turn[:, 1])
            points.append(place + way)
            place = points[-1][-1]
            turn = turn @ pin.exp3(np.array([0.0, 0.0, after.angle]))
    return Curve.points(np.vstack(points))


def _shares(size: float, step: float) -> Array:
    """Equal shares of a stretch, its end among them and its beginning not, (n, 1)."""
    count = max(int(np.ceil(size / step)), 1)
    return (np.arange(1, count + 1) / count)[:, None]


class _Surface(NamedTuple):
    """The pipe as samples along its axis.

    Attributes:
        axis: places on the axis, (n, 3) [m].
        out: unit vectors from the axis to the middle of each side, (n, sides, 3); carried along without
            turning about the axis.
    """

    axis: Array
    out: Array


def pipe(
    path: Curve,
    radius: float,
    sides: int = 6,
    thickness: float = 0.005,
    margin: float = 0.005,
    self_collision: bool = False,
    arm_radius: float | None = None,
) -> Scene:
    """Make a scene of a pipe with open ends along a curve.

    Args:
        path: axis of the pipe, in the world.
        radius: as in `pipe_walls`.
        sides: likewise.
        thickness: likewise.
        margin: as in `Scene`.
        self_collision: likewise.
        arm_radius: likewise.

    Raises:
        InvalidValue: values that make no pipe, or a bend that is too tight for its radius.
    """
    return Scene(pipe_walls(path, radius, sides, thickness), self_collision, margin, arm_radius)


def pipe_walls(path: Curve, radius: float, sides: int = 6, thickness: float = 0.005) -> dict[str, Box]:
    """The walls of a pipe, for a scene in which there is more.

    They are rings of boxes: polygons whose sides are a radius away from the axis, with corners farther out.
    Rings are as long as bends let them, so that a straight run is a single one; where the pipe bends, walls
    are within one percent of the radius.

    Args:
        path: axis of the pipe, in the world.
        radius: inner radius [m].
        sides: number of sides of a ring, at least 6.
        thickness: of the walls [m].

    Returns:
        Boxes by name: "pipe 1.1" (first ring, first side), "pipe 1.2", ...

    Raises:
        InvalidValue: values that make no pipe, or a bend that is too tight for its radius.
    """
    if not isinstance(path, Curve):
        raise InvalidValue("path", path, "a Curve")
    radius, thickness = length("radius", radius), length("thickness", thickness)
    if not is_count(sides) or sides < FEWEST:
        raise InvalidValue("sides", sides, f"a whole number of at least {FEWEST}")
    s = np.linspace(0.0, path.length, int(np.ceil(SAMPLES_TO_A_RADIUS * path.length / radius)) + 1)
    tightest = float(np.max(path.curvature(s)))
    if radius * tightest > TIGHTEST:
        allowed = (
            f"at most {TIGHTEST / tightest:.4g} m, where the axis bends with a radius of {1 / tightest:.4g} m"
        )
        raise InvalidValue("radius", radius, allowed)
    surface = _surface(path, s, sides)
    return {
        f"pipe {ring + 1}.{side + 1}": _wall(surface, stretch, side, radius, thickness)
        for ring, stretch in enumerate(_rings(surface.axis[:, None] + radius * surface.out, ROUGH * radius))
        for side in range(sides)
    }


def _surface(path: Curve, s: Array, sides: int) -> _Surface:
    axis, tangents = path.at(s), path.tangent(s)
    across = np.eye(3)[np.argmin(np.abs(tangents[0]))]
    normals = np.empty_like(axis)
    for i, tangent in enumerate(tangents):  # carried from place to place by projection
        across = across - (across @ tangent) * tangent
        across = across / np.linalg.norm(across)
        normals[i] = across
    angles = 2.0 * np.pi * np.arange(sides) / sides
    other = np.cross(tangents, normals)
    out = np.cos(angles)[:, None] * normals[:, None] + np.sin(angles)[:, None] * other[:, None]
    return _Surface(axis, out)


def _rings(walls: Array, allowed: float) -> list[slice]:
    """Samples of each ring, the ends included: the longest whose sides stay near their chords.

    They are put between chord and arc, so that they are off by half of what the arc rises, at most.

    Args:
        walls: middle of the inside of each side along the pipe, (n, sides, 3) [m].
        allowed: how far a side may be off [m].
    """
    rings, first, last = [], 0, len(walls) - 1
    while first < last:
        low, high = first + 1, last  # the longest one, by bisection: what rises once does not fall again soon
        while low < high:
            middle = (low + high + 1) // 2
            if _rise(walls[first : middle + 1]) <= 2.0 * allowed:
                low = middle
            else:
                high = middle - 1
        rings.append(slice(first, low + 1))
        first = low
    return rings


def _rise(walls: Array) -> float:
    """How far lines, (n, sides, 3), are from the chords between their ends, at most [m]."""
    chords, gaps = walls[-1] - walls[0], walls - walls[0]
    square = np.maximum(np.einsum("ji,ji->j", chords, chords), 1e-300)
    along = np.clip(np.einsum("nji,ji->nj", gaps, chords) / square, 0.0, 1.0)
    return float(np.linalg.norm(gaps - along[:, :, None] * chords, axis=2).max())


def _wall(surface: _Surface, ring: slice, side: int, radius: float, thickness: float) -> Box:
    """One side of one ring: as long and as wide as it takes for its outside to meet its neighbours'."""
    axis, outs = surface.axis[ring], surface.out[ring]
    out = outs[:, side]
    inner = axis + radius * out
    along = inner[-1] - inner[0]
    along /= np.linalg.norm(along)
    normal = out[len(out) // 2] - (out[len(out) // 2] @ along) * along
    normal /= np.linalg.norm(normal)
    across = np.cross(normal, along)
    heights = (inner - inner[0]) @ normal
    height = 0.5 * float(heights.max() + heights.min())
    corners = [axis + (radius + thickness) * corner for corner in _corners(outs, side)]
    ends = np.concatenate([inner[[0, -1]], *(corner[[0, -1]] for corner in corners)]) - inner[0]
    more = ROUGH * radius * np.array([-1.0, 1.0])  # a trace, against rounding
    first, last = np.array([np.min(ends @ along), np.max(ends @ along)]) + more
    right, left = np.array([np.min(ends @ across), np.max(ends @ across)]) + more
    middle = 0.5 * (first + last) * along + 0.5 * (right + left) * across
    x, y, z = (inner[0] + middle + (height + 0.5 * thickness) * normal).tolist()
    turn = _validation.rotation("rotation", np.column_stack([along, across, normal]))
    size = (float(last - first), float(left - right), thickness)
    return Box((x, y, z), size, turn)


def _corners(outs: Array, side: int) -> tuple[Array, Array]:
    """From the axis to both edges of a side that is at a distance of 1, (n, 3) each."""
    sides = outs.shape[1]
    scale = 0.5 / np.cos(np.pi / sides) ** 2
    return scale * (outs[:, side] + outs[:, side - 1]), scale * (outs[:, side] + outs[:, (side + 1) % sides])
