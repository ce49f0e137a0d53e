"""Export a motion: joint positions, velocities and accelerations for a robot, and read them back.

python examples/07_export_a_motion.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp

# A short motion: six modules, from straight to a hook and back.
arm = pp.Arm.from_template("RyRz", modules=6)
straight = pp.Curve.line((0, 0, 0), (0.3, 0, 0))
hook = pp.Curve.spline([(0, 0, 0), (0.12, 0, 0), (0.22, 0.06, 0), (0.2, 0.2, 0.08)])
postures = [
    pp.Keyframe(straight),
    pp.Keyframe(hook, duration=1.5, hold=0.3, trim=True),
    pp.Keyframe(straight, duration=1.5),
]
limits = pp.Limits(step=None, dt=0.02, velocity=1.5, acceleration=6.0)
motion = pp.move_through(arm, postures, limits=limits, scene=pp.Scene())

# The input of a robot: positions, velocities and accelerations of the joints. At rest at both ends.
joints = motion.joint_trajectory()
print(joints)
fastest = np.abs(joints.velocities).max()
hardest = np.abs(joints.accelerations).max()
print(f"largest velocity {fastest:.3g} rad/s, largest acceleration {hardest:.3g} rad/s^2")

# Three formats: for NumPy, for a spreadsheet, and the message that ros2_control accepts.
out = Path("out/export")
for suffix in ("npz", "csv", "json"):
    path = pp.save(joints, out / f"motion.{suffix}")
    again = pp.load(path).matched(arm)
    same = np.array_equal(again.positions, joints.positions)
    print(f"{path}: {path.stat().st_size} bytes, reads back unchanged: {same}")

# Resample it for a controller with another cycle time.
print("at 1 kHz:", joints.sampled(0.001))

pp.plot(joints).savefig(out / "joints.png", dpi=100)
print(f"figure: {out / 'joints.png'}")
