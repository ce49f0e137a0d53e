"""Pipes: box walls around a curve, and axes made of straight runs and bends."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture import _validation
from pinposture._validation import length, require_instance, require_whole
from pinposture.collision.scene import USUAL_MARGIN, Scene
from pinposture.collision.shapes import Box
from pinposture.curve import Curve
from pinposture.errors import InvalidValue
from pinposture.units import length_text

Array = NDArray[np.float64]


class PipeSettings(NamedTuple):
    """How walls of pipes are made."""

    wall_tolerance: float = 0.008
    """Largest deviation of a wall from the radius of the pipe in a bend, relative to that radius."""

    samples_per_radius: int = 50
    """Number of samples of the axis per radius of the pipe."""

    points_per_bend_radius: int = 50
    """Number of points of the axis per radius of the sharpest bend."""

    largest_radius: float = 0.9
    """Largest radius of a pipe in a bend, relative to the radius of the bend."""

    fewest_sides: int = 6
    """Smallest number of sides; with fewer, the overlap of rings at their corners would narrow a bend."""


PIPE = PipeSettings()


class Bend(NamedTuple):
    """A bend of a pipe.

    Attributes:
        radius: bend radius of the axis [m].
        angle: bend angle [rad].
        roll: direction, as an angle about the axis from the direction of the previous bend [rad]. The first
            bend goes towards +y at 0 and towards +z at pi/2.
    """

    radius: float
    angle: float
    roll: float = 0.0


def pipe_axis(runs: Sequence[float], bends: Sequence[Bend | tuple[float, ...]]) -> Curve:
    """Create the axis of a pipe: straight runs connected by bends.

    The axis starts at the origin along +x. It is a spline through closely spaced points: its error is 1e-4 of
    the bend radius where a bend starts or ends, and smaller elsewhere.

    Args:
        runs: lengths of the straight runs, one more than bends [m]; the first and the last may be 0.
        bends: the bends, or their attributes as tuples.

    Raises:
        InvalidValue: invalid lengths, radii or angles.
    """
    if len(runs) != len(bends) + 1:
        raise InvalidValue("runs (how many)", len(runs), f"one more than bends, {len(bends) + 1}")
    lengths = [length(f"runs[{i}]", run, zero=True) for i, run in enumerate(runs)]
    listed = [Bend(*bend) for bend in bends]
    for i, (radius, angle, roll) in enumerate(listed):
        length(f"bends[{i}].radius", radius)
        if not (0.0 < angle <= 2.0 * np.pi and np.isfinite(roll)):
            allowed = "an angle above 0, at most 2 pi, and a finite roll [rad]"
            raise InvalidValue(f"bends[{i}]", listed[i], allowed)
    step = min([bend.radius for bend in listed], default=sum(lengths)) / PIPE.points_per_bend_radius
    turn = np.eye(3)
    points = [np.zeros((1, 3))]
    for run, bend in zip(lengths, [*listed, None], strict=True):
        if run > 0.0:
            points.append(points[-1][-1] + _shares(run, step) * run * turn[:, 0])
        if bend is not None:
            turn = turn @ pin.exp3(np.array([bend.roll, 0.0, 0.0]))
            angles = _shares(bend.radius * bend.angle, step) * bend.angle
            arc = bend.radius * (np.sin(angles) * turn[:, 0] + (1.0 - np.cos(angles)) * turn[:, 1])
            points.append(points[-1][-1] + arc)
            turn = turn @ pin.exp3(np.array([0.0, 0.0, bend.angle]))
    return Curve.points(np.vstack(points))


def _shares(size: float, step: float) -> Array:
    """Return equidistant fractions of a length, 0 excluded and 1 included, at most a step apart, (n, 1)."""
    count = max(int(np.ceil(size / step)), 1)
    return (np.arange(1, count + 1) / count)[:, None]


def pipe(
    path: Curve,
    radius: float,
    sides: int = 6,
    thickness: float = 0.005,
    margin: float = USUAL_MARGIN,
    self_collision: bool = True,
    arm_radius: float | None = None,
) -> Scene:
    """Create a scene with an open-ended pipe along a curve.

    Args:
        path: axis of the pipe, in the world.
        radius: as in `pipe_walls`.
        sides: as in `pipe_walls`.
        thickness: as in `pipe_walls`.
        margin: as in `Scene`.
        self_collision: as in `Scene`.
        arm_radius: as in `Scene`.

    Raises:
        InvalidValue: invalid values, or a bend that is too tight for the radius.
    """
    return Scene(pipe_walls(path, radius, sides, thickness), self_collision, margin, arm_radius)


def pipe_walls(path: Curve, radius: float, sides: int = 6, thickness: float = 0.005) -> dict[str, Box]:
    """Create the walls of a pipe, for a scene with other obstacles.

    The walls are rings of boxes: polygons whose sides are at the radius from the axis, with corners farther
    out. Rings are as long as the bends allow, so a straight run is a single ring; in bends, walls are within
    one percent of the radius.

    Args:
        path: axis of the pipe, in the world.
        radius: inner radius [m].
        sides: number of sides of a ring, at least 6.
        thickness: wall thickness [m].

    Returns:
        Boxes by name: "pipe 1.1" (first ring, first side), "pipe 1.2", ...

    Raises:
        InvalidValue: invalid values, or a bend that is too tight for the radius.
    """
    require_instance("path", path, Curve, "a Curve")
    radius = length("radius", radius)
    thickness = length("thickness", thickness)
    require_whole("sides", sides, PIPE.fewest_sides)
    s = np.linspace(0.0, path.length, int(np.ceil(PIPE.samples_per_radius * path.length / radius)) + 1)
    tightest = float(np.max(path.curvature(s)))
    if radius * tightest > PIPE.largest_radius:
        bend = f"where the axis bends with a radius of {length_text(1.0 / tightest)}"
        raise InvalidValue("radius", radius, f"at most {PIPE.largest_radius / tightest:.4g} m, {bend}")
    axis = path.at(s)
    normals = _side_normals(path.tangent(s), sides)
    return {
        f"pipe {number + 1}.{side + 1}": _wall(axis[ring], normals[ring], side, radius, thickness)
        for number, ring in enumerate(_rings(axis[:, None] + radius * normals, PIPE.wall_tolerance * radius))
        for side in range(sides)
    }


def _side_normals(tangents: Array, sides: int) -> Array:
    """Return twist-free unit vectors from the axis to the middle of each side, (n, sides, 3)."""
    across = np.eye(3)[np.argmin(np.abs(tangents[0]))]
    first = np.empty_like(tangents)
    for i, tangent in enumerate(tangents):  # transported from sample to sample by projection
        across = across - (across @ tangent) * tangent
        first[i] = across = across / np.linalg.norm(across)
    angles = 2.0 * np.pi * np.arange(sides) / sides
    second = np.cross(tangents, first)
    normals = np.cos(angles)[:, None] * first[:, None] + np.sin(angles)[:, None] * second[:, None]
    return np.asarray(normals)


def _rings(walls: Array, allowed: float) -> list[slice]:
    """Return the samples of each ring, ends included: the longest rings within a tolerance.

    `walls`, (n, sides, 3), are the midpoints of the inner face of each side along the pipe. Sides lie halfway
    between chord and arc, so their deviation is at most half the arc height.
    """
    rings = []
    first = 0
    last = len(walls) - 1
    while first < last:
        # bisection: the arc height grows with the length
        low = first + 1
        high = last
        while low < high:
            middle = (low + high + 1) // 2
            if _arc_height(walls[first : middle + 1]) <= 2.0 * allowed:
                low = middle
            else:
                high = middle - 1
        rings.append(slice(first, low + 1))
        first = low
    return rings


def _arc_height(walls: Array) -> float:
    """Return the maximum distance of lines, (n, sides, 3), from the chords between their ends [m]."""
    chords = walls[-1] - walls[0]
    gaps = walls - walls[0]
    square = np.maximum(np.einsum("ji,ji->j", chords, chords), 1e-300)
    along = np.clip(np.einsum("nji,ji->nj", gaps, chords) / square, 0.0, 1.0)
    return float(np.linalg.norm(gaps - along[:, :, None] * chords, axis=2).max())


def _wall(axis: Array, normals: Array, side: int, radius: float, thickness: float) -> Box:
    """Return one side of a ring, long and wide enough for its outer face to meet those of its neighbours."""
    out = normals[:, side]
    inner = axis + radius * out
    along = inner[-1] - inner[0]
    along /= np.linalg.norm(along)
    normal = out[len(out) // 2] - (out[len(out) // 2] @ along) * along
    normal /= np.linalg.norm(normal)
    across = np.cross(normal, along)
    heights = (inner - inner[0]) @ normal
    height = 0.5 * float(heights.max() + heights.min())
    corners = [axis + (radius + thickness) * corner for corner in _corners(normals, side)]
    ends = np.concatenate([inner[[0, -1]], *(corner[[0, -1]] for corner in corners)]) - inner[0]
    extra = PIPE.wall_tolerance * radius * np.array([-1.0, 1.0])  # against gaps due to rounding error
    first, last = np.array([np.min(ends @ along), np.max(ends @ along)]) + extra
    right, left = np.array([np.min(ends @ across), np.max(ends @ across)]) + extra
    middle = 0.5 * (first + last) * along + 0.5 * (right + left) * across
    x, y, z = (inner[0] + middle + (height + 0.5 * thickness) * normal).tolist()
    turn = _validation.rotation("rotation", np.column_stack([along, across, normal]))
    size = (float(last - first), float(left - right), thickness)
    return Box((x, y, z), size, turn)


def _corners(normals: Array, side: int) -> tuple[Array, Array]:
    """Return the vectors from the axis to both edges of a side at distance 1, (n, 3) each."""
    sides = normals.shape[1]
    scale = 0.5 / np.cos(np.pi / sides) ** 2
    normal, before, after = (normals[:, k % sides] for k in (side, side - 1, side + 1))
    return scale * (normal + before), scale * (normal + after)
