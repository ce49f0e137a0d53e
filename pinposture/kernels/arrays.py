"""Named tuples of arrays that kernels take as arguments.

Unpacking a tuple adds half a microsecond to a call from Python, so arrays that few kernels share are passed
as plain arguments.
"""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array1 = Annotated[NDArray[np.float64], 1]
Array2 = Annotated[NDArray[np.float64], 2]
Array3 = Annotated[NDArray[np.float64], 3]
Array4 = Annotated[NDArray[np.float64], 4]
Singles1 = Annotated[NDArray[np.float32], 1]
Singles2 = Annotated[NDArray[np.float32], 2]
Singles3 = Annotated[NDArray[np.float32], 3]
Ints1 = Annotated[NDArray[np.int64], 1]
Ints2 = Annotated[NDArray[np.int64], 2]
Flags1 = Annotated[NDArray[np.bool_], 1]
Flags2 = Annotated[NDArray[np.bool_], 2]
Bytes1 = Annotated[NDArray[np.int8], 1]
Halves1 = Annotated[NDArray[np.int32], 1]
Words1 = Annotated[NDArray[np.uint64], 1]
"""C-contiguous arrays by number of dimensions: the types for which `kernels.compiled` compiles."""

FULL_TURN = 2.0 * np.pi
"""A full turn [rad]."""

TORQUE_LANES = 8
"""Number of postures or joints whose torques are computed together. The torques along a path of 40 joints
took 30 % longer with 4, and as long with 16."""

Three = tuple[float, float, float]
Four = tuple[float, float, float, float]
Nine = tuple[float, float, float, float, float, float, float, float, float]


class SplineArrays(NamedTuple):
    """A B-spline in space with n coefficients, on k knot spans.

    Attributes:
        knots: the knots, not decreasing, (n + degree + 1,).
        table: coefficients of the spline, of its first derivative, and so on, (degree + 1, n, 3), from
            `spline_coefficients`.
        degree: 1 to 5.
        breaks: ends of the knot spans of the curve, increasing, (k + 1,).
    """

    knots: Array1
    table: Array3
    degree: int
    breaks: Array1


class JointHistory(NamedTuple):
    """How n joints have responded to their commands; see `kernels.joint_response`.

    Attributes:
        anchors: measured positions from which the joints have not moved since, (n,) [rad or m].
        starts: commanded positions at that time, (n,) [rad or m].
        standing: time since then, (n,) [s].
        waiting: time since the command has moved on noticeably, (n,) [s].
        leads: distance of the command ahead of a joint at which it begins to move, (n,) [rad or m].
        readings: the last two different measured positions, (2, n) [rad or m].
        variances: of the noise of a measured position, (n,) [rad^2 or m^2].
        errors: measured minus expected positions where a joint last came to rest, (n,) [rad or m].
        commands: commanded positions at that time, (n,) [rad or m].
        overshoots: how often that error has changed its sign, though the command moved little, (n,).
        steps: distance between the last two rests on either side, (n,) [rad or m].
    """

    anchors: Array1
    starts: Array1
    standing: Array1
    waiting: Array1
    leads: Array1
    readings: Array2
    variances: Array1
    errors: Array1
    commands: Array1
    overshoots: Array1
    steps: Array1


class LengthArrays(NamedTuple):
    """Arc length as a function of the parameter: a polynomial on each of n short pieces.

    Attributes:
        edges: parameters where the pieces meet, (n + 1,).
        lengths: arc lengths there, (n + 1,) [m].
        series: power coefficients of the length of each piece in x from -1 to 1, highest first, (n, N + 1).
    """

    edges: Array1
    lengths: Array1
    series: Array2


class JointKinds(NamedTuple):
    """How a joint moves what it carries; see `Joints`."""

    revolute: int = 0
    """About its axis."""

    prismatic: int = 1
    """Along it."""

    other: int = 2


JOINT = JointKinds()


class Joints(NamedTuple):
    """Joints of an arm, of a module or of a whole model, described with all of them at zero.

    Frame 0 is the base, and joint u carries frame u + 1. The origin of that frame is at the joint; with all
    joints at zero, its axes are parallel to those of the base. So a joint is an axis and an offset, without a
    constant rotation, and a base far from the origin costs no digits. In a chain, frame u carries joint u.

    Attributes:
        parents: the frame that carries each joint, (k,); at most u.
        kinds: kind of each joint, of `JOINT`, (k,).
        axes: unit axis of each joint, (k, 3).
        offsets: origin of each joint in the frame that carries it, (k, 3).
        columns: index of its degree of freedom among all joint positions, (k,).
        ratios: its position relative to its degree of freedom, (k,); 1 unless coupled.
    """

    parents: Ints1
    kinds: Ints1
    axes: Array2
    offsets: Array2
    columns: Ints1
    ratios: Array1


