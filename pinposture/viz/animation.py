"""Which configurations are shown when, and how objects in the viewer move with them."""

from __future__ import annotations

import itertools
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import umsgpack
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.errors import InvalidValue
from pinposture.motion import Motion, Trajectory
from pinposture.viz import palette
from pinposture.viz.body import bodies, body_poses

# Paths of objects in the viewer, and how their properties change with time.

Array = NDArray[np.float64]

ROOT = "/pinposture"
POINT_SIZE = 1.9  # radius of an active control point, relative to that of the bars of the arm
IDLE_SIZE = 0.75  # size of an inactive control point, relative to an active one


def body_path(index: int) -> str:
    """Return the path of the body that joint `index` of the chain moves."""
    return f"{ROOT}/arm/body_{index + 1:03d}"


def point_path(index: int) -> str:
    """Return the path of the control point on the body that joint `index` of the chain moves."""
    return f"{body_path(index)}/point"


class Track(NamedTuple):
    """How one property of one object changes with time.

    `meshcat.animation.AnimationTrack` takes three times the space, because it packs each number of each frame
    separately, and it cannot hold a value until the next.

    Attributes:
        path: the object in the viewer.
        name: the property, for instance "position".
        kind: "vector3", "quaternion" (x, y, z, w) or "color" (red, green, blue in [0, 1]).
        times: increasing, (n,) [frames].
        values: (n, 3) or (n, 4).
        smooth: whether values are interpolated, or held until the next.
    """

    path: str
    name: str
    kind: str
    times: Array
    values: Array
    smooth: bool = True

    def lower(self) -> dict[str, Any]:
        """Return the track as meshcat's viewer receives it: numbers packed in single precision."""
        lowered: dict[str, Any] = {"name": f".{self.name}", "type": self.kind}
        for name, numbers in (("times", self.times), ("values", self.values)):
            lowered[name] = umsgpack.Ext(0x17, numbers.astype("<f4").tobytes())
        if not self.smooth:
            lowered["interpolation"] = 2300  # three.js's InterpolateDiscrete
        return lowered


def pose_tracks(path: str, times: Array, positions: Array, turns: Array) -> list[Track]:
    """Return the motion of an object: positions (n, 3) [m] and quaternions (n, 4), (x, y, z, w)."""
    return [
        Track(path, "position", "vector3", times, positions),
        Track(path, "quaternion", "quaternion", times, turns),
    ]


# Which configurations are shown, and when.

REST_BEFORE, REST_AFTER = 0.6, 1.6  # how long the first and the last posture are held [s]
MIN_DURATION = 2.0  # of a run; one of few steps is shown slower [s]
MAX_DURATION = 60.0  # of a motion in time; a longer one is shown faster [s]


@dataclass(frozen=True)
class Timeline:
    """The configurations of a run or a motion that are shown, and when.

    Attributes:
        run: the run, or that of the motion.
        motion: the motion; None for a run, whose steps have no time.
        rows: rows of `run.q` that are shown, increasing, first and last included, (f,).
        times: when each is reached, (f,) [frames].
        end: when the animation is over and starts again [frames].
        fps: frames per second.
        speedup: speed relative to that of the motion; 1 in real time.
    """

    run: Trajectory
    motion: Motion | None
    rows: NDArray[np.intp]
    times: Array
    end: float
    fps: float
    speedup: float = 1.0

    @property
    def key_rows(self) -> NDArray[np.intp]:
        """Which of `rows` is shown at each of `key_times`, (f + 2,)."""
        return np.concatenate([[0], np.arange(len(self.rows)), [len(self.rows) - 1]])

    @property
    def key_times(self) -> Array:
        """`times` with beginning and end, where first and last configuration are held, (f + 2,) [frames]."""
        return np.concatenate([[0.0], self.times, [self.end]])


