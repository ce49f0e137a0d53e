"""Survey of foreign and awkward arms: loaded, placed on a curve, and tracked."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from functools import partial
from itertools import groupby
from pathlib import Path
from typing import Annotated

import numpy as np
import typer
from numpy.typing import NDArray
from scipy.optimize import least_squares

from benchmarks.cases.families import gentle_curve
from benchmarks.harness import Case, Row, Study
from benchmarks.report import Columns, Report, StudyOptions, short, table
from pinposture._validation import require_whole
from pinposture.arm import Arm, JointSpec, ModuleTemplate
from pinposture.arm.template import modules_to_urdf
from pinposture.cli.inputs import ARM, MOTION
from pinposture.cli.output import examples
from pinposture.curve import Curve
from pinposture.errors import FileError, PostureError, no_warnings
from pinposture.motion import track
from pinposture.placement import Target, resolve_targets

# The survey loads every file of a directory, or arms of shapes that once caused problems (`awkward_arms`),
# places each on a curve and tracks it.

Array = NDArray[np.float64]

TRACKED = {"joint": 1000, "switching": 300, "geodesic": 300}
"""Controllers that track each arm, and their maximum number of steps."""


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


def survey_arms(directory: str | Path | None, least_joints: int = 5, seed: int = 0) -> Study:
    """Survey every URDF file below a directory, or the `awkward_arms`.

    Args:
        directory: where to search for files that end in ".urdf"; None for `awkward_arms`.
        least_joints: files with fewer moving joints are skipped.
        seed: seed of the starts.

    Raises:
        InvalidValue: an invalid seed.
        FileError: no such directory, or no URDF file in it.
    """
    require_whole("seed", seed, 0)
    sources: list[tuple[str, str | Path]]
    if directory is None:
        sources, least_joints = list(awkward_arms().items()), 1
    else:
        directory = Path(directory)
        if not directory.is_dir():
            raise FileError(directory, "is not a directory")
        sources = [(path.name, path) for path in sorted(directory.rglob("*.urdf"))]
        if not sources:
            raise FileError(directory, "contains no file that ends in .urdf")
    cases = [Case({"file": name}, partial(_load, name, source)) for name, source in sources]
    return Study(cases, [tuple(TRACKED)], partial(_survey, least_joints, seed))


def _load(name: str, source: str | Path) -> Arm | str:
    """Return an arm, or why its file is refused."""
    try:
        with no_warnings():  # they are stored on the arm
            return Arm.load(source)
    except PostureError as error:
        return str(error).replace(str(source), name)


UNKNOWN = Row(
    refused="",
    joints=0,
    modules=(),
    dimension=0,
    length=0.0,
    method="",
    residual=None,
    farthest=None,
    reference=None,
    reached=None,
    steps=0,
    switching=None,
    switching_steps=0,
    geodesic=None,
    geodesic_steps=0,
    qp_status="",
    path_length_ratio=None,
    qp_within_limits=True,
    within_limits=True,
    notes=(),
)
"""What is found of an arm; here of one that is refused. Distances are relative to the arm length.

