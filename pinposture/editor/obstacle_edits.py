"""What hands do to the obstacles of a task: each of these is a request for the editor's loop."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import count
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from pinposture.collision import Obstacle, Scene
from pinposture.collision.scene import obstacles_around
from pinposture.editor.edits import Edit, with_obstacle
from pinposture.editor.new_obstacles import new_obstacle
from pinposture.editor.session import Proposal, Session
from pinposture.errors import InvalidValue, PostureError, TaskError
from pinposture.task import Task

Array = NDArray[np.float64]
Change: TypeAlias = Callable[[Obstacle], Obstacle]


def obstacles_of(task: Task) -> dict[str, Obstacle]:
    """The obstacles of a task, by name."""
    return {} if task.scene is None else dict(task.scene.obstacles)


def with_sound_obstacle(name: str, obstacle: Obstacle, instead: str | None = None) -> Edit:
    """As `with_obstacle`; refused if the obstacle stands where the base of the arm is."""
    put = with_obstacle(name, obstacle, instead)

    def edit(task: Task) -> Task:
        base = task.arm.chain.base
        if obstacles_around(Scene({name: obstacle}), base):
            at = ", ".join(f"{value:.4g}" for value in base)
            raise TaskError(f"obstacle {name!r}", f"it would stand where the base of the arm is, at ({at}) m")
        return put(task)

    return edit


def select_obstacle(name: str | None, session: Session) -> None:
    """Select an obstacle, in place of a control point of the curve."""
    if name is not None and name not in obstacles_of(session.shown):
        return
    if session.obstacle != name or (name is not None and session.handle is not None):
        session.obstacle = name
        session.handle = None if name is not None else session.handle


def add_obstacle(kind: str, points: Array, session: Session) -> None:
    """Add an obstacle of a kind.

    Args:
        kind: of `new_obstacles.KINDS`.
        points: where the arm is, from base to tip, (n, 3) [m].
        session: what is edited.
    """
    obstacle = new_obstacle(kind, session.arm, points, session.task.scene)
    take_in(free_name(kind, obstacles_of(session.task)), obstacle, session)


def take_in(name: str, obstacle: Obstacle, session: Session) -> None:
    """Add an obstacle that is there, and select it."""
    if session.edit(with_sound_obstacle(name, obstacle), f"added {name}"):
        select_obstacle(name, session)


def delete_obstacle(session: Session) -> None:
    """Delete the obstacle that is selected."""
    name = session.obstacle
    if name is None:
        session.say("no obstacle is selected: click on one first", "warning")
        return
    session.proposal = None
    session.edit(with_obstacle(name, None), f"deleted {name}")


def rename_obstacle(name: str, to: str, session: Session) -> None:
    """Give an obstacle another name; it keeps its place in the order."""
    obstacle, to = obstacles_of(session.task).get(name), to.strip()
    if obstacle is None or to == name:
        return
    session.proposal = None
    if session.edit(with_obstacle(to, obstacle, instead=name), f"renamed {name} to {to}"):
        session.obstacle = to


def rearrange(name: str, change: Change, what: str, final: bool, session: Session) -> None:
    """Move, turn or resize an obstacle.

    While the hand is at it each change is made to the obstacle from before, and nothing counts; all of it
    then is one step to undo.

    Args:
        name: of the obstacle.
        change: what to do to it.
        what: the same in words.
        final: whether it is to count.
        session: what is edited.
    """
    obstacle = obstacles_of(session.task).get(name)
    if obstacle is None:
        return
    select_obstacle(name, session)
    if final:
        session.proposal = None
        try:
            other = change(obstacle)
        except PostureError as error:
            session.say(str(error), "error")
            other = obstacle
        if other == obstacle or not session.edit(with_sound_obstacle(name, other, instead=name), what):
            session.touch()  # what was proposed before is gone
        return
    try:
        task = with_sound_obstacle(name, change(obstacle), instead=name)(session.task)
    except PostureError as error:
        if session.notice.text != " ".join(str(error).split()):
            session.say(str(error), "warning")
        return
    # The solver is told at its own pace: see `Surroundings`.
    session.proposal = Proposal(task, what, False, session.number + 1)


def edit_obstacle(name: str, key: str, value: object, final: bool, session: Session) -> None:
    """Give an obstacle another value: of its centre, size, radius and so on, by the name of the attribute."""

    def change(obstacle: Obstacle) -> Obstacle:
        if not hasattr(obstacle, key):  # it has become another one since
            raise InvalidValue(f"{key} of {name}", value, f"nothing, of a {obstacle.type}")
        return replace(obstacle, **{key: value})  # type: ignore[arg-type]

    rearrange(name, change, f"changed {name}", final, session)


def free_name(kind: str, taken: dict[str, Obstacle]) -> str:
    """A name that no obstacle has: of the kind, with a number."""
    return next(name for k in count(1) if (name := f"{kind}_{k}") not in taken)
