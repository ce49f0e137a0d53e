"""The pictures of the documentation: drawn here, figures that examples save, and frames of their animations.

python docs/pictures.py            # all, into docs/pictures, and three GIFs beside; frames need Chromium
python docs/pictures.py limits     # those named
"""

from __future__ import annotations

import contextlib
import io
import os
import runpy
import shutil
import sys
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import matplotlib as mpl

mpl.use("Agg")

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray
from PIL import Image

import pinposture as pp
from benchmarks.cases.clutter import KINDS_WITH_A_WAY, draw_problem
from benchmarks.cases.scenarios import SCENARIOS, case
from benchmarks.cases.situations import situation_arm
from benchmarks.reproduce.runs import thesis_arm
from benchmarks.studies.clutter import draw_clutter, run_problem
from pinposture.task.reference import Reference
from pinposture.viz import palette
from pinposture.viz.body import backbone
from pinposture.viz.palette import THEME, format_time_axes
from pinposture.viz.panels import plot_clearance
from pinposture.viz.postures import PosturePanel, draw_ellipsoids, draw_runs, ellipsoid_key, shade_ellipsoids

Array = NDArray[np.float64]

HERE = Path(__file__).parent
DPI = 110
COLORS = 256
"""Resolution of the drawings, and the number of colours of a file."""

PLANAR = pp.Arm.from_template("Rz", modules=20, link_lengths=(0.05,))
"""The arm of most pictures: planar, 1 m."""

WORDS: dict[str, Any] = {"fontsize": 9, "color": THEME.ink}
ARROW: dict[str, Any] = {"arrowstyle": "-", "color": THEME.quiet, "lw": 0.8, "shrinkB": 3}


