"""Surfaces drawn by rule: plaster, brick, wood, metal, screens, posters, cut-outs. Colours are blue, green, red."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight_sim.rooms.scene import Texture

Array = NDArray[np.float32]
Colour = tuple[float, float, float]
Rng = np.random.Generator


def stored(reflectance: NDArray[np.floating], cover: NDArray[np.floating] | None = None) -> Texture:
    """Return the texture of a reflectance (h, w, 3), 1 for white, and a coverage (h, w)."""
    height, width = reflectance.shape[:2]
    out = np.full((height, width, 4), 255, np.uint8)
    out[:, :, :3] = np.round(255.0 * np.sqrt(np.clip(reflectance, 0.0, 1.0)))
    if cover is not None:
        out[:, :, 3] = np.round(255.0 * np.clip(cover, 0.0, 1.0))
    return Texture(bytes=out)


def noise(size: tuple[int, int], cells: int, octaves: int, rng: Rng, *, stretch: float = 1.0) -> Array:
    """Return noise (h, w) of mean 0 and standard deviation 1 that repeats without a seam; each octave half as strong
    and fine.

    cells: of the coarsest octave over the width; stretch: how much longer than high its grains are.
    """
    height, width = size
    total = np.zeros(size, np.float32)
    for octave in range(octaves):
        columns = min(max(2, round(cells * 2**octave)), width)
        rows = min(max(2, round(cells * 2**octave * stretch * height / width)), height)
        grid = rng.normal(size=(rows, columns)).astype(np.float32)
        pad = np.pad(grid, 2, mode="wrap")
        scale = (width / columns, height / rows)
        full = (round(pad.shape[1] * scale[0]), round(pad.shape[0] * scale[1]))
        large = cv2.resize(pad, full, interpolation=cv2.INTER_CUBIC)
        j, i = round(2 * scale[1]), round(2 * scale[0])
        total += large[j : j + height, i : i + width] * 0.5**octave
    return np.asarray((total - total.mean()) / total.std(), dtype=np.float32)


def tinted(grain: NDArray[np.floating], colour: Colour, contrast: float) -> Array:
    """Return a colour (h, w, 3) whose brightness follows grain (h, w)."""
    return np.asarray(np.exp(contrast * grain)[:, :, None] * np.array(colour), dtype=np.float32)


def plaster(rng: Rng, colour: Colour, size: int = 768) -> Texture:
    """Return a painted wall of 2.5 m: roller grain, patches, scuffs."""
    fine = noise((size, size), 160, 3, rng)
    broad = noise((size, size), 3, 4, rng)
    image = tinted(0.035 * fine + 0.05 * broad, colour, 1.0)
    for _ in range(14):
        position = rng.uniform(0, size, 2)
        end = position + rng.normal(0, 30, 2)
        scuff = np.zeros((size, size), np.float32)
        cv2.line(scuff, position.astype(int).tolist(), end.astype(int).tolist(), 1.0, int(rng.integers(1, 3)))
        image *= (1.0 - rng.uniform(0.1, 0.4) * cv2.GaussianBlur(scuff, (0, 0), 1.2))[:, :, None]
    return stored(image)


def brick(rng: Rng, colour: Colour, size: int = 1024) -> Texture:
    """Return brickwork of 2 m: courses of 77 mm, every brick of its own tone, rough mortar."""
    rows, columns = 26, 8
    v, u = np.mgrid[0:size, 0:size] / size
    wobble = 0.0015 * noise((size, size), 40, 3, rng)
    row = np.floor((v + wobble) * rows) % rows
    across = (u + wobble) * columns + 0.5 * (row % 2)
    column = np.floor(across) % columns
    high, wide = (v + wobble) * rows % 1.0, across % 1.0
    joint = np.minimum(np.minimum(high, 1.0 - high) / rows, np.minimum(wide, 1.0 - wide) / columns) * size
    mortar = np.clip((4.0 - joint) / 2.0, 0.0, 1.0)[:, :, None]
    tone = rng.normal(0.0, 0.22, (rows, columns))[row.astype(int), column.astype(int)]
    hue = rng.normal(0.0, 0.08, (rows, columns, 3))[row.astype(int), column.astype(int)]
    grain = noise((size, size), 60, 4, rng)
    bricks = tinted(tone + 0.12 * grain, colour, 1.0) * np.exp(hue)
    joints = tinted(0.1 * noise((size, size), 100, 3, rng), (0.40, 0.43, 0.45), 1.0)
    return stored(bricks * (1.0 - mortar) + joints * mortar)


def concrete(rng: Rng, colour: Colour, size: int = 1024) -> Texture:
    """Return a floor of 3 m: grain, stains, cracks."""
    broad, fine = noise((size, size), 4, 6, rng), noise((size, size), 220, 2, rng)
    stains = np.clip(noise((size, size), 6, 3, rng) - 1.1, 0.0, 1.0)
    image = tinted(0.13 * broad + 0.06 * fine - 0.5 * stains, colour, 1.0)
    crack = np.zeros((size, size), np.float32)
    for _ in range(3):
        position = np.cumsum(
            np.vstack([rng.uniform(0, size, 2), rng.normal(0, 14, (50, 2)) + rng.normal(0, 9, 2)]), axis=0
        )
        cv2.polylines(crack, [np.round(position).astype(np.int32)], False, 1.0, 1, cv2.LINE_AA)
    return stored(image * (1.0 - 0.55 * crack)[:, :, None])


def wood(rng: Rng, colour: Colour, size: tuple[int, int] = (256, 768)) -> Texture:
    """Return boards with grain along the width."""
    height, width = size
    v = np.mgrid[0:height, 0:width][0] / height
    bend = noise(size, 2, 3, rng, stretch=4.0)
    rings = np.sin(2.0 * np.pi * (9.0 * v + 0.6 * bend))
    pores = noise(size, 24, 3, rng, stretch=14.0)
    planks = rng.normal(0.0, 0.1, 4)[np.minimum((4 * v).astype(int), 3)]
    gap = (np.abs((4 * v) % 1.0 - 0.5) > 0.485).astype(np.float32)
    return stored(tinted(0.10 * rings + 0.12 * pores + planks - 0.9 * gap, colour, 1.0))


def metal(rng: Rng, colour: Colour, size: tuple[int, int] = (256, 256)) -> Texture:
    """Return brushed sheet metal with scratches."""
    grain = noise(size, 6, 3, rng, stretch=40.0)
    image = tinted(0.10 * grain + 0.05 * noise(size, 4, 3, rng), colour, 1.0)
    for _ in range(10):
        position, end = rng.integers(0, size[0], 2), rng.integers(0, size[0], 2)
        cv2.line(image, position.tolist(), end.tolist(), [1.3 * c for c in colour], 1, cv2.LINE_AA)
    return stored(image)


def paint(rng: Rng, colour: Colour, size: int = 128) -> Texture:
    """Return a painted or plastic surface: nearly even, with worn rims."""
    image = tinted(0.04 * noise((size, size), 5, 4, rng), colour, 1.0)
    rim = np.minimum.reduce([np.arange(size)[:, None] + np.zeros(size), np.arange(size)[None, :] + np.zeros((size, 1))])
    rim = np.minimum(rim, rim[::-1, ::-1])
    image *= (1.0 - 0.25 * np.exp(-rim / 2.5))[:, :, None]
    return stored(image)


def cardboard(rng: Rng, size: int = 256) -> Texture:
    """Return a carton's side: tape, a printed label, creases."""
    image = tinted(0.06 * noise((size, size), 8, 4, rng, stretch=0.3), (0.16, 0.29, 0.42), 1.0)
    image[int(0.47 * size) : int(0.55 * size)] *= np.array([1.15, 1.2, 1.25], np.float32)
    i, j = int(rng.uniform(0.08, 0.5) * size), int(rng.uniform(0.08, 0.5) * size)
    label = image[j : j + int(0.3 * size), i : i + int(0.38 * size)]
    label[:] = (0.75, 0.78, 0.78)
    for line in range(6, label.shape[0] - 6, 7):
        cv2.line(label, (6, line), (int(rng.uniform(0.4, 0.95) * label.shape[1]), line), (0.08, 0.08, 0.08), 2)
    return stored(image)


