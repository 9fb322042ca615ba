"""What is known of a camera beside its optics: the noise of its grey levels, and when it exposes."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from math import inf, sqrt
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.fields import Bounds, Doc
from armsight.records.checks import Shape, frozen_array
from armsight.records.output import Output, figure, output
from armsight.records.result_parts import NamedCovariance
from armsight.shown import Shown, Table, digits

ROUNDING_LEVELS2 = 1.0 / 12.0
"""Variance of rounding to whole grey levels (EMVA 1288: sigma_q^2 = 1/12 DN^2). No pixel is known better."""

LAGS = (1, 2)
"""Distances in px of the neighbours whose correlation is kept, along x and along y."""

OF_LAGS = Shape((len(LAGS),))
Pair = Annotated[Array, Shape((2,))]

LEVELS = 256
"""Grey levels of an 8-bit image."""


def unknown() -> Array:
    """Return standard deviations of correlations that nobody gave."""
    return np.zeros(len(LAGS))


@output
class LinearNoise(Output):
    """A camera whose variance is a line over the grey level, by EMVA 1288's linear model, black at level 0.

    variance = read_noise_levels^2 + 1/12 + gain_levels * level, in grey levels squared; gain_levels: K.
    """

    read_noise_levels: Annotated[float, Doc("Noise in the dark, grey levels.")]
    gain_levels: Annotated[float, Doc("Grey levels for each electron.")]

    def __post_init__(self) -> None:
        if not (0.0 <= self.read_noise_levels < inf and 0.0 < self.gain_levels < inf):
            raise Inconsistent(f"noise with {self} cannot be: the read noise is 0 or more, the gain above 0")


@output
class NeighbourCorrelation(Output):
    """Correlation of a pixel's noise with that of its neighbours, at LAGS; along a diagonal the mean of both."""

    x: Annotated[Array, OF_LAGS, Doc("With the pixels 1 and 2 px away along x.")]
    y: Annotated[Array, OF_LAGS, Doc("With the pixels 1 and 2 px away along y.")]
    diagonal: Annotated[float, Doc("With the next pixel along the diagonals.")] = 0.0
    std_x: Annotated[Array, OF_LAGS, Doc("Standard deviations of `x`.")] = field(default_factory=unknown)
    std_y: Annotated[Array, OF_LAGS, Doc("Standard deviations of `y`.")] = field(default_factory=unknown)
    std_diagonal: Annotated[float, Doc("Standard deviation of `diagonal`.")] = 0.0

    def __post_init__(self) -> None:
        for name in ("x", "y", "std_x", "std_y"):
            object.__setattr__(self, name, frozen_array(name, getattr(self, name), (len(LAGS),)))
        size, least_std = self.largest, min(self.std_x.min(), self.std_y.min(), self.std_diagonal)
        if not (size <= 1.0 and least_std >= 0.0 and self.std_diagonal < inf):
            raise Inconsistent("noise: a correlation is not between -1 and 1, or its standard deviation is negative")

    @property
    def largest(self) -> float:
        """The largest of them in size."""
        return float(np.abs([*self.x, *self.y, self.diagonal]).max())