def bent(*curvatures: float) -> Array:
    """A configuration of the planar arm that bends by so many radians in each of as many equal parts."""
    return np.repeat(np.array(curvatures) * len(curvatures) / PLANAR.nq, PLANAR.nq // len(curvatures))


def empty(columns: int, height: float, **grid: Any) -> tuple[Figure, list[Axes]]:
    """A figure with axes beside each other."""
    figure = Figure(figsize=(9.0, height), layout="constrained")
    return figure, list(figure.subplots(1, columns, squeeze=False, **grid)[0])


def frame(*axes: Axes) -> None:
    """Give axes the same scales, fitted to what they show."""
    boxes = [ax.dataLim for ax in axes]
    wide = np.array([min(box.x0 for box in boxes), max(box.x1 for box in boxes)])
    high = np.array([min(box.y0 for box in boxes), max(box.y1 for box in boxes)])
    room = 0.04 * np.ptp(wide) * np.array([-1.0, 1.0])
    for ax in axes:
        ax.set_aspect("equal", adjustable="box")
        ax.set(xlim=wide + room, ylim=high + room)


def modules() -> Figure:
    """An arm of three modules with the names of its parts."""
    arm = pp.Arm.from_template("RzRz", modules=3)
    figure, (ax,) = empty(1, 3.4)
    panel = PosturePanel(arm, ax)
    q = np.array([0.45, -0.15, -0.5, -0.35, 0.3, 0.5])
    points = np.vstack([arm.chain.base, arm.at(q).points])
    joints = arm.at(q).origins
    for k in range(3):
        line = np.vstack([points[k], joints[2 * k : 2 * k + 2], points[k + 1]])
        panel.line(line, color=THEME.modules[k % 2], lw=9.0, solid_capstyle="butt", zorder=3)
    panel.line(joints, ls="none", marker="o", ms=6, mfc="none", mec=THEME.turn, mew=1.5, zorder=5)
    panel.line(points[1:], ls="none", marker="o", ms=9, mfc=THEME.active, mec=THEME.ink, zorder=4)
    panel.finish()
    middle = (points[1] + joints[3]) / 2.0
    for text, place, offset in (
        ("base", points[0], (-6, -38)),
        ("joint", joints[1], (-4, 32)),
        ("module 2: two joints, two links", middle, (-70, -62)),
        ("module boundary,\nposture control point 1", points[1], (-6, 34)),
        ("posture control point 3, the tip", points[3], (-170, 22)),
    ):
        words = {"xytext": offset, "textcoords": "offset points", "arrowprops": ARROW}
        ax.annotate(text, place[:2], **words, **WORDS)
    ax.set_aspect("equal", adjustable="box")
    ax.set(xlim=(-0.06, 0.92), ylim=(-0.13, 0.24))
    return figure


def target() -> Figure:
    """A target curve with its control points, and the target posture on it."""
    controls = np.array([(0, 0, 0), (0.35, 0, 0), (0.5, 0.5, 0), (0.8, 0.1, 0), (1.2, 0.2, 0)])
    curve = pp.Curve.spline(controls)
    resolved = pp.resolve_targets(PLANAR, curve)
    figure, axes = empty(2, 3.0)
    drawn = PosturePanel(PLANAR, axes[0])
    drawn.line(controls, color=THEME.start, lw=0.8, ls=(0, (4, 3)), marker="s", ms=5)
    drawn.line(curve.at(np.linspace(0, curve.length, 300)), color=THEME.target, lw=1.6)
    drawn.finish()
    axes[0].set_title("target curve and its control points", **WORDS)
    panel = PosturePanel(PLANAR, axes[1])
    panel.target(resolved)
    panel.posture(resolved.q, THEME.final, "posture of the arm", 2.0)
    panel.finish()
    axes[1].set_title("target posture: a point on the curve for each control point", **WORDS)
    axes[1].legend(fontsize=8, frameon=False, loc="upper left")
    frame(*axes)
    return figure


def ellipsoids() -> Figure:
    """Manipulability ellipsoids of three postures, from singular to regular."""
    figure, axes = empty(3, 3.1, width_ratios=(1.0, 1.0, 1.0))
    postures = {"straight, singular": bent(0.0), "nearly straight": bent(0.5, -0.5), "bent": bent(2.6, -2.6)}
    for ax, (name, q) in zip(axes, postures.items(), strict=True):
        panel = PosturePanel(PLANAR, ax)
        chosen = PLANAR.at(q).ellipsoids([6, 12, 19])
        draw_ellipsoids(panel, chosen)
        panel.posture(q, THEME.start, "arm", 2.0)
        panel.finish()
        shade_ellipsoids(panel, chosen)
        if ax is not axes[0]:
            ax.set_ylabel("")
        ax.set_title(f"{name}: index of the tip {chosen[-1].index:.2g}", **WORDS)
    frame(*axes)
    figure.legend(handles=ellipsoid_key(), loc="outside lower center", ncols=3, fontsize=8, frameon=False)
    return figure


def active() -> Figure:
    """The active control set of Selection, in a posture with a straight part."""
    q = bent(0.0, 0.0, 1.2, -0.7, 1.3)
    goal = pp.Target.from_configuration(PLANAR, bent(0.4, 0.5, -0.8, 0.6, 0.3))
    step = pp.Selection().step(PLANAR.at(q), goal)
    figure, (ax,) = empty(1, 3.0)
    panel = PosturePanel(PLANAR, ax)
    points = PLANAR.at(q).points
    panel.line(np.vstack([PLANAR.chain.base, points]), color=THEME.modules[0], lw=4.0, zorder=3)
    dots = {"ls": "none", "marker": "o", "ms": 7.5, "mec": THEME.ink, "mew": 0.8}
    panel.line(points, mfc=THEME.idle, zorder=4, label="not active", **dots)
    panel.line(points[list(step.active)], mfc=THEME.active, zorder=5, label="active", **dots)
    panel.finish()
    ax.legend(fontsize=9, frameon=False, loc="upper left")
    frame(ax)
    ax.set_title(f"{len(step.active)} of {PLANAR.n_modules} control points are active", **WORDS)
    return figure


def direct() -> Figure:
    """The most direct path to a posture, and the straight one through joint space."""
    start = bent(1.5, -0.3)
    goal = bent(-1.1, -0.9)
    slowly = pp.Limits(step=0.02)
    figure, axes = empty(2, 4.4)
    names = {"geodesic": "the most direct path (geodesic)", "joint": "straight through joint space (joint)"}
    for ax, (controller, name) in zip(axes, names.items(), strict=True):
        run = pp.track(PLANAR, pp.Target.from_configuration(PLANAR, goal), start, controller, slowly)
        panel = PosturePanel(PLANAR, ax)
        moved = np.linalg.norm(np.diff(run.points, axis=0), axis=2).mean(axis=1)
        way = np.append(0.0, np.cumsum(moved))
        for share in np.linspace(0.0, 1.0, 7):
            row = int(np.abs(way - share * way[-1]).argmin())
            panel.posture(run.q[row], palette.in_time(share), "_", 1.4)
        for k in (9, 19):
            panel.line(run.points[:, k], color=THEME.quiet, lw=0.8, ls=(0, (3, 2)), zorder=1)
        panel.finish()
        ax.set_title(f"{name}:\n{run.path_length_ratio:.2f} times as long as straight lines", **WORDS)
    frame(*axes)
    return figure


def limits() -> Figure:
    """Joint speeds of a run under limits of speed and acceleration."""
    within = pp.Limits(step=None, dt=0.02, velocity=0.5, acceleration=2.0)
    goal = pp.Target.from_configuration(PLANAR, bent(1.4, -1.8, 1.0, -0.6))
    run = pp.track(PLANAR, goal, bent(0.3, -0.2, 0.6, -0.4), limits=within, max_steps=2000)
    joints = run.joint_trajectory()
    figure, axes = empty(2, 3.0)
    for ax, values, bound, label in (
        (axes[0], joints.velocities, 0.5, "joint speed [rad/s]"),
        (axes[1], joints.accelerations, 2.0, "joint acceleration [rad/s²]"),
    ):
        for k, line in enumerate(values.T):
            ax.plot(joints.time, line, lw=0.8, color=THEME.along[k * len(THEME.along) // values.shape[1]])
        for sign in (-1.0, 1.0):
            ax.axhline(sign * bound, color=THEME.mark, lw=1.0, ls=(0, (4, 2)))
        format_time_axes(ax, label)
        ax.set_ylim(-1.15 * bound, 1.15 * bound)
    figure.suptitle("20 joints, from base (dark) to tip (light); red: the limits", **WORDS)
    return figure


def scene() -> Figure:
    """A path around a post, and the clearance along it."""
    post = pp.Cylinder(start=(0.82, 0.0, -1.0), end=(0.82, 0.0, 1.0), radius=0.06)
    around = pp.Scene({"post": post}, margin=0.02)
    goal = pp.Target.from_configuration(PLANAR, bent(-0.9, 0.6))
    run = pp.track(PLANAR, goal, bent(0.9, -0.6), scene=around)
    figure, axes = empty(2, 4.0, width_ratios=(1.0, 1.0))
    draw_runs([(run, "final posture", palette.controller_color(run.controller))], axes[0])
    plot_clearance(run, axes[1])
    return figure


def wrapped() -> Figure:
    """A long arm wrapped around a column."""
    arm = pp.Arm.from_template("RyRz", modules=40)
    column = pp.Cylinder((0.8, 0.2, -0.5), (0.8, 0.2, 0.5), radius=0.15)
    curve = pp.curve_around(column, start=(0, 0, 0), gap=0.03, turns=1.25, direction=(1, 0, 0))
    target = pp.resolve_targets(arm, curve, placement="as_is")
    return pp.plot_arm(arm, target.q, scene=pp.Scene({"column": column}))


def clutter() -> Figure:
    """A problem of each kind of `make study STUDY=clutter`, and its run."""
    arm = situation_arm()
    return draw_clutter({kind: run_problem(draw_problem(arm, kind, 0)) for kind in KINDS_WITH_A_WAY})


def between() -> Figure:
    """The curve between two keyframes: it bends, and keeps its length."""
    line = pp.Curve.line((0, 0, 0), (1, 0, 0))
    coil = pp.Curve.helix(radius=0.16, pitch=0.0, turns=1.0)
    keyframes = [pp.Keyframe(line), pp.Keyframe(coil, time=1.0, placement="align", trim=True)]
    reference: Reference = pp.keyframe_reference(PLANAR, keyframes, interval=0.02)
    figure, (ax,) = empty(1, 3.4)
    panel = PosturePanel(PLANAR, ax)
    for share in np.linspace(0.0, 1.0, 7):
        row = round(share * (reference.rows - 1))
        label = f"{reference.times[row]:.2f} s"
        panel.posture(reference.configuration(row), palette.in_time(share), label, 1.6)
    panel.finish()
    frame(ax)
    ax.legend(fontsize=8, frameon=False, loc="center left", bbox_to_anchor=(1.0, 0.5))
    return figure


def helix() -> Figure:
    """Four controllers on one helix, as in `make demo`."""
    arm = thesis_arm("ryrz20")
    start, goal = case(arm, SCENARIOS["helix"], 17)
    names = ("geodesic", "selection", "projection", "switching")
    return pp.plot_comparison({name: pp.track(arm, goal, start, name) for name in names})


def keyframes() -> Figure:
    """The motion of the example of a task file."""
    return pp.plot(pp.Task.load(HERE.parent / "examples" / "tasks" / "keyframes.toml").perform())


DRAGGED = 3
FRAMES = 150
CYCLE = 0.04
"""The control point that the animation drags, its number of frames, and the time between two of them [s]."""

FLOOR = -0.12
"""Height of the floor in the animation [m]."""


def on_screen(points: Array) -> Array:
    """Project points (n, 3) [m] to the plane of the picture: right, up and towards the viewer."""
    turn, tilt = np.radians((-62.0, 24.0))
    right = np.array([np.cos(turn + np.pi / 2), np.sin(turn + np.pi / 2), 0.0])
    eye = np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)])
    return np.asarray(points @ np.stack([right, np.cross(eye, right), eye], axis=1))


