"""Manipulability indices of every section of the arm at once (Section 4.3)."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from pinposture import kernels
from pinposture.arm.screws import constants_of, screws_of

if TYPE_CHECKING:
    from pinposture.arm.state import ArmState

Array = NDArray[np.float64]


def all_pairs(state: ArmState) -> Array:
    """Index w[s, i] of every control point i relative to every control point s < i (0 is the base).

    w = (product of sigma) / sigma_max^d, (4.3) and (4.4), by the Gram matrices of the sections. It is
    resolved to about 1e-8, because the determinant of a Gram matrix is only known to machine precision.

    Args:
        state: where the arm is.

    Returns:
        Array (m + 1, m + 1) of indices in [0, 1], zero on and below the diagonal.
    """
    m = state.arm.n_modules
    indices = np.zeros((m + 1, m + 1))
    kernels.all_indices(*screws_of(state), constants_of(state.arm).plane, indices)
    return indices
