"""Whether lengths can be metres at all: one rule for whatever is calibrated, identified or verified."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from armsight.errors import Inconsistent

FAR_M = 50.0
"""No robot's flange is so far from its base, no camera sees a target and no tip rests on a point so far away: such
numbers are millimetres."""
SPREAD_M = 25.0
"""Positions that an arm brought its tool to lie no further from their middle: those of a gantry 20 m long lie 10 m from
it. In millimetres an arm reaches it that moves by 25 mm."""
TOOL_M = 10.0
"""No tool's end is so far from its flange, nor from the target on it: 10 mm taken as metres."""
PITCH_M = 1.0
"""No board's points are so far apart."""
TARGET_M = 15.0
"""No target's lights are so far apart: 15 mm taken as metres."""
LARGEST_BASELINE_M = 1.0
"""A pair further apart than this has its unit said: centimetres (7.5), millimetres (60) and squares of a board (2.4)
look like wide rigs, and no rig of cameras that see a tool has been met that is wider than 0.6 m."""


def wide_rig(baseline_m: float) -> str:
    """Return what to look for where a rig is wider than any that sees an arm, else ''."""
    if baseline_m <= LARGEST_BASELINE_M:
        return ""
    return (
        f"The rig's cameras are {baseline_m:.3g} m apart: lengths in centimetres, millimetres or squares look so. "
        "Where they stand closer, calibrate with the board's square in metres, or convert the rig's file with --unit."
    )


def check_metres(length_m: ArrayLike, most_m: float, what: str) -> None:
    """Raise Inconsistent where the middle of lengths that are said to be metres is beyond what any is. what: they are,
    in words that a length follows."""
    array = np.atleast_1d(np.asarray(length_m, float))
    middle = float(np.median(array)) if array.size else 0.0
    if middle > most_m:
        raise Inconsistent(
            f"{what} {middle:.4g} m: these are millimetres (mm, or another unit) given as metres",
            consequence="Every distance in the result would be wrong",
            cure="Divide the lengths by 1000, or name the right unit when exporting them",
        )


def check_spread(xyz_m: ArrayLike, what: str) -> None:
    """Raise Inconsistent where positions (m, 3) that an arm brought its tool to lie too far from their middle for
    metres.

    Where they are seen from does not count: a tracker or a map has its origin anywhere.
    """
    array = np.asarray(xyz_m, float).reshape(-1, 3)
    if len(array):
        check_metres(np.linalg.norm(array - np.median(array, axis=0), axis=1), SPREAD_M, f"{what} spread over")
