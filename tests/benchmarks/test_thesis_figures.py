"""The figures of the thesis show the data of their runs."""

from __future__ import annotations

from dataclasses import replace

import matplotlib as mpl
import numpy as np
import pytest
from arms import template_arm
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

import pinposture as pp
from benchmarks.reproduce.figures import draw_errors, draw_final_postures, draw_planar, plot_used_points
from pinposture.errors import InvalidValue
from pinposture.units import length_text
from pinposture.viz import palette
from pinposture.viz.body import backbone
from pinposture.viz.palette import THEME
from pinposture.viz.panels import mark_projection, plot_point_count, plot_points_and_index


def spatial() -> pp.Arm:
    return template_arm("RyRz", 5)


def planar() -> pp.Arm:
    return template_arm("Rz", 8, (0.1,))


def run_of(arm, controller, steps=12, straight=False) -> pp.Run:
    rng = np.random.default_rng(7)
    target = pp.Target.from_configuration(arm, rng.uniform(-0.4, 0.4, arm.nv))
    q = np.full(arm.nv, 0.0) if straight else rng.uniform(-0.4, 0.4, arm.nv)
    return pp.track(arm, target, q, controller, pp.Limits(step=0.05), max_steps=steps)


@pytest.fixture(scope="session")
def selection() -> pp.Run:
    return run_of(spatial(), "selection")


@pytest.fixture(scope="session")
def projection() -> pp.Run:
    return run_of(spatial(), "projection", 9)


@pytest.fixture(scope="session")
def flat_selection() -> pp.Run:
    return run_of(planar(), "selection")


@pytest.fixture(scope="session")
def flat_projection() -> pp.Run:
    return run_of(planar(), "projection", 6)


def panel(**kind):
    return Figure().add_subplot(**kind)


def draw(figure: Figure) -> np.ndarray:
    """Draw a figure in earnest; pixels (height, width, 4)."""
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return np.asarray(canvas.buffer_rgba())


def heads(figure: Figure) -> dict[str, mpl.axes.Axes]:
    """Axes by what is written above them."""
    return {ax.get_title(loc="left"): ax for ax in figure.axes if ax.get_title(loc="left")}


def shows(ax, values) -> bool:
    return any(np.array_equal(line.get_ydata(), values) for line in ax.get_lines())


def marked(run, method) -> pp.Run:
    """The run as if its controller had several methods."""
    return replace(run, info={**run.info, "method": np.array(method)})


def test_points_used_are_dots_at_their_steps(selection):
    ax = panel()
    plot_used_points(selection, ax)
    (line,) = ax.get_lines()
    dots = set(zip(line.get_xdata().tolist(), line.get_ydata().tolist(), strict=True))
    assert dots == {
        (step + 1, point + 1) for step, points in enumerate(selection.active_sets) for point in points
    }
    assert line.get_linestyle() == "None"
    assert line.get_color() == THEME.controllers["selection"]
    assert ax.get_ylim() == (0, 6) and ax.get_xlim()[1] > selection.steps


def test_points_and_index_have_axes_of_their_own(selection):
    ax = panel()
    plot_points_and_index(selection, ax)
    assert shows(ax, selection.active.sum(axis=1))
    (other,) = [twin for twin in ax.figure.axes if twin is not ax]
    assert shows(other, selection.info["manipulability"])
    assert (ax.get_ylabel(), other.get_ylabel()) == ("active control points", "manipulability index")
    alone = panel()
    plot_point_count(selection, alone)
    assert shows(alone, selection.active.sum(axis=1))
    assert len(alone.figure.axes) == 1


def test_steps_of_a_method_are_red_dots_on_the_step_axis(selection):
    methods = ["selection"] * 3 + ["projection"] * 4 + ["selection"] * 5
    run = marked(selection, methods)
    ax = panel()
    plot_point_count(run, ax)
    mark_projection(run, ax)
    dots = ax.get_lines()[-1]
    assert dots.get_xdata().tolist() == [4, 5, 6, 7]
    assert set(dots.get_ydata().tolist()) == {0.0}
    assert dots.get_color() == THEME.mark
    on_axis = dots.get_transform().transform([[4.0, 0.0]])[0]
    bottom = ax.transAxes.transform([[0.0, 0.0]])[0]
    assert on_axis[1] == pytest.approx(bottom[1])


