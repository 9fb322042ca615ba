"""Figures of errors, and how much a series of them is worth where neighbours hang together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """Mean, mean absolute, largest absolute, standard deviation and RMS of errors, in their own unit."""

    me: float
    mae: float
    max: float
    sd: float
    rms: float

    @classmethod
    def of(cls, errors: Array) -> Figures:
        """Return the figures of errors (m,), m >= 1."""
        size = np.abs(errors)
        return cls(
            me=float(errors.mean()),
            mae=float(size.mean()),
            max=float(size.max()),
            sd=float(errors.std(ddof=1)) if len(errors) > 1 else 0.0,
            rms=float(np.sqrt(np.mean(errors**2))),
        )


def inflation(residual: Array) -> float:
    """Return how many rows of residuals (m, k) are worth one independent row, at least 1.

    One plus twice the sum of the autocorrelation up to where it first falls below zero (Geyer's initial sequence).
    """
    m = len(residual)
    if m < 8:
        return 1.0
    centred = residual - residual.mean(axis=0)
    size = 1 << (2 * m - 1).bit_length()
    power = np.abs(np.fft.rfft(centred, size, axis=0)) ** 2
    correlation = np.fft.irfft(power.sum(axis=1), size)[: m // 2]
    if not correlation[0] > 0.0:
        return 1.0
    correlation = correlation / correlation[0]
    noise = 2.0 / np.sqrt(m * residual.shape[1])
    end = int(np.argmax(np.append(correlation, -1.0) < noise))
    return float(max(1.0, 1.0 + 2.0 * correlation[1:end].sum()))
