"""Bends of neighbouring modules against sums over pairs."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

from pinposture import kernels


@pytest.mark.parametrize("sizes", [(2,) * 7, (1,) * 9, (1, 2, 2, 1, 1, 3, 3, 2), (4,)])
def test_modules_with_as_many_joints_are_compared(sizes: tuple[int, ...]) -> None:
    starts = np.cumsum([0, *sizes])
    q = np.random.default_rng(len(sizes)).normal(size=starts[-1])
    modules = [q[a:b] for a, b in pairwise(starts)]
    pairs = [(a, b) for a, b in pairwise(modules) if len(a) == len(b)]
    products, norms = kernels.neighbours(q, starts)
    assert products == pytest.approx(sum(a @ b for a, b in pairs), abs=1e-12)
    assert norms == pytest.approx(sum(np.linalg.norm(a) * np.linalg.norm(b) for a, b in pairs), abs=1e-12)
