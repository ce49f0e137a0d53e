"""Figures show the data of the run."""

from __future__ import annotations

import io
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from functools import cache

import matplotlib as mpl
import numpy as np
import pytest
from arms import template_arm
from matplotlib.figure import Figure
from mpl_toolkits.mplot3d import Axes3D, proj3d
from sampling import cases

import pinposture as pp
from pinposture.errors import InvalidValue
from pinposture.units import length_text
from pinposture.viz import palette, plot_active_points, plot_point_errors, plot_posture_error, plot_postures
from pinposture.viz.body import backbone
from pinposture.viz.palette import THEME


def six_modules() -> pp.Arm:
    return template_arm("RyRz", 6)


def goal() -> np.ndarray:
    return np.random.default_rng(1).uniform(-0.4, 0.4, 12)


def bent() -> pp.Target:
    return pp.Target.from_configuration(six_modules(), goal())


@cache
def helix() -> pp.Target:
    return pp.resolve_targets(six_modules(), pp.Curve.helix(0.1, 0.3, 1.0), placement="align")


def run_to(target: pp.Target, start=None, controller="projection", steps=15, arm=None) -> pp.Run:
    arm = arm or six_modules()
    start = np.random.default_rng(0).uniform(-0.4, 0.4, arm.nv) if start is None else start
    return pp.track(arm, target, start, controller, max_steps=steps)


@cache
def some_run() -> pp.Run:
    return run_to(helix())


def draw(figure: Figure) -> np.ndarray:
    """Draw a figure in earnest; pixels (height, width, 4)."""
    file = io.BytesIO()
    figure.savefig(file, format="rgba")
    width, height = (round(side * figure.dpi) for side in figure.get_size_inches())
    return np.frombuffer(file.getvalue(), np.uint8).reshape(height, width, 4)


def titles(figure: Figure) -> str:
    return " ".join(figure.get_suptitle().split())


def lines(ax):
    return {line.get_label(): line for line in ax.get_lines()}


def one_panel(**kind):
    return Figure().add_subplot(**kind)


def test_posture_error_panel_shows_every_step_and_writes_both_ends():
    run = some_run()
    ax = one_panel()
    plot_posture_error(run, ax)
    np.testing.assert_array_equal(ax.get_lines()[0].get_ydata(), run.posture_error)
    np.testing.assert_array_equal(ax.get_lines()[0].get_xdata(), np.arange(run.steps + 1))
    written = [text.get_text() for text in ax.texts]
    assert written == [length_text(run.posture_error[0]), length_text(run.posture_error[-1])]
    assert ax.get_ylabel() == "posture error [mm]"


def test_point_errors_panel_has_a_line_of_its_own_colour_for_each_point():
    run = some_run()
    ax = one_panel()
    plot_point_errors(run, ax)
    assert len(ax.get_lines()) == 6
    for k, line in enumerate(ax.get_lines()):
        np.testing.assert_array_equal(line.get_ydata(), run.point_errors[:, k])
    assert len({line.get_color() for line in ax.get_lines()}) == 6
    assert ax.get_legend() is None
    (bar,) = [other for other in ax.figure.axes if other is not ax]
    assert bar.get_ylabel() == "control point"


@pytest.mark.parametrize(("size", "unit", "tick"), [(0.5, "mm", "200"), (5.0, "m", "2")])
def test_axes_of_lengths_have_the_unit_of_the_text_beside_them(size, unit, tick):
    """Millimetres below one metre, on linear and logarithmic axes."""
    ax = one_panel()
    ax.plot([0.0, 1.0], [size, 0.8 * size])
    palette.scale_values(ax)
    palette.label_lengths([ax], "error")
    assert ax.get_ylabel() == f"error [{unit}]"
    assert tick in ax.yaxis.get_major_formatter().format_ticks(ax.get_yticks())
    ax = one_panel()
    ax.plot([0.0, 1.0], [size, 1e-4 * size])
    palette.scale_values(ax)
    palette.label_lengths([ax], "error")
    assert ax.get_yscale() == "log"
    assert "{10^{0}}" in ax.yaxis.get_major_formatter()(1.0 if unit == "m" else 1e-3)


