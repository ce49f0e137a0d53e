"""Which pairs of solids are looked at, and which cannot be told apart by any motion of the arm.

Left out are
* bodies on one joint, and bodies on joints that follow each other: they touch where they are joined;
* bodies of the arm that are nearer to each other than twice the margin where the arm is stretched farthest,
  or at its neutral configuration: links so thick or so short that their neighbours' neighbours touch, tubes
  that slide in one another, meshes that overlap as they were made. Had they to keep clear, the arm could not
  even stand straight;
* an obstacle that the arm is mounted on: one within the margin of an end of a body that no joint moves;
* bodies that no joint moves, against obstacles;
* pairs that are within the margin in every posture that is tried, the straight one and many arbitrary ones:
  something beside the base, that the first links pass however the arm bends. These are also warned of. If the
  last body is among them, the arm is inside of an obstacle, and nothing is left out.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, NamedTuple, TypeAlias

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.scene.bodies import Body
from pinposture.scene.distances import Distances
from pinposture.scene.narrow import Narrow
from pinposture.scene.placements import Placements
from pinposture.scene.solids import Solid

if TYPE_CHECKING:
    from pinposture.scene.scene import Scene

Array = NDArray[np.float64]
IndexPair: TypeAlias = tuple[int, int]

POSTURES = 40
"""Arbitrary postures that are tried before a pair counts as one that can never keep the margin."""

STRETCHED = 2.0
"""Bodies nearer than this many margins where the arm is straight are left out."""
ALWAYS_CLOSE = "within the margin however the arm bends"
"""Why a pair is left out that is also warned of."""

_STILL = 1e-9
"""How far a point may move that does not move, relative to the arm."""


class LeftOut(NamedTuple):
    """A pair whose distance is not looked at, though neither one joint nor a common one holds it together.

    Attributes:
        first: name of the body.
        second: name of the other body, or of the obstacle.
        reason: why.
    """

    first: str
    second: str
    reason: str


def self_pairs(model: pin.Model, bodies: Sequence[Body]) -> Iterator[IndexPair]:
    """The pairs of bodies that can move against each other and are not joined by one joint."""
    for second, other in enumerate(bodies):
        for first, body in enumerate(bodies[:second]):
            joints = (body.joint, other.joint)
            joined = any(a == b or int(model.parents[a]) == b for a, b in (joints, joints[::-1]) if a or b)
            if not joined and joints != (0, 0):
                # The one nearer to the tip comes first: it is the one that moves away.
                yield (second, first) if other.joint >= body.joint else (first, second)


def choose_pairs(
    arm: Arm,
    places: Placements,
    bodies: Sequence[Body],
    solids: Sequence[Solid],
    obstacles: Mapping[str, Solid],
    scene: Scene,
) -> tuple[list[IndexPair], dict[IndexPair, str]]:
    """The pairs to look at, by the rules above.

    Args:
        arm: the arm.
        places: scratch data of its model.
        bodies: its bodies.
        solids: the same as solids.
        obstacles: the obstacles.
        scene: what the pairs are for.

    Returns:
        Pairs of a body and another, or of a body and the number of bodies plus that of an obstacle; and those
        left out, with the reason.
    """
    fixed, count = list(obstacles.values()), len(bodies)
    standing = _mounted(arm, places, bodies, solids, fixed, scene.margin)
    left_out = dict.fromkeys(sorted(standing), "the arm is mounted on it")
    moving = [index for index, body in enumerate(bodies) if body.joint]
    against = [(index, count + k) for index in moving for k in range(len(fixed))]
    own = list(self_pairs(arm.model, bodies)) if scene.self_collision else []
    near = Distances(solids, [body.joint for body in bodies], [], own)
    touching = set[IndexPair]()
    for q in (arm.straight(), arm.neutral()):
        pin.forwardKinematics(arm.model, places.data, q)
        limit = STRETCHED * scene.margin + _STILL * arm.length
        found, _ = near.near(places.rotations, places.positions, limit)
        touching |= {(int(near.first[k]), int(near.second[k])) for k, _ in found}
    left_out |= dict.fromkeys(sorted(touching), "near each other where the arm is straight or neutral")
    left = [pair for pair in (*against, *own) if pair not in left_out]
    close = dict.fromkeys(_always_close(arm, places, bodies, solids, fixed, left, scene.margin), ALWAYS_CLOSE)
    return [pair for pair in left if pair not in close], left_out | close


def _always_close(
    arm: Arm,
    places: Placements,
    bodies: Sequence[Body],
    solids: Sequence[Solid],
    fixed: Sequence[Solid],
    pairs: Sequence[IndexPair],
    margin: float,
) -> list[IndexPair]:
    """Pairs that are nearer than the margin in every posture that is tried."""
    rng, left = np.random.default_rng(0), list(pairs)
    postures = (arm.straight(), arm.neutral(), *(arm.random(rng) for _ in range(POSTURES)))
    for q in postures:
        if not left:
            break
        distances = Distances(solids, [body.joint for body in bodies], fixed, left)
        pin.forwardKinematics(arm.model, places.data, q)
        found, _ = distances.near(places.rotations, places.positions, margin)
        left = [(int(distances.first[k]), int(distances.second[k])) for k in sorted(k for k, _ in found)]
    # What not even the tip comes clear of is no neighbour of the base: the arm is inside of it.
    around_all = {second for first, second in left if second >= len(bodies) and first == len(bodies) - 1}
    return [pair for pair in left if pair[1] not in around_all]


def _mounted(
    arm: Arm,
    places: Placements,
    bodies: Sequence[Body],
    solids: Sequence[Solid],
    fixed: Sequence[Solid],
    margin: float,
) -> set[IndexPair]:
    """Pairs of a body and an obstacle that some point of the body never moves away from."""
    ends = np.array([[each.start, each.end] for each in solids]).reshape(-1, 2, 3)
    joints, rng, found = [body.joint for body in bodies], np.random.default_rng(0), []
    for q in (arm.neutral(), arm.random(rng), arm.random(rng)):
        pin.forwardKinematics(arm.model, places.data, q)
        turns, shifts = places.rotations[joints], places.positions[joints]
        found.append(ends @ turns.swapaxes(1, 2) + shifts[:, None])
    still = np.ptp(found, axis=0).max(axis=2) <= _STILL * arm.length  # (bodies, 2)
    narrow, pairs = Narrow(), set()
    for body, end in np.argwhere(still & (np.array(joints) > 0)[:, None]):
        radius = solids[body].radius if solids[body].round else 1e-3 * _STILL * arm.length
        ball, at = coal.Sphere(radius), coal.Transform3s(np.eye(3), found[0][body, end])
        for k, each in enumerate(fixed):
            there = coal.Transform3s(each.rotation, each.position)
            if narrow.distance((ball, at, each.geometry, there)) <= margin:
                pairs.add((int(body), len(bodies) + k))
    return pairs
