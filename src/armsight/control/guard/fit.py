"""Whether limits can be those of an arm: their number, their units, and whether they leave the arm any place to be."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Inconsistent, UsageError
from armsight.kinematics import Arm
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from armsight.control.guard.limits import Box, JointLimit, Limits

Array = NDArray[np.float64]

MOST_TURN_RAD = 4.0 * math.pi
"""Two turns either way: only an endless joint has a wider range, and degrees are wider with most arms."""
ENDLESS_RAD = 800.0
"""Beyond it a range is that of an endless joint: in degrees it would be two turns and more."""
WIDER = 1.5
"""A range that goes this many times beyond the arm's own, and beyond a turn, limits nothing: ten degrees as 10 rad."""
MOST_SLIDE_M = 30.0
"""A linear axis of 10 m is a long one; strokes in millimetres begin at some tens."""
MOST_OF_TURNING = {"speed": 50.0, "acceleration": 1000.0, "jerk": 50_000.0}
"""rad/s, s^2, s^3: the last joint of a small SCARA arm turns at 2,600 deg/s, which is 45; 50 g of a delta arm with
forearms of 0.5 m are 1,000, and that within 20 ms 50,000."""
MOST_OF_SLIDING = {"speed": 20.0, "acceleration": 500.0, "jerk": 50_000.0}
"""m/s, s^2, s^3: a linear motor goes 5 m/s at 200 m/s^2, the tool of a delta arm 10 at 150."""


def check_fit(arm: Arm, limits: Limits) -> None:
    """Raise UsageError for limits of another number of joints, Inconsistent where they cannot be those of this arm."""
    for given in (len(limits.joints) or arm.n, arm.n if limits.retreat is None else len(limits.retreat)):
        if given != arm.n:
            raise UsageError(
                f"the limits are those of {given} joints, {arm.name} has {arm.n}",
                consequence="The robot is not moved",
                cure="Take the limits of this arm",
            )
    for j, row in enumerate(limits.joints):
        _check_joint(arm, j, row)
    _check_retreat(arm, limits)
    _check_boxes(arm, limits)


def _check_joint(arm: Arm, j: int, row: JointLimit) -> None:
    """Raise Inconsistent for a joint's range or speed in degrees or mm, and for a range that the arm's own excludes."""
    turns = bool(arm.revolute[j])
    unit, small, factor = _units(turns)
    low, high = float(arm.lower[j]), float(arm.upper[j])
    if _too_wide(row, turns, math.inf if arm.couplings else max(abs(low), abs(high))):
        told = ", ".join(f"{key}: {end * factor:.4g}" for key, end in _ends(row))
        raise Inconsistent(
            f"joint {j + 1}: the limits {_range(row.lower, row.upper)} {unit} look like {small}",
            consequence="As they stand they would limit nothing; nothing is moved",
            cure=f"Write lower and upper in {unit} (from {small}: {told}), or leave them out where the arm's own hold",
        )
    if not arm.couplings and not max(row.lower, low) < min(row.upper, high):
        raise Inconsistent(
            f"joint {j + 1}: the limits {_range(row.lower, row.upper)} and the arm's own, {_range(low, high)} {unit}, "
            "leave no way to go",
            consequence="The robot is not moved",
            cure="Take the limits of this arm, or compare them with its file",
        )
    for key, most in (MOST_OF_TURNING if turns else MOST_OF_SLIDING).items():
        value = getattr(row, key)
        if value is not None and value > most:
            raise Inconsistent(
                f"joint {j + 1}: {key} {value:g} is more than any joint's, {most:g}: it looks like one in {small}",
                consequence="As it stands it would limit nothing; nothing is moved",
                cure=f"Write it with {unit}: {key}: {value * factor:.4g} if {value:g} is in {small}",
            )


def _units(turns: bool) -> tuple[str, str, float]:
    """Return the unit of a joint's reading, the one it is mistaken for, and that one in the other."""
    return ("rad", "degrees", DEG) if turns else ("m", "mm", MM)


