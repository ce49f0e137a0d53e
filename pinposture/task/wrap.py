"""Wrap an arm around an object, carry the object, and let go of it.

The last modules of the arm hold the object, the others move it. The frame at the end of the last free module
stands where a curve around the object begins, along the curve. The wrapped modules first stand off straight,
a margin beside a tangent of the object, and then bend onto the curve; while all bend in proportion, they are
on curves of larger radius with nearly the same tangent, so the arm closes from outside. The object is carried
as the free modules move that frame, while the wrapped ones stay as they are. From then on it is a part of the
arm (`Scene.carried`), until it is let go.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from math import isfinite
from types import MappingProxyType
from typing import Annotated, Any, NamedTuple, cast

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import (
    SMALLEST_LENGTH,
    as_number,
    make_read_only,
    point,
    require_finite,
    require_instance,
    require_known,
    require_positive,
    require_whole,
)
from pinposture.arm import Arm, ArmState, ChainState
from pinposture.collision import Carried, CollisionModel, Scene
from pinposture.collision.bodies import bodies_of
from pinposture.collision.model import MOTION_TOLERANCE, Distances, Pair
from pinposture.collision.obstacles import displaced
from pinposture.collision.wrapping import Winding, as_turns, winding_around
from pinposture.control import EndEffector, Hold, JointPath, Limits, Objective, assess_hold, plan, retime
from pinposture.control.hold import squeezing_torques
from pinposture.control.limits import cycle_of
from pinposture.control.reach import bring_to_goal
from pinposture.control.tasks import link_axes
from pinposture.curve import Curve
from pinposture.errors import InvalidValue, TargetError, TaskError, raise_together
from pinposture.motion import JointTrajectory
from pinposture.motion.files import Format, check_arrays, register
from pinposture.placement import Target, resolve_targets
from pinposture.placement.target import arm_axis
from pinposture.schema import CheckedBy, Declared, Text, declared, quantity
from pinposture.units import length_text

Array = NDArray[np.float64]


class WindingSettings(NamedTuple):
    """How an arm is wound around an object, holds it, and carries it."""

    pitch: float = 3.0
    """Advance of a turn in radii of the arm: where it squeezes, turns are still half a radius apart."""

    touches: float = 2e-4
    gap_corrections: int = 5
    """Distance from the object, or overlap with it, at which the wrapped arm counts as touching, in arm
    lengths, and the largest number of gaps that are tried. Three arms needed one to three gaps around
    cylinders and capsules, up to four around boxes, where 0.12 mm remained with an arm of 1 m."""

    within: float = 2e-3
    """Distance of bodies that count as in contact in the assessment of a hold, in arm lengths."""

    reached: float = 1e-5
    """Distance of a frame from its goal that counts as reached, in arm lengths."""

    steps_per_module: int = 2
    """Postures for each module that is wound, one after the other."""

    seed_bends: tuple[float, ...] = 0.3, -0.3
    """Bends of the free modules in postures that the search for the first frame starts from, one period of
    a cosine, in `Arm.joint_units`. With a third or twice of these it ended in the same posture, to 1e-3
    rad."""

    carry_step: float = 0.01
    largest_turn: float = 0.3
    """Displacement between postures while an object is carried, in arm lengths, and the joint motion
    between two of them that counts as a jump to another posture [rad]."""

    least_squeeze: float = 0.01
    less_squeeze: float = 0.95
    """Smallest share of a squeeze that is commanded where the arm would touch itself, and the steps to
    it."""


WINDING = WindingSettings()


def _as_share(name: str, value: Any) -> float:
    return as_number(name, value, "a share from 0 to 1", lambda x: 0.0 <= x <= 1.0)


@declared()
class Wrapping(Declared):
    """How an arm wraps around an object of a scene; see `wrap`.

    Attributes:
        obstacle: name of the object, which is touchable.
        turns: number of turns about its axis; negative: clockwise.
        friction: coefficient of friction between arm and object.
        squeeze: share by which the wrapped joints are commanded to bend further than where they touch.
        force: normal force with which contacts are to press, in place of that share [N]; the stiffness of the
            arm has to be known. None: the share.

    Raises:
        InvalidValue: an invalid value.
    """

    obstacle: Text
    turns: Annotated[float, CheckedBy(as_turns)] = 1.0
    friction: Annotated[float, CheckedBy(partial(require_positive, zero=True))] = 1.0
    squeeze: Annotated[float, CheckedBy(_as_share)] = 0.1
    force: Annotated[float, quantity("force", above=0.0)] | None = None


@dataclass(frozen=True, eq=False)
class Grip:
    """An arm that is wrapped around an object, and the motions that lead there.

    Attributes:
        arm: the arm.
        scene: the obstacles; the object is where it is after the motions.
        obstacle: name of the object.
        limits: the limits of the motions.
        friction: coefficient of friction between arm and object.
        first: index of the control point where the wrap begins, the last that is free, 0-based.
        opened: configuration in which the arm stands off with its wrapped modules straight, clear of the
            object by the margin, (nq,).
        winding: displacements from it to the wrap, the first of which is zero, (r, nv) [rad or m].
        touching: configuration in which all wrapped modules touch the object, (nq,).
        held: configuration to command for the arm to squeeze, (nq,).
        displacement: displacement of the object since it was wrapped, a homogeneous matrix, (4, 4), world
            frame.
        ways: configurations on the way by phase, (n, nq) each: "approach", "wind" and "squeeze", or "carry".
    """

    arm: Arm
    scene: Scene
    obstacle: str
    limits: Limits
    friction: float
    first: int
    opened: Array
    winding: Array
    touching: Array
    held: Array
    displacement: Array
    ways: Mapping[str, Array]

    def __post_init__(self) -> None:
        make_read_only(*vars(self).values(), *self.ways.values())

    def __repr__(self) -> str:
        count = self.arm.n_modules - self.first - 1
        closed = "force closure" if self.hold.closed else "no force closure"
        return f"Grip({self.obstacle}, {count} modules, {closed}, up to {self.hold.mass:.3g} kg)"

    @cached_property
    def phases(self) -> Mapping[str, JointTrajectory]:
        """The motions by phase, each from rest to rest within the limits."""
        return MappingProxyType(
            {name: _timed(path_through(self.arm, way), self.limits) for name, way in self.ways.items()}
        )

    @property
    def motion(self) -> JointTrajectory:
        """All phases in one motion."""
        return JointTrajectory.joined(tuple(self.phases.values()))

    @cached_property
    def hold(self) -> Hold:
        """How well the arm holds the object.

        Raises:
            WeightUnknown: masses of the arm that are not known.
        """
        within = WINDING.within * self.arm.length
        return assess_hold(self.arm, self.touching, self.scene, self.obstacle, self.friction, within)

    def summary(self) -> dict[str, Any]:
        """Return the results as JSON-compatible data [m, s, kg]."""
        hold = self.hold
        return {
            "kind": "grip",
            "obstacle": self.obstacle,
            "modules": self.arm.n_modules - self.first - 1,
            "first": self.arm.control_points[self.first],
            "friction": self.friction,
            "contacts": len(hold.bodies),
            "force_closure": hold.closed,
            "mass": hold.mass if isfinite(hold.mass) else None,
            "displacement": self.displacement.tolist(),
            "durations": {name: motion.duration for name, motion in self.phases.items()},
        }

    @cached_property
    def carrying(self) -> Scene:
        """The scene while the arm holds the object, which is a part of the arm then.

            tracker = pp.Tracker(arm, limits=limits, scene=grip.carrying)

        The object need not keep clear of what it stands on here, or is within the margin of.
        """
        return self._carrying(self.beside)

    @cached_property
    def beside(self) -> tuple[str, ...]:
        """Names of the obstacles that the object stands on, or is within the margin of."""
        pairs = self._near(self.touching).pairs
        near = {other for body, other in pairs if body == self.obstacle and other in self.scene.obstacles}
        return tuple(sorted(near))

    def _carrying(self, beside: Sequence[str]) -> Scene:
        """Return the scene in which the arm carries the object, beside some obstacles."""
        frame = _frame(self.arm.at(self.touching), self.first)
        carried = Carried(
            self.arm.control_points[self.first],
            position=frame.translation,
            rotation=frame.rotation,
            beside=beside,
        )
        return replace(self.scene, carried={**self.scene.carried, self.obstacle: carried})

    def _near(self, q: Array) -> Distances:
        """Return the pairs within the margin at a configuration, (nq,), with the object as it is carried."""
        model = CollisionModel(self.arm, self._carrying(()))
        return model.nearest(self.arm.at(q), self.scene.margin)


def wrap(
    arm: Arm,
    obstacle: str,
    scene: Scene,
    q0: ArrayLike,
    limits: Limits,
    *,
    turns: float = 1.0,
    friction: float = 1.0,
    squeeze: float = 0.1,
    force: float | None = None,
) -> Grip:
    """Plan how an arm wraps around an object and squeezes it.

        scene = pp.Scene({"can": can}, touchable=["can"])
        limits = pp.Limits(step=None, dt=0.02, velocity=1.0, acceleration=4.0)
        grip = pp.wrap(arm, "can", scene, q0, limits, turns=1.0, friction=0.5)
        grip.hold.mass
        ended = sim.simulate(arm, grip.motion, scene=scene, contact=sim.ContactModel(masses={"can": 0.3}))

    The arm goes to a posture in which its free modules bring it beside the object along a tangent, with the
    others straight (`plan`, clear of the scene and of the object). Then these bend around the object, all at
    once if that is clear, else one after the other, and on beyond contact: the drives then press with what
    their stiffness and their torque limits give. The curve is that of `curve_around`, from the side on which
    the base stands.

    Args:
        arm: the arm.
        obstacle: name of the object: a sphere, capsule, cylinder, box or mesh, which is touchable.
        scene: the obstacles.
        q0: the configuration at first, (nq,).
        limits: limits of the motions, with `dt` and `acceleration`.
        turns: number of turns about the axis of the object, rounded up to whole modules; counterclockwise
            seen from the tip of the axis, negative: clockwise.
        friction: coefficient of friction, for the assessment of the hold.
        squeeze: share by which the wrapped joints are commanded to bend further than where they touch, up
            to their limits.
        force: normal force with which contacts are to press [N], in place of that share. The commands then
            bend the joints further by the torques that this takes, divided by their stiffness, which has to
            be known (`Arm.with_stiffness`). It is met in the mean on a hard object; how the load is shared
            between contacts is up to friction. None: the share.

    Raises:
        UnknownName: there is no such obstacle.
        InvalidValue: an obstacle that is not touchable or cannot be wrapped, or an invalid argument.
        TaskError: the arm does not get around the object; says where and why.
        WeightUnknown: masses of the arm, or with a force its stiffness, that are not known.
    """
    require_instance("arm", arm, Arm, "an Arm")
    require_instance("scene", scene, Scene, "a Scene(...)")
    wrapping = Wrapping(obstacle, turns=turns, friction=friction, squeeze=squeeze, force=force)
    require_touchable(obstacle, scene)
    start = arm.checked_start(q0, "q0")
    cycle_of(limits)
    if limits.acceleration is None:
        raise InvalidValue("limits.acceleration", None, "a limit of acceleration")
    arm.require_masses()
    return find_grip(arm, wrapping, scene, start, limits)


def require_touchable(obstacle: str, scene: Scene) -> None:
    """Refuse an obstacle that a scene lacks, or that the arm may not touch there."""
    require_known("obstacle", obstacle, scene.obstacles)
    if obstacle not in scene.touchable:
        raise InvalidValue(
            "obstacle", obstacle, f"one that may be touched: Scene(..., touchable=[{obstacle!r}])"
        )


def find_grip(
    arm: Arm, wrapping: Wrapping, scene: Scene, start: Array, limits: Limits, *, clear: bool = False
) -> Grip:
    """Find how an arm wraps around an object, from a configuration, (nq,); as `wrap`.

    With `clear`, it is commanded to squeeze only as far as the commanded arm keeps the margin to itself and
    to others, as what follows it among obstacles needs; the real arm stops at the object before.
    """
    obstacle = wrapping.obstacle
    wound = _Wrap(arm, obstacle, scene, wrapping.turns).find(start)
    way = wound.winding
    touching = arm.integrate(wound.opened, way[-1])
    further = wrapping.squeeze * way[-1]
    if wrapping.force is not None:
        further = _pressed(arm, touching, scene, wrapping)
    further = np.where(_holds(arm, wound.first), further, 0.0)
    if clear:
        held = _squeezed(arm, scene, obstacle, touching, further)
    else:
        held = _within_limits(arm, arm.integrate(touching, further))
    beyond = np.abs(arm.difference(held, touching) + further).max()
    if wrapping.force is not None and beyond > WINDING.reached:
        reason = (
            f"the commands that press with {wrapping.force:g} N reach a limit, or the margin to something"
        )
        raise TaskError(_where(obstacle), f"{reason}; ask for less, or use stiffer joints")
    goal = Target.from_configuration(arm, wound.opened)
    approach = plan(arm.at(start), goal, _untouchable(scene, obstacle), limits)
    if approach.blocked_by:
        raise TaskError(_where(obstacle), f"the way to where it begins is blocked: {approach.blocked_by}")
    ways = {"wind": arm.integrate(wound.opened, way), "squeeze": np.array([touching, held])}
    if approach.length > 0.0:
        ways = {"approach": approach.configurations, **ways}
    return Grip(
        arm=arm,
        scene=scene,
        obstacle=obstacle,
        limits=limits,
        friction=wrapping.friction,
        first=wound.first,
        opened=wound.opened,
        winding=way,
        touching=touching,
        held=held,
        displacement=np.eye(4),
        ways=MappingProxyType(ways),
    )


def _pressed(arm: Arm, touching: Array, scene: Scene, wrapping: Wrapping) -> Array:
    """Return how far joints are commanded beyond contact, to press with a force, (nv,) [rad or m]."""
    force = cast(float, wrapping.force)
    torques, share = squeezing_torques(
        arm,
        touching,
        scene,
        wrapping.obstacle,
        friction=wrapping.friction,
        within=WINDING.within * arm.length,
        force=force,
    )
    if share > 1.0:
        reason = f"pressing with {force:g} N takes {share:.3g} times the torque of a joint; ask for less"
        if not isfinite(share):
            reason = "no forces that press everywhere balance on it: more turns, or more friction, are needed"
        raise TaskError(_where(wrapping.obstacle), reason)
    return np.asarray(np.linalg.solve(arm.stiffness, torques))


def _squeezed(arm: Arm, scene: Scene, obstacle: str, touching: Array, further: Array) -> Array:
    """Return a configuration that is commanded to squeeze, (nq,).

    Args:
        arm: the arm.
        scene: the scene.
        obstacle: name of the object.
        touching: the configuration that touches it, (nq,).
        further: displacement beyond it, (nv,) [rad or m]; it is cut short where joint limits, or the margin
            to all but the object, are reached.
    """
    others = {name: shape for name, shape in scene.obstacles.items() if name != obstacle}
    model = CollisionModel(arm, scene.with_obstacles(others))
    share = 1.0
    while share > WINDING.least_squeeze:
        held = _within_limits(arm, arm.integrate(touching, share * further))
        if model.minimum_between(touching, arm.difference(touching, held)).distance >= scene.margin:
            return held
        share *= WINDING.less_squeeze
    return touching


def carry(grip: Grip, displacement: pin.SE3 | ArrayLike, *, onto: Sequence[str] = ()) -> Grip:
    """Plan how an arm carries the object that it holds, along a straight line.

        lifted = pp.carry(grip, (0, 0, 0.2))
        down = pp.carry(lifted, (0.1, 0, -0.2), onto=["table"])

    The free modules move the frame where the wrap begins; the wrapped ones stay as they are. The arm and the
    object keep clear of the scene. Obstacles that the object stands on at first, or is within the margin of,
    may be as close until they part. There is no way around others: carry the object in several parts.

    Args:
        grip: the arm and the object.
        displacement: of the object from where it is, a translation, (3,) [m], or a `pin.SE3`, world frame.
        onto: names of obstacles that the object may touch on the way, to be put down on them.

    Returns:
        The grip at the other place, with the motion there.

    Raises:
        InvalidValue: not a grip, or an invalid displacement.
        UnknownName: no obstacle of a name in `onto`.
        TaskError: the arm does not get there; says how far it gets, and why not farther.
    """
    require_instance("grip", grip, Grip, "a Grip, as pp.wrap(...) returns it")
    arm = grip.arm
    motion: pin.SE3 = displacement
    if not isinstance(displacement, pin.SE3):
        motion = pin.SE3(np.eye(3), np.array(point("displacement", displacement)))
    require_instance("onto", onto, list | tuple, "a list of names of obstacles")
    for name in onto:
        require_known("obstacle", name, grip.scene.obstacles)
    middle = grip.scene.obstacles[grip.obstacle].pose(np.zeros(3)).translation
    state = arm.chain_at(grip.held)
    frame = _frame(state, grip.first)
    loose = arm.difference(grip.held, grip.touching)
    rows = [grip.held]
    way = _CarriedWay(grip, onto)
    for share, moved in _displacements(motion, middle, arm.length):
        state, error = bring_to_goal(arm, EndEffector(pose=moved * frame, point=grip.first), state)
        step = arm.difference(rows[-1], state.q)
        if error > WINDING.reached * arm.length or np.abs(step).max() > WINDING.largest_turn:
            why = "the free modules do not get farther"
        else:
            why = way.go_on(arm.integrate(rows[-1], loose), step)
        if why:
            raise TaskError(f"carry {grip.obstacle!r}", f"{100.0 * share:.0f} % of the way: {why}")
        rows.append(state.q)
    held = rows[-1]
    touching = arm.integrate(held, loose)
    there = displaced(grip.scene.obstacles[grip.obstacle], motion)
    scene = replace(grip.scene, obstacles={**grip.scene.obstacles, grip.obstacle: there})
    opened, winding = _opened_elsewhere(grip, touching, motion)
    return replace(
        grip,
        scene=scene,
        opened=opened,
        winding=winding,
        touching=touching,
        held=held,
        displacement=motion.homogeneous @ grip.displacement,
        ways=MappingProxyType({"carry": np.array(rows)}),
    )


class _CarriedWay:
    """The clearance of an arm, and of the object that it carries, on the way.

    Pairs that are within the margin at first may be until they part, but come no closer.
    """

    def __init__(self, grip: Grip, onto: Sequence[str]) -> None:
        self._arm = grip.arm
        self._model = CollisionModel(grip.arm, grip._carrying(()))
        self._margin = grip.scene.margin
        self._put_down = {(grip.obstacle, name) for name in onto}
        self._least = self._near(grip.touching)  # distances that pairs may have, by number [m]

    def go_on(self, q: Array, step: Array) -> str:
        """Take a step, (nv,) [rad or m], from a configuration, (nq,); return what is too close after it."""
        model = self._model
        if not self._least:
            closest = model.minimum_between(q, step)
            if closest.distance < self._margin - MOTION_TOLERANCE * self._arm.length:
                near = cast(Pair, closest.pair)
                if near not in self._put_down:
                    return _too_close(near)
        near_now = self._near(self._arm.integrate(q, step))
        rounding = WINDING.touches * self._arm.length
        for number, distance in near_now.items():
            pair = model.pairs[number]
            if pair in self._put_down and distance < -rounding:
                return f"{pair[0]} is pressed into {pair[1]}"
            if pair not in self._put_down and distance < self._least.get(number, self._margin) - rounding:
                return _too_close(pair)
        self._least = {number: least for number, least in self._least.items() if number in near_now}
        return ""

    def _near(self, q: Array) -> dict[int, float]:
        """Return the distances of pairs within the margin at a configuration, (nq,), by their numbers [m]."""
        near = self._model.nearest(self._arm.at(q), self._margin)
        return dict(zip(near.numbers.tolist(), near.distances.tolist(), strict=True))


def _opened_elsewhere(grip: Grip, touching: Array, motion: pin.SE3) -> tuple[Array, Array]:
    """Return where the arm stands off after a motion of the object, and the way from there to the wrap.

    Args:
        grip: the grip before the motion.
        touching: configuration that touches the object after it, (nq,).
        motion: the motion, world frame.

    Raises:
        TaskError: the arm cannot stand off there.
    """
    arm = grip.arm
    frame = _frame(arm.at(grip.opened), grip.first)
    state = arm.chain_at(arm.integrate(touching, -grip.winding[-1]))
    goal = EndEffector(pose=motion * frame, point=grip.first)
    state, error = bring_to_goal(arm, goal, state)
    if error > WINDING.reached * arm.length:
        raise TaskError(f"carry {grip.obstacle!r}", "where it ends, the free modules cannot back off")
    winding = np.where(_holds(arm, grip.first), grip.winding, arm.difference(state.q, touching))
    winding[0] = 0.0
    return state.q, winding


def unwrap(grip: Grip, q_end: ArrayLike | None = None) -> JointTrajectory:
    """Plan how an arm lets go of the object that it holds, and withdraws.

    From where it stands off on, it is clear of the object, too. What the object then stands on is up to you.

    Args:
        grip: the arm and the object.
        q_end: where the arm goes then, clear of the scene, (nq,); None: it stays as it stands off.

    Raises:
        InvalidValue: not a grip, or an invalid configuration.
        TaskError: the way from the object is blocked; says by what.
    """
    require_instance("grip", grip, Grip, "a Grip, as pp.wrap(...) returns it")
    arm = grip.arm
    release = replace(grip, ways=opening_ways(grip)).motion
    if q_end is None:
        return release
    end = arm.checked_start(q_end, "q_end")
    goal = Target.from_configuration(arm, end)
    path = plan(arm.at(grip.opened), goal, _untouchable(grip.scene, grip.obstacle), grip.limits)
    if path.blocked_by:
        raise TaskError(f"unwrap {grip.obstacle!r}", f"the way from it is blocked: {path.blocked_by}")
    if path.length == 0.0:
        return release
    return JointTrajectory.joined([release, _timed(path, grip.limits)])


def opening_ways(grip: Grip) -> dict[str, Array]:
    """Return the ways from an object that is held to where the arm stands off, as `Grip.ways`.

    Raises:
        TaskError: the way is blocked; says by what.
    """
    arm = grip.arm
    closest = CollisionModel(arm, grip.scene).minimum_on_motions(grip.opened, grip.winding)
    if closest.pair is not None and closest.distance < grip.scene.margin:
        raise TaskError(f"unwrap {grip.obstacle!r}", f"as it opens, {_too_close(closest.pair)}")
    opening = arm.integrate(grip.opened, grip.winding)[::-1]
    return {"loosen": np.array([grip.held, grip.touching]), "open": opening}


def _where(obstacle: str) -> str:
    return f"wrap around {obstacle!r}"


def _too_close(pair: Pair) -> str:
    return f"{pair[0]} comes within the margin of {pair[1]}"


def _frame(state: ArmState | ChainState, index: int) -> pin.SE3:
    """Return the pose of the frame of a control point, by index."""
    return pin.SE3(np.array(state.rotations[index]), np.array(state.points[index]))


def _holds(arm: Arm, first: int) -> NDArray[np.bool_]:
    """Return which degrees of freedom are those of the modules behind a control point, by index, (nv,)."""
    holding = np.zeros(arm.nv, dtype=np.bool_)
    holding[arm.columns[arm.module_starts[first + 1] :]] = True
    return holding


def _untouchable(scene: Scene, obstacle: str) -> Scene:
    """Return a scene in which the arm may not touch an obstacle."""
    return replace(scene, touchable=[name for name in scene.touchable if name != obstacle])


def _within_limits(arm: Arm, q: Array) -> Array:
    """Return a configuration with its joints inside their limits, (nq,)."""
    inside = np.minimum(np.maximum(arm.positions(q), arm.limits.lower), arm.limits.upper)
    return np.asarray(arm.configuration(inside))


def _displacements(motion: pin.SE3, middle: Array, size: float) -> Iterator[tuple[float, pin.SE3]]:
    """Yield shares of a displacement, and each as a displacement: its middle, (3,) [m], goes straight."""
    turn = pin.log3(motion.rotation)
    way = motion.act(middle) - middle
    far = float(np.linalg.norm(way)) / size + float(np.linalg.norm(turn))
    count = max(2, int(np.ceil(far / WINDING.carry_step)))
    for share in np.arange(1, count + 1) / count:
        rotation = pin.exp3(share * turn)
        yield float(share), pin.SE3(rotation, middle + share * way - rotation @ middle)


def path_through(arm: Arm, rows: Array) -> JointPath:
    """Return the path through configurations, (n, nq)."""
    objective = Objective(arm, Target.from_configuration(arm, rows[-1]))
    return JointPath(objective, rows[0], _offsets(arm, rows))


def _offsets(arm: Arm, rows: Array) -> Array:
    """Return the displacements from the first of configurations, (r, nq), to each, (r, nv) [rad or m]."""
    steps = arm.difference(rows[:-1], rows[1:])
    return np.vstack([np.zeros(arm.nv), np.cumsum(steps, axis=0)])


def s_in_time(path: JointPath, limits: Limits) -> Array:
    """Return s on a path after each cycle of the motion along it, two at least, (n,) [waypoints]."""
    s = retime(path, limits).s
    return s if len(s) > 1 else np.zeros(2)  # it is there already, and rests for a cycle


def _timed(path: JointPath, limits: Limits) -> JointTrajectory:
    """Return the motion along a path."""
    rows = path.arm.integrate(path.start, path.smooth_offset(s_in_time(path, limits)))
    return JointTrajectory.from_configurations(path.arm, rows, cycle_of(limits))


class _Found(NamedTuple):
    """Where a wrap begins, and the way around the object; see `Grip`."""

    first: int
    opened: Array
    winding: Array


class _Wrap:
    """The search for the wrap of an arm around an object."""

    def __init__(self, arm: Arm, obstacle: str, scene: Scene, turns: float) -> None:
        self.arm = arm
        self.obstacle = obstacle
        self.scene = scene
        self.turns = turns
        self.model = CollisionModel(arm, scene)
        self.where = _where(obstacle)

    def find(self, start: Array) -> _Found:
        """Find the wrap that touches the object with most bodies, from a start, (nq,), and other postures."""
        arm = self.arm
        gap = max(body.shape.solid().radius for body in bodies_of(arm, self.scene.arm_radius))
        windings: list[_Found] = []
        errors: dict[str, TaskError] = {}
        for seed in self._seeds(self._last_free(self._winding(gap)), start):
            try:
                windings.append(self._find_from(seed, gap))
            except TaskError as error:
                errors[error.reason] = error
        if not windings:
            raise_together(list(errors.values()))
        straight = arm.straight()
        bends = [float(np.linalg.norm(arm.difference(straight, way.opened))) for way in windings]
        touching = [self._count_touching(arm.integrate(way.opened, way.winding[-1])) for way in windings]
        return windings[min(range(len(windings)), key=lambda k: (-touching[k], bends[k]))]

    def _find_from(self, seed: Array, gap: float) -> _Found:
        """Find a wrap from a posture, (nq,), with a gap to begin with [m]."""
        arm = self.arm
        for _ in range(WINDING.gap_corrections):
            winding = self._winding(gap)
            first = self._last_free(winding)
            opened = self._opened(winding, first, seed)
            way = self._wind(winding, first, opened)
            overlap = -self._distance(arm.integrate(opened, way[-1]))
            if abs(overlap) <= WINDING.touches * arm.length:
                off = self._standing_off(winding, first, opened)
                whole = np.vstack([np.zeros(arm.nv), arm.difference(off, opened) + way])
                return _Found(first, off, self._clear(off, whole))
            gap += overlap
        away = length_text(abs(overlap))
        raise TaskError(self.where, f"the arm is {away} off where it would touch: its modules are too long")

    def _winding(self, gap: float) -> Winding:
        """Return the curve around the object at a distance [m]."""
        shape = self.scene.obstacles[self.obstacle]
        base = self.arm.chain.base
        pitch = WINDING.pitch * gap
        return winding_around(shape, base, gap, self.turns, pitch=pitch, heading=arm_axis(self.arm))

    def _last_free(self, winding: Winding) -> int:
        """Return the index of the last control point that is not wrapped."""
        arm = self.arm
        lengths = arm.chain.module_lengths
        needed = float(np.linalg.norm(np.diff(winding.points, axis=0), axis=1).sum())
        wrapped = 1 + int(np.searchsorted(np.cumsum(lengths[::-1]), needed))
        if wrapped >= arm.n_modules:
            most = length_text(float(lengths[1:].sum()))
            reason = (
                f"the turns are {length_text(needed)} long, and all modules but one {most}; ask for fewer"
            )
            raise TaskError(self.where, reason)
        return arm.n_modules - wrapped - 1

    def _opened(self, winding: Winding, first: int, seed: Array) -> Array:
        """Return the posture near a seed, (nq,), in which the wrapped modules are a straight tangent."""
        arm = self.arm
        x = winding.heading
        z = winding.body.axis - (winding.body.axis @ x) * x
        z /= np.linalg.norm(z)
        upright = np.column_stack([x, np.cross(z, x), z])
        # The link that ends there lies along the tangent.
        along = pin.Quaternion.FromTwoVectors(link_axes(arm).links[first], np.eye(3)[0]).matrix()
        frame = pin.SE3(upright @ along, winding.points[0])
        state = arm.chain_at(self._straightened(seed, first))
        state, error = bring_to_goal(arm, EndEffector(pose=frame, point=first), state)
        if error > WINDING.reached * arm.length:
            away = length_text(float(np.linalg.norm(winding.points[0] - arm.chain.base)))
            reason = f"it begins {away} from the base, and the {first + 1} free modules do not get there"
            reason += "; ask for fewer turns, or move the object"
            raise TaskError(self.where, reason)
        q = self._straightened(state.q, first)
        self._require_clear(self.model, q)
        return q

    def _require_clear(self, model: CollisionModel, q: Array) -> None:
        """Refuse a posture, (nq,), from which the arm would wind, that is not clear."""
        closest = model.minimum(q)
        if closest.pair is not None and closest.distance < self.scene.margin:
            raise TaskError(
                self.where, f"where it begins, {closest.pair[0]} is too close to {closest.pair[1]}"
            )

    def _standing_off(self, winding: Winding, first: int, opened: Array) -> Array:
        """Return the posture beside a tangent, (nq,), in which the arm keeps the margin to the object."""
        arm = self.arm
        side = np.cross(winding.heading, winding.body.axis)
        side *= (self.scene.margin + 2.0 * WINDING.touches * arm.length) / np.linalg.norm(side)
        sides = winding.points[0] + np.stack([side, -side])
        nearer = int(winding.body.distances(sides).argmin())
        state = arm.chain_at(opened)
        frame = _frame(state, first)
        frame.translation = frame.translation + (-side if nearer == 0 else side)
        state, error = bring_to_goal(arm, EndEffector(pose=frame, point=first), state)
        if error > WINDING.reached * arm.length:
            raise TaskError(self.where, "the free modules cannot stand off from where it begins")
        q = self._straightened(state.q, first)
        self._require_clear(CollisionModel(arm, _untouchable(self.scene, self.obstacle)), q)
        return q

    def _straightened(self, q: Array, first: int) -> Array:
        """Return a configuration with the wrapped modules straight."""
        arm = self.arm
        straight = arm.straight()
        offset = np.where(_holds(arm, first), 0.0, arm.difference(straight, q))
        return arm.integrate(straight, offset)

    def _seeds(self, first: int, start: Array) -> Iterator[Array]:
        """Yield postures for the search: the start, and arches of the free modules."""
        arm = self.arm
        yield start
        ends = np.append(arm.module_starts[1:], len(arm.columns))
        shares = np.cos(2.0 * np.pi * (np.arange(first + 1) + 0.5) / (first + 1))
        for bend in WINDING.seed_bends:
            for axis in range(int((ends - arm.module_starts).max())):
                offset = np.zeros(arm.nv)
                for module in range(first + 1):
                    column = arm.module_starts[module] + axis
                    if column < ends[module]:
                        offset[arm.columns[column]] = (
                            bend * shares[module] * arm.joint_units[arm.columns[column]]
                        )
                yield _within_limits(arm, arm.integrate(arm.straight(), offset))

    def _wind(self, winding: Winding, first: int, opened: Array) -> Array:
        """Return displacements from the tangent to the wrap, module by module, (r, nv) [rad or m]."""
        arm = self.arm
        state = arm.at(opened)
        line = state.links
        last = int(np.linalg.norm(line - state.points[first], axis=1).argmin())
        apart = np.linalg.norm(np.diff(line[: last + 1], axis=0), axis=1) > SMALLEST_LENGTH
        kept = line[: last + 1][np.append(True, apart)]
        near = Target.from_configuration(arm, opened)
        wrapped = float(arm.chain.module_lengths[first + 1 :].sum())
        steps = WINDING.steps_per_module * (arm.n_modules - first - 1)
        rows = [opened]
        for share in np.arange(1, steps + 1) / steps:
            wound = _continued(winding, share, wrapped)
            try:
                curve = Curve.points(np.vstack([kept, wound[1:]]))
                near = resolve_targets(arm, curve, placement="as_is", method="closest", near=near)
            except TargetError as error:
                raise TaskError(self.where, f"the arm cannot follow it: {error}") from None
            rows.append(cast(Array, near.q))
        return _offsets(arm, np.array(rows))

    def _distance(self, q: Array) -> float:
        """Return the distance of the arm from the object [m], negative for overlap."""
        return float(self._distances(q, np.inf).min())

    def _count_touching(self, q: Array) -> int:
        """Return the number of bodies that touch the object."""
        within = WINDING.within * self.arm.length
        return int(np.sum(self._distances(q, within) <= within))

    def _distances(self, q: Array, within: float) -> Array:
        """Return the distances of bodies from the object that are nearer than one [m], (k,) [m]."""
        depth = self.scene.depth(self.obstacle)
        near = self.model.nearest(self.arm.at(q), within + depth)
        return near.distances[[other == self.obstacle for _, other in near.pairs]] - depth

    def _clear(self, opened: Array, way: Array) -> Array:
        """Return a way to the wrap that is clear: at once, or module by module."""
        for tried in (way[[0, -1]], way):
            closest = self.model.minimum_on_motions(opened, np.ascontiguousarray(tried))
            if closest.distance >= self.scene.margin:
                return tried
        named = "" if closest.pair is None else f": {closest.pair[0]} comes too close to {closest.pair[1]}"
        raise TaskError(self.where, f"the way around the object is not clear{named}")


def _continued(winding: Winding, share: float, wrapped: float) -> Array:
    """Return the part of a winding that is wound, and the tangent beyond it, for a wrapped length [m]."""
    points = winding.points
    lengths = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1)))
    end = share * lengths[-1]
    s = np.append(lengths[lengths < end - SMALLEST_LENGTH], end)
    cut = np.column_stack([np.interp(s, lengths, column) for column in points.T])
    heading = cut[-1] - cut[-2] if len(cut) > 1 else winding.heading
    beyond = np.arange(1.0, 1.1 * wrapped / winding.spacing) * winding.spacing
    return np.vstack([cut, cut[-1] + beyond[:, None] * heading / np.linalg.norm(heading)])


def _check(grip: Grip) -> None:
    """Raise an error unless the parts of a grip fit each other."""
    arm = grip.arm
    require_known("obstacle", grip.obstacle, grip.scene.obstacles)
    require_whole("first", grip.first, 0)
    if grip.first >= arm.n_modules - 1:
        raise InvalidValue("first", grip.first, f"an index below {arm.n_modules - 1}")
    shapes: dict[str, tuple[int, ...]] = {name: (arm.nq,) for name in ("opened", "touching", "held")}
    fields = vars(grip) | {f"way {name}": way for name, way in grip.ways.items()}
    shapes |= {f"way {name}": (len(way), arm.nq) for name, way in grip.ways.items()}
    shapes |= {"winding": (len(grip.winding), arm.nv), "displacement": (4, 4)}
    check_arrays(fields, shapes)
    for name in shapes:
        require_finite(name, fields[name])
    cycle_of(grip.limits)
    require_positive("friction", grip.friction, zero=True)


register(Format("pinposture-grip", 1, Grip, "grip", _check))
