"""Ways that are planned and shown first, and then driven while something is held: forth, and back again."""

from __future__ import annotations

from collections.abc import Callable
from threading import Event
from typing import NamedTuple, cast

import numpy as np
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.collision import CollisionModel, Scene
from pinposture.control import JointPath, Limits, plan
from pinposture.control.limits import cycle_of
from pinposture.control.planner.avoidance import Avoidance
from pinposture.control.planner.damped_least_squares import PlanningProblem
from pinposture.control.planner.plan import repair
from pinposture.curve import Curve
from pinposture.errors import FileError, TaskError
from pinposture.motion.latest import Done, Latest
from pinposture.operate.leaders import LEADERS
from pinposture.placement import Target
from pinposture.task import Leader, Task
from pinposture.task.phases import is_phased
from pinposture.task.retreat import WayIn, can_retreat, nearest_posture
from pinposture.task.steering import describe_contact, margin_back, moving_target
from pinposture.task.wrap import path_through, s_in_time
from pinposture.units import CONVERGED

Array = NDArray[np.float64]


class WaySettings(NamedTuple):
    """How ways are planned and driven."""

    budget: float = 3.0
    """Time after which no other way is searched for among obstacles [s]: an operator waits for it."""

    retreat_budget: float = 20.0
    """The same for the way out of an arm with a joint that fails [s]; the search took 0.6 s in the median
    and 17 s at most in `make study STUDY=retreat`."""

    samples: int = 60
    """Number of postures of a way that are shown, and looked at when there are other obstacles: 1 ms for an
    arm of 16 joints and a ball. What comes too close between them is noticed by the step that leads there."""

    handles: int = 6
    """Control points of the curve along the arm, of which the first stays."""


WAYS = WaySettings()

FindPath = Callable[[Array, Scene], JointPath]
"""Finds a path from a configuration (nq,), clear of the obstacles of a scene; called in a thread."""


