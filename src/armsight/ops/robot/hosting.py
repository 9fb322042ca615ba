"""Where a served robot's loop runs: in a process of its own, or in a thread on a clock that a test moves."""

from __future__ import annotations

import contextlib
import math
import multiprocessing
import os
import pickle
import signal
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from armsight.clock import Clock, SystemClock
from armsight.control.guard import Limits
from armsight.control.session.channels import TURN_S, Grant, JointTrack, LineChannels, Serves, error_of, put_error
from armsight.control.session.loop_host import LoopEvent, LoopRecord
from armsight.control.session.loop_side import Channels, lateness_s, run_loop
from armsight.control.setpoints import Hold, JointGoal, JointVelocity, SetPoint, ToolTwist
from armsight.control.status import RobotStatus
from armsight.drivers import Robot
from armsight.drivers.remote.protocol import RobotDescription
from armsight.errors import ArmsightError, DeviceFailed, DeviceLost, UsageError
from armsight.kinematics import Arm
from armsight.ops.requests.motion import RobotJob
from armsight.ops.robot.opening import driver_settings, open_robot
from armsight.priority import control_first

BEGIN_S = 120.0
"""Longest wait for the loop's first cycle: kernels may have to be compiled, a controller to answer."""

END_S = 10.0
"""Longest wait for the robot to come to rest at the end, before the loop's process is killed."""

HANGS_S = 1.0
"""A web server that fetched nothing from the loop for so long hangs: it does so ten times a second and more."""

LOST_S = 1.0
"""A loop whose newest state is so old has ended or hangs."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RobotSpec:
    """A robot as its process opens it: DRIVER:DEVICE, its driver's settings, the arm's model and the guard's limits."""

    robot: str
    arm: Arm
    limits: Limits = field(default_factory=Limits)
    settings: Mapping[str, Any] = field(default_factory=dict)


def spec_of(job: RobotJob, arm: Arm, limits: Limits) -> RobotSpec:
    """Return the robot of a job with its driver's settings. Raises UsageError for settings that it has no use for."""
    settings = driver_settings(job.robot, job.robot_settings, arm=arm, rsi_config=job.rsi_config)
    return RobotSpec(robot=job.robot, arm=arm, limits=limits, settings=settings)


class _SharedMemoryHost:
    """The server's side of the channels; a LoopHost. Subclasses run the loop. For one thread at a time."""

    def __init__(self, arm: Arm, limits: Limits, clock: Clock, track: JointTrack | None = None) -> None:
        self._arm, self._limits = arm, limits
        self._clock = clock
        self._channels = Channels(track=track)
        self._description: RobotDescription | None = None
        self._fetched_s = math.inf
        self._urgent: deque[tuple[Any, ...]] = deque()
        self._kept: list[LoopRecord] = []
        self._ended = ""

    @property
    def description(self) -> RobotDescription:
        """What robot it is. Raises DeviceFailed before the loop runs."""
        if self._description is None:
            raise DeviceFailed("the robot's loop does not run yet", consequence="Nothing is known of it")
        return self._description

    @property
    def arm(self) -> Arm | None:
        """The arm's model."""
        return self._arm

    @property
    def enable_age_s(self) -> float:
        """How old an enable or a set point may be."""
        return self._limits.enable_age_s

    @property
    def line(self) -> LineChannels:
        """What the line for stops shares with loop and server."""
        return self._channels.line

    def now_s(self) -> float:
        """Return the time on the loop's clock."""
        return self._clock.now_s()

    def lateness_p99_s(self) -> float:
        """Return by how much at most 99 % of the cycles began too late."""
        return lateness_s(self.lateness_counts(), 0.99)

    def lateness_counts(self) -> NDArray[np.uint64]:
        """Return how many cycles began how much too late, in the bins of loop_side.lateness_s."""
        return np.frombuffer(self._channels.lateness, dtype=np.uint64).copy()

    def status(self) -> RobotStatus:
        """Return the newest state. Raises DeviceLost where the loop has ended or hangs."""
        found = self._newest()
        # a loop that hangs writes no more, though its process lives: its last status would be shown for ever
        if found is None or self._ended or not self._runs() or self.now_s() - found.t_s > LOST_S:
            raise DeviceLost(
                f"the loop of the robot does not run{': ' if self._ended else ''}{self._ended}",
                consequence="Where the robot is is not known, and it takes no commands",
                cure="Look at the robot, and start the server anew",
            )
        return found

    def grant(self, lease: int, key: str, person: str = "") -> None:
        """Let the line for stops take the enables of a lease from a person, by its key; an empty key: of nobody."""
        self.line.grant.write(Grant(lease, key, person).encoded())

    def post(self, setpoint: SetPoint, *, age_s: float = 0.0) -> None:
        """Replace what is asked of the robot. Raises DeviceLost, UsageError for what a client cannot ask."""
        match setpoint:
            case JointGoal() | JointVelocity() | ToolTwist():
                self._order("follow", setpoint, self.now_s() - age_s)
            case Hold():
                self._order("hold")
            case _:
                raise UsageError(f"{type(setpoint).__name__} is no set point of a client")

    def beat(self, *, enable: bool, age_s: float = 0.0, lease: int = 0, number: int | None = None) -> None:
        """Tell the loop that a driver was alive age_s ago, and whether motion was allowed then. Raises DeviceLost."""
        self._order("beat", (enable, number), self.now_s() - age_s, lease)

    def release(self, why: str, *, lease: int = 0) -> None:
        """Hold at once: the driver is gone."""
        self._urge("release", why, 0.0, lease)

    def stop(self, why: str) -> None:
        """Come to rest and take nothing until reset."""
        self._urge("stop", why)

    def reset(self) -> None:
        """Take set points again after a stop. Raises DeviceLost."""
        self._order("reset")

    def records(self) -> list[LoopRecord]:
        """Return what the loop did since this was last asked."""
        self._fetched_s = self.now_s()
        self._push()
        for queue in (self.line.notes, self._channels.records):
            while (data := queue.get()) is not None:
                self._take(pickle.loads(data))
        kept, self._kept = self._kept, []
        return kept

    def _order(self, *order: Any) -> None:
        if self._ended or not self._push() or not self._channels.orders.put(pickle.dumps(order)):
            raise DeviceLost("the loop of the robot takes no orders", consequence="Nothing was sent")

    def _urge(self, *order: Any) -> None:
        """Give an order that must not be lost: where there is no room for it now it waits, and others behind it."""
        # through the same deque as those before it: a release must not overtake a stop
        self._urgent.append(order)
        self._push()

    def _push(self) -> bool:
        while self._urgent:
            if not self._channels.orders.put(pickle.dumps(self._urgent[0])):
                return False
            self._urgent.popleft()
        return True

    def _take(self, record: Any) -> None:
        if (error := error_of(record)) is not None:
            self._ended = str(error)
            self._kept.append(LoopEvent(t_s=self.now_s(), level="error", message=self._ended))
        elif isinstance(record, tuple):
            self._description = RobotDescription.model_validate(record[1])
        else:
            self._kept.append(record)

    def _newest(self) -> RobotStatus | None:
        data = self._channels.state.read()
        found: RobotStatus | None = None if data is None else pickle.loads(data)
        return found

    def _wait(self) -> None:
        """Wait for the first cycle. Raises the error that kept the loop from it, DeviceFailed after BEGIN_S."""
        until_s = time.monotonic() + BEGIN_S
        while self._newest() is None or self._description is None:
            self._fetch_start()
            if time.monotonic() > until_s or not self._runs():
                self._fetch_start()
                raise DeviceFailed("the robot's loop did not begin", consequence="Nothing is served")
            time.sleep(0.002)

    def _fetch_start(self) -> None:
        while (data := self._channels.records.get()) is not None:
            record = pickle.loads(data)
            if (error := error_of(record)) is not None:
                raise error
            self._take(record)

    def _runs(self) -> bool:
        raise NotImplementedError


