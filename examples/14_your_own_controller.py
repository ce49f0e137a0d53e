"""A controller of your own: the Jacobian transpose, beside those of the thesis.

python examples/14_your_own_controller.py
"""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

import pinposture as pp
from pinposture.control import CONTROLLERS, Step
from pinposture.units import length_text


@dataclass(frozen=True)
class JacobianTranspose:
    """Moves the joints down the gradient of the squared errors of all control points."""

    gain: float = 1.0
    name: str = "transpose"

    def step(self, state, target, limits=None, memory=None):
        """Compute one step: take a state and a target, return a `Step`."""
        limits = limits or pp.Limits()
        before = memory.dq if memory else None
        errors = (target.points - state.points) * target.has_target[:, None]  # (m, 3) [m], world frame
        gradient = np.einsum("kdu,kd->u", state.jacobians, errors)  # (nv,): the sum of J_k^T e_k
        moved = np.einsum("kdu,u->kd", state.jacobians, gradient)  # how the points would move along it
        length = np.sum(gradient**2) / max(np.sum(moved**2), 1e-30)  # where the linearised error is least
        limited = limits.apply(state, self.gain * length * gradient, before)
        active = tuple(np.flatnonzero(target.has_target))
        info = {"scale": limited.scale, "length": length}  # become columns of `run.info`
        return Step(limited.dq, active, limited.clipped, info=info)


def main() -> None:
    """Register it, and run it beside Projection and the default controller."""
    arm = pp.Arm.from_template("RyRz", modules=20)
    target = pp.resolve_targets(arm, pp.Curve.helix(radius=0.06, pitch=0.15, turns=4))
    q0 = pp.arm.smooth_configuration(arm, np.random.default_rng(0), 0.5)

    CONTROLLERS["transpose"] = JacobianTranspose  # now it has a name
    runs = {name: pp.track(arm, target, q0, name) for name in ("transpose", "projection", "geodesic")}
    for name, run in runs.items():
        print(f"{name:12}{length_text(run.mean_error[-1], arm.length):>15} after {run.steps} steps")

    out = Path("out/your_own_controller")
    out.mkdir(parents=True, exist_ok=True)
    pp.plot_comparison(runs).savefig(out / "comparison.png", dpi=120)
    print(f"look at {out / 'comparison.png'}")


if __name__ == "__main__":
    main()
