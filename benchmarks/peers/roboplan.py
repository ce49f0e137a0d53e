"""RRT-Connect and shortcuts of roboplan, which has Pinocchio and coal in C++.

Its scene has no margin, so the bodies of the arm are larger by the margin; by half of it where they are kept
from each other. That is exact for capsules. The flat end of the arm becomes a longer cylinder, which at its
rim keeps up to 0.41 times the margin more. Boxes and spheres are boxes and spheres there, capsules are
cylinders with a sphere at either end, and a scan is a mesh of triangles of a micrometre at its points, from
which the bodies keep the radius of the points as well. Adjacent and other pairs of bodies are checked where
this library checks them. `count_verdicts` compares both.

Options are its defaults, but for `rrt_connect`, the number of nodes and the time.
"""

from __future__ import annotations

import xml.etree.ElementTree as xml
from itertools import combinations
from pathlib import Path
from tempfile import TemporaryDirectory
from time import process_time
from typing import NamedTuple

import numpy as np
import pinocchio as pin
import trimesh
from numpy.typing import NDArray
from roboplan import core, rrt

from benchmarks.harness import Problem
from benchmarks.peers.planner import RESOLUTION, Found
from pinposture.arm import Arm, smooth_configuration
from pinposture.collision import Box, Capsule, CollisionModel, Obstacle, Scan, Scene, Sphere

Array = NDArray[np.float64]

WORLD, GREY = "universe", np.full(4, 0.5)

DOT = 1e-6
"""Edges of the triangles that stand for points of scans [m]."""

MOST_NODES = 1_000_000

RIM = np.sqrt(2.0) - 1.0
"""What the corner of a cylinder that is larger by 1 is farther away than 1."""

ROUNDING = 2.0 * DOT


class Verdicts(NamedTuple):
    """Configurations that both judge.

    Attributes:
        collisions: number of those that come too close, by this library.
        rim: number of those that only roboplan refuses, because of the rim of the end.
        different: number of other differences.
        count: number of all.
    """

    collisions: int
    rim: int
    different: int
    count: int


class Planner:
    """RRT-Connect for a problem."""

    def __init__(self, problem: Problem) -> None:
        arm, start, target, scene = problem
        assert scene is not None
        assert target.q is not None
        self.problem = problem
        self.growth = _growth(scene)
        self.scene, links = _described(arm, scene, self.growth)
        added: list[str] = []
        with TemporaryDirectory() as folder:
            for name, obstacle in scene.obstacles.items():
                added += _add(self.scene, name, obstacle, Path(folder))
        pairs = CollisionModel(arm, scene).index_pairs
        checked = [(links[one], links[other]) for one, other in pairs if other < len(links)]
        self.scene.setCollisions([*combinations(links, 2), *combinations(added, 2)], False)
        if checked:
            self.scene.setCollisions(checked, True)
        self.joints = list(arm.model.names[1:])
        self.ends = [core.JointConfiguration(self.joints, np.array(q, float)) for q in (start, target.q)]

    def solve(self, budget: float, seed: int) -> Found:
        """Search for a path for up to a time [s], and shorten it."""
        options = rrt.RRTOptions(
            max_nodes=MOST_NODES,
            collision_check_step_size=RESOLUTION,
            max_planning_time=budget,
            rrt_connect=True,
        )
        planner = rrt.RRT(self.scene, options)
        planner.setRngSeed(seed)
        shortcutter = core.PathShortcutter(
            self.scene, core.PathShortcuttingOptions(max_step_size=RESOLUTION, seed=seed)
        )
        began = process_time()
        try:
            path = planner.plan(*self.ends)
        except RuntimeError:  # none within the time
            return Found.none(process_time() - began)
        first_time = process_time() - began
        first_path = np.array(path.positions)
        began = process_time()
        shorter = shortcutter.shortcut(path)
        took = process_time() - began
        return Found(first_time, first_path, first_time + took, np.array(shorter.positions))

    def count_verdicts(self, count: int, seed: int) -> Verdicts:
        """Compare with this library at configurations near the straight motion from start to goal."""
        arm, start, target, scene = self.problem
        model = CollisionModel(arm, scene)
        rng = np.random.default_rng(seed)
        collisions = rim = different = 0
        for share in rng.uniform(0.0, 1.0, count):
            q = (
                (1.0 - share) * start
                + share * target.q
                + smooth_configuration(arm, rng, rng.uniform(0.0, 0.5))
            )
            q = np.clip(q, arm.limits.lower, arm.limits.upper)
            beyond = model.minimum(q).distance - scene.margin
            close = bool(beyond < 0.0)
            refused = self.scene.hasCollisions(q)
            collisions += close
            if refused != close and abs(beyond) > ROUNDING:
                at_rim = bool(refused and beyond < RIM * self.growth + ROUNDING)
                rim += at_rim
                different += not at_rim
        return Verdicts(collisions, rim, different, count)


