"""Obstacles, scenes and scans, and the distances between an arm, obstacles and itself."""

from pinposture.collision.bodies import weigh
from pinposture.collision.mapping import Intrinsics, Map, MapContent, Mounting
from pinposture.collision.model import Closest, CollisionModel, Distances, ExcludedPair
from pinposture.collision.obstacles import Obstacle, obstacle_from_dict
from pinposture.collision.pipe import Bend, pipe, pipe_axis, pipe_walls
from pinposture.collision.scan import Cells, Scan
from pinposture.collision.scene import Carried, Scene
from pinposture.collision.shapes import Box, Capsule, Cylinder, HalfSpace, Mesh, Sphere
from pinposture.collision.wrapping import curve_around

__all__ = [
    "Bend",
    "Box",
    "Capsule",
    "Carried",
    "Cells",
    "Closest",
    "CollisionModel",
    "Cylinder",
    "Distances",
    "ExcludedPair",
    "HalfSpace",
    "Intrinsics",
    "Map",
    "MapContent",
    "Mesh",
    "Mounting",
    "Obstacle",
    "Scan",
    "Scene",
    "Sphere",
    "curve_around",
    "obstacle_from_dict",
    "pipe",
    "pipe_axis",
    "pipe_walls",
    "weigh",
]