class PlannedWay:
    """A planned motion that is driven as far as something is held.

    Attributes:
        arm: the arm, in which joints that are stuck are locked.
        name: where it leads.
        at: how far it is driven [cycles].
        end: how long it is [cycles].
        goal: the configuration at its end, (nq,).
        rate: how fast it is driven, relative to the limits; negative: back.
        reason: why the last step was not as asked for; empty if it was.
        path: the path.

    Args:
        path: the path.
        limits: the limits of the joints, with the duration of a cycle.
        name: where it leads.
        driven: whether the arm is at its end.
    """

    def __init__(self, path: JointPath, limits: Limits, name: str, driven: bool = False) -> None:
        self.arm = path.arm
        self.name = name
        self.path = path
        self._s = s_in_time(path, limits)
        self._offsets = path.smooth_offset(self._s)
        self._rows = np.asarray(path.arm.integrate(path.start, self._offsets))
        self.goal = np.array(self._rows[-1])
        self.end = len(self._rows) - 1
        self.at = float(self.end) if driven else 0.0
        self.rate = 0.0
        self.reason = ""
        self._dt = cycle_of(limits)
        easing = LEADERS.easing / self._dt
        most = limits.for_arm(self.arm).acceleration
        if most is not None:
            moving = most > 0.0
            fastest = np.abs(self._steps()).max(axis=0)
            easing = max(easing, float((fastest[moving] / most[moving]).max(initial=0.0)))
        self._ease = 1.0 / easing
        self._model: CollisionModel | None = None
        self._cut: str | None = None  # what is in the way on the rest of it; None: not looked for

    @property
    def q(self) -> Array:
        """The configuration where the way is driven to, (nq,)."""
        return self._configuration(self.at)

    @property
    def start(self) -> Array:
        """The configuration at its beginning, (nq,)."""
        return np.array(self._rows[0])

    @property
    def line(self) -> Array:
        """Points of the way of the tip, (n, 3) [m], world frame."""
        return np.array([self.arm.chain_at(q).points[-1] for q in self._samples(0)])

    @property
    def rest(self) -> Array:
        """Displacements from where it is driven to it and the waypoints ahead, (n, nv) [rad or m]."""
        row = self._row(self.at)
        share = self.at - row
        s = (1.0 - share) * self._s[row] + share * self._s[row + 1]
        here = (1.0 - share) * self._offsets[row] + share * self._offsets[row + 1]
        ahead = self.path.offsets[int(s) + 1 :] - here
        return np.vstack([np.zeros((1, self.arm.nv)), ahead])

    def move(self, rate: float, scene: Scene) -> Target:
        """Drive it on for a cycle, or back.

        Args:
            rate: how fast, relative to the limits; from -1 to 1.
            scene: what the arm has to keep clear of.

        Returns:
            The target of this cycle, with its velocity.
        """
        before = self.q
        model = self._among(scene)
        faster = self.rate + float(np.clip(rate - self.rate, -self._ease, self._ease))
        stop = 0.5 * faster * max(abs(faster) / self._ease - 1.0, 0.0)
        self.reason = self._describe_contact(model, self.at + faster + stop)
        if self.reason:  # it was known before that it can stop on the way to there
            braked = float(np.copysign(max(abs(self.rate) - self._ease, 0.0), self.rate))
            faster = min(faster, braked, key=abs) if faster * braked > 0.0 else 0.0
            stopped = self._describe_contact(model, self.at + faster)
            faster = 0.0 if stopped else faster
        self.rate = faster
        self.at = self._within(self.at + faster)
        if self.at in (0.0, float(self.end)):
            self.rate = 0.0
        return moving_target(self.arm, before, self.q, self._dt)

    def obstruction(self, scene: Scene) -> str:
        """Return which pair comes too close on the rest of the way; empty if none does."""
        model = self._among(scene)
        if self._cut is None:
            ahead = self._samples(int(self.at))
            contacts = (describe_contact(model, self.q, q, scene.margin) for q in ahead)
            self._cut = next(filter(None, contacts), "")
        return self._cut or ("" if self.rate else self.reason)

    def _samples(self, first: int) -> Array:
        """Return some of its rows, from one on, (n, nq)."""
        numbers = np.unique(np.linspace(first, self.end, WAYS.samples).astype(int))
        return np.asarray(self._rows[numbers])

    def _among(self, scene: Scene) -> CollisionModel:
        """Return the distances from the obstacles of a scene."""
        if self._model is None or self._model.scene is not scene:
            self._model = CollisionModel(self.arm, scene)
            self._cut = None
        return self._model

    def _row(self, at: float) -> int:
        """Return the row before a time [cycles] that has another one behind it."""
        return min(int(at), self.end - 1)

    def _within(self, at: float) -> float:
        """Return a time [cycles], or that of the nearer end if it is beyond."""
        return min(max(at, 0.0), float(self.end))

    def _describe_contact(self, model: CollisionModel, at: float) -> str:
        """Return which pair comes too close if it is driven to a time [cycles]; empty if none does."""
        margin = margin_back(model.scene) if at < self.at else model.scene.margin
        return describe_contact(model, self.q, self._configuration(self._within(at)), margin)

    def _steps(self) -> Array:
        """Return the steps between its rows, (n, nv)."""
        return self.arm.difference(self._rows[:-1], self._rows[1:])

    def _configuration(self, at: float) -> Array:
        """Return the configuration at a time [cycles], (nq,)."""
        row = self._row(at)
        step = self.arm.difference(self._rows[row], self._rows[row + 1])
        return np.asarray(self.arm.integrate(self._rows[row], (at - row) * step))


class Planned(NamedTuple):
    """What a page shows of the way that is planned.

    Attributes:
        number: tells it from others: a page says which it drives.
        text: where it leads and how far it is driven, or why there is none.
        goal: the configuration at its end, (nq,); None if there is no way.
        line: points of the way of the tip, (n, 3) [m].
    """

    number: int
    text: str
    goal: Array | None
    line: Array


NO_PLAN = "nothing is planned"


