"""Simulate an arm with masses, servos, gravity and contact in MuJoCo; needs the extra `[sim]`."""

from pinposture.arm.mjcf import MujocoMissing
from pinposture.motion.drive_response import DriveModel
from pinposture.sim.camera import DepthCamera, TipCamera
from pinposture.sim.contact import ContactEvent, ContactHistory, ContactModel
from pinposture.sim.control_loop import (
    AnyMotion,
    SetPoints,
    StreamingController,
    set_points,
    simulate,
    simulate_closed,
)
from pinposture.sim.drives import Drives
from pinposture.sim.link_sensors import InertialReading, LinkSensing, LinkSensors
from pinposture.sim.model import Gains, PlantModel, Servos, build_plant_model, mass_matrix
from pinposture.sim.plant import Sensing, Sensors
from pinposture.sim.simulation import Simulation, Slip

__all__ = [
    "AnyMotion",
    "ContactEvent",
    "ContactHistory",
    "ContactModel",
    "DepthCamera",
    "DriveModel",
    "Drives",
    "Gains",
    "InertialReading",
    "LinkSensing",
    "LinkSensors",
    "MujocoMissing",
    "PlantModel",
    "Sensing",
    "Sensors",
    "Servos",
    "SetPoints",
    "Simulation",
    "Slip",
    "StreamingController",
    "TipCamera",
    "build_plant_model",
    "mass_matrix",
    "set_points",
    "simulate",
    "simulate_closed",
]
