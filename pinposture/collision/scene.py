"""Scenes: obstacles, self-collision and margin; scene files."""

from __future__ import annotations

import json
from collections.abc import ItemsView, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinposture._validation import (
    Vector,
    known_keys,
    length,
    point,
    require_instance,
    require_known,
    require_name,
    require_positive,
    set_fields,
)
from pinposture.collision.distances import PairDistances, Placements
from pinposture.collision.obstacles import (
    OBSTACLE_TYPES,
    Obstacle,
    displaced,
    obstacle_from_dict,
)
from pinposture.collision.shapes import Sphere
from pinposture.errors import FileError, InvalidValue, PostureError, UnknownName, warn_caller
from pinposture.storage import parse_json, parse_toml, read_text, relative, require_suffix, write_text

VERSION = 1
USUAL_MARGIN = 0.005  # the clearance to keep unless another one is given [m]
MAX_LISTED_OBSTACLES = 8  # maximum number of obstacles that `repr` names individually
PROBE_RADIUS = 1e-6  # radius of the sphere that represents a point [m]

_KEYS = ("version", "obstacles", "self_collision", "margin", "arm_radius", "velocities")


@dataclass(frozen=True, eq=False)
class Scene:
    """Obstacles, and the clearance that an arm must keep from them and from itself.

    A scene is immutable, comparable and picklable, and independent of arms; `CollisionModel` takes both:

        scene = pp.Scene({"post": pp.Cylinder([0.3, 0.1, -1], [0.3, 0.1, 1], 0.02)}, margin=0.01)
        scene = pp.Scene.load("scene.toml")

    For moving obstacles, create a new scene for each moment with `moved`.

    Attributes:
        obstacles: the obstacles by name.
        self_collision: whether the arm must also keep clear of itself; `CollisionModel` says of which pairs.
        margin: the clearance to keep [m].
        arm_radius: radius of stand-in capsules along the links [m], which replace the collision geometry of
            the description. None: use that geometry, and where there is none, capsules with a tenth of the
            mean module length as radius (`pinposture.collision.bodies`).
        velocities: velocities of moving obstacles by name, (3,) [m/s]; all others stand still.
    """

    obstacles: Mapping[str, Obstacle] = field(default_factory=dict)
    self_collision: bool = True
    margin: float = USUAL_MARGIN
    arm_radius: float | None = None
    velocities: Mapping[str, Vector] = field(default_factory=dict)
    _first: Scene | None = field(init=False, repr=False, default=None)
    _hash: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        require_instance("obstacles", self.obstacles, Mapping, "a mapping from names to obstacles")
        for name, obstacle in self.obstacles.items():
            require_name("name of an obstacle", name)
            if not isinstance(obstacle, tuple(OBSTACLE_TYPES.values())):
                allowed = ", ".join(kind.__name__ for kind in OBSTACLE_TYPES.values())
                raise InvalidValue(f"obstacles[{name!r}]", obstacle, allowed)
        require_instance("self_collision", self.self_collision, bool, "True or False")
        obstacles = MappingProxyType(dict(self.obstacles))
        margin = length("margin", self.margin, zero=True)
        set_fields(self, obstacles=obstacles, margin=margin)
        if self.arm_radius is not None:
            set_fields(self, arm_radius=length("arm_radius", self.arm_radius))
        velocities = {name: point(f"velocities[{name!r}]", v) for name, v in self._known(self.velocities)}
        set_fields(self, velocities=MappingProxyType(velocities))
        # The hash is precomputed: every control step may look up the collision model of a scene.
        set_fields(self, _hash=hash(self._key()))

    def _known(self, values: Mapping[str, Any]) -> ItemsView[str, Any]:
        """Return the items of a mapping from obstacle names; raise UnknownName for an unknown obstacle."""
        require_instance("values", values, Mapping, "a mapping from names of obstacles")
        for name in values:
            require_known("obstacle", name, self.obstacles)
        return values.items()

    @property
    def first(self) -> Scene:
        """The original scene from which `moved` or `after` derived this one; otherwise the scene itself."""
        return self if self._first is None else self._first

    @property
    def empty(self) -> bool:
        """Whether there is nothing to keep clear of: no obstacle, and self-collision is off."""
        return not (self.obstacles or self.self_collision)

    @cached_property
    def moving(self) -> frozenset[str]:
        """Names of the obstacles that have been moved or have a velocity."""
        before = self.first.obstacles
        return frozenset(name for name, each in self.obstacles.items() if before[name] is not each) | {
            *self.velocities
        }

    def moved(
        self,
        placements: Mapping[str, pin.SE3 | ArrayLike],
        velocities: Mapping[str, Vector] | None = None,
    ) -> Scene:
        """Return the scene with some obstacles moved.

            scene = scene.moved({"person": (0.5, y, 0.0)}, velocities={"person": (0.0, 0.2, 0.0)})

        Args:
            placements: displacements relative to the first scene, by obstacle name: a `pin.SE3`, or a
                translation, (3,) [m]. For an obstacle described in its own frame, it places that frame.
            velocities: as the attribute; obstacles without one stand still.

        Returns:
            A scene in which all other obstacles stay where they are in this scene.

        Raises:
            UnknownName: an unknown obstacle.
            InvalidValue: an invalid placement or velocity.
        """
        first = self.first
        obstacles = dict(self.obstacles)
        for name, placement in self._known(placements):
            if isinstance(placement, pin.SE3):
                motion = placement
            else:
                allowed = "a pin.SE3 (of a matrix: pin.SE3(matrix)), or three finite numbers [m]"
                motion = pin.SE3(np.eye(3), np.array(point(f"placements[{name!r}]", placement, allowed)))
            obstacles[name] = displaced(first.obstacles[name], motion)
        return self._at_moment(obstacles, {} if velocities is None else velocities)

    def after(self, time: float) -> Scene:
        """Return the scene after a time [s] in which obstacles keep their velocities.

        Raises:
            InvalidValue: the time is negative or not finite.
        """
        require_positive("time", time, zero=True)
        obstacles = dict(self.obstacles)
        for name, velocity in self.velocities.items():
            obstacles[name] = displaced(obstacles[name], pin.SE3(np.eye(3), time * np.array(velocity)))
        return self._at_moment(obstacles, self.velocities)

    def without_obstacles(self) -> Scene:
        """Return the scene without obstacles: the arm has only itself to keep clear of."""
        return replace(self, obstacles={}, velocities={})

    def without_self_collision(self) -> Scene:
        """Return the scene with self-collision disabled."""
        if not self.self_collision:
            return self
        other = replace(self, self_collision=False)
        if self._first is not None:
            set_fields(other, _first=replace(self._first, self_collision=False))
        return other

    def _at_moment(self, obstacles: Mapping[str, Obstacle], velocities: Mapping[str, Vector]) -> Scene:
        other = replace(self, obstacles=obstacles, velocities=velocities)
        set_fields(other, _first=self.first)
        return other

    def to_dict(self, embed: bool = True) -> dict[str, Any]:
        """Return the scene as JSON-compatible data.

        Args:
            embed: whether to include the points of meshes and scans from files, rather than their paths.
        """
        radius = {} if self.arm_radius is None else {"arm_radius": self.arm_radius}
        velocities = {name: list(velocity) for name, velocity in self.velocities.items()}
        return {
            "version": VERSION,
            "self_collision": self.self_collision,
            "margin": self.margin,
            **radius,
            **({"velocities": velocities} if velocities else {}),
            "obstacles": {name: each.to_dict(embed) for name, each in self.obstacles.items()},
        }

    @classmethod
    def from_dict(cls, described: Mapping[str, Any], folder: str = ".") -> Scene:
        """Create a scene from its description by `to_dict`.

        Args:
            described: the attributes by name, and the version of the format; all are optional.
            folder: folder to which paths of meshes and scans are relative.

        Raises:
            InvalidValue: an unknown key or an invalid value; names the obstacle.
            UnknownName: an unknown type of obstacle.
            FileError: a missing or unreadable mesh or scan.
        """
        require_instance("scene", described, Mapping, f"a table of: {', '.join(_KEYS)}")
        known_keys("the scene", described, _KEYS)
        version = described.get("version", VERSION)
        if isinstance(version, bool) or version != VERSION:
            raise InvalidValue("version", version, str(VERSION))
        values = {key: described[key] for key in _KEYS[2:] if key in described}
        listed = described.get("obstacles", {})
        require_instance("obstacles", listed, Mapping, "a table of obstacles, each under its name")
        obstacles = {name: _obstacle(name, each, folder) for name, each in listed.items()}
        return cls(obstacles, **values)

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a scene from a TOML or JSON file; both have the keys of `to_dict`.

        A `PostureWarning` reports a file without obstacles that does not set self-collision either.

        Paths of meshes and scans are relative to the folder of the file.

        Raises:
            FileError: missing, unreadable, malformed, or not a scene; names the line, or key and allowed
                values.
        """
        path = Path(path)
        suffix = require_suffix(path, ".toml", ".json")
        text = read_text(path)
        try:
            content = parse_toml(text) if suffix == ".toml" else parse_json(path, text)
        except (ValueError, RecursionError) as error:  # of TOML, with the line
            raise FileError(path, str(error).replace("\n", " ")) from error
        try:
            scene = cls.from_dict(content, str(path.parent))
        except PostureError as error:
            raise FileError(path, str(error)) from error
        if not scene.obstacles and "self_collision" not in content:
            warn_caller(f"{path} contains no obstacles")
        return scene

    def save(self, path: str | Path) -> Path:
        """Write the scene atomically to a JSON file and return its path.

        Meshes and scans that were loaded from files are stored as paths.

        Raises:
            FileError: the name does not end in .json, or the file cannot be written.
        """
        path = Path(path)
        require_suffix(path, ".json")
        described = self.to_dict(embed=False)
        for each in described["obstacles"].values():
            if "path" in each:
                each["path"] = relative(Path(each["path"]), path.parent)
        write_text(path, json.dumps(described, allow_nan=False, indent=1) + "\n")
        return path

    def __repr__(self) -> str:
        named = ", ".join(self.obstacles) or "no obstacles"
        if len(self.obstacles) > MAX_LISTED_OBSTACLES:
            first, *_, last = self.obstacles
            named = f"{len(self.obstacles)} obstacles, {first} to {last}"
        itself = "" if self.self_collision else ", self-collision off"
        return f"Scene({named}{itself}, margin={self.margin:g})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Scene):
            return NotImplemented
        return self is other or (self._hash == other._hash and self._key() == other._key())

    def __hash__(self) -> int:
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        given = dict(self.obstacles), self.self_collision, self.margin, self.arm_radius, dict(self.velocities)
        return Scene, given, {"_first": self._first}

    def _key(self) -> tuple[Any, ...]:
        obstacles = frozenset(self.obstacles.items())
        velocities = frozenset(self.velocities.items())
        return obstacles, velocities, self.self_collision, self.margin, self.arm_radius


def _obstacle(name: str, described: Any, folder: str) -> Obstacle:
    try:
        return obstacle_from_dict(described, folder)
    except InvalidValue as error:
        raise InvalidValue(f"obstacle {name!r}: {error.name}", error.value, error.allowed) from None
    except UnknownName as error:
        raise UnknownName(f"type of obstacle {name!r}", error.name, error.allowed) from None
    except FileError as error:
        raise FileError(
            error.path, f"{error.reason}; the {described['type']} of obstacle {name!r}"
        ) from error


def obstacles_around(scene: Scene, point: ArrayLike, depth: float = 1e-4) -> tuple[str, ...]:
    """Return the names of the obstacles that contain a point.

    Args:
        scene: the scene.
        point: the point, (3,) [m], world frame.
        depth: depth below the surface from which it counts as inside [m].
    """
    return obstacles_near(scene, point, PROBE_RADIUS, -depth - PROBE_RADIUS)


def obstacles_near(scene: Scene, center: ArrayLike, radius: float, within: float = 0.0) -> tuple[str, ...]:
    """Return the names of the obstacles within a distance of a sphere.

    Args:
        scene: the scene.
        center: centre of the sphere, (3,) [m], world frame.
        radius: radius of the sphere [m].
        within: the distance between the surfaces [m].
    """
    x, y, z = np.array(center, dtype=np.float64)
    named = [
        (name, each) for name, obstacle in scene.obstacles.items() for each in obstacle.geometry.solids()
    ]
    pairs = [(0, 1 + k) for k in range(len(named))]
    distances = PairDistances([Sphere((x, y, z), radius).solid()], [0], [each for _, each in named], pairs)
    near = distances.near(Placements(np.eye(3)[None, None], np.zeros((1, 1, 3))), within)
    return tuple(dict.fromkeys(named[k][0] for k in np.sort(distances.second[near.pairs] - 1)))
