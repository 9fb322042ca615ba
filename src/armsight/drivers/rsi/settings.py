"""What a person may set for an RSI link, and what the controller's own RSI Ethernet file says."""

from __future__ import annotations

import math
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from armsight._files import read_file
from armsight.errors import BadFile, UsageError

Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False)]

JOINTS = ("A1", "A2", "A3", "A4", "A5", "A6")
POSE = ("X", "Y", "Z", "A", "B", "C")

LARGEST_FILE = 100_000
"""Bytes of an RSI Ethernet file at most; KUKA's own examples have 3000."""


class RsiSettings(BaseModel):
    """Settings of an RSI link.

    rsi_config: the controller's RSI Ethernet XML file, whose Sen type and tags are used. cycle_s: 0.004 (IPO_FAST) or
    0.012 (IPO). guidance: joint (AK) or pose (RKorr); left out, what the file takes, joints first. late_limit: late
    packets after which the controller ends RSI, its ETHERNET object's Timeout, or more. stale_s: age of a reading that
    is stale. silent_s: silence after which the link is lost; left out, as long as late_limit cycles. controller: the
    only address that is listened to; empty: the first that speaks. bind: the own address to listen at.
    max_speed_rad_s, lower_rad, upper_rad: of each joint; speed_m_s, speed_rad_s: of the flange in pose guidance.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    rsi_config: Path | None = None
    cycle_s: Positive = 0.004
    guidance: Literal["joint", "pose"] | None = None
    late_limit: Annotated[int, Field(ge=1)] = 100
    stale_s: Positive = 0.02
    silent_s: Positive | None = None
    controller: str = ""
    bind: str = "0.0.0.0"
    open_s: Positive = 5.0
    max_speed_rad_s: Positive = math.pi / 3
    lower_rad: Annotated[list[float], Field(min_length=6, max_length=6)] | None = None
    upper_rad: Annotated[list[float], Field(min_length=6, max_length=6)] | None = None
    speed_m_s: Positive = 0.1
    speed_rad_s: Positive = math.pi / 3


@dataclass(frozen=True, slots=True, kw_only=True)
class RsiTags:
    """Names in the two messages: Sen's type, the element of joint and of Cartesian corrections, what is sent."""

    sen_type: str = "ImFree"
    joint: str = "AK"
    pose: str = "RKorr"
    sends_pose: bool = True


def rsi_settings(values: Mapping[str, Any]) -> RsiSettings:
    """Return checked settings. Raises UsageError that names the wrong key."""
    try:
        return RsiSettings.model_validate(dict(values))
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"])
        raise UsageError(
            f"the setting {key!r} of the RSI link cannot be: {first['msg']}",
            consequence="The robot is not opened",
            cure=f"Known are: {', '.join(RsiSettings.model_fields)}",
        ) from error


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
