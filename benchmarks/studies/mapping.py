"""An arm enters a box through a hole that it has not seen, mapping with a depth camera at its tip.

    python -m benchmarks.studies.mapping                 # 50 draws
    python -m benchmarks.studies.mapping --draws 5 --json
    python -m benchmarks.studies.mapping --unknown free  # the margin to what is not seen is lost in some

The arm has 20 RyRz modules on a feed, 1 m in all, and stands straight 20 cm in front of a box of 60 x 60 x
50 cm. Its front wall has a square hole, 9 to 12 cm wide, up to 10 cm off the axis of the arm; in the box
hangs a ball of 5 cm, at most 3 cm beside the way of the arm. The camera looks ahead 5 times a second, with
100 degrees and 160 x 120 pixels; its rays are intersected with the true box in closed form, with a noise of
1 mm. Each picture reaches the loop 60 ms after it was taken. Cells are 1 cm wide; unknown ones are
forbidden, but for those within 15 cm of the arm at first.

The hole is read off the map, as the middle of the free cells within the wall. The arm follows a curve
through it, posture by posture, to a point in the box; it has arrived if its tip rests within 1 cm of that.
Margins are judged at every cycle and halfway between, by coal with the placements of Pinocchio, against the
true box. Times are those of the processor. Cycles that plan, in this thread, count apart; after them the path
is another one. Of these, cycles count apart once more in which nothing changed but the map: it cut the way,
and the time is that from the new map to the first step on another way.
"""

from __future__ import annotations

import argparse
import json
import sys
from itertools import pairwise
from time import thread_time
from typing import Any, Literal, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.progress import track as with_progress
from scipy.interpolate import CubicSpline

import pinposture as pp

Array = np.ndarray

DT = 0.02
MARGIN = 0.01
THIN = 0.01
CELL = 0.01
LIMITS = pp.Limits(step=None, velocity=1.0, acceleration=5.0, dt=DT)
FRONT = 1.25
HALF = 0.3
DEPTH = 0.5
WALL = 0.01
BALL = 0.05
BESIDE = (0.0, 0.03)
"""Place of the front wall, half its width, depth of the box, thickness of its walls, radius of the ball, and
least and largest distance between ball and arm on the way that is drawn [m]."""

PICTURE = 10
LATE = 3
LOOKING = 50
CYCLES = 700
"""Cycles from one picture to the next, until one reaches the loop, before the arm sets out, and at most."""

ROOM = 0.15
"""How far around the arm it is known to be free at first [m]."""

POSTURES = 24
NEAR = 0.01
"""Number of postures on the way, and mean error at which the next one is taken [m]."""

AHEAD = np.array([[0.0, 0.0, 1.0], [-1.0, 0.0, 0.0], [0.0, -1.0, 0.0]])
"""From the axes of a camera that looks along x to those of the tip."""


class Draw(NamedTuple):
    """What is drawn: the hole, its middle (y, z) and half its width; the ball; and the point to reach."""

    hole: Array
    half: float
    ball: Array
    goal: Array

    @classmethod
    def of(cls, seed: int) -> Draw:
        """Return a draw."""
        rng = np.random.default_rng(seed)
        hole = rng.uniform(-0.1, 0.1, 2)
        half = rng.uniform(0.045, 0.06)
        goal = np.array([FRONT + rng.uniform(0.25, 0.35), *(hole + rng.uniform(-0.08, 0.08, 2))])
        way = Way(hole, goal)
        points = way.spline(np.linspace(0.0, way.end, 400))
        while True:
            ball = rng.uniform((FRONT + 0.1, -0.2, -0.2), (FRONT + 0.4, 0.2, 0.2))
            beside = np.linalg.norm(points - ball, axis=1).min() - BALL - THIN
            if BESIDE[0] < beside < BESIDE[1] and np.linalg.norm(goal - ball) > BALL + 0.06:
                return cls(hole, half, ball, goal)

    @property
    def boxes(self) -> list[tuple[Array, Array]]:
        """The walls: middle and half the edge lengths of each."""
        y, z = self.hole
        back = FRONT + DEPTH
        walls = [
            ((FRONT, -HALF, -HALF), (FRONT + WALL, y - self.half, HALF)),
            ((FRONT, y + self.half, -HALF), (FRONT + WALL, HALF, HALF)),
            ((FRONT, y - self.half, -HALF), (FRONT + WALL, y + self.half, z - self.half)),
            ((FRONT, y - self.half, z + self.half), (FRONT + WALL, y + self.half, HALF)),
            ((back, -HALF, -HALF), (back + WALL, HALF, HALF)),
            ((FRONT, -HALF - WALL, -HALF), (back, -HALF, HALF)),
            ((FRONT, HALF, -HALF), (back, HALF + WALL, HALF)),
            ((FRONT, -HALF, -HALF - WALL), (back, HALF, -HALF)),
            ((FRONT, -HALF, HALF), (back, HALF, HALF + WALL)),
        ]
        return [(0.5 * np.add(low, high), 0.5 * np.subtract(high, low)) for low, high in walls]


