"""Factors between what people read (mm, degrees) and what the program computes in (m, rad, s)."""

from __future__ import annotations

import math

MM = 1e-3
"""One millimetre in metres."""

DEG = math.pi / 180.0
"""One degree in radians."""

MS = 1e-3
"""One millisecond in seconds."""
