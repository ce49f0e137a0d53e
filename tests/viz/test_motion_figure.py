"""The figure of a motion in time shows its numbers, and can be read."""

from __future__ import annotations

import io
import warnings
from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
from arms import template_arm
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from sampling import cases
from viz.motions import LIMITS, around_a_ball, five_modules, some_motion

import pinposture as pp
from pinposture.errors import InvalidValue
from pinposture.motion.trajectory import Trajectory
from pinposture.viz.body import backbone
from pinposture.viz.panels import plot_waypoints

RATES = "largest of all joints\n[share of limit]"


def planar() -> pp.Arm:
    return template_arm("Rz", 5, (0.1,))


def draw(figure: Figure) -> None:
    """Draw in earnest; a layout that does not work out warns."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        figure.savefig(io.BytesIO(), format="png")


@cache
def slowed() -> Trajectory:
    return some_motion(planned=1.5, start_index=10)


def panel(figure: Figure, label: str):
    (found,) = [ax for ax in figure.axes if ax.get_ylabel() == label]
    return found


def lines(ax):
    return {line.get_label(): line for line in ax.get_lines()}


def labels(figure: Figure) -> list[str]:
    return [ax.get_ylabel() for ax in figure.axes[1:]]


def names_above(ax) -> list:
    return [text for text in ax.texts if text.get_text() in ("straight", "S", "coil")]


@pytest.mark.long
def test_a_motion_as_planned_has_errors_and_rates_over_time_and_nothing_to_say_of_its_clock():
    motion = some_motion()
    figure = pp.plot(motion)
    assert labels(figure) == ["point errors [mm]", RATES]
    errors = motion.run.point_errors * np.linspace(1.0, 2.0, 5)
    shown = lines(
        panel(pp.plot(replace(motion, run=replace(motion.run, point_errors=errors))), "point errors [mm]")
    )
    np.testing.assert_array_equal(shown["mean"].get_xdata(), motion.time)
    np.testing.assert_allclose(shown["mean"].get_ydata(), 1.5e-3)
    np.testing.assert_allclose(shown["largest"].get_ydata(), 2e-3)
    assert figure.axes[-1].get_xlabel() == "time [s]"
    assert "it is there; duration: 3 s, as planned" in figure.get_suptitle()
    draw(figure)


@pytest.mark.filterwarnings("ignore:velocity .* is above")
def test_joint_rates_are_those_of_the_joint_nearest_to_its_limit():
    fast = np.linspace(1.0, 4.0, 10)
    motion = some_motion(limits=pp.Limits(step=None, dt=0.05, velocity=fast, acceleration=30.0))
    drawn = lines(panel(pp.plot(motion), RATES))
    speeds = []
    changes = []
    before = np.zeros(10)
    for a, b in zip(motion.q[:-1], motion.q[1:], strict=True):
        now = (b - a) / 0.05
        speeds.append(max(abs(now) / fast))
        changes.append(max(abs(now - before)) / 0.05 / 30.0)
        before = now
    changes.append(max(abs(before)) / 0.05 / 30.0)
    np.testing.assert_allclose(drawn["speed"].get_ydata(), speeds, atol=1e-12)
    np.testing.assert_allclose(drawn["acceleration"].get_ydata(), changes, atol=1e-12)
    np.testing.assert_allclose(drawn["speed"].get_xdata(), motion.time[1:] - 0.025)
    np.testing.assert_array_equal(drawn["limit"].get_ydata(), 1.0)


@pytest.mark.long
def test_what_has_no_limit_is_left_out():
    fast = np.full(10, 2.0)
    fast[0] = np.inf  # the others still have one
    drawn = lines(panel(pp.plot(some_motion(limits=pp.Limits(step=None, dt=0.05, velocity=fast))), RATES))
    assert "acceleration" not in drawn
    assert "speed" in drawn
    free = pp.Limits(step=None, dt=0.05, velocity=np.inf)
    assert labels(pp.plot(some_motion(limits=free))) == ["point errors [mm]"]


@pytest.mark.long
def test_a_slowed_motion_shows_the_time_of_the_plan_and_says_by_how_much():
    motion = slowed()
    figure = pp.plot(motion)
    drawn = lines(panel(figure, "plan time [s]"))
    (was,) = [line for label, line in drawn.items() if label.startswith("as executed")]
    assert "1.67 times" in was.get_label()
    np.testing.assert_array_equal(was.get_ydata(), motion.plan_time)
    planned = drawn["as planned"]
    np.testing.assert_allclose(np.array(planned.get_data()).T, [[0.0, 0.0], [0.5, 0.0], [2.0, 1.5]])
    title = " ".join(figure.get_suptitle().split())
    assert f"duration: 2.5 s, {motion.slowdown}; before that 0.5 s to come to the first posture" in title
    words = [text.get_text() for text in panel(figure, "point errors [mm]").get_legend().get_texts()]
    assert words == ["mean", "largest", "moving to the first posture"]
    draw(figure)


@pytest.mark.parametrize(("slower", "told"), [(1.004, False), (1.006, True)])
def test_the_clock_is_shown_of_a_motion_that_is_said_to_be_slow(slower, told):
    motion = some_motion(planned=3.0 / slower)
    figure = pp.plot(motion)
    assert ("plan time [s]" in labels(figure)) is bool(motion.slowdown) is told


@pytest.mark.long
def test_places_are_marked_in_every_panel_and_named_above_the_first():
    motion = slowed()
    figure = pp.plot(motion)
    for ax in figure.axes[1:]:
        marks = [each.get_segments()[0][0][0] for each in ax.collections if hasattr(each, "get_segments")]
        np.testing.assert_allclose(marks, [motion.time[place.row] for place in motion.waypoints])
    named = names_above(figure.axes[1])
    assert [text.get_text() for text in named] == ["straight", "S", "coil"]
    assert [text.xy[0] for text in named] == pytest.approx([0.5, 1.75, 3.0])
    assert not names_above(figure.axes[2])


@pytest.mark.pictures
@pytest.mark.parametrize("count", [3, 8, 12, 40])
def test_names_do_not_run_into_each_other(count):
    motion = some_motion(names=tuple(f"the place of number {k}" for k in range(count)))
    figure = pp.plot(motion)
    draw(figure)
    named = [text for text in figure.axes[1].texts if text.get_text().startswith("the place")]
    assert len(named) >= 2
    turn = np.radians(named[0].get_rotation())
    if turn == 0.0:
        boxes = [text.get_window_extent() for text in named]
        assert not any(Bbox.intersection(a, b) for a, b in pairwise(boxes))
    else:  # lines of text one above the other, as far apart as they are high
        places = [text.get_transform().transform((0.0, 0.0))[0] for text in named]
        height = 8.0 * figure.dpi / 72.0
        assert np.diff(places).min() * np.sin(turn) > 0.9 * height


@pytest.mark.long
def test_words_above_the_figure_keep_clear_of_each_other():
    motion = some_motion(scene=around_a_ball(), start_index=10)
    figure = pp.plot(replace(motion, deviations=("at 1 s it went round",)))
    draw(figure)
    heading = figure.texts[0]
    legend = figure.axes[0].get_legend()
    assert heading.get_window_extent().y0 > legend.get_window_extent().y1


def spatial(line) -> np.ndarray:
    return np.array(line.get_data_3d()).T


@pytest.mark.long
def test_the_posture_of_each_place_is_drawn_in_its_colour_and_told_with_its_time():
    motion = slowed()
    figure = pp.plot(motion)
    ax = figure.axes[0]
    words = [text.get_text() for text in ax.get_legend().get_texts()]
    for place in motion.waypoints:
        line = backbone(five_modules(), motion.q[place.row])
        assert any(np.array_equal(spatial(each), line) for each in ax.get_lines())
        assert f"{place.name}, {motion.time[place.row]:.3g} s" in words
    assert "initial posture" in words
    rings = [spatial(each) for each in ax.get_lines() if each.get_label() == "target points"]
    rows = [place.row for place in motion.waypoints]
    np.testing.assert_array_equal(rings[0], motion.targets[rows].reshape(-1, 3))


def test_postures_that_look_alike_are_drawn_once_and_have_both_names():
    motion = some_motion()
    run = motion.run
    points = run.points.copy()
    q = run.q.copy()
    points[-1] = points[0]
    q[-1] = q[0]
    figure = pp.plot(replace(motion, run=replace(run, points=points, q=q)))
    words = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert "straight, 0 s; coil, 3 s" in words


@pytest.mark.long
def test_in_a_scene_there_is_clearance_over_time_and_the_obstacle():
    motion = some_motion(scene=around_a_ball())
    figure = pp.plot(motion)
    ax = panel(figure, "clearance [mm]")
    np.testing.assert_array_equal(ax.get_lines()[0].get_data(), [motion.time, motion.run.clearance])
    margin = [line for line in ax.get_lines() if str(line.get_label()).startswith("margin")]
    np.testing.assert_array_equal(margin[0].get_xdata(), [0.0, 3.0])
    words = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert any(word.startswith("obstacle") for word in words)
    draw(figure)


@pytest.mark.long
def test_escapes_and_limits_that_gave_way_are_marked_at_their_moments():
    motion = some_motion()
    run = motion.run
    escape = run.error_increasing.copy()
    relaxed = run.violated_constraints.astype("<U40")
    escape[10:14] = True
    relaxed[20] = "acceleration of joint 3"
    figure = pp.plot(replace(motion, run=replace(run, error_increasing=escape, violated_constraints=relaxed)))
    ax = panel(figure, "point errors [mm]")
    (span,) = [each for each in ax.collections if str(each.get_label()).startswith("4 steps in which")]
    corners = span.get_paths()[0].vertices
    assert (corners[:, 0].min(), corners[:, 0].max()) == pytest.approx((0.5, 0.7))
    (mark,) = [each for each in ax.get_lines() if str(each.get_label()).startswith("violated")]
    assert mark.get_xdata() == pytest.approx([21 * 0.05])
    draw(figure)


@pytest.mark.long
def test_an_error_of_rounding_is_none_to_speak_of():
    figure = pp.plot(some_motion(off=1e-17))
    ax = panel(figure, "point errors [mm]")
    assert "below rounding throughout" in [text.get_text() for text in ax.texts]
    np.testing.assert_array_equal(ax.get_lines()[0].get_ydata(), 0.0)
    draw(figure)


@pytest.mark.long
@pytest.mark.parametrize(
    "case", cases(["planar", "no step", "one step", "no place", "one place", "lost"], quick=2)
)
def test_unusual_motions_are_drawn_too(case):
    names = {"no place": (), "no step": ("here",), "one place": ("there",)}.get(case, ("a", "$b$", "c"))
    steps = {"no step": 0, "one step": 1}.get(case, 30)
    motion = some_motion(steps, planar() if case == "planar" else None, names=names)
    if case == "lost":
        late = [place._replace(reached=None, row=None, mean_error=None) for place in motion.waypoints[1:]]
        motion = replace(
            motion,
            waypoints=(motion.waypoints[0], *late),
            plan_time=0.4 * motion.plan_time,
            run=replace(motion.run, status="stalled"),
            deviations=("one", "two", "three"),
        )
    figure = pp.plot(motion)
    draw(figure)
    words = [text.get_text() for text in figure.axes[0].get_legend().get_texts()]
    assert ("final posture" in words) is (case == "no place")
    if case == "lost":
        assert "did not reach the target (stalled): " in figure.get_suptitle()
        assert "for 0.6 of the 1.5 s of the plan" in figure.get_suptitle()
        assert "and 1 more" in figure.get_suptitle()


def test_plain_axes_do_for_planar_arms_only():
    with pytest.raises(InvalidValue, match="projection"):
        plot_waypoints(some_motion(), Figure().add_subplot())
    plot_waypoints(some_motion(arm=planar()), Figure().add_subplot())


def test_limits_of_the_step_count_as_limits_of_speed():
    motion = some_motion(limits=replace(LIMITS, step=0.05))  # 1 rad/s
    drawn = lines(panel(pp.plot(motion), RATES))
    assert drawn["speed"].get_ydata().max() == pytest.approx(np.abs(motion.velocities).max())
