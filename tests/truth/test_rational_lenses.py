"""Rational lenses calibrated from boards in a world of its own: as near as the images allow, and as they say.

The lenses are alike those of an OAK-D wide and of an Azure Kinect's colour camera; the bound is the Cramer-Rao bound of
this world, its derivatives by differences.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.calibrate.cameras import BoardOptions, calibrate_camera
from armsight.errors import Inconsistent
from armsight.optics import LensKind
from armsight.records import BoardView
from armsight.store import parse_board
from refusals import refuses

BOARD = parse_board("checkerboard:11x8:0.030")
X = BOARD.xyz_m - BOARD.xyz_m.mean(axis=0)
SIGMA_PX = 0.1
DRAWS = 4
FREE = [0, 1, 2, 3, *range(5, 13)]
"""fx, fy, cx, cy and the eight coefficients among thirteen intrinsics."""


@dataclass(frozen=True)
class Lens:
    size: tuple[int, int]
    k: tuple[float, ...]  # fx, fy, cx, cy, then OpenCV's k1, k2, p1, p2, k3, k4, k5, k6
    reach: float  # tangent of the widest angle that is on the picture

    def pixels(self, P: np.ndarray, k: np.ndarray | None = None) -> np.ndarray:
        fx, fy, cx, cy, k1, k2, p1, p2, k3, k4, k5, k6 = self.k if k is None else k
        x, y = P[..., 0] / P[..., 2], P[..., 1] / P[..., 2]
        q = x**2 + y**2
        f = (1 + k1 * q + k2 * q**2 + k3 * q**3) / (1 + k4 * q + k5 * q**2 + k6 * q**3)
        u = fx * (x * f + 2 * p1 * x * y + p2 * (q + 2 * x**2)) + cx
        return np.stack([u, fy * (y * f + p1 * (q + 2 * y**2) + 2 * p2 * x * y) + cy], axis=-1)


OAK = Lens((1280, 800), (566.0, 566.3, 640.3, 398.2, 9.0, -5.2, 3e-4, -2e-4, 0.9, 9.3, -2.6, -0.4), 1.42)
KINECT = Lens((1280, 720), (607.0, 607.2, 637.4, 366.1, 0.45, -2.6, 7e-4, -3e-4, 1.5, 0.33, -2.4, 1.45), 1.4)
FIVE = Lens((1280, 720), (900.0, 901.0, 637.4, 366.1, -0.3, 0.12, 7e-4, -3e-4, -0.02, 0.0, 0.0, 0.0), 0.85)


def boards(lens: Lens, rng: np.random.Generator, n: int = 20) -> list[tuple[np.ndarray, np.ndarray]]:
    """Return poses (rotation vector, place) of boards all over the picture, some of them partly beside it."""
    found = []
    size, k = np.array(lens.size), np.array(lens.k)
    while len(found) < n:
        xy = (rng.uniform(-0.1, 1.1, 2) * size - k[2:4]) / k[:2] * rng.uniform(0.8, 1.3)
        ray = np.array([*xy, 1.0]) / np.sqrt(1.0 + xy @ xy)
        facing = Rotation.align_vectors(ray[None], [[0.0, 0.0, 1.0]])[0]
        tilt = Rotation.from_euler("zxy", rng.uniform([-180, -40, -40], [180, 40, 40]), degrees=True)
        pose = ((facing * tilt).as_rotvec(), rng.uniform(0.25, 0.7) * ray)
        P = Rotation.from_rotvec(pose[0]).apply(X) + pose[1]
        if (
            P[:, 2].min() > 0.02
            and np.hypot(*P[:, :2].T / P[:, 2]).max() < lens.reach
            and on_picture(lens, P).sum() > 39
        ):
            found.append(pose)
    return found


def on_picture(lens: Lens, P: np.ndarray) -> np.ndarray:
    uv = lens.pixels(P)
    return ((uv > 5.0) & (uv < np.array(lens.size) - 6.0)).all(axis=1)


def seen(lens: Lens, poses: list[tuple[np.ndarray, np.ndarray]], rng: np.random.Generator) -> list[BoardView]:
    views = []
    for turn, place in poses:
        P = Rotation.from_rotvec(turn).apply(X) + place
        index = np.flatnonzero(on_picture(lens, P))
        uv = lens.pixels(P[index]) + rng.normal(0.0, SIGMA_PX, (len(index), 2))
        source, (width, height) = str(len(views)), lens.size
        views.append(BoardView(source=source, width=width, height=height, index=index, uv_px=uv, sigma_px=SIGMA_PX))
    return views


def slopes(function, x: np.ndarray) -> np.ndarray:
    steps = 1e-6 * np.maximum(np.abs(x), 1e-2)
    return np.stack(
        [(function(x + e) - function(x - e)) / (2 * h) for h, e in zip(steps, np.diag(steps), strict=True)], axis=-1
    )


def bound(lens: Lens, poses: list[tuple[np.ndarray, np.ndarray]]) -> np.ndarray:
    """Return the Cramer-Rao bound (12, 12) of the lens's numbers, the boards' poses unknown."""
    information = np.zeros((12, 12))
    for turn, place in poses:
        index = np.flatnonzero(on_picture(lens, Rotation.from_rotvec(turn).apply(X) + place))

        def uv(x: np.ndarray, turn=turn, index=index) -> np.ndarray:
            P = (Rotation.from_rotvec(x[12:15]) * Rotation.from_rotvec(turn)).apply(X[index]) + x[15:]
            return lens.pixels(P, x[:12]).ravel()

        J = slopes(uv, np.concatenate([lens.k, np.zeros(3), place])) / SIGMA_PX
        A, B = J[:, :12], J[:, 12:]
        information += A.T @ A - A.T @ B @ np.linalg.solve(B.T @ B, B.T @ A)
    scale = np.sqrt(np.diag(information))
    return np.linalg.inv(information / np.outer(scale, scale)) / np.outer(scale, scale)


def judged(lens: Lens, seed: int, draws: int) -> tuple[float, float]:
    """Return the error over the bound of where the picture's rays are seen, and the share within 1.96 deviations."""
    rng = np.random.default_rng(seed)
    poses = boards(lens, rng)
    C = bound(lens, poses)
    P = np.concatenate([Rotation.from_rotvec(turn).apply(X) + place for turn, place in poses])
    P = P[on_picture(lens, P)][::17]
    D = slopes(lambda k: lens.pixels(P, k).ravel(), np.array(lens.k))
    least = np.einsum("ij,jk,ik->i", D, C, D)
    ratio, within = [], []
    for _ in range(draws):
        done = calibrate_camera(seen(lens, poses, rng), BOARD, BoardOptions(lens=LensKind.RATIONAL, folds=0))
        assert done.camera.lens is LensKind.RATIONAL
        off = done.camera.project(P).ravel() - lens.pixels(P).ravel()
        E = slopes(lambda k: lens.pixels(P, k).ravel(), done.camera.intrinsics[FREE])
        own = np.einsum("ij,jk,ik->i", E, done.covariance.matrix, E)
        ratio.append(np.mean(off**2 / least))
        within.append(np.mean(off**2 < 1.96**2 * own))
    return float(np.sqrt(np.mean(ratio))), float(np.mean(within))


