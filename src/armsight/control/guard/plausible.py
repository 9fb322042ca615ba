"""Values of limits that no arm has: they are in another unit than meant, and would keep nothing."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from armsight.errors import Inconsistent
from armsight.units import DEG, MM, MS

if TYPE_CHECKING:
    from armsight.control.guard.limits import Box, Limits


@dataclass(frozen=True, slots=True)
class Plausible:
    """most: the largest value of a key that is meant as it stands, in unit; beyond it, it is taken for one in small.

    one: one of those in the key's own unit. small is empty where no other unit is likely.
    """

    most: float
    unit: str
    small: str
    one: float


PLAUSIBLE = {
    # a delta arm's tool goes 10 m/s at 150 m/s^2; a SCARA's last joint turns at 2,600 deg/s, which is 45 rad/s
    "speed_m_s": Plausible(20.0, "m/s", "mm/s", MM),
    "turn_rad_s": Plausible(50.0, "rad/s", "deg/s", DEG),
    "acceleration_m_s2": Plausible(500.0, "m/s^2", "mm/s^2", MM),
    "turn_acceleration_rad_s2": Plausible(1000.0, "rad/s^2", "deg/s^2", DEG),
    # those accelerations within 10 to 20 ms
    "jerk_m_s3": Plausible(50_000.0, "m/s^3", "mm/s^3", MM),
    "turn_jerk_rad_s3": Plausible(50_000.0, "rad/s^3", "deg/s^3", DEG),
    # a tenth and more of most arms' reach; a path at 10 m/s goes 0.12 m in a cycle of 12 ms, one at 50 rad/s 0.6 rad
    "margin_m": Plausible(0.5, "m", "mm", MM),
    "jump_m": Plausible(0.5, "m", "mm", MM),
    "jump_rad": Plausible(1.0, "rad", "degrees", DEG),
    "following": Plausible(0.5, "rad", "degrees", DEG),
    "following_m": Plausible(0.5, "m", "mm", MM),
    # a least singular value, lengths in mean links, is below 1 for every preset
    "singularity": Plausible(1.0, "", "percent", 0.01),
    # ten frames or commands of one second; a target may be waited for during minutes
    "target_age_s": Plausible(10.0, "s", "ms", MS),
    # half a second: controllers end a guidance that is silent for 0.1 to 1 s
    "stall_s": Plausible(0.5, "s", "ms", MS),
    "lost_s": Plausible(10.0, "s", "ms", MS),
    "lag_s": Plausible(10.0, "s", "ms", MS),
    "retreat_after_s": Plausible(900.0, "s", "ms", MS),
    # shares and counts of cycles: beyond a second of the fastest link, of 1 ms, they watch nothing
    "silent_cycles": Plausible(1000.0, "cycles", "", 1.0),
    "late_cycles": Plausible(1000.0, "cycles", "", 1.0),
}
MOST_M = 30.0
"""Of a corner: no arm stands so far from its box, a linear axis of 10 m is a long one; millimetres go beyond it."""


def check_units(limits: Limits) -> None:
    """Raise Inconsistent for values that no arm has: they are in another unit, and would keep nothing."""
    for key, plausible in PLAUSIBLE.items():
        value = getattr(limits, key)
        if value <= plausible.most:
            continue
        unit, small = plausible.unit, plausible.small
        like = f": it looks like {small}" if small else ""
        raise Inconsistent(
            " ".join(f"{key} is {value:g} {unit}".split()) + f", more than any arm needs ({plausible.most:g}){like}",
            consequence="As it stands it would not keep what is meant, and nothing is moved",
            cure=f"{value:g} {small} would be {key}: {value * plausible.one:.4g}" if small else f"Give {unit}",
        )


def check_corners(box: Box, key: str) -> None:
    """Raise Inconsistent, with the box's key, where its corners are in mm."""
    called = key if box.name == "box" else f"{key} {box.name}"
    furthest = max((*box.lower_m.tolist(), *box.upper_m.tolist()), key=abs)
    if abs(furthest) > MOST_M:
        lower, upper = ([float(f"{v * MM:.4g}") for v in corner] for corner in (box.lower_m, box.upper_m))
        raise Inconsistent(
            f"{called}: a corner at {furthest:g} m is further away than any arm: it looks like mm",
            consequence="As it stands it would limit nothing, and nothing is moved",
            cure=f"Write m (from mm: lower_m: {lower}, upper_m: {upper}); an endless wall may be {MOST_M:g} m off",
        )
