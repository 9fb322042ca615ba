"""When a camera exposes: line by line, on a clock of its own, with stamps that are late and jitter."""

from __future__ import annotations

from dataclasses import dataclass
from math import inf

import numpy as np
from numpy.typing import ArrayLike

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.records.covariance import NamedCovariance

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
