"""How well sensors tell the shape of an arm that sags behind its encoders.

    python -m benchmarks.studies.shape                  # 20 draws, some three minutes
    python -m benchmarks.studies.shape --draws 3

Each draw is an arm of 10 modules (20 joints, 1 m, 0.4 kg) that moves between two random postures within 4 s
on soft servos (MuJoCo, slowest mode at 2 Hz), with an unknown payload of 20 to 100 g at its tip. Encoders are
on the motors: they tell the set points, with noise. What other sensors measure is computed by Pinocchio from
the simulated arm, in each cycle of 20 ms:

* tilts: accelerometers on every second module, 10 mrad; orientations: the same with a compass, 20 mrad;
* points: a camera that sees every second module, 2 mm; 30 % are hidden, and 5 % are off by 0.2 m;
* tip: its placement, 1 mm and 10 mrad; fibre: bends of all modules, 0.05/m.

Told are the distance of the tip from where the estimator has it, and that of the farthest control point, over
all cycles after the first second; and whether the estimator knows how far off it is: the squared error of the
configuration in terms of its covariance, per joint, which should be near 1.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import pinposture as pp
from pinposture.sim import Servos, Simulation, simulate

Array = NDArray[np.float64]

DT = 0.02
SECONDS = 4.0
SERVOS = Servos(frequency=2.0)
ENCODER = 1e-3
TILT = 0.01
TURN = 0.02
POINT = 0.002
HIDDEN = 0.3
OUTLIERS = 0.05
OFF = 0.2
TIP = (0.001, 0.01)
FIBRE = 0.05
BEGINS = 50
"""The first row that counts."""

GIVE = 0.03
"""Standard deviation of joints from their encoders that the payload causes [rad]; 0.02 to 0.06 here."""


class Truth(NamedTuple):
    """A simulated motion, and the placements of the control points in each row."""

    simulation: Simulation
    points: Array
    rotations: Array


def bare_arm() -> pp.Arm:
    """Return the arm without a payload."""
    return pp.Arm.from_template("RyRz", modules=10, link_lengths=(0.05, 0.05))


def draw(seed: int) -> Truth:
    """Simulate a motion with a random payload."""
    rng = np.random.default_rng(seed)
    arm = bare_arm().with_payload(float(rng.uniform(0.02, 0.1)))
    start, goal = (pp.arm.smooth_configuration(arm, rng, 0.5) for _ in range(2))
    shares = np.linspace(0.0, 1.0, int(SECONDS / DT))[:, None]
    way = start + (3.0 * shares**2 - 2.0 * shares**3) * (goal - start)
    # Gravity acts from the first row on: the arm swings in the first second.
    moved = simulate(arm, np.concatenate([np.repeat(way[:1], BEGINS, axis=0), way]), SERVOS, dt=DT)
    data = arm.model.createData()
    frames = [arm.model.getFrameId(name) for name in arm.control_points]
    points = np.empty((len(moved.q), arm.n_modules, 3))
    rotations = np.empty((len(moved.q), arm.n_modules, 3, 3))
    for row, q in enumerate(moved.q):
        pin.framesForwardKinematics(arm.model, data, q)
        for k, frame in enumerate(frames):
            points[row, k] = data.oMf[frame].translation
            rotations[row, k] = data.oMf[frame].rotation
    return Truth(moved, points, rotations)


class Reader:
    """Gives noisy readings of a motion to an estimator."""

    def __init__(self, truth: Truth, estimator: pp.ShapeEstimator, seed: int) -> None:
        self.truth = truth
        self.estimator = estimator
        self.rng = np.random.default_rng(seed)
        self.some = list(range(1, truth.points.shape[1], 2))

    def encoders(self, row: int) -> None:
        """Read the encoders of all motors."""
        read = self.truth.simulation.commanded[row] + ENCODER * self.rng.standard_normal(
            self.estimator.arm.nv
        )
        self.estimator.add_encoders(read, ENCODER, side="motor")

    def half_of_the_encoders(self, row: int) -> None:
        """Read the encoders of every second motor."""
        read = self.truth.simulation.commanded[row] + ENCODER * self.rng.standard_normal(
            self.estimator.arm.nv
        )
        read[1::2] = np.nan
        self.estimator.add_encoders(read, ENCODER, side="motor")

    def tilts(self, row: int) -> None:
        """Read accelerometers."""
        turns = self._turned(row, TILT)
        self.estimator.add_tilts(turns[:, 2], TILT, at=self.some)

    def orientations(self, row: int) -> None:
        """Read inertial sensors."""
        self.estimator.add_orientations(self._turned(row, TURN), TURN, at=self.some)

    def points(self, row: int) -> None:
        """Read a camera."""
        seen = self.truth.points[row, self.some] + POINT * self.rng.standard_normal((len(self.some), 3))
        wrong = self.rng.random(len(seen)) < OUTLIERS
        seen[wrong] += OFF * self.rng.standard_normal((int(wrong.sum()), 3))
        seen[self.rng.random(len(seen)) < HIDDEN] = np.nan
        self.estimator.add_points(seen, POINT, at=self.some)

    def points_at_first(self, row: int) -> None:
        """Read a camera for a second."""
        if row < BEGINS:
            self.points(row)

    def tip(self, row: int) -> None:
        """Read a tracking system."""
        turn = pin.exp3(TIP[1] * self.rng.standard_normal(3))
        place = self.truth.points[row, -1] + TIP[0] * self.rng.standard_normal(3)
        self.estimator.add_placement(pin.SE3(self.truth.rotations[row, -1] @ turn, place), *TIP)

    def fibre(self, row: int) -> None:
        """Read a fibre."""
        turns = self.truth.rotations[row]
        before = np.concatenate([np.eye(3)[None], turns[:-1]])
        lengths = self.estimator.arm.chain.module_lengths
        bends = np.array([pin.log3(start.T @ end) for start, end in zip(before, turns, strict=True)])
        read = bends / lengths[:, None] + FIBRE * self.rng.standard_normal(bends.shape)
        read[:, 0] = np.nan
        self.estimator.add_curvatures(read, FIBRE)

    def _turned(self, row: int, noise: float) -> Array:
        turns = self.truth.rotations[row, self.some]
        return np.array([turn @ pin.exp3(noise * self.rng.standard_normal(3)) for turn in turns])


Read = Callable[[Reader, int], None]

MIXES: dict[str, tuple[Read, ...]] = {
    "encoders": (Reader.encoders,),
    "encoders, tilts": (Reader.encoders, Reader.tilts),
    "encoders, orientations": (Reader.encoders, Reader.orientations),
    "encoders, points": (Reader.encoders, Reader.points),
    "encoders, points in the first second": (Reader.encoders, Reader.points_at_first),
    "encoders, tip": (Reader.encoders, Reader.tip),
    "encoders, fibre": (Reader.encoders, Reader.fibre),
    "half of the encoders, tilts, points": (Reader.half_of_the_encoders, Reader.tilts, Reader.points),
    "fibre": (Reader.fibre,),
    "all": (Reader.encoders, Reader.tilts, Reader.points, Reader.tip, Reader.fibre),
}


class Errors(NamedTuple):
    """Errors in the rows that count: of the tip and the farthest point [m]; relative to what is known."""

    tip: Array
    farthest: Array
    relative: Array


def estimate(truth: Truth, mix: tuple[Read, ...], weighed: bool, seed: int) -> Errors:
    """Estimate the shape in each row.

    Args:
        truth: the motion.
        mix: what is read.
        weighed: whether the estimator knows masses and stiffness, but not the payload.
        seed: seed of the noise.
    """
    arm = bare_arm()
    if weighed:
        arm = arm.with_stiffness(SERVOS.stiffness(arm))
    commanded = truth.simulation.commanded
    estimator = pp.ShapeEstimator(arm, commanded[0], give=GIVE if weighed else 2.0 * GIVE)
    reader = Reader(truth, estimator, seed)
    rows = []
    for row in range(1, len(commanded)):
        estimator.predict(DT, arm.difference(commanded[row - 1], commanded[row]))
        for read in mix:
            read(reader, row)
        if row < BEGINS:
            continue
        apart = np.linalg.norm(arm.at(estimator.q).points - truth.points[row], axis=1)
        missed = arm.difference(estimator.q, truth.simulation.q[row])
        relative = missed @ np.linalg.solve(estimator.covariance, missed) / arm.nv
        rows.append((apart[-1], apart.max(), relative))
    return Errors(*np.array(rows).T)


def uncorrected(truth: Truth) -> Errors:
    """Return the errors of the set points."""
    arm = bare_arm()
    points = np.array([arm.at(q).points for q in truth.simulation.commanded[BEGINS:]])
    apart = np.linalg.norm(points - truth.points[BEGINS:], axis=2)
    return Errors(apart[:, -1], apart.max(axis=1), np.full(len(apart), np.nan))


def print_errors(name: str, found: list[Errors]) -> None:
    """Print a row of the table."""
    tip, farthest, relative = (np.concatenate(each) for each in zip(*found, strict=True))
    tips = f"{1e3 * np.median(tip):.1f} | {1e3 * np.quantile(tip, 0.95):.1f}"
    all_points = f"{1e3 * np.median(farthest):.1f} | {1e3 * np.quantile(farthest, 0.95):.1f}"
    print(f"| {name} | {tips} | {all_points} | {np.mean(relative):.2f} |", flush=True)


def main() -> None:
    """Print a row for each mix of sensors, without and with the weight."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=20)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    seeds = range(given.seed, given.seed + given.draws)
    truths = [draw(seed) for seed in seeds]
    print(
        "| sensors | tip [mm], median | 95 % | farthest point [mm], median | 95 % | relative to covariance |"
    )
    print("|---" * 6 + "|")
    print_errors("set points, without an estimator", [uncorrected(truth) for truth in truths])
    for weighed in (False, True):
        for name, mix in MIXES.items():
            found = [estimate(truth, mix, weighed, seed) for truth, seed in zip(truths, seeds, strict=True)]
            print_errors(f"{name}; weight known" if weighed else name, found)


if __name__ == "__main__":
    main()
