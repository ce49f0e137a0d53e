"""Building of a Pinocchio model from a description, out of the parts that the model is made of.

Shapes, materials and extensions are left out: the reader in Pinocchio prints a message for each that it does
not know, as <capsule>, although the library reads them itself.
"""

from __future__ import annotations

import threading
from collections.abc import Collection
from concurrent.futures import ThreadPoolExecutor
from xml.etree.ElementTree import Element, SubElement, tostring

import pinocchio as pin

from pinposture.arm.configurations import MOST_LINKS, MOST_MOVING, NO_LIMIT
from pinposture.arm.urdf_reader import finite_numbers, parse_xml
from pinposture.errors import URDFError

_JOINT_PARTS = ("parent", "child", "origin", "axis", "limit", "dynamics")
_STACK = 16 << 20
_STACK_PER_LINK = 8 << 10
"""Stack for reading a description, and more for each link and joint, which need 2.3 kB together [bytes]."""
_STACK_SIZE = threading.Lock()  # the size is that of all threads that are started
_MOMENTS = ("ixx", "iyy", "izz", "ixy", "ixz", "iyz")


def build_model(text: str, source: str, unlimited: Collection[str] = ()) -> pin.Model:
    """Build the model of all links and joints of a description, with independent mimic joints.

    Links whose <inertial> Pinocchio cannot read have no mass.

    Args:
        text: the URDF, as `text_for_pinocchio` makes it.
        source: its name in error messages.
        unlimited: names of continuous joints to make revolute without limits.

    Raises:
        URDFError: Pinocchio rejects the description, or would take too long for it.
    """
    robot = parse_xml(text, source)
    links = len(robot.findall("link"))
    moving = sum(joint.get("type") != "fixed" for joint in robot.findall("joint"))
    for count, what, most in ((links, "links", MOST_LINKS), (moving, "moving joints", MOST_MOVING)):
        if count > most:
            raise URDFError(source, "<robot>", f"has {count} {what}; allowed: {most} at most")
    needed = Element("robot", robot.attrib)
    for link in robot.findall("link"):
        made = SubElement(needed, "link", name=link.get("name", ""))
        made.extend(each for each in link.findall("inertial") if _is_readable(each))
    for joint in robot.findall("joint"):
        made = SubElement(needed, "joint", joint.attrib)
        made.extend(each for each in joint if each.tag in _JOINT_PARTS)
        if joint.get("name") in unlimited:
            _remove_limits(made)
    try:
        return _parse(tostring(needed, encoding="unicode"), _STACK + _STACK_PER_LINK * len(needed))
    except (ValueError, RuntimeError) as error:
        raise URDFError(source, "<robot>", f"was rejected by Pinocchio: {error}") from None


def _parse(text: str, stack: int) -> pin.Model:
    """Let Pinocchio read a description in a thread with a stack of its own [bytes].

    It follows the tree by recursion, and would overflow the stack of the caller at 4,000 joints.
    """
    with ThreadPoolExecutor(1) as reader:
        with _STACK_SIZE:
            before = threading.stack_size(stack)
            try:
                model = reader.submit(pin.buildModelFromXML, text)
            finally:
                threading.stack_size(before)
        return model.result()


def _remove_limits(joint: Element) -> None:
    """Make a continuous joint revolute; its position is then a number that counts turns."""
    joint.set("type", "revolute")
    if joint.find("limit") is None:
        SubElement(joint, "limit", effort="0", velocity="0")
    for limit in joint.findall("limit"):
        limit.attrib.update(lower=repr(-NO_LIMIT), upper=repr(NO_LIMIT))


def _is_readable(inertial: Element) -> bool:
    """Return whether an <inertial> has all numbers that it must have."""
    origin = inertial.find("origin")
    mass = inertial.find("mass")
    inertia = inertial.find("inertia")
    if mass is None or inertia is None:
        return False
    numbers = [mass.get("value", ""), *(inertia.get(name, "") for name in _MOMENTS)]
    vectors = [] if origin is None else [origin.get(name, "0 0 0") for name in ("xyz", "rpy")]
    words = [*numbers, *(word for vector in vectors for word in vector.split())]
    return finite_numbers(words) is not None and all(len(vector.split()) == 3 for vector in vectors)