def _too_wide(row: JointLimit, turns: bool, own: float) -> bool:
    """Tell whether a range is of another unit: wider than any joint's, or than the arm's own, own, by far."""
    most = min(MOST_TURN_RAD, WIDER * max(own, MOST_TURN_RAD / 2.0)) if turns else MOST_SLIDE_M
    return any(most < abs(end) and not (turns and abs(end) > ENDLESS_RAD) for _, end in _ends(row))


def _ends(row: JointLimit) -> list[tuple[str, float]]:
    return [(key, end) for key, end in (("lower", row.lower), ("upper", row.upper)) if math.isfinite(end)]


def _range(low: float, high: float) -> str:
    return f"{low:.4g} to {high:.4g}"


def _check_retreat(arm: Arm, limits: Limits) -> None:
    """Raise Inconsistent for readings to go back to that are degrees, or beyond a joint's range."""
    if limits.retreat is None:
        return
    for j, value in enumerate(limits.retreat):
        low, high = (-math.inf, math.inf) if arm.couplings else (float(arm.lower[j]), float(arm.upper[j]))
        if limits.joints:
            low, high = max(low, limits.joints[j].lower), min(high, limits.joints[j].upper)
        unit, small, factor = _units(bool(arm.revolute[j]))
        turned = bool(arm.revolute[j]) and MOST_TURN_RAD < abs(value) <= ENDLESS_RAD
        if low <= value <= high and not turned:
            continue
        why = "looks like degrees" if turned else f"is beyond its range, {_range(low, high)}"
        raise Inconsistent(
            f"retreat: {value:.4g} {unit} of joint {j + 1} {why}",
            consequence="The arm could not go back there; nothing is moved",
            cure=f"Write readings of this arm in {unit}; if {value:.4g} are {small}, that is {value * factor:.4g}",
        )


def _check_boxes(arm: Arm, limits: Limits) -> None:
    """Raise Inconsistent for boxes that surely leave tool and flange no place: beyond reach, too thin, all forbidden.

    What only these joints' ranges leave out is not looked for: an arm that stands outside is told so.
    """
    reach_m, margin_m, inside = arm.reach_m, limits.margin_m, limits.workspace
    ball = np.array([np.full(3, -reach_m), np.full(3, reach_m)])  # around the base, which is the origin here
    if inside is not None:
        kept = np.array([inside.lower_m + margin_m, inside.upper_m - margin_m])
        tool_m = float(np.linalg.norm(arm.T_flange_tool.translation))
        if not (kept[0] < kept[1]).all():
            _refuse_box(f"workspace {inside.name} is thinner than twice margin_m ({margin_m:g} m)")
        if np.linalg.norm(np.clip(0.0, *kept)) > reach_m:
            _refuse_box(
                f"workspace {inside.name} begins {float(np.linalg.norm(np.clip(0.0, *kept))):.3g} m from the base, and "
                f"{arm.name} reaches {reach_m:.3g} m"
            )
        if np.linalg.norm(kept[1] - kept[0]) < tool_m:
            _refuse_box(f"workspace {inside.name} is smaller than the {tool_m:.3g} m from flange to tool, both in it")
        ball = np.array([np.maximum(ball[0], kept[0]), np.minimum(ball[1], kept[1])])
    for box in limits.forbidden:
        if _covers(box, margin_m, ball):
            what = "all that the arm reaches" if inside is None else f"the whole workspace {inside.name} within reach"
            _refuse_box(f"forbidden box {box.name} covers {what}")


def _covers(box: Box, margin_m: float, region: Array) -> bool:
    return bool((box.lower_m - margin_m <= region[0]).all() and (region[1] <= box.upper_m + margin_m).all())


def _refuse_box(cause: str) -> None:
    raise Inconsistent(
        cause,
        consequence="Nowhere could the arm be within its limits; nothing is moved",
        cure="Write boxes in base axes, in m, for this arm",
    )