def test_a_rational_lens_is_found_as_well_as_its_images_allow() -> None:
    ratio, within = judged(OAK, 1, DRAWS)
    assert ratio < 1.3  # of twelve numbers four times
    assert within > 0.85


def test_the_kind_of_lens_is_chosen_by_images_left_out() -> None:
    rng = np.random.default_rng(5)
    for lens, kind in ((KINECT, LensKind.RATIONAL), (FIVE, LensKind.PINHOLE)):
        views = seen(lens, boards(lens, rng, 25), rng)
        done = calibrate_camera(views, BOARD, BoardOptions(choose_lens=True, folds=0))
        assert done.camera.lens is kind
        assert f"--lens {kind}" in done.advice[0]


def test_what_is_no_rational_lens_is_refused_or_told() -> None:
    rng = np.random.default_rng(6)
    views = seen(KINECT, boards(KINECT, rng), rng)
    with refuses(Inconsistent, "rational", "--lens rational"):
        calibrate_camera(views, BOARD, BoardOptions(folds=0))


def test_of_a_plain_lens_a_rational_one_is_found_that_sees_alike() -> None:
    rng = np.random.default_rng(7)
    poses = boards(FIVE, rng)
    done = calibrate_camera(seen(FIVE, poses, rng), BOARD, BoardOptions(lens=LensKind.RATIONAL, folds=0))
    P = np.concatenate([Rotation.from_rotvec(turn).apply(X) + place for turn, place in poses])
    P = P[on_picture(FIVE, P)][::17]
    off = done.camera.project(P).ravel() - FIVE.pixels(P).ravel()
    E = slopes(lambda k: FIVE.pixels(P, k).ravel(), done.camera.intrinsics[FREE])
    assert (off**2 < 4.0**2 * np.einsum("ij,jk,ik->i", E, done.covariance.matrix, E)).all()
    assert set(done.covariance.names) >= {"k1", "k6"}
