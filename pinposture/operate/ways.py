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
from pinposture.curve import Curve
from pinposture.errors import FileError, TaskError
from pinposture.motion.latest import Done, Latest
from pinposture.operate.leaders import LEADERS
from pinposture.placement import Target
from pinposture.task import Leader, Task
from pinposture.task.phases import is_phased
from pinposture.task.retreat import WayIn, can_retreat, nearest_posture
from pinposture.task.steering import describe_contact, margin_back, moving_target
from pinposture.task.wrap import path_through, rows_in_time

Array = NDArray[np.float64]


class WaySettings(NamedTuple):
    """How ways are planned and driven."""

    budget: float = 3.0
    """Time after which no other way is searched for among obstacles [s]: an operator waits for it."""

    retreat_budget: float = 20.0
    """The same for the way out of an arm with a joint that is stuck [s]; the search took 0.6 s in the median
    and 17 s at most in `make study STUDY=retreat`."""

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

    Args:
        path: the path.
        limits: the limits of the joints, with the duration of a cycle.
        name: where it leads.
        driven: whether the arm is at its end.
    """

    def __init__(self, path: JointPath, limits: Limits, name: str, driven: bool = False) -> None:
        self.arm = path.arm
        self.name = name
        self._rows = rows_in_time(path, limits)
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
        rows = self._rows[np.unique(np.linspace(0, self.end, 60).astype(int))]
        return np.array([self.arm.chain_at(q).points[-1] for q in rows])

    def move(self, rate: float, scene: Scene) -> Target:
        """Drive it on for a cycle, or back.

        Args:
            rate: how fast, relative to the limits; from -1 to 1.
            scene: what the arm has to keep clear of.

        Returns:
            The target of this cycle, with its velocity.
        """
        before = self.q
        if self._model is None or self._model.scene is not scene:
            self._model = CollisionModel(self.arm, scene)
        faster = self.rate + float(np.clip(rate - self.rate, -self._ease, self._ease))
        stop = 0.5 * faster * max(abs(faster) / self._ease - 1.0, 0.0)
        self.reason = self._describe_contact(self._model, self.at + faster + stop)
        if self.reason:  # it was known before that it can stop on the way to there
            braked = float(np.copysign(max(abs(self.rate) - self._ease, 0.0), self.rate))
            faster = min(faster, braked, key=abs) if faster * braked > 0.0 else 0.0
            stopped = self._describe_contact(self._model, self.at + faster)
            faster = 0.0 if stopped else faster
        self.rate = faster
        self.at = self._within(self.at + faster)
        if self.at in (0.0, float(self.end)):
            self.rate = 0.0
        return moving_target(self.arm, before, self.q, self._dt)

    def _within(self, at: float) -> float:
        """Return a time [cycles], or that of the nearer end if it is beyond."""
        return min(max(at, 0.0), float(self.end))

    def _describe_contact(self, model: CollisionModel, at: float) -> str:
        """Return which pair comes too close if it is driven to a time [cycles]; empty if none does."""
        margin = margin_back(model.scene) if at < self.at else model.scene.margin
        return describe_contact(model, self.q, self._configuration(self._within(at)), margin)

    def _steps(self) -> Array:
        """Return the steps between its rows, (n, nv)."""
        pairs = zip(self._rows[:-1], self._rows[1:], strict=True)
        return np.array([self.arm.difference(one, other) for one, other in pairs])

    def _configuration(self, at: float) -> Array:
        """Return the configuration at a time [cycles], (nq,)."""
        row = min(int(at), self.end - 1)
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
    """

    name: str
    q: Array
    scene: Scene
    find: FindPath


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
        if way is None:
            self.say(f"{done.request.name}: no way: {done.error}")
            return None
        away = np.abs(way.arm.difference(q, way.start)) / way.arm.joint_units
        if away.max() > LEADERS.rejoined:
            self.say(f"{way.name}: the arm has moved since the way was planned")
            return None
        self._keep()
        self.way = way
        self._show(way)
        return way

    def drive(self, rate: float, scene: Scene) -> Target | None:
        """Drive the way on for a cycle, or back, as `PlannedWay.move`; None at its end."""
        way = self.way
        if rate < 0.0 and (way is None or way.at == 0.0):
            way = self._before() or way
        if way is None or (way.rate == 0.0 and way.at == (way.end if rate > 0.0 else 0.0)):
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

    def _show(self, way: PlannedWay) -> None:
        """Say how far a way is driven."""
        shown = self.planned
        text = f"{way.name}: {100.0 * way.at / way.end:.0f} % driven"
        if shown.goal is way.goal:
            self.planned = shown._replace(text=text)
        else:
            self.planned = Planned(shown.number + 1, text, way.goal, way.line)

    def _find(self, request: WantedWay, outdated: Event) -> PlannedWay:
        """Find a path, and its motion; runs in the thread."""
        path = request.find(request.q, request.scene)
        return PlannedWay(path, self._limits, request.name)

    def _deliver(self, done: Done[WantedWay, PlannedWay]) -> None:
        self._found = done


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


def out_of(arm: Arm, way_in: WayIn, joint: str, limits: Limits) -> FindPath:
    """Return what finds the way out of an arm with a joint that is stuck.

    Args:
        arm: the arm, whose joints all work.
        way_in: the way by which it went in.
        joint: the joint.
        limits: the limits of the joints.
    """

    def find(q: Array, scene: Scene) -> JointPath:
        rows = way_in.until(q)
        last = [len(rows) - 1]
        ways = can_retreat(
            arm, rows, scene, joint, postures=last, limits=limits, budget=WAYS.retreat_budget
        ).ways
        if ways[0].path is None:
            raise TaskError("the way out", ways[0].reason)
        return ways[0].path

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
        """Return the target of an arm whose control points are moved as their places on the curve are.

        Raises:
            CurveError: control points that coincide.
        """
        points = np.array(arm.chain_at(self.q).points)
        line = _line_along(arm, self.q)
        before = line.controlled(WAYS.handles)
        after = Curve.spline(self.points)
        lengths = np.linalg.norm(np.diff(line.coefficients, axis=0), axis=1)
        places = np.append(0.0, np.cumsum(lengths))[-len(points) :]
        points += _extended(after, places) - _extended(before, places)
        return Target.from_points(arm, points)


def _line_along(arm: Arm, q: Array) -> Curve:
    """Return the line through the control points of an arm, from the base, or behind the feed, on."""
    points = arm.chain_at(q).points
    if not arm.slides[arm.chain.columns[0]]:
        points = np.vstack([arm.chain.base, points])
    return Curve.spline(points, degree=1)


def _extended(curve: Curve, places: Array) -> Array:
    """Return the points of a curve, straight on behind its end, at arc lengths (n,) [m], (n, 3) [m]."""
    beyond = np.maximum(places - curve.length, 0.0)
    ahead = curve.tangent(np.array([curve.length]))[0]
    return np.asarray(curve.at(np.minimum(places, curve.length)) + beyond[:, None] * ahead)


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
