"""How soon an operated arm brakes after its operator lets go, or the page is gone.

    python -m benchmarks.studies.holding                  # 20 trials of each, some three minutes
    python -m benchmarks.studies.holding --trials 3

A simulated arm of 20 modules on a feed, its control loop at 50 Hz and the server of the page run in this
process, as in `pinposture operate`. A page that another process stands for holds "ahead" for a while; then
it tells of the release, falls silent, or is closed. Told are the times from its last message, or from the
end of its connection, to the end of the first cycle that brakes the tip, of the first one in which the
commanded feed has at most half of its speed, and of the first one in which it rests.
"""

from __future__ import annotations

import argparse
import multiprocessing
import time
from threading import Event, Thread
from typing import Any

import numpy as np

import pinposture as pp
from pinposture.operate import Control, LivePage, Operation, SimulatedArm
from pinposture.ros2.driver import usual_limits

DT = 0.02
HELD = 2.0
"""Time for which it is held [s]."""

WAYS = ("release", "silence", "closed")


class RecordedArm(SimulatedArm):
    """A simulated arm that records when it moved its feed, by how much, and how fast it led the tip."""

    def __init__(self, *given: Any, **named: Any) -> None:
        super().__init__(*given, **named)
        self.times: list[float] = []
        self.steps: list[float] = []
        self.speeds: list[float] = []

    def cycle(self) -> bool:
        """Make a cycle, and record it."""
        before = self._sent[0]
        goes_on = super().cycle()
        self.times.append(time.monotonic())
        self.steps.append(abs(float(self._sent[0] - before)))
        self.speeds.append(float(self._operation._velocity[0]))
        return goes_on


def hold_often(url: str, asked: Any, told: Any) -> None:
    """Hold for a while in each way that is asked for, until None is; tell when it ended [s]."""
    while (way := asked.get()) is not None:
        hold(url, way, told)


def hold(url: str, way: str, told: Any) -> None:
    """Hold for a while, as a page does, and end that in a way; tell when [s]."""
    from websockets.sync.client import connect

    with connect(url.replace("http", "ws", 1) + "/control") as page:

        def tell(message: str) -> None:
            page.send(message)
            page.recv()

        tell('{"do": "ask"}')
        tell('{"do": "release"}')
        last = begun = time.monotonic()
        while last < begun + HELD:
            time.sleep(0.02)
            last = time.monotonic()
            tell('{"do": "hold", "ahead": 1, "left": 0, "up": 0, "override": 1}')
        if way == "release":
            last = time.monotonic()
            tell('{"do": "release"}')
        if way != "closed":
            told.put(last)
            time.sleep(1.0)
            return
    told.put(time.monotonic())


def main() -> None:
    """Run the trials, and print the times."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--trials", type=int, default=20)
    trials = parser.parse_args().trials
    slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=8.0, velocity=0.1)
    feed = pp.ModuleTemplate("Feed", joints=(slide,), link_lengths=(0.05,))
    arm = pp.Arm.from_modules([feed, *[pp.template("RyRz")] * 20])
    limits = usual_limits(arm, DT)
    operation = Operation(arm, limits, Control())
    simulated = RecordedArm(arm, operation, limits, deadline=0.5 * DT)
    page = LivePage(operation)
    page.start()
    stop = Event()
    loop = Thread(target=simulated.run, args=(stop,))
    loop.start()
    context = multiprocessing.get_context("spawn")
    asked = context.Queue()
    told = context.Queue()
    other = context.Process(target=hold_often, args=(page.url, asked, told))
    other.start()
    for way in WAYS:
        found = []
        for _ in range(trials):
            simulated.times.clear()
            simulated.steps.clear()
            simulated.speeds.clear()
            asked.put(way)
            last = told.get()
            time.sleep(1.5)
            found.append(times_after(simulated, last))
        print_times(way, np.array(found))
    asked.put(None)
    other.join()
    stop.set()
    loop.join()
    print(f"{simulated.plant.cycles} cycles, {simulated.tracker.overruns} of them too long")
    simulated.close()
    page.close()


def times_after(simulated: RecordedArm, last: float) -> list[float]:
    """Return how long after a time the arm brakes, has half of its speed, and rests [s]."""
    times = np.array(simulated.times)
    steps = np.array(simulated.steps)
    speeds = np.array(simulated.speeds)
    if len(times) < 2 or times[-1] < last:
        raise SystemExit("the loop stands")
    full = np.median(steps[times <= last][-5:])
    later = times > last
    begun = times[later & (speeds < speeds[~later][-1])][0]
    moments = [begun, *(times[later & (steps <= share * full)][0] for share in (0.5, 0.0))]
    return [float(moment - last) for moment in moments]


def print_times(way: str, found: Any) -> None:
    """Print the times of trials, (n, 3) [s]."""
    for name, column in zip(("brakes", "is at half speed", "rests"), 1e3 * found.T, strict=True):
        print(f"{way:8} {name} after {np.median(column):.0f} ms (median), {column.max():.0f} ms (most)")


if __name__ == "__main__":
    main()
