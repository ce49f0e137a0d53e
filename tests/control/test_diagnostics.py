"""Diagnostics: numbers that are only computed when they are read."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.control import Diagnostics
from pinposture.control.controller import SingularValues
from pinposture.control.thesis.posture_matrix import PostureMatrix


def arm() -> pp.Arm:
    return template_arm("RyRz", 6)


def a_step(name: str) -> pp.control.Step:
    rng = np.random.default_rng(0)
    target = pp.Target.from_configuration(arm(), rng.uniform(-0.5, 0.5, 12))
    return pp.control.controller_named(name).step(arm().at(rng.uniform(-0.5, 0.5, 12)), target)


@pytest.mark.parametrize("name", ["selection", "projection"])
def test_singular_values_are_computed_when_they_are_read(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []
    extreme = PostureMatrix._extreme
    monkeypatch.setattr(
        PostureMatrix, "_extreme", lambda self, *args: asked.append(args) or extreme(self, *args)
    )
    note = a_step(name).diagnostics._replace(method="it", following_path=True)
    assert not asked
    assert 0.0 < note.sigma_min < note.sigma_max
    assert (note.sigma_min, note.sigma_max) == (note.sigma_min, note.sigma_max)
    assert len(asked) == 2  # once each
    again = pickle.loads(pickle.dumps(note))
    assert (again.sigma_min, again.method) == (note.sigma_min, "it")


def test_numbers_stay_numbers() -> None:
    clipped = np.zeros(2, dtype=bool)
    note = Diagnostics(clipped, manipulability=0.5, spectrum=SingularValues(0.1, 2.0), rows=3)
    assert (note.sigma_min, note.sigma_max, note.manipulability) == (0.1, 2, 0.5)
    assert isinstance(note._replace(reason="none"), Diagnostics)


def test_without_a_matrix_there_are_no_singular_values() -> None:
    note = a_step("geodesic").diagnostics
    assert note.spectrum is None and (note.sigma_min, note.sigma_max) == (0.0, 0.0)


def test_a_run_keeps_numbers() -> None:
    target = pp.Target.from_configuration(arm(), np.full(12, 0.3))
    states = []
    run = pp.track(
        arm(), target, np.full(12, 0.1), "selection", max_steps=5, callback=lambda *a: states.append(a[1])
    )
    for state, active, smallest, largest in zip(
        [arm().at(q) for q in run.q], run.active_sets, run.sigma_min, run.sigma_max, strict=False
    ):
        sigma = np.linalg.svd(state.task_jacobians[list(active)].reshape(-1, 12), compute_uv=False)
        np.testing.assert_allclose([smallest, largest], sigma[[-1, 0]], rtol=1e-9)
