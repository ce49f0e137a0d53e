"""Orientation errors and rows of control points, and the directions of their links."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm, ArmState
from pinposture.arm.chain import ON_AXIS, PARALLEL

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class LinkAxes(NamedTuple):
    """Properties of the orientations of control points that hold at every configuration.

    Attributes:
        links: direction of the link that ends at each control point, unit vectors, (m, 3), in its own frame.
        turns: along how many axes each can turn, (m,): 0 if all joints before it slide, 1 if those that turn
            are parallel, else 3.
        axes: the axis about which it turns where there is one, unit vectors, (m, 3), world frame; else zero.
    """

    links: Array
    turns: Indices
    axes: Array


def link_axes(arm: Arm) -> LinkAxes:
    """Return the link axes of an arm, cached with it.

    The link that ends at a control point comes from the last joint origin or control point before it along
    the chain that lies elsewhere. Its direction at the neutral configuration is kept fixed in the frame of
    the control point. For template arms this is the x axis of that frame. Where the link belongs to the same
    body as the point, as it does unless the last joint sits at the point itself, it is the link at every
    configuration. Where there is no such place before the point, it is the x axis, too.
    """
    found: LinkAxes | None = arm.cache.get(LinkAxes)
    if found is None:
        turns, axes = _turning(arm)
        found = arm.cache[LinkAxes] = LinkAxes(_links(arm), turns, axes)
    return found


def _links(arm: Arm) -> Array:
    chain = arm.chain
    links, stations = np.zeros((arm.n_modules, 3)), [chain.base]
    for k, (joints, turn) in enumerate(
        zip(chain.module_slices, arm.at(arm.neutral()).compiled.rotations, strict=True)
    ):
        stations.extend(chain.origins[joints])
        spans = chain.points[k] - np.array(stations)
        elsewhere = np.flatnonzero(np.linalg.norm(spans, axis=1) > ON_AXIS * arm.length)
        link = turn.T @ spans[elsewhere[-1]] if len(elsewhere) else np.array([1.0, 0.0, 0.0])
        links[k] = link / np.linalg.norm(link)
        stations.append(chain.points[k])
    return links


def _turning(arm: Arm) -> tuple[Indices, Array]:
    chain = arm.chain
    turns, axes = np.zeros(arm.n_modules, dtype=np.intp), np.zeros((arm.n_modules, 3))
    for k, joints in enumerate(chain.module_slices):
        before = chain.axes[: joints.stop][chain.revolute[: joints.stop]]
        if len(before):
            mean = np.where(before @ before[0] < 0.0, -1.0, 1.0) @ before
            mean /= np.linalg.norm(mean)
            parallel = np.all(np.linalg.norm(np.cross(before, mean), axis=1) < PARALLEL)
            turns[k], axes[k] = (1, mean) if parallel else (3, axes[k])
    return turns, axes


# Errors are rotation vectors about axes through the control point, world frame, so that rows are angular
# Jacobians. Where all joints that move a point turn about one axis, as in a planar arm, it can turn about
# that axis alone: the error is then the turn about it that comes closest.

HALF_TURN_TOLERANCE = 1e-9
"""Distance from half a turn within which its direction is chosen, not left to rounding [rad]."""


def link_directions(state: ArmState, points: Indices) -> Array:
    """Return the directions of the links that end at some control points, (k, 3), world frame."""
    return np.asarray(np.einsum("kij,kj->ki", state.rotations[points], link_axes(state.arm).links[points]))


def orientation_rows(state: ArmState, point: int, wanted: Array) -> tuple[Array, Array]:
    """Return the rows that turn a control point to an orientation.

    With M = R_wanted R^T and e = log M, a rotation w of the control point changes M to M exp(-w), and so e by
    -E w, where E is the derivative of the logarithm, to first order. Hence the rows E J_w for the error e. As
    E e = e, the step that covers the error turns the point straight to that orientation.

    Args:
        state: where the arm is.
        point: index of the control point, 0-based.
        wanted: the orientation, from the frame of the control point to the world, (3, 3).

    Returns:
        Rows (r, nv) [rad/rad] and error (r,) [rad]. r = 3; or 1 where the point turns about one axis; or 0
        where it does not turn. About one axis, both are scaled by the cosine of half the turn that is left,
        which no joint can change: 1 if the orientation can be had.
    """
    known = link_axes(state.arm)
    jacobian = state.angular_jacobians[point]
    if known.turns[point] == 0:
        return jacobian[:0], np.zeros(0)
    x, y, z, w = pin.Quaternion(wanted @ state.rotations[point].T).coeffs()
    if known.turns[point] == 1:
        axis = known.axes[point]
        half = np.array([axis @ (x, y, z), w]) * np.copysign(1.0, w)  # both signs are the same rotation
        share = np.linalg.norm(half)
        return share * (axis @ jacobian)[None], share * _wrap(2.0 * np.arctan2(half[:1], half[1:]))
    error = _rotation_vector(np.array([x, y, z]), float(w))
    return _logarithm_derivative(error) @ jacobian, error


def direction_rows(state: ArmState, points: Indices, wanted: Array) -> tuple[Array, Array]:
    """Return the rows that turn the links that end at some control points to given directions.

    A rotation w moves the direction t of a link by w x t. The error is the way from t to the direction asked
    for along the great circle, in a basis (b, t x b) across t: a vector of the length of the angle between
    them, [0, pi]. Opposite directions are half a turn apart in a direction that depends on t alone.

    Args:
        state: where the arm is.
        points: indices of the control points, 0-based, (k,).
        wanted: unit vectors, (k, 3), world frame.

    Returns:
        Rows (r, nv) [rad/rad] and errors (r,) [rad]: two of each for a point; or one where it turns about one
        axis; or none where it does not turn. About one axis, the error is the angle between the projections
        across it, and both are scaled by the geometric mean of their lengths: if the direction can be had,
        by as much as a turn moves the link.
    """
    known = link_axes(state.arm)
    turns, axes = known.turns[points], known.axes[points]
    link = link_directions(state, points)
    basis = _across(link)
    ahead, beside = _dot(basis, wanted)
    sine, cosine = np.hypot(ahead, beside), _dot(link, wanted)
    opposite = (sine < HALF_TURN_TOLERANCE) & (cosine < 0.0)
    way = np.stack([np.where(opposite, 1.0, ahead), beside])
    way *= np.arctan2(sine, cosine) / np.maximum(np.hypot(way[0], way[1]), 1e-300)
    # b . (w x t) = w . (t x b): turning about t x b moves t along b.
    about = np.stack([basis[1], -basis[0]], axis=1)
    errors = way.T
    single = turns == 1
    if np.any(single):
        along, aside = _dot(basis, axes)
        sines = aside * ahead - along * beside  # of the projections: axis . (t x d)
        cosines = cosine - _dot(link, axes) * _dot(wanted, axes)
        share = np.sqrt(np.hypot(sines, cosines))
        apart = share * _wrap(np.arctan2(sines, cosines))
        about[single, 0], errors[single, 0] = (share[:, None] * axes)[single], apart[single]
    used = np.stack([turns > 0, turns > 1], axis=1)
    rows = about @ state.angular_jacobians[points]
    return rows[used], errors[used]


def _wrap(angle: Array) -> Array:
    """Return angles in (-pi, pi], half a turn always positive."""
    return np.where(angle < HALF_TURN_TOLERANCE - np.pi, angle + 2.0 * np.pi, angle)


def _rotation_vector(vector: Array, scalar: float) -> Array:
    """Return the rotation vector (3,) [rad] of a unit quaternion; half a turn is about one of two axes."""
    size = float(np.linalg.norm(vector))
    if size < 1e-150:
        return np.zeros(3)
    forward = scalar > 0.0
    if (
        abs(scalar) < HALF_TURN_TOLERANCE / 2.0
    ):  # the first component that is not small decides, and one always is not
        forward = vector[np.argmax(np.abs(vector) > 0.4 * size)] > 0.0
    sign = 1.0 if forward else -1.0
    return np.asarray(2.0 * np.arctan2(size, sign * scalar) / size * sign * vector)


def _logarithm_derivative(error: Array) -> Array:
    """E (3, 3) with log(exp(e) exp(d)) = e + E d to first order, for |e| up to half a turn."""
    angle = float(np.linalg.norm(error))
    x, y, z = error
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    half = angle / 2.0
    second = 1.0 / 12.0 if angle < 1e-3 else (1.0 - half / np.tan(half)) / angle**2
    return np.asarray(np.eye(3) + cross / 2.0 + second * (cross @ cross))


def _dot(a: Array, b: Array) -> Array:
    return np.asarray((a * b).sum(axis=-1))


def _across(directions: Array) -> Array:
    """Unit vectors b and t x b, (2, k, 3), across unit vectors t, (k, 3), without a place that is inexact.

    Source: Duff et al., Building an Orthonormal Basis, Revisited, JCGT 6 (2017).
    """
    x, y, z = directions.T
    sign = np.copysign(1.0, z)
    a = -1.0 / (sign + z)
    b = x * y * a
    first = np.stack([1.0 + sign * x * x * a, sign * b, -sign * x], axis=1)
    return np.stack([first, np.stack([b, sign + y * y * a, -y], axis=1)])