class Bodies(NamedTuple):
    """What k joints carry, each in the frame of its joint, and what else their torques depend on.

    Attributes:
        masses: mass of each body, (k,).
        first_moments: mass times centre of mass, (k, 3).
        second_moments: sum of m r r^T over its masses m at r, xx, yy, zz, xy, xz, yz, (k, 6).
        carried: mass of all bodies that each joint carries, (k,).
        armature: inertia of each drive, along its degree of freedom, (nv,).
        gravity: gravitational acceleration, (3,).
    """

    masses: Array1
    first_moments: Array2
    second_moments: Array2
    carried: Array1
    armature: Array1
    gravity: Array1


class ArmArrays(NamedTuple):
    """A chain of k joints with n degrees of freedom and m control points.

    There are more joints than degrees of freedom if joints are coupled. Other kernels use "joint" for a
    degree of freedom, whose effect is the sum over its coupled joints.

    Attributes:
        joints: the joints.
        ends: number of joints that carry each control point, (m,); increasing.
        levers: position of each control point in the frame of the last joint that carries it, (m, 3).
        turns: orientation of each control point in that frame, (m, 3, 3).
        inputs: index of each degree of freedom among all joint positions, (n,).
        driven: joints sorted by degree of freedom, (k,).
        starts: index into `driven` of the first joint of each degree of freedom, and k, (n + 1,).
    """

    joints: Joints
    ends: Ints1
    levers: Array2
    turns: Array3
    inputs: Ints1
    driven: Ints1
    starts: Ints1


class LimitArrays(NamedTuple):
    """The limits of a step, of a chain of n joints among nv joint positions.

    Attributes:
        units: unit of motion of each joint of the chain, (n,) [rad or m].
        slack: excess over a position limit beyond which a joint is brought back, (n,) [rad or m].
        position_limits: smallest and largest positions, (2, nv) [rad or m].
        bound: largest step of each joint, (nv,) [rad or m].
    """

    units: Array1
    slack: Array1
    position_limits: Array2
    bound: Array1


class PointGoals(NamedTuple):
    """Where m points are to be.

    Attributes:
        targets: their positions, (m, 3) [m].
        flags: which of them have one, (m,).
    """

    targets: Array2
    flags: Flags1


class Contacts(NamedTuple):
    """Pairs nearer than a given distance at s configurations.

    Attributes:
        samples: index of the configuration of each contact, (k,); increasing.
        pairs: the pair of each, (k,).
        distances: between the surfaces, negative for overlap, (k,) [m].
        carrying: the joints that carry the two solids, 0 for an obstacle, (k, 2).
        points: the contacts, (k, 3) [m], world frame.
        normals: unit vectors from the second solid to the first, (k, 3), world frame.
        minima: smallest distance at each configuration, at most the given one, (s,) [m].
        within: the given distance [m].
    """

    samples: Ints1
    pairs: Ints1
    distances: Array1
    carrying: Ints2
    points: Array2
    normals: Array2
    minima: Array1
    within: float


class MotionSearch(NamedTuple):
    """Settings of the search for the smallest distance on motions.

    Attributes:
        below: only distances below this matter [m]; if there are none, the search may find none.
        enough: the search ends at the first distance below this [m].
        tolerance: error allowed in the smallest distance between the ends of a motion [m].
        open_motion: motion of an inexact pair below which its distance is left open [m].
    """

    below: float
    enough: float
    tolerance: float
    open_motion: float


class PathTolerances(NamedTuple):
    """Tolerances of the steps along a path, in units of motion of the joints.

    Attributes:
        disturbed: largest difference from the expected joint positions.
        arrived: remaining joint motion at which the path ends.
        rounding: excess over the limits that counts as rounding.
        max_motion: largest motion of a joint in a step.
    """

    disturbed: float
    arrived: float
    rounding: float
    max_motion: float


class StepArrays(NamedTuple):
    """A step of nv joints, filled by a kernel.

    Attributes:
        dq: the step, (nv,) [rad or m].
        reached: joint positions after it, (nv,) [rad or m].
        at_limit: joints that are at a position limit then, (nv,).
    """

    dq: Array1
    reached: Array1
    at_limit: Flags1


