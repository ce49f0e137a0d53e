"""What steps report: numbers that are only computed when they are read."""

from __future__ import annotations

import pickle

import numpy as np
import pytest
from arms import template_arm

import pinposture as pp
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
    info = a_step(name).info | {"method": "it"}
    assert not asked
    assert 0.0 < info["sigma_min"] < info["sigma_max"]
    assert (info["sigma_min"], info["sigma_max"]) == (info["sigma_min"], info["sigma_max"])
    assert len(asked) == 2  # once each
    again = pickle.loads(pickle.dumps(info))
    assert again.keys() == info.keys()
    assert again["sigma_min"] == info["sigma_min"]
    assert again["method"] == "it"


def test_a_controller_without_a_matrix_reports_nothing() -> None:
    assert a_step("geodesic").info == {}
    assert set(a_step("joint").info) == {"scale"}


def test_a_run_keeps_numbers() -> None:
    target = pp.Target.from_configuration(arm(), np.full(12, 0.3))
    states = []
    run = pp.track(
        arm(), target, np.full(12, 0.1), "selection", max_steps=5, callback=lambda *a: states.append(a[1])
    )
    for state, active, smallest, largest in zip(
        [arm().at(q) for q in run.q],
        run.active_sets,
        run.info["sigma_min"],
        run.info["sigma_max"],
        strict=False,
    ):
        sigma = np.linalg.svd(state.task_jacobians[list(active)].reshape(-1, 12), compute_uv=False)
        np.testing.assert_allclose([smallest, largest], sigma[[-1, 0]], rtol=1e-9)
