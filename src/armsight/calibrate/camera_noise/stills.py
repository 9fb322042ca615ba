"""Still frames -> their differences, free of what changes whole frames or moves the camera.

Successive frames of a scene at rest differ by noise alone: the scene and the fixed pattern of the pixels cancel (EMVA
1288, release 4.0 linear: sigma_y^2 is the mean of (y[0] - y[1])^2 / 2 over the pixels of two images taken alike, less
half of their means' difference squared). What an ordinary room adds is fitted to each difference and taken off:
brightness that changes by any smooth function of the grey level (lamps at mains frequency, automatic exposure), by
bands of rows (rolling shutter under such lamps) or in parts (one lamp of several), and shifts of the camera by parts of
a pixel.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Image
from armsight.errors import BadImage, Degenerate, Inconsistent, NotEnoughData
from armsight.records.camera import LEVELS

Floats = NDArray[np.float32]
Flags = NDArray[np.bool_]
Number = TypeVar("Number", np.float32, np.float64, np.int64)

BLOCK_PX = 16
"""Side of the blocks in which movement is looked for: a multiple of JPEG's 8, wider than any correlation of noise."""

MIN_FRAMES = 4
"""Three differences: the fewest with which a block's own median tells a passing movement."""

MIN_BLOCKS = 40
"""An image needs so many blocks: standard deviations come from groups of them."""

MIN_USABLE = 0.05
"""Least share of the pixels that is neither black nor clipped."""

TOUCHED = 0.005
"""A grey level is left out where more than this share of its pixels ever touch black or white: of four frames the
pixels that do not lack 2 % of their variance, of more frames less."""

SPIKE = 4
"""So many times more pixels at the darkest or brightest level than at the next: the camera clips there."""

COLUMNS = 4
"""Parts across the image, each with a brightness of its own for every row of blocks."""

OUTLIER = 4.0
"""Differences beyond so many robust standard deviations do not count in the fit of the whole frame's brightness and
shift."""

FITTED_PIXELS = 40_000
"""Of so many pixels the shift and the brightness of the whole frame are fitted."""

