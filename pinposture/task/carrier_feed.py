"""A robot as the feed of an arm: its flange carries the arm straight ahead."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import cached_property
from math import inf, isinf
from pathlib import Path
from typing import Annotated, Any, NamedTuple, cast

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from pinposture._validation import direction as unit_vector
from pinposture._validation import finite_array, make_read_only, require_instance, require_positive
from pinposture.arm import Arm, ArmState, JointSpec
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.bodies import bodies_of
from pinposture.collision.distances import JointFrames, PairDistances, TreeKinematics
from pinposture.collision.model import Closest, describe_distance
from pinposture.collision.scene import USUAL_MARGIN
from pinposture.collision.solids import Solid
from pinposture.control.limits import Limits
from pinposture.control.tasks import orientation_rows
from pinposture.document import Document
from pinposture.errors import InvalidValue, ReachError
from pinposture.motion.actuators import Actuators
from pinposture.motion.joint_trajectory import METRE, RADIAN, JointTrajectory, joint_units
from pinposture.schema import AS_GIVEN, Declared, Length, declared
from pinposture.units import CONVERGED, ROUNDING, length_text

Array = NDArray[np.float64]


class FeedSettings(NamedTuple):
    """How the way of a flange is computed and judged.

    With the first two, a UR5 that goes straight for 0.3 m from 27 random configurations is off the line by at
    most 9e-8 of its length; with half of `parts` by 1e-6, with a tolerance of 1e-7 by 3e-7. Its tests guard
    1e-6 m.
    """

    tolerance: float = 1e-9
    """Relative and absolute tolerance of the integration [rad or m]."""

    parts: int = 8
    """Number of parts of each step of the integration, with a cubic spline through their ends."""

    deviation: float = 1e-5
    """Largest error between samples, as a share of the length of the carrier; rotations times
    `characteristic_length`. It is a hundred times the usual one, and far below that of a robot without the
    joints to go straight."""

    largest_rate: float = 100.0
    """Largest joint motion per feed, in `Arm.joint_units` over the length of the carrier. Beyond it is a
    singular posture: a robot of 1 m that feeds 1 cm/s would need 1 rad/s. Of 60 strokes of a UR5, twice of it
    lengthened none by more than 0.2 % of its length; half of it ended one that passes such a posture."""

    off_way: float = 0.05
    """Distance of a joint of the robot from its way, in `Arm.joint_units`, above which it is not known where
    the robot has the arm: 5 cm at the end of a metre."""

    projections: int = 4
    """Number of steps that project measured joints on the way, from the nearest sample on."""

    watched: float = 0.1
    """Clearance beyond the margin up to which robot and arm are near each other, in lengths of the arm."""


FEED = FeedSettings()


class CarrierFeed:
    """A robot that feeds an arm: its flange moves straight ahead without turning, and carries the arm.

    For `follow_leader` and `Steering` the robot is a slide: build the arm on `joint`, in front of the flange.
    `joint_trajectory` then puts the joints of the robot in place of the slide.

        feed = pp.CarrierFeed(robot, q, stroke=0.4)
        slide = pp.ModuleTemplate("Feed", joints=(feed.joint,), link_lengths=(0.05,))
        arm = pp.Arm.from_modules([slide, *modules], base_placement=feed.base_placement)
        motion = pp.perform(pp.follow_leader(arm, path, interval=0.1, speed=0.02), limits=limits)
        pp.save(feed.joint_trajectory(motion.joint_trajectory()), "both.csv")

    The scene of a motion knows the arm, not the robot; give it here, so that the robot is checked as well.

    Args:
        carrier: the robot, to its flange, which is the tip.
        q: its configuration with the feed retracted, (nq,).
        stroke: how far it is to feed [m].
        direction: direction of the feed in the frame of the flange, (3,); z points out of most flanges.
        scene: obstacles that the robot has to stay clear of on the whole way, and of itself; None: none.

    Attributes:
        carrier: the robot.
        start: its configuration with the feed retracted, (nq,).
        stroke: how far it feeds [m].
        base_placement: placement of the base of the arm, with x along the feed, world frame.
        s: positions of the feed at the samples, (k,) [m].
        configurations: configurations of the robot there, (k, nq).

    Raises:
        ReachError: the flange does not get so far, and which stroke is possible and why, or the robot is too
            close to an obstacle on the way.
        InvalidValue: not an arm, not a configuration, a stroke that is not positive, or not a direction.
    """

    def __init__(
        self,
        carrier: Arm,
        q: ArrayLike,
        stroke: float,
        direction: ArrayLike = (0.0, 0.0, 1.0),
        scene: Scene | None = None,
    ) -> None:
        require_instance("carrier", carrier, Arm, "an Arm, from the base of the robot to its flange")
        require_positive("stroke", stroke)
        ahead = np.array(unit_vector("direction", direction))
        self.carrier = carrier
        self.start = carrier.checked(q, "q")
        self.stroke = float(stroke)
        begin = _flange(carrier.at(self.start))
        turn = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), ahead).toRotationMatrix()
        self.base_placement = begin * pin.SE3(turn, np.zeros(3))
        self._axis = begin.rotation @ ahead
        self.s, offsets = self._integrate(begin.translation)
        self.configurations = carrier.integrate(self.start, offsets)
        self._spline = CubicSpline(self.s, offsets)
        make_read_only(self.s, self.configurations)
        self._check_straight(begin)
        if scene is not None:
            self._check_clear(scene, begin.translation, offsets)

    @cached_property
    def max_speed(self) -> float:
        """Largest speed of the feed within the velocity limits of the robot [m/s]; infinite: none known."""
        rates = np.abs(self._spline(np.linspace(0.0, self.stroke, 4 * len(self.s)), 1)).max(axis=0)
        moves = rates > ROUNDING
        return float((self.carrier.limits.velocity[moves] / rates[moves]).min(initial=inf))

    @property
    def joint(self) -> JointSpec:
        """The slide that the arm sees in place of the robot: along x, with `stroke` and `max_speed`."""
        slide = JointSpec("x", type="prismatic", lower=0.0, upper=self.stroke)
        return slide if isinf(self.max_speed) else replace(slide, velocity=self.max_speed)

    def limits(self, arm: Arm, limits: Limits) -> Limits:
        """Return limits of an arm, with which the feed, its first joint, is no faster than `max_speed`."""
        require_instance("arm", arm, Arm, "an Arm")
        require_instance("limits", limits, Limits, "a Limits(...)")
        speeds = arm.limits.velocity if limits.velocity is None else limits.velocity
        velocity = np.array(np.broadcast_to(speeds, arm.nv), dtype=np.float64)
        velocity[0] = min(velocity[0], self.max_speed)
        return replace(limits, velocity=velocity)

    def at(self, s: ArrayLike) -> Array:
        """Return configurations of the robot.

        Args:
            s: positions of the feed, one number or (N,) [m].

        Returns:
            The configuration, (nq,), or one for each, (N, nq).

        Raises:
            InvalidValue: positions that are not within the stroke.
        """
        return self.carrier.integrate(self.start, self.offsets(s))

    def offsets(self, s: ArrayLike) -> Array:
        """Return displacements of the robot from its start, as `at`, (nv,) or (N, nv) [rad or m]."""
        return np.asarray(self._spline(self._checked(s)))

    def rates(self, s: float) -> Array:
        """Return the joint motion of the robot per feed at a position of the feed [m], (nv,) [rad/m or 1]."""
        return np.asarray(self._spline(self._checked(s), 1))

    def find(self, q: ArrayLike) -> float:
        """Return the position of the feed at which the robot is, [m].

        Args:
            q: its measured configuration, (nq,).

        Raises:
            InvalidValue: not a configuration, or a joint off its way by more than `FEED.off_way`.
        """
        arm = self.carrier
        units = arm.joint_units
        offset = arm.difference(self.start, arm.checked(q, "q"))
        apart = (self._spline(self.s) - offset) / units
        s = float(self.s[int(np.einsum("ij,ij->i", apart, apart).argmin())])
        for _ in range(FEED.projections):
            rate = self._spline(s, 1) / units
            left = (offset - self._spline(s)) / units
            s = float(np.clip(s + (rate @ left) / max(float(rate @ rate), 1e-300), 0.0, self.stroke))
        off = (offset - self._spline(s)) / units
        joint = int(np.abs(off).argmax())
        if abs(off[joint]) > FEED.off_way:
            size = f"{abs(off[joint] * units[joint]):.3g} {'m' if arm.in_metres[joint] else 'rad'}"
            allowed = f"on the way of the feed; it is {size} off"
            raise InvalidValue(
                f"joint {arm.joint_names[joint]!r} of the robot", float(offset[joint]), allowed
            )
        return s

    def joint_trajectory(self, trajectory: JointTrajectory) -> JointTrajectory:
        """Return a trajectory of the arm with the joints of the robot in place of the feed.

        Args:
            trajectory: positions of the joints of the arm; the first is the feed. Times stay.

        Raises:
            InvalidValue: not a trajectory; a first joint that is no slide or leaves the stroke; joints of
                robot and arm of the same name.
        """
        require_instance(
            "trajectory", trajectory, JointTrajectory, "a JointTrajectory of the arm on its feed"
        )
        feed = trajectory.joint_names[0]
        if trajectory.units[0] != METRE:
            unit = trajectory.units[0] or "an unknown unit"
            raise InvalidValue("first joint", feed, f"the feed, a slide in m; it is in {unit}")
        s = self._checked(trajectory.positions[:, 0])
        speeds = trajectory.velocities[:, :1]
        slopes = self._spline(s, 1)
        velocities = slopes * speeds
        accelerations = self._spline(s, 2) * speeds**2 + slopes * trajectory.accelerations[:, :1]
        robot = JointTrajectory(
            self.carrier.joint_names,
            trajectory.time,
            self.carrier.positions(self.start) + self._spline(s),
            velocities,
            accelerations,
            joint_units(self.carrier),
        ).driven(self.carrier)
        return replace(
            trajectory,
            joint_names=(*robot.joint_names, *trajectory.joint_names[1:]),
            units=(*robot.units, *trajectory.units[1:]),
            positions=np.hstack([robot.positions, trajectory.positions[:, 1:]]),
            velocities=np.hstack([robot.velocities, trajectory.velocities[:, 1:]]),
            accelerations=np.hstack([robot.accelerations, trajectory.accelerations[:, 1:]]),
        )

    def _checked(self, s: ArrayLike) -> Array:
        """Return positions of the feed that are within the stroke, (N,) or a number."""
        positions = finite_array("s", s)
        if positions.ndim > 1:
            raise InvalidValue("s", positions.shape, "one number or (N,)")
        outside = np.maximum(-positions, positions - self.stroke)
        if outside.size and outside.max() > CONVERGED * self.carrier.length:
            raise InvalidValue("s", float(positions.flat[outside.argmax()]), f"0 to {self.stroke:g} m")
        return np.clip(positions, 0.0, self.stroke)

    def _solve_rates(self, offset: Array) -> Array:
        """Return the joint motion per feed at a displacement from the start, (nv,) [rad/m or 1]."""
        state = self.carrier.at(self.carrier.integrate(self.start, offset))
        turns, _ = orientation_rows(state, len(state.points) - 1, state.rotations[-1])
        moves = np.vstack([state.jacobians[-1], turns])
        ahead = np.append(self._axis, np.zeros(len(turns)))
        units = self.carrier.joint_units
        return np.asarray(units * np.linalg.lstsq(moves * units, ahead, rcond=None)[0])

    def _integrate(self, begin: Array) -> tuple[Array, Array]:
        """Return positions of the feed, (k,), and displacements of the robot from its start, (k, nv)."""
        arm = self.carrier
        positions = arm.positions(self.start)

        def room(_: float, offset: Array) -> float:
            now = positions + offset
            return float(np.minimum(now - arm.limits.lower, arm.limits.upper - now).min())

        def regularity(_: float, offset: Array) -> float:
            rates = np.abs(self._solve_rates(offset) / arm.joint_units)
            return FEED.largest_rate - arm.length * float(rates.max())

        events: list[Any] = [room, regularity]
        for event in events:
            event.terminal = True
            event.direction = -1.0
        solved = solve_ivp(
            lambda _, offset: self._solve_rates(offset),
            (0.0, self.stroke),
            np.zeros(arm.nv),
            method="DOP853",
            dense_output=True,
            events=events,
            rtol=FEED.tolerance,
            atol=FEED.tolerance,
        )
        reached = float(solved.t[-1])
        if reached < self.stroke:
            why = ""
            if len(solved.t_events[0]):
                now = positions + solved.y[:, -1]
                closest = int(np.minimum(now - arm.limits.lower, arm.limits.upper - now).argmin())
                why = f"joint {arm.joint_names[closest]!r} is at its limit"
            raise self._stopped(begin, reached, why)
        shares = np.arange(FEED.parts) / FEED.parts
        s = np.append((solved.t[:-1, None] + np.diff(solved.t)[:, None] * shares).ravel(), self.stroke)
        return s, solved.sol(s).T

    def _stopped(self, begin: Array, reached: float, why: str = "") -> ReachError:
        why = why or "the robot is stretched or singular, or lacks joints for it"
        how_far = f"the flange goes straight for {length_text(reached)} of {length_text(self.stroke)}"
        advice = "ask for a shorter stroke, or start from another configuration"
        return ReachError(begin + self.stroke * self._axis, f"{how_far}, where {why}; {advice}")

    def _check_straight(self, begin: pin.SE3) -> None:
        """Require that the flange moves straight, also between samples."""
        arm = self.carrier
        for s in 0.5 * (self.s[1:] + self.s[:-1]):
            goal = pin.SE3(begin.rotation, begin.translation + s * self._axis)
            off = goal.actInv(_flange(arm.at(self.at(s))))
            turned = arm.characteristic_length * np.linalg.norm(pin.log3(off.rotation))
            if max(np.linalg.norm(off.translation), turned) > FEED.deviation * arm.length:
                raise self._stopped(begin.translation, float(s))

    def _check_clear(self, scene: Scene, begin: Array, offsets: Array) -> None:
        """Require that the robot keeps the margin of a scene on the whole way."""
        model = CollisionModel(self.carrier, scene)
        closest = model.minimum_on_motions(self.start, offsets)
        if closest.distance < scene.margin:
            told = describe_distance(closest.pair or (), closest.distance)
            least = f"at least {length_text(scene.margin)} are kept"
            raise ReachError(begin + self.stroke * self._axis, f"on the way, {told}; {least}")


class _CarriedBodies(NamedTuple):
    """The bodies of an arm and of the robot that carries it.

    Attributes:
        arm: the kinematics of the arm.
        robot: that of the robot.
        distances: the distances of the pairs that count, by the joint placements of the arm and the robot.
        joints: the joints that carry the bodies, (n,): first those of the arm, then of the robot.
        names: their names.
    """

    arm: TreeKinematics
    robot: TreeKinematics
    distances: PairDistances
    joints: NDArray[np.int64]
    names: tuple[str, ...]

    @classmethod
    def of(cls, arm: Arm, robot: Arm) -> _CarriedBodies:
        """Return the bodies, without pairs; it takes long, as descriptions are read."""
        both = (TreeKinematics(arm.model), TreeKinematics(robot.model))
        solids: list[Solid] = []
        joints: list[int] = []
        names: list[str] = []
        for kinematics, bodies, first, of in zip(
            both,
            (bodies_of(arm), bodies_of(robot)),
            (0, arm.model.njoints),
            ("", " of the robot"),
            strict=True,
        ):
            solids += [body.shape.solid().turned(kinematics.turns[body.joint]) for body in bodies]
            joints += [first + body.joint for body in bodies]
            names += [f"{body.name}{of}" for body in bodies]
        distances = PairDistances(solids, joints, [], [])
        return cls(*both, distances, np.array(joints, dtype=np.int64), tuple(names))

    @staticmethod
    def both(arm: JointFrames, robot: JointFrames) -> JointFrames:
        """Return the placements of the joints of the arm and then of the robot, each at s configurations."""
        rotations = np.concatenate([arm.rotations, robot.rotations], axis=1)
        return JointFrames(rotations, np.concatenate([arm.origins, robot.origins], axis=1))


class CarrierClearance:
    """The clearance of the robot that carries an arm from the arm, and from obstacles: for `Geodesic`.

        controller = pp.Geodesic(constraints=[CarrierClearance(feed, arm, scene=scene)])

    The mount of the arm, up to its feed, does not count, nor does what is closer than the margin while the
    arm is straight and retracted: bodies beside the flange.

    Attributes:
        scene: the obstacles that the robot stays clear of; another one may be set at any time, such as that
            of a map that grows. None: none.

    Args:
        feed: the robot.
        arm: the arm; its first joint is the feed.
        margin: the clearance to keep [m].
        scene: the obstacles, as above.

    Raises:
        InvalidValue: a first joint that is no slide, or a base that is not at the flange.
    """

    name = "clearance of the robot that carries the arm"

    def __init__(
        self, feed: CarrierFeed, arm: Arm, margin: float = USUAL_MARGIN, scene: Scene | None = None
    ) -> None:
        _require_mounted(feed, arm)
        self.feed = feed
        self.arm = arm
        self.margin = margin
        self.scene = scene
        self._model: tuple[Scene, CollisionModel] | None = None

    def __reduce__(self) -> tuple[Any, ...]:
        return CarrierClearance, (self.feed, self.arm, self.margin, self.scene)

    @cached_property
    def _bodies(self) -> _CarriedBodies:
        """The bodies of arm and robot, and the pairs that count."""
        bodies = _CarriedBodies.of(self.arm, self.feed.carrier)
        joints = bodies.joints
        mount = int(self.arm.model.getJointId(self.arm.joint_names[0]))
        own = joints < self.arm.model.njoints
        carried = np.flatnonzero(own & (joints > mount))
        pairs = [(int(i), int(k)) for i in carried for k in np.flatnonzero(~own)]
        distances = bodies.distances.among(pairs)
        retracted = bodies.both(bodies.arm.place(self.arm.straight()), bodies.robot.place(self.feed.start))
        near = distances.near(retracted, float(np.nextafter(self.margin, inf))).pairs
        close = {(int(distances.first[i]), int(distances.second[i])) for i in near}
        return bodies._replace(distances=distances.among([pair for pair in pairs if pair not in close]))

    @property
    def _obstacles(self) -> CollisionModel | None:
        """The robot among the obstacles of the scene, without its own bodies; None if there are none."""
        scene = self.scene
        if scene is None or not scene.obstacles:
            return None
        known = self._model
        if known is None or known[0] is not scene:
            alone = replace(scene, self_collision=False)
            self._model = known = scene, CollisionModel(self.feed.carrier, alone)
        return known[1]

    def closest(self, q: ArrayLike) -> Closest:
        """Return the robot and what is nearest to it at a configuration of the arm, (nq,)."""
        q = self.arm.checked(q, "q")
        s = self._feed_at(q)
        bodies = self._bodies
        distances = bodies.distances
        placed = bodies.both(bodies.arm.place(q), bodies.robot.place(self.feed.at(s)))
        distance, pair = distances.minimum(placed)
        names = bodies.names
        both = None if pair < 0 else (names[distances.first[pair]], names[distances.second[pair]])
        nearest = Closest(float(distance), both)
        if self._obstacles is None:
            return nearest
        beside = self._obstacles.minimum(self.feed.at(s))
        if beside.pair is None or nearest.distance <= beside.distance:
            return nearest
        return Closest(beside.distance, (f"{beside.pair[0]} of the robot", beside.pair[1]))

    def require_clear(self, q: ArrayLike, name: str) -> None:
        """Raise InvalidValue unless the robot is clear at a configuration of the arm, (nq,)."""
        closest = self.closest(q)
        if closest.distance < (1.0 - CONVERGED) * self.margin:
            told = describe_distance(closest.pair or (), closest.distance)
            raise InvalidValue(name, told, f"at least {length_text(self.margin)} around the robot")

    def _feed_at(self, q: Array) -> float:
        return float(np.clip(self.arm.positions(q)[0], 0.0, self.feed.stroke))

    def rows(self, state: ArmState) -> tuple[Array, Array, Array]:
        """Return the rows of near bodies; see `Constraint.rows`."""
        s = self._feed_at(state.q)
        robot = self.feed.at(s)
        rates = self.feed.rates(s)
        watched = self.margin + FEED.watched * self.arm.length
        matrix, distances = self._rows_beside_arm(state.q, robot, rates, watched)
        if self._obstacles is not None:
            near = self._obstacles.nearest(self.feed.carrier.at(robot), watched)
            others = np.zeros((len(near.distances), self.arm.nv))
            others[:, 0] = near.jacobian @ rates
            matrix = np.concatenate([matrix, others])
            distances = np.concatenate([distances, near.distances])
        if not len(distances):
            return np.zeros((1, self.arm.nv)), np.array([-self.arm.length]), np.array([inf])
        return matrix, self.margin - distances, np.full(len(distances), inf)

    def violations(self, start: ArmState, offsets: Array) -> Array:
        """Return by how much it is violated at states displaced from one; see `Constraint`."""
        feed = self.arm.positions(start.q)[0] + offsets[:, 0]
        carried = self.feed.offsets(np.clip(feed, 0.0, self.feed.stroke))
        bodies = self._bodies
        robot = bodies.robot.place(self.feed.start, carried)
        placed = bodies.both(bodies.arm.place(start.q, offsets), robot)
        beside = self._obstacles
        least = bodies.distances.minimum(placed, below=self.margin)[0]
        if beside is not None:
            least = min(least, beside.minimum_along(self.feed.start, carried, self.margin).distance)
        if least >= self.margin:  # nearly always
            return np.zeros(len(offsets))
        distances = np.empty(len(offsets))
        for k in range(len(offsets)):
            frames = JointFrames(placed.rotations[k : k + 1], placed.origins[k : k + 1])
            distances[k] = bodies.distances.minimum(frames)[0]
            if beside is not None:
                there = beside.minimum_along(self.feed.start, carried[k : k + 1])
                distances[k] = min(distances[k], there.distance)
        return np.maximum(self.margin - distances, 0.0)

    def _rows_beside_arm(self, q: Array, robot: Array, rates: Array, within: float) -> tuple[Array, Array]:
        """Return the derivatives, (r, nv), of distances between arm and robot, and these, (r,) [m].

        Args:
            q: the configuration of the arm, (nq,).
            robot: that of the robot, (nq,).
            rates: its joint motion per feed, (nv,).
            within: the distance up to which they count [m].
        """
        bodies = self._bodies
        placed = bodies.arm.place(q)
        carrier = bodies.robot.place(robot)
        near = bodies.distances.near(bodies.both(placed, carrier), within)
        fixed = np.zeros(len(near.pairs), dtype=np.int64)
        joints = bodies.joints[bodies.distances.first[near.pairs]]
        matrix = bodies.arm.differentiate(placed, joints, fixed, near.points, near.normals)
        # The feed moves the bodies of the robot as well.
        joints = bodies.joints[bodies.distances.second[near.pairs]] - self.arm.model.njoints
        there = near.points - near.distances[:, None] * near.normals
        moved = bodies.robot.differentiate(carrier, joints, fixed, there, -near.normals)
        matrix[:, 0] += moved @ rates
        return matrix, near.distances


class CarriedDrives:
    """The drives of an arm and of the robot that carries it, whose joints move in place of the feed.

    Attributes:
        names: names of the joints that are measured and commanded: those of the robot, and of the arm but its
            feed.

    Args:
        feed: the robot.
        arm: the arm; its first joint is the feed.

    Raises:
        InvalidValue: a first joint that is no slide, a base that is not at the flange, or joints of robot
            and arm of the same name.
    """

    def __init__(self, feed: CarrierFeed, arm: Arm) -> None:
        _require_mounted(feed, arm)
        self._feed = feed
        self._arm = arm
        self.names = (*feed.carrier.drives.names, *arm.drives.names[1:])
        twice = sorted({name for name in self.names if self.names.count(name) > 1})
        if twice:
            raise InvalidValue("joint", twice[0], "another name: robot and arm have it")

    def commands(self, positions: Array) -> Array:
        """Return the positions of `names`, given those of `Arm.drives`, both [rad or m]."""
        feed = float(self._arm.drives.joint_positions(positions)[0])
        s = min(max(feed, 0.0), self._feed.stroke)
        carrier = self._feed.carrier
        return np.append(carrier.drives.positions(carrier.positions(self._feed.at(s))), positions[1:])

    def measured(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Return the positions of `Arm.drives` by name, given those of `names`, both [rad or m].

        Raises:
            InvalidValue: the robot is off the way of the feed.
        """
        carrier = self._feed.carrier
        q = carrier.configuration(carrier.drives.joint_positions(positions))
        joints = np.zeros(self._arm.nv)
        joints[0] = self._feed.find(q)
        feed = float(self._arm.drives.positions(joints)[0])
        return {
            self._arm.drives.names[0]: feed,
            **{name: positions[name] for name in self._arm.drives.names[1:]},
        }

    def limits(self, limits: Limits) -> Limits:
        """Return limits of the arm within which the robot keeps its own; see `CarrierFeed.limits`."""
        return self._feed.limits(self._arm, limits)


