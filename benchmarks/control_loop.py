"""The control loop against a robot on loopback UDP, on the machine's own clock: punctuality and time of a decision.

The robot is another process that takes joint values and answers with a reading. Cycle 4 ms, 60 s (--seconds), on an
idle machine; --load N runs N busy processes beside it. First the time of guard.step for each kind of set point.
"""

from __future__ import annotations

import argparse
import multiprocessing
import socket
import struct
import time
from collections.abc import Callable
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

import bench
from armsight.clock import SystemClock
from armsight.control import CycleState, JointGoal, SetPoint, ToolPose, ToolTwist
from armsight.control.guard import Box, Guard, Inputs, Limits
from armsight.control.loop import ControlLoop
from armsight.drivers import RobotState, Sent
from armsight.kinematics import preset
from armsight.records import JointReading
from armsight.units import MS

Array = NDArray[np.float64]
CYCLE_S = 0.004
HOME = np.radians([0.0, -60.0, 90.0, -30.0, 90.0, 0.0])
PACKET = struct.Struct("<q6d")
LIMITS = Limits(
    workspace=Box(lower_m=np.full(3, -2.0), upper_m=np.full(3, 2.0)),
    forbidden=(Box(lower_m=np.array([-2.0, -2.0, -2.0]), upper_m=np.array([2.0, 2.0, -0.5]), name="floor"),),
)