@pytest.mark.parametrize("least", range(5))
@pytest.mark.parametrize("depth", [0.01, 1.0])
def test_the_least_value_is_written_inside_the_axes(least, depth):
    """Also where it is the first or the last, and where the line is almost level."""
    ax = one_panel()
    values = np.full(5, 0.03)
    values[least] *= 1.0 - depth
    ax.plot(np.arange(5.0), values)
    palette.scale_values(ax)
    ax.set_xlim(0.0, 4.0)
    palette.mark_value(ax, float(least), float(values[least]), THEME.ink, "least")
    box = ax.texts[0].get_window_extent()
    inside = ax.get_window_extent()
    assert inside.x0 <= box.x0 and box.x1 <= inside.x1 and inside.y0 <= box.y0 and box.y1 <= inside.y1


def test_points_without_a_target_are_left_out_and_counted():
    arm = six_modules()
    target = pp.Target.from_points(arm, arm.at(goal()).points, [1, 0, 1, 1, 0, 1])
    run = run_to(target)
    ax = one_panel()
    plot_point_errors(run, ax)
    for k, line in zip([0, 2, 3, 5], ax.get_lines(), strict=True):
        np.testing.assert_array_equal(line.get_ydata(), run.point_errors[:, k])
    assert ax.get_title(loc="right") == "2 of 6 control points have no target"


def test_active_points_panel_counts_and_shows_the_conditioning_of_each_step():
    run = run_to(helix(), controller="selection")
    assert run.steps > 2
    ax = one_panel()
    plot_active_points(run, ax)
    np.testing.assert_array_equal(ax.get_lines()[0].get_ydata(), run.active.sum(axis=1))
    np.testing.assert_array_equal(ax.get_lines()[0].get_xdata(), np.arange(1, run.steps + 1))
    (other,) = [twin for twin in ax.figure.axes if twin is not ax]
    np.testing.assert_array_equal(other.get_lines()[0].get_ydata(), run.info["sigma_min"])
    assert "m/rad" in other.get_ylabel()
    low, high = ax.get_ylim()
    assert low < 0.0 < 6.0 < high


def spatial_line(line) -> np.ndarray:
    return np.array(line.get_data_3d()).T


def test_posture_panel_draws_start_end_and_target_to_one_scale():
    arm = six_modules()
    target = helix()
    run = some_run()
    ax = one_panel(projection="3d")
    plot_postures(run, ax)
    drawn = [spatial_line(line) for line in ax.get_lines() if len(line.get_data_3d()[0])]
    for q in (run.q[0], run.q[-1]):
        line = backbone(arm, q)
        assert any(found.shape == line.shape and np.allclose(found, line) for found in drawn)
    named = lines(ax)
    np.testing.assert_allclose(spatial_line(named["target points"]), target.points)
    curve = spatial_line(named["target curve"])
    np.testing.assert_allclose(curve[0], target.curve.start)
    np.testing.assert_allclose(curve[-1], target.curve.at(target.parameters.max()), atol=1e-9)
    np.testing.assert_allclose(spatial_line(named["base"])[0], arm.chain.base)
    spans = np.ptp([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()], axis=1)
    np.testing.assert_allclose(ax._box_aspect / spans, (ax._box_aspect / spans)[0])
    low, high = np.array([ax.get_xlim(), ax.get_ylim(), ax.get_zlim()]).T
    assert all(np.all((points >= low) & (points <= high)) for points in drawn)


@pytest.mark.long
@pytest.mark.parametrize("axis", ["y", "z"])
def test_a_planar_arm_is_drawn_in_its_plane(axis):
    module = pp.ModuleTemplate("One", (pp.JointSpec(axis),), (0.1,))
    arm = pp.Arm.from_modules([module] * 5)
    run = run_to(pp.Target.from_configuration(arm, np.full(5, 0.3)), arm=arm)
    figure = pp.plot(run)
    ax = figure.axes[0]
    assert not isinstance(ax, Axes3D)
    across = "xyz".index("z" if axis == "y" else "y")
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [m]", f"{'xyz'[across]} [m]")
    np.testing.assert_allclose(
        lines(ax)["target points"].get_xydata(), run.target.points[:, [0, across]], atol=1e-12
    )
    draw(figure)
    transform = ax.transData.transform([[0.0, 0.0], [0.1, 0.0], [0.0, 0.1]])
    assert transform[1, 0] - transform[0, 0] == pytest.approx(transform[2, 1] - transform[0, 1], rel=0.01)


