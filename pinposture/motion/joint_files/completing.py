"""Files of others: what they leave out of a joint motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from pinposture.errors import FileError, InvalidValue
from pinposture.motion.joint_trajectory import JointTrajectory

Array = NDArray[np.float64]


def completed(
    path: Path,
    joints: Sequence[str],
    time: Array,
    told: Sequence[Array],
    units: Sequence[str] = (),
) -> JointTrajectory:
    """A motion read from a file, with rates worked out from the positions where the file has none.

    Args:
        path: the file.
        joints: names of the joints, n.
        time: when each row is reached, (N,) [s].
        told: positions, velocities and accelerations, each (N, n); the latter two NaN where there are none.
        units: see `JointTrajectory`.

    Raises:
        FileError: what the file says makes no motion.
    """
    positions, velocities, accelerations = told
    try:
        if not (np.isnan(velocities).any() or np.isnan(accelerations).any()):
            return JointTrajectory(tuple(joints), time, positions, velocities, accelerations, tuple(units))
        known = JointTrajectory.from_positions(joints, positions, time, units)
        return replace(
            known,
            velocities=np.where(np.isnan(velocities), known.velocities, velocities),
            accelerations=np.where(np.isnan(accelerations), known.accelerations, accelerations),
        )
    except InvalidValue as error:
        raise FileError(path, str(error)) from error
