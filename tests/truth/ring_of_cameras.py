"""Cameras round a place, projected by OpenCV, and a printed board that turns before some of them at a time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import cv2
import numpy as np

from armsight.records import BoardView, TargetKind, board_target

SIZE = (1280, 720)
BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.04)
NAMES = ("fx", "fy", "cx", "cy", "skew", "k1", "k2", "p1", "p2", "k3")
POSE = ("tx", "ty", "tz", "rx", "ry", "rz")
MOST_SLANT = np.cos(np.radians(60.0))


def matrix(pose: np.ndarray) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = cv2.Rodrigues(pose[3:])[0], pose[:3]
    return T


def vector(T: np.ndarray) -> np.ndarray:
    return np.r_[T[:3, 3], cv2.Rodrigues(T[:3, :3])[0].ravel()]


def pixels(k: np.ndarray, T: np.ndarray, points: np.ndarray = BOARD.xyz_m) -> np.ndarray:
    """Pixels (n, 2) of points (n, 3), the board's, at T_camera_board (4, 4); k (10,) in the order of NAMES."""
    X = points @ T[:3, :3].T + T[:3, 3]
    K = np.array([[k[0], 0.0, k[2]], [0.0, k[1], k[3]], [0.0, 0.0, 1.0]])
    uv = cv2.projectPoints(X, np.zeros(3), np.zeros(3), K, k[5:])[0].reshape(-1, 2)
    return uv + k[4] * (uv[:, 1:] - k[3]) / k[1] * [1.0, 0.0]


@dataclass(frozen=True)
class Ring:
    """k (C, 10), T_first_camera (C, 4, 4), boards T_first_board (G, 4, 4), seen (G, C)."""

    k: np.ndarray
    T: np.ndarray
    boards: np.ndarray
    seen: np.ndarray

    def uv(self, late: np.ndarray | None = None, at: Callable[[float, int], np.ndarray] | None = None) -> np.ndarray:
        """Pixels (G, C, n, 2) without noise; at: T_first_board of a moment when a camera's clock is late (C,) s."""
        out = np.full((*self.seen.shape, len(BOARD.xyz_m), 2), np.nan)
        for g, c in zip(*np.nonzero(self.seen), strict=True):
            board = self.boards[g] if at is None or late is None else at(float(late[c]), int(g))
            out[g, c] = pixels(self.k[c], np.linalg.inv(self.T[c]) @ board)
        return out

    def parameters(self) -> np.ndarray:
        """The 16 C - 6 numbers."""
        return np.r_[self.k.ravel(), np.ravel([vector(T) for T in self.T[1:]])]

    def names(self, cameras: tuple[str, ...]) -> list[str]:
        return [f"{c}.{n}" for c in cameras for n in NAMES] + [f"{c}.{n}" for c in cameras[1:] for n in POSE]

    def bound(self, sigma_px: float) -> np.ndarray:
        """Cramer-Rao covariance (S, S) of the numbers, rotations as Exp(dw) R, by differences of OpenCV's pixels."""
        C, G, n = len(self.k), len(self.boards), 16 * len(self.k) - 6
        H, W, D = np.zeros((n, n)), np.zeros((G, n, 6)), np.zeros((G, 6, 6))
        step = np.r_[np.tile([1e-3] * 5 + [1e-5] * 5, 1)]
        for g, c in zip(*np.nonzero(self.seen), strict=True):
            base = (self.k[c], self.T[c], self.boards[g])

            def at(k: np.ndarray, camera: np.ndarray, board: np.ndarray) -> np.ndarray:
                return pixels(k, np.linalg.inv(camera) @ board).ravel()

            J = np.zeros((2 * len(BOARD.xyz_m), n))
            for i in range(10):
                h = np.zeros(10)
                h[i] = step[i]
                J[:, 10 * c + i] = (at(base[0] + h, *base[1:]) - at(base[0] - h, *base[1:])) / (2.0 * step[i])
            own = np.zeros((2 * len(BOARD.xyz_m), 6))
            for i in range(6):
                h = np.zeros(6)
                h[i] = 1e-6
                if c:
                    J[:, 10 * C + 6 * (c - 1) + i] = (
                        at(base[0], moved(base[1], h), base[2]) - at(base[0], moved(base[1], -h), base[2])
                    ) / 2e-6
                own[:, i] = (at(base[0], base[1], moved(base[2], h)) - at(base[0], base[1], moved(base[2], -h))) / 2e-6
            H += J.T @ J
            W[g] += J.T @ own
            D[g] += own.T @ own
        H -= np.einsum("gsl,glk,gtk->st", W, np.linalg.inv(D), W)
        scale = 1.0 / np.sqrt(np.diag(H))
        return np.linalg.inv(H * np.outer(scale, scale)) * np.outer(scale, scale) * sigma_px**2


