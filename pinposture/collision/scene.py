"""Scenes: obstacles, self-collision and the margin to keep; scene files."""

from __future__ import annotations

import json
import sys
from collections.abc import ItemsView, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from pinposture._validation import Vector, known_keys, length, point, require_positive
from pinposture.collision.distances import PairDistances, Placements
from pinposture.collision.obstacles import (
    OBSTACLE_TYPES,
    Obstacle,
    displaced,
    obstacle_from_dict,
    solid,
    solids,
)
from pinposture.collision.shapes import Sphere
from pinposture.errors import FileError, InvalidValue, PostureError, UnknownName
from pinposture.storage import read_text, relative, write_text

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

VERSION = 1
MAX_LISTED_OBSTACLES = 8  # number of obstacles up to which `repr` names them all
PROBE_RADIUS = 1e-6  # radius of the ball that stands for a point [m]

_KEYS = ("version", "obstacles", "self_collision", "margin", "arm_radius", "velocities")


@dataclass(frozen=True, eq=False)
class Scene:
    """Obstacles, and how an arm must keep clear of them and of itself.

    A scene is immutable, can be compared and pickled, and belongs to no arm; `CollisionModel` takes both:

        scene = pp.Scene({"post": pp.Cylinder([0.3, 0.1, -1], [0.3, 0.1, 1], 0.02)}, self_collision=True)
        scene = pp.Scene.load("scene.toml")

    Where obstacles move, the scene of each moment is another one (`moved`).

    Attributes:
        obstacles: the obstacles by name.
        self_collision: whether the arm must keep clear of itself as well.
        margin: the distance to keep [m].
        arm_radius: radius of stand-in capsules along the links [m], in place of the collision geometry in
            the arm's description. If None, that geometry, or where there is none capsules with a radius of a
            tenth of the mean module length (`pinposture.collision.bodies`).
        velocities: velocities of the obstacles that move, by name, (3,) [m/s]; others stand still.
    """

    obstacles: Mapping[str, Obstacle] = field(default_factory=dict)
    self_collision: bool = False
    margin: float = 0.005
    arm_radius: float | None = None
    velocities: Mapping[str, Vector] = field(default_factory=dict)
    _first: Scene | None = field(init=False, repr=False, default=None)
    _hash: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        if not isinstance(self.obstacles, Mapping):
            raise InvalidValue("obstacles", self.obstacles, "a mapping from names to obstacles")
        for name, obstacle in self.obstacles.items():
            if not isinstance(name, str) or not name.strip() or not name.isprintable():
                raise InvalidValue("name of an obstacle", name, "printable text that is not blank")
            if not isinstance(obstacle, tuple(OBSTACLE_TYPES.values())):
                allowed = ", ".join(kind.__name__ for kind in OBSTACLE_TYPES.values())
                raise InvalidValue(f"obstacles[{name!r}]", obstacle, allowed)
        if not isinstance(self.self_collision, bool):
            raise InvalidValue("self_collision", self.self_collision, "True or False")
        object.__setattr__(self, "obstacles", MappingProxyType(dict(self.obstacles)))
        object.__setattr__(self, "margin", length("margin", self.margin, zero=True))
        if self.arm_radius is not None:
            object.__setattr__(self, "arm_radius", length("arm_radius", self.arm_radius))
        velocities = {name: point(f"velocities[{name!r}]", v) for name, v in self._known(self.velocities)}
        object.__setattr__(self, "velocities", MappingProxyType(velocities))
        # Every control step may look up the collision model of a scene.
        object.__setattr__(self, "_hash", hash(self._key()))

    def _known(self, values: Mapping[str, Any]) -> ItemsView[str, Any]:
        """Return values for obstacles; raise UnknownName for a name that no obstacle has."""
        if not isinstance(values, Mapping):
            raise InvalidValue("values", values, "a mapping from names of obstacles")
        for name in values:
            if name not in self.obstacles:
                raise UnknownName("obstacle", name, tuple(self.obstacles))
        return values.items()

    @property
    def first(self) -> Scene:
        """The scene that this one was made of by `moved`; itself if it was not."""
        return self if self._first is None else self._first

    @cached_property
    def moving(self) -> frozenset[str]:
        """Names of the obstacles that have moved or have a velocity."""
        before = self.first.obstacles
        return frozenset(name for name, each in self.obstacles.items() if before[name] is not each) | {
            *self.velocities
        }

    def moved(
        self,
        placements: Mapping[str, pin.SE3 | ArrayLike],
        velocities: Mapping[str, Vector] | None = None,
    ) -> Scene:
        """Return the scene with some obstacles elsewhere.

            scene = scene.moved({"person": (0.5, y, 0.0)}, velocities={"person": (0.0, 0.2, 0.0)})

        Args:
            placements: motion of obstacles from where they were in the first scene, by name: a `pin.SE3`, or
                a translation, (3,) [m]. Where an obstacle was described in a frame of its own, this is where
                that frame is.
            velocities: as the attribute; obstacles without one stand still.

        Returns:
            A scene in which obstacles that are not named stay where they are in this one.

        Raises:
            UnknownName: no obstacle has that name.
            InvalidValue: not a placement, or not a velocity.
        """
        first, obstacles = self.first, dict(self.obstacles)
        for name, placement in self._known(placements):
            if isinstance(placement, pin.SE3):
                motion = placement
            else:
                motion = pin.SE3(np.eye(3), np.array(point(f"placements[{name!r}]", placement)))
            obstacles[name] = displaced(first.obstacles[name], motion)
        return self._at_moment(obstacles, {} if velocities is None else velocities)

    def after(self, time: float) -> Scene:
        """Return the scene after a time [s], if all obstacles keep their velocities.

        Raises:
            InvalidValue: a time that is negative or not finite.
        """
        require_positive("time", time, zero=True)
        obstacles = dict(self.obstacles)
        for name, velocity in self.velocities.items():
            obstacles[name] = displaced(obstacles[name], pin.SE3(np.eye(3), time * np.array(velocity)))
        return self._at_moment(obstacles, self.velocities)

    def without_self_collision(self) -> Scene:
        """Return the scene in which the arm need not keep clear of itself."""
        if not self.self_collision:
            return self
        other = replace(self, self_collision=False)
        if self._first is not None:
            object.__setattr__(other, "_first", replace(self._first, self_collision=False))
        return other

    def _at_moment(self, obstacles: Mapping[str, Obstacle], velocities: Mapping[str, Vector]) -> Scene:
        other = replace(self, obstacles=obstacles, velocities=velocities)
        object.__setattr__(other, "_first", self.first)
        return other

    def to_dict(self, embed: bool = True) -> dict[str, Any]:
        """Return the scene as data that JSON can hold.

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
        """Make the scene that `to_dict` described.

        Args:
            described: the attributes under their names, and the version of the format; all may be left out.
            folder: folder to which paths of meshes and scans are relative.

        Raises:
            InvalidValue: an unknown key, or an invalid value; names the obstacle.
            UnknownName: a type of obstacle that does not exist.
            FileError: a mesh or a scan that is missing or cannot be read.
        """
        if not isinstance(described, Mapping):
            raise InvalidValue("scene", described, f"a table of: {', '.join(_KEYS)}")
        known_keys("the scene", described, _KEYS)
        version = described.get("version", VERSION)
        if isinstance(version, bool) or version != VERSION:
            raise InvalidValue("version", version, str(VERSION))
        values = {key: described[key] for key in _KEYS[2:] if key in described}
        listed = described.get("obstacles", {})
        if not isinstance(listed, Mapping):
            raise InvalidValue("obstacles", listed, "a table of obstacles, each under its name")
        obstacles = {name: _obstacle(name, each, folder) for name, each in listed.items()}
        return cls(obstacles, **values)

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a scene from a TOML or JSON file; both have the keys of `to_dict`.

        Paths of meshes and scans are relative to the folder of the file.

        Raises:
            FileError: missing, unreadable, malformed, or not a scene; names the line, or the key and what is
                allowed.
        """
        path = Path(path)
        suffix = path.suffix.lower()
        if suffix not in (".toml", ".json"):
            raise FileError(path, f"the name ends in {suffix!r}; allowed: .toml, .json")
        text = read_text(path)
        try:
            content = tomllib.loads(text) if suffix == ".toml" else json.loads(text)
        except json.JSONDecodeError as error:
            raise FileError(path, f"line {error.lineno}, column {error.colno}: {error.msg}") from error
        except (ValueError, RecursionError) as error:  # TOML errors contain the line
            raise FileError(path, str(error).replace("\n", " ")) from error
        try:
            return cls.from_dict(content, str(path.parent))
        except PostureError as error:
            raise FileError(path, str(error)) from error

    def save(self, path: str | Path) -> Path:
        """Write the scene to a JSON file, whole or not at all. Returns its path.

        Meshes and scans that were loaded from files are given by the paths of these.

        Raises:
            FileError: the name does not end in .json, or the file cannot be written.
        """
        path = Path(path)
        if path.suffix.lower() != ".json":
            raise FileError(path, f"the name ends in {path.suffix!r}; allowed: .json")
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
        itself = ", clear of itself" if self.self_collision else ""
        return f"Scene({named}{itself}, margin={self.margin:g})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Scene):
            return NotImplemented
        return self is other or (self._hash == other._hash and self._key() == other._key())

    def __hash__(self) -> int:
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        given = dict(self.obstacles), self.self_collision, self.margin, self.arm_radius, dict(self.velocities)
        return Scene, given

    def _key(self) -> tuple[Any, ...]:
        obstacles, velocities = frozenset(self.obstacles.items()), frozenset(self.velocities.items())
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
    """Return the names of the obstacles that a point lies inside.

    Args:
        scene: the scene.
        point: the point, (3,) [m], world frame.
        depth: depth below the surface at which it counts as inside [m].
    """
    return obstacles_near(scene, point, PROBE_RADIUS, -depth - PROBE_RADIUS)


def obstacles_near(scene: Scene, center: ArrayLike, radius: float, within: float = 0.0) -> tuple[str, ...]:
    """Return the names of the obstacles that a ball is nearer to than a distance, or overlaps.

    Args:
        scene: the scene.
        center: centre of the ball, (3,) [m], world frame.
        radius: its radius [m].
        within: the distance of the surfaces [m].
    """
    x, y, z = np.array(center, dtype=np.float64)
    named = [(name, each) for name, obstacle in scene.obstacles.items() for each in solids(obstacle)]
    pairs = [(0, 1 + k) for k in range(len(named))]
    distances = PairDistances([solid(Sphere((x, y, z), radius))], [0], [each for _, each in named], pairs)
    near = distances.near(Placements(np.eye(3)[None, None], np.zeros((1, 1, 3))), within)
    return tuple(dict.fromkeys(named[k][0] for k in np.sort(distances.second[near.pairs] - 1)))
