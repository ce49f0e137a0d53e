"""Whether the modules of an arm can follow a curve (Section 4.1).

If all modules have the same joint angles, the control points lie on a helix, because repeating one rigid
motion is a screw motion. The curvature and torsion of that helix follow from the module's forward kinematics,
so the curvature that a module can follow is found without solving for a target.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm.kinematics import Chain
from pinposture.curve import Curve
from pinposture.units import length_text

Array = NDArray[np.float64]

QUARTER_TURN = np.pi / 2
"""Largest turn of the curve, or of its bending direction, within one module [rad].

With fewer than four modules per turn, the control points no longer resolve the shape of the curve: each may
lie on the curve while the chain cuts across its loops."""


@dataclass(frozen=True)
class Violation:
    """A stretch of the curve that the modules cannot follow.

    Attributes:
        quantity: "curvature" or "torsion".
        start: arc length at its start [m].
        end: arc length at its end [m].
        worst: the largest value on it [1/m].
        allowed: the largest value that the modules can follow [1/m].
    """

    quantity: str
    start: float
    end: float
    worst: float
    allowed: float

    def __str__(self) -> str:
        where = f"between {length_text(self.start)} and {length_text(self.end)} along the curve"
        times = (
            f"{self.worst / self.allowed:.3g} times the {self.allowed:.4g} /m" if self.allowed else "none is"
        )
        return f"{self.quantity} up to {self.worst:.4g} /m {where}, {times} allowed"


@dataclass(frozen=True)
class Feasibility:
    """Whether the modules can follow a curve; truthy if they can.

    Attributes:
        max_curvature: largest curvature that every module can follow in any direction [1/m].
        max_torsion: largest torsion that every module can follow [1/m].
        curvature: largest curvature of the curve [1/m].
        torsion: largest absolute torsion of the curve's bending within one module [1/m].
        excesses: the stretches that the modules cannot follow, in order along the curve.
    """

    max_curvature: float
    max_torsion: float
    curvature: float
    torsion: float
    excesses: tuple[Violation, ...]

    def __bool__(self) -> bool:
        return not self.excesses


def check_feasibility(chain: Chain, lower: Array, upper: Array, curve: Curve) -> Feasibility:
    """Compare the curvature and torsion of a curve with those that the modules can follow.

    Only the part of the curve that the arm can cover counts. Torsion is averaged over one module, weighted by
    curvature, because torsion peaks where a curve hardly bends do not matter. `lower` and `upper` are the
    position limits, (nv,) [rad or m].
    """
    span = float(chain.spans.max())
    allowed_curvature = min(_largest_curvature(chain, k, lower, upper) for k in range(len(chain.points)))
    allowed_torsion = QUARTER_TURN / span
    s = np.linspace(0.0, min(curve.length, chain.length), 2000)
    curvature = np.asarray(curve.curvature(s))
    torsion = _weighted_torsion(s, curvature, np.abs(curve.torsion(s)), span)
    excesses = [
        *_exceeding("curvature", s, curvature, allowed_curvature),
        *_exceeding("torsion", s, torsion, allowed_torsion),
    ]
    return Feasibility(
        max_curvature=allowed_curvature,
        max_torsion=allowed_torsion,
        curvature=float(curvature.max()),
        torsion=float(torsion.max()),
        excesses=tuple(sorted(excesses, key=lambda excess: excess.start)),
    )


def _weighted_torsion(s: Array, curvature: Array, torsion: Array, span: float) -> Array:
    """Curvature-weighted mean torsion within a span around each point, (n,) [1/m]; 0 if straight."""
    low = np.maximum(s - span / 2.0, s[0])
    high = np.minimum(s + span / 2.0, s[-1])

    def integral(values: Array) -> Array:
        sums = np.concatenate([[0.0], np.cumsum(np.diff(s) * (values[1:] + values[:-1]) / 2.0)])
        return np.asarray(np.interp(high, s, sums) - np.interp(low, s, sums))

    bend = integral(curvature)
    # With less bend within a module, a curve deviates from its chord by less than 1/80 of the module length.
    least = 0.1
    return np.where(bend > least, integral(curvature * torsion) / np.maximum(bend, least), 0.0)


def _largest_curvature(chain: Chain, module: int, lower: Array, upper: Array) -> float:
    """Curvature that the weakest joint of a module reaches alone, in its weaker direction.

    A curve may bend in any direction; the directions in which only one joint contributes are the hardest.
    Joints that do not bend the module (a roll, a slide) are ignored; coupled joints bend it together.
    """
    start = chain.base if module == 0 else chain.points[module - 1]
    span = chain.points[module] - start
    if chain.module_lengths[module] <= 1e-12 * chain.length:
        return 0.0  # the module has no length
    along = span / chain.module_lengths[module]
    joints = chain.module_slices[module]
    reachable = []
    for column in dict.fromkeys(chain.columns[joints].tolist()):
        driven = np.flatnonzero(chain.columns[joints] == column) + joints.start
        amounts = chain.ratios[driven] * chain.revolute[driven]
        turn = amounts @ chain.axes[driven]
        size = float(np.linalg.norm(turn))
        if size < 1e-12 or np.linalg.norm(turn - along * (along @ turn)) < 0.1 * size:
            continue
        # A section of coupled joints is itself curved, so half a turn still resolves the shape of the curve.
        most = (QUARTER_TURN if len(driven) == 1 else 2.0 * QUARTER_TURN) / size
        bends = []
        for limit in (lower[column], upper[column]):
            values = np.linspace(0.0, np.clip(limit, -most, most), 91)
            bends.append(float(_module_curvature(chain, module, driven, values).max()))
        reachable.append(min(bends))
    return min(reachable, default=0.0)


def _module_curvature(chain: Chain, module: int, joints: NDArray[np.intp], values: Array) -> Array:
    """Return the curvature of a module bent only by `joints`, which share one degree of freedom, (n,) [1/m].

    It is that of the helix that repeats the motion from the base of the module to its end. `values` are the
    positions of the degree of freedom, (n,) [rad].
    """
    start = chain.base if module == 0 else chain.points[module - 1]
    turn = Rotation.from_rotvec(np.zeros((len(values), 3)))
    shift = np.zeros((len(values), 3))
    for u in joints:
        amount = chain.ratios[u] * values[:, None] * chain.axes[u]
        origins = turn.apply(chain.origins[u]) + shift
        if chain.revolute[u]:
            turn = turn * Rotation.from_rotvec(amount)
        else:
            origins += turn.apply(amount)
        shift = origins - turn.apply(chain.origins[u])
    displacements = turn.apply(chain.points[module]) + shift - start
    turns = turn.as_rotvec()
    angles = np.maximum(np.linalg.norm(turns, axis=1), 1e-12)
    axes = turns / angles[:, None]
    along = np.einsum("ni,ni->n", displacements, axes)
    across = np.linalg.norm(displacements - along[:, None] * axes, axis=1)
    radius = across / (2.0 * np.sin(angles / 2.0))
    return np.where(angles > 1e-12, radius / (radius**2 + (along / angles) ** 2), 0.0)


def _exceeding(quantity: str, s: Array, values: Array, allowed: float) -> list[Violation]:
    over = np.concatenate([[False], values > allowed * (1.0 + 1e-9), [False]])
    edges = np.flatnonzero(np.diff(over.astype(np.int8)))
    return [
        Violation(quantity, float(s[a]), float(s[b - 1]), float(values[a:b].max()), allowed)
        for a, b in zip(edges[::2], edges[1::2], strict=True)
    ]
