"""Position drives without masses: delay, lag, friction and sag, for tests of control loops."""

from __future__ import annotations

from collections import deque

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import finite_array, finite_vector, require_positive
from pinposture.motion.drive_response import DriveModel

Array = NDArray[np.float64]


class Drives:
    """The joints of an arm with drives of a model, exact for commands that stay as they are for a cycle.

    Attributes:
        model: the model of the drives.
        positions: joint positions, (nv,) [rad or m]; may be changed.
        sag: displacement of the joints by loads, (nv,) [rad or m]; may be changed.
        running: whether each drive runs; joints of others stand still, (nv,). May be changed.
    """

    def __init__(self, model: DriveModel, positions: ArrayLike, dt: float) -> None:
        require_positive("dt", dt)
        self.model = model
        self.positions = finite_array("positions", positions, (None,))
        self.sag = np.zeros_like(self.positions)
        self.running = np.ones(len(self.positions), dtype=np.bool_)
        self._dt = dt
        self._moving = np.zeros(len(self.positions), dtype=np.bool_)
        self._sent = deque([self.positions.copy()], maxlen=2 + int(np.ceil(model.delay / dt)))

    def advance(self, command: ArrayLike) -> Array:
        """Send joint positions, (nv,) [rad or m], and return those of the arm a cycle later, (nv,)."""
        model = self.model
        self._sent.appendleft(finite_vector("command", command, len(self.positions)))
        age = model.delay / self._dt  # of the command that arrives [cycles]
        last = len(self._sent) - 1
        newer = min(int(age), last)
        share = age - int(age)
        sent = (1.0 - share) * self._sent[newer] + share * self._sent[min(newer + 1, last)]
        arrived = sent + self.sag
        error = arrived - self.positions
        holds = np.where(self._moving, model.friction, model.friction + model.stiction)
        self._moving = self.running & (np.abs(error) > holds)
        ends = arrived - model.friction * np.sign(error)
        moved = (1.0 - np.exp(-self._dt / model.lag)) * (ends - self.positions)
        self.positions = self.positions + np.where(self._moving, moved, 0.0)
        return np.array(self.positions)
