"""Coming out with a joint that fails: what `can_retreat` promises, and what a simulation keeps.

    python -m benchmarks.studies.retreat                   # 100 draws of joints that stick in a pipe
    python -m benchmarks.studies.retreat --draws 5 --jobs 2
    python -m benchmarks.studies.retreat --failure limp    # or weak, between balls

Each draw is a pipe with two bends of 30 to 90 degrees, of radii of 0.2 to 0.35 m, in random directions, 3 to
15 mm wider all around than the arm (20 modules on a feed, 1 m, 1 cm thick), which followed its tip into it
by a random depth. There a hinge sticks that is bent by 1 degree or more. Wanted is the way back to the entry.

Ways that are promised are performed in time by drives with a lag of 0.1 s, of which that of the failed joint
does not run. Clearance is judged apart from the library: balls every 2 mm along the links, and the rim at the
tip, against the boxes of the pipe in closed form. For comparison, the arm is driven back along the path by
which it came, as if the joint still worked.

Limp and weak joints fall, and so are drawn where there is room: an arm of 16 hinges (0.8 m, up to 0.8 rad),
mounted at a random roll, has bent between six balls, and the drive of a random hinge gives nothing, or 30 %
of what weight needs at most. MuJoCo simulates the fall for three seconds without friction, with hard end
stops, and then the way.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from functools import partial
from itertools import pairwise
from time import process_time
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

import pinposture as pp
from benchmarks.harness import Case, Row, Study, check_study
from benchmarks.studies.steering import MARGIN, draw, fed_arm
from pinposture.collision.pipe import pipe, pipe_axis
from pinposture.errors import PostureError
from pinposture.motion.drive_response import DriveModel
from pinposture.sim import Servos, build_plant_model
from pinposture.sim.drives import Drives
from pinposture.sim.plant import FAILURES, PLANT, Plant

Array = NDArray[np.float64]

DT = 0.01
LIMITS = pp.Limits(dt=DT, acceleration=5.0)
LAG = DriveModel(lag=0.1, friction=0.0, stiction=0.0, delay=0.0, error=0.0)
RADIUS = 0.01
"""Radius of the arm [m]."""

FREE = (0.003, 0.015)
"""Least and largest free width around the arm [m]."""

BENT = np.radians(1.0)
"""Least bend of the hinge that sticks [rad]."""

SPACING = 0.002
"""Distance of points along the arm [m]."""

CHECKED = 10
"""Cycles between two checks of clearance."""

ARRIVED = 1e-3
"""Distance of the arm from its goal that counts as being there [rad or m]."""


ROOM = 0.01
"""Margin between balls [m]."""

SLOW = pp.Limits(dt=DT, velocity=0.3, acceleration=1.0)
"""Limits of the way out with a joint that hangs."""

FALLING = 300
"""Cycles in which a joint falls."""

STOPS = (0.004, 1.0)
"""Time constant [s] and damping of end stops in MuJoCo: so hard that a joint exceeds them by up to 0.04 rad,
with physics steps in which it gains no energy there."""


SWINGING = 0.1
"""The same for an arm with a joint that may swing there without friction [rad]."""


class Trapped(NamedTuple):
    """An arm in a pipe: the way in, (N, nq), the scene, where a joint fails, and which."""

    arm: pp.Arm
    rows: Array
    scene: pp.Scene
    posture: int
    column: int
    free: float


def trapped(seed: int) -> Trapped:
    """Draw pipes until the arm can follow one and keeps the margin."""
    rng = np.random.default_rng(seed)
    arm = fed_arm()
    while True:
        drawn = draw(rng)
        free = float(rng.uniform(*FREE))
        try:
            reference = pp.follow_leader(arm, pipe_axis(drawn.runs, drawn.bends), 0.2, 0.05)
        except PostureError:
            continue
        path = reference.waypoints[0].target.curve
        assert path is not None
        walls = pipe(path, radius=RADIUS + free, self_collision=False)
        scene = pp.Scene(walls.obstacles, margin=MARGIN, self_collision=False)
        rows = np.array([reference.configuration(row) for row in range(reference.rows)])
        model = pp.CollisionModel(arm, scene)
        if min(model.minimum(q).distance for q in rows) < MARGIN:
            continue
        posture = int(rng.integers(len(rows) // 5, len(rows)))
        bent = arm.columns[1:][np.abs(arm.positions(rows[posture])[arm.columns[1:]]) > BENT]
        if len(bent):
            return Trapped(arm, rows, scene, posture, int(rng.choice(bent)), free)


def clearance(arm: pp.Arm, rows: Array, scene: pp.Scene) -> float:
    """Return the least distance of the arm in configurations (n, nq) from boxes [m]."""
    boxes = list(scene.obstacles.values())
    centers = np.array([box.center for box in boxes])
    turns = np.array([box.rotation for box in boxes])
    halves = 0.5 * np.array([box.size for box in boxes])
    least = np.inf
    angles = np.linspace(0.0, 2.0 * np.pi, 48, endpoint=False)
    for q in rows:
        links = arm.at(q).links.copy()
        tip = links[-1].copy()
        ahead = (tip - links[-2]) / np.linalg.norm(tip - links[-2])
        links[-1] -= RADIUS * ahead  # the last link is a tube that ends flat at the tip: its rim is added
        across = np.linalg.svd(ahead[None])[2][1:]
        rim = tip + RADIUS * np.column_stack([np.cos(angles), np.sin(angles)]) @ across
        points = [rim]
        for begin, end in pairwise(links):
            count = 1 + max(1, int(np.linalg.norm(end - begin) / SPACING))
            points.append(np.linspace(begin, end, count))
        radii = np.repeat([0.0, RADIUS], [len(rim), sum(map(len, points[1:]))])
        local = np.einsum("pbj,bjk->pbk", np.concatenate(points)[:, None] - centers, turns)
        outside = np.maximum(np.abs(local) - halves, 0.0)
        least = min(least, float((np.linalg.norm(outside, axis=-1).min(axis=1) - radii).min()))
    return least


def among_balls(seed: int) -> Trapped:
    """Draw balls until the arm can bend between them and keeps the margin."""
    rng = np.random.default_rng(seed)
    hinges = tuple(pp.JointSpec(axis, lower=-0.8, upper=0.8) for axis in "yz")
    arm = pp.Arm.from_modules([pp.ModuleTemplate("m", hinges, (0.05, 0.05))] * 8)
    roll = rng.uniform(0.0, 2.0 * np.pi)
    arm = arm.with_gravity((0.0, 9.81 * np.sin(roll), 9.81 * np.cos(roll)))
    while True:
        middles = rng.uniform((0.1, -0.5, -0.5), (0.8, 0.5, 0.5), (6, 3))
        balls = {f"ball {k}": pp.Sphere(middle, rng.uniform(0.05, 0.12)) for k, middle in enumerate(middles)}
        scene = pp.Scene(balls, margin=ROOM, arm_radius=RADIUS, self_collision=False)
        rows = np.linspace(0.0, 1.0, 40)[:, None] * rng.uniform(-0.4, 0.4, arm.nv)
        model = pp.CollisionModel(arm, scene)
        if min(model.minimum(q).distance for q in rows) > ROOM:
            return Trapped(arm, rows, scene, len(rows) - 1, int(rng.integers(arm.nv)), ROOM)


def clearance_between_balls(arm: pp.Arm, rows: Array, scene: pp.Scene) -> float:
    """Return the least distance of the arm in configurations (n, nq) from balls [m]."""
    least = np.inf
    for q in rows:
        links = arm.at(q).links
        steps = np.diff(links, axis=0)
        for ball in scene.obstacles.values():
            to = ball.center - links[:-1]
            shares = np.einsum("ij,ij->i", to, steps) / np.maximum(np.einsum("ij,ij->i", steps, steps), 1e-12)
            apart = to - np.clip(shares, 0.0, 1.0)[:, None] * steps
            least = min(least, float(np.linalg.norm(apart, axis=1).min()) - ball.radius - RADIUS)
    return least


def let_fall(drawn: Trapped, failure: str, commands: Array) -> Array:
    """Return where servos take an arm of which one joint fails and falls at first, (n, nq)."""
    arm = drawn.arm
    built = build_plant_model(arm, Servos(20.0, timestep=2e-4))
    built.model.jnt_solref[:] = STOPS
    plant = Plant(built, drawn.rows[drawn.posture], DT)
    plant.fail(**{failure: [arm.joint_names[drawn.column]]})
    rows = []
    held = np.repeat(drawn.rows[drawn.posture][None], FALLING, axis=0)
    for command in np.concatenate([held, commands]):
        plant.advance(command)
        rows.append(plant.positions)
    return np.array(rows)


def measure_fall(drawn: Trapped, failure: str) -> Mapping[str, Any]:
    """Ask for a way out with a joint that falls, perform it, and drive back along the path for comparison."""
    arm = drawn.arm
    torque = PLANT.weak * float(arm.outstretched_torques[drawn.column]) if failure == "weak" else 0.0
    name = arm.joint_names[drawn.column]
    begun = process_time()
    (way,) = pp.can_retreat(
        arm, drawn.rows, drawn.scene, name, torque=torque, postures=[drawn.posture], limits=SLOW
    ).ways
    taken = process_time() - begun
    back = let_fall(drawn, failure, np.repeat(drawn.rows[::-1], 10, axis=0))
    columns = {
        "joint": name,
        "position": way.position,
        "free": drawn.free,
        "depth": 1.0,
        "time": taken,
        "promised": way.path is not None,
        "said": way.path.found_by if way.path is not None else way.reason,
        "driven back": clearance_between_balls(arm, back[::CHECKED], drawn.scene),
        "kept": None,
        "left": None,
    }
    if way.path is None:
        return columns
    commands = pp.retime(way.path, SLOW).configurations
    still = np.repeat(commands[-1:], FALLING, axis=0)
    rows = let_fall(drawn, failure, np.concatenate([commands, still]))
    kept = clearance_between_balls(arm, rows[::CHECKED], drawn.scene)
    return {**columns, "kept": kept, "left": float(np.abs(rows[-1] - commands[-1]).max())}


def perform(arm: pp.Arm, q: Array, commands: Array, column: int) -> Array:
    """Return where drives take an arm, (n, nq): commanded joint positions (n, nv), one of which fails."""
    drives = Drives(LAG, arm.positions(q), DT)
    drives.running[column] = False
    still = np.repeat(commands[-1:], 200, axis=0)
    return np.array([arm.configuration(drives.advance(row)) for row in np.concatenate([commands, still])])


def measure(drawn: Trapped, _: None) -> Mapping[str, Any]:
    """Ask for a way out, perform it, and drive back along the path for comparison."""
    arm = drawn.arm
    q = drawn.rows[drawn.posture]
    begun = process_time()
    (way,) = pp.can_retreat(
        arm, drawn.rows, drawn.scene, arm.joint_names[drawn.column], postures=[drawn.posture]
    ).ways
    taken = process_time() - begun
    back = arm.difference(arm.origin, drawn.rows[drawn.posture :: -1])
    driven = perform(arm, q, np.repeat(back, 20, axis=0), drawn.column)
    columns = {
        "joint": way.joint,
        "position": way.position,
        "free": drawn.free,
        "depth": drawn.posture / (len(drawn.rows) - 1),
        "time": taken,
        "promised": way.path is not None,
        "said": way.path.found_by if way.path is not None else way.reason,
        "driven back": clearance(arm, driven[::CHECKED], drawn.scene),
    }
    if way.path is None:
        return {**columns, "kept": None, "left": None}
    timed = pp.retime(way.path, LIMITS)
    commands = way.path.positions + way.path.smooth_offset(timed.s)
    rows = perform(arm, q, commands, drawn.column)
    left = float(np.abs(arm.difference(rows[-1], way.path.configuration(way.path.end))).max())
    return {**columns, "kept": clearance(arm, rows[::CHECKED], drawn.scene), "left": left}


def study_retreat(draws: int, first_seed: int = 0, failure: str = "stuck") -> Study:
    """Return the study of draws, from a first seed on, with one of `FAILURES`.

    Raises:
        InvalidValue: not a number of draws, or a seed below 0.
    """
    check_study(first_seed, draws=draws)
    drawn = trapped if failure == "stuck" else among_balls
    cases = [Case({"seed": seed}, partial(drawn, seed)) for seed in range(first_seed, first_seed + draws)]
    return Study(cases, (failure,), measure if failure == "stuck" else measure_fall)


COLUMNS = (
    *("draw", "joint", "at [deg]", "free [mm]", "depth [%]"),
    *("driven back [mm]", "kept [mm]", "time [s]", "way"),
)


def show(row: Row) -> str:
    """Return a row of the table."""
    kept = "-" if row.kept is None else f"{1e3 * row.kept:.1f}"
    where = f"{row.joint} | {np.degrees(row.position):.1f} | {1e3 * row.free:.0f} | {100 * row.depth:.0f}"
    return f"| {row.seed} | {where} | {1e3 * row['driven back']:.1f} | {kept} | {row.time:.1f} | {row.said} |"


def main() -> None:
    """Print a row for each draw, and what became of all."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--failure", choices=FAILURES, default="stuck")
    given = parser.parse_args()
    print(
        "| draw | joint | at [deg] | free [mm] | depth [%] | driven back [mm] | kept [mm] | time [s] | way |"
    )
    print("|---|---|---|---|---|---|---|---|---|")
    rows = study_retreat(given.draws, given.seed, given.failure).rows(given.jobs)
    for row in rows:
        print(show(row))
    promised = [row for row in rows if row.promised]
    arrived = ARRIVED if given.failure == "stuck" else SWINGING
    kept = [row for row in promised if row.kept > 0.0 and row.left < arrived]
    least = min((row.kept for row in promised), default=np.inf)
    naive = sum(row["driven back"] > 0.0 for row in rows)
    times = [row.time for row in rows]
    print(f"\nways promised: {len(promised)} of {len(rows)}, kept: {len(kept)}")
    margin = MARGIN if given.failure == "stuck" else ROOM
    left = ", ".join(f"{row.left:.3f}" for row in promised if row.left >= arrived)
    print(f"not where they should be in the end: {left or 'none'} [rad or m]")
    print(f"least clearance on them: {1e3 * least:.2f} mm, margin {1e3 * margin:g} mm")
    print(f"clear when driven back as if nothing had failed: {naive}")
    print(f"time: median {np.median(times):.2g} s, most {max(times):.3g} s")


if __name__ == "__main__":
    main()
