"""Small scenes that tests of the Python face share: the simulated cell with a hand, and lights drawn by hand."""

from functools import cache
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import armsight

CAMERA = armsight.Camera.pinhole(320, 240, 250.0, 250.0, 160.0, 120.0)
LIGHTS = {"A": (-0.05, 0.0, 0.0), "B": (0.05, 0.04, 0.0), "C": (0.03, -0.04, 0.0)}


@cache
def hand_cell() -> Any:
    """Three frames in the dark: made by the first test that asks, and kept."""
    return armsight.simulate("hand-cell", frames=3, room="dark")


@cache
def pictures(side: str) -> list[Any]:
    return [getattr(frame, side) for frame in hand_cell()]


def drawn(shift_m: tuple[float, float, float] = (0.05, 0.0, 0.5)) -> list[np.ndarray]:
    """Return what a parallel pair of CAMERA, 0.1 m apart, sees of LIGHTS moved by a shift."""
    y, x = np.mgrid[0:240, 0:320]
    out = []
    for side in (0.0, 0.1):
        image = np.full((240, 320), 8.0)
        for light in LIGHTS.values():
            X, Y, Z = np.array(light) + shift_m - (side, 0.0, 0.0)
            image += 150.0 * np.exp(-((x - 160 - 250 * X / Z) ** 2 + (y - 120 - 250 * Y / Z) ** 2) / 8.0)
        out.append(image.astype(np.uint8))
    return out


def some_poses(n: int, seed: int) -> RigidTransform:
    rng = np.random.default_rng(seed)
    return RigidTransform.from_components(rng.normal(0, 0.2, (n, 3)), Rotation.from_rotvec(rng.normal(0, 0.5, (n, 3))))
