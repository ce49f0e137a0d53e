"""Part of an arm: the outer half of a planar arm takes a shape, the rest is free; four controllers compared.

python examples/04_part_of_an_arm.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.arm import bent_configuration
from pinposture.units import length_text

# A planar arm of 45 joints; each joint is a control point.
arm = pp.Arm.from_template("Rz", modules=45, link_lengths=(0.15,))
rng = np.random.default_rng(3)
start = bent_configuration(arm, rng, heading=1.2)

# The target: the posture of another bent configuration, but only from control point 23 to the tip.
goal = pp.Target.from_configuration(arm, bent_configuration(arm, rng, heading=1.5))
target = goal.region(22, 44)

# The default controller, "geodesic", plans the most direct path and follows it. Selection moves the points
# that it can move safely, Projection moves all points in the directions in which they can move, Switching
# alternates between the two and records why.
names = ("geodesic", "selection", "projection", "switching")
runs = {name: pp.track(arm, target, start, name) for name in names}
for name, run in runs.items():
    error = length_text(run.mean_error[-1], arm.length)
    print(f"{name}: {run.status} after {run.steps} steps, mean point error {error}")
for switch in runs["switching"].switches:
    print(f"  step {switch.step + 1}: {switch.method}, because {switch.reason}")

# Manipulability of the tip. The ellipsoid of its Jacobian is flat where the posture is singular.
(tip,) = arm.at(runs["switching"].q[-1]).ellipsoids([-1])
print(f"tip: condition number {tip.condition:.3g}, smallest singular value {tip.smallest:.3g} m/rad")

out = Path("out/part_of_an_arm")
out.mkdir(parents=True, exist_ok=True)
pp.plot_comparison(runs).savefig(out / "comparison.png", dpi=120)
pp.plot_arm(arm, runs["switching"].q[-1], ellipsoids=[22, 33, 44]).savefig(out / "ellipsoids.png", dpi=120)
pp.save_html(arm, runs["switching"], out / "run.html", ellipsoids=[44])
print(f"figures: {out}, animation: {out / 'run.html'}")
