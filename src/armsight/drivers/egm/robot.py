"""A robot of ABB behind Externally Guided Motion."""

from __future__ import annotations

import contextlib
import math
import socket
import threading
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.clock import Clock, SystemClock
from armsight.drivers.cyclic import CyclicRobot, LinkTimes
from armsight.drivers.egm.packets import ControllerPacket, answer_joints, answer_pose, parse
from armsight.drivers.egm.settings import EgmSettings, egm_settings
from armsight.drivers.joint_goals import JointLimits
from armsight.drivers.pose_goals import PoseGoals, between
from armsight.drivers.robot import Sent
from armsight.errors import DeviceFailed, DeviceLost, DeviceNotFound, Inconsistent, UsageError
from armsight.records import JointReading
from armsight.units import MS

Array = NDArray[np.float64]

LARGEST_PACKET = 4096
"""Bytes of a packet at most: a full EgmRobot message has about 700."""

LARGEST_SPEED_RAD_S = 60.0
"""No joint of a robot moves so fast: a reading that says so is refused."""

JUMP_CYCLES = 3
"""Over so many missed cycles a joint may have moved; an arm that is elsewhere after more is refused until the link is
lost: the old goal must not pull it back."""

RESTART_PACKETS = 3
"""So many packets behind the newest, one behind the other in order, are those of a link that has started anew."""


@dataclass(slots=True)
class EgmCounts:
    """Packets since the link was opened.

    heard: good ones. missed: numbers that never came. repeated: with a number that was there. refused: that are no
    packets of a controller. foreign: of another sender.
    """

    heard: int = 0
    missed: int = 0
    repeated: int = 0
    refused: int = 0
    foreign: int = 0


