"""Steering: an operator drives an arm through a hole with three numbers, and the body follows the tip.

python examples/20_steering.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.task import path_deviation

# An arm of 20 modules, 1 m long, on a feed; a wall with a hole of 16 cm, which is to the left and above.
slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=1.2, velocity=0.1)
feed = pp.ModuleTemplate("Feed", joints=(slide,), link_lengths=(0.05,))
arm = pp.Arm.from_modules([feed, *[pp.template("RyRz")] * 20])
wall = {
    "left": pp.Box((1.4, 0.53, 0.1), (0.02, 0.6, 1.2)),
    "right": pp.Box((1.4, -0.23, 0.1), (0.02, 0.6, 1.2)),
    "top": pp.Box((1.4, 0.15, 0.48), (0.02, 0.16, 0.6)),
    "bottom": pp.Box((1.4, 0.15, -0.28), (0.02, 0.16, 0.6)),
}
scene = pp.Scene(wall, margin=0.01)

# Each order of the operator: for how long [s], how fast [m/s], how much to bend to the left and up [1/m].
limits = pp.Limits(dt=0.05, acceleration=10.0)
orders = [
    (6.0, 0.07, (0.0, 0.0)),  # straight on, until the wall stops the arm
    (5.0, -0.07, (0.0, 0.0)),  # back
    (2.5, 0.07, (6.0, 4.0)),  # left and up, towards the hole
    (2.5, 0.07, (-6.0, -4.0)),  # straight again
    (4.0, 0.07, (0.0, 0.0)),  # through the hole
    (3.0, 0.07, (0.0, 20.0)),  # up behind the wall, as much as joints allow
]
steering = pp.Steering(arm, limits, scene)
tracker = pp.Tracker(arm, limits=limits, scene=scene)
rows = [steering.q]
for seconds, speed, bend in orders:
    told = {}
    for _ in range(round(seconds / limits.dt)):
        tracker.update(steering.step(speed, bend))
        rows.append(arm.integrate(rows[-1], tracker.step(rows[-1])))  # here the drives do what they are told
        told[steering.reason] = None
    x, y, z = arm.at(rows[-1]).points[-1]
    print(f"{speed:5.2f} m/s, bend {bend}: tip at ({x:.2f}, {y:.2f}, {z:.2f})")
    print("    " + "; ".join(reason or "as told" for reason in told))

clearance = min(pp.CollisionModel(arm, scene).minimum(q).distance for q in rows)
print(f"clearance {1e3 * clearance:.1f} mm")

# The body is on the path of the tip, which can be followed again, or kept in a file.
deviation = path_deviation(arm, [steering.q], steering.path, placement="as_is")
print(f"largest distance from the path of the tip: {1e3 * deviation.largest:.1f} mm")
reference = pp.follow_leader(arm, steering.path, 0.1, 0.07, placement="as_is", depth=steering.depth)
apart = np.abs(reference.configuration(reference.rows - 1) - steering.q).max()
print(f"follow_leader ends within {apart:.0e} rad of it")

out = Path("out/steering")
out.mkdir(parents=True, exist_ok=True)
steering.path.save(out / "path.json")
pp.save(pp.JointTrajectory.from_configurations(arm, rows, limits.dt), out / "motion.csv")
pp.plot_arm(arm, rows[-1], scene=scene).savefig(out / "arm.png", dpi=100)
print(f"path: {out / 'path.json'}, motion: {out / 'motion.csv'}, figure: {out / 'arm.png'}")
