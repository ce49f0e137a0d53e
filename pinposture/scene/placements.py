"""Where all joints of a model are, read at once.

Pinocchio keeps the placements of the joints side by side in memory. Reading them one by one from Python takes
ten times as long as computing them, so two arrays are laid over that memory instead.
"""

from __future__ import annotations

import threading
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin
from numpy.lib.stride_tricks import as_strided
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]


MOST = 300
"""Degrees of freedom up to which there is memory: 2 GB."""


class Placements(threading.local):
    """Scratch data of a model, one for each thread.

    Attributes:
        data: the scratch data.
        rotations: from joint to world frame, (njoints, 3, 3); changes with `data`.
        positions: origins of the joints, (njoints, 3) [m], world frame; changes with `data`.
    """

    def __init__(self, model: pin.Model) -> None:
        if model.nv > MOST:
            allowed = f"an arm of at most {MOST}: Pinocchio's data take memory with the cube of their number"
            raise InvalidValue("degrees of freedom of an arm in a scene", model.nv, allowed)
        self.data = model.createData()
        self.rotations = _side_by_side([placement.rotation for placement in self.data.oMi])
        self.positions = _side_by_side([placement.translation for placement in self.data.oMi])


_KNOWN: WeakKeyDictionary[Arm, Placements] = WeakKeyDictionary()


def placements_of(arm: Arm) -> Placements:
    """The scratch data of an arm, the same for all scenes: it takes a second to make for 200 joints.

    What it holds counts until it is next asked for in the same thread.
    """
    if arm not in _KNOWN:
        _KNOWN[arm] = Placements(arm.model)
    return _KNOWN[arm]


def _side_by_side(views: list[Array]) -> Array:
    """One array over arrays that lie in memory at equal distances."""
    places = np.array([view.__array_interface__["data"][0] for view in views])
    step = int(places[1] - places[0])
    if np.any(np.diff(places) != step) or len({view.strides for view in views}) != 1:
        raise RuntimeError("Pinocchio does not keep placements side by side; another version than tested")
    first = views[0]
    return as_strided(first, (len(views), *first.shape), (step, *first.strides), writeable=False)