def playback(shown: Trajectory | Motion, fps: float, max_frames: int) -> Timeline:
    """Choose what to show: every configuration, or as many as allowed, evenly spaced.

    A motion is shown in real time, or 2, 5, 10, ... times as fast if that takes longer than `MAX_DURATION`.

    Args:
        shown: a run, or a motion in time.
        fps: configurations of a motion per second of playback, fewer if it has fewer; steps of a run per
            second, fewer if it would take less than `MIN_DURATION`.
        max_frames: largest number of configurations, at least 2.

    Raises:
        InvalidValue: `fps` or `max_frames`.
    """
    if not (np.isfinite(fps) and 0.0 < fps <= 120.0):
        raise InvalidValue("fps", fps, "a number above 0, at most 120 [1/s]")
    if isinstance(max_frames, bool) or not isinstance(max_frames, int) or max_frames < 2:
        raise InvalidValue("max_frames", max_frames, "a whole number of at least 2")
    if isinstance(shown, Motion):
        return _motion_playback(shown, float(fps), max_frames)
    count = min(shown.steps + 1, max_frames)
    fps = min(fps, max(count - 1, 1) / MIN_DURATION)
    rows = np.round(np.linspace(0, shown.steps, count)).astype(np.intp)
    times = REST_BEFORE * fps + np.arange(count, dtype=np.float64)
    return Timeline(shown, None, rows, times, float(times[-1] + REST_AFTER * fps), float(fps))


def _motion_playback(motion: Motion, fps: float, max_frames: int) -> Timeline:
    """Choose rows of a motion and when to show them; `fps` is only the unit of time here."""
    factors = (digit * 10.0**power for power in itertools.count() for digit in (1.0, 2.0, 5.0))
    end = float(motion.time[-1])
    speedup = next(factor for factor in factors if end <= MAX_DURATION * factor * (1.0 + 1e-9))
    frames = int(np.ceil(motion.time[-1] / speedup * fps))
    count = min(frames, motion.steps, max_frames - 1) + 1
    rows = np.round(np.linspace(0, motion.steps, count)).astype(np.intp)
    times = (REST_BEFORE + motion.time[rows] / speedup) * fps
    return Timeline(motion.run, motion, rows, times, float(times[-1] + REST_AFTER * fps), fps, speedup)


def arm_tracks(arm: Arm, shown: Timeline) -> list[Track]:
    """Return how the bodies of the arm move and its control points change.

    A control point counts as active at a configuration if it is active in the step from there; at the last
    configuration, in the step to there.
    """
    run = shown.run
    poses = body_poses(arm, run.q[shown.rows])  # (f, n, 4, 4)
    held, times = shown.key_rows, shown.key_times
    listed = []
    for u in range(poses.shape[1]):
        turns = Rotation.from_matrix(poses[:, u, :3, :3]).as_quat()
        listed += pose_tracks(body_path(u), times, poses[held, u, :3, 3], turns[held])
    if run.steps:
        active = run.active[np.minimum(shown.rows, run.steps - 1)][held]  # (f + 2, m)
        ends = [u for u, body in enumerate(bodies(arm)) if body.point is not None]
        for u, on in zip(ends, active.T, strict=True):
            listed.extend(_activity_tracks(point_path(u), times, on))
    return listed


def _activity_tracks(path: str, times: Array, on: NDArray[np.bool_]) -> list[Track]:
    """Return colour and size of a control point that is active at some times, with a key for each change."""
    changed = np.concatenate([[True], on[1:] != on[:-1]])
    changed[-1] = True  # all tracks have to end together, because each starts again when it ends
    colors = np.where(on[changed, None], palette.rgb(palette.ACTIVE), palette.rgb(palette.IDLE))
    sizes = np.where(on[changed, None], 1.0, IDLE_SIZE) * np.ones(3)
    return [
        Track(f"{path}/<object>", "material.color", "color", times[changed], colors, smooth=False),
        Track(path, "scale", "vector3", times[changed], sizes, smooth=False),
    ]


