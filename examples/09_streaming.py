"""Streaming: a control loop with new targets, lagging drives, failed measurements and a push.

python examples/09_streaming.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import pinposture as pp
from pinposture.viz.palette import format_time_axes

# cycle time, and time constant of the drives [s]
DT = 0.01
LAG = 0.05

arm = pp.Arm.from_template("RyRz", modules=20)
helix = pp.resolve_targets(arm, pp.Curve.helix(radius=0.06, pitch=0.15, turns=4))
bow = pp.resolve_targets(arm, pp.Curve.helix(radius=0.4, pitch=0.0, turns=0.5), placement="align")
limits = pp.Limits(step=None, dt=DT, velocity=2.0, acceleration=10.0)

tracker = pp.Tracker(arm, limits=limits)
rng = np.random.default_rng(0)
sag = 0.02 * rng.normal(size=arm.nv)  # sag of the drives under gravity [rad]
q = arm.straight()
errors = []
notes = {}

for cycle in range(1000):
    if cycle == 20:
        tracker.update(helix)
    if cycle == 500:
        tracker.update(bow)  # while the arm moves
    measured = q + 1e-4 * rng.normal(size=arm.nv)
    if 150 <= cycle < 170:
        measured = None  # the bus is down
    if cycle == 300:
        measured[7] = np.nan
    if cycle == 800:
        q = q + 0.4 * rng.normal(size=arm.nv)  # somebody bumps into the arm

    tracker.step(measured)  # returns dq; position drives receive `command`

    q = q + (tracker.command + sag - q) * (DT / LAG)
    errors.append(1e3 * (tracker.report.mean_error or np.nan))
    status = tracker.report.status
    reason = tracker.report.reason
    if (status, reason.split(" is ")[0]) not in notes:
        notes[status, reason.split(" is ")[0]] = cycle
        print(f"{cycle * DT:5.2f} s  {status:8} {reason}")

final = np.linalg.norm(arm.at(q).points - bow.points, axis=1).mean()
print(f"mean point error at the end: {1e6 * final:.0f} um, with sag and noise")

figure, ax = plt.subplots(figsize=(8, 3), layout="constrained")
ax.semilogy(DT * np.arange(len(errors)), errors)
ax.set_title("a target at 0.2 s, another at 5 s, a push at 8 s", fontsize=10, loc="left")
format_time_axes(ax, "mean error [mm]")
out = Path("out/streaming")
out.mkdir(parents=True, exist_ok=True)
figure.savefig(out / "errors.png", dpi=120)
print(f"figure: {out / 'errors.png'}")
