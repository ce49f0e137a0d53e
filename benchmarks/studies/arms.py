"""Survey of foreign and awkward arms; arms and families of cases for the studies."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal, NamedTuple, get_args

import numpy as np
from joblib import delayed
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.cases.scenarios import NEARLY, PLANAR, SPATIAL, TARGET_CURVES, arbitrary_configuration
from pinposture._validation import require_known
from pinposture.arm import Arm, JointSpec, ModuleTemplate
from pinposture.arm.template import modules_to_urdf
from pinposture.curve import Curve
from pinposture.errors import FileError, InvalidValue, PostureError, no_warnings
from pinposture.motion import track
from pinposture.motion.processes import in_order
from pinposture.placement import Target, resolve_targets

# The survey loads every file of a directory, or arms of shapes that once caused problems (`awkward_arms`),
# places each on a curve and tracks it.

Array = NDArray[np.float64]


class ArmSurvey(NamedTuple):
    """Result of the survey for one file. Distances are relative to the arm length; None if not available.

    Attributes:
        file: file name.
        refused: why the file was rejected, or empty.
        joints: number of moving joints of the chain.
        modules: number of joints of each module.
        dimension: 2 if planar, 3 if spatial.
        length: length from the first joint to the tip [m].
        method: how its modules were placed on the gentle curve.
        residual: root mean square distance of its control points from the curve.
        farthest: largest distance of the links from the curve in the placement
            (`Target.distance_from_curve`).
        reference: residual of the best of several independent bounded least-squares fits.
        reached: mean point error after tracking from a random start by joint interpolation.
        steps: steps of that run.
        switching: mean point error after at most 300 steps of Switching from the same start.
        switching_steps: steps of that run.
        geodesic: mean point error after at most 300 steps of Geodesic, the default, from the same start.
        geodesic_steps: steps of that run.
        qp_status: how the Geodesic run ended, as `Trajectory.status`.
        path_length_ratio: its path length of all control points relative to straight lines.
        qp_within_limits: whether all its configurations were within the joint limits.
        within_limits: whether all configurations of all three runs were.
        notes: warnings from loading.
    """

    file: str
    refused: str = ""
    joints: int = 0
    modules: tuple[int, ...] = ()
    dimension: int = 0
    length: float = 0.0
    method: str = ""
    residual: float | None = None
    farthest: float | None = None
    reference: float | None = None
    reached: float | None = None
    steps: int = 0
    switching: float | None = None
    switching_steps: int = 0
    geodesic: float | None = None
    geodesic_steps: int = 0
    qp_status: str = ""
    path_length_ratio: float | None = None
    qp_within_limits: bool = True
    within_limits: bool = True
    notes: tuple[str, ...] = ()


def gentle_curve(arm: Arm) -> Curve:
    """Return a curve that such an arm should be able to follow: two slight bends, flat if planar."""
    points = np.array([(0, 0, 0), (0.3, 0, 0), (0.6, 0.04, 0.03), (0.9, 0.12, 0.03), (1.3, 0.15, 0)])
    return Curve.spline(arm.length * points * ((1, 1, 0) if arm.dimension == 2 else 1))


def awkward_arms() -> dict[str, str]:
    """Return arms with shapes that once caused problems, as URDF by name; lengths in metres.

    Joints that do not repeat: yaw and roll, then parallel axes with different limits ("unrepeating21");
    parallel axes after a joint that turns their plane, formerly one module ("long_module7", "bucket4") or
    three ("long_modules36"); a planar arm whose tip is off its plane ("tip_out_of_plane8"); joints without
    limits ("no_limits10"); a base that slides within limits of 1e6 m ("huge_slides10").
    """
    yaw, half_pi = JointSpec("z", lower=-2.8, upper=2.8), math.pi / 2
    pitches = [JointSpec("y", lower=-0.5 - 0.05 * k, upper=0.6 + 0.03 * k) for k in range(19)]
    roll = JointSpec("x", lower=-half_pi, upper=half_pi)
    endless = [JointSpec("z", type="continuous"), JointSpec("y", type="continuous")]
    drives = [JointSpec(axis, type="prismatic", lower=-1e6, upper=1e6) for axis in "xy"]
    bend = JointSpec("y", lower=-1.5, upper=1.5)
    rows = [joint for count in (10, 11, 12) for joint in (yaw, *[bend] * count)]
    flat = [JointSpec("z", lower=-1.5, upper=1.5)] * 8
    chains = {
        "unrepeating21": ([yaw, roll, *pitches], [0.05] * 21),
        "long_module7": ([yaw, *[bend] * 6], [0.1, 0.2, 0.15, 0.12, 0.1, 0.08, 0.06]),
        "bucket4": ([yaw, *[bend] * 3], [0.3, 1.0, 0.8, 0.3]),
        "long_modules36": (rows, [0.05] * 36),
        "tip_out_of_plane8": (flat, [0.1] * 8),
        "no_limits10": (endless * 5, [0.1] * 10),
        "huge_slides10": ([*drives, *[yaw, bend] * 4], [0.0, 0.1, *[0.1] * 8]),
    }
    texts = {
        name: modules_to_urdf([ModuleTemplate(name, joints, lengths)], name)
        for name, (joints, lengths) in chains.items()
    }
    robot = ET.fromstring(texts["tip_out_of_plane8"].encode())
    for tip in robot.iterfind("joint[@name='tip_joint']/origin"):
        tip.set("xyz", "0.1 0.0 0.05")
    texts["tip_out_of_plane8"] = ET.tostring(robot, encoding="unicode")
    return texts


def survey_arms(
    directory: str | Path | None,
    least_joints: int = 5,
    seed: int = 0,
    jobs: int = 1,
    progress: Callable[[ArmSurvey], object] | None = None,
) -> list[ArmSurvey]:
    """Survey every URDF file below a directory, or the `awkward_arms`.

    Args:
        directory: where to search for files that end in ".urdf"; None for `awkward_arms`.
        least_joints: files with fewer moving joints are skipped.
        seed: seed of the starts.
        jobs: number of processes.
        progress: called with each result as it arrives.

    Returns:
        One result for each file, in order of path.

    Raises:
        FileError: no such directory, or no URDF file in it.
    """
    if directory is None:
        tasks = [delayed(_survey)(name, text, 1, seed) for name, text in awkward_arms().items()]
    else:
        directory = Path(directory)
        if not directory.is_dir():
            raise FileError(directory, "is not a directory")
        files = sorted(directory.rglob("*.urdf"))
        if not files:
            raise FileError(directory, "contains no file that ends in .urdf")
        tasks = [delayed(_survey)(path.name, path, least_joints, seed) for path in files]
    results = []
    for result in in_order(tasks, jobs):
        if result is not None:
            results.append(result)
            if progress is not None:
                progress(result)
    return results


def _survey(name: str, source: str | Path, least_joints: int, seed: int) -> ArmSurvey | None:
    try:
        with no_warnings():  # they are stored on the arm
            arm = Arm.load(source)
    except PostureError as error:
        return ArmSurvey(name, refused=str(error).replace(str(source), name))
    if len(arm.columns) < least_joints:
        return None
    found = ArmSurvey(
        name,
        joints=len(arm.columns),
        modules=tuple(len(joints) for joints in arm.module_joints),
        dimension=arm.dimension,
        length=arm.length,
        notes=arm.warnings,
    )
    with no_warnings():  # the table reports it
        target = resolve_targets(arm, gentle_curve(arm), placement="align", incomplete="partial")
    curve = target.curve or gentle_curve(arm)
    distance = curve.nearest(arm.chain.flattened(target.points))[1]
    away = target.distance_from_curve(arm)
    found = found._replace(
        method=target.method if not target.incomplete else f"{target.method}: {target.incomplete}",
        residual=float(np.sqrt(np.mean(distance**2))) / arm.length,
        farthest=None if away is None else away / arm.length,
        reference=_reference(arm, curve) / arm.length,
    )
    start = arm.random(np.random.default_rng(seed))
    # All points must be reached, even those off the curve: the arm can take that posture.
    posture = Target(target.points, np.ones(arm.n_modules), q=target.q)
    direct = track(arm, posture, start, "joint", max_steps=1000)
    switched, constrained = (
        track(arm, posture, start, name, max_steps=300) for name in ("switching", "geodesic")
    )
    inside = [all(arm.within_limits(q) for q in run.q) for run in (direct, switched, constrained)]
    return found._replace(
        reached=float(direct.point_errors[-1].mean()) / arm.length,
        steps=direct.steps,
        switching=float(switched.point_errors[-1].mean()) / arm.length,
        switching_steps=switched.steps,
        geodesic=float(constrained.point_errors[-1].mean()) / arm.length,
        geodesic_steps=constrained.steps,
        qp_status=constrained.status,
        path_length_ratio=constrained.path_length_ratio,
        qp_within_limits=inside[-1],
        within_limits=all(inside),
    )


def _reference(arm: Arm, curve: Curve, starts: int = 6) -> float:
    """Return the root mean square distance [m] of the best of several fits with free arc lengths."""
    rng, n, m = np.random.default_rng(0), arm.nv, arm.n_modules
    straight = arm.positions(arm.straight())
    still = 1e-6 * arm.joint_units  # equal bounds would have no interior
    low, high = (
        np.where(arm.roaming, straight + side * still, bound)
        for side, bound in zip((-1.0, 1.0), arm.usual_positions, strict=True)
    )
    along = np.cumsum(arm.chain.module_lengths) / arm.length * min(arm.length, 0.99 * curve.length)

    def distances(unknowns: Array) -> Array:
        state = arm.at(arm.configuration(unknowns[:n]))
        points = arm.chain.flattened(state.points)
        return np.asarray((points - curve.at(unknowns[n:])).ravel() / arm.length)

    def jacobian(unknowns: Array) -> Array:
        state, tangents = arm.at(arm.configuration(unknowns[:n])), curve.tangent(unknowns[n:])
        rows = np.zeros((m, 3, n + m))
        rows[:, :, :n] = state.jacobians
        rows[np.arange(m), :, n + np.arange(m)] = -tangents
        return np.asarray(rows.reshape(3 * m, n + m) / arm.length)

    bounds = (np.r_[low, np.zeros(m)], np.r_[high, np.full(m, curve.length)])
    costs = []
    for k in range(starts):
        joints = np.clip(straight + 0.3 * (k > 0) * rng.normal(size=n), low, high)
        guess = np.clip(np.r_[joints, along], bounds[0] + 1e-9 * arm.length, bounds[1] - 1e-9 * arm.length)
        costs.append(least_squares(distances, guess, jac=jacobian, bounds=bounds, max_nfev=200).cost)
    return float(np.sqrt(2.0 * min(costs) / m)) * arm.length


# Families of cases: a kind of start and a kind of target, determined by a seed alone.

StartKind = Literal["smooth", "uniform-0.6", "uniform-1.5", "noise", "straight"]
TargetKind = Literal["helix", "line", "folded", "random", "gentle"]

START_KINDS: tuple[StartKind, ...] = get_args(StartKind)
UNIFORM = {"uniform-0.6": 0.6, "uniform-1.5": 1.5}
"""Largest joint position of starts with independent joints [rad or sliding unit]."""

BUILT: dict[str, tuple[TargetKind, ...]] = {
    "ryrz20": ("helix", "line", "folded", "random"),
    "planar45": ("line", "folded", "random"),
}
"""The built-in arms, and the kinds of target that each can take."""


class Subject(NamedTuple):
    """An arm under study.

    Attributes:
        name: name of the arm.
        arm: the arm.
        targets: the kinds of target it can take.
    """

    name: str
    arm: Arm
    targets: tuple[TargetKind, ...]

    @property
    def families(self) -> tuple[Family, ...]:
        """All combinations of starts and targets except straight to a line, where nothing moves."""
        pairs = (Family(start, target) for start in START_KINDS for target in self.targets)
        return tuple(family for family in pairs if family != ("straight", "line"))


class Family(NamedTuple):
    """A kind of start and a kind of target.

    Attributes:
        start: "smooth" for a posture like that of an arm at rest (`arbitrary_configuration`); "uniform-0.6"
            and "uniform-1.5" for independent joints within that distance of the straight posture, clipped to
            the limits [rad or sliding unit]; "noise" for the same within 1e-3; "straight".
        target: "helix" (6.17) and "line" (6.16) of the thesis; "folded" for the straight arm folded back by a
            half turn of one joint; "random" for another smooth posture; "gentle" for `gentle_curve`. For a
            spatial arm, curves are rolled by a random angle.
    """

    start: StartKind
    target: TargetKind


def built_subject(name: str) -> Subject:
    """Return a built-in arm by name.

    "ryrz20" is the spatial arm of Section 6.1, 20 modules of two joints. "planar45" is the planar one of
    Section 6.2 with 23 control points, at every second joint and at the tip: the arm may bend either way
    between two of its points.

    Raises:
        UnknownName: there is no such arm.
    """
    require_known("arm", name, BUILT)
    if name == "ryrz20":
        return Subject(name, Arm.from_modules(SPATIAL, name=name), BUILT[name])
    pairs, rest = divmod(len(PLANAR), 2)
    sizes = [2] * pairs + [1] * rest
    return Subject(name, Arm.load(modules_to_urdf(PLANAR, name), modules=sizes), BUILT[name])


def loaded_subject(arm: Arm) -> Subject:
    """Return the subject of any other arm, which can take slight bends and its own postures."""
    return Subject(arm.model.name, arm, ("gentle", "random"))


def draw_case(subject: Subject, family: Family, seed: int) -> tuple[Array, Target]:
    """Return the start configuration and the target of a seed, a whole number >= 0.

    Starts and targets are drawn from separate streams, so that a seed has the same start for every kind of
    target, and the same target for every kind of start. Each target includes its configuration.

    Raises:
        UnknownName: no such kind of start, or a kind of target that this arm cannot take.
        InvalidValue: a "folded" target for an arm that cannot fold back.
    """
    require_known("kind of start", family.start, START_KINDS)
    require_known("kind of target", family.target, subject.targets)
    start = _start(subject.arm, family.start, _stream(seed, "start", family.start))
    return start, _target(subject, family.target, _stream(seed, "target", family.target))


def _stream(seed: int, *names: str) -> np.random.Generator:
    """Return a random generator for one purpose, independent of those for others with the same seed."""
    return np.random.default_rng([seed, *" ".join(names).encode()])


def _start(arm: Arm, kind: StartKind, rng: np.random.Generator) -> Array:
    if kind == "straight":
        return arm.straight()
    if kind == "smooth":
        return arbitrary_configuration(arm, rng)
    width = NEARLY if kind == "noise" else UNIFORM[kind]
    positions = arm.positions(arm.straight())
    on_chain = np.zeros(arm.nv)
    on_chain[arm.columns] = arm.joint_units[arm.columns]
    positions = positions + on_chain * rng.uniform(-width, width, arm.nv)
    return arm.configuration(np.clip(positions, arm.limits.lower, arm.limits.upper))


def _target(subject: Subject, kind: TargetKind, rng: np.random.Generator) -> Target:
    arm = subject.arm
    roll = float(rng.uniform(-np.pi, np.pi)) if arm.dimension == 3 else 0.0
    if kind == "folded":
        return _folded(arm, rng)
    if kind == "random":
        return Target.from_configuration(arm, arbitrary_configuration(arm, rng))
    if kind == "gentle":
        # Use the posture, not the curve: an arm with few joints stays slightly off it.
        placed = resolve_targets(arm, gentle_curve(arm), placement="align", roll=roll, incomplete="partial")
        return Target.from_configuration(arm, arm.neutral() if placed.q is None else placed.q)
    return resolve_targets(arm, TARGET_CURVES[subject.name, kind], placement="align", roll=roll)


def _folded(arm: Arm, rng: np.random.Generator) -> Target:
    """Return the straight arm with a half turn of one joint, in either direction.

    In half of the cases this is the first joint, so that the whole arm lies on the other side of its base;
    else it is any joint in the first half of the arm. The points lie exactly on the line of the straight arm,
    from which no joint reduces an error to first order; rounding errors of a sine would break this.
    """
    half = range(max(len(arm.columns) // 2, 1))
    ways = [(joint, turn) for joint in half for turn in (-np.pi, np.pi) if _can_fold(arm, joint, turn)]
    if np.any(arm.straight() != arm.neutral()) or not ways:
        raise InvalidValue("arm", arm, "an arm that is straight at zero, with a joint there that turns by pi")
    first = [way for way in ways if way[0] == ways[0][0]]
    choice = first if rng.random() < 0.5 else ways
    joint, turn = choice[int(rng.integers(len(choice)))]
    column, points = arm.columns[joint], arm.at(arm.straight()).points
    moved = arm.support[:, column, None] > 0.0  # (m, 1)
    positions = np.zeros(arm.nv)
    positions[column] = turn
    folded = np.where(moved, 2.0 * arm.chain.origins[joint] - points, points)
    return replace(Target.from_points(arm, folded), q=arm.configuration(positions))


def _can_fold(arm: Arm, joint: int, turn: float) -> bool:
    """Return whether a joint of the chain can turn that far, about an axis perpendicular to the arm."""
    column, axis = arm.columns[joint], arm.chain.axes[joint]
    across = abs(axis @ (arm.chain.points[-1] - arm.chain.base)) < 1e-9 * arm.length
    inside = arm.limits.lower[column] <= turn <= arm.limits.upper[column]
    return bool(arm.chain.revolute[joint] and across and inside)