def test_a_spatial_arm_needs_spatial_axes():
    with pytest.raises(InvalidValue, match="3d"):
        plot_postures(some_run(), one_panel())


def test_a_planar_arm_may_be_drawn_in_space():
    arm = template_arm("Rz", 5, (0.1,))
    run = run_to(pp.Target.from_configuration(arm, np.full(5, 0.3)), arm=arm)
    ax = one_panel(projection="3d")
    plot_postures(run, ax)
    np.testing.assert_allclose(spatial_line(lines(ax)["target points"]), run.target.points)


@pytest.mark.long
def test_a_figure_says_who_ran_how_it_ended_and_why():
    run = some_run()
    figure = pp.plot(run)
    assert titles(figure).startswith("Projection")
    assert " ".join(run.reason.split()) in titles(figure)
    words = "Projection with default parameters; limits: 0.1 rad per step; curve moved by"
    assert figure.get_supxlabel().startswith(words)
    assert draw(figure).shape[1] == 1200
    long = replace(run, reason="word " * 100)
    assert max(map(len, pp.plot(long).get_suptitle().splitlines())) < 150


def straighten(state, target):
    """An objective of a user."""


@pytest.mark.parametrize(
    ("controller", "words"),
    [
        (pp.Geodesic(), "Geodesic with default parameters"),
        (pp.Geodesic(joint_weight=0.5), "Geodesic with joint weight 0.5"),
        (pp.Geodesic(tasks=(pp.EndEffector(position=(0.1, 0.0, 0.2)),)), "Geodesic with tasks EndEffector"),
        (pp.Switching(projection=pp.Projection(gain=0.7)), "Switching with projection gain 0.7"),
        ("Own(gain=2.0, shape=array([[1., 2.],\n [3., 4.]]))", "Own with gain 2.0, shape array"),
        (pp.Selection(null_objective=straighten), "Selection with null objective straighten"),
        ("<robot.lab.Own object at 0x7f00>", "Own"),
        (
            "Own(text='a (b, c', gain=<robot.lab.Gain object at 0x7f00>)",
            "Own with text a (b, c, gain robot.lab.Gain",
        ),
    ],
)
def test_the_footnote_names_parameters_that_are_not_at_their_defaults(controller, words):
    told = controller if isinstance(controller, str) else repr(controller)
    assert palette.controller_text(replace(some_run(), controller=told)) == words


@pytest.mark.parametrize(
    ("limits", "words"),
    [
        (pp.Limits(step=0.05), "0.05 rad per step"),
        (pp.Limits(step=None), "joint positions only"),
        (pp.Limits(step=None, dt=0.02), "speeds of the arm, steps of 0.02 s"),
        (
            pp.Limits(None, np.linspace(1, 2, 12), dt=0.01, acceleration=4.0, jerk=50.0, position_margin=0.1),
            "1 to 2 rad/s, 4 rad/s², 50 rad/s³, steps of 0.01 s, 0.1 rad from the ends of the joints",
        ),
    ],
)
def test_the_footnote_has_the_limits_in_words(limits, words):
    assert palette.limits_text(replace(some_run(), limits=limits)) == f"limits: {words}"


@pytest.mark.long
def test_the_arm_is_the_largest_panel_and_lies_within_its_room():
    figure = pp.plot(some_run())
    draw(figure)
    postures, *others = figure.axes
    sizes = [ax.get_position(original=True).size.prod() for ax in (postures, *others)]
    assert sizes[0] > 2.0 * max(sizes[1:])
    room = postures.get_position(original=True).transformed(figure.transFigure)
    corners = np.array(np.meshgrid(postures.get_xlim(), postures.get_ylim(), postures.get_zlim())).reshape(
        3, 8
    )
    x, y, _ = proj3d.proj_transform(*corners, postures.get_proj())
    shown = postures.transData.transform(np.column_stack([x, y]))
    assert np.all((shown > room.min) & (shown < room.max))
    assert np.max(np.ptp(shown, axis=0) / room.size) > 0.65


