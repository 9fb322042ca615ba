"""A robot of ABB behind Externally Guided Motion."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from armsight.clock import Clock, SystemClock
from armsight.drivers.cyclic import LinkTimes
from armsight.drivers.egm.packets import ControllerPacket, answer_joints, answer_pose, parse
from armsight.drivers.egm.settings import EgmSettings, egm_settings
from armsight.drivers.given_goals import GivenGoals
from armsight.drivers.joint_goals import JointLimits
from armsight.drivers.udp import RESTART_PACKETS, Sender, UdpRobot, udp_port
from armsight.errors import DeviceFailed, DeviceNotFound, Inconsistent, UsageError
from armsight.units import MS

Array = NDArray[np.float64]


class EgmRobot(UdpRobot[ControllerPacket]):
    """An arm that sends EgmRobot packets to this computer's UDP port and takes EgmSensor packets back.

    device: the UDP port. settings: see EgmSettings. Raises UsageError for a port or a setting that cannot be.
    """

    guided_by = "set guidance to joint and run EGMRunJoint on the controller"

    def __init__(self, device: str, *, settings: Mapping[str, Any] | None = None, clock: Clock | None = None) -> None:
        self.settings: EgmSettings = egm_settings(settings or {})
        n = self.settings.joints
        limits = JointLimits(
            lower=_each(self.settings.lower_rad, -math.inf, n),
            upper=_each(self.settings.upper_rad, math.inf, n),
            max_speed=np.full(n, self.settings.max_speed_rad_s),
        )
        times = LinkTimes(cycle_s=self.settings.cycle_s, stale_s=self.settings.stale_s, silent_s=self.settings.silent_s)
        super().__init__(
            f"egm:{device}",
            udp_port(device, "egm:6510"),
            self.settings,
            limits=limits,
            times=times,
            clock=clock or SystemClock(),
        )
        self.takes_poses = self.settings.guidance == "pose"
        self._given = GivenGoals()
        self._answers = 0

    def _begin(self) -> None:
        self._behind_sequence = -1

    def _rebase(self, q: Array) -> None:
        super()._rebase(q)
        self._given.start()

    def _not_opened(self, nobody: str) -> DeviceFailed:
        return DeviceNotFound(
            nobody,
            consequence="The robot is not opened",
            cure="Give this computer's address and port to the controller (UDPUC device) and start its EGM program",
        )

    def _parse(self, data: bytes) -> ControllerPacket:
        packet = parse(data, self.n_joints)
        if self.takes_poses and packet.T_base_flange is None:
            raise Inconsistent("a packet has no measured pose")
        return packet

    def _cycles_between(self, last: ControllerPacket, state: ControllerPacket) -> int:
        return state.sequence - last.sequence

    def _taken(self, state: ControllerPacket) -> bool:
        taken = self._given.taken(state.T_planned if self.takes_poses else state.q_planned)
        self.counts.late += not taken
        return taken

    def _hear(self, state: ControllerPacket) -> None:
        self._behind_sequence = -1
        if state.why_still or self._held:
            self._halt(state.why_still, state.q)
        self._heard(state.q, self._clock.now_s())

    def _hear_old(self, state: ControllerPacket, newest: ControllerPacket, sender: Sender) -> None:
        """Note a link that has started anew.

        None is answered: after a new start the arm may stand elsewhere, and the old goal must not pull it back.
        """
        self._behind = self._behind + 1 if state.sequence > self._behind_sequence else 0
        self._behind_sequence = state.sequence
        if state.tm_ms > newest.tm_ms or self._behind >= RESTART_PACKETS:
            self._lose("its controller, or EGM on it, has started anew")

    def _answer(self, state: ControllerPacket, sender: Sender) -> None:
        tm_ms = int(self._clock.now_s() / MS)
        q, pose = self._goals.sent, self._poses.sent
        self._given.give(pose if self.takes_poses else q)
        data = answer_pose(self._answers, tm_ms, pose) if self.takes_poses else answer_joints(self._answers, tm_ms, q)
        self._answers += 1
        with contextlib.suppress(OSError):  # a controller that is gone is told by its silence
            self._socket.sendto(data, sender)


def _each(values: list[float] | None, otherwise: float, n: int) -> Array:
    """Return one value for each joint, (n,)."""
    if values is None:
        return np.full(n, otherwise)
    if len(values) != n:
        raise UsageError(f"{len(values)} joint limits are given for {n} joints", cure=f"Give {n}")
    return np.array(values, dtype=float)
