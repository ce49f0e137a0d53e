"""Estimates the shape of an arm from any mix of sensors.

An iterated extended Kalman filter on the manifold of configurations knows the configuration q and how far
each joint is from what its encoder on the motor says, as gears, tendons and links give way. The latter is
the deflection -K^-1 g(q) where the stiffness K and the masses are known, and a rest that changes slowly (an
Ornstein-Uhlenbeck process). So what cameras or inertial sensors tell of it stays known while they see
nothing.

Readings, which may be outliers, with the errors e(x), measured minus expected, and the rows H by which the
expected ones change, move its state x to the most probable one, by damped Gauss-Newton steps (Bell and
Cathey, 1993). States are written as x + P p, with the covariance P before and a pull p, so that P need not
have an inverse: joints that do not move have no variance.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from math import exp
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.linalg import lapack
from scipy.special import gammainccinv

from pinposture._validation import (
    LARGEST_COORDINATE,
    as_number,
    finite_vector,
    float_array,
    require_instance,
    require_known,
    rigid_placement,
    rotation,
)
from pinposture.arm import Arm, ChainState, ControlPoints
from pinposture.arm.manipulability import chosen_points
from pinposture.errors import InvalidValue
from pinposture.units import CONVERGED

Array = NDArray[np.float64]
Chosen = NDArray[np.bool_]


class UpdateSettings(NamedTuple):
    """How an update with measurements is found by Gauss-Newton steps."""

    max_steps: int = 20
    """Largest number of steps."""

    max_halvings: int = 8
    """How often a step that makes the fit worse is halved."""


UPDATE = UpdateSettings()


class Readings(NamedTuple):
    """Readings near a state.

    Attributes:
        errors: measured minus expected, (k, b).
        rows: change of the expected ones per change of the state, (k, b, 2 nv), or of the configuration, nv.
    """

    errors: Array
    rows: Array


class Sensor(NamedTuple):
    """What is measured.

    Attributes:
        near: returns the readings near a state, given the arm, and distances of joints from encoders, (nv,).
        noise: standard deviation of a reading.
        likely: the largest distance of a reading from what is expected, squared, in standard deviations.
    """

    near: Callable[[ChainState, Array], Readings]
    noise: float
    likely: float


class FittedState(NamedTuple):
    """A state to which readings draw the arm.

    Attributes:
        state: the arm.
        give: distance of each joint from its encoder, (nv,) [rad or m].
        pull: it is the state before plus the covariance before times this, (2 nv,).
        near: the readings there.
    """

    state: ChainState
    give: Array
    pull: Array
    near: Readings


class Spread(NamedTuple):
    """How readings scatter about what is expected.

    Attributes:
        rows: H, how the expected ones change with the state, (r, 2 nv).
        across: H P, (r, 2 nv).
        factor: the lower Cholesky factor of H P H^T and their noise, (r, r).
    """

    rows: Array
    across: Array
    factor: Array

    def solve(self, right: Array) -> Array:
        """Return the solution of H P H^T and the noise for a right side, (r,) or (r, k).

        The functions of SciPy that do this check and copy for longer than they compute.
        """
        return np.asarray(lapack.dpotrs(self.factor, right, lower=True)[0])


class Belief(NamedTuple):
    """What is believed of the state.

    Attributes:
        state: the arm.
        give: distance of each joint from its encoder, (nv,) [rad or m].
        covariance: of the configuration and those distances, (2 nv, 2 nv).
    """

    state: ChainState
    give: Array
    covariance: Array

    def given(self, sensor: Sensor) -> tuple[Belief, Chosen]:
        """Return what is believed after readings, and which of them were used, (k,).

        All are used if none is farther from the fit to all than is likely. Else they are taken one by one,
        from the base on, but for outliers; and the fit of those begins where this leads to. Far from the
        state before, the readings of a long arm are not linear: all at once they lead astray.
        """
        start = self._moved(sensor, np.zeros(len(self.covariance)))
        used = np.ones(len(start.near.errors), dtype=np.bool_)
        if not used.any():
            return self, used
        fit = self._fit(sensor, start, used)
        spread = self._spread(sensor, fit.near, used)
        if self._distances(sensor, fit, used, spread).max() > sensor.likely:
            start, used = self._one_by_one(sensor, start)
            fit, used = self._without_outliers(sensor, start, used)
            if not used.any():
                return self, used
            spread = self._spread(sensor, fit.near, used)
        return self._after(sensor, fit, spread), used

    def _one_by_one(self, sensor: Sensor, start: FittedState) -> tuple[FittedState, Chosen]:
        """Return the state after one reading after the other, and those that were no outliers."""
        belief = self
        used = np.zeros(len(start.near.errors), dtype=np.bool_)
        joints = np.count_nonzero(start.near.rows, axis=(1, 2))  # the more, the farther from the base
        for k in np.argsort(joints, kind="stable"):
            one = np.arange(len(used)) == k
            begun = belief._moved(sensor, np.zeros(len(self.covariance)))
            fit = belief._fit(sensor, begun, one)
            spread = belief._spread(sensor, fit.near, one)
            if belief._distances(sensor, fit, one, spread)[k] <= sensor.likely:
                used[k] = True
                belief = belief._after(sensor, fit, spread)
        arm = self.state.arm
        moved = np.concatenate([arm.difference(self.state.q, belief.state.q), belief.give - self.give])
        pull = np.linalg.lstsq(self.covariance, moved, rcond=None)[0]
        return self._moved(sensor, pull), used

    def _without_outliers(self, sensor: Sensor, fit: FittedState, used: Chosen) -> tuple[FittedState, Chosen]:
        """Fit readings; while one is farther off than is likely, leave out the farthest (Baarda, 1968)."""
        used = used.copy()
        while used.any():
            fit = self._fit(sensor, fit, used)
            apart = self._distances(sensor, fit, used, self._spread(sensor, fit.near, used))
            farthest = int(apart.argmax())
            if apart[farthest] <= sensor.likely:
                break
            used[farthest] = False
        return fit, used

    def _moved(self, sensor: Sensor, pull: Array) -> FittedState:
        """Return the state to which a pull moves this one."""
        moved = self.covariance @ pull
        state = self.state.moved(moved[: len(self.give)])
        give = self.give + moved[len(self.give) :]
        return FittedState(state, give, pull, sensor.near(state, give))

    def _cost(self, sensor: Sensor, fit: FittedState, used: Chosen) -> float:
        """Return minus twice the logarithm of the probability of a state, but for a constant."""
        missed = fit.near.errors[used] / sensor.noise
        return float(fit.pull @ self.covariance @ fit.pull + (missed**2).sum())

    def _fit(self, sensor: Sensor, fit: FittedState, used: Chosen) -> FittedState:
        """Return the most probable state, given some readings, from another on."""
        covariance = self.covariance
        units = np.tile(self.state.arm.joint_units, 2)
        cost = self._cost(sensor, fit, used)
        for _ in range(UPDATE.max_steps):
            spread = self._spread(sensor, fit.near, used)
            innovation = fit.near.errors[used].ravel() + spread.across @ fit.pull
            change = spread.rows.T @ spread.solve(innovation) - fit.pull
            for halved in range(UPDATE.max_halvings):
                step = 0.5**halved * change
                tried = self._moved(sensor, fit.pull + step)
                lower = self._cost(sensor, tried, used)
                if lower <= cost:
                    break
            else:
                break
            fit = tried
            cost = lower
            if np.abs(covariance @ step / units).max() < CONVERGED:
                break
        return fit

    def _spread(self, sensor: Sensor, near: Readings, used: Chosen) -> Spread:
        """Return how the readings that are used scatter."""
        chosen = near.rows[used]
        rows = np.zeros((chosen.shape[0] * chosen.shape[1], len(self.covariance)))
        rows[:, : chosen.shape[2]] = chosen.reshape(len(rows), -1)
        across = rows @ self.covariance
        spread = across @ rows.T
        spread.flat[:: len(spread) + 1] += sensor.noise**2
        factor, fault = lapack.dpotrf(spread, lower=True)
        if fault:
            raise np.linalg.LinAlgError("the covariance of the readings is not positive definite")
        return Spread(rows, across, factor)

    def _distances(self, sensor: Sensor, fit: FittedState, used: Chosen, spread: Spread) -> Array:
        """Return how far each reading is from what the others tell, squared, in standard deviations, (k,).

        From its residual at the fit, with the covariance N (H P H^T + N)^-1 N, where N is the noise; for a
        single one this is its distance from the state before.
        """
        residuals = fit.near.errors[used]
        count, size = residuals.shape
        inverse = spread.solve(np.eye(count * size))
        blocks = np.einsum("kbkc->kbc", inverse.reshape(count, size, count, size)) * sensor.noise**4
        distances = np.zeros(len(used))
        distances[used] = np.einsum(
            "kb,kb->k", residuals, np.linalg.solve(blocks, residuals[..., None])[..., 0]
        )
        return distances

    def _after(self, sensor: Sensor, fit: FittedState, spread: Spread) -> Belief:
        """Return what is believed after the readings to which a state is fitted."""
        gain = spread.solve(spread.across).T
        left = self.covariance - gain @ spread.across
        noise = sensor.noise**2 * gain @ gain.T
        left = left - (left @ spread.rows.T) @ gain.T + noise  # positive despite rounding
        return Belief(fit.state, fit.give, 0.5 * (left + left.T))


logger = logging.getLogger(__name__)


SMALLEST_NOISE = 1e-9
"""Smallest standard deviation [rad, m, 1/m or `Arm.joint_units`] or time [s] that is possible: no reading is
exact."""

SIDES = ("joint", "motor")
"""Where encoders are."""


class ShapeEstimator:
    """Estimates the shape of an arm from encoders, inertial sensors, fibres and cameras.

    Use it in front of a `Tracker` where the encoders do not tell the shape: some are missing, or the arm sags
    behind them. In each cycle call `predict`, then one method for each kind of sensor that has new readings;
    `q` is the configuration to give to `Tracker.step`. Sensors that have nothing new are left out, and single
    readings that are missing are NaN. Positions and orientations are in the world frame of the arm; if its
    base moves, say so with `move_base`.

    Each method that takes readings returns which of them were used, (k,). A reading is left out if it is
    missing, or if it is farther from what is expected than its noise and the covariance explain.

    Args:
        arm: the arm. If its masses and stiffness are known (`Arm.sag_known`), encoders on motors are read
            with the deflection under its weight.
        q: the configuration to begin with, (nq,).
        deviation: standard deviation of the joints from it, in `Arm.joint_units`.
        drift: how far joints move, besides what `predict` is told, within a second; standard deviation, in
            `Arm.joint_units`. It grows with the root of time.
        give: standard deviation of joints from encoders on motors that the deflection does not explain, in
            `Arm.joint_units`; 0: there is none.
        give_time: time after which that has changed [s].
        outliers: share of good readings that may be left out as outliers, in (0, 1).

    Raises:
        InvalidValue: not an arm, not a configuration, or numbers out of range.
    """

    def __init__(
        self,
        arm: Arm,
        q: ArrayLike,
        *,
        deviation: float = 0.1,
        drift: float = 0.3,
        give: float = 0.0,
        give_time: float = 2.0,
        outliers: float = 1e-4,
    ) -> None:
        require_instance("arm", arm, Arm, "an Arm")
        n = arm.nv
        self.arm = arm
        state = arm.chain_at(arm.checked(q))
        units = arm.joint_units * arm.moved
        self._drift = (_bounded("drift", drift, zero=True) * units) ** 2
        self._spread = (_bounded("give", give, zero=True) * units) ** 2
        self._give_time = _bounded("give_time", give_time)
        share = as_number("outliers", outliers, "a number in (0, 1)", lambda number: 0.0 < number < 1.0)
        # The quantiles of chi-squared distributions of one, two and three degrees of freedom.
        self._likely = 2.0 * gammainccinv(0.5 * np.array([1.0, 2.0, 3.0]), share)
        begun = (_bounded("deviation", deviation, zero=True) * units) ** 2
        self._belief = Belief(state, np.zeros(n), np.diag(np.concatenate([begun, self._spread])))
        self._base = pin.SE3.Identity()
        self._weighed = arm

    # What is known.

    @property
    def q(self) -> Array:
        """The configuration, (nq,); a copy."""
        return np.array(self._belief.state.q)

    @property
    def give(self) -> Array:
        """How far joints are from encoders on motors, besides their deflection, (nv,) [rad or m]; a copy."""
        return np.array(self._belief.give)

    @property
    def covariance(self) -> Array:
        """Covariance of the joint positions, (nv, nv) [rad^2, rad m or m^2]; a copy."""
        n = self.arm.nv
        return np.array(self._belief.covariance[:n, :n])

    @property
    def deviations(self) -> Array:
        """Standard deviation of each joint, (nv,) [rad or m]."""
        return np.asarray(np.sqrt(np.diagonal(self.covariance)))

    @property
    def point_deviations(self) -> Array:
        """Root mean square distance of each control point from where it is believed to be, (m,) [m]."""
        rows = self._belief.state.jacobians
        variances = np.einsum("kij,jl,kil->k", rows, self.covariance, rows)
        return np.asarray(np.sqrt(np.maximum(variances, 0.0)))

    # What changes.

    def predict(self, dt: float, change: ArrayLike | None = None) -> None:
        """Say that time has passed; call it first in each cycle.

        Args:
            dt: the time [s].
            change: how far the joints have been commanded to move in it, (nv,) [rad or m]; None: not known.

        Raises:
            InvalidValue: no time, or another shape.
        """
        _bounded("dt", dt)
        n = self.arm.nv
        state, give, covariance = self._belief
        if change is not None:
            state = state.moved(finite_vector("change", change, n))
        kept = exp(-dt / self._give_time)
        shares = np.repeat([1.0, kept], n)
        grown = np.concatenate([self._drift * dt, self._spread * (1.0 - kept * kept)])
        self._belief = Belief(state, kept * give, covariance * np.outer(shares, shares) + np.diag(grown))

    def move_base(self, placement: pin.SE3 | ArrayLike) -> None:
        """Say where the base of the arm is now.

        Args:
            placement: of the world frame of the arm in the frame in which orientations, points and placements
                are measured and gravity acts as at the beginning, a `pin.SE3` or (4, 4) [m].

        Raises:
            InvalidValue: not a placement.
        """
        before = self._base.rotation
        self._base = rigid_placement("placement", placement)
        if self.arm.sag_known and not np.array_equal(before, self._base.rotation):
            gravity = self._base.rotation.T @ self.arm.model.gravity.linear
            self._weighed = self.arm.with_gravity(gravity)

    # Readings.

    def add_encoders(
        self, positions: ArrayLike | Mapping[str, float], noise: float, side: str = "joint"
    ) -> Chosen:
        """Take readings of joint positions.

        Args:
            positions: (nv,) [rad or m], NaN where a joint has no encoder or it did not answer; or by name, of
                driven joints.
            noise: standard deviation of a reading [rad or m].
            side: "joint": of the joint itself; "motor": before gears, tendons and what else gives way.

        Returns:
            Which were used, (nv,).

        Raises:
            InvalidValue: another shape, infinite, or no noise.
            UnknownName: another `side`.
        """
        arm = self.arm
        deviation = _bounded("noise", noise)
        require_known("side of encoders", side, SIDES)
        if isinstance(positions, Mapping):
            read = np.full(arm.nv, np.nan)
            columns = arm.drives.find(positions)
            if not columns:
                raise InvalidValue(
                    "positions", list(positions), f"names of joints, such as {arm.joint_names[0]!r}"
                )
            read[list(columns)] = list(columns.values())
        else:
            read = _readings("positions", positions, (arm.nv,))
        known = np.flatnonzero(~np.isnan(read))
        measured = arm.configuration(np.where(np.isnan(read), 0.0, read))
        n = arm.nv
        before = np.eye(n, 2 * n)
        if side == "motor":
            before[:, n:] = -np.eye(n)

        def near(state: ChainState, give: Array) -> Readings:
            errors = arm.difference(state.q, measured)
            rows = before
            if side == "motor":
                errors = errors + give
            if side == "motor" and arm.sag_known:
                loaded = state if self._weighed is arm else self._weighed.chain_at(state.q)
                rows = before.copy()
                rows[:, :n] += np.linalg.solve(arm.stiffness, loaded.gravity_gradient)
                errors = errors + loaded.deflection
            # Full turns are not measured.
            errors = np.where(arm.in_metres, errors, np.remainder(errors + np.pi, 2.0 * np.pi) - np.pi)
            return Readings(errors[known, None], rows[known, None])

        return self._scattered(arm.nv, known, self._read(near, 1, deviation))

    def add_orientations(
        self,
        rotations: ArrayLike,
        noise: float,
        at: ControlPoints | None = None,
        mounting: ArrayLike | None = None,
    ) -> Chosen:
        """Take orientations, as inertial sensors with a compass give them.

        Args:
            rotations: from the frame of each sensor to the world frame, (k, 3, 3); NaN: it is missing.
            noise: standard deviation about each axis [rad].
            at: the control points that carry the sensors, by index or name, k of them; all if None.
            mounting: rotation from the frame of a sensor to that of its control point, (3, 3), or roll, pitch
                and yaw [rad]; None: none.

        Returns:
            Which were used, (k,).

        Raises:
            InvalidValue: another shape, not rotations, or no noise.
            UnknownName: no such control point.
        """
        deviation = _bounded("noise", noise)
        chosen = self._chosen(at)
        read = _readings("rotations", rotations, (len(chosen), 3, 3))
        known = _complete(read)
        for k in known:
            rotation(f"rotations[{k}]", read[k])
        mounted = np.array(rotation("mounting", mounting))
        world = self._base.rotation.T @ read[known]
        points = chosen[known]

        def near(state: ChainState, _: Array) -> Readings:
            expected = state.rotations[points] @ mounted
            apart = np.swapaxes(expected, 1, 2) @ world
            errors = np.array([pin.log3(turn) for turn in apart]).reshape(-1, 3)
            # exp(-u) M moves log M by the inverse of its left Jacobian, times -u.
            turning = np.array([pin.Jlog3(turn).T for turn in apart]).reshape(-1, 3, 3)
            rows = turning @ np.swapaxes(expected, 1, 2) @ state.angular_jacobians[points]
            return Readings(errors, rows)

        return self._scattered(len(chosen), known, self._read(near, 3, deviation))

    def add_tilts(
        self,
        up: ArrayLike,
        noise: float,
        at: ControlPoints | None = None,
        mounting: ArrayLike | None = None,
    ) -> Chosen:
        """Take the direction upwards, as accelerometers at rest give it.

        Args:
            up: +z of the world in the frame of each sensor, (k, 3), of any length; NaN: it is missing.
            noise: standard deviation of the direction, about each of two axes [rad].
            at: as for `add_orientations`.
            mounting: as for `add_orientations`.

        Returns:
            Which were used, (k,).

        Raises:
            InvalidValue: another shape, a direction of no length, or no noise.
            UnknownName: no such control point.
        """
        deviation = _bounded("noise", noise)
        chosen = self._chosen(at)
        read = _readings("up", up, (len(chosen), 3))
        known = _complete(read)
        sizes = np.linalg.norm(read[known], axis=1)
        if not np.all(sizes > SMALLEST_NOISE):
            k = int(known[int(sizes.argmin())])
            raise InvalidValue(f"up[{k}]", read[k].tolist(), "a direction, not all 0")
        mounted = np.array(rotation("mounting", mounting))
        local = (read[known] / sizes[:, None]) @ mounted.T
        vertical = self._base.rotation.T[:, 2]
        points = chosen[known]

        def near(state: ChainState, _: Array) -> Readings:
            # The arm is to turn the measured direction t to the vertical z: the arc from t to z, in a basis
            # across z. A rotation w of the arm moves t by w x t.
            measured = np.einsum("kij,kj->ki", state.rotations[points], local)
            sideways = np.eye(3)[int(np.abs(vertical).argmin())]
            first = np.cross(vertical, sideways)
            first /= np.linalg.norm(first)
            across = np.stack([first, np.cross(vertical, first)])
            beside = measured @ across.T
            sines = np.linalg.norm(beside, axis=1)
            angles = np.arctan2(sines, measured @ vertical)
            scale = np.where(sines > SMALLEST_NOISE, angles / np.maximum(sines, SMALLEST_NOISE), 1.0)
            errors = -scale[:, None] * beside
            # It moves b . t by w . (t x b).
            about = np.cross(measured[:, None], across[None])
            rows = scale[:, None, None] * (about @ state.angular_jacobians[points])
            return Readings(errors, rows)

        return self._scattered(len(chosen), known, self._read(near, 2, deviation))

    def add_points(self, points: ArrayLike, noise: float, at: ControlPoints | None = None) -> Chosen:
        """Take positions of control points, as cameras see them.

        Args:
            points: (k, 3) [m], world frame; NaN for one that is not seen.
            noise: standard deviation along each axis [m].
            at: the control points, by index or name, k of them; all if None.

        Returns:
            Which were used, (k,).

        Raises:
            InvalidValue: another shape, infinite, or no noise.
            UnknownName: no such control point.
        """
        deviation = _bounded("noise", noise)
        chosen = self._chosen(at)
        read = _readings("points", points, (len(chosen), 3))
        known = _complete(read)
        seen = (read[known] - self._base.translation) @ self._base.rotation
        which = chosen[known]

        def near(state: ChainState, _: Array) -> Readings:
            return Readings(seen - state.points[which], state.jacobians[which])

        return self._scattered(len(chosen), known, self._read(near, 3, deviation))

    def add_curvatures(self, curvatures: ArrayLike, noise: float, at: ControlPoints | None = None) -> Chosen:
        """Take curvatures of modules, as fibres along the arm give them.

        If R is the rotation of the end of a module relative to its start since the neutral configuration, its
        curvature is log(R) / length, in the frame at its end: as if it was bent evenly.

        Args:
            curvatures: of the module before each control point, (k, 3) [rad/m]; NaN for what is not measured,
                such as the twist about the link.
            noise: standard deviation of a component [rad/m].
            at: the control points at the ends of the modules, k of them; all if None.

        Returns:
            Which components were used, (k, 3).

        Raises:
            InvalidValue: another shape, infinite, or no noise.
            UnknownName: no such control point.
        """
        deviation = _bounded("noise", noise)
        chosen = self._chosen(at)
        read = _readings("curvatures", curvatures, (len(chosen), 3))
        lengths = self.arm.chain.module_lengths[chosen]
        neutral = self.arm.chain_at(self.arm.origin).rotations
        known = np.argwhere(~np.isnan(read))
        entries = known[:, 0] * 3 + known[:, 1]

        def near(state: ChainState, _: Array) -> Readings:
            expected, rows = _bends(state, neutral, chosen)
            errors = (read - expected / lengths[:, None]).reshape(-1, 1)
            rows = (rows / lengths[:, None, None]).reshape(-1, 1, self.arm.nv)
            return Readings(errors[entries], rows[entries])

        used = self._scattered(read.size, entries, self._read(near, 1, deviation))
        return used.reshape(read.shape)

    def add_placement(
        self, placement: pin.SE3 | ArrayLike, noise: float, turn_noise: float, at: str | int = -1
    ) -> Chosen:
        """Take the placement of a control point, as a tracking system gives it.

        Args:
            placement: a `pin.SE3` or (4, 4) [m], world frame.
            noise: standard deviation of its position along each axis [m].
            turn_noise: standard deviation of its orientation about each axis [rad].
            at: the control point, by index or name; the tip by default.

        Returns:
            Whether its position and its orientation were used, (2,).

        Raises:
            InvalidValue: not a placement, or no noise.
            UnknownName: no such control point.
        """
        placed = rigid_placement("placement", placement)
        _bounded("turn_noise", turn_noise)
        position = self.add_points(placed.translation[None], noise, [at])
        return np.concatenate([position, self.add_orientations(placed.rotation[None], turn_noise, [at])])

    # The filter.

    def _chosen(self, at: ControlPoints | None) -> NDArray[np.intp]:
        names = self.arm.control_points
        chosen = range(len(names)) if at is None else chosen_points(names, at)
        return np.array(chosen, dtype=np.intp)

    def _scattered(self, count: int, known: NDArray[np.intp], used: Chosen) -> Chosen:
        """Return which of all readings were used, (count,), given which of those that are known."""
        all_used = np.zeros(count, dtype=np.bool_)
        all_used[known] = used
        return all_used

    def _read(self, near: Callable[[ChainState, Array], Readings], size: int, noise: float) -> Chosen:
        """Take readings of some numbers each, near a state; return which of them were used, (k,)."""
        sensor = Sensor(near, noise, float(self._likely[size - 1]))
        self._belief, used = self._belief.given(sensor)
        if len(used) and not used.any():
            logger.debug("all of %d readings are left out as outliers", len(used))
        return used


def _bends(state: ChainState, neutral: Array, chosen: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return how far modules are bent from the neutral configuration.

    Args:
        state: the state of the arm.
        neutral: orientations of the control points in that configuration, (m, 3, 3).
        chosen: the control points at the ends of the modules, (k,).

    Returns:
        Rotation vectors, (k, 3) [rad], in the frames at their ends, and their rows, (k, 3, nv) [rad/rad].
    """
    arm = state.arm
    jacobians = state.angular_jacobians
    vectors = np.empty((len(chosen), 3))
    rows = np.empty((len(chosen), 3, arm.nv))
    for i, k in enumerate(chosen):
        end = state.rotations[k]
        turned = neutral[k].T @ end
        relative = jacobians[k]
        if k:
            turned = neutral[k].T @ neutral[k - 1] @ state.rotations[k - 1].T @ end
            relative = relative - jacobians[k - 1]
        vectors[i] = pin.log3(turned)
        rows[i] = pin.Jlog3(turned) @ (end.T @ relative)
    return vectors, rows


def _readings(name: str, given: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Return readings as a fresh array that may contain NaN, but nothing infinite or huge."""
    read = float_array(name, given, shape)
    for where in np.argwhere(np.abs(read) > LARGEST_COORDINATE)[:1]:
        allowed = f"at most {LARGEST_COORDINATE:g} in size, or NaN for a reading that is missing"
        raise InvalidValue(f"{name}{where.tolist()}", float(read[tuple(where)]), allowed)
    return read


def _complete(read: Array) -> NDArray[np.intp]:
    """Return the indices of readings without NaN."""
    return np.flatnonzero(~np.isnan(read).reshape(len(read), -1).any(axis=1))


def _bounded(name: str, value: float, zero: bool = False) -> float:
    """Return a number whose square is neither zero nor huge, or zero where that is allowed."""
    largest = 1e6
    words = f"{'0, or ' if zero else ''}{SMALLEST_NOISE:g} to {largest:g}"
    return as_number(
        name,
        value,
        words,
        lambda number: SMALLEST_NOISE <= number <= largest or (zero and number == 0.0),
    )
