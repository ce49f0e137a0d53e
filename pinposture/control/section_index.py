"""Manipulability indices of sections, next to the best that links of those lengths can have.

The index of (4.4) is 1 only where the arm moves its end equally well in every direction. Two links of one
length never get there: their best is (sqrt(5) - 1) / 2. A score that multiplies indices, as (4.8) does,
would count every such section as a loss, however good its posture; relative to the best it does not.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from pinposture import kernels
from pinposture.arm import Arm, ArmState
from pinposture.arm.chain import Chain
from pinposture.arm.screws import constants_of
from pinposture.control.sections import SectionEdges
from pinposture.kernels.arrays import Screws

Array = NDArray[np.float64]

NEVER = 1e-3
"""A section whose best index is below this counts as always singular; its indices stay as they are."""


def best_index(lengths: tuple[float, ...]) -> float:
    """Largest manipulability index of a planar chain of hinges, over all its postures.

    Args:
        lengths: distances from each hinge to the next and from the last one to the end, (n,) [m].

    Returns:
        An index in [0, 1]: exact for two links, to about 1e-9 for three, an upper bound of 1 for more; 0 for
        fewer, or where links without length leave one direction only.
    """
    if len(lengths) < 2 or max(lengths) <= 0.0:
        return 0.0
    shares = tuple(float(length) / max(lengths) for length in lengths)
    if len(shares) == 2:
        # The elbow at cos q = -2 l1 l2 / (l1^2 + 2 l2^2) has the largest determinant for its trace.
        first, second = shares
        ratio = first * second / np.hypot(first**2, 2.0 * second**2)
        return float(2.0 * ratio / (1.0 + np.sqrt(max(1.0 - 4.0 * ratio**2, 0.0))))
    return _best_of_three(shares) if len(shares) == 3 else 1.0


@lru_cache(maxsize=1024)
def _best_of_three(lengths: tuple[float, float, float]) -> float:
    """Best index of three links: a grid over the two inner joints, then a search from each of its peaks.

    Peaks where the index is 1 are sharp and can look low on the grid, hence several of them. Mirrored
    postures have the same index, hence half of them.
    """
    angles = np.linspace(-np.pi, np.pi, 180, endpoint=False)
    index = _planar_index(lengths, angles[:, None], angles)
    around = [np.roll(index, (i, j), (0, 1)) for i in (-1, 0, 1) for j in (-1, 0, 1)]
    peaks = np.argwhere((index >= np.max(around, axis=0)) & (angles[:, None] >= 0.0))
    highest = peaks[np.argsort(-index[tuple(peaks.T)], kind="stable")][:6]
    found = [
        minimize(
            lambda inner: -float(_planar_index(lengths, *inner)),
            angles[peak],
            method="Nelder-Mead",
            options={"xatol": 1e-9, "fatol": 1e-12},
        )
        for peak in highest
    ]
    return -float(min(result.fun for result in found))


def _planar_index(lengths: tuple[float, float, float], middle: Array, last: Array) -> Array:
    """Index of three links at given inner joint positions.

    With z_u the vector from hinge u to the end as a complex number, the eigenvalues of J J^T have the sum
    sum |z_u|^2 and the difference |sum z_u^2|.
    """
    third = lengths[2] + 0j
    second = third + lengths[1] * np.exp(-1j * last)
    first = second + lengths[0] * np.exp(-1j * (last + middle))
    trace = np.abs(first) ** 2 + np.abs(second) ** 2 + abs(third) ** 2
    spread = np.abs(first**2 + second**2 + third**2)
    return np.asarray(np.sqrt(np.maximum(trace - spread, 0.0) / np.maximum(trace + spread, 1e-300)))


def section_indices(state: ArmState, strides: tuple[int, ...]) -> Array:
    """Manipulability indices of the sections of one of the strides, relative to the best that each can have.

    The best is known for planar sections of two or three hinges. The indices of longer sections, of sections
    with a slide and of spatial arms stay as they are.

    Args:
        state: where the arm is.
        strides: how many modules a section may have.

    Returns:
        Array (m + 1, m + 1) like that of `ArmState.manipulability`, in [0, 1]; what is not a section of one
        of the strides stays as it is, too.
    """
    indices = np.array(state.manipulability())
    for stride, best in zip(strides, _best_indices(state.arm.chain, strides), strict=True):
        starts = np.arange(len(indices) - stride)
        indices[starts, starts + stride] /= best[stride:]
    return np.minimum(indices, 1.0)


def section_edges(
    arm: Arm, screws: Screws, usable: NDArray[np.bool_], threshold: float, strides: tuple[int, ...]
) -> SectionEdges:
    """The edges of the tree of sections, with the indices that `section_indices` has for them.

    Args:
        arm: the arm.
        screws: how its joints move it.
        usable: which control points may be active, (m,).
        threshold: an edge is unstable unless its index exceeds this.
        strides: how many modules a section may have; increasing.
    """
    indices = np.zeros((len(strides), arm.n_modules + 1))
    wanted = np.array(strides, dtype=np.int64)
    kernels.stride_indices(*screws, constants_of(arm).plane, wanted, indices)
    return SectionEdges.of(
        np.minimum(indices / _best_indices(arm.chain, strides), 1.0), usable, threshold, strides
    )


@lru_cache(maxsize=64)
def _best_indices(chain: Chain, strides: tuple[int, ...]) -> Array:
    """Best index of the section to each node from so many modules before, (S, m + 1)."""
    m = len(chain.points)
    best = np.ones((len(strides), m + 1))
    if len(chain.plane) == 2:
        for row, stride in zip(best, strides, strict=True):
            for start in range(m + 1 - stride):
                lengths = _section_lengths(chain, start, start + stride)
                if 2 <= len(lengths) <= 3:
                    found = best_index(lengths)
                    row[start + stride] = found if found > NEVER else 1.0
    return best


def _section_lengths(chain: Chain, start: int, end: int) -> tuple[float, ...]:
    """Distances between the axes of the hinges of a section and from the last to its end; () with a slide.

    Rounded to twelve digits: sections of equal links are equal however the file writes them.
    """
    joints = slice(chain.module_slices[start].start, chain.module_slices[end - 1].stop)
    if not np.all(chain.revolute[joints]):
        return ()
    stations = np.vstack([chain.origins[joints], chain.points[end - 1]]) @ chain.plane.T
    return tuple(float(f"{length:.12g}") for length in np.linalg.norm(np.diff(stations, axis=0), axis=1))
