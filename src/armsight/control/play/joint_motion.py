"""Set points of a joint motion that was planned, one a cycle."""

from __future__ import annotations

import numpy as np
from scipy.interpolate import CubicSpline

from armsight.arrays import Array
from armsight.control.setpoints import CycleState, Finished, Hold, JointGoal, JointVelocity, SetPoint
from armsight.errors import UsageError
from armsight.records import Motion

CLOSE = 2e-3
"""rad or m: an arm so near to the motion goes along with it; one further off goes there first."""
ASTRAY = 0.02
"""Further from the motion than this the motion waits until the arm is back on it."""
ARRIVED = 1e-5
PULL_PER_S = 4.0
"""How quickly what an arm is off the motion is taken back."""
RAMP_S = 0.5
"""Time in which the motion gathers its full speed, and gives it up where it is paused."""


class JointMotionSource:
    """Runs a motion of the joints: to its first reading as the guard goes there, then along it by its own times.

    Where the guard does not follow, the motion stands still, and goes on from the same reading once the arm was brought
    back to it. next is for the loop; pause, resume and override may be called from any thread.
    """

    name = "joint motion"

    def __init__(self, motion: Motion, *, override: float = 1.0) -> None:
        """override: share of the planned speed, 0.01 to 1. Raises UsageError for another."""
        if not 0.01 <= override <= 1.0:
            raise UsageError(
                f"an override of {override:g} is no share from 0.01 to 1",
                consequence="Nothing is moved",
                cure="Give for instance 0.5 (--override)",
            )
        self.override = override
        self._t_s = motion.t_s - motion.t_s[0]
        self._spline = CubicSpline(self._t_s, motion.q)
        self._speed = self._spline.derivative()
        self._at_s, self._rate = 0.0, 0.0
        self._on_it, self._paused, self._finished = False, False, False

    @property
    def length_s(self) -> float:
        """How long the motion takes at full override."""
        return float(self._t_s[-1])

    @property
    def at_s(self) -> float:
        """How far along it the motion is, s of its own time."""
        return self._at_s

    @property
    def stage(self) -> str:
        """approach, motion or finished."""
        return "finished" if self._finished else "motion" if self._on_it or self._at_s > 0.0 else "approach"

    @property
    def paused(self) -> bool:
        """Whether it was told to wait."""
        return self._paused

    def pause(self) -> None:
        """Come to rest along the motion, and wait there."""
        self._paused = True

    def resume(self) -> None:
        """Go on."""
        self._paused = False

    def next(self, now: CycleState) -> SetPoint:
        """Return the joints' velocity along the motion; a goal where the arm is beside it; Finished at its end."""
        if self._finished:
            return Finished()
        if len(now.q_sent) != self._spline.c.shape[2]:
            return JointGoal(q=np.asarray(self._spline(0.0)))  # the guard refuses it, and says why
        goal = np.asarray(self._spline(self._at_s))
        off = float(np.abs(goal - now.q_sent).max())
        still = float(np.abs(now.qd_sent).max())
        if not now.running or (self._on_it and off > ASTRAY):
            self._on_it, self._rate = False, 0.0
        if not self._on_it:
            if not now.running or off > CLOSE or still > ARRIVED:
                return JointGoal(q=goal)
            self._on_it = True
        if self._paused and self._rate == 0.0:
            return Hold()
        return self._along(now, goal)

    def _along(self, now: CycleState, goal: Array) -> SetPoint:
        """Go on by a cycle, at a rate that grows and falls evenly; back towards the motion where it is beside it."""
        wanted = 0.0 if self._paused else self.override
        most = now.cycle_s / RAMP_S
        self._rate += float(np.clip(wanted - self._rate, -most, most))
        before, self._at_s = self._at_s, min(self._at_s + self._rate * now.cycle_s, self.length_s)
        if before >= self.length_s:
            if np.abs(goal - now.q_sent).max() < ARRIVED and np.abs(now.qd_sent).max() < ARRIVED:
                self._finished = True
                return Finished()
            return JointGoal(q=goal)
        pull = PULL_PER_S * (goal - now.q_sent)
        return JointVelocity(qd=np.asarray(self._rate * self._speed(self._at_s) + pull))
