"""An emulated ABB controller that runs EGM: its own process sends its state over UDP and takes guidance.

It does what the manual says of a controller: joint or pose guidance, whichever comes, no faster than
MaxSpeedDeviation; a sensor that falls silent ends the guidance and the arm stays where it is, and the program starts
EGM anew. It smooths nothing, so that whatever comes at once is gone at once.
"""

from __future__ import annotations

import math
import socket
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from enum import StrEnum
from types import TracebackType
from typing import Any, Self

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.clock import Clock, SystemClock
from armsight.errors import DeviceFailed, Inconsistent, UsageError
from armsight_sim.arms import Drive, Servo, SimArm
from armsight_sim.twins.base import RIGHT, Wrong, host_port, note_silence, twin_arm, twin_drive, twin_home
from armsight_sim.twins.protobuf_wire import BadWire, doubles, fields, message, real, whole

COMM_TIMEOUT_S = 1.0
"""Silence of the sensor after which guidance ends: CommTimeout of EGMSetupUC."""

DATA, CORRECTION = 2, 3
MOTORS_ON, MOTORS_OFF = 1, 2
MCI_STOPPED, MCI_RUNNING = 2, 3
RAPID_RUNNING = 2

CYCLE_S = 0.004
"""EGM's shortest cycle."""

DRIVER = "127.0.0.1:6510"
"""Where a driver listens by ABB's usual port."""

JOINTS = 6

MAX_SPEED_DEVIATION_RAD_S = math.radians(60.0)
"""How fast a joint goes at most to where the sensor has it: MaxSpeedDeviation of EGMActJoint."""

LATE_CYCLES = 5
"""A twin so far behind time lets the cycles go that it has missed."""

CONVERGED_RAD = math.radians(0.5)
"""Within so much of its goal the controller tells convergence (CondTime's window)."""


class EgmFault(StrEnum):
    """What can be made to go wrong."""

    SILENT = "silent"
    FROZEN = "frozen"
    MOTORS_OFF = "motors_off"
    EGM_STOPPED = "egm_stopped"
    BLOCKED = "blocked"
    """The arm is held up by something, and goes on when that gives way."""


@dataclass(slots=True)
class EgmTwinCounts:
    """What came from the sensor: taken, refused (no guidance), late (an old number), and how often it fell silent."""

    taken: int = 0
    refused: int = 0
    late: int = 0
    timeouts: int = 0


