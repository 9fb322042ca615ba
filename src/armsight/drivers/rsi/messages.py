"""The two messages of RSI, Rob, the controller's state, and Sen, the answer; what the controller's file says of them.

Millimetres and degrees on the wire.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight._files import read_file
from armsight.arrays import Array
from armsight.drivers.readings import LARGEST_M, LARGEST_RAD
from armsight.errors import BadFile, Inconsistent
from armsight.records import frozen_array
from armsight.units import MM

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
