"""What distances are computed from: solids with their bounding volumes, and trees of boxes."""

from __future__ import annotations

from collections.abc import Sequence
from threading import Lock
from typing import NamedTuple, TypeAlias

import coal
import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.kernels.arrays import SOLID, Trees

Array = NDArray[np.float64]

MAX_PIECES = 64  # maximum number of pieces, a power of two; a body has one contact with each


class Tree:
    """Points or triangles in a tree of boxes; see `kernels.bounding_volumes`.

    Attributes:
        corners: the points, (n, 1, 3), or the triangle corners, (n, 3, 3), in the order of the tree [m].
        boxes: minimum and maximum corner of each node; the first is unused, (nodes, 2, 3) [m].
        levels: number of levels.
        pieces: the nodes that count as obstacles; together they contain each item once.
    """

    def __init__(self, corners: Array) -> None:
        """Build the tree of points, (n, 1, 3), or triangles, (n, 3, 3) [m]."""
        count = len(corners)
        most = count.bit_length() - 1  # so that no node is empty
        wide = MAX_PIECES.bit_length() - 1
        deep = (-(-count // 4) - 1).bit_length()  # down to four corners
        self.levels = 1 + min(max(deep, wide), most)
        order = np.arange(count)
        self.boxes = np.zeros((2**self.levels, 2, 3))
        kernels.build_tree(np.array(corners), order, self.boxes)
        self.corners = np.ascontiguousarray(corners[order])
        first = 2 ** min(wide, self.levels - 1)
        self.pieces = range(first, 2 * first)
        self._geometries: dict[int, coal.BVHModelOBBRSS] = {}
        self._lock = Lock()

    def geometry(self, node: int) -> coal.BVHModelOBBRSS:
        """Return the coal geometry of a node, created on first use; points are degenerate triangles."""
        with self._lock:
            if node not in self._geometries:
                level = node.bit_length() - 1
                begin, end = ((node - 2**level + k) * len(self.corners) >> level for k in (0, 1))
                items = self.corners[begin:end]
                vertices = np.broadcast_to(items, (len(items), 3, 3)).reshape(-1, 3)
                geometry = coal.BVHModelOBBRSS()
                geometry.beginModel(len(items), len(vertices))
                geometry.addVertices(vertices)
                geometry.addTriangles(np.arange(len(vertices)).reshape(-1, 3))
                geometry.endModel()
                self._geometries[node] = geometry
            return self._geometries[node]


Piece: TypeAlias = tuple[Tree, int]
"""A tree and one of its nodes."""


def join_trees(pieces: Sequence[Piece | None]) -> Trees:
    """Return the trees of obstacles in the form that the kernels use; None: an obstacle without a tree."""
    trees = list(dict.fromkeys(piece[0] for piece in pieces if piece is not None))
    rows = {}
    boxes = 0
    lengths = {1: 0, 3: 0}
    for tree in trees:
        count, corners = tree.corners.shape[:2]
        rows[tree] = [boxes, 0, tree.levels, lengths[corners], count, int(corners == 1)]
        boxes = boxes + len(tree.boxes)
        lengths[corners] = lengths[corners] + count
    listed = np.zeros((len(pieces), 6), dtype=np.int64)
    for k, piece in enumerate(pieces):
        if piece is not None:
            listed[k] = rows[piece[0]]
            listed[k, 1] = piece[1]
    points = [tree.corners[:, 0] for tree in trees if tree.corners.shape[1] == 1]
    triangles = [tree.corners for tree in trees if tree.corners.shape[1] == 3]
    return Trees(
        boxes=_joined([tree.boxes for tree in trees], (2, 3)),
        points=_joined(points, (3,)),
        triangles=_joined(triangles, (3, 3)),
        pieces=listed,
    )


def _joined(arrays: Sequence[Array], shape: tuple[int, ...]) -> Array:
    """Concatenate arrays into a C-contiguous one; a single one is not copied."""
    if len(arrays) == 1:
        return np.ascontiguousarray(arrays[0])
    return np.concatenate([np.zeros((0, *shape)), *arrays])


class Solid(NamedTuple):
    """A solid or a piece of a surface in some frame, with its bounding volumes.

    Attributes:
        shape: the coal shape, or a piece of a surface.
        rotation: from the axes of the shape to the frame, (3, 3).
        position: origin of the shape in the frame, (3,) [m].
        start: one axis end of a capsule that contains the solid, (3,) [m].
        end: the other axis end, (3,) [m]; the same for a sphere.
        radius: radius of that capsule [m]; infinite for a half-space. For a piece, the radius of its points.
        center: centre of a box with the axes of `rotation` that contains the solid, (3,) [m].
        half: half the edge lengths of that box, (3,) [m].
        kind: the primitive used for distances from capsules, as in `kernels.arrays.Pairs`.
        exact: whether the solid is that primitive; otherwise the primitive contains it.
        coarse: whether bodies count as the capsules around them in distances from it, so that none needs
            coal: it is replaced too often for that.
    """

    shape: coal.CollisionGeometry | Piece
    rotation: Array
    position: Array
    start: Array
    end: Array
    radius: float
    center: Array
    half: Array
    kind: int
    exact: bool
    coarse: bool = False

    @property
    def round(self) -> bool:
        """Whether the solid is identical to its bounding capsule."""
        return self.exact and self.kind == SOLID.segment

    @property
    def geometry(self) -> coal.CollisionGeometry:
        """The coal shape."""
        return self.shape[0].geometry(self.shape[1]) if isinstance(self.shape, tuple) else self.shape

    def turned(self, turn: Array) -> Solid:
        """Return the solid in a frame with the same origin, given the rotation to it, (3, 3)."""
        return self._replace(
            rotation=turn @ self.rotation,
            position=turn @ self.position,
            start=turn @ self.start,
            end=turn @ self.end,
            center=turn @ self.center,
        )


def z_along(axis: Array) -> Array:
    """Return a rotation (3, 3) that takes z to the direction of a vector (3,)."""
    z = axis / np.linalg.norm(axis)
    x = np.cross(np.eye(3)[np.argmin(np.abs(z))], z)
    x /= np.linalg.norm(x)
    return np.stack([x, np.cross(z, x), z], axis=1)


def capsule_around(points: Array) -> tuple[Array, Array, float]:
    """Return axis ends and radius of a capsule around points, along their direction of largest spread."""
    middle = (points.min(axis=0) + points.max(axis=0)) / 2.0
    offsets = points - middle
    axis = np.linalg.svd(offsets, full_matrices=False)[2][0]
    along = offsets @ axis
    across = np.linalg.norm(offsets - np.outer(along, axis), axis=1)
    radius = float(across.max()) * (1.0 + 1e-9)
    # Points may lie beyond the axis ends, inside the caps.
    reach = np.sqrt(radius**2 - across**2)
    first = float(np.min(along + reach))
    last = float(np.max(along - reach))
    if first > last:  # a single sphere contains all points
        first = last = (first + last) / 2.0
    return middle + first * axis, middle + last * axis, radius