class Way:
    """The curve that the arm follows: along its axis, through the hole, to the point."""

    def __init__(self, hole: Array, goal: Array) -> None:
        knots = np.array(
            [(x, 0.0, 0.0) for x in (0.0, 0.3, 0.6, 0.8)]
            + [(FRONT - 0.1, *hole), (FRONT + 0.08, *hole), tuple(goal)]
        )
        chords = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(knots, axis=0), axis=1)))
        self.spline = CubicSpline(chords, knots)
        self.end = float(chords[-1])

    def posture(self, arm: pp.Arm, tip: float) -> Array:
        """Return control points, (m, 3), of an arm along the curve with the tip at a length on it."""
        at = np.linspace(0.0, self.end, 4000)
        points = self.spline(at)
        lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
        places = tip - arm.length + np.cumsum([0.05] * arm.n_modules)
        return np.column_stack([np.interp(places, lengths, points[:, axis]) for axis in range(3)])

    @property
    def length(self) -> float:
        """Its length [m]."""
        points = self.spline(np.linspace(0.0, self.end, 4000))
        return float(np.linalg.norm(np.diff(points, axis=0), axis=1).sum())


def build_arm() -> pp.Arm:
    """Return the arm: modules on a feed."""
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=1.0)
    feed = pp.ModuleTemplate("Feed", joints=(slide,), link_lengths=(0.05,))
    return pp.Arm.from_modules([feed, *[pp.template("RyRz")] * 20])


class Camera:
    """A depth camera that sees the true box.

    Args:
        drawn: the box.
        width: number of columns; three quarters as many rows.
        noise: standard deviation of depths [m].
    """

    def __init__(self, drawn: Draw, width: int = 160, noise: float = 0.001) -> None:
        height = 3 * width // 4
        focal = 0.5 * width / np.tan(np.radians(50.0))
        self.intrinsics = pp.Intrinsics(focal, focal, 0.5 * (width - 1), 0.5 * (height - 1))
        rows, columns = np.mgrid[0:height, 0:width]
        u = (columns - self.intrinsics.cx) / focal
        v = (rows - self.intrinsics.cy) / focal
        self._ways = np.stack([u, v, np.ones_like(u)], axis=-1).reshape(-1, 3)
        self._shape = height, width
        self._drawn = drawn
        self._noise = noise

    def depth(self, placement: pin.SE3, rng: np.random.Generator) -> Array:
        """Return what it sees from a placement, (h, w) [m]; infinite where there is nothing."""
        ways = self._ways @ placement.rotation.T
        origin = placement.translation
        depth = np.full(len(ways), np.inf)
        with np.errstate(divide="ignore", invalid="ignore"):
            for middle, half in self._drawn.boxes:
                one = (middle - half - origin) / ways
                other = (middle + half - origin) / ways
                enters = np.minimum(one, other).max(axis=1)
                leaves = np.maximum(one, other).min(axis=1)
                hit = (enters <= leaves) & (enters > 0.0)
                depth = np.where(hit, np.minimum(depth, enters), depth)
        offset = origin - self._drawn.ball
        a = (ways**2).sum(axis=1)
        b = ways @ offset
        square = b * b - a * (offset @ offset - BALL**2)
        hit = (square > 0.0) & (b < 0.0)
        near = (-b - np.sqrt(np.maximum(square, 0.0))) / a
        depth = np.where(hit, np.minimum(depth, near), depth)
        return (depth + rng.normal(0.0, self._noise, len(depth))).reshape(self._shape)


