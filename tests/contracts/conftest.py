"""Drivers of controllers that ask for an answer in each cycle, each beside its twin on a real link, by one clock."""

from __future__ import annotations

import select
import socket
import threading
import time
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform
from tests.truth.emulated_links import without_waiting

from armsight.clock import ManualClock
from armsight.drivers import RobotState
from armsight.drivers.alter import AlterRobot
from armsight.drivers.egm import EgmRobot
from armsight.drivers.linuxcnc import LinuxcncRobot
from armsight.drivers.rsi import RsiRobot
from armsight.drivers.udp import UdpRobot
from armsight.testing import WrongController
from armsight.testing.clocks import HaltingClock
from armsight.testing.wrong_controllers import prove
from armsight_sim.twins.alter import AlterController
from armsight_sim.twins.base import RIGHT, Wrong, small_arm, twin_drive, twin_home
from armsight_sim.twins.egm import EgmController
from armsight_sim.twins.rsi import RsiController
from linuxcnc_world import SAMPLES, SERVO_S, LinuxcncController

CYCLE_S = 0.004
EXACT = {"bind": "127.0.0.1", "stale_s": 3.5 * CYCLE_S, "silent_s": 9.0 * CYCLE_S}
"""No time of the machine counts here, so that the limits may be tight."""


WRONG = {
    WrongController.RELATIVE: Wrong(adds=True),
    WrongController.REVERSED: Wrong(reversed=(1,)),
    WrongController.EXCHANGED: Wrong(exchanged=(0, 2)),
    WrongController.SCALE: Wrong(scale=1.1),
    WrongController.RADIANS: Wrong(scale=57.3),
    WrongController.GEAR: Wrong(gear=(2, 2.0)),
}
OF_EVERY_LINK = (
    WrongController.RELATIVE,
    WrongController.HALF_CYCLE,
    WrongController.RADIANS,
    WrongController.EXCHANGED,
)
"""What each link's own units, order of axes and counter of cycles decide."""
SAME_CODE = "what finds it is the same code for all links: tried with RSI"


def until(holds: Callable[[], bool]) -> None:
    """Return when another thread has done its part; fails where it never does."""
    pause = threading.Event()
    for _ in range(15_000):
        if holds():
            return
        pause.wait(0.002)
    raise AssertionError("it never came to be")


def _free_port() -> int:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


BY_HAND_S = 1.2
"""Every controller has ended its session after such a silence, EGM's after 1 s."""


