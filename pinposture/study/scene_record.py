"""What is kept of one run among obstacles."""

from __future__ import annotations

import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from pinposture.collision import CollisionModel, Scene
from pinposture.motion import Trajectory
from pinposture.study.record import RISE, TOLERANCE
from pinposture.study.reproduce.measures import displacements
from pinposture.study.situations import Situation
from pinposture.study.table import distinct

SAMPLES = 10
"""Places on each step at which the distance is looked up, its end among them."""

ROUNDING = 1e-9
"""How much closer than the margin counts as rounding [m]."""


class SceneRun(NamedTuple):
    """One run among obstacles.

    Attributes:
        scene: name of the situation.
        seed: seed of the case.
        refused: how many starts and targets were drawn that were not as clear as they should be.
        reachable: whether the configuration that takes the target keeps the margin.
        status: how the run ended, as `Trajectory.status`.
        reason: why, in words, on one line.
        blamed: obstacles, or bodies of the arm, that the reason names, separated by commas.
        steps: number of steps.
        error: mean point error at the end, relative to the arm length.
        margin: the distance to keep [m].
        start: smallest distance at the start [m]; negative in penetration, as the following.
        closest: smallest distance at the start and at `SAMPLES` places of every step [m].
        end: smallest distance at the end [m].
        loss: how much closer, within a step, the arm came than the margin, or than it was before the step
            where that was closer still [m]; the most of all steps, 0 if it never did.
        path: length of the paths of all control points relative to the direct distances from start to end.
        escaping: share of steps that were flagged as an escape.
        seconds: time of the run, with whatever else the machine did [s].
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
        """Whether the margin was kept all the way; from a start in collision: from when the arm was out.

        Such an arm must come out, and must not go deeper before it has.
        """
        return self.loss <= ROUNDING and self.end >= self.margin - ROUNDING

    @property
    def explained(self) -> bool:
        """Whether it got there, or the reason names what it came too close to."""
        return self.reached or bool(self.blamed)

    @property
    def as_it_should(self) -> bool:
        """Whether the margin was kept, and the target reached if it could be; else the reason says why."""
        return self.kept and self.explained and self.reached == self.reachable


def record_scene_run(
    run: Trajectory, situation: Situation, seed: int, refused: int = 0, seconds: float = 0.0
) -> SceneRun:
    """Measure a run; the distances are looked up again, whatever was recorded of them on the way.

    Args:
        run: the run.
        situation: what it was about.
        seed: its seed.
        refused: how many draws were refused.
        seconds: time that the run took [s].
    """
    around, margin = CollisionModel(run.arm, situation.scene), situation.scene.margin
    at = np.array([around.minimum(q).distance for q in run.q])
    ways = zip(run.q[:-1], displacements(run), strict=True)
    between = np.array([around.minimum_between(q, dq, SAMPLES).distance for q, dq in ways])
    lost = np.minimum(at[:-1], margin) - between
    return SceneRun(
        scene=situation.name,
        seed=seed,
        refused=refused,
        reachable=situation.goal_clear,
        status=run.status,
        reason=" ".join(run.reason.split()),
        blamed=", ".join(blamed(run.reason, situation.scene, around.bodies)),
        steps=run.steps,
        error=float(run.posture_error[-1]) / int(run.target.placed.sum()) / run.arm.length,
        margin=margin,
        start=float(at[0]),
        closest=float(min(at[0], between.min(initial=np.inf))),
        end=float(at[-1]),
        loss=float(lost.max(initial=0.0)),
        path=run.sweep,
        escaping=float(run.escape.mean()) if run.steps else 0.0,
        seconds=seconds,
    )


def blamed(reason: str, scene: Scene, bodies: Sequence[str]) -> list[str]:
    """The obstacles that a text names; among bodies that must keep clear of each other, those as well."""
    names = [*scene.obstacles, *(bodies if scene.self_collision else ())]
    return [name for name in distinct(names) if re.search(rf"(?<!\w){re.escape(name)}(?!\w)", reason)]
