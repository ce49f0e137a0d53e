"""How long a depth image takes to become part of a map, and of the cells that an arm keeps clear of.

    python -m benchmarks.studies.depth_images            # 10 draws, half a minute
    python -m benchmarks.studies.depth_images --draws 3 --width 320

Images have 640 x 480 pixels, 100 degrees and a noise of 1 mm; cells are 1 cm wide. One scene is a wavy wall
80 cm away, of random waves; the other the inside of a random box of `benchmarks.studies.mapping`, seen from
its hole. In each draw, a new map takes a first image, in which all is new, and then nine more, each from 1 cm
to the side. Times are those of the processor.
"""

from __future__ import annotations

import argparse
from time import thread_time
from typing import Literal, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import pinposture as pp
from benchmarks.studies.mapping import AHEAD, CELL, FRONT, Camera, Draw

Array = NDArray[np.float64]

Unknown = Literal["free", "forbidden"]

IMAGES = 10
ASIDE = 0.01
"""Number of images of a map, and distance from one to the next [m]."""

AWAY = 0.8
WAVE = 0.05
LENGTH = 0.3
"""Distance of the wall, height of its waves, and their usual length [m]."""

NOISE = 0.001
"""Standard deviation of depths [m]."""

REACH = 2.0
"""Half of the edge length of a map [m]."""


class Wall:
    """A wavy wall across x, as a height over y and z.

    Args:
        rng: draws the waves.
        camera: how it is seen.
        shape: number of rows and columns of an image.
    """

    def __init__(self, rng: np.random.Generator, camera: pp.Intrinsics, shape: tuple[int, int]) -> None:
        rows, columns = np.mgrid[0 : shape[0], 0 : shape[1]]
        self._side = (columns - camera.cx) / camera.fx
        self._down = (rows - camera.cy) / camera.fy
        self._waves = 2.0 * np.pi / (LENGTH * rng.uniform(0.7, 1.5, 2))
        self._phases = rng.uniform(0.0, 2.0 * np.pi, 2)

    def depth(self, aside: float, rng: np.random.Generator) -> Array:
        """Return what a camera sees that looks along x, given its place along y [m]: depths, (h, w) [m]."""
        depth = np.full(self._side.shape, AWAY)
        for _ in range(20):  # the depth at which a ray meets the height there
            y = aside - self._side * depth
            z = -self._down * depth
            waves = np.sin(self._waves[0] * y + self._phases[0]) + np.sin(
                self._waves[1] * z + self._phases[1]
            )
            depth = 0.5 * (depth + AWAY + 0.5 * WAVE * waves)
        return np.asarray(depth + rng.normal(0.0, NOISE, depth.shape))


def measure(seed: int, width: int, unknown: Unknown, boxed: bool) -> tuple[list[float], int]:
    """Return the times of the images of a draw [ms], and how many cells the map has in the end."""
    rng = np.random.default_rng(seed)
    drawn = Draw.of(seed)
    camera = Camera(drawn, width, NOISE)
    wall = Wall(rng, camera.intrinsics, (3 * width // 4, width))
    start = np.array([FRONT, *drawn.hole]) if boxed else np.zeros(3)
    mapped = pp.Map(CELL, center=tuple(start), reach=REACH, unknown=unknown)
    times = []
    for number in range(IMAGES):
        place = pin.SE3(AHEAD, start + (0.0, ASIDE * number, 0.0))
        depth = camera.depth(place, rng) if boxed else wall.depth(ASIDE * number, rng)
        begun = thread_time()
        mapped.add_depth(depth, camera.intrinsics, place, 0.2 * number)
        cells = mapped.cells
        times.append(1e3 * (thread_time() - begun))
    return times, len(cells.points)


def main() -> None:
    """Print a table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--draws", type=int, default=10)
    parser.add_argument("--width", type=int, default=640)
    given = parser.parse_args()
    measure(0, given.width, "free", False)  # kernels are loaded
    print("| scene | unknown cells | cells | first image [ms]: median | most | later ones: median | most |")
    print("|---" * 7 + "|")
    for boxed in (False, True):
        for unknown in get_args(Unknown):
            found = [measure(seed, given.width, unknown, boxed) for seed in range(given.draws)]
            times = np.array([row for row, _ in found])
            cells = int(np.median([count for _, count in found]))
            first = times[:, 0]
            later = times[:, 1:]
            numbers = [np.median(first), first.max(), np.median(later), later.max()]
            words = " | ".join(f"{number:.0f}" for number in numbers)
            print(f"| {'box' if boxed else 'wall'} | {unknown} | {cells} | {words} |", flush=True)


if __name__ == "__main__":
    main()
