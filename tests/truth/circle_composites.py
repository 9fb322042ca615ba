"""Circle grids printed on paper that lies in real photographs: what a detector meets on a bench, with the truth.

The photographs are those beside the repository (opencv_stereo, dots_10x10_handeye, rooms). Nothing here comes from the
product but the board's points: every sub-pixel is traced back to the paper, and centres are those of the outlines'
images, found by OpenCV's projection of finely traced rings.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.records import Target, TargetKind, board_target

Array = NDArray[np.float64]
Image = NDArray[np.uint8]

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
FOLDERS = ("opencv_stereo", "dots_10x10_handeye/images", "rooms/left", "rooms/right")

PITCH_M = 0.025
OVER = 3
"""Sub-pixels along each axis; at a dot's edge each has its covered share."""
SYMMETRIC = ((7, 5), (9, 7), (11, 7), (7, 11), (10, 10), (6, 6), (5, 4))
ASYMMETRIC = ((4, 11), (3, 9), (5, 7))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Print:
    """How a board is printed and lit: radius and paper's edge in pitches, reflectances, blur in px."""

    board: Target
    radius: float
    edge: float
    ink: float
    paper: float
    slope: Array
    blur_px: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Composite:
    """The picture, the board in it, and the centres (n, 2) of its dots' outlines in px."""

    image: Image
    board: Target
    uv_px: Array
    light_dots: bool
    photograph: str


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """A camera of OpenCV's model before the board: p_camera = R p_board + t."""

    width: int
    height: int
    K: Array
    lens: Array
    R: Array
    t_m: Array

    def project(self, xyz_m: Array) -> Array:
        """Return pixels (n, 2)."""
        return np.asarray(cv2.projectPoints(xyz_m, cv2.Rodrigues(self.R)[0], self.t_m, self.K, self.lens)[0])[:, 0]


@cache
def photographs() -> tuple[tuple[str, Image], ...]:
    """Return the photographs' names and grey levels (h, w); none where they are not beside the repository."""
    files = [path for folder in FOLDERS for path in sorted((DATA / folder).glob("*.[jp][pn]g"))]
    return tuple((f"{path.parent.name}/{path.name}", cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)) for path in files)


def composite(seed: int) -> Composite:
    """Return the picture of one random board on one random photograph."""
    rng = np.random.default_rng([18, seed])
    name, photograph = photographs()[int(rng.integers(len(photographs())))]
    return lay(draw_board(rng), name, photograph, rng)


def draw_board(rng: np.random.Generator) -> Target:
    """Return a board of one of the usual sizes."""
    if rng.uniform() < 0.3:
        return board_target(TargetKind.ACIRCLES, *ASYMMETRIC[int(rng.integers(len(ASYMMETRIC)))], PITCH_M)
    return board_target(TargetKind.CIRCLES, *SYMMETRIC[int(rng.integers(len(SYMMETRIC)))], PITCH_M)


def lay(board: Target, name: str, photograph: Image, rng: np.random.Generator) -> Composite:
    """Return the photograph with the board laid into it, whole, at a random pose."""
    if rng.uniform() < 0.5:
        photograph = np.ascontiguousarray(photograph[:, ::-1])
    light = bool(rng.uniform() < 0.15)
    asymmetric = board.kind is TargetKind.ACIRCLES
    radius = float(rng.uniform(0.3, 0.55) if asymmetric else rng.uniform(0.2, 0.35))
    level = float(rng.uniform(0.35, 0.95))
    printed = Print(
        board=board,
        radius=radius,
        edge=radius + float(rng.uniform(0.15, 1.0)),
        ink=level if light else level * float(rng.uniform(0.05, 0.2)),
        paper=level * float(rng.uniform(0.05, 0.2)) if light else level,
        slope=rng.normal(0.0, 0.12, 2),
        blur_px=float(rng.uniform(0.4, 1.2)),
    )
    view = draw_view(printed, photograph.shape, rng)
    return Composite(
        image=develop(printed, view, photograph, rng),
        board=board,
        uv_px=outline_centres(printed, view),
        light_dots=light,
        photograph=name,
    )


