"""Cameras all round a place, projected by OpenCV, and what turns before them: a plate with two prints, or lights."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np
from ring_of_cameras import MOST_SLANT, POSE, SIZE, looking, moved, pixels, vector

from armsight.records import BoardView, TargetKind, board_target

FRONT = board_target(TargetKind.CHARUCO, 8, 6, 0.04, marker_m=0.03, dictionary="DICT_4X4_50")
BACK = board_target(TargetKind.CHARUCO, 7, 5, 0.045, marker_m=0.034, dictionary="DICT_5X5_50")


@dataclass(frozen=True)
class Turning:
    """k (C, 10), T_first_camera (C, 4, 4), boards T_first_front (G, 4, 4), T_front_part of each set of points.

    seen (G, C): which set a camera sees of a moment, -1 for none. lit (G, C, n): which of its points, of one set.
    """

    k: np.ndarray
    T: np.ndarray
    boards: np.ndarray
    parts: tuple[np.ndarray, ...]
    points: tuple[np.ndarray, ...]
    seen: np.ndarray
    lit: np.ndarray | None = None

    def shown(self, g: int, c: int) -> np.ndarray:
        part = self.points[self.seen[g, c]]
        return np.arange(len(part)) if self.lit is None else np.flatnonzero(self.lit[g, c])

    def pixels(self, c: int, camera: np.ndarray, board: np.ndarray, part: int, behind: np.ndarray) -> np.ndarray:
        return pixels(self.k[c], np.linalg.inv(camera) @ board @ (behind if part else np.eye(4)), self.points[part])

    def views(self, names: tuple[str, ...], sigma_px: float, rng: np.random.Generator) -> dict[str, list]:
        """What each camera sees, with noise; points are numbered through all sets."""
        first = np.cumsum([0, *map(len, self.points)])
        out: dict[str, list] = {name: [None] * len(self.boards) for name in names}
        for g, c in zip(*np.nonzero(self.seen >= 0), strict=True):
            part = self.seen[g, c]
            shown = self.shown(g, c)
            uv = self.pixels(c, self.T[c], self.boards[g], part, self.parts[-1])[shown]
            out[names[c]][g] = BoardView(
                uv_px=uv + rng.normal(0.0, sigma_px, uv.shape),
                index=first[part] + shown,
                sigma_px=sigma_px,
                width=SIZE[0],
                height=SIZE[1],
                source=f"{names[c]}/{g}",
            )
        return out

    def bound(self, sigma_px: float) -> np.ndarray:
        """Cramer-Rao covariance of the cameras' places and of the back, lenses held, by differences of pixels.

        The back's step is of its middle, in the front's axes, about the front's middle.
        """
        C, G, n = len(self.k), len(self.boards), 6 * len(self.k) - 6 + 6 * (len(self.parts) - 1)
        H, W, D = np.zeros((n, n)), np.zeros((G, n, 6)), np.zeros((G, 6, 6))
        middle = self.points[-1].mean(axis=0)

        def slope(at) -> np.ndarray:
            return np.array([(at(h) - at(-h))[shown].ravel() / 2e-6 for h in 1e-6 * np.eye(6)]).T

        for g, c in zip(*np.nonzero(self.seen >= 0), strict=True):
            T, board, part, behind = self.T[c], self.boards[g], self.seen[g, c], self.parts[-1]
            shown = self.shown(g, c)
            J = np.zeros((2 * len(shown), n))
            if c:
                J[:, 6 * c - 6 : 6 * c] = slope(lambda h: self.pixels(c, moved(T, h), board, part, behind))  # noqa: B023
            if part:
                J[:, 6 * C - 6 :] = slope(lambda h: self.pixels(c, T, board, part, about(behind, middle, h)))  # noqa: B023
            own = slope(lambda h: self.pixels(c, T, moved(board, h), part, behind))  # noqa: B023
            H += J.T @ J
            W[g] += J.T @ own
            D[g] += own.T @ own
        H -= np.einsum("gsl,glk,gtk->st", W, np.linalg.inv(D), W)
        return np.linalg.inv(H) * sigma_px**2

    def names(self, cameras: tuple[str, ...]) -> tuple[str, ...]:
        each = [f"{c}.{n}" for c in cameras[1:] for n in POSE]
        return tuple(each + [f"board:back.{n}" for n in POSE] * (len(self.parts) - 1))


def about(T: np.ndarray, middle: np.ndarray, step: np.ndarray) -> np.ndarray:
    """T with the place of its middle moved by dt, and turned about it by Exp(dw)."""
    at = np.eye(4)
    at[:3, 3] = middle
    return moved(T @ at, step) @ np.linalg.inv(at)


def in_axes_of_middles(T: np.ndarray) -> np.ndarray:
    """T_front_back between the prints' middles."""
    out = T.copy()
    out[:3, 3] += T[:3, :3] @ BACK.xyz_m.mean(axis=0) - FRONT.xyz_m.mean(axis=0)
    return out


