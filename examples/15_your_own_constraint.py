"""A constraint of your own: a link that stays inside a cone, whatever posture the arm takes.

python examples/15_your_own_constraint.py
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

import pinposture as pp


@dataclass(frozen=True)
class LinkInCone:
    """The link before a control point stays within an angle [rad] of the x axis of the world."""

    point: int
    angle: float
    name: str = "link in cone"

    def rows(self, state):
        """Linearise the constraint at a state: matrix (1, nv) [m/rad], and its bounds [m]."""
        axis = np.array([1.0, 0.0, 0.0])
        link = state.rotations[self.point][:, 0]  # unit vector along the link
        size = state.arm.length  # rows are in metres
        matrix = size * np.cross(link, axis) @ state.angular_jacobians[self.point]  # of the cosine
        lower = size * (np.cos(self.angle) - link @ axis)  # how far the cosine may fall
        return matrix[None], [lower], [np.inf]


def main() -> None:
    """Track a posture with and without the constraint, and compare the angle of the link."""
    arm = pp.Arm.from_template("RyRz", modules=12)
    cone = LinkInCone(point=5, angle=np.deg2rad(30.0))
    q0 = pp.arm.smooth_configuration(arm, np.random.default_rng(28), 0.8)
    goal = pp.arm.smooth_configuration(arm, np.random.default_rng(29), 0.8)
    target = pp.Target.from_configuration(arm, goal)

    runs = {
        "free": pp.track(arm, target, q0, scene=pp.Scene()),
        "in the cone": pp.track(arm, target, q0, pp.Geodesic(constraints=[cone]), scene=pp.Scene()),
    }
    figure = Figure(figsize=(7.0, 3.2), layout="constrained")
    ax = figure.subplots()
    for name, run in runs.items():
        angles = np.rad2deg([np.arccos(arm.at(q).rotations[cone.point][0, 0]) for q in run.q])
        ended = f"{run.status} after {run.steps} steps"
        print(f"{name:12}{ended}; the sixth link turns up to {angles.max():.1f} deg")
        ax.plot(angles, label=name)
    ax.axhline(30.0, color="0.5", ls="--", label="bound")
    ax.set(xlabel="step", ylabel="angle of the sixth link [deg]")
    ax.legend()
    out = Path("out/your_own_constraint")
    out.mkdir(parents=True, exist_ok=True)
    figure.savefig(out / "angles.png", dpi=120)
    print(f"look at {out / 'angles.png'}")


if __name__ == "__main__":
    main()
