"""Webcams that run free by clocks of their own, and the spots that a detector finds in their frames, by numpy alone.

Robot's time = stamp + delay_s + 1e-6 drift_ppm stamp; a line v is exposed readout_s (v / (h - 1) - 0.5) later.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

Array = NDArray[np.float64]
DEG = np.pi / 180.0
SIZES = ((1280, 720), (1920, 1080), (640, 480))
EDGE_PX, HIDDEN_DEG = 4.0, 65.0
"""Spots nearer to the edge are not found, nor lights that are turned away further."""


@dataclass(frozen=True, kw_only=True)
class WebCam:
    """A camera as it is. intrinsics: fx, fy, cx, cy, k1, k2, p1, p2, k3; T_base_camera (4, 4).

    noise_px: of its spots; claim: what they claim over what is true; late: stamps that only come late, not normal ones.
    """

    size: tuple[int, int]
    intrinsics: Array
    T_base_camera: Array
    rate_hz: float
    delay_s: float
    drift_ppm: float
    readout_s: float
    jitter_s: float
    late: bool
    lost: float
    noise_px: float
    claim: float

    def project(self, points: Array) -> Array:
        """Return pixels (..., 2) of points (..., 3) in base axes, NaN where it does not look."""
        fx, fy, cx, cy, k1, k2, p1, p2, k3 = self.intrinsics
        c = (points - self.T_base_camera[:3, 3]) @ self.T_base_camera[:3, :3]
        with np.errstate(divide="ignore", invalid="ignore"):
            x, y = c[..., 0] / c[..., 2], c[..., 1] / c[..., 2]
        r2 = x * x + y * y
        wide = np.hypot(*self.size) / 2.0 / fx
        looks = (c[..., 2] > 0.05) & (r2 < (1.3 * wide) ** 2)
        x, y, r2 = (np.where(looks, value, np.nan) for value in (x, y, r2))
        radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
        xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
        yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
        return np.stack([fx * xd + cx, fy * yd + cy], axis=-1)

    def inside(self, uv: Array, edge_px: float = EDGE_PX) -> NDArray[np.bool_]:
        """Return which pixels are in the image."""
        w, h = self.size
        return np.asarray(((uv > edge_px) & (uv < (w - 1 - edge_px, h - 1 - edge_px))).all(axis=-1))

    def facing(self, points: Array, normals: Array) -> Array:
        """Return the angles (...) between the lights' axes and the ways to the camera."""
        way = self.T_base_camera[:3, 3] - points
        return np.asarray(np.arccos(np.clip((way * normals).sum(axis=-1) / np.linalg.norm(way, axis=-1), -1.0, 1.0)))

    def robot_time(self, stamp_s: Array) -> Array:
        """Return the robot's time of exact stamps."""
        return np.asarray(stamp_s + self.delay_s + 1e-6 * self.drift_ppm * stamp_s)

    def turned(self, rotation: Rotation) -> WebCam:
        """Return it turned about its own centre."""
        T = self.T_base_camera.copy()
        T[:3, :3] = T[:3, :3] @ rotation.as_matrix()
        return replace(self, T_base_camera=T)


@dataclass(frozen=True, kw_only=True)
class Track:
    """Stamps (n,) of a camera's frames; spots (m,): the frame each is of, pixels, claimed covariances; image size.

    light (m,): which light it truly is, -1 for none of them; for checks alone.
    """

    t_s: Array
    frame: NDArray[np.intp]
    uv_px: Array
    covariance_px2: Array
    size: tuple[int, int]
    light: NDArray[np.intp]


def draw_lens(rng: np.random.Generator, size: tuple[int, int]) -> Array:
    """Return intrinsics (9,) of a lens whose rays do not fold within the image."""
    w, h = size
    while True:
        fx = 0.5 * w / np.tan(0.5 * rng.uniform(55.0, 90.0) * DEG)
        k1, k2, k3 = rng.uniform(-0.25, 0.25), rng.normal(0.0, 0.06), rng.normal(0.0, 0.01)
        r = np.linspace(0.0, 1.3 * np.hypot(w, h) / 2.0 / fx, 100)
        slope = 1.0 + 3.0 * k1 * r**2 + 5.0 * k2 * r**4 + 7.0 * k3 * r**6
        if slope.min() > 0.35 and slope.max() < 2.5:
            break
    off = rng.uniform(-0.025, 0.025, 2) * w
    fy = fx * (1.0 + rng.normal(0.0, 0.001))
    p1, p2 = rng.normal(0.0, 5e-4, 2)
    return np.array([fx, fy, 0.5 * (w - 1) + off[0], 0.5 * (h - 1) + off[1], k1, k2, p1, p2, k3])


def _looking(at: Array, to: Array, roll: float) -> Array:
    z = (to - at) / np.linalg.norm(to - at)
    down = np.array([0.0, 0.0, -1.0]) if abs(z[2]) < 0.95 else np.array([1.0, 0.0, 0.0])
    y = down - z * (down @ z)
    y /= np.linalg.norm(y)
    T = np.eye(4)
    T[:3, :3] = np.stack([np.cross(y, z), y, z], axis=1) @ Rotation.from_rotvec([0.0, 0.0, roll]).as_matrix()
    T[:3, 3] = at
    return T


