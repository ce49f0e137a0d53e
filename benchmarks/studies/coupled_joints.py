"""Arms with coupled joints beside others: random postures reached, limits kept, and the time of a step.

    python -m benchmarks.studies.coupled_joints              # about a minute; a Markdown table
    python -m benchmarks.studies.coupled_joints --postures 5

Each arm goes from one random posture to another, as often as asked. Every configuration on the way is checked
against the limits of the degrees of freedom, and against those of every joint in the description, which a
model of Pinocchio without couplings knows.
"""

from __future__ import annotations

import argparse
import time
import warnings
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pinocchio as pin

import pinposture as pp
from pinposture.arm import JointSpec, ModuleTemplate, continuum_section, smooth_configuration, template

MOST_STEPS = 3000
THESIS = ("selection", "projection", "switching")


def geared(links: int) -> ModuleTemplate:
    """A finger: parallel hinges, each of which turns by 0.8 of what the first does."""
    hinges = [JointSpec("z", lower=-1.0, upper=1.0)]
    hinges += [JointSpec("z", lower=-1.0, upper=1.0, follows=0, ratio=0.8) for _ in range(links - 1)]
    return ModuleTemplate("Geared", hinges, [0.05] * links)


def snake(modules: int, together: int) -> pp.Arm:
    """A snake of crossed hinges whose modules are coupled in groups, as tendons couple them."""
    text = pp.Arm.from_template("RyRz", modules).urdf
    names = [f"m{m:02d}_j{j}" for m in range(1, modules + 1) for j in ("1_y", "2_z")]
    couplings = {
        name: names[number // (2 * together) * 2 * together + number % 2]
        for number, name in enumerate(names)
        if number % (2 * together) > 1
    }
    return pp.Arm.load(text, couplings=couplings)


def described(file: str) -> pp.Arm:
    """An arm of the package example-robot-data."""
    robots = Path(pin.__file__).resolve().parents[4] / "share/example-robot-data/robots"
    return pp.Arm.load(robots / file)


RADII = (0.014, 0.012, 0.01, 0.008)
ARMS: dict[str, Callable[[], pp.Arm]] = {
    "3 sections of 10 disks": lambda: pp.Arm.from_template("Continuum", 3),
    "10 sections of 10 disks": lambda: pp.Arm.from_template("Continuum", 10),
    "30 sections of 10 disks": lambda: pp.Arm.from_template("Continuum", 30),
    "100 sections of 4 disks": lambda: pp.Arm.from_modules([continuum_section(4, 0.05)] * 100),
    "5 sections that stretch": lambda: pp.Arm.from_modules([continuum_section(8, 0.2, stretch=0.03)] * 5),
    "4 tapered sections": lambda: pp.Arm.from_modules(
        [continuum_section(n, 0.2, 2.0, radius=r) for n, r in zip((12, 10, 8, 6), RADII, strict=True)]
    ),
    "sections and RyRz modules": lambda: pp.Arm.from_modules(
        [continuum_section(6, 0.15), *[template("RyRz")] * 4] * 3
    ),
    "planar, 8 geared fingers": lambda: pp.Arm.from_modules([geared(3)] * 8),
    "snake, 2 modules together": lambda: snake(20, 2),
    "snake, 5 modules together": lambda: snake(20, 5),
    "snake, none together": lambda: pp.Arm.from_template("RyRz", 20),
    "Panda": lambda: described("panda_description/urdf/panda.urdf"),
    "UR10": lambda: described("ur_description/urdf/ur10_robot.urdf"),
    "TALOS, left arm": lambda: described("talos_data/robots/talos_left_arm.urdf"),
}


def keeps_all_limits(arm: pp.Arm, run: pp.Run) -> bool:
    """Whether all joints of the description are within their own limits, whatever moves them."""
    if not arm.couplings:
        return all(arm.within_limits(q) for q in run.q)
    free = pin.buildModelFromXML(arm.urdf)
    rows = np.array([arm.positions(q) for q in run.q])
    members = [(name, name, 1.0, 0.0) for name in arm.joint_names] + list(arm.couplings)
    for name, leader, ratio, offset in members:
        joint = free.joints[free.getJointId(name)]
        if joint.nq == 1:
            position = ratio * rows[:, arm.joint_names.index(leader)] + offset
            low, high = free.lowerPositionLimit[joint.idx_q], free.upperPositionLimit[joint.idx_q]
            if low < high and (position.min() < low - 1e-9 or position.max() > high + 1e-9):
                return False
    return True


def main() -> None:
    """Run all arms and print the table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--postures", type=int, default=50)
    given = parser.parse_args()
    warnings.simplefilter("ignore", pp.PostureWarning)
    print(
        "| arm | joints | degrees of freedom | modules | reached | limits kept | thesis | run per step [us] |"
    )
    print("|---|---|---|---|---|---|---|---|")
    for name, make in ARMS.items():
        arm, rng = make(), np.random.default_rng(0)
        most = float(np.abs(np.array(arm.usual_positions)).max()) / 2.0
        limits, times, reached, kept, by_thesis = pp.Limits(step=most / 20.0), [], 0, 0, []
        for number in range(given.postures):
            start, goal = (smooth_configuration(arm, rng, most) for _ in range(2))
            target = pp.Target.from_configuration(arm, goal)
            begin = time.perf_counter()
            run = pp.track(arm, target, start, limits=limits, max_steps=MOST_STEPS)
            if number:  # the first compiles
                times.append((time.perf_counter() - begin) / max(run.steps, 1))
            reached += run.converged
            kept += keeps_all_limits(arm, run)
            if number < 5:
                runs = [pp.track(arm, target, start, other, limits=limits, max_steps=200) for other in THESIS]
                by_thesis.append([bool(np.all(np.isfinite(each.q))) for each in runs])
        thesis = "runs" if np.all(by_thesis) else "FAILS"
        count = f"{reached} of {given.postures} | {kept} of {given.postures}"
        step = 1e6 * float(np.median(times)) if times else float("nan")
        print(
            f"| {name} | {len(arm.chain.joints)} | {len(arm.columns)} | {arm.n_modules} | {count} "
            f"| {thesis} | {step:.0f} |",
            flush=True,
        )


if __name__ == "__main__":
    main()
