"""Many targets: one arm, forty random postures, all cores, one file.

python examples/12_many_targets.py
"""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

import pinposture as pp
from pinposture.arm import smooth_configuration
from pinposture.units import length_text
from pinposture.viz.palette import add_colorbar, colors_along
from pinposture.viz.postures import PosturePanel

if __name__ == "__main__":  # worker processes import this file
    # An arm of 10 modules, 20 degrees of freedom, 0.5 m long, and 40 reachable postures.
    arm = pp.Arm.from_template("RyRz", modules=10)
    rng = np.random.default_rng(0)
    goals = [smooth_configuration(arm, rng, rng.uniform(0.3, 0.7)) for _ in range(40)]
    targets = [pp.Target.from_configuration(arm, goal) for goal in goals]

    # One start for all. In a scene, if only an empty one, the arm keeps clear of itself. Forty runs take a
    # moment; ten thousand would use every core automatically.
    batch = pp.track_many(arm, targets, arm.straight(), max_steps=100, scene=pp.Scene())

    out = Path("out/many_targets")
    pp.save(batch, out / "batch.npz")
    print(batch)

    # Plot each final posture, coloured by its number of steps; a cross marks the target of the tip.
    figure, axes = plt.subplots(subplot_kw={"projection": "3d"}, figsize=(7, 6))
    panel = PosturePanel(arm, axes)
    colors, norm = colors_along(batch.steps.max())
    for number, run in enumerate(batch):
        panel.posture(run.q[-1], colors(norm(run.steps)), "_", width=1)
        label = "_" if number else "target of the tip"
        axes.scatter(*batch.target(number).points[-1], marker="x", color="black", s=12, label=label)
    panel.finish()
    axes.legend(loc="upper left", fontsize=9, frameon=False)
    add_colorbar([axes], batch.steps.max(), "steps", shrink=0.6)
    figure.savefig(out / "reached.png", dpi=120)

    # The runs with the most steps.
    print("\n run  status     steps     start error       end error   path")
    for k in np.argsort(-batch.steps, kind="stable")[:8]:
        errors = [length_text(each[k], arm.length) for each in (batch.start_error, batch.final_error)]
        shown = "  ".join(f"{text:>14}" for text in errors)
        print(f"{k:4}  {batch.status[k]:9}  {batch.steps[k]:5}  {shown}  {batch.path_length_ratio[k]:5.2f}")
    print(f"figure: {out / 'reached.png'}")
