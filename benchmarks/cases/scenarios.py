"""The arms and scenarios of the thesis, and a study of controllers on them."""

from __future__ import annotations

import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import MappingProxyType
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from pinposture.arm import Arm, bent_configuration, smooth_configuration
from pinposture.arm.arm import link_headings
from pinposture.arm.template import ModuleTemplate, modules_to_urdf, template
from pinposture.curve import HELIX, LINE, PLANAR_LINE, Curve
from pinposture.errors import PostureError
from pinposture.placement import Target, resolve_targets
from pinposture.storage import write_text

StartKind = Literal["smooth", "near-straight", "straight"]
TargetKind = Literal["helix", "line", "near-line", "random", "opposite"]


@dataclass(frozen=True)
class Scenario:
    """A kind of start and a kind of target; a seed determines the details.

    Attributes:
        name: short name.
        title: description in words.
        section: where the thesis describes it; empty if it does not.
        start: "smooth" for an arbitrary non-singular posture, "near-straight" for a nearly singular one,
            "straight" for the singular one.
        target: "helix" (6.17), "line" (6.16), "near-line" for a nearly straight curve, "random" for an
            arbitrary non-singular posture, "opposite" for the start with all joints reversed, on the other
            side of the straight posture.
        arm: name of the arm, one of `benchmarks.cases.scenarios.ARMS`.
    """

    name: str
    title: str
    section: str
    start: StartKind
    target: TargetKind
    arm: str = "ryrz20"


SPATIAL_SCENARIOS = (
    Scenario("helix", "random -> helix", "6.1.2", "smooth", "helix"),
    Scenario("line", "random -> line", "6.1.3", "smooth", "line"),
    Scenario("from-straight", "straight -> helix", "6.1.4", "straight", "helix"),
)
"""The spatial arm; a seed gives the first two scenarios the same start, as in Section 6.1.3."""

PLANAR_SCENARIOS = (
    Scenario("planar-random", "random -> random", "6.2.1", "smooth", "random", "planar45"),
    Scenario("planar-near-line", "random -> near line", "6.2.2", "smooth", "near-line", "planar45"),
    Scenario("planar-from-straight", "straight -> random", "6.2.3", "straight", "random", "planar45"),
)
"""The planar arm; Section 6.2.4 uses the second scenario again."""

FURTHER_SCENARIOS = (
    Scenario("random", "random -> random", "", "smooth", "random"),
    Scenario("opposite", "random -> opposite", "", "smooth", "opposite"),
    Scenario("near-straight", "near-straight -> helix", "", "near-straight", "helix"),
    Scenario("planar-opposite", "random -> opposite", "", "smooth", "opposite", "planar45"),
    Scenario("planar-near-straight", "near-straight -> random", "", "near-straight", "random", "planar45"),
)
"""Cases that the thesis mentions but does not show: other targets, leaving and passing singular postures."""

SCENARIOS: Mapping[str, Scenario] = MappingProxyType(
    {scenario.name: scenario for scenario in SPATIAL_SCENARIOS + PLANAR_SCENARIOS + FURTHER_SCENARIOS}
)
"""All of the above by name."""


TARGET_CURVES: Mapping[tuple[str, str], Curve] = MappingProxyType(
    {("ryrz20", "helix"): HELIX, ("ryrz20", "line"): LINE, ("planar45", "line"): PLANAR_LINE}
)
"""The curve for each arm and each kind of target that does not depend on the seed."""


# How far the parts of an arm turn between two postures. Link headings are not defined modulo a full turn: a
# link is attached to the links before it and these to the base, so that turns add up along the arm. A link
# that must turn by more than pi cannot take the shorter direction. This is why least squares on the control
# points fail.

Array = NDArray[np.float64]


def largest_turn(arm: Arm, start: Array, goal: Array) -> float:
    """Return the largest change of heading of any part of the arm between two configurations, (nq,) [rad].

    For a planar arm, the largest change of heading of a link, full turns included. For a spatial arm, the
    largest turn of a module: the changes of orientation of successive modules differ by a small rotation, and
    the rotation vectors of these, summed along the arm from the base, give the turn of a module. For a planar
    arm this would be the change of heading at the module ends, if no single module bends by more than pi.
    """
    if arm.dimension == 2:
        turns = link_headings(arm, np.asarray(pin.difference(arm.model, start, goal)))
        return float(np.abs(turns).max())
    return float(np.linalg.norm(_module_turns(arm, start, goal), axis=1).max())


def _module_turns(arm: Arm, start: Array, goal: Array) -> Array:
    """Return the rotation vectors of the modules between two configurations, summed along the arm, (m, 3)."""
    changes = arm.at(goal).rotations @ arm.at(start).rotations.transpose(0, 2, 1)
    before = np.concatenate([np.eye(3)[None], changes[:-1]])
    turns = Rotation.from_matrix(changes @ before.transpose(0, 2, 1)).as_rotvec()
    return np.asarray(np.cumsum(turns, axis=0))


POSTURE_AMPLITUDES = (0.2, 1.0)
"""Range of the largest joint position of an arbitrary posture of a spatial arm [rad or m]."""