class NextSteps(NamedTuple):
    """Consecutive steps, k, of nv joints along a path, filled by a kernel.

    Attributes:
        s: the position on the path at the end of each, in waypoints, (k,).
        errors: sum of distances from the targets, before the first step and after each, (k + 1,) [m].
        dq: the steps, (k, nv) [rad or m]; initially zeros.
        reached: joint positions after each, (k, nv) [rad or m].
        at_limit: joints that are at a position limit then, (k, nv).
    """

    s: Array1
    errors: Array1
    dq: Array2
    reached: Array2
    at_limit: Flags2


class ProfileRows(NamedTuple):
    """Limits |a u + b x + c| <= limit along a path, in K parts of constant path acceleration u.

    x is the square of the path speed where a part begins. There are R quantities: the accelerations of all
    joints, then those of torques that may come near their limits.

    Attributes:
        a: three rows of each part, (K, 3, R or more); see `find_speed_profile`.
        b: likewise.
        c: likewise.
        limit: the limits, (R,); may be infinite.
    """

    a: Array3
    b: Array3
    c: Array3
    limit: Array1


class PathParts(NamedTuple):
    """The K parts of a path, of which each piece between waypoints has one or more of equal length.

    Attributes:
        piece: the piece in which each part is, (K,).
        first: the first part of each of the N pieces, and K, (N + 1,).
    """

    piece: Ints1
    first: Ints1


class TorqueSamples(NamedTuple):
    """Torques a u + b x + c at positions on a path, of a path acceleration u and a squared path speed x.

    Attributes:
        a: torques per path acceleration, (s, nv).
        b: torques per squared path speed, (s, nv).
        c: torques at rest, (s, nv) [N m or N].
    """

    a: Array2
    b: Array2
    c: Array2


class TimedPathArrays(NamedTuple):
    """A path of nv joints through N + 1 waypoints, and the highest speed along it.

    Attributes:
        offsets: displacement of each waypoint from the start, (N + 1, nv) [rad or m].
        slopes: change of it per waypoint, (N + 1, nv).
        start: joint positions at the start, (nv,) [rad or m].
        top: the highest speed between its parts, (K + 1,) [waypoints per step]; empty without a profile.
        rows: the limits of its parts.
        parts: the parts.
        most: largest number of waypoints of one step; may be infinite.
        small: slope that counts as zero, relative to the largest.
    """

    offsets: Array2
    slopes: Array2
    start: Array1
    top: Array1
    rows: ProfileRows
    parts: PathParts
    most: float
    small: float


class PathMotion(NamedTuple):
    """How an arm moves along a path.

    Attributes:
        s: the position on the path, in waypoints.
        speed: number of waypoints in the previous step.
        expected: joint positions expected there, (nv,) [rad or m].
        previous: the previous step, (nv,) [rad or m]; empty: it does not matter, as there is no `brake`.
        brake: largest change of a step, (nv,) [rad or m]; empty: no limit.
    """

    s: float
    speed: float
    expected: Array1
    previous: Array1
    brake: Array1


