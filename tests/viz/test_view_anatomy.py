"""The picture of an arm shows where its modules, axes and control points are."""

from __future__ import annotations

import io
from itertools import pairwise

import numpy as np
import pinocchio as pin
import pytest
from arms import template_arm
from matplotlib.figure import Figure

import pinposture as pp
from pinposture.errors import InvalidValue
from pinposture.viz import palette
from pinposture.viz.palette import THEME


def spatial() -> pp.Arm:
    return template_arm("RyRz", 6)


def planar() -> pp.Arm:
    return template_arm("Rz", 5, (0.1,))


@pytest.fixture
def rng():
    return np.random.default_rng(3)


def sliding(axes: list[str], kinds: list[str]) -> pp.Arm:
    """An arm whose joints sit 0.1 m apart along x."""
    text = ""
    links = [f"l{k}" for k in range(len(axes) + 2)]
    for k, (axis, kind) in enumerate(zip([*axes, "1 0 0"], [*kinds, "fixed"], strict=True)):
        text += f'<joint name="j{k}" type="{kind}"><origin xyz="0.1 0 0"/><axis xyz="{axis}"/>'
        text += f'<parent link="{links[k]}"/><child link="{links[k + 1]}"/>'
        text += '<limit lower="-1" upper="1" velocity="1" effort="1"/></joint>'
    links_text = "".join(f'<link name="{name}"/>' for name in links)
    return pp.Arm.load(f'<robot name="r">{links_text}{text}</robot>', split=1)


def flat_points(figure: Figure, label: str) -> np.ndarray:
    """Where the dots of that label are, (n, 2) or (n, 3)."""
    (line,) = [line for line in figure.axes[0].get_lines() if line.get_label() == label]
    data = line.get_data_3d() if figure.axes[0].name == "3d" else line.get_data()
    return np.transpose(data)


def numbers(figure: Figure) -> dict[str, np.ndarray]:
    texts = figure.axes[0].texts
    spatial = figure.axes[0].name == "3d"
    return {t.get_text(): np.array(t.get_position_3d() if spatial else t.get_position()) for t in texts}


def pixels(figure: Figure) -> np.ndarray:
    file = io.BytesIO()
    figure.savefig(file, format="rgba")
    return np.frombuffer(file.getvalue(), np.uint8).reshape(-1, 1200, 4)


@pytest.mark.parametrize(
    "make",
    [
        spatial,
        planar,
        lambda: sliding(["0 0 1", "0 1 0", "1 0 0"], ["revolute", "prismatic", "revolute"]),
    ],
    ids=["spatial", "planar", "sliding"],
)
def test_the_parts_are_where_pinocchio_has_them(rng, make):
    arm = make()
    q = arm.random(rng)
    parts = arm.chain_at(q).placements
    model = arm.model
    data = arm.model.createData()
    pin.forwardKinematics(model, data, q)
    for u, name in enumerate(arm.chain.joints):
        joint = model.getJointId(name)
        pin_axis = {"X": 0, "Y": 1, "Z": 2}[model.joints[joint].shortname()[-1]]
        np.testing.assert_allclose(parts.axes[u], data.oMi[joint].rotation[:, pin_axis], atol=1e-12)
        np.testing.assert_allclose(parts.origins[u], data.oMi[joint].translation, atol=1e-12)
    np.testing.assert_allclose(parts.points, arm.at(q).points, atol=1e-12)


def test_modules_join_end_to_end_from_base_to_tip(rng):
    arm = spatial()
    q = arm.random(rng)
    drawn = pp.plot_arm(arm, q).axes[0].get_lines()
    shaded = [line for line in drawn if line.get_color() in THEME.modules]
    modules = [np.transpose(line.get_data_3d()) for line in shaded[: arm.n_modules]]
    np.testing.assert_array_equal(modules[0][0], arm.chain.base)
    for before, after in pairwise(modules):
        np.testing.assert_array_equal(before[-1], after[0])
    for line, point in zip(modules, arm.at(q).points, strict=True):
        np.testing.assert_allclose(line[-1], point, atol=1e-12)


