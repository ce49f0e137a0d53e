"""The deviation of an arm from the path that its tip has travelled."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.spatial import cKDTree

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import InvalidValue
from pinposture.task.follow_leader import Route

Array = NDArray[np.float64]

PIECES_PER_LINK = 8
"""Pieces into which each link is cut; distances are those of their ends."""

SAMPLES_PER_ARM = 4000
"""Samples of the path per arm length."""


@dataclass(frozen=True, eq=False)
class Deviation:
    """Distances of an arm from the path that its tip has travelled, including the straight line to the entry.

    Attributes:
        length: length of the arm from its first joint that bends to the tip, without the feed [m]; what
            percentages refer to.
        points: distance of each control point, (N, m) [m].
        body: largest distance of any part of the axis of the arm, joints, links and control points, (N,) [m].
        where: arc length of that part along the arm, from its first joint that bends, (N,) [m].
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
    """Measure the distance of an arm from the path that its tip has travelled.

    The distance of a point is that from the nearest place of the route from the first joint at the start to
    the current place of the tip; what lies farther ahead does not count.

    Args:
        arm: an arm on a feed, as in `follow_leader`.
        q: configurations, (N, nq), in order.
        path: the path, as it was given to `follow_leader`.
        placement: likewise.
        start: likewise.

    Returns:
        Distances, row by row.

    Raises:
        InvalidValue: as `follow_leader`, or configurations of the wrong shape.
        UnknownName: no such placement.
    """
    route = Route(arm, path, placement, start)
    fed, rows = route.fed, np.asarray(q, dtype=np.float64)
    if rows.ndim != 2 or rows.shape[1] != arm.nq or len(rows) == 0:
        raise InvalidValue("q (shape)", rows.shape, f"(1 or more, {arm.nq})")
    points, stations, feeds = [], [], []
    order = _stations(arm)
    for row in rows:
        state = arm.at(row)
        points.append(state.points)
        stations.append(np.vstack([state.forward.origins, state.points])[order])
        feeds.append(state.positions[fed.column])
    pieces, along = _cut_links(np.array(stations))  # (N, p, 3)
    begin = float(arm.positions(fed.start)[fed.column])
    depths = fed.sense * (np.array(feeds) - begin)
    whole = np.concatenate([pieces, np.array(points)], axis=1)
    distances = _distances(route, whole, _travelled(route, pieces[:, -1], depths))
    split = pieces.shape[1]
    worst = np.argmax(distances[:, :split], axis=1)
    body = np.take_along_axis(distances[:, :split], worst[:, None], axis=1)[:, 0]
    return Deviation(fed.length, distances[:, split:], body, along[worst])


def _stations(arm: Arm) -> list[int]:
    """Order joints that bend and control points from base to tip: indices into joints, then points."""
    joints, order = len(arm.chain.joints), []
    for k, module in enumerate(arm.chain.module_slices):
        order += [*range(module.start, module.stop), joints + k]
    return order[order.index(1) :]  # joint 0 is the feed


def _cut_links(stations: Array) -> tuple[Array, Array]:
    """Cut links into pieces: their places (N, p, 3), and their arc lengths along the arm, (p,) [m]."""
    shares = np.arange(1, PIECES_PER_LINK + 1) / PIECES_PER_LINK
    begins, links = stations[:, :-1, None], np.diff(stations, axis=1)[:, :, None]
    inner = (begins + shares[:, None] * links).reshape(len(stations), -1, 3)
    lengths = np.linalg.norm(links[0, :, 0], axis=1)
    along = (np.cumsum(lengths) - lengths)[:, None] + shares * lengths[:, None]
    return np.concatenate([stations[:, :1], inner], axis=1), np.append(0.0, along.ravel())


def _travelled(route: Route, tips: Array, depths: Array) -> Array:
    """Return the arc length of the route at the tip in each row, (N,) [m], near where the feed pushed it."""
    near, curve = route.fed.max_tip_lead, route.whole
    shifts = np.linspace(-near, near, 101)
    s = np.clip(route.fed.run_up + depths[:, None] + shifts, 0.0, curve.length)
    gaps = curve.at(s.ravel()).reshape(*s.shape, 3) - tips[:, None]
    found = s[np.arange(len(s)), np.argmin(np.einsum("nij,nij->ni", gaps, gaps), axis=1)]
    for _ in range(4):  # refined by steps along the tangent
        ahead = np.einsum("ni,ni->n", tips - curve.at(found), curve.tangent(found))
        found = np.clip(found + ahead, 0.0, curve.length)
    return np.asarray(found)


def _distances(route: Route, places: Array, ends: Array) -> Array:
    """Return distances (N, p) [m] of places (N, p, 3) from the route up to its end in each row, (N,) [m]."""
    curve = route.whole
    count = max(int(np.ceil(SAMPLES_PER_ARM * curve.length / route.fed.length)), 2)
    s = np.linspace(0.0, curve.length, count)
    samples = curve.at(s)
    flat, limits = places.reshape(-1, 3), np.repeat(ends, places.shape[1])
    last = np.searchsorted(s, limits, side="right") - 1  # of the samples travelled
    nearest = np.asarray(cKDTree(samples).query(flat)[1])
    for i in np.flatnonzero(nearest > last):
        gaps = samples[: last[i] + 1] - flat[i]
        nearest[i] = int(np.argmin(np.einsum("ij,ij->i", gaps, gaps)))
    stops = curve.at(ends).repeat(places.shape[1], axis=0)
    found = np.linalg.norm(flat - samples[nearest], axis=1)
    for other in (nearest - 1, nearest + 1):
        begin, end = samples[nearest], samples[np.clip(other, 0, count - 1)]
        chord = np.where((other > last)[:, None], stops, end) - begin
        square = np.maximum(np.einsum("ij,ij->i", chord, chord), 1e-300)
        share = np.clip(np.einsum("ij,ij->i", flat - begin, chord) / square, 0.0, 1.0)
        found = np.minimum(found, np.linalg.norm(begin + share[:, None] * chord - flat, axis=1))
    shaped: Array = found.reshape(places.shape[:2])
    return shaped