def moved(T: np.ndarray, step: np.ndarray) -> np.ndarray:
    """T + dt, Exp(dw) R of a step (dt, dw)."""
    out = T.copy()
    out[:3, :3] = cv2.Rodrigues(step[3:])[0] @ T[:3, :3]
    out[:3, 3] += step[:3]
    return out


def off(found: np.ndarray, true: np.ndarray) -> np.ndarray:
    """(dt, dw) from a true pose (4, 4) to a found one."""
    return np.r_[found[:3, 3] - true[:3, 3], cv2.Rodrigues(found[:3, :3] @ true[:3, :3].T)[0].ravel()]


def looking(at_deg: float, distance_m: float = 1.5) -> np.ndarray:
    """T_world_camera of a camera round the origin that looks at it."""
    a = np.radians(at_deg)
    place = distance_m * np.array([np.sin(a), 0.15 * np.cos(3.0 * a), -np.cos(a)])
    z = -place / np.linalg.norm(place)
    x = np.cross([0.0, 1.0, 0.0], z)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack([x, np.cross(z, x), z]), place
    return T


def ring(rng: np.random.Generator, n_cameras: int = 4, n_moments: int = 60, apart_deg: float = 55.0) -> Ring:
    """Cameras apart_deg apart round a place; of every board two neighbours at least see it, never all cameras."""
    k = np.array(
        [
            [900.0, 903.0, 640.0, 360.0, 0.0, -0.1, 0.05, 0.0, 0.0, 0.0]
            + rng.normal(0.0, 1.0, 10) * [20, 20, 10, 10, 0.5, 0.02, 0.02, 5e-4, 5e-4, 0.005]
            for _ in range(n_cameras)
        ]
    )
    world = np.array([looking(apart_deg * (c - 0.5 * (n_cameras - 1))) for c in range(n_cameras)])
    T = np.linalg.inv(world[0]) @ world
    boards, seen = [], []
    while len(boards) < n_moments:
        front = looking(rng.uniform(-0.5, 0.5) * apart_deg * (n_cameras - 1), 0.0 + 1e-9)
        board = moved(np.eye(4), np.r_[0, 0, 0, rng.uniform(-0.5, 0.5, 3)])
        pose = np.eye(4)
        pose[:3, :3] = front[:3, :3] @ board[:3, :3]
        pose[:3, 3] = rng.uniform(-0.45, 0.45, 3) * [1.0, 0.6, 1.0] - pose[:3, :3] @ BOARD.xyz_m.mean(axis=0)
        pose = np.linalg.inv(world[0]) @ pose
        here = visible(k, T, pose)
        if 1 < sum(here) < max(n_cameras, 3):
            boards.append(pose)
            seen.append(here)
    return Ring(k=k, T=T, boards=np.array(boards), seen=np.array(seen))


def seen_from(of: Ring, order: list[int]) -> Ring:
    """The same cameras in another order, in axes of the one that is then first."""
    back = np.linalg.inv(of.T[order[0]])
    return Ring(k=of.k[order], T=back @ of.T[order], boards=back @ of.boards, seen=of.seen[:, order])