def draw_view(printed: Print, shape: tuple[int, ...], rng: np.random.Generator) -> View:
    """Return a view in which the whole paper is seen, its dots at least 2.5 px in radius."""
    height, width = shape
    f = float(rng.uniform(0.7, 1.4)) * width
    K = np.array([[f, 0.0, 0.5 * width], [0.0, f, 0.5 * height], [0.0, 0.0, 1.0]])
    lens = np.array([rng.uniform(-0.2, 0.05), 0.0, 0.0, 0.0, 0.0])
    middle, corners = printed.board.xyz_m.mean(axis=0), paper_corners(printed)
    for _ in range(1000):
        tilt = np.radians(rng.uniform(0.0, 50.0)) * np.array([*_direction(rng), 0.0])
        turn = np.array([0.0, 0.0, rng.uniform(-np.pi, np.pi)])
        R = cv2.Rodrigues(tilt)[0] @ cv2.Rodrigues(turn)[0]
        pitch_px = float(np.exp(rng.uniform(np.log(10.0), np.log(70.0))))
        depth = f * PITCH_M / pitch_px
        at = np.array([rng.uniform(-0.4, 0.4) * width, rng.uniform(-0.4, 0.4) * height]) / f
        t = np.array([*(at * depth), depth]) - R @ middle
        view = View(width=width, height=height, K=K, lens=lens, R=np.asarray(R), t_m=t)
        if ((corners @ R.T + t)[:, 2] < 0.3 * depth).any():
            continue
        uv = view.project(corners)
        if (uv < 3.0).any() or (uv > np.array([width, height]) - 4.0).any():
            continue
        if _least_radius_px(printed, view) >= 2.5:
            return view
    raise AssertionError("no view of the board was found")


def _direction(rng: np.random.Generator) -> Array:
    angle = rng.uniform(0.0, 2.0 * np.pi)
    return np.array([np.cos(angle), np.sin(angle)])


def paper_corners(printed: Print) -> Array:
    """Return the sheet's corners (4, 3) in m."""
    low, high = printed.board.xyz_m.min(axis=0)[:2], printed.board.xyz_m.max(axis=0)[:2]
    low, high = low - printed.edge * PITCH_M, high + printed.edge * PITCH_M
    return np.array([[low[0], low[1], 0.0], [high[0], low[1], 0.0], [high[0], high[1], 0.0], [low[0], high[1], 0.0]])


def _rings(printed: Print, n: int) -> Array:
    a = np.linspace(0.0, 2.0 * np.pi, n, endpoint=False)
    ring = np.stack([np.cos(a), np.sin(a), 0.0 * a], axis=1) * printed.radius * PITCH_M
    return np.asarray(printed.board.xyz_m[:, None] + ring)


def _least_radius_px(printed: Print, view: View) -> float:
    uv = view.project(_rings(printed, 16).reshape(-1, 3)).reshape(-1, 16, 2)
    return float(np.linalg.norm(uv - uv.mean(axis=1, keepdims=True), axis=2).min())


def outline_centres(printed: Print, view: View) -> Array:
    """Return the centres of area (n, 2) of the dots' images."""
    rings = view.project(_rings(printed, 200).reshape(-1, 3)).reshape(-1, 200, 2)
    x, y = rings[..., 0], rings[..., 1]
    x1, y1 = np.roll(x, -1, axis=1), np.roll(y, -1, axis=1)
    cross = x * y1 - x1 * y
    area = cross.sum(axis=1) / 2.0
    return np.stack([((x + x1) * cross).sum(axis=1), ((y + y1) * cross).sum(axis=1)], axis=1) / (6.0 * area[:, None])


