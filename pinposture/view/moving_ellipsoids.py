"""Manipulability ellipsoids in the browser: balls that are stretched and turned as the arm moves."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm, Ellipsoid
from pinposture.view import palette
from pinposture.view.animation import Film
from pinposture.view.commands import Command, Track, draw, transform
from pinposture.view.ellipsoids import drawn_length
from pinposture.view.mesh import Mesh, ball
from pinposture.view.scene import ROOT, link_radius

Array = NDArray[np.float64]

OPACITY = 0.5

THINNEST = 0.3
"""Least radius of a ball, relative to that of the bars of the arm: a flat one is drawn as a disc or a rod."""

# The ways to name the axes of a right-handed frame anew, signs included, as rotations (24, 3, 3).
_RENAMINGS = np.rint(Rotation.create_group("O").as_matrix())


class Balls(NamedTuple):
    """Ellipsoids of p control points at f configurations, as unit balls that are stretched and turned.

    Attributes:
        points: indices of the control points, 0-based, (p,).
        centers: (f, p, 3) [m], world frame.
        frames: principal axes, one per row, right-handed, (f, p, 3, 3), world frame; axes keep their row and
            their sign from each configuration to the next as far as they can.
        radii: along these axes, as drawn, (f, p, 3) [m].
        indices: manipulability indices, (f, p).
    """

    points: tuple[int, ...]
    centers: Array
    frames: Array
    radii: Array
    indices: Array


def balls(arm: Arm, points: tuple[int, ...], rows: Array) -> Balls:
    """The ellipsoids of control points, 0-based, at configurations (f, nq), one after the other."""
    shape = (len(rows), len(points))
    listed = [one for q in rows for one in arm.at(q).ellipsoids(points)] if points else []
    centers = np.array([one.center for one in listed]).reshape(*shape, 3)
    frames = np.array([frame_of(one) for one in listed]).reshape(*shape, 3, 3)
    # An ellipse in a plane has no third radius.
    radii = np.array([np.append(one.radii, 0.0)[:3] for one in listed]).reshape(*shape, 3)
    indices = np.array([one.index for one in listed]).reshape(shape)
    drawn = np.maximum(drawn_length(arm, points) * radii, THINNEST * link_radius(arm))
    return Balls(points, centers, *carried_on(frames, drawn), indices)


def ball_ends(shown: Balls) -> Array:
    """The ends of the principal axes at all configurations, (n, 3) [m], world frame."""
    axes = shown.frames * shown.radii[..., None]
    ends = shown.centers[..., None, :] + np.stack([axes, -axes])
    return ends.reshape(-1, 3)


def ball_commands(shown: Balls) -> list[Command]:
    """Draw the ellipsoids of the first configuration, or draw them anew."""
    commands = []
    for p, point in enumerate(shown.points):
        drawing = draw(_path(point), _BALL, palette.index_color(shown.indices[0, p]), OPACITY)
        matrix = np.eye(4)
        matrix[:3, :3] = (shown.frames[0, p] * shown.radii[0, p, :, None]).T
        matrix[:3, 3] = shown.centers[0, p]
        commands += [drawing, transform(_path(point), matrix)]
    return commands


def ball_tracks(shown: Balls, film: Film) -> list[Track]:
    """How ellipsoids that have been drawn move, stretch and change their colour.

    Args:
        shown: the ellipsoids at the configurations of the film.
        film: what else is shown.
    """
    held, times = film.held, film.moments
    listed = []
    for p, point in enumerate(shown.points):
        turns = _turns(shown.frames[:, p])
        colors = np.array([palette.rgb(palette.index_color(index)) for index in shown.indices[:, p]])
        path = _path(point)
        listed += [
            Track(path, "position", "vector3", times, shown.centers[held, p], smooth=True),
            Track(path, "quaternion", "quaternion", times, turns[held], smooth=True),
            Track(path, "scale", "vector3", times, shown.radii[held, p], smooth=True),
            Track(f"{path}/<object>", "material.color", "color", times, colors[held], smooth=True),
        ]
    return listed


def carried_on(frames: Array, radii: Array) -> tuple[Array, Array]:
    """Name the axes of each frame such that they continue those of the one before.

    An ellipsoid has no order of its axes, and no signs: where two radii pass each other, or anywhere, they
    would jump.

    Args:
        frames: right-handed, axes in rows, (f, p, 3, 3).
        radii: along them, (f, p, 3).

    Returns:
        Both, with the rows of each frame in another order and some of them reversed; still right-handed.
    """
    frames, radii = frames.copy(), radii.copy()
    for before, now, lengths in zip(frames[:-1], frames[1:], radii[1:], strict=True):
        renamed = _RENAMINGS[:, None] @ now  # (24, p, 3, 3)
        best = np.einsum("gpij,pij->gp", renamed, before).argmax(axis=0)
        now[:] = renamed[best, np.arange(len(best))]
        lengths[:] = np.einsum("pij,pj->pi", np.abs(_RENAMINGS[best]), lengths)
    return frames, radii


def _rounder(mesh: Mesh) -> Mesh:
    """The unit ball with each triangle cut into four: large ones show their corners."""
    sides = np.sort(mesh.faces[:, [[1, 2], [2, 0], [0, 1]]], axis=2)  # opposite each corner
    distinct, number = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
    middles = mesh.vertices[distinct].sum(axis=1)
    middles /= np.linalg.norm(middles, axis=1, keepdims=True)
    (a, b, c), (d, e, f) = mesh.faces.T, len(mesh.vertices) + number.reshape(-1, 3).T
    faces = np.concatenate([np.stack(corners, 1) for corners in ((a, f, e), (b, d, f), (c, e, d), (d, e, f))])
    return Mesh(np.vstack([mesh.vertices, middles]), faces)


_BALL = _rounder(ball(np.zeros(3), 1.0))


def _path(point: int) -> str:
    return f"{ROOT}/ellipsoids/point_{point + 1:03d}"


def frame_of(one: Ellipsoid) -> Array:
    """Principal axes, one per row, right-handed, (3, 3); that of an ellipse in a plane is completed."""
    if len(one.directions) == 3:
        return one.directions
    return np.vstack([one.directions, np.cross(*one.directions)])


def _turns(frames: Array) -> Array:
    """Frames (f, 3, 3), axes in rows, as quaternions (x, y, z, w) that keep their sign, (f, 4)."""
    turns = np.asarray(Rotation.from_matrix(frames.transpose(0, 2, 1)).as_quat())
    products = np.einsum("fi,fi->f", turns[1:], turns[:-1])
    return turns * np.cumprod(np.concatenate([[1.0], np.where(products < 0.0, -1.0, 1.0)]))[:, None]
