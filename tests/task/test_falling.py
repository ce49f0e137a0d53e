"""Where joints fall to: against the energy of the weight by Pinocchio, on a fine grid."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

import pinposture as pp
from pinposture.task.falling import LEAST_PULL, Fall, fall_of, torque_left

STEP = 1e-4


def gained(arm: pp.Arm, q: np.ndarray, column: int, torque: float, moved: np.ndarray) -> np.ndarray:
    """Return the kinetic energy after motions of a joint, against a torque, (n,) [J]."""
    data = arm.model.createData()

    def height(by: float) -> float:
        at = q.copy()
        at[column] += by
        return float(pin.computePotentialEnergy(arm.model, data, at))

    begin = height(0.0)
    return np.array([begin - height(by) for by in moved]) - torque * np.abs(moved)


@pytest.mark.parametrize("seed", range(6))
def test_a_joint_rests_where_energy_is_least_and_swings_until_none_is_left(seed: int) -> None:
    rng = np.random.default_rng(seed)
    arm = pp.Arm.from_template("RyRz", modules=3)
    state = arm.at(rng.uniform(-0.6, 0.6, arm.nv))
    column = 2 * int(rng.integers(3))  # these hinges carry weight wherever the arm is
    torque = float(rng.choice([0.0, 0.5])) * abs(float(state.gravity_torques[column]))
    fall = fall_of(state, column, torque)
    assert fall is not None
    here = state.q[column]
    side = -np.sign(state.gravity_torques[column])
    limit = arm.limits.upper[column] if side > 0.0 else arm.limits.lower[column]
    moved = side * np.arange(0.0, abs(limit - here), STEP)
    energy = gained(arm, state.q, column, torque, moved)
    lost = np.flatnonzero(energy < -1e-12)
    farthest = here + moved[lost[0]] if len(lost) else limit
    assert fall.rest == pytest.approx(here + moved[np.argmax(energy)], abs=2.0 * STEP)
    assert fall.farthest == pytest.approx(farthest, abs=2.0 * STEP)


def test_a_joint_falls_no_farther_than_its_end_stop_and_not_at_all_where_its_drive_holds_it() -> None:
    hinge = pp.ModuleTemplate("m", (pp.JointSpec("y", lower=-0.4, upper=0.4),), (0.1,))
    arm = pp.Arm.from_modules([hinge] * 3)
    state = arm.at(np.array([0.1, 0.2, -0.1]))
    needed = float(state.gravity_torques[0])
    stop = 0.4 if needed < 0.0 else -0.4
    assert fall_of(state, 0, 0.0) == Fall(stop, stop)
    assert fall_of(state, 0, 1.01 * abs(needed)) == Fall(0.1, 0.1)


def test_where_weight_does_not_tell_where_a_joint_falls_none_is_returned() -> None:
    arm = pp.Arm.from_template("RyRz", modules=3)
    straight = arm.at(arm.straight())
    assert fall_of(straight, 1, 0.0) is None  # a vertical hinge
    upright = arm.at(np.array([-np.pi / 2 + 0.5 * LEAST_PULL, 0.0, 0.0, 0.0, 0.0, 0.0]))
    assert fall_of(upright, 0, 0.0) is None
    assert fall_of(arm.at(np.array([-np.pi / 2 + 0.3, *np.zeros(5)])), 0, 0.0) is not None


def test_where_a_joint_has_fallen_to_tells_what_its_drive_still_gives() -> None:
    hinge = pp.ModuleTemplate("m", (pp.JointSpec("y", lower=-1.0, upper=1.0),), (0.1,))
    arm = pp.Arm.from_modules([hinge] * 3)
    q = np.array([0.1, 0.2, -0.1])
    torque = 0.7 * abs(float(arm.at(q).gravity_torques[0]))
    fall = fall_of(arm.at(q), 0, torque)
    assert fall is not None
    q[0] = fall.rest
    assert torque_left(arm.at(q), 0) == pytest.approx(torque)
    q[0] = 0.99
    assert torque_left(arm.at(q), 0) == 0.0  # at its end stop
    q[:] = 0.5 * np.pi, 0.0, 0.0
    assert torque_left(arm.at(q), 0) == 0.0  # it hangs


def test_a_slide_falls_to_its_end_stop() -> None:
    slide = pp.JointSpec("z", type="prismatic", lower=-0.2, upper=0.3)
    arm = pp.Arm.from_modules([pp.ModuleTemplate("lift", (slide,), (0.05,)), pp.template("RyRz")])
    assert fall_of(arm.at(arm.neutral()), 0, 0.0) == Fall(-0.2, -0.2)
