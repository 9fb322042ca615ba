"""What a servo is asked to do, and with what."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from armsight.app.servo.stepped import SteppedClock
from armsight.clock import Clock
from armsight.drivers import PairSource, Robot

CAMERA, TOOL = "camera", "tool"


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
