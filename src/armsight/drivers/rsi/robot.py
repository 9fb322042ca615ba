"""A robot of KUKA behind the Robot Sensor Interface."""

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
from armsight.drivers.joint_goals import JointLimits
from armsight.drivers.pose_goals import PoseGoals, between
from armsight.drivers.robot import Sent
from armsight.drivers.rsi.messages import RobMessage, answer, correction, parse
from armsight.drivers.rsi.settings import RsiSettings, RsiTags, read_tags, rsi_settings
from armsight.errors import DeviceFailed, DeviceLost, DeviceNotFound, Inconsistent, UsageError
from armsight.records import JointReading
from armsight.units import DEG, MS

Array = NDArray[np.float64]

STALE_CYCLES = 3.5
"""A reading older than so many cycles is stale: two packets in a row may be late, a third is a fault."""

SILENT_CYCLES = 9.0
"""A link that was silent for so many cycles is lost, and stays so until it is opened again."""

LARGEST_PACKET = 4096
"""Bytes of a packet at most: a Rob message has about 600."""

LARGEST_SPEED_RAD_S = 60.0
"""No joint of a robot moves so fast: a reading that says so is refused."""

JUMP_CYCLES = 3
"""Over so many missed cycles a joint may have moved before its reading is refused."""

RESTART_PACKETS = 3
"""So many packets in a row, older than the newest, are those of a controller that has started anew."""

CORRECTED_RAD = 0.1 * DEG
"""Joints farther from their set point than this at rest stand under another program's correction."""


@dataclass(slots=True)
class RsiCounts:
    """Packets since the link was opened.

    heard: good ones. missed: cycles whose packet never came. repeated: with an IPOC that was there. refused: that are
    no state. foreign: of another sender. late: answers that the controller counted as late (its Delay).
    """

    heard: int = 0
    missed: int = 0
    repeated: int = 0
    refused: int = 0
    foreign: int = 0
    late: int = 0


