"""What a servo is asked to do, and with what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from armsight.app.servo.stepped import SteppedClock
from armsight.clock import Clock
from armsight.drivers import PairSource, Robot
from armsight.units import DEG

LATENCY_S = 0.03
"""From the middle of an exposure to the frame in memory, of cameras nobody has measured: two frames at 60 a second."""
CAMERA, TOOL = "camera", "tool"


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoJob:
    """robot: DRIVER:DEVICE. left and right, or image: live cameras; of a simulated robot none, its cell has them.

    at: whether the target is wanted on the camera's or on the tool's z axis, distance_m from its origin. gain: of
    translation and rotation in 1/s; None: the largest without overshoot. rotation: align, keep or hold, see
    control.servo.Turning. predict:
    go for where the target will be. arm_lag_s: from a command to the arm's motion, as first assumed; None: two cycles.
    latency_s: from exposure to frame in memory. speed: share of the limits' speeds. seconds_s: end after so long. hand,
    hand_speed_m_s: how the target of a simulated cell is led. resume_m, resume_rad: how near to where it would be
    a target that jumped has to be, to be followed again by itself.
    """

    robot: str
    rig: Path
    target: Path
    handeye: Path
    out: Path
    left: str | None = None
    right: str | None = None
    image: str | None = None
    at: str = CAMERA
    distance_m: float = 0.6
    gain: float | None = None
    rotation: str = "align"
    predict: bool = True
    arm: Path | None = None
    limits: Path | None = None
    speed: float = 1.0
    arm_lag_s: float | None = None
    latency_s: float = LATENCY_S
    exposure_s: float | None = None
    seconds_s: float | None = None
    hand: str | None = None
    hand_speed_m_s: float = 0.05
    resume_m: float = 0.02
    resume_rad: float = 3.0 * DEG


@dataclass(frozen=True, slots=True, kw_only=True)
class ServoDevices:
    """A robot and its cameras, not yet open. overlaid: one image holds both views.

    origin_s: tells the clock's time of the cameras' zero once they are open, None where only arrivals tell it.
    stepped: the clock of a simulated cell, which moves only as far as the loop waits; None: real time.
    """

    robot: Robot
    pairs: PairSource
    clock: Clock
    overlaid: bool = False
    origin_s: Callable[[], float] | None = None
    stepped: SteppedClock | None = None
