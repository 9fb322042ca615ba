"""The loop's side of a robot server: it takes what the server puts into shared memory, and tells what it does there."""

from __future__ import annotations

import math
import os
import pickle
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from multiprocessing import RawArray
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armsight.clock import Clock
from armsight.control.guard import Guard, GuardState, Limits
from armsight.control.loop import ControlLoop
from armsight.control.session.channels import JointTrack, LineChannels, Newest, Queue, granted, put_error
from armsight.control.session.loop_host import SETPOINT_S, LoopCommand, LoopEvent
from armsight.control.setpoints import ClientSource, CycleState, JointGoal, SetPoint
from armsight.control.status import RobotStatus
from armsight.drivers import Robot, RobotTraits, listen
from armsight.drivers.remote.protocol import JointDescription, RobotDescription
from armsight.errors import ArmsightError
from armsight.kinematics import Arm
from armsight.records import JointReading
from armsight.units import MS

OFF_CYCLES = 2
"""Cycles without enable after somebody let go of it, however soon they give it anew: a reset is done in the first."""

ARRIVED = 1e-12
"""A goal this near (rad or m) was reached."""

RECORD_BYTES = 768
"""Longest record: a command of 16 joints has 500."""

STATUS_BYTES = 8192
"""Longest status: of 16 joints, each cut by three limits, with the longest reason in letters of four bytes."""

BINS_PER_OCTAVE = 32
OCTAVES = 20
LEAST_S = 1e-6
"""Lateness is counted in bins 2.2 % wide, from 1 us to 1 s."""


@dataclass(frozen=True, slots=True)
class Channels:
    """What server and loop share. orders: to the loop; records: from it; state: its newest; lateness: of its cycles.

    line: of the line for stops, which the server has no part in. track: where a simulated arm is, for the process that
    draws what cameras see of it.
    """

    orders: Queue = field(default_factory=lambda: Queue(1024, 1024))
    line: LineChannels = field(default_factory=LineChannels)
    records: Queue = field(default_factory=lambda: Queue(8192, RECORD_BYTES))
    state: Newest = field(default_factory=lambda: Newest(STATUS_BYTES))
    lateness: Any = field(default_factory=lambda: RawArray("Q", BINS_PER_OCTAVE * OCTAVES))
    track: JointTrack | None = None


class CountedClock:
    """A clock that counts by how much later than asked it wakes up."""

    def __init__(self, clock: Clock, counts: Any) -> None:
        self._clock = clock
        self._counts = counts

    def now_s(self) -> float:
        """Return the time in s."""
        return self._clock.now_s()

    def sleep_until(self, t_s: float) -> None:
        """Wait for t_s."""
        self._clock.sleep_until(t_s)
        octave = math.log2(max(self._clock.now_s() - t_s, LEAST_S) / LEAST_S)
        self._counts[min(int(BINS_PER_OCTAVE * octave), len(self._counts) - 1)] += 1


def lateness_s(counts: NDArray[np.uint64], share: float) -> float:
    """Return the lateness in s that a share of the counted wake-ups, 0 to 1, do not exceed; 0 before the first."""
    total = int(counts.sum())
    if not total:
        return 0.0
    index = int(np.searchsorted(np.cumsum(counts), math.ceil(share * total)))
    return float(LEAST_S * 2.0 ** ((index + 1) / BINS_PER_OCTAVE))


class RecordSink:
    """Puts what the loop did among the records; what finds no room there is counted."""

    def __init__(self, records: Queue) -> None:
        self._records = records
        self.dropped = 0

    def event(self, t_s: float, message: str, level: str, name: str) -> None:
        """Tell an event."""
        self._put(LoopEvent(t_s=t_s, level=level, message=message[:200]))

    def command(self, t_s: float, kind: str, values: Mapping[str, Any]) -> None:
        """Tell what was sent to the robot."""
        self._put(LoopCommand(t_s=t_s, kind=kind, values=dict(values)))

    def joints(self, reading: JointReading) -> None:
        """Tell a reading."""
        self._put(reading)

    def _put(self, record: object) -> None:
        data = pickle.dumps(record, protocol=5)
        # the loop never waits for the server: a record that finds no room is lost, and counted
        if len(data) > RECORD_BYTES or not self._records.put(data):
            self.dropped += 1