MIN_CHANGED = 0.05
"""Least share of pixels that change between frames. Noise of 0.05 grey levels makes 5 % of them change."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Difference:
    """One frame minus the one before, d (h, w) in grey levels, corrected.

    brightness: relative change that was taken off, RMS over the image. shift_px: (2,) of the image. changed: (H, W),
    blocks in which any pixel differed before the correction.
    """

    d: Floats
    brightness: float
    shift_px: Array
    changed: Flags


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Fit:
    """What is taken off a difference: terms (5,) of 1, x, x^2, d/du, d/dv; gain (rows, COLUMNS) by cells."""

    terms: Array
    gain: Array
    brightness: float


class Stills:
    """Frames (h, w) uint8 grey of a scene at rest, kept as they are.

    Raises BadImage, Inconsistent, NotEnoughData, and Degenerate where nothing changes. The last rows and columns that
    fill no block are left out. n_given: frames that came. mean: (h, w) over frames. usable: (h, w), neither clipped
    nor black. level: (h, w) mean rounded.
    """

    def __init__(self, frames: Iterable[Image]) -> None:
        self.frames, self.n_given = _distinct(frames)
        first = self.frames[0]
        self.shape = (first.shape[0] // BLOCK_PX * BLOCK_PX, first.shape[1] // BLOCK_PX * BLOCK_PX)
        h, w = self.shape
        if (h // BLOCK_PX) * (w // BLOCK_PX) < MIN_BLOCKS:
            raise NotEnoughData(
                f"an image of {first.shape[1]} x {first.shape[0]} px is too small to tell noise from movement",
                consequence="The noise is not known",
                cure="Give whole frames as the camera sends them",
            )
        self.frames = [frame[:h, :w] for frame in self.frames]
        total = np.zeros(self.shape, np.uint32)
        for frame in self.frames:
            total += frame
        self.mean = (total / np.float32(len(self.frames))).astype(np.float32)
        self.level = np.rint(self.mean).astype(np.uint8)
        self.usable = self._usable()
        if self.usable.mean() < MIN_USABLE:
            raise NotEnoughData(
                f"{100.0 * (1.0 - self.usable.mean()):.0f} % of the pixels are black or clipped",
                consequence="Noise cannot be seen in them",
                cure="Change the exposure so that most of the scene is neither black nor white",
            )
        self._fits: list[_Fit] = []
        self._keep: Flags | None = None
        self._prepare()

    def __iter__(self) -> Iterator[Difference]:
        for k, (before, after) in enumerate(zip(self.frames[:-1], self.frames[1:], strict=True)):
            raw = np.subtract(after, before, dtype=np.int16)
            changed = block_sums((raw != 0) & self.usable) > 0
            d = raw.astype(np.float32)
            if k == len(self._fits):
                self._fits.append(self._fit(d, self._squares if self._keep is None else self._squares * self._keep[k]))
            fit = self._fits[k]
            self._take_off(d, fit.terms, fit.gain)
            yield Difference(d=d, brightness=fit.brightness, shift_px=-fit.terms[3:], changed=changed)

    def leave_out(self, keep: Flags) -> None:
        """Fit the brightness anew, to those blocks alone that stand still, keep (m, H, W)."""
        self._keep = keep
        self._fits.clear()

    @property
    def n_fitted(self) -> int:
        """How many numbers are fitted to each difference."""
        return len(self._terms) + COLUMNS * len(self._squares)

    def changed_share(self) -> float:
        """Return the share of usable pixels that differ between successive frames."""
        pairs = list(zip(self.frames[:-1], self.frames[1:], strict=True))
        return float(np.mean([(a != b)[self.usable].mean() for a, b in pairs[:: max(1, len(pairs) // 8)]]))

    def _usable(self) -> Flags:
        """Return which pixels (h, w) are never at the darkest or brightest level, and not of a level that often is."""
        counts = np.zeros(LEVELS, np.int64)
        for frame in self.frames:
            counts += np.bincount(frame.ravel(), minlength=LEVELS)
        low, high = _clip_levels(counts)
        touched = np.zeros(self.shape, bool)
        for frame in self.frames:
            touched |= (frame <= low) | (frame >= high)
        n = np.bincount(self.level.ravel(), minlength=LEVELS)
        share = np.bincount(self.level[touched], minlength=LEVELS) / np.maximum(n, 1)
        return np.asarray(~touched & (share <= TOUCHED)[self.level])

    def _prepare(self) -> None:
        """Choose the pixels of the global fit and the cells of the local one."""
        gy, gx = np.gradient(self.mean)
        x = self.mean / np.float32(LEVELS - 1)
        self._terms = (np.ones_like(x), x, x * x, gx, gy)
        chosen = np.flatnonzero(self.usable)
        self._chosen = chosen[:: max(1, len(chosen) // FITTED_PIXELS)]
        self._design = np.stack([term.ravel()[self._chosen] for term in self._terms], axis=1).astype(float)
        self._inverse = np.linalg.pinv(self._design)  # (5, n)
        self._light = self.mean * self.usable
        self._squares = block_sums(self._light * self.mean)  # (H, W)
        self._down = _interpolation(self.shape[0], len(self._squares))
        self._across = _interpolation(self.shape[1], COLUMNS)

    def _fit(self, raw: Floats, weight: Array) -> _Fit:
        """Return the changes of brightness and the shift in a raw difference (h, w); weight (H, W) of the blocks."""
        sample = raw.ravel()[self._chosen].astype(float)
        terms = np.zeros(len(self._terms))
        for _ in range(4):
            rest = sample - self._design @ terms
            scale = max(1.4826 * float(np.median(np.abs(rest))), 0.5)  # robust, not below that of rounding
            terms += self._inverse @ np.where(np.abs(rest) <= OUTLIER * scale, rest, 0.0)
        d = raw.copy()
        self._take_off(d, terms, np.zeros((1, 1)))
        gain = _medians(block_sums(d * self._light) / np.maximum(self._squares, 1.0), weight)
        middle = self._design[:, :3].mean(axis=0)
        change = terms[:3] @ middle / ((LEVELS - 1.0) * middle[1]) + gain
        return _Fit(terms=terms, gain=gain, brightness=float(np.sqrt(np.mean(np.square(change)))))

    def _take_off(self, d: Floats, terms: Array, gain: Array) -> None:
        """Subtract from d (h, w), in place, terms (5,) of the whole frame and the cells' relative brightness."""
        part = np.empty_like(d)
        for value, term in zip(terms, self._terms, strict=True):
            if value != 0.0:
                d -= np.multiply(term, np.float32(value), out=part)
        if gain.any():
            np.matmul(self._down, (gain.astype(np.float32) @ self._across.T), out=part)
            d -= np.multiply(part, self.mean, out=part)


