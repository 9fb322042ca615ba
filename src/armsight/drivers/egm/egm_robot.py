"""A robot of ABB behind Externally Guided Motion."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Annotated, Any, ClassVar, Literal

from pydantic import Field

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.drivers.controller_clock import ControllerClock
from armsight.drivers.egm.packets import ControllerPacket, answer_joints, answer_pose, parse
from armsight.drivers.goals import GivenGoals
from armsight.drivers.link_settings import Positive, UdpSettings
from armsight.drivers.udp import Sender, UdpRobot
from armsight.units import MS


class EgmSettings(UdpSettings):
    """Settings of an EGM link, beside those of every link by UDP.

    cycle_s: EGMActJoint's and EGMActPose's SampleRate. joints: how many the arm has. guidance: what the controller's
    program runs, EGMRunJoint or EGMRunPose. silent_s: silence after which the link is lost, CommTimeout of EGMSetupUC.
    """

    link: ClassVar[str] = "the EGM link"

    joints: Annotated[int, Field(ge=1, le=12)] = 6
    guidance: Literal["joint", "pose"] = "joint"
    silent_s: Positive = 1.0


class EgmRobot(UdpRobot[ControllerPacket]):
    """An arm that sends EgmRobot packets to this computer's UDP port and takes EgmSensor packets back.

    device: the UDP port. settings: see EgmSettings. Raises UsageError for a port or a setting that cannot be.
    """

    scheme, usual_port = "egm", 6510
    guided_by = "set guidance to joint and run EGMRunJoint on the controller"
    to_begin = "Give this computer's address and port to the controller (UDPUC device) and start its EGM program"

    def __init__(self, device: str, *, settings: Mapping[str, Any] | None = None, clock: Clock | None = None) -> None:
        kept = self.settings = EgmSettings.checked(settings)
        super().__init__(device, kept, n=kept.joints, silent_s=kept.silent_s, guidance=kept.guidance, clock=clock)
        self._given = GivenGoals()
        self._number = 0
        self._controller_clock = ControllerClock(kept.cycle_s, numbered=True)

    def _rebase(self, q: Array) -> None:
        super()._rebase(q)
        self._given.start()

    def _decode(self, data: bytes) -> ControllerPacket:
        return parse(data, self.n_joints)

    def _cycles_between(self, last: ControllerPacket, state: ControllerPacket) -> int:
        return state.sequence - last.sequence

    def _check_session(self, state: ControllerPacket, last: ControllerPacket) -> None:
        """Begin anew where the controller had no answer for its CommTimeout: it has ended the guidance by then."""
        if self._unheard_s() > self._times.silent_s:
            self._begin_anew("EGM on its controller has started anew meanwhile", state.q)

    def _stamp(self, state: ControllerPacket) -> tuple[float, int]:
        return state.tm_ms * MS, state.sequence

    def _taken(self, state: ControllerPacket) -> bool:
        taken = self._given.taken(state.T_planned if self.takes_poses else state.q_planned)
        self.counts.late += not taken
        return taken

    def _hear(self, state: ControllerPacket) -> None:
        if state.why_still or self._held:
            self._halt(state.why_still, state.q)

    def _hear_old(self, state: ControllerPacket, newest: ControllerPacket, sender: Sender) -> None:
        """Note a link that has started anew.

        None is answered: after a new start the arm may stand elsewhere, and the old goal must not pull it back.
        """
        if state.tm_ms > newest.tm_ms or self._restarted(state.sequence, newest.sequence, 1):
            self._lose("its controller, or EGM on it, has started anew")

    def _encode(self, state: ControllerPacket) -> bytes:
        tm_ms = int(self._clock.now_s() / MS)
        q, pose = self._goals.sent, self._poses.sent
        self._given.give(pose if self.takes_poses else q)
        data = answer_pose(self._number, tm_ms, pose) if self.takes_poses else answer_joints(self._number, tm_ms, q)
        self._number += 1
        return data
