"""Of a target only the part that is controlled is drawn boldly."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from matplotlib.figure import Figure
from viz.commands import recorded_commands

import pinposture as pp
from pinposture.viz.body import backbone
from pinposture.viz.drawing import outline
from pinposture.viz.meshcat import add_target
from pinposture.viz.postures import PosturePanel


@pytest.fixture(scope="session")
def arm() -> pp.Arm:
    return template_arm("RyRz", 10)


@pytest.fixture(scope="session")
def whole(arm) -> pp.Target:
    return pp.resolve_targets(arm, pp.Curve.helix(0.1, 0.3, 1.0), placement="align")


@pytest.fixture(scope="session")
def bent(arm) -> pp.Target:
    return pp.Target.from_configuration(arm, np.full(arm.nv, 0.1))


def length(line: np.ndarray) -> float:
    return float(np.linalg.norm(np.diff(line, axis=0), axis=1).sum())


def test_a_whole_arm_has_its_curve_from_the_base_to_the_last_point(arm, whole):
    lines = outline(arm, whole)
    (bold,), (rest,) = lines
    assert length(bold) == pytest.approx(whole.parameters[-1], rel=1e-3)
    np.testing.assert_allclose(bold[0], whole.curve.start)
    np.testing.assert_allclose(rest[0], bold[-1])


def test_of_a_region_only_its_part_is_bold_and_the_rest_is_on_both_sides(arm, whole):
    (bold,), (before, after) = outline(arm, whole.region(4, 7))
    np.testing.assert_allclose(bold[[0, -1]], whole.points[[4, 7]], atol=1e-6)
    assert length(bold) == pytest.approx(np.ptp(whole.parameters[[4, 7]]), rel=1e-3)
    np.testing.assert_allclose(before[[0, -1]], [whole.curve.start, whole.points[4]], atol=1e-6)
    np.testing.assert_allclose(after[0], whole.points[7], atol=1e-6)


def test_a_region_at_the_base_begins_there_and_single_points_have_no_line(arm, whole):
    (bold,), (rest,) = outline(arm, whole.region(0, 2))
    np.testing.assert_allclose(bold[[0, -1]], [whole.curve.start, whole.points[2]], atol=1e-6)
    assert len(rest)
    covered, rest = outline(arm, whole.region(5, 5))
    assert covered == ()
    assert len(rest) == 2


@pytest.mark.parametrize("region", [(0, 9), (0, 3), (3, 6), (6, 9)])
def test_of_a_known_posture_the_part_between_the_controlled_points_is_bold(arm, bent, region):
    first, last = region
    covered, rest = outline(arm, bent.region(first, last))
    (bold,) = covered
    start = arm.chain.base if first == 0 else bent.points[first]
    np.testing.assert_allclose(bold[[0, -1]], [start, bent.points[last]], atol=1e-12)
    assert len(rest) == (first > 0) + (last < 9)
    whole = backbone(arm, bent.q)
    assert sum(map(length, (*covered, *rest))) == pytest.approx(length(whole))


def test_gaps_between_the_controlled_points_are_dashed(arm, whole):
    weights = np.array([1, 1, 0, 1, 1, 0, 0, 0, 1, 1.0])
    target = pp.Target(whole.points, weights, curve=whole.curve, parameters=whole.parameters)
    covered, _ = outline(arm, target)
    ends = [(line[0], line[-1]) for line in covered]
    expected = [(whole.curve.start, whole.points[1]), (whole.points[3], whole.points[4])]
    expected.append((whole.points[8], whole.points[9]))
    np.testing.assert_allclose(ends, expected, atol=1e-6)


@pytest.mark.parametrize("name", ["curve", "posture"])
def test_both_parts_are_named_once_and_shown_in_the_browser(arm, whole, bent, name):
    target = whole if name == "curve" else bent
    panel = PosturePanel(arm, Figure().add_subplot(projection="3d"))
    panel.target(target.region(3, 6))
    _, labels = panel.ax.get_legend_handles_labels()
    assert labels == [f"target {name}", f"rest of the {name}", "target points"]
    paths = [command["path"] for command in recorded_commands(add_target, arm, target.region(3, 6))]
    assert paths == [f"/pinposture/target/{part}" for part in ("covered", "rest", "points")]
