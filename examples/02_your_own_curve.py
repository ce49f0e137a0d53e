"""Your own curve: through points, from a file, and the error for a curve that is too short.

python examples/02_your_own_curve.py
"""

from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.units import length_text

arm = pp.Arm.from_template("RyRz", modules=20)
out = Path("out/your_own_curve")

# A curve through points [m]; with through=False they are control points instead.
points = [(0, 0, 0), (0.25, 0.02, 0), (0.45, 0.2, 0.1), (0.6, 0.2, 0.3), (0.55, 0.0, 0.5), (0.5, -0.2, 0.6)]
curve = pp.Curve.spline(points, through=True)
curve.save(out / "curve.json")
curve = pp.Curve.load(out / "curve.json")
largest = curve.curvature(np.linspace(0, curve.length, 500)).max()
print(f"length {curve.length:.3f} m, largest curvature {largest:.1f} /m")

target = pp.resolve_targets(arm, curve)
residual = length_text(target.residual.max(), arm.length)
print(f"modules end at {target.parameters[:3].round(3)} ... m, residual {residual}")

# A curve that is too short raises an error, or is placed as far as it goes.
short = pp.Curve.line((0, 0, 0), (0.6, 0, 0))
try:
    pp.resolve_targets(arm, short)
except pp.PostureError as error:
    print("refused:", error)
partial = pp.resolve_targets(arm, short, incomplete="partial")
print(f"placed partially: {partial.has_target.sum()} of {arm.n_modules} control points")

start = smooth_configuration(arm, np.random.default_rng(6), amplitude=0.4)
run = pp.track(arm, target, start)  # with the default controller, "geodesic"
pp.plot(run).savefig(out / "run.png", dpi=120)
print(f"{run.status} after {run.steps} steps; figure: {out / 'run.png'}")
