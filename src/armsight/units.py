"""Factors between what people read (mm, degrees) and what the program computes in (m, rad, s)."""

from __future__ import annotations

import math
import re

MM = 1e-3
"""One millimetre in metres."""

DEG = math.pi / 180.0
"""One degree in radians."""

MS = 1e-3
"""One millisecond in seconds."""

NOTHING = 1e-9
"""Below this no figure that people read says anything, in mm, degrees or px: 64-bit numbers are no finer."""

WRITTEN = {"m": 1.0, "mm": MM, "rad": 1.0, "deg": DEG, "m/s": 1.0, "mm/s": MM}
"""Units that people may write behind a number, in SI."""


def read_value(text: str) -> tuple[float, str]:
    """Return a number in SI and the unit written behind it: (0.6, 'mm') of '600mm', (0.6, '') of '0.6'.

    Raises ValueError.
    """
    match = re.fullmatch(r"\s*([-+0-9.eE]+?)\s*(deg|rad|mm/s|m/s|mm|m|)\s*", text)
    if match is None:
        raise ValueError(text)
    return float(match[1]) * WRITTEN.get(match[2], 1.0), match[2]