class PointObjective(NamedTuple):
    """A weighted least-squares objective of points along a chain, and of chords between successive points.

    Attributes:
        screws: linear and angular velocity of each joint's first point, (n, 6), from `find_screws`.
        ends: number of joints that carry each point, (p,); not decreasing.
        points: the points, (p, 3).
        weights: weights W of the points, (p,).
        chords: weights C of the chords to the previous point, (p,).
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
    """The joints of a path. Displacements are relative to the start, in units of each joint.

    Attributes:
        chain: the chain.
        which: joints that may move, by index along the chain, (n,).
        ends: number of those joints that carry each control point, (m,).
        units: unit of motion of each of them, (n,).
        start: joint positions at the start, (nv,).
        lower: smallest displacement, (n,).
        upper: largest displacement, (n,).
        weight: mu^2, weight of joint motion against control point motion [m^2].
    """

    chain: ArmArrays
    which: Ints1
    ends: Ints1
    units: Array1
    start: Array1
    lower: Array1
    upper: Array1
    weight: float


class PathRows(NamedTuple):
    """Linear equations on a path, each for one waypoint: row x_i = error.

    Attributes:
        matrix: the rows, (k, n).
        errors: right-hand sides, (k,) [m].
        waypoints: the waypoint i of each row, not an end, (k,).
    """

    matrix: Array2
    errors: Array1
    waypoints: Ints1


class PathContacts(NamedTuple):
    """Contacts on a path: pairs of solids whose distance should increase by an error where that is positive.

    Attributes:
        errors: errors times the root of the weight, (k,) [m].
        begins: first contact of each waypoint, and number of contacts, (N + 2,); the ends have none.
        carried: number of moving joints of the chain that carry each of the two solids, (k, 2).
        points: closest points, (k, 3) [m].
        normals: unit vectors from the second to the first solid, times the root of the weight, (k, 3).
    """

    errors: Array1
    begins: Ints1
    carried: Ints2
    points: Array2
    normals: Array2


class ModuleSearch(NamedTuple):
    """Modules of a chain with n degrees of freedom, whose ends are to reach m points; see `branch_search`.

    Each joint belongs to the first point it can move.

    Attributes:
        joints: the joints; their columns count the n degrees of freedom.
        levers: the end of each module in the frame of its last joint, (m, 3).
        starts: index of the first joint of each module, and the number of joints, (m + 1,).
        begins: index of the first degree of freedom of each module, and their number, (m + 1,).
        sliding: True for a degree of freedom of prismatic joints, (n,).
        lower: lower limits, (n,).
        upper: upper limits, (n,).
        near: preferred joint positions, within the limits, (n,).
    """

    joints: Joints
    levers: Array2
    starts: Ints1
    begins: Ints1
    sliding: Flags1
    lower: Array1
    upper: Array1
    near: Array1


class CurveModule(NamedTuple):
    """A module with k degrees of freedom whose end is to reach a curve; see `target_point`.

    Attributes:
        chain: its joints, and its end as the only control point, in the frame of its base.
        units: unit motion of each degree of freedom, (k,).
        turning: True for a degree of freedom of revolute joints, (k,).
        reach: largest distance of the end from the base, (1,).
    """

    chain: ArmArrays
    units: Array1
    turning: Flags1
    reach: Array1


class Trees(NamedTuple):
    """Points and triangles of obstacles in trees of boxes; see `kernels.bounding_volumes`.

    Attributes:
        boxes: lowest and highest corner of each node, tree after tree, (nodes, 2, 3).
        points: points in the order of their trees, (p, 3).
        triangles: corners of triangles, in the same order, (t, 3, 3).
        pieces: for each obstacle the index of its first box, its node, number of levels of its tree, index of
            its first point or triangle, their number in its tree, and 1 if these are points, (o, 6).
    """

    boxes: Array3
    points: Array2
    triangles: Array3
    pieces: Ints2


class Pairs(NamedTuple):
    """Pairs of two bodies, or of a body and an obstacle, in groups; b bodies and o obstacles.

    Attributes:
        first: the body of each pair, (n,).
        second: the other body, or b plus the index of the obstacle, (n,).
        kinds: kind of the second solid, of `SOLID`, (n,).
        exact: False if the shapes given here only enclose the solids, (n,).
        radii: radii of body capsules, then of capsule obstacles or of the points of scans, otherwise 0; less
            the depth beneath the surface from which the distance of an obstacle counts, (b + o,).
        lines: axis of the capsule of each obstacle, (o, 2, 3).
        centers: centre of each obstacle that is not a capsule, or of the box around it, (o, 3).
        frames: its axes, as columns; z is the normal of a half-space and the axis of a cylinder, (o, 3, 3).
        halves: half its extent along them, (o, 3).
        trees: the obstacles that are pieces of scans or meshes.
        shapes: the kind of each obstacle, (o,).
        groups: a block of bodies, and another block or the number of blocks plus an obstacle, (g, 2).
        starts: first pair of each group, and the number of pairs, (g + 1,).
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


class SearchTrees(NamedTuple):
    """Two trees of offsets; see `kernels.tree_search`.

    Attributes:
        nodes: the nodes, (2, capacity, nv); the first of each is its root.
        parents: index of the parent of each node, -1 for a root, (2, capacity).
        counts: number of nodes, (2,).
        state: how far the search is, by the entries of `STATE`, (4,).
    """

    nodes: Array3
    parents: Ints2
    counts: Ints1
    state: Ints1


class TreeSettings(NamedTuple):
    """How trees grow; see `kernels.tree_search`.

    Attributes:
        step: largest joint motion of an edge, in units.
        least: the distance to keep on edges [m].
        tolerance: as for `smallest_distance_on_motions` [m].
        open_motion: as for `smallest_distance_on_motions` [m].
        doubtful: whether every edge needs a further check.
    """

    step: float
    least: float
    tolerance: float
    open_motion: float
    doubtful: bool


