"""Families of cases: a kind of start and a kind of target, drawn from a seed and nothing else."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.arm.template import modules_to_urdf
from pinposture.errors import InvalidValue, UnknownName
from pinposture.placement import Target, resolve_targets
from pinposture.study.arms import gentle_curve
from pinposture.study.cases import NEARLY, arbitrary_configuration
from pinposture.thesis.arms import PLANAR, SPATIAL
from pinposture.thesis.curves import TARGET_CURVES

Array = NDArray[np.float64]

StartKind = Literal["smooth", "uniform-0.6", "uniform-1.5", "noise", "straight"]
TargetKind = Literal["helix", "line", "folded", "random", "gentle"]

STARTS: tuple[StartKind, ...] = get_args(StartKind)
UNIFORM = {"uniform-0.6": 0.6, "uniform-1.5": 1.5}
"""Largest joint position of the starts whose joints know nothing of each other [rad or sliding unit]."""

BUILT: dict[str, tuple[TargetKind, ...]] = {
    "ryrz20": ("helix", "line", "folded", "random"),
    "planar45": ("line", "folded", "random"),
}
"""The arms that are built here, and the kinds of target that each can take."""


class Subject(NamedTuple):
    """An arm under study.

    Attributes:
        name: what to call it.
        arm: the arm.
        targets: the kinds of target that it can take.
    """

    name: str
    arm: Arm
    targets: tuple[TargetKind, ...]

    @property
    def families(self) -> tuple[Family, ...]:
        """Every kind of start with every kind of target, but from straight to a line, where nothing moves."""
        pairs = (Family(start, target) for start in STARTS for target in self.targets)
        return tuple(family for family in pairs if family != ("straight", "line"))


class Family(NamedTuple):
    """Where an arm starts, and what it should become.

    Attributes:
        start: "smooth" for a posture as a relaxed arm would lie (`arbitrary_configuration`); "uniform-0.6"
            and "uniform-1.5" for independent joints within that of the straight posture, cut at the limits
            [rad or sliding unit]; "noise" for the same within 1e-3; "straight".
        target: "helix" (6.17) and "line" (6.16) of the thesis; "folded" for the straight arm folded back on
            itself by a half turn of one joint; "random" for another smooth posture; "gentle" for
            `gentle_curve`. Curves are rolled about a spatial arm by any angle.
    """

    start: StartKind
    target: TargetKind


def built_subject(name: str) -> Subject:
    """One of the arms that are built here, by name.

    "ryrz20" is the spatial arm of Section 6.1, 20 modules of two joints. "planar45" is the planar one of
    Section 6.2 with a control point at every second joint and one at the tip, 23 of them: the arm may bend
    either way between two of its points.

    Raises:
        UnknownName: there is no such arm.
    """
    if name not in BUILT:
        raise UnknownName("arm", name, BUILT)
    if name == "ryrz20":
        return Subject(name, Arm.from_modules(SPATIAL, name=name), BUILT[name])
    pairs, rest = divmod(len(PLANAR), 2)
    sizes = [2] * pairs + [1] * rest
    return Subject(name, Arm.from_urdf(modules_to_urdf(PLANAR, name), modules=sizes), BUILT[name])


def loaded_subject(arm: Arm) -> Subject:
    """Any other arm: nobody knows which curves it can take, but slight bends and its own postures it can."""
    return Subject(arm.model.name, arm, ("gentle", "random"))


def draw_case(subject: Subject, family: Family, seed: int) -> tuple[Array, Target]:
    """Start configuration and target of one seed.

    Starts and targets are drawn from streams of their own, so that one seed has the same start for every
    kind of target, and the same target for every kind of start. Each target knows its configuration.

    Args:
        subject: the arm.
        family: what kind of case.
        seed: a whole number >= 0.

    Raises:
        UnknownName: no such kind of start, or a kind of target that this arm cannot take.
        InvalidValue: a target folded back, and an arm that cannot do so.
    """
    for kind, name, allowed in (
        ("start", family.start, STARTS),
        ("target", family.target, subject.targets),
    ):
        if name not in allowed:
            raise UnknownName(f"kind of {kind}", name, allowed)
    start = _start(subject.arm, family.start, _stream(seed, "start", family.start))
    return start, _target(subject, family.target, _stream(seed, "target", family.target))


def _stream(seed: int, *names: str) -> np.random.Generator:
    """Random numbers for one purpose; those for another, from the same seed, have nothing to do with them."""
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
        # The posture counts, not the curve: an arm of few joints stays a little off it.
        placed = resolve_targets(arm, gentle_curve(arm), placement="align", roll=roll, incomplete="partial")
        return Target.from_configuration(arm, arm.neutral() if placed.q is None else placed.q)
    return resolve_targets(arm, TARGET_CURVES[subject.name, kind], placement="align", roll=roll)


def _folded(arm: Arm, rng: np.random.Generator) -> Target:
    """The straight arm with a half turn of one joint, either way.

    In half of the cases that is the first joint, so that the whole arm lies on the other side of its base;
    else it is any of those in the first half of the arm. The points lie exactly on the line of the straight
    arm: seen from there, no joint brings any of them closer, whereas the rounding of a sine would.
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
    """Whether a joint of the chain can turn that far, about an axis across the arm."""
    column, axis = arm.columns[joint], arm.chain.axes[joint]
    across = abs(axis @ (arm.chain.points[-1] - arm.chain.base)) < 1e-9 * arm.length
    inside = arm.limits.lower[column] <= turn <= arm.limits.upper[column]
    return bool(arm.chain.revolute[joint] and across and inside)