# The targets of a motion: a hoop for each control point, where it should be.

NO_SIZE = 1e-3  # size of a hoop without a target


def moving_target_tracks(motion: Motion, playback: Timeline) -> list[Track]:
    """Return how the hoops of targets move, appear and disappear."""
    held, times = playback.key_rows, playback.key_times
    targets, mask = motion.targets[playback.rows], motion.target_mask[playback.rows]
    turns = hoop_turns(motion.arm, targets, mask)
    listed = []
    for k in targeted_points(motion):
        path = hoop_path(k)
        listed += pose_tracks(path, times, targets[held, k], turns[held, k])
        if not mask[:, k].all():
            sizes = np.where(mask[held, k, None], 1.0, NO_SIZE) * np.ones(3)
            listed.append(Track(path, "scale", "vector3", times, sizes, smooth=False))
    return listed


def hoop_path(point: int) -> str:
    """Return the path of the hoop for a control point, 0-based."""
    return f"{ROOT}/target/hoop_{point + 1:03d}"


def hoop_turns(arm: Arm, targets: Array, mask: NDArray[np.bool_]) -> Array:
    """Return orientations of hoops across the line through the targets, (f, m, 4), (x, y, z, w).

    Each follows from the one before by the smallest rotation, so that hoops do not spin.

    Args:
        arm: the arm.
        targets: where control points should be, (f, m, 3) [m], world frame.
        mask: which of them have a target, (f, m).
    """
    turns = np.empty((*mask.shape, 4))
    normals = np.broadcast_to([0.0, 0.0, 1.0], (mask.shape[1], 3))
    turn = Rotation.identity(mask.shape[1])
    for row in range(len(targets)):
        ahead = _tangents(arm, targets[row], mask[row], normals)
        turn = _shortest_rotations(normals, ahead) * turn
        normals, turns[row] = ahead, turn.as_quat()
    return same_signs(turns)


def same_signs(turns: Array) -> Array:
    """Choose the signs of quaternions (f, ..., 4) such that each is closest to the one before."""
    flips = np.ones(turns.shape[:-1])
    flips[1:] = np.where(np.sum(turns[1:] * turns[:-1], axis=-1) < 0.0, -1.0, 1.0)
    return np.asarray(turns * np.cumprod(flips, axis=0)[..., None])


def _tangents(arm: Arm, points: Array, mask: NDArray[np.bool_], known: Array) -> Array:
    """Return tangents of the line from the base through targets (m, 3); known ones where there are none."""
    tangents: Array = known.copy()
    targeted = np.flatnonzero(mask)
    behind = _unit(np.diff(np.vstack([arm.chain.base, points[targeted]]), axis=0))
    across = behind + np.vstack([behind[1:], behind[-1:]])
    lengths = np.linalg.norm(across, axis=1)
    plain = lengths > 1e-6
    tangents[targeted[plain]] = across[plain] / lengths[plain, None]
    return tangents


def _unit(vectors: Array) -> Array:
    lengths = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.asarray(vectors / np.maximum(lengths, 1e-12))


def _shortest_rotations(before: Array, after: Array) -> Rotation:
    """Return the smallest rotations from unit vectors (m, 3) to others."""
    axes = np.cross(before, after)
    sines = np.linalg.norm(axes, axis=1, keepdims=True)
    angles = np.arctan2(sines, np.einsum("mi,mi->m", before, after)[:, None])
    aside = np.cross(before, np.eye(3)[np.abs(before).argmin(axis=1)])  # for opposite vectors
    around = np.where(sines > 1e-9, axes / np.maximum(sines, 1e-9), _unit(aside))
    turns: Rotation = Rotation.from_rotvec(angles * around)
    return turns


def targeted_points(motion: Motion) -> NDArray[np.intp]:
    """Return the control points, 0-based, that have a target at some time."""
    return np.asarray(np.flatnonzero(motion.target_mask.any(axis=0)))
