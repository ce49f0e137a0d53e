"""Contact in the simulation: shapes of the arm and of obstacles in MuJoCo, forces, first touch, slip.

The arm collides with the same bodies as in `CollisionModel`, and the same pairs are left out: neighbours, and
bodies that always touch. Obstacles of the scene stand still, or are free if they have a mass.

Contacts are those of MuJoCo: surfaces yield a little, the penetration decays like a damped oscillator, and
friction keeps within a circular cone.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property, partial
from itertools import combinations, product
from typing import Annotated, Any, NamedTuple

import coal
import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture._validation import (
    make_read_only,
    require_instance,
    require_known,
    require_name,
    require_positive,
)
from pinposture.arm import Arm
from pinposture.arm.mjcf import load_mujoco
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.bodies import solid_inertia
from pinposture.collision.model import Pair
from pinposture.collision.shapes import Described
from pinposture.collision.solids import Solid
from pinposture.errors import InvalidValue
from pinposture.schema import CheckedBy, Declared, Duration, declared

Array = NDArray[np.float64]


class NamePrefixes(NamedTuple):
    """How names in the MuJoCo model begin."""

    arm: str = "arm"
    """Those of shapes of the arm."""

    obstacle: str = "obstacle"
    """Those of obstacles."""

    free: str = "free"
    """Those of joints of free obstacles."""


PREFIX = NamePrefixes()


def _as_masses(name: str, value: Any) -> dict[str, float]:
    require_instance(name, value, Mapping, "a mapping from names of obstacles to masses [kg]")
    return {
        require_name("name of an obstacle", key): require_positive(f"{name}[{key!r}]", mass)
        for key, mass in value.items()
    }


@declared()
class ContactModel(Declared):
    """How the arm, the obstacles of a scene and free objects touch each other in a simulation.

        contact = sim.ContactModel(friction=0.6, masses={"can": 0.3})
        ended = sim.simulate(arm, run, scene=scene, contact=contact)

    The defaults of friction, time constant and damping are those of MuJoCo. What the arm may touch is said by
    the scene (`touchable`).

    Attributes:
        friction: coefficient of sliding friction between all surfaces.
        time_constant: time in which a penetration decays, the softness of surfaces [s]; at least two physics
            steps (`Servos.timestep`), or MuJoCo takes these.
        damping: damping ratio of that; 1 is critical, less bounces.
        masses: masses of the obstacles that are free to move, by name [kg]; all others stand still. They are
            of uniform density and at rest at first.

    Raises:
        InvalidValue: a number that is not positive (friction: negative), or not a mapping from names.
    """

    friction: Annotated[float, CheckedBy(partial(require_positive, zero=True))] = 1.0
    time_constant: Duration = 0.02
    damping: Annotated[float, CheckedBy(require_positive)] = 1.0
    masses: Annotated[dict[str, float], CheckedBy(_as_masses)] = field(default_factory=dict)


class ContactEvent(NamedTuple):
    """A contact of two things in a simulation, from the first touch to the end.

    Attributes:
        pair: names of a body of the arm and what it touched, or of an obstacle and what that touched.
        time: when they first touched [s].
        speed: how fast they then came together [m/s].
        force: the largest force between them, friction included [N].
        slip: how far they slid on each other [m].
    """

    pair: Pair
    time: float
    speed: float
    force: float
    slip: float

    def __str__(self) -> str:
        first, second = self.pair
        how = f"at {self.speed:.3g} m/s, up to {self.force:.3g} N"
        return f"{first} touches {second} at {self.time:.4g} s ({how})"


@dataclass(frozen=True, eq=False)
class ContactHistory:
    """The contacts of a simulation, with a row for its start and for each cycle.

    Attributes:
        model: how things touch.
        pairs: names of what touched, in order of the first touch.
        own: names of the bodies of the arm.
        touchable: names of the obstacles that the arm may touch.
        begins: when each pair first touched, (p,) [s].
        speeds: how fast it then came together, (p,) [m/s].
        peaks: the largest force in a physics step, (p,) [N].
        forces: mean force on the first of a pair in a cycle, (N, p, 3) [N], world axes.
        slips: how far surfaces slid on each other since the start, (N, p) [m].
        displacements: displacements of the free obstacles since the start, as homogeneous matrices, in the
            order of `model.masses`, (N, k, 4, 4), world frame.
    """

    model: ContactModel
    pairs: tuple[Pair, ...]
    own: tuple[str, ...]
    touchable: tuple[str, ...]
    begins: Array
    speeds: Array
    peaks: Array
    forces: Array
    slips: Array
    displacements: Array

    def __post_init__(self) -> None:
        make_read_only(*vars(self).values())

    @cached_property
    def all(self) -> tuple[ContactEvent, ...]:
        """All contacts, in order of the first touch."""
        columns = zip(self.begins, self.speeds, self.peaks, self.slips[-1], strict=True)
        return tuple(
            ContactEvent(pair, *map(float, values)) for pair, values in zip(self.pairs, columns, strict=True)
        )

    @cached_property
    def of_arm(self) -> tuple[ContactEvent, ...]:
        """The contacts of the arm, with obstacles and with itself, in order of the first touch."""
        return tuple(event for event in self.all if event.pair[0] in self.own)

    @cached_property
    def faults(self) -> tuple[ContactEvent, ...]:
        """The contacts of the arm that are not allowed."""
        return tuple(event for event in self.of_arm if event.pair[1] not in self.touchable)

    def scene_in(self, row: int, scene: Scene) -> Scene:
        """Return a scene with its free obstacles where they are in a row, given that at the start."""
        named = zip(self.model.masses, self.displacements[row], strict=True)
        at = {name: pin.SE3(matrix) for name, matrix in named if name in scene.obstacles}
        return scene.moved(at) if at else scene

    def summary(self) -> dict[str, Any]:
        """Return the contacts as data for JSON."""
        told = [
            {**event._asdict(), "pair": list(event.pair), "of_arm": event in self.of_arm}
            for event in self.all
        ]
        return {"first_touch": next((event for event in told if event["of_arm"]), None), "all": told}


def add_contact(spec: Any, arm: Arm, scene: Scene, contact: ContactModel) -> None:
    """Add the shapes of an arm and of obstacles, and the pairs that collide, to a `mujoco.MjSpec`.

    Args:
        spec: the specification; its bodies are named by the joints of the description.
        arm: the arm.
        scene: the obstacles.
        contact: how they touch.

    Raises:
        UnknownName: a mass of something that does not exist.
        InvalidValue: an obstacle that is not convex, or is carried, or a half-space with a mass.
    """
    mujoco = load_mujoco()
    if scene.carried:
        raise InvalidValue("scene", scene, "one in which the arm carries nothing: contact holds objects")
    model = CollisionModel(arm, scene)
    for name in contact.masses:
        require_known("obstacle", name, scene.obstacles)
    spec.option.disableflags &= ~int(mujoco.mjtDisableBit.mjDSBL_CONTACT)
    spec.option.cone = mujoco.mjtCone.mjCONE_ELLIPTIC
    # Stiffness of friction relative to that of the normal direction. With MuJoCo's 1, a box held by friction
    # on a slope creeps eight times as fast; `tests/sim/test_sim_contact.py` bounds it.
    spec.option.impratio = 10.0
    shapes = []
    for index, (joint, solid) in enumerate(model.solids):
        shapes.append(f"{PREFIX.arm} {index} {model.bodies[index]}")
        add_shape(spec, spec.body(str(arm.model.names[joint])), shapes[index], solid)
    for name, obstacle in scene.obstacles.items():
        shapes.append(f"{PREFIX.obstacle} {name}")
        _add_obstacle(spec, name, obstacle, contact.masses.get(name))
    free = [shape for shape in shapes if shape.removeprefix(f"{PREFIX.obstacle} ") in contact.masses]
    fixed = [shapes[k] for k, (joint, _) in enumerate(model.solids) if joint == 0]
    fixed += [shape for shape in shapes[len(model.solids) :] if shape not in free]
    pairs = [(shapes[first], shapes[second]) for first, second in model.index_pairs]
    pairs += [*product(fixed, free), *combinations(free, 2)]
    for first, second in pairs:
        pair = spec.add_pair(geomname1=first, geomname2=second)
        pair.condim = 3
        pair.friction = [contact.friction] * 2 + [0.0] * 3
        pair.solref = [contact.time_constant, contact.damping]


def _add_obstacle(spec: Any, name: str, obstacle: Described, mass: float | None) -> None:
    """Add an obstacle, free if it has a mass [kg]."""
    shape: Described = obstacle.geometry
    if not shape.convex:
        allowed = "a convex shape: only these touch in the simulation; a pipe of boxes may replace a surface"
        raise InvalidValue(f"obstacle {name!r}", obstacle, allowed)
    if mass is not None and not shape.bounded:
        raise InvalidValue(f"masses[{name!r}]", mass, f"none, as a {shape.type} has no end")
    (solid,) = shape.solids()
    if mass is None:
        add_shape(spec, spec.worldbody, f"{PREFIX.obstacle} {name}", solid)
        return
    inertia = solid_inertia(solid)
    middle = np.array(inertia.lever)
    xx, xy, yy, xz, yz, zz = np.asarray(inertia.inertia)[np.tril_indices(3)] * mass / inertia.mass
    body = spec.worldbody.add_body(
        pos=middle, explicitinertial=True, mass=mass, ipos=np.zeros(3), fullinertia=[xx, yy, zz, xy, xz, yz]
    )
    body.add_freejoint(name=f"{PREFIX.free} {name}")
    add_shape(spec, body, f"{PREFIX.obstacle} {name}", solid._replace(position=solid.position - middle))


def add_shape(spec: Any, body: Any, name: str, solid: Solid) -> None:
    """Add a shape, which collides only in the pairs that are named."""
    mujoco = load_mujoco()
    kinds = mujoco.mjtGeom
    shape: Any = solid.shape
    if isinstance(shape, coal.Sphere):
        values = {"type": kinds.mjGEOM_SPHERE, "size": [shape.radius, 0.0, 0.0]}
    elif isinstance(shape, (coal.Capsule, coal.Cylinder)):
        kind = kinds.mjGEOM_CAPSULE if isinstance(shape, coal.Capsule) else kinds.mjGEOM_CYLINDER
        values = {"type": kind, "size": [shape.radius, shape.halfLength, 0.0]}
    elif isinstance(shape, coal.Box):
        values = {"type": kinds.mjGEOM_BOX, "size": shape.halfSide}
    elif isinstance(shape, coal.Halfspace):
        values = {"type": kinds.mjGEOM_PLANE, "size": [0.0, 0.0, 1.0]}
    else:
        mesh = spec.add_mesh(name=name)
        mesh.uservert = np.array(shape.points()).ravel()
        values = {"type": kinds.mjGEOM_MESH, "meshname": name}
    quaternion = np.roll(pin.Quaternion(solid.rotation).coeffs(), 1)
    body.add_geom(
        name=name, pos=solid.position, quat=quaternion, mass=0.0, contype=0, conaffinity=0, **values
    )


class Touching(NamedTuple):
    """A pair of things that touch in a physics step.

    Attributes:
        force: force on the first, (3,) [N], world axes.
        closing: how fast they come together [m/s].
        sliding: how fast they slide on each other [m/s].
    """

    force: Array
    closing: float
    sliding: float

    def with_point(self, other: Touching) -> Touching:
        """Return both as one, for two points at which a pair touches."""
        return Touching(
            self.force + other.force, max(self.closing, other.closing), max(self.sliding, other.sliding)
        )


class ContactRecorder:
    """Collects the contacts of a simulation after each physics step."""

    def __init__(self, model: Any, contact: ContactModel, touchable: tuple[str, ...]) -> None:
        """Prepare to record.

        Args:
            model: the `mujoco.MjModel`, with shapes as `add_contact` names them.
            contact: how things touch.
            touchable: names of the obstacles that the arm may touch.
        """
        self._mujoco = load_mujoco()
        self._model = model
        self._contact = contact
        self._touchable = touchable
        shapes = [str(model.geom(k).name).split(" ", 1) for k in range(model.ngeom)]
        self._ranks = [
            (kind != PREFIX.arm, k) for k, (kind, _) in enumerate(shapes)
        ]  # the arm is first in a pair
        self._names = [name.split(" ", 1)[1] if kind == PREFIX.arm else name for kind, name in shapes]
        self._own = tuple(dict.fromkeys(self._names[k] for other, k in sorted(self._ranks) if not other))
        starts = [int(model.joint(f"{PREFIX.free} {name}").qposadr[0]) for name in contact.masses]
        self._free = [slice(start, start + 7) for start in starts]
        self._begins: dict[Pair, tuple[float, float]] = {}
        self._peaks: dict[Pair, float] = {}
        self._impulses: dict[Pair, Array] = {}
        self._slips: dict[Pair, float] = {}
        self._rows: list[tuple[dict[Pair, Array], dict[Pair, float], Array]] = []

    def observe(self, data: Any, time: float) -> None:
        """Record the contacts of a physics step that began at a time [s]; `data` are as it left them."""
        for pair, touching in self._touching(data).items():
            self._begins.setdefault(pair, (time, touching.closing))
            self._peaks[pair] = max(self._peaks.get(pair, 0.0), float(np.linalg.norm(touching.force)))
            step = self._model.opt.timestep
            self._impulses[pair] = self._impulses.get(pair, np.zeros(3)) + step * touching.force
            self._slips[pair] = self._slips.get(pair, 0.0) + step * touching.sliding

    def end_cycle(self, data: Any, duration: float) -> None:
        """End the row of a cycle of a duration [s], or that of the start."""
        placements = []
        for columns in self._free:
            x, y, z, w, *vector = data.qpos[columns]
            pose = pin.XYZQUATToSE3(np.array([x, y, z, *vector, w]))
            start = pin.SE3(np.eye(3), self._model.qpos0[columns][:3])
            placements.append((pose * start.inverse()).homogeneous)
        displacements = np.reshape(placements, (len(self._free), 4, 4))
        forces = {pair: impulse / duration for pair, impulse in self._impulses.items()}
        self._rows.append((forces, dict(self._slips), displacements))
        self._impulses = {}

    def history(self) -> ContactHistory:
        """Return what was recorded."""
        pairs = tuple(self._begins)
        none = np.zeros(3)
        forces = [[acting.get(pair, none) for pair in pairs] for acting, _, _ in self._rows]
        slips = [[slid.get(pair, 0.0) for pair in pairs] for _, slid, _ in self._rows]
        shape = len(self._rows), len(pairs)
        begins = np.array(list(self._begins.values())).reshape(len(pairs), 2)
        return ContactHistory(
            model=self._contact,
            pairs=pairs,
            own=self._own,
            touchable=self._touchable,
            begins=begins[:, 0],
            speeds=begins[:, 1],
            peaks=np.array([self._peaks[pair] for pair in pairs]),
            forces=np.reshape(forces, (*shape, 3)),
            slips=np.reshape(slips, shape),
            displacements=np.array([displacements for _, _, displacements in self._rows]),
        )

    def _touching(self, data: Any) -> dict[Pair, Touching]:
        """Return the pairs that touch; MuJoCo lists their points."""
        wrenches = np.zeros((data.ncon, 6))
        for k, wrench in enumerate(wrenches):
            self._mujoco.mj_contactForce(self._model, data, k, wrench)
        pressed = np.flatnonzero(wrenches[:, 0] > 0.0)
        points = data.contact.pos[pressed]
        shapes = data.contact.geom[pressed]
        # The first axis leads from the first shape to the other.
        axes = data.contact.frame[pressed].reshape(-1, 3, 3)
        forces = -np.einsum("ki,kij->kj", wrenches[pressed, :3], axes)
        bodies = self._model.geom_bodyid[shapes]
        twists = data.cvel[bodies]
        turning = twists[..., :3]
        levers = points[:, None] - data.subtree_com[self._model.body_rootid[bodies]]
        # As np.cross, which takes five times as long for a few points.
        ahead = (1, 2, 0)
        back = (2, 0, 1)
        turned = turning.take(ahead, -1) * levers.take(back, -1)
        turned -= turning.take(back, -1) * levers.take(ahead, -1)
        velocities = twists[..., 3:] + turned
        moved = np.einsum("kij,kj->ki", axes, velocities[:, 1] - velocities[:, 0])
        closing = np.maximum(0.0, -moved[:, 0]).tolist()
        sliding = np.hypot(moved[:, 1], moved[:, 2]).tolist()
        touching: dict[Pair, Touching] = {}
        for (one, other), force, *speeds in zip(shapes.tolist(), forces, closing, sliding, strict=True):
            swapped = self._ranks[one] > self._ranks[other]
            pair = self._names[other if swapped else one], self._names[one if swapped else other]
            touch = Touching(-force if swapped else force, *speeds)
            touching[pair] = touching[pair].with_point(touch) if pair in touching else touch
        return touching