class WantedWay(NamedTuple):
    """A way that is to be found.

    Attributes:
        name: where it is to lead.
        q: where the arm is, (nq,).
        scene: what it keeps clear of.
        find: finds the path.
        instead_of: the way whose rest it replaces; None: it is a way of its own.
    """

    name: str
    q: Array
    scene: Scene
    find: FindPath
    instead_of: PlannedWay | None = None


class Ways:
    """The way that is planned, and what was driven before it, which can be driven back.

    Plans are made in a thread of their own. A new plan takes the place of one that was not begun; while a way
    is being driven, none does.

    Attributes:
        planned: what to show; may be read from any thread.
        way: the way that is planned, or was driven last; None: there is none.
        driven: in which direction a way was driven last: positive on, negative back, 0 in none.

    Args:
        limits: the limits of the joints, with the duration of a cycle.
    """

    def __init__(self, limits: Limits) -> None:
        self.planned = Planned(0, NO_PLAN, None, np.zeros((0, 3)))
        self.way: PlannedWay | None = None
        self.driven = 0.0
        self._limits = limits
        self._driven: list[PlannedWay] = []
        self._led: WayIn | None = None
        self._led_to: Array | None = None
        self._found: Done[WantedWay, PlannedWay] | None = None
        self._failed: WantedWay | None = None  # the way around something that was not found last
        self._why_not = ""
        self._finder: Latest[WantedWay, PlannedWay] = Latest(
            self._find, "pinposture-ways", deliver=self._deliver
        )

    @property
    def moving(self) -> bool:
        """Whether the way is being driven."""
        return self.way is not None and self.way.rate != 0.0

    def ask(self, name: str, q: Array, scene: Scene, find: FindPath) -> None:
        """Have a way planned; returns at once. May be called from any thread.

        Args:
            name: where it is to lead.
            q: where the arm is, (nq,).
            scene: what it keeps clear of.
            find: finds the path.
        """
        self._finder.ask(WantedWay(name, q, scene, find))

    def poll(self, q: Array) -> PlannedWay | None:
        """Take a way that was found meanwhile, for an arm that is at a configuration (nq,).

        Returns:
            The way; None if there is no new one.
        """
        done = self._found
        if done is None or self.moving:
            return None
        self._found = None
        way = done.answer
        request = done.request
        fault = "" if way is not None else f"no way: {done.error}"
        if way is not None and not _is_at(way.arm, q, way.start):
            fault = "the arm has moved since the way was planned"
        replaced = request.instead_of
        if way is None and replaced is not None:
            self._failed = request
            self._why_not = f"; around what is on it {fault}"
        elif fault and replaced is None:
            self.say(f"{request.name}: {fault}")
        if way is None or fault or replaced not in (None, self.way):
            return None
        self._keep()
        self.way = way
        self._show(way, new=replaced is None or not _is_at(way.arm, way.goal, replaced.goal))
        return way

    def go_around(self, scene: Scene) -> str:
        """Have the rest of the way planned anew if an obstacle of a scene is on it; returns at once.

        A way that is found takes the place of the one that is planned. It has its number, and so is driven
        while that is held, unless it ends elsewhere, as the end is blocked by now. If none is found, the way
        that there is can be driven as far as it is clear; there another one is searched for each time that
        the scene has changed.

        Returns:
            Why the arm has to wait for it; empty if it can go on.
        """
        way = self.way
        cut = "" if way is None else way.obstruction(scene)
        if way is None or not cut:
            return ""
        failed = self._failed
        if failed is not None and failed.instead_of is way:
            stands = bool(way.reason) and not way.rate
            if failed.scene is scene or not stands:
                return ""
        if not (way.rate or self._finder.working or self._found is not None):
            self._finder.ask(WantedWay(way.name, way.q, scene, around(way, self._limits), way))
        return f"{cut}; a way around it is looked for"

    def drive(self, rate: float, scene: Scene) -> Target | None:
        """Drive the way on for a cycle, or back, as `PlannedWay.move`; None beyond its ends."""
        way = self.way
        if rate < 0.0 and (way is None or way.at == 0.0):
            way = self._before() or way
        if way is None or (rate and not way.rate and way.at == (way.end if rate > 0.0 else 0.0)):
            return None
        self.way = way
        target = way.move(rate, scene)
        self.driven = way.rate or self.driven
        self._show(way)
        return target

    def lead(self, arm: Arm, before: Array, q: Array, kept: bool) -> None:
        """Tell that the tip led an arm from a configuration to another, (nq,).

        Args:
            arm: the arm.
            before: the configuration before.
            q: the configuration.
            kept: whether this is to be driven back here.
        """
        if self.way is not None:
            self.say(NO_PLAN)
        if not kept:
            return
        if self._led is None:
            self._led = WayIn(arm)
            self._led.add(before)
        self._led.add(q)
        self._led_to = q

    def say(self, text: str) -> None:
        """Show words in place of a way; what was driven can still be driven back."""
        if self.way is not None:
            self._keep()
            self.way = None
        self.planned = Planned(self.planned.number + 1, text, None, np.zeros((0, 3)))

    def forget(self) -> None:
        """Forget all ways."""
        self.say(NO_PLAN)
        self._driven = []
        self._led = None

    def close(self) -> None:
        """End the thread in which plans are made."""
        self._finder.close()

    def _keep(self) -> None:
        """Keep what was driven last, to drive it back."""
        if self.way is not None and self.way.at > 0.0:
            self._driven.append(self.way)
        elif self.way is None and self._led is not None:
            rows = self._led.until(cast(Array, self._led_to))
            if len(rows) > 1:
                path = path_through(self._led.arm, rows)
                self._driven.append(PlannedWay(path, self._limits, "the way of the tip", driven=True))
        self._led = None

    def _before(self) -> PlannedWay | None:
        """Return what was driven before, if anything."""
        if self.way is None:
            self._keep()
        return self._driven.pop() if self._driven else None

    def _show(self, way: PlannedWay, new: bool = True) -> None:
        """Say how far a way is driven, which may be new, or the rest of the one that is shown."""
        shown = self.planned
        failed = self._failed is not None and self._failed.instead_of is way
        text = f"{way.name}: {100.0 * way.at / way.end:.0f} % driven{self._why_not if failed else ''}"
        if shown.goal is way.goal:
            self.planned = shown._replace(text=text)
        else:
            self.planned = Planned(shown.number + new, text, way.goal, way.line)

    def _find(self, request: WantedWay, outdated: Event) -> PlannedWay:
        """Find a path, and its motion; runs in the thread."""
        path = request.find(request.q, request.scene)
        return PlannedWay(path, self._limits, request.name)

    def _deliver(self, done: Done[WantedWay, PlannedWay]) -> None:
        self._found = done


