"""What contacts carry: an object that an arm holds, or the arm itself where it leans on something.

At each point of contact the arm can push within the cone of friction, here a pyramid inside of it. Forces and
torques are linear in these pushes, so all questions are linear programs (SciPy's HiGHS).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from scipy.optimize import linprog

from pinposture._validation import length, require_instance, require_known, require_positive
from pinposture.arm import Arm, ArmState
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.bodies import scene_at, solid_inertia
from pinposture.collision.solids import z_along
from pinposture.errors import InvalidValue

Array = NDArray[np.float64]

EDGES = 16
"""Edges of the pyramid in a cone of friction: it is at most 2 % narrower."""


class Hold(NamedTuple):
    """How an arm holds an object.

    Attributes:
        points: points of contact on the object, (c, 3) [m], world frame.
        normals: unit vectors into the object, (c, 3), world axes.
        bodies: names of the bodies of the arm there.
        closed: whether there is force closure: contacts that press can resist any force and torque.
        mass: largest mass of the object that contacts and torque limits hold at rest [kg]; infinite if no
            limit is known that bounds it, 0 if the object is not held.
    """

    points: Array
    normals: Array
    bodies: tuple[str, ...]
    closed: bool
    mass: float


class Support(NamedTuple):
    """How an arm leans on what it may touch.

    Attributes:
        points: points of contact on the obstacles, (c, 3) [m], world frame.
        normals: unit vectors into the obstacles, (c, 3), world axes.
        pairs: names of the body of the arm and of the obstacle there.
        share: smallest possible largest share of a torque limit that holds the arm; at most 1 if the motors
            can hold it.
        alone: that share without contact.
        torques: torques of the motors with that share, (nv,) [N m or N].
    """

    points: Array
    normals: Array
    pairs: tuple[tuple[str, str], ...]
    share: float
    alone: float
    torques: Array


def assess_support(
    arm: Arm, q: ArrayLike, scene: Scene, friction: float = 1.0, within: float = 1e-3
) -> Support:
    """Tell how far the obstacles that an arm touches relieve its motors.

        support = pp.assess_support(arm, q, scene, friction=0.5)
        support.alone, support.share

    Obstacles carry the arm where it touches them, if the scene says that it may (`Scene.touchable`). It takes
    one point of contact for each body of the arm and each obstacle. Of all forces that friction admits, it
    takes those with which the motors need the smallest share of their limits: at rest the arm can be held so.
    Which forces really act is up to the commands and to the stiffness of arm and obstacles.

    Args:
        arm: the arm.
        q: its configuration, (nq,).
        scene: the scene, with touchable obstacles.
        friction: coefficient of friction between arm and obstacles.
        within: largest distance of bodies that count as in contact [m].

    Raises:
        InvalidValue: an argument of the wrong type, or an invalid number.
        WeightUnknown: masses of the arm, or torque limits, that are not known.
    """
    require_instance("arm", arm, Arm, "an Arm")
    require_instance("scene", scene, Scene, "a Scene")
    arm.require_effort()
    friction = require_positive("friction", friction, zero=True)
    within = length("within", within, zero=True)
    state = arm.at(arm.checked(q, "q"))
    touched = _contacts(state, scene_at(arm, state.q, scene), scene.touchable, within)
    holding = np.array(state.gravity_torques)
    torques = _torques(arm, state.q, touched, _pyramids(touched.normals, friction))
    limited = np.isfinite(arm.effort)
    effort = arm.effort[limited]
    alone = float(np.max(np.abs(holding[limited]) / effort, initial=0.0))
    needed = np.vstack([torques[limited], -torques[limited]]) / np.tile(effort, 2)[:, None]
    rows = np.concatenate([holding[limited], -holding[limited]]) / np.tile(effort, 2)
    count = torques.shape[1]
    solution = linprog(
        np.eye(count + 1)[-1],
        A_ub=np.column_stack([needed, -np.ones(len(rows))]),
        b_ub=-rows,
        bounds=(0.0, None),
    )
    if not solution.success:
        return Support(touched.points, touched.normals, touched.pairs, alone, alone, holding)
    relieved = holding + torques @ solution.x[:-1]
    return Support(touched.points, touched.normals, touched.pairs, float(solution.x[-1]), alone, relieved)


def assess_hold(
    arm: Arm, q: ArrayLike, scene: Scene, obstacle: str, friction: float = 1.0, within: float = 1e-3
) -> Hold:
    """Tell how well an arm holds an obstacle that it touches or wraps around.

        hold = pp.assess_hold(arm, q, scene, "can", friction=0.5)
        hold.closed, hold.mass

    It takes one point of contact for each body of the arm, the nearest, which does not resist turning about
    its normal. Torques are those at rest, of the arm and of the object; internal forces, which squeeze, are
    chosen as it is best. Whether the drives apply them is up to the commands.

    Args:
        arm: the arm.
        q: its configuration, (nq,).
        scene: the scene.
        obstacle: name of the object, a convex obstacle of uniform density.
        friction: coefficient of friction between arm and object.
        within: largest distance of bodies that count as in contact [m].

    Raises:
        UnknownName: there is no such obstacle.
        InvalidValue: an obstacle that is not convex or not bounded, or an invalid number.
        WeightUnknown: masses of the arm that are not known.
    """
    require_instance("arm", arm, Arm, "an Arm")
    require_instance("scene", scene, Scene, "a Scene")
    require_known("obstacle", obstacle, scene.obstacles)
    state = arm.at(arm.checked(q, "q"))
    scene = scene_at(arm, state.q, scene)
    shape = scene.obstacles[obstacle].geometry
    if not (shape.convex and shape.bounded):
        raise InvalidValue(
            f"obstacle {obstacle!r}", scene.obstacles[obstacle], "a convex shape of finite size"
        )
    friction = require_positive("friction", friction, zero=True)
    within = length("within", within, zero=True)
    touched = _contacts(state, scene, [obstacle], within)
    pushes = _pyramids(touched.normals, friction)
    wrenches = _wrenches(scene, obstacle, touched, pushes)
    torques = _torques(arm, state.q, touched, pushes)
    held = _largest_mass(arm, state.gravity_torques, wrenches, torques)
    bodies = tuple(body for body, _ in touched.pairs)
    return Hold(touched.points, touched.normals, bodies, _is_closed(wrenches), held)


def squeezing_torques(
    arm: Arm, q: Array, scene: Scene, obstacle: str, *, friction: float, within: float, force: float
) -> tuple[Array, float]:
    """Return the torques with which an arm squeezes an object that it touches, as `assess_hold`.

    The contacts press with at least a normal force everywhere, and their forces balance on the object.
    Friction takes part as little as it has to, as it is not known which forces it bears.

    Args:
        arm: the arm.
        q: its configuration, (nq,).
        scene: the scene.
        obstacle: name of the object.
        friction: coefficient of friction.
        within: largest distance of bodies that count as in contact [m].
        force: the smallest normal force at a contact [N].

    Returns:
        Torques of the contacts, without those that hold the arm, (nv,) [N m or N]; and the largest share of a
        torque limit with both, infinite if no such forces balance.
    """
    state = arm.at(q)
    touched = _contacts(state, scene, [obstacle], within)
    pushes = np.concatenate([touched.normals[:, None], _pyramids(touched.normals, friction)], axis=1)
    rays = pushes.shape[1]
    wrenches = _wrenches(scene_at(arm, state.q, scene), obstacle, touched, pushes)
    torques = _torques(arm, state.q, touched, pushes)
    size = np.abs(wrenches[3:]).max(initial=0.0) or 1.0
    pressing = np.kron(np.eye(len(touched.points)), np.ones(rays))
    # Cost of a push along the normal, relative to one along an edge of the cone of friction. A tenth and ten
    # times of it changed no torque; tests/sim/test_sim_wrap.py measures the forces.
    normal_cost = 0.01
    solution = linprog(
        np.tile(np.append(normal_cost, np.ones(rays - 1)), len(touched.points)),
        A_ub=-pressing,
        b_ub=np.full(len(pressing), -force),
        A_eq=wrenches / np.repeat([1.0, size], 3)[:, None],
        b_eq=np.zeros(6),
        bounds=(0.0, None),
    )
    if not (solution.success and len(touched.points)):
        return np.zeros(arm.nv), np.inf
    needed = torques @ solution.x
    limited = np.isfinite(arm.effort)
    holding = state.gravity_torques if arm.torques_known else np.zeros(arm.nv)
    shares = np.abs(needed + holding)[limited] / arm.effort[limited]
    return needed, float(shares.max(initial=0.0))


class _Touched(NamedTuple):
    """Contacts of an arm: points and normals as of a `Hold`, pairs of names, and the joints."""

    points: Array
    normals: Array
    pairs: tuple[tuple[str, str], ...]
    joints: list[int]


def _contacts(state: ArmState, scene: Scene, obstacles: Sequence[str], within: float) -> _Touched:
    """Return the contacts with some obstacles, up to a distance [m]; each body touches each in one point."""
    model = CollisionModel(state.arm, replace(scene, touchable=()))
    near = model.nearest(state, within)
    chosen = [k for k, pair in enumerate(near.pairs) if pair[1] in obstacles]
    normals = -near.normals[chosen]
    return _Touched(
        points=near.points[chosen] + near.distances[chosen][:, None] * normals,
        normals=normals,
        pairs=tuple(near.pairs[k] for k in chosen),
        joints=[model.solids[model.index_pairs[number][0]][0] for number in near.numbers[chosen]],
    )


def _pyramids(normals: Array, friction: float) -> Array:
    """Return the pyramids of contacts with normals, (c, 3), as (c, EDGES, 3)."""
    return np.array([_pyramid(normal, friction) for normal in normals]).reshape(-1, EDGES, 3)


def _pyramid(normal: Array, friction: float) -> Array:
    """Return the edges of a pyramid in the cone of friction about a normal, (EDGES, 3)."""
    angles = 2.0 * np.pi * np.arange(EDGES) / EDGES
    across = np.column_stack([np.cos(angles), np.sin(angles)]) @ z_along(normal)[:, :2].T
    return np.asarray(normal + friction * across)


def _wrenches(scene: Scene, obstacle: str, touched: _Touched, pushes: Array) -> Array:
    """Return forces on an object and torques about its middle, (6, c EDGES), per push."""
    middle = np.array(solid_inertia(scene.obstacles[obstacle].geometry.solid()).lever)
    wrenches = np.concatenate([pushes, np.cross((touched.points - middle)[:, None], pushes)], axis=2)
    return np.asarray(wrenches.reshape(-1, 6).T)


def _torques(arm: Arm, q: Array, touched: _Touched, pushes: Array) -> Array:
    """Return the torques of the motors per push at points that joints carry, (nv, c EDGES)."""
    data = arm.model.createData()
    pin.computeJointJacobians(arm.model, data, q)
    columns = [np.zeros((arm.nv, 0))]
    for joint, point, edges in zip(touched.joints, touched.points, pushes, strict=True):
        whole = pin.getJointJacobian(arm.model, data, joint, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED)
        whole = whole.reshape(6, arm.nv)  # of one joint it is flat
        lever = point - data.oMi[joint].translation
        moving = whole[:3] + np.cross(whole[3:], lever, axis=0)
        columns.append(moving.T @ edges.T)
    return np.concatenate(columns, axis=1)


def _is_closed(wrenches: Array) -> bool:
    """Return whether pushes that all take part balance, and their wrenches, (6, k), span all directions."""
    count = wrenches.shape[1]
    if count == 0:
        return False
    size = np.abs(wrenches[3:]).max() or 1.0
    scaled = wrenches / np.repeat([1.0, size], 3)[:, None]
    if np.linalg.matrix_rank(scaled) < 6:
        return False
    # The largest t for which pushes of at least t, that are 1 together, balance.
    balance = np.column_stack([scaled, scaled.sum(axis=1)])
    total = np.append(np.ones(count), count)
    solution = linprog(
        -np.eye(count + 1)[-1],
        A_eq=np.vstack([balance, total]),
        b_eq=np.eye(7)[-1],
        bounds=(0.0, None),
    )
    # of an equal distribution; HiGHS keeps equalities to 1e-7
    return bool(solution.success and solution.x[-1] * count > 1e-6)


def _largest_mass(arm: Arm, holding: Array, wrenches: Array, torques: Array) -> float:
    """Return the largest mass that pushes hold within the torques of the motors [kg].

    Args:
        arm: the arm.
        holding: torques that hold the arm alone, (nv,) [N m or N].
        wrenches: forces and torques on the object per push, (6, k).
        torques: torques of the motors per push, (nv, k).
    """
    limited = np.isfinite(arm.effort)
    effort = arm.effort[limited]
    gravity = np.append(np.array(arm.model.gravity.linear), np.zeros(3))
    count = wrenches.shape[1]
    size = np.abs(wrenches[3:]).max(initial=0.0) or 1.0
    scale = np.repeat([1.0, size], 3)
    needed = np.column_stack([torques[limited], np.zeros(len(effort))])
    solution = linprog(
        -np.eye(count + 1)[-1],
        A_ub=np.vstack([needed, -needed]),
        b_ub=np.concatenate([effort - holding[limited], effort + holding[limited]]),
        A_eq=np.column_stack([wrenches, gravity]) / scale[:, None],
        b_eq=np.zeros(6),
        bounds=(0.0, None),
    )
    if solution.status == 3:  # there is no largest value
        return float("inf")
    return max(0.0, float(solution.x[-1])) if solution.success else 0.0
