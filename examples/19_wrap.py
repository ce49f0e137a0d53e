"""Wrap: an arm winds around a can, lifts it by 0.2 m, carries it to another place, and lets go of it.

python examples/19_wrap.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.sim import ContactModel, simulate

# An arm of 1 m, 0.3 kg, beside a can of 300 g that stands on the floor. The arm may touch the can.
arm = pp.Arm.from_template("RyRz", modules=20).with_effort(5.0)
can = pp.Cylinder((0.42, 0.12, -0.12), (0.42, 0.12, 0.12), radius=0.06)
floor = pp.HalfSpace((0, 0, -0.12), (0, 0, 1))
scene = pp.Scene({"can": can, "floor": floor}, touchable=["can"])
limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=2.0)
start = arm.straight()

# Nine tenths of a turn around the can, with a coefficient of friction of 0.5.
grip = pp.wrap(arm, "can", scene, start, limits, turns=0.9, friction=0.5)
print(grip)
print(", ".join(f"{name} {motion.duration:.1f} s" for name, motion in grip.phases.items()))

# The free modules move the can, the wrapped ones stay as they are.
lifted = pp.carry(grip, (0.0, 0.0, 0.2))
aside = pp.carry(lifted, (-0.1, 0.15, 0.0))
down = pp.carry(aside, (0.0, 0.0, -0.2), onto=["floor"])
away = pp.unwrap(down, start)

# All motions in one, with friction, servos and gravity.
motion = pp.JointTrajectory.joined([grip.motion, lifted.motion, aside.motion, down.motion, away])
contact = ContactModel(friction=0.5, masses={"can": 0.3})
ended = simulate(arm, motion, scene=scene, contact=contact)
print(ended.verdict)
middle = np.array([0.42, 0.12, 0.0, 1.0])
way = ended.contacts.displacements[:, 0] @ middle - middle
print(f"the can was lifted by {100 * way[:, 2].max():.1f} cm")
print(f"it was carried by {100 * np.linalg.norm(way[-1, :2]):.1f} cm")

out = Path("out/wrap")
out.mkdir(parents=True, exist_ok=True)
row = int(np.argmax(way[:, 2]))
pp.plot_arm(arm, ended.q[row], scene=ended.scene_in(row, scene)).savefig(out / "lifted.png")
pp.save(ended, out / "simulation.npz")
print(f"look at {out / 'lifted.png'}")