def draw_cameras(
    rng: np.random.Generator, centre: Array, normal: Array, noise_px: float | None
) -> tuple[WebCam, WebCam]:
    """Return two webcams that converge on a centre and look at it along about -normal."""
    far = rng.uniform(0.8, 1.6)
    wide = rng.uniform(0.3, min(0.9, 0.75 * far))
    tilt = Rotation.from_rotvec(rng.normal(0.0, 8.0 * DEG, 3)).as_matrix()
    way = tilt @ normal
    size, lens_like = SIZES[rng.integers(3)], rng.random() < 0.7
    first = draw_lens(rng, size)
    across = _looking(centre + far * way, centre, rng.normal(0.0, 8.0 * DEG))[:3, 0]
    out = []
    for side in (-0.5, 0.5):
        other = size if lens_like else SIZES[rng.integers(3)]
        lens = first if side < 0.0 else draw_lens(rng, other)
        at = centre + far * way + side * wide * across + rng.normal(0.0, 0.03, 3)
        to = centre + rng.normal(0.0, 0.03, 3)
        out.append(
            WebCam(
                size=size if side < 0.0 else other,
                intrinsics=lens,
                T_base_camera=_looking(at, to, rng.normal(0.0, 5.0 * DEG)),
                rate_hz=30.0 * (1.0 + rng.uniform(-1e-3, 1e-3)),
                delay_s=rng.uniform(-3.0, 3.0),
                drift_ppm=rng.uniform(-80.0, 80.0),
                readout_s=rng.uniform(0.010, 0.028),
                jitter_s=rng.uniform(1e-3, 2e-3),
                late=bool(rng.random() < 0.5),
                lost=rng.uniform(0.01, 0.02),
                noise_px=rng.uniform(0.05, 0.15) if noise_px is None else noise_px,
                claim=rng.uniform(0.85, 1.2),
            )
        )
    return out[0], out[1]


def watched(
    rng: np.random.Generator,
    camera: WebCam,
    begin_s: float,
    seconds: float,
    way: Callable[[Array, int], Array],
    axes: Callable[[Array], Array],
    lamps: Array,
    *,
    turn: tuple[float, Rotation] | None = None,
    dark: bool = False,
    blind: bool = False,
) -> Track:
    """Return what a camera sees from the robot's time begin_s on.

    way(t, light) gives the light's places (m, 3) in base axes, axes(t) their axes (m, n, 3). turn: when and how the
    camera is turned; dark: half of the frames have no lights; blind: none has.
    """
    first = (begin_s - camera.delay_s) / (1.0 + 1e-6 * camera.drift_ppm)
    stamp = first + np.arange(int(seconds * camera.rate_hz)) / camera.rate_hz
    stamp = stamp[rng.random(len(stamp)) >= camera.lost]
    t = camera.robot_time(stamp)
    normals = axes(t)
    n, lights = normals.shape[:2]
    later = np.zeros(n, bool) if turn is None else t >= turn[0]

    def pixels(points: Array) -> Array:
        uv = camera.project(points)
        if turn is not None:
            uv[later] = camera.turned(turn[1]).project(points[later])
        return uv

    late, uv, points = np.zeros((n, lights)), np.empty((n, lights, 2)), np.empty((n, lights, 3))
    for _ in range(4):
        for i in range(lights):
            points[:, i] = way(t + late[:, i], i)
        uv = pixels(points)
        late = np.nan_to_num(camera.readout_s * (uv[..., 1] / (camera.size[1] - 1) - 0.5))
    seen = camera.inside(uv) & (camera.facing(points, normals) < HIDDEN_DEG * DEG)
    for i in range(lights):  # stretches behind a cable or a hand, 1 % of the time
        for start in rng.uniform(0.0, n, rng.poisson(0.01 * n / 18.0)):
            seen[int(start) : int(start + rng.uniform(6.0, 30.0)), i] = False
    seen &= ~(rng.random(n) < 0.5)[:, None] if dark else not blind
    lamp_uv = pixels(np.tile(lamps, (n, 1, 1))) if len(lamps) else np.empty((n, 0, 2))
    lit = camera.inside(lamp_uv) & (rng.random(lamp_uv.shape[:2]) > 0.02)
    stray = np.flatnonzero(rng.random(n) < 0.01)
    stray_uv = rng.uniform(EDGE_PX, np.array(camera.size) - 1 - EDGE_PX, (len(stray), 2))
    frame = np.concatenate([np.nonzero(seen)[0], np.nonzero(lit)[0], stray])
    light = np.concatenate([np.nonzero(seen)[1], np.full(lit.sum() + len(stray), -1)])
    spots = np.concatenate([uv[seen], lamp_uv[lit], stray_uv])
    sigma = camera.noise_px * np.exp(rng.normal(0.0, 0.2, len(spots)))[:, None] * [1.0, rng.uniform(0.9, 1.1)]
    spots = spots + rng.normal(size=spots.shape) * sigma
    wild = rng.random(len(spots)) < 0.01
    turns = rng.uniform(0.0, 2.0 * np.pi, wild.sum())
    spots[wild] += rng.uniform(0.5, 5.0, (wild.sum(), 1)) * np.stack([np.cos(turns), np.sin(turns)], axis=1)
    claimed = sigma * camera.claim * rng.uniform(0.97, 1.03, sigma.shape)
    order = np.lexsort((rng.random(len(frame)), frame))
    told = stamp + (
        np.minimum(rng.exponential(camera.jitter_s, n), 0.015) if camera.late else rng.normal(0.0, camera.jitter_s, n)
    )
    covariance = claimed[:, :, None] ** 2 * np.eye(2)
    return Track(
        t_s=told,
        frame=frame[order].astype(np.intp),
        uv_px=spots[order],
        covariance_px2=covariance[order],
        size=camera.size,
        light=light[order].astype(np.intp),
    )
