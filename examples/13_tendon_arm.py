"""A tendon arm: three sections of ten coupled disks each, through keyframes and on servos.

pip install 'pinposture[sim]'
python examples/13_tendon_arm.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.arm import continuum_section
from pinposture.sim import Servos, simulate

# Tendons bend each section as a whole: two degrees of freedom move ten disks with crossed hinges. The arm
# tapers from 12 to 8 mm. For a URDF use <mimic>, or pp.Arm.load(urdf, couplings={...}).
sections = [continuum_section(disks=10, length=0.25, bend=2.5, radius=r) for r in (0.012, 0.01, 0.008)]
arm = pp.Arm.from_modules(sections, name="tendon_arm")
print(f"{arm.nv} degrees of freedom move {len(arm.chain.joints)} joints in {arm.n_modules} sections")

# Curves as for any other arm. Each section approximates them by an arc.
straight = pp.Curve.line((0, 0, 0), (1, 0, 0))
bow = pp.Curve.spline(np.array([(0, 0, 0), (0.25, 0, 0), (0.45, 0.15, 0), (0.5, 0.4, 0), (0.4, 0.6, 0)]))
swan = pp.Curve.spline(
    np.array([(0, 0, 0), (0.2, 0, 0.05), (0.35, 0, 0.22), (0.55, 0, 0.25), (0.8, 0.1, 0.1)])
)
keyframes = [
    pp.Keyframe(straight, name="straight", trim=True),
    pp.Keyframe(bow, duration=2.0, name="bow", trim=True),
    pp.Keyframe(swan, duration=2.0, hold=0.5, name="swan", trim=True),
    pp.Keyframe(straight, duration=2.0, name="straight again", trim=True),
]
limits = pp.Limits(step=None, dt=0.02, velocity=0.5, acceleration=2.0)  # of the degrees of freedom
motion = pp.move_through(arm, keyframes, limits=limits)
print(f"{motion.run.status} after {motion.time[-1]:.2f} s")
for place in motion.waypoints:
    print(f"  {place.name:14}  planned {place.planned:.2f} s, reached {place.reached:.2f} s")

# Simulate servos and gravity. All disks of a section move together.
ended = simulate(arm, motion, Servos(frequency=10.0))
joints = ended.summary()["turning_joints"]
print(f"largest error on servos: {1e3 * joints['largest']:.2g} mrad")

# The degrees of freedom for the drives; all joints for drawing the robot.
out = Path("out/tendon_arm")
trajectory = motion.joint_trajectory()
pp.save(trajectory, out / "degrees_of_freedom.csv")
pp.save(trajectory.with_coupled(arm), out / "all_joints.json")
pp.plot(motion).savefig(out / "motion.png", dpi=120)
pp.save_html(arm, motion, out / "motion.html")
print(f"figure: {out / 'motion.png'}, animation: {out / 'motion.html'}")