def develop(printed: Print, view: View, photograph: Image, rng: np.random.Generator) -> Image:
    """Return the photograph with the sheet before it: blurred, with noise, and compressed half of the time."""
    uv = view.project(paper_corners(printed))
    low = np.maximum(np.floor(uv.min(axis=0)).astype(int) - 4, 0)
    high = np.minimum(np.ceil(uv.max(axis=0)).astype(int) + 5, [view.width, view.height])
    light, cover = trace(printed, view, low, high)
    light, cover = (cv2.GaussianBlur(part, (0, 0), printed.blur_px) for part in (light, cover))
    part = photograph[low[1] : high[1], low[0] : high[0]] / 255.0
    linear = np.where(part <= 0.04045, part / 12.92, ((part + 0.055) / 1.055) ** 2.4)
    seen = np.clip(linear * (1.0 - cover) + light, 0.0, 1.0)
    curved = np.where(seen <= 0.0031308, seen * 12.92, 1.055 * seen ** (1 / 2.4) - 0.055)
    picture = photograph.astype(float)
    picture[low[1] : high[1], low[0] : high[0]] = 255.0 * curved
    picture += rng.normal(0.0, rng.uniform(0.3, 4.0), picture.shape)
    image = np.clip(np.rint(picture), 0, 255).astype(np.uint8)
    if rng.uniform() < 0.5:
        coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(rng.integers(60, 96))])[1]
        image = cv2.imdecode(coded, cv2.IMREAD_GRAYSCALE)
    return np.asarray(image, dtype=np.uint8)


def trace(printed: Print, view: View, low: NDArray[np.intp], high: NDArray[np.intp]) -> tuple[Array, Array]:
    """Return light and cover (h, w) of the sheet in the window from low to high (u, v), light in linear levels."""
    w, h = high - low
    cells = np.stack(np.meshgrid(np.arange(OVER * w), np.arange(OVER * h)), axis=-1)
    grid = ((cells + 0.5) / OVER - 0.5 + low).reshape(-1, 1, 2)
    rays = cv2.undistortPointsIter(grid, view.K, view.lens, None, None, (3, 20, 1e-9)).reshape(-1, 2)
    d = np.column_stack([rays, np.ones(len(rays))]) @ view.R
    o = -view.R.T @ view.t_m
    xy = (o[:2] - d[:, :2] * (o[2] / d[:, 2])[:, None]) / PITCH_M  # pitches
    grain = float(np.linalg.norm(o)) / PITCH_M / view.K[0, 0] / OVER
    corners = paper_corners(printed)[[0, 2], :2] / PITCH_M
    inside = np.minimum(xy - corners[0], corners[1] - xy).min(axis=1)
    cover = np.clip(0.5 + inside / grain, 0.0, 1.0)
    ink = np.clip(0.5 + _inner(printed, xy) / grain, 0.0, 1.0)
    level = (printed.paper + (printed.ink - printed.paper) * ink) * (1.0 + (xy - xy.mean(axis=0)) @ printed.slope / 5.0)
    planes = np.stack([cover * np.maximum(level, 0.0), cover]).reshape(2, h, OVER, w, OVER).mean(axis=(2, 4))
    return planes[0], planes[1]


def _inner(printed: Print, xy: Array) -> Array:
    """Return how far (n,) points of the sheet lie inside the nearest dot, in pitches."""
    board = printed.board
    row = np.clip(np.rint(xy[:, 1]), 0, board.rows - 1)
    if board.kind is TargetKind.CIRCLES:
        column = np.clip(np.rint(xy[:, 0]), 0, board.columns - 1)
        return np.asarray(printed.radius - np.hypot(xy[:, 0] - column, xy[:, 1] - row))
    nearest = np.full(len(xy), np.inf)
    for step in (-1, 0, 1):  # the nearest dot of an asymmetric grid may be in the next row
        r = np.clip(row + step, 0, board.rows - 1)
        column = 2 * np.clip(np.rint((xy[:, 0] - r % 2) / 2), 0, board.columns - 1) + r % 2
        nearest = np.minimum(nearest, np.hypot(xy[:, 0] - column, xy[:, 1] - r))
    return np.asarray(printed.radius - nearest)
