"""KUKA's Robot Sensor Interface: the controller sends its state as XML over UDP and is answered with a correction.

Millimetres and degrees on the wire.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal
from xml.sax.saxutils import quoteattr

import numpy as np
from pydantic import Field
from scipy.spatial.transform import RigidTransform, Rotation

from armsight._files import read_file
from armsight.arrays import Array
from armsight.clock import Clock
from armsight.drivers.goals import between
from armsight.drivers.link_settings import Positive, UdpSettings
from armsight.drivers.pace import LARGEST_M, LARGEST_RAD
from armsight.drivers.udp import NEW_SESSION_CYCLES, Sender, UdpRobot
from armsight.errors import BadFile, DeviceFailed, Inconsistent, UsageError
from armsight.records import frozen_array
from armsight.units import DEG, MM, MS

JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6")
POSE = ("X", "Y", "Z", "A", "B", "C")

LARGEST_FILE = 100_000
"""Bytes of an RSI Ethernet file at most; KUKA's own examples have 3000."""


@dataclass(frozen=True, slots=True, kw_only=True)
class RsiTags:
    """Names in the two messages: Sen's type, the element of joint and of Cartesian corrections, what is sent."""

    sen_type: str = "ImFree"
    joint: str = "AK"
    pose: str = "RKorr"
    sends_pose: bool = True


def read_tags(path: Path) -> RsiTags:
    """Return what an RSI Ethernet file says. Raises BadFile where it is none, or no corrections can be sent by it."""
    try:
        data = read_file(path, limit=LARGEST_FILE)
        text = data.decode("utf-8-sig")  # here, as in messages.parse
    except UnicodeDecodeError as error:
        raise BadFile(f"{path} is not UTF-8 text", cure="Give the controller's RSI Ethernet file") from error
    except OSError as error:
        raise BadFile(
            f"{path} cannot be read: {error.strerror}", cure="Give the controller's RSI Ethernet file"
        ) from error
    if len(data) > LARGEST_FILE or any(part in text for part in ("<!DOCTYPE", "<!ENTITY", "\0")):
        raise BadFile(f"{path} is no RSI Ethernet file", cure="Give the controller's RSI Ethernet file")
    try:
        root = ET.fromstring(text)
    except (ET.ParseError, ValueError) as error:
        raise BadFile(f"{path} is no XML: {error}", cure="Give the controller's RSI Ethernet file") from error
    return _tags(root, path)


def _tags(root: ET.Element, path: Path) -> RsiTags:
    sent, taken = ([e.get("TAG", "") for e in root.findall(f"{part}/ELEMENTS/ELEMENT")] for part in ("SEND", "RECEIVE"))
    sen_type = (root.findtext("CONFIG/SENTYPE") or "").strip()
    if not (sen_type and sent):
        raise BadFile(f"{path} names no SENTYPE, or sends nothing", cure="Give the controller's RSI Ethernet file")
    if (root.findtext("CONFIG/ONLYSEND") or "").strip().upper() == "TRUE":
        raise BadFile(f"{path} has ONLYSEND TRUE", consequence="The controller takes no answer", cure="Set it to FALSE")
    joint, pose = _group(taken, JOINTS), _group(taken, POSE)
    if not (joint or pose):
        raise BadFile(
            f"{path} takes neither joint (AK.A1 .. AK.A6) nor Cartesian (RKorr.X .. RKorr.C) corrections",
            consequence="The robot cannot be moved",
            cure="Add them under RECEIVE, here and on the controller",
        )
    if "DEF_AIPos" not in sent:
        raise BadFile(
            f"{path} does not send DEF_AIPos", consequence="Joint values are not known", cure="Add it to SEND"
        )
    return RsiTags(sen_type=sen_type, joint=joint, pose=pose, sends_pose="DEF_RIst" in sent)


