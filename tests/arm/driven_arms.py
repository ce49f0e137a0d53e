"""An arm whose drives move other joints than those that lead on its chain, and a robot that is built like it.

The robot knows the couplings from the table below and the tip from Pinocchio's model of all joints, each of
which moves on its own there: nothing of how the arm maps its degrees of freedom to its drives.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
from arm.describing import X, Y, Z, fixed, joint, limit, robot

import pinposture as pp

FOLLOWS = {
    "a": ("c", 2.0, 0.1),  # a later joint of the chain has the drive
    "b": ("d", -4.0, 0.02),  # a slide
    "f": ("motor", -0.5, 0.3),  # an actuator beside the chain
    "g": ("f", 0.7, -0.05),  # which a joint follows that follows the motor
}
"""Leader, multiplier and offset of each joint with <mimic>."""

DRIVES = ("c", "d", "turn", "motor", "h")
"""The joints that move on their own, in the order of the joints of the arm that move with them."""

LEADERS = ("a", "b", "turn", "f", "h")

CHAIN = (
    ("a", "revolute", Y, limit(-2, 2, 3, 40)),
    ("b", "revolute", Z, limit(-2, 2, 3, 40)),
    ("c", "revolute", Y, limit(-1.2, 1.2, 3, 50)),
    ("d", "prismatic", X, limit(-0.4, 0.4, 3, 60)),
    ("turn", "continuous", X, limit(None, None, 3, 70)),
    ("f", "revolute", Y, limit(-2, 2, 3, 40)),
    ("g", "revolute", Z, limit(-2, 2, 3, 40)),
    ("h", "revolute", Z, limit(-2, 2, 3, 80)),
)

MASS = (
    '<inertial><origin xyz="0.05 0.01 -0.02"/><mass value="{mass}"/>'
    '<inertia ixx="4e-4" iyy="5e-4" izz="6e-4" ixy="0" ixz="0" iyz="0"/></inertial>'
)


def _moving(name: str, parent: str, child: str, kind: str, axis: str, limits: str) -> str:
    inside = f'<origin xyz="0.1 0 0"/><axis xyz="{axis}"/>{limits}'
    if name in FOLLOWS:
        leader, ratio, offset = FOLLOWS[name]
        inside += f'<mimic joint="{leader}" multiplier="{ratio}" offset="{offset}"/>'
    return joint(name, parent, child, kind, inside)


def driven_text() -> str:
    """The description, with a gripper beside the chain."""
    links = ["l0", *(f"l_{name}" for name, *_ in CHAIN), "side", "finger"]
    body = "".join(
        f'<link name="{name}">{MASS.format(mass=0.1 + 0.05 * k)}</link>' for k, name in enumerate(links)
    )
    body += '<link name="tip"/>' + fixed("end", "l_h", "tip", "0.1 0 0")
    for (name, *about), parent, child in zip(CHAIN, links[:-3], links[1:-2], strict=True):
        body += _moving(name, parent, child, *about)
    body += _moving("motor", "l0", "side", "revolute", Z, limit(-3, 3, 5, 90))
    return robot(body + _moving("gripper", "l_h", "finger", "prismatic", Y, limit(0, 0.1, 1, 10)))


def driven_arm() -> pp.Arm:
    return pp.Arm.load(driven_text(), tip="tip")


class Robot:
    """What the robot does: its drives go where they are sent, and it says where all its joints are.

    Attributes:
        model: Pinocchio's model of all joints, none of which follows another.
        driven: position of each drive by name [rad or m].
    """

    def __init__(self, driven: Mapping[str, float]) -> None:
        self.model = pin.buildModelFromXML(driven_text())
        self.driven = dict(driven)

    def states(self) -> dict[str, float]:
        """Return the positions of all joints by name, as a JointState has them, with full turns."""
        known = {"gripper": 0.0} | self.driven
        names = [str(name) for name in list(self.model.names)[1:]]
        return {name: self._position(name, known) for name in names}

    def _position(self, name: str, known: Mapping[str, float]) -> float:
        if name in known:
            return known[name]
        leader, ratio, offset = FOLLOWS[name]
        return ratio * self._position(leader, known) + offset

    def configuration(self, states: Mapping[str, float] | None = None) -> np.ndarray:
        """Return the configuration of Pinocchio's model."""
        positions = self.states() if states is None else states
        tangent = np.zeros(self.model.nv)
        for name, position in positions.items():
            tangent[self.model.joints[self.model.getJointId(name)].idx_v] = position
        return np.array(pin.integrate(self.model, pin.neutral(self.model), tangent))

    def tip(self) -> np.ndarray:
        """Return where the tip is, (3,) [m]."""
        data = self.model.createData()
        pin.framesForwardKinematics(self.model, data, self.configuration())
        return np.array(data.oMf[self.model.getFrameId("tip")].translation)

    def motion(self) -> np.ndarray:
        """Return the velocities of all joints per velocity of each drive, (n, drives)."""
        matrix = np.zeros((self.model.nv, len(DRIVES)))
        still = dict.fromkeys(DRIVES, 0.0)
        for column, name in enumerate(DRIVES):
            moved = Robot(still | {name: 1.0}).states()
            for joint_name, position in Robot(still).states().items():
                row = self.model.joints[self.model.getJointId(joint_name)].idx_v
                matrix[row, column] = moved[joint_name] - position
        return matrix