class EgmController:
    """One controller; `cycle` is what it does each cycle. It sends to sensor (address, port)."""

    def __init__(
        self, sensor: tuple[str, int], *, arm: SimArm, drive: Drive, home: ArrayLike, clock: Clock, own: str = ""
    ) -> None:
        self.arm = arm
        self.counts = EgmTwinCounts()
        self.messages: list[str] = []
        self._sensor = sensor
        self._drive = drive
        self._clock = clock
        self._origin_s = clock.now_s()
        self._servo = Servo(drive, home, keep=1000)
        self.wrong: Wrong = RIGHT
        self._wanted = self._planned = self._servo.goal
        self._first: Array | None = None
        self._faults: set[EgmFault] = set()
        self._sequence = 0
        self._started_cycle = 0
        self._cycles = 0
        self._last_packet = b""
        self._sensor_sequence = -1
        self._silent_s = 0.0
        self._socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self._socket.bind((own, 0))
        self._socket.setblocking(False)

    @property
    def q(self) -> Array:
        """Where the joints are, (n,) in rad."""
        return np.asarray(self._servo.at(self._servo.t_s)[0])

    @property
    def link(self) -> socket.socket:
        """Its socket, to wait for an answer."""
        return self._socket

    def close(self) -> None:
        """Close its socket."""
        self._socket.close()

    def fault(self, fault: EgmFault | str, *, on: bool = True) -> None:
        """Make something go wrong, or right again."""
        kind = EgmFault(fault)
        (self._faults.add if on else self._faults.discard)(kind)
        if on and kind is not EgmFault.FROZEN:
            self._halt(kind is not EgmFault.BLOCKED)

    def restart(self) -> None:
        """Start anew: numbers and time begin at zero, and the arm stays where it is."""
        self._halt()
        self._receive()  # what is still under way was meant for the session before
        self._sequence, self._started_cycle, self._sensor_sequence = 0, self._cycles, -1

    def push(self, by: ArrayLike) -> None:
        """Move the arm by (n,) in rad without EGM: by hand, or by another program."""
        q = self.q + np.asarray(by, dtype=float)
        self._servo = Servo(self._drive, q, self._servo.t_s, keep=1000)
        self._wanted = self._planned = q
        self._first = None

    def cycle(self) -> None:
        """Take what has come, move for one cycle, and send."""
        self._listen()
        self._plan()
        self._cycles += 1
        self._servo.advance(self._cycles * self._drive.cycle_s)
        if EgmFault.SILENT in self._faults:
            return
        if EgmFault.FROZEN not in self._faults or not self._last_packet:
            self._last_packet = self._packet()
            self._sequence += 1
        try:
            self._socket.sendto(self._last_packet, self._sensor)
        except OSError:  # nobody listens there yet
            return

    def _listen(self) -> None:
        self._silent_s += self._drive.cycle_s
        for data in self._receive():
            self._guide(data)
        if self._silent_s > COMM_TIMEOUT_S and self._sensor_sequence >= 0:
            self.counts.timeouts += 1
            self.messages.append(f"guidance ended: the sensor was silent for {COMM_TIMEOUT_S:g} s")
            self._sensor_sequence = -1
            self._halt()

    def _halt(self, plan: bool = True) -> None:
        """Stay where the arm is; plan: take no more of what was guided."""
        self._servo.halt()
        if plan:
            self._wanted = self._planned = self._servo.goal
            self._first = None

    def _plan(self) -> None:
        """Go on towards where the sensor has the arm; what holds it up does not hold up the plan."""
        longest = 1.001 * MAX_SPEED_DEVIATION_RAD_S * self._drive.cycle_s
        self._planned = self._planned + np.clip(self._wanted - self._planned, -longest, longest)
        if EgmFault.BLOCKED not in self._faults:
            self._servo.command(self._servo.t_s, self._planned)

    def _receive(self) -> list[bytes]:
        """Return the packets that have come from the sensor; those of others are refused."""
        packets: list[bytes] = []
        while True:
            try:
                data, sender = self._socket.recvfrom(4096)
            except OSError:  # nothing more, or the report that nobody listens
                return packets
            if sender[1] == self._sensor[1]:
                packets.append(data)
            else:
                self.counts.refused += 1

    def _guide(self, data: bytes) -> None:
        """Take one packet of the sensor."""
        try:
            sequence, goal = self._goal(fields(data))
        except (BadWire, Inconsistent, ValueError, TypeError, KeyError, IndexError):
            self.counts.refused += 1
            return
        if sequence <= self._sensor_sequence:
            self.counts.late += 1
            return
        self.counts.taken += 1
        self._sensor_sequence, self._silent_s = sequence, 0.0
        if not self._faults & {EgmFault.MOTORS_OFF, EgmFault.EGM_STOPPED}:
            self._wanted = goal

    def _goal(self, sensor: dict[int, list[int | float | bytes]]) -> tuple[int, Array]:
        """Return number and joint goal (n,) in rad of a sensor's message; raises where it holds none."""
        header = fields(_bytes(sensor[1][-1]))
        if header[3][-1] != CORRECTION:
            raise BadWire("not a correction")
        planned = fields(_bytes(sensor[2][-1]))
        if 1 in planned:
            degrees = doubles(fields(_bytes(planned[1][-1]))[1])
            if len(degrees) != self.arm.n:
                raise BadWire("another number of joints")
            q = np.radians(degrees)
            self._first = q if self._first is None else self._first
            q = self.wrong.guided(q, self._first, self._wanted)
        else:
            q = self._led(_pose(planned[2][-1]))
        if not np.isfinite(q).all():
            raise BadWire("a goal is not finite")
        low, high = (np.array([getattr(joint, end) for joint in self.arm.joints]) for end in ("lower", "upper"))
        return int(header[1][-1]), np.clip(q, low, high)

    def _led(self, pose: Array) -> Array:
        """Return the joints (n,) that bring the flange to where a pose (4, 4) of the sensor guides it."""
        if self.wrong == RIGHT:
            return self.arm.reach(pose, self._planned)
        self._first = self.arm.reach(pose, self._planned) if self._first is None else self._first
        first, last = (self.arm.frames(q)[-1] for q in (self._first, self._wanted))
        turn = Rotation.from_matrix(pose[:3, :3] @ first[:3, :3].T).as_rotvec()
        made = self.wrong.of(np.concatenate([pose[:3, 3] - first[:3, 3], turn]))
        goal = (last if self.wrong.adds else first).copy()
        goal[:3, 3] += made[:3]
        goal[:3, :3] = Rotation.from_rotvec(made[3:]).as_matrix() @ goal[:3, :3]
        return self.wrong.joints(self.arm.reach(goal, self._first), self._first)

    def _packet(self) -> bytes:
        """Return the controller's state as an EgmRobot message."""
        now_ms = round((self._cycles - self._started_cycle) * self._drive.cycle_s * 1000)
        q = self._servo.read(self._servo.t_s)[0]
        goal = self._planned
        near = float(np.abs(goal - q).max()) < CONVERGED_RAD
        motors = MOTORS_OFF if EgmFault.MOTORS_OFF in self._faults else MOTORS_ON
        mci = MCI_RUNNING if not self._faults & {EgmFault.MOTORS_OFF, EgmFault.EGM_STOPPED} else MCI_STOPPED
        time_s = self._clock.now_s()
        moment = message(4, whole(1, int(time_s)), whole(2, int(1e6 * (time_s % 1.0))))
        return b"".join(
            (
                message(1, whole(1, self._sequence), whole(2, now_ms), whole(3, DATA)),
                message(2, _joints(q), _flange(self.arm, q), message(3), moment),
                message(3, _joints(goal), _flange(self.arm, goal), message(3), moment),
                message(4, whole(1, motors)),
                message(5, whole(1, mci)),
                whole(6, int(near)),
                message(8, whole(1, RAPID_RUNNING)),
                real(10, 50.0),
            )
        )


