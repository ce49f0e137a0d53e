"""How often the intervals of `pinposture.identify` cover the truth, on simulated logs.

    python -m benchmarks.studies.identification                # 100 draws, some minutes
    python -m benchmarks.studies.identification --draws 20 --seconds 60

Each draw is an arm of four modules on a wall, floor or ceiling, with drives of random lag, delay, friction
and stiffness (`pinposture.sim.Drives`, in steps of 1 ms), in half of the draws with a payload, which the log
tells in half of them. Its joints take sums of three sines, sent 50 times a second and held. Measured are
positions, 100 times a second on an irregular clock, with noise of 0.3 mrad; a tenth of the rows repeats the
one before. A slow disturbance of 10 mrad (standard deviation; correlated over 2 s) moves each joint on its
own. Neither is in the model that is fitted.
"""

from __future__ import annotations

import argparse
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pinposture as pp
from pinposture.motion.identification import DriveEstimate, Estimate
from pinposture.motion.log import Log
from pinposture.sim import DriveModel, Drives

Array = NDArray[np.float64]

STEP = 1e-3
GRAVITY = {"floor": (0.0, 0.0, -9.81), "wall": (0.0, -9.81, 0.0), "ceiling": (0.0, 0.0, 9.81)}


class Draw(NamedTuple):
    """A robot and its log."""

    log: Log
    model: DriveModel
    stiffness: float
    payload: float


class Conditions(NamedTuple):
    """What the log of a draw is like: length [s], noise and disturbance [rad], frequency of commands [Hz]."""

    seconds: float = 30.0
    noise: float = 3e-4
    disturbance: float = 1e-2
    frequency: float = 0.3


def draw(arm: pp.Arm, rng: np.random.Generator, conditions: Conditions) -> Draw:
    """Return the log of a random robot with this arm."""
    lag = float(np.exp(rng.uniform(np.log(0.05), np.log(0.5))))
    model = DriveModel(lag=lag, delay=STEP * int(rng.integers(0, 60)), friction=rng.uniform(0.0, 0.15))
    gravity = np.array(list(GRAVITY.values())[rng.integers(3)])
    payload = float(rng.uniform(0.05, 0.3)) if rng.random() < 0.5 else 0.0
    loaded = arm.with_gravity(gravity)
    loaded = loaded.with_payload(payload) if payload else loaded
    most = float(np.abs(loaded.at(arm.straight()).gravity_torques).max())
    stiffness = most / rng.uniform(0.05, 0.2)
    sent_at = np.arange(int(conditions.seconds / 0.02), dtype=np.float64) / 50.0
    sent = _sines(rng, sent_at, arm.nv, conditions.frequency)
    followed = _follow(loaded, model, stiffness, sent, _slow(rng, conditions, arm.nv))
    regular = np.arange(0.03, conditions.seconds - 0.03, 0.01)
    time = np.sort(regular + rng.normal(0.0, 5e-4, len(regular)))
    positions = followed[np.round(time / STEP).astype(int) - 1]
    positions = positions + rng.normal(0.0, conditions.noise, positions.shape)
    for row in np.flatnonzero(rng.random(len(time)) < 0.1)[1:]:
        positions[row] = positions[row - 1]
    known = payload if rng.random() < 0.5 else None
    log = Log(sent_at, sent, time, positions, gravity=gravity, payload=known)
    return Draw(log, model, stiffness, payload)


def _sines(rng: np.random.Generator, times: Array, joints: int, frequency: float) -> Array:
    """Return sums of three sines that begin at zero, (k, n) [rad]."""
    rates = 2.0 * np.pi * frequency * rng.uniform(0.5, 1.5, (3, joints))
    sizes = rng.uniform(0.2, 0.5, (3, joints))
    phases = rng.uniform(0.0, 2.0 * np.pi, (3, joints))
    waves = sizes * (np.sin(times[:, None, None] * rates + phases) - np.sin(phases))
    return np.asarray(waves.sum(axis=1))


def _slow(rng: np.random.Generator, conditions: Conditions, joints: int) -> Array:
    """Return a disturbance in steps of `STEP`, (m, n) [rad]: noise with a correlation time of 2 s."""
    kept = np.exp(-STEP / 2.0)
    pushes = rng.normal(
        0.0, conditions.disturbance * np.sqrt(1.0 - kept**2), (int(conditions.seconds / STEP), joints)
    )
    pushes[0] = rng.normal(0.0, conditions.disturbance, joints)
    for row in range(1, len(pushes)):
        pushes[row] += kept * pushes[row - 1]
    return pushes


def _follow(arm: pp.Arm, model: DriveModel, stiffness: float, sent: Array, disturbance: Array) -> Array:
    """Return the positions of drives after each step of `STEP`, (m, n) [rad]."""
    drives = Drives(model, sent[0], STEP)
    followed = np.empty_like(disturbance)
    for step, push in enumerate(disturbance):
        if step % 10 == 0:
            torques = arm.at(arm.configuration(drives.positions)).gravity_torques
        drives.sag = push - torques / stiffness
        followed[step] = drives.advance(sent[step // 20])
    return followed


def covered(found: DriveEstimate, payload: Estimate | None, truth: Draw) -> dict[str, bool | None]:
    """Return whether each interval covers the truth; None for what is not identified."""
    known = {
        "lag": (found.lag, truth.model.lag),
        "delay": (found.delay, truth.model.delay),
        "friction": (found.friction, truth.model.friction),
        "stiffness": (found.stiffness, truth.stiffness),
        "payload": (payload, truth.payload),
    }
    return {
        name: None if each is None else bool(each.lower <= value <= each.upper)
        for name, (each, value) in known.items()
    }


def main() -> None:
    """Print a table with a row for each number."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--draws", type=int, default=100)
    parser.add_argument("--seconds", type=float, default=30.0)
    parser.add_argument("--seed", type=int, default=0)
    given = parser.parse_args()
    arm = pp.Arm.from_template("RyRz", modules=4)
    together: list[dict[str, bool | None]] = []
    alone: list[dict[str, bool | None]] = []
    for seed in range(given.seed, given.seed + given.draws):
        truth = draw(arm, np.random.default_rng(seed), Conditions(given.seconds))
        result = pp.identify(arm, truth.log)
        together.append(covered(result.drives, result.payload, truth))
        alone += [covered(each, None, truth) for each in result.joints.values()]
    print("| number | one set: identified | covered | each joint: identified | covered |")
    print("|---|---|---|---|---|")
    for name in ("lag", "delay", "friction", "stiffness", "payload"):
        cells = []
        for results in (together, alone):
            known = [bool(each[name]) for each in results if each[name] is not None]
            cells += [f"{len(known)} of {len(results)}", f"{np.mean(known):.0%}" if known else "-"]
        print(f"| {name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
