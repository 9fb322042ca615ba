"""A camera's noise from frames of a scene at rest: photon transfer with every pixel as a light source of its own.

EMVA 1288, release 4.0 linear (https://www.emva.org/standards-technology/emva-1288/): over the mean grey level mu_y the
temporal variance is sigma_y^2 = K^2 sigma_d^2 + sigma_q^2 + K (mu_y - mu_y.dark), with the gain K in grey levels for
each electron, the dark noise sigma_d in electrons and the rounding sigma_q^2 = 1/12. The standard lights a uniform
target in steps; here the steps are the grey levels of an ordinary room, and since webcams are not linear (release 4.0
general), the variance is kept as a table.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, fields
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Image
from armsight.calibrate.camera_noise.stationary import Survey, survey
from armsight.calibrate.camera_noise.stills import BLOCK_PX, Stills, block_sums, require_change, to_pixels
from armsight.errors import Degenerate, NotEnoughData
from armsight.fields import Doc
from armsight.records.camera import LAGS, LEVELS, ROUNDING_LEVELS2, LinearNoise, NeighbourCorrelation, NoiseModel
from armsight.records.output import Output, extended, output
from armsight.shown import WRITTEN, Shown

Flags = NDArray[np.bool_]

KNOTS = 9
BEND = 1.5
"""Knots stand at the range of levels x (i / 8)^1.5: closer where it is dark, where transfer curves are steep."""

KNOT_PIXELS = 300
"""A knot needs so many pixels nearer to it than to the next: the variance is then known to 5 % from four frames."""

PRODUCT_FRAMES = 16
"""Correlations are summed over about so many differences: they are then known better than they are constant."""

SHIFTS = ((0, 0), *((0, lag) for lag in LAGS), *((lag, 0) for lag in LAGS), (1, 1), (1, -1))
"""Neighbours, rows down and columns right: the pixel itself, those along x, along y, and the diagonal ones."""

GROUPS = 20
"""Groups of blocks for the standard deviations (delete-a-group jackknife): their own relative standard deviation is 16
%."""

TOLD_BRIGHTNESS = 0.003
TOLD_SHARE = 0.02
TOLD_SHIFT_PX = 0.02
TOLD_FRAME_RATIO = 1.1
SHARED = 0.1

NO_GRAIN = 0.75
"""Correlation of pixels two apart: the simulated webcam leaves 0.07 at JPEG's quality 88 and 0.54 at 50, a board that
moves before it 0.92."""

DARK_NOISE_LEVELS2 = 0.24
"""EMVA 1288: variances below it are mostly rounding's."""

LINE_TOLERANCE = 0.05
LINE_DEVIATIONS = 4.0
"""The line holds where every knot is within 5 % of it or within four of its standard deviations."""

LINE_KNOTS = 4
LINE_RANGE = 3.0
"""... and where there are four knots, the highest at three times the lowest level: else any curve is a line."""


@output
class NoiseCalibration(NoiseModel):
    """A camera's noise as still frames show it, and how it was found."""

    n_given: Annotated[int, Doc("Still frames given.")]
    n_copies: Annotated[int, Doc("Frames equal to the one before, left out.")]
    brightness_rms: Annotated[float, Doc("Relative change of brightness between frames, RMS, taken off.")]
    shift_px_rms: Annotated[float, Doc("Shift of the image between frames, RMS, px, taken off.", unit="px")]
    moving: Annotated[float, Doc("Share of the image, 0 to 1, left out because something moves in it.")]
    frozen: Annotated[float, Doc("Share of the image, 0 to 1, left out because it does not change at all.")]
    unusable: Annotated[float, Doc("Share of the pixels, 0 to 1, that are black or clipped.")]
    frame_ratio: Annotated[
        float, Doc("Mean square change over two frames relative to that over one; 1 for independent frames.")
    ]
    line_deviation: Annotated[float | None, Doc("Largest relative deviation from the line.")]
    advice: Annotated[tuple[str, ...], Doc("What to know about it.")]

    def summary(self) -> Iterator[Shown]:
        """Yield the noise, and what to know about it."""
        yield from NoiseModel.summary(self)  # slots make another class of it than super() knows
        yield from (f"  {text}" for text in self.advice)

    @property
    def noise(self) -> NoiseModel:
        """What files keep of it."""
        return NoiseModel(**{one.name: getattr(self, one.name) for one in fields(NoiseModel)})


