"""Motion by hand: axes of a keyboard or a gamepad, which count only while they are fresh."""

from __future__ import annotations

from collections.abc import Sequence
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray

from armsight.control.setpoints import CycleState, Hold, JointVelocity, SetPoint, ToolTwist
from armsight.errors import UsageError
from armsight.units import DEG

TIMEOUT_S = 0.25
"""Axes older than this are let go of: a keyboard repeats a key about thirty times a second after its first pause."""
SPEED_M_S = 0.05
TURN_RAD_S = 20.0 * DEG
JOINT_SPEED = 10.0 * DEG
DEAD_ZONE = 0.05
"""A stick nearer to its middle than this share of its way is let go of."""


class JogFrame(StrEnum):
    """What the axes move: each joint, or the tool along and about the axes of the base or its own."""

    JOINTS = "joints"
    BASE = "base"
    TOOL = "tool"


class JogSource:
    """Turns axes of -1 to 1 into velocities. It reads no keys: whoever does calls push.

    n: joints of the robot. Axes are n joints, or x, y, z, rx, ry, rz of the frame. speed_m_s, turn_rad_s, joint_speed
    (rad/s or m/s): at a full axis; the guard cuts what is too fast.
    """

    name = "jog"

    def __init__(
        self,
        n: int,
        frame: JogFrame | str = JogFrame.JOINTS,
        *,
        speed_m_s: float = SPEED_M_S,
        turn_rad_s: float = TURN_RAD_S,
        joint_speed: float = JOINT_SPEED,
        timeout_s: float = TIMEOUT_S,
    ) -> None:
        self.frame = JogFrame(frame)
        self._n = n if self.frame is JogFrame.JOINTS else 6
        self._most = np.full(n, joint_speed) if self.frame is JogFrame.JOINTS else _both(speed_m_s, turn_rad_s)
        self._timeout_s = timeout_s
        self._axes: tuple[float, NDArray[np.float64]] | None = None

    def push(self, axes: Sequence[float], t_s: float) -> None:
        """Take the axes' values at t_s, on the loop's clock; legal from any thread.

        Raises UsageError for another number of axes; what is no number between -1 and 1 is cut, or let go of.
        """
        values = np.asarray(axes, dtype=float)
        if values.shape != (self._n,):
            raise UsageError(
                f"{len(axes)} axes were pushed, {self.frame} has {self._n}",
                consequence="They are not followed",
                cure=f"Push {self._n} values between -1 and 1",
            )
        values = np.clip(np.where(np.isfinite(values), values, 0.0), -1.0, 1.0)
        self._axes = (t_s, np.where(np.abs(values) < DEAD_ZONE, 0.0, values))

    def release(self) -> None:
        """Let go of all axes."""
        self._axes = None

    def next(self, now: CycleState) -> SetPoint:
        """Return the velocity that the axes ask for; Hold where none is pushed, or longer ago than the time-out."""
        pushed = self._axes
        if pushed is None or now.t_s - pushed[0] > self._timeout_s or not pushed[1].any():
            return Hold()
        velocity = self._most * pushed[1]
        if self.frame is JogFrame.JOINTS:
            return JointVelocity(qd=velocity)
        if self.frame is JogFrame.TOOL:
            turn = now.T_base_tool.rotation
            return ToolTwist(velocity_m_s=turn.apply(velocity[:3]), angular_rad_s=turn.apply(velocity[3:]))
        return ToolTwist(velocity_m_s=velocity[:3], angular_rad_s=velocity[3:])


def _both(straight: float, turned: float) -> NDArray[np.float64]:
    return np.array([straight] * 3 + [turned] * 3)