def _is_at(arm: Arm, q: Array, goal: Array) -> bool:
    """Return whether a configuration is at another one, (nq,), but for rounding."""
    return bool(np.all(np.abs(arm.difference(q, goal)) <= CONVERGED * arm.joint_units))


def towards(arm: Arm, goal: Target, limits: Limits, name: str) -> FindPath:
    """Return what finds a path to a target posture; if its configuration is not known, to the nearest one."""

    def find(q: Array, scene: Scene) -> JointPath:
        there = goal
        if goal.q is None:
            posture = nearest_posture(arm.chain_at(q), goal, scene, limits.for_arm(arm))
            there = Target.from_configuration(arm, posture.q)
        path = plan(arm.at(q), there, scene, limits, budget=WAYS.budget, strict=False)
        if path.blocked_by:
            raise TaskError(name, path.blocked_by)
        return path

    return find


def around(way: PlannedWay, limits: Limits) -> FindPath:
    """Return what finds the rest of a way around what is on it by now; if need be, another way to its end."""
    arm = way.arm
    objective = way.path.objective
    rest = way.rest
    goal = Target.from_configuration(arm, way.goal)

    def find(q: Array, scene: Scene) -> JointPath:
        bounds = limits.for_arm(arm)
        avoidance = Avoidance.of(scene, objective, bounds)
        repaired = repair(
            PlanningProblem(objective, arm.chain_at(q), bounds.position_limits, avoidance), rest
        )
        return towards(arm, goal, limits, way.name)(q, scene) if repaired is None else repaired

    return find


