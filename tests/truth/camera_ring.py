"""A world of one to eight cameras that share no code with the product: its own projection, its own bound of the pose.

Six lights with relief, each seen within a cone; some hidden at random, some reflections beside them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

FOCAL, K1, SIZE = 950.0, -0.08, (1280, 720)
CENTRE = np.array([641.0, 358.0])

ANGLES = np.arange(6) * np.pi / 3.0 + np.array([0.0, 0.1, -0.15, 0.2, 0.05, -0.1])
LIGHTS = np.stack(
    [
        0.05 * np.cos(ANGLES) * [1.2, 1.0, 0.9, 1.1, 1.0, 0.95],
        0.05 * np.sin(ANGLES),
        [0.03, 0.0, 0.025, -0.005, 0.03, 0.0],
    ],
    axis=1,
)
"""Six lights with 30 mm of relief, that no turn brings onto each other."""


@dataclass(frozen=True)
class Ring:
    """Cameras at eyes (v, 3) that look at the origin's neighbourhood; the first one's axes are the rig's."""

    R: np.ndarray  # (v, 3, 3), (v, 3): p_camera = R p_rig + t
    t: np.ndarray

    def __len__(self) -> int:
        return len(self.R)

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Return (n, v, 2) of points (n, 3) in rig axes; NaN behind a camera or outside its picture."""
        p = np.einsum("vij,nj->nvi", self.R, points) + self.t
        xy = p[..., :2] / p[..., 2:]
        uv = FOCAL * xy * (1.0 + K1 * (xy**2).sum(axis=2, keepdims=True)) + CENTRE
        inside = (p[..., 2] > 0.1) & (uv > 4.0).all(axis=2) & (uv < np.array(SIZE) - 5.0).all(axis=2)
        uv[~inside] = np.nan
        return uv

    def bound(self, X: np.ndarray, T: np.ndarray, sights: np.ndarray, sigma_px: float) -> np.ndarray:
        """Return the Cramer-Rao bound (6, 6) of translation and turn, by differences of the projection."""
        columns = []
        for i in range(6):
            step = np.zeros(6)
            step[i] = 1e-6
            ends = []
            for sign in (1.0, -1.0):
                turned = Rotation.from_rotvec(sign * step[3:]).as_matrix() @ T[:3, :3]
                ends.append(self.pixels(X @ turned.T + T[:3, 3] + sign * step[:3]))
            columns.append(((ends[0] - ends[1]) / 2e-6)[sights].ravel())
        J = np.array(columns).T / sigma_px
        return np.asarray(np.linalg.inv(J.T @ J))


def ring(views: int, distance_m: float = 1.3, spread_rad: float = 2.0) -> Ring:
    """Return `views` cameras on an arc about the first one's line of sight, which all look at."""
    middle = np.array([0.0, 0.0, distance_m])
    R, t = [], []
    for i in range(views):
        turn = 0.0 if views == 1 else spread_rad * i / (views - 1)
        tip = 0.0 if i == 0 else 0.2 * (-1.0) ** i
        C = (Rotation.from_euler("x", tip) * Rotation.from_euler("y", turn)).as_matrix()  # camera from rig
        R.append(C)
        t.append(np.array([0.0, 0.0, distance_m]) - C @ middle)
    return Ring(np.array(R), np.array(t))


def pose(rng: np.random.Generator, distance_m: float = 1.3, tilt_rad: float = 0.35) -> np.ndarray:
    """Return a target's pose (4, 4) in rig axes near where the cameras look."""
    T = np.eye(4)
    T[:3, :3] = (
        Rotation.from_rotvec(rng.normal(0.0, tilt_rad, 3)) * Rotation.from_euler("z", rng.uniform(-np.pi, np.pi))
    ).as_matrix()
    T[:3, 3] = [*rng.uniform(-0.15, 0.15, 2), distance_m + rng.uniform(-0.15, 0.15)]
    return T


@dataclass(frozen=True)
class Seen:
    """Spots by view: uv (k, 2) each, in an order of their own, and the light of each (-1: a reflection)."""

    uv: list[np.ndarray]
    light: list[np.ndarray]


def look(
    world: Ring,
    X: np.ndarray,
    T: np.ndarray,
    rng: np.random.Generator,
    *,
    sigma_px: float = 0.05,
    hidden: float = 0.0,
    reflections: int = 0,
) -> Seen:
    """Return what the cameras see: each light hidden with a probability, reflections within 80 px of the target."""
    uv = world.pixels(X @ T[:3, :3].T + T[:3, 3])
    out, light = [], []
    for s in range(len(world)):
        there = np.flatnonzero(np.isfinite(uv[:, s, 0]) & (rng.random(len(X)) >= hidden))
        near = np.nanmean(uv[:, s], axis=0) + rng.uniform(-80.0, 80.0, (reflections, 2))
        both = np.vstack([uv[there, s] + rng.normal(0.0, sigma_px, (len(there), 2)), near])
        names = np.concatenate([there, np.full(reflections, -1)])
        order = rng.permutation(len(both))
        out.append(both[order])
        light.append(names[order])
    return Seen(out, light)
