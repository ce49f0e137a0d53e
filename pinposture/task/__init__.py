"""Motions over time: keyframes, following the leader, and coming out again."""

from pinposture.task.carrier_feed import CarrierClearance, CarrierFeed, load_feed
from pinposture.task.find_path import find_path
from pinposture.task.follow_leader import Deviation, Leader, follow_leader, path_deviation
from pinposture.task.keyframe import Keyframe
from pinposture.task.keyframes import keyframe_reference
from pinposture.task.perform import move_through, perform
from pinposture.task.phases import Carrying, Phase, Release, TipGoal, Withdrawal
from pinposture.task.reference import Reference, Waypoint
from pinposture.task.retreat import Retreat, Retreats, can_retreat
from pinposture.task.steering import Steering
from pinposture.task.task import Task
from pinposture.task.wrap import Grip, Wrapping, carry, unwrap, wrap

__all__ = [
    "CarrierClearance",
    "CarrierFeed",
    "Carrying",
    "Deviation",
    "Grip",
    "Keyframe",
    "Leader",
    "Phase",
    "Reference",
    "Release",
    "Retreat",
    "Retreats",
    "Steering",
    "Task",
    "TipGoal",
    "Waypoint",
    "Withdrawal",
    "Wrapping",
    "can_retreat",
    "carry",
    "find_path",
    "follow_leader",
    "keyframe_reference",
    "load_feed",
    "move_through",
    "path_deviation",
    "perform",
    "unwrap",
    "wrap",
]