def _require_mounted(feed: CarrierFeed, arm: Arm) -> None:
    """Require an arm whose first joint is a feed, at the flange of a robot."""
    require_instance("feed", feed, CarrierFeed, "a CarrierFeed")
    require_instance("arm", arm, Arm, "an Arm")
    if not arm.in_metres[0]:
        raise InvalidValue("first joint of the arm", arm.joint_names[0], "a slide, the feed")
    off = feed.base_placement.actInv(arm.base_placement)
    if max(np.linalg.norm(off.translation), arm.length * np.linalg.norm(pin.log3(off.rotation))) > (
        FEED.deviation * arm.length
    ):
        allowed = "at the flange: Arm.from_modules(..., base_placement=feed.base_placement)"
        raise InvalidValue("base placement of the arm", arm.base_placement.translation.tolist(), allowed)
    lowest = float(arm.limits.lower[0])
    highest = float(arm.limits.upper[0])
    if min(lowest, feed.stroke - highest) < -CONVERGED * arm.length:
        raise InvalidValue(
            "limits of the feed", (lowest, highest), f"within 0 to {feed.stroke:g} m, the stroke"
        )
    axis = arm.chain.axes[0]
    if np.linalg.norm(axis - feed.base_placement.rotation[:, 0]) > FEED.deviation:
        raise InvalidValue(
            "first joint of the arm", axis.tolist(), "a slide along the feed (`CarrierFeed.joint`)"
        )