@output
class NoiseResult(Output):
    """armsight calibrate camera --noise, without a board.

    size: (width, height) of the frames; inputs: paths of their files.
    """

    noise: Annotated[
        NoiseCalibration | NoiseModel,
        Doc("The camera's noise; the keys from n_given on of still frames, not of a file."),
    ]
    size: tuple[int, int]
    inputs: tuple[Any, ...]

    @property
    def model(self) -> NoiseModel:
        """The noise as `CameraResult.save` and Rig(noise=...) take it."""
        return self.noise.noise if isinstance(self.noise, NoiseCalibration) else self.noise

    def summary(self) -> Iterator[Shown]:
        """Yield the noise."""
        yield from self.noise.summary()
        yield WRITTEN


def calibrate_noise(frames: Iterable[Image]) -> NoiseCalibration:
    """Return the noise of the camera that took frames (h, w) uint8 grey of a scene at rest, standing still itself.

    The frames are kept in memory as they are, nothing else grows with their number. Raises BadImage, Inconsistent,
    NotEnoughData, and Degenerate where the noise cannot be seen or the scene or the camera moves.
    """
    stills = Stills(frames)
    require_change(stills)
    seen = survey(stills)
    if seen.moving > TOLD_SHARE:  # what moves has spoilt the brightness fitted beside it
        stills.leave_out(seen.keep)
        seen = survey(stills)
    pooled = _pool(stills, seen)
    levels, variance, std = _table(pooled)
    linear, deviation = fit_line(levels, variance, std)
    correlation = _correlation(pooled)
    _require_grain(correlation)
    noise = NoiseModel(
        levels=levels,
        variance_levels2=variance,
        std_levels2=std,
        correlation=correlation,
        n_frames=len(stills.frames),
        linear=linear,
    )
    return extended(
        noise,
        NoiseCalibration,
        n_given=stills.n_given,
        n_copies=stills.n_given - len(stills.frames),
        brightness_rms=seen.brightness_rms,
        shift_px_rms=seen.shift_px_rms,
        moving=seen.moving,
        frozen=seen.frozen,
        unusable=1.0 - float(stills.usable.mean()),
        frame_ratio=seen.frame_ratio,
        line_deviation=deviation,
        advice=_advice(stills, seen, noise),
    )


def fit_line(levels: Array, variance: Array, std: Array) -> tuple[LinearNoise | None, float | None]:
    """Return EMVA's line through the knots (n,) and the largest relative deviation from it.

    No line where a knot is beyond the tolerances, the slope is not positive or the levels are too few or too close;
    no deviation where there are fewer than three knots. The level of black is taken as 0.
    """
    if len(levels) < 3:
        return None, None
    weight = 1.0 / np.hypot(std, 0.02 * variance)  # 2 %: no knot, however sure, may pull the line alone
    # EMVA 1288, photon transfer: variance = read noise + rounding + gain (level - dark level), in levels squared
    design = np.stack([np.ones_like(levels), levels], axis=1)  # (n, 2)
    offset, gain = np.linalg.lstsq(design * weight[:, None], variance * weight, rcond=None)[0]
    off = np.abs(variance - offset - gain * levels)
    holds = bool((off <= np.maximum(LINE_TOLERANCE * variance, LINE_DEVIATIONS * std)).all())
    told = len(levels) >= LINE_KNOTS and levels[-1] >= LINE_RANGE * max(levels[0], 1.0)
    # rounding to whole levels is uniform within half a level, 1/12 of a squared level, and no noise of the sensor
    read = float(np.sqrt(max(offset - ROUNDING_LEVELS2, 0.0)))
    line = LinearNoise(read_noise_levels=read, gain_levels=float(gain)) if holds and told and gain > 0.0 else None
    return line, float((off / variance).max())


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class _Pooled:
    """Sums over all that stands still, by group of blocks.

    squares, samples: (GROUPS, 256) of the differences by grey level; pixels: (256,) of each level. products,
    pairs: (7, GROUPS) of standardized differences with themselves and with their neighbours: SHIFTS.
    """

    squares: Array
    samples: Array
    pixels: Array
    products: Array
    pairs: Array