refused: why the file was rejected, or empty.
joints: number of moving joints of the chain.
modules: number of joints of each module.
dimension: 2 if planar, 3 if spatial.
length: length from the first joint to the tip [m].
method: how its modules were placed on the gentle curve.
residual: root mean square distance of its control points from the curve.
farthest: largest distance of the links from the curve in the placement (`Target.distance_from_curve`).
reference: residual of the best of several independent bounded least-squares fits.
reached: mean point error after tracking from a random start by joint interpolation.
steps: steps of that run.
switching, switching_steps: the same after at most 300 steps of Switching from the same start.
geodesic, geodesic_steps: the same after at most 300 steps of Geodesic, the default.
qp_status: how the Geodesic run ended, as `Run.status`.
path_length_ratio: its path length of all control points relative to straight lines.
qp_within_limits: whether all its configurations were within the joint limits.
within_limits: whether all configurations of all three runs were.
notes: warnings from loading.
"""


def _survey(least_joints: int, seed: int, arm: Arm | str, controllers: tuple[str, ...]) -> Row | None:
    if isinstance(arm, str):
        return UNKNOWN.but(refused=arm)
    if len(arm.columns) < least_joints:
        return None
    with no_warnings():  # the table reports it
        target = resolve_targets(arm, gentle_curve(arm), placement="align", incomplete="partial")
    curve = target.curve or gentle_curve(arm)
    distance = curve.nearest(arm.chain.flattened(target.points))[1]
    away = target.distance_from_curve(arm)
    start = arm.random(np.random.default_rng(seed))
    # All points must be reached, even those off the curve: the arm can take that posture.
    posture = Target(target.points, np.ones(arm.n_modules), q=target.q)
    runs = [track(arm, posture, start, name, max_steps=TRACKED[name]) for name in controllers]
    direct, switched, constrained = runs
    errors = [float(run.point_errors[-1].mean()) / arm.length for run in runs]
    inside = [all(arm.within_limits(q) for q in run.q) for run in runs]
    return UNKNOWN.but(
        joints=len(arm.columns),
        modules=tuple(len(joints) for joints in arm.module_joints),
        dimension=arm.dimension,
        length=arm.length,
        method=target.method if not target.incomplete else f"{target.method}: {target.incomplete}",
        residual=float(np.sqrt(np.mean(distance**2))) / arm.length,
        farthest=None if away is None else away / arm.length,
        reference=_reference(arm, curve) / arm.length,
        reached=errors[0],
        steps=direct.steps,
        switching=errors[1],
        switching_steps=switched.steps,
        geodesic=errors[2],
        geodesic_steps=constrained.steps,
        qp_status=constrained.status,
        path_length_ratio=constrained.path_length_ratio,
        qp_within_limits=inside[-1],
        within_limits=all(inside),
        notes=arm.warnings,
    )


def _reference(arm: Arm, curve: Curve, starts: int = 6) -> float:
    """Return the root mean square distance [m] of the best of several fits with free arc lengths."""
    rng, n, m = np.random.default_rng(0), arm.nv, arm.n_modules
    straight = arm.positions(arm.straight())
    still = 1e-6 * arm.joint_units  # equal bounds would have no interior
    low, high = (
        np.where(arm.base_slides, straight + side * still, bound)
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


AS_CLOSE = 1.05
"""Maximum ratio of the residual of a good placement to that of the reference."""

RESIDUAL_ROUNDING = 1e-6
"""Tolerance of residuals, relative to the arm length: sampling of the curve, rounding errors."""

_COLUMNS: Columns = {
    "file": lambda row: row.file,
    "joints": lambda row: row.joints,
    "modules": lambda row: compressed(row.modules),
    "kind": lambda row: "planar" if row.dimension == 2 else "spatial",
    "length [m]": lambda row: row.length,
    "placed by": lambda row: row.method.partition(":")[0] + (" (partial)" if ":" in row.method else ""),
    "residual": lambda row: short(row.residual),
    "reference": lambda row: short(row.reference),
    "ratio": lambda row: "ok" if _is_close(row) else short(_ratio(row)),
    "farthest": lambda row: short(row.farthest),
    "joint": lambda row: short(row.reached),
    "Switching": lambda row: short(row.switching),
    "geodesic": lambda row: short(row.geodesic),
    "geodesic steps": lambda row: row.geodesic_steps if row.geodesic is not None else None,
    "geodesic paths": lambda row: short(row.path_length_ratio),
    "limits held": lambda row: "yes" if row.within_limits else "no",
}
_REFUSED_COLUMNS: Columns = {"file": lambda row: row.file, "outcome": lambda row: f"refused: {row.refused}"}


@examples(
    "make study STUDY=arms -- urdf/",
    "make study STUDY=arms -- urdf/ --least-joints 8 --seed 1 --jobs 4",
    "make study STUDY=arms -- urdf/ --json",
    "make study STUDY=arms",
)
def run(
    *,
    directory: Annotated[
        Path | None,
        typer.Argument(
            metavar="[DIRECTORY]",
            help="Where to search for .urdf files, at any depth; default: built-in arms of unusual shapes.",
        ),
    ] = None,
    least_joints: Annotated[int, ARM("Skip arms with fewer moving joints.", "N")] = 5,
    seed: Annotated[int, MOTION("Seed of the starts.")] = 0,
    options: StudyOptions,
) -> None:
    """Test every arm of a directory: place it on a gentle curve, and drive it there.

    Without a directory, arms of unusual shapes are tested: joints that do not repeat, long rows of parallel
    axes, a tip beside the plane of the arm, no limits, a base that slides within limits of 1e6 m.

    Distances are relative to the arm length. The residual is the distance of the placed control points from
    the curve (root mean square), the reference that of the best of several independent fits; their ratio is
    ok up to 1.05 (plus 1e-6). Farthest is the largest distance of the whole arm, including its links, from
    the curve. The next columns are the mean point errors that joint interpolation, Switching and geodesic,
    the default controller, reach from a random start; the number of steps of geodesic, and its path length of
    control points relative to straight lines; and whether all three kept the joint limits.
    """
    rows = options.run(survey_arms(directory, least_joints, seed), "arm")
    tried = [row for row in rows if not row.refused]
    refused = [row for row in rows if row.refused]
    parts = ((_COLUMNS, tried), (_REFUSED_COLUMNS, refused))
    unplaced = {row.file: row.method.partition(": ")[2] for row in tried}
    options.write(
        Report(
            rows,
            {
                "directory": None if directory is None else str(directory),
                "least_joints": least_joints,
                "seed": seed,
                "arms": [{**row, "ratio": _ratio(row), "ok": _is_close(row)} for row in rows],
            },
            [table(columns, own) for columns, own in parts if own],
            notes=[] if rows else [f"no arm of at least {least_joints} moving joints"],
            warnings=[
                f"{row.file}: {note}"
                for row in rows
                for note in (*row.notes, *filter(None, [unplaced.get(row.file)]))
            ],
        )
    )


def _is_close(row: Row) -> bool | None:
    """Return whether an arm is placed about as close to the curve as possible; None if it was not placed."""
    if row.residual is None or row.reference is None:
        return None
    return bool(row.residual <= AS_CLOSE * row.reference + RESIDUAL_ROUNDING)


def _ratio(row: Row) -> float | None:
    """Return the residual relative to the reference, both at least the rounding tolerance."""
    if row.residual is None or row.reference is None:
        return None
    return float(max(row.residual, RESIDUAL_ROUNDING) / max(row.reference, RESIDUAL_ROUNDING))


def compressed(sizes: tuple[int, ...]) -> str:
    """Format numbers of joints, with repetitions combined: "2 x 8", "2, 2, 3", "1 x 18, 2"."""
    runs = [[str(size) for size in same] for _, same in groupby(sizes)]
    return ", ".join(f"{run[0]} x {len(run)}" if len(run) > 2 else ", ".join(run) for run in runs)
