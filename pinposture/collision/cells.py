"""The cells of a map that an arm keeps clear of, as an obstacle."""

from __future__ import annotations

import math
from dataclasses import fields
from functools import cached_property
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import LARGEST_LENGTH, make_read_only, set_fields
from pinposture.collision.scan import Scan
from pinposture.collision.shapes import UNTURNED
from pinposture.collision.solids import MAX_PIECES, Solid, Tree
from pinposture.schema import OutputFile

Array = NDArray[np.float64]

NOWHERE = np.full((1, 3), LARGEST_LENGTH)
"""The only point of the tree of a map without cells, 17 km from the origin [m]."""


class Cells(Scan):
    """The cells of a map that an arm keeps clear of, at one moment: an obstacle, as `Map.cells` gives it.

    Each cell counts as the ball around it, and a body that is neither sphere nor capsule as the capsule
    around it. Only cells with a free face are listed. A file stores it as a scan. It may be empty; its
    distance is then over 10 km.

    Attributes:
        points: centres of the cells, (n, 3) [m]; read-only.
    """

    @classmethod
    def of(cls, centers: Array, resolution: float) -> Cells:
        """Return the cells with given centres, (n, 3) [m], and edge lengths [m]; nothing is checked."""
        cells = object.__new__(cls)
        for item in fields(Scan):
            value = None if item.name in ("faces", "colors", "path", "outlier_distance") else item.default
            set_fields(cells, **{item.name: value})
        make_read_only(centers)
        radius = 0.5 * math.sqrt(3.0) * resolution
        set_fields(cells, points=centers, name="map", point_radius=radius, rotation=UNTURNED)
        cells.prepare()
        return cells

    def prepare(self) -> None:
        """Make what distances need, so that a control loop need not."""
        _ = self._pieces
        _ = self._digest

    @cached_property
    def _pieces(self) -> list[Solid]:
        return [solid._replace(coarse=True) for solid in super().solids()]

    def solids(self) -> list[Solid]:
        """Return the pieces of its surface, of which there are always as many."""
        return self._pieces

    def placed(self, center: ArrayLike, turn: Any = None) -> Cells:
        """Return a copy with another placement; see `Surface.placed`."""
        other = super().placed(center, turn)
        other.__dict__.pop("_pieces", None)
        return other

    @cached_property
    def tree(self) -> Tree:
        """The tree of the centres, always with as many pieces; see `Scene.updated`."""
        points = self.points if len(self.points) else NOWHERE
        return Tree(np.resize(points, (max(len(points), MAX_PIECES), 3))[:, None])

    @cached_property
    def bounds(self) -> Array:
        """Minimum and maximum coordinates, (2, 3) [m]; zeros without cells."""
        return super().bounds if len(self.points) else np.zeros((2, 3))

    def pose(self, near: Array) -> pin.SE3:
        """Return its pose, that of the grid: a map that changes does not move."""
        return pin.SE3(np.array(self.rotation), np.array(self.center))

    def written(self, file: OutputFile) -> dict[str, Any]:
        """Return the values of fields that differ from their defaults."""
        table = super().written(file)
        return table if len(self.points) else table | {"points": NOWHERE.tolist()}

    def __repr__(self) -> str:
        return f"Cells({len(self.points)} cells)"