def test_control_points_base_and_tip_are_marked_where_they_are(rng):
    arm = spatial()
    q = arm.random(rng)
    figure = pp.plot_arm(arm, q)
    points = arm.at(q).points
    np.testing.assert_allclose(flat_points(figure, "control points"), points[:-1], atol=1e-12)
    np.testing.assert_allclose(flat_points(figure, "tip"), points[-1:], atol=1e-12)
    np.testing.assert_allclose(flat_points(figure, "base"), arm.chain.base[None], atol=1e-12)


def test_modules_take_turns_in_two_shades():
    figure = pp.plot_arm(spatial())
    shades = [line.get_color() for line in figure.axes[0].get_lines() if line.get_color() in THEME.modules]
    assert shades[:6] == list(THEME.modules) * 3


@pytest.mark.parametrize("make", [spatial, planar])
def test_every_control_point_has_its_number_beside_it_and_beside_no_other(make):
    arm = make()
    figure = pp.plot_arm(arm)
    written = numbers(figure)
    points = np.vstack([flat_points(figure, "control points"), flat_points(figure, "tip")])
    assert set(written) == {str(k) for k in range(1, arm.n_modules + 1)}
    for text, place in written.items():
        distances = np.linalg.norm(points - place, axis=1)
        assert distances.argmin() == int(text) - 1
        assert 0.0 < distances.min() < 0.06 * arm.length


def test_numbers_that_would_lie_upon_each_other_are_left_out_but_never_the_last():
    arm = pp.Arm.from_template("Rz", modules=200, link_lengths=(0.01,))
    written = numbers(pp.plot_arm(arm))
    places = np.array(list(written.values()))
    gaps = np.linalg.norm(places[:, None] - places[None], axis=2)
    assert gaps[~np.eye(len(places), dtype=bool)].min() >= 0.0169 * arm.length
    assert "200" in written
    assert 40 < len(written) < 100


def test_a_bar_lies_along_each_axis_about_its_joint(rng):
    arm = spatial()
    q = arm.random(rng)
    bars = flat_points(pp.plot_arm(arm, q), "axis of a joint that turns")
    parts = arm.chain_at(q).placements
    ends = bars.reshape(arm.nv, 3, 3)  # both ends, and a gap
    np.testing.assert_allclose(ends[:, :2].mean(axis=1), parts.origins, atol=1e-12)
    along = ends[:, 1] - ends[:, 0]
    lengths = np.linalg.norm(along, axis=1)
    np.testing.assert_allclose(along / lengths[:, None], parts.axes, atol=1e-9)
    np.testing.assert_allclose(lengths, lengths[0])
    assert 0.02 * arm.length < lengths[0] < 0.1 * arm.length


def test_a_planar_arm_is_drawn_in_its_plane_with_rings_for_axes_seen_from_the_end():
    turned = pin.SE3(pin.utils.rotate("x", np.pi / 2), np.array([0.0, 0.3, 0.0]))
    arm = pp.Arm.load(planar().urdf, base_placement=turned)
    figure = pp.plot_arm(arm, arm.configuration([0.3, 0.2, -0.5, 0.1, 0.4]))
    (ax,) = figure.axes
    assert ax.name == "rectilinear"
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [m]", "z [m]")
    places = arm.at(arm.configuration([0.3, 0.2, -0.5, 0.1, 0.4])).origins[:, [0, 2]]
    np.testing.assert_allclose(flat_points(figure, "axis of a joint that turns"), places, atol=1e-12)


