"""Short ways to write robot descriptions, and what Pinocchio makes of them."""

from __future__ import annotations

import pinocchio as pin

LIMIT = '<limit effort="1" velocity="2" lower="-1" upper="3"/>'


def robot(body):
    return f'<robot name="r">{body}</robot>'


def links(names):
    return "".join(f'<link name="{name}"/>' for name in names)


def joint(name, parent, child, kind="fixed", inside=""):
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>{inside}</joint>'
    )


def one_joint(kind="revolute", inside=LIMIT):
    return robot(links("ab") + joint("j", "a", "b", kind, inside))


def pinocchio_loads(text):
    try:
        pin.buildModelFromXML(text)
    except ValueError:
        return False
    return True