def above_floor(arm: pp.Arm, q: Array) -> tuple[Figure, Axes]:
    """Draw the floor, and the shadow of an arm at q."""
    figure = Figure(figsize=(6.4, 3.6), dpi=100)
    ax = figure.add_axes((0.0, 0.0, 1.0, 1.0))
    for k in np.arange(-0.4, 1.41, 0.2):
        for ends in ([(k, -0.6, FLOOR), (k, 0.8, FLOOR)], [(-0.4, k - 0.2, FLOOR), (1.4, k - 0.2, FLOOR)]):
            ax.plot(*on_screen(np.array(ends))[:, :2].T, color=THEME.faint, lw=0.6, zorder=0)
    shadow = backbone(arm, q) * (1, 1, 0) + (0, 0, FLOOR)
    ax.plot(*on_screen(shadow)[:, :2].T, color="#E4E4E4", lw=7, zorder=1)
    return figure, ax


def draw_modules(ax: Axes, arm: pp.Arm, q: Array, width: float, order: Callable[[float], float]) -> Array:
    """Draw the modules of an arm and its base, in an order by their place towards the viewer.

    Returns:
        The base and the control points on the screen, (m + 1, 3).
    """
    ends = on_screen(np.vstack([arm.chain.base, arm.at(q).points]))
    stations = on_screen(backbone(arm, q))
    for k in range(arm.n_modules):
        first, last = (int(np.abs(stations - end).sum(axis=1).argmin()) for end in ends[k : k + 2])
        part = stations[first : last + 1, :2].T
        color = THEME.modules[k % 2]
        ax.plot(*part, color=color, lw=width, solid_capstyle="round", zorder=order(float(ends[k, 2])))
    ax.plot(*ends[:1, :2].T, ls="none", marker="s", ms=11, color=THEME.base, zorder=4)
    return ends


