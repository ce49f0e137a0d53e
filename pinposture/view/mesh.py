"""Triangle meshes: the round bars and balls that an arm is drawn with."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

SIDES = 16
"""Corners of the polygon that stands for a circle."""


class Mesh(NamedTuple):
    """A surface made of triangles.

    Attributes:
        vertices: (n, 3) [m].
        faces: indices of the corners of each triangle, counter-clockwise seen from outside, (k, 3).
    """

    vertices: Array
    faces: NDArray[np.intp]


def merge(meshes: Sequence[Mesh]) -> Mesh:
    """Several surfaces as one, so that one transform moves them all."""
    shifts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + shift for mesh, shift in zip(meshes, shifts, strict=False)]
    return Mesh(np.vstack([mesh.vertices for mesh in meshes]), np.vstack(faces))


def ball(center: Array, radius: float, rings: int = SIDES // 2) -> Mesh:
    """A sphere about a centre (3,) [m]."""
    polar = np.pi * np.arange(1, rings) / rings
    height, width = np.cos(polar), np.sin(polar)
    around = 2.0 * np.pi * np.arange(SIDES) / SIDES
    circles = np.stack(
        [np.outer(width, np.cos(around)), np.outer(width, np.sin(around)), np.outer(height, np.ones(SIDES))],
        -1,
    )
    vertices = np.vstack([circles.reshape(-1, 3), [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0]]])
    top, bottom, last = len(vertices) - 2, len(vertices) - 1, (rings - 2) * SIDES
    here = np.arange(SIDES)
    beyond = (here + 1) % SIDES
    caps = [
        np.stack([np.full(SIDES, top), here, beyond], 1),
        np.stack([np.full(SIDES, bottom), last + beyond, last + here], 1),
    ]
    return Mesh(np.asarray(center) + radius * vertices, np.vstack([_sheet(rings - 1), *caps]))


def tube(path: Array, radius: float) -> Mesh:
    """A round bar along a path, open at its ends.

    Args:
        path: points that the axis of the bar goes through, (n, 3) [m], n >= 2, no two in a row equal.
        radius: of the bar [m].
    """
    tangents = _tangents(path)
    side = _perpendicular(tangents[0])
    around = 2.0 * np.pi * np.arange(SIDES) / SIDES
    rings = []
    for point, tangent in zip(path, tangents, strict=True):
        # Carried along rather than chosen anew, so that the bar does not twist.
        side = side - tangent * (tangent @ side)
        length = np.linalg.norm(side)
        side = side / length if length > 1e-6 else _perpendicular(tangent)
        other = np.cross(tangent, side)
        rings.append(point + radius * (np.outer(np.cos(around), side) + np.outer(np.sin(around), other)))
    return Mesh(np.vstack(rings), _sheet(len(path))[:, ::-1])


def disc(center: Array, axis: Array, radius: float, thickness: float) -> Mesh:
    """A round plate about a centre (3,) [m], its faces across a unit axis (3,)."""
    half = axis * thickness / 2.0
    rim = tube(np.array([center - half, center + half]), radius)
    plates = []
    for sign in (-1.0, 1.0):
        ring = rim.vertices[:SIDES] if sign < 0 else rim.vertices[SIDES:]
        here = np.arange(SIDES)
        fan = np.stack([np.full(SIDES, SIDES), here, (here + 1) % SIDES], 1)
        plates.append(Mesh(np.vstack([ring, center + sign * half]), fan if sign > 0 else fan[:, ::-1]))
    return merge([rim, *plates])


def _sheet(rings: int) -> NDArray[np.intp]:
    """Triangles between rings of SIDES vertices each, the outside of rings going down and around."""
    ring, corner = np.meshgrid(np.arange(rings - 1), np.arange(SIDES), indexing="ij")
    a = (ring * SIDES + corner).ravel()
    b = (ring * SIDES + (corner + 1) % SIDES).ravel()
    return np.vstack([np.stack([a, a + SIDES, b], 1), np.stack([b, a + SIDES, b + SIDES], 1)])


def _tangents(path: Array) -> Array:
    legs = np.diff(path, axis=0)
    legs /= np.linalg.norm(legs, axis=1, keepdims=True)
    inner = legs[:-1] + legs[1:]
    turned = np.linalg.norm(inner, axis=1, keepdims=True)
    inner = np.where(turned > 1e-9, inner / np.maximum(turned, 1e-9), legs[:-1])
    return np.vstack([legs[:1], inner, legs[-1:]])


def _perpendicular(direction: Array) -> Array:
    across = np.cross(direction, np.eye(3)[np.abs(direction).argmin()])
    return np.asarray(across / np.linalg.norm(across))
