"""The phases of a task in the page: which one is shown, its values, its path and its goal."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial
from threading import Event
from typing import Any, NamedTuple, cast

import numpy as np
import viser
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.editor.phases import EditedPhase, editable, phase_label, with_phase
from pinposture.editor.session import Session
from pinposture.editor.solver import Live
from pinposture.editor.ui.parts import (
    MILLIMETRE,
    Bound,
    Post,
    Request,
    add_lines,
    color,
    coordinate_digits,
    on_change,
    on_choice,
    put,
    put_at,
)
from pinposture.errors import TaskError
from pinposture.motion.latest import Done, Latest
from pinposture.task import Leader, Phase, Task, TipGoal
from pinposture.task.phases import phase_title
from pinposture.viz.drawing import link_radius
from pinposture.viz.palette import THEME

Array = NDArray[np.float64]


class PhaseLook(NamedTuple):
    """How the path of a leader and the goal of a tip are drawn, and their fields."""

    number_step: float = 0.1
    """Step of the arrows beside a number."""

    path_pieces: int = 120
    """Number of straight pieces of the path of a leader."""

    path_color: str = THEME.spare[2]
    """Colour of that path."""

    goal_color: str = THEME.spare[1]
    """Colour of a goal of the tip."""

    goal_radius: float = 1.8
    """Radius of a goal, relative to that of the bars of the arm."""


PHASE = PhaseLook()


class PhaseField(NamedTuple):
    """A field for a value of the motion of a phase."""

    label: str  # with its unit
    unit: float  # the value of what it shows as 1
    digits: int  # decimals that it shows
    hint: str
    none: str = ""  # what 0 means, in words; empty if the value must not be None


NUMBERS = {
    "speed": PhaseField("Speed [mm/s]", MILLIMETRE, 2, "Largest speed of the feed", "as on the way in"),
    "depth": PhaseField("Depth [mm]", MILLIMETRE, 2, "How far along the path; 0: to its end", "to the end"),
    "pipe": PhaseField("Pipe [mm]", MILLIMETRE, 2, "Radius of a pipe around the path; 0: none", "no pipe"),
    "duration": PhaseField("Duration [s]", 1.0, 3, "0: as fast as the limits allow", "as fast as possible"),
    "hold": PhaseField("Stay [s]", 1.0, 3, "How long to stay there"),
}
VECTORS = {
    "position": PhaseField("Goal [mm]", MILLIMETRE, 0, "Where the tip has to be, world frame"),
    "direction": PhaseField("Tip along", 1.0, 4, "Direction of the last link there, world frame"),
    "rotation": PhaseField(
        "Tip turned [deg]", np.pi / 180.0, 2, "Roll, pitch and yaw of the last link there"
    ),
}
"""Fields for the values of phases, by attribute."""


class WantedPhase(NamedTuple):
    """A phase to show."""

    before: Task  # the task that is shown until then
    whole: Task  # the task of all phases
    number: int  # of the phase, 0-based
    what: str  # what has changed then, in words


class PhasePlanner:
    """Shows another phase of a task, or a changed one, once it is planned.

    Args:
        post: `Editor.post`.
    """

    def __init__(self, post: Callable[..., None]) -> None:
        self._wanted: WantedPhase | None = None  # the last one; what an earlier one finds is dropped
        self._planning: Latest[WantedPhase, Task] = Latest(
            _plan, "pinposture-phase", deliver=lambda done: post(partial(self._take, done))
        )

    def choose(self, index: int, session: Session) -> None:
        """Show another phase, 0-based."""
        task = session.task
        if isinstance(task, EditedPhase) and 0 <= index < len(task.phases) and index != task.index:
            self._show(session, task.whole, index, f"shown: {phase_title(task.phases, index)}")

    def arrange(self, action: str, session: Session) -> None:
        """Add a copy of the phase that is shown behind it, delete it, or move it.

        Args:
            action: "Add", "Delete", "Earlier" or "Later".
            session: the session.

        Raises:
            TaskError: it is the only one, or there is no position to move it to.
            PostureError: phases that a task cannot have in this order.
        """
        task = session.task
        if not isinstance(task, EditedPhase):
            return
        phases = list(cast("tuple[Phase, ...]", task.whole.motion))
        index = task.index
        title = phase_title(tuple(phases), index)
        phase = phases.pop(index)
        if action == "Delete":
            to = max(index - 1, 0)
            what = f"deleted {title}"
        elif action == "Add":
            to = index + 1
            phases[index:index] = [phase, replace(phase, name="")]
            what = f"added a copy of {title}"
        else:
            to = index + (1 if action == "Later" else -1)
            if not 0 <= to <= len(phases):
                raise TaskError(title, f"is the {'last' if to > 0 else 'first'} one already")
            phases.insert(to, phase)
            what = f"moved {title} to position {to + 1}"
        if not phases:
            raise TaskError(title, "is the only one, and cannot be deleted")
        self._show(session, task.whole.edited(motion=tuple(phases)), to, what)

    def change(self, values: dict[str, Any], what: str, session: Session) -> None:
        """Change values of the motion of the phase that is shown, such as the speed of a leader.

        Args:
            values: the values, by attribute.
            what: the change in words, for `undo`.
            session: the session.

        Raises:
            PostureError: a value that is not allowed.
        """
        task = session.task
        if not isinstance(task, EditedPhase) or task.end is None:
            return
        motion: Any = task.phases[task.index].motion
        motion = replace(motion, **values)
        whole = task.whole.edited(motion=with_phase(task, motion=motion))
        self._show(session, whole, task.index, f"{phase_title(task.phases, task.index)}: {what}")

    def _show(self, session: Session, whole: Task, index: int, what: str) -> None:
        """Show a phase once it is planned; `what` says in words what then has changed."""
        phases = cast("tuple[Phase, ...]", whole.motion)
        session.say(f"planning up to {phase_title(phases, index)} ...")
        self._wanted = WantedPhase(session.task, whole, index, what)
        self._planning.ask(self._wanted)

    def _take(self, done: Done[WantedPhase, Task], session: Session) -> None:
        request = done.request
        view = done.answer
        if request is not self._wanted:
            return
        if view is None:
            session.say(f"{request.what}: not possible: {done.error}", "error")
        elif session.task is not request.before:
            reason = "dropped, since the task was changed meanwhile; try again"
            session.say(f"{request.what}: {reason}", "warning")
        else:
            first = 1 if isinstance(view, EditedPhase) and view.begin is not None else 0
            session.take_up(view, first, request.what)


def _plan(request: WantedPhase, _: Event) -> Task:
    return editable(request.whole, request.number)


def rename_phase(name: str, session: Session) -> None:
    """Rename the phase that is shown."""
    task = session.task
    if isinstance(task, EditedPhase):
        phases = with_phase(task, name=name)
        session.edit(lambda now: now.edited(phases=phases), f"named phase {task.index + 1} {name!r}")


class PhaseControls:
    """Controls that choose a phase, and edit what is no keyframe of it."""

    def __init__(self, server: viser.ViserServer, arm: Arm, planner: PhasePlanner, post: Post) -> None:
        self._planner = planner
        gui = server.gui
        bind = partial(Bound, post)
        self._index = 0
        choice = gui.add_dropdown("Phase", ("none",), visible=False, hint="Which phase is shown")
        self._choice = bind(
            choice, _label_of, lambda label: partial(planner.choose, int(label.split(maxsplit=1)[0]) - 1)
        )
        hint = "Add a copy of this phase after it; delete it; move it earlier or later"
        self._actions = gui.add_button_group("Phases", ("Add", "Delete", "Earlier", "Later"), hint=hint)
        on_choice(self._actions, lambda action: post(partial(planner.arrange, action)))
        self._name = bind(
            gui.add_text("Phase name", "", visible=False),
            _name_of,
            lambda name: partial(rename_phase, name),
        )
        self._fields: list[Bound] = []
        for key, (label, unit, digits, hint, _) in NUMBERS.items():
            number = gui.add_number(label, 0.0, min=0.0, step=PHASE.number_step, visible=False, hint=hint)
            number.precision = digits
            self._fields.append(bind(number, partial(_value_of, key), partial(self._set, key), unit=unit))
        finest = {"position": coordinate_digits(arm.length)}
        for key, (label, unit, digits, hint, _) in VECTORS.items():
            step = 10.0 ** -finest.get(key, digits)
            vector = gui.add_vector3(label, (0.0, 0.0, 0.0), step=step, visible=False, hint=hint)
            vector.precision = finest.get(key, digits)
            self._fields.append(bind(vector, partial(_value_of, key), partial(self._set, key), unit=unit))
        back = gui.add_checkbox("Come back", False, visible=False, hint="Return along the path")
        self._fields.append(
            bind(
                back,
                partial(_value_of, "and_back"),
                lambda value: self._change({"and_back": value}, "comes back" if value else "stays"),
            )
        )
        self._point = gui.add_dropdown("Path point", ("1",), visible=False, hint="Control point of the path")
        digits = coordinate_digits(arm.length)
        coordinates = gui.add_vector3("Point [mm]", (0.0, 0.0, 0.0), step=10.0**-digits, visible=False)
        coordinates.precision = digits
        self._coordinates = bind(coordinates, self._position_of, self._move_point, unit=MILLIMETRE)
        on_change(self._point, lambda _: self._coordinates.finish())

    def show(self, session: Session, _: Live) -> None:
        """Bring it up to date."""
        task = session.task
        put(self._actions, visible=isinstance(task, EditedPhase))
        if isinstance(task, EditedPhase):
            options = tuple(phase_label(task.phases, index) for index in range(len(task.phases)))
            if tuple(self._choice.control.options) != options:
                self._choice.control.options = options
            if task.index != self._index:
                self._index = task.index
                for field in (self._name, self._coordinates, *self._fields):
                    field.forget()  # it was meant for the phase before
        points = path_points(session)
        put(self._point, visible=points is not None)
        names = tuple(str(number) for number in range(1, len(() if points is None else points) + 1))
        if names and tuple(self._point.options) != names:
            self._point.options = names
        for field in (self._choice, self._name, *self._fields, self._coordinates):
            field.show(session)

    def _set(self, key: str, value: Any) -> Request:
        field = {**NUMBERS, **VECTORS}[key]
        words = field.label.partition(" [")[0].lower()
        if key in VECTORS:
            return self._change({key: value}, f"{words} changed")
        if value == 0.0 and field.none:
            return self._change({key: None}, f"{words}: {field.none}")
        unit = field.label.partition("[")[2].rstrip("]")
        return self._change({key: value}, f"{words} {value / field.unit:g} {unit}")

    def _change(self, values: dict[str, Any], what: str) -> Request:
        return partial(self._planner.change, values, what)

    def _position_of(self, session: Session) -> Array | None:
        points = path_points(session)
        return None if points is None else np.asarray(points[int(self._point.value) - 1])

    def _move_point(self, position: tuple[float, float, float]) -> Request:
        return partial(move_path_point, self._planner, int(self._point.value) - 1, position)


def motion_of(session: Session) -> Any:
    """Return the motion of the phase that is shown, if it is not keyframes; None otherwise."""
    task = session.task
    return task.phases[task.index].motion if isinstance(task, EditedPhase) and task.end is not None else None


def path_points(session: Session) -> Array | None:
    """Return the control points of the path of the phase that is shown, (n, 3) [m]; None without any."""
    motion = motion_of(session)
    return motion.path.control_points if isinstance(motion, Leader) else None


def _value_of(key: str, session: Session) -> Any:
    """Return a value of the motion of the phase that is shown; None if it has no such value."""
    motion = motion_of(session)
    value = getattr(motion, key, None)
    return 0.0 if value is None and key in NUMBERS and hasattr(motion, key) else value


def _label_of(session: Session) -> str | None:
    task = session.task
    return phase_label(task.phases, task.index) if isinstance(task, EditedPhase) else None


def _name_of(session: Session) -> str | None:
    task = session.task
    return task.phases[task.index].name if isinstance(task, EditedPhase) else None


def move_path_point(
    planner: PhasePlanner, index: int, position: tuple[float, float, float], session: Session
) -> None:
    """Move a control point of the path of a leader, 0-based, to a position (3,) [m]."""
    task = session.task
    motion = task.phases[task.index].motion if isinstance(task, EditedPhase) else None
    if not isinstance(motion, Leader) or motion.path.control_points is None:
        return
    points = np.array(motion.path.control_points)
    if index < len(points):
        points[index] = position
        path = Curve.spline(points, motion.path.degree)
        planner.change({"path": path}, f"point {index + 1} of the path moved", session)


class PhaseDrawing:
    """The path of the leader, or the goal of the tip, of the phase that is shown; each with its name."""

    def __init__(self, server: viser.ViserServer, arm: Arm) -> None:
        self._shown: Task | None = None
        self._line = add_lines(
            server, "/phase/path", PHASE.path_pieces, 0.6 * link_radius(arm), visible=False
        )
        self._goal = server.scene.add_icosphere(
            "/phase/goal",
            PHASE.goal_radius * link_radius(arm),
            color(PHASE.goal_color),
            subdivisions=2,
            cast_shadow=False,
            visible=False,
        )
        self._label = server.scene.add_label("/phase/label", "", visible=False)

    def show(self, session: Session, _: Live) -> None:
        """Bring it up to date."""
        task = session.task
        if task is self._shown:
            return
        self._shown = task
        path = task.path if isinstance(task, EditedPhase) else None
        motion = task.phases[task.index].motion if isinstance(task, EditedPhase) else None
        goal = np.array(motion.position) if isinstance(motion, TipGoal) else None
        put(self._line, visible=path is not None)
        put(self._goal, visible=goal is not None)
        put(self._label, visible=path is not None or goal is not None)
        if path is not None:
            points = np.asarray(path.at(np.linspace(0.0, path.length, PHASE.path_pieces + 1)))
            self._line.points = np.stack([points[:-1], points[1:]], axis=1).astype(np.float32)
            self._line.colors = np.full((PHASE.path_pieces, 2, 3), color(PHASE.path_color), dtype=np.uint8)
            put(self._label, text="path of the tip")
            put_at(self._label, points[-1])
        elif goal is not None:
            put_at(self._goal, goal)
            put(self._label, text="goal of the tip")
            put_at(self._label, goal)
