"""Scans and meshes in pieces: points or triangles in trees of boxes, with some nodes as obstacles."""

from __future__ import annotations

from collections.abc import Sequence
from threading import Lock
from typing import TypeAlias

import coal
import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.kernels.arrays import Trees

Array = NDArray[np.float64]

MAX_PIECES = 64  # largest number of pieces, a power of two: a body has one contact with each
LEAF_SIZE = 4  # largest number of points or triangles in a node of the last level


class Tree:
    """Points or triangles in a tree of boxes; see `kernels.bounding_volumes`.

    Attributes:
        corners: the points, (n, 1, 3), or the corners of the triangles, (n, 3, 3), in the order of the tree
            [m].
        boxes: lowest and highest corner of each node; the first is unused, (nodes, 2, 3) [m].
        levels: number of levels.
        pieces: the nodes that count as obstacles; together they hold everything once.
    """

    def __init__(self, corners: Array) -> None:
        """Sort points, (n, 1, 3), or triangles, (n, 3, 3) [m]."""
        count = len(corners)
        most, wide = count.bit_length() - 1, MAX_PIECES.bit_length() - 1  # so that no node is empty
        deep = (-(-count // LEAF_SIZE) - 1).bit_length()
        self.levels = 1 + min(max(deep, wide), most)
        order, self.boxes = np.arange(count), np.zeros((2**self.levels, 2, 3))
        kernels.build_tree(np.array(corners), order, self.boxes)
        self.corners = np.ascontiguousarray(corners[order])
        first = 2 ** min(wide, self.levels - 1)
        self.pieces = range(first, 2 * first)
        self._geometries: dict[int, coal.BVHModelOBBRSS] = {}
        self._lock = Lock()

    def geometry(self, node: int) -> coal.BVHModelOBBRSS:
        """Return what is in a node for coal, made on first use; a point is a triangle without size."""
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
"""A tree, and a node of it."""


def join_trees(pieces: Sequence[Piece | None]) -> Trees:
    """Return the trees of obstacles as kernels take them; None stands for an obstacle of another kind."""
    trees = list(dict.fromkeys(piece[0] for piece in pieces if piece is not None))
    rows, boxes, lengths = {}, 0, {1: 0, 3: 0}
    for tree in trees:
        count, corners = tree.corners.shape[:2]
        rows[tree] = [boxes, 0, tree.levels, lengths[corners], count, int(corners == 1)]
        boxes, lengths[corners] = boxes + len(tree.boxes), lengths[corners] + count
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
    """Return arrays as one that is C-contiguous; a single one is not copied."""
    if len(arrays) == 1:
        return np.ascontiguousarray(arrays[0])
    return np.concatenate([np.zeros((0, *shape)), *arrays])


def is_closed(faces: NDArray[np.integer]) -> bool:
    """Return whether triangles, (t, 3) as indices of corners, enclose something: no edge is free."""
    _, counts = np.unique(_edges(faces)[0], return_counts=True)
    return bool(np.all(counts % 2 == 0))


def is_oriented(faces: NDArray[np.integer]) -> bool:
    """Return whether closed triangles, (t, 3), all face outwards, or all inwards: edges go to and fro."""
    edges, forward = _edges(faces)
    return np.array_equal(np.sort(edges[forward]), np.sort(edges[~forward]))


def _edges(faces: NDArray[np.integer]) -> tuple[NDArray[np.int64], NDArray[np.bool_]]:
    """Return each edge of each triangle as one number, and whether it leads to the corner of larger index."""
    starts = faces.astype(np.int64).ravel()
    ends = faces[:, [1, 2, 0]].astype(np.int64).ravel()
    edges = np.minimum(starts, ends) << 32 | np.maximum(starts, ends)
    return edges[starts != ends], (starts < ends)[starts != ends]
