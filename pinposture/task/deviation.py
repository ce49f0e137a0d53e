"""How far an arm is from the path that its tip has travelled."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import InvalidValue
from pinposture.task.follow_leader import Passage, ahead_of_feed, passage

Array = NDArray[np.float64]

TO_A_LINK = 8
"""Into how many pieces each link is cut where its distance from the path is looked at."""

TO_AN_ARM = 4000
"""How many samples of the path there are to an arm length."""


@dataclass(frozen=True, eq=False)
class Deviation:
    """Distances of an arm from the path that its tip has travelled, the straight way to the entry included.

    Attributes:
        length: length of the arm from its first joint that bends to the tip, without the feed [m]; what
            shares are of.
        points: distance of each control point, (N, m) [m].
        body: largest distance of any part of the axis of the arm, joints, links and control points, (N,) [m].
        where: how far along the arm from its first joint that bends that part is, (N,) [m].
    """

    length: float
    points: Array
    body: Array
    where: Array

    @cached_property
    def row(self) -> int:
        """The row in which the body is farthest from the path."""
        return int(np.argmax(self.body))

    @property
    def largest(self) -> float:
        """Largest distance of any part of the arm in any row [m]."""
        return float(self.body[self.row])

    @property
    def largest_point(self) -> float:
        """Largest distance of any control point in any row [m]."""
        return float(self.points.max())

    @property
    def percent(self) -> float:
        """Largest distance of any part of the arm [% of its length]."""
        return 100.0 * self.largest / self.length

    @property
    def percent_points(self) -> float:
        """Largest distance of any control point [% of the arm length]."""
        return 100.0 * self.largest_point / self.length

    def __repr__(self) -> str:
        place = f"{self.where[self.row]:.4g} m along the arm in row {self.row}"
        return f"Deviation({self.percent:.3g} % of {self.length:.4g} m, {place})"


def path_deviation(
    arm: Arm, q: ArrayLike, path: Curve, placement: str = "align", start: ArrayLike | None = None
) -> Deviation:
    """Measure how far the arm is from the path that its tip has travelled.

    The distance of a point is that from the nearest place of the way from the first joint at the start to
    where the tip is now; what lies farther ahead does not count.

    Args:
        arm: an arm on a feed, as in `follow_leader`.
        q: configurations, (N, nq), as they were reached.
        path: the path, as it was given to `follow_leader`.
        placement: likewise.
        start: likewise.

    Returns:
        Distances, row by row.

    Raises:
        InvalidValue: as `follow_leader`, or configurations of the wrong shape.
        UnknownName: no such placement.
    """
    laid = passage(arm, path, placement, start)
    rows = np.asarray(q, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != arm.nq or len(rows) == 0:
        raise InvalidValue("q (shape)", rows.shape, f"(1 or more, {arm.nq})")
    return measure(laid, rows)


def measure(laid: Passage, rows: Array) -> Deviation:
    """Measure the distances of configurations, (N, nq); see `path_deviation`."""
    arm, fed = laid.fed.arm, laid.fed
    points, stations, feeds = [], [], []
    order = _stations(arm)
    for q in rows:
        state = arm.at(q)
        points.append(state.points)
        stations.append(np.vstack([state.forward.origins, state.points])[order])
        feeds.append(state.positions[fed.column])
    pieces, along = _cut(np.array(stations))  # (N, p, 3)
    begin = float(fed.arm.positions(fed.start)[fed.column])
    depths = fed.sense * (np.array(feeds) - begin)
    whole = np.concatenate([pieces, np.array(points)], axis=1)
    distances = _distances(laid, whole, _travelled(laid, pieces[:, -1], depths))
    split = pieces.shape[1]
    worst = np.argmax(distances[:, :split], axis=1)
    body = np.take_along_axis(distances[:, :split], worst[:, None], axis=1)[:, 0]
    return Deviation(fed.length, distances[:, split:], body, along[worst])


def _stations(arm: Arm) -> list[int]:
    """Joints that bend and control points from base to tip: indices into joints, then points."""
    joints, order = len(arm.chain.joints), []
    for k, module in enumerate(arm.chain.module_slices):
        order += [*range(module.start, module.stop), joints + k]
    return order[order.index(1) :]  # joint 0 is the feed


def _cut(stations: Array) -> tuple[Array, Array]:
    """Links cut into pieces: places (N, p, 3), and how far along the arm they are, (p,) [m]."""
    shares = np.arange(1, TO_A_LINK + 1) / TO_A_LINK
    begins, ways = stations[:, :-1, None], np.diff(stations, axis=1)[:, :, None]
    inner = (begins + shares[:, None] * ways).reshape(len(stations), -1, 3)
    lengths = np.linalg.norm(ways[0, :, 0], axis=1)
    along = (np.cumsum(lengths) - lengths)[:, None] + shares * lengths[:, None]
    return np.concatenate([stations[:, :1], inner], axis=1), np.append(0.0, along.ravel())


def _travelled(laid: Passage, tips: Array, depths: Array) -> Array:
    """Arc length of the way at which the tip is in each row, (N,) [m], near where the feed pushed it."""
    fed, way = laid.fed, laid.way
    run_up = float((fed.tip - fed.body.chain.base) @ fed.axis)
    near = ahead_of_feed(fed)
    shifts = np.linspace(-near, near, 101)
    s = np.clip(run_up + depths[:, None] + shifts, 0.0, way.length)
    gaps = way.at(s.ravel()).reshape(*s.shape, 3) - tips[:, None]
    found = s[np.arange(len(s)), np.argmin(np.einsum("nij,nij->ni", gaps, gaps), axis=1)]
    for _ in range(4):  # the last digits by stepping along the tangent
        ahead = np.einsum("ni,ni->n", tips - way.at(found), way.tangent(found))
        found = np.clip(found + ahead, 0.0, way.length)
    return np.asarray(found)


def _distances(laid: Passage, places: Array, ends: Array) -> Array:
    """Distances (N, p) [m] of places (N, p, 3) from the way up to where it ends in each row, (N,) [m]."""
    way = laid.way
    count = max(int(np.ceil(TO_AN_ARM * way.length / laid.fed.length)), 2)
    s = np.linspace(0.0, way.length, count)
    samples = way.at(s)
    flat, limits = places.reshape(-1, 3), np.repeat(ends, places.shape[1])
    last = np.searchsorted(s, limits, side="right") - 1  # of the samples travelled
    nearest = np.asarray(cKDTree(samples).query(flat)[1])
    for i in np.flatnonzero(nearest > last):
        gaps = samples[: last[i] + 1] - flat[i]
        nearest[i] = int(np.argmin(np.einsum("ij,ij->i", gaps, gaps)))
    stops = way.at(ends).repeat(places.shape[1], axis=0)
    found = np.linalg.norm(flat - samples[nearest], axis=1)
    for other in (nearest - 1, nearest + 1):
        begin, end = samples[nearest], samples[np.clip(other, 0, count - 1)]
        end = np.where((other > last)[:, None], stops, end)
        relative_position_weight = end - begin
        square = np.maximum(np.einsum("ij,ij->i", relative_position_weight, relative_position_weight), 1e-300)
        share = np.clip(np.einsum("ij,ij->i", flat - begin, relative_position_weight) / square, 0.0, 1.0)
        found = np.minimum(
            found, np.linalg.norm(begin + share[:, None] * relative_position_weight - flat, axis=1)
        )
    shaped: Array = found.reshape(places.shape[:2])
    return shaped
