"""Joints in the figure of an arm have the colours of their torques, by Pinocchio."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm

import pinposture as pp
from pinposture.errors import WeightUnknown
from pinposture.viz.palette import THEME

MEANING = {
    THEME.regular: (0.0, 0.5),
    THEME.worse: (0.5, 0.8),
    THEME.active: (0.8, 1.0),
    THEME.singular: (1.0, np.inf),
}


def drawn(figure) -> dict[str, np.ndarray]:
    """The marked points by their colour, world frame."""
    marked = [line for line in figure.axes[0].get_lines() if line.get_color() in {*MEANING, THEME.rest}]
    lines = {line.get_color(): line for line in marked if line.get_label()[:2] in ("to", "up", "be", "li")}
    return {color: np.transpose(line.get_data_3d()) for color, line in lines.items()}


@pytest.mark.parametrize("bend", [0.0, -0.25])
def test_each_joint_has_the_colour_of_its_share(bend: float) -> None:
    arm = template_arm("RyRz", 12).with_effort(0.5)
    q = np.zeros(arm.nq)
    q[::2] = bend
    figure = pp.plot_arm(arm, q, torques=True)
    torques = pin.computeGeneralizedGravity(arm.model, arm.model.createData(), q)
    origins = arm.at(q).origins
    found = drawn(figure)
    assert sum(len(points) for points in found.values()) == arm.nv
    for color, points in found.items():
        low, high = MEANING[color]
        for point in points:
            joint = int(np.linalg.norm(origins - point, axis=1).argmin())
            assert low - 1e-12 <= abs(torques[joint]) / 0.5 <= high + 1e-9
    assert (THEME.singular in found) == (bend == 0.0)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert ("beyond its limit" in labels) == (bend == 0.0)


def test_joints_without_limits_are_grey_and_arms_without_any_are_refused() -> None:
    arm = template_arm("RyRz", 4)
    found = drawn(pp.plot_arm(arm.with_effort({"m01_j1_y": 3.0}), torques=True))
    assert len(found[THEME.rest]) == arm.nv - 1
    with pytest.raises(WeightUnknown, match="torque limits"):
        pp.plot_arm(arm, torques=True)
    assert drawn(pp.plot_arm(arm.with_effort(3.0))) == {}


def test_a_long_legend_stays_within_the_figure() -> None:
    arm = template_arm("RyRz", 12).with_effort(0.35)  # all five shares
    figure = pp.plot_arm(arm, arm.straight(), torques=True)
    figure.draw_without_rendering()
    [legend] = figure.legends
    assert len(legend.get_texts()) == 10
    assert legend.get_window_extent().x1 <= figure.bbox.width