@pytest.mark.long
def test_text_that_looks_like_mathematics_is_shown_as_it_is():
    run = some_run()
    draw(pp.plot(replace(run, reason="costs $x_{$")))
    draw(pp.plot(replace(run, controller="Odd($\\frac$)")))


def with_errors(change: Callable[[np.ndarray], np.ndarray]) -> pp.Run:
    return replace(some_run(), point_errors=change(some_run().point_errors))


CASES = {
    "no step": lambda: run_to(bent(), start=goal()),
    "zero errors": lambda: with_errors(np.zeros_like),
    "some zeros": lambda: with_errors(
        lambda errors: errors * np.logspace(0, -8, len(errors))[:, None] * (np.arange(6) > 1)
    ),
    "zero at the end": lambda: with_errors(lambda errors: np.vstack([errors[:-1], np.zeros((1, 6))])),
    "one step": lambda: run_to(helix(), steps=1),
    "one module": lambda: run_to(
        pp.Target.from_configuration(pp.Arm.from_template("RyRz", modules=1), [0.3, 0.2]),
        arm=pp.Arm.from_template("RyRz", modules=1),
    ),
    "no curve": lambda: run_to(bent()),
    "points only": lambda: run_to(pp.Target.from_points(six_modules(), bent().points, [1, 1, 0, 1, 0, 0])),
    "straight to straight": lambda: run_to(
        pp.Target.from_configuration(six_modules(), np.zeros(12)), start=np.zeros(12), controller="selection"
    ),
    "no target at all": lambda: replace(some_run(), target=replace(helix(), weights=np.zeros(6))),
    "partial": lambda: run_to(
        pp.resolve_targets(
            six_modules(), pp.Curve.helix(0.1, 0.3, 0.3), placement="align", incomplete="partial"
        )
    ),
}


@pytest.mark.long
@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("case", cases(CASES, quick=3))
def test_unusual_runs_are_drawn_without_a_warning(case):
    run = CASES[case]()
    pixels = draw(pp.plot(run))
    assert np.mean(pixels[:, :, :3].min(axis=2) < 200) > 0.005  # more than a title


def test_zeros_stay_in_the_data_of_a_logarithmic_axis():
    run = CASES["zero at the end"]()
    wide = replace(run, point_errors=run.point_errors * np.logspace(0, -5, run.steps + 1)[:, None])
    ax = one_panel()
    plot_posture_error(wide, ax)
    assert ax.get_yscale() == "log"
    assert ax.get_lines()[0].get_ydata()[-1] == 0.0
    assert ax.texts[-1].get_text() == "below rounding"
    assert 0.0 < ax.get_ylim()[0] < wide.posture_error[wide.posture_error > 0].min()


def test_small_ranges_are_drawn_linearly_and_include_zero():
    run = some_run()
    ax = one_panel()
    plot_posture_error(
        replace(run, point_errors=np.linspace(2.0, 1.0, 6 * (run.steps + 1)).reshape(-1, 6)), ax
    )
    assert ax.get_yscale() == "linear"
    assert ax.get_ylim()[0] <= 0.0


@pytest.mark.long
def test_runs_that_lie_on_each_other_are_all_seen_in_a_comparison():
    run = some_run()
    errors = run.point_errors * 10.0 ** -np.arange(run.steps + 1)[:, None]  # in the end below the axis
    names = ("geodesic", "selection", "projection", "switching")
    runs = {name: replace(run, controller=name, point_errors=errors) for name in names}
    figure = pp.plot_comparison(runs)
    drawn = draw(figure)[..., :3].astype(float)
    _, panel, counts = figure.axes
    box = counts.get_window_extent()
    low = len(drawn) - int(box.y1) - 5
    high = len(drawn) - int(box.y0)
    inside = drawn[low:high, int(box.x0) : int(box.x1)]
    for name in names:
        color = 255.0 * np.array(palette.rgb(THEME.controllers[name]))
        assert (np.abs(inside - color).max(axis=2) < 40.0).sum() > 100
    labels = [text.get_window_extent() for text in panel.texts]
    assert len(labels) == 4
    assert not any(one.overlaps(two) for k, one in enumerate(labels) for two in labels[:k])