class OrderSource:
    """Set points and heartbeats of whoever drives, from the queues of orders: the loop's source, and its enable.

    Goals are followed until they are reached, velocities for SETPOINT_S; all is forgotten when the enable ends, the
    driver leaves or the guard stops. The enable comes by two ways, the server's and the line for stops; whichever is
    first counts. It ends by itself where it is too old, or one of the processes that serve the robot stood still, and
    counts again once it was let go of. dropped: how often it forgot. lapsed: why the enable ended by itself, empty
    where it did not.
    """

    name = "client"

    def __init__(self, channels: Channels, clock: Clock, parent: int | None, enable_age_s: float) -> None:
        self._orders, self._line_orders, self._grant = channels.orders, channels.line.orders, channels.line.grant
        self._turns, self._enable_age_s = channels.line.turns, enable_age_s
        self._clock = clock
        self._parent = parent
        self._loop: ControlLoop | None = None
        self._client = ClientSource(SETPOINT_S)
        self._goal: JointGoal | None = None
        self._asked = False
        self._beat_s = self._since_s = -math.inf
        self._lease, self._number = 0, 0
        self._enable = False
        self._off = 0
        self.dropped = 0
        self.lapsed = ""

    def attach(self, loop: ControlLoop) -> None:
        """Let orders stop, reset and end this loop."""
        self._loop = loop

    def next(self, now: CycleState) -> SetPoint:
        """Take the orders that came, and return what is wanted."""
        self._hear()
        # an enable that ends takes its set point along: one given anew must not continue the old motion
        if not self._alive():
            self.drop()
        if self._goal is not None:
            self._client.post(self._goal, now.t_s)  # a goal does not age
            if np.abs(now.q_sent - self._goal.q).max() <= ARRIVED and not now.qd_sent.any():
                self._forget()
        return self._client.next(now)

    def enabled(self) -> bool:
        """Return whether the driver lives and allows motion; asked in cycles too in which nothing is wanted."""
        self._hear()
        enabled = not self._off and self._alive()
        self._off = max(0, self._off - 1)
        return enabled

    def _hear(self) -> None:
        """Do the orders that came. A controller that is lost takes no more steps, and is left all the same."""
        for queue in (self._line_orders, self._orders):  # a stop before all that a server may have piled up
            while (data := queue.get()) is not None:
                self._obey(*pickle.loads(data))
        if self._parent is not None and os.getppid() != self._parent:
            self._leave()  # the server's process died

    def drop(self) -> None:
        """Forget what was asked."""
        if self._asked:
            self._forget()
            self.dropped += 1

    def _forget(self) -> None:
        self._client.clear()
        self._goal, self._asked = None, False

    def _alive(self) -> bool:
        """Tell whether the enable is alive; one that is not any more has lapsed."""
        if self._enable and (why := self._why_lapsed(self._clock.now_s())):
            self._enable, self._beat_s, self.lapsed = False, -math.inf, why
        return self._enable

    def _why_lapsed(self, now_s: float) -> str:
        if missed := self._turns.missed(now_s, self._enable_age_s, self._since_s):
            return f"{missed} stood still"
        if now_s - self._beat_s > self._enable_age_s:
            return f"no enable came for more than {self._enable_age_s / MS:.0f} ms"
        return ""

    def _obey(self, order: str, value: Any = None, sent_s: float = -math.inf, lease: int = 0, key: str = "") -> None:
        match order:
            case "follow":
                self._follow(value, sent_s)
            case "hold":
                self.drop()
            case "beat" if not (key and value[0]) or granted(self._grant)[:2] == (lease, key):
                self._beat(value, sent_s, lease)
            case "release":
                self._let_go()
                if lease:  # what that driver still has under way counts no more
                    self._lease, self._number = max(self._lease, lease + 1), 0
                self.drop()
            case "stop" if self._loop is not None:
                self._loop.stop(value)
                self.drop()
            case "reset" if self._loop is not None:
                self._loop.reset()
                self.drop()
            case "end":
                self._leave()

    def _follow(self, wanted: SetPoint, sent_s: float) -> None:
        if self._alive():  # what came before the enable, or after its end, is not done later
            self._client.post(wanted, sent_s)
            self._goal, self._asked = wanted if isinstance(wanted, JointGoal) else None, True

    def _beat(self, said: tuple[bool, int | None], sent_s: float, lease: int) -> None:
        """Take an enable, or its end, with its number; not from who has left, nor one that was overtaken."""
        enable, number = said
        if lease and (lease < self._lease or (lease == self._lease and number is not None and number <= self._number)):
            return
        if lease > self._lease or number is not None:
            self._lease, self._number = lease, number or 0
        if not enable:
            self._let_go()
        elif not self.lapsed and self._clock.now_s() - sent_s <= self._enable_age_s:
            self._since_s = self._since_s if self._enable else sent_s
            self._enable, self._beat_s = True, max(sent_s, self._beat_s)

    def _let_go(self) -> None:
        self._enable, self._beat_s, self._off, self.lapsed = False, -math.inf, OFF_CYCLES, ""

    def _leave(self) -> None:
        self._let_go()
        self.drop()
        if self._loop is not None:
            self._loop.end()


