"""Families of cases: a kind of start and a kind of target, determined by a seed alone."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from benchmarks.cases.scenarios import NEARLY, PLANAR, SPATIAL, TARGET_CURVES, arbitrary_configuration
from pinposture._validation import require_known
from pinposture.arm import Arm
from pinposture.arm.template import modules_to_urdf
from pinposture.curve import Curve
from pinposture.errors import InvalidValue
from pinposture.placement import Target, resolve_targets

Array = NDArray[np.float64]

StartKind = Literal["smooth", "uniform-0.6", "uniform-1.5", "noise", "straight"]
TargetKind = Literal["helix", "line", "folded", "random", "gentle"]

START_KINDS: tuple[StartKind, ...] = get_args(StartKind)
UNIFORM = {"uniform-0.6": 0.6, "uniform-1.5": 1.5}
"""Largest joint position of starts with independent joints [rad or sliding unit]."""

BUILT: dict[str, tuple[TargetKind, ...]] = {
    "ryrz20": ("helix", "line", "folded", "random"),
    "planar45": ("line", "folded", "random"),
}
"""The built-in arms, and the kinds of target that each can take."""


class Subject(NamedTuple):
    """An arm under study.

    Attributes:
        name: name of the arm.
        arm: the arm.
        targets: the kinds of target it can take.
    """

    name: str
    arm: Arm
    targets: tuple[TargetKind, ...]

    @property
    def families(self) -> tuple[Family, ...]:
        """All combinations of starts and targets except straight to a line, where nothing moves."""
        pairs = (Family(start, target) for start in START_KINDS for target in self.targets)
        return tuple(family for family in pairs if family != ("straight", "line"))


class Family(NamedTuple):
    """A kind of start and a kind of target.

    Attributes:
        start: "smooth" for a posture like that of an arm at rest (`arbitrary_configuration`); "uniform-0.6"
            and "uniform-1.5" for independent joints within that distance of the straight posture, clipped to
            the limits [rad or sliding unit]; "noise" for the same within 1e-3; "straight".
        target: "helix" (6.17) and "line" (6.16) of the thesis; "folded" for the straight arm folded back by a
            half turn of one joint; "random" for another smooth posture; "gentle" for `gentle_curve`. For a
            spatial arm, curves are rolled by a random angle.
    """

    start: StartKind
    target: TargetKind


def built_subject(name: str) -> Subject:
    """Return a built-in arm by name.

    "ryrz20" is the spatial arm of Section 6.1, 20 modules of two joints. "planar45" is the planar one of
    Section 6.2 with 23 control points, at every second joint and at the tip: the arm may bend either way
    between two of its points.

    Raises:
        UnknownName: there is no such arm.
    """
    require_known("arm", name, BUILT)
    if name == "ryrz20":
        return Subject(name, Arm.from_modules(SPATIAL, name=name), BUILT[name])
    pairs, rest = divmod(len(PLANAR), 2)
    sizes = [2] * pairs + [1] * rest
    return Subject(name, Arm.load(modules_to_urdf(PLANAR, name), split=sizes), BUILT[name])


def loaded_subject(arm: Arm) -> Subject:
    """Return the subject of any other arm, which can take slight bends and its own postures."""
    return Subject(arm.model.name, arm, ("gentle", "random"))


def draw_case(subject: Subject, family: Family, seed: int) -> tuple[Array, Target]:
    """Return the start configuration and the target of a seed, a whole number >= 0.

    Starts and targets are drawn from separate streams, so that a seed has the same start for every kind of
    target, and the same target for every kind of start. Each target includes its configuration.

    Raises:
        UnknownName: no such kind of start, or a kind of target that this arm cannot take.
        InvalidValue: a "folded" target for an arm that cannot fold back.
    """
    require_known("kind of start", family.start, START_KINDS)
    require_known("kind of target", family.target, subject.targets)
    start = _start(subject.arm, family.start, _stream(seed, "start", family.start))
    return start, _target(subject, family.target, _stream(seed, "target", family.target))


def _stream(seed: int, *names: str) -> np.random.Generator:
    """Return a random generator for one purpose, independent of those for others with the same seed."""
    return np.random.default_rng([seed, *" ".join(names).encode()])


def _start(arm: Arm, kind: StartKind, rng: np.random.Generator) -> Array:
    if kind == "straight":
        return arm.straight()
    if kind == "smooth":
        return arbitrary_configuration(arm, rng)
    width = NEARLY if kind == "noise" else UNIFORM[kind]
    positions = arm.positions(arm.straight())
    on_chain = np.zeros(arm.nv)
    on_chain[arm.columns] = arm.joint_units[arm.columns]
    positions = positions + on_chain * rng.uniform(-width, width, arm.nv)
    return arm.configuration(np.clip(positions, arm.limits.lower, arm.limits.upper))


def _target(subject: Subject, kind: TargetKind, rng: np.random.Generator) -> Target:
    arm = subject.arm
    roll = float(rng.uniform(-np.pi, np.pi)) if arm.dimension == 3 else 0.0
    if kind == "folded":
        return _folded(arm, rng)
    if kind == "random":
        return Target.from_configuration(arm, arbitrary_configuration(arm, rng))
    if kind == "gentle":
        # Use the posture, not the curve: an arm with few joints stays slightly off it.
        placed = resolve_targets(arm, gentle_curve(arm), placement="align", roll=roll, incomplete="partial")
        return Target.from_configuration(arm, arm.neutral() if placed.q is None else placed.q)
    return resolve_targets(arm, TARGET_CURVES[subject.name, kind], placement="align", roll=roll)


def _folded(arm: Arm, rng: np.random.Generator) -> Target:
    """Return the straight arm with a half turn of one joint, in either direction.

    In half of the cases this is the first joint, so that the whole arm lies on the other side of its base;
    else it is any joint in the first half of the arm. The points lie exactly on the line of the straight arm,
    from which no joint reduces an error to first order; rounding errors of a sine would break this.
    """
    half = range(max(len(arm.columns) // 2, 1))
    ways = [(joint, turn) for joint in half for turn in (-np.pi, np.pi) if _can_fold(arm, joint, turn)]
    if np.any(arm.straight() != arm.neutral()) or not ways:
        raise InvalidValue("arm", arm, "an arm that is straight at zero, with a joint there that turns by pi")
    first = [way for way in ways if way[0] == ways[0][0]]
    choice = first if rng.random() < 0.5 else ways
    joint, turn = choice[int(rng.integers(len(choice)))]
    column, points = arm.columns[joint], arm.at(arm.straight()).points
    moved = arm.support[:, column, None] > 0.0  # (m, 1)
    positions = np.zeros(arm.nv)
    positions[column] = turn
    folded = np.where(moved, 2.0 * arm.chain.origins[joint] - points, points)
    return replace(Target.from_points(arm, folded), q=arm.configuration(positions))


def _can_fold(arm: Arm, joint: int, turn: float) -> bool:
    """Return whether a joint of the chain can turn that far, about an axis perpendicular to the arm."""
    column, axis = arm.columns[joint], arm.chain.axes[joint]
    across = abs(axis @ (arm.chain.points[-1] - arm.chain.base)) < 1e-9 * arm.length
    inside = arm.limits.lower[column] <= turn <= arm.limits.upper[column]
    return bool(arm.chain.revolute[joint] and across and inside)


def gentle_curve(arm: Arm) -> Curve:
    """Return a curve that such an arm should be able to follow: two slight bends, flat if planar."""
    points = np.array([(0, 0, 0), (0.3, 0, 0), (0.6, 0.04, 0.03), (0.9, 0.12, 0.03), (1.3, 0.15, 0)])
    return Curve.spline(arm.length * points * ((1, 1, 0) if arm.dimension == 2 else 1))
