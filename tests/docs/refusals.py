"""What the URDF guide says is refused: a case for each message that it shows."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from typing import Any

from arm.describing import HERE, LINK, X, Y, Z, arm_text, joint, limit, links, moving, pairs, robot
from arm.faults import FAULTS

import pinposture as pp

Load = Callable[[], Any]

ARM = arm_text(pairs(2))
FORK = robot(
    links(["base", "left", "right"]) + moving("a", "base", "left") + moving("b", "base", "right", axis=Z)
)
FOLLOWER = '<mimic joint="j1" multiplier="1"/>'
LOCKED = [("revolute", Y, LINK, limit(0, 0)), ("revolute", Z, LINK, limit(0, 0))]
TWO = links("abc") + moving("j", "a", "b")


def loading(text: str, **options: Any) -> Load:
    """A call that loads an arm."""
    return lambda: pp.Arm.load(text, **options)


CHAIN: dict[str, Load] = {
    "several longest chains": loading(FORK),
    "no moving joint": loading(arm_text(LOCKED)),
    "nothing but floating joints": loading(arm_text([("floating", Y, LINK, "")] * 2), tip="l2"),
    "a joint that follows one that is not there": loading(
        robot(TWO + moving("k", "b", "c", axis=Z, more='<mimic joint="jj"/>')), tip="c"
    ),
    "a floating joint inside the chain": loading(robot(TWO + joint("k", "b", "c", "floating")), tip="c"),
    "a planar joint inside the chain": loading(robot(TWO + joint("k", "b", "c", "planar")), tip="c"),
    "no length": loading(arm_text([("revolute", Y, HERE), ("revolute", Z, HERE)], tip="0 0 0")),
    "a tip that is not below the base": loading(FORK, base="left", tip="right"),
    "a link that does not exist": loading(ARM, tip="tipp"),
    "a base and no tip": loading(ARM, base="l0"),
    "joints per module that do not divide": loading(ARM, split=3),
    "sizes that do not add up": loading(ARM, split=[2, 1]),
    "links that are not in order": loading(ARM, split=["l3", "l2", "tip"]),
    "links that leave joints over": loading(ARM, tip="tip", split=["l2", "l3"]),
    "a locked joint that does not exist": loading(ARM, locked={"j9": 0.0}),
    "a locked position that is no number": loading(ARM, locked={"j1": "bent"}),
}
"""Refused once the file itself has been read: what was asked of it does not fit."""


def mjcf(after: str = "", joint: str = "", body: str = "", **options: Any) -> Load:
    """A call that loads an arm of two hinges from MJCF."""
    shape = '<geom size="0.01"/>'
    inner = f'{shape}<joint name="j2" axis="0 0 1" {joint}/><site name="tip" pos="0.1 0 0"/>'
    outer = f'{shape}<joint name="j1" axis="0 1 0"/><body name="b2" pos="0.1 0 0">{inner}</body>'
    base = f'<body name="base" {body}><body name="b1">{outer}</body></body>'
    return loading(f"<mujoco><worldbody>{base}</worldbody>{after}</mujoco>", **options)


def equality(content: str) -> Load:
    """A call that loads an arm with an equality from MJCF."""
    return mjcf(f"<equality>{content}</equality>")


_CORD = (
    '<tendon><fixed name="cord" {}><joint joint="j1" coef="1"/><joint joint="j2" coef="1"/></fixed></tendon>'
)

MJCF: dict[str, Load] = {
    "a ball joint": mjcf(joint='type="ball"'),
    "a mocap body": mjcf(body='mocap="true"'),
    "a weld": equality('<weld name="grasp" body1="b2"/>'),
    "a loop": equality('<connect name="rod" body1="b2" body2="base" anchor="0 0 0"/>'),
    "a coupling that is not linear": equality(
        '<joint name="gear" joint1="j2" joint2="j1" polycoef="0 1 0.5 0 0"/>'
    ),
    "a joint with two leaders": equality('<joint joint1="j2" joint2="j1"/><joint name="stop" joint1="j2"/>'),
    "coupled tendons": mjcf(_CORD.format("") + '<equality><tendon name="pair" tendon1="cord"/></equality>'),
    "a tendon that drives joints together": mjcf(
        _CORD.format("") + '<actuator><position tendon="cord" kp="1"/></actuator>'
    ),
    "a tendon with a range": mjcf(_CORD.format('range="-1 1"')),
}
"""Refused because no serial chain is like that."""

FILE: dict[str, Load] = {name: loading(fault[0]) for name, fault in FAULTS.items()}
"""Refused because the description has a fault."""

SETTLED: dict[str, Load] = {
    "a base that floats": loading(
        robot(links(["world"]) + joint("free", "world", "l0", "floating") + ARM[len('<robot name="r">') : -8])
    ),
    "an element twice, differently": loading(
        arm_text(pairs(2)).replace("<axis", f'<axis xyz="{X}"/><axis', 1)
    ),
    "limits that leave one position": loading(
        arm_text([*pairs(1), ("revolute", X, LINK, limit(0.5, 0.5)), *pairs(1)])
    ),
    "no limits": loading(arm_text([*pairs(1), ("revolute", Y, LINK, limit()), ("revolute", Z, LINK)])),
    "a velocity limit of 0": loading(
        arm_text([*pairs(1), ("revolute", Y, LINK, limit(-1, 1, velocity=0)), ("revolute", Z, LINK)])
    ),
    "revolute limits of 4 pi to 360 rad": loading(
        arm_text([*pairs(1), ("revolute", Y, LINK, limit(-90, 90)), ("revolute", Z, LINK)])
    ),
    "more than 100 m from the first joint to the tip": loading(
        arm_text([("revolute", Y, "100 0 0"), ("revolute", Z, "100 0 0")] * 2, tip="100 0 0")
    ),
    "parallel axes in a row": loading(arm_text([("revolute", Z, LINK), *[("revolute", Y, LINK)] * 3])),
    "joints beside the chain": loading(
        arm_text(pairs(2), extra=links(["jaw"]) + moving("grip", "l2", "jaw", "prismatic"))
    ),
    "a follower beside the chain": loading(
        arm_text(pairs(2), extra=links(["fin"]) + moving("fold", "l2", "fin", more=FOLLOWER))
    ),
}
"""Not refused, but settled with a warning."""


def refusal(load: Load) -> str:
    """What is said as the load is refused; empty if it is not."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        try:
            load()
        except pp.PostureError as error:
            return str(error)
    return ""


def settlements(load: Load) -> list[str]:
    """The warnings of a load that is not refused."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        load()
    return [str(each.message) for each in caught]
