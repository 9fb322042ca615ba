"""Which joint values and places a reading can tell at all."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

LARGEST_RAD = 100.0
"""No joint of a robot turns 16 times: a larger value is not a reading."""

LARGEST_M = 100.0
"""No flange is so far from its base."""

LARGEST_SPEED_RAD_S = 60.0
"""No joint of a robot moves so fast: a reading that says so is refused."""

JUMP_CYCLES = 3
"""Over so many missed cycles a joint may have moved; an arm that is elsewhere after more is refused until the link is
lost: the old goal must not pull it back."""


def possible(q: NDArray[np.float64], last: NDArray[np.float64], cycles: int, cycle_s: float) -> bool:
    """Tell whether joints can be where they are read, q (n,), so many cycles after the reading last (n,)."""
    return bool(np.abs(q - last).max() <= LARGEST_SPEED_RAD_S * min(cycles, JUMP_CYCLES) * cycle_s)
