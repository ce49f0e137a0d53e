"""Arms to measure: templates, loaded ones with collision geometry, and one of a single solid."""

from __future__ import annotations

import numpy as np
import pinocchio as pin

import pinposture as pp
from pinposture.arm.template import JointSpec, ModuleTemplate, continuum_section
from pinposture.collision import Box, Capsule, Cylinder, HalfSpace, Mesh, Sphere

RATIOS = {"j3": ("j1", 0.7, 0.1), "j4": ("j2", -0.5), "j5": "j1"}

PLACED = pin.SE3(pin.rpy.rpyToMatrix(0.3, -0.5, 1.1), np.array([0.1, -0.2, 0.3]))

SLIDING = ModuleTemplate(
    "RyRzP",
    (JointSpec("y"), JointSpec("z"), JointSpec("x", type="prismatic", lower=0.0, upper=0.05)),
    (0.03, 0.05, 0.03),
)


def spatial(modules=6):
    return pp.Arm.from_template("RyRz", modules, (0.04, 0.05), base_placement=PLACED)


def planar(modules=4):
    return pp.Arm.from_template("RzRz", modules, (0.15, 0.15), base_placement=PLACED)


def sliding(modules=3):
    return pp.Arm.from_modules([SLIDING] * modules, base_placement=PLACED)


def modelled():
    """An arm without a description, of three hinges, one of them without limits."""
    model = pin.Model()
    parent = 0
    for k, joint in enumerate((pin.JointModelRZ(), pin.JointModelRUBY(), pin.JointModelRY())):
        parent = model.addJoint(parent, joint, pin.SE3(np.eye(3), np.array([0.2 * (k > 0), 0, 0])), f"j{k}")
    model.addFrame(
        pin.Frame("tip", parent, pin.SE3(np.eye(3), np.array([0.2, 0, 0])), pin.FrameType.OP_FRAME)
    )
    model.lowerPositionLimit[:] = -2.0
    model.upperPositionLimit[:] = 2.0
    return pp.Arm.from_model(model, ["tip"], base_placement=PLACED)


def geometry(shape, xyz="0 0 0", rpy="0 0 0"):
    return f'<collision><origin xyz="{xyz}" rpy="{rpy}"/><geometry>{shape}</geometry></collision>'


def described(collisions, length=0.2, base="", slides=()):
    """A serial arm of hinges about y and z in turn, with that collision XML on the link after each.

    Joints whose numbers are among `slides` slide along x instead, from 0 to 0.2 m.
    """
    body = f'<link name="l0">{base}</link>'
    for k, collision in enumerate(collisions, 1):
        body += f'<link name="l{k}">{collision}</link>'
        kind = "revolute"
        axis = "0 1 0" if k % 2 else "0 0 1"
        lower = -3
        upper = 3
        if k in slides:
            kind = "prismatic"
            axis = "1 0 0"
            lower = 0
            upper = 0.2
        body += (
            f'<joint name="j{k}" type="{kind}"><parent link="l{k - 1}"/><child link="l{k}"/>'
            f'<origin xyz="{length * (k > 1)} 0 0"/><axis xyz="{axis}"/>'
            f'<limit effort="1" velocity="1" lower="{lower}" upper="{upper}"/></joint>'
        )
    body += '<link name="tip"/><joint name="jt" type="fixed">'
    body += f'<parent link="l{len(collisions)}"/><child link="tip"/><origin xyz="{length} 0 0"/></joint>'
    return f'<robot name="r">{body}</robot>'


def single(shape, xyz="0.5 0 0", rpy="0 0 0"):
    """An arm with one solid, on its second link, whose frame is the world's at zero positions."""
    text = described(["", geometry(shape, xyz, rpy)]).replace('xyz="0.2 0 0"/><axis', 'xyz="0 0 0"/><axis')
    return pp.Arm.load(text, split=2)


CYLINDER = geometry('<cylinder radius="0.03" length="0.16"/>', "0.1 0 0", "0 1.5707963267948966 0")
BLOCK = geometry('<box size="0.1 0.05 0.08"/>', "0.1 0.01 0", "0.2 0.3 0.4")

ARMS = {
    "spatial": spatial,
    "planar": planar,
    "sliding": sliding,
    "modelled": modelled,
    "described": lambda: pp.Arm.load(described([CYLINDER, BLOCK] * 3), split=2),
    "coupled": lambda: pp.Arm.load(described([CYLINDER, BLOCK] * 3), couplings=RATIOS),
    "sections": lambda: pp.Arm.from_modules([continuum_section(4, 0.3, stretch=0.1)] * 2),
}


def around(arm, rng):
    """One obstacle of each kind, that a random posture may or may not touch."""
    base = arm.chain.base
    length = arm.length

    def place():
        return base + rng.normal(size=3) * 0.5 * length

    return {
        "sphere": Sphere(place(), 0.15 * length),
        "capsule": Capsule(place(), place(), 0.05 * length),
        "cylinder": Cylinder(place(), place(), 0.05 * length),
        "box": Box(place(), np.array([0.2, 0.3, 0.1]) * length, rng.uniform(-3, 3, 3)),
        "floor": HalfSpace(base - [0, 0, 0.3 * length], (0.1, 0.2, 1)),
        "mesh": Mesh(rng.normal(size=(30, 3)) * 0.1 * length, place()),
    }
