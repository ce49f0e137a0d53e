"""Does it work on arms that nobody here made? Load every file of a directory, place it on a curve, track."""

from __future__ import annotations

import warnings
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
from joblib import delayed
from numpy.typing import NDArray
from scipy.optimize import least_squares

from pinposture.arm import Arm
from pinposture.curve import Curve
from pinposture.errors import FileError, PostureError
from pinposture.motion import track
from pinposture.motion.processes import in_order
from pinposture.target import Target, resolve_targets

Array = NDArray[np.float64]


class ArmSurvey(NamedTuple):
    """What came of one file. Distances are relative to the arm length, None where there is none.

    Attributes:
        file: its name.
        refused: why it was refused, or empty.
        joints: number of moving joints of the chain.
        modules: number of joints of each module.
        dimension: 2 if planar, 3 if spatial.
        length: arc length from the first joint to the tip [m].
        method: how its modules were placed on the gentle curve.
        residual: root mean square distance of its control points from the curve.
        reference: the same, of the best of several independent bounded least-squares fits.
        reached: mean point error after tracking from a random start by joint interpolation.
        steps: steps of that run.
        switching: mean point error after at most 300 steps of Switching from the same start.
        switching_steps: steps that Switching took.
        qp: mean point error after at most 300 steps of ConstrainedQP, the default, from the same start.
        qp_steps: steps that it took.
        qp_status: how that run ended, as `Trajectory.status`.
        path_excess: length of the paths of all its control points relative to the direct distances.
        qp_within_limits: whether every configuration on its way was within the joint limits.
        within_limits: whether every configuration of all three runs was.
        notes: what loading warned of.
    """

    file: str
    refused: str = ""
    joints: int = 0
    modules: tuple[int, ...] = ()
    dimension: int = 0
    length: float = 0.0
    method: str = ""
    residual: float | None = None
    reference: float | None = None
    reached: float | None = None
    steps: int = 0
    switching: float | None = None
    switching_steps: int = 0
    qp: float | None = None
    qp_steps: int = 0
    qp_status: str = ""
    path_excess: float | None = None
    qp_within_limits: bool = True
    within_limits: bool = True
    notes: tuple[str, ...] = ()


def gentle_curve(arm: Arm) -> Curve:
    """A curve that an arm of that length should be able to follow: two slight bends, flat if it is planar."""
    points = np.array([(0, 0, 0), (0.3, 0, 0), (0.6, 0.04, 0.03), (0.9, 0.12, 0.03), (1.3, 0.15, 0)])
    return Curve.spline(arm.length * points * ((1, 1, 0) if arm.dimension == 2 else 1))


def survey_arms(
    directory: str | Path,
    least_joints: int = 5,
    seed: int = 0,
    jobs: int = 1,
    progress: Callable[[ArmSurvey], object] | None = None,
) -> list[ArmSurvey]:
    """Try every URDF file below a directory.

    Args:
        directory: where to look for files that end in ".urdf".
        least_joints: arms with fewer moving joints are left out.
        seed: draws the starts of the runs.
        jobs: number of processes.
        progress: called with each result as it arrives.

    Returns:
        One result for each file, in the order of their paths.

    Raises:
        FileError: no such directory, or no URDF file in it.
    """
    directory = Path(directory)
    if not directory.is_dir():
        raise FileError(directory, "is no directory")
    files = sorted(directory.rglob("*.urdf"))
    if not files:
        raise FileError(directory, "holds no file that ends in .urdf")
    results = []
    tasks = (delayed(_survey)(path, least_joints, seed) for path in files)
    for result in in_order(tasks, jobs):
        if result is not None:
            results.append(result)
            if progress is not None:
                progress(result)
    return results


def _survey(path: Path, least_joints: int, seed: int) -> ArmSurvey | None:
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # they are kept on the arm
            arm = Arm.from_urdf(path)
    except PostureError as error:
        return ArmSurvey(path.name, refused=str(error).replace(str(path), path.name))
    if len(arm.columns) < least_joints:
        return None
    found = ArmSurvey(
        path.name,
        joints=len(arm.columns),
        modules=tuple(len(joints) for joints in arm.module_joints),
        dimension=arm.dimension,
        length=arm.length,
        notes=arm.warnings,
    )
    target = resolve_targets(arm, gentle_curve(arm), placement="align", incomplete="partial")
    curve = target.curve or gentle_curve(arm)
    distance = curve.nearest(target.points)[1]
    found = found._replace(
        method=target.method if not target.incomplete else f"{target.method}: {target.incomplete}",
        residual=float(np.sqrt(np.mean(distance**2))) / arm.length,
        reference=_reference(arm, curve) / arm.length,
    )
    start = arm.random(np.random.default_rng(seed))
    # All points are to be reached, also those that lie off the curve: the arm can take that posture.
    posture = Target(target.points, np.ones(arm.n_modules), q=target.q)
    direct = track(arm, posture, start, "joint", max_steps=1000)
    switched, constrained = (track(arm, posture, start, name, max_steps=300) for name in ("switching", "qp"))
    inside = [all(arm.within_limits(q) for q in run.q) for run in (direct, switched, constrained)]
    return found._replace(
        reached=float(direct.point_errors[-1].mean()) / arm.length,
        steps=direct.steps,
        switching=float(switched.point_errors[-1].mean()) / arm.length,
        switching_steps=switched.steps,
        qp=float(constrained.point_errors[-1].mean()) / arm.length,
        qp_steps=constrained.steps,
        qp_status=constrained.status,
        path_excess=constrained.sweep,
        qp_within_limits=inside[-1],
        within_limits=all(inside),
    )


def _reference(arm: Arm, curve: Curve, starts: int = 6) -> float:
    """Root mean square distance [m] of the best of several fits with free places on the curve."""
    rng, n, m = np.random.default_rng(0), arm.nv, arm.n_modules
    low = np.where(np.isfinite(arm.limits.lower), arm.limits.lower, -np.pi)
    high = np.where(np.isfinite(arm.limits.upper), arm.limits.upper, np.pi)
    straight = arm.positions(arm.straight())
    along = np.cumsum(arm.chain.module_lengths) / arm.length * min(arm.length, 0.99 * curve.length)

    def distances(unknowns: Array) -> Array:
        state = arm.at(arm.configuration(unknowns[:n]))
        return np.asarray((state.points - curve.at(unknowns[n:])).ravel() / arm.length)

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
