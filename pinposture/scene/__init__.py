"""What is in the way: obstacles, the arm itself, and how far it is from both."""

from pinposture.scene.clearance import Clearance, Closest, Nearness
from pinposture.scene.mesh import Mesh
from pinposture.scene.obstacles import Box, Capsule, Cylinder, HalfSpace, Obstacle, Sphere, obstacle_from_dict
from pinposture.scene.pairs import LeftOut
from pinposture.scene.pipe import Bend, pipe, pipe_axis, pipe_walls
from pinposture.scene.scan import Scan
from pinposture.scene.scan_clearance import ScanClearance, ScanGap, scan_clearance
from pinposture.scene.scene import Scene

__all__ = [
    "Bend",
    "Box",
    "Capsule",
    "Clearance",
    "Closest",
    "Cylinder",
    "HalfSpace",
    "LeftOut",
    "Mesh",
    "Nearness",
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
    "scan_clearance",
]