class OccupancyGrid(NamedTuple):
    """A cube of cells in n blocks of 8 x 8 x 8 along each edge; see `kernels.occupancy`.

    Attributes:
        corner: its lowest corner, (3,) [m].
        resolution: edge length of a cell [m].
        blocks: n.
        evidence: of each cell, block by block, (n**3 * 512,): above 0 for something seen there, times the
            scale at that time; -1 for free; 0 for unknown.
        marks: what a cell has been in the last picture that covered it, (n**3 * 512,).
        bits: a bit for each cell, (n**3 * 8,); all are 0 while no kernel runs.
        used: whether a block has cells that are not unknown, (n**3,).
    """

    corner: Array1
    resolution: float
    blocks: int
    evidence: Singles1
    marks: Halves1
    bits: Words1
    used: Bytes1


BLOCK = 8
"""Number of bodies in a block of `Pairs`."""


class SolidKinds(NamedTuple):
    """Kinds of second solids in `Pairs`."""

    segment: int = 0
    """With a radius: a sphere, a capsule, or a body."""

    box: int = 1
    plane: int = 2
    cylinder: int = 3

    piece: int = 4
    """A part of a tree of `Trees`."""

    inside: int = 5
    """What a closed surface encloses."""


SOLID = SolidKinds()


class TreeOutcomes(NamedTuple):
    """Why trees stop growing; see `kernels.tree_search`."""

    ended: int = 0
    """Samples or room are used up."""

    open: int = 1
    """The new edge needs a further check."""

    joined: int = 2
    """They meet."""


OUTCOME = TreeOutcomes()


class SearchState(NamedTuple):
    """Entries of the state of `SearchTrees`."""

    turn: int = 0
    """The tree that extends."""

    at: int = 1
    """Its new node, which the other tree is to reach; -1 before it is added."""

    met: int = 2
    """The node of the other tree there, or -1."""

    last: int = 3
    """The tree of the last edge."""


STATE = SearchState()


class RowCouplings(NamedTuple):
    """How rows depend on the joints before their section; see `kernels.kinematics`."""

    full: int = 0
    relative: int = 1
    local: int = 2


COUPLING = RowCouplings()


class Rows(NamedTuple):
    """The rows of a posture control matrix.

    Attributes:
        stations: control points with rows, (p,); increasing, at least one.
        ranks: number of rows of each of them, (p,).
        directions: orthonormal directions, those with a row first, (p, 3, 3), world axes.
        coupling: one of `COUPLING`.
    """

    stations: Ints1
    ranks: Ints1
    directions: Array3
    coupling: int


class Factors(NamedTuple):
    """The factor L of a posture control matrix L Q; see `kernels.posture_matrix`.

    Attributes:
        triangles: lower triangular blocks R, (p, 3, 3); a tiny diagonal entry stands for zero, for a row that
            depends linearly on others.
        gains: K, (p, 6, 3).
    """

    triangles: Array3
    gains: Array3


class PostureProblem(NamedTuple):
    """The least-squares problem of moving control points to their targets.

    Attributes:
        chain: the arm.
        joints: joints that may move, by index along the chain, (n,); increasing.
        units: unit motion of each of them, (n,) [rad or m].
        position_limits: their smallest and largest positions, (2, n).
        indices: control points with a target, (p,); increasing.
        ends: number of the joints that carry each of these, (p,).
        targets: their target positions, (p, 3).
        weights: weights of their squared errors, (p,).
        chords: weights of the squared errors of the chords to the previous point, (p,).
        normal: direction in which errors are ignored, (3,); zero for none.
    """

    chain: ArmArrays
    joints: Ints1
    units: Array1
    position_limits: Array2
    indices: Ints1
    ends: Ints1
    targets: Array2
    weights: Array1
    chords: Array1
    normal: Array1


class SearchSettings(NamedTuple):
    """Settings of a search by damped least squares; see `POSTURE_SEARCH`.

    Attributes:
        good: mean error at which the search ends.
        largest_step: largest step of a joint, in units.
        damping_share: damping relative to the sum of squares.
        least_damping: smallest damping relative to the stiffness of the chain.
        least_stiffness: lower bound of that stiffness.
        decrease: factor of the damping after a step that reduced the errors.
        increase: factor of the damping after a step that did not.
        least_factor: smallest factor of the damping.
        most_factor: largest factor; beyond it a failed step counts as idle.
        converged: relative decrease of the sum of squares below which a step counts as idle.
        idle: number of successive idle steps at which the search ends.
        steps: maximum number of steps.
    """

    good: float
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