def robot_process(port: int) -> None:
    """Answer each command with the joints that it brought."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.connect(("127.0.0.1", port))
        link.send(PACKET.pack(0, *HOME))
        while True:
            data = link.recv(256)
            if not data:
                return
            link.send(data)


def busy() -> None:
    """Keep a core busy."""
    while True:
        sum(range(1000))


class UdpRobot:
    """A robot of six joints behind a socket."""

    name, n_joints, cycle_s, takes_poses = "udp", 6, CYCLE_S, False

    def __init__(self) -> None:
        self.state = RobotState.CLOSED
        self._link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._link.bind(("127.0.0.1", 0))
        self._peer = multiprocessing.get_context("spawn").Process(
            target=robot_process, args=(self._link.getsockname()[1],), daemon=True
        )
        self._q, self._sequence = HOME, 0
        self._newest = (HOME, 0)

    def __enter__(self) -> Self:
        self._peer.start()
        _, there = self._link.recvfrom(256)
        self._link.connect(there)
        self._link.setblocking(False)
        self.state = RobotState.READY
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._link.send(b"")
        self._peer.join(2.0)
        self._link.close()
        self.state = RobotState.CLOSED

    def read(self) -> JointReading:
        """Return what the newest packet says."""
        while True:
            try:
                sequence, *q = PACKET.unpack(self._link.recv(256))
            except BlockingIOError:
                break
            self._newest = (np.array(q), sequence)
        return JointReading(q=self._newest[0], t_s=time.monotonic(), sequence=self._newest[1], source=self.name)

    def step_joints(self, step: Array) -> Sent:
        """Send where it shall go."""
        self._q = self._q + step
        self._sequence += 1
        self._link.send(PACKET.pack(self._sequence, *self._q))
        return Sent(q=self._q, t_s=time.monotonic(), sequence=self._sequence)

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """It takes none."""
        raise NotImplementedError

    def stop(self) -> None:
        """It stands where it is."""

    def reset(self) -> None:
        """It is never stopped."""


class Circle:
    """A path of the tool, 60 mm/s along a circle."""

    name = "path"

    def __init__(self, start: Array) -> None:
        self._start = RigidTransform.from_matrix(start)
        self._begun_s: float | None = None
        self._way_m = 0.0

    def next(self, now: CycleState) -> SetPoint:
        """Return the next pose; the path waits where the guard does not follow."""
        if self._begun_s is None:
            self._begun_s = now.t_s
        if now.running or self._way_m == 0.0:
            speed = 0.06 * min(1.0, (now.t_s - self._begun_s) / 2.0)
            self._way_m += speed * now.cycle_s
        a = self._way_m / 0.05
        shift = 0.05 * np.array([np.sin(a), 0.0, 1.0 - np.cos(a)])
        return ToolPose(T_base_tool=RigidTransform.from_translation(shift) * self._start)


def decisions(kind: str, wanted: Callable[[int, CycleState], SetPoint]) -> list[object]:
    """Return the times of 5,000 decisions for one kind of set point, in ms."""
    guard = Guard(preset("ur10"), LIMITS, CYCLE_S)
    guard.begin(HOME, 0.0)
    guard.warm_up()
    took = []
    for k in range(5000):
        reading = JointReading(q=guard.q_sent, t_s=k * CYCLE_S, sequence=k, source="x")
        point = wanted(k, guard.cycle_state(k * CYCLE_S, reading))
        begun = time.perf_counter()
        guard.step(point, reading, Inputs(now_s=k * CYCLE_S, enabled=True))
        took.append((time.perf_counter() - begun) / MS)
        guard.acknowledge(guard.q_sent)
    return [kind, f"{np.median(took):.3f}", f"{np.percentile(took, 99):.3f}", f"{max(took):.3f}"]


def where(name: str, limits: Limits, wanted: Callable[[int], SetPoint]) -> list[object]:
    """Return the times of 5,000 decisions, in ms of the processor and of the clock, and what the guard said last."""
    guard = Guard(preset("ur10"), limits, CYCLE_S)
    guard.begin(HOME, 0.0)
    guard.warm_up()
    guard.begin(HOME, 0.0)
    took, said = [], ""
    for k in range(5000):
        reading = JointReading(q=guard.q_sent, t_s=k * CYCLE_S, sequence=k, source="x")
        point = wanted(k)
        begun = time.thread_time(), time.perf_counter()
        decision = guard.step(point, reading, Inputs(now_s=k * CYCLE_S, enabled=True))
        took.append(((time.thread_time() - begun[0]) / MS, (time.perf_counter() - begun[1]) / MS))
        guard.acknowledge(guard.q_sent)
        said = decision.why or str(decision.state)
    figures = np.percentile(took, [50.0, 99.0], axis=0).T.ravel()
    return [name, *(f"{value:.3f}" for value in figures), said.split(",")[0]]


def in_a_cell() -> list[list[object]]:
    """Return rows of decisions of an arm of six axes with a workspace and two boxes: within them, at them, outside."""
    at = preset("ur10").fk(HOME)[:3, 3]
    cell = Box(lower_m=at - 1.0, upper_m=at + 1.0, name="cell")
    table = Box(lower_m=at - np.array([0.5, 0.5, 0.6]), upper_m=at + np.array([0.5, 0.5, -0.3]), name="table")
    near = Box(lower_m=at + np.array([-0.3, 0.02, -0.3]), upper_m=at + np.array([0.3, 0.3, 0.3]), name="wall")
    over = Box(lower_m=at - 0.3, upper_m=at + np.array([0.3, 0.1, 0.3]), name="wall")
    inside, outside = (Limits(workspace=cell, forbidden=(table, wall)) for wall in (near, over))
    still, along = np.zeros(3), np.array([0.0, 0.05, 0.0])

    def circling(k: int) -> SetPoint:
        return ToolTwist(velocity_m_s=0.02 * np.array([np.sin(0.02 * k), 0.0, np.cos(0.02 * k)]), angular_rad_s=still)

    def out(k: int) -> SetPoint:
        return ToolTwist(velocity_m_s=0.01 * along, angular_rad_s=still)

    def further(k: int) -> SetPoint:
        return ToolTwist(velocity_m_s=-along, angular_rad_s=still)

    return [
        where("within all limits", inside, circling),
        where("against a wall", inside, lambda k: ToolTwist(velocity_m_s=along, angular_rad_s=still)),
        where("outside, on the way back", outside, out),
        where("outside, asked further out", outside, further),
        where("outside, a goal of the joints", outside, lambda k: JointGoal(q=HOME + 0.3)),
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seconds", type=float, default=60.0, help="0: the times of decisions alone")
    parser.add_argument("--load", type=int, default=0, help="busy processes beside it")
    asked = parser.parse_args()
    print(bench.machine())
    start = preset("ur10").fk(HOME)
    circle = Circle(start)
    still = np.zeros(3)

    def twist(k: int, now: CycleState) -> SetPoint:
        return ToolTwist(velocity_m_s=np.array([0.0, 0.05 * np.sin(0.01 * k), 0.0]), angular_rad_s=still)

    rows = [
        decisions("joint goal", lambda k, now: JointGoal(q=HOME + 0.3)),
        decisions("tool twist", twist),
        decisions("tool pose", lambda k, now: circle.next(now)),
    ]
    bench.table("Time of a decision, ms", ["set point", "median", "p99", "max"], rows)
    heads = ["where", "processor: median", "p99", "clock: median", "p99", "the guard, at the end"]
    bench.table("Time of a decision with a workspace and two boxes, ms", heads, in_a_cell())
    if asked.seconds <= 0.0:
        return
    context = multiprocessing.get_context("spawn")
    loads = [context.Process(target=busy, daemon=True) for _ in range(asked.load)]
    for load in loads:
        load.start()
    with UdpRobot() as robot:
        guard = Guard(preset("ur10"), LIMITS, CYCLE_S)
        loop = ControlLoop(robot, guard, Circle(start), SystemClock(), enabled=lambda: True)
        timing = loop.run(for_s=asked.seconds)
    for load in loads:
        load.terminate()
    status = loop.status
    rows = [
        [name, *(f"{value / MS:.4f}" for value in figures)]
        for name, figures in (
            ("wake-up lateness", timing.lateness_s),
            ("period", timing.period_s),
            ("wake-up to command sent", timing.busy_s),
        )
    ]
    bench.table(f"The loop at {CYCLE_S / MS:g} ms for {asked.seconds:g} s, ms", ["", "median", "p99", "max"], rows)
    state = "nothing" if status is None else status.guard
    print(f"\n{timing.n_cycles} cycles, {timing.late} late, {timing.missed} missed; the guard is {state}")


if __name__ == "__main__":
    main()
