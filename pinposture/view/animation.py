"""A run or a motion as it passes before the eyes: which configurations are shown, and when."""

from __future__ import annotations

import itertools
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm
from pinposture.errors import InvalidValue
from pinposture.motion import Motion, Trajectory
from pinposture.view import palette
from pinposture.view.body import bodies, body_poses
from pinposture.view.commands import Track
from pinposture.view.scene import IDLE_SIZE, body_path, point_path

Array = NDArray[np.float64]

REST_BEFORE, REST_AFTER = 0.6, 1.6
"""How long the first and the last posture stand still [s]."""

SHORTEST = 2.0
"""How long a run is shown at least; one of few steps is shown slower [s]."""

LONGEST = 60.0
"""How long a motion in time is shown at most; one that takes longer is shown faster [s]."""


@dataclass(frozen=True)
class Film:
    """The configurations of a run or a motion that are shown, one after the other.

    Attributes:
        run: the run, or that of the motion.
        motion: the motion; None for a run, whose steps know of no time.
        rows: which rows of `run.q` are shown, increasing, first and last included, (f,).
        times: when each is reached, (f,), in frames.
        end: when it is over and starts again, in frames.
        fps: frames per second.
        pace: how many times as fast as it was a motion is shown; 1 in real time.
    """

    run: Trajectory
    motion: Motion | None
    rows: NDArray[np.intp]
    times: Array
    end: float
    fps: float
    pace: float = 1.0

    @property
    def held(self) -> NDArray[np.intp]:
        """Which of `rows` is seen at each of `moments`, (f + 2,)."""
        return np.concatenate([[0], np.arange(len(self.rows)), [len(self.rows) - 1]])

    @property
    def moments(self) -> Array:
        """`times` with beginning and end, (f + 2,), in frames.

        The first and the last configuration are held, so that one sees them before all starts again.
        """
        return np.concatenate([[0.0], self.times, [self.end]])


def film(shown: Trajectory | Motion, fps: float, max_frames: int) -> Film:
    """Choose what to show: every configuration, or as many as allowed, evenly spaced.

    A motion is shown in real time, unless that takes longer than `LONGEST`. Then it is shown 2, 5, 10, ...
    times as fast.

    Args:
        shown: a run, or a motion in time.
        fps: configurations of a motion per second of the film, fewer if it has fewer; steps of a run per
            second, fewer if it would be over too soon.
        max_frames: number of configurations at most, at least 2.

    Raises:
        InvalidValue: `fps` or `max_frames`.
    """
    if not (np.isfinite(fps) and 0.0 < fps <= 120.0):
        raise InvalidValue("fps", fps, "a number above 0, at most 120 [1/s]")
    if isinstance(max_frames, bool) or not isinstance(max_frames, int) or max_frames < 2:
        raise InvalidValue("max_frames", max_frames, "a whole number of at least 2")
    if isinstance(shown, Motion):
        return _in_time(shown, float(fps), max_frames)
    count = min(shown.steps + 1, max_frames)
    fps = min(fps, max(count - 1, 1) / SHORTEST)
    rows = np.round(np.linspace(0, shown.steps, count)).astype(np.intp)
    times = REST_BEFORE * fps + np.arange(count, dtype=np.float64)
    return Film(shown, None, rows, times, float(times[-1] + REST_AFTER * fps), float(fps))


def _in_time(motion: Motion, fps: float, max_frames: int) -> Film:
    """Rows of a motion and when to show them; `fps` is but the unit of time then."""
    pace = _pace(float(motion.time[-1]))
    frames = int(np.ceil(motion.time[-1] / pace * fps))
    count = min(frames, motion.steps, max_frames - 1) + 1
    rows = np.round(np.linspace(0, motion.steps, count)).astype(np.intp)
    times = (REST_BEFORE + motion.time[rows] / pace) * fps
    return Film(motion.run, motion, rows, times, float(times[-1] + REST_AFTER * fps), fps, pace)


def _pace(seconds: float) -> float:
    """How many times as fast to show a motion: the least of 1, 2, 5, 10, 20, ... that makes it short."""
    paces = (digit * 10.0**power for power in itertools.count() for digit in (1.0, 2.0, 5.0))
    return next(pace for pace in paces if seconds <= LONGEST * pace * (1.0 + 1e-9))


def tracks(arm: Arm, shown: Film) -> list[Track]:
    """How the bodies of the arm move and its control points change, for an arm that has been drawn.

    Args:
        arm: the arm.
        shown: what to show. A control point counts as active at a configuration if it is in the active
            control set of the step that leaves it; at the last, of the step that led to it.
    """
    run = shown.run
    poses = body_poses(arm, run.q[shown.rows])  # (f, n, 4, 4)
    held, times = shown.held, shown.moments
    listed = []
    for u in range(poses.shape[1]):
        turns = Rotation.from_matrix(poses[:, u, :3, :3]).as_quat()
        listed.append(Track(body_path(u), "position", "vector3", times, poses[held, u, :3, 3], smooth=True))
        listed.append(Track(body_path(u), "quaternion", "quaternion", times, turns[held], smooth=True))
    if run.steps:
        active = run.active[np.minimum(shown.rows, run.steps - 1)][held]  # (f + 2, m)
        ends = [u for u, body in enumerate(bodies(arm)) if body.point is not None]
        for u, on in zip(ends, active.T, strict=True):
            listed.extend(_activity(point_path(u), times, on))
    return listed


def _activity(path: str, times: Array, on: NDArray[np.bool_]) -> list[Track]:
    """Colour and size of a control point that is active at some times, told only where that changes."""
    told = np.concatenate([[True], on[1:] != on[:-1]])
    told[-1] = True  # all tracks end together, or those that end early would start again early
    colors = np.where(on[told, None], palette.rgb(palette.ACTIVE), palette.rgb(palette.IDLE))
    sizes = np.where(on[told, None], 1.0, IDLE_SIZE) * np.ones(3)
    return [
        Track(f"{path}/<object>", "material.color", "color", times[told], colors, smooth=False),
        Track(path, "scale", "vector3", times[told], sizes, smooth=False),
    ]
