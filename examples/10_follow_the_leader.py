"""Follow the leader: an arm on a feed enters a pipe with two bends, and every part of it follows the tip.

python examples/10_follow_the_leader.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.collision.pipe import pipe, pipe_axis
from pinposture.task import perform
from pinposture.task.follow_leader import follow_leader, path_deviation

# An arm of 20 modules, 1 m long, on a prismatic joint that pushes it along its axis by up to 1.2 m.
slide = pp.JointSpec("x", type="prismatic", lower=0.0, upper=1.2, velocity=0.1)
feed = pp.ModuleTemplate("Feed", joints=(slide,), link_lengths=(0.05,))
arm = pp.Arm.from_modules([feed, *[pp.template("RyRz")] * 20])

# The path: 10 cm straight, a bend of 90 degrees to the left, 10 cm, a bend of 90 degrees up, 5 cm.
bends = (0.25, np.pi / 2, 0.0), (0.25, np.pi / 2, np.pi / 2)  # radius [m], angle, direction
path = pipe_axis(runs=(0.1, 0.1, 0.05), bends=bends)

# The reference motion at 5 cm/s, in rows of 0.1 s. The path is moved to the tip.
reference = follow_leader(arm, path, interval=0.1, speed=0.05)
laid = reference.waypoints[-1].target.curve
print(f"{reference.rows} rows, {reference.duration:.1f} s for {path.length:.3f} m")

# Run it within the limits, in a pipe with a radius of 4.5 cm.
scene = pipe(laid, radius=0.045, self_collision=False)  # too narrow to touch itself
limits = pp.Limits(dt=0.1, acceleration=2.0)
motion = perform(reference, "geodesic", limits, scene=scene)
run = motion.run
print(f"{run.status} after {run.steps * limits.dt:.1f} s")

deviation = path_deviation(arm, run.q, path)
print(f"largest deviation: {deviation.percent:.3f} % of the arm length, {1e3 * deviation.largest:.2f} mm")
nearest = pp.CollisionModel(arm, scene).minimum(run.q[run.clearance.argmin()])
print(f"clearance {1e3 * nearest.distance:.1f} mm ({' to '.join(nearest.pair)})")

out = Path("out/follow_the_leader")
pp.save(run, out / "run.npz")
pp.plot(motion).savefig(out / "motion.png", dpi=100)
pp.save_html(arm, run, out / "run.html")
print(f"figure: {out / 'motion.png'}, animation: {out / 'run.html'}")