def as_frame(
    figure: Figure, ax: Axes, note: str, across: tuple[float, float], upward: tuple[float, float]
) -> Image.Image:
    """Return a figure as a frame of an animation, with a note, and what it shows in both directions [m]."""
    ax.text(0.02, 0.05, note, transform=ax.transAxes, fontsize=9, color=THEME.ink)
    ax.set(xlim=across, ylim=upward, aspect="equal")
    ax.axis("off")
    canvas = FigureCanvasAgg(figure)
    canvas.draw()
    return Image.fromarray(np.asarray(canvas.buffer_rgba())).convert("RGB")


def dragging_frame(arm: pp.Arm, q: Array, controls: Array, curve: pp.Curve, note: str) -> Image.Image:
    """Draw one frame: the curve with its control points, the arm at q, and their shadows on the floor."""
    figure, ax = above_floor(arm, q)
    polygon = on_screen(controls)
    ax.plot(*polygon[:, :2].T, color=THEME.start, lw=0.9, ls=(0, (4, 3)), zorder=2)
    line = on_screen(curve.at(np.linspace(0, curve.length, 300)))
    ax.plot(*line[:, :2].T, color=THEME.target, lw=1.4, zorder=8)  # above the arm: it is always seen
    ends = draw_modules(ax, arm, q, 9, lambda toward: 3.0 + 0.5 * toward)
    ax.plot(*ends[1:, :2].T, ls="none", marker="o", ms=4, mfc=THEME.active, mec=THEME.ink, mew=0.5, zorder=9)
    ax.plot(*polygon[1:, :2].T, ls="none", marker="o", ms=7, color=THEME.spare[0], mec=THEME.ink, zorder=9)
    held = polygon[DRAGGED : DRAGGED + 1, :2].T
    ax.plot(*held, ls="none", marker="o", ms=11, color=THEME.start, mec=THEME.ink, zorder=10)
    ax.plot(*held, ls="none", marker="o", ms=21, mfc="none", mec=THEME.final, mew=1.6, zorder=10)
    return as_frame(figure, ax, note, (-0.32, 1.2), (-0.28, 0.575))


