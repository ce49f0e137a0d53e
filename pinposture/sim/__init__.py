"""Does a motion survive dynamics? The arm in MuJoCo, with servos at its joints; needs the extra `[sim]`."""

from pinposture.sim import files as files  # registers the format of simulations
from pinposture.sim.engine import MujocoMissing
from pinposture.sim.physics import Physics, mass_matrix, physics_of
from pinposture.sim.sensing import Sensing
from pinposture.sim.servos import Gains, Servos
from pinposture.sim.set_points import AnyMotion, SetPoints, set_points
from pinposture.sim.simulate import StreamingController, simulate, simulate_closed
from pinposture.sim.simulation import Simulation

__all__ = [
    "AnyMotion",
    "Gains",
    "MujocoMissing",
    "Physics",
    "Sensing",
    "Servos",
    "SetPoints",
    "Simulation",
    "StreamingController",
    "mass_matrix",
    "physics_of",
    "set_points",
    "simulate",
    "simulate_closed",
]
