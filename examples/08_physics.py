"""Does the motion survive dynamics? The thesis's helix, with servos and gravity, in open and in closed loop.

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

# The arm of the thesis, a random smooth start, and a motion of cycles of 20 ms to the helix.
arm = pp.Arm.from_template("RyRz", modules=20)
target = pp.resolve_targets(arm, HELIX)
start = smooth_configuration(arm, np.random.default_rng(0), 0.6)
limits = pp.Limits(dt=0.02, acceleration=10.0)
run = pp.track(arm, target, start, limits=limits)

# Servos that hold the arm so stiffly that no vibration of it is slower than 10 Hz.
servos = Servos(frequency=10.0)


def simulated(closed, gravity):
    """The arm under way, with or without being looked at."""
    if not closed:  # the servos are sent the motion, and nobody looks
        return simulate(arm, run, servos, gravity, hold=2.0)
    tracker = Tracker(arm, limits=limits)  # told in each cycle where the arm is
    duration = run.steps * limits.dt + 2.0
    return simulate_closed(arm, tracker, target, start, duration, limits.dt, servos, gravity)


out = Path("out/physics")
out.mkdir(parents=True, exist_ok=True)
print("               joints off [mrad]     points off [mm]   off the helix")
print("loop   gravity     rms   largest mean (rms)   largest  at the end [mm]")
for loop in ("open", "closed"):
    for gravity in (True, False):
        ended = simulated(loop == "closed", gravity)
        told = ended.summary()
        joints, points = told["turning_joints"], told["mean_point_error"]
        final = np.linalg.norm(ended.points[-1] - target.points, axis=1).mean()
        largest = told["largest_point_error"]["value"]
        numbers = (joints["rms"], joints["largest"], points["rms"], largest, final)
        columns = [f"{1e3 * number:9.2g}" for number in numbers]
        print(f"{loop:6} {'yes' if gravity else 'no':6}", *columns)
        name = f"{loop}_{'gravity' if gravity else 'weightless'}"
        pp.save(ended, out / f"{name}.npz")
        if gravity:
            plot_simulation(ended).savefig(out / f"{name}.png")
print(f"look at {out / 'open_gravity.png'} and {out / 'closed_gravity.png'}")