def behind(thick_m: float = 0.006) -> np.ndarray:
    """T_front_back of a back glued on a little off and twisted, seen from the other side."""
    T = np.eye(4)
    T[:3, :3] = cv2.Rodrigues(np.array([0.0, np.pi, 0.0]))[0] @ cv2.Rodrigues(np.array([0.0, 0.0, 0.05]))[0]
    T[:3, 3] = FRONT.xyz_m.mean(axis=0) - T[:3, :3] @ BACK.xyz_m.mean(axis=0) + [0.004, -0.003, thick_m]
    return T


def plate(
    angles_deg: tuple[float, ...], seed: int, n_moments: int = 60, most_tilt: float = 0.6, towards: int = 4
) -> Turning:
    """Cameras at angles round the place, and a plate that is tilted between them; every moment two of them see it.

    towards: its front looks to the first cameras only.
    """
    rng = np.random.default_rng(seed)
    lens = np.array([900.0, 903.0, 640.0, 360.0, 0.0, -0.1, 0.05, 0.0, 0.0, 0.0])
    k = np.array([lens + rng.normal(0.0, 1.0, 10) * [20, 20, 10, 10, 0, 0.02, 0.02, 5e-4, 5e-4, 0] for _ in angles_deg])
    world = np.array([looking(a) for a in angles_deg])
    T, B = np.linalg.inv(world[0]) @ world, behind()
    points, parts = (FRONT.xyz_m, BACK.xyz_m), (np.eye(4), B)
    boards, seen = [], []
    while len(boards) < n_moments:
        facing = looking(float(rng.choice(angles_deg[:towards])) + rng.uniform(-60.0, 60.0), 1e-9)
        pose = np.eye(4)
        pose[:3, :3] = facing[:3, :3] @ cv2.Rodrigues(rng.uniform(-most_tilt, most_tilt, 3))[0]
        pose[:3, 3] = rng.uniform(-0.35, 0.35, 3) * [1.0, 0.6, 1.0] - pose[:3, :3] @ FRONT.xyz_m.mean(axis=0)
        pose = np.linalg.inv(world[0]) @ pose
        here = [side_shown(k[c], np.linalg.inv(T[c]) @ pose, points, parts) for c in range(len(k))]
        if sum(one >= 0 for one in here) > 1:
            boards.append(pose)
            seen.append(here)
    return Turning(k=k, T=T, boards=np.array(boards), parts=parts, points=points, seen=np.array(seen))


LIGHTS = np.array(
    [[0.06 * np.cos(a), 0.06 * np.sin(a), 0.02 * (-1) ** k] for k, a in enumerate(np.radians(60.0 * np.arange(6)))]
)
"""A crown of six lights, every other one further out."""


def crown(angles_deg: tuple[float, ...], seed: int, n_moments: int = 60) -> Turning:
    """Cameras round a place and a crown of lights that turns every way, of which each camera sees four or more."""
    rng = np.random.default_rng(seed)
    still = plate(angles_deg, seed, 1)
    world = np.array([looking(a) for a in angles_deg])
    boards = []
    for _ in range(n_moments):
        pose = np.eye(4)
        pose[:3, :3] = cv2.Rodrigues(rng.uniform(-2.0, 2.0, 3))[0]
        pose[:3, 3] = rng.uniform(-0.3, 0.3, 3) * [1.0, 0.7, 1.0]
        boards.append(np.linalg.inv(world[0]) @ pose)
    lit = rng.random((n_moments, len(angles_deg), 6)) > 0.15
    seen = np.where(lit.sum(axis=2) >= 4, 0, -1)
    kept = (seen == 0).sum(axis=1) > 1
    return replace(
        still, boards=np.array(boards)[kept], parts=(np.eye(4),), points=(LIGHTS,), seen=seen[kept], lit=lit[kept]
    )


def side_shown(k: np.ndarray, front: np.ndarray, points: tuple, parts: tuple) -> int:
    """Which side a camera sees as a whole, -1 for none."""
    for side, (X, part) in enumerate(zip(points, parts, strict=True)):
        own = front @ part
        middle = own[:3, :3] @ X.mean(axis=0) + own[:3, 3]
        if middle[2] < 0.4 or own[:3, 2] @ middle / np.linalg.norm(middle) < MOST_SLANT:
            continue
        uv = pixels(k, own, X)
        if (uv > 2).all() and (uv < np.array(SIZE) - 3).all():
            return side
    return -1


def errors(done, true: Turning) -> np.ndarray:
    """(dt, dw) of the cameras' places, and of the back where there is one."""
    found = [*done.state.sides, *([done.state.back] if len(done.state.back) else [])]
    right = [*true.T[1:], *([in_axes_of_middles(true.parts[1])] if len(true.parts) > 1 else [])]
    each = []
    for pose, T in zip(found, right, strict=True):
        R = cv2.Rodrigues(pose[3:])[0]
        each.append(np.r_[pose[:3] - vector(T)[:3], cv2.Rodrigues(R @ T[:3, :3].T)[0].ravel()])
    return np.ravel(each)
