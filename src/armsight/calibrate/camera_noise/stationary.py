"""Which parts of still frames stand still: told from the noise itself, block by block."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array
from armsight.calibrate.camera_noise.stills import BLOCK_PX, Stills, block_sums
from armsight.errors import Degenerate
from armsight.records.camera import LEVELS

Flags = NDArray[np.bool_]

MOVES_ONCE = 2.0
"""A block whose mean square is so many times its own median over time moves in that frame; of noise alone, even that
of a demosaiced image, 256 pixels reach 1.6 in one of 10^5."""

MOVES_ALWAYS = 6.0
"""... and so many times that of blocks as bright: in all frames. JPEG's noise differs 2 to 4 times from place
to place."""

DRIFTS = 0.6
"""A block drifts where the mean square over two frames, relative to that over one, exceeds the median block's by this;
1 is due to noise alone, its standard deviation is 0.15 from four frames."""

SPREADS = 6.0
"""The three limits give way to so many robust standard deviations of all blocks where those scatter more
(compression)."""

CLASS_BLOCKS = 25
MAX_CLASSES = 10
"""Blocks as bright: classes of equally many blocks by their mean level."""

MAX_MOVING = 0.5
MAX_FROZEN = 0.5
MAX_SHIFT_PX = 0.5

MAX_FRAME_RATIO = 1.5
"""Half of the noise's variance is then hidden by denoising over time, or the scene changes slowly."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Survey:
    """What the first look at all differences says.

    keep: (m, H, W) which blocks stand still in which difference. scale: (256,) rms difference by grey level. moving,
    frozen: shares of the blocks that move, or do not change at all. frame_ratio: mean square over two frames relative
    to that over one: 1 for independent frames, 2 - a for a camera that adds the part a of each new frame to the
    picture, 4 for a drift. brightness_rms: relative, shift_px_rms: from frame to frame.
    """

    keep: Flags
    scale: Array
    moving: float
    frozen: float
    frame_ratio: float
    brightness_rms: float
    shift_px_rms: float


