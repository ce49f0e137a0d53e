"""What is written down while an arm is simulated."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from pinposture.collision import CollisionModel, Scene
from pinposture.placement import Target
from pinposture.sim.plant import Cycle, Plant
from pinposture.sim.simulation import Simulation

Array = NDArray[np.float64]

TOLERANCE = 0.01
"""Mean distance of the control points from where they should be at the end that counts as there, in arm
lengths: servos are springs, and weight makes the arm sag on them by some thousandths."""


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

    def simulation(
        self, loop: str, scene: Scene | None, tolerance: float | None, measured: float = 1.0
    ) -> Simulation:
        """What came of it.

        Args:
            loop: "open" or "closed".
            scene: what distances are measured to; nothing if None.
            tolerance: mean distance of the control points from where they should be at the end that counts
                as there [m]; 1 % of the arm length if None.
            measured: share of the cycles in which a measurement arrived.
        """
        plant, physics = self.plant, self.plant.physics
        arm = physics.arm
        commanded = np.array([arm.configuration(row) for row in self._sent])
        q = np.array([arm.configuration(row) for row in self._taken])
        clearance = np.full(len(q), np.inf)
        if scene is not None:
            around = CollisionModel(arm, scene)
            clearance = np.array([around.minimum(row).distance for row in q])
        # Targets may be without a place where their weight is 0.
        targets = [np.where(each.weights[:, None] > 0.0, each.points, 0.0) for each in self._targets]
        commanded_points = np.array([arm.at(row).points for row in commanded])
        points = np.array([arm.at(row).points for row in q])
        saturated = self._saturated / max(plant.cycles * plant.substeps, 1)
        last = Target(commanded_points[-1], np.ones(arm.n_modules))
        last = self._targets[-1] if self._targets else last
        off = np.linalg.norm((last.points - points[-1])[last.placed], axis=1)
        error = float(off.sum()) / max(len(off), 1)
        tolerance = TOLERANCE * arm.length if tolerance is None else tolerance
        status, reason = "unstable", self.failure
        if not self.failure:
            status = "converged" if error <= tolerance else "missed"
            reason = _told(error, tolerance, plant.dt * (len(q) - 1), saturated)
        return Simulation(
            arm=arm,
            loop=loop,
            servos=physics.servos,
            gravity=physics.gravity,
            dt=plant.dt,
            timestep=plant.dt / plant.substeps,
            status=status,
            reason=reason,
            commanded=commanded,
            q=q,
            commanded_points=commanded_points,
            points=points,
            torques=np.array(self._torques),
            torque_limits=physics.torque_limits[physics.columns],
            saturated=saturated,
            clearance=clearance,
            targets=np.array(targets) if targets else None,
            weights=np.array([each.weights for each in self._targets], dtype=np.float64) if targets else None,
            measured=measured,
            warnings=physics.warnings,
            scene=scene,
        )


def _told(error: float, tolerance: float, end: float, saturated: Array) -> str:
    """How far off an arm is at its end, and why perhaps."""
    off = f"mean point error {error:.3g} m after {end:.6g} s"
    if error <= tolerance:
        return f"{off}, within the tolerance of {tolerance:.3g} m"
    limited = int(np.count_nonzero(saturated))
    weak = f"; {limited} of {len(saturated)} servos were at their limit" if limited else ""
    return f"{off}, above the tolerance of {tolerance:.3g} m{weak}"
