"""Obstacles, scenes and scans, and the distances of an arm from them and from itself."""

from pinposture.collision.model import Closest, CollisionModel, Distances, ExcludedPair
from pinposture.collision.obstacles import (
    Box,
    Capsule,
    Cylinder,
    HalfSpace,
    Mesh,
    Obstacle,
    Sphere,
    obstacle_from_dict,
)
from pinposture.collision.pipe import Bend, pipe, pipe_axis, pipe_walls
from pinposture.collision.scan import Scan
from pinposture.collision.scan_clearance import ScanClearance, ScanGap
from pinposture.collision.scene import Scene

__all__ = [
    "Bend",
    "Box",
    "Capsule",
    "Closest",
    "CollisionModel",
    "Cylinder",
    "Distances",
    "ExcludedPair",
    "HalfSpace",
    "Mesh",
    "Obstacle",
    "Scan",
    "ScanClearance",
    "ScanGap",
    "Scene",
    "Sphere",
    "obstacle_from_dict",
    "pipe",
    "pipe_axis",
    "pipe_walls",
]