@output
class NoiseModel(Output):
    """Temporal noise of single pixels, rounding included, as photon transfer finds it (EMVA 1288)."""

    levels: Annotated[Array, Shape((None,)), Doc("Grey levels, 0 to 255, increasing.")]
    variance_levels2: Annotated[Array, Shape((None,)), Doc("Variance of a pixel from frame to frame at these levels.")]
    std_levels2: Annotated[Array, Shape((None,)), Doc("Standard deviations of these variances.")]
    correlation: Annotated[NeighbourCorrelation, Doc("What neighbours share.")]
    n_frames: Annotated[int, Bounds(least=1, most=1_000_000), Doc("Still frames used.")]
    linear: Annotated[LinearNoise | None, Doc("The line, null where the variance is none over the level.")] = field(
        default_factory=lambda: None
    )  # made, so that programs are always told of it

    def __post_init__(self) -> None:
        n = len(np.atleast_1d(self.levels))
        for name in ("levels", "variance_levels2", "std_levels2"):
            object.__setattr__(self, name, frozen_array(name, getattr(self, name), (n,)))
        if n == 0 or (np.diff(self.levels) <= 0.0).any() or self.levels[0] < 0.0 or self.levels[-1] > LEVELS - 1:
            raise Inconsistent(f"noise: the levels are not one or more between 0 and {LEVELS - 1}, increasing")
        if (self.variance_levels2 < 0.0).any() or (self.std_levels2 < 0.0).any():
            raise Inconsistent("noise: a variance or a standard deviation is negative")
        if self.n_frames < 2:
            raise Inconsistent(f"noise: {self.n_frames} frames show none")

    def variance_at(self, level: ArrayLike) -> Array:
        """Return the variance in grey levels squared at any grey levels, in their shape.

        Between the knots a line; below the first knot and above the last one their values, above the last one of a
        linear camera its slope. Nowhere below what rounding alone makes.
        """
        x = np.asarray(level, float)
        variance = np.interp(x, self.levels, self.variance_levels2)
        if self.linear is not None:
            variance = variance + self.linear.gain_levels * np.maximum(x - self.levels[-1], 0.0)
        return np.asarray(np.maximum(variance, ROUNDING_LEVELS2))

    @figure(
        "Factors along u and v on the variance of a wide light's centre, for what neighbours share.", key="widening"
    )
    def widest(self) -> Pair:
        return self.widening()

    def summary(self) -> Iterator[Shown]:
        """Yield the noise at the levels, what neighbours share, and whether the camera is linear."""
        rows = [
            [digits(level), digits(sqrt(variance)), digits(std / (2.0 * sqrt(variance)) if variance else None, 2)]
            for level, variance, std in zip(self.levels, self.variance_levels2, self.std_levels2, strict=True)
        ]
        yield Table(f"Noise, {self.n_frames} frames", ["at grey level", "noise, grey levels", "+-"], rows)
        near, line = self.correlation, self.linear
        yield (
            f"Correlation with the next pixel: {near.x[0]:.3f} along x, {near.y[0]:.3f} along y, "
            f"{near.diagonal:.3f} along diagonals; the one after it: {near.x[1]:.3f}, {near.y[1]:.3f}"
        )
        if line is None:
            yield "The variance is no line over the grey level: a transfer curve or compression; the table holds"
        else:
            yield (
                f"Linear camera: read noise {digits(line.read_noise_levels)} grey levels, "
                f"{digits(line.gain_levels)} grey levels for each electron"
            )

    def table(self) -> Array:
        """Return the variance (256,) at every grey level, for kernels that look it up."""
        return self.variance_at(np.arange(LEVELS, dtype=float))

    def widening(self, sigma_px: float = inf) -> Array:
        """Return by what factor (2,) correlated noise widens the variance of a smooth light's centre, u and v.

        1: noise of independent pixels. Of a Gaussian of sigma_px, fitted with equal weights, the centre moves by the
        sum of (noise x derivative of the light), so that its variance grows by the sum over all lags of (correlation
        of the noise x correlation of the derivative with itself):
        (1 - t^2 / (2 s^2)) exp(-t^2 / (4 s^2)) for t px along the derivative, exp(-t^2 / (4 s^2)) across it. Without
        sigma_px its limit for wide lights, (1 + 2 x1 + 2 x2) (1 + 2 y1 + 2 y2) + 4 (diagonal - x1 y1). But for the
        nearest diagonal, correlations along x and y are taken to multiply, and those beyond LAGS to be 0. Not below 0.
        """
        t2 = np.square(np.array(LAGS, float)) / sigma_px**2  # (2,)
        across = np.exp(-t2 / 4.0)
        along = (1.0 - t2 / 2.0) * across
        x, y = self.correlation.x, self.correlation.y
        sums = [(1.0 + 2.0 * x @ a) * (1.0 + 2.0 * y @ b) for a, b in ((along, across), (across, along))]
        corners = 4.0 * (self.correlation.diagonal - x[0] * y[0]) * along[0] * across[0]
        return np.maximum(np.array(sums, float) + float(corners), 0.0)