def test_a_value_is_moved_away_from_the_dot_of_another():
    ax = one_panel()
    ax.set_xlim(0.0, 10.0)
    for place in (1.0, 2.0, 3.0):  # each in the text of the one before
        palette.mark_value(ax, place, 0.5, THEME.ink, "end")
    palette.add_title(ax.figure, ["values"])
    texts = [text.get_window_extent() for text in ax.texts]
    dots = [line.get_window_extent() for line in ax.lines]
    assert len(texts) == len(dots) == 3
    assert not any(text.overlaps(dot) for text in texts for dot in dots)
    assert not any(one.overlaps(two) for k, one in enumerate(texts) for two in texts[:k])


@pytest.mark.long
def test_a_comparison_draws_a_common_start_once_and_every_end_in_its_colour():
    runs = {"first": run_to(helix(), controller="selection"), "second": some_run()}
    figure = pp.plot_comparison(runs)
    postures, errors, counts = figure.axes
    labels = [text.get_text() for text in postures.get_legend().get_texts()]
    assert labels.count("initial posture") == 1
    assert {"first", "second", "target curve"} <= set(labels)
    for (label, run), line in zip(runs.items(), counts.get_lines(), strict=True):
        np.testing.assert_array_equal(lines(errors)[label].get_ydata(), run.mean_error)
        np.testing.assert_array_equal(line.get_ydata(), run.active.sum(axis=1))
    assert lines(errors)["first"].get_color() == THEME.controllers["selection"]
    assert lines(errors)["second"].get_color() == THEME.controllers["projection"]
    starts = [
        line for line in postures.get_lines() if line.get_color() == THEME.start and len(line.get_xdata()) > 1
    ]
    assert len(starts) == 2  # its bodies and its control points
    assert errors.get_xlim() == counts.get_xlim() == (0.0, max(run.steps for run in runs.values()))
    draw(figure)


def test_different_starts_are_all_drawn():
    other = run_to(helix(), start=np.full(six_modules().nv, 0.1))
    postures = pp.plot_comparison({"a": some_run(), "b": other}).axes[0]
    starts = [
        line for line in postures.get_lines() if line.get_color() == THEME.start and len(line.get_xdata()) > 1
    ]
    assert len(starts) == 4


def test_several_runs_in_one_panel_all_fit():
    run = some_run()
    ax = one_panel()
    short = run_to(helix(), steps=4)
    plot_posture_error(run, ax, label="long")
    plot_posture_error(short, ax, label="short")
    assert run.steps > short.steps
    assert ax.get_xlim() == (0.0, run.steps)
    low, high = ax.get_ylim()
    assert low < min(run.posture_error.min(), short.posture_error.min())
    assert high > run.posture_error.max()


@pytest.mark.parametrize(
    ("show", "words"),
    [
        (lambda: pp.plot(helix()), r"run is Target.*a Run or .*pp\.view\(arm, target=target\)"),
        (lambda: pp.plot(six_modules()), r"run is Arm.*pp\.plot_arm\(arm\)"),
        (lambda: pp.plot([some_run()]), r"run is \[Run.*pp\.plot_comparison"),
        (lambda: pp.plot("run.npz"), r"run is 'run.npz'.*pp\.load"),
        (lambda: pp.plot_arm(some_run()), r"arm is Run.*an Arm; pp\.plot\(run\)"),
        (lambda: pp.plot_comparison([some_run()]), r"runs is \[.*\{label: run"),
        (lambda: pp.plot_comparison({"a": six_modules()}), r"runs\['a'\] is Arm.*a Run; pp\.plot_arm"),
        (lambda: pp.view(helix()), r"arm is Target.*an Arm; pp\.view\(arm, target=target\)"),
        (lambda: pp.view(six_modules(), helix()), r"run is Target.*or None; pp\.view\(arm, target=target\)"),
        (lambda: pp.view(six_modules(), scene="a.toml"), r"scene is 'a.toml'.*pp\.Scene\.load"),
        (lambda: pp.animate(six_modules(), None), "run is not given; allowed: a Run or a Trajectory"),
        (
            lambda: pp.animate(six_modules(), some_run(), pp.Curve.line((0, 0), (1, 0))),
            "target is Curve.*resolve",
        ),
    ],
)
def test_what_a_viewer_cannot_show_is_refused_with_the_function_that_can(show, words):
    with pytest.raises(InvalidValue, match=words):
        show()


