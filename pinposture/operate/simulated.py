"""A simulated arm that operators move, in this process: servos, encoders, a camera at its tip."""

from __future__ import annotations

import time
from math import inf
from threading import Event
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from pinposture._validation import require_known
from pinposture.arm import Arm
from pinposture.collision import Map, Mounting, Scene
from pinposture.collision.mapping import MAPPING, SEEN
from pinposture.collision.model import effective_scene
from pinposture.control import Geodesic, Limits
from pinposture.control.limits import cycle_of
from pinposture.motion import Tracker
from pinposture.motion.latest import Latest
from pinposture.operate.operation import Operation
from pinposture.sim.camera import DepthCamera, TipCamera
from pinposture.sim.model import Servos, build_plant_model
from pinposture.sim.plant import FAILURES, Plant, Sensing, Sensors
from pinposture.task.carrier_feed import CarrierClearance, CarrierFeed

Array = NDArray[np.float64]

PICTURE_PERIOD = 0.2
"""Time between two pictures of the camera [s]."""


class Picture(NamedTuple):
    """What the camera is to take.

    Attributes:
        q: the configuration, (nq,).
        time: when [s].
    """

    q: Array
    time: float


class SimulatedArm:
    """An arm in MuJoCo, and the control loop that moves it by an `Operation`.

    Without a camera the arm keeps clear of the obstacles of the scene. With one it does not know them: it
    keeps clear of what it sees of them, in a `Map`.

    A robot that carries the arm is where the feed is: it is not simulated.

    A joint can fail on request (`fail`). Once there is a way out without one that sticks, the arm goes on
    with that joint locked in its model.

    Attributes:
        plant: the simulation.
        tracker: what computes the steps.
        scene: what the arm keeps clear of.
        picture: the last picture of the camera, distances (height, width) [m], infinite where nothing is near
            enough; None before the first.

    Args:
        arm: the arm.
        operation: what leads it.
        limits: the limits of the motion; `dt` is required.
        scene: the obstacles; None: none.
        servos: the servos; None: `Servos()`.
        sensing: the joint sensors; None: ideal ones.
        camera: the depth camera at the tip; None: there is none.
        q0: where it starts, (nq,), at rest; None: at its neutral configuration.
        deadline: as for `Tracker` [s].
        feed: the robot that carries the arm, which stays clear of the arm and of obstacles; None: none does.

    Raises:
        MujocoMissing: MuJoCo is not installed.
        PostureError: the arm cannot be simulated, as `build_plant_model` says, q0 is invalid, or the arm is
            not at the flange of the robot.
    """

    def __init__(
        self,
        arm: Arm,
        operation: Operation,
        limits: Limits,
        scene: Scene | None = None,
        *,
        servos: Servos | None = None,
        sensing: Sensing | None = None,
        camera: DepthCamera | None = None,
        q0: ArrayLike | None = None,
        deadline: float = inf,
        feed: CarrierFeed | None = None,
    ) -> None:
        self._arm = arm
        self._operation = operation
        self._limits = limits
        operation.goes_on = True
        start = arm.checked_start(arm.neutral() if q0 is None else q0, "q0")
        self._sent = arm.drives.positions(arm.positions(start))
        self.plant = Plant(build_plant_model(arm, servos), self._sent, cycle_of(limits))
        self._sensors = Sensors(Sensing() if sensing is None else sensing)
        known = effective_scene(arm, scene)
        self._camera = None
        if camera is not None:
            self._camera = TipCamera(arm, known, camera)
            self._map = Map(MAPPING.cell * arm.length, arm)
            known = known.with_obstacles({SEEN: self._map.cells})
        self.scene = known
        self._beside = None if feed is None else CarrierClearance(feed, arm, known.margin, known)
        self._deadline = deadline
        self.tracker = self._new_tracker(arm)
        self._looking: Latest[Picture, None] = Latest(self._look, "pinposture-camera")
        self._pictures = 0
        self._failing: dict[str, tuple[str, ...]] | None = None
        self.picture: Array | None = None

    @property
    def time(self) -> float:
        """Time of the simulation [s]."""
        return self.plant.cycles * self.plant.dt

    def cycle(self) -> bool:
        """Measure, let the tracker take a step, and simulate a cycle; return False if the arm runs away."""
        arm = self._arm
        names = arm.drives.names
        failing = self._failing
        if failing is not None:
            self._failing = None
            self.plant.fail(**failing)
        if self.tracker.arm is not self._operation.arm:
            self.tracker = self._new_tracker(self._operation.arm)
        read = self._sensors.measure(self.plant.positions)
        measured = None if read is None else dict(zip(names, read.tolist(), strict=True))
        q = None if measured is None else arm.configuration(arm.drives.joint_positions(measured))
        self._see(q)
        hold = self._operation.lead(self.tracker, q, self.scene, self.plant.dt)
        self.tracker.step(None if hold else measured, scene=self.scene)
        if self._operation.shown.commanded is not None or not hold:
            self._sent = self.tracker.positions
        return self.plant.advance(self._sent)

    def _new_tracker(self, arm: Arm) -> Tracker:
        """Return a tracker of the arm, of which some joints may be locked."""
        controller = Geodesic(constraints=() if self._beside is None else (self._beside,))
        return Tracker(arm, controller, limits=self._limits, scene=self.scene, deadline=self._deadline)

    def fail(self, *joints: str, kind: str = "stuck") -> None:
        """Let joints fail from the next cycle on, and no others. May be called from any thread.

        Args:
            joints: their names.
            kind: how they fail, one of `FAILURES`: they stick, or their drives are limp or weak.

        Raises:
            UnknownName: a joint that no drive moves, or another kind.
        """
        require_known("kind of failure", kind, FAILURES)
        for joint in joints:
            require_known("joint with a drive", joint, self._arm.drives.names)
        self._failing = {kind: joints}

    def run(self, stop: Event) -> None:
        """Go on in real time until it is stopped, or the arm runs away."""
        begun = time.monotonic() - self.time
        while not stop.is_set() and self.cycle():
            late = time.monotonic() - begun - self.time
            if late < 0.0:
                stop.wait(-late)
            elif late > 0.2:  # too late to be made good [s]
                begun += late

    def close(self) -> None:
        """End the thread of the camera."""
        self._looking.close()

    def _see(self, q: Array | None) -> None:
        """Have a picture taken, if it is time, and take what was seen into the scene."""
        if self._camera is None or q is None:
            return
        self._map.measure(q, self.time + self.plant.dt)
        if self.time >= self._pictures * PICTURE_PERIOD:
            self._pictures = int(self.time / PICTURE_PERIOD) + 1
            self._looking.ask(Picture(q, self.time + self.plant.dt))
        if self._map.cells is not self.scene.obstacles[SEEN]:
            self.scene = self.scene.updated({SEEN: self._map.cells})
            if self._beside is not None:
                self._beside.scene = self.scene

    def _look(self, picture: Picture, outdated: Event) -> None:
        """Take a picture, and add it to the map. Runs in a thread."""
        if self._camera is not None:
            points = self._camera.look(picture.q)
            self.picture = self._camera.image
            self._map.add_cloud(points, Mounting(self._arm.tip, pin.SE3.Identity()), picture.time, picture.q)
