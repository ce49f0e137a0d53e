"""Files of every kind for `test_storage.py`, and what they say when another process reads them.

python tests/reloaded.py                    # reads each file of the folders that stdin names, a line each,
                                            # writes what it says beside it, and repeats the name
"""

from __future__ import annotations

import json
import pickle
import sys
import warnings
from pathlib import Path
from typing import Any

import numpy as np

import pinposture as pp
from pinposture.errors import PostureWarning
from pinposture.sim import Simulation, simulate

FOLLOWS = (0.5, 0.1)
"""Ratio and offset [rad or m] of coupled joints."""


def couple(arm: pp.Arm, coupling: str) -> pp.Arm:
    """The same arm, in which the first joint of one module follows that of another."""
    if arm.couplings or coupling == "free":  # by its template
        return arm
    first = arm.joint_names[0]
    second = arm.joint_names[arm.nv // arm.n_modules]
    if coupling == "driven from behind":  # the drive is not that of the joint that leads in the arm
        return pp.Arm.load(arm.urdf, couplings={first: (second, -FOLLOWS[0], FOLLOWS[1])})
    return pp.Arm.load(arm.urdf, couplings={second: (first, *FOLLOWS)})


def write_all(arm: pp.Arm, folder: Path) -> dict[str, Any]:
    """Write a file of each kind; return what was written, by the names of the files."""
    q = np.zeros(arm.nq) if arm.nq == arm.nv else arm.neutral()
    target = pp.Target.from_configuration(arm, arm.integrate(q, np.full(arm.nv, 0.05)))
    limits = pp.Limits(step=None, dt=0.05, velocity=1.0, acceleration=5.0)
    scene = pp.Scene({"ball": pp.Sphere((0.1, 0.5, 0.2), 0.05)}, margin=0.01)
    run = pp.track(arm, target, q, limits=limits, scene=scene)
    joints = tuple(arm.positions(run.q[-1]))
    keyframes = (pp.Keyframe(joints=tuple(arm.positions(q))), pp.Keyframe(joints=joints, duration=0.3))
    task = pp.Task(arm, keyframes, limits, scene=scene)
    motion = task.perform()
    batch = pp.track_many(arm, [target], [q, run.q[1]], limits=limits, keep="motions", jobs=1)
    written: dict[str, Any] = {
        "run.npz": run,
        "motion.npz": motion,
        "batch.npz": batch,
        "simulation.npz": simulate(arm, motion, hold=0.0),
        "joints.npz": run.joint_trajectory(),
        "joints.csv": run.joint_trajectory(),
        "joints.json": run.joint_trajectory(),
        "task.toml": task,
        "scene.json": scene,
        "curve.json": pp.Curve.line((0.0, 0.0, 0.0), (0.1, 0.1, 0.0)),
        "arm.json": arm,
        "arm.pickle": arm,
        "target.pickle": target,
        "tracker.pickle": pp.Tracker(arm, limits=limits, scene=scene),
        "plan.pickle": pp.plan(arm.at(q), target),
    }
    for name, result in written.items():
        path = folder / name
        if path.suffix == ".pickle":
            path.write_bytes(pickle.dumps(result))
        elif isinstance(result, pp.Arm):
            path.write_text(json.dumps(result.to_dict()))
        elif isinstance(result, pp.Task | pp.Scene | pp.Curve):
            result.save(path)
        else:
            pp.save(result, path)
    return written


def read(path: Path) -> Any:
    """What a file holds."""
    if path.suffix == ".pickle":
        return pickle.loads(path.read_bytes())
    readers = {
        "task.toml": pp.Task.load,
        "scene.json": pp.Scene.load,
        "curve.json": pp.Curve.load,
        "arm.json": lambda file: pp.Arm.from_dict(json.loads(file.read_text())),
    }
    return readers.get(path.name, pp.load)(path)


def say(result: Any) -> dict[str, np.ndarray]:
    """What a result says in numbers: configurations, kinematics there, limits, times."""
    if isinstance(result, pp.Trajectory):
        told = {"time": result.time, "targets": result.targets, "accelerations": result.accelerations}
        return {**say(result.run), **told}
    if isinstance(result, pp.Batch):
        return {f"{k} {name}": value for k, run in enumerate(result) for name, value in say(run).items()}
    if isinstance(result, pp.Run):
        told = {name: getattr(result, name) for name in ("q", "point_errors", "clearance")}
        told |= {"dt": np.array(result.limits.dt), "target": result.target.points}
        return told | _kinematics(result.arm, result.q[-1])
    if isinstance(result, pp.JointTrajectory):
        return {"time": result.time, "positions": result.positions, "names": np.array(result.joint_names)}
    if isinstance(result, pp.Task):
        reference = result.reference()
        return {"rows": reference.offsets, **_kinematics(result.arm, reference.start)}
    if isinstance(result, pp.Tracker):
        result.update(pp.Target.from_configuration(result.arm, result.arm.neutral()))
        step = result.step(result.arm.neutral())
        return {"step": step, "command": result.command, "sent": result.positions}
    if isinstance(result, pp.Arm):
        return _kinematics(result, result.random(0))
    if isinstance(result, pp.Scene):
        return {"margin": np.array(result.margin), "text": np.array(json.dumps(result.to_dict()))}
    if isinstance(result, pp.Curve):
        return {"points": result.resample(7)}
    if isinstance(result, pp.Target):
        return {"points": result.points, "q": np.array(result.q)}
    if isinstance(result, Simulation):
        return {"q": result.q, "torques": result.torques, **_kinematics(result.arm, result.q[-1])}
    return {"start": result.start, "offsets": result.offsets, **_kinematics(result.arm, result.start)}


def _kinematics(arm: pp.Arm, q: np.ndarray) -> dict[str, np.ndarray]:
    state = arm.at(q)
    return {
        "names": np.array(arm.joint_names),
        "couplings": np.array([f"{each}" for each in arm.couplings]),
        "drives": np.array([f"{each}" for each in arm.drives]),
        "lower": arm.limits.lower,
        "upper": arm.limits.upper,
        "all positions": arm.positions(q),
        "points": state.points,
        "rotations": state.rotations,
        "jacobians": state.jacobians,
        "chain": state.chain_state.points,
    }


def main() -> None:
    warnings.simplefilter("ignore", PostureWarning)
    for line in sys.stdin:
        for path in sorted(Path(line.strip()).iterdir()):
            if path.suffix == ".urdf":  # of the task beside it
                continue
            np.savez(path.with_name(f"{path.name}.told"), **say(read(path)))
        sys.stdout.write(line)
        sys.stdout.flush()


if __name__ == "__main__":
    main()