class RsiRobot(CyclicRobot):
    """An arm that sends Rob messages to this computer's UDP port and takes Sen messages back.

    device: the UDP port. settings: see RsiSettings. Corrections are absolute: from where RSI was started. Raises
    UsageError for a port or a setting that cannot be, BadFile for the RSI Ethernet file.
    """

    def __init__(self, device: str, *, settings: Mapping[str, Any] | None = None, clock: Clock | None = None) -> None:
        self.settings: RsiSettings = rsi_settings(settings or {})
        self.tags = RsiTags() if self.settings.rsi_config is None else read_tags(self.settings.rsi_config)
        self.port = _port(device)
        limits = JointLimits(
            lower=np.array(self.settings.lower_rad or [-math.inf] * 6),
            upper=np.array(self.settings.upper_rad or [math.inf] * 6),
            max_speed=np.full(6, self.settings.max_speed_rad_s),
        )
        cycle_s = self.settings.cycle_s
        times = LinkTimes(cycle_s=cycle_s, stale_s=STALE_CYCLES * cycle_s, silent_s=SILENT_CYCLES * cycle_s)
        super().__init__(f"rsi:{device}", limits=limits, times=times, clock=clock or SystemClock())
        self.takes_poses = self._guidance() == "pose"
        self._poses = PoseGoals(self.name, self.settings.speed_m_s, self.settings.speed_rad_s, self.cycle_s)
        self.counts = RsiCounts()
        self._last: RobMessage | None = None
        self._start_q: Array | None = None
        self._start_pose: RigidTransform | None = None
        self._answered_ipoc: int | None = None

    def step_joints(self, step: Array) -> Sent:
        """Move on by step (6,) in rad; in pose guidance only a step of zeros, which asks for nothing."""
        if not self.takes_poses:
            return super().step_joints(step)
        with self._lock:
            reading = self._ready()
            if np.shape(step) != (6,) or np.any(step):  # not a number is not zero
                raise UsageError(
                    f"{self.name} is guided by poses",
                    consequence="Nothing was sent",
                    cure="Send poses, or let RSI on the controller take AK corrections",
                )
            return self._note(reading.q, self._poses.next, ())

    def move_pose(self, T_base_flange: RigidTransform) -> Sent:
        """Move towards a pose of the flange in the controller's base frame, as far as one cycle allows.

        The joint values of the answer are those read last: only the controller knows which belong to the pose.
        """
        if not self.takes_poses:
            return super().move_pose(T_base_flange)
        with self._lock:
            reading = self._ready()
            message = self._last
            if message is None or message.T_base_flange is None:
                raise DeviceLost(f"{self.name} tells no pose", consequence="Nothing was sent")
            pose, limited = self._poses.go(T_base_flange, message.T_base_flange)
            return self._note(reading.q, pose, limited)

    def _guidance(self) -> str:
        guidance = self.settings.guidance or ("joint" if self.tags.joint else "pose")
        if not getattr(self.tags, guidance):
            raise UsageError(
                f"the RSI Ethernet file takes no {guidance} corrections",
                consequence="The robot cannot be moved so",
                cure="Choose the other guidance, or add them under RECEIVE",
            )
        if guidance == "pose" and not self.tags.sends_pose:
            raise UsageError("the RSI Ethernet file does not send DEF_RIst", cure="Add it under SEND")
        return guidance

    def _start(self) -> None:
        self.counts = RsiCounts()
        self._last, self._refusal = None, ""
        self._behind = 0
        self._first_late: int | None = None
        self._sender: tuple[str, int] | None = None
        self._closing = False
        self._socket = self._bind()
        self._first = threading.Event()
        self._thread = threading.Thread(target=self._run, name=self.name, daemon=True)
        self._thread.start()
        if not self._first.wait(self.settings.open_s):
            self._finish()
            raise self._not_opened()

    def _not_opened(self) -> DeviceFailed:
        if self._refusal:
            return DeviceFailed(
                self._refusal,
                consequence="The robot is not opened: an answer from zero on would pull the arm back",
                cure="End RSI on the controller and start it again",
            )
        wrong = f" ({self.counts.refused} packets were no RSI state)" if self.counts.refused else ""
        return DeviceNotFound(
            f"no controller has sent to UDP port {self.port} within {self.settings.open_s:g} s{wrong}",
            consequence="The robot is not opened",
            cure="Give this computer's address and port in the RSI Ethernet file, and start RSI on the controller",
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
                    self._lose("its controller has fallen silent: RSI has ended, or the cable is cut")
                continue
            except OSError:  # a datagram's error report: the next packet tells how it is
                continue
            self._take(data, sender)

    def _take(self, data: bytes, sender: tuple[str, int]) -> None:
        """Take one packet, and answer where it is a good one."""
        if self._sender not in (None, sender) or self.settings.controller not in ("", sender[0]):
            self.counts.foreign += 1
            return
        try:
            message = parse(data)
            self._check(message)
        except Inconsistent:
            self.counts.refused += 1
            return
        if self._last is None and not self._may_begin(message):
            return
        self._sender = sender
        if self._last is not None and message.ipoc <= self._last.ipoc:
            self._hear_again(message, self._last, sender)
            return
        self._hear(message)
        self._answer(message, sender, again=False)
        self.counts.heard += 1
        self._first.set()

    def _may_begin(self, message: RobMessage) -> bool:
        """Note where the corrections begin; False where that cannot be told from this packet.

        Corrections count from the start of RSI. A session that this robot has left holds the last one it was given:
        it is taken up again at once, or not before the controller must have ended it.
        """
        before = self._answered_ipoc
        gap = math.inf if before is None or message.ipoc < before else (message.ipoc - before) * MS / self.cycle_s
        if gap <= 2.0:
            return True
        if gap < self.settings.late_limit:
            self._refusal = f"{self.name} is in the middle of an RSI session that was left"
            return False
        if message.q_set is not None and float(np.abs(message.q - message.q_set).max()) > CORRECTED_RAD:
            self._refusal = f"{self.name} stands away from its set point, under another program's correction"
            return False
        self._start_q, self._start_pose = message.q, message.T_base_flange
        return True

    def _check(self, message: RobMessage) -> None:
        """Raise Inconsistent where a packet contradicts the one before, or lacks what its guidance needs."""
        if self.takes_poses and message.T_base_flange is None:
            raise Inconsistent("a packet has no RIst")
        last = self._last
        if last is not None and message.ipoc > last.ipoc:
            cycles = min(max((message.ipoc - last.ipoc) * MS / self.cycle_s, 1.0), JUMP_CYCLES)
            if float(np.abs(message.q - last.q).max()) > LARGEST_SPEED_RAD_S * cycles * self.cycle_s:
                raise Inconsistent("a packet's joints are where they cannot have come to")

    def _hear(self, message: RobMessage) -> None:
        if self._last is not None:
            self.counts.missed += max(0, round((message.ipoc - self._last.ipoc) * MS / self.cycle_s) - 1)
        self._behind = 0
        self._last = message
        if message.n_late is not None:
            self._first_late = message.n_late if self._first_late is None else self._first_late
            self.counts.late = max(0, message.n_late - self._first_late)
        self._heard(message.q, self._clock.now_s())

    def _hear_again(self, message: RobMessage, newest: RobMessage, sender: tuple[str, int]) -> None:
        """Take a packet that is not newer than the newest: the same again, a late one, or those of a new start.

        The same is answered once more as before, for a controller that waits. After a new start none is: the arm may
        stand elsewhere, and the old correction must not pull it.
        """
        self._heard_s = self._clock.now_s()
        if message.ipoc == newest.ipoc:
            self._answer(message, sender, again=True)
            self.counts.repeated += 1
            return
        self.counts.repeated += 1
        self._behind += 1
        if self._behind >= RESTART_PACKETS:
            self._lose("its controller, or RSI on it, has started anew (IPOC went back)")

    def _answer(self, message: RobMessage, sender: tuple[str, int], *, again: bool) -> None:
        if self._lost or self._start_q is None:
            return
        if self.takes_poses and self._start_pose is not None:
            pose = self._poses.sent if again else self._poses.take()
            data = answer(self.tags, message.ipoc, pose=correction(self._start_pose, pose))
        else:
            q = self._goals.sent if again else self._goals.take()
            data = answer(self.tags, message.ipoc, joint_deg=np.degrees(q - self._start_q))
        with contextlib.suppress(OSError):  # a controller that is gone is told by its silence
            self._socket.sendto(data, sender)
            self._answered_ipoc = message.ipoc

    def _hold(self) -> None:
        super()._hold()
        self._poses.hold()

    def _rebase(self, q: Array) -> None:
        super()._rebase(q)
        if self._last is not None and self._last.T_base_flange is not None:
            self._poses.start(self._last.T_base_flange)

    def _off(self, reading: JointReading) -> float:
        message = self._last
        if not self.takes_poses or message is None or message.T_base_flange is None:
            return super()._off(reading)
        way_m, turn = between(message.T_base_flange, self._poses.sent)
        return float(max(np.abs(way_m).max(), np.abs(turn).max()))


def _port(device: str) -> int:
    """Return the UDP port that a person gave."""
    if device.isascii() and device.isdigit() and 0 < int(device) < 65536:
        return int(device)
    raise UsageError(f"{device!r} is no UDP port", consequence="There is no robot", cure="Give for instance rsi:49152")