def poster(rng: Rng, size: tuple[int, int] = (640, 460)) -> Texture:
    """Return a printed sheet: a head line, text, a chart."""
    height, width = size
    image = np.full((height, width, 3), 0.78, np.float32)
    hue = rng.uniform(0.05, 0.7, 3)
    image[: height // 7] = hue
    for line in range(height // 6, height // 2, 14):
        at = 24
        while at < width - 60:
            word = int(rng.uniform(12, 50))
            cv2.rectangle(image, (at, line), (at + word, line + 6), (0.12, 0.12, 0.12), -1)
            at += word + 9
    heights = np.abs(rng.normal(0.5, 0.25, 9)).clip(0.05, 1.0)
    for n, value in enumerate(heights):
        left = 30 + n * (width - 60) // 9
        colour = rng.uniform(0.05, 0.7, 3).tolist()
        cv2.rectangle(image, (left, height - 30), (left + 28, int(height - 30 - 0.38 * height * value)), colour, -1)
    return stored(image)


def checkerboard(columns: int, rows: int, pixels: int = 24) -> Texture:
    """Return a printed checkerboard of columns x rows squares with a margin of one square."""
    j, i = np.mgrid[0 : (rows + 2) * pixels, 0 : (columns + 2) * pixels] // pixels
    black = ((i + j) % 2 == 0) & (i > 0) & (j > 0) & (i <= columns) & (j <= rows)
    return stored(np.where(black, 0.04, 0.82)[:, :, None] * np.ones(3))


def screen(rng: Rng, size: tuple[int, int] = (360, 640)) -> Texture:
    """Return what a monitor shows: windows, lines of text, bright squares."""
    height, width = size
    image = np.full((height, width, 3), 0.0, np.float32) + np.array([0.10, 0.07, 0.04], np.float32)
    for _ in range(3):
        w, h = int(rng.uniform(0.3, 0.6) * width), int(rng.uniform(0.3, 0.7) * height)
        i, j = int(rng.uniform(0, width - w)), int(rng.uniform(0, height - h))
        dark = rng.uniform() < 0.5
        image[j : j + h, i : i + w] = 0.03 if dark else 0.8
        image[j : j + 14, i : i + w] = rng.uniform(0.1, 0.6, 3)
        for line in range(j + 24, j + h - 8, 11):
            end = i + 8 + int(rng.uniform(0.2, 0.9) * (w - 16))
            cv2.line(image, (i + 8, line), (end, line), (0.5, 0.5, 0.5) if dark else (0.15, 0.15, 0.15), 2)
    for _ in range(7):
        side = int(rng.uniform(12, 46))
        i, j = int(rng.uniform(0, width - side)), int(rng.uniform(0, height - side))
        image[j : j + side, i : i + side] = rng.uniform(0.2, 1.0, 3) if rng.uniform() < 0.5 else 1.0
    return stored(image)


def daylight(rng: Rng, size: tuple[int, int] = (256, 256)) -> Texture:
    """Return the view from a window: sky, a roof line, trees, all of it bright."""
    height, width = size
    image = np.ones((height, width, 3), np.float32) * np.array([1.0, 0.96, 0.90], np.float32)
    line = (0.62 + 0.06 * noise((1, width), 3, 3, rng)[0] if height > 1 else np.full(width, 0.6)) * height
    below = np.mgrid[0:height, 0:width][0] > line[None, :]
    leaves = tinted(0.35 * noise(size, 20, 4, rng), (0.14, 0.28, 0.20), 1.0)
    image[below] = leaves[below]
    house = (slice(int(0.45 * height), height), slice(int(rng.uniform(0, 0.5) * width), int(0.7 * width)))
    image[house] = (0.42, 0.45, 0.5)
    return stored(image)


def devices(rng: Rng, size: tuple[int, int] = (128, 384)) -> Texture:
    """Return an instrument's front: a dark display, knobs, sockets, print."""
    height, width = size
    image = tinted(0.03 * noise(size, 20, 3, rng), (0.30, 0.31, 0.31), 1.0)
    cv2.rectangle(image, (14, 20), (int(0.38 * width), int(0.62 * height)), (0.03, 0.05, 0.03), -1)
    for n in range(6):
        position = (int(0.47 * width + n * 0.085 * width), int((0.35 if n % 2 else 0.65) * height))
        cv2.circle(image, position, 9, (0.05, 0.05, 0.05), -1, cv2.LINE_AA)
        cv2.line(image, position, (position[0] + 5, position[1] - 6), (0.7, 0.7, 0.7), 1, cv2.LINE_AA)
        cv2.rectangle(
            image, (position[0] - 8, position[1] + 14), (position[0] + 8, position[1] + 16), (0.7, 0.7, 0.7), -1
        )
    return stored(image)


def cabinet(rng: Rng, size: tuple[int, int] = (384, 128)) -> Texture:
    """Return a switch cabinet's front: a door with its gap, a handle, ventilation slots, a label, stickers."""
    height, width = size
    image = tinted(0.03 * noise(size, 6, 4, rng), (0.38, 0.40, 0.38), 1.0)
    cv2.rectangle(image, (4, 4), (width - 5, height - 5), (0.05, 0.05, 0.05), 1, cv2.LINE_AA)
    cv2.rectangle(image, (width - 18, height // 2 - 16), (width - 12, height // 2 + 16), (0.04, 0.04, 0.04), -1)
    for line in range(height - 70, height - 30, 7):
        cv2.line(image, (26, line), (width - 27, line), (0.04, 0.04, 0.04), 2)
    cv2.rectangle(image, (18, 70), (60, 88), (0.75, 0.75, 0.75), -1)
    cv2.line(image, (22, 79), (54, 79), (0.05, 0.05, 0.05), 3)
    triangle = np.array([[90, 96], [72, 126], [108, 126]], np.int32)
    cv2.fillPoly(image, [triangle], (0.03, 0.55, 0.75), cv2.LINE_AA)
    cv2.line(image, (90, 104), (90, 116), (0.02, 0.02, 0.02), 3)
    return stored(image)


def cable(rng: Rng, colour: Colour, size: tuple[int, int] = (512, 256), thick: int = 7) -> Texture:
    """Return the cut-out of a cable that hangs in bends down its rectangle."""
    height, width = size
    v = np.linspace(0.0, 1.0, 60)
    u = 0.5 + 0.14 * np.sin(2 * np.pi * (rng.uniform(0.7, 1.6) * v + rng.uniform())) + 0.2 * (v - 0.5) * rng.normal()
    points = np.column_stack([np.clip(u, 0.06, 0.94) * width, v * height])
    cover = np.zeros(size, np.uint8)
    cv2.polylines(cover, [np.round(points).astype(np.int32)], False, 255, thick)
    shine = np.zeros(size, np.float32)
    cv2.polylines(shine, [np.round(points - [thick / 4, 0]).astype(np.int32)], False, 1.0, max(thick // 3, 1))
    image = np.array(colour, np.float32) * (1.0 + 1.5 * cv2.GaussianBlur(shine, (0, 0), 1.0))[:, :, None]
    return stored(image, cover / 255.0)


def tool(rng: Rng, kind: str, size: tuple[int, int] = (384, 128)) -> Texture:
    """Return the cut-out of a tool that hangs on a wall: 'spanner', 'driver' or 'hammer'."""
    height, width = size
    cover = np.zeros(size, np.uint8)
    image = tinted(0.08 * noise(size, 8, 3, rng), (0.45, 0.45, 0.44), 1.0)
    handle: Colour = (0.05, 0.05, 0.05)
    middle = width // 2
    if kind == "spanner":
        cv2.rectangle(cover, (middle - 13, 50), (middle + 13, height - 50), 255, -1)
        for end in (46, height - 46):
            cv2.circle(cover, (middle, end), 38, 255, -1)
            cv2.circle(cover, (middle, end - 22 if end < height / 2 else end + 22), 20, 0, -1)
    elif kind == "driver":
        cv2.rectangle(cover, (middle - 5, 8), (middle + 5, height // 2), 255, -1)
        cv2.rectangle(cover, (middle - 20, height // 2), (middle + 20, height - 8), 255, -1)
        handle = (0.04, 0.06, 0.5) if rng.uniform() < 0.5 else (0.03, 0.35, 0.5)
        image[height // 2 :] = handle
    else:
        cv2.rectangle(cover, (middle - 9, 40), (middle + 9, height - 8), 255, -1)
        cv2.rectangle(cover, (12, 16), (width - 12, 62), 255, -1)
        image[62:] = (0.1, 0.22, 0.36)
    return stored(image, cover / 255.0)


def hand(rng: Rng, size: int = 256) -> Texture:
    """Return the cut-out of a hand with its sleeve, fingers up."""
    cover = np.zeros((size, size), np.uint8)
    scale = size / 256.0

    def at(x: float, y: float) -> tuple[int, int]:
        return round(x * scale), round(y * scale)

    cv2.ellipse(cover, at(128, 150), at(46, 52), 0, 0, 360, 255, -1)
    for base, tip, thick in (
        ((92, 130), (74, 52), 21),
        ((116, 112), (108, 20), 23),
        ((142, 112), (146, 16), 23),
        ((164, 124), (182, 42), 20),
        ((90, 172), (42, 118), 25),
    ):
        cv2.line(cover, at(*base), at(*tip), 255, round(thick * scale), cv2.LINE_AA)
    cv2.rectangle(cover, at(98, 180), at(158, 256), 255, -1)
    inside = cv2.distanceTransform((cover > 127).astype(np.uint8), cv2.DIST_L2, 5)
    round_off = np.clip(inside / (14.0 * scale), 0.0, 1.0) ** 0.5
    skin = tinted(0.06 * noise((size, size), 10, 4, rng), (0.25, 0.36, 0.55), 1.0)
    image = skin * (0.45 + 0.55 * round_off)[:, :, None]
    image[int(222 * scale) :] = (
        np.array([0.25, 0.12, 0.08], np.float32) * (0.4 + 0.6 * round_off[int(222 * scale) :])[:, :, None]
    )
    return stored(image, cover / 255.0)
