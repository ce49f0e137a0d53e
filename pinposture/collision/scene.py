"""Scenes: obstacles, self-collision and margin; scene files."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import field, fields, replace
from functools import cached_property, partial
from pathlib import Path
from types import MappingProxyType
from typing import Annotated, Any, ClassVar, TypeAlias, cast

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray
from pydantic import AfterValidator, BeforeValidator, ValidationInfo

from pinposture._validation import (
    LARGEST_LENGTH,
    length,
    point,
    require_instance,
    require_known,
    require_name,
    require_positive,
    set_fields,
)
from pinposture.collision.distances import JointFrames, PairDistances
from pinposture.collision.obstacles import Obstacle, ObstacleField, displaced
from pinposture.collision.scan import Cells
from pinposture.collision.shapes import UNTURNED, Point, Size, Sphere, Turn
from pinposture.document import Document, plain_data
from pinposture.errors import InvalidValue, warn_caller
from pinposture.schema import (
    CheckedBy,
    Declared,
    Flag,
    InFolder,
    InputFile,
    NotAllowed,
    OutputFile,
    Text,
    as_plain,
    declared,
    in_file,
    is_text,
    read_again,
    read_by,
    read_keys,
    read_plain,
    read_quantities,
    read_within,
    refusing,
)
from pinposture.storage import require_suffix, settled, write_text
from pinposture.units import length_text

Array = NDArray[np.float64]

VERSION = 1
USUAL_MARGIN = 0.005  # the clearance to keep unless another one is given [m]


Twist: TypeAlias = tuple[float, ...]
"""A velocity as it is given, with three numbers or six."""


def _require_named(value: object) -> dict[str, object]:
    """Return a mapping from names of obstacles as a new dictionary."""
    if not isinstance(value, Mapping):
        raise NotAllowed(value, "a table or mapping from names of obstacles")
    for name in value:
        require_name("name of an obstacle", name)
    return dict(value)


def _require_known_names(value: Mapping[str, Twist], info: ValidationInfo) -> Mapping[str, Twist]:
    for name in value:
        require_known("obstacle", name, info.data.get("obstacles", value))
    return value


def as_names(name: str, value: Any) -> tuple[str, ...]:
    """Return a list of names of obstacles, in order.

    Raises:
        InvalidValue: something else.
    """
    if isinstance(value, str) or not isinstance(value, (tuple, list, set, frozenset)):
        raise InvalidValue(name, value, "a list of names of obstacles")
    names = [require_name(f"{name}[{k}]", item) for k, item in enumerate(value)]
    return tuple(sorted(dict.fromkeys(names)))


def _require_known(value: tuple[str, ...], info: ValidationInfo) -> tuple[str, ...]:
    for name in value:
        require_known("obstacle", name, info.data.get("obstacles", value))
    return value


def _read_velocity(value: object, info: ValidationInfo) -> Twist:
    """Read a velocity: of the middle of an obstacle, and if there are six numbers, that of its rotation."""
    name = str(info.field_name)
    if np.shape(np.asarray(value, dtype=object)) != (6,):
        allowed = "three finite numbers [m/s], or six: with the angular velocity [rad/s]"
        return cast(Twist, CheckedBy(partial(point, allowed=allowed), "speed").read(name, value))
    numbers = read_quantities(value, [*3 * ["speed"], *3 * ["rate of turning"]])
    for index, number in enumerate(numbers):
        if abs(number) > LARGEST_LENGTH:
            raise NotAllowed(number, f"at most {LARGEST_LENGTH:g} either way", index)
    return numbers


Velocity = Annotated[Twist, read_by(_read_velocity)]
"""A velocity, (3,) [m/s], or with a rotation, (6,) [m/s, rad/s]."""

_Named = BeforeValidator(_require_named)
_ReadOnly = AfterValidator(MappingProxyType)
_Velocities: TypeAlias = Annotated[Mapping[str, Velocity], _Named]


def split_velocity(velocity: Twist) -> tuple[Array, Array]:
    """Return the linear and the angular part of a velocity, (3,) each [m/s] and [rad/s]."""
    both = np.zeros(6)
    both[: len(velocity)] = velocity
    return both[:3], both[3:]


@declared()
class Carried(Declared):
    """How the arm carries an obstacle of a scene: fixed to a frame, with which it moves.

        tool = pp.Box((0.05, 0.0, 0.0), (0.1, 0.02, 0.02))  # in the frame of the link
        scene = pp.Scene({"tool": tool}, carried={"tool": pp.Carried("tip")})

    Attributes:
        frame: the link, control point or joint that carries it, by name.
        position: where that frame is when the obstacle is where the scene describes it, (3,) [m], world
            frame. As it is by default, the obstacle is described in that frame.
        rotation: orientation of the frame then, as that of a box.
        beside: names of obstacles of which it need not keep clear: what it stands on, or is plugged into.
    """

    frame: Text
    position: Point = (0.0, 0.0, 0.0)
    rotation: Turn = UNTURNED
    beside: Annotated[Sequence[str], CheckedBy(as_names)] = ()

    @property
    def placement(self) -> pin.SE3:
        """The pose of the frame when the obstacle is where the scene describes it."""
        return pin.SE3(np.array(self.rotation), np.array(self.position))


def carried_among(carried: Mapping[str, Carried], obstacles: Collection[str]) -> dict[str, Carried]:
    """Return how the arm carries those of some obstacles, beside those of them, by names."""
    return {
        name: replace(item, beside=[other for other in item.beside if other in obstacles])
        for name, item in carried.items()
        if name in obstacles
    }


def _require_carriable(value: Mapping[str, Carried], info: ValidationInfo) -> Mapping[str, Carried]:
    obstacles = info.data.get("obstacles", {})
    for name, carried in value.items():
        for other in (name, *carried.beside):
            require_known("obstacle", other, obstacles)
        shape = obstacles[name].geometry
        if not (shape.convex and shape.bounded):
            raise InvalidValue(f"carried[{name!r}]", obstacles[name], "a convex obstacle of finite size")
    return value


@declared(eq=False)
class Scene(Declared):
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
        velocities: velocities of moving obstacles by name, world axes: (3,) [m/s]; or (6,), with the angular
            velocity about the middle of the obstacle [rad/s] behind that of the middle. All others stand
            still.
        touchable: names of the obstacles that the arm may touch, such as an object to wrap around, or a
            surface to lean on. From these it need keep no margin: it may overlap with them by as much as
            the margin. Their distances, and so clearances, count from two margins beneath their surface.
            In a simulation with contact, touching them is no fault.
        carried: how the arm carries obstacles, by name. These are parts of the arm: they keep clear of all
            other obstacles, and of the arm up to the frame that carries them. What lies beyond it holds them.
    """

    _first: ClassVar[Scene | None] = None  # of a scene that is another one at some moment
    obstacles: Annotated[Mapping[str, ObstacleField], _ReadOnly, _Named] = field(default_factory=dict)
    self_collision: Flag = True
    margin: Annotated[float, CheckedBy(partial(length, zero=True), "length")] = USUAL_MARGIN
    arm_radius: Size | None = None
    velocities: Annotated[_Velocities, AfterValidator(_require_known_names), _ReadOnly] = field(
        default_factory=dict
    )
    touchable: Annotated[Sequence[str], CheckedBy(as_names), AfterValidator(_require_known)] = ()
    carried: Annotated[Mapping[str, Carried], AfterValidator(_require_carriable), _ReadOnly, _Named] = field(
        default_factory=dict
    )

    @classmethod
    def check_keys(cls, values: Mapping[str, Any]) -> tuple[str, ...]:
        """Return the keys of its table."""
        return ("version", *(item.name for item in fields(cls)))

    @classmethod
    def from_table(cls, values: Mapping[str, Any], source: InputFile) -> dict[str, Any]:
        """Return the values of fields, without the version of the format."""
        version = values.get("version", VERSION)
        if isinstance(version, bool) or version != VERSION:
            raise NotAllowed(version, str(VERSION), "version")
        return {key: value for key, value in values.items() if key != "version"}

    def to_table(self, file: OutputFile) -> dict[str, Any]:
        """Return the table: the file of the scene if it is known, or its content."""
        known: dict[str, Any] | None = file.find(self, SceneField)
        return known or {"margin": self.margin, **self.written(file)}

    @cached_property
    def _hash(self) -> int:
        return hash(self._key())

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
        """Names of the obstacles that have been moved or have a velocity, and of maps."""
        before = self.first.obstacles
        changing = (name for name, obstacle in self.obstacles.items() if before[name] is not obstacle)
        return frozenset(changing) | {*self.velocities, *self.maps}

    @cached_property
    def maps(self) -> frozenset[str]:
        """Names of the obstacles that are cells of maps."""
        return frozenset(
            name for name, obstacle in self.first.obstacles.items() if isinstance(obstacle, Cells)
        )

    def moved(
        self,
        placements: Mapping[str, pin.SE3 | ArrayLike],
        velocities: Mapping[str, Twist] | None = None,
    ) -> Scene:
        """Return the scene with some obstacles moved.

            scene = scene.moved({"person": (0.5, y, 0.0)}, velocities={"person": (0.0, 0.2, 0.0)})

        Args:
            placements: displacements relative to the first scene, by obstacle name: a `pin.SE3`, or a
                translation, (3,) [m]. For an obstacle described in its own frame, it places that frame.
            velocities: as the attribute; obstacles without one stand still, except that a `Tracker` takes
                their velocities from the scenes that it gets.

        Returns:
            A scene in which all other obstacles stay where they are in this scene.

        Raises:
            UnknownName: an unknown obstacle.
            InvalidValue: an invalid placement or velocity.
        """
        first = self.first
        obstacles = dict(self.obstacles)
        require_instance("placements", placements, Mapping, "a mapping from names of obstacles")
        for name, placement in placements.items():
            require_known("obstacle", name, first.obstacles)
            if isinstance(placement, pin.SE3):
                motion = placement
            else:
                allowed = "a pin.SE3 (of a matrix: pin.SE3(matrix)), or three finite numbers [m]"
                motion = pin.SE3(np.eye(3), np.array(point(f"placements[{name!r}]", placement, allowed)))
            obstacles[name] = displaced(first.obstacles[name], motion)
        speeds = {} if velocities is None else read_plain(_Velocities, velocities, "velocities")
        for name in speeds:
            require_known("obstacle", name, obstacles)
        return self._at_moment(obstacles, speeds)

    def updated(self, maps: Mapping[str, Cells]) -> Scene:
        """Return the scene with the latest cells of maps.

            scene = scene.updated({"map": mapped.cells})

        It is the same scene at another moment, as from `moved`, and made as quickly: what distances need is
        made with the cells.

        Args:
            maps: the cells by the names that those of these maps have in the first scene.

        Raises:
            UnknownName: an unknown map.
            InvalidValue: no cells, or those of a map of another resolution.
        """
        require_instance("maps", maps, Mapping, "a mapping from names of maps")
        obstacles = dict(self.obstacles)
        for name, cells in maps.items():
            require_known("map", name, self.maps)
            require_instance(f"maps[{name!r}]", cells, Cells, "the cells of a map")
            size = self.first.obstacles[name].point_radius
            if cells.point_radius != size:
                text = f"cells with a radius of {length_text(cells.point_radius)}"
                raise InvalidValue(f"maps[{name!r}]", text, f"a radius of {length_text(size)}, as at first")
            obstacles[name] = cells
        return self._at_moment(obstacles, dict(self.velocities))

    def has_maps_of(self, before: Scene | None) -> bool:
        """Return whether maps are as they were at another moment of the same scene."""
        if not self.maps or before is self:
            return True
        if before is None or before.maps != self.maps:
            return False
        return all(self.obstacles[name] is before.obstacles[name] for name in self.maps)

    def after(self, time: float) -> Scene:
        """Return the scene after a time [s] in which obstacles keep their velocities.

        Raises:
            InvalidValue: the time is negative or not finite.
        """
        require_positive("time", time, zero=True)
        obstacles = dict(self.obstacles)
        for name, velocity in self.velocities.items():
            linear, angular = split_velocity(velocity)
            middle = obstacles[name].pose(np.zeros(3)).translation
            turn = pin.exp3(time * angular)
            obstacles[name] = displaced(
                obstacles[name], pin.SE3(turn, middle + time * linear - turn @ middle)
            )
        return self._at_moment(obstacles, dict(self.velocities))

    def displacement(self, before: Scene, reach: float) -> float:
        """Return how far obstacles are from where they were at another moment of the same scene [m].

        Args:
            before: a scene that `moved` or `after` derived from the same first one; infinity otherwise, and
                if a map has other cells.
            reach: distance from the middle of an obstacle at which its rotation counts [m].

        Raises:
            InvalidValue: no scene, or no length.
        """
        require_instance("before", before, Scene, "a Scene(...)")
        require_positive("reach", reach, zero=True)
        if before.first != self.first:
            return math.inf
        farthest = 0.0
        for name, obstacle in self.obstacles.items():
            there = before.obstacles[name]
            if obstacle is not there:
                if name in self.maps and obstacle.content[0] is not there.content[0] and obstacle != there:
                    return math.inf
                motion = there.pose(np.zeros(3)).actInv(obstacle.pose(np.zeros(3)))
                turned = float(np.linalg.norm(pin.log3(motion.rotation)))
                farthest = max(farthest, float(np.linalg.norm(motion.translation)) + reach * turned)
        return farthest

    def depth(self, name: str) -> float:
        """Return how far beneath its surface the distance from an obstacle counts [m].

        Returns:
            0, or two margins if the arm may touch it.

        Raises:
            UnknownName: an unknown obstacle.
        """
        require_known("obstacle", name, self.obstacles)
        return 2.0 * self.margin if name in self.touchable else 0.0

    @property
    def standing(self) -> dict[str, Obstacle]:
        """The obstacles that the arm does not carry, by name."""
        return {name: obstacle for name, obstacle in self.obstacles.items() if name not in self.carried}

    def with_obstacles(self, obstacles: Mapping[str, Obstacle]) -> Scene:
        """Return the scene with other obstacles, which stand still.

        Args:
            obstacles: the obstacles by name; those that are touchable or carried now stay so.

        Raises:
            InvalidValue: not obstacles by name.
        """
        require_instance("obstacles", obstacles, Mapping, "a mapping from names of obstacles")
        touchable = tuple(name for name in self.touchable if name in obstacles)
        carried = carried_among(self.carried, obstacles)
        return replace(self, obstacles=obstacles, velocities={}, touchable=touchable, carried=carried)

    def without_obstacles(self) -> Scene:
        """Return the scene without obstacles: the arm has only itself to keep clear of."""
        return self.with_obstacles({})

    def without_self_collision(self) -> Scene:
        """Return the scene with self-collision disabled."""
        if not self.self_collision:
            return self
        other = replace(self, self_collision=False)
        if self._first is not None:
            set_fields(other, _first=replace(self._first, self_collision=False))
        return other

    def _at_moment(self, obstacles: dict[str, Obstacle], velocities: dict[str, Twist]) -> Scene:
        """Return the scene at another moment, without a check: that of many obstacles takes long."""
        other = object.__new__(type(self))
        other.__dict__.update({item.name: getattr(self, item.name) for item in fields(self)})
        set_fields(other, obstacles=MappingProxyType(obstacles), velocities=MappingProxyType(velocities))
        set_fields(other, _first=self.first)
        return other

    def to_dict(self, embed: bool = True) -> dict[str, Any]:
        """Return the scene as JSON-compatible data.

        Args:
            embed: whether to include the points of meshes and scans from files, rather than their paths.
        """
        table = as_plain(self, embed)
        return {"version": VERSION, "self_collision": self.self_collision, **table}

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
        scene: Scene = read_plain(cls, described, folder=folder)
        return scene

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a scene from a TOML or JSON file; both have the keys of `to_dict`.

        Lengths and angles may be text with a unit, such as "25 mm". A `PostureWarning` reports a file without
        obstacles that does not set self-collision either.

        Paths of meshes and scans are relative to the folder of the file.

        Raises:
            FileError: missing, unreadable, malformed, or not a scene; names the line, or key and allowed
                values.
        """
        document = Document.load(Path(path))
        scene: Scene = document.read(cls, ())
        if not scene.obstacles and "self_collision" not in document.values:
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
        table = self.to_table(InFolder(path.parent))
        described = {"version": VERSION, "self_collision": self.self_collision, **table}
        text = json.dumps(plain_data(described, path.parent), allow_nan=False, indent=1)
        write_text(path, text + "\n")
        return path

    def __repr__(self) -> str:
        named = ", ".join(self.obstacles) or "no obstacles"
        if len(self.obstacles) > 8:
            first, *_, last = self.obstacles
            named = f"{len(self.obstacles)} obstacles, {first} to {last}"
        itself = "" if self.self_collision else ", self-collision off"
        touchable = f", touchable: {', '.join(self.touchable)}" if self.touchable else ""
        carried = f", carried: {', '.join(self.carried)}" if self.carried else ""
        return f"Scene({named}{itself}, margin={self.margin:g}{touchable}{carried})"

    def __eq__(self, other: object) -> bool:
        if not isinstance(other, Scene):
            return NotImplemented
        return self is other or (self._hash == other._hash and self._key() == other._key())

    def __hash__(self) -> int:
        return self._hash

    def __reduce__(self) -> tuple[Any, ...]:
        values: dict[str, Any] = {item.name: getattr(self, item.name) for item in fields(self)}
        values |= {name: dict(values[name]) for name in ("obstacles", "velocities", "carried")}
        return Scene, tuple(values.values()), {"_first": self._first}

    def _key(self) -> tuple[Any, ...]:
        obstacles = frozenset(self.obstacles.items())
        velocities = frozenset(self.velocities.items())
        carried = frozenset(self.carried.items())
        settings = self.self_collision, self.margin, self.arm_radius
        return obstacles, velocities, *settings, self.touchable, carried


def _read_scene(value: object, info: ValidationInfo) -> Scene | None:
    """Read a scene of a task: a table with its file, or with its content; None for an empty one."""
    source = in_file(info)
    if value is None or isinstance(value, Scene):
        return value
    if source is None:
        raise NotAllowed(value, "a Scene, or None")
    if isinstance(value, Mapping) and "file" in value:
        name = read_keys(value, ("file",))["file"]
        if not is_text(name):
            raise NotAllowed(name, "text", "file")
        path = read_within("file", source.resolve, name)
        with refusing(key="file"):
            scene = Scene.load(path)
        source.described[scene] = {"file": settled(path)}
        return scene
    return None if value == {} else read_again(Scene, value, source)


SceneField: TypeAlias = Annotated[Scene | None, read_by(_read_scene)]
"""A scene, in a call and in a task file."""


def obstacles_around(scene: Scene, point: ArrayLike, depth: float = 1e-4) -> tuple[str, ...]:
    """Return the names of the obstacles that contain a point, but for those that the arm carries.

    Args:
        scene: the scene.
        point: the point, (3,) [m], world frame.
        depth: depth below the surface from which it counts as inside [m].
    """
    radius = 1e-6  # of the sphere that represents the point [m]
    return obstacles_near(scene, point, radius, -depth - radius)


def obstacles_near(scene: Scene, center: ArrayLike, radius: float, within: float = 0.0) -> tuple[str, ...]:
    """Return the names of the obstacles within a distance of a sphere, but for those that the arm carries.

    Args:
        scene: the scene.
        center: centre of the sphere, (3,) [m], world frame.
        radius: radius of the sphere [m].
        within: the distance between the surfaces [m].
    """
    x, y, z = np.array(center, dtype=np.float64)
    named = [
        (name, solid) for name, obstacle in scene.standing.items() for solid in obstacle.geometry.solids()
    ]
    pairs = [(0, 1 + k) for k in range(len(named))]
    distances = PairDistances([Sphere((x, y, z), radius).solid()], [0], [solid for _, solid in named], pairs)
    near = distances.near(JointFrames(np.eye(3)[None, None], np.zeros((1, 1, 3))), within)
    return tuple(dict.fromkeys(named[k][0] for k in np.sort(distances.second[near.pairs] - 1)))
