"""What a scene costs with the number of joints: planning, and a cycle on the way.

    python -m benchmarks.studies.obstacle_joints                       # 40 to 1,000 joints, 8 draws each
    python -m benchmarks.studies.obstacle_joints --joints 40,200 --draws 3 --json
    python -m benchmarks.studies.obstacle_joints -o docs/obstacle_joints.png

An arm of RyRz modules, 1 m long and 20 mm thick, among 30 boxes of 5 cm, or 150 of 3 cm, with limits of
speed and acceleration. Start and goal are drawn until they are clear; half of the draws are such that the
direct path between them is not. Times are by one thread: of the plan, median and largest, and of the cycles
that follow, median and 99th percentile.
"""

from __future__ import annotations

import argparse
import json
import warnings
from pathlib import Path
from time import perf_counter
from typing import Any

import numpy as np

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.kernels import load

BOXES = {30: 0.05, 150: 0.03}
"""Numbers of boxes, and the length of their position_limits [m]."""

MARGIN, CYCLES, MAX_DRAWS = 0.005, 60, 3000

BEND = 24.0
"""Joint motion of smooth random configurations, times the number of joints [rad]."""


def draw_scene(arm: pp.Arm, boxes: int, rng: np.random.Generator) -> pp.Scene:
    """Boxes at random, away from the base."""
    obstacles: dict[str, pp.Box] = {}
    while len(obstacles) < boxes:
        center = rng.uniform(-0.8, 0.8, 3)
        if np.linalg.norm(center) > 0.25:
            position_limits, turn = (BOXES[boxes],) * 3, tuple(rng.uniform(-3.0, 3.0, 3))
            obstacles[f"box {len(obstacles) + 1}"] = pp.Box(tuple(center), position_limits, turn)
    return pp.Scene(obstacles, self_collision=False, margin=MARGIN, arm_radius=0.01)


def draw_problem(
    arm: pp.Arm, boxes: int, rng: np.random.Generator, blocked: bool
) -> tuple[pp.Scene, np.ndarray, np.ndarray]:
    """A scene, and a clear start and goal, between which the direct path is blocked or not."""
    for _ in range(MAX_DRAWS):
        scene = draw_scene(arm, boxes, rng)
        model = pp.CollisionModel(arm, scene)
        start, goal = (smooth_configuration(arm, rng, BEND / arm.nv) for _ in range(2))
        if min(model.minimum(q).distance for q in (start, goal)) < 2.0 * MARGIN:
            continue
        free = pp.plan(arm.at(start), pp.Target.from_configuration(arm, goal))
        clear = model.minimum_on_motions(start, free.offsets, MARGIN).distance >= MARGIN
        if clear != blocked:
            return scene, start, goal
    raise SystemExit(f"no such problem in {MAX_DRAWS} draws")


def measure(joints: int, boxes: int, draws: int) -> dict[str, Any]:
    """Times with one number of joints and of boxes [ms]."""
    arm = pp.Arm.from_template("RyRz", joints // 2, (1.0 / joints, 1.0 / joints))
    speed = 40.0 / joints  # so that the tip is as fast whatever the number of joints
    limits = pp.Limits(step=None, velocity=speed, acceleration=5.0 * speed, dt=0.02)
    plans, cycles, found = [], [], 0
    for draw in range(draws):
        scene, start, goal = draw_problem(arm, boxes, np.random.default_rng(draw), draw % 2 == 1)
        target, state = pp.Target.from_configuration(arm, goal), arm.at(start)
        began = perf_counter()
        path = pp.plan(state, target, scene, limits)
        plans.append(perf_counter() - began)
        found += not path.blocked_by
        controller, memory, q = pp.Geodesic(scene=scene), None, start
        for number in range(CYCLES):
            state = arm.at(q)
            began = perf_counter()
            step = controller.step(state, target, limits, memory)
            if number:
                cycles.append(perf_counter() - began)
            memory, q = step.memory, arm.integrate(q, step.dq)
    return {
        "joints": joints,
        "boxes": boxes,
        "found": found,
        "of": draws,
        "plan_ms": 1e3 * float(np.median(plans)),
        "largest_plan_ms": 1e3 * max(plans),
        "cycle_ms": 1e3 * float(np.median(cycles)),
        "cycle_p99_ms": 1e3 * float(np.percentile(cycles, 99)),
    }


def draw_plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Draw times against the number of joints."""
    import matplotlib as mpl

    mpl.use("Agg")
    import matplotlib.pyplot as plt

    figure, both = plt.subplots(1, 2, figsize=(9.0, 3.6), layout="constrained")
    for boxes, colour in zip(BOXES, ("#c8541e", "#5b8db8"), strict=True):
        own = [row for row in rows if row["boxes"] == boxes]
        joints = [row["joints"] for row in own]
        for axes, low, high, name in (
            (both[0], "cycle_ms", "cycle_p99_ms", "99 %"),
            (both[1], "plan_ms", "largest_plan_ms", "largest"),
        ):
            axes.plot(joints, [row[low] for row in own], "o-", color=colour, label=f"{boxes} boxes, median")
            axes.plot(joints, [row[high] for row in own], "o:", color=colour, label=f"{boxes} boxes, {name}")
    both[0].set(title="a cycle on the way")
    both[1].set(title="the plan")
    ticks = sorted({row["joints"] for row in rows})
    for axes in both:
        axes.set(xlabel="joints", ylabel="[ms]", xscale="log", yscale="log")
        axes.set_xticks(ticks, [str(each) for each in ticks])
        axes.minorticks_off()
        axes.legend(fontsize=8)
        axes.grid(color="#e4e4e4")
        axes.spines[["top", "right"]].set_visible(False)
    figure.savefig(path, dpi=110)
    plt.close(figure)


def main() -> None:
    """Measure, and print a line for each number of joints."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--joints", default="40,100,200,400,700,1000", help="numbers of joints, even")
    parser.add_argument("--draws", type=int, default=8, help="problems for each number")
    parser.add_argument("--json", action="store_true", help="print JSON")
    parser.add_argument("-o", "--output", type=Path, help="leave a plot here")
    options = parser.parse_args()
    warnings.simplefilter("ignore", pp.PostureWarning)
    load()
    rows = []
    for boxes in BOXES:
        for joints in map(int, options.joints.split(",")):
            row = measure(joints, boxes, options.draws)
            rows.append(row)
            if not options.json:
                print(
                    f"{joints:5d} joints {boxes:4d} boxes: plan {row['plan_ms']:8.1f} ms (largest "
                    f"{row['largest_plan_ms']:8.1f}), clear {row['found']} of {row['of']}; cycle "
                    f"{row['cycle_ms']:6.2f} ms (99 %: {row['cycle_p99_ms']:6.2f})",
                    flush=True,
                )
    if options.json:
        print(json.dumps(rows))
    if options.output is not None:
        draw_plot(rows, options.output)


if __name__ == "__main__":
    main()