class Judge:
    """Distance of the arm from the true box, by coal with the placements of Pinocchio."""

    def __init__(self, arm: pp.Arm, drawn: Draw) -> None:
        self._arm = arm
        self._data = arm.model.createData()
        self._things = [
            (coal.Box(*(2.0 * half)), coal.Transform3s(np.eye(3), middle)) for middle, half in drawn.boxes
        ]
        self._things.append((coal.Sphere(BALL), coal.Transform3s(np.eye(3), drawn.ball)))

    def gap(self, q: Array) -> float:
        """Return the smallest distance between the surfaces [m]."""
        model = self._arm.model
        pin.forwardKinematics(model, self._data, q)
        placed = [self._data.oMi[joint].translation for joint in range(1, model.njoints)]
        nodes = np.vstack([placed, self._arm.chain_at(q).points[-1]])
        nearest = np.inf
        for a, b in pairwise(nodes):
            size = float(np.linalg.norm(b - a))
            if max(a[0], b[0]) < FRONT - 0.1 or size < 1e-9:
                continue
            turn = pin.Quaternion.FromTwoVectors(np.array([0.0, 0.0, 1.0]), b - a).toRotationMatrix()
            capsule = coal.Capsule(THIN, size)
            here = coal.Transform3s(turn, 0.5 * (a + b))
            for shape, there in self._things:
                found = coal.distance(
                    capsule, here, shape, there, coal.DistanceRequest(), coal.DistanceResult()
                )
                nearest = min(nearest, found)
        return nearest


def find_hole(mapped: pp.Map) -> Array | None:
    """Return the middle (y, z) of the free cells of a map within the front wall; None: there are none."""
    seen = mapped.cells.points
    seen = seen[mapped.states(seen) == 1]
    ahead = seen[(np.abs(seen[:, 1:]) < HALF).all(axis=1)]
    if not len(ahead):
        return None
    layers, counts = np.unique(ahead[:, 0].round(6), return_counts=True)
    front = layers[counts.argmax()]
    side = np.arange(-HALF + 0.05, HALF - 0.05, CELL)
    y, z = (each.ravel() for each in np.meshgrid(side, side))
    free = mapped.states(np.column_stack([np.full(y.size, front), y, z])) == -1
    return np.array([y[free].mean(), z[free].mean()]) if free.sum() > 20 else None


class Outcome(NamedTuple):
    """How a draw went: the smallest true distance [m], whether it arrived, its status, and times [ms].

    Times are those of pictures, of cycles, of those with a new map, of those that plan for a new target, and
    of those that plan because a new map cut the way.
    """

    lowest: float
    arrived: bool
    status: str
    pictures: list[float]
    cycles: list[float]
    with_map: list[float]
    with_plan: list[float]
    with_cut: list[float]

    def add_cycle(self, taken: float, new_map: bool, plans: bool, new_target: bool) -> None:
        """Add the time of a cycle [ms]."""
        if plans:
            (self.with_cut if new_map and not new_target else self.with_plan).append(taken)
        else:
            (self.with_map if new_map else self.cycles).append(taken)


def path_of(tracker: pp.Tracker) -> Array | None:
    """Return the offsets of the path that a tracker follows; None: it has none."""
    step = tracker.report.step
    progress = getattr(None if step is None else step.memory, "progress", None)
    return None if progress is None else progress.path.offsets