class ProcessHost(_SharedMemoryHost):
    """A robot's loop in a process of its own: nothing that the web server does makes a cycle wait."""

    def __init__(self, spec: RobotSpec, track: JointTrack | None = None) -> None:
        """track: filled with where a simulated arm is."""
        clock = SystemClock()  # monotonic time is one for all processes of a machine
        super().__init__(spec.arm, spec.limits, clock, track)
        self._process = multiprocessing.get_context("spawn").Process(
            target=_loop_process, args=(self._channels, spec, os.getpid()), name="armsight-loop", daemon=True
        )
        self._over = threading.Event()
        self._turning = threading.Thread(target=self._turn, name="armsight-turns", daemon=True)

    def __enter__(self) -> Self:
        with _interrupts_ignored():  # Ctrl-C reaches both processes; this one ends the other in order
            self._process.start()
        try:
            self._wait()
        except BaseException:
            self._end()
            raise
        self._turning.start()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def _turn(self) -> None:
        """Tell the loop that this process is alive and serves: while it stands still or hangs no enable counts."""
        while not self._over.wait(TURN_S):
            if self.now_s() - self._fetched_s <= HANGS_S:
                self.line.turns.turn(Serves.WEB, self.now_s())

    def _end(self) -> None:
        self._over.set()
        self._urge("end", None)
        self._process.join(END_S)
        if self._process.is_alive():
            self._process.kill()
            self._process.join()

    def _runs(self) -> bool:
        return self._process.is_alive()


class ThreadHost(_SharedMemoryHost):
    """A robot's loop in a thread of this process, on a given clock: for tests and simulation, not for real time."""

    def __init__(
        self,
        robot: Robot,
        arm: Arm,
        clock: Clock,
        limits: Limits | None = None,
        *,
        ended: Callable[[], None] = lambda: None,
    ) -> None:
        """ended is called in the loop's thread at its end."""
        super().__init__(arm, limits or Limits(), clock)
        self._robot, self._when_ended = robot, ended
        self._thread = threading.Thread(target=self._run, name="armsight-loop", daemon=True)

    def _run(self) -> None:
        try:
            run_loop(self._channels, self._robot, self._arm, self._limits, self._clock, driver=self._robot.name)
        finally:
            self._when_ended()

    def begin(self) -> None:
        """Start the loop; it waits for its clock."""
        self._thread.start()

    def wait(self) -> None:
        """Wait for the loop's first cycle. Raises what kept it from it."""
        self._wait()

    def end(self, let_pass: Callable[[], None]) -> None:
        """End the loop; let_pass lets time pass, and is called until the robot has come to rest."""
        self._urge("end", None)
        while self._runs():
            let_pass()

    def _runs(self) -> bool:
        return self._thread.is_alive()


@contextlib.contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Let a process that is started here ignore SIGINT from its first moment on."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)


def _loop_process(channels: Channels, spec: RobotSpec, parent: int) -> None:
    """Run a robot's loop; the process that started it ends it."""
    control_first()
    clock = SystemClock()
    try:
        robot = open_robot(spec.robot, clock, spec.settings)
    except ArmsightError as error:
        put_error(channels.records, error)
        return
    run_loop(channels, robot, spec.arm, spec.limits, clock, driver=spec.robot, parent=parent)
