"""How links of a description weigh, and what is done where it cannot be so.

A physics engine needs every body that moves to have a mass and an inertia that some solid could have. Files
often leave them out, or hold numbers of no solid. Nothing is settled silently: each change is a warning.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.errors import URDFError

Array = NDArray[np.float64]

STAND_IN_MASS, STAND_IN_RADIUS = 1e-3, 1e-2
"""The ball that stands in for a moving link without mass: 1 g, radius 1 cm, at its joint [kg], [m]."""

SMALLEST_RADIUS = 1e-4
"""A link is not more slender, about its centre of mass, than a ball of its mass and this radius [m]."""

ROUNDING = 1e-3
"""Share of the largest spread of mass by which rounded numbers of a file may be off without a word."""


class Body(NamedTuple):
    """Mass of a rigid body in the frame of its first link.

    Attributes:
        mass: mass [kg].
        center: centre of mass, (3,) [m].
        inertia: moments about the centre of mass, axes parallel to the frame, (3, 3) [kg m^2].
    """

    mass: float
    center: Array
    inertia: Array


NOTHING = Body(0.0, np.zeros(3), np.zeros((3, 3)))


def read_inertia(link: Element, source: str) -> Body:
    """What <inertial> of a link says, in the frame of the link; nothing if there is none.

    Raises:
        URDFError: a number that is missing, or is none.
    """
    inertial = link.find("inertial")
    if inertial is None:
        return NOTHING
    name = f"link {link.get('name')!r}"
    mass = _numbers(inertial, "mass", ("value",), source, name)[0]
    if mass < 0.0:
        raise URDFError(source, name, f"<mass> value is {mass:g}; allowed: 0 or more [kg]")
    xx, xy, xz, yy, yz, zz = _numbers(
        inertial, "inertia", ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), source, name
    )
    moments = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    placement = pin.SE3.Identity()
    origin = inertial.find("origin")
    if origin is not None:
        placement.translation = np.array(_vector(origin, "xyz", source, name))
        placement.rotation = pin.rpy.rpyToMatrix(*_vector(origin, "rpy", source, name))
    turn = placement.rotation
    return Body(mass, np.array(placement.translation), turn @ moments @ turn.T)


def together(bodies: Sequence[tuple[pin.SE3, Body]]) -> Body:
    """Several bodies that are fixed to each other, each in a frame of its own, as one."""
    placed = [
        (body.mass, where.act(body.center), where.rotation @ body.inertia @ where.rotation.T)
        for where, body in bodies
    ]
    mass = sum(part for part, _, _ in placed)
    if mass <= 0.0:
        return Body(0.0, np.zeros(3), sum((moments for _, _, moments in placed), np.zeros((3, 3))))
    center = sum((part * at for part, at, _ in placed), np.zeros(3)) / mass
    total = np.zeros((3, 3))
    for part, at, moments in placed:
        arm = at - center
        total += moments + part * (arm @ arm * np.eye(3) - np.outer(arm, arm))
    return Body(mass, center, total)


def settled(body: Body) -> tuple[Body, str]:
    """A body as near to that one as a solid can be, and what was changed; "" if nothing.

    Moments of inertia belong to a solid if the spread of its mass, trace(I) / 2 - I, has no negative
    eigenvalue: no moment is then larger than the sum of the other two.
    """
    if body.mass <= 0.0:
        ball = 0.4 * STAND_IN_MASS * STAND_IN_RADIUS**2 * np.eye(3)
        return Body(STAND_IN_MASS, np.zeros(3), ball), "no mass"
    spread, axes = np.linalg.eigh(np.trace(body.inertia) / 2.0 * np.eye(3) - body.inertia)
    # Less than 1e-12 of the largest could come out negative by rounding.
    least = max(body.mass * SMALLEST_RADIUS**2 / 5.0, 1e-12 * float(spread[2]))
    if spread[0] >= least:
        return body, ""
    repaired = np.maximum(spread, least)
    spreads = axes * repaired @ axes.T
    changed = "" if spread[0] >= -ROUNDING * spread[2] and spread[1] > least else "moments of no solid"
    return Body(body.mass, body.center, np.trace(spreads) * np.eye(3) - spreads), changed


def _numbers(
    inertial: Element, tag: str, names: tuple[str, ...], source: str, link: str
) -> tuple[float, ...]:
    part = inertial.find(tag)
    if part is None:
        raise URDFError(source, link, f"<inertial> has no <{tag}>")
    return tuple(_number(part.get(name), f"<{tag}> {name}", source, link) for name in names)


def _vector(origin: Element, attribute: str, source: str, link: str) -> list[float]:
    text = origin.get(attribute)
    pieces = ["0", "0", "0"] if text is None else text.split()
    if len(pieces) != 3:
        raise URDFError(source, link, f"<origin> {attribute} is {text!r}; allowed: three numbers")
    return [_number(piece, f"<origin> {attribute}", source, link) for piece in pieces]


def _number(text: str | None, what: str, source: str, link: str) -> float:
    try:
        number = float(text) if text is not None else np.nan
    except ValueError:
        number = np.nan
    if not np.isfinite(number):
        raise URDFError(source, link, f"{what} is {text!r}; allowed: a finite number")
    return number