class Pair:
    """A driver and its twin on a real link, one cycle after the other, by a clock that moves only when told."""

    kind: str
    cycle_s = CYCLE_S
    robot: Any
    twin: Any
    brakes_rad = 2e-5
    """So far from where it was sent last an arm comes to rest that is stopped at full speed."""

    def __init__(self, **more: Any) -> None:
        self.clock = ManualClock(100.0)
        self.halting = HaltingClock(self.clock)
        self.arm, self.home = small_arm(), twin_home(small_arm())
        self.join(**more)
        without_waiting(self.robot)
        self._takes, self._newest, self._drained = 0, None, True
        self._take, self.robot._take = self.robot._take, self._counted
        self.lock = threading.Lock()
        self._done = threading.Event()
        self._pump = threading.Thread(target=self._start_up, daemon=True)
        self._pump.start()

    def join(self, **more: Any) -> None:
        """Make robot, not opened, and twin, one at each end of the link."""
        raise NotImplementedError

    def restart(self) -> None:
        """Start the controller anew."""
        self.twin.reboot()

    def prove(self) -> None:
        """Let the link be proven; the arm then stands where it stood."""
        if self.robot.state is RobotState.READY:
            prove(self.robot, self.advance)
        self.advance(self.cycle_s)

    def newest(self) -> Any:
        """Return what the twin sent last, as the driver takes it."""
        return self.twin._last_packet

    def answered(self, heard: int) -> bool:
        """Tell whether the driver gave an answer to the newest packet; heard: good ones before it."""
        raise NotImplementedError

    def _counted(self, data: Any, *args: Any, **more: Any) -> None:
        """Let the driver take what has come, and answer it; only then it counts."""
        self._take(data, *args, **more)
        self._newest = data
        self._takes += 1

    def _start_up(self) -> None:
        """Send while the driver is closed, so that it hears something when it opens."""
        while not self._done.wait(0.001):
            with self.lock:
                if self.robot.state is RobotState.CLOSED:
                    self.clock.advance(self.cycle_s)
                    self.twin.cycle()
                    self._drained = False
                    if not getattr(self.robot, "_closing", True):  # it opens, and answers
                        select.select([self.twin.link], [], [], 0.02)

    def advance(self, time_s: float) -> None:
        for _ in range(round(time_s / self.cycle_s)):
            with self.lock:
                self.clock.advance(self.cycle_s)
                if self.robot.state is RobotState.CLOSED:
                    self.twin.cycle()
                    continue
                self._drain()
                before, heard = self._takes, self.robot.counts.heard
                self.twin.cycle()
                self._wait(before, heard)

    def stand_still(self, time_s: float) -> None:
        """Let the driver's thread stand while the controller goes on; the arm is moved by hand once it must have ended
        the session."""
        self.halting.halt(self.robot.name)
        for cycle in range(round(time_s / self.cycle_s)):
            self.clock.advance(self.cycle_s)
            self.twin.cycle()
            if cycle * self.cycle_s <= BY_HAND_S < (cycle + 1) * self.cycle_s:
                self.twin.push(np.full(6, 0.02))
        self.halting.go_on()

    def _drain(self) -> None:
        """Let the driver take what was sent while it opened."""
        for _ in range(0 if self._drained else 20_000):
            if self._newest == self.newest():
                break
            time.sleep(0.0001)
        self._drained = True

    def sends(self) -> bool:
        """Tell whether the controller sent a packet in its newest cycle."""
        return "silent" not in self.twin._faults

    def _wait(self, before: int, heard: int) -> None:
        """Wait until the driver has taken what the twin sent, and an answer has come where it gave one."""
        asked = self.sends()
        for _ in range(20_000):
            if not asked and self.robot._turns.turn_s == self.clock.now_s():
                return  # else time that passed while its thread waited would be a stand-still
            if self._takes > before or self.robot.state is RobotState.LOST:
                select.select([self.twin.link], [], [], 0.5 if self.answered(heard) else 0.0)
                return
            time.sleep(0.0001)
        assert not asked, "the driver took nothing"

    def close(self) -> None:
        self._done.set()
        self._pump.join()
        self.robot.__exit__(None, None, None)
        self.twin.close()


class UdpPair(Pair):
    """... on a port."""

    driver: type[UdpRobot[Any]]

    def join(self, **more: Any) -> None:
        port = _free_port()
        self.robot = self.driver(str(port), settings={**EXACT, **more}, clock=self.halting)  # type: ignore[call-arg]
        self.twin = self.controller(port, self.home)

    def controller(self, port: int, home: NDArray[np.float64]) -> Any:
        """Return a controller whose arm stands at home."""
        raise NotImplementedError

    def stand(self, by: float) -> None:
        """Put the controller's arm elsewhere, as no motion does."""
        raise NotImplementedError


class EgmPair(UdpPair):
    kind, driver = "egm", EgmRobot

    def restart(self) -> None:
        self.twin.restart()

    def controller(self, port: int, home: NDArray[np.float64]) -> EgmController:
        drive, own = twin_drive(self.arm, self.cycle_s), "127.0.0.1"
        return EgmController(("127.0.0.1", port), arm=self.arm, drive=drive, home=home, clock=self.clock, own=own)

    def stand(self, by: float) -> None:
        self.twin.push(np.full(6, by))

    def answered(self, heard: int) -> bool:
        return bool(self.robot.counts.heard > heard and not self.robot._lost)


class RsiPair(UdpPair):
    kind, driver = "rsi", RsiRobot

    def controller(self, port: int, home: NDArray[np.float64]) -> RsiController:
        return RsiController(("127.0.0.1", port), arm=self.arm, drive=twin_drive(self.arm, self.cycle_s), home=home)

    def stand(self, by: float) -> None:
        twin = self.twin
        twin._servo = type(twin._servo)(twin._drive, self.home + by, twin._servo.t_s, keep=1000)
        twin._start = self.home + by

    def sends(self) -> bool:
        return bool(self.twin._asked and super().sends())

    def answered(self, heard: int) -> bool:
        return bool(self.robot._answered_ipoc == self.twin._ipoc and not self.robot._lost)


