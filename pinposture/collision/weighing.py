"""Masses of links to which a description gives none, from the density of their shapes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture._validation import as_number, require_instance, require_known, require_positive
from pinposture.arm import Arm
from pinposture.arm.inertias import RigidBody
from pinposture.arm.kinematics import frame_ids
from pinposture.arm.weight import Load, find_frame, rod_body
from pinposture.collision.bodies import described_bodies
from pinposture.collision.solids import Solid
from pinposture.errors import InvalidValue, WeightUnknown

Array = NDArray[np.float64]

_TRIANGLE = ((0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2))
"""Rows and columns of the moments of a `Load`: xx, yy, zz, xy, xz, yz."""


def weigh(arm: Arm, density: float | None = None, masses: Mapping[str, float] | None = None) -> Arm:
    """Return an arm with masses for the links to which its description gives none.

    The masses that the description gives stay as they are. Parts that are fixed to a link with mass may go
    without. Shapes are those of <collision>, or of <visual> for a link without these; a mesh counts as its
    convex hull, and what two shapes share counts twice.

        arm = pp.weigh(pp.Arm.load("snake.urdf"), density=1200.0)
        arm = pp.weigh(pp.Arm.load("snake.urdf"), density=1200.0, masses={"camera": 0.08, "marker": 0.0})

    Args:
        arm: the arm.
        density: density of the shapes of links without mass [kg/m^3]; None: `masses` names all of them.
        masses: masses of some of these links [kg]; 0 for one that weighs nothing. A mass is spread over the
            shapes of its link, or without any along the line from the link to the next joint.

    Returns:
        The arm. `arm.weight.masses` lists what was found, `arm.weight.density` tells from which density.

    Raises:
        UnknownName: a link has a mass, or no joint moves it, or it does not exist.
        InvalidValue: a density that is not positive, or a negative mass.
        WeightUnknown: links without a mass and without shapes that can be read; names them.
    """
    require_instance("arm", arm, Arm, "an Arm")
    if density is not None:
        density = require_positive("density", density)
    if not isinstance(masses, Mapping | None):
        raise InvalidValue("masses", masses, "a mapping from names of links to masses [kg], or None")
    lacking = arm.links_without_mass
    known: dict[str, float] = {}
    for name, value in (masses or {}).items():
        require_known("link without a mass", name, lacking)
        known[name] = as_number(f"masses[{name!r}]", value, "a finite number >= 0 [kg]", lambda x: x >= 0.0)
    solids, faults = _solids(arm, lacking)
    added = []
    unknown: list[str] = []
    for name in lacking:
        mass = known.get(name)
        solid = solids.get(name)
        if mass is None and density is not None and solid is not None:
            added.append(_load(name, solid, density))
        elif mass is None:
            unknown.append(name)
        elif mass == 0.0:
            added.append(Load(0.0, frame=name))
        elif solid is not None:
            added.append(_load(name, solid, mass / solid.mass))
        else:
            added.append(_rod(arm, name, mass))
    weight = replace(arm.weight, masses=(*arm.weight.masses, *added), density=density)
    weighed = arm.with_weight(weight)
    unknown = [name for name in unknown if name not in weighed.parts_without_mass]
    if unknown:
        reasons = "; ".join(faults[name] for name in unknown if name in faults)
        remedy = "give a density, or their masses" if density is None else "they have no shapes: give masses"
        raise WeightUnknown("mass", unknown, f"{remedy}{f' ({reasons})' if reasons else ''}")
    return weighed


def _solids(arm: Arm, links: tuple[str, ...]) -> tuple[dict[str, pin.Inertia], dict[str, str]]:
    """Return the inertias of links of density 1, in their own frames, and why shapes cannot be read."""
    inertias: dict[str, pin.Inertia] = {}
    faults: dict[str, str] = {}
    if not links or arm.urdf is None:
        return inertias, faults
    for tag in ("collision", "visual"):
        bodies, unread = described_bodies(arm, tag, [name for name in links if name not in inertias])
        here: dict[str, pin.Inertia] = {}
        for body in bodies:
            solid = find_frame(arm.model, body.name).placement.actInv(solid_inertia(body.shape.solid()))
            here[body.name] = here[body.name] + solid if body.name in here else solid
        broken = {name: f"link {name!r}: {reason}" for name, _, reason in unread}
        faults |= broken
        inertias |= {name: solid for name, solid in here.items() if solid.mass > 0.0 and name not in broken}
    return inertias, faults


def solid_inertia(solid: Solid) -> pin.Inertia:
    """Return the inertia of a convex solid of density 1, in the frame of its coordinates."""
    geometry: Any = solid.shape
    body = RigidBody(
        float(geometry.computeVolume()),
        np.ravel(geometry.computeCOM()),
        np.array(geometry.computeMomentofInertiaRelatedToCOM()),
    )
    return pin.SE3(solid.rotation, solid.position).act(body.spatial)


def _load(name: str, solid: pin.Inertia, density: float) -> Load:
    moments = density * np.asarray(solid.inertia)[_TRIANGLE]
    return Load(density * solid.mass, tuple(solid.lever), name, tuple(moments))


def _rod(arm: Arm, name: str, mass: float) -> Load:
    """Return a mass along the line from a link without shapes to what follows it."""
    start = find_frame(arm.model, name)
    ends = [
        arm.model.jointPlacements[joint].translation
        for joint in range(1, arm.model.njoints)
        if arm.model.parents[joint] == start.parentJoint
    ]
    points = (arm.model.frames[index] for index in frame_ids(arm.model, arm.control_points))
    ends += [point.placement.translation for point in points if point.parentJoint == start.parentJoint]
    local = [start.placement.actInv(np.array(end)) for end in ends]
    far = max(local, key=lambda end: float(np.linalg.norm(end)), default=np.zeros(3))
    length = float(np.linalg.norm(far))
    body = rod_body(mass / length, np.zeros(3), far) if length > 0.0 else None
    if body is None:
        return Load(mass, frame=name)
    return Load(mass, tuple(body.center), name, tuple(body.inertia[_TRIANGLE]))
