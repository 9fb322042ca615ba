"""A driver of bus servos beside its twin, by a clock that moves only when told, and without a line between them."""

from __future__ import annotations

import threading
from collections.abc import Callable
from typing import Any

import numpy as np

from armsight.drivers import RobotState
from armsight.drivers.servo_bus import DynamixelRobot, FeetechRobot
from armsight_sim.twins.base import small_arm, twin_home
from armsight_sim.twins.servo_bus import ServoBus
from armsight_sim.twins.servo_twins import DynamixelBus, FeetechBus, bus_drive

KINDS: dict[str, tuple[type[ServoBus], Any]] = {
    "feetech": (FeetechBus, FeetechRobot),
    "dynamixel": (DynamixelBus, DynamixelRobot),
}


class OwnClock:
    """Time passes when the test says so; the driver's thread then does all that it would do until then."""

    def __init__(self, t_s: float) -> None:
        self._t_s, self._wanted_s, self._free = t_s, None, False
        self._news = threading.Condition()
        self.runs: Callable[[], bool] = lambda: False

    def now_s(self) -> float:
        return self._t_s

    def sleep_until(self, t_s: float) -> None:
        with self._news:
            if t_s <= self._t_s:
                return
            self._wanted_s = t_s
            self._news.notify_all()
            self._news.wait_for(lambda: self._t_s >= t_s or self._free)
            self._wanted_s = None

    def advance(self, dt_s: float) -> None:
        end_s = self._t_s + dt_s
        while True:
            with self._news:
                while self.runs() and self._wanted_s is None:
                    self._news.wait(0.001)
                if not self.runs() or self._wanted_s > end_s:
                    self._t_s = end_s
                    return
                self._t_s, self._wanted_s = max(self._t_s, self._wanted_s), None
                self._news.notify_all()

    def pass_over(self, dt_s: float) -> None:
        """Let time pass while the driver's thread stands still, as one that the system has stopped."""
        with self._news:
            while self.runs() and self._wanted_s is None:
                self._news.wait(0.001)
            self._t_s += dt_s
        self.advance(0.0)

    def let_go(self, *, free: bool) -> None:
        with self._news:
            self._free = free
            self._news.notify_all()


class InMemory:
    """Stands for a serial port: what is written is with the servos at once."""

    def __init__(self, bus: ServoBus) -> None:
        self.bus, self.inbox, self.baudrate, self.timeout = bus, b"", 1_000_000, 0.0
        bus._send = self._come  # type: ignore[method-assign]
        bus._speed = lambda: self.baudrate  # type: ignore[method-assign]

    def _come(self, data: bytes) -> None:
        self.inbox += data

    @property
    def in_waiting(self) -> int:
        return len(self.inbox)

    def reset_input_buffer(self) -> None:
        self.inbox = b""

    def write(self, data: bytes) -> int:
        self.bus.feed(data)
        return len(data)

    def read(self, n: int) -> bytes:
        piece, self.inbox = self.inbox[:n], self.inbox[n:]
        return piece

    def close(self) -> None: ...


class ServoPair:
    """A driver and its twin."""

    def __init__(self, kind: str, *, sag: float = 0.0, weighed: bool = False, **more: Any) -> None:
        bus, robot = KINDS[kind]
        self.kind, self.clock = kind, OwnClock(100.0)
        self.arm, self.home = small_arm(), twin_home(small_arm())
        drive = bus_drive(self.arm)
        self.twin = bus(arm=self.arm, drive=drive, home=self.home, clock=self.clock, sag=sag, weighed=weighed)
        self.robot = robot("line", settings=more, clock=self.clock)
        self.port = InMemory(self.twin)
        self.robot._open_port = lambda: self.port
        self.clock.runs = lambda: self.robot.state is not RobotState.CLOSED and self.robot._thread.is_alive()
        finish = self.robot._finish

        def finish_at_once() -> None:
            self.robot._closing = True
            self.clock.let_go(free=True)
            finish()
            self.clock.let_go(free=False)

        self.robot._finish = finish_at_once
        self.cycle_s = self.robot.cycle_s

    def advance(self, time_s: float) -> None:
        self.clock.advance(time_s)

    def enable(self) -> None:
        """Let torque be switched on."""
        for _ in range(100):
            if not self.robot.step_joints(np.full(6, 1e-12)).limited:
                return
            self.advance(self.cycle_s)
        raise AssertionError("it is never enabled")

    def close(self) -> None:
        self.robot.__exit__(None, None, None)
        self.twin.close()
