"""What a person may set for an RSI link, and what the controller's own RSI Ethernet file says."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, ClassVar, Literal

from pydantic import Field

from armsight._files import read_file
from armsight.drivers.link_settings import Positive
from armsight.drivers.udp import UdpSettings
from armsight.errors import BadFile

JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6")
POSE = ("X", "Y", "Z", "A", "B", "C")

LARGEST_FILE = 100_000
"""Bytes of an RSI Ethernet file at most; KUKA's own examples have 3000."""


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
