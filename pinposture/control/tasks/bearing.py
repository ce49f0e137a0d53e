"""Where the links of an arm point, and about which axes they can turn, whatever its configuration."""

from __future__ import annotations

from typing import NamedTuple
from weakref import WeakKeyDictionary

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.arm.skeleton import ON_AXIS, PARALLEL

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class Bearing(NamedTuple):
    """What can be said of the control points' orientation whatever the configuration.

    Attributes:
        links: direction of the link that ends at each control point, unit vectors, (m, 3), in its own frame.
        turns: along how many axes each can turn, (m,): 0 if all joints before it slide, 1 if those that turn
            are parallel, else 3.
        axes: the axis about which it turns where there is one, unit vectors, (m, 3), world frame; else zero.
    """

    links: Array
    turns: Indices
    axes: Array


_KNOWN: WeakKeyDictionary[Arm, Bearing] = WeakKeyDictionary()


def bearing(arm: Arm) -> Bearing:
    """The bearing of an arm; remembered as long as the arm lives.

    The link that ends at a control point comes from the last joint origin or control point before it along
    the chain that lies elsewhere. Its direction at the neutral configuration is kept fixed in the frame of
    the control point. For template arms this is the x axis of that frame. Where the link belongs to the same
    body as the point, as it does unless the last joint sits at the point itself, it is the link at every
    configuration. Where there is no such place before the point, it is the x axis, too.
    """
    if arm not in _KNOWN:
        turns, axes = _turning(arm)
        _KNOWN[arm] = Bearing(_links(arm), turns, axes)
    return _KNOWN[arm]


def _links(arm: Arm) -> Array:
    chain = arm.chain
    links, stations = np.zeros((arm.n_modules, 3)), [chain.base]
    for k, (joints, turn) in enumerate(
        zip(chain.module_slices, arm.at(arm.neutral()).rotations, strict=True)
    ):
        stations.extend(chain.origins[joints])
        spans = chain.points[k] - np.array(stations)
        elsewhere = np.flatnonzero(np.linalg.norm(spans, axis=1) > ON_AXIS * arm.length)
        link = turn.T @ spans[elsewhere[-1]] if len(elsewhere) else np.array([1.0, 0.0, 0.0])
        links[k] = link / np.linalg.norm(link)
        stations.append(chain.points[k])
    return links


def _turning(arm: Arm) -> tuple[Indices, Array]:
    chain = arm.chain
    turns, axes = np.zeros(arm.n_modules, dtype=np.intp), np.zeros((arm.n_modules, 3))
    for k, joints in enumerate(chain.module_slices):
        before = chain.axes[: joints.stop][chain.revolute[: joints.stop]]
        if len(before):
            mean = np.where(before @ before[0] < 0.0, -1.0, 1.0) @ before
            mean /= np.linalg.norm(mean)
            parallel = np.all(np.linalg.norm(np.cross(before, mean), axis=1) < PARALLEL)
            turns[k], axes[k] = (1, mean) if parallel else (3, axes[k])
    return turns, axes
