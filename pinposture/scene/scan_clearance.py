"""How far an arm is from a scan of what surrounds it."""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm
from pinposture.arm.configurations import ConfigurationSpace
from pinposture.errors import InvalidValue
from pinposture.scene.bodies import Body, bodies_of
from pinposture.scene.checks import SMALLEST, length
from pinposture.scene.obstacles import Sphere
from pinposture.scene.pairs import LeftOut
from pinposture.scene.placements import placements_of
from pinposture.scene.scan import Scan
from pinposture.scene.scan_distances import ScanDistances
from pinposture.scene.solids import solid

Array = NDArray[np.float64]

MOUNTED = 0.01
"""How near a scan has to be to where the arm is fixed to count as what it is mounted on [m]."""

_STILL = 1e-9
"""How far a point may move that does not move, relative to the arm."""


class ScanGap(NamedTuple):
    """Where an arm is nearest to a scan.

    Attributes:
        distance: from the surface of the arm to the nearest point of the scan [m]. Negative where points of
            the scan are inside of the arm: how deep the deepest lies. Infinite if no body is looked at.
        body: name of the body that is nearest; None if no body is looked at.
        on_arm: the point of its surface, (3,) [m], world frame; None likewise.
        on_scan: the point of the scan, (3,) [m], world frame; None likewise.
    """

    distance: float
    body: str | None
    on_arm: Array | None
    on_scan: Array | None


class ScanClearance:
    """The distance of an arm from a scan; make one with `Scan.around`. May be shared between threads.

    It is exact, for points and for triangles; how deep a triangle goes into a body that is neither a ball nor
    a capsule is found to within 0.01 mm.

    Attributes:
        bodies: names of the bodies that are looked at, from base to tip.
        left_out: bodies that are not: those that no joint moves, and those that have a point that stands
            still within `MOUNTED` of the scan, which is what the arm is mounted on.
    """

    def __init__(self, scan: Scan, arm: Arm, arm_radius: float | None = None) -> None:
        # Neither the arm nor the scan itself: what remembers clearances by them would never forget them.
        if not isinstance(arm, Arm):
            raise InvalidValue("arm", arm, "an Arm")
        radius = None if arm_radius is None else length("arm_radius", arm_radius)
        self._model, self._space, self._places = (
            arm.model,
            ConfigurationSpace(arm.model),
            placements_of(arm),
        )
        listed = bodies_of(arm, radius)
        moved = [body for body in listed if body.joint]
        standing = self._standing(scan, arm, moved)
        reasons = {body.name: "no joint moves it" for body in listed if not body.joint}
        reasons |= {moved[k].name: "the arm is mounted on the scan" for k in standing}
        self.left_out = tuple(LeftOut(name, scan.name, why) for name, why in reasons.items())
        left = [body for k, body in enumerate(moved) if k not in standing]
        self.bodies = tuple(body.name for body in left)
        self._joints = [body.joint for body in left]
        self._distances = ScanDistances([body.shape for body in left], scan.tree) if left else None

    def minimum(self, q: ArrayLike) -> ScanGap:
        """How far the arm is from the scan at a configuration, and where.

        Args:
            q: configuration, (nq,) [rad or m].

        Raises:
            InvalidValue: q has the wrong size or is not finite.
        """
        pin.forwardKinematics(self._model, self._places.data, self._space.checked(q))
        if self._distances is None:
            return ScanGap(np.inf, None, None, None)
        turns, shifts = self._places.rotations[self._joints], self._places.positions[self._joints]
        found = self._distances.nearest(turns, shifts)
        return ScanGap(found.distance, self.bodies[found.body], found.on_body, found.on_scan)

    def _standing(self, scan: Scan, arm: Arm, bodies: list[Body]) -> set[int]:
        """Indices of the bodies by which the arm is mounted on the scan."""
        ends = np.array([[each.start, each.end] for each in (solid(body.shape) for body in bodies)])
        joints, rng, found = [body.joint for body in bodies], np.random.default_rng(0), []
        if not bodies:
            return set()
        for q in (arm.neutral(), arm.random(rng), arm.random(rng)):
            pin.forwardKinematics(arm.model, self._places.data, q)
            turns, shifts = self._places.rotations[joints], self._places.positions[joints]
            found.append(ends @ turns.swapaxes(1, 2) + shifts[:, None])
        still = np.ptp(found, axis=0).max(axis=2) <= _STILL * arm.length  # (bodies, 2)
        mounted = set()
        for body, end in np.argwhere(still):
            shape = solid(bodies[body].shape)
            ball = Sphere((0.0, 0.0, 0.0), shape.radius if shape.round else SMALLEST)
            place = ScanDistances([ball], scan.tree).nearest(np.eye(3)[None], found[0][body, end][None])
            if place.distance <= MOUNTED:
                mounted.add(int(body))
        return mounted


_KNOWN: WeakKeyDictionary[Scan, WeakKeyDictionary[Arm, dict[float | None, ScanClearance]]]
_KNOWN = WeakKeyDictionary()
_MOST = 16  # radii with which one arm is remembered


def scan_clearance(arm: Arm, scan: Scan, q: ArrayLike, arm_radius: float | None = None) -> ScanGap:
    """How far an arm is from a scan at a configuration, and where; what this takes to prepare is remembered.

    Args:
        arm: the arm.
        scan: the scan.
        q: configuration, (nq,) [rad or m].
        arm_radius: as in `Scan.around`.

    Raises:
        InvalidValue: as in `Scan.around` and `ScanClearance.minimum`.
    """
    for name, value, kind in (("scan", scan, Scan), ("arm", arm, Arm)):
        if not isinstance(value, kind):
            raise InvalidValue(name, value, "an Arm" if kind is Arm else "a Scan")
    known = _KNOWN.setdefault(scan, WeakKeyDictionary()).setdefault(arm, {})
    if arm_radius not in known:
        if len(known) >= _MOST:
            known.clear()
        known[arm_radius] = ScanClearance(scan, arm, arm_radius)
    return known[arm_radius].minimum(q)
