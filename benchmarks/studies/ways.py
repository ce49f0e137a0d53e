"""Whether an operator's way goes on when a ball appears on it.

    python -m benchmarks.studies.ways                    # 10 ways of each arm, a minute
    python -m benchmarks.studies.ways --draws 5

The way leads from one random smooth posture to another. While it is held, a ball of 5 cm appears about a
point of the arm in its middle third, clear of its ends, 0.2 s after the arm has set out. Commands are
followed exactly; the time of the simulation waits for a plan, which counts apart. Told are how many arms
arrive at the end of the way, the time of the whole motion, without that of plans, relative to that of the
free way, the smallest distance, and how long plans took.
"""

from __future__ import annotations

import argparse
import json
import time
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

import pinposture as pp
from benchmarks.studies.repair import with_ball
from pinposture.operate import Control, Operation
from pinposture.operate.ways import towards
from pinposture.ros2.driver import usual_limits

Array = NDArray[np.float64]

DT = 0.02
APPEARS = 0.2
"""Time after which the ball appears [s]."""
LONGEST = 30.0
"""Time within which the arm has to be at the end of the way [s]."""
BEND = 0.5
"""Bend of the postures."""
MARGIN = 0.005
NEAR = 1e-3
"""Largest distance of a joint from the end of the way at which the arm has arrived [rad]."""


class Outcome(NamedTuple):
    """How a draw went.

    Attributes:
        arrived: whether the arm is at the end of the way.
        longer: the time of the motion relative to that of the free way.
        lowest: smallest distance from the ball [m].
        planning: how long plans took [s].
    """

    arrived: bool
    longer: float
    lowest: float
    planning: float


class Desk:
    """An operator who holds R, and an arm that does what it is told.

    Args:
        arm: the arm.
        q: where it is, (nq,).
    """

    def __init__(self, arm: pp.Arm, q: Array) -> None:
        self.now = 0.0
        self.q = q
        self.scene = pp.Scene(margin=MARGIN, self_collision=False)
        self.limits = usual_limits(arm, DT)
        self.operation = Operation(arm, self.limits, Control(), clock=lambda: self.now)
        self._tracker = pp.Tracker(arm, limits=self.limits, scene=self.scene)
        for what in ("ask", "release"):
            self._tell(do=what)

    def _tell(self, **message: object) -> None:
        self.operation.control.take("page", json.dumps(message), self.now)

    def cycle(self, along: float) -> None:
        """Let a cycle pass in which the way that is planned first is held, or nothing."""
        self.now += DT
        held = {"do": "hold", "ahead": 0, "left": 0, "up": 0, "override": 1, "along": along, "way": 1}
        self._tell(**(held if along else {"do": "release"}))
        hold = self.operation.lead(self._tracker, self.q, self.scene, DT)
        self.q = self.operation.arm.integrate(
            self.q, self._tracker.step(None if hold else self.q, scene=self.scene)
        )

    def plan(self) -> float:
        """Wait for a plan that was asked for; return how long [s]."""
        begun = time.perf_counter()
        self.operation.ways._finder.finish(LONGEST)
        return time.perf_counter() - begun


def run(arm: pp.Arm, seed: int) -> Outcome | None:
    """Run a draw; None if no ball fits."""
    rng = np.random.default_rng(seed)
    start, end = (pp.arm.smooth_configuration(arm, rng, BEND) for _ in range(2))
    desk = Desk(arm, start)
    ways = desk.operation.ways
    for _ in range(5):
        desk.cycle(0.0)
    goal = pp.Target.from_configuration(arm, end)
    ways.ask("the posture", start, desk.scene, towards(arm, goal, desk.limits, "the posture"))
    desk.plan()
    desk.cycle(0.0)
    way = ways.way
    if way is None:
        return None
    scene = with_ball(way.path, desk.scene, seed)
    for _ in range(round(APPEARS / DT)):
        desk.cycle(1.0)
    if scene is None or pp.CollisionModel(arm, scene).minimum(desk.q).distance <= MARGIN:
        return None
    desk.scene = scene
    model = pp.CollisionModel(arm, scene)
    begun = desk.now
    lowest = np.inf
    planning = 0.0
    arrived = False
    while not arrived and desk.now < begun + LONGEST:
        desk.cycle(1.0)
        planning += desk.plan()
        lowest = min(lowest, model.minimum(desk.q).distance)
        arrived = bool(np.abs(arm.difference(desk.q, way.goal)).max() < NEAR)
    desk.operation.close()
    return Outcome(arrived, (desk.now - begun + APPEARS) / (way.end * DT), lowest, planning)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=10)
    draws = parser.parse_args().draws
    print("| joints | arrived | time, median | most | smallest distance [mm] | plans [s]: median | most |")
    print("|---" * 7 + "|")
    for modules in (8, 20):
        arm = pp.Arm.from_template("RyRz", modules=modules)
        found = [outcome for seed in range(draws) if (outcome := run(arm, seed)) is not None]
        longer = np.array([outcome.longer for outcome in found if outcome.arrived])
        planning = np.array([outcome.planning for outcome in found])
        numbers = (
            f"{sum(outcome.arrived for outcome in found)} of {len(found)}",
            f"{np.median(longer):.2f}",
            f"{longer.max():.2f}",
            f"{1e3 * min(outcome.lowest for outcome in found):.1f}",
            f"{np.median(planning):.2f}",
            f"{planning.max():.2f}",
        )
        print(f"| {arm.nv} | {' | '.join(numbers)} |", flush=True)


if __name__ == "__main__":
    main()