class Model:
    """The arm's geometry as an application gives it; longer: by so much in m its last link is another arm's."""

    def __init__(self, longer: float = 0.0) -> None:
        self.longer = RigidTransform.from_translation([0.0, 0.0, longer])

    def fk(self, q: np.ndarray) -> RigidTransform:
        return small_arm().flange(q) * self.longer

    def ik(self, T_base_flange: RigidTransform, near: np.ndarray) -> np.ndarray:
        return small_arm().reach((T_base_flange * self.longer.inv()).as_matrix(), near)

    def flange(self, q: np.ndarray) -> np.ndarray:
        return self.fk(q).as_matrix()

    def jacobian(self, q: np.ndarray) -> np.ndarray:
        steps = [(self.flange(q + 1e-6 * e) - self.flange(q - 1e-6 * e)) / 2e-6 for e in np.eye(len(q))]
        R = self.flange(q)[:3, :3]
        turns = [step[:3, :3] @ R.T for step in steps]
        return np.array([[*step[:3, 3], W[2, 1], W[0, 2], W[1, 0]] for step, W in zip(steps, turns, strict=True)]).T

    @property
    def ranges(self) -> np.ndarray:
        return np.array([[-np.inf], [np.inf]]).repeat(6, axis=1)


class AlterPair(Pair):
    """... on a pseudo terminal; longer: of Model, None for an application without the arm's geometry."""

    kind, cycle_s = "alter", 0.028

    def join(self, *, cumulative: bool = True, tool: bool = False, longer: float | None = 0.0, **more: Any) -> None:
        drive = twin_drive(self.arm, self.cycle_s)
        self.twin = AlterController(arm=self.arm, drive=drive, home=self.home, cumulative=cumulative, tool=tool)
        model = None if longer is None else Model(longer)
        chosen = {"arm": model, "cumulative": cumulative, "axes": "tool" if tool else "world", **more}
        self.robot = AlterRobot(self.twin.path, settings=chosen, clock=self.halting)

    def newest(self) -> Any:
        return self.twin._number

    def _counted(self, data: Any, *args: Any, **more: Any) -> None:
        super()._counted(data, *args, **more)
        self._newest = data.sequence

    def answered(self, heard: int) -> bool:
        last = self.robot._last
        return bool(self.robot.counts.heard > heard and last is not None and last.on and not self.robot._lost)


class LinuxcncPair(Pair):
    """... with the bridge that is shipped, beside a small LinuxCNC."""

    kind, cycle_s = "linuxcnc", SAMPLES * SERVO_S
    brakes_rad = 0.04

    def join(self, *, wrong: Wrong = RIGHT, **more: Any) -> None:
        self.twin = LinuxcncController(self.home, self.clock, wrong=wrong)
        settings = {"stale_s": 3.5 * self.cycle_s, "silent_s": 9.0 * self.cycle_s, **more}
        self.robot = LinuxcncRobot(f"127.0.0.1:{self.twin.port}", settings=settings, clock=self.halting)

    def sends(self) -> bool:
        return bool(super().sends() and self.twin.bridge._client is not None)

    def _wait(self, before: int, heard: int) -> None:
        if self.sends():
            super()._wait(before, heard)
        else:  # a bridge that has given the driver up says nothing more
            until(lambda: bool(self.robot._lost) or self.robot._turns.turn_s == self.clock.now_s())

    def answered(self, heard: int) -> bool:
        return bool(self.robot.counts.heard > heard and not self.robot._lost)


@pytest.fixture
def opened() -> Iterator[Callable[[type[Pair]], Callable[..., Pair]]]:
    """Return what makes pairs, all of which are closed at the end."""
    pairs: list[Pair] = []

    def of(kind: type[Pair]) -> Callable[..., Pair]:
        def make(**more: object) -> Pair:
            pairs.append(kind(**more))
            return pairs[-1]

        make.of = kind  # type: ignore[attr-defined]
        return make

    yield of
    while pairs:
        pairs.pop().close()


@pytest.fixture
def make_egm(opened: Any) -> Any:
    return opened(EgmPair)


@pytest.fixture
def make_rsi(opened: Any) -> Any:
    return opened(RsiPair)


@pytest.fixture
def make_alter(opened: Any) -> Any:
    return opened(AlterPair)


@pytest.fixture
def make_linuxcnc(opened: Any) -> Any:
    return opened(LinuxcncPair)


@pytest.fixture(params=[EgmPair, RsiPair, AlterPair, LinuxcncPair], ids=["egm", "rsi", "alter", "linuxcnc"])
def make_link(request: Any, opened: Any) -> Any:
    """What makes pairs of every link in turn."""
    return opened(request.param)


@pytest.fixture(params=[EgmPair, RsiPair], ids=["egm", "rsi"])
def make_pair(request: Any, opened: Any) -> Any:
    """What makes pairs of each link by UDP in turn."""
    return opened(request.param)


@pytest.fixture
def free_port() -> int:
    return _free_port()