class EgmTwin:
    """An emulated ABB controller in real time. It sends to a driver at connect (HOST:PORT), or at port of this machine.

    Raises UsageError for an address that is none, and for an arm without six joints.
    """

    def __init__(
        self,
        *,
        port: str | None = None,
        connect: str | None = None,
        arm: Mapping[str, Any] | None = None,
        cycle_s: float | None = None,
        clock: Clock | None = None,
    ) -> None:
        if port is not None and connect is not None:
            raise UsageError(
                "--port and --connect both say where the driver listens", cure="Give one of them, the port or HOST:PORT"
            )
        self._sensor = host_port(connect or port or DRIVER)
        self._arm = twin_arm(arm)
        if self._arm.n != JOINTS:
            raise UsageError(
                f"the emulated controller guides {JOINTS} joints, not {self._arm.n}",
                consequence="There is no twin",
                cure="Give an arm of six joints",
            )
        self._drive = twin_drive(self._arm, cycle_s or CYCLE_S)
        self._clock = clock or SystemClock()
        self._controller: EgmController | None = None

    @property
    def address(self) -> str:
        """What opens the driver."""
        return f"egm:{self._sensor[1]}"

    @property
    def messages(self) -> list[str]:
        """Why it ended guidance or fell silent."""
        return [] if self._controller is None else self._controller.messages

    @property
    def controller(self) -> EgmController:
        """The controller itself. Raises DeviceFailed where it is not open."""
        if self._controller is None:
            raise DeviceFailed("the twin is not open", cure="Open it first")
        return self._controller

    def __enter__(self) -> Self:
        self._controller = EgmController(
            self._sensor, arm=self._arm, drive=self._drive, home=twin_home(self._arm), clock=self._clock
        )
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._controller is not None:
            self._controller.close()
            self._controller = None

    def run(self, on: Callable[[], bool]) -> None:
        """Do one cycle after the other in real time as long as on() holds."""
        cycle_s = self._drive.cycle_s
        next_s = self._clock.now_s()
        while on():
            next_s = max(next_s + cycle_s, self._clock.now_s() - LATE_CYCLES * cycle_s)
            self._clock.sleep_until(next_s)
            note_silence(self.messages, self._clock.now_s() - next_s)
            self.controller.cycle()


def _bytes(value: int | float | bytes) -> bytes:
    if not isinstance(value, bytes):
        raise BadWire("a message is a number")
    return value


def _joints(q: Array) -> bytes:
    return message(1, *(real(1, math.degrees(value)) for value in q))


def _flange(arm: SimArm, q: Array) -> bytes:
    pose = arm.frames(q)[-1]
    x, y, z, w = Rotation.from_matrix(pose[:3, :3]).as_quat()
    position = (real(i, 1000.0 * value) for i, value in enumerate(pose[:3, 3], 1))
    turn = (real(i, value) for i, value in enumerate((w, x, y, z), 1))
    return message(2, message(1, *position), message(2, *turn))


def _pose(value: int | float | bytes) -> Array:
    """Return the pose (4, 4) of an EgmPose message; Euler angles go before quaternions, as the definition says."""
    parts = fields(_bytes(value))
    position = fields(_bytes(parts[1][-1]))
    xyz_m = np.array([_real(position[i][-1]) for i in (1, 2, 3)]) / 1000.0
    if 3 in parts:
        euler = fields(_bytes(parts[3][-1]))
        turn = Rotation.from_euler("xyz", [_real(euler[i][-1]) for i in (1, 2, 3)], degrees=True)
    else:
        quat = fields(_bytes(parts[2][-1]))
        w, x, y, z = (_real(quat[i][-1]) for i in (1, 2, 3, 4))
        turn = Rotation.from_quat([x, y, z, w])
    return RigidTransform.from_components(xyz_m, turn).as_matrix()


def _real(value: int | float | bytes) -> float:
    if not isinstance(value, float) or not math.isfinite(value):
        raise BadWire("a double is something else")
    return value