def test_joints_that_slide_are_told_from_those_that_turn():
    arm = sliding(["0 0 1", "0 1 0", "0 1 0"], ["revolute", "prismatic", "revolute"])
    assert arm.dimension == 3
    figure = pp.plot_arm(arm)
    parts = arm.at(arm.neutral())
    for name, joints in (("slides", [1]), ("turns", [0, 2])):
        bars = flat_points(figure, f"axis of a joint that {name}").reshape(-1, 3, 3)[:, :2]
        np.testing.assert_allclose(bars.mean(axis=1), parts.origins[joints], atol=1e-12)
    labels = [text.get_text() for text in figure.legends[0].get_texts()]
    assert {"axis of a joint that slides", "axis of a joint that turns", "odd modules", "tip"} <= set(labels)


def test_in_a_plane_an_axis_that_lies_in_it_is_a_bar_and_no_ring():
    arm = sliding(["0 0 1", "0 1 0", "1 0 0"], ["revolute", "prismatic", "revolute"])
    assert arm.dimension == 2  # the last joint turns the tip on the spot
    figure = pp.plot_arm(arm)
    np.testing.assert_allclose(flat_points(figure, "axis of a joint that turns"), [[0.1, 0.0]], atol=1e-12)
    lines = [line for line in figure.axes[0].get_lines() if line.get_color() == THEME.turn]
    (bar,) = [np.transpose(line.get_data())[:2] for line in lines if len(line.get_xdata()) == 3]
    np.testing.assert_allclose(bar[:, 1], 0.0, atol=1e-12)
    assert bar[1, 0] - bar[0, 0] > 0.0
    assert bar[:, 0].mean() == pytest.approx(0.3)


@pytest.mark.long
def test_an_arm_of_one_module_and_one_that_stands_are_drawn(recwarn):
    standing = pp.Arm.load(
        planar().urdf, base_placement=pin.SE3(pin.utils.rotate("z", np.pi / 2), np.zeros(3))
    )
    for arm in (pp.Arm.from_template("RyRz", modules=1), pp.Arm.from_template("Rz", modules=1), standing):
        assert len(np.unique(pixels(pp.plot_arm(arm)).reshape(-1, 4), axis=0)) > 20
    assert [str(warning.message) for warning in recwarn] == []


@pytest.mark.parametrize(
    "make", [spatial, lambda: template_arm("RyRz", 20), planar], ids=["spatial", "long", "planar"]
)
def test_the_arm_fills_the_width_and_stays_clear_of_title_and_legend(make):
    picture = pixels(pp.plot_arm(make()))[:, :, :3]
    shades = [np.round(255 * np.array(palette.rgb(shade))) for shade in THEME.modules]
    body = np.any([np.abs(picture - shade).max(axis=2) < 3 for shade in shades], axis=0)
    legend = 35
    rows, columns = np.nonzero(body[:-legend])
    assert np.ptp(columns) > 750
    assert rows.min() > 40
    assert rows.max() < len(body) - 60


@pytest.mark.parametrize("modules", [6, 11, 30])
def test_scales_and_their_labels_are_within_the_figure(modules):
    figure = pp.plot_arm(template_arm("RyRz", modules))
    picture = pixels(figure)[:, :, :3]
    assert picture[:, :5].min() == picture[:, -5:].min() == picture.max()  # nothing reaches the sides
    for axis in (figure.axes[0].xaxis, figure.axes[0].yaxis, figure.axes[0].zaxis):
        box = axis.label.get_window_extent()
        assert box.x0 >= 0.0 and box.x1 <= figure.bbox.width


def test_the_title_tells_of_the_arm_and_of_the_neutral_configuration_only_there(rng):
    arm = spatial()
    title = pp.plot_arm(arm).get_suptitle()
    for fact in ("RyRz_6", "spatial", "6 modules", "12 DOF", "300 mm", "neutral"):
        assert fact in title
    assert "neutral" not in pp.plot_arm(arm, arm.random(rng)).get_suptitle()


@pytest.mark.parametrize("q", [np.zeros(3), np.full(12, np.nan)])
def test_a_configuration_that_is_none_is_refused(q):
    with pytest.raises(InvalidValue):
        pp.plot_arm(spatial(), q)
