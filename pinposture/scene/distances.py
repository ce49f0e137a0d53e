"""The distances of pairs of solids: bounds of all, exact ones of as few as it takes."""

from __future__ import annotations

import math
from collections.abc import Sequence

import coal
import numpy as np
from numpy.typing import NDArray

from pinposture.scene.bounds import Bounds
from pinposture.scene.narrow import Contact, Narrow, Posed
from pinposture.scene.solids import Solid

Array = NDArray[np.float64]

NO_PAIR = -1


class Distances:
    """Distances of pairs of a body and another, or of a body and an obstacle.

    Attributes:
        first: index of the body of each pair, (n,).
        second: index of the other body, or the number of bodies plus that of the obstacle, (n,).
    """

    def __init__(
        self,
        bodies: Sequence[Solid],
        joints: Sequence[int],
        fixed: Sequence[Solid],
        pairs: Sequence[tuple[int, int]],
    ) -> None:
        """Prepare for pairs; the arguments are those of `Bounds`."""
        self._bounds, self._narrow = Bounds(bodies, joints, fixed, pairs), Narrow()
        self.first, self.second = self._bounds.first, self._bounds.second
        self._solids, self._joints = [*bodies, *fixed], list(joints)
        self._fixed = [coal.Transform3s(each.rotation, each.position) for each in fixed]
        self._exact = np.flatnonzero(self._bounds.exact)
        self._inexact = np.flatnonzero(~self._bounds.exact)

    def near(
        self, turns: Array, shifts: Array, within: float
    ) -> tuple[list[tuple[int, Contact]], tuple[float, int]]:
        """The pairs nearer than a distance, and the nearest of all.

        Args:
            turns: rotations of the joints, (njoints, 3, 3).
            shifts: positions of the joints, (njoints, 3) [m].
            within: how near [m].

        Returns:
            Index and contact of each pair that is near, nearest first; distance and index of the nearest
            pair, near or not: infinity and `NO_PAIR` if there are none.
        """
        ends = self._bounds.ends(turns, shifts)
        lower = self._bounds.lower(ends)
        best, pair = np.inf, NO_PAIR
        found = []
        if len(self._exact):
            pair = int(self._exact[np.argmin(lower[self._exact])])
            best = float(lower[pair])
            chosen = self._exact[lower[self._exact] < within]
            contacts = zip(*self._bounds.contacts(ends, chosen), strict=True)
            found = [
                (int(k), Contact(float(lower[k]), n, p)) for k, (n, p) in zip(chosen, contacts, strict=True)
            ]
        places: dict[tuple[int, int], coal.Transform3s] = {}
        for k in self._inexact[np.argsort(lower[self._inexact])]:
            if lower[k] >= max(within, best):
                break
            contact = self._narrow.contact(self._posed(int(k), turns[None], shifts[None], 0, places))
            if math.isnan(contact.distance):
                contact = contact._replace(distance=float(lower[k]))
            if contact.distance < best:
                best, pair = contact.distance, int(k)
            if contact.distance < within:
                found.append((int(k), contact))
        return sorted(found, key=lambda each: each[1].distance), (best, pair)

    def minimum(self, turns: Array, shifts: Array, below: float = np.inf) -> tuple[float, int]:
        """Distance and index of the nearest pair at any of several configurations.

        Args:
            turns: rotations of the joints, (s, njoints, 3, 3).
            shifts: positions of the joints, (s, njoints, 3) [m].
            below: distances that matter [m]: of larger ones some is found, or none, in less time.

        Returns:
            Infinity and `NO_PAIR` if there are none.
        """
        lower = self._bounds.lower(self._bounds.ends(turns, shifts))  # (s, n)
        best, pair = np.inf, NO_PAIR
        if len(self._exact):
            exact = lower[:, self._exact]
            at = int(np.argmin(exact))
            best, pair = float(exact.flat[at]), int(self._exact[at % exact.shape[1]])
        rest = lower[:, self._inexact].ravel()
        open_ = np.flatnonzero(rest < min(best, below))
        places: dict[tuple[int, int], coal.Transform3s] = {}
        for at in open_[np.argsort(rest[open_])]:
            if rest[at] >= best:
                break
            sample, k = divmod(int(at), len(self._inexact))
            candidate = int(self._inexact[k])
            distance = self._narrow.distance(self._posed(candidate, turns, shifts, sample, places))
            if math.isnan(distance):  # on the safe side
                distance = float(rest[at])
            if distance < best:
                best, pair = distance, candidate
        return best, pair

    def axes(self, pair: int, turns: Array, shifts: Array) -> tuple[Array, Array]:
        """Ends of the axes of the capsules around both solids of a pair, (2, 3) each [m], world frame."""
        ends = self._bounds.ends(turns, shifts)
        return ends[self.first[pair]], ends[self.second[pair]]

    def _posed(
        self,
        pair: int,
        turns: Array,
        shifts: Array,
        sample: int,
        places: dict[tuple[int, int], coal.Transform3s],
    ) -> Posed:
        """Both solids of a pair and where they are; `places` remembers those of bodies."""
        posed = []
        for index in (int(self.first[pair]), int(self.second[pair])):
            each = self._solids[index]
            if index >= len(self._joints):
                place = self._fixed[index - len(self._joints)]
            elif (sample, index) in places:
                place = places[sample, index]
            else:
                turn, shift = turns[sample, self._joints[index]], shifts[sample, self._joints[index]]
                place = coal.Transform3s(turn @ each.rotation, turn @ each.position + shift)
                places[sample, index] = place
            posed += [each.geometry, place]
        return posed[0], posed[1], posed[2], posed[3]
