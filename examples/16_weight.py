"""Weight: the torques of a posture, a camera and its cable, and a motion that no motor can hold.

python examples/16_weight.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp

# A snake of twelve modules on a wall, with motors of 2 N m. Template arms weigh as much as solid bars of
# water: 33 g for each module.
module = pp.template("RyRz").with_lengths((0.03, 0.05))
wall = pp.Arm.from_modules([module] * 12).with_effort(2.0)
print(f"{wall.length:.2f} m, {sum(body.mass for body in wall.model.inertias):.2f} kg")

state = wall.at(wall.straight())
print(f"straight out: {state.most_loaded()}")

# A camera at the tip, and its cable along the arm.
arm = wall.with_payload(0.15, com=(0.02, 0, 0)).with_cable(0.08)
loaded = arm.at(arm.straight())
print(f"with camera and cable: {loaded.most_loaded()}")
print(f"margin of the first joint: {loaded.torque_margin[0]:.2f} N m")

# How far can it be held out, from whichever side gravity comes?
held = arm.held_out()
print(f"held straight out: {1e3 * held.length:.0f} mm; first to give up: {held.load}")

# A bow upwards is easier than a straight line, and the way back down is not for a robot.
bow = pp.Target.from_configuration(arm, arm.configuration(np.tile([-0.25, 0.0], 12)))
line = pp.Target.from_configuration(arm, arm.straight())
print(f"bow: {bow.load(arm)}")
run = pp.track(arm, line, bow.q)
print(f"from the bow to the line: {run.verdict}")

# What the description does not say: torque limits of single joints, masses from a density.
strong = arm.with_effort({name: 6.0 if name < "m05" else 2.0 for name in arm.joint_names})
print(f"with stronger motors at the base: {strong.at(strong.straight()).most_loaded()}")
bare = pp.Arm.load(wall.urdf.replace("inertial", "ignored"), split=2)
aluminium = pp.weigh(bare, density=2700.0)
print(f"solid aluminium: {sum(load.mass for load in aluminium.weight.masses):.2f} kg")

out = Path("out/weight")
out.mkdir(parents=True, exist_ok=True)
pp.plot_arm(arm, arm.straight(), torques=True).savefig(out / "straight.png", dpi=120)
pp.plot_arm(arm, bow.q, torques=True).savefig(out / "bow.png", dpi=120)
print(f"joints coloured by their share of the torque: {out}")