# When a camera exposes: line by line, on a clock of its own, with stamps that are late and jitter.

PPM = 1e-6

CLOCK = ("delay_s", "drift_ppm")
TIMING = (*CLOCK, "readout_s", "exposure_s", "jitter_s")
"""Names that the covariance of a camera's timing may hold."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CameraTiming:
    """How the times of a camera's lines follow from the stamps of its frames.

    readout_s: from the first line's exposure to the last one's; 0 for a global shutter. exposure_s: of each line, 0
    where not known. delay_s, drift_ppm: what turns a stamp into the rig's time (that of the left camera's stamps):
    t + delay_s + 1e-6 drift_ppm t. jitter_s: standard deviation of a single stamp about that line. covariance: of any
    of TIMING, in these units; what it does not name is exact.
    """

    readout_s: float = 0.0
    exposure_s: float = 0.0
    delay_s: float = 0.0
    drift_ppm: float = 0.0
    jitter_s: float = 0.0
    covariance: NamedCovariance | None = None

    def __post_init__(self) -> None:
        if not (abs(self.readout_s) < 1.0 and 0.0 <= self.exposure_s < inf and 0.0 <= self.jitter_s < inf):
            raise Inconsistent(
                f"a camera cannot take {self.readout_s:g} s to read out, {self.exposure_s:g} s to expose and stamp to "
                f"{self.jitter_s:g} s",
                cure="Give seconds: the read-out of a rolling shutter takes 0.005 to 0.05",
            )
        if not (abs(self.delay_s) < inf and abs(self.drift_ppm) < 1e5):
            raise Inconsistent(
                f"a delay of {self.delay_s:g} s and a drift of {self.drift_ppm:g} ppm cannot be",
                cure="Clocks of cameras drift by less than 1000 ppm",
            )
        unknown = [name for name in self.names if name not in TIMING]
        if unknown:
            raise Inconsistent(
                f"the timing of a camera has no {', '.join(unknown)}", cure=f"It has {', '.join(TIMING)}"
            )

    @property
    def names(self) -> tuple[str, ...]:
        """Names in the covariance, in its order."""
        return () if self.covariance is None else self.covariance.names

    @property
    def std(self) -> dict[str, float]:
        """Standard deviations by name; what is not named is exact."""
        return {} if self.covariance is None else self.covariance.std()

    @property
    def rolling(self) -> bool:
        """Whether the lines are exposed one after the other."""
        return self.readout_s != 0.0

    def rig_time(self, stamp_s: ArrayLike) -> Array:
        """Return the rig's time of stamps (n,): the middle of the exposure of the middle line."""
        stamp = np.asarray(stamp_s, float)
        return np.asarray(stamp + self.delay_s + PPM * self.drift_ppm * stamp)

    def clock_std_s(self, stamp_s: ArrayLike) -> Array:
        """Return the standard deviation in s of rig_time at stamps (n,), by delay and drift together."""
        stamp = np.asarray(stamp_s, float)
        slopes = {"delay_s": np.ones_like(stamp), "drift_ppm": PPM * stamp}
        names = tuple(name for name in CLOCK if name in self.names)
        if self.covariance is None or not names:
            return np.zeros_like(stamp)
        J = np.stack([slopes[name] for name in names], axis=-1)
        return np.asarray(np.sqrt(np.einsum("...i,ij,...j->...", J, self.covariance.block(names), J)))

    def line_time(self, v_px: ArrayLike, height: int) -> Array:
        """Return when lines v_px (n,) of an image are exposed in s, from the middle line's time on."""
        return np.asarray(self.readout_s * (np.asarray(v_px, float) / (height - 1) - 0.5))


AT_ONCE = CameraTiming()
"""A global shutter whose stamps are the rig's time."""
