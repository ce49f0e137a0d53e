"""Around obstacles: the arm moves through a slot in a wall; the run records its clearance.

python examples/05_around_obstacles.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp

# An arm of 20 modules, each with two crossed hinges: 40 degrees of freedom, 1 m long.
arm = pp.Arm.from_template("RyRz", modules=20)

# A wall across the way, 55 cm from the base: two boxes with a slot of 30 cm between them.
wall = {
    "left": pp.Box(center=(0.6, 0.45, 0.0), size=(0.1, 0.6, 0.5)),
    "right": pp.Box(center=(0.6, -0.45, 0.0), size=(0.1, 0.6, 0.5)),
}
scene = pp.Scene(wall, margin=0.01)  # 1 cm of clearance

# The start is bent along the wall; the goal reaches through the slot in the shape of an S.
start = np.zeros(arm.nq)
goal = np.zeros(arm.nq)
start[1::2] = 0.1  # the joints about z [rad]
goal[0::2] = 0.015
goal[1::2] = np.linspace(-0.03, 0.03, 20)
target = pp.Target.from_configuration(arm, goal)

run = pp.track(arm, target, start, scene=scene)

print(run.status, "-", run.reason)
nearest = pp.CollisionModel(arm, scene).minimum(run.q[run.clearance.argmin()])
print(f"{run.steps} steps, clearance {1e3 * nearest.distance:.1f} mm ({' to '.join(nearest.pair)})")
print(f"path length of the control points: {run.path_length_ratio:.2f} times the straight lines")
print(f"steps on which the posture error rose: {run.error_increasing.sum()}")

out = Path("out/around_obstacles")
pp.save(run, out / "run.npz")
pp.plot(run).savefig(out / "run.png", dpi=120)
pp.save_html(arm, run, out / "run.html")
print(f"figure: {out / 'run.png'}, animation: {out / 'run.html'}")
