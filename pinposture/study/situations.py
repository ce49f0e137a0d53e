"""Arms among obstacles: what is in the way, where the arm starts, and what it should become."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pinposture.arm import Arm
from pinposture.collision import Box, Capsule, CollisionModel, Cylinder, HalfSpace, Obstacle, Scene, Sphere
from pinposture.errors import InvalidValue, UnknownName
from pinposture.study.cases import smooth_configuration
from pinposture.study.families import built_subject

Array = NDArray[np.float64]

MODULES = 20
MARGIN = 0.01
"""Distance to keep from obstacles [m]."""
OWN_MARGIN = 0.005
"""Distance that parts of the arm keep from each other [m]: half of that of next neighbours but one."""

AMPLITUDE = 0.02
"""Largest change of a joint between the starts, or the targets, of two seeds of a situation [rad]."""
DRAWS = 100
"""How many starts, or targets, are drawn until one is as clear as the situation says."""

STAVES, PIPE, STAVE = 12, 0.1, 0.03
"""A pipe is made of that many capsules on a circle of this radius, so thick [m]: they leave no gap."""


class Situation(NamedTuple):
    """Where the spatial arm of 20 modules starts, what it should become, and what is in the way.

    Attributes:
        name: what to call it.
        scene: what to keep clear of.
        start: joint positions to start from, (40,) [rad]; each seed varies them a little.
        goal: joint positions that take the target, (40,) [rad]; likewise.
        start_clear: whether the arm keeps the margin at the start; else it overlaps with something there.
        goal_clear: whether it does at the target, so that this can be reached; else it overlaps there.
    """

    name: str
    scene: Scene
    start: Array
    goal: Array
    start_clear: bool = True
    goal_clear: bool = True


class Draw(NamedTuple):
    """Start and target of one seed.

    Attributes:
        start: configuration, (nq,).
        goal: configuration that takes the target, (nq,).
        refused: how many starts and targets were drawn before that were not as clear as they should be.
    """

    start: Array
    goal: Array
    refused: int


def situation_arm() -> Arm:
    """The arm of all situations: that of Section 6.1, 1 m, with capsules of 1 cm along its links."""
    return built_subject("ryrz20").arm


def situation_named(name: str) -> Situation:
    """The situation of that name; raises UnknownName if there is none."""
    if name not in SITUATIONS:
        raise UnknownName("scene", name, SITUATIONS)
    return SITUATIONS[name]


def draw_situation(arm: Arm, situation: Situation, seed: int) -> Draw:
    """Vary start and target of a situation a little, smoothly along the arm.

    Both are drawn from one stream, the start first, each until it is as clear as the situation says.

    Args:
        arm: what `situation_arm` returns.
        situation: the situation.
        seed: a whole number >= 0.

    Raises:
        InvalidValue: none of `DRAWS` draws is as clear as it should be.
    """
    rng = np.random.default_rng([seed, *situation.name.encode()])
    around = CollisionModel(arm, situation.scene)
    found, refused = [], 0
    for what, positions, clear in (
        ("start", situation.start, situation.start_clear),
        ("goal", situation.goal, situation.goal_clear),
    ):
        for _ in range(DRAWS):
            change = arm.positions(smooth_configuration(arm, rng, AMPLITUDE))
            q = arm.configuration(np.clip(positions + change, arm.limits.lower, arm.limits.upper))
            if _as_clear(around, q, clear):
                break
            refused += 1
        else:
            text = f"one that {'keeps the margin' if clear else 'overlaps with something'}"
            raise InvalidValue(f"{what} of {situation.name}", positions, text)
        found.append(q)
    return Draw(found[0], found[1], refused)


def _as_clear(around: CollisionModel, q: Array, clear: bool) -> bool:
    distance = around.minimum(q).distance
    return distance >= around.scene.margin if clear else distance < 0.0


def _bent(y: ArrayLike, z: ArrayLike) -> Array:
    """Positions of the joints about y and about z, given as bend per arm length, (40,) [rad]."""
    positions = np.zeros((MODULES, 2))
    positions[:, 0], positions[:, 1] = y, z
    return (positions / MODULES).ravel()


def _coil(bend: float, twist: float) -> Array:
    """A helix, by its bend and the turn of the direction of bending, both per arm length, (40,) [rad]."""
    along = np.linspace(-0.5, 0.5, MODULES)
    return _bent(bend * np.sin(twist * along), bend * np.cos(twist * along))


def _pipe(first: float, last: float) -> dict[str, Obstacle]:
    """A pipe about the x axis, from one place on it to another [m]."""
    staves: dict[str, Obstacle] = {}
    for number in range(STAVES):
        angle = 2.0 * np.pi * number / STAVES
        across = (PIPE * np.cos(angle), PIPE * np.sin(angle))
        staves[f"stave {number + 1}"] = Capsule((first, *across), (last, *across), STAVE)
    return staves


def _slot(width: float) -> dict[str, Obstacle]:
    """A wall across the x axis, too high to go over and too wide to go round, with an upright slot [m]."""
    size, middle = (0.1, 1.0, 1.4), width / 2.0 + 0.5
    return {"left": Box((0.6, middle, 0.0), size), "right": Box((0.6, -middle, 0.0), size)}


def _listed() -> list[Situation]:
    along = np.linspace(0.0, 1.0, MODULES)
    # Its control points pass the middle of the wall in the middle of the slot, slightly aslant.
    through = _bent(0.3, 3.0 * along - 0.6)
    beyond = np.where(np.arange(MODULES) < MODULES // 2, 0.0, 1.0)
    post = Cylinder((0.5, 0.35, -1.0), (0.5, 0.35, 1.0), 0.05)
    wall = HalfSpace((0.55, 0.0, 0.0), (-1.0, 0.0, 0.0))
    return [
        Situation("post", Scene({"post": post}, margin=MARGIN), _bent(0.0, -1.2), _bent(0.0, 2.4)),
        Situation("slot", Scene(_slot(0.2), margin=MARGIN), _bent(0.0, 2.5), through),
        Situation("narrow", Scene(_slot(0.12), margin=MARGIN), _bent(0.0, 2.5), through),
        Situation("wall", Scene({"wall": wall}, margin=MARGIN), _bent(0.0, -2.0), _bent(0.0, 2.0)),
        Situation(
            "pipe", Scene(_pipe(0.2, 0.5), margin=MARGIN), _bent(0.0, -8.0 * beyond), _bent(0.0, 8.0 * beyond)
        ),
        Situation(
            "inside",
            Scene({"ball": Sphere((0.8, 0.3, 0.0), 0.12)}, margin=MARGIN),
            _bent(0.0, -1.0),
            _bent(0.0, 0.7),
            goal_clear=False,
        ),
        Situation("coil", Scene(self_collision=True, margin=OWN_MARGIN), _coil(8.0, 2.0), _coil(8.0, -2.0)),
        Situation(
            "out",
            Scene({"ball": Sphere((0.5, 0.06, 0.0), 0.07)}, margin=MARGIN),
            _bent(0.0, 0.2),
            _bent(0.0, 1.6),
            start_clear=False,
        ),
    ]


SITUATIONS: Mapping[str, Situation] = MappingProxyType({each.name: each for each in _listed()})
"""The situations by name.

post: an upright post between start and target, which the arm must go round.
slot: a wall with an upright slot of 20 cm, which the arm must thread, starting curled up before it.
narrow: the same with a slot of 12 cm.
wall: a wall close behind start and target; the straight arm would not fit before it.
pipe: a pipe round the middle of the arm, the rest of which is to hook back beside it, on the other side.
inside: a target inside a ball, before which the arm has to stop.
coil: nothing but the arm itself, a helix of more than a turn that becomes its mirror image.
out: a start that overlaps with a ball, and a target on the other side of it.
"""
