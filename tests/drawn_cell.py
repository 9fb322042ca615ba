"""What two webcams see of the simulated set `cell`, drawn at half its size: spots of Gaussian light on noise."""

import csv
from collections import defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.ops.simulation.run import simulate

WIDTH, HEIGHT, FPS, SET_FPS = 640, 360, 15.0, 30.0
SIGMA_PX, PEAK, DARK, NOISE = 1.5, 200.0, 8.0, 1.5
REACH = 10
NOISES = 16
"""Pictures of noise, of which each frame has one: drawing new ones would take most of the time."""
SIDES = ("left", "right")

Image = NDArray[np.uint8]


@dataclass(frozen=True, kw_only=True)
class DrawnCell:
    """A set in a folder, with joints.csv, target.yaml and arm.yaml, and its spots by number of frame."""

    folder: Path
    n: int
    spots: dict[str, dict[int, list[tuple[float, float]]]]

    def images(self, side: str) -> Iterator[Image]:
        """Yield what a camera sees, 15 times a second."""
        rng = np.random.default_rng([1, SIDES.index(side)])
        noise = np.rint(DARK + rng.normal(0.0, NOISE, (NOISES, HEIGHT, WIDTH))).clip(0, 255).astype(np.uint8)
        v, u = np.mgrid[:HEIGHT, :WIDTH]
        for k in range(0, self.n, 2):
            image = noise[rng.integers(NOISES)].copy()
            for full in self.spots[side].get(k, ()):
                x, y = ((c + 0.5) / 2.0 - 0.5 for c in full)
                rows = slice(max(int(y) - REACH, 0), int(y) + REACH + 1)
                columns = slice(max(int(x) - REACH, 0), int(x) + REACH + 1)
                square = (u[rows, columns] - x) ** 2 + (v[rows, columns] - y) ** 2
                lit = np.rint(image[rows, columns] + PEAK * np.exp(-0.5 * square / SIGMA_PX**2))
                image[rows, columns] = np.minimum(lit, 255.0)
            yield image


def drawn_cell(folder: Path, *, frames: int, seed: int = 1) -> DrawnCell:
    """Simulate the set with so many frames a camera at its 30 a second, of which every second one is drawn."""
    simulate("cell", folder, frames=frames, seed=seed)
    spots: dict[str, dict[int, list[tuple[float, float]]]] = {}
    for side in SIDES:
        with (folder / f"{side}.csv").open(encoding="utf-8") as file:
            rows = [(float(row["t_s"]), float(row["u_px"]), float(row["v_px"])) for row in csv.DictReader(file)]
        of: dict[int, list[tuple[float, float]]] = defaultdict(list)
        for t_s, u, v in rows:
            of[round((t_s - rows[0][0]) * SET_FPS)].append((u, v))
        spots[side] = of
    return DrawnCell(folder=folder, n=frames, spots=spots)
