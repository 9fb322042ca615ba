"""Poses of a tool that pivots on a point, in one recording whose errors drift, made with numpy and scipy alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

TIP_M = np.array([0.01, -0.02, 0.12])
POINT_M = np.array([0.2, 1.2, 0.08])


@dataclass(frozen=True, slots=True, kw_only=True)
class Pivot:
    """Times and T_world_target of one recording; drift_s: after which its errors are forgotten; sigma_m, sigma_rad: of
    one component of the drift."""

    t_s: np.ndarray
    poses: RigidTransform
    drift_s: float
    sigma_m: float
    sigma_rad: float
    white: float


def drifting(rng: np.random.Generator, t_s: np.ndarray, drift_s: float) -> np.ndarray:
    """Ornstein and Uhlenbeck's process (n, 3) at t_s, standard deviation 1."""
    out = rng.normal(size=(len(t_s), 3))
    for i, kept in enumerate(np.exp(-np.diff(t_s) / drift_s), 1):
        out[i] = kept * out[i - 1] + np.sqrt(1.0 - kept**2) * out[i]
    return out


def pivot(seed: int, *, drifts: bool = True) -> Pivot:
    """10 to 40 s of smooth pivoting, 5 poses a second; errors drift over 0.2 to 5 s, beside white noise.

    drifts: otherwise the same errors, in random order.
    """
    rng = np.random.default_rng([seed, 3])
    t_s = np.arange(0.0, rng.uniform(10.0, 40.0), 0.2)
    n = len(t_s)
    period, phase = rng.uniform(2.0, 7.0, (3, 3)), rng.uniform(0.0, 2.0 * np.pi, (3, 3))
    way = sum(np.sin(2.0 * np.pi * t_s[:, None] / period[k] + phase[k]) for k in range(3)) / 1.7
    turn = Rotation.from_rotvec(way * np.array([0.4, 0.35, 0.3]) * rng.uniform(0.5, 1.2))
    drift_s = float(np.exp(rng.uniform(np.log(0.2), np.log(5.0))))
    sigma_m, white = rng.uniform(0.1e-3, 0.5e-3), rng.uniform(0.1, 1.0)
    sigma_rad = sigma_m * rng.uniform(1.0, 5.0)
    off_m, off_rad = (drifting(rng, t_s, drift_s) + rng.normal(0.0, white, (n, 3)) for _ in range(2))
    if not drifts:
        off_m, off_rad = (rng.permutation(off) for off in (off_m, off_rad))
    place = POINT_M - turn.apply(TIP_M) + sigma_m * off_m
    poses = RigidTransform.from_components(place, Rotation.from_rotvec(sigma_rad * off_rad) * turn)
    return Pivot(t_s=t_s, poses=poses, drift_s=drift_s, sigma_m=sigma_m, sigma_rad=sigma_rad, white=white)
