"""Linear light of ordinary rooms behind lit targets, from the photographs among the real recordings.

Photographs of opencv_stereo and dots_10x10_handeye, enlarged, cropped, mirrored, tinted and exposed at random. The two
views show different photographs, both halves of a real stereo pair, or one photograph as a wall that both cameras see
at its place in space, so that what is bright there agrees with the rig as a light would.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from functools import cache

import cv2
import numpy as np

from bench import DATA
from lights import Array, Lens
from webcam import Light, linear_of

KINDS = ("different", "pair", "wall")
"""What composites draw from."""

PATTERNS = ("lamps", "grid", "screen", "white")
"""Walls with lights of their own, and one that is white all over; 'dark' is black."""
STEP = 32
"""Pixels between the rays of a wall's map; between them the map is linear."""

OPENCV_STEREO = tuple(n for n in range(1, 15) if n != 10)


@cache
def photographs() -> tuple[tuple[Light, ...], tuple[Light, ...], tuple[Light, ...]]:
    """Return the linear photographs (480, 640, 3): left ones and right ones of the pairs, and single ones."""
    stereo, dots = DATA / "opencv_stereo", DATA / "dots_10x10_handeye" / "images"
    left = [cv2.imread(str(stereo / f"left{n:02d}.jpg")) for n in OPENCV_STEREO]
    right = [cv2.imread(str(stereo / f"right{n:02d}.jpg")) for n in OPENCV_STEREO]
    single = [cv2.imread(str(dots / f"{n}.png")) for n in range(15)]
    if any(picture is None for picture in (*left, *right, *single)):
        raise FileNotFoundError(f"the photographs of opencv_stereo and dots_10x10_handeye are not in {DATA}")
    return tuple(map(linear_of, left)), tuple(map(linear_of, right)), tuple(map(linear_of, single))


def draw_backdrop(rng: np.random.Generator) -> dict[str, object]:
    """Return random settings: from dim to partly over-exposed, windows brighter than what a photograph holds."""
    return {
        "background": str(rng.choice(KINDS, p=[0.4, 0.25, 0.35])),
        "exposure": float(np.exp(rng.uniform(np.log(0.12), np.log(1.8)))),
        "highlights": float(rng.choice([0.0, 1.0, 3.0])),
        "tint": tuple(np.exp(rng.normal(0.0, 0.12, 3)).tolist()),
        "montage": bool(rng.uniform() < 0.4),
        "wall_m": float(rng.uniform(0.8, 4.0)),
    }


def backdrops(lenses: Sequence[Lens], settings: Mapping[str, object], rng: np.random.Generator) -> list[Light]:
    """Return the light (h, w, 3) behind the target for each lens."""
    kind = settings["background"]
    if kind == "dark":
        return [np.zeros((lens.height, lens.width, 3), np.float32) for lens in lenses]
    left, right, _ = photographs()
    if kind == "white":
        return [np.full((lens.height, lens.width, 3), 30.0, np.float32) for lens in lenses]
    if kind in PATTERNS:
        return _wall(lenses, pattern(lenses[0], settings, rng), settings, rng)
    if kind == "wall":
        views = _wall(lenses, sheet(lenses[0].width, lenses[0].height, bool(settings["montage"]), rng), settings, rng)
    elif kind == "pair":
        n, state = int(rng.integers(len(left))), rng.bit_generator.state
        views = []
        for lens, photo in zip(lenses, (left[n], right[n]), strict=True):
            rng.bit_generator.state = state  # both halves are cut and mirrored alike
            views.append(cut(photo, lens.width, lens.height, rng))
    else:
        views = [sheet(lens.width, lens.height, bool(settings["montage"]), rng) for lens in lenses]
    return [exposed(view, settings) for view in views]


def sheet(width: int, height: int, montage: bool, rng: np.random.Generator) -> Light:
    """Return one photograph cut to size, or four at their own sharpness."""
    left, right, single = photographs()
    every = (*left, *right, *single, *single)

    def one(w: int, h: int) -> Light:
        return cut(every[int(rng.integers(len(every)))], w, h, rng)

    if not montage:
        return one(width, height)
    x, y = int(rng.uniform(0.35, 0.65) * width), int(rng.uniform(0.35, 0.65) * height)
    top = np.hstack([one(x, y), one(width - x, y)])
    return np.vstack([top, np.hstack([one(x, height - y), one(width - x, height - y)])])


def cut(photo: Light, width: int, height: int, rng: np.random.Generator) -> Light:
    """Return a random part of a photograph, mirrored at random, enlarged to the size."""
    h, w = photo.shape[:2]
    largest = min(w / width, h / height)
    share = largest * rng.uniform(0.65, 1.0)
    cw, ch = int(share * width), int(share * height)
    x, y = int(rng.integers(w - cw + 1)), int(rng.integers(h - ch + 1))
    part = photo[y : y + ch, x : x + cw]
    if rng.uniform() < 0.5:
        part = part[:, ::-1]
    if rng.uniform() < 0.2:
        part = part[::-1]
    return np.asarray(cv2.resize(part, (width, height), interpolation=cv2.INTER_LINEAR))


