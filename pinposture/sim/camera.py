"""A depth camera on a link of a simulated arm, by the rays of MuJoCo; it needs no display."""

from __future__ import annotations

from typing import Annotated, Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from pinposture.arm import Arm
from pinposture.arm.kinematics import frame_ids
from pinposture.arm.mjcf import load_mujoco
from pinposture.collision import CollisionModel, Scene
from pinposture.collision.obstacles import Obstacle
from pinposture.collision.solids import z_along
from pinposture.errors import no_warnings
from pinposture.schema import Count, Declared, Length, WholeNumber, declared, quantity
from pinposture.sim.contact import add_shape

Array = NDArray[np.float64]


@declared()
class DepthCamera(Declared):
    """A depth camera, whose image is plane, with square pixels.

    Attributes:
        width: number of pixels across.
        height: number of pixels down.
        field_of_view: angle across the image, at most 3 [rad].
        reach: largest distance that it measures [m].
        noise: standard deviation of a distance [m].
        seed: random seed of the noise.

    Raises:
        InvalidValue: a number that is out of range.
    """

    width: Count = 64
    height: Count = 48
    field_of_view: Annotated[float, quantity("angle", above=0.0, most=3.0)] = 1.2
    reach: Length = 3.0
    noise: Annotated[float, quantity("length", least=0.0)] = 0.0
    seed: WholeNumber = 0

    def rays(self) -> Array:
        """Return the unit vectors of the pixels, row by row, (height * width, 3).

        They are in the optical frame, as ROS has it: x to the right, y down, z ahead.
        """
        focal = 0.5 * self.width / np.tan(0.5 * self.field_of_view)
        across = (np.arange(self.width) + 0.5 - 0.5 * self.width) / focal
        down = (np.arange(self.height) + 0.5 - 0.5 * self.height) / focal
        x, y = np.meshgrid(across, down)
        ahead = np.stack([x, y, np.ones_like(x)], axis=-1).reshape(-1, 3)
        return np.asarray(ahead / np.linalg.norm(ahead, axis=1, keepdims=True))


class TipCamera:
    """A depth camera at the tip of an arm, which sees obstacles and the arm itself.

    It stands at the tip and looks on in the direction of the last link of the straight arm. It sees
    everything but the link that it is on, and scans without triangles.

    Attributes:
        camera: the camera.
        mounting: the optical frame in the frame of the tip link, a `pin.SE3`.
        image: the last picture, distances along the rays (height, width) [m]; infinite where nothing is seen.

    Args:
        arm: the arm.
        scene: the obstacles.
        camera: the camera.

    Raises:
        MujocoMissing: MuJoCo is not installed.
    """

    def __init__(self, arm: Arm, scene: Scene, camera: DepthCamera) -> None:
        self.camera = camera
        self._mujoco = load_mujoco()
        self._arm = arm
        self._rng = np.random.default_rng(camera.seed)
        self._rays = camera.rays()
        self.image: Array = np.full((camera.height, camera.width), np.inf)
        self._data = arm.model.createData()
        [self._frame] = frame_ids(arm.model, [arm.tip])
        self.mounting = pin.SE3(self._turn(), np.zeros(3))
        with no_warnings():
            self._solids = CollisionModel(arm, scene.without_obstacles()).solids
        spec = self._mujoco.MjSpec()
        for number, (_, solid) in enumerate(self._solids):
            body = spec.worldbody.add_body(name=f"body {number}", mocap=True)
            add_shape(spec, body, f"body {number}", solid)
        for name, obstacle in scene.obstacles.items():
            _add_obstacle(spec, f"obstacle {name}", obstacle)
        self._model = spec.compile()
        self._scene = self._mujoco.MjData(self._model)
        carrier = arm.model.frames[self._frame].parentJoint
        solids = [number for number, (joint, _) in enumerate(self._solids) if joint == carrier]
        self._own = self._model.body(f"body {solids[-1]}").id if solids else -1

    def _turn(self) -> Array:
        """Return the optical axes in the frame of the tip link, (3, 3)."""
        q = self._arm.straight()
        points = self._arm.at(q).points
        begin = points[-2] if len(points) > 1 else np.array(self._arm.base_placement.translation)
        ahead = points[-1] - begin
        axes = z_along(ahead / np.linalg.norm(ahead))
        pin.framesForwardKinematics(self._arm.model, self._data, q)
        return np.asarray(self._data.oMf[self._frame].rotation.T @ axes)

    def look(self, q: Array) -> Array:
        """Return the points that are seen at a configuration, (n, 3) [m], in the frame of the tip link.

        Args:
            q: the configuration, (nq,).
        """
        mujoco = self._mujoco
        arm = self._arm
        pin.framesForwardKinematics(arm.model, self._data, q)
        for number, (joint, _) in enumerate(self._solids):
            placement = self._data.oMi[joint]
            mocap = self._model.body(f"body {number}").mocapid[0]
            self._scene.mocap_pos[mocap] = placement.translation
            self._scene.mocap_quat[mocap] = np.roll(pin.Quaternion(placement.rotation).coeffs(), 1)
        mujoco.mj_kinematics(self._model, self._scene)
        optical = self._data.oMf[self._frame].act(self.mounting)
        count = len(self._rays)
        distances = np.zeros(count)
        seen = np.zeros(count, dtype=np.int32)
        directions = np.ascontiguousarray(self._rays @ optical.rotation.T).ravel()
        arguments: dict[str, Any] = {
            "pnt": np.array(optical.translation),
            "vec": directions,
            "geomgroup": None,
            "flg_static": True,
            "bodyexclude": self._own,
            "geomid": seen,
            "dist": distances,
            "nray": count,
            "cutoff": self.camera.reach,
        }
        if "normal:" in (mujoco.mj_multiRay.__doc__ or ""):  # since MuJoCo 3.4
            arguments["normal"] = None
        mujoco.mj_multiRay(self._model, self._scene, **arguments)
        hit = (seen >= 0) & (distances <= self.camera.reach)
        measured = distances[hit] + self.camera.noise * self._rng.standard_normal(int(hit.sum()))
        image = np.full(count, np.inf)
        image[hit] = measured
        self.image = image.reshape(self.image.shape)
        points = measured[:, None] * self._rays[hit]
        return np.asarray(points @ self.mounting.rotation.T + self.mounting.translation)


def _add_obstacle(spec: Any, name: str, obstacle: Obstacle) -> None:
    """Add an obstacle to a `mujoco.MjSpec`, with its triangles if it is not convex."""
    mujoco = load_mujoco()
    shape: Any = obstacle.geometry
    if shape.convex:
        (solid,) = shape.solids()
        add_shape(spec, spec.worldbody, name, solid)
        return
    points, faces = shape.content
    if faces is None:
        return  # points have no surface for a ray
    mesh = spec.add_mesh(name=name)
    mesh.uservert = np.asarray(points, dtype=np.float64).ravel()
    mesh.userface = np.asarray(faces, dtype=np.int32).ravel()
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    quaternion = np.roll(pin.Quaternion(np.array(shape.rotation)).coeffs(), 1)
    spec.worldbody.add_geom(
        name=name,
        type=mujoco.mjtGeom.mjGEOM_MESH,
        meshname=name,
        pos=np.array(shape.center),
        quat=quaternion,
        mass=0.0,
        contype=0,
        conaffinity=0,
    )
