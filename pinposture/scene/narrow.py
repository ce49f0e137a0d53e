"""The distance of two solids by coal, with a normal that can always be used."""

from __future__ import annotations

import math
import threading
from typing import NamedTuple, TypeAlias

import coal
import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


Posed: TypeAlias = tuple[coal.CollisionGeometry, coal.Transform3s, coal.CollisionGeometry, coal.Transform3s]
"""Two solids, each with its placement."""
_SOUND = 1e100
"""A distance this large is none [m]."""


class Contact(NamedTuple):
    """How two solids stand to each other.

    Attributes:
        distance: between their surfaces, negative where they overlap [m].
        normal: unit vector from the second solid to the first, (3,); zero where coal has none.
        point: of the first solid, nearest to the second or deepest in it, (3,) [m].
    """

    distance: float
    normal: Array
    point: Array


class Narrow(threading.local):
    """What coal writes into, one for each thread."""

    def __init__(self) -> None:
        self._result = coal.DistanceResult()
        # By default distances are wrong by up to a micrometre for a metre, which shows in a derivative. The
        # search in penetration must not be asked for more: it then fails, and calls the distance 1.8e308.
        self._requests = [coal.DistanceRequest(), coal.DistanceRequest()]
        self._requests[0].gjk_tolerance = 1e-9
        self._requests[1].epa_tolerance = 1e-4

    def distance(self, posed: Posed) -> float:
        """Distance of two solids, negative where they overlap [m]; not a number if coal cannot tell."""
        for request in self._requests:
            self._result.clear()
            distance = float(coal.distance(*posed, request, self._result))
            if abs(distance) < _SOUND:
                return distance
        return math.nan

    def contact(self, posed: Posed) -> Contact:
        """Distance, normal and point of two solids; the distance is not a number if coal cannot tell."""
        distance = self.distance(posed)
        if math.isnan(distance):
            return Contact(distance, np.zeros(3), np.array(posed[1].getTranslation()))
        away = -np.array(self._result.normal)  # coal's goes from the first to the second
        size = float(np.linalg.norm(away))
        normal = away / size if abs(size - 1.0) < 1e-3 else np.zeros(3)
        return Contact(distance, normal, np.array(self._result.getNearestPoint1()))