def block_sums(image: NDArray[np.floating] | Flags) -> Array:
    """Return the sums (h / 16, w / 16) over the blocks of an image (h, w)."""
    h, w = image.shape
    rows = image.reshape(h // BLOCK_PX, BLOCK_PX, w).sum(axis=1, dtype=np.float32)
    return np.asarray(rows.reshape(h // BLOCK_PX, w // BLOCK_PX, BLOCK_PX).sum(axis=2, dtype=np.float64))


def to_pixels(blocks: NDArray[Number]) -> NDArray[Number]:
    """Return an image (h, w) in which every pixel has its block's value."""
    return blocks.repeat(BLOCK_PX, axis=0).repeat(BLOCK_PX, axis=1)


def _distinct(frames: Iterable[Image]) -> tuple[list[Image], int]:
    """Return the frames that differ from the one before, and how many there were. Raises as Stills does."""
    kept: list[Image] = []
    n = 0
    for frame in frames:
        n += 1
        if frame.dtype != np.uint8 or frame.ndim != 2:
            raise BadImage(f"frame {n} of type {frame.dtype} and shape {frame.shape} is not 8-bit grey")
        if kept and frame.shape != kept[0].shape:
            raise Inconsistent(
                f"frame {n} has {frame.shape[0]} rows of {frame.shape[1]} px, the first one {kept[0].shape[0]} of "
                f"{kept[0].shape[1]}",
                consequence="The noise is that of one camera in one mode",
                cure="Give the frames of one camera, uncropped",
            )
        if not kept or not np.array_equal(frame, kept[-1]):
            kept.append(frame)
    if n < MIN_FRAMES:
        raise NotEnoughData(
            f"{n} frames are too few to see noise in",
            consequence="Movement and noise cannot be told apart",
            cure=f"Give at least {MIN_FRAMES} frames, better 20, of a scene that stands still",
        )
    if len(kept) < MIN_FRAMES:
        raise Degenerate(
            f"only {len(kept)} of {n} frames differ from the one before: the others are copies of it",
            consequence="The noise cannot be seen in them",
            cure="Check that the camera is not frozen, and that the frames are not one picture saved many times",
        )
    return kept, n


def require_change(stills: Stills) -> None:
    """Raise Degenerate where hardly any pixel changes from frame to frame."""
    share = stills.changed_share()
    if share < MIN_CHANGED:
        raise Degenerate(
            f"only {100.0 * share:.1f} % of the pixels change from frame to frame",
            consequence="Noise so far below the rounding to whole grey levels, or smoothed away, cannot be seen",
            cure="Switch denoising and video compression off, or use every n-th frame (--every)",
        )


def _clip_levels(counts: NDArray[np.int64]) -> tuple[int, int]:
    """Return the levels at which the camera is black and clipped, from how many pixels (256,) each level has."""
    there = np.flatnonzero(counts)
    enough = max(100, int(1e-4 * counts.sum()))

    def spike(level: int, inner: int) -> bool:
        return bool(counts[level] > max(enough, SPIKE * counts[inner]))

    low, high = int(there[0]), int(there[-1])
    return (
        low if low < 255 and spike(low, low + 1) else 0,
        high if high > 0 and spike(high, high - 1) else 255,
    )


def _medians(gain: Array, weight: Array) -> Array:
    """Return the weighted medians (H, COLUMNS) of the blocks' gains (H, W) over COLUMNS parts across.

    Medians see no movement in less than half of a part. A part without weight has the mean of its row's others.
    """
    parts = []
    for part in np.array_split(np.arange(gain.shape[1]), COLUMNS):
        order = np.argsort(gain[:, part], axis=1)
        ordered = np.take_along_axis(gain[:, part], order, axis=1)
        share = np.cumsum(np.take_along_axis(weight[:, part], order, axis=1), axis=1)
        at = (share >= 0.5 * share[:, -1:]).argmax(axis=1)
        parts.append(np.where(share[:, -1] > 0.0, np.take_along_axis(ordered, at[:, None], axis=1)[:, 0], np.nan))
    found = np.stack(parts, axis=1)
    known = np.isfinite(found)
    mean = np.where(known, found, 0.0).sum(axis=1) / np.maximum(known.sum(axis=1), 1)
    return np.where(known, found, mean[:, None])


def _interpolation(n: int, cells: int) -> Floats:
    """Return the matrix (n, cells) that interpolates values at the cells' middles to n pixels, flat beyond."""
    at = np.clip((np.arange(n) + 0.5) * cells / n - 0.5, 0.0, cells - 1.0)
    return np.maximum(0.0, 1.0 - np.abs(at[:, None] - np.arange(cells))).astype(np.float32)
