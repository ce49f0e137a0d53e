"""A robot as the feed of an arm: its flange carries the arm straight ahead."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from math import inf, isinf
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

from pinposture._validation import direction as unit_vector
from pinposture._validation import finite_array, make_read_only, require_instance, require_positive
from pinposture.arm import Arm, ArmState, JointSpec
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.model import describe_distance
from pinposture.control.tasks import orientation_rows
from pinposture.errors import InvalidValue, ReachError
from pinposture.motion.joint_trajectory import METRE, JointTrajectory, joint_units
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

    def at(self, s: ArrayLike) -> Array:
        """Return configurations of the robot.

        Args:
            s: positions of the feed, one number or (N,) [m].

        Returns:
            The configuration, (nq,), or one for each, (N, nq).

        Raises:
            InvalidValue: positions that are not within the stroke.
        """
        positions = self._checked(s)
        return self.carrier.integrate(self.start, self._spline(positions))

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

    def _rates(self, offset: Array) -> Array:
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
            rates = np.abs(self._rates(offset) / arm.joint_units)
            return FEED.largest_rate - arm.length * float(rates.max())

        events: list[Any] = [room, regularity]
        for event in events:
            event.terminal = True
            event.direction = -1.0
        solved = solve_ivp(
            lambda _, offset: self._rates(offset),
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


def _flange(state: ArmState) -> pin.SE3:
    """Return the placement of the tip, world frame."""
    return pin.SE3(state.rotations[-1], state.points[-1])
