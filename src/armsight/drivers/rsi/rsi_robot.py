"""A robot of KUKA behind the Robot Sensor Interface."""

from __future__ import annotations

import math
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.clock import Clock
from armsight.drivers.goals import between
from armsight.drivers.link_settings import Positive, UdpSettings
from armsight.drivers.rsi.messages import RobMessage, RsiTags, answer, correction, parse, read_tags
from armsight.drivers.udp import NEW_SESSION_CYCLES, Sender, UdpRobot
from armsight.errors import DeviceFailed, UsageError
from armsight.units import DEG, MS

CORRECTED_RAD = 0.1 * DEG
"""Joints farther from their set point than this at rest stand under another program's correction."""


class RsiSettings(UdpSettings):
    """Settings of an RSI link, beside those of every link by UDP.

    rsi_config: the controller's RSI Ethernet XML file, whose Sen type and tags are used. cycle_s: 0.004 (IPO_FAST) or
    0.012 (IPO). guidance: joint (AK) or pose (RKorr); left out, what the file takes, joints first. late_limit: late
    packets after which the controller ends RSI, its ETHERNET object's Timeout, or more. silent_s: silence after which
    the link is lost; left out, as long as late_limit cycles.
    """

    link: ClassVar[str] = "the RSI link"

    rsi_config: Path | None = None
    guidance: Literal["joint", "pose"] | None = None
    late_limit: Annotated[int, Field(ge=1)] = 100
    silent_s: Positive | None = None
    lower_rad: Annotated[list[float], Field(min_length=6, max_length=6)] | None = None
    upper_rad: Annotated[list[float], Field(min_length=6, max_length=6)] | None = None


