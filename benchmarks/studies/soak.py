"""Control loops that run for long, while everything changes that does in a laboratory.

    python -m benchmarks.studies.soak --steps 100000
    python -m benchmarks.studies.soak --scenario obstacles --steps 1000000
    python -m benchmarks.studies.soak --all --steps 20000
    python -m benchmarks.studies.soak --scenario jumps --steps 1000000 --seconds 3600

In the scenario `faults`, targets jump at random, among them straight and folded ones and ones out of reach,
or arrive late; cycles are late; measurements are missing, not finite, or wrong by radians; now and then
somebody pushes the arm. Drives lag behind and sag. Each of the others changes one thing, again and again: see
`SCENARIOS`. Every output is checked: finite, within the limits of speed, acceleration and position. Memory
and objects are counted ten times on the way, and the processor time of a cycle is compared between the first
and the last tenth.
"""

from __future__ import annotations

import argparse
import gc
import json
import resource
import sys
import time
import warnings
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.errors import PostureError, PostureWarning
from pinposture.motion import Tracker

DT, LAG, SAG = 0.01, 0.05, 0.02
SPEED, ACCELERATION = 2.0, 10.0
OVERRUN = 5e-3  # time of a cycle that is counted, if there is no deadline [s]


def targets(arm: pp.Arm, rng: np.random.Generator, count: int) -> list[pp.Target]:
    """Postures to jump between: smooth, harsh, straight, folded, bare points, and out of reach."""
    made = []
    for k in range(count):
        q = smooth_configuration(arm, rng, rng.uniform(0.1, 1.0))
        if k % 6 == 1:
            q = arm.straight()
        elif k % 6 == 2:
            q = rng.uniform(-1.5, 1.5, arm.nv)
        elif k % 6 == 3:  # folded back upon itself
            q = arm.straight()
            q[arm.nv // 2] = np.pi - 1e-3
        points = arm.at(q).points
        if k % 6 == 4:
            made.append(pp.Target.from_points(arm, points))
        elif k % 6 == 5:
            made.append(pp.Target.from_points(arm, 1.3 * points))
        else:
            made.append(pp.Target.from_configuration(arm, q))
    return made


class Loop:
    """A control loop; a scenario changes its attributes before each cycle.

    Attributes:
        arm: the arm.
        rng: source of all random numbers.
        tracker: the tracker.
        targets: postures to jump between.
        first: the scene at the start; None: there are no obstacles.
        q: configuration of the arm, (nq,) [rad].
        measured: what is measured of it; None: nothing.
        scene: the scene to pass to the next cycle; None: none.
        duration: time since the cycle before [s].
    """

    def __init__(self, given: argparse.Namespace, scenario: str) -> None:
        self.rng = np.random.default_rng(given.seed)
        self.arm = pp.Arm.from_template("RyRz", modules=given.modules)
        acceleration = None if given.free else ACCELERATION
        limits = pp.Limits(step=None, velocity=SPEED, dt=DT, acceleration=acceleration, jerk=given.jerk)
        points = 5000 if scenario == "scans" else 0
        self.first = scene_of(self.arm, self.rng, points) if scenario in IN_SCENES else None
        controller: str | pp.Geodesic = given.controller
        if scenario == "tip":
            tip = pp.EndEffector(position=0.5 * self.arm.at(self.arm.straight()).points[-1], weight=0.1)
            controller = pp.Geodesic(tasks=(tip,))
        self.tracker = Tracker(self.arm, controller, limits, scene=self.first, deadline=given.deadline)
        self.targets = targets(self.arm, self.rng, 240)
        self.q = smooth_configuration(self.arm, self.rng, 0.5)
        self.sag = SAG * self.rng.normal(size=self.arm.nv)
        self.measured: np.ndarray | None = self.q
        self.scene: pp.Scene | None = None
        self.duration = DT

    def jump(self, chance: float) -> None:
        """Set another target, with some probability."""
        if self.rng.random() < chance:
            self.tracker.update(self.targets[self.rng.integers(len(self.targets))])

    def cycle(self, change: Callable[[Loop, int], None], number: int) -> tuple[np.ndarray, float, float]:
        """Run a cycle; return its step, how long it took, and the processor time of its thread [s]."""
        self.measured, self.scene, self.duration = self.q + self._noise(), None, DT
        change(self, number)
        begun = time.perf_counter()
        idle = time.thread_time()
        dq = self.tracker.step(self.measured, self.duration, scene=self.scene)
        worked = time.thread_time() - idle
        taken = time.perf_counter() - begun
        self.q = self.q + (self.tracker.command + self.sag - self.q) * (DT / LAG)
        return dq, taken, worked

    def _noise(self) -> np.ndarray:
        return 1e-4 * self.rng.normal(size=self.arm.nv)


def scene_of(arm: pp.Arm, rng: np.random.Generator, points: int = 0) -> pp.Scene:
    """Return three balls and a post at random around an arm, and a scanned wall of some points."""
    away = rng.uniform(0.4, 0.7, (3, 3)) * rng.choice([-1.0, 1.0], (3, 3)) * arm.length
    obstacles: dict[str, object] = {
        f"ball {k}": pp.Sphere(place, 0.05 * arm.length) for k, place in enumerate(away)
    }
    place = arm.length * np.array([0.5, rng.uniform(0.4, 0.6), -1.0])
    obstacles["post"] = pp.Cylinder(place, place + [0.0, 0.0, 2.0 * arm.length], 0.03 * arm.length)
    if points:
        wall = rng.uniform(-1.0, 1.0, (points, 3)) * [1.0, 1.0, 0.01] + [0.0, 0.0, -1.2]
        obstacles["wall"] = pp.Scan(arm.length * wall)
    return pp.Scene(obstacles, margin=0.005 * arm.length)


# The scenarios: what changes before a cycle.


def faults(loop: Loop, number: int) -> None:
    """Jumping targets, missing and wrong measurements, late cycles, pushes."""
    loop.jump(0.005)
    rng, q = loop.rng, loop.q
    chance = rng.random()
    if chance < 0.01:
        loop.measured = None
    elif chance < 0.02:
        loop.measured = np.where(rng.random(loop.arm.nv) < 0.1, np.nan, q)
    elif chance < 0.03:
        loop.measured = q + rng.normal(size=loop.arm.nv)
    elif chance < 0.0302:
        loop.q = q + 0.5 * rng.normal(size=loop.arm.nv)
    loop.duration = 3.0 * DT if rng.random() < 0.01 else DT


def obstacles(loop: Loop, number: int) -> None:
    """Obstacles that are measured anew in every cycle, some with velocities."""
    loop.jump(0.005)
    away = 0.05 * np.sin(0.01 * number)
    moved = {f"ball {k}": (0.0, 0.0, away) for k in range(1 + number // 100 % 3)}
    velocities = {"ball 0": (0.0, 0.0, 0.05)} if number // 500 % 2 else None
    loop.scene = loop.first.moved(moved, velocities)


def drifting(loop: Loop, number: int) -> None:
    """Obstacles whose velocities are given now and then; the tracker moves them on."""
    loop.jump(0.005)
    if number % 200 == 0:
        sign = 1.0 if number // 200 % 2 else -1.0
        before = loop.tracker.scene.moved({}, {"ball 0": (0.0, 0.0, 0.05 * sign)})
        loop.scene = before.after(DT)


def scenes(loop: Loop, number: int) -> None:
    """Scenes with other obstacles, every half second; a scan among them, every five seconds."""
    loop.jump(0.005)
    if number % 50 == 0:
        loop.scene = scene_of(loop.arm, loop.rng, points=5000 if number % 500 == 0 else 0)


def limits(loop: Loop, number: int) -> None:
    """Other limits every half second, among them of jerk, and cycles of all durations."""
    loop.jump(0.005)
    loop.duration = DT * loop.rng.choice([1e-3, 0.1, 0.5, 1.0, 1.0, 1.0, 3.0])
    if number % 50 == 0:
        velocity, acceleration = SPEED * loop.rng.uniform(0.2, 1.0), ACCELERATION * loop.rng.uniform(0.2, 1.0)
        jerk = loop.rng.choice([None, 50.0, 200.0])
        loop.tracker.limits = pp.Limits(
            step=None, velocity=velocity, acceleration=acceleration, jerk=jerk, dt=DT
        )


def jumps(loop: Loop, number: int) -> None:
    """New targets ten times a second: configurations with velocities, points, and curves."""
    if number % 10:
        return
    arm, rng = loop.arm, loop.rng
    q = smooth_configuration(arm, rng, rng.uniform(0.1, 1.0))
    kind = number // 10 % 3
    if kind == 0:
        loop.tracker.update(pp.Target.from_configuration(arm, q), velocity=0.1 * rng.normal(size=arm.nv))
    elif kind == 1:
        loop.tracker.update(pp.Target.from_points(arm, arm.at(q).points * rng.uniform(0.9, 1.1)))
    else:
        points = arm.at(q).points
        curve = pp.Curve.spline(points + 0.005 * arm.length * rng.normal(size=points.shape), through=True)
        try:
            loop.tracker.update(pp.resolve_targets(arm, curve, placement="align"))
        except PostureError:
            loop.jump(1.0)


def scans(loop: Loop, number: int) -> None:
    """New targets ten times a second, beside a scan."""
    jumps(loop, number)


def follow(loop: Loop, number: int) -> None:
    """A target that moves in every cycle."""
    wanted = 0.3 * np.sin(0.01 * number + np.arange(loop.arm.nv))
    loop.tracker.update(pp.Target.from_configuration(loop.arm, wanted))


def tip(loop: Loop, number: int) -> None:
    """A task of the tip beside targets that jump."""
    loop.jump(0.005)


def restarts(loop: Loop, number: int) -> None:
    """Restarts, at rest or in motion, every half second."""
    loop.jump(0.005)
    if number % 50 == 0:
        loop.tracker.restart(loop.q, 1e-3 * loop.rng.normal(size=loop.arm.nv) if number % 100 else None)


SCENARIOS = {
    each.__name__: each
    for each in (faults, obstacles, drifting, scenes, limits, jumps, scans, follow, tip, restarts)
}
IN_SCENES = ("obstacles", "drifting", "scenes", "scans")


def resident() -> float:
    """Return the memory of this process now [MB]; on other systems than Linux, the most it ever had."""
    pages = Path("/proc/self/statm")
    if pages.exists():
        return int(pages.read_text().split()[1]) * resource.getpagesize() / 2**20
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def run(given: argparse.Namespace, scenario: str) -> dict[str, object]:
    """Run a scenario, and return what was found."""
    loop = Loop(given, scenario)
    change, arm, steps = SCENARIOS[scenario], loop.arm, given.steps
    gc.collect()
    gc.freeze()  # or a pause of some 90 ms would come when the collector goes through all there is
    taken = np.full(steps, np.nan)  # written here, so that its pages do not count as growth on the way
    worked = np.full(steps, np.nan)
    outcome = Counter[str]()
    every = max(steps // 1000, 1)
    counted: list[tuple[float, int]] = []
    last_moment = time.perf_counter() + given.seconds
    before, fastest, hardest, beyond = np.zeros(arm.nv), 0.0, 0.0, -np.inf
    changed, roughest, last, flagged = np.zeros(arm.nv), 0.0, DT, 0
    for step in range(steps):
        dq, taken[step], worked[step] = loop.cycle(change, step)
        if given.pause:
            time.sleep(given.pause)
        outcome[loop.tracker.report.status] += 1
        if not np.all(np.isfinite(dq)):
            raise SystemExit(f"step {step}: not finite")
        duration = min(max(loop.duration, 1e-3 * DT), DT)
        jumped = (dq / duration - before / last) * DT
        told = bool(loop.tracker.report.violated_constraints) or scenario == "restarts"
        flagged += told
        fastest = max(fastest, float(np.abs(dq).max()) / duration)
        if not told:
            hardest = max(hardest, float(np.abs(jumped).max()) / DT / max(duration, last))
            roughest = max(roughest, float(np.abs(jumped - changed).max()) / DT**3)
        beyond = max(beyond, float((np.abs(loop.tracker.command) - arm.limits.upper).max()))
        before, changed, last = dq, jumped, duration
        if (step + 1) % every == 0:
            gc.collect()
            counted.append((resident(), len(gc.get_objects())))
            if time.perf_counter() > last_moment:
                break
    done = step + 1
    taken = taken[:done]
    worked = worked[:done]
    overrun = min(given.deadline, OVERRUN)
    tenth = max(done // 10, 1)
    ten = counted[:: -max(len(counted) // 10, 1)][9::-1]
    acceleration = None if given.free or scenario == "limits" else hardest / ACCELERATION
    return {
        "scenario": scenario,
        "steps": done,
        "controller": loop.tracker._steps.controller.name,
        "largest speed, of its limit": fastest / SPEED,
        "largest acceleration that was not reported, of its limit": acceleration,
        "largest jerk, of its limit": roughest / given.jerk if given.jerk else None,
        "steps that reported a violated constraint": flagged,
        "farthest beyond a position limit [rad]": beyond,
        **{f"microseconds p{q:g}": 1e6 * float(np.percentile(taken, q)) for q in (50, 99, 99.9)},
        "microseconds max": 1e6 * float(taken[10:].max()),
        "median of processor time in the first and last tenth [us]": [
            round(1e6 * float(np.median(part))) for part in (worked[:tenth], worked[-tenth:])
        ],
        "mean of processor time in the first and last tenth [us]": [
            round(1e6 * float(np.mean(part))) for part in (worked[:tenth], worked[-tenth:])
        ],
        f"overruns of {1e3 * overrun:g} ms": int(np.sum(taken > overrun)),
        "memory [MB], ten times on the way": [round(memory, 1) for memory, _ in ten],
        "objects, ten times on the way": [objects for _, objects in ten],
        **{f"cycles {status}": count for status, count in sorted(outcome.items())},
    }


def main() -> None:
    """Run the loops and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=100_000)
    parser.add_argument("--seconds", type=float, default=float("inf"), help="end after this time [s]")
    parser.add_argument("--scenario", choices=SCENARIOS, default="faults")
    parser.add_argument("--all", action="store_true", help="all scenarios, one after the other")
    parser.add_argument("--modules", type=int, default=20)
    parser.add_argument("--controller", default="geodesic")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jerk", type=float, help="limit of jerk [rad/s^3]; else there is none")
    parser.add_argument("--free", action="store_true", help="no limit of acceleration")
    parser.add_argument("--deadline", type=float, default=float("inf"), help="of the tracker [s]")
    parser.add_argument("--pause", type=float, default=0.0, help="between cycles, for other threads [s]")
    parser.add_argument(
        "--switch", type=float, default=5e-3, help="interval at which threads of Python take turns [s]"
    )
    parser.add_argument("--json", action="store_true")
    given = parser.parse_args()
    sys.setswitchinterval(given.switch)
    warnings.simplefilter("ignore", PostureWarning)
    for scenario in SCENARIOS if given.all else (given.scenario,):
        found = run(given, scenario)
        text = "\n".join(f"{k:58} {v}" for k, v in found.items()) + "\n"
        print(json.dumps(found, indent=2) if given.json else text, flush=True)


if __name__ == "__main__":
    main()
