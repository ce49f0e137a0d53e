"""Arms, states and targets that the tests of the baselines share."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import pinposture as pp

PLACEMENT = pin.SE3(pin.rpy.rpyToMatrix(0.3, -1.1, 2.0), np.array([0.4, -2.0, 0.7]))
SLIDE = pp.JointSpec("x", type="prismatic", lower=-0.04, upper=0.05)
ENDLESS = pp.JointSpec("z", type="continuous")
SLIDING = pp.ModuleTemplate("slides", (pp.JointSpec("y"), SLIDE, ENDLESS), (0.03,) * 3)


def state_of(arm: pp.Arm, seed: int, amplitude: float = 0.8) -> pp.ArmState:
    rng = np.random.default_rng(seed)
    return arm.at(arm.configuration(amplitude * arm.joint_units * rng.uniform(-1, 1, arm.nv)))


def target_of(arm: pp.Arm, seed: int, weights: object = None) -> pp.Target:
    state = state_of(arm, seed + 10**6)
    target = pp.Target.from_points(arm, state.points, weights)
    return pp.Target(target.points, target.weights, q=state.q)
