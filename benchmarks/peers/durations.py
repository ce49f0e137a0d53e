"""How long runs and motions take, relative to the shortest time in which their paths can be followed.

    python -m benchmarks.peers.durations                    # 16 to 200 joints, 20 draws each
    python -m benchmarks.peers.durations --joints 40 --draws 5 --json
    python -m benchmarks.peers.durations --cost             # how long `retime` takes with limits of torque

Arms of RyRz modules, 1 m long. Runs go from one smooth random posture to another; motions through five of
them, at times at which limits bind throughout. Limits of all joints are 1 rad/s, and 2, 5 or 20 rad/s^2; or
5 rad/s^2 alone. The cycle is 10 ms. The shortest time is that of TOPP-RA (the `toppra` package, in an
environment of its own, made when first needed) for the same path, from rest to rest. What the output takes of
the limits is measured from the joint positions of the run.

Paths between postures are also timed within limits of torque, 1.2 or 2 times what gravity takes on the path,
and of speed, 3 or 10 rad/s, in cycles of 1 ms; TOPP-RA has the same inverse dynamics (Pinocchio), and no
reserve of 2 %. It keeps limits of torque only at samples of the path, which have to be dense: with 4 for each
waypoint motions of 100 joints were 1 to 3 % too short. Pinocchio also computes the torques of our steps.

Single joints also have limits of jerk; their shortest time is that of Ruckig (package `ruckig`, as above).
Ratios below 1 come from cycles: limits hold for differences between them, not for all times.

The cost of limits of torque is that of `retime` on the same paths, in relation to limits of 2 rad/s and of
2, 5 or 20 rad/s^2 alone: with both, and with those of torque in place of acceleration. Each is timed in turn,
and the shortest of the times counts.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from rich.console import Console
from rich.progress import track as with_progress
from scipy.interpolate import CubicSpline

import pinposture as pp
from benchmarks.peers import environments
from pinposture.arm import smooth_configuration
from pinposture.kernels import load
from pinposture.task.perform import ReferencePath
from pinposture.task.reference import Reference

CYCLE = 0.01
LIMITS = ((1.0, 2.0), (1.0, 5.0), (1.0, 20.0), (1000.0, 5.0))
"""Limits of speed [rad/s] and acceleration [rad/s^2]."""

EFFORTS = ((3.0, 1.2), (3.0, 2.0), (10.0, 1.2), (10.0, 2.0))
"""Limits of speed [rad/s], and of torque in relation to the largest one that gravity takes on a path."""

JERKS, DISTANCES = (20.0, 50.0, 200.0), (0.003, 0.02, 0.1, 0.3, 1.0, 2.5)
"""Limits of jerk [rad/s^3], and distances that single joints move [rad]."""

SHORT_CYCLE, DENSE = 0.001, 16
"""Cycle of paths with limits of torque [s], and samples of each waypoint for TOPP-RA."""

COST_SPEED, COST_ACCELERATIONS, COST_TURNS = 2.0, (2.0, 5.0, 20.0), 30
"""Limits of paths on which the cost of `retime` is measured [rad/s, rad/s^2], and times of each."""

LONGEST_WITH_TORQUES = 100
"""Most joints of an arm whose torques are limited."""

BEND, POSTURES, ROWS, SAMPLES = 32.0, 5, 401, 4
"""Joint motion of postures, times the number of joints [rad]; postures and waypoints of a motion; and samples
of each waypoint for TOPP-RA."""


class Run(NamedTuple):
    """A run or a motion.

    Attributes:
        path: its path, sampled at equal distances, (s, n) [rad].
        q: its joint positions in each cycle, (k, n) [rad].
        arrived: whether it came to its end.
    """

    path: np.ndarray
    q: np.ndarray
    arrived: bool


def sample(path: pp.JointPath, samples: int = SAMPLES) -> np.ndarray:
    """Return joint positions along the curve that is followed, (s, n)."""
    places = np.linspace(0.0, path.end, samples * int(path.end) + 1)
    return path.start + np.array([path.smooth_offset(place) for place in places])


def run_between(arm: pp.Arm, rng: np.random.Generator, limits: pp.Limits) -> Run:
    """Go from one posture to another."""
    start, goal = (smooth_configuration(arm, rng, BEND / arm.nv) for _ in range(2))
    target = pp.Target.from_configuration(arm, goal)
    timed = pp.retime(pp.plan(arm.at(start), target, limits=limits), limits)
    run = pp.track(arm, target, start, limits=limits, max_steps=20_000)
    return Run(sample(timed.path), run.q, run.status == "converged")


def perform_postures(arm: pp.Arm, rng: np.random.Generator, limits: pp.Limits) -> Run:
    """Go through several postures, much faster than limits allow."""
    postures = np.array([smooth_configuration(arm, rng, BEND / arm.nv) for _ in range(POSTURES)])
    spline = CubicSpline(np.linspace(0.0, 1.0, POSTURES), postures, bc_type="clamped")
    q = spline(np.linspace(0.0, 1.0, ROWS))
    reference = Reference(arm, CYCLE / 10.0, q[0], q - q[0], np.ones((ROWS, arm.n_modules)))
    motion = pp.perform(reference, limits=limits)
    path = ReferencePath(reference, limits).timed.path
    return Run(sample(path), motion.run.q, motion.run.status == "converged")


def shortest_durations(
    paths: list[np.ndarray], limits: list[np.ndarray], urdf: str | None = None
) -> list[float]:
    """Return the shortest durations by TOPP-RA [s].

    Args:
        paths: joint positions at equal distances, (s, n) each [rad].
        limits: limits of speed, and of acceleration or of torque, (2, n) each.
        urdf: the arm, for limits of torque.
    """
    where = environments.prepare({"toppra"})["toppra"]
    if where.python is None:
        raise SystemExit(f"toppra cannot be installed: {where.reason}")
    with tempfile.TemporaryDirectory() as folder:
        source, output = Path(folder, "paths.npz"), Path(folder, "durations.json")
        arrays = {f"path_{k}": path for k, path in enumerate(paths)}
        arrays |= {f"limits_{k}": each for k, each in enumerate(limits)}
        if urdf is not None:
            arrays |= {f"urdf_{k}": np.array(urdf) for k in range(len(paths))}
        np.savez(source, **arrays)
        script = ["-m", "benchmarks.peers.toppra_durations", str(source), str(output)]
        subprocess.run([where.python, *script], cwd=environments.ROOT, check=True)
        return [float(each) for each in json.loads(output.read_text())]


def measure_jerk(jerk: float) -> list[dict[str, Any]]:
    """Return the figures of motions of a single joint."""
    arm, (speed, acceleration) = pp.Arm.from_template("RyRz", 1), LIMITS[1]
    limits = pp.Limits(step=None, velocity=speed, acceleration=acceleration, jerk=jerk, dt=CYCLE)
    rows, motions = [], [(distance, speed, acceleration, jerk) for distance in DISTANCES]
    for motion, best in zip(motions, shortest_motions(motions), strict=True):
        target = pp.Target.from_configuration(arm, [motion[0], 0.0])
        run = pp.track(arm, target, [0.0, 0.0], limits=limits, max_steps=20_000)
        jerks = np.diff(np.pad(run.q, ((3, 3), (0, 0)), mode="edge"), 3, axis=0) / CYCLE**3
        duration, used = CYCLE * run.steps, float(np.abs(jerks).max() / jerk)
        row = {"kind": "joint", "distance": motion[0], "jerk": jerk, "arrived": run.converged}
        rows.append({**row, "duration": duration, "ratio": duration / best, "jerk_used": used})
    return rows


def shortest_motions(motions: list[tuple[float, ...]]) -> list[float]:
    """Return the shortest durations of motions of one joint, by Ruckig [s]."""
    where = environments.prepare({"ruckig"})["ruckig"]
    if where.python is None:
        raise SystemExit(f"ruckig cannot be installed: {where.reason}")
    with tempfile.TemporaryDirectory() as folder:
        source, output = Path(folder, "motions.json"), Path(folder, "durations.json")
        source.write_text(json.dumps(motions))
        script = ["-m", "benchmarks.peers.ruckig_durations", str(source), str(output)]
        subprocess.run([where.python, *script], cwd=environments.ROOT, check=True)
        return [float(each) for each in json.loads(output.read_text())]


def measure(kind: str, joints: int, speed: float, acceleration: float, draws: int) -> dict[str, Any]:
    """Return the figures of one kind of runs with one number of joints."""
    arm = pp.Arm.from_template("RyRz", joints // 2, (1.0 / joints, 1.0 / joints))
    limits = pp.Limits(step=None, velocity=speed, acceleration=acceleration, dt=CYCLE)
    make = run_between if kind == "run" else perform_postures
    runs = [make(arm, np.random.default_rng(draw), limits) for draw in range(draws)]
    limited = np.tile([[speed], [acceleration]], arm.nv)
    least = shortest_durations([run.path for run in runs], [limited] * draws)
    ratios = [CYCLE * (len(run.q) - 1) / best for run, best in zip(runs, least, strict=True)]
    rest, used = np.zeros((1, arm.nv)), [0.0, 0.0]
    for run in runs:
        speeds = np.diff(run.q, axis=0) / CYCLE
        changes = np.diff(np.concatenate([rest, speeds, rest]), axis=0) / CYCLE
        used = [max(used[0], np.abs(speeds).max()), max(used[1], np.abs(changes).max())]
    return {
        "kind": kind,
        "joints": joints,
        "speed": speed,
        "acceleration": acceleration,
        "arrived": sum(run.arrived for run in runs),
        "of": draws,
        "ratio": float(np.median(ratios)),
        "largest_ratio": max(ratios),
        "speed_used": float(used[0] / speed),
        "acceleration_used": float(used[1] / acceleration),
    }


def measure_torques(joints: int, speed: float, effort: float, draws: int) -> dict[str, Any]:
    """Return the figures of paths that are timed within limits of torque."""
    arm = pp.Arm.from_template("RyRz", joints // 2, (1.0 / joints, 1.0 / joints))
    limits = pp.Limits(step=None, velocity=speed, dt=SHORT_CYCLE)
    data = arm.model.createData()
    timed: list[pp.TimedPath] = []
    bounds = []
    used = 0.0
    for draw in range(draws):
        rng = np.random.default_rng(draw)
        start, goal = (smooth_configuration(arm, rng, BEND / arm.nv) for _ in range(2))
        path = pp.plan(arm.at(start), pp.Target.from_configuration(arm, goal), limits=limits)
        held = [arm.at(q).gravity_torques for q in arm.integrate(path.start, sample(path) - path.start)]
        strong = arm.with_effort(effort * float(np.abs(held).max()))
        path = pp.plan(strong.at(start), pp.Target.from_configuration(strong, goal), limits=limits)
        timed.append(pp.retime(path, limits, effort=True))
        bounds.append(np.array([np.full(arm.nv, speed), strong.effort]))
        rest = np.pad(timed[-1].path.smooth_offset(timed[-1].s), ((1, 1), (0, 0)), mode="edge")
        steps = np.diff(rest, axis=0) / SHORT_CYCLE
        q = arm.integrate(path.start, rest[1:-1])
        rates = (steps[1:] + steps[:-1]) / 2.0
        changes = np.diff(steps, axis=0) / SHORT_CYCLE
        for motion in zip(q, rates, changes, strict=True):
            used = max(used, float(np.abs(pin.rnea(arm.model, data, *motion) / strong.effort).max()))
    least = shortest_durations([sample(each.path, DENSE) for each in timed], bounds, arm.urdf)
    ratios = [each.duration / best for each, best in zip(timed, least, strict=True)]
    return {
        "kind": "torque",
        "joints": joints,
        "speed": speed,
        "effort": effort,
        "of": draws,
        "ratio": float(np.median(ratios)),
        "largest_ratio": max(ratios),
        "effort_used": used,
    }


def measure_cost(joints: int, draws: int) -> dict[str, Any]:
    """Return how long `retime` takes with limits of torque, in relation to limits of acceleration alone."""
    arm = pp.Arm.from_template("RyRz", joints // 2, (1.0 / joints, 1.0 / joints))
    speed = pp.Limits(step=None, velocity=COST_SPEED, dt=CYCLE)
    shortest = []
    for draw in range(draws):
        rng = np.random.default_rng(draw)
        start, goal = (smooth_configuration(arm, rng, BEND / arm.nv) for _ in range(2))
        path = pp.plan(arm.at(start), pp.Target.from_configuration(arm, goal), limits=speed)
        for acceleration in COST_ACCELERATIONS:
            for _, share in EFFORTS[:2]:
                effort = share * float(path.largest_held.max())
                alone = replace(speed, acceleration=acceleration)
                cases = alone, replace(alone, effort=effort), replace(speed, effort=effort)
                times = np.array([[_time_retime(path, each) for each in cases] for _ in range(COST_TURNS)])
                shortest.append(times.min(axis=0))
    found = np.array(shortest)
    return {
        "kind": "cost",
        "joints": joints,
        "of": len(found),
        "milliseconds": float(np.median(1e3 * found[:, 0])),
        "ratio": float(np.median(found[:, 1] / found[:, 0])),
        "torque_ratio": float(np.median(found[:, 2] / found[:, 0])),
    }


def _time_retime(path: pp.JointPath, limits: pp.Limits) -> float:
    """Return how long `retime` takes [s]."""
    begun = time.perf_counter()
    pp.retime(path, limits)
    return time.perf_counter() - begun


def main() -> None:
    """Measure, and print a line for each kind, number of joints and limits."""
    kind = argparse.RawDescriptionHelpFormatter
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=kind)
    parser.add_argument("--joints", type=int, nargs="+", default=[16, 40, 100, 200], help="even numbers")
    parser.add_argument("--draws", type=int, default=20, help="runs for each")
    parser.add_argument("--cost", action="store_true", help="only how long `retime` takes")
    parser.add_argument("--json", action="store_true", help="print JSON")
    given = parser.parse_args()
    if given.cost:
        for joints in (each for each in given.joints if each <= LONGEST_WITH_TORQUES):
            row = measure_cost(joints, given.draws)
            words = (
                "retime {joints:4d} joints: {milliseconds:.2f} ms with limits of acceleration; {ratio:.2f} "
                "times as long with those of torque as well, {torque_ratio:.2f} times with those instead"
            )
            print(json.dumps(row) if given.json else words.format(**row), flush=True)
        return
    load()
    cases = [(each, n, *limits) for each in ("run", "motion") for n in given.joints for limits in LIMITS]
    console, rows = Console(stderr=True), []
    for case in with_progress(cases, "durations", console=console, transient=True):
        row = measure(*case, given.draws)
        rows.append(row)
        if not given.json:
            print(
                "{kind:6s} {joints:4d} joints, {speed:6g} rad/s, {acceleration:4g} rad/s^2: {ratio:.3f} "
                "times the shortest (largest {largest_ratio:.3f}); arrived {arrived} of {of}; at most "
                "{speed_used:.1%} of the speed, {acceleration_used:.1%} of the acceleration".format(**row),
                flush=True,
            )
    for joints in (each for each in given.joints if each <= LONGEST_WITH_TORQUES):
        for speed, effort in EFFORTS:
            row = measure_torques(joints, speed, effort, given.draws)
            rows.append(row)
            if not given.json:
                words = (
                    "torque {joints:4d} joints, {speed:g} rad/s, {effort:g} x gravity: {ratio:.3f} times the "
                    "shortest (largest {largest_ratio:.3f}); at most {effort_used:.1%} of the torque"
                )
                print(words.format(**row), flush=True)
    for row in (row for jerk in JERKS for row in measure_jerk(jerk)):
        rows.append(row)
        if not given.json:
            print(
                "one joint by {distance:4g} rad, {jerk:4g} rad/s^3: {duration:.2f} s, {ratio:.3f} times the "
                "shortest; at most {jerk_used:.1%} of the jerk".format(**row),
                flush=True,
            )
    if given.json:
        json.dump(rows, sys.stdout, indent=1)


if __name__ == "__main__":
    main()
