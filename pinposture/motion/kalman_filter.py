"""An iterated extended Kalman filter on the manifold of configurations, with readings that may be outliers.

The state x is a configuration and how far each joint is from its encoder. Readings with the errors e(x),
measured minus expected, and the rows H by which the expected ones change, move it to the most probable state,
by damped Gauss-Newton steps (Bell and Cathey, 1993). States are written as x + P p, with the covariance P
before and a pull p, so that P need not have an inverse: joints that do not move have no variance.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve

from pinposture.arm import ChainState

Array = NDArray[np.float64]
Chosen = NDArray[np.bool_]


class UpdateSettings(NamedTuple):
    """How an update with measurements is found by Gauss-Newton steps."""

    max_steps: int = 20
    """Largest number of steps."""

    max_halvings: int = 8
    """How often a step that makes the fit worse is halved."""

    small_motion: float = 1e-6
    """Motion of a joint at which the fit ends, in `Arm.joint_units`."""


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
        if self._distances(sensor, fit, used).max() > sensor.likely:
            start, used = self._one_by_one(sensor, start)
            fit, used = self._without_outliers(sensor, start, used)
        return (self._after(sensor, fit, used) if used.any() else self), used

    def _one_by_one(self, sensor: Sensor, start: FittedState) -> tuple[FittedState, Chosen]:
        """Return the state after one reading after the other, and those that were no outliers."""
        belief = self
        used = np.zeros(len(start.near.errors), dtype=np.bool_)
        joints = np.count_nonzero(start.near.rows, axis=(1, 2))  # the more, the farther from the base
        for k in np.argsort(joints, kind="stable"):
            one = np.arange(len(used)) == k
            begun = belief._moved(sensor, np.zeros(len(self.covariance)))
            fit = belief._fit(sensor, begun, one)
            if belief._distances(sensor, fit, one)[k] <= sensor.likely:
                used[k] = True
                belief = belief._after(sensor, fit, one)
        arm = self.state.arm
        moved = np.concatenate([arm.difference(self.state.q, belief.state.q), belief.give - self.give])
        pull = np.linalg.lstsq(self.covariance, moved, rcond=None)[0]
        return self._moved(sensor, pull), used

    def _without_outliers(self, sensor: Sensor, fit: FittedState, used: Chosen) -> tuple[FittedState, Chosen]:
        """Fit readings; while one is farther off than is likely, leave out the farthest (Baarda, 1968)."""
        used = used.copy()
        while used.any():
            fit = self._fit(sensor, fit, used)
            apart = self._distances(sensor, fit, used)
            farthest = int(apart.argmax())
            if apart[farthest] <= sensor.likely:
                break
            used[farthest] = False
        return fit, used

    def _moved(self, sensor: Sensor, pull: Array) -> FittedState:
        """Return the state to which a pull moves this one."""
        change, given = np.split(self.covariance @ pull, 2)
        state = self.state.moved(change)
        give = self.give + given
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
            rows = _rows(fit.near, used, len(covariance))
            innovation = fit.near.errors[used].ravel() + rows @ (covariance @ fit.pull)
            change = rows.T @ cho_solve(self._spread(sensor, rows), innovation) - fit.pull
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
            if np.abs(covariance @ step / units).max() < UPDATE.small_motion:
                break
        return fit

    def _spread(self, sensor: Sensor, rows: Array) -> tuple[Array, bool]:
        """Return the factor of the covariance of readings, H P H^T and their noise."""
        spread = rows @ self.covariance @ rows.T
        np.einsum("ii->i", spread)[:] += sensor.noise**2
        factor: tuple[Array, bool] = cho_factor(spread)
        return factor

    def _distances(self, sensor: Sensor, fit: FittedState, used: Chosen) -> Array:
        """Return how far each reading is from what the others tell, squared, in standard deviations, (k,).

        From its residual at the fit, with the covariance N (H P H^T + N)^-1 N, where N is the noise; for a
        single one this is its distance from the state before.
        """
        rows = _rows(fit.near, used, len(self.covariance))
        residuals = fit.near.errors[used]
        count, size = residuals.shape
        inverse = cho_solve(self._spread(sensor, rows), np.eye(count * size))
        own = np.einsum("kbkc->kbc", inverse.reshape(count, size, count, size)) * sensor.noise**4
        distances = np.zeros(len(used))
        distances[used] = np.einsum("kb,kb->k", residuals, np.linalg.solve(own, residuals[..., None])[..., 0])
        return distances

    def _after(self, sensor: Sensor, fit: FittedState, used: Chosen) -> Belief:
        """Return what is believed after the readings to which a state is fitted."""
        covariance = self.covariance
        rows = _rows(fit.near, used, len(covariance))
        across = rows @ covariance
        gain = cho_solve(self._spread(sensor, rows), across).T
        left = covariance - gain @ across
        left = left - (left @ rows.T) @ gain.T + sensor.noise**2 * gain @ gain.T  # positive despite rounding
        return Belief(fit.state, fit.give, 0.5 * (left + left.T))


def _rows(near: Readings, used: Chosen, size: int) -> Array:
    """Return the rows of the readings that are used, for the whole state, (r, size)."""
    rows = near.rows[used]
    filled = np.zeros((rows.shape[0] * rows.shape[1], size))
    filled[:, : rows.shape[2]] = rows.reshape(len(filled), -1)
    return filled
