"""Actuators that move several joints: tendons, gears, differential drives.

The position of an actuator is a linear function of the joint positions, u = R q. There may be more actuators
than degrees of freedom, as with antagonistic tendons.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from math import inf
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from pydantic import model_validator
from scipy.optimize import lsq_linear
from typing_extensions import Self

from pinposture._validation import (
    as_floats,
    finite_array,
    finite_vector,
    make_read_only,
    require_instance,
    require_known,
    require_positive,
    set_fields,
)
from pinposture.arm import Arm
from pinposture.control import Limits
from pinposture.errors import InvalidValue, enumerated
from pinposture.motion.joint_trajectory import METRE, RADIAN, JointTrajectory, check_names
from pinposture.quadratic_program import ROW_PROGRAM, solve
from pinposture.schema import AS_GIVEN, CheckedBy, Declared, declared
from pinposture.units import CONVERGED, ROUNDING

Array = NDArray[np.float64]


class Tendon(NamedTuple):
    """A tendon that runs along the arm at a fixed position in its cross-section.

    Attributes:
        offset: distance from the axis of the straight arm, (y, z) in the frame of the base link [m], or along
            two directions perpendicular to the axis if that is not x.
        end: the control point at whose module it ends, by name or index, 0-based.
        start: the control point at which it starts, likewise; None: at the base.
    """

    offset: tuple[float, float]
    end: str | int = -1
    start: str | int | None = None


@declared(eq=False)
class Actuators(Declared):
    """The actuators of an arm: u = R q.

    Attributes:
        arm: the arm.
        names: names of the actuators, (k,).
        matrix: R, (k, nv): motion of each actuator per unit of each degree of freedom; positive if a tendon
            is paid out.
        units: "m" or "rad" for each actuator, (k,).
        velocity: largest speed of each, (k,) [m/s or rad/s]; infinite: no limit.
        acceleration: largest acceleration of each, (k,) [m/s^2 or rad/s^2]; infinite: no limit.
    """

    arm: Annotated[Arm, AS_GIVEN]
    names: Annotated[tuple[str, ...], CheckedBy(lambda _, names: check_names(names))]
    matrix: Annotated[Array, AS_GIVEN]
    units: Annotated[tuple[str, ...], AS_GIVEN]
    velocity: Annotated[Array, AS_GIVEN] = inf  # type: ignore[assignment]
    acceleration: Annotated[Array, AS_GIVEN] = inf  # type: ignore[assignment]

    @model_validator(mode="after")
    def _fit(self) -> Self:
        require_instance("arm", self.arm, Arm, "an Arm")
        count = len(self.names)
        matrix = finite_array("matrix", self.matrix, (count, self.arm.nv))
        units = tuple(self.units) if isinstance(self.units, Iterable) else ()
        if len(units) != count or not all(unit in (RADIAN, METRE) for unit in units):
            allowed = f"{RADIAN!r} or {METRE!r} for each of {count} actuators"
            raise InvalidValue("units", self.units, allowed)
        limits = {}
        for name in ("velocity", "acceleration"):
            limits[name] = _of_each(name, getattr(self, name), count)
            for number in limits[name]:
                if number != inf:
                    require_positive(name, float(number))
        make_read_only(matrix, *limits.values())
        set_fields(self, matrix=matrix, units=units, **limits)
        return self

    @classmethod
    def from_matrix(
        cls,
        arm: Arm,
        names: Sequence[str],
        matrix: ArrayLike,
        units: Sequence[str],
        velocity: float | ArrayLike = inf,
        acceleration: float | ArrayLike = inf,
    ) -> Actuators:
        """Make actuators from a matrix.

        Args:
            arm: the arm.
            names: names of the actuators, k.
            matrix: R, (k, nv).
            units: "m" or "rad" for each actuator.
            velocity: largest speed, one number or (k,) [m/s or rad/s].
            acceleration: largest acceleration, one number or (k,) [m/s^2 or rad/s^2].

        Raises:
            InvalidValue: wrong shapes, numbers that are not finite, or limits that are not positive.
        """
        return cls(arm, names, matrix, units, velocity, acceleration)  # type: ignore[arg-type]

    @classmethod
    def from_tendons(
        cls,
        arm: Arm,
        tendons: Mapping[str, Tendon],
        velocity: float | ArrayLike = inf,
        acceleration: float | ArrayLike = inf,
    ) -> Actuators:
        """Make the actuators of tendons.

        The moment arms are those of the straight arm; they are constant if joints lie on the axis and tendons
        cross them through small holes. A tendon along t lengthens by t . (a x r) per radian of a revolute
        joint with axis a at a vector r from the joint, and by t . a per metre of a prismatic one.

        Args:
            arm: the arm, straight at its neutral configuration.
            tendons: the tendons by their names.
            velocity: largest speed of each, one number or (k,) [m/s].
            acceleration: largest acceleration of each, one number or (k,) [m/s^2].

        Raises:
            InvalidValue: an arm that is not straight at its neutral configuration, a tendon without length,
                or limits that are not positive.
            UnknownName: a control point that does not exist.
        """
        chain = arm.chain
        axis = chain.points[-1] - chain.base
        if np.linalg.norm(axis) < (1.0 - 1e-6) * arm.length:
            raise InvalidValue("arm", arm.name, "an arm that is straight at its neutral configuration")
        axis = axis / np.linalg.norm(axis)
        across = _across(arm, axis)
        matrix = np.zeros((len(tendons), arm.nv))
        for row, (name, tendon) in zip(matrix, tendons.items(), strict=True):
            first = 0 if tendon.start is None else _module_end(arm, name, tendon.start)
            last = _module_end(arm, name, tendon.end)
            offset = finite_vector(f"offset of tendon {name!r}", tendon.offset, 2)
            if last <= first:
                raise InvalidValue(f"tendon {name!r}", tendon, "an end farther along the arm than its start")
            for u in range(first, last):
                if chain.revolute[u]:
                    lever = chain.base + offset @ across - chain.origins[u]
                    change = float(axis @ np.cross(chain.axes[u], lever))
                else:
                    change = float(axis @ chain.axes[u])
                row[chain.columns[u]] += chain.ratios[u] * change
        return cls.from_matrix(arm, tuple(tendons), matrix, (METRE,) * len(tendons), velocity, acceleration)

    def positions(self, q: ArrayLike) -> Array:
        """Return the actuator positions at a configuration, (k,), or at several (N, nq), (N, k).

        Raises:
            InvalidValue: not a configuration.
        """
        rows = np.atleast_2d(as_floats("q", q))
        moved = np.array([self.arm.positions(row) for row in rows]) @ self.matrix.T
        return np.asarray(moved if np.ndim(q) == 2 else moved[0])

    def configuration(self, positions: ArrayLike) -> tuple[Array, float]:
        """Return the configuration that fits measured actuator positions best.

        Args:
            positions: actuator positions, (k,) [m or rad].

        Returns:
            The configuration (nq,), and the largest residual [m or rad], zero unless there are more actuators
            than degrees of freedom. Degrees of freedom off the chain are at zero.

        Raises:
            InvalidValue: not k finite numbers, or actuators that do not determine the degrees of freedom.
        """
        checked = finite_vector("positions", positions, len(self.names))
        u, sigma, vt = self._require_determined()
        moved = np.zeros(self.arm.nv)
        moved[self.arm.columns] = vt.T @ ((u.T @ checked) / sigma)
        return self.arm.configuration(moved), float(np.abs(self.matrix @ moved - checked).max())

    def commands(self, positions: Array) -> Array:
        """Return the actuator positions, (k,), for positions of `Arm.drives`, (nv,) [rad or m]."""
        return np.asarray(self.matrix @ self.arm.drives.joint_positions(positions))

    def measured(self, positions: Mapping[str, float]) -> dict[str, float]:
        """Return the positions of `Arm.drives` by name that fit measured actuators, by name, best.

        Raises:
            InvalidValue: a position is missing, or the actuators do not determine all joints.
        """
        for name in self.names:
            require_known("position of actuator", name, positions)
        u, sigma, vt = self._require_determined()
        moved = np.zeros(self.arm.nv)
        readings = np.array([positions[name] for name in self.names])
        moved[self.arm.columns] = vt.T @ ((u.T @ readings) / sigma)
        return self.arm.drives.named(self.arm.drives.positions(moved))

    def _require_determined(self) -> tuple[Array, Array, Array]:
        """Return the singular values of the matrix; raise InvalidValue if a degree of freedom is free."""
        columns = self.matrix[:, self.arm.columns]
        u, sigma, vt = np.linalg.svd(columns)
        rank = int(np.count_nonzero(sigma > ROUNDING * sigma.max(initial=0.0)))
        if rank < columns.shape[1]:
            free = self.arm.joint_names[self.arm.columns[int(np.abs(vt[-1]).argmax())]]
            allowed = f"{columns.shape[1]} independent rows; {free!r} is not determined"
            raise InvalidValue("rank of the matrix", rank, allowed)
        return u[:, : len(sigma)], sigma, vt

    def stiffness(self, stiffness: float | ArrayLike) -> Array:
        """Return the stiffness of the joints that elastic tendons or gears hold, R^T diag(k) R.

        It holds while the tendons are taut. `Arm.with_stiffness` takes it.

        Args:
            stiffness: force or torque of each actuator per displacement from its command, one number or (k,)
                [N/m or N m/rad].

        Returns:
            Torque or force per displacement of the degrees of freedom, (nv, nv) [N m/rad or N/m].

        Raises:
            InvalidValue: not positive numbers, or actuators that leave a degree of freedom free: names it.
        """
        stiffnesses = _of_each("stiffness", stiffness, len(self.names))
        for number in stiffnesses:
            require_positive("stiffness", float(number))
        self._require_determined()
        return np.asarray(self.matrix.T @ (stiffnesses[:, None] * self.matrix))

    def tensions(
        self, torques: ArrayLike, least: float | ArrayLike = 0.0, most: float | ArrayLike = inf
    ) -> Array:
        """Return the smallest tensions of tendons that exert given torques on the joints.

        They solve -R^T t = torques, because a tendon pulls to where it is shorter, with the smallest sum of
        squares within the limits. Torques that hold the arm are `arm.at(q).gravity_torques`.

        Args:
            torques: torque or force along each degree of freedom, (nv,) [N m or N].
            least: smallest tension, which keeps the tendons taut, one number or (k,) [N].
            most: largest tension, one number or (k,) [N]; infinite: no limit.

        Returns:
            The tensions, (k,) [N].

        Raises:
            InvalidValue: an actuator that is no tendon (in metres); wrong shapes or numbers; or torques that
                no such tensions exert: names the joint that lacks most.
        """
        count = len(self.names)
        needed = finite_vector("torques", torques, self.arm.nv)
        turning = [name for name, unit in zip(self.names, self.units, strict=True) if unit != METRE]
        if turning:
            raise InvalidValue("units", self.units, f"{METRE!r}, of tendons; {turning[0]!r} is none")
        lower = _of_each("least", least, count)
        upper = _of_each("most", most, count)
        if not np.all((lower >= 0.0) & (lower < inf) & (upper >= lower)):
            raise InvalidValue("least, most", (least, most), "0 <= least <= most [N]")
        pull = -self.matrix.T
        u, sigma, vt = np.linalg.svd(pull, full_matrices=False)
        rank = int(np.count_nonzero(sigma > ROUNDING * sigma.max(initial=0.0)))
        # Equations with orthonormal rows, which say the same.
        exact = (u[:, :rank].T @ needed) / sigma[:rank]
        size = max(float(np.abs(exact).max(initial=0.0)), float(lower.max()), 1e-30)
        bounds = (lower / size, np.minimum(upper / size, ROW_PROGRAM.no_bound))
        balanced = solve(np.eye(count), np.zeros(count), *bounds, equal=(vt[:rank], exact / size)).x
        if balanced is not None:
            tensions = np.clip(size * balanced, lower, upper)
            lack = np.abs(pull @ tensions - needed)
            # the tolerance of the quadratic program
            if lack.max(initial=0.0) <= 1e-7 * max(float(np.abs(needed).max()), size * sigma.max()):
                return tensions
        raise self._lacking(pull, needed, lower, upper)

    def _lacking(self, pull: Array, needed: Array, lower: Array, upper: Array) -> InvalidValue:
        """Return the error of torques that no tensions exert."""
        most = np.where(upper > lower, upper, np.nextafter(lower, inf))
        nearest = lsq_linear(pull, needed, (lower, most)).x
        lack = needed - pull @ nearest
        worst = int(np.abs(lack).argmax())
        joint = self.arm.joint_names[worst]
        unit = "N" if self.arm.in_metres[worst] else "N m"
        allowed = f"torques that the tendons can exert; joint {joint!r} lacks {abs(lack[worst]):.4g} {unit}"
        full = [
            name
            for name, t, top in zip(self.names, nearest, upper, strict=True)
            if t >= top * (1.0 - CONVERGED)
        ]
        if full:
            allowed += f" with {enumerated(map(repr, full), 4)} at the largest tension"
        return InvalidValue(f"torque of joint {joint!r}", float(needed[worst]), allowed)

    def limits(self, limits: Limits) -> Limits:
        """Return joint limits with which the actuators keep their velocity and acceleration limits.

        The limits of the joints that an actuator moves are scaled together, so that it keeps its own even if
        all of them move at their limits: sum_j |R_ij| v_j <= u_i.

        Args:
            limits: limits of the joints, with `dt`.

        Raises:
            InvalidValue: limits without `dt`, or a limited actuator that moves joints without limits.
        """
        if limits.dt is None:
            raise InvalidValue("limits.dt", None, "the duration of a step [s]")
        speed = self.arm.limits.velocity if limits.velocity is None else limits.velocity
        acceleration = inf if limits.acceleration is None else limits.acceleration
        return replace(
            limits,
            velocity=self._share("velocity", speed, self.velocity),
            acceleration=None
            if limits.acceleration is None and not np.isfinite(self.acceleration).any()
            else self._share("acceleration", acceleration, self.acceleration),
        )

    def _share(self, name: str, joints: float | Array, most: Array) -> Array:
        """Return joint limits, (nv,), with which the actuators keep theirs, (k,)."""
        bound = np.array(np.broadcast_to(np.asarray(joints, dtype=np.float64), self.arm.nv))
        factor = np.ones(self.arm.nv)
        for actuator, row, limit in zip(self.names, np.abs(self.matrix), most, strict=True):
            moves = row > 0.0
            if not np.isfinite(limit) or not np.any(moves):
                continue
            used = float(row[moves] @ bound[moves])
            if not np.isfinite(used):
                joint = self.arm.joint_names[int(np.flatnonzero(moves & ~np.isfinite(bound))[0])]
                allowed = f"a finite {name} of joint {joint!r}, which actuator {actuator!r} moves"
                raise InvalidValue(f"limits.{name}", joints, allowed)
            factor[moves] = np.minimum(factor[moves], limit / used)
        return np.where(np.isfinite(bound), bound * factor, bound)

    def trajectory(self, joints: JointTrajectory) -> JointTrajectory:
        """Return the motion of the actuators for a joint trajectory; InvalidValue if it is of another arm."""
        moved = joints.matched(self.arm)
        return JointTrajectory(
            self.names,
            moved.time,
            moved.positions @ self.matrix.T,
            moved.velocities @ self.matrix.T,
            moved.accelerations @ self.matrix.T,
            self.units,
            moved.name,
        )


def _of_each(name: str, value: float | ArrayLike, count: int) -> Array:
    """Return a number of each actuator, (count,), given one for all or one for each."""
    listed = as_floats(name, value)
    if listed.shape not in ((), (count,)):
        raise InvalidValue(f"{name} (shape)", listed.shape, f"one number or ({count},)")
    return np.array(np.broadcast_to(listed, count))


def _across(arm: Arm, axis: Array) -> Array:
    """Return two directions perpendicular to an axis, (2, 3): y and z of the base if the axis is its x."""
    y = np.asarray(arm.base_placement.rotation)[:, 1]
    y = y - axis * (axis @ y)
    if np.linalg.norm(y) < 1e-6:
        y = np.cross(axis, np.eye(3)[np.argmin(np.abs(axis))])
    y = y / np.linalg.norm(y)
    return np.array([y, np.cross(axis, y)])


def _module_end(arm: Arm, name: str, point: str | int) -> int:
    """Return the number of joints of the chain up to a control point."""
    points = arm.control_points
    if isinstance(point, str):
        require_known(f"control point of tendon {name!r}", point, points)
        point = points.index(point)
    if not -len(points) <= point < len(points):
        raise InvalidValue(f"control point of tendon {name!r}", point, f"an index of {len(points)} points")
    stop: int = arm.chain.module_slices[point].stop
    return stop