class EgmRobot(CyclicRobot):
    """An arm that sends EgmRobot packets to this computer's UDP port and takes EgmSensor packets back.

    device: the UDP port. settings: see EgmSettings. Raises UsageError for a port or a setting that cannot be.
    """

    def __init__(self, device: str, *, settings: Mapping[str, Any] | None = None, clock: Clock | None = None) -> None:
        self.settings: EgmSettings = egm_settings(settings or {})
        self.port = _port(device)
        n = self.settings.joints
        limits = JointLimits(
            lower=_each(self.settings.lower_rad, -math.inf, n),
            upper=_each(self.settings.upper_rad, math.inf, n),
            max_speed=np.full(n, self.settings.max_speed_rad_s),
        )
        cycle_s = self.settings.cycle_s
        times = LinkTimes(cycle_s=cycle_s, stale_s=self.settings.stale_s, silent_s=self.settings.silent_s)
        super().__init__(f"egm:{device}", limits=limits, times=times, clock=clock or SystemClock())
        self.takes_poses = self.settings.guidance == "pose"
        self._poses = PoseGoals(self.name, self.settings.speed_m_s, self.settings.speed_rad_s, self.cycle_s)
        self.counts = EgmCounts()
        self._last: ControllerPacket | None = None
        self._answers = 0

    def step_joints(self, step: Array) -> Sent:
        """Move on by step (n,) in rad; in pose guidance only a step of zeros, which asks for nothing."""
        if not self.takes_poses:
            return super().step_joints(step)
        with self._lock:
            reading = self._ready()
            if np.shape(step) != (self.n_joints,) or np.any(step):  # not a number is not zero
                raise UsageError(
                    f"{self.name} is guided by poses",
                    consequence="Nothing was sent",
                    cure="Send poses, or set guidance to joint and run EGMRunJoint on the controller",
                )
            return self._note(reading.q, self._poses.next, ())

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """Move towards a pose of the flange in the controller's correction frame, as far as one cycle allows.

        The joint values of the answer are those read last: only the controller knows which belong to the pose.
        """
        if not self.takes_poses:
            return super().move_pose(T_base_flange)
        with self._lock:
            reading = self._ready()
            packet = self._last
            if packet is None or packet.T_base_flange is None:
                raise DeviceLost(f"{self.name} tells no pose", consequence="Nothing was sent")
            pose, limited = self._poses.go(T_base_flange, packet.T_base_flange)
            return self._note(reading.q, pose, limited)

    def _start(self) -> None:
        self.counts = EgmCounts()
        self._last = None
        self._behind, self._behind_sequence = 0, -1
        self._sender: tuple[str, int] | None = None
        self._other: tuple[str, int] | None = None
        self._closing = False
        self._socket = self._bind()
        self._first = threading.Event()
        self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()
        if not self._first.wait(self.settings.open_s):
            self._finish()
            wrong = f" ({self.counts.refused} packets were no EGM state)" if self.counts.refused else ""
            raise DeviceNotFound(
                f"no controller has sent to UDP port {self.port} within {self.settings.open_s:g} s{wrong}",
                consequence="The robot is not opened",
                cure="Give this computer's address and port to the controller (UDPUC device) and start its EGM program",
            )

    def _bind(self) -> socket.socket:
        link = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        try:
            link.bind((self.settings.bind, self.port))
        except OSError as error:
            link.close()
            raise DeviceFailed(
                f"UDP port {self.port} cannot be taken: {error.strerror or error}",
                consequence="The robot is not opened: one program at a time may drive it",
                cure="Stop the other program, or choose another port here and on the controller",
            ) from error
        link.settimeout(self.cycle_s)
        return link

    def _finish(self) -> None:
        self._closing = True
        self._thread.join()
        self._socket.close()

    def _run(self) -> None:
        while not self._closing:
            try:
                data, sender = self._socket.recvfrom(LARGEST_PACKET)
            except TimeoutError:
                if self._silent():
                    self._lose(self._why_silent())
                continue
            except OSError:  # a datagram's error report: the next packet tells how it is
                continue
            self._take(data, sender)

    def _why_silent(self) -> str:
        other = f"; {self._other[0]}:{self._other[1]} sends instead" if self._other else ""
        return f"its controller has fallen silent{other}"

    def _take(self, data: bytes, sender: tuple[str, int]) -> None:
        """Take one packet, and answer where it is a good one."""
        if (self._sender not in (None, sender)) or self.settings.controller not in ("", sender[0]):
            self.counts.foreign += 1
            self._other = sender
            return
        try:
            packet = parse(data, self.n_joints)
            self._check(packet)
        except Inconsistent:
            self.counts.refused += 1
            return
        now_s = self._clock.now_s()
        if self._last is not None and packet.sequence <= self._last.sequence:
            self._hear_old(packet, self._last, now_s)
            return
        self._hear(packet, now_s)
        self._sender = sender
        if not self._lost:
            self._answer(sender)
        self._first.set()

    def _check(self, packet: ControllerPacket) -> None:
        """Raise Inconsistent where a packet contradicts the one before, or lacks what its guidance needs."""
        if self.takes_poses and packet.T_base_flange is None:
            raise Inconsistent("a packet has no measured pose")
        last = self._last
        if last is not None and packet.sequence > last.sequence:
            cycles = min(packet.sequence - last.sequence, JUMP_CYCLES)
            if float(np.abs(packet.q - last.q).max()) > LARGEST_SPEED_RAD_S * cycles * self.cycle_s:
                raise Inconsistent("a packet's joints are where they cannot have come to")

    def _hear(self, packet: ControllerPacket, now_s: float) -> None:
        if self._last is not None:
            self.counts.missed += packet.sequence - self._last.sequence - 1
        self.counts.heard += 1
        self._behind, self._behind_sequence = 0, -1
        self._last = packet
        if packet.why_still or self._held:
            self._halt(packet.why_still, packet.q)
        self._heard(packet.q, now_s)

    def _hear_old(self, packet: ControllerPacket, newest: ControllerPacket, now_s: float) -> None:
        """Take a packet that is not newer than the newest: a late one, the same again, or those of a new start.

        None is answered: after a new start the arm may stand elsewhere, and the old goal must not pull it back.
        """
        self.counts.repeated += 1
        self._heard_s = now_s
        self._behind = self._behind + 1 if packet.sequence > self._behind_sequence else 0
        self._behind_sequence = packet.sequence
        if packet.tm_ms > newest.tm_ms or self._behind >= RESTART_PACKETS:
            self._lose("its controller, or EGM on it, has started anew")

    def _answer(self, sender: tuple[str, int]) -> None:
        tm_ms = int(self._clock.now_s() / MS)
        if self.takes_poses:
            data = answer_pose(self._answers, tm_ms, self._poses.take())
        else:
            data = answer_joints(self._answers, tm_ms, self._goals.take())
        self._answers += 1
        with contextlib.suppress(OSError):  # a controller that is gone is told by its silence
            self._socket.sendto(data, sender)

    def _hold(self) -> None:
        super()._hold()
        self._poses.hold()

    def _rebase(self, q: Array) -> None:
        super()._rebase(q)
        if self._last is not None and self._last.T_base_flange is not None:
            self._poses.start(self._last.T_base_flange)

    def _off(self, reading: JointReading) -> float:
        packet = self._last
        if not self.takes_poses or packet is None or packet.T_base_flange is None:
            return super()._off(reading)
        way_m, turn = between(packet.T_base_flange, self._poses.sent)
        return float(max(np.abs(way_m).max(), np.abs(turn).max()))


def _port(device: str) -> int:
    """Return the UDP port that a person gave."""
    if device.isascii() and device.isdigit() and 0 < int(device) < 65536:
        return int(device)
    raise UsageError(f"{device!r} is no UDP port", consequence="There is no robot", cure="Give for instance egm:6510")


def _each(values: list[float] | None, otherwise: float, n: int) -> Array:
    """Return one value for each joint, (n,)."""
    if values is None:
        return np.full(n, otherwise)
    if len(values) != n:
        raise UsageError(f"{len(values)} joint limits are given for {n} joints", cure=f"Give {n}")
    return np.array(values, dtype=float)
