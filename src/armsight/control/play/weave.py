"""Weaves: what the tip does across the direction of its path."""

from __future__ import annotations

import math
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array
from armsight.errors import UsageError

MOST_M = {"amplitude_m": 0.025, "wavelength_m": 0.1}
"""Wider or longer weaves are millimetres taken for metres: welding robots weave by 25 mm at most."""
HARMONICS = 3
"""Of a zigzag: its flanks are straight to a few per cent, its tips round, so that the arm need not stop there."""


class WeaveKind(StrEnum):
    """What a weave looks like from above."""

    NONE = "none"
    SINE = "sine"
    ZIGZAG = "zigzag"


@dataclass(frozen=True, slots=True, kw_only=True)
class Weave:
    """amplitude_m: from the seam to the farthest position on either side. wavelength_m: along the seam."""

    kind: WeaveKind = WeaveKind.NONE
    amplitude_m: float = 0.0
    wavelength_m: float = 0.0

    def __post_init__(self) -> None:
        if self.kind is WeaveKind.NONE:
            return
        for name in ("amplitude_m", "wavelength_m"):
            value = getattr(self, name)
            if not (math.isfinite(value) and 0.0 < value <= MOST_M[name]):
                raise UsageError(
                    f"the weave's {name} is {value:g}, which is not above zero and up to {MOST_M[name]:g} m",
                    consequence="Nothing is moved",
                    cure="Give metres, for instance --weave sine:0.002:0.008",
                )

    @classmethod
    def parse(cls, text: str) -> Weave:
        """Return the weave of a text none, sine:AMPLITUDE:WAVELENGTH or zigzag:..., in m. Raises UsageError."""
        name, *numbers = text.split(":")
        try:
            kind = WeaveKind(name)
            values = [float(part) for part in numbers]
            if len(values) != (0 if kind is WeaveKind.NONE else 2):
                raise ValueError
        except ValueError:
            raise UsageError(
                f"{text[:60]!r} is no weave",
                consequence="Nothing is moved",
                cure="Give none, sine:AMPLITUDE:WAVELENGTH or zigzag:AMPLITUDE:WAVELENGTH in metres",
            ) from None
        return cls() if not values else cls(kind=kind, amplitude_m=values[0], wavelength_m=values[1])

    def offset_m(self, s_m: ArrayLike) -> Array:
        """Return the offset across the seam (n,) at lengths s_m (n,) along it; 0 at length 0."""
        s = np.asarray(s_m, dtype=np.float64)
        if self.kind is WeaveKind.NONE:
            return np.zeros_like(s)
        phase = s / self.wavelength_m
        if self.kind is WeaveKind.SINE:
            return np.asarray(self.amplitude_m * np.sin(2.0 * np.pi * phase))
        return self.amplitude_m * _zigzag(phase)


def _zigzag(phase: Array) -> Array:
    """Return a zigzag (n,) of height 1 with tips rounded: the first harmonics of a triangular wave."""
    angle = 2.0 * np.pi * phase
    rows = [(-1) ** k * np.sin((2 * k + 1) * angle) / (2 * k + 1) ** 2 for k in range(HARMONICS)]
    return np.asarray(np.sum(rows, axis=0) / sum(1.0 / (2 * k + 1) ** 2 for k in range(HARMONICS)))