HEADINGS = (0.5, 1.5)
"""Range of the largest heading of a link in an arbitrary posture of a planar arm [rad]."""

SLIGHT_HEADINGS = (0.02, 0.06)
"""Range of the largest heading of a link for a nearly straight target curve [rad]."""

NEARLY = 1e-3
"""Largest joint position of a nearly straight start [rad or m]."""


def case(arm: Arm, scenario: Scenario, seed: int) -> tuple[Array, Target]:
    """Return the start configuration and the target of one seed.

    The seed determines the roll of a curve about a spatial arm, the start if it is not straight, and the
    target if it is not a fixed curve, in this order. Arbitrary postures of a spatial arm have a largest joint
    angle between 0.2 and 1.0 rad, those of a planar arm a largest heading between 0.5 and 1.5 rad.
    """
    rng = np.random.default_rng(seed)
    roll = rng.uniform(-np.pi, np.pi)
    if scenario.start == "straight":
        start = arm.straight()
    elif scenario.start == "near-straight":
        start = smooth_configuration(arm, rng, NEARLY)
    else:
        start = arbitrary_configuration(arm, rng)
    return start, _target(arm, scenario, start, roll, rng)


def arbitrary_configuration(arm: Arm, rng: np.random.Generator) -> Array:
    """Draw an arbitrary non-singular configuration, as used for the starts of scenarios; see `case`."""
    if arm.dimension == 2:
        return bent_configuration(arm, rng, rng.uniform(*HEADINGS))
    return smooth_configuration(arm, rng, rng.uniform(*POSTURE_AMPLITUDES))


def _target(arm: Arm, scenario: Scenario, start: Array, roll: float, rng: np.random.Generator) -> Target:
    if scenario.target == "opposite":
        return Target.from_configuration(arm, arm.configuration(-arm.positions(start)))
    if scenario.target in ("random", "near-line"):
        if scenario.target == "random":
            goal = arbitrary_configuration(arm, rng)
        elif arm.dimension == 2:
            goal = bent_configuration(arm, rng, rng.uniform(*SLIGHT_HEADINGS))
        else:
            goal = smooth_configuration(arm, rng, NEARLY)
        if arm.dimension == 3:  # a curve that leaves the base at an angle makes two-joint modules zigzag
            return Target.from_configuration(arm, goal)
        return resolve_targets(arm, curve_along(arm, goal), placement="as_is")
    curve = TARGET_CURVES[scenario.arm, scenario.target]
    return resolve_targets(arm, curve, placement="align", roll=roll if arm.dimension == 3 else 0.0)


def curve_along(arm: Arm, q: Array) -> Curve:
    """Return the curve through the control points at a configuration, extended straight by two modules."""
    points = np.vstack([arm.chain.base, arm.at(q).points])
    on = points[-1] + np.outer((1.0, 2.0), points[-1] - points[-2])
    return Curve.points(np.vstack([points, on]))


SPATIAL: tuple[ModuleTemplate, ...] = (template("RyRz").with_lengths((0.025, 0.025)),) * 20
"""The spatial arm of Section 6.1: 20 RyRz modules, 40 DOF, 1 m."""

PLANAR: tuple[ModuleTemplate, ...] = (template("Rz").with_lengths((0.15,)),) * 45
"""The planar arm of Section 6.2: 45 DOF, links of 15 cm, 6.75 m."""

MIXED: tuple[ModuleTemplate, ...] = (
    template("RyRz").with_lengths((0.03, 0.04)),
    template("RzRy").with_lengths((0.02, 0.035)),
) * 6
"""Two alternating kinds of modules, each with links of two lengths: 12 modules, 24 DOF, 0.75 m."""

ARMS: Mapping[str, tuple[ModuleTemplate, ...]] = MappingProxyType(
    {"ryrz20": SPATIAL, "planar45": PLANAR, "mixed12": MIXED}
)
"""The arms by name, which is also the name of the robot and, with ".urdf", of its file."""


def urdf_files() -> dict[str, str]:
    """Return the generated robot descriptions: file name -> URDF text."""
    return {f"{name}.urdf": modules_to_urdf(modules, name, "make urdf") for name, modules in ARMS.items()}


def write_urdf_files(directory: str | Path) -> list[Path]:
    """Write the robot descriptions to a directory, created if necessary, and return their paths.

    Files are replaced atomically.

    Raises:
        FileError: the directory or a file in it cannot be written.
    """
    files = {Path(directory) / name: text for name, text in urdf_files().items()}
    for path, text in files.items():
        write_text(path, text)
    return list(files)


def main(arguments: Sequence[str]) -> int:
    """Write the files to the given directory and print their paths. Returns the exit status."""
    if len(arguments) != 1 or arguments[0].startswith("-"):
        sys.stderr.write("usage: python -m benchmarks.cases DIRECTORY\n")
        return 2
    try:
        paths = write_urdf_files(arguments[0])
    except PostureError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    sys.stdout.write(f"wrote {', '.join(map(str, paths))}\n")
    return 0
