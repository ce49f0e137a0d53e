"""Named tuples of arrays that kernels take as arguments.

Unpacking a tuple costs a call from Python half a microsecond: arrays that few kernels share stay plain
arguments.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array1 = Annotated[NDArray[np.float64], 1]
Array2 = Annotated[NDArray[np.float64], 2]
Array3 = Annotated[NDArray[np.float64], 3]
Array4 = Annotated[NDArray[np.float64], 4]
Ints1 = Annotated[NDArray[np.int64], 1]
Ints2 = Annotated[NDArray[np.int64], 2]
Flags1 = Annotated[NDArray[np.bool_], 1]
Flags2 = Annotated[NDArray[np.bool_], 2]
Bytes1 = Annotated[NDArray[np.int8], 1]
"""C-contiguous arrays with their number of dimensions: `kernels.compiled` compiles for these types."""

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]


class ChainArrays(NamedTuple):
    """The constants of a serial chain of k joints with n degrees of freedom and m control points.

    There are more joints than degrees of freedom where joints are coupled. Other kernels call the degrees of
    freedom joints: they see the sum of what coupled joints do.

    Attributes:
        slides: True for a prismatic joint, (k,); others are revolute.
        columns: index of the degree of freedom of each joint among all joint positions, (k,).
        ratios: position of each joint relative to that of its degree of freedom, (k,).
        fixed: placement of each joint in the frame of the one before, rotation and translation, (k, 12).
        axes: unit axis in the frame of the joint, (k, 3).
        ends: number of joints that carry each control point, (m,); increasing.
        offsets: position of each control point in the frame of the last of them, (m, 3).
        turns: orientation of each control point there, (m, 3, 3).
        inputs: index of each degree of freedom among all joint positions, (n,).
        driven: the joints of the first degree of freedom, of the second and so on, (k,).
        starts: where those of each begin, and how many there are, (n + 1,).
    """

    slides: Flags1
    columns: Ints1
    ratios: Array1
    fixed: Array2
    axes: Array2
    ends: Ints1
    offsets: Array2
    turns: Array3
    inputs: Ints1
    driven: Ints1
    starts: Ints1


class PointObjective(NamedTuple):
    """A weighted least-squares objective of points along a chain, and of chords from each point to the next.

    Attributes:
        screws: linear and angular velocity of the first point that each joint carries, (n, 6), from
            `find_screws`.
        ends: number of joints that carry each point, (p,); not decreasing.
        points: the points, (p, 3).
        weights: weights W of the points, (p,).
        chords: weights C of the chords to the point before, (p,).
    """

    screws: Array2
    ends: Ints1
    points: Array2
    weights: Array1
    chords: Array1


class Screws(NamedTuple):
    """The joint screws of a chain at one configuration.

    Attributes:
        screws: linear velocity of the first control point that each joint carries, and angular velocity,
            (n, 6) [m, rad], per unit of joint motion (`Arm.joint_units`), world axes.
        ends: number of joints that carry each control point, (m,); increasing.
        points: the control points, (m, 3) [m].
    """

    screws: Array2
    ends: Ints1
    points: Array2


class PathProblem(NamedTuple):
    """The joints that a path is sought for. Displacements are from its start, in units of each joint.

    Attributes:
        chain: the chain.
        which: joints that may move, by their index along the chain, (n,).
        ends: number of those that carry each control point, (m,).
        units: unit of motion of each of them, (n,).
        start: joint positions at the start, (nv,).
        lower: smallest displacement, (n,).
        upper: largest displacement, (n,).
        weight: mu^2, of the motion of joints against that of control points [m^2].
    """

    chain: ChainArrays
    which: Ints1
    ends: Ints1
    units: Array1
    start: Array1
    lower: Array1
    upper: Array1
    weight: float


class PathRows(NamedTuple):
    """Rows on a path, each of one waypoint: row x_i = error.

    Attributes:
        matrix: (k, n).
        errors: (k,) [m].
        waypoints: the waypoint i, not one of the ends, (k,).
    """

    matrix: Array2
    errors: Array1
    waypoints: Ints1


class PathContacts(NamedTuple):
    """Contacts on a path: solids that should part by an error where it is positive.

    Attributes:
        errors: times the root of the weight, (k,) [m].
        begins: first contact of each waypoint, and how many there are, (N + 2,); the ends have none.
        carried: number of moving joints of the chain that carry both solids, (k, 2); 0: none.
        points: where they are closest, (k, 3) [m].
        normals: from the second to the first, times the root of the weight, (k, 3).
    """

    errors: Array1
    begins: Ints1
    carried: Ints2
    points: Array2
    normals: Array2


class ScrewChain(NamedTuple):
    """A chain as screws in its neutral posture, each joint assigned to the first point that it can move.

    It has k joints with n degrees of freedom, fewer if joints are coupled.

    Attributes:
        slides: True for a prismatic joint, (k,); others are revolute.
        axes: unit joint axes, (k, 3).
        origins: a point on each axis, (k, 3).
        inputs: the degree of freedom of each joint, (k,).
        ratios: motion of each joint relative to that of its degree of freedom, (k,).
        points: the points that are carried, (m, 3).
        joints: index of the first joint of each point, and the number of joints, (m + 1,).
        begins: index of the first degree of freedom of each point, and their number, (m + 1,).
        sliding: True for a degree of freedom that slides, (n,).
        lower: lower limits, (n,).
        upper: upper limits, (n,).
        near: preferred joint positions, within the limits, (n,).
    """

    slides: Flags1
    axes: Array2
    origins: Array2
    inputs: Ints1
    ratios: Array1
    points: Array2
    joints: Ints1
    begins: Ints1
    sliding: Flags1
    lower: Array1
    upper: Array1
    near: Array1


class ModuleArrays(NamedTuple):
    """The joints of a module in its base frame, with n joints and k degrees of freedom.

    Attributes:
        slides: True for a joint that slides, (n,).
        axes: unit joint axes, (n, 3).
        origins: a point on each axis, (n, 3).
        end: the end of the module, (3,).
        inputs: degree of freedom of each joint, (n,).
        ratios: motion of each joint relative to that, (n,).
        units: motion of each degree of freedom that counts as one, (k,).
        turning: True for a degree of freedom that turns a joint, (k,).
        reach: largest distance of the end from the base, (1,).
    """

    slides: Flags1
    axes: Array2
    origins: Array2
    end: Array1
    inputs: Ints1
    ratios: Array1
    units: Array1
    turning: Flags1
    reach: Array1


class JointTree(NamedTuple):
    """The joints of a model, numbered as there: the first is the world, and parents come before children.

    Attributes:
        parents: the joint that carries each, (njoints,).
        columns: where its position is among all joint positions, (njoints,).
        ratios: its position relative to that of its degree of freedom, (njoints,); 1 unless coupled.
        kinds: 0 where it turns about an axis, 1 where it slides along one, 2 if it does anything else.
        fixed: placement in the frame of the joint before, rotation and translation, (njoints, 12).
        axes: unit axis in its own frame, (njoints, 3).
    """

    parents: Ints1
    columns: Ints1
    ratios: Array1
    kinds: Ints1
    fixed: Array2
    axes: Array2


class Trees(NamedTuple):
    """Points and triangles of obstacles in trees of boxes; see `kernels.bounding_volumes`.

    Attributes:
        boxes: lowest and highest corner of each node, tree after tree, (nodes, 2, 3).
        points: points in the order of their trees, (p, 3).
        triangles: corners of triangles, likewise, (t, 3, 3).
        pieces: where each obstacle is: where its boxes begin, its node, how many levels its tree has, where
            its points or triangles begin, how many its tree has, and 1 if these are points, (o, 6).
    """

    boxes: Array3
    points: Array2
    triangles: Array3
    pieces: Ints2


class Pairs(NamedTuple):
    """Pairs of a body and another, or of a body and an obstacle, in groups; b bodies and o obstacles.

    Attributes:
        first: the body of each pair, (n,).
        second: the other body, or b plus the number of the obstacle, (n,).
        kinds: what the second solid is, `SEGMENT` for spheres, capsules and bodies, (n,).
        exact: False where solids only lie in the shapes that are given here, (n,).
        radii: radius of the capsule of each body, then of each obstacle that is one, or of its points,
            (b + o,).
        lines: axis of the capsule of each obstacle, (o, 2, 3).
        centers: centre of each obstacle that is no capsule, or of the box around it, (o, 3).
        frames: its axes, as columns; z is the normal of a half-space and the axis of a cylinder, (o, 3, 3).
        halves: half its extent along them, (o, 3).
        trees: the obstacles that are pieces of scans or meshes.
        shapes: the kind of each obstacle, (o,).
        groups: block of bodies, and another block or the number of blocks plus that of an obstacle, (g, 2).
        starts: first pair of each group, and at the end how many pairs there are, (g + 1,).
    """

    first: Ints1
    second: Ints1
    kinds: Ints1
    exact: Flags1
    radii: Array1
    lines: Array3
    centers: Array2
    frames: Array3
    halves: Array2
    trees: Trees
    shapes: Ints1
    groups: Ints2
    starts: Ints1


BLOCK = 8
"""Number of bodies in a block of `Pairs`."""

SEGMENT, BOX, PLANE, CYLINDER, PIECE, INSIDE = 0, 1, 2, 3, 4, 5
"""Kinds of `Pairs`, by the second solid; the last are a piece of a tree and the inside of a surface."""

FULL, RELATIVE, LOCAL = 0, 1, 2
"""Couplings: how rows depend on the joints before their section; see `kernels.kinematics`."""


class Rows(NamedTuple):
    """The rows of a posture control matrix.

    Attributes:
        stations: control points that have rows, (p,); increasing, at least one.
        ranks: number of directions of each of them that have rows, (p,).
        directions: orthonormal directions, those with a row first, (p, 3, 3), world axes.
        coupling: FULL, RELATIVE or LOCAL.
    """

    stations: Ints1
    ranks: Ints1
    directions: Array3
    coupling: int


class Factors(NamedTuple):
    """The factor L of a posture control matrix L Q; see `kernels.posture_matrix`.

    Attributes:
        triangles: lower triangular blocks R, (p, 3, 3); a tiny number on a diagonal stands for zero, where a
            row depends linearly on others.
        gains: K, (p, 6, 3).
    """

    triangles: Array3
    gains: Array3


class PostureProblem(NamedTuple):
    """Where the control points of an arm should be.

    Attributes:
        chain: the arm.
        joints: joints that may move, by their numbers along the chain, (n,); increasing.
        units: the motion of each that counts as one, (n,) [rad or m].
        edges: their position limits, (2, n).
        indices: the control points that have a target, (p,); increasing.
        ends: how many of the joints carry each of these, (p,).
        targets: where they should be, (p, 3).
        weights: weights of their squared errors, (p,).
        chords: weights of the squared errors of the chords to the point before, (p,).
        normal: direction in which errors do not count, (3,); zero for none.
    """

    chain: ChainArrays
    joints: Ints1
    units: Array1
    edges: Array2
    indices: Ints1
    ends: Ints1
    targets: Array2
    weights: Array1
    chords: Array1
    normal: Array1


class SearchSettings(NamedTuple):
    """Settings of the search; see `damped_least_squares`.

    Attributes:
        good: mean error at which it ends.
        largest_error: errors are scaled down until none is larger.
        largest_step: of a joint, in units.
        damping_share: damping, relative to the sum of squares.
        least_damping: the same, relative to the stiffness of the chain.
        least_stiffness: which counts where the stiffness is smaller.
        decrease: factor of the damping after a step that reduced the errors.
        increase: factor after one that did not.
        least_factor: smallest factor of the damping.
        most_factor: largest one; beyond it a failed step counts as idle.
        converged: relative fall of the sum of squares below which a step counts as idle.
        idle: number of idle steps in a row at which it ends.
        steps: largest number of steps.
    """

    good: float
    largest_error: float
    largest_step: float
    damping_share: float
    least_damping: float
    least_stiffness: float
    decrease: float
    increase: float
    least_factor: float
    most_factor: float
    converged: float
    idle: int
    steps: int