def visible(k: np.ndarray, T: np.ndarray, board: np.ndarray) -> list[bool]:
    """Whether each camera sees the whole board at T_first_board from its front, not too slanted."""
    out = []
    for intrinsics, camera in zip(k, T, strict=True):
        own = np.linalg.inv(camera) @ board
        middle = own[:3, :3] @ BOARD.xyz_m.mean(axis=0) + own[:3, 3]
        slant = own[:3, 2] @ middle / np.linalg.norm(middle)
        uv = pixels(intrinsics, own) if middle[2] > 0.4 else np.full((1, 2), -1.0)
        out.append(bool(slant > MOST_SLANT and (uv > 2).all() and (uv < np.array(SIZE) - 3).all()))
    return out


def waved(still: Ring, n_moments: int = 60, interval_s: float = 0.1) -> tuple[Ring, Callable[[float, int], np.ndarray]]:
    """The same cameras before a board that a hand waves, and T_first_board by (seconds after, moment)."""
    world = looking(-55.0 * 0.5 * (len(still.k) - 1))
    middle = BOARD.xyz_m.mean(axis=0)

    def at(late_s: float, g: int) -> np.ndarray:
        t = 0.6 * (interval_s * g + late_s)
        front = looking(75.0 * np.cos(1.4 * t), 1e-9)
        pose = np.eye(4)
        tilt = 0.4 * np.array([np.sin(1.7 * t), np.cos(1.3 * t), np.sin(1.1 * t + 1.0)])
        pose[:3, :3] = front[:3, :3] @ cv2.Rodrigues(tilt)[0]
        place = 0.25 * np.array([np.sin(1.5 * t), 0.5 * np.cos(2.1 * t), np.cos(1.2 * t)])
        pose[:3, 3] = place - pose[:3, :3] @ middle
        return np.linalg.inv(world) @ pose

    boards = np.array([at(0.0, g) for g in range(n_moments)])
    seen = np.array([visible(still.k, still.T, one) for one in boards])
    return Ring(k=still.k, T=still.T, boards=boards, seen=seen), at


def rolled(film: Ring, at: Callable[[float, int], np.ndarray], late: np.ndarray, readout_s: np.ndarray) -> np.ndarray:
    """Pixels (G, C, n, 2) of cameras that read their rows one after the other, the middle one at the picture's time."""
    out = np.full((*film.seen.shape, len(BOARD.xyz_m), 2), np.nan)
    node = np.linspace(-0.5, 0.5, 5)
    others = [np.delete(node, j) for j in range(5)]
    for g, c in zip(*np.nonzero(film.seen), strict=True):
        back = np.linalg.inv(film.T[c])
        uv = np.array([pixels(film.k[c], back @ at(late[c] + readout_s[c] * x, int(g))) for x in node])
        seen = uv[2]
        for _ in range(4):  # a point is seen where it was when its row was read
            line = seen[:, 1] / (SIZE[1] - 1.0) - 0.5
            weight = [np.prod((line[:, None] - o) / (x - o), axis=1) for x, o in zip(node, others, strict=True)]
            seen = np.einsum("jn,jnk->nk", weight, uv)
        out[g, c] = seen
    return out


def views(
    uv: np.ndarray, cameras: tuple[str, ...], sigma_px: float, size: tuple[int, int] = SIZE
) -> dict[str, list[BoardView | None]]:
    """Views by camera of pixels (G, C, n, 2), NaN where nothing is seen."""
    index = np.arange(uv.shape[2])
    return {
        name: [
            None
            if not np.isfinite(one).all()
            else BoardView(
                uv_px=one, index=index, sigma_px=sigma_px, width=size[0], height=size[1], source=f"{name}/{g}"
            )
            for g, one in enumerate(uv[:, c])
        ]
        for c, name in enumerate(cameras)
    }