def dragging(count: int = FRAMES) -> list[Image.Image]:
    """Drag one control point of a curve in a loop, follow it with a tracker, and draw the first cycles."""
    arm = pp.Arm.from_template("RyRz", modules=20)
    limits = pp.Limits(step=None, dt=CYCLE, velocity=2.0, acceleration=10.0)
    tracker = pp.Tracker(arm, limits=limits)
    rest = np.array([(0, 0, 0), (0.25, 0, 0), (0.45, 0.1, 0.25), (0.75, 0.1, 0.25), (1.15, 0.05, 0.05)])
    target = None
    q = None
    frames = []
    for k in range(count + 1):
        angle = 2.0 * np.pi * k / FRAMES
        controls = rest.copy()
        controls[DRAGGED] += (0.12 * (np.cos(angle) - 1), 0.25 * np.sin(2 * angle), 0.28 * np.sin(angle))
        curve = pp.Curve.spline(controls)
        target = pp.resolve_targets(arm, curve, placement="as_is", near=target)
        q = target.q if q is None else q
        tracker.update(target)
        q = arm.integrate(q, tracker.step(q))
        error = np.linalg.norm(arm.at(q).points - target.points, axis=1).mean()
        note = f"40 joints, 2 rad/s and 10 rad/s² at most; mean point error {1e3 * error:.1f} mm"
        frames.append(dragging_frame(arm, q, controls, curve, note))
    return frames[1:]


OPERATING_DELAY = 100
"""Time for which a picture of the operator's run is shown [ms]: twice the speed of the simulation."""

SHOWN = 8
"""Every so many cycles of the simulation of `19_wrap` there is a frame, which is shown at twice the speed."""


