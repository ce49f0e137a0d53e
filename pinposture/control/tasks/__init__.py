"""What an arm is asked to do besides taking the target posture: tasks that a controller weighs against it.

All rows are metres, so that weights compare with those of control points. A turn counts as what it moves at
the end of a lever, `length`, by default as long as `Arm.sliding_unit`: the mean module length.
"""

from pinposture.control.tasks.end_effector import EndEffector
from pinposture.control.tasks.joint_posture import JointPosture
from pinposture.control.tasks.tangents import Tangents
from pinposture.control.tasks.task import Task, TaskRows

__all__ = ["EndEffector", "JointPosture", "Tangents", "Task", "TaskRows"]
