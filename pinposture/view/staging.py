"""All that the browser is to draw and to move: an arm, its run or motion, targets, obstacles, ellipsoids."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.scene import Scene
from pinposture.target import Target
from pinposture.view.animation import Film, tracks
from pinposture.view.commands import Command, Track
from pinposture.view.moving_ellipsoids import ball_commands, ball_ends, ball_tracks, balls
from pinposture.view.moving_targets import moving_target_commands, moving_target_tracks
from pinposture.view.obstacles import near_corners, obstacle_commands, shown_obstacles
from pinposture.view.places import Place, alike, shown_places
from pinposture.view.scene import arm_commands, stage_commands, stage_points, target_commands

Array = NDArray[np.float64]


class Staged(NamedTuple):
    """What the browser is told.

    Attributes:
        drawn: what to draw, the first configuration of the arm included.
        tracks: how that moves; nothing if there is nothing to play.
        obstacles: whether there are obstacles in the picture.
        places: the named places of a motion with lines of their own, those that look alike together.
    """

    drawn: list[Command]
    tracks: list[Track]
    obstacles: bool
    places: list[list[Place]]


def staged(
    arm: Arm, shown: Film | None, target: Target | None, scene: Scene | None, points: tuple[int, ...]
) -> Staged:
    """Set up a scene.

    Args:
        arm: the arm.
        shown: what to play; None to show the arm at its neutral configuration.
        target: a target that stays where it is; None if there is none.
        scene: what surrounds the arm; None if nothing.
        points: control points with an ellipsoid, 0-based.
    """
    rows = arm.neutral()[None] if shown is None else shown.run.q[shown.rows]
    run, motion = (None, None) if shown is None else (shown.run, shown.motion)
    ellipsoids = balls(arm, points, rows)
    stage = np.vstack([stage_points(arm, run, target), ball_ends(ellipsoids)])
    places: list[list[Place]] = []
    if motion is not None:
        stage = np.vstack([stage, motion.targets[motion.asked]])
        places = alike(motion, shown_places(motion))
    obstacles = shown_obstacles(scene, stage)
    drawn = [
        *stage_commands(arm, np.vstack([stage, near_corners(obstacles)])),
        *arm_commands(arm, rows[0]),
        *([] if target is None else target_commands(arm, target)),
        *([] if motion is None else moving_target_commands(motion, [group[0] for group in places])),
        *obstacle_commands(obstacles),
        *ball_commands(ellipsoids),
    ]
    moving: list[Track] = []
    if shown is not None:
        moving = [*tracks(arm, shown), *ball_tracks(ellipsoids, shown)]
        moving += [] if motion is None else moving_target_tracks(motion, shown)
    return Staged(drawn, moving, bool(obstacles), places)