def _growth(scene: Scene) -> float:
    """How much larger the bodies of the arm are [m]."""
    radii = [each.point_radius for each in scene.obstacles.values() if isinstance(each, Scan)]
    if scene.self_collision:
        return 0.5 * scene.margin
    return scene.margin + max(radii, default=0.0)


def _described(arm: Arm, scene: Scene, growth: float) -> tuple[core.Scene, list[str]]:
    """Return a scene of the arm alone, and the name of the link of each body."""
    robot = xml.fromstring(arm.urdf)
    robot.set("version", "1.2")  # of those that have capsules
    links = {link.get("name"): link for link in robot.iter("link")}
    for link in links.values():
        for part in list(link):
            link.remove(part)
    child = {joint.get("name"): str(joint.find("child").get("link")) for joint in robot.iter("joint")}
    names = []
    for joint, solid in CollisionModel(arm, scene).solids:
        names.append(child[arm.model.names[joint]])
        collision = xml.SubElement(links[names[-1]], "collision")
        turn = pin.rpy.matrixToRpy(solid.rotation)
        xml.SubElement(collision, "origin", xyz=_written(solid.position), rpy=_written(turn))
        length = float(np.linalg.norm(solid.end - solid.start))
        kind = "capsule" if solid.round else "cylinder"
        length += 0.0 if solid.round else 2.0 * growth
        sizes = {"radius": repr(float(solid.radius + growth)), "length": repr(length)}
        xml.SubElement(xml.SubElement(collision, "geometry"), kind, sizes)
    described = core.loadUrdfSceneDescriptionFromXml(xml.tostring(robot, encoding="unicode"))
    return core.Scene("clutter", described), names


def _written(values: Array) -> str:
    return " ".join(repr(float(value)) for value in values)


def _add(scene: core.Scene, name: str, obstacle: Obstacle, folder: Path) -> list[str]:
    """Add an obstacle, and return the names of its parts."""
    names = [name]
    if isinstance(obstacle, Scan):
        corners = obstacle.points[:, None] + DOT * np.array([(0, 0, 0), (1, 0, 0), (0, 1, 1)])
        faces = np.arange(3 * len(obstacle.points)).reshape(-1, 3)
        file = folder / f"{name}.ply"
        trimesh.Trimesh(corners.reshape(-1, 3), faces, process=False).export(file)
        scene.addMeshGeometry(name, WORLD, core.Mesh(file), np.eye(4), GREY)
        return names
    pose = np.asfortranarray(obstacle.pose(np.zeros(3)).homogeneous)
    if isinstance(obstacle, Box):
        scene.addBoxGeometry(name, WORLD, core.Box(*obstacle.size), pose, GREY)
    elif isinstance(obstacle, Sphere):
        scene.addSphereGeometry(name, WORLD, core.Sphere(obstacle.radius), pose, GREY)
    elif isinstance(obstacle, Capsule):
        length = float(np.linalg.norm(np.subtract(obstacle.end, obstacle.start)))
        scene.addCylinderGeometry(name, WORLD, core.Cylinder(obstacle.radius, length), pose, GREY)
        for end in ("start", "end"):
            names.append(f"{name} {end}")
            pose = pin.SE3(np.eye(3), np.array(getattr(obstacle, end))).homogeneous
            scene.addSphereGeometry(names[-1], WORLD, core.Sphere(obstacle.radius), pose, GREY)
    else:
        raise TypeError(f"{name}: roboplan has no {type(obstacle).__name__}")
    return names