def _pool(stills: Stills, seen: Survey) -> _Pooled:
    """Sum squares and products of the differences where the scene stands still."""
    h, w = stills.shape
    usable = stills.usable.astype(np.float32)
    unit = (1.0 / seen.scale).astype(np.float32)[stills.level]  # (h, w)
    squares = np.zeros((h, w), np.float32)
    products = np.zeros((len(SHIFTS), h // BLOCK_PX, w // BLOCK_PX))
    pairs = np.zeros_like(products)
    every = max(1, len(seen.keep) // PRODUCT_FRAMES)
    for k, (difference, keep) in enumerate(zip(stills, seen.keep, strict=True)):
        d = difference.d * (usable * to_pixels(keep.astype(np.float32)))
        squares += d * d
        if k % every == 0:
            mask = usable * to_pixels(keep.astype(np.float32))
            products += _products(d * unit)
            pairs += _products(mask)
    group: NDArray[np.int64] = (7 * np.arange(h // BLOCK_PX)[:, None] + np.arange(w // BLOCK_PX)) % GROUPS
    at = (to_pixels(group) * LEVELS + stills.level)[stills.usable]
    times = to_pixels(seen.keep.sum(axis=0).astype(float))[stills.usable]
    free = 1.0 - stills.n_fitted / max(float(stills.usable.sum()), 1.0)
    size = GROUPS * LEVELS
    return _Pooled(
        squares=np.bincount(at, squares[stills.usable], size).reshape(GROUPS, LEVELS) / free,
        samples=np.bincount(at, times, size).reshape(GROUPS, LEVELS).astype(float),
        pixels=np.bincount(stills.level[stills.usable][times > 0], minlength=LEVELS).astype(float),
        products=np.array([np.bincount(group.ravel(), p.ravel(), GROUPS) for p in products]),
        pairs=np.array([np.bincount(group.ravel(), p.ravel(), GROUPS) for p in pairs]),
    )


def _products(z: NDArray[np.float32]) -> Array:
    """Return the sums (7, H, W) over blocks of z (h, w) times its neighbours by SHIFTS, 0 beyond the image."""
    h, w = z.shape
    out = []
    for down, right in SHIFTS:
        part = np.zeros_like(z)
        here, there = z[: h - down, max(0, -right) : w - max(0, right)], z[down:, max(0, right) : w + min(0, right)]
        np.multiply(here, there, out=part[: h - down, max(0, -right) : w - max(0, right)])
        out.append(block_sums(part))
    return np.array(out)


def _table(pooled: _Pooled) -> tuple[Array, Array, Array]:
    """Return knots (n,), the variance there and its standard deviation, by least squares over all levels."""
    levels = _knots(pooled.pixels)
    at = np.arange(LEVELS, dtype=float)
    hats = np.stack([np.interp(at, levels, row) for row in np.eye(len(levels))], axis=1)  # (256, n)
    hats[(at < levels[0]) | (at > levels[-1])] = 0.0
    squares, samples = pooled.squares.sum(axis=0), pooled.samples.sum(axis=0)
    rough = np.maximum(_smooth(squares) / np.maximum(_smooth(samples), 1.0), 1e-3)  # (256,), twice the variance

    def solve(squares: Array, samples: Array) -> Array:
        weight = 1.0 / rough**2
        normal = (hats * (samples * weight)[:, None]).T @ hats
        right = hats.T @ (0.5 * squares * weight)
        ridge = 1e-9 * np.trace(normal) * np.eye(len(levels))
        return np.asarray(np.linalg.solve(normal + ridge, right))

    variance = solve(squares, samples)
    without = np.array([solve(squares - pooled.squares[g], samples - pooled.samples[g]) for g in range(GROUPS)])
    return levels, np.maximum(variance, 0.0), _jackknife(without)


def _knots(pixels: Array) -> Array:
    """Return the levels (n,) of up to KNOTS knots from the pixels (256,) of each level. Raises NotEnoughData."""
    total = np.cumsum(pixels)
    if total[-1] < 2 * KNOT_PIXELS:
        raise NotEnoughData(
            f"only {total[-1]:.0f} pixels stand still and are neither black nor clipped",
            consequence="The noise is not known",
            cure="Let nothing move, and expose so that most of the scene is neither black nor white",
        )
    low = int(np.searchsorted(total, KNOT_PIXELS))
    high = int(np.searchsorted(total, total[-1] - KNOT_PIXELS))
    if high - low < 4:  # one level: a uniform target
        return np.array([float(np.average(np.arange(LEVELS), weights=pixels))])
    count = min(KNOTS, 2 + (high - low) // 6)
    knots = np.rint(low + (high - low) * np.linspace(0.0, 1.0, count) ** BEND)
    while len(knots) > 2:
        nearest = np.abs(np.arange(LEVELS)[:, None] - knots).argmin(axis=1)
        near = np.bincount(nearest, pixels, len(knots))[1:-1]
        if (near >= KNOT_PIXELS).all():
            break
        knots = np.delete(knots, 1 + int(near.argmin()))
    return np.asarray(knots, float)


def _smooth(values: Array) -> Array:
    """Return sums (256,) over 15 neighbouring levels."""
    return np.convolve(values, np.ones(15), mode="same")


def _correlation(pooled: _Pooled) -> NeighbourCorrelation:
    """Return what neighbours share."""

    def solve(products: Array, pairs: Array) -> Array:  # (5,) x1, x2, y1, y2, diagonal
        mean = products / np.maximum(pairs, 1.0)  # (7,)
        found = mean[1:] / mean[0]
        return np.append(found[:4], found[4:].mean())

    products, pairs = pooled.products.sum(axis=1), pooled.pairs.sum(axis=1)
    of_all = solve(products, pairs)
    without = np.array([solve(products - pooled.products[:, g], pairs - pooled.pairs[:, g]) for g in range(GROUPS)])
    found, std = np.clip(of_all, -1.0, 1.0), _jackknife(without)
    return NeighbourCorrelation(
        x=found[:2],
        y=found[2:4],
        diagonal=float(found[4]),
        std_x=std[:2],
        std_y=std[2:4],
        std_diagonal=float(std[4]),
    )


def _require_grain(correlation: NeighbourCorrelation) -> None:
    """Raise Degenerate where what changes is alike over neighbourhoods."""
    along_x, along_y = correlation.x[1], correlation.y[1]
    if min(along_x, along_y) > NO_GRAIN:
        raise Degenerate(
            f"what changes from frame to frame is alike over several pixels (correlation {along_x:.2f} and "
            f"{along_y:.2f} of pixels two apart)",
            consequence="It is light or things that move, and noise cannot be told from it",
            cure="Give frames of one scene that stands still, under light that does not change",
        )


def _jackknife(without: Array) -> Array:
    """Return the standard deviations (n,) of what was found without each group in turn, (GROUPS, n)."""
    return np.asarray(np.sqrt((GROUPS - 1) / GROUPS * np.square(without - without.mean(axis=0)).sum(axis=0)))


def _advice(stills: Stills, seen: Survey, noise: NoiseModel) -> tuple[str, ...]:
    """Return what a person should know about the frames, as sentences."""
    copies = stills.n_given - len(stills.frames)
    low, high = noise.levels[0], noise.levels[-1]
    told = {
        f"{copies} frames are copies of the one before and were left out": copies > 0,
        f"the brightness changes by {100.0 * seen.brightness_rms:.2g} % from frame to frame (lamps, automatic "
        "exposure); it was taken off": seen.brightness_rms > TOLD_BRIGHTNESS,
        f"the image shifts by {seen.shift_px_rms:.2g} px from frame to frame; it was taken off": seen.shift_px_rms
        > TOLD_SHIFT_PX,
        f"something moves in {100.0 * seen.moving:.2g} % of the image; it was left out": seen.moving > TOLD_SHARE,
        f"{100.0 * seen.frozen:.2g} % of the image do not change at all (compression, denoising) and were left out: "
        "the noise is that of the others": seen.frozen > TOLD_SHARE,
        "successive frames are more alike than frames further apart (denoising over time, or a slow change): the noise "
        f"is {0.5 * (seen.frame_ratio - 1.0):.0%} or more above what is given; switch denoising off, or use every n-th "
        "frame (--every)": seen.frame_ratio > TOLD_FRAME_RATIO,
        f"the scene has grey levels from {low:.0f} to {high:.0f} only: beyond, the noise is a guess": high < 180.0,
        "neighbouring pixels share their noise, so the line's gain is not that of single electrons": noise.linear
        is not None
        and float(np.abs([*noise.correlation.x, *noise.correlation.y]).max()) > SHARED,
        "the noise is below what rounding to whole grey levels lets one see": bool(
            np.median(noise.variance_levels2) < DARK_NOISE_LEVELS2
        ),
    }
    return tuple(text for text, holds in told.items() if holds)
