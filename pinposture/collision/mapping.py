"""Maps: what depth cameras and laser scanners see, in the cells of a grid, while the arm moves."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any, Literal, NamedTuple, TypeAlias, cast

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture import kernels
from pinposture._validation import (
    as_floats,
    finite_array,
    is_number,
    length,
    point,
    require_instance,
    require_known,
    require_positive,
    rigid_placement,
)
from pinposture.arm import Arm
from pinposture.collision.bodies import bodies_of
from pinposture.collision.distances import TreeKinematics
from pinposture.collision.model import CollisionObjects, stationary_ends
from pinposture.collision.scan import Cells
from pinposture.errors import InvalidValue
from pinposture.kernels.arrays import OccupancyGrid
from pinposture.kernels.occupancy import OCCUPANCY

Array = NDArray[np.float64]
Unknown: TypeAlias = Literal["free", "forbidden"]


class MapSettings(NamedTuple):
    """How far a map reaches, and what it keeps."""

    max_cells: int = 2**28
    """Largest number of cells of a grid. Memory is used only for blocks that rays have reached: 4 kB
    each, and a bit for each cell."""

    reach: float = 1.2
    """Distance from the base up to which a map reaches, in lengths of the arm: what is farther away cannot
    be near the arm, but for thick ends."""

    cell: float = 0.02
    """Edge length of cells, in lengths of the arm, unless it is given."""

    rescaled: float = 1e6
    """Scale of evidence at which it is made 1 again, far below what single precision holds."""

    mount: float = 3.0
    """Distance from where the arm is mounted within which points are left out, beside the radius of the
    body there and `own_margin`, in cells: the balls of cells reach 1.73 cells beyond a point, and the
    margin of a scene comes on top."""

    measured: int = 500
    """Number of measured configurations that are kept: 5 s of a loop at 100 Hz, far longer than pictures
    take."""

    fewest: int = 20_000
    """Cells for which there is room at first when those on surfaces are listed."""

    far: float = 1e3
    """Depth that an infinite one stands for [m], which is beyond every grid that fits into memory."""


MAPPING = MapSettings()


SEEN = "seen by cameras"
"""Name of a map among the obstacles of a scene."""


class Intrinsics(NamedTuple):
    """How a depth camera projects: pixel = focal length * direction / depth + centre.

    Attributes:
        fx: focal length along columns [pixels].
        fy: focal length along rows [pixels].
        cx: column of the optical axis [pixels]; 0 is the middle of the first one.
        cy: row of the optical axis [pixels].
    """

    fx: float
    fy: float
    cx: float
    cy: float


class Mounting(NamedTuple):
    """Where a sensor is mounted on an arm.

    Attributes:
        frame: name of the link or other frame of the arm's description.
        placement: the frame of the sensor in it, a `pin.SE3`. That of a camera has x to the right, y down,
            and z along the optical axis.
    """

    frame: str
    placement: pin.SE3


class MapContent(NamedTuple):
    """What a map knows, for files.

    Attributes:
        cells: coordinates of the cells that are not unknown, (k, 3).
        evidence: their evidence, (k,): -1 for free ones; see `Map`.
        time: the time of the map [s].
    """

    cells: NDArray[np.int64]
    evidence: Array
    time: float


class Map:
    """A map of what sensors see around an arm, which grows while it moves.

        mapped = pp.Map(0.01, arm)
        scene = pp.Scene({"map": mapped.cells}, margin=0.01)
        mapped.measure(q, time)                          # in the control loop
        mapped.add_depth(depth, camera, mounting, time)  # in a thread of its own, for each picture
        dq = tracker.step(q, scene=scene.updated({"map": mapped.cells}))

    The grid is a cube. A cell in which something is seen is occupied at once, and gains evidence with each
    picture, up to 4. A picture that sees through it takes 1 away; a cell with at most 0.5 left is free. So a
    thing that has gone is gone after 4 pictures at most. Evidence decays with the time constant `forget`;
    what has not been seen again for `forget * log(2 * evidence)` seconds is unknown. Free cells stay free.

    Points on the measured arm, or within `own_margin` of it, are left out, and so are those around where it
    is mounted. Cells whose centre the measured arm covers are free. A body that is no sphere or capsule
    counts as the capsule around it.

    One thread adds what sensors see; others may read `cells`, an immutable obstacle, and call `measure`.
    There is no lock.

    Args:
        resolution: edge length of a cell [m].
        arm: the arm whose points are left out; None: none.
        center: middle of the grid, (3,) [m], world frame; None: the base of the arm, or the origin.
        reach: half the edge length of the grid [m]; None: 1.2 lengths of the arm, and as much of the travel
            of its slides, if that has limits. At least as much is taken as gives whole blocks of 8 cells.
        own_margin: distance from the measured arm within which points are its own [m]: noise of the sensor,
            and errors of the measured posture and of the shape of the arm. None: a cell.
        forget: time constant with which evidence decays [s]; infinite: nothing is forgotten.
        unknown: whether cells in which nothing has been seen are "free" to move in, or "forbidden". Then
            `clear` tells what is free around the arm at first.
        sensor_range: smallest and largest distance at which a sensor sees something [m]. Farther points only
            make cells free.
        content: what it knows at first; None: nothing.

    Attributes:
        cells: what the arm has to keep clear of, at the time of the map.
        time: the latest time of a picture [s].

    Raises:
        InvalidValue: an invalid argument, or more than 268 million cells.
    """

    def __init__(
        self,
        resolution: float,
        arm: Arm | None = None,
        *,
        center: ArrayLike | None = None,
        reach: float | None = None,
        own_margin: float | None = None,
        forget: float = math.inf,
        unknown: Unknown = "free",
        sensor_range: ArrayLike = (0.0, math.inf),
        content: MapContent | None = None,
    ) -> None:
        require_instance("arm", arm, Arm | None, "an Arm, or None")
        require_known("unknown", unknown, ("free", "forbidden"))
        require_instance("content", content, MapContent | None, "a MapContent, or None")
        self.arm = arm
        self.resolution = length("resolution", resolution)
        self.unknown = unknown
        self.own_margin = self.resolution if own_margin is None else length("own_margin", own_margin, True)
        if forget != math.inf:
            require_positive("forget", forget)
        self.forget = float(forget)
        self.sensor_range = _sensor_range(sensor_range)
        if center is None:
            center = (0.0, 0.0, 0.0) if arm is None else arm.base_placement.translation
        self.center = point("center", np.array(center))
        if reach is None:
            if arm is None:
                raise InvalidValue("reach", None, "half the width of the map [m], for a map without an arm")
            reach = MAPPING.reach * (arm.length + (arm.travel if math.isfinite(arm.travel) else 0.0))
        self.reach = length("reach", reach)
        self._grid = self._make_grid()
        self._own = None if arm is None else _OwnBodies(arm, self.own_margin, MAPPING.mount * self.resolution)
        self._pictures = 0
        self._found = 0
        self._scaled_at = 0.0
        self._history: tuple[tuple[float, Array], ...] = ()
        self.time = 0.0
        if content is not None:
            self._take(content)
        self._publish()

    def _make_grid(self) -> OccupancyGrid:
        across = 2.0 * self.reach / (OCCUPANCY.edge * self.resolution)
        if across > MAPPING.max_cells:
            raise InvalidValue("reach", self.reach, f"less at a resolution of {self.resolution:g} m")
        blocks = math.ceil(across * (1.0 - 1e-12))
        count = blocks**3 * OCCUPANCY.cells
        if count > MAPPING.max_cells:
            least = 2.0 * self.reach / MAPPING.max_cells ** (1.0 / 3.0)
            allowed = f"at least {least:.2g} m with a reach of {self.reach:g} m"
            raise InvalidValue("resolution", self.resolution, allowed)
        corner = np.array(self.center) - 0.5 * blocks * OCCUPANCY.edge * self.resolution
        return OccupancyGrid(
            corner=corner,
            resolution=self.resolution,
            blocks=blocks,
            evidence=np.zeros(count, dtype=np.float32),
            marks=np.zeros(count, dtype=np.int32),
            bits=np.zeros(count // 64, dtype=np.uint64),
            used=np.zeros(blocks**3, dtype=np.int8),
        )

    def __repr__(self) -> str:
        width = OCCUPANCY.edge * self._grid.blocks * self.resolution
        cells = len(self.cells.points)
        size = f"{width:.3g} m in cells of {self.resolution:g} m"
        return f"Map({size}, {cells} on surfaces, unknown is {self.unknown})"

    # What is measured

    def measure(self, q: ArrayLike, time: float) -> None:
        """Keep a measured configuration, for pictures taken about that time; from any one thread.

        Args:
            q: the measured configuration, (nq,) [rad or m].
            time: when it was measured [s]; later than those before.

        Raises:
            InvalidValue: a map without an arm, an invalid configuration, or a time that is not later.
        """
        arm = self._require_arm()
        measured = arm.checked(q)
        when = _time(time)
        if self._history and when <= self._history[-1][0]:
            raise InvalidValue("time", when, f"more than {self._history[-1][0]!r}, that of the last one")
        self._history = (*self._history[1 - MAPPING.measured :], (when, measured))

    def configuration_at(self, time: float) -> Array:
        """Return the measured configuration at a time, interpolated between those around it, (nq,).

        Args:
            time: the time [s].

        Raises:
            InvalidValue: a map without an arm, or a time before the first or after the last one that was
                measured.
        """
        arm = self._require_arm()
        when = _time(time)
        history = self._history
        if not history or not history[0][0] <= when <= history[-1][0]:
            known = "none" if not history else f"from {history[0][0]!r} to {history[-1][0]!r}"
            raise InvalidValue("time", when, f"a time at which the arm is measured: {known}")
        times = [time for time, _ in history]
        after = int(np.searchsorted(times, when))
        later, end = history[after]
        if later == when:
            return np.array(end)
        earlier, start = history[after - 1]
        share = (when - earlier) / (later - earlier)
        return arm.integrate(start, share * arm.difference(start, end))

    def sensor_placement(self, mounting: Mounting, q: ArrayLike) -> pin.SE3:
        """Return the placement of a mounted sensor at a configuration (nq,), world frame.

        Raises:
            InvalidValue: a map without an arm, or an invalid mounting or configuration.
            UnknownName: no such frame.
        """
        arm = self._require_arm()
        require_instance("mounting", mounting, Mounting, "a Mounting(frame, placement)")
        placement = rigid_placement("placement", mounting.placement)
        kinematics = cast(_OwnBodies, self._own).kinematics
        return kinematics.frame_pose(arm.checked(q), mounting.frame) * placement

    def add_cloud(
        self,
        points: ArrayLike,
        sensor: pin.SE3 | Mounting | None,
        time: float,
        q: ArrayLike | None = None,
    ) -> int:
        """Add a cloud of points.

        Args:
            points: the points, (m, 3) [m], in the frame of the sensor; those that are not finite are missing.
            sensor: its placement, world frame, or its mounting on the arm. None: the points are in the world
                frame, and it is not known from where they were seen: they make no cell free.
            time: when they were measured [s].
            q: the configuration of the arm at that time, (nq,); None: as it was measured, interpolated.

        Returns:
            Number of points that were left out as the arm's own. Of points in one cell, those after the
            first that counts are not looked at.

        Raises:
            InvalidValue: an invalid argument, or a time at which the arm has not been measured.
            UnknownName: no such frame.
        """
        cloud = as_floats("points", points, "points, (m, 3) [m]")
        if cloud.ndim != 2 or cloud.shape[1] != 3:
            raise InvalidValue("points (shape)", cloud.shape, "(m, 3)")
        cloud = cloud[np.isfinite(cloud).all(axis=1)]
        when = _time(time)
        measured = self._measured(when, q)
        if sensor is None:
            return self._add(cloud, None, when, measured)
        placement = self._placement(sensor, measured)
        placed = cloud @ placement.rotation.T + placement.translation
        return self._add(np.ascontiguousarray(placed), np.array(placement.translation), when, measured)

    def add_depth(
        self,
        depth: ArrayLike,
        camera: Intrinsics,
        sensor: pin.SE3 | Mounting,
        time: float,
        q: ArrayLike | None = None,
    ) -> int:
        """Add a depth image.

        Args:
            depth: depth along the optical axis, (h, w) [m]; as in ROS (REP 118), NaN or 0 where it is
                missing, infinite where all is free up to the range of the sensor.
            camera: how the camera projects.
            sensor: the placement of the camera, world frame, or its mounting on the arm; x to the right, y
                down, z along the optical axis.
            time: when it was taken [s].
            q: as for `add_cloud`.

        Returns:
            As `add_cloud`.

        Raises:
            InvalidValue: an invalid argument, or a time at which the arm has not been measured.
            UnknownName: no such frame.
        """
        image = np.ascontiguousarray(as_floats("depth", depth, "depths, (h, w) [m]"))
        if image.ndim != 2:
            raise InvalidValue("depth (shape)", image.shape, "(h, w)")
        require_instance("camera", camera, Intrinsics, "Intrinsics(fx, fy, cx, cy)")
        focal = finite_array("focal lengths", camera[:2], (2,))
        if not np.all(focal > 0.0):
            raise InvalidValue("camera", camera, "focal lengths above 0")
        axis = finite_array("centre of the image", camera[2:], (2,))
        when = _time(time)
        measured = self._measured(when, q)
        placement = self._placement(sensor, measured)
        origin = np.array(placement.translation)
        rotation = np.ascontiguousarray(placement.rotation)
        points = np.empty((image.size, 3))
        kernels.place_pixels(image, focal, axis, rotation, origin, MAPPING.far, points)
        return self._add(points, origin, when, measured)

    def clear(self, q: ArrayLike, distance: float) -> None:
        """Tell that the surroundings of the arm are free, as a person sees.

        Args:
            q: a configuration, (nq,).
            distance: how far around the bodies of the arm there all cells are free [m].

        Raises:
            InvalidValue: a map without an arm, or an invalid argument.
        """
        measured = self._require_arm().checked(q)
        lines, radii = cast(_OwnBodies, self._own).covered(measured)
        kernels.clear_capsules(self._grid, lines, radii + length("distance", distance, zero=True))
        self._publish()

    def advance(self, time: float) -> None:
        """Forget what has not been seen again by a time [s], when no picture comes.

        Raises:
            InvalidValue: not a time.
        """
        self.time = max(self.time, _time(time))
        self._publish()

    # What is known

    def states(self, points: ArrayLike) -> NDArray[np.int64]:
        """Return what is known of the cells that contain points.

        Args:
            points: the points, (m, 3) [m], world frame.

        Returns:
            1 for occupied, -1 for free, 0 for unknown, and outside the map, (m,).

        Raises:
            InvalidValue: not finite points.
        """
        located = finite_array("points", points, (None, 3))
        states = np.empty(len(located), dtype=np.int64)
        kernels.read_cells(self._grid, self._scale, located, states)
        return states

    @property
    def content(self) -> MapContent:
        """What the map knows, for files."""
        grid = self._grid
        self._rescale()
        blocks = np.flatnonzero(grid.used)
        evidence = grid.evidence.reshape(-1, OCCUPANCY.cells)[blocks]
        which, inner = np.nonzero(evidence)
        n = grid.blocks
        block = blocks[which]
        corners = np.column_stack([block // (n * n), block // n % n, block % n])
        cells = OCCUPANCY.edge * corners + np.column_stack([inner >> 6, inner >> 3 & 7, inner & 7])
        return MapContent(cells, evidence[which, inner].astype(np.float64), self.time)

    def _take(self, content: MapContent) -> None:
        """Take what a file tells."""
        grid = self._grid
        size = OCCUPANCY.edge * grid.blocks
        cells = np.asarray(content.cells)
        evidence = finite_array("evidence", content.evidence) if len(cells) else np.zeros(0)
        if cells.shape != (len(evidence), 3) or cells.dtype.kind != "i":
            raise InvalidValue("cells (shape)", cells.shape, f"whole numbers, ({len(evidence)}, 3)")
        if len(cells) and not (cells.min() >= 0 and cells.max() < size):
            raise InvalidValue("cells", int(cells.max()), f"coordinates from 0 to {size - 1}")
        within = (evidence == OCCUPANCY.free) | ((evidence > 0.0) & (evidence <= OCCUPANCY.full))
        if not np.all(within):
            allowed = f"{OCCUPANCY.free:g}, or more than 0 and at most {OCCUPANCY.full:g}"
            raise InvalidValue("evidence", float(evidence[~within][0]), allowed)
        x, y, z = (cells >> 3).T
        blocks = (x * grid.blocks + y) * grid.blocks + z
        x, y, z = (cells & 7).T
        grid.evidence[blocks * OCCUPANCY.cells + (x << 6) + (y << 3) + z] = evidence
        grid.used[blocks] = 1
        self.time = self._scaled_at = _time(content.time)

    def _require_arm(self) -> Arm:
        if self.arm is None:
            raise InvalidValue("arm", None, "a map that knows the arm: Map(resolution, arm)")
        return self.arm

    def _measured(self, time: float, q: ArrayLike | None) -> Array | None:
        """Return the configuration at a time, given or interpolated; None without an arm."""
        if self.arm is None:
            if q is not None:
                raise InvalidValue("q", q, "None for a map without an arm")
            return None
        return self.configuration_at(time) if q is None else self.arm.checked(q)

    def _placement(self, sensor: pin.SE3 | Mounting, measured: Array | None) -> pin.SE3:
        if not isinstance(sensor, Mounting):
            require_instance("sensor", sensor, pin.SE3, "a pin.SE3, world frame, or a Mounting(...)")
            return rigid_placement("sensor", sensor)
        return self.sensor_placement(sensor, cast(Array, measured))

    def _add(self, points: Array, origin: Array | None, time: float, q: Array | None) -> int:
        """Add points, (m, 3) [m], seen from an origin, (3,) [m]; both in the world frame."""
        grid = self._grid
        self.time = max(self.time, time) if self._pictures or self.time else time
        if self._scale > MAPPING.rescaled:
            self._rescale()
        lines = np.zeros((0, 2, 3))
        radii = np.zeros(0)
        if q is not None:
            lines, radii = cast(_OwnBodies, self._own).ignored(q)
        self._pictures += 1
        passes = origin is not None
        begin = np.array(self.center) if origin is None else origin
        limits = np.array(self.sensor_range if passes else (0.0, math.inf))
        own: int = kernels.cast_rays(
            grid, self._pictures, self._scale, begin, points, limits, passes, lines, radii
        )
        if q is not None:
            lines, radii = cast(_OwnBodies, self._own).covered(q)
            kernels.clear_capsules(grid, lines, radii)
        self._publish()
        return own

    @property
    def _scale(self) -> float:
        """The number by which evidence is multiplied now."""
        return math.exp(min((self.time - self._scaled_at) / self.forget, 80.0))

    def _rescale(self) -> None:
        """Make the scale of evidence 1."""
        kernels.forget_cells(self._grid, self._scale)
        self._scaled_at = self.time

    def _publish(self) -> None:
        """Replace `cells` by those of now."""
        if self._scale > MAPPING.rescaled:
            self._rescale()
        self._pictures += 1
        forbidden = self.unknown == "forbidden"
        room = max(MAPPING.fewest, 2 * self._found)
        while True:
            centers = np.empty((room, 3))
            count = kernels.find_surface(self._grid, self._pictures, self._scale, forbidden, centers)
            if count <= room:
                break
            room = count
            self._pictures += 1
        self._found = count
        self.cells = Cells.of(centers[:count].copy(), self.resolution)


class _OwnBodies:
    """The bodies of an arm as capsules, at its measured configurations.

    Attributes:
        kinematics: that of the arm.

    Args:
        arm: the arm.
        margin: distance within which points are its own [m].
        mount: further distance from where it is mounted [m].
    """

    def __init__(self, arm: Arm, margin: float, mount: float) -> None:
        kinematics = TreeKinematics(arm.model)
        bodies = bodies_of(arm)
        solids = [body.shape.solid().turned(kinematics.turns[body.joint]) for body in bodies]
        self.kinematics = kinematics
        self._margin = margin
        self._joints = np.array([body.joint for body in bodies], dtype=np.int64)
        self._local = np.array([[solid.start, solid.end] for solid in solids]).reshape(-1, 2, 3)
        self._radii = np.array([solid.radius for solid in solids])
        objects = CollisionObjects(arm, kinematics, self._joints.tolist(), solids, (), (), len(solids))
        ends = stationary_ends(objects)
        self._ends = np.array([[point, point] for _, point in ends]).reshape(-1, 2, 3)
        self._end_radii = np.array([self._radii[body] + margin + mount for body, _ in ends])

    def covered(self, q: Array) -> tuple[Array, Array]:
        """Return axes, (b, 2, 3) [m], and radii, (b,) [m], of capsules around the bodies; world frame."""
        placements = self.kinematics.place(q)
        axes = np.empty((1, *self._local.shape))
        kernels.place_axes(self._joints, self._local, placements.rotations, placements.origins, axes)
        return axes[0], self._radii

    def ignored(self, q: Array) -> tuple[Array, Array]:
        """Return capsules as `covered`, within which points are left out."""
        axes, radii = self.covered(q)
        return np.concatenate([axes, self._ends]), np.append(radii + self._margin, self._end_radii)


def _time(value: Any) -> float:
    if not (is_number(value) and -1e12 <= value <= 1e12):
        raise InvalidValue("time", value, "a finite number of seconds")
    return float(value)


def _sensor_range(value: ArrayLike) -> tuple[float, float]:
    allowed = "smallest and largest distance [m], at least 0 and increasing; the largest may be infinite"
    near_far: Sequence[Any] = as_floats("sensor_range", value, allowed).tolist()
    if not (isinstance(near_far, list) and len(near_far) == 2 and 0.0 <= near_far[0] < near_far[1]):
        raise InvalidValue("sensor_range", value, allowed)
    return near_far[0], near_far[1]
