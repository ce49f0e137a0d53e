"""What scans cost: the same surroundings as boxes, as a cloud of points, and as a surface of triangles.

    python -m benchmarks.studies.scan_obstacles      # 30 and 150 boxes, 200,000 points and triangles
    python -m benchmarks.studies.scan_obstacles --items 20000 --boxes 30 --json

Boxes stand around an arm of 20 RyRz modules, 1 m, at random, clear of a start and a goal. Each is scanned on
all sides. Times are medians, by one thread: to prepare the scene for the arm; to find the distances that a
control step needs, at random configurations near the way; to test such configurations; of the first cycle,
which plans; and of the cycles after it.
"""

from __future__ import annotations

import argparse
import json
import statistics
import warnings
from collections.abc import Callable
from time import perf_counter

import numpy as np

import pinposture as pp
from pinposture.arm import smooth_configuration

MARGIN, REACH = 0.01, 0.15
"""Distance to keep, and distance beyond it within which a control step asks for distances [m]."""

LIMITS, MOST_CYCLES = pp.Limits(dt=0.02, velocity=1.0), 2000

POSTURES = 60
"""Number of configurations at which distances are measured."""


def draw_boxes(
    arm: pp.Arm, count: int, rng: np.random.Generator, clear: list[np.ndarray]
) -> dict[str, pp.Box]:
    """Boxes that keep well clear of an arm at some configurations."""
    boxes: dict[str, pp.Box] = {}
    while len(boxes) < count:
        center = rng.normal(size=3) * 0.45 + (0.4, 0.0, 0.0)
        size = rng.uniform(0.05, 0.3, 3) * (30.0 / count) ** (1.0 / 3.0)
        box = pp.Box(tuple(center), tuple(size), tuple(rng.uniform(-3.0, 3.0, 3)))
        model = pp.CollisionModel(arm, pp.Scene({"box": box}, self_collision=False, margin=MARGIN))
        if not model.excluded_pairs and min(model.minimum(q).distance for q in clear) > 2.0 * MARGIN:
            boxes[f"box {len(boxes) + 1}"] = box
    return boxes


def scanned(boxes: dict[str, pp.Box], count: int, surface: bool) -> pp.Scan:
    """The faces of boxes as a grid of about so many points or triangles."""
    area = sum(2.0 * sum(float(np.prod(np.delete(box.size, k))) for k in range(3)) for box in boxes.values())
    spacing = np.sqrt(area / count * (2.0 if surface else 1.0))
    points, faces, total = [], [], 0
    for box in boxes.values():
        half, turn = np.array(box.size) / 2.0, np.array(box.rotation)
        for axis in range(3):
            j, k = (axis + 1) % 3, (axis + 2) % 3
            numbers = [2 + int(2.0 * half[each] / spacing) for each in (j, k)]
            u, v = np.meshgrid(*(np.linspace(-1.0, 1.0, number) for number in numbers), indexing="ij")
            at = np.arange(u.size).reshape(u.shape)
            corners = [at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]]
            for side in (-1.0, 1.0):
                own = np.zeros((u.size, 3))
                own[:, axis], own[:, j], own[:, k] = side, u.ravel(), v.ravel()
                points.append(own * half @ turn.T + box.center)
                for three in ((0, 1, 2), (0, 2, 3)):
                    faces.append(total + np.stack([corners[n].ravel() for n in three], axis=1))
                total += u.size
    return pp.Scan(np.vstack(points), np.vstack(faces) if surface else None)


def median_time(calls: list[Callable[[], object]], repeats: int = 3) -> float:
    """Median over calls of the least time of each [s]."""
    times = []
    for call in calls:
        own = []
        for _ in range(repeats):
            began = perf_counter()
            call()
            own.append(perf_counter() - began)
        times.append(min(own))
    return statistics.median(times)


def measure(arm: pp.Arm, scene: pp.Scene, start: np.ndarray, goal: np.ndarray) -> dict[str, float]:
    """Times of one scene [ms], and the smallest clearance of the run [mm]."""
    began = perf_counter()
    model = pp.CollisionModel(arm, scene)
    prepared = perf_counter() - began
    rng, target = np.random.default_rng(1), pp.Target.from_configuration(arm, goal)
    shares = rng.uniform(size=POSTURES)
    way = [start + share * (goal - start) + rng.normal(size=arm.nq) * 0.03 for share in shares]
    states, offsets = [arm.at(q) for q in way], np.zeros((2, arm.nv))
    tracker = pp.Tracker(arm, limits=LIMITS, scene=scene)
    tracker.update(target)
    q, cycles, clearance = start, list[float](), np.inf
    while len(cycles) < MOST_CYCLES and tracker.report.status != "converged":
        began = perf_counter()
        dq = tracker.step(q)
        cycles.append(perf_counter() - began)
        q, clearance = tracker.command, min(clearance, model.minimum(tracker.command).distance)
        if len(cycles) > 1 and not dq.any():
            break
    return {
        "prepare": 1e3 * prepared,
        "nearest": 1e3 * median_time([lambda s=state: model.nearest(s, MARGIN + REACH) for state in states]),
        "minimum": 1e3 * median_time([lambda q=q: model.minimum(q) for q in way]),
        "keeps": 1e3
        * median_time([lambda q=q: model.minimum_on_motions(q, offsets, MARGIN, MARGIN) for q in way]),
        "first cycle": 1e3 * cycles[0],
        "cycle": 1e3 * statistics.median(cycles[1:]),
        "clearance": 1e3 * clearance,
    }


def main() -> None:
    """Measure, and print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--boxes", default="30,150", help="numbers of boxes")
    parser.add_argument("--items", type=int, default=200_000, help="number of points, and of triangles")
    parser.add_argument("--json", action="store_true", help="print JSON instead of a table")
    chosen = parser.parse_args()
    arm = pp.Arm.from_template("RyRz", modules=20)
    results: dict[str, dict[str, float]] = {}
    for count in (int(word) for word in chosen.boxes.split(",")):
        rng = np.random.default_rng(0)
        start, goal = (smooth_configuration(arm, rng, amplitude=0.6) for _ in range(2))
        boxes = draw_boxes(arm, count, rng, [start, goal])
        ways = {"boxes": boxes, "points": None, "triangles": None}
        for name in ways:
            obstacles = (
                boxes if name == "boxes" else {"scan": scanned(boxes, chosen.items, name == "triangles")}
            )
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", pp.PostureWarning)
                scene = pp.Scene(obstacles, self_collision=False, margin=MARGIN)
                results[f"{count} boxes as {name}"] = measure(arm, scene, start, goal)
    if chosen.json:
        print(json.dumps(results, indent=1))
        return
    keys = next(iter(results.values())).keys()
    print(f"{'[ms]; clearance [mm]':26}" + "".join(f"{key:>13}" for key in keys))
    for name, times in results.items():
        print(f"{name:26}" + "".join(f"{times[key]:13.3f}" for key in keys))


if __name__ == "__main__":
    main()