def _group(tags: list[str], parts: tuple[str, ...]) -> str:
    """Return the name whose parts are all among tags such as AK.A1; empty where there is none."""
    for tag in tags:
        name, dot, part = tag.partition(".")
        if dot and part == parts[0] and all(f"{name}.{other}" in tags for other in parts):
            return name
    return ""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RobMessage:
    """The controller's state: IPOC (its time stamp, in ms on most), joints, set point of the joints, flange, late.

    q (6,): AIPos in rad. q_set (6,): ASPos in rad. T_base_flange: RIst. n_late: Delay, the packets that came late by
    the controller's own count. None where it does not tell.
    """

    ipoc: int
    q: Array
    q_set: Array | None = None
    T_base_flange: RigidTransform | None = None
    n_late: int | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "q", frozen_array("q", self.q, (6,)))


def parse(data: bytes) -> RobMessage:
    """Return the state in one packet. Raises Inconsistent where it is none."""
    try:
        text = data.decode("utf-8")  # here and not by the parser: in another encoding no declaration would be seen,
        if "<!" in text or "\0" in text:  # and zeros make it take the text for one; entities may grow without bound
            raise Inconsistent("a packet declares entities")
        root = ET.fromstring(text)
        if root.tag != "Rob":
            raise Inconsistent("a packet is no Rob message")
        ipoc = (root.findtext("IPOC") or "").strip()
        if re.fullmatch(r"[0-9]{1,18}", ipoc) is None:
            raise Inconsistent("a packet has no IPOC")
        q, q_set, position = (_values(root, *what) for what in (("AIPos", JOINTS), ("ASPos", JOINTS), ("RIst", POSE)))
        delay = root.find("Delay")
        n_late = None if delay is None else int(delay.get("D", ""))
    except (ET.ParseError, ValueError, LookupError) as error:
        raise Inconsistent("a packet is no RSI state") from error
    if q is None:
        raise Inconsistent("a packet has no AIPos")
    return RobMessage(
        ipoc=int(ipoc),
        q=_within(np.radians(q), LARGEST_RAD),
        q_set=None if q_set is None else _within(np.radians(q_set), LARGEST_RAD),
        T_base_flange=None if position is None else pose_of(position),
        n_late=n_late,
    )


def answer(tags: RsiTags, ipoc: int, *, joint_deg: Array | None = None, pose: Array | None = None) -> bytes:
    """Return a Sen message: a correction of the joints (6,) in degrees or of the pose X Y Z A B C in mm and degrees."""
    name, parts, values = (tags.joint, JOINTS, joint_deg) if pose is None else (tags.pose, POSE, pose)
    if values is None or not np.isfinite(values).all():
        raise Inconsistent("a correction is not finite", consequence="Nothing was sent")
    body = " ".join(f'{part}="{value:.6f}"' for part, value in zip(parts, values, strict=True))
    return f"<Sen Type={quoteattr(tags.sen_type)}><{name} {body}/><IPOC>{ipoc}</IPOC></Sen>".encode()


def pose_of(values: Array) -> RigidTransform:
    """Return the pose of X Y Z in mm and A B C in degrees: turns about z, then the new y, then the new x."""
    xyz_m = _within(values[:3] * MM, LARGEST_M)
    return RigidTransform.from_components(xyz_m, Rotation.from_euler("ZYX", values[3:], degrees=True))


def correction(start: RigidTransform, goal: RigidTransform) -> Array:
    """Return X Y Z A B C in mm and degrees that bring the flange from start to goal, way and turn in base axes."""
    way_mm = (np.asarray(goal.translation) - np.asarray(start.translation)) / MM
    turn = (goal.rotation * start.rotation.inv()).as_euler("ZYX", degrees=True)
    return np.concatenate([way_mm, turn])


def _values(root: ET.Element, tag: str, parts: tuple[str, ...]) -> Array | None:
    element = root.find(tag)
    if element is None:
        return None
    return np.array([float(element.attrib[part]) for part in parts])


def _within(values: Array, most: float) -> Array:
    if not all(math.isfinite(value) and abs(value) <= most for value in values):
        raise Inconsistent("a packet holds values that cannot be")
    return values


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
        if self.takes_poses and self._start_pose is not None:
            return bool(np.concatenate(between(self._start_pose, self._poses.sent)).any())
        return bool((self._goals.sent != self._start_q).any())

    def _late_since(self, state: RobMessage) -> int | None:
        """Return how many answers were late since the last one, beyond cycles without; None where it is not told."""
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
