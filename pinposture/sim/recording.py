"""What is written down while an arm is simulated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.sim.plant import Cycle, Plant
from pinposture.sim.simulation import Simulation
from pinposture.target import Target

Array = NDArray[np.float64]


class Recording:
    """A simulation under way.

    Attributes:
        plant: the simulated arm.
        failure: why it could not go on, in words; "" while it can.
    """

    def __init__(self, plant: Plant, target: Target | None = None) -> None:
        self.plant, self.failure = plant, ""
        self._sent, self._taken, self._torques = [plant.positions], [plant.positions], [plant.torques]
        self._saturated = np.zeros(len(plant.positions), dtype=np.intp)
        self._targets = [] if target is None else [target]

    def advance(self, sent: Array, target: Target | None = None) -> bool:
        """Simulate a cycle and write it down; False, and nothing is, if the arm runs away in it.

        Args:
            sent: where the joints are sent, (nv,) [rad or m].
            target: where its control points should be at the end of the cycle.
        """
        cycle: Cycle = self.plant.advance(sent)
        self._saturated += cycle.saturated
        self.failure = cycle.failure
        if cycle.failure:
            return False
        self._sent.append(self.plant.set_points)
        self._taken.append(cycle.positions)
        self._torques.append(cycle.torques)
        if target is not None:
            self._targets.append(target)
        return True

    def simulation(self, loop: str, measured: float = 1.0) -> Simulation:
        """What came of it.

        Args:
            loop: "open" or "closed".
            measured: share of the cycles in which a measurement arrived.
        """
        plant, physics = self.plant, self.plant.physics
        arm = physics.arm
        commanded = np.array([arm.configuration(row) for row in self._sent])
        q = np.array([arm.configuration(row) for row in self._taken])
        end = plant.dt * (len(q) - 1)
        # Targets may be without a place where their weight is 0.
        targets = [np.where(each.weights[:, None] > 0.0, each.points, 0.0) for each in self._targets]
        return Simulation(
            arm=arm,
            loop=loop,
            servos=physics.servos,
            gravity=physics.gravity,
            dt=plant.dt,
            timestep=plant.dt / plant.substeps,
            status="unstable" if self.failure else "finished",
            reason=self.failure or f"came to its end after {end:.6g} s",
            commanded=commanded,
            q=q,
            commanded_points=np.array([arm.at(row).points for row in commanded]),
            points=np.array([arm.at(row).points for row in q]),
            torques=np.array(self._torques),
            torque_limits=physics.torque_limits[physics.columns],
            saturated=self._saturated / max(plant.cycles * plant.substeps, 1),
            targets=np.array(targets) if targets else None,
            weights=np.array([each.weights for each in self._targets], dtype=np.float64) if targets else None,
            measured=measured,
            warnings=physics.warnings,
        )
