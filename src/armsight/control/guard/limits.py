"""What the guard keeps: limits of tool, joints and space, how long it waits for what, and whether they fit an arm."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from numbers import Real
from typing import Annotated

import numpy as np

from armsight.arrays import Array
from armsight.clock import STALL_S
from armsight.control.guard.plausible import check_corners, check_units
from armsight.defaults import TOOL_SPEED_M_S, TOOL_SPEED_RAD_S
from armsight.errors import Inconsistent, UsageError
from armsight.fields import Bounds
from armsight.kinematics import Arm
from armsight.records import Saveable, frozen_array, require_kind
from armsight.records.checks import NotNegative, Positive, Shape, require_bounds
from armsight.units import DEG, MM

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
                f"the limits are those of {given} joints, {arm.name} has {arm.n}", cure="Take the limits of this arm"
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
        ends = ", ".join(f"{key}: {end * factor:.4g}" for key, end in _ends(row))
        raise Inconsistent(
            f"joint {j + 1}: the limits {_range(row.lower, row.upper)} {unit} look like {small}",
            consequence="As they stand they would limit nothing; nothing is moved",
            cure=f"Write lower and upper in {unit} (from {small}: {ends}), or leave them out where the arm's own hold",
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
    shoulder = np.asarray(arm.T_base_frame0.translation)
    ball = shoulder + reach_m * np.array([[-1.0], [1.0]])  # around where the first joint stands, in base axes
    if inside is not None:
        kept = np.array([inside.lower_m + margin_m, inside.upper_m - margin_m])
        tool_m = float(np.linalg.norm(arm.T_flange_tool.translation))
        if not (kept[0] < kept[1]).all():
            _refuse_box(f"workspace {inside.name} is thinner than twice margin_m ({margin_m:g} m)")
        away_m = float(np.linalg.norm(np.clip(shoulder, *kept) - shoulder))
        if away_m > reach_m:
            _refuse_box(
                f"workspace {inside.name} begins {away_m:.3g} m from the first joint, and {arm.name} reaches "
                f"{reach_m:.3g} m"
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


JOINT_SPEED = 60.0 * DEG
"""Speed of a turning joint in rad/s where neither limits nor arm say one; the limits of the tool are reached sooner."""
SLIDE_SPEED_M_S = 0.1
JOINT_ACCELERATION = 5.0
"""rad/s^2: to full speed in 0.2 s."""
SLIDE_ACCELERATION = 1.0
JOINT_JERK = 250.0
"""rad/s^3: to full acceleration in 20 ms, five cycles of 4 ms."""
SLIDE_JERK = 50.0

ENABLE_AGE_S = 0.15
"""An enable sent longer ago is none: with the way to rest behind it the arm stands 0.3 s after the hand let go."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Box:
    """An axis-parallel box in base axes, corners lower_m (3,) and upper_m (3,); name: what messages call it."""

    lower_m: Annotated[Array, Shape((3,))]
    upper_m: Annotated[Array, Shape((3,))]
    name: str = "box"

    def __post_init__(self) -> None:
        for key in ("lower_m", "upper_m"):
            object.__setattr__(self, key, frozen_array(key, getattr(self, key), (3,)))
        if not (self.lower_m < self.upper_m).all():
            axes = ", ".join(axis for axis, kept in zip("xyz", self.lower_m < self.upper_m, strict=True) if not kept)
            raise Inconsistent(
                f"{self.name}: its lower corner {self.lower_m.tolist()} is not below its upper one "
                f"{self.upper_m.tolist()} in {axes}",
                consequence="The box holds no space",
                cure="Give the smaller value of each axis as lower_m",
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointLimit:
    """Limits of one joint's reading in rad or m, and of its speed, acceleration and jerk; None: the guard's default.

    They narrow what the arm's file says of the joint, and never widen it.
    """

    lower: float = -math.inf
    upper: float = math.inf
    speed: Positive | None = None
    acceleration: Positive | None = None
    jerk: Positive | None = None

    def __post_init__(self) -> None:
        for name in ("lower", "upper"):  # endless is as good a number
            require_kind(f"a joint's {name}", getattr(self, name), Real)
        if not self.lower < self.upper:
            raise Inconsistent(
                f"a joint's limits are {self.lower:g} to {self.upper:g}",
                consequence="The joint could not move",
                cure="Give the smaller one as lower",
            )
        require_bounds(self, "a joint's ")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Limits(Saveable):
    """What the guard keeps; the defaults are those of teaching beside people: 0.1 m/s and 60 deg/s at the tool.

    speed to jerk: of the tool's origin and of its turning. joints: one per joint, or none. workspace: the box that tool
    and flange stay in; forbidden: boxes they stay out of; margin_m: how far they keep from both, for what the arm's
    model does not know. singularity: least singular value of the Jacobian, lengths in units of the arm's mean link, for
    motion asked for in space. enable_age_s: of an enable or a set point that came over a network, ENABLE_AGE_S at most.
    target_age_s: of the frame a set point is from. silent_cycles: without a new reading, before it holds. late_cycles:
    lateness of a cycle that makes it hold; stall_s: time between two cycles that makes it stop; lost_s: without a
    reading. following (rad), following_m: how far readings may be from all that was sent within lag_s. jump_m,
    jump_rad: how far a ToolPose may be from the tool. calm_cycles: in time, before motion goes on after a late one.
    retreat (n,): readings to go back to, at the share retreat_speed of all speeds, when the target has been away for
    retreat_after_s.
    """

    speed_m_s: Positive = TOOL_SPEED_M_S
    turn_rad_s: Positive = TOOL_SPEED_RAD_S
    acceleration_m_s2: Positive = 2.0
    turn_acceleration_rad_s2: Positive = 20.0
    jerk_m_s3: Positive = 100.0
    turn_jerk_rad_s3: Positive = 1000.0
    joints: Annotated[tuple[JointLimit, ...], Bounds(least=1)] = ()
    workspace: Box | None = None
    forbidden: tuple[Box, ...] = ()
    margin_m: NotNegative = 0.005
    singularity: NotNegative = 0.03
    enable_age_s: Positive = ENABLE_AGE_S
    target_age_s: Positive = 0.15
    silent_cycles: Positive = 3.0
    late_cycles: Positive = 0.5
    stall_s: Positive = STALL_S
    lost_s: Positive = 0.5
    calm_cycles: Annotated[int, Bounds(least=0, most=100_000)] = 5
    lag_s: Positive = 0.3
    following: Positive = 0.02
    following_m: Positive = 0.005
    jump_m: Positive = 0.02
    jump_rad: Positive = 0.1
    retreat: Annotated[Array, Shape((None,))] | None = None
    retreat_after_s: NotNegative = 1.0
    retreat_speed: Positive = 0.25

    def __post_init__(self) -> None:
        require_bounds(self)
        for key, kind in (("joints", JointLimit), ("forbidden", Box)):
            require_kind(key, getattr(self, key), list, tuple)
            object.__setattr__(self, key, tuple(getattr(self, key)))
            for one in getattr(self, key):
                require_kind(f"an entry of {key}", one, kind)
        if self.retreat is not None:
            object.__setattr__(self, "retreat", frozen_array("retreat", self.retreat, (None,)))
        if self.enable_age_s > ENABLE_AGE_S:
            raise Inconsistent(
                f"enable_age_s is {self.enable_age_s:g}, longer than {ENABLE_AGE_S:g} s",
                consequence="A hand that lets go would stop the arm too late, and the robot is not moved",
                cure="Give less, or leave it away; a line too slow for that is none to drive over",
            )
        check_units(self)
        named = [("workspace", self.workspace), *((f"forbidden[{k}]", box) for k, box in enumerate(self.forbidden))]
        for key, box in named:
            if box is not None:
                check_corners(box, key)
        if self.retreat_speed > 1.0:
            raise Inconsistent(f"retreat_speed is {self.retreat_speed:g}, which is no share of the speed up to 1")

    def slowed(self, share: float) -> Limits:
        """Return the same limits with all speeds cut to a share of them."""
        joints = tuple(
            joint if joint.speed is None else replace(joint, speed=share * joint.speed) for joint in self.joints
        )
        return replace(self, speed_m_s=share * self.speed_m_s, turn_rad_s=share * self.turn_rad_s, joints=joints)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointBounds:
    """The limits of an arm's joints as arrays (n,), in rad or m and per s, s^2, s^3; lower, upper: of readings."""

    lower: Array
    upper: Array
    speed: Array
    acceleration: Array
    jerk: Array
    following: Array = field(repr=False)


def joint_bounds(arm: Arm, limits: Limits) -> JointBounds:
    """Return what limits and the arm's file say of each joint, the narrower of both.

    Raises UsageError where the limits are those of another number of joints, Inconsistent where they cannot be those of
    this arm, or leave it no place.
    """
    check_fit(arm, limits)
    rows = limits.joints or (JointLimit(),) * arm.n
    turns = arm.revolute
    lower, upper = (np.array([getattr(row, key) for row in rows]) for key in ("lower", "upper"))
    if not arm.couplings:  # with couplings the arm's own limits are those of other numbers, and are kept beside these
        lower, upper = np.maximum(lower, arm.lower), np.minimum(upper, arm.upper)
    fastest = np.array([math.inf if joint.max_speed is None else joint.max_speed for joint in arm.joints])
    speed = _of(rows, "speed", np.minimum(np.where(turns, JOINT_SPEED, SLIDE_SPEED_M_S), fastest))
    return JointBounds(
        lower=lower,
        upper=upper,
        speed=np.minimum(speed, fastest),
        acceleration=_of(rows, "acceleration", np.where(turns, JOINT_ACCELERATION, SLIDE_ACCELERATION)),
        jerk=_of(rows, "jerk", np.where(turns, JOINT_JERK, SLIDE_JERK)),
        following=np.where(turns, limits.following, limits.following_m),
    )


def _of(rows: tuple[JointLimit, ...], key: str, default: Array) -> Array:
    return np.array(
        [d if getattr(row, key) is None else getattr(row, key) for row, d in zip(rows, default, strict=True)]
    )
