"""A robot of Universal Robots, driven by servoj through ur-rtde's control program."""

from __future__ import annotations

import contextlib
import math
import threading
from collections.abc import Mapping
from typing import Annotated, Any, ClassVar

import numpy as np
from pydantic import Field

from armsight._files import DeviceLock
from armsight.clock import Clock, SystemClock
from armsight.defaults import RTDE_CYCLE_S, RTDE_OPEN_S, STALE_S
from armsight.drivers.cyclic import CyclicRobot
from armsight.drivers.goals import GivenGoals
from armsight.drivers.link_settings import LinkSettings, Positive
from armsight.drivers.pace import LARGEST_RAD, LinkTimes
from armsight.drivers.rtde.link import ControllerState, Worker, address, unreachable
from armsight.drivers.rtde.worker import PLAYING
from armsight.errors import DeviceFailed, DeviceLost, DeviceNotFound, Inconsistent
from armsight.priority import control_first

JOINTS = 6

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


class RtdeSettings(LinkSettings):
    """Settings of an RTDE link.

    cycle_s: 0.002 with an e-Series, 0.008 with a CB3. lookahead_s, gain: of servoj: how smoothly and how tightly the
    arm follows. stale_s: age of a reading that is stale; at 2 ms an ordinary system that is busy is later than three
    cycles now and then. silent_s: silence after which the link is lost: one period of watchdog_hz. watchdog_hz: the
    controller ends its program where it hears less often from here. open_s: how long opening may take.
    max_speed_rad_s, lower_rad, upper_rad: of each joint.
    """

    link: ClassVar[str] = "the RTDE link"

    cycle_s: Annotated[float, Field(ge=0.002, le=0.1)] = RTDE_CYCLE_S
    lookahead_s: Annotated[float, Field(ge=0.03, le=0.2)] = 0.05
    gain: Annotated[float, Field(ge=100.0, le=2000.0)] = 500.0
    watchdog_hz: Annotated[float, Field(ge=1.0, le=125.0)] = 10.0
    stale_s: Positive = STALE_S
    silent_s: Positive = 0.1
    open_s: Positive = RTDE_OPEN_S
    max_speed_rad_s: Annotated[float, Field(gt=0.0, le=math.pi)] = math.pi / 3
    lower_rad: Annotated[list[float], Field(min_length=JOINTS, max_length=JOINTS)] = [-math.tau] * JOINTS
    upper_rad: Annotated[list[float], Field(min_length=JOINTS, max_length=JOINTS)] = [math.tau] * JOINTS


