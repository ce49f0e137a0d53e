"""Follow the leader: deviation of an arm from the path of its tip, against the path's curvature."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from types import MappingProxyType
from typing import NamedTuple

import numpy as np

from benchmarks.studies.record import run_all
from pinposture._validation import is_number, require_known
from pinposture.arm import Arm, JointSpec, ModuleTemplate, template
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, TargetError
from pinposture.motion.processes import Progress
from pinposture.task.follow_leader import PATH_METHODS, Method, follow_leader, path_deviation

MODULE, MODULES = 0.05, 20
"""Length of a module [m], and number of modules of an arm."""

FEED = ModuleTemplate("Feed", (JointSpec("x", "prismatic", 0.0, 1.2, velocity=0.1),), (MODULE,))

ARMS: Mapping[str, ModuleTemplate] = MappingProxyType(
    {
        "ryrz": template("RyRz"),
        "universal": template("RyRz").with_lengths((0.0, MODULE)),
        "hinge": template("Rz").with_lengths((MODULE,)),
    }
)
"""Modules of the arms: two crossed hinges half a module apart, two coincident ones, a single one (planar)."""

SHAPES = ("arc", "helix")
"""An arc of up to three quarters of a turn; and, for spatial arms, a helix with torsion = curvature / 2."""

BENDINGS = (0.05, 0.1, 0.2, 0.3, 0.5, 0.7, 1.0, 1.4)
"""Curvature times module length, kappa l [rad]: the turn of the path along a module."""

SHARE = 0.9
"""Largest length of a path relative to the arm, so that the first joint stays on the straight entry."""

FEED_STEP = 0.1
"""Feed between successive postures, in module lengths."""


class Following(NamedTuple):
    """Result of one arm that follows one path of constant curvature.

    Attributes:
        arm: name of the arm, one of `ARMS`.
        shape: shape of the path, one of `SHAPES`.
        bending: curvature times module length [rad].
        method: how its modules were placed, as in `follow_leader`.
        points: largest distance of a control point from the path [% of the arm length]; None if refused.
        body: largest distance of any part of the arm from the path [% of the arm length]; None if refused.
        sagitta: distance of the midpoint of a straight module from an arc through its ends [% of arm length].
        joints: largest joint position [rad]; None if refused.
        refused: why the path cannot be followed, or empty.
    """

    arm: str
    shape: str
    bending: float
    method: str
    points: float | None
    body: float | None
    sagitta: float
    joints: float | None
    refused: str = ""


def fed_arm(name: str) -> Arm:
    """Build one of `ARMS`, 1 m long, on a feed; raises UnknownName if there is no such arm."""
    require_known("arm", name, ARMS)
    return Arm.from_modules([FEED, *[ARMS[name]] * MODULES], name=name)


def bent_path(shape: str, curvature: float) -> Curve:
    """Return a path of constant curvature [1/m], nearly as long as the arm; arcs turn by at most 270 degrees.

    Raises:
        UnknownName: there is no such shape.
    """
    require_known("shape", shape, SHAPES)
    torsion = 0.5 * curvature if shape == "helix" else 0.0
    twist = float(np.hypot(curvature, torsion))  # angle about the axis by arc length [rad/m]
    radius, pitch = curvature / twist**2, 2.0 * np.pi * torsion / twist**2
    turns = SHARE * MODULE * MODULES * twist / (2.0 * np.pi)
    if shape == "arc":
        return Curve.helix(radius, 0.0, min(turns, 0.75), axis=(0, 0, 1))
    return Curve.helix(radius, pitch, turns)


def study_leader(
    arms: Sequence[str] = tuple(ARMS),
    bendings: Sequence[float] = BENDINGS,
    methods: Sequence[Method] = PATH_METHODS,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[Following]:
    """Feed arms along paths of constant curvature and measure their deviation.

    Paths begin to bend at the entry, so that the arm lies on a straight line and an arc at every depth.

    Args:
        arms: names of arms, some of `ARMS`.
        bendings: curvature times module length, each above 0, at most pi / 2 [rad].
        methods: how modules are placed, see `follow_leader`.
        jobs: number of processes; joblib's backends apply.
        progress: called with the numbers of finished and of all paths.

    Returns:
        One result for each arm, shape, method and bending, in this order. Planar arms have arcs only.

    Raises:
        InvalidValue: a bending out of range.
        UnknownName: no such arm or method.
    """
    for bending in bendings:
        if not (is_number(bending) and 0.0 < bending <= np.pi / 2.0):
            raise InvalidValue("bending", bending, "above 0, at most pi / 2 [rad]")
    for method in methods:
        require_known("method", method, PATH_METHODS)
    cases = [
        (name, shape, method, float(bending))
        for name in arms
        for shape in (SHAPES if fed_arm(name).dimension == 3 else SHAPES[:1])
        for method in methods
        for bending in bendings
    ]
    return run_all(_one, cases, jobs, progress)


def _one(name: str, shape: str, method: Method, bending: float) -> Following:
    arm, path = fed_arm(name), bent_path(shape, bending / MODULE)
    length = MODULE * MODULES
    radius = MODULE / bending
    rise = 100.0 * float(radius - np.sqrt(radius**2 - 0.25 * MODULE**2)) / length
    try:
        reference = follow_leader(arm, path, FEED_STEP * MODULE, 1.0, method=method)
    except TargetError as error:
        return Following(name, shape, bending, method, None, None, rise, None, str(error))
    q = np.array([reference.configuration(row) for row in range(reference.rows)])
    deviation = path_deviation(arm, q, path)
    joints = float(np.abs(reference.offsets[:, 1:]).max())
    points, body = deviation.percent_points, deviation.percent
    return Following(name, shape, bending, method, points, body, rise, joints)
