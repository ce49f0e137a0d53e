"""`pinposture export`: write a motion for a robot, a simulator or a spreadsheet."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from pinposture.cli.inputs import OUTPUT, JsonOption, RunArgument, read_numbers, read_option
from pinposture.cli.output import (
    examples,
    find_kept,
    load_kept,
    print_note,
    print_result,
    print_warning,
    words_of,
)
from pinposture.errors import FileError
from pinposture.storage import require_suffix

if TYPE_CHECKING:
    from pinposture.arm import Arm
    from pinposture.motion import Run, Trajectory
    from pinposture.motion.joint_trajectory import JointTrajectory

GOAL = "follow-joint-trajectory"
BAG = "rosbag"


@examples(
    "pinposture export out --dt 0.02 -o out/joints.json",
    "pinposture export out/run.npz --dt 0.02 -o out/joints.csv",
    "pinposture export out --dt 0.02 -o out/joints.npz --json",
    "pinposture export out --dt 0.02 --format follow-joint-trajectory -o g.json",
    "pinposture export out --dt 0.02 -o out/motion.mcap",
)
def run(
    *,
    path: RunArgument,
    output: Annotated[
        Path,
        OUTPUT(
            ".json for ROS 2, .csv for a table, .npz for NumPy, .mcap for a ROS 2 bag.", "FILE", "--output -o"
        ),
    ],
    form: Annotated[
        str,
        OUTPUT(
            "follow-joint-trajectory: a goal of this action, as JSON. rosbag: a ROS 2 bag, a folder. "
            "Default: by the suffix.",
            "NAME",
            "--format",
        ),
    ] = "",
    trajectory_options: TrajectoryOptions,
    as_json: JsonOption = False,
) -> None:
    """Write a motion as joint positions, velocities and accelerations over time.

    A .json file is a ROS 2 trajectory_msgs/msg/JointTrajectory, for the controllers of ros2_control. A .csv
    file has one column per quantity, with units. A .npz file contains the exact arrays. Joints keep their
    URDF names; the angles of continuous joints have no jumps. A bag (.mcap, or a folder with --format rosbag)
    has the topics /joint_states, /joint_trajectory, /tf and /robot_description; it needs the extra "ros".

    A motion that did not converge, exceeds its limits, or penetrates something is rejected unless --force is
    given. The summary lists the largest velocity and acceleration, from rest to rest.
    """
    from pinposture.motion import Trajectory
    from pinposture.schema import Duration
    from pinposture.storage import check_writable

    check_form(output, form)
    check_writable(output.parent)
    source, which = find_kept(path)
    if which:
        print_note(which)
    if output.exists() and output.samefile(source):
        raise FileError(output, "is the input; allowed: another file")
    kept = load_kept(source)
    trajectory = trajectory_options.read(kept)
    _write(trajectory, output, form, kept.arm)
    limits = (kept.run if isinstance(kept, Trajectory) else kept).limits
    if limits.acceleration is None:
        cycle = read_option("--dt", trajectory_options.dt, Duration)
        most = words_of(trajectory.summary())["acceleration"]
        print_warning(
            f"no acceleration limit: joints accelerate by {most}; plan again with "
            f"--dt {limits.dt or cycle:g} --acceleration A, or acceleration in the [limits] of a task"
        )
    run = kept.run if isinstance(kept, Trajectory) else kept
    faults = [
        fault for fault in kept.faults if not (trajectory_options.compensate and fault in run.sag_faults)
    ]
    for fault in faults:
        print_warning(f"exported despite a fault: {fault}")
    verdict = {"verdict": kept.verdict, "faults": list(kept.faults)}
    data = {"run": str(source), **verdict, **trajectory.summary(), "file": str(output)}
    print_result(as_json, data, words_of(trajectory.summary()), [output])


@dataclass(frozen=True)
class TrajectoryOptions:
    """The joint trajectory of a saved run or motion."""

    dt: Annotated[
        str | None, OUTPUT("Duration of a step in seconds; required if the run has none.", "TIME")
    ] = None
    force: Annotated[
        bool,
        OUTPUT("Write it despite faults: not converged, limits exceeded, penetration.", flags="--force"),
    ] = False
    coupled: Annotated[
        bool, OUTPUT("Also write the joints that follow others (<mimic>).", flags="--coupled")
    ] = False
    compensate: Annotated[
        bool,
        OUTPUT(
            "Write the commands for which the loaded arm makes the motion; the arm needs a stiffness.",
            flags="--compensate",
        ),
    ] = False
    start: Annotated[
        str | None,
        OUTPUT(
            "Positions at which the drives of the robot stand, one per joint: continuous joints start with "
            "their full turns.",
            "NUMBERS",
        ),
    ] = None

    def read(self, kept: Run | Trajectory) -> JointTrajectory:
        """Return the joint trajectory of a motion, which has its own time, or of a run.

        Raises:
            PostureError: as `joint_trajectory` and `starting_at`; or positions that are no numbers.
        """
        from pinposture.motion import Trajectory
        from pinposture.motion.joint_trajectory import step_duration
        from pinposture.schema import Duration

        cycle = read_option("--dt", self.dt, Duration)
        if isinstance(kept, Trajectory):
            step_duration(cycle, kept.dt)  # rejects another duration
            trajectory = kept.joint_trajectory(self.force, self.compensate)
        else:
            trajectory = kept.joint_trajectory(cycle, self.force, self.compensate)
        if self.start is not None:
            trajectory = trajectory.starting_at(kept.arm, read_numbers("--start", self.start))
        return trajectory.with_coupled(kept.arm) if self.coupled else trajectory


def check_form(output: Path, form: str) -> None:
    """Raise an error for an unknown format or suffix."""
    from pinposture._validation import require_known
    from pinposture.motion.joint_files import SUFFIXES

    if form:
        require_known("format", form, (GOAL, BAG))
    else:
        require_suffix(output, *SUFFIXES, ".mcap")


def _write(trajectory: JointTrajectory, output: Path, form: str, arm: Arm) -> None:
    from pinposture.motion import save
    from pinposture.motion.ros import write_bag, write_goal

    if form == GOAL:
        write_goal(trajectory, output)
    elif form == BAG or output.suffix.lower() == ".mcap":
        write_bag(trajectory, output, arm)
    else:
        save(trajectory, output)