class RsiRobot(UdpRobot[RobMessage]):
    """An arm that sends Rob messages to this computer's UDP port and takes Sen messages back.

    device: the UDP port. settings: see RsiSettings. Corrections are absolute: from where RSI was started. Raises
    UsageError for a port or a setting that cannot be, BadFile for the RSI Ethernet file.
    """

    scheme, usual_port = "rsi", 49152
    guided_by = "let RSI on the controller take AK corrections"
    to_begin = "Give this computer's address and port in the RSI Ethernet file, and start RSI on the controller"

    def __init__(self, device: str, *, settings: Mapping[str, Any] | None = None, clock: Clock | None = None) -> None:
        kept = self.settings = RsiSettings.checked(settings)
        self.tags = RsiTags() if kept.rsi_config is None else read_tags(kept.rsi_config)
        # the controller ends RSI after so many late packets; until then it only holds
        silent_s = kept.late_limit * kept.cycle_s if kept.silent_s is None else kept.silent_s
        super().__init__(device, kept, n=6, silent_s=silent_s, guidance=self._guidance(), clock=clock)
        self._start_q: Array | None = None
        self._start_pose: RigidTransform | None = None
        self._answered_ipoc: int | None = None

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

    def _begin(self) -> None:
        self._refusal = ""
        self._set_point_tells = False  # that joints are away from their set point by the correction in force
        self._obeyed = False
        self._first_late: int | None = None
        self._late_when_answered: int | None = None

    def _not_opened(self) -> DeviceFailed:
        if self._refusal:
            return DeviceFailed(
                self._refusal,
                consequence="The robot is not opened: an answer from zero on would pull the arm back",
                cure="End RSI on the controller and start it again",
            )
        return super()._not_opened()

    def _deaf(self, answers: int) -> tuple[str, str] | None:
        if self._obeyed or self._answers < answers or self._late_when_answered is None:
            return None
        return (
            f"its controller takes none of our answers: its Delay counted every one of {self._answers}",
            f"The Sen type ({self.tags.sen_type}) or the tags ({self.tags.joint}, {self.tags.pose}) are not its own: "
            "give its RSI Ethernet file (--rsi-config). Where they are, each answer comes after its cycle: connect "
            "this computer to it without a network between",
        )

    def _decode(self, data: bytes) -> RobMessage:
        return parse(data)

    def _cycles_between(self, last: RobMessage, state: RobMessage) -> int:
        ahead_ms = state.ipoc - last.ipoc
        return max(round(ahead_ms * MS / self.cycle_s), 1) if ahead_ms > 0 else min(ahead_ms, 0)

    def _stamp(self, state: RobMessage) -> tuple[float, int]:
        return state.ipoc * MS, 0

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
        if _uncorrected(message) is False:
            self._refusal = f"{self.name} stands away from its set point, under another program's correction"
            return False
        self._start_q, self._start_pose = message.q, message.T_base_flange
        return True

    def _taken(self, state: RobMessage) -> bool:
        """Tell whether the answer given last was in time."""
        late = self._late_since(state)
        self._obeyed = self._obeyed or (late is not None and late < 1)
        return late is None or late < 1

    def _check_session(self, state: RobMessage, last: RobMessage) -> None:
        """Begin anew where a state is of another session.

        A session that goes on has counted all cycles since as late, and the joints are away from their set point by
        the correction. In a new one the correction of before would pull the arm, and none would where it is in force
        still: where it cannot be told, the link is lost, and nothing is sent.
        """
        corrects = self._corrects()
        gone = corrects and self._set_point_tells and _uncorrected(state) is True
        restarted = state.n_late is not None and last.n_late is not None and state.n_late < last.n_late
        if not restarted:
            late = self._late_since(state)
            counted = late is not None and late >= 0
            if self._unheard_s() <= NEW_SESSION_CYCLES * self.cycle_s or (counted and not gone):
                return
        why = "RSI on its controller has started anew"
        if corrects and not gone:
            self._lose(f"{why}, or may have")
            return
        if restarted or gone:
            self._stop_moved(why)
        self._start_q, self._start_pose = state.q, state.T_base_flange
        self._rebase(state.q)

    def _corrects(self) -> bool:
        """Tell whether a correction is in force."""
        if self.takes_poses and self._start_pose is not None:
            return bool(np.concatenate(between(self._start_pose, self._poses.sent)).any())
        return bool((self._goals.sent != self._start_q).any())

    def _late_since(self, state: RobMessage) -> int | None:
        """Return how many answers were late since the last one, and that one, beyond the cycles that had none.

        0: the last was in time. None where the controller does not tell.
        """
        if self._late_when_answered is None or state.n_late is None or self._answered_ipoc is None:
            return None
        without = max(round((state.ipoc - self._answered_ipoc) * MS / self.cycle_s), 1) - 1
        return state.n_late - self._late_when_answered - without

    def _hear(self, state: RobMessage) -> None:
        if state.n_late is not None:
            self._first_late = state.n_late if self._first_late is None else self._first_late
            self.counts.late = max(0, state.n_late - self._first_late)
        self._set_point_tells |= self._corrects() and _uncorrected(state) is False

    def _hear_old(self, state: RobMessage, newest: RobMessage, sender: Sender) -> None:
        """Answer the same once more as before, for a controller that waits.

        After a new start none is answered: the arm may stand elsewhere, and the old correction must not pull it.
        """
        if state.ipoc == newest.ipoc:
            self._answer(state, sender)
            return
        if self._restarted(state.ipoc, newest.ipoc, round(self.cycle_s / MS)):
            self._lose("its controller, or RSI on it, has started anew (IPOC went back)")

    def _encode(self, state: RobMessage) -> bytes | None:
        if self._lost or self._start_q is None:
            return None
        if self.takes_poses and self._start_pose is not None:
            return answer(self.tags, state.ipoc, pose=correction(self._start_pose, self._poses.sent))
        return answer(self.tags, state.ipoc, joint_deg=np.degrees(self._goals.sent - self._start_q))

    def _answered(self, state: RobMessage) -> None:
        self._answered_ipoc, self._late_when_answered = state.ipoc, state.n_late


def _uncorrected(message: RobMessage) -> bool | None:
    """Tell whether the joints are at their set point, so that no correction is in force; None where it is not told."""
    return None if message.q_set is None else float(np.abs(message.q - message.q_set).max()) <= CORRECTED_RAD