@declared()
class CarrierTable(Declared):
    """The robot that carries an arm, in a file.

    Attributes:
        robot: file of its description, relative to the folder of the file.
        start: its configuration with the feed retracted, (nq,) [rad or m].
        stroke: how far it is to feed [m].
        direction: direction of the feed in the frame of the flange, (3,).
        tip: its flange; None: the end of its chain.
    """

    robot: str
    start: Annotated[Sequence[float], AS_GIVEN]
    stroke: Length
    direction: Annotated[Sequence[float], AS_GIVEN] = (0.0, 0.0, 1.0)
    tip: str | None = None


@declared()
class DrumTable(Declared):
    """A drum or a wheel that pays out an arm, in a file.

    Attributes:
        radius: its radius [m].
        name: the joint of its drive.
    """

    radius: Length
    name: str = "drum"


@declared()
class FeedFile(Declared):
    """What feeds an arm in place of its slide, in a file: a robot, or a drum.

    Attributes:
        carrier: the robot.
        drum: the drum.
    """

    carrier: CarrierTable | None = None
    drum: DrumTable | None = None


def load_feed(path: str | Path, arm: Arm) -> CarrierFeed | Actuators:
    """Read what feeds an arm in place of its first joint, a slide, from a TOML or JSON file.

    A robot stands such that its flange, with the feed retracted, is at the base of the arm.

    Raises:
        FileError: the file, or the description of the robot, is missing or malformed.
        PostureError: values that are refused, or a first joint that is no slide.
    """
    read: FeedFile = Document.load(Path(path)).read(FeedFile, ())
    table = read.carrier
    if (table is None) == (read.drum is None):
        raise InvalidValue("feed", str(path), "a table [carrier] or a table [drum]")
    if not arm.in_metres[0]:
        raise InvalidValue("first joint of the arm", arm.joint_names[0], "a slide, the feed")
    if table is None:
        drum = cast(DrumTable, read.drum)
        matrix = np.eye(arm.nv)
        matrix[0, 0] = 1.0 / drum.radius
        units = (RADIAN, *joint_units(arm)[1:])
        return Actuators.from_matrix(arm, (drum.name, *arm.joint_names[1:]), matrix, units)
    file = Path(path).parent / table.robot
    there = Arm.load(file, tip=table.tip)
    ahead = np.array(unit_vector("direction", table.direction))
    turn = pin.Quaternion.FromTwoVectors(np.array([1.0, 0.0, 0.0]), ahead).toRotationMatrix()
    mount = _flange(there.at(there.checked(table.start, "start"))) * pin.SE3(turn, np.zeros(3))
    placed = Arm.load(file, tip=table.tip, base_placement=arm.base_placement * mount.inverse())
    return CarrierFeed(placed, table.start, table.stroke, table.direction)


def _flange(state: ArmState) -> pin.SE3:
    """Return the placement of the tip, world frame."""
    return pin.SE3(state.rotations[-1], state.points[-1])
