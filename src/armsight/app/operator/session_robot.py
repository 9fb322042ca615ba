"""The robot that an operator drives, as the Robot that a job such as a sweep or a path moves."""

from __future__ import annotations

from collections.abc import Callable
from types import TracebackType
from typing import Any, Self

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.control.session.authority import EnableLost
from armsight.control.session.operator_session import OperatorSession
from armsight.defaults import STALE_CYCLES
from armsight.drivers import RobotState, Sent
from armsight.errors import ArmsightError, DeviceFailed, StaleData, UsageError
from armsight.records import JointReading
from armsight.store.arm_file import arm_mapping

STALE_S = 0.1

LED_AWAY = 0.06
"""A robot further (rad or m) from where it was told to go was led elsewhere meanwhile; held on a sweep at 10 degrees a
second it rests up to 0.04 short of it."""

SHORT = 1e-6
"""Of where it was told to go (rad, m), by which a robot at rest is short of it."""

NOT_HELD = "the enable is not held"


class SessionRobot:
    """A robot that moves only while the browser whose job this is holds the enable.

    waits: a step asked for without enable waits for it, until cancelled() says to give up; else it leads nowhere, as
    its Sent tells. Closing it holds the robot and leaves the loop running.
    """

    takes_joints = True
    guarded = True

    def __init__(
        self,
        session: OperatorSession,
        browser: Callable[[], str],
        clock: Clock,
        *,
        waits: bool,
        cancelled: Callable[[], bool],
    ) -> None:
        """browser: the one whose job it is, asked at each step."""
        description = session.service.authority.robot
        self.name, self.n_joints, self.cycle_s = description.name, description.n_joints, description.cycle_s
        self.takes_poses = False
        self._session, self._browser, self._clock = session, browser, clock
        self._waits, self._cancelled = waits, cancelled
        self._open = False
        self._number = 0
        self._goal: Array | None = None
        self._halted = False
        self._pushes = session.pushes
        self._dropped = session.status().dropped

    @property
    def state(self) -> RobotState:
        """What the robot can do just now; one whose enable is not held is not stopped."""
        if not self._open:
            return RobotState.CLOSED
        try:
            return self._session.status().robot
        except ArmsightError:
            return RobotState.LOST

    def __enter__(self) -> Self:
        self._open = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()
        self._open = False

    def arm_mapping(self) -> dict[str, Any]:
        """Return the arm that the loop's guard keeps. Raises UsageError where its lengths are not known."""
        arm = self._session.arm
        if arm is None:
            raise UsageError("the arm's lengths are not known", cure="Give the arm's file on the page Settings")
        return arm_mapping(arm)

    def read(self) -> JointReading:
        """Return the newest reading; a job that waits first goes where it was told to, if the loop was kept from it.

        Raises DeviceFailed where closed, DeviceLost, StaleData.
        """
        self._check_open("be read")
        if self._waits and self._forgotten():
            self._step(np.zeros(self.n_joints))
        now = self._session.status()
        limit_s = max(STALE_S, STALE_CYCLES * self.cycle_s)
        if now.reading is None or self._clock.now_s() - now.reading.t_s > limit_s:
            raise StaleData(f"{self.name}: no fresh reading", consequence="Where the arm is now is not known")
        return now.reading

    def step_joints(self, step: Array) -> Sent:
        """Move on by step (n,) in rad or m as far as enable and limits allow; return where that leads."""
        self._check_open("move")
        values = np.asarray(step, dtype=float)
        if values.shape != (self.n_joints,):
            raise UsageError(f"{self.name} has {self.n_joints} joints, the step {values.size}", cure="Give them all")
        if not values.any():
            return self._sent(self._last_goal(), ())
        return self._step(values)

    def _step(self, values: Array) -> Sent:
        while self._await_enable():
            try:
                with self._session.lock:
                    asked, dropped = values, self._session.status().dropped
                    if self._halted or dropped != self._dropped:
                        # it comes to rest, or has, a little short of where it was told to go
                        goal = self._last_goal()
                        asked = values if self._goal is None else values + goal - self._session.status().q_sent
                    self._goal, limited = self._session.step(self._browser(), asked)
            except EnableLost:  # since it was looked for
                self._halted = True
                self._session.hold(self._browser())
                if not self._waits or self._cancelled():
                    break
                self._clock.sleep_until(self._clock.now_s() + self.cycle_s)
                continue
            self._halted, self._dropped = False, dropped
            return self._sent(self._goal, limited)
        return self._sent(self._last_goal(), (NOT_HELD,))

    def _forgotten(self) -> bool:
        """Return whether the loop held since the last step and so stands short of where it was told to go."""
        now = self._session.status()
        short = self._goal is not None and np.abs(self._goal - now.q_sent).max() > SHORT
        return short and (self._halted or now.dropped != self._dropped)

    def _await_enable(self) -> bool:
        """Return whether the enable is held, waiting for it where that is wanted. Raises DeviceFailed once stopped."""
        while not self._session.enabled(self._browser()):
            if not self._waits or self._cancelled():
                self._halted = True
                return False
            self._check_link()
            self._clock.sleep_until(self._clock.now_s() + self.cycle_s)
        return True

    def _last_goal(self) -> Array:
        """Return where the robot was last told to go (n,); where it stands, if it was led elsewhere since."""
        q_sent = self._session.status().q_sent
        led = self._session.pushes != self._pushes
        self._pushes = self._session.pushes
        if self._goal is None or led or np.abs(self._goal - q_sent).max() > LED_AWAY:
            self._goal = None
            return q_sent
        return self._goal

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """Refuse: a job in an operator's session sends joints. Raises UsageError."""
        raise UsageError(f"{self.name} takes joint steps here", consequence="Nothing was sent")

    def stop(self) -> None:
        """Let the robot come to rest; legal always. It is not stopped until a reset: that is the person's button."""
        self._session.hold(self._browser())

    def reset(self) -> None:
        """Refuse to go on after a stop: only a person resets it, on the page. Raises DeviceFailed."""
        raise DeviceFailed(f"{self.name} is stopped", consequence="It stays so", cure="Reset it on the page")

    def _check_open(self, what: str) -> None:
        if not self._open:
            raise DeviceFailed(f"{self.name} is not open", consequence=f"It cannot {what}", cure="Open it first")

    def _check_link(self) -> None:
        state = self.state
        if state in (RobotState.STOPPED, RobotState.LOST):
            raise DeviceFailed(f"{self.name} is {state}", consequence="The work ends", cure="Reset it, and begin anew")

    def _sent(self, q: Array, limited: tuple[str, ...]) -> Sent:
        self._number += 1
        return Sent(q=q, t_s=self._clock.now_s(), sequence=self._number - 1, limited=limited)