def run_loop(
    channels: Channels, robot: Robot, arm: Arm, limits: Limits, clock: Clock, *, driver: str, parent: int | None = None
) -> None:
    """Open the robot and run its loop until the order to end, or process parent's end; the description comes first."""
    sink = RecordSink(channels.records)
    try:
        with robot:
            guard = Guard.of(robot, arm, limits)
            source = OrderSource(channels, clock, parent, limits.enable_age_s)
            counted = CountedClock(clock, channels.lateness)
            loop = ControlLoop(robot, guard, source, counted, enabled=source.enabled, sink=sink)
            source.attach(loop)
            channels.records.put(pickle.dumps(("described", describe(robot, guard, driver).model_dump())))
            publish = StatusPublisher(channels.state, source, sink).publish
            loop.run(until=publish if channels.track is None else tracked(publish, robot, channels.track, clock))
    except ArmsightError as error:
        put_error(channels.records, error)
    except Exception as error:  # whatever ended it, the server tells it
        text = f"the loop failed: {type(error).__name__}: {error}"[:300]
        put_error(channels.records, ArmsightError(text, consequence="The robot was stopped"))


def tracked(
    publish: Callable[[RobotStatus], bool], robot: Robot, track: JointTrack, clock: Clock
) -> Callable[[RobotStatus], bool]:
    """Return publish, with a robot's joints written into the track, after each cycle or as its link hears them.

    Those of a simulated robot are written as they truly are. Raises UsageError for a robot that tells no time of them.
    """
    true_joints = RobotTraits.of(robot).true_joints
    if true_joints is None:
        listen(robot, track.write)
        return publish

    def publish_tracked(status: RobotStatus) -> bool:
        now_s = clock.now_s()
        track.write(now_s, true_joints(now_s))
        return publish(status)

    return publish_tracked


class StatusPublisher:
    """Publishes the newest status after each cycle."""

    def __init__(self, state: Newest, source: OrderSource, sink: RecordSink) -> None:
        self._state, self._source, self._sink = state, source, sink
        self._lapsed = ""

    def publish(self, status: RobotStatus) -> bool:
        """Publish it with what the source of orders forgot; never ends the loop."""
        # what was asked before a stop must not move the robot after the reset
        if status.guard is GuardState.STOPPED:
            self._source.drop()
        lapsed = self._source.lapsed
        if lapsed and lapsed != self._lapsed:
            self._sink.event(status.t_s, f"the enable ended: {lapsed}", "warning", self._source.name)
        self._lapsed = lapsed
        why = lapsed if lapsed and status.guard is GuardState.DISABLED else status.why
        published = replace(status, why=why[:500], dropped=self._source.dropped, lapsed=lapsed)
        self._state.write(pickle.dumps(published, protocol=5))
        return False


def describe(robot: Robot, guard: Guard, driver: str) -> RobotDescription:
    """Return what robot it is, with the limits that the guard keeps for its joints."""
    bounds = guard.bounds
    joints = [
        JointDescription(
            name=joint.name,
            lower=low if math.isfinite(low) else None,
            upper=high if math.isfinite(high) else None,
            max_speed=speed,
        )
        for joint, low, high, speed in zip(
            guard.arm.joints, bounds.lower.tolist(), bounds.upper.tolist(), bounds.speed.tolist(), strict=True
        )
    ]
    return RobotDescription(
        name=robot.name,
        driver=driver,
        n_joints=robot.n_joints,
        cycle_s=robot.cycle_s,
        takes_poses=robot.takes_poses,
        joints=joints,
    )