def wrapping_frame(arm: pp.Arm, q: Array, can: pp.Cylinder, note: str) -> Image.Image:
    """Draw one frame: an arm at q, in front of a can or behind it."""
    figure, ax = above_floor(arm, q)
    start = np.array(can.start)
    end = np.array(can.end)
    axis = (end - start) / np.linalg.norm(end - start)
    side = np.cross(axis, (1.0, 0.0, 0.0))
    side /= np.linalg.norm(side)
    angles = np.linspace(0.0, 2.0 * np.pi, 61)[:, None]
    rim = can.radius * (np.cos(angles) * side + np.sin(angles) * np.cross(axis, side))
    low, high = (on_screen(place + rim)[:, :2] for place in (start, end))
    middle = on_screen(0.5 * (start + end)[None])[0, 2]
    shadow = on_screen((start + rim) * (1, 1, 0) + (0, 0, FLOOR))[:, :2]
    ax.fill(*shadow.T, color="#E4E4E4", zorder=1)
    for k in range(len(low) - 1):  # the mantle, as far as it faces the viewer
        quad = np.array([low[k], low[k + 1], high[k + 1], high[k]])
        ax.fill(*quad.T, color=THEME.spare[0], alpha=0.35, lw=0, zorder=5)
    ax.plot(*high.T, color=THEME.ink, lw=0.8, zorder=5.5)
    draw_modules(ax, arm, q, 8, lambda toward: (3.0 if toward < middle else 6.0) + 0.5 * toward)
    return as_frame(figure, ax, note, (-0.15, 0.95), (-0.27, 0.349))


def wrapping(count: int | None = None) -> list[Image.Image]:
    """Draw the first frames of the simulation of `19_wrap`."""
    back = Path.cwd()
    with tempfile.TemporaryDirectory() as place, contextlib.redirect_stdout(io.StringIO()):
        os.chdir(place)
        try:
            made = runpy.run_path(str(HERE.parent / "examples/19_wrap.py"))
        finally:
            os.chdir(back)
    ended, scene = made["ended"], made["scene"]
    rows = range(0, len(ended.q), SHOWN)[:count]
    return [
        wrapping_frame(
            ended.arm,
            ended.q[row],
            ended.scene_in(row, scene).obstacles["can"],
            f"simulated in MuJoCo: 40 joints of 5 N m, a can of 300 g, friction 0.5; {ended.time[row]:.1f} s",
        )
        for row in rows
    ]