def test_final_postures_have_the_colours_of_the_thesis(selection, projection):
    figure = draw_final_postures({"Selection": selection, "Projection": projection}, "Title")
    whole, closer = figure.axes

    def drawn(ax, q, color):
        line = backbone(spatial(), q)
        found = [np.array(each.get_data_3d()).T for each in ax.get_lines() if each.get_color() == color]
        return any(each.shape == line.shape and np.allclose(each, line) for each in found)

    for ax in (whole, closer):
        assert drawn(ax, selection.q[-1], THEME.controllers["selection"])
        assert drawn(ax, projection.q[-1], THEME.controllers["projection"])
        assert drawn(ax, selection.q[0], THEME.start) is (ax is whole)
    labels = [text.get_text() for text in whole.get_legend().get_texts()]
    assert {"initial posture", "Selection, final posture", "Projection, final posture"} <= set(labels)
    assert draw(figure).shape[1] == 1200


@pytest.mark.long
def test_errors_have_a_row_for_each_run_and_the_letters_of_the_thesis(selection, projection):
    figure = draw_errors({"Selection": selection, "Projection": projection}, "Title")
    found = heads(figure)
    assert [head[:3] for head in found] == ["(a)", "(b)", "(c)", "(d)", "(e)", "(f)"]
    assert shows(found["(b) Selection: posture error"], selection.posture_error)
    assert shows(found["(e) Projection: posture error"], projection.posture_error)
    for letter, run in (("a", selection), ("d", projection)):
        ax = next(ax for head, ax in found.items() if head.startswith(f"({letter})"))
        for k in range(5):
            assert shows(ax, run.point_errors[:, k])
    assert shows(found["(c) Selection: control points used"], selection.active.sum(axis=1))
    pixels = draw(figure)
    assert pixels.shape[1] == 1200 and (pixels[..., :3] < 250).any()


def test_rows_share_a_scale_that_holds_all_their_values(selection):
    exact = run_of(spatial(), "lm", 40)
    assert exact.posture_error[-1] < 1e-4 < selection.posture_error.min()
    figure = draw_errors({"Selection": selection, "LM": exact}, "Title")
    found = heads(figure)
    first = found["(b) Selection: posture error"]
    second = found["(e) LM: posture error"]
    assert first.get_yscale() == second.get_yscale() == "log"
    assert first.get_ylim() == second.get_ylim()
    low, high = first.get_ylim()
    positive = exact.posture_error[exact.posture_error > 0]
    assert low < max(positive.min(), 1e-12 * high) and selection.posture_error.max() < high


@pytest.mark.long
def test_a_planar_figure_shows_everything_about_its_runs(flat_selection, flat_projection):
    arm = planar()
    runs = {"Selection": flat_selection, "Projection": flat_projection}
    figure = draw_planar(runs, "Title")
    found = heads(figure)
    assert sorted(head[1] for head in found) == list("abcdefg")
    initial = found["(a) initial posture and target curve"]
    start = backbone(arm, flat_selection.q[0])
    assert any(np.array_equal(line.get_ydata(), start[:, 1]) for line in initial.get_lines())
    for letters, (name, run) in zip(("bcd", "efg"), runs.items(), strict=True):
        used, progress, final = (
            next(ax for head, ax in found.items() if head.startswith(f"({letter}) {name}"))
            for letter in letters
        )
        assert len(used.get_lines()[0].get_xdata()) == run.active.sum()
        assert shows(progress, run.posture_error)
        end = backbone(arm, run.q[-1])
        colors = [
            line.get_color() for line in final.get_lines() if np.array_equal(line.get_ydata(), end[:, 1])
        ]
        assert palette.controller_color(run.controller) in colors
        on_the_way = backbone(arm, run.q[1])
        assert any(np.array_equal(line.get_ydata(), on_the_way[:, 1]) for line in final.get_lines())
        assert any(shows(ax, run.info["manipulability"]) for ax in figure.axes)
    words = "\n".join(text.get_text() for ax in figure.axes for text in ax.texts)
    assert length_text(flat_projection.posture_error[-1], arm.length) in words
    assert draw(figure).shape[1] == 1200


@pytest.mark.long
def test_a_switching_run_is_compared_and_its_steps_by_projection_are_marked(flat_selection, flat_projection):
    run = marked(flat_selection, ["selection"] * 4 + ["projection"] * 8)
    compared = {"Selection": flat_selection, "Projection": flat_projection}
    figure = draw_planar({"Switching": run}, "Title", compared)
    error = next(ax for head, ax in heads(figure).items() if head.startswith("(c)"))
    labels = {text.get_text() for ax in figure.axes if (key := ax.get_legend()) for text in key.get_texts()}
    named = {f"{name}: posture error" for name in ("Switching", "Selection alone", "Projection alone")}
    assert named < labels
    assert shows(error, flat_projection.posture_error)
    red = [line for ax in figure.axes for line in ax.get_lines() if line.get_color() == THEME.mark]
    assert [line.get_xdata().tolist() for line in red] == [list(range(5, 13))]
    draw(figure)


