"""Steering an arm by its tip into pipes that only a pilot sees.

    python -m benchmarks.studies.steering                  # 20 draws, some two minutes
    python -m benchmarks.studies.steering --draws 3

Each draw is a pipe with two bends of 30 to 90 degrees, of radii of 0.2 to 0.35 m, in random directions, 15 to
35 mm wider all around than the arm (20 modules, 1 m, 1 cm thick). The pilot sees how far the tip is from the
middle of the pipe 8 cm ahead, with errors of 3 mm, and steers towards it, ten times a second, at 5 cm/s. A
tracker moves the arm (100 Hz, velocities and accelerations limited). Then the arm is withdrawn.

Told are how far it came, its clearance to the pipe by a collision model with all walls, how far the body is
from the path of the tip, and how far from its start the arm ends after it is withdrawn.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pinposture as pp
from pinposture.collision.pipe import pipe, pipe_axis
from pinposture.task import Steering, path_deviation

Array = NDArray[np.float64]

DT = 0.01
SPEED = 0.05
AHEAD = 0.08
EVERY = 10
"""Cycles between two looks of the pilot."""

SEEN = 0.003
"""Standard deviation of what the pilot sees [m]."""

MARGIN = 0.002
LIMITS = pp.Limits(dt=DT, acceleration=10.0)


class Draw(NamedTuple):
    """A pipe: runs [m]; radius [m], angle and direction [rad] of bends; free width around the arm [m]."""

    runs: tuple[float, float, float]
    bends: tuple[tuple[float, float, float], ...]
    free: float


class Outcome(NamedTuple):
    """What became of a draw: arc length reached, of the pipe [m], and the rest as the module says [m]."""

    reached: float
    length: float
    clearance: float
    deviation: float
    back: float
    reasons: tuple[str, ...]


def fed_arm() -> pp.Arm:
    """Return an arm of 1 m on a feed."""
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=1.2, velocity=0.1)
    feed = pp.ModuleTemplate("Feed", joints=(slide,), link_lengths=(0.05,))
    return pp.Arm.from_modules([feed, *[pp.template("RyRz")] * 20])


def draw(rng: np.random.Generator) -> Draw:
    """Return a random pipe."""
    runs = tuple(float(each) for each in rng.uniform(0.05, 0.12, 3))
    bends = tuple(
        (
            float(rng.uniform(0.2, 0.35)),
            float(rng.uniform(0.5, np.pi / 2)),
            float(rng.uniform(0.0, 2 * np.pi)),
        )
        for _ in range(2)
    )
    return Draw(runs, bends, float(rng.uniform(0.015, 0.035)))  # type: ignore[arg-type]


def look(steering: Steering, path: pp.Curve, rng: np.random.Generator) -> Array:
    """Return the curvature towards the middle of the pipe ahead, to the left and up, (2,) [1/m]."""
    tip = steering.arm.at(steering.q).points[-1]
    s = np.linspace(0.0, path.length, 2000)
    points = path.at(s)
    nearest = int(np.linalg.norm(points - tip, axis=1).argmin())
    ahead = points[min(nearest + int(AHEAD / path.length * 2000), 1999)] + SEEN * rng.standard_normal(3)
    x, y, z = steering.frame.T @ (ahead - tip)
    across = np.array([y, z])
    return np.asarray(2.0 * across / (x**2 + across @ across))


def run(drawn: Draw, seed: int) -> Outcome:
    """Steer an arm into a pipe, and withdraw it."""
    rng = np.random.default_rng(seed)
    arm = fed_arm()
    axis = pipe_axis(runs=drawn.runs, bends=drawn.bends)
    start = pp.Steering(arm, LIMITS).q
    path = axis.moved(np.eye(3), arm.at(start).points[-1] - axis.start)
    scene = pipe(path, radius=0.01 + drawn.free, self_collision=False)
    scene = pp.Scene(scene.obstacles, margin=MARGIN, self_collision=False)
    steering = Steering(arm, LIMITS, scene)
    tracker = pp.Tracker(arm, limits=LIMITS, scene=scene)
    q = steering.q
    rows = [q]
    reasons = set()
    curvature = np.zeros(2)
    stands = 0
    while steering.depth < path.length and stands < 100:
        if len(rows) % EVERY == 1:
            curvature = look(steering, path, rng)
        before = steering.depth
        tracker.update(steering.step(SPEED, curvature))
        stands = stands + 1 if steering.depth == before else 0
        reasons.add(steering.reason.split(":")[0])
        q = arm.integrate(q, tracker.step(q))
        rows.append(q)
    reached = min(steering.depth, path.length)
    deviation = path_deviation(arm, np.array(rows[::5]), steering.path, placement="as_is")
    while steering.depth > 0.0:
        tracker.update(steering.step(-SPEED))
        q = arm.integrate(q, tracker.step(q))
        rows.append(q)
    for _ in range(100):
        q = arm.integrate(q, tracker.step(q))
    model = pp.CollisionModel(arm, scene)
    clearance = min(model.minimum(row).distance for row in rows[::5])
    back = float(np.linalg.norm(arm.at(q).points - arm.at(start).points, axis=1).max())
    return Outcome(reached, path.length, clearance, deviation.largest, back, tuple(sorted(reasons - {""})))


COLUMNS = ("pipe [m]", "free [mm]", "came [m]", "clearance [mm]", "off the path [mm]", "back to [mm]", "told")


def print_row(*cells: str) -> None:
    """Print a row of a table."""
    print("|", " | ".join(cells), "|", flush=True)


def main() -> None:
    """Print a row for each draw."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    print_row(*COLUMNS)
    print_row(*["---"] * len(COLUMNS))
    for number in range(given.seed, given.seed + given.draws):
        drawn = draw(np.random.default_rng(number))
        found = run(drawn, number)
        print_row(
            f"{found.length:.2f}",
            f"{1e3 * drawn.free:.0f}",
            f"{found.reached:.2f}",
            f"{1e3 * found.clearance:.1f}",
            f"{1e3 * found.deviation:.2f}",
            f"{1e3 * found.back:.4f}",
            ", ".join(found.reasons) or "-",
        )


if __name__ == "__main__":
    main()