def survey(stills: Stills) -> Survey:
    """Look at the blocks of all differences. Raises Degenerate where too much moves or nothing is to be seen."""
    seen = _look(stills)
    _require_fixed(seen.shifts_px)
    frozen = 1.0 - float(seen.alive[:, seen.there].mean()) if seen.there.any() else 0.0
    if frozen > MAX_FROZEN:
        raise _unseen(f"{100.0 * frozen:.0f} % of the image repeats the frame before unchanged")
    own = _own(seen)
    usual = _usual(seen, own)
    keep, frame_ratio = _standing(seen, own, usual)
    moving = 1.0 - float(keep.sum()) / max(float(seen.alive.sum()), 1.0)
    _require_still(moving, frame_ratio)
    return Survey(
        keep=keep,
        scale=np.sqrt(np.maximum(usual, 1e-3)),
        moving=moving,
        frozen=frozen,
        frame_ratio=frame_ratio,
        brightness_rms=float(np.sqrt(np.mean(np.square(seen.brightness)))),
        shift_px_rms=float(np.sqrt(np.square(seen.shifts_px).sum(axis=1).mean())),
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Seen:
    """All m differences by blocks.

    squares (m, H, W), twice (m - 1, H, W): mean squares over one and over two frames. there (H, W): blocks with enough
    usable pixels. alive (m, H, W): those that change. level (H, W): their mean. brightness (m,), shifts_px (m, 2).
    """

    squares: Array
    twice: Array
    there: Flags
    alive: Flags
    level: Array
    brightness: Array
    shifts_px: Array


def _look(stills: Stills) -> _Seen:
    usable = stills.usable.astype(np.float32)
    count = block_sums(usable)  # (H, W)
    pixels = np.maximum(count, 1.0)
    squares, twice, changed, brightness, shifts = [], [], [], [], []
    last = None
    for difference in stills:
        d = difference.d * usable
        squares.append(block_sums(d * d) / pixels)
        if last is not None:
            twice.append(block_sums(np.square(d + last)) / pixels)
        last = d
        changed.append(difference.changed)
        brightness.append(difference.brightness)
        shifts.append(difference.shift_px)
    there = count >= 0.5 * BLOCK_PX**2
    return _Seen(
        squares=np.array(squares),
        twice=np.array(twice),
        there=there,
        alive=np.array(changed) & there,
        level=block_sums(stills.mean * usable) / pixels,
        brightness=np.array(brightness),
        shifts_px=np.array(shifts),
    )


def _own(seen: _Seen) -> Array:
    """Return each block's median mean square (H, W) over the differences in which it changes; 0 where it never does."""
    own = np.zeros(seen.level.shape)
    ever = seen.alive.any(axis=0)
    own[ever] = np.nanmedian(np.where(seen.alive, seen.squares, np.nan)[:, ever], axis=0)
    return own


def _usual(seen: _Seen, own: Array) -> Array:
    """Return the usual mean square (256,) by grey level: the median of blocks as bright, interpolated."""
    there = own > 0.0
    order = np.argsort(seen.level[there])
    classes = np.array_split(order, int(np.clip(len(order) // CLASS_BLOCKS, 1, MAX_CLASSES)))
    level = [float(np.median(seen.level[there][one])) for one in classes]
    square = [float(np.median(own[there][one])) for one in classes]
    return np.interp(np.arange(LEVELS), level, square)


def _standing(seen: _Seen, own: Array, usual: Array) -> tuple[Flags, float]:
    """Return which blocks stand still in which difference (m, H, W), and the frame_ratio of those."""
    safe = np.maximum(own, 1e-9)
    once = np.log(np.maximum(seen.squares, 1e-9) / safe)  # (m, H, W)
    always = np.log(safe / usual[np.rint(seen.level).astype(int)])  # (H, W)
    ever = own > 0.0
    still = seen.alive & (once <= max(np.log(MOVES_ONCE), SPREADS * _spread(once[seen.alive])))
    still &= always <= max(np.log(MOVES_ALWAYS), SPREADS * _spread(always[ever]))
    n = np.maximum(seen.alive.sum(axis=0), 1)
    ratio = seen.twice.mean(axis=0) / np.maximum((seen.squares * seen.alive).sum(axis=0) / n, 1e-9)
    complete = still.all(axis=0)
    if not complete.any():
        return still, 1.0
    middle = float(np.median(ratio[complete]))
    limit = middle + max(DRIFTS, SPREADS * _spread(ratio[complete] - middle))
    return still & (ratio <= limit)[None], middle


def _spread(values: Array) -> float:
    """Return the robust standard deviation about 0."""
    return 1.4826 * float(np.median(np.abs(values))) if len(values) else 0.0


def _require_fixed(shifts_px: Array) -> None:
    """Raise Degenerate where the image has moved too far over the frames (m, 2)."""
    path = np.vstack([np.zeros((1, 2)), np.cumsum(shifts_px, axis=0)])
    far = float(np.ptp(path, axis=0).max())
    if far > MAX_SHIFT_PX:
        raise Degenerate(
            f"the image moves by {far:.1f} px over the frames",
            consequence="Its edges would pass for noise",
            cure="Fix the camera, touch nothing, and let nothing large move in the scene",
        )


def _require_still(moving: float, frame_ratio: float) -> None:
    """Raise Degenerate where the scene moves, or where frames are smoothed over time."""
    if moving > MAX_MOVING:
        raise Degenerate(
            f"something moves in {100.0 * moving:.0f} % of the image",
            consequence="Noise cannot be told from movement",
            cure="Give frames of a scene that stands still",
        )
    if frame_ratio > MAX_FRAME_RATIO:
        raise _unseen(
            f"frames two apart differ {frame_ratio:.1f} times as much (mean square) as successive ones: they are "
            "averaged over time, or the scene drifts"
        )


def _unseen(cause: str) -> Degenerate:
    return Degenerate(
        cause,
        consequence="The noise cannot be seen in such frames",
        cure="Switch denoising and video compression off, or use every n-th frame (--every)",
    )
