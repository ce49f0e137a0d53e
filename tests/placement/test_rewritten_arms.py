"""The same arm written down in another way, or with its axes moved aside, finds the same or a good target."""

from __future__ import annotations

import warnings
import xml.etree.ElementTree as ET

import numpy as np
import pytest
from arm.rewriting import numbers, renamed, turned_frames, vector, with_fixed_joints, with_sensors

import pinposture as pp
from benchmarks.cases.families import gentle_curve


def load(text: str) -> pp.Arm:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", pp.PostureWarning)
        return pp.Arm.load(text)


@pytest.mark.parametrize("template", ["RyRz", "Rz"])
@pytest.mark.parametrize("seed", range(4))
def test_an_arm_written_in_another_way_has_the_same_targets(template: str, seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = pp.Arm.from_template(template, 8)
    text, _ = renamed(arm.urdf, rng)
    for change in (with_sensors, with_fixed_joints, turned_frames):
        text = change(text, rng)
    other = load(text)
    for method in ("auto", "closest"):
        # A sensor a little beyond the tip may have become the tip, which turns the arm's axis a little.
        expected, found = (
            pp.resolve_targets(each, gentle_curve(arm), placement="as_is", method=method)
            for each in (arm, other)
        )
        np.testing.assert_allclose(found.points[:-1], expected.points[:-1], atol=2e-6 * arm.length)
        np.testing.assert_allclose(found.parameters[:-1], expected.parameters[:-1], atol=2e-6 * arm.length)


def test_axes_that_stand_aside_of_the_links_are_no_obstacle() -> None:
    root = ET.fromstring(pp.Arm.from_template("RyRz", 8, (0.03, 0.03)).urdf)
    for number, joint in enumerate(root.findall("joint")):
        aside = np.array([0.0, 0.004, -0.003]) * (1 if number % 2 else -1)
        joint.find("origin").set("xyz", numbers(vector(joint, "origin", "xyz") + aside))
    arm = load(ET.tostring(root, encoding="unicode"))
    assert [len(joints) for joints in arm.module_joints] == [2] * 8
    target = pp.resolve_targets(arm, gentle_curve(arm))
    assert target.method == "closest"
    assert np.all(target.has_target)
    assert np.sqrt(np.mean(target.residual**2)) < 1e-6 * arm.length
    run = pp.track(arm, target, arm.random(np.random.default_rng(0)), "joint")
    assert run.converged
