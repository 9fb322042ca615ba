"""Whether numbers can be what is said of them: degrees given for radians, millimetres for metres."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike

LARGEST_RAD = 7.0
"""Joints and pose angles in radians stay below: a whole turn and a tenth. Those in degrees of an arm that moves at all
go beyond it."""
SMALLEST_DEG = 3.2
"""Where every angle of a table in degrees stays below, it holds radians: no arm is measured within three degrees."""
SMALLEST_SPREAD_RAD = 0.2
"""... but only where they spread by more than this: an arm may stand at zero."""
LARGEST_LIMIT_RAD = 4.0 * math.pi
"""Two turns either way: no revolute joint but an endless one has a wider limit, and degrees are wider with any arm."""
ENDLESS_RAD = 800.0
"""Beyond it a limit is that of an endless joint: in degrees it would be two turns and more."""
WHOLE_TURN = 0.01
"""Share of a turn by which a limit of many turns may miss a whole number of them: 50.3 for 16 pi."""
LARGEST_M = 30.0
"""A position further away is one in millimetres: no arm, rig or tracker's target is so far off."""
SMALLEST_MM = 3.0
"""Where all positions in millimetres lie closer than that to the origin, they are metres."""
FEWEST_ROWS = 5
"""Fewer rows than these say nothing of where an arm stays within."""


def largest(values: ArrayLike) -> float:
    """Return the largest absolute value that is finite, 0 where there is none."""
    array = np.abs(np.asarray(values, float)).ravel()
    array = array[np.isfinite(array)]
    return float(array.max()) if array.size else 0.0


def looks_like_degrees(values_rad: ArrayLike) -> bool:
    """Whether angles that are said to be radians can only be degrees."""
    return largest(values_rad) > LARGEST_RAD


def limits_look_like_degrees(values_rad: ArrayLike) -> bool:
    """Whether limits of revolute joints that are said to be radians are degrees; those that are not finite are none.

    A pair of as many whole turns either way is one of radians: 16 pi, also written as 50.3.
    """
    array = np.abs(np.asarray(values_rad, float)).ravel()
    array = array[np.isfinite(array)]
    turns = array / (2.0 * math.pi)
    if len(array) == 2 and array[0] == array[1] and abs(turns[0] - round(turns[0])) < WHOLE_TURN:
        return False
    return bool(((array > LARGEST_LIMIT_RAD) & (array <= ENDLESS_RAD)).any())


def looks_like_radians(values_deg: ArrayLike) -> bool:
    """Whether angles (n, k) that are said to be degrees are radians: all small, over several rows, and spread."""
    array = np.atleast_2d(np.asarray(values_deg, float))
    if len(array) < FEWEST_ROWS or largest(array) >= SMALLEST_DEG:
        return False
    return bool(np.nanmax(np.ptp(array, axis=0)) > SMALLEST_SPREAD_RAD * 5.0)


def looks_like_mm(xyz_m: ArrayLike) -> bool:
    """Whether positions that are said to be metres can only be millimetres."""
    return largest(xyz_m) > LARGEST_M


def looks_like_m(xyz_mm: ArrayLike) -> bool:
    """Whether positions (n, 3) that are said to be millimetres are metres."""
    array = np.atleast_2d(np.asarray(xyz_mm, float))
    return len(array) >= FEWEST_ROWS and 0.0 < largest(array) < SMALLEST_MM


def degrees_cause(values_rad: ArrayLike) -> str:
    """Return what is wrong with angles that look like degrees, in words."""
    return (
        f"these look like degrees: the largest value is {largest(values_rad):.4g}, and a turn has {2 * math.pi:.3g} rad"
    )
