"""Keyframes: five postures at given times, within velocity and acceleration limits.

python examples/06_keyframes.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.units import length_text

# An arm of 20 modules, each with two crossed hinges: 40 degrees of freedom, 1 m long.
arm = pp.Arm.from_template("RyRz", modules=20)

# The postures and their times. If a curve is longer than the arm, the arm takes its first part.
straight = pp.Curve.line((0, 0, 0), (1, 0, 0))
bend = pp.Curve.spline(np.array([(0, 0, 0), (0.4, 0, 0), (0.6, 0.3, 0.1), (0.9, 0.3, 0.3), (1.3, 0.2, 0.3)]))
helix = pp.Curve.helix(radius=0.06, pitch=0.15, turns=4)
coil = pp.Curve.helix(radius=0.06, pitch=0.06, turns=3)
keyframes = [
    pp.Keyframe(straight, name="straight"),
    pp.Keyframe(bend, duration=1.5, name="S", trim=True),
    pp.Keyframe(helix, duration=1.0, name="helix", trim=True),
    pp.Keyframe(coil, duration=2.0, hold=0.5, name="coil", trim=True),
    pp.Keyframe(straight, duration=2.0, name="straight again"),
]

# A cycle time of 20 ms. If the limits do not allow the times, the motion takes longer.
limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=4.0)
# A scene without obstacles: the arm keeps clear of itself.
motion = pp.move_through(arm, keyframes, limits=limits, scene=pp.Scene())

print(f"{motion.run.status} after {motion.time[-1]:.2f} s, {motion.time_scale:.2f} times as long as planned")
print(f"largest joint velocity: {np.abs(motion.velocities).max():.3f} of {limits.velocity} rad/s")
print(f"largest acceleration: {np.abs(motion.accelerations).max():.3f} of {limits.acceleration} rad/s^2")
for place in motion.waypoints:
    print(f"  {place.name:14}  planned {place.planned:.2f} s, reached {place.reached:.2f} s")
print(f"largest mean point error: {length_text(motion.mean_error.max(), arm.length)}")

out = Path("out/five_postures")
pp.save(motion, out / "motion.npz")
pp.save(motion.joint_trajectory(), out / "motion.json")  # for a robot: trajectory_msgs/JointTrajectory
pp.plot(motion).savefig(out / "motion.png", dpi=120)
pp.save_html(arm, motion, out / "motion.html")
print(f"figure: {out / 'motion.png'}, animation: {out / 'motion.html'}")
