"""A robot of Universal Robots, driven by servoj through ur-rtde's control program."""

from __future__ import annotations

import contextlib
import math
import threading
import time
from collections.abc import Mapping
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from armsight.clock import Clock, SystemClock
from armsight.drivers.cyclic import CyclicRobot, LinkTimes
from armsight.drivers.joint_goals import JointLimits
from armsight.drivers.lock import DeviceLock
from armsight.drivers.rtde.link import Connections, address
from armsight.errors import DeviceFailed, DeviceNotFound, Inconsistent, UsageError

Array = NDArray[np.float64]

JOINTS = 6

PLAYING = 2
"""runtime_state of a controller whose program runs."""

SAFETY_STOPS = {
    2: "a protective stop",
    3: "recovery mode",
    4: "a safeguard stop",
    5: "a system emergency stop",
    6: "an emergency stop at the robot",
    7: "an emergency stop",
    8: "a safety violation",
    9: "a safety fault",
}
"""Bits of safety_status_bits that end motion."""

LARGEST_RAD = 100.0
"""No joint of a robot turns 16 times: a larger value is not a reading."""

STOP_RAD_S2 = 10.0
"""Deceleration of the arm when the link is closed, in m/s^2 of its tool as servoStop has it."""

STALE_S = 0.02
"""Age of a reading that is stale: at 2 ms an ordinary system that is busy comes later than three cycles now and then."""

POLL_S = 1e-4
"""How often a new state is looked for once it is due."""

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]


class RtdeSettings(BaseModel):
    """Settings of an RTDE link.

    cycle_s: 0.002 with an e-Series, 0.008 with a CB3. lookahead_s, gain: of servoj: how smoothly and how tightly the
    arm follows. silent_s: silence after which the link is lost. watchdog_hz: the controller ends its program where it hears less often from here. open_s: how long each
    step of opening may take. max_speed_rad_s, lower_rad, upper_rad: of each joint.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    cycle_s: Annotated[float, Field(ge=0.002, le=0.1)] = 0.002
    lookahead_s: Annotated[float, Field(ge=0.03, le=0.2)] = 0.05
    gain: Annotated[float, Field(ge=100.0, le=2000.0)] = 500.0
    watchdog_hz: Annotated[float, Field(ge=1.0, le=125.0)] = 20.0
    silent_s: Positive = 0.1
    open_s: Positive = 3.0
    max_speed_rad_s: Annotated[float, Field(gt=0.0, le=math.pi)] = math.pi / 3
    lower_rad: Annotated[list[float], Field(min_length=JOINTS, max_length=JOINTS)] = [-math.tau] * JOINTS
    upper_rad: Annotated[list[float], Field(min_length=JOINTS, max_length=JOINTS)] = [math.tau] * JOINTS


class RtdeRobot(CyclicRobot):
    """An arm whose controller runs ur-rtde's control program and takes one servoj each cycle.

    device: HOST or HOST:PORT. settings: see RtdeSettings. Raises UsageError for a device or a setting that cannot be.
    """

    def __init__(self, device: str, *, settings: Mapping[str, Any] | None = None, clock: Clock | None = None) -> None:
        try:
            self.settings = RtdeSettings.model_validate(dict(settings or {}))
        except ValidationError as error:
            first = error.errors()[0]
            raise UsageError(
                f"the setting {'.'.join(map(str, first['loc']))!r} of the RTDE link cannot be: {first['msg']}",
                consequence="The robot is not opened",
                cure=f"Known are: {', '.join(RtdeSettings.model_fields)}",
            ) from error
        self.host, self.port = address(device)
        limits = JointLimits(
            lower=np.array(self.settings.lower_rad),
            upper=np.array(self.settings.upper_rad),
            max_speed=np.full(JOINTS, self.settings.max_speed_rad_s),
        )
        cycle_s = self.settings.cycle_s
        stale_s, silent_s = max(STALE_S, 3.5 * cycle_s), max(self.settings.silent_s, 9.0 * cycle_s)
        times = LinkTimes(cycle_s=cycle_s, stale_s=stale_s, silent_s=silent_s)
        super().__init__(f"rtde:{device}", limits=limits, times=times, clock=clock or SystemClock())
        self.missed = 0
        self._stamp_s = -math.inf
        self._closing = False

    def _start(self) -> None:
        lock = contextlib.ExitStack()
        lock.enter_context(DeviceLock(f"rtde-{self.host}-{self.port}"))
        try:
            self._ends = Connections(self.host, self.port, 1.0 / self.cycle_s, self.settings.open_s)
        except BaseException:
            lock.close()
            raise
        self._lock_file = lock
        self.missed, self._stamp_s, self._closing = 0, -math.inf, False
        self._first = threading.Event()
        try:
            self._ends.controller.setWatchdog(self.settings.watchdog_hz)
        except Exception as error:
            self._close()
            raise DeviceFailed(
                f"{self.name}: the controller's watchdog cannot be set: {error}", consequence="The robot is not opened"
            ) from error
        self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()
        if not self._first.wait(self.settings.open_s):
            self._finish()
            raise DeviceNotFound(f"{self.name}: the controller sends no state", consequence="The robot is not opened")

    def _finish(self) -> None:
        self._closing = True
        self._thread.join()
        if not self._lost:
            with contextlib.suppress(Exception):
                self._ends.controller.servoStop(STOP_RAD_S2)
                self._ends.controller.stopScript()
        self._close()

    def _close(self) -> None:
        self._ends.close()
        self._lock_file.close()

    def _run(self) -> None:
        while not self._closing and not self._lost:
            try:
                self._cycle()
            except Inconsistent as error:
                self._lose(error.cause)
            except Exception as error:
                self._lose(f"ur-rtde failed: {error}")

    def _cycle(self) -> None:
        """Wait for the next state and answer it with the goal of that moment."""
        receiver = self._ends.receiver
        stamp_s = receiver.getTimestamp()
        if stamp_s == self._stamp_s:
            if self._silent() or not receiver.isConnected():
                self._lose("its controller has fallen silent")
            time.sleep(POLL_S)
            return
        if stamp_s < self._stamp_s:
            raise Inconsistent("its controller has started anew")
        if math.isfinite(self._stamp_s):
            self.missed += max(0, round((stamp_s - self._stamp_s) / self.cycle_s) - 1)
        self._stamp_s = stamp_s
        q = np.array(receiver.getActualQ(), dtype=float)
        if q.shape != (JOINTS,) or not (np.abs(q) < LARGEST_RAD).all():
            raise Inconsistent("its controller tells joint values that no joint can have")
        self._heard(q, self._clock.now_s())
        self._first.set()
        self._check_program(receiver)
        self._servo()
        time.sleep(0.5 * self.cycle_s)

    def _check_program(self, receiver: Any) -> None:
        """Raise Inconsistent where the controller takes no motion any more."""
        bits = int(receiver.getSafetyStatusBits())
        stops = [text for bit, text in SAFETY_STOPS.items() if bits >> bit & 1]
        if stops:
            raise Inconsistent(f"its controller tells {' and '.join(stops)}")
        if int(receiver.getRuntimeState()) != PLAYING:
            raise Inconsistent("the control program on its controller has ended")

    def _servo(self) -> None:
        goal = self._goals.take().tolist()
        settings = self.settings
        # speed and acceleration are not used by servoj
        taken = self._ends.controller.servoJ(goal, 0.5, 0.5, self.cycle_s, settings.lookahead_s, settings.gain)
        if not taken:
            raise Inconsistent("its controller took no goal")
