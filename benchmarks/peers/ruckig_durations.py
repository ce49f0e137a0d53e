"""The shortest durations of motions of one joint by Ruckig; runs in an environment with the `ruckig` package.

    python ruckig_durations.py motions.json durations.json

The motions are lists of a distance and of the largest speed, acceleration and jerk.
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from ruckig import InputParameter, Ruckig, Trajectory


def shortest_duration(distance: float, speed: float, acceleration: float, jerk: float) -> float:
    """Return the shortest duration from rest to rest [s]."""
    motion, found = InputParameter(1), Trajectory(1)
    motion.current_position, motion.target_position = [0.0], [distance]
    motion.max_velocity, motion.max_acceleration, motion.max_jerk = [speed], [acceleration], [jerk]
    Ruckig(1).calculate(motion, found)
    return float(found.duration)


def main() -> None:
    """Read the motions, and write the durations."""
    source, output = map(Path, sys.argv[1:])
    output.write_text(json.dumps([shortest_duration(*motion) for motion in json.loads(source.read_text())]))


if __name__ == "__main__":
    main()
