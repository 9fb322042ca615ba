"""Drivers and emulated controllers joined without sockets, threads and time of their own, and a wire that loses."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armsight.clock import ManualClock
from armsight.drivers.alter import AlterRobot
from armsight.drivers.alter.frames import FrameSplitter
from armsight.drivers.egm import EgmRobot
from armsight.drivers.rsi import RsiRobot
from armsight.drivers.rtde import RtdeRobot
from armsight.drivers.rtde.link import ControllerState
from armsight.drivers.rtde.worker import GOAL, STATE
from armsight.testing import WrongCase
from armsight_sim.arms import Drive
from armsight_sim.twins.alter import AlterController
from armsight_sim.twins.base import LAG_S, RIGHT, Wrong, small_arm, twin_drive, twin_home
from armsight_sim.twins.egm import EgmController
from armsight_sim.twins.rsi import RsiController
from armsight_sim.twins.ur_controller import UrController

Array = NDArray[np.float64]
SMALL = small_arm()
HOME = twin_home(SMALL)
OPENING = 80
"""Cycles after which a driver that is not open will never be."""


@dataclass(slots=True)
class Wire:
    """One way of a link, in cycles: what is sent now is there later, with others, or never; in_order: as TCP."""

    rng: np.random.Generator
    loss: float
    late: float
    in_order: bool = False
    under_way: list[tuple[int, bytes]] = field(default_factory=list)
    held_until: int = 0
    lost: int = 0

    def send(self, data: bytes, cycle: int) -> None:
        if self.rng.random() < self.loss:
            self.lost += 1
            return
        due = cycle + (int(self.rng.integers(1, 4)) if self.rng.random() < self.late else 0)
        if self.rng.random() < 0.2 * self.late:  # everything stands still for a while, and comes at once
            self.held_until = cycle + int(self.rng.integers(2, 9))
        due = max(due, self.held_until)
        if self.in_order and self.under_way:
            due = max(due, self.under_way[-1][0])
        self.under_way.append((due, data))

    def due(self, cycle: int) -> list[bytes]:
        here = [data for when, data in self.under_way if when <= cycle]
        self.under_way = [(when, data) for when, data in self.under_way if when > cycle]
        return here


class Socket:
    """Stands for a socket or a serial line: what is written is kept."""

    def __init__(self) -> None:
        self.out: list[bytes] = []

    def sendto(self, data: bytes, there: Any) -> int:
        self.out.append(data)
        return len(data)

    def write(self, data: bytes) -> int:
        self.out.append(data)
        return len(data)

    def drained(self) -> list[bytes]:
        out, self.out = self.out, []
        return out

    def close(self) -> None: ...

    def settimeout(self, time_s: float) -> None: ...


class TwinSocket(Socket):
    """The emulated controller's end: what has come is read from it."""

    def __init__(self, driver: tuple[str, int]) -> None:
        super().__init__()
        self.inbox: list[bytes] = []
        self._driver = driver

    def recvfrom(self, size: int) -> tuple[bytes, tuple[str, int]]:
        return self.recv(size), self._driver

    def recv(self, size: int) -> bytes:
        if not self.inbox:
            raise BlockingIOError
        return self.inbox.pop(0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class World:
    """What a controller is like: what is wrong with it, its cycle as a multiple of what is set, drives and readings."""

    wrong: Wrong = RIGHT
    cycles: float = 1.0
    lag_s: float = LAG_S
    noise: float = 0.0
    home: Array = field(default_factory=lambda: HOME)

    def drive(self, cycle_s: float) -> tuple[float, Drive]:
        """Return the controller's cycle in s, and its motors."""
        own_s = cycle_s * self.cycles
        return own_s, twin_drive(small_arm(), own_s, lag_s=self.lag_s, noise=self.noise)


class Model:
    """The emulated controller's arm, as the driver of a serial link takes it."""

    def fk(self, q: Array) -> Any:
        return SMALL.flange(q)

    def ik(self, T_base_flange: Any, near: Array) -> Array:
        return SMALL.reach(T_base_flange.as_matrix(), near)

    def flange(self, q: Array) -> Array:
        return SMALL.frames(q)[-1]

    def jacobian(self, q: Array) -> Array:
        return SMALL.jacobian(SMALL.frames(q))

    @property
    def ranges(self) -> Array:
        return np.array([[getattr(joint, end) for joint in SMALL.joints] for end in ("lower", "upper")])


class Link:
    """What all have in common: until the driver is open, cycle by cycle on its own."""

    cycle_s: float
    robot: Any
    twin: Any
    clock: ManualClock

    twin_cycle_s: float

    def cycle(self) -> None:
        """Let one of the controller's cycles pass, with a line that loses nothing."""
        self.clock.advance(self.twin_cycle_s)
        self.twin.cycle()
        for data in self.hear(self.spoken(), together=True, between=lambda: None):
            self.answer(data)

    def wrong_case(self) -> WrongCase:
        """Return it as the contract takes a wrong controller."""

        def advance(time_s: float) -> None:
            for _ in range(max(1, round(time_s / self.twin_cycle_s))):
                self.cycle()

        return WrongCase(robot=self.robot, advance=advance, joints=lambda: self.twin.q)

    def open_up(self) -> None:
        """Let cycles pass until the driver has heard enough; what it says against being opened then counts."""
        for _ in range(OPENING):
            self.cycle()
            if self.robot._first.is_set():
                return
        self.robot._first.set()

    def spoken(self) -> list[bytes]:
        """Return what the controller has sent."""
        raise NotImplementedError

    def answer(self, data: bytes) -> None:
        """Bring an answer to the controller."""
        raise NotImplementedError

    def hear(self, packets: list[bytes], *, together: bool, between: Callable[[], None]) -> list[bytes]:
        """Bring packets to the driver, at once or one by one; return its answers."""
        raise NotImplementedError

    def close(self) -> None:
        """Close what the operating system keeps."""


class UdpLink(Link):
    """EGM or RSI without sockets and threads."""

    def __init__(self, kind: str, clock: ManualClock, world: World, **settings: object) -> None:
        there = ("127.0.0.1", 49000)
        self.clock, self.cycle_s = clock, 0.004
        self.twin_cycle_s, drive = world.drive(self.cycle_s)
        if kind == "egm":
            self.twin = EgmController(there, arm=small_arm(), drive=drive, home=world.home, clock=clock)
            self.robot = EgmRobot("49000", settings={"arm": Model(), **settings}, clock=clock)
        else:
            self.twin = RsiController(there, arm=small_arm(), drive=drive, home=world.home)
            self.robot = RsiRobot("49000", settings={"arm": Model(), **settings}, clock=clock)
        self.twin.wrong = world.wrong
        self.twin.close()
        self.far = self.twin._socket = TwinSocket(there)
        self.near = Socket()
        self.robot._bind = lambda: self.near
        self.robot._run = self.open_up

    def spoken(self) -> list[bytes]:
        return self.far.drained()

    def answer(self, data: bytes) -> None:
        self.far.inbox.append(data)

    def hear(self, packets: list[bytes], *, together: bool, between: Callable[[], None]) -> list[bytes]:
        for i, data in enumerate(packets):
            self.robot._take(data, ("127.0.0.1", 50000), newest=not together or i == len(packets) - 1)
            if not together:
                between()
        return self.near.drained()


class AlterLink(Link):
    """A serial line without threads: its own end is read where the driver's thread would."""

    def __init__(self, clock: ManualClock, world: World, *, geometry: bool = True, **settings: Any) -> None:
        self.clock, self.cycle_s = clock, 0.028
        self.twin_cycle_s, drive = world.drive(self.cycle_s)
        self.twin = AlterController(
            arm=small_arm(), drive=drive, home=world.home, cumulative=settings.get("cumulative", True)
        )
        self.twin.wrong = world.wrong
        os.set_blocking(self.twin._slave, False)
        model = {"arm": Model()} if geometry else {}
        self.robot = AlterRobot("line", settings={**model, **settings}, clock=clock)
        self.near = Socket()
        self.robot._open_line = lambda: self.near
        self.robot._run = self.open_up
        self._frames: list[Any] = []
        self._splitter = FrameSplitter()

    def close(self) -> None:
        self.twin.close()

    def spoken(self) -> list[bytes]:
        try:
            data = os.read(self.twin._slave, 4096)
        except BlockingIOError:
            return []
        return [data[i : i + 48] for i in range(0, len(data), 48)]

    def answer(self, data: bytes) -> None:
        os.write(self.twin._slave, data)

    def hear(self, packets: list[bytes], *, together: bool, between: Callable[[], None]) -> list[bytes]:
        states = [state for data in packets for state in self._splitter.feed(data)]
        for i, state in enumerate(states):
            self.robot._take(state, newest=not together or i == len(states) - 1)
            if not together:
                between()
        return self.near.drained()


PROGRAM = """def follow():
  while True:
    if read_input_integer_register(0) == 1:
      q = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0]
      i = 0
      while i < 6:
        q[i] = read_input_float_register(i)
        i = i + 1
      end
      servoj(q, 0, 0, 0.002, 0.05, 500)
    else:
      sync()
    end
  end
end
"""


class RtdeLink(Link):
    """RTDE without ur-rtde, its process and sockets: the newest goal that has come is the one of a servoj."""

    def __init__(self, clock: ManualClock, world: World, **settings: object) -> None:
        self.clock, self.cycle_s = clock, 0.002
        self.twin_cycle_s, drive = world.drive(self.cycle_s)
        self.twin = UrController(arm=small_arm(), drive=drive, home=world.home)
        self.twin.play(PROGRAM.replace("0.002", repr(self.twin_cycle_s)))
        self.twin.wrong = world.wrong
        self.robot = RtdeRobot("127.0.0.1", settings=settings, clock=clock)
        self.robot._start, self.robot._finish = self._begin, lambda: None
        self.near = self.robot._worker = self
        self._out: list[bytes] = []

    def _begin(self) -> None:
        self.twin.cycle()
        state = _state(self.spoken()[0])
        self.robot._stamp_s = state.stamp_s
        self.robot._hear_first(state)
        self.robot._given.start()
        self.open_up()
        if self.robot._controller_clock.wrong:
            raise self.robot._not_timed()

    def send(self, q: list[float]) -> None:
        self._out.append(GOAL.pack(*q))

    def spoken(self) -> list[bytes]:
        names = ("timestamp", "actual_q", "target_q", "runtime_state", "safety_status_bits")
        return [STATE.pack(*(value for name in names for value in self.twin.output(name)))]

    def answer(self, data: bytes) -> None:
        for i, value in enumerate(GOAL.unpack(data)):
            self.twin.write(f"input_double_register_{i}", [value])
        self.twin.write("input_int_register_0", [1])

    def hear(self, packets: list[bytes], *, together: bool, between: Callable[[], None]) -> list[bytes]:
        for data in packets[-1:] if together else packets:
            self.robot._take(_state(data))
            between()
        out, self._out = self._out, []
        return out


def _state(data: bytes) -> ControllerState:
    stamp_s, *q, runtime, safety = STATE.unpack(data)
    return ControllerState(stamp_s=stamp_s, q=tuple(q[:6]), q_planned=tuple(q[6:]), runtime=runtime, safety=safety)


def without_waiting(robot: Any) -> None:
    """Let a driver that is closed wait for no cycles: none passes meanwhile."""
    robot._ticked.wait_for = lambda holds, timeout_s: holds()


def link_of(kind: str, clock: ManualClock, world: World | None = None, **more: Any) -> Any:
    """Return a link of a kind (alter, egm, rsi, rtde) to a controller of a world, a right one where none is given."""
    world = world or World()
    link: Any
    if kind == "alter":
        link = AlterLink(clock, world, **{"speed_m_s": 1.5, "speed_rad_s": 6.0, **more})
    elif kind == "rtde":
        link = RtdeLink(clock, world, **{"silent_s": 1.0, **more})
    else:
        link = UdpLink(kind, clock, world, **{"silent_s": 1.0, **more})
    without_waiting(link.robot)
    return link
