"""Your own module: describe it in a few lines, chain it, and get a URDF that other programs can read.

python examples/03_your_own_module.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp

# A thick module with hinges that turn by up to 60 degrees, and a slimmer one for the far half of the arm.
bend = np.radians(60.0)
hinges = (pp.JointSpec("z", lower=-bend, upper=bend), pp.JointSpec("y", lower=-bend, upper=bend))
stub = pp.ModuleTemplate("stub", joints=hinges, link_lengths=(0.04, 0.05), radius=0.02)
slim = pp.ModuleTemplate("slim", joints=hinges, link_lengths=(0.03, 0.04), radius=0.012)

arm = pp.Arm.from_modules([stub] * 6 + [slim] * 8, name="tapered")
print(arm)

out = Path("out/your_own_module")
out.mkdir(parents=True, exist_ok=True)
(out / "tapered.urdf").write_text(arm.urdf)

# Check the curvature before tracking.
curve = pp.Curve.helix(radius=0.15, pitch=0.4, turns=2)
feasibility = arm.can_follow(curve)
print(f"largest curvature: arm {feasibility.max_curvature:.1f} /m, curve {feasibility.curvature:.1f} /m")

target = pp.resolve_targets(arm, curve, placement="align")  # the helix does not start at the base
run = pp.track(arm, target, arm.straight())  # with the default controller, "geodesic"
print(run.status, "-", run.reason)
pp.plot_arm(arm, run.q[-1]).savefig(out / "arm.png", dpi=100)
pp.save_html(arm, run, out / "run.html")
print(f"figure: {out / 'arm.png'}, animation: {out / 'run.html'}")