class RtdeRobot(CyclicRobot):
    """An arm whose controller runs ur-rtde's control program and takes one servoj each cycle.

    device: HOST or HOST:PORT. settings: see RtdeSettings. Raises UsageError for a device or a setting that cannot be.
    """

    def __init__(self, device: str, *, settings: Mapping[str, Any] | None = None, clock: Clock | None = None) -> None:
        self.settings = RtdeSettings.checked(settings)
        self.host, self.port = address(device)
        limits = self.settings.joint_limits(JOINTS)
        cycle_s = self.settings.cycle_s
        times = LinkTimes(cycle_s=cycle_s, stale_s=self.settings.stale_s, silent_s=self.settings.silent_s)
        super().__init__(f"rtde:{device}", limits=limits, times=times, clock=clock or SystemClock())
        self.missed = self.late = 0
        self._given = GivenGoals()
        self._stamp_s = -math.inf
        self._closing = False
        self._first = threading.Event()

    def _start(self) -> None:
        settings = self.settings
        with contextlib.ExitStack() as undo:
            # one program at a time: of two the controller would take the goals in turn
            lock = DeviceLock(
                self.name,
                key=f"rtde-{self.host}-{self.port}",
                consequence="The robot is not opened: one program at a time may drive it",
                cure="Stop the other program",
            )
            undo.enter_context(lock)
            numbers = (self.cycle_s, settings.lookahead_s, settings.gain, settings.watchdog_hz)
            self._worker = Worker(self.host, self.port, numbers)
            undo.callback(lambda: self._worker.close(at_once=bool(self._lost) or self._reading is None))
            self._hear_first(self._first_state())
            self.missed, self.late, self._closing = 0, 0, False
            self._given.start()
            self._first.clear()
            self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
            self._thread.start()
            undo.callback(self._end_thread)
            measured = self._first.wait(settings.open_s)
            if not measured or self._controller_clock.wrong:
                self._lost = self._lost or "its cycle is not what is set"  # it is ended at once
                raise self._not_timed()
            self._undo = undo.pop_all()

    def _not_timed(self) -> DeviceFailed:
        clock = self._controller_clock
        return DeviceFailed(
            f"{self.name}: {clock.wrong or self._lost}",
            cure=clock.cure if clock.wrong else "Look at the controller, and open it again",
        )

    def _first_state(self) -> ControllerState:
        """Wait for the controller's program to run. Raises DeviceFailed."""
        why = f"no controller has answered at {self.host}:{self.port} within {self.settings.open_s:g} s"
        try:
            state = self._worker.receive(self.settings.open_s)
        except DeviceLost as error:
            state, why = None, error.cause
        if state is not None:
            self._stamp_s = state.stamp_s
            return state
        if refused := unreachable(self.host, self.port):
            why = f"nothing takes a connection at {self.host}:{self.port} ({refused})"
        raise DeviceNotFound(
            f"{self.name} cannot be driven: {why}",
            cure="Check address and cable, that remote control is on, the brakes are released, no other client drives "
            "the controller, and no fieldbus uses its registers",
        )

    def _hear_first(self, state: ControllerState) -> None:
        """Take the first reading. Raises DeviceFailed where the controller takes no motion."""
        try:
            self._hear(state)
        except (DeviceLost, Inconsistent) as error:
            raise DeviceFailed(
                f"{self.name}: {error.cause}", cure="Clear it on the controller, and open it again"
            ) from error

    def _finish(self) -> None:
        self._undo.close()

    def _end_thread(self) -> None:
        self._closing = True
        self._thread.join()

    def _run(self) -> None:
        control_first()
        while not self._closing and not self._lost:
            try:
                state = self._worker.receive(self.cycle_s)
                self._stood_still()  # the program on the controller, kept going by ur-rtde's process, has held the goal
                if state is not None:
                    self._take(state)
                elif self._fallen_silent():
                    raise DeviceLost("its controller has fallen silent")
            except (DeviceLost, Inconsistent) as error:
                self._lose(error.cause)
        if self._lost:
            self._worker.cut()

    def _take(self, state: ControllerState) -> None:
        if state.stamp_s < self._stamp_s:
            raise DeviceLost("its controller has started anew")
        cycles = max(1, round((state.stamp_s - self._stamp_s) / self.cycle_s))
        self.missed += cycles - 1
        self._stamp_s = state.stamp_s
        self._hear(state)
        self._hear_clock(state.stamp_s, 0)
        taken = self._given.taken(np.array(state.q_planned))
        self.late += not taken
        self._tick(cycles, taken=taken)
        # noted before it is sent, so that the state that answers it finds it
        self._given.give(self._goals.sent)
        if not self._lost and not self._outlived():
            self._worker.send(self._goals.sent.tolist())
        if self._measured():
            self._first.set()

    def _hear(self, state: ControllerState) -> None:
        q = np.array(state.q)
        if not (np.abs(q) < LARGEST_RAD).all():
            raise Inconsistent("its controller tells joint values that no joint can have")
        stops = [text for bit, text in SAFETY_STOPS.items() if state.safety >> bit & 1]
        if stops:
            raise DeviceLost(f"its controller tells {' and '.join(stops)}")
        if state.runtime != PLAYING:
            raise DeviceLost("the control program on its controller has ended")
        self._heard(q, self._clock.now_s())
