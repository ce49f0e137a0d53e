"""Phases of a task, one after the other: along a path, to a goal of the tip, through keyframes, and out.

An arm can also wrap around an object, carry it, and let go of it.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from math import ceil
from types import MappingProxyType
from typing import Annotated, Any, Literal, NamedTuple, TypeAlias, TypeGuard, cast

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from pydantic import ValidationInfo, model_validator

from pinposture._validation import direction as unit_vector
from pinposture._validation import is_usable, require_function, require_known
from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.pipe import pipe
from pinposture.collision.scene import as_names
from pinposture.control import JointPath, Limits, plan
from pinposture.control.limits import cycle_of
from pinposture.control.planner.objective import Objective
from pinposture.control.reach import reach, reach_from, require_within_reach, tip_task
from pinposture.control.tasks import EndEffector, link_axes
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, PostureError, TaskError, gather, raise_together
from pinposture.motion.held import HeldObject
from pinposture.placement import Target
from pinposture.schema import (
    CheckedBy,
    Declared,
    Duration,
    InputFile,
    NotAllowed,
    OutputFile,
    Position,
    Refusal,
    Rotation,
    Speed,
    Text,
    Time,
    declared,
    is_list_of,
    is_table,
    one_of,
    read_again,
    read_by,
    read_within,
    refusing,
    write_parts,
)
from pinposture.task.follow_leader import Leader, check_leader, follow_leader
from pinposture.task.keyframe import (
    Keyframe,
    check_each_keyframe,
    placed,
    usual_placement,
    with_fitting_joints,
)
from pinposture.task.keyframes import TRANSITION, Progress, keyframe_reference
from pinposture.task.reference import Reference, Waypoint, require_wide_pipe, smooth_step
from pinposture.task.wrap import (
    Grip,
    Wrapping,
    carry,
    find_grip,
    opening_ways,
    path_through,
    require_touchable,
)

Array = NDArray[np.float64]


class TipMotionSettings(NamedTuple):
    """How the tip is led to its goal."""

    min_cycles: int = 20
    """Fewest control cycles of a motion along a planned path."""

    drag_share: float = 0.25
    min_drag_steps: int = 8
    """Distance between goals on the straight line to a goal of the tip, in modules, and their smallest
    number."""

    drag_margin: float = 1.1
    """Clearance sought at these goals, in margins, so that the smooth motion between them keeps the
    margin."""


TIP_MOTION = TipMotionSettings()


def _read_direction(value: Any, _: ValidationInfo) -> tuple[float, ...]:
    if not is_list_of(is_usable)(value) or len(value) != 3:
        raise NotAllowed(value, "three numbers")
    with refusing():
        unit_vector("direction", value)
    return tuple(map(float, value))


@declared()
class TipGoal(Declared):
    """A goal of the tip; the rest of the arm is free, and keeps clear of obstacles.

    Attributes:
        position: where the tip has to be, (3,) [m], world frame.
        direction: direction of the last link there, (3,), world frame; None for any.
        rotation: roll, pitch and yaw of the last link, (3,) [rad], in place of a direction; None for any.
        duration: time for the motion [s]; None: as fast as the limits allow.
        hold: how long to stay there [s].
        budget: time for the search [s], as for `reach`.
        objective: what the posture is chosen for, as for `reach`. With "dexterity" the tip moves straight to
            its goal if that is clear.

    Raises:
        InvalidValue: an invalid value, or both a direction and a rotation.
    """

    position: Position
    direction: Annotated[tuple[float, ...], read_by(_read_direction)] | None = None
    rotation: Rotation | None = None
    duration: Duration | None = None
    hold: Time = 0.0
    budget: Duration = 5.0
    objective: Annotated[Literal["dexterity", "torque"], one_of("objective", "dexterity", "torque")] = (
        "dexterity"
    )

    @model_validator(mode="after")
    def _check(self) -> TipGoal:
        if self.direction is not None and self.rotation is not None:
            raise InvalidValue("direction", self.direction, "None where a rotation is given")
        return self

    def task(self, arm: Arm) -> EndEffector:
        """Return the goal as a task of the tip."""
        pose: Any = np.array(self.position)
        if self.rotation is not None:
            pose = pin.SE3(pin.rpy.rpyToMatrix(*self.rotation), pose)
        return tip_task(arm, pose, self.direction)


@declared()
class Withdrawal(Declared):
    """The way out: back to where the last path was entered last, and out along it in reverse.

    Attributes:
        speed: largest speed of the feed [m/s]; that of the way in if None.

    Raises:
        InvalidValue: a speed that is not positive.
    """

    speed: Speed | None = None


@declared()
class Carrying(Declared):
    """The arm carries the object that it holds, along a straight line; see `pinposture.carry`.

    Attributes:
        position: where the middle of the object comes to, (3,) [m], world frame.
        turn: roll, pitch and yaw by which the object is turned on the way, (3,) [rad], world axes.
        onto: names of obstacles that the object may touch, to be put down on them.

    Raises:
        InvalidValue: an invalid value.
    """

    position: Position
    turn: Rotation = (0.0, 0.0, 0.0)
    onto: Annotated[Sequence[str], CheckedBy(as_names)] = ()


@declared()
class Release(Declared):
    """The arm lets go of the object that it holds, and stands off from it by the margin."""


PhaseMotion: TypeAlias = (
    "Leader | TipGoal | tuple[Keyframe, ...] | Withdrawal | Wrapping | Carrying | Release"
)


MOTIONS: Mapping[str, Any] = MappingProxyType(
    {
        "leader": Leader,
        "reach": TipGoal,
        "keyframes": tuple[Keyframe, ...],
        "withdraw": Withdrawal,
        "wrap": Wrapping,
        "carry": Carrying,
        "release": Release,
    }
)
"""Keys of the table of a phase, of which each has one, and what they contain."""


def _read_motion(value: Any, _: ValidationInfo) -> PhaseMotion:
    if isinstance(value, Leader | TipGoal | Withdrawal | Wrapping | Carrying | Release):
        return value
    if not isinstance(value, list | tuple) or not all(isinstance(keyframe, Keyframe) for keyframe in value):
        allowed = (
            "a Leader, a TipGoal, one or more of Keyframe(...), a Withdrawal, a Wrapping, a Carrying, or a "
            "Release"
        )
        raise NotAllowed(value, allowed)
    if not value:
        raise NotAllowed(value, "one or more of Keyframe(...)")
    return tuple(value)


@declared()
class Phase(Declared):
    """A part of a motion, which begins at rest where the one before it ended, and ends at rest.

    Attributes:
        motion: a `Leader` moves the straight arm along a path; a `TipGoal` brings the tip to a position or a
            pose; keyframes are taken in order, at times from the beginning of the phase; a `Withdrawal` moves
            out along the path of the last leader. The first phase of all begins with its first keyframe; in
            others, the first keyframe has a time or a duration. A `Wrapping` takes an object in the arm, a
            `Carrying` moves it, and a `Release` lets go of it; between these there are no others.
        name: a name; if empty, messages use the number of the phase.

    Raises:
        InvalidValue: a motion or name of another type.
    """

    motion: Annotated[PhaseMotion, read_by(_read_motion)]
    name: Text = ""

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> tuple[str, ...]:
        """Refuse a phase without a motion, or with several."""
        keys = [key for key in MOTIONS if key in values]
        if len(keys) > 1:
            raise Refusal(f"does not go with {keys[0]!r}; a phase has one motion", keys[1])
        allowed = ("name", *MOTIONS)
        if not keys and all(key in allowed for key in values):
            raise Refusal(f"needs one of the keys {', '.join(map(repr, MOTIONS))}")
        return allowed

    @classmethod
    def from_table(cls, values: Mapping[str, Any], source: InputFile) -> dict[str, Any]:
        """Return the values of fields: the one motion that the table has."""
        key = next(name for name in MOTIONS if name in values)
        if key == "keyframes" and not is_list_of(is_table)(values[key]):
            raise NotAllowed(values[key], "a list of tables, each begun by [[phases.keyframes]]", key)
        motion = read_within(key, read_again, MOTIONS[key], values[key], source)
        name = {"name": values["name"]} if "name" in values else {}
        return {"motion": motion, **name}

    def to_table(self, file: OutputFile) -> dict[str, Any]:
        """Return the table, with the motion under the key of its kind."""
        kinds = {kind: key for key, kind in MOTIONS.items() if key != "keyframes"}
        name = {"name": self.name} if self.name else {}
        return {**name, kinds.get(type(self.motion), "keyframes"): write_parts(self.motion, file)}


def phase_title(phases: Sequence[Phase], index: int) -> str:
    """Return the title of a phase in messages: its number from 1, and its name if it has one."""
    name = phases[index].name
    return f"phase {index + 1} {name!r}" if name else f"phase {index + 1}"


def is_phased(motion: object) -> TypeGuard[tuple[Phase, ...]]:
    """Whether the motion of a task is divided into phases."""
    return isinstance(motion, tuple) and any(isinstance(phase, Phase) for phase in motion)


def keyed(phase: Phase) -> tuple[Keyframe, ...]:
    """Return the keyframes of a phase; none if it is another one."""
    motion = phase.motion
    return motion if isinstance(motion, tuple) and not isinstance(motion, Leader) else ()


def check_phases(phases: tuple[Phase, ...], arm: Arm, scene: Scene | None) -> None:
    """Refuse phases that do not define a motion of an arm.

    Raises:
        TaskError: names the phase.
    """
    if not all(isinstance(phase, Phase) for phase in phases):
        raise InvalidValue("motion", phases, "only phases, or only keyframes")
    raise_together(gather(*(_check(phases, index, arm, scene) for index in range(len(phases)))))


def _check(phases: tuple[Phase, ...], index: int, arm: Arm, scene: Scene | None) -> Any:
    phase = phases[index]

    def check() -> None:
        with _naming(phases, index):
            if isinstance(phase.motion, Leader):
                check_leader(phase.motion, arm, scene)
            if keyed(phase):
                check_each_keyframe(keyed(phase), arm)
            if index == 0 and len(keyed(phase)) == 1:
                raise InvalidValue("keyframes", 1, "two or more, as it is the first phase")
            if isinstance(phase.motion, Withdrawal) and _open_leader(phases[:index]) is None:
                raise InvalidValue("withdrawal", phase.motion, "one after a leader that does not return")
            _check_hand(phases, index, scene)

    return check


def _check_hand(phases: tuple[Phase, ...], index: int, scene: Scene | None) -> None:
    """Refuse a phase that an arm cannot do with what it holds, or with what there is to hold."""
    motion = phases[index].motion
    holding = _held_before(phases[:index])
    if isinstance(motion, Carrying | Release):
        if holding is None:
            word = "carry" if isinstance(motion, Carrying) else "release"
            raise InvalidValue(word, motion, "one after a phase that wraps around an object")
    elif holding is not None:
        raise InvalidValue("motion", motion, f"a Carrying or a Release, as the arm holds {holding!r}")
    if isinstance(motion, Wrapping):
        require_touchable(motion.obstacle, Scene() if scene is None else scene)
    if isinstance(motion, Carrying):
        for name in motion.onto:
            require_known("obstacle", name, {} if scene is None else scene.obstacles)


def _held_before(before: Sequence[Phase]) -> str | None:
    """Return the name of the object that the arm holds after some phases; None if it holds none."""
    held: str | None = None
    for phase in before:
        if isinstance(phase.motion, Wrapping):
            held = phase.motion.obstacle
        elif isinstance(phase.motion, Release):
            held = None
    return held


def _open_leader(before: Sequence[Phase]) -> Leader | None:
    """Return the leader whose path the arm is still in after some phases."""
    inside: Leader | None = None
    for phase in before:
        if isinstance(phase.motion, Leader):
            inside = None if phase.motion.and_back else phase.motion
        elif isinstance(phase.motion, Withdrawal):
            inside = None
    return inside


def with_placements(phases: tuple[Phase, ...], arm: Arm, scene: Scene | None) -> tuple[Phase, ...]:
    """Return the phases with the usual placement where a path or curve has none of its own."""

    def own(phase: Phase) -> Phase:
        motion = phase.motion
        if isinstance(motion, Leader) and motion.placement is None:
            placement = usual_placement(scene, motion.path)
            return replace(phase, motion=replace(motion, placement=placement))
        if keyed(phase):
            return replace(phase, motion=placed(with_fitting_joints(arm, keyed(phase)), scene))
        return phase

    return tuple(map(own, phases))


@contextmanager
def _naming(phases: Sequence[Phase], index: int, begun: bool = False) -> Iterator[None]:
    """Name the phase in errors; `begun`: its keyframes were counted with the posture in which it begins."""
    try:
        yield
    except PostureError as error:
        reason = str(error)
        if begun:
            reason = re.sub(r"\bkeyframe (\d+)", lambda match: f"keyframe {int(match[1]) - 1}", reason)
        raise TaskError(phase_title(phases, index), reason) from error


def phased_reference(
    arm: Arm,
    phases: tuple[Phase, ...],
    limits: Limits,
    scene: Scene | None = None,
    start: Array | None = None,
    continuity: Literal["velocity", "acceleration"] = "velocity",
    progress: Progress | None = None,
) -> Reference:
    """Plan phases one after the other, each from where the one before it ends; the arm is at rest in between.

    Args:
        arm: the arm.
        phases: one or more.
        limits: the limits of a step, with dt.
        scene: the obstacles that goals of the tip and ways back to a path avoid.
        start: the initial configuration, (nq,); that of the first phase if None.
        continuity: as for `keyframe_reference`.
        progress: called with the number of postures of a phase found so far, and their total number.

    Returns:
        The reference. Its waypoints are named after the phases.

    Raises:
        TaskError: the arm cannot perform a phase; names it.
    """
    require_function("progress", progress)
    planner = _Planner(arm, limits, scene, start, continuity, progress)
    for index in range(len(phases)):
        planner.append(phases, index)
    return planner.joined()


class PlannedPhase(NamedTuple):
    """Where and when a phase begins and ends in the plan."""

    begin: Array  # configuration in which it begins, (nq,)
    end: Array  # configuration in which it ends, (nq,)
    begins: float  # planned time of its beginning [s]
    ends: float  # planned time of its end [s]
    path: Curve | None  # the path of a leader as placed, world frame; None for other phases


def plan_phases(
    arm: Arm,
    phases: tuple[Phase, ...],
    limits: Limits,
    scene: Scene | None = None,
    start: Array | None = None,
    continuity: Literal["velocity", "acceleration"] = "velocity",
) -> list[PlannedPhase]:
    """Plan phases one after the other; arguments and errors are those of `phased_reference`."""
    planner = _Planner(arm, limits, scene, start, continuity, None)
    planned: list[PlannedPhase] = []
    time = 0.0
    for index, phase in enumerate(phases):
        pieces = planner.append(phases, index)
        first = pieces[0]
        last = pieces[-1]
        ends = time + sum(piece.duration for piece in pieces)
        path = first.waypoints[0].target.curve if isinstance(phase.motion, Leader) else None
        end = last.configuration(last.rows - 1)
        planned.append(PlannedPhase(first.configuration(0), end, time, ends, path))
        time = ends
    return planned


def surrounded(phases: Sequence[Phase], reference: Reference, scene: Scene) -> Scene:
    """Return the scene with the pipes of the leaders, around their paths as placed.

    Raises:
        TaskError: a pipe is too narrow, or bends too much; names the phase.
    """
    paths = list(
        {
            id(waypoint.way): waypoint.target.curve
            for waypoint in reference.waypoints
            if waypoint.way is not None
        }.values()
    )
    leaders = [index for index, phase in enumerate(phases) if isinstance(phase.motion, Leader)]
    for index, path in zip(leaders, paths, strict=False):
        leader = phases[index].motion
        if isinstance(leader, Leader) and leader.pipe is not None and path is not None:
            with _naming(phases, index):
                scene = with_pipe(scene, path, leader.pipe, reference)
    return scene


def with_pipe(scene: Scene | None, path: Any, radius: float, reference: Reference) -> Scene:
    """Return a scene with a pipe around the path of a reference.

    Raises:
        InvalidValue: the pipe bends too much, or is too narrow for the arm and the margin.
    """
    walls = pipe(path, radius)
    if scene is None:
        require_wide_pipe(reference, walls, radius)
        return walls
    require_wide_pipe(reference, scene.with_obstacles(walls.obstacles), radius)
    return replace(scene, obstacles={**scene.obstacles, **walls.obstacles})


class _Planner:
    """Plans phases in order."""

    def __init__(
        self,
        arm: Arm,
        limits: Limits,
        scene: Scene | None,
        start: Array | None,
        continuity: Literal["velocity", "acceleration"],
        progress: Progress | None,
    ) -> None:
        self._arm = arm
        self._limits = limits
        self._scene = scene
        self._continuity = continuity
        self._progress = progress
        self._dt = cycle_of(limits)
        self._q = start
        self._pieces: list[Reference] = []
        self._inside: tuple[Leader, Reference] | None = None
        self._grip: Grip | None = None

    def append(self, phases: Sequence[Phase], index: int) -> list[Reference]:
        """Plan a phase from the configuration in which the last one ended; return its pieces.

        Raises:
            TaskError: the arm cannot perform it; names it.
        """
        phase = phases[index]
        before = len(self._pieces)
        name = phase.name or f"phase {index + 1}"
        with _naming(phases, index, begun=index > 0 and bool(keyed(phase))):
            if isinstance(phase.motion, Leader):
                self._follow(phase.motion, name)
            elif isinstance(phase.motion, TipGoal):
                self._reach(phase.motion, name)
            elif isinstance(phase.motion, Withdrawal):
                self._withdraw(phase.motion, name)
            elif isinstance(phase.motion, Wrapping):
                self._wrap(phase.motion, name)
            elif isinstance(phase.motion, Carrying):
                self._carry(phase.motion, name)
            elif isinstance(phase.motion, Release):
                self._release(name)
            else:
                self._take(phase.motion, name)
        return self._pieces[before:]

    def joined(self) -> Reference:
        """Return all phases as one reference."""
        first = self._pieces[0]
        offsets = [np.zeros((1, self._arm.nv))]
        weights = [first.weights[:1]]
        waypoints: list[Waypoint] = []
        held: list[HeldObject] = []
        for piece in self._pieces:
            row = sum(map(len, offsets)) - 1
            held += [part.shifted(row) for part in piece.held]
            offsets.append(offsets[-1][-1] + piece.offsets[1:])
            weights.append(piece.weights[1:])
            waypoints += [waypoint._replace(row=waypoint.row + row) for waypoint in piece.waypoints]
        durations = np.concatenate([np.diff(piece.times) for piece in self._pieces])
        if self._grip is not None:  # to the end
            held[-1] = replace(held[-1], end=held[-1].end + 1)
        return Reference(
            arm=self._arm,
            interval=float(durations.min()),
            start=first.start,
            offsets=np.concatenate(offsets),
            weights=np.concatenate(weights),
            waypoints=tuple(waypoints),
            durations=durations,
            held=tuple(held),
        )

    def _add(self, piece: Reference, name: str) -> None:
        """Add a piece; its waypoints are named after the phase."""
        named = tuple(
            waypoint._replace(name=name if waypoint.name in ("", name) else f"{name}: {waypoint.name}")
            for waypoint in piece.waypoints
        )
        self._pieces.append(replace(piece, waypoints=named))
        self._q = piece.configuration(piece.rows - 1)

    def _follow(self, leader: Leader, name: str) -> None:
        arguments = leader.arguments()
        radius = leader.pipe
        arguments["placement"] = leader.placement or usual_placement(self._scene, leader.path)
        reference = follow_leader(
            self._arm, interval=self._dt, start=self._q, progress=self._progress, **arguments
        )
        path = reference.waypoints[0].target.curve
        if radius is not None:
            self._scene = with_pipe(self._scene, path, radius, reference)
        self._inside = None if leader.and_back else (leader, reference)
        self._add(reference, name)

    def _reach(self, goal: TipGoal, name: str) -> None:
        require_within_reach(self._arm, goal.task(self._arm))
        straight = self._drag(goal) if goal.objective == "dexterity" else None
        path = straight or self._search(goal)
        piece = self._along(path, goal.duration, goal.hold)
        waypoint = _waypoint(name, piece)._replace(tip=goal.task(self._arm), row=piece.rows - 1)
        self._add(replace(piece, waypoints=(waypoint,)), name)

    def _drag(self, goal: TipGoal) -> JointPath | None:
        """Return the path on which the tip moves straight to its goal; None if it is not clear."""
        arm = self._arm
        start = self._begin()
        scene = self._scene
        if scene is not None:
            scene = replace(scene, margin=TIP_MOTION.drag_margin * scene.margin)
        state = arm.at(start)
        now = pin.SE3(state.rotations[-1], state.points[-1])
        link = now.rotation @ link_axes(arm).links[-1]
        there = np.array(goal.position)
        spacing = TIP_MOTION.drag_share * arm.length / arm.n_modules
        steps = max(ceil(float(np.linalg.norm(there - now.translation)) / spacing), TIP_MOTION.min_drag_steps)
        q = start
        offsets = [np.zeros(arm.nv)]
        for share in np.arange(1, steps + 1) / steps:
            pose: Any = (1.0 - share) * now.translation + share * there
            direction = None
            if goal.rotation is not None:
                posed = pin.SE3(pin.rpy.rpyToMatrix(*goal.rotation), there)
                pose = pin.SE3(pin.SE3.Interpolate(now, posed, float(share)).rotation, pose)
            if goal.direction is not None:
                direction = (1.0 - share) * link + share * np.array(unit_vector("direction", goal.direction))
            try:
                goal_reached = reach_from(arm, pose, q, scene, self._limits, direction)
            except PostureError:  # a posture on the way, or a direction, that there is not
                return None
            if goal_reached is None:
                return None
            offsets.append(offsets[-1] + arm.difference(q, goal_reached.q))
            q = goal_reached.q
        rows = np.array(offsets)
        if scene is not None:
            clear = CollisionModel(arm, scene).minimum_on_motions(start, rows).distance
            if clear < scene.margin / TIP_MOTION.drag_margin:
                return None
        return JointPath(Objective(arm, Target.from_configuration(arm, q)), start, rows)

    def _search(self, goal: TipGoal) -> JointPath:
        """Return the clear path to a posture found by `reach`."""
        posed = pin.SE3(pin.rpy.rpyToMatrix(*(goal.rotation or (0.0, 0.0, 0.0))), np.array(goal.position))
        pose = posed.translation if goal.rotation is None else posed
        found = reach(
            self._arm,
            pose,
            direction=goal.direction,
            scene=self._scene,
            start=self._begin(),
            budget=goal.budget,
            limits=self._limits,
            objective=goal.objective,
        )
        path = found[0].path
        if path is None or path.blocked_by:
            blocked_by = "" if path is None else path.blocked_by
            reason = f"no clear path was found: {blocked_by}; raise the budget, or choose a nearer goal"
            raise TaskError("the way to its posture", reason)
        return path

    def _take(self, keyframes: tuple[Keyframe, ...], name: str) -> None:
        if self._pieces and self._q is not None:
            keyframes = tuple(
                replace(keyframe, name=keyframe.name or f"keyframe {number}")
                for number, keyframe in enumerate(keyframes, start=1)
            )
            keyframes = (Keyframe(joints=tuple(self._arm.positions(self._q))), *keyframes)
        keyframes = placed(keyframes, self._scene)
        piece = keyframe_reference(
            self._arm, keyframes, self._dt, self._continuity, self._progress, limits=self._limits
        )
        self._add(replace(piece, waypoints=piece.waypoints[1:] if self._pieces else piece.waypoints), name)

    def _withdraw(self, withdrawal: Withdrawal, name: str) -> None:
        if self._inside is None:
            raise InvalidValue("withdrawal", withdrawal, "one after a leader that does not return")
        leader, entered = self._inside
        arm = self._arm
        start = self._begin()
        inside = entered.configuration(entered.rows - 1)
        if np.abs(arm.difference(start, inside)).max() > 1e-9:
            back = Target.from_configuration(arm, inside)
            path = plan(arm.at(start), back, self._scene, self._limits, budget=5.0, strict=False)
            pieces = self._reversed(entered) if path.blocked_by else [self._along(path, None, 0.0)]
            for piece in pieces:
                waypoints = (_waypoint("back on the path", piece),) if piece is pieces[-1] else ()
                self._add(replace(piece, waypoints=waypoints), name)
        slower = 1.0 if withdrawal.speed is None else leader.speed / withdrawal.speed
        target = Target.from_configuration(arm, entered.start)
        way = entered.waypoints[-1]
        out = Waypoint("outside", entered.rows - 1, replace(target, curve=way.target.curve), way=way.way)
        self._inside = None
        self._add(replace(_in_reverse(entered), interval=slower * entered.interval, waypoints=(out,)), name)

    def _wrap(self, wrapping: Wrapping, name: str) -> None:
        scene = Scene() if self._scene is None else self._scene
        grip = find_grip(self._arm, wrapping, scene, self._begin(), self._limits, clear=True)
        for way in grip.ways:
            self._hold(grip, way, name, () if way == "approach" else grip.beside)
        self._grip = grip

    def _carry(self, carrying: Carrying, name: str) -> None:
        grip = cast(Grip, self._grip)
        middle = grip.scene.obstacles[grip.obstacle].pose(np.zeros(3)).translation
        turn = pin.rpy.rpyToMatrix(*carrying.turn)
        moved = pin.SE3(turn, np.array(carrying.position) - turn @ middle)
        self._grip = carry(grip, moved, onto=carrying.onto)
        self._hold(self._grip, "carry", name, sorted({*grip.beside, *carrying.onto}))

    def _release(self, name: str) -> None:
        grip = cast(Grip, self._grip)
        opened = replace(grip, ways=opening_ways(grip))
        for way in opened.ways:
            self._hold(opened, way, name, grip.beside)
        self._scene = grip.scene
        self._grip = None

    def _hold(self, grip: Grip, way: str, name: str, beside: Sequence[str]) -> None:
        """Add a way of a grip, on which the object moves with the arm unless the arm approaches it."""
        piece = self._along(path_through(grip.arm, grip.ways[way]), None, 0.0)
        last = way in (list(grip.ways)[-1], "approach")
        waypoints = (_waypoint("" if way != "approach" else way, piece),) if last else ()
        if way != "approach":
            frame = grip.arm.control_points[grip.first]
            held = HeldObject(grip.obstacle, frame, begin=0, end=piece.rows - 1, beside=beside)
            piece = replace(piece, held=(held,))
        self._add(replace(piece, waypoints=waypoints), name)

    def _reversed(self, entered: Reference) -> list[Reference]:
        """Return the pieces since an insertion in reverse, the last first."""
        since = max(
            k for k, piece in enumerate(self._pieces) if np.shares_memory(piece.offsets, entered.offsets)
        )
        return [_in_reverse(piece) for piece in self._pieces[:since:-1]]

    def _begin(self) -> Array:
        """Return the configuration in which the next phase begins."""
        return self._arm.straight() if self._q is None else self._q

    def _along(self, path: JointPath, duration: float | None, hold: float) -> Reference:
        """Return a motion from rest to rest along a path, and the rest after it."""
        arm = self._arm
        travel = np.append(
            0.0, np.cumsum(np.abs(np.diff(path.offsets, axis=0) / arm.joint_units).max(axis=1))
        )
        if duration is None:
            moved = np.abs(np.diff(path.offsets, axis=0)).sum(axis=0)
            bound = self._limits.for_arm(arm).bound
            cycles = TRANSITION.peak_speed_ratio * float(
                (moved / np.where(np.isfinite(bound), bound, TRANSITION.row_step)).max()
            )
            duration = self._dt * max(cycles, TIP_MOTION.min_cycles)
        rows = max(
            ceil(duration / self._dt),
            TIP_MOTION.min_cycles,
            ceil(TRANSITION.peak_speed_ratio * travel[-1] / TRANSITION.row_step),
        )
        share = smooth_step(np.linspace(0.0, 1.0, rows + 1))
        parameters = np.interp(share * travel[-1], travel, np.arange(len(travel), dtype=np.float64))
        offsets = np.array([path.smooth_offset(float(s)) for s in parameters])
        held = round(hold / self._dt)
        offsets = np.vstack([offsets, np.repeat(offsets[-1:], held, axis=0)])
        durations = np.append(np.full(rows, duration / rows), np.full(held, self._dt))
        weights = np.ones((len(offsets), arm.n_modules))
        start = path.configuration(0)
        return Reference(arm, float(durations.min()), start, offsets - offsets[0], weights, (), durations)


def _in_reverse(piece: Reference) -> Reference:
    """Return a piece from its end to its beginning, without waypoints."""
    return replace(
        piece,
        start=piece.configuration(piece.rows - 1),
        offsets=piece.offsets[::-1] - piece.offsets[-1],
        weights=piece.weights[::-1],
        waypoints=(),
        durations=None if piece.durations is None else piece.durations[::-1],
    )


def _waypoint(name: str, piece: Reference) -> Waypoint:
    """Return the waypoint at the end of a piece."""
    q = piece.configuration(piece.rows - 1)
    return Waypoint(name, piece.rows - 1, Target.from_configuration(piece.arm, q))