def test_runs_that_have_nothing_in_common_are_not_compared():
    with pytest.raises(InvalidValue, match="same target"):
        pp.plot_comparison({"a": some_run(), "b": run_to(bent())})
    with pytest.raises(InvalidValue, match="at least one"):
        pp.plot_comparison({})


def test_runs_of_one_controller_get_different_colours():
    assert len(set(palette.distinct_colors(["Selection()"] * 8))) == 8
    assert palette.distinct_colors(["Projection(x=1)", "selection"]) == [
        THEME.controllers["projection"],
        THEME.controllers["selection"],
    ]


def luminance(color: str) -> float:
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in palette.rgb(color)]
    return float(np.dot([0.2126, 0.7152, 0.0722], linear))


def test_what_must_be_told_apart_differs_in_more_than_hue():
    def contrast(a: str, b: str) -> float:
        dark, light = sorted([luminance(a), luminance(b)])
        return (light + 0.05) / (dark + 0.05)

    assert contrast(THEME.active, THEME.idle) > 1.8
    assert contrast(*THEME.modules) > 2.0
    for color in (THEME.start, THEME.target, THEME.ink, *THEME.controllers.values()):
        assert contrast(color, "#FFFFFF") > 2.0
    along = [luminance(color) for color in THEME.along]
    assert np.all(np.diff(along) > 0.0)


@pytest.mark.process
def test_drawing_leaves_the_settings_of_matplotlib_alone_and_pyplot_asleep():
    before = dict(mpl.rcParams)
    draw(pp.plot(some_run()))
    assert dict(mpl.rcParams) == before
    code = "import sys, pinposture.viz; sys.exit('matplotlib.pyplot' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_steps_that_were_left_to_projection_are_marked_on_the_axis():
    arm = six_modules()
    target = pp.resolve_targets(arm, pp.Curve.helix(radius=0.06, pitch=0.15, turns=2), placement="align")
    run = pp.track(arm, target, arm.straight(), "switching")
    panel = next(ax for ax in pp.plot(run).axes if "Projection" in ax.get_xlabel())
    (marks,) = (line for line in panel.get_lines() if line.get_color() == THEME.mark)
    np.testing.assert_array_equal(marks.get_xdata(), np.flatnonzero(run.info["method"] == "projection") + 1)
    alone = pp.plot(pp.track(arm, target, arm.straight(), "projection", max_steps=3))
    assert not any("red" in ax.get_xlabel() for ax in alone.axes)


@pytest.mark.long
def test_a_joint_trajectory_is_drawn_joint_by_joint() -> None:
    q = np.random.default_rng(0).normal(size=(7, 12))
    joints = pp.JointTrajectory.from_configurations(six_modules(), q, 0.1)
    panels = pp.plot(joints).axes[:3]
    for ax, table in zip(panels, (joints.positions, joints.velocities, joints.accelerations), strict=True):
        assert len(ax.lines) == 12
        for line, values in zip(ax.lines, table.T, strict=True):
            np.testing.assert_array_equal(line.get_xdata(), joints.time)
            np.testing.assert_array_equal(line.get_ydata(), values)
    assert [ax.get_ylabel() for ax in panels] == [
        "position [rad]",
        "velocity [rad/s]",
        "acceleration [rad/s²]",
    ]
    draw(pp.plot(pp.JointTrajectory.from_positions(["a"], [[0.5]], 1.0)))  # one row, and no units
