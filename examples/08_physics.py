"""Physics: the helix of the thesis with servos and gravity, in open and in closed loop.

pip install 'pinposture[sim]'
python examples/08_physics.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.curve import HELIX
from pinposture.motion import Tracker
from pinposture.sim import Servos, simulate, simulate_closed
from pinposture.viz.simulation import plot_simulation

# The arm of the thesis, a random smooth start, and a motion to the helix with a cycle time of 20 ms.
arm = pp.Arm.from_template("RyRz", modules=20)
target = pp.resolve_targets(arm, HELIX)
start = smooth_configuration(arm, np.random.default_rng(0), 0.6)
limits = pp.Limits(dt=0.02, acceleration=10.0)
run = pp.track(arm, target, start, limits=limits)

# Servos so stiff that no vibration of the arm is slower than 10 Hz.
servos = Servos(frequency=10.0)


def simulated(closed, gravity):
    """Simulate the motion, with or without feedback."""
    if not closed:  # the servos receive the motion, without feedback
        return simulate(arm, run, servos, gravity=gravity, hold=2.0)
    tracker = Tracker(arm, limits=limits)  # receives the measured positions in each cycle
    duration = run.steps * limits.dt + 2.0
    return simulate_closed(arm, tracker, target, start, duration, limits.dt, servos, gravity=gravity)


out = Path("out/physics")
out.mkdir(parents=True, exist_ok=True)
print("             joint errors [mrad]   point errors [mm]  helix error")
print("loop   gravity     rms   largest mean (rms)   largest  at the end [mm]")
for loop in ("open", "closed"):
    for gravity in (True, False):
        ended = simulated(loop == "closed", gravity)
        summary = ended.summary()
        joints = summary["turning_joints"]
        points = summary["mean_point_error"]
        final = np.linalg.norm(ended.points[-1] - target.points, axis=1).mean()
        largest = summary["largest_point_error"]["value"]
        numbers = (joints["rms"], joints["largest"], points["rms"], largest, final)
        columns = [f"{1e3 * number:9.2g}" for number in numbers]
        print(f"{loop:6} {'yes' if gravity else 'no':6}", *columns)
        name = f"{loop}_{'gravity' if gravity else 'weightless'}"
        pp.save(ended, out / f"{name}.npz")
        if gravity:
            plot_simulation(ended).savefig(out / f"{name}.png")
print(f"figures: {out / 'open_gravity.png'}, {out / 'closed_gravity.png'}")
