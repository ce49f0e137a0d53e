"""The targets of a motion in the browser: hoops that go where the control points should be."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.motion import Motion
from pinposture.view import palette
from pinposture.view.animation import Film
from pinposture.view.commands import Command, Track, draw, transform
from pinposture.view.mesh import Mesh, tube
from pinposture.view.places import Place
from pinposture.view.scene import POINT_SIZE, ROOT, link_radius

Array = NDArray[np.float64]

HOOP, WIRE = 1.35, 0.14
"""Radius of a hoop, and of the wire that it is made of, relative to that of a control point."""

SIDES = 32
"""Corners of the polygon that stands for a hoop."""

THIN = 0.25
"""Radius of a line through the targets at a named place, relative to that of the bars of the arm."""

GONE = 1e-3
"""Size of a hoop that is not there."""


def moving_target_commands(motion: Motion, places: list[Place]) -> list[Command]:
    """Draw the targets of a motion where it starts, and thin lines through those at named places."""
    arm, radius = motion.arm, link_radius(motion.arm)
    commands = []
    for number, place in enumerate(places):
        line = _line(arm, motion.targets[place.row][motion.asked[place.row]])
        if len(line) > 1:
            path = f"{ROOT}/target/place_{number + 1:03d}"
            commands.append(draw(path, tube(line, THIN * radius), place.color))
    turns = hoop_turns(arm, motion.targets[:1], motion.asked[:1])
    for k in _ever_asked(motion):
        matrix = np.eye(4)
        size = 1.0 if motion.asked[0, k] else GONE
        matrix[:3, :3] = size * Rotation.from_quat(turns[0, k]).as_matrix()
        matrix[:3, 3] = motion.targets[0, k]
        hoop = draw(hoop_path(k), _hoop(POINT_SIZE * radius), palette.TARGET)
        commands += [hoop, transform(hoop_path(k), matrix)]
    return commands


def moving_target_tracks(motion: Motion, film: Film) -> list[Track]:
    """How targets that have been drawn move, come and go."""
    held, times = film.held, film.moments
    targets, asked = motion.targets[film.rows], motion.asked[film.rows]
    turns = hoop_turns(motion.arm, targets, asked)
    listed = []
    for k in _ever_asked(motion):
        path = hoop_path(k)
        listed.append(Track(path, "position", "vector3", times, targets[held, k], smooth=True))
        listed.append(Track(path, "quaternion", "quaternion", times, turns[held, k], smooth=True))
        if not asked[:, k].all():
            sizes = np.where(asked[held, k, None], 1.0, GONE) * np.ones(3)
            listed.append(Track(path, "scale", "vector3", times, sizes, smooth=False))
    return listed


def hoop_path(point: int) -> str:
    """Path in the scene of the hoop for a control point, 0-based."""
    return f"{ROOT}/target/hoop_{point + 1:03d}"


def hoop_turns(arm: Arm, targets: Array, asked: NDArray[np.bool_]) -> Array:
    """Turns that stand hoops across the line through the targets, quaternions (x, y, z, w), (f, m, 4).

    Each follows from the one before by the least rotation, so that hoops do not spin.

    Args:
        arm: the arm.
        targets: where control points should be, (f, m, 3) [m], world frame.
        asked: which of them have a target, (f, m).
    """
    turns = np.empty((*asked.shape, 4))
    normals = np.broadcast_to([0.0, 0.0, 1.0], (asked.shape[1], 3))
    turn = Rotation.identity(asked.shape[1])
    for row in range(len(targets)):
        ahead = _tangents(arm, targets[row], asked[row], normals)
        turn = _least(normals, ahead) * turn
        normals, turns[row] = ahead, turn.as_quat()
    products = np.einsum("fmi,fmi->fm", turns[1:], turns[:-1])
    signs = np.cumprod(np.vstack([np.ones(asked.shape[1]), np.where(products < 0.0, -1.0, 1.0)]), axis=0)
    steady: Array = turns * signs[..., None]
    return steady


def _tangents(arm: Arm, points: Array, asked: NDArray[np.bool_], known: Array) -> Array:
    """Directions of the line from the base through targets (m, 3), or those known where there is none."""
    tangents: Array = known.copy()
    here = np.flatnonzero(asked)
    line = np.vstack([arm.chain.base, points[here]])
    behind = np.diff(line, axis=0)
    ahead = np.vstack([behind[1:], behind[-1:]])
    across = _unit(behind) + _unit(ahead)
    lengths = np.linalg.norm(across, axis=1)
    plain = lengths > 1e-6
    tangents[here[plain]] = across[plain] / lengths[plain, None]
    return tangents


def _unit(vectors: Array) -> Array:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-12))


def _least(before: Array, after: Array) -> Rotation:
    """The least rotations that take unit vectors (m, 3) to others."""
    axes = np.cross(before, after)
    sines = np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.arctan2(sines, np.einsum("mi,mi->m", before, after)[:, None])
    aside = np.cross(before, np.eye(3)[np.abs(before).argmin(axis=1)])  # for those that turn round
    around = np.where(sines > 1e-9, axes / np.maximum(sines, 1e-9), _unit(aside))
    turns: Rotation = Rotation.from_rotvec(angles * around)
    return turns


def _ever_asked(motion: Motion) -> NDArray[np.intp]:
    """Control points, 0-based, that have a target at some time."""
    return np.asarray(np.flatnonzero(motion.asked.any(axis=0)))


def _line(arm: Arm, points: Array) -> Array:
    """From the base through target points, no two in a row equal, (n, 3)."""
    line = np.vstack([arm.chain.base, points])
    apart = np.linalg.norm(np.diff(line, axis=0), axis=1) > 1e-9 * arm.length
    return np.asarray(line[np.concatenate([[True], apart])])


def _hoop(inner: float) -> Mesh:
    around = 2.0 * np.pi * np.arange(SIDES + 1) / SIDES
    circle = np.stack([np.cos(around), np.sin(around), np.zeros(SIDES + 1)], axis=1)
    return tube(HOOP * inner * circle, WIRE * inner)
