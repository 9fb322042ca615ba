"""Joint values: one reading, and a track of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Inconsistent
from armsight.records.checks import frozen_array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointReading:
    """Joint values q (n,) in rad or m at one moment, with number and origin."""

    q: NDArray[np.float64]
    t_s: float
    sequence: int
    source: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", frozen_array("q", self.q, (None,)))
        if not np.isfinite(self.t_s):
            raise Inconsistent(f"{self.source}: the time {self.t_s} is not finite")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Motion:
    """A track of joint values: t_s (m,) increasing, q (m, n) in rad or m."""

    t_s: NDArray[np.float64]
    q: NDArray[np.float64]

    def __post_init__(self) -> None:
        object.__setattr__(self, "t_s", frozen_array("t_s", self.t_s, (None,)))
        object.__setattr__(self, "q", frozen_array("q", self.q, (len(self.t_s), None)))
        if (np.diff(self.t_s) <= 0.0).any():
            row = int(np.argmax(np.diff(self.t_s) <= 0.0)) + 1
            raise Inconsistent(
                f"time does not increase at row {row}: {self.t_s[row]:.9g} s after {self.t_s[row - 1]:.9g} s",
                consequence="The track has no order",
                cure="Give each time once, in order",
            )