def run(arm: pp.Arm, seed: int, unknown: Literal["free", "forbidden"] = "forbidden") -> Outcome:
    """Run a draw."""
    drawn = Draw.of(seed)
    rng = np.random.default_rng(seed)
    camera = Camera(drawn)
    judge = Judge(arm, drawn)
    lowest = np.inf
    mounting = pp.Mounting(arm.tip, pin.SE3(AHEAD, np.zeros(3)))
    mapped = pp.Map(CELL, arm, center=(0.5, 0.0, 0.0), reach=1.7, unknown=unknown)
    if unknown == "forbidden":
        mapped.clear(0.0 * arm.straight(), ROOM)
    scene = pp.Scene({"map": mapped.cells}, margin=MARGIN, self_collision=False)
    tracker = pp.Tracker(arm, limits=LIMITS, scene=scene)
    q = 0.0 * arm.straight()
    tracker.update(pp.Target.from_configuration(arm, q))
    outcome = Outcome(np.inf, False, "", [], [], [], [], [])
    path = path_of(tracker)
    way = None
    number = 0
    coming: list[tuple[int, pp.Scene]] = []
    for cycle in range(CYCLES):
        now = cycle * DT
        mapped.measure(q, now)
        if cycle % PICTURE == 0:
            depth = camera.depth(mapped.sensor_placement(mounting, q), rng)
            began = thread_time()
            mapped.add_depth(depth, camera.intrinsics, mounting, now)
            outcome.pictures.append(1e3 * (thread_time() - began))
            coming.append((cycle + LATE, scene.updated({"map": mapped.cells})))
        if way is None and cycle >= LOOKING:
            hole = find_hole(mapped)
            if hole is None:
                break
            way = Way(hole, drawn.goal)
            tips = np.linspace(arm.length, way.length, POSTURES)
        aimed = tracker.target
        close = tracker.report.mean_error is not None and tracker.report.mean_error < NEAR
        if way is not None and number < POSTURES and (close or number == 0):
            tracker.update(pp.Target.from_points(arm, way.posture(arm, tips[number])))
            number += 1
        new = coming.pop(0)[1] if coming and coming[0][0] <= cycle else None
        began = thread_time()
        dq = tracker.step(q, scene=new)
        taken = 1e3 * (thread_time() - began)
        known = path
        path = path_of(tracker)
        outcome.add_cycle(taken, new is not None, path is not known, tracker.target is not aimed)
        for share in (0.5, 1.0):
            lowest = min(lowest, judge.gap(arm.integrate(q, share * dq)))
        q = tracker.command
        apart = float(np.linalg.norm(arm.chain_at(q).points[-1] - drawn.goal))
        if number == POSTURES and apart < NEAR and not np.any(np.abs(dq) > 1e-4):
            return outcome._replace(lowest=lowest, arrived=True, status=tracker.report.status)
    return outcome._replace(lowest=lowest, status=f"{number} {tracker.report}")


def summarise(outcomes: list[Outcome]) -> dict[str, Any]:
    """Return what is printed."""

    def percentiles(name: str) -> dict[str, float]:
        times = np.concatenate([getattr(each, name) for each in outcomes])
        if not len(times):
            return {}
        return {f"p{k}": float(np.percentile(times, k)) for k in (50, 90, 99, 100)}

    lowest = [each.lowest for each in outcomes]
    return {
        "draws": len(outcomes),
        "margin_kept": int(np.sum(np.array(lowest) >= MARGIN - 2e-4)),
        "smallest_distance": float(min(lowest)),
        "arrived": sum(each.arrived for each in outcomes),
        "picture_ms": percentiles("pictures"),
        "cycle_ms": percentiles("cycles"),
        "cycle_with_map_ms": percentiles("with_map"),
        "cycle_with_plan_ms": percentiles("with_plan"),
        "cycle_with_cut_ms": percentiles("with_cut"),
        "ways_cut": sum(len(each.with_cut) for each in outcomes),
    }


def main() -> int:
    """Run all draws, and print how many kept the margin and arrived."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=50)
    parser.add_argument("--first", type=int, default=0, help="seed of the first draw")
    parser.add_argument("--unknown", choices=("free", "forbidden"), default="forbidden")
    parser.add_argument("--json", action="store_true")
    asked = parser.parse_args()
    arm = build_arm()
    console = Console(stderr=True)
    outcomes = []
    seeds = range(asked.first, asked.first + asked.draws)
    for seed in with_progress(seeds, "draws", console=console, transient=True):
        outcome = run(arm, seed, asked.unknown)
        outcomes.append(outcome)
        console.log(f"{seed}: {1e3 * outcome.lowest:.1f} mm, arrived: {outcome.arrived}, {outcome.status}")
    result = summarise(outcomes)
    if asked.json:
        json.dump(result, sys.stdout, indent=1)
        return 0
    print(
        f"margin kept in {result['margin_kept']} of {asked.draws}; smallest distance "
        f"{1e3 * result['smallest_distance']:.1f} mm; {result['arrived']} arrived"
    )
    for name in ("picture_ms", "cycle_ms", "cycle_with_map_ms", "cycle_with_plan_ms", "cycle_with_cut_ms"):
        times = ", ".join(f"{value:.1f} ({key})" for key, value in result[name].items())
        print(f"{name}: {times}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
