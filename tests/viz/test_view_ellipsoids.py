"""Ellipsoids in pictures are those of the arm, at a scale and in colours that a legend explains."""

from __future__ import annotations

import numpy as np
import pytest
from arms import template_arm
from hypothesis import given
from hypothesis import strategies as st
from sampling import examples
from viz.ellipsoid_shapes import levels, planar, spatial

import pinposture as pp
from pinposture.viz import palette
from pinposture.viz.palette import THEME
from pinposture.viz.postures import INDEX_LABELS, drawn_length, silhouette


@pytest.fixture
def rng():
    return np.random.default_rng(11)


def outlines(figure, arm: pp.Arm) -> list[np.ndarray]:
    """Lines (n, 3) in the world that are neither of the arm nor of its joints: those of ellipsoids."""
    own = {*THEME.modules, THEME.turn, THEME.ink, THEME.base, THEME.slide}
    found = []
    for line in figure.axes[0].get_lines():
        if line.get_color() in own or line.get_linestyle() == "None" or not len(line.get_xdata()):
            continue
        spatial = figure.axes[0].name == "3d"
        found.append(np.transpose(line.get_data_3d()) if spatial else np.transpose(line.get_data()) @ PLANE)
    return found


PLANE = np.eye(3)[:2]  # of the planar arms here


@pytest.mark.parametrize(
    "make", [spatial, planar, lambda: template_arm("RyRz", 40)], ids=["spatial", "planar", "long"]
)
def test_the_scale_is_round_and_lets_the_largest_be_well_seen_beside_the_arm(rng, make):
    arm = make()
    for chosen in ([arm.n_modules - 1], [1, 3]):
        length = drawn_length(arm, chosen)
        assert float(f"{length:.1e}") == pytest.approx(length, rel=1e-12)
        straight = length * max(one.radii[0] for one in arm.at(arm.straight()).ellipsoids(chosen))
        assert 0.1 * arm.length < straight < 0.25 * arm.length
        for _ in range(20):
            bent = length * max(one.radii[0] for one in arm.at(arm.random(rng)).ellipsoids(chosen))
            assert bent <= 1.0001 * straight


def test_a_point_that_nothing_moves_still_has_a_scale():
    still = pp.Arm.from_model(spatial().model, ["m01_j1_y", "m06_l2"])
    assert 0.0 < drawn_length(still, [0]) < np.inf


def test_colours_go_from_that_of_singular_postures_to_that_of_good_ones():
    assert palette.index_color(0.0) == THEME.singular
    assert palette.index_color(0.1) == THEME.worse
    assert palette.index_color(0.4) == palette.index_color(1.0) == THEME.regular
    shades = [palette.rgb(palette.index_color(index)) for index in np.linspace(0.0, 0.4, 400)]
    # Red falls from yellow on, green grows before: no colour comes twice.
    kept = list(dict.fromkeys(shades))
    assert 20 < len(kept) <= 33
    assert shades == sorted(shades, key=kept.index)


@pytest.mark.parametrize("make", [spatial, planar])
def test_lines_of_a_figure_lie_on_the_ellipsoids(rng, make):
    arm = make()
    q = arm.configuration(rng.uniform(-1.0, 1.0, arm.nv))
    chosen = [2, 5] if make is spatial else [1, 4]
    figure = pp.plot_arm(arm, q, ellipsoids=chosen)
    drawn = outlines(figure, arm)
    assert len(drawn) == len(chosen) * (4 if make is spatial else 2)
    scale = drawn_length(arm, chosen)
    for line in drawn:
        on = [np.allclose(levels(line, arm, q, point, scale), 1.0, atol=1e-5) for point in chosen]
        assert sum(on) == 1
    (ax,) = figure.axes
    everything = np.vstack(drawn) @ (np.eye(3) if make is spatial else PLANE.T)
    for name, values in zip("xyz", everything.T, strict=False):
        low, high = getattr(ax, f"get_{name}lim")()
        assert low <= values.min() < values.max() <= high


@given(seed=st.integers(0, 10**6), flat=st.booleans())
@examples(30)
def test_an_outline_is_as_wide_as_the_ellipsoid_in_every_direction_of_the_screen(seed, flat):
    rng = np.random.default_rng(seed)
    axes = rng.standard_normal((2 if flat else 3, 3))
    screen = np.linalg.qr(rng.standard_normal((3, 3)))[0][:2]
    unit = rng.standard_normal((20000, len(axes)))
    surface = unit / np.linalg.norm(unit, axis=1, keepdims=True) @ axes @ screen.T
    outline = silhouette(axes, screen) @ screen.T
    angle = np.linspace(0.0, 2.0 * np.pi, 13)
    ways = np.stack([np.cos(angle), np.sin(angle)])
    widest = (outline @ ways).max(axis=0)
    seen = (surface @ ways).max(axis=0)
    # 48 corners: short of the ellipse by 1 - cos(pi / 48) at most.
    exact = np.linalg.norm(axes @ screen.T @ ways, axis=0)
    assert np.all(widest <= exact * (1.0 + 1e-12))
    assert np.all(widest >= 0.997 * exact)
    assert np.all(seen <= exact * (1.0 + 1e-12))


def test_in_a_singular_posture_a_disc_is_left_in_space_and_a_line_in_the_plane():
    arm = spatial()
    flat = planar()
    figure = pp.plot_arm(arm, ellipsoids=[5])
    disc = np.vstack(outlines(figure, arm)) - arm.chain.points[5]
    radii = drawn_length(arm, [5]) * arm.at(arm.neutral()).ellipsoids(5)[0].radii
    np.testing.assert_allclose(disc[:, 0], 0.0, atol=1e-12)  # the arm lies along x
    assert np.linalg.norm(disc, axis=1).max() == pytest.approx(radii[0])
    assert np.ptp(disc[:, 1:], axis=0).min() == pytest.approx(2.0 * radii[1], rel=0.01)
    figure = pp.plot_arm(flat, ellipsoids=[4])
    stroke = np.vstack(outlines(figure, flat)) - flat.chain.points[4]
    np.testing.assert_allclose(stroke[:, 0], 0.0, atol=1e-12)
    assert np.ptp(stroke[:, 1]) > 0.2 * flat.length
    colors = {line.get_color() for line in figure.axes[0].get_lines()}
    assert THEME.singular in colors
    assert THEME.regular not in colors


def test_the_legend_says_the_scale_and_what_colours_mean_only_if_there_are_ellipsoids():
    arm = spatial()
    figure = pp.plot_arm(arm, ellipsoids=["module_06"])
    _, key = figure.legends
    assert key.get_title().get_text() == (
        f"manipulability ellipsoids, 1 m/rad drawn as {1e3 * drawn_length(arm, [5]):g} mm"
    )
    assert [text.get_text() for text in key.get_texts()] == [
        f"index {meaning}" for meaning in INDEX_LABELS.values()
    ]
    assert len(pp.plot_arm(arm).legends) == 1
    assert outlines(pp.plot_arm(arm), arm) == []


def test_the_arm_lies_on_top_of_its_ellipsoids(rng):
    figure = pp.plot_arm(spatial(), spatial().random(rng), ellipsoids=range(6))
    (ax,) = figure.axes
    arm = [line.get_zorder() for line in ax.get_lines() if line.get_color() in THEME.modules]
    figure.canvas.draw()
    assert len(ax.collections) == 6
    assert max(shade.get_zorder() for shade in ax.collections) < min(arm)
