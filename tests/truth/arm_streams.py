"""An arm with wrong zeros, followed by a tracker whose errors drift; by Denavit-Hartenberg matrices of its own."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from armsight.calibrate.arm import ArmPoints
from armsight.kinematics import Arm, Joint

LINKS = np.array(
    [
        [0.0, 0.3, 0.05, np.pi / 2],
        [0.0, 0.1, 0.3, 0.0],
        [0.0, 0.1, 0.1, np.pi / 2],
        [0.0, 0.3, 0.0, -np.pi / 2],
        [0.0, 0.1, 0.0, 0.0],
    ]
)
NOMINAL = Arm(
    name="chain",
    joints=tuple(
        Joint(name=f"j{i}", theta_rad=t, d_m=d, a_m=a, alpha_rad=w) for i, (t, d, a, w) in enumerate(LINKS.tolist(), 1)
    ),
)
TOOL_M = np.array([0.05, 0.08, 0.1])
JUDGED = ("j2.theta_rad", "j3.theta_rad", "j4.theta_rad")
"""Zeros that neither base nor tool can stand for."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmStream:
    """Rows of one recording, the true arm's rows (theta, d, a, alpha), true changes of the judged zeros, and the size
    of the errors of one coordinate."""

    points: ArmPoints
    rows: np.ndarray
    true: dict[str, float]
    sigma_m: float

    def places(self, q: np.ndarray) -> np.ndarray:
        """Return where the tool is (m, 3) at q (m, n)."""
        return place(self.rows, q)


def place(rows: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Return the tool's places (m, 3) of the arm with rows (theta, d, a, alpha) at q (m, n)."""
    out = np.tile(TOOL_M, (len(q), 1))
    for (theta, d, a, alpha), value in zip(rows[::-1], q.T[::-1], strict=True):
        c, s, ca, sa = np.cos(value + theta), np.sin(value + theta), np.cos(alpha), np.sin(alpha)
        x, y, z = out.T
        near, side = ca * y - sa * z, sa * y + ca * z
        out = np.stack([c * x - s * near + a * c, s * x + c * near + a * s, side + d], axis=1)
    return out


def stream(
    seed: int,
    *,
    rate_hz: float = 10.0,
    drifts: bool = True,
    off_rad: float = 0.005,
    reach: float = 1.0,
    built_m: np.ndarray | None = None,
) -> ArmStream:
    """20 to 60 s of smooth motion of all joints; errors drift over 0.3 to 5 s, beside white noise.

    drifts: otherwise the same errors, in random order. reach: share of the ranges that the joints go over. built_m:
    (5, 2) by which d and a are off.
    """
    rng = np.random.default_rng([seed, 5])
    t_s = np.arange(0.0, rng.uniform(20.0, 60.0), 1.0 / rate_hz)
    n = len(t_s)
    period, phase = rng.uniform(3.0, 12.0, (3, 5)), rng.uniform(0.0, 2.0 * np.pi, (3, 5))
    q = reach * sum(np.sin(2.0 * np.pi * t_s[:, None] / period[k] + phase[k]) for k in range(3)) / 1.7
    drift_s, sigma_m = np.exp(rng.uniform(np.log(0.3), np.log(5.0))), rng.uniform(1e-4, 5e-4)
    white = rng.uniform(0.1, 1.0)
    error = rng.normal(size=(n, 3))
    kept = np.exp(-1.0 / rate_hz / drift_s)
    for i in range(1, n):
        error[i] = kept * error[i - 1] + np.sqrt(1.0 - kept**2) * error[i]
    error = error + rng.normal(0.0, white, (n, 3))
    if not drifts:
        error = rng.permutation(error)
    rows, wrong = LINKS.copy(), rng.normal(0.0, off_rad, 3)
    rows[1:4, 0] += wrong
    rows[:, 1:3] += 0.0 if built_m is None else built_m
    points = ArmPoints(q=q, xyz_m=place(rows, q) + sigma_m * error, t_s=t_s)
    true = dict(zip(JUDGED, wrong.tolist(), strict=True))
    return ArmStream(points=points, rows=rows, true=true, sigma_m=float(sigma_m * np.sqrt(1.0 + white**2)))
