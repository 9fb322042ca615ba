"""A robot led from pose to pose before cameras, and looked at where it rests: repeated visits of commanded poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.control.joint_sweep import HELD_BACK_S, REST_FRAMES, REST_STEP, REST_TIMEOUT_S, STUCK
from armsight.drivers import Robot, RobotState
from armsight.errors import Cancelled, DeviceFailed, DeviceLost, NotEnoughData
from armsight.records import PoseStatus, Progress, TargetPose

THERE = 1e-6
"""Joint readings (rad, m) so near to where the track has them are there."""
MOST_LOST = 30
"""Looks in a row at a stop without a whole pose that mean the target is not seen there."""


class PoseObserver(Protocol):
    """Sees where the target is, now."""

    def observe(self, while_: str) -> tuple[float, TargetPose]:
        """Return when the newest frames were taken at the earliest, on our clock, and what they show.

        while_: what the robot does, for messages. Raises DeviceFailed where no frames come.
        """


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Leg:
    """The way to a pose: joint readings q (k, n) at times t_s (k,); it begins where the last leg ended."""

    name: str
    q: Array
    t_s: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Visit:
    """What was seen at one stop: the pose's name, the cycle from 1, frames with a whole pose, and the readings (n,)."""

    name: str
    cycle: int
    poses: tuple[TargetPose, ...]
    q: Array


class Visitor:
    """Leads an open robot along legs. Nothing here stops the robot: whoever catches an error does."""

    def __init__(self, robot: Robot, observer: PoseObserver, clock: Clock, progress: Progress, *, frames: int) -> None:
        """frames: with a whole pose that are wanted at a stop."""
        self._robot, self._observer = robot, observer
        self._clock, self._progress, self._frames = clock, progress, frames
        self._at: Array | None = None

    def visit(self, leg: Leg, cycle: int) -> Visit:
        """Go along a leg, rest, and look. Raises DeviceFailed, DeviceLost, NotEnoughData, Cancelled."""
        self._go(leg)
        self._rest(leg)
        return self._look(leg, cycle)

    def _go(self, leg: Leg) -> None:
        at = self._robot.step_joints(np.zeros(leg.q.shape[1])).q if self._at is None else self._at
        gone_s, stuck = 0.0, 0
        while gone_s < leg.t_s[-1] or np.abs(leg.q[-1] - at).max() > THERE:
            self._check_going(f"on the way to {leg.name}")
            gone_s = min(gone_s + self._robot.cycle_s, float(leg.t_s[-1])) if stuck == 0 else gone_s
            goal = np.array([np.interp(gone_s, leg.t_s, column) for column in leg.q.T])
            sent = self._robot.step_joints(goal - at)
            short = np.abs(goal - sent.q).max()
            stuck = stuck + 1 if short > THERE else 0  # the guard took a part of it: wait on the track
            if stuck >= STUCK and np.abs(sent.q - at).max() < THERE:
                raise _does_not_go(leg.name, sent.limited)
            at = self._at = sent.q
            self._clock.sleep_until(self._clock.now_s() + self._robot.cycle_s)

    def _rest(self, leg: Leg) -> None:
        """Return when the joints keep still and frames come that were taken after."""
        arrived_s, still = self._clock.now_s(), 0
        before = self._robot.read()
        while still < REST_FRAMES:
            self._check_going(f"coming to rest at {leg.name}")
            if self._clock.now_s() - arrived_s > REST_TIMEOUT_S:
                raise DeviceFailed(
                    f"the arm did not come to rest at {leg.name} in {REST_TIMEOUT_S:g} s",
                    consequence="The run ends there",
                    cure="Look for vibration or a slipping brake",
                )
            taken_s, _ = self._observer.observe(f"at {leg.name}")
            now = self._robot.read()
            same = np.abs(now.q - before.q).max() <= REST_STEP
            still = still + 1 if same and taken_s >= arrived_s + HELD_BACK_S else 0
            before = now

    def _look(self, leg: Leg, cycle: int) -> Visit:
        poses: list[TargetPose] = []
        lost = 0
        while len(poses) < self._frames:
            self._check_going(f"while {leg.name} was looked at")
            _, pose = self._observer.observe(f"at {leg.name}")
            if pose.status is PoseStatus.OK:
                poses.append(pose)
                lost = 0
                continue
            lost += 1
            if lost >= MOST_LOST:
                raise NotEnoughData(
                    f"the target is not seen whole at {leg.name}" + (f": {pose.why}" if pose.why else ""),
                    consequence="The run ends there",
                    cure="Free the view of it, or choose a smaller cube",
                )
        return Visit(name=leg.name, cycle=cycle, poses=tuple(poses), q=self._robot.read().q)

    def _check_going(self, when: str) -> None:
        if self._progress.cancelled():
            raise Cancelled(f"stopped {when}", consequence="The robot is held")
        state = self._robot.state
        if state not in (RobotState.READY, RobotState.MOVING):
            kind = DeviceLost if state is RobotState.LOST else DeviceFailed
            raise kind(
                f"{self._robot.name} is {state} {when}",
                consequence="The run ends there",
                cure="Look at the robot and its controller, then begin anew",
            )


def _does_not_go(name: str, limited: Sequence[str]) -> DeviceFailed:
    said = f": {', '.join(limited)}" if limited else ""
    return DeviceFailed(
        f"the arm does not go on towards {name}{said}",
        consequence="The run ends there",
        cure="Choose a smaller cube, or wider limits",
    )
