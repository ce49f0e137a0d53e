"""Of a target only the part that is controlled is drawn boldly."""

from __future__ import annotations

import numpy as np
import pytest
import umsgpack
from matplotlib.figure import Figure

import pinposture as pp
from pinposture.view.body import backbone
from pinposture.view.commands import pack
from pinposture.view.outline import outline
from pinposture.view.postures import PosturePanel
from pinposture.view.scene import target_commands

ARM = pp.Arm.from_template("RyRz", modules=10)
CURVE = pp.Curve.helix(0.1, 0.3, 1.0)
WHOLE = pp.resolve_targets(ARM, CURVE)
BENT = pp.Target.from_configuration(ARM, np.full(ARM.nv, 0.1))


def length(line: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def test_a_whole_arm_has_its_curve_from_the_base_to_the_last_point():
    lines = outline(ARM, WHOLE)
    (bold,), (rest,) = lines
    assert length(bold) == pytest.approx(WHOLE.parameters[-1], rel=1e-3)
    np.testing.assert_allclose(bold[0], WHOLE.curve.start)
    np.testing.assert_allclose(rest[0], bold[-1])


def test_of_a_region_only_its_part_is_bold_and_the_rest_is_on_both_sides():
    (bold,), (before, after) = outline(ARM, WHOLE.region(4, 7))
    np.testing.assert_allclose(bold[[0, -1]], WHOLE.points[[4, 7]], atol=1e-6)
    assert length(bold) == pytest.approx(np.ptp(WHOLE.parameters[[4, 7]]), rel=1e-3)
    np.testing.assert_allclose(before[[0, -1]], [WHOLE.curve.start, WHOLE.points[4]], atol=1e-6)
    np.testing.assert_allclose(after[0], WHOLE.points[7], atol=1e-6)


def test_a_region_at_the_base_begins_there_and_single_points_have_no_line():
    (bold,), (rest,) = outline(ARM, WHOLE.region(0, 2))
    np.testing.assert_allclose(bold[[0, -1]], [WHOLE.curve.start, WHOLE.points[2]], atol=1e-6)
    assert len(rest)
    covered, rest = outline(ARM, WHOLE.region(5, 5))
    assert covered == ()
    assert len(rest) == 2


@pytest.mark.parametrize("region", [(0, 9), (0, 3), (3, 6), (6, 9)])
def test_of_a_known_posture_the_part_between_the_controlled_points_is_bold(region):
    first, last = region
    covered, rest = outline(ARM, BENT.region(first, last))
    (bold,) = covered
    start = ARM.chain.base if first == 0 else BENT.points[first]
    np.testing.assert_allclose(bold[[0, -1]], [start, BENT.points[last]], atol=1e-12)
    assert len(rest) == (first > 0) + (last < 9)
    whole = backbone(ARM, BENT.q)
    assert sum(map(length, (*covered, *rest))) == pytest.approx(length(whole))


def test_gaps_between_the_controlled_points_are_dashed():
    weights = np.array([1, 1, 0, 1, 1, 0, 0, 0, 1, 1.0])
    target = pp.Target(WHOLE.points, weights, curve=WHOLE.curve, parameters=WHOLE.parameters)
    covered, _ = outline(ARM, target)
    ends = [(line[0], line[-1]) for line in covered]
    expected = [(WHOLE.curve.start, WHOLE.points[1]), (WHOLE.points[3], WHOLE.points[4])]
    expected.append((WHOLE.points[8], WHOLE.points[9]))
    np.testing.assert_allclose(ends, expected, atol=1e-6)


@pytest.mark.parametrize(("target", "name"), [(WHOLE, "curve"), (BENT, "posture")])
def test_both_parts_are_named_once_and_shown_in_the_browser(target, name):
    panel = PosturePanel(ARM, Figure().add_subplot(projection="3d"))
    panel.target(target.region(3, 6))
    _, labels = panel.ax.get_legend_handles_labels()
    assert labels == [f"target {name}", f"rest of the {name}", "target points"]
    commands = target_commands(ARM, target.region(3, 6))
    paths = [umsgpack.unpackb(pack(command))["path"] for command in commands]
    assert paths == [f"/pinposture/target/{part}" for part in ("covered", "rest", "points")]
