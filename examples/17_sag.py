"""Sag: where a loaded arm with soft joints really is, and the commands that put it where it should be.

python examples/17_sag.py
"""

from pathlib import Path

import numpy as np
import pinocchio as pin

import pinposture as pp
from pinposture.arm import Weight
from pinposture.motion import Actuators, Tendon
from pinposture.sim import Servos, simulate

# A snake of ten modules and 1 m, with 50 g at its tip, on servos so soft that it swings at 3 Hz.
module = pp.template("RyRz").with_lengths((0.03, 0.07))
snake = pp.Arm.from_modules([module] * 10).with_payload(0.05)
arm = snake.with_stiffness(Servos(frequency=3.0).stiffness(snake))
posture = arm.configuration(0.1 * np.cos(0.7 * np.arange(arm.nv)))

sagged = arm.sag(posture)
off = np.linalg.norm(arm.at(sagged).points[-1] - arm.at(posture).points[-1])
print(f"commanded to a posture, the tip is {1e3 * off:.1f} mm beside it")

# The command for which the loaded arm takes the posture, and the commands of a motion.
command = arm.compensate(posture)
left = np.abs(arm.positions(arm.sag(command)) - arm.positions(posture)).max()
print(f"with the command against sag it is there: {left < 1e-9}")
run = pp.track(arm, pp.Target.from_configuration(arm, posture), arm.straight())
out = Path("out/sag")
out.mkdir(parents=True, exist_ok=True)
pp.save(run.joint_trajectory(0.1, compensate=True), out / "commands.csv")
print(f"commands of the motion: {out / 'commands.csv'}")

# An arm that is too soft to stand upright is refused.
upright = pin.SE3(pin.rpy.rpyToMatrix(0.0, -np.pi / 2.0, 0.0), np.zeros(3))
column = pp.Arm.from_modules([module] * 10, base_placement=upright).with_payload(0.05)
try:
    column.with_stiffness(1.0).sag(column.straight())
except pp.errors.NoEquilibrium as error:
    print(error)

# Six arms in MuJoCo, which knows nothing of these formulas.
hanging = pin.SE3(pin.rpy.rpyToMatrix(0.0, np.pi / 2.0, 0.0), np.zeros(3))
half = pp.template("RyRz").with_lengths((0.015, 0.035))
slide = pp.JointSpec("x", type="prismatic", lower=-0.05, upper=0.05)
sliding = pp.ModuleTemplate("Sliding", [pp.JointSpec("y"), pp.JointSpec("z"), slide], [0.05, 0.1, 0.1])
offsets = {"a": (0.02, 0.0), "b": (-0.01, 0.017), "c": (-0.01, -0.017)}
tendons = {f"{name}{k}": Tendon(at, end=k) for k in range(10) for name, at in offsets.items()}
pulled = Actuators.from_tendons(snake, tendons)


def soft(arm):
    """Return an arm with servos on which it swings at 3 Hz."""
    return arm.with_stiffness(Servos(frequency=3.0).stiffness(arm))


arms = {
    "on a wall": arm,
    "on a ceiling": soft(pp.Arm.from_modules([module] * 10, hanging).with_payload(0.05)),
    "on the floor": soft(column),
    "of 40 joints": soft(pp.Arm.from_modules([half] * 20).with_payload(0.05)),
    "with slides": soft(pp.Arm.from_modules([sliding] * 4).with_payload(0.05)),
    "on tendons": snake.with_stiffness(pulled.stiffness(2e4)),
}
print(f"{'tip off by':14}{'sag':>10}{'predicted':>13}{'compensated':>14}{'payload -20 %':>16}")
for name, arm in arms.items():
    posture = arm.configuration(0.1 * np.cos(0.7 * np.arange(arm.nv)) * arm.joint_units)
    wanted = arm.at(posture).points[-1]
    share = np.linspace(0.0, 1.0, 60)
    way = (share**3 * (10 - 15 * share + 6 * share**2))[:, None] * arm.difference(arm.straight(), posture)
    rows = arm.integrate(arm.straight(), way)
    lighter = arm.with_weight(Weight(stiffness=arm.weight.stiffness)).with_payload(0.04)
    hold = 12.0 if name == "on tendons" else 3.0
    plain = simulate(arm, rows, dt=0.02, hold=hold)
    held = simulate(arm, rows, dt=0.02, hold=hold, compensate=True)
    wrong = simulate(arm, lighter.compensate(rows), dt=0.02, hold=hold)
    predicted = np.linalg.norm(arm.at(arm.sag(posture)).points[-1] - wanted)
    tips = [1e3 * np.linalg.norm(each.points[-1, -1] - wanted) for each in (plain, held, wrong)]
    print(f"{name:14}{tips[0]:7.2f} mm{1e3 * predicted:10.2f} mm{tips[1]:11.2f} mm{tips[2]:13.2f} mm")