def animate(path: Path, frames: list[Image.Image], delay: int) -> None:
    """Write frames as an animated GIF that repeats, with one palette for all, and a delay [ms]."""
    sample = Image.new("RGB", (frames[0].width, 3 * frames[0].height))
    for k in range(3):
        sample.paste(frames[k * len(frames) // 3], (0, k * frames[0].height))
    colors = sample.quantize(64, dither=Image.Dither.NONE)
    entries = np.reshape(colors.getpalette(), (-1, 3))
    entries[entries.min(axis=1) > 245] = 255  # the background stays white
    reduced = [frame.quantize(palette=colors, dither=Image.Dither.NONE) for frame in frames]
    for frame in reduced:
        frame.putpalette(entries.ravel().tolist())
    reduced[0].save(path, save_all=True, append_images=reduced[1:], duration=delay, loop=0, optimize=True)


CONCEPTS: dict[str, Callable[[], Figure]] = {
    drawing.__name__: drawing
    for drawing in (
        *(modules, target, ellipsoids, active, direct, limits),
        *(scene, wrapped, clutter, between, helix, keyframes),
    )
}
"""The pictures that are drawn here."""

EXAMPLES = {
    "01_first_posture": "out/first_posture/run.png",
    "02_your_own_curve": "out/your_own_curve/run.png",
    "03_your_own_module": "out/your_own_module/arm.png",
    "04_part_of_an_arm": "out/part_of_an_arm/comparison.png",
    "05_around_obstacles": "out/around_obstacles/run.png",
    "06_keyframes": "out/five_postures/motion.png",
    "07_export_a_motion": "out/export/joints.png",
    "08_physics": "out/physics/open_gravity.png",
    "09_streaming": "out/streaming/errors.png",
    "10_follow_the_leader": "out/follow_the_leader/motion.png",
    "12_many_targets": "out/many_targets/reached.png",
    "13_tendon_arm": "out/tendon_arm/motion.png",
    "14_your_own_controller": "out/your_own_controller/comparison.png",
    "15_your_own_constraint": "out/your_own_constraint/angles.png",
    "16_weight": "out/weight/straight.png",
    "19_wrap": "out/wrap/lifted.png",
    "20_steering": "out/steering/arm.png",
}
"""The figure that each example of the tutorial saves."""


ANIMATIONS = {
    "first_posture": ("01_first_posture", "out/first_posture/run.html", 0.68, 1.3),
    "obstacles": ("05_around_obstacles", "out/around_obstacles/run.html", 0.44, 1.6),
}
"""The animation that an example saves, the share of its time that is shown, and how far it is enlarged."""

MEASURED = {
    "steps.png": "make bench",
    "obstacle_joints.png": "make study STUDY=obstacle_joints",
    "leader.png": "make study STUDY=leader",
    "figure-6.04.png": "make reproduce -- 6.4",
    "figure-6.04-own.png": "make reproduce -- 6.4 "
    "--controller examples.14_your_own_controller:JacobianTranspose",
    "figure-6.12.png": "make reproduce -- 6.12",
}
"""Pictures beside the pages that other commands draw from what they measure."""


@contextlib.contextmanager
def chromium() -> Iterator[Any]:
    """Yield Chromium without a screen, driven by Playwright."""
    from playwright.sync_api import sync_playwright

    flags = ["--no-sandbox", "--use-gl=angle", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
    with sync_playwright() as driver:
        browser = driver.chromium.launch(executable_path=shutil.which("chromium"), args=flags)
        yield browser
        browser.close()


def photograph(page: Path, share: float, zoom: float) -> bytes:
    """Return a frame of an animation as PNG, as Chromium shows it.

    Args:
        page: the animation, HTML.
        share: share of its duration at which the picture is taken.
        zoom: how far the view is enlarged.
    """
    with chromium() as browser:
        window = browser.new_page(viewport={"width": 1100, "height": 560})
        window.goto(page.absolute().as_uri())
        window.evaluate(
            "([share, zoom]) => {viewer.camera.zoom *= zoom; viewer.camera.updateProjectionMatrix();"
            "time.value = share * time.max; time.dispatchEvent(new Event('input'))}",
            [share, zoom],
        )
        window.wait_for_timeout(2000)
        return bytes(window.screenshot())


def draw(name: str, folder: Path) -> Path:
    """Make one picture.

    Args:
        name: a key of `CONCEPTS`, `EXAMPLES` or `ANIMATIONS`.
        folder: where to leave it.

    Returns:
        The file, a PNG.
    """
    made = io.BytesIO()
    if name in CONCEPTS:
        CONCEPTS[name]().savefig(made, dpi=DPI)
    else:
        example, saved, *shares = ANIMATIONS.get(name, (name, EXAMPLES.get(name, "")))
        back = Path.cwd()
        with tempfile.TemporaryDirectory() as place, contextlib.redirect_stdout(io.StringIO()):
            os.chdir(place)
            try:
                runpy.run_path(str(HERE.parent / "examples" / f"{example}.py"), run_name="__main__")
                made = io.BytesIO(photograph(Path(saved), *shares) if shares else Path(saved).read_bytes())
            finally:
                os.chdir(back)
    picture = Image.open(made).convert("RGB").quantize(COLORS, dither=Image.Dither.NONE)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / f"{name}.png"
    picture.save(path, optimize=True)
    return path


if __name__ == "__main__":
    for name in sys.argv[1:] or (*CONCEPTS, *EXAMPLES, *ANIMATIONS, "dragging", "wrapping", "operating"):
        if name == "dragging":
            animate(HERE / "dragging.gif", dragging(), round(1e3 * CYCLE))
        elif name == "wrapping":
            animate(HERE / "wrapping.gif", wrapping(), 80)
        elif name == "operating":
            from operating import operating

            with chromium() as browser:
                animate(HERE / "operating.gif", operating(browser), OPERATING_DELAY)
        else:
            draw(name, HERE / "pictures")