def exposed(view: Light, settings: Mapping[str, object]) -> Light:
    """Return the view with its exposure and tint; what was nearly white may be brighter than the photograph says."""
    boost = np.float32(settings["highlights"])
    tint = np.array(settings["tint"], np.float32) * np.float32(settings["exposure"])
    if boost:
        near = np.clip((view[..., 1] - np.float32(0.7)) / np.float32(0.3), 0.0, 1.0)
        view = view * (1.0 + boost * near**2)[..., None]
    return view * tint


def pattern(lens: Lens, settings: Mapping[str, object], rng: np.random.Generator) -> Light:
    """Return a sheet, exposed, with lights on it: round lamps and tubes, a grid of lights, or a screen's squares."""
    width, height, level = 2 * lens.width, 2 * lens.height, float(settings["level"])
    photo = exposed(sheet(lens.width, lens.height, bool(settings["montage"]), rng), settings)
    out = cv2.resize(photo, (width, height), interpolation=cv2.INTER_LINEAR)
    fine = 16  # cv2 draws in sixteenths of a pixel

    def at(*xy: float) -> tuple[int, int]:
        return round(fine * xy[0]), round(fine * xy[1])

    if settings["background"] == "grid":
        pitch, radius = rng.uniform(0.045, 0.09) * width, rng.uniform(0.002, 0.005) * width
        for x in np.arange(0.5 * pitch, width, pitch):
            for y in np.arange(0.5 * pitch, height, pitch):
                cv2.circle(out, at(x, y), round(fine * radius), (level,) * 3, -1, cv2.LINE_AA, 4)
    elif settings["background"] == "lamps":
        for _ in range(int(rng.integers(8, 30))):
            x, y = rng.uniform([0, 0], [width, height])
            size, bright = np.exp(rng.uniform(np.log(0.002), np.log(0.04))) * width, float(rng.uniform(1.0, 8.0))
            if rng.uniform() < 0.7:
                cv2.circle(out, at(x, y), round(fine * 0.5 * size), (bright,) * 3, -1, cv2.LINE_AA, 4)
            else:
                cv2.line(out, at(x, y), at(x + 4.0 * size, y), (bright,) * 3, max(1, int(0.3 * size)), cv2.LINE_AA, 4)
    else:
        x0, y0 = (rng.uniform(0.15, 0.3, 2) * (width, height)).astype(int)
        x1, y1 = (rng.uniform(0.7, 0.85, 2) * (width, height)).astype(int)
        out[y0:y1, x0:x1] = 0.004
        for _ in range(60):
            a, b = rng.integers([x0, y0], [x1, y1])
            w, h = rng.integers(6, 40, 2)
            out[b : min(b + h, y1), a : min(a + w, x1)] = level * rng.uniform(0.3, 1.0)
    return np.asarray(out)


def _wall(lenses: Sequence[Lens], big: Light, settings: Mapping[str, object], rng: np.random.Generator) -> list[Light]:
    """Return what the lenses see of one sheet that hangs behind the target, a little turned."""
    depth, turn = float(settings["wall_m"]), rng.uniform(-0.25, 0.25, 2)
    normal = np.array([turn[0], turn[1], 1.0])
    width, height = lenses[0].width, lenses[0].height
    scale = big.shape[1] / width
    per_m = 0.75 * scale * lenses[0].f[0] / depth
    views = []
    for lens in lenses:
        grid_u, grid_v = np.arange(0, width + STEP, STEP), np.arange(0, height + STEP, STEP)
        u, v = np.meshgrid(grid_u, grid_v)
        rays = lens.rays(np.column_stack([u.ravel(), v.ravel()]).astype(float))
        s = ((np.array([0.0, 0.0, depth]) - lens.eye) @ normal) / (rays @ normal)
        at = (lens.eye + s[:, None] * rays)[:, :2] * per_m + (0.5 * scale * width, 0.5 * scale * height)
        x, y = (_spread(at[:, i].reshape(u.shape), width, height) for i in (0, 1))
        views.append(cv2.remap(big, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REFLECT))
    return views


def _spread(coarse: Array, width: int, height: int) -> Light:
    """Return values given every STEP pixels, linear in between, at every pixel."""

    def weights(n: int, m: int) -> Array:
        at = np.arange(n) / STEP
        first = np.minimum(at.astype(int), m - 2)
        out = np.zeros((n, m))
        out[np.arange(n), first] = 1.0 - (at - first)
        out[np.arange(n), first + 1] = at - first
        return out

    rows, columns = coarse.shape
    return (weights(height, rows) @ coarse @ weights(width, columns).T).astype(np.float32)