def drawn_in(ax) -> set[str]:
    """Colours of the lines of an axes, without those of the frame."""
    return {line.get_color() for line in ax.get_lines()}


@pytest.mark.long
def test_each_run_has_a_colour_of_its_own_throughout_a_figure(flat_selection, flat_projection):
    """Also more own controllers than there are spare colours, one of them called as a method is."""
    names = ["Switching", "transpose", "lm", "a", "b", "Selection(mine)"]
    runs = {name: replace(flat_selection, controller=f"{name}()") for name in names}
    compared = {"Selection": flat_selection, "Projection": flat_projection}
    figure = draw_planar(runs, "Title", compared)
    found = heads(figure)
    errors = {head[4:].partition(":")[0]: ax for head, ax in found.items() if "posture error" in head}
    used = {head[4:].partition(":")[0]: ax for head, ax in found.items() if "points used" in head}
    others = {THEME.controllers[name] for name in ("selection", "projection")}
    own = {name: drawn_in(ax) - others for name, ax in errors.items()}
    assert [len(colors) for colors in own.values()] == [1] * len(names)
    assert len(set.union(*own.values())) == len(names)
    assert {name: drawn_in(ax) for name, ax in used.items()} == own
    (key,) = [legend for ax in figure.axes if (legend := ax.get_legend())]
    shown = {
        text.get_text().removesuffix(": posture error"): {line.get_color()}
        for text, line in zip(key.get_texts(), key.get_lines(), strict=True)
    }
    assert {name: shown[name] for name in names} == own


@pytest.mark.long
@pytest.mark.parametrize("width", [None, 88.0, 180.0])
def test_nothing_in_a_figure_lies_upon_something_else_or_is_cut(width, flat_selection, flat_projection):
    compared = {"Selection": flat_selection, "Projection": flat_projection}
    runs = compared | {"a_controller_of_ones_own": flat_projection, "b": flat_selection}
    for figure in (draw_planar(runs, "Title", compared, width), draw_errors(runs, "Title", width)):
        draw(figure)
        whole = figure.bbox
        for ax in figure.axes:
            title = ax.title if ax.get_title() else ax._left_title
            words = [text for text in ax.texts if text.get_text()]
            for text in words:
                box = text.get_window_extent()
                assert not title.get_text() or not box.overlaps(title.get_window_extent()), text
                legend = ax.get_legend()
                assert legend is None or not box.overlaps(legend.get_window_extent()), text
            for text in (*words, title, ax.xaxis.label, ax.yaxis.label):
                box = text.get_window_extent()
                assert not text.get_text() or (box.x0 >= 0.0 and box.x1 <= whole.x1), text
                assert not text.get_text() or (box.y0 >= 0.0 and box.y1 <= whole.y1), text
        steps = [ax.get_xlim()[1] for ax in figure.axes if ax.get_xlabel().startswith("step")]
        assert len(set(steps)) == 1


@pytest.mark.long
@pytest.mark.parametrize("width", [None, 88.0])
def test_axes_in_space_are_named_within_the_figure(width, selection, projection):
    figure = draw_final_postures({"Selection": selection, "a long name": projection}, "Title", width)
    draw(figure)
    for ax in figure.axes:
        for axis in (ax.xaxis, ax.yaxis, ax.zaxis):
            box = axis.label.get_window_extent()
            assert box.x0 >= 0.0 and box.y0 >= 0.0 and box.x1 <= figure.bbox.x1 and box.y1 <= figure.bbox.y1


@pytest.mark.long
def test_runs_that_took_no_step_can_be_drawn():
    still = run_of(spatial(), "selection", straight=True)
    assert still.steps == 0
    draw(draw_errors({"Selection": still}, "Title"))
    draw(draw_final_postures({"Selection": still}, "Title"))
    flat = run_of(planar(), "selection", straight=True)
    assert flat.steps == 0
    draw(draw_planar({"Selection": flat}, "Title"))


def test_what_cannot_be_drawn_is_refused(selection):
    for drawn in (draw_errors, draw_final_postures, draw_planar):
        with pytest.raises(InvalidValue, match="runs"):
            drawn({}, "Title")
    with pytest.raises(InvalidValue, match="planar"):
        draw_planar({"Selection": selection}, "Title")
