"""Masses and moments of inertia of links: what descriptions may give, and what no solid has."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm.urdf_reader import parse_xml
from pinposture.errors import URDFError

Array = NDArray[np.float64]

# Solid ball at the joint that replaces a moving link without mass [kg], [m].
DEFAULT_MASS = 1e-3
DEFAULT_RADIUS = 1e-2
MIN_RADIUS = 1e-4  # moments of inertia are at least those of a ball of the same mass with this radius [m]
INERTIA_ROUNDING = 1e-3  # relative violation of physical consistency that is corrected without a warning

# Attributes of the elements of <inertial>: number of values, their minimum, and a description.
_INERTIAL = {
    "mass": (("value",), 1, 0.0, "a finite number, 0 or more [kg]"),
    "inertia": (("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), 1, -np.finfo(np.float64).max, "a finite number"),
    "origin": (("xyz", "rpy"), 3, -np.finfo(np.float64).max, "three finite numbers"),
}


class RigidBody(NamedTuple):
    """Inertial parameters of a rigid body.

    Attributes:
        mass: mass [kg].
        center: centre of mass in the frame of the body, (3,) [m].
        inertia: inertia tensor about the centre of mass, axes of the body frame, (3, 3) [kg m^2].
    """

    mass: float
    center: Array
    inertia: Array


def physically_consistent(body: RigidBody) -> tuple[RigidBody, str]:
    """Return the nearest physically consistent inertial parameters, and the corrected fault, or "".

    An inertia tensor I is physically consistent if the second moment of mass, trace(I) / 2 - I, is positive
    semidefinite: then no principal moment exceeds the sum of the other two.
    """
    if body.mass <= 0.0:
        ball = 0.4 * DEFAULT_MASS * DEFAULT_RADIUS**2 * np.eye(3)
        return RigidBody(DEFAULT_MASS, np.zeros(3), ball), "no mass"
    moments, axes = np.linalg.eigh(np.trace(body.inertia) / 2.0 * np.eye(3) - body.inertia)
    # A moment below 1e-12 of the largest could become negative due to rounding error.
    least = max(body.mass * MIN_RADIUS**2 / 5.0, 1e-12 * float(moments[2]))
    if moments[0] >= least:
        return body, ""
    second = axes * np.maximum(moments, least) @ axes.T
    rounded = moments[0] >= -INERTIA_ROUNDING * moments[2] and moments[1] > least
    inertia = np.trace(second) * np.eye(3) - second
    return RigidBody(body.mass, body.center, inertia), "" if rounded else "unphysical moments of inertia"


def read_inertials(text: str, source: str) -> dict[str, RigidBody]:
    """Return what a description gives as <inertial> of its links, by the name of the link.

    Args:
        text: the URDF.
        source: its name in error messages.

    Raises:
        URDFError: an invalid number, such as NaN or a negative mass, which Pinocchio accepts; names the link.
    """
    bodies = {}
    for link in parse_xml(text, source).findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        name = link.get("name", "")
        read: dict[str, list[float]] = {}
        for tag, (attributes, size, least, allowed) in _INERTIAL.items():
            part = inertial.find(tag)
            if part is None and tag != "origin":
                raise URDFError(source, f"link {name!r}", f"<inertial> has no <{tag}>")
            for attribute in attributes:
                value = None if part is None else part.get(attribute)
                if value is None and tag == "origin":
                    value = "0 0 0"
                try:
                    numbers = [float(piece) for piece in (value or "").split()]
                except ValueError:
                    numbers = []
                if len(numbers) != size or not all(least <= number < np.inf for number in numbers):
                    reason = f"<{tag}> {attribute} is {value!r}; allowed: {allowed}"
                    raise URDFError(source, f"link {name!r}", reason)
                read[attribute] = numbers
        moments = np.zeros((3, 3))
        moments[np.triu_indices(3)] = [read[each][0] for each in _INERTIAL["inertia"][0]]
        turn = pin.rpy.rpyToMatrix(*read["rpy"])
        moments = turn @ (moments + np.triu(moments, 1).T) @ turn.T
        bodies[name] = RigidBody(read["value"][0], np.array(read["xyz"]), moments)
    return bodies
