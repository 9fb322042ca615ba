"""Streams of a robot and a camera whose errors drift, made with numpy and scipy alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

RATE_HZ = 30.0
CAMERA = RigidTransform.from_components([0.03, -0.06, 0.09], Rotation.from_euler("xyz", [0.1, -0.05, 1.5]))
TARGET = RigidTransform.from_components([0.6, 0.1, 0.02], Rotation.from_euler("xyz", [0.02, 0.01, 1.6]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Streams:
    """Times, T_base_flange and T_camera_target of one recording; drift_s: after which its errors are forgotten."""

    t_s: np.ndarray
    flange: RigidTransform
    camera: RigidTransform
    drift_s: float


def drifting(rng: np.random.Generator, n: int, drift_s: float, size: float) -> np.ndarray:
    """Ornstein and Uhlenbeck's process (n, 3), standard deviation `size`."""
    out = np.empty((n, 3))
    out[0] = rng.normal(0.0, size, 3)
    kept = np.exp(-1.0 / RATE_HZ / drift_s)
    for i in range(1, n):
        out[i] = kept * out[i - 1] + rng.normal(0.0, size * np.sqrt(1.0 - kept**2), 3)
    return out


def streams(seed: int) -> Streams:
    """15 to 60 s of smooth motion; the camera's errors drift over 0.2 to 5 s, beside white noise."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(0.0, rng.uniform(15.0, 60.0), 1.0 / RATE_HZ)
    n = len(t_s)
    period, phase = rng.uniform(3.0, 8.0, (3, 6)), rng.uniform(0.0, 2.0 * np.pi, (3, 6))
    swing = np.array([0.05, 0.05, 0.06, 0.3, 0.3, 0.4]) * rng.uniform(0.5, 1.2)
    way = sum(np.sin(2.0 * np.pi * t_s[:, None] / period[k] + phase[k]) for k in range(3)) / 1.7 * swing
    seen = RigidTransform.from_components(way[:, :3] + [0.0, 0.0, 0.45], Rotation.from_rotvec(way[:, 3:]))
    drift_s = float(np.exp(rng.uniform(np.log(0.2), np.log(5.0))))
    move = rng.uniform(0.2e-3, 1e-3)
    turn, white = move * rng.uniform(1.0, 3.0), rng.uniform(0.1, 1.0)
    off_m = drifting(rng, n, drift_s, move) + rng.normal(0.0, white * move, (n, 3))
    off_rad = drifting(rng, n, drift_s, turn) + rng.normal(0.0, white * turn, (n, 3))
    camera = RigidTransform.from_components(seen.translation + off_m, Rotation.from_rotvec(off_rad) * seen.rotation)
    return Streams(t_s=t_s, flange=TARGET * seen.inv() * CAMERA.inv(), camera=camera, drift_s=drift_s)


def error(found: RigidTransform) -> np.ndarray:
    """Return (6,) how far the camera was found from where it is: m and rotation vector, in the flange's axes."""
    turn = (found.rotation * CAMERA.rotation.inv()).as_rotvec()
    return np.concatenate([found.translation - CAMERA.translation, turn])