def out_of(arm: Arm, way_in: WayIn, joint: str, limits: Limits, torque: float | None = None) -> FindPath:
    """Return what finds the way out of an arm with a joint that fails.

    Args:
        arm: the arm, whose joints all work.
        way_in: the way by which it went in.
        joint: the joint.
        limits: the limits of the joints.
        torque: None: the joint sticks. Else its drive gives at most this torque or force [N m or N].
    """

    def find(q: Array, scene: Scene) -> JointPath:
        rows = way_in.until(q)
        (way,) = can_retreat(
            arm,
            rows,
            scene,
            joint,
            torque=torque,
            postures=[len(rows) - 1],
            limits=limits,
            budget=WAYS.retreat_budget,
        ).ways
        if way.path is None:
            raise TaskError("the way out", way.reason)
        return way.path

    return find


class CurveAlong(NamedTuple):
    """A curve along an arm, whose control points are dragged; the arm is to take its shape.

    Attributes:
        q: the configuration of the arm at first, (nq,).
        points: the control points, (n, 3) [m], world frame; the first one stays.
    """

    q: Array
    points: Array

    @classmethod
    def of(cls, arm: Arm, q: Array) -> CurveAlong:
        """Return the curve along an arm at a configuration, (nq,); on a feed, it begins behind that."""
        return cls(q, np.array(_line_along(arm, q).controlled(WAYS.handles).coefficients))

    def target(self, arm: Arm) -> Target:
        """Return the target of an arm whose control points are moved as the points of the curve are.

        Raises:
            CurveError: control points that coincide.
        """
        points = np.array(arm.chain_at(self.q).points)
        line = _line_along(arm, self.q)
        before = line.controlled(WAYS.handles)
        after = Curve.spline(self.points)
        lengths = np.linalg.norm(np.diff(line.coefficients, axis=0), axis=1)
        s = np.append(0.0, np.cumsum(lengths))[-len(points) :]
        points += _extended(after, s) - _extended(before, s)
        return Target.from_points(arm, points)


def _line_along(arm: Arm, q: Array) -> Curve:
    """Return the line through the control points of an arm, from the base, or behind the feed, on."""
    points = arm.chain_at(q).points
    if not arm.slides[arm.chain.columns[0]]:
        points = np.vstack([arm.chain.base, points])
    return Curve.spline(points, degree=1)


def _extended(curve: Curve, s: Array) -> Array:
    """Return the points of a curve, straight on behind its end, at arc lengths (n,) [m], (n, 3) [m]."""
    beyond = np.maximum(s - curve.length, 0.0)
    ahead = curve.tangent(np.array([curve.length]))[0]
    return np.asarray(curve.at(np.minimum(s, curve.length)) + beyond[:, None] * ahead)


class NextStep(NamedTuple):
    """A posture to which the arm goes when the operator asks for the next step.

    Attributes:
        name: what to call it.
        target: the posture.
    """

    name: str
    target: Target


def read_steps(arm: Arm, path: str) -> list[NextStep]:
    """Return the postures of the keyframes of a task file as steps.

    Raises:
        FileError: as `Task.load`, or it is a task of another arm, or without keyframes.
    """
    task = Task.load(path)
    if task.arm.joint_names != arm.joint_names:
        allowed = f"a task for the same {arm.nv} joints as the arm that is operated"
        raise FileError(path, f"is for an arm of {task.arm.nv} joints with other names; allowed: {allowed}")
    if isinstance(task.motion, Leader) or is_phased(task.motion):
        raise FileError(path, "has no keyframes; allowed: a task of keyframes")
    return [NextStep(waypoint.name, waypoint.target) for waypoint in task.reference().waypoints]
