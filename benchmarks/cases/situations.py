"""Starts and targets among obstacles."""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.cases.families import built_subject
from pinposture._validation import require_known
from pinposture.arm import Arm, smooth_configuration
from pinposture.collision import Box, Capsule, CollisionModel, Cylinder, HalfSpace, Obstacle, Scene, Sphere
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

MODULES = 20
MARGIN = 0.01
"""Distance to keep from obstacles [m]."""
OWN_MARGIN = 0.005
"""Distance that parts of the arm keep from each other [m]: half of that of next neighbours but one."""

VARIATION = 0.02
"""Largest variation of a joint in the starts, or the targets, of a situation [rad]."""
DRAWS = 100
"""Maximum number of draws of a start or a target that is as clear as required."""

STAVES, PIPE, STAVE = 12, 0.1, 0.03
"""Number of capsules of a pipe, radius of their circle, and their radius [m]; they leave no gap."""


class Situation(NamedTuple):
    """Start, target and obstacles for the spatial arm of 20 modules.

    Attributes:
        name: name of the situation.
        scene: the obstacles.
        start: joint positions at the start, (40,) [rad]; each seed varies them slightly.
        goal: joint positions at the target, (40,) [rad]; varied likewise.
        start_clear: True if the arm keeps the margin at the start, False if it collides there.
        goal_clear: True if it does at the target, which is then reachable; False if it collides there.
    """

    name: str
    scene: Scene
    start: Array
    goal: Array
    start_clear: bool = True
    goal_clear: bool = True


class Draw(NamedTuple):
    """Start and target, (nq,), of one seed, and the number of draws that were not as clear as required."""

    start: Array
    goal: Array
    refused: int


def situation_arm() -> Arm:
    """Return the arm of all situations: that of Section 6.1, 1 m, with capsules of 1 cm along its links."""
    return built_subject("ryrz20").arm


def situation_named(name: str) -> Situation:
    """Return a situation by name; raises UnknownName if there is none."""
    require_known("scene", name, SITUATIONS)
    return SITUATIONS[name]


def draw_situation(arm: Arm, situation: Situation, seed: int) -> Draw:
    """Vary start and target of a situation slightly and smoothly along the arm of `situation_arm`.

    Both are drawn from one stream, the start first, each until it is as clear as the situation requires.

    Raises:
        InvalidValue: none of `DRAWS` draws is as clear as required.
    """
    rng = np.random.default_rng([seed, *situation.name.encode()])
    around = CollisionModel(arm, situation.scene)
    refused = 0

    def draw(what: str, positions: Array, clear: bool) -> Array:
        nonlocal refused
        for _ in range(DRAWS):
            change = arm.positions(smooth_configuration(arm, rng, VARIATION))
            q = arm.configuration(np.clip(positions + change, arm.limits.lower, arm.limits.upper))
            distance = around.minimum(q).distance
            if distance >= around.scene.margin if clear else distance < 0.0:
                return q
            refused += 1
        text = f"one that {'keeps the margin' if clear else 'overlaps with something'}"
        raise InvalidValue(f"{what} of {situation.name}", positions, text)

    start = draw("start", situation.start, situation.start_clear)
    goal = draw("goal", situation.goal, situation.goal_clear)
    return Draw(start, goal, refused)


def _bent(y: ArrayLike, z: ArrayLike) -> Array:
    """Return positions of the joints about y and z, given as bend per arm length, (40,) [rad]."""
    positions = np.zeros((MODULES, 2))
    positions[:, 0], positions[:, 1] = y, z
    return (positions / MODULES).ravel()


def coiled(bend: float, twist: float) -> Array:
    """Return a helix, given its bend and the twist of its bending direction per arm length, (40,) [rad]."""
    along = np.linspace(-0.5, 0.5, MODULES)
    return _bent(bend * np.sin(twist * along), bend * np.cos(twist * along))


def _pipe(first: float, last: float) -> dict[str, Obstacle]:
    """Return a pipe about the x axis between two x coordinates [m]."""
    staves: dict[str, Obstacle] = {}
    for number, angle in enumerate(2.0 * np.pi * np.arange(STAVES) / STAVES, start=1):
        across = (PIPE * np.cos(angle), PIPE * np.sin(angle))
        staves[f"stave {number}"] = Capsule((first, *across), (last, *across), STAVE)
    return staves


def _slot(width: float) -> dict[str, Obstacle]:
    """Return a wall across the x axis, too large to bypass, with a vertical slot of a given width [m]."""
    size, middle = (0.1, 1.0, 1.4), width / 2.0 + 0.5
    return {"left": Box((0.6, middle, 0.0), size), "right": Box((0.6, -middle, 0.0), size)}


def _listed() -> list[Situation]:
    along = np.linspace(0.0, 1.0, MODULES)
    # Its control points pass through the centre of the slot, slightly slanted.
    through = _bent(0.3, 3.0 * along - 0.6)
    beyond = np.where(np.arange(MODULES) < MODULES // 2, 0.0, 1.0)
    post = Cylinder((0.5, 0.35, -1.0), (0.5, 0.35, 1.0), 0.05)
    wall = HalfSpace((0.55, 0.0, 0.0), (-1.0, 0.0, 0.0))
    return [
        Situation(
            "post",
            Scene({"post": post}, self_collision=False, margin=MARGIN),
            _bent(0.0, -1.2),
            _bent(0.0, 2.4),
        ),
        Situation("slot", Scene(_slot(0.2), self_collision=False, margin=MARGIN), _bent(0.0, 2.5), through),
        Situation(
            "narrow", Scene(_slot(0.12), self_collision=False, margin=MARGIN), _bent(0.0, 2.5), through
        ),
        Situation(
            "wall",
            Scene({"wall": wall}, self_collision=False, margin=MARGIN),
            _bent(0.0, -2.0),
            _bent(0.0, 2.0),
        ),
        Situation(
            "pipe",
            Scene(_pipe(0.2, 0.5), self_collision=False, margin=MARGIN),
            _bent(0.0, -8.0 * beyond),
            _bent(0.0, 8.0 * beyond),
        ),
        Situation(
            "inside",
            Scene({"ball": Sphere((0.8, 0.3, 0.0), 0.12)}, self_collision=False, margin=MARGIN),
            _bent(0.0, -1.0),
            _bent(0.0, 0.7),
            goal_clear=False,
        ),
        Situation("coil", Scene(self_collision=True, margin=OWN_MARGIN), coiled(8.0, 2.0), coiled(8.0, -2.0)),
        Situation(
            "out",
            Scene({"ball": Sphere((0.5, 0.06, 0.0), 0.07)}, self_collision=False, margin=MARGIN),
            _bent(0.0, 0.2),
            _bent(0.0, 1.6),
            start_clear=False,
        ),
    ]


SITUATIONS: Mapping[str, Situation] = MappingProxyType({situation.name: situation for situation in _listed()})
"""The situations by name.

post: a vertical post between start and target, which the arm must go around.
slot: a wall with a vertical slot of 20 cm, which the arm must thread from a curled-up start in front of it.
narrow: the same with a slot of 12 cm.
wall: a wall close behind start and target; the straight arm would not fit in front of it.
pipe: a pipe around the middle of the arm, whose outer half must bend from one side to the other.
inside: a target inside a ball, before which the arm has to stop.
coil: only the arm itself, a helix of more than a turn that becomes its mirror image.
out: a start in collision with a ball, and a target on its other side.
"""
