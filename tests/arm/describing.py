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


def limit(lower=None, upper=None, velocity=2, effort=1):
    given = {"effort": effort, "velocity": velocity, "lower": lower, "upper": upper}
    return (
        "<limit " + " ".join(f'{name}="{value}"' for name, value in given.items() if value is not None) + "/>"
    )


def moving(name, parent, child, kind="revolute", axis="0 1 0", xyz="0.1 0 0", limits=None, more=""):
    """A joint that moves; revolute and prismatic ones have limits unless told otherwise."""
    limits = limit(-1, 1) if limits is None else limits
    return joint(name, parent, child, kind, f'<origin xyz="{xyz}"/><axis xyz="{axis}"/>{limits}{more}')


def fixed(name, parent, child, xyz="0 0 0", rpy="0 0 0"):
    return joint(name, parent, child, "fixed", f'<origin xyz="{xyz}" rpy="{rpy}"/>')


def arm_text(joints, tip="0.1 0 0", extra=""):
    """A serial arm l0 -j1- l1 -j2- ... tip of joints given as (kind, axis, xyz) or (kind, axis, xyz, limits).

    `extra` is more XML, which may hang on to those links.
    """
    body = links(["l0"])
    for k, (kind, axis, xyz, *limits) in enumerate(joints, 1):
        body += links([f"l{k}"]) + moving(f"j{k}", f"l{k - 1}", f"l{k}", kind, axis, xyz, *limits)
    return robot(body + links(["tip"]) + fixed("jt", f"l{len(joints)}", "tip", tip) + extra)


Y = "0 1 0"
Z = "0 0 1"
X = "1 0 0"
LINK = "0.1 0 0"
HERE = "0 0 0"


def pairs(count):
    """Joints of `count` modules of two perpendicular hinges and two links."""
    return [("revolute", Y, LINK), ("revolute", Z, LINK)] * count
