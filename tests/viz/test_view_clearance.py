"""Panels of runs in a scene: how near, which steps were escapes, what gave way; which panels there are."""

from __future__ import annotations

import io
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from arms import template_arm
from matplotlib.figure import Figure

import pinposture as pp
from pinposture.viz import plot_clearance
from pinposture.viz.palette import THEME
from pinposture.viz.panels import mark_rising_steps, mark_violations


@cache
def free_run() -> pp.Run:
    arm = template_arm("RyRz", 4, (0.1, 0.1))
    target = pp.Target.from_configuration(arm, np.full(arm.nv, 0.3))
    return pp.track(arm, target, np.zeros(arm.nv), "projection", max_steps=12)


def in_scene(clearance=None, **fields) -> pp.Run:
    free = free_run()
    scene = pp.Scene({"ball": pp.Sphere((0.4, 0.3, 0.0), 0.05)}, margin=0.02)
    clearance = np.linspace(0.1, 0.03, free.steps + 1) if clearance is None else np.asarray(clearance)
    return replace(free, scene=scene, clearance=clearance, **fields)


def labels(figure: Figure) -> list[str]:
    return [ax.get_ylabel() for ax in figure.axes]


def entries(ax) -> list[str]:
    return [text.get_text() for text in ax.get_legend().get_texts()]


def panel():
    return Figure().add_subplot()


def test_the_clearance_panel_shows_every_step_the_margin_and_the_least_value():
    free = free_run()
    distances = np.full(free.steps + 1, 0.08)
    distances[5] = 0.0213
    ax = panel()
    run = in_scene(distances)
    plot_clearance(run, ax)
    line, margin, *_ = ax.get_lines()
    np.testing.assert_array_equal(line.get_ydata(), distances)
    np.testing.assert_array_equal(line.get_xdata(), np.arange(free.steps + 1))
    np.testing.assert_array_equal(margin.get_ydata(), [0.02, 0.02])
    pair = pp.CollisionModel(run.arm, run.scene).minimum(run.q[5]).pair
    assert entries(ax) == [f"closest: {' to '.join(pair)}", "margin to keep, 20 mm"]
    (text,) = ax.texts
    assert text.get_text() == "21.3 mm"
    assert text.xy == (5, 0.0213)


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize(
    "values", [[0.1, -0.04], [-0.1, -0.2], [0.0, 0.1], [3.0, 1e-4], [np.inf, 0.1], [0.1, np.inf]]
)
def test_whatever_the_distances_are_they_are_inside_of_the_panel(values):
    distances = np.resize(values, free_run().steps + 1)
    ax = panel()
    plot_clearance(in_scene(distances), ax)
    low, high = ax.get_ylim()
    finite = distances[np.isfinite(distances)]
    assert low < min(finite.min(), 0.02)
    assert high > max(finite.max(), 0.02)
    ax.figure.savefig(io.BytesIO(), dpi=20)


@pytest.mark.long
def test_only_a_run_in_a_scene_has_a_clearance_panel():
    free = free_run()
    assert "clearance [mm]" in labels(pp.plot(in_scene()))
    assert "clearance [mm]" not in labels(pp.plot(free))
    alone = in_scene(np.full(free.steps + 1, np.inf))
    assert "clearance [mm]" not in labels(pp.plot(alone))
    assert "clearance [mm]" in labels(pp.plot_comparison({"a": in_scene(), "b": free}))
    assert "clearance [mm]" not in labels(pp.plot_comparison({"a": free, "b": free}))


def test_a_comparison_names_the_margin_once():
    figure = pp.plot_comparison({"a": in_scene(), "b": in_scene()})
    (ax,) = (each for each in figure.axes if each.get_ylabel() == "clearance [mm]")
    assert entries(ax).count("margin to keep, 20 mm") == 1
    assert len(ax.texts) == 2


def test_escape_steps_are_shaded_from_where_they_begin_to_where_they_lead():
    escape = np.zeros(free_run().steps, dtype=bool)
    escape[[1, 2, 4]] = True
    ax = panel()
    mark_rising_steps(in_scene(error_increasing=escape), ax)
    spans = [np.ptp(path.vertices[:, 0]) for path in ax.collections[0].get_paths()]
    starts = [path.vertices[:, 0].min() for path in ax.collections[0].get_paths()]
    assert (starts, spans) == ([1.0, 4.0], [2.0, 1.0])
    ax = pp.plot(in_scene(error_increasing=escape)).axes[1]
    assert entries(ax) == ["3 steps in which the error may rise"]


@pytest.mark.long
def test_steps_in_which_something_gave_way_are_marked_and_quoted():
    relaxed = np.full(free_run().steps, "", dtype="<U200")
    relaxed[[1, 4]] = "margin: m1 and $ball are 3 mm apart; and much more that a legend has no room for"
    ax = pp.plot(in_scene(violated_constraints=relaxed)).axes[1]
    (words,) = entries(ax)
    assert words.startswith("violated in 2 steps: margin: m1 and $ball are 3 mm")
    assert len(words) < 70
    (marks,) = (line for line in ax.get_lines() if line.get_marker() == "|")
    np.testing.assert_array_equal(marks.get_xdata(), [2, 5])
    assert marks.get_color() == THEME.mark
    ax.figure.savefig(io.BytesIO(), dpi=20)


def test_a_run_without_either_has_no_marks_and_no_legend():
    free = free_run()
    ax = panel()
    mark_rising_steps(free, ax)
    mark_violations(free, ax)
    assert len(ax.collections) == len(ax.get_lines()) == 0
    assert pp.plot(free).axes[1].get_legend() is None


def test_what_a_controller_does_not_have_is_left_out():
    free = free_run()
    run = pp.track(free.arm, free.target, free.q[0], "geodesic", max_steps=5)
    assert "sigma_max" not in run.info
    assert labels(pp.plot(run))[1:3] == ["mean point error [mm]", "point errors [mm]"]
    assert not any("sigma" in label or "active" in label for label in labels(pp.plot(run)))
    kept = labels(pp.plot(free))
    assert "active control points" in kept
    assert any("sigma" in label for label in kept)


def test_postures_on_the_way_are_drawn_and_named_where_there_is_something_to_get_around():
    def pale(run):
        ax = pp.plot(run).axes[0]
        return [line for line in ax.get_lines() if line.get_alpha() == 0.35], entries(ax)

    drawn, named = pale(in_scene())
    assert 1 < len(drawn) <= 8
    assert named.count("intermediate postures") == 1
    drawn, named = pale(free_run())
    assert drawn == []
    assert "intermediate postures" not in named
