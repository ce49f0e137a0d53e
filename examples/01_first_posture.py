"""First posture: a 40-joint arm takes the shape of a helix.

python examples/01_first_posture.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.units import length_text

# An arm of 20 modules, each with two crossed hinges: 40 degrees of freedom, 1 m long.
arm = pp.Arm.from_template("RyRz", modules=20)

# The target curve. It is moved to the base and aligned with the arm's axis.
curve = pp.Curve.helix(radius=0.06, pitch=0.15, turns=4)
target = pp.resolve_targets(arm, curve)

# Any start works; this one is a random, gently curved posture.
start = smooth_configuration(arm, np.random.default_rng(0), amplitude=0.6)
# The default controller, "geodesic", plans the most direct path; no joint moves by more than 0.1 rad per
# step. In a scene, also one without obstacles, the arm keeps clear of itself.
run = pp.track(arm, target, start, limits=pp.Limits(step=0.1), scene=pp.Scene())

print(run.verdict)
errors = [length_text(error, arm.length) for error in run.mean_error]
print(f"mean point error {errors[0]} -> {errors[-1]} in {run.steps} steps")

out = Path("out/first_posture")
pp.save(run, out / "run.npz")
pp.plot(run).savefig(out / "run.png", dpi=120)
pp.save_html(arm, run, out / "run.html")
print(f"figure: {out / 'run.png'}, animation: {out / 'run.html'}")
