"""Runs among obstacles: situations, records of runs, and the study."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from itertools import product
from time import perf_counter
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from benchmarks.studies.arms import built_subject
from benchmarks.studies.record import (
    RISE,
    TOLERANCE,
    Spread,
    check_study,
    distinct,
    drive,
    final_error,
    grouped,
    one_line,
    run_all,
)
from pinposture._validation import require_known
from pinposture.arm import Arm, smooth_configuration
from pinposture.collision import Box, Capsule, CollisionModel, Cylinder, HalfSpace, Obstacle, Scene, Sphere
from pinposture.errors import InvalidValue
from pinposture.motion import Trajectory
from pinposture.motion.processes import Progress
from pinposture.placement import Target

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


SITUATIONS: Mapping[str, Situation] = MappingProxyType({each.name: each for each in _listed()})
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


SAMPLES_OF_A_STEP = 10
"""Number of places on each step at which the distance is evaluated, including its end."""

DISTANCE_ROUNDING = 1e-9
"""Violation of the margin that counts as rounding error [m]."""


class SceneRun(NamedTuple):
    """Record of one run among obstacles.

    Attributes:
        scene: name of the situation.
        seed: seed of the case.
        refused: number of starts and targets rejected as not clear enough.
        reachable: whether the target configuration keeps the margin.
        status: how the run ended, as `Trajectory.status`.
        reason: explanation of the status on one line.
        blamed: obstacles, or bodies of the arm, named in the reason, separated by commas.
        steps: number of steps.
        error: mean point error at the end, relative to the arm length.
        margin: the distance to keep [m].
        start: smallest distance at the start [m]; like the following, negative in penetration.
        closest: smallest distance at the start and at `SAMPLES_OF_A_STEP` places of every step [m].
        end: smallest distance at the end [m].
        loss: largest amount by which the distance within a step fell below the smaller of the margin and the
            distance before the step [m]; 0 if it never did.
        path: path length of all control points relative to straight lines from start to end.
        escaping: share of steps in which the controller lets the posture error rise.
        seconds: wall time of the run [s].
    """

    scene: str
    seed: int
    refused: int
    reachable: bool
    status: str
    reason: str
    blamed: str
    steps: int
    error: float
    margin: float
    start: float
    closest: float
    end: float
    loss: float
    path: float
    escaping: float
    seconds: float

    @property
    def reached(self) -> bool:
        """Whether the mean point error is within `record.TOLERANCE`."""
        return self.error <= TOLERANCE * (1.0 + RISE)

    @property
    def kept(self) -> bool:
        """Whether the margin was kept; after a start in collision, once the arm was out.

        Such an arm must come out, and must not go deeper before that.
        """
        return self.loss <= DISTANCE_ROUNDING and self.end >= self.margin - DISTANCE_ROUNDING

    @property
    def explained(self) -> bool:
        """Whether the target was reached, or the reason names the obstacle."""
        return self.reached or bool(self.blamed)

    @property
    def as_it_should(self) -> bool:
        """Whether the margin was kept, and the target reached if possible, otherwise with a reason."""
        return self.kept and self.explained and self.reached == self.reachable


def record_scene_run(
    run: Trajectory, situation: Situation, seed: int, refused: int = 0, seconds: float = 0.0
) -> SceneRun:
    """Create the record of a run, given the number of rejected draws and the wall time [s].

    Distances are computed again, independently of the run.
    """
    around, margin = CollisionModel(run.arm, situation.scene), situation.scene.margin
    at = np.array([around.minimum(q).distance for q in run.q])
    ways = zip(run.q[:-1], run.displacements, strict=True)
    shares = np.arange(1, SAMPLES_OF_A_STEP + 1)[:, None] / SAMPLES_OF_A_STEP
    between = np.array([around.minimum_along(run.arm.checked(q), shares * dq).distance for q, dq in ways])
    lost = np.minimum(at[:-1], margin) - between
    return SceneRun(
        scene=situation.name,
        seed=seed,
        refused=refused,
        reachable=situation.goal_clear,
        status=run.status,
        reason=one_line(run.reason),
        blamed=", ".join(blamed(run.reason, situation.scene, around.bodies)),
        steps=run.steps,
        error=final_error(run),
        margin=margin,
        start=float(at[0]),
        closest=float(min(at[0], between.min(initial=np.inf))),
        end=float(at[-1]),
        loss=float(lost.max(initial=0.0)),
        path=run.path_length_ratio,
        escaping=float(run.error_increasing.mean()) if run.steps else 0.0,
        seconds=seconds,
    )


def blamed(reason: str, scene: Scene, bodies: Sequence[str]) -> list[str]:
    """Return the obstacles, and with self-collision the bodies, named in a text."""
    names = [*scene.obstacles, *(bodies if scene.self_collision else ())]
    return [name for name in distinct(names) if re.search(rf"(?<!\w){re.escape(name)}(?!\w)", reason)]


SEEDS = 10
"""Default number of runs for each situation."""


class SceneRow(NamedTuple):
    """Summary of all runs of a situation.

    Attributes:
        scene: name of the situation.
        runs: number of runs.
        refused: number of starts and targets rejected as not clear enough.
        reachable: number of reachable targets.
        reached: number of reached targets.
        kept: number of runs that kept the margin, see `SceneRun.kept`.
        unexplained: number of runs that did not reach the target and named no obstacle.
        room: smallest distance of any run minus the margin [m].
        loss: largest `SceneRun.loss` of any run [m].
        steps, path, escaping, seconds: those of `SceneRun`.
    """

    scene: str
    runs: int
    refused: int
    reachable: int
    reached: int
    kept: int
    unexplained: int
    room: float
    loss: float
    steps: Spread
    path: Spread
    escaping: Spread
    seconds: Spread


def study_scenes(
    scenes: Sequence[str] = tuple(SITUATIONS),
    seeds: int = SEEDS,
    first_seed: int = 0,
    jobs: int = 1,
    progress: Progress | None = None,
) -> list[SceneRun]:
    """Run the spatial arm of 20 modules among obstacles, with the controller that can avoid them.

    |dq| <= 0.1 rad per step, at most 400 steps, until the mean point error is within 1e-6 of the arm length.

    Args:
        scenes: names of situations, see `SITUATIONS`.
        seeds: number of runs for each.
        first_seed: seed of the first.
        jobs: number of processes; joblib's backends apply.
        progress: called with the numbers of finished and of all runs.

    Returns:
        The runs in the order of situations, then seeds; apart from `seconds`, independent of `jobs`.

    Raises:
        InvalidValue: no scene, or invalid numbers.
        UnknownName: there is no such scene.
    """
    check_study(first_seed, seeds=seeds, scenes=scenes)
    arm, names = situation_arm(), [situation_named(name).name for name in scenes]
    cases = product([arm], names, range(first_seed, first_seed + seeds))
    return run_all(_one, cases, jobs, progress)


def _one(arm: Arm, name: str, seed: int) -> SceneRun:
    situation = situation_named(name)
    draw = draw_situation(arm, situation, seed)
    target = Target.from_configuration(arm, draw.goal)
    began = perf_counter()
    run = drive(arm, target, draw.start, scene=situation.scene)
    return record_scene_run(run, situation, seed, draw.refused, perf_counter() - began)


def by_scene(runs: Sequence[SceneRun]) -> list[SceneRow]:
    """Summarise runs by situation, in order of first appearance."""
    spreads = ("steps", "path", "escaping", "seconds")
    return [
        SceneRow(
            scene=scene,
            runs=len(own),
            refused=sum(run.refused for run in own),
            reachable=sum(run.reachable for run in own),
            reached=sum(run.reached for run in own),
            kept=sum(run.kept for run in own),
            unexplained=sum(not run.explained for run in own),
            room=min(run.closest - run.margin for run in own),
            loss=max(run.loss for run in own),
            **{name: Spread.of([getattr(run, name) for run in own]) for name in spreads},
        )
        for scene, own in grouped(runs, lambda run: run.scene).items()
    ]
