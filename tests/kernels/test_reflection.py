"""The reflection that zeroes a row: an orthogonal change of columns, finite however small the row."""

from __future__ import annotations

import numpy as np
import pytest

from pinposture.kernels.posture_matrix import _reflect

reflect = _reflect.py_func


@pytest.mark.parametrize("size", [1.0, 1e-8, 1e-29, 1e-40, 1e-120, 1e-161, 0.0])
def test_it_keeps_lengths_and_stays_finite(size: float) -> None:
    rng = np.random.default_rng(0)
    before = rng.normal(size=(6, 5))
    before[0] *= size
    after = before.copy()
    with np.errstate(all="ignore"):
        reflect(after, 0, 0, 5)
    assert np.all(np.isfinite(after))
    np.testing.assert_allclose(after @ after.T, before @ before.T, rtol=1e-12, atol=1e-12)
    np.testing.assert_allclose(after[0, 1:], 0.0, atol=1e-29)
