"""Objects that an arm holds on a part of a motion, and the scenes in its rows."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Annotated, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import Carried, Scene
from pinposture.collision.bodies import frame_pose
from pinposture.collision.obstacles import displaced
from pinposture.collision.scene import as_names, carried_among
from pinposture.schema import CheckedBy, Declared, Text, WholeNumber, declared

Array = NDArray[np.float64]


@declared()
class HeldObject(Declared):
    """An obstacle that the arm holds in some rows of a motion.

    Attributes:
        obstacle: its name.
        frame: the link, control point or joint with which it moves, by name.
        begin: the first row in which the arm holds it.
        end: the row in which it no longer does, or holds it beside others; the number of rows if it does at
            the end.
        beside: names of the obstacles of which it need not keep clear.
    """

    obstacle: Text
    frame: Text
    begin: WholeNumber
    end: WholeNumber
    beside: Annotated[Sequence[str], CheckedBy(as_names)] = ()

    def shifted(self, rows: int) -> HeldObject:
        """Return it in a motion that has so many more rows before."""
        return replace(self, begin=self.begin + rows, end=self.end + rows)


def joined(held: Sequence[HeldObject]) -> tuple[HeldObject, ...]:
    """Return holds of a motion with those as one in which a frame keeps an obstacle, beside whatever."""
    parts: list[HeldObject] = []
    for part in held:
        before = parts[-1] if parts else None
        if before is not None and (before.obstacle, before.frame, before.end) == (
            part.obstacle,
            part.frame,
            part.begin,
        ):
            parts[-1] = replace(before, end=part.end)
        else:
            parts.append(part)
    return tuple(parts)


class HeldStage(NamedTuple):
    """A part of a motion in which the same is held.

    Attributes:
        row: its first row.
        moved: displacements of obstacles since the start, by name, world frame.
        carried: how the arm carries obstacles, by name.
    """

    row: int
    moved: Mapping[str, pin.SE3]
    carried: Mapping[str, Carried]

    def scene(self, scene: Scene) -> Scene:
        """Return a scene in this stage, given that at the start; it may lack obstacles."""
        obstacles = dict(scene.obstacles)
        for name in self.moved.keys() & obstacles.keys():
            obstacles[name] = displaced(obstacles[name], self.moved[name])
        carried = {**scene.carried, **carried_among(self.carried, obstacles)}
        return replace(scene, obstacles=obstacles, carried=carried)


class Stages:
    """The scenes in the rows of a motion in which the arm holds objects.

    Args:
        arm: the arm.
        held: what it holds, in order.
        configuration: returns the configuration in a row, (nq,).
        rows: number of rows.
    """

    def __init__(
        self, arm: Arm, held: Sequence[HeldObject], configuration: Callable[[int], Array], rows: int
    ) -> None:
        self._arm = arm
        stages = [HeldStage(0, {}, {})]
        for part in held:
            taken = frame_pose(arm, configuration(part.begin), part.frame)
            left = frame_pose(arm, configuration(min(part.end, rows - 1)), part.frame)
            before = stages[-1].moved
            carried = Carried(part.frame, taken.translation, taken.rotation, part.beside)
            stages.append(HeldStage(part.begin, before, {part.obstacle: carried}))
            moved = left * taken.inverse() * before.get(part.obstacle, pin.SE3.Identity())
            stages.append(HeldStage(part.end, {**before, part.obstacle: moved}, {}))
        self._stages = stages
        self._rows = [stage.row for stage in stages]
        self._scenes: dict[tuple[int, Scene], Scene] = {}

    def motion(self, row: int, q: Array) -> dict[str, pin.SE3]:
        """Return displacements of obstacles since the start, by name, in a row, at a configuration (nq,)."""
        stage = self._stages[self.number(row)]
        poses = dict(stage.moved)
        for name, carried in stage.carried.items():
            before = poses.get(name, pin.SE3.Identity())
            poses[name] = frame_pose(self._arm, q, carried.frame) * carried.placement.inverse() * before
        return poses

    def number(self, row: float) -> int:
        """Return the number of the stage in which a row is, or a position between rows."""
        return bisect_right(self._rows, row) - 1

    def scene(self, number: int, scene: Scene) -> Scene:
        """Return a scene in a stage by number, given that at the start."""
        if number == 0:
            return scene
        known = self._scenes.get((number, scene))
        if known is None:
            known = self._scenes[number, scene] = self._stages[number].scene(scene)
        return known


def obstacle_motions(
    arm: Arm, q: Array, held: Sequence[HeldObject], scene: Scene, rows: Sequence[int]
) -> dict[str, list[pin.SE3]]:
    """Return how far obstacles that an arm holds or carries have moved, by name, in rows of a motion.

    Args:
        arm: the arm.
        q: configurations of the motion, (N, nq).
        held: what it holds on the way.
        scene: the scene at the start.
        rows: the rows.

    Returns:
        Displacements from where the scene describes each, world frame.
    """
    stages = Stages(arm, held, lambda row: q[row], len(q))
    names = {part.obstacle for part in held} | scene.carried.keys()
    poses: dict[str, list[pin.SE3]] = {name: [] for name in names & scene.obstacles.keys()}
    for row in rows:
        moved = stages.motion(row, q[row])
        for name, motions in poses.items():
            carried = scene.carried.get(name)
            if carried is not None:
                moved[name] = frame_pose(arm, q[row], carried.frame) * carried.placement.inverse()
            motions.append(moved.get(name, pin.SE3.Identity()))
    return poses
