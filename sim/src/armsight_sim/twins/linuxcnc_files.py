"""What a LinuxCNC without a screen is started from: INI, HAL and NML files of an arm in Craig's convention."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from armsight.errors import UsageError
from armsight_sim.twins.base import HOME

JOINTS = 6
"""genserkins holds so many: parameters A-0 to A-5."""

SPEED_RAD_S = math.radians(30.0)
"""Speed of a joint whose file states none: that of LinuxCNC's own Puma."""

SPEED_UP_S = 0.15
"""Every joint comes to its speed within so long: 200 degrees/s2 at 30 degrees/s."""

RANGE_RAD = 2.0 * math.pi
"""Half the range of a joint whose file states none."""

OFFSETS = 0.5
"""Share of an axis' speed and acceleration that is its external offset's; programs have the rest."""

ANGLE = 1e-9
"""An angle so small, in rad, is zero: arms that were written in another convention carry rounding."""

STATUS_SPARE = 0.999
"""A start position keeps within so much of a range: on its very end LinuxCNC refuses to jog."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Row:
    """One joint in LinuxCNC's units: genserkins' lengths in mm and twist in rad; range, speed, start in degrees."""

    a_mm: float
    alpha_rad: float
    d_mm: float
    lower_deg: float
    upper_deg: float
    speed_deg_s: float
    home_deg: float

    @property
    def acceleration_deg_s2(self) -> float:
        """Its acceleration."""
        return self.speed_deg_s / SPEED_UP_S


def rows_of(mapping: Mapping[str, Any]) -> tuple[Row, ...]:
    """Return the joints of arm.yaml's structure. Raises UsageError for what genserkins cannot hold."""
    joints = mapping["joints"]
    if mapping.get("convention", "standard") != "craig":
        raise _refused("it is not in Craig's convention", "Convert it: armsight convert arm")
    if len(joints) != JOINTS:
        raise _refused(f"it has {len(joints)} joints, and genserkins {JOINTS}", f"Give an arm of {JOINTS} joints")
    return tuple(_row(i, joint) for i, joint in enumerate(joints))


def _row(i: int, joint: Mapping[str, Any]) -> Row:
    name = joint["name"]
    if joint.get("type") == "prismatic":
        raise _refused(f"joint {name} is linear, and genserkins' joints turn", "Give an arm of turning joints")
    if abs(offset_rad := float(joint.get("theta_rad") or 0.0)) > ANGLE:
        raise _refused(
            f"joint {name} has theta_rad {offset_rad:.6g}, and genserkins has no offset of a joint",
            "Count that joint from where its x axes are parallel, as its controller does, so that theta_rad is 0",
        )
    odd = [key for key in ("beta_rad", "coupled") if joint.get(key)] + ["sign"] * (joint.get("sign", 1) != 1)
    if odd:
        raise _refused(
            f"joint {name} has {', '.join(odd)}, which genserkins cannot hold", "Give nominal lengths and angles"
        )
    lower, upper = _or(joint.get("lower"), -RANGE_RAD), _or(joint.get("upper"), RANGE_RAD)
    low, high = STATUS_SPARE * lower, STATUS_SPARE * upper
    return Row(
        a_mm=1000.0 * float(joint.get("a_m") or 0.0),
        alpha_rad=float(joint.get("alpha_rad") or 0.0),
        d_mm=1000.0 * float(joint.get("d_m") or 0.0),
        lower_deg=math.degrees(lower),
        upper_deg=math.degrees(upper),
        speed_deg_s=math.degrees(_or(joint.get("max_speed"), SPEED_RAD_S)),
        home_deg=math.degrees(min(max(HOME[i], min(low, high)), max(low, high))),
    )


def _refused(why: str, cure: str) -> UsageError:
    return UsageError(f"LinuxCNC cannot be started with this arm: {why}", consequence="There is no twin", cure=cure)


def _or(value: Any, otherwise: float) -> float:
    return otherwise if value is None else float(value)


HEAD = """\
[EMC]
VERSION = 1.1
MACHINE = armsight-twin
DEBUG = 0
NML_FILE = linuxcnc.nml
[KINS]
JOINTS = {joints}
KINEMATICS = genserkins
[HAL]
HALUI = halui
{hal_files}
[RS274NGC]
PARAMETER_FILE = linuxcnc.var
[DISPLAY]
DISPLAY = {display}
PROGRAM_PREFIX = .
[EMCMOT]
EMCMOT = motmod
COMM_TIMEOUT = 1.0
SERVO_PERIOD = {servo_ns}
[TASK]
TASK = milltask
CYCLE_TIME = 0.010
[TRAJ]
COORDINATES = X Y Z A B C
LINEAR_UNITS = mm
ANGULAR_UNITS = deg
DEFAULT_LINEAR_VELOCITY = 20.0
MAX_LINEAR_VELOCITY = 250.0
DEFAULT_LINEAR_ACCELERATION = {linear:.9g}
MAX_LINEAR_ACCELERATION = {linear:.9g}
MAX_ANGULAR_VELOCITY = {fastest:.9g}
[EMCIO]
EMCIO = io
CYCLE_TIME = 0.100
TOOL_TABLE = linuxcnc.tbl
"""

AXIS = """\
[AXIS_{letter}]
MAX_VELOCITY = {speed:.9g}
MAX_ACCELERATION = {acceleration:.9g}
MIN_LIMIT = -{most}
MAX_LIMIT = {most}
OFFSET_AV_RATIO = {offsets}
"""

JOINT = """\
[JOINT_{number}]
TYPE = ANGULAR
MAX_VELOCITY = {row.speed_deg_s:.9g}
MAX_ACCELERATION = {row.acceleration_deg_s2:.9g}
MIN_LIMIT = {row.lower_deg:.9g}
MAX_LIMIT = {row.upper_deg:.9g}
HOME = {row.home_deg:.9g}
HOME_OFFSET = {row.home_deg:.9g}
HOME_SEARCH_VEL = 0
HOME_LATCH_VEL = 0
HOME_SEQUENCE = 0
"""


def ini(rows: tuple[Row, ...], *, servo_ns: int, display: str, hal_files: tuple[str, ...]) -> str:
    """Return the INI file; display: the program that stands in the screen's place."""
    fastest = max(row.speed_deg_s for row in rows)
    hardest = max(row.acceleration_deg_s2 for row in rows)
    head = HEAD.format(
        joints=len(rows),
        hal_files="\n".join(f"HALFILE = {name}" for name in hal_files),
        display=display,
        servo_ns=servo_ns,
        linear=max(1000.0, hardest),  # it limits the jogs of turning joints, too
        fastest=fastest,
    )
    kinds = [(250.0, 1000.0, 10000)] * 3 + [(fastest, hardest, 3600)] * 3
    axes = [
        AXIS.format(
            letter=letter,
            speed=speed / (1.0 - OFFSETS),
            acceleration=acceleration / (1.0 - OFFSETS),
            most=most,
            offsets=OFFSETS,
        )
        for letter, (speed, acceleration, most) in zip("XYZABC", kinds, strict=True)
    ]
    return "".join([head, *axes, *(JOINT.format(number=i, row=row) for i, row in enumerate(rows))])


def machine_hal(rows: tuple[Row, ...]) -> str:
    """Return the HAL file of the machine itself: kinematics, motion, and motors that are where they are told to be."""
    lines = [
        "loadrt [KINS]KINEMATICS",
        "loadrt [EMCMOT]EMCMOT servo_period_nsec=[EMCMOT]SERVO_PERIOD num_joints=[KINS]JOINTS",
        "addf motion-command-handler servo-thread",
        "addf motion-controller servo-thread",
        "net estop-loop iocontrol.0.user-enable-out => iocontrol.0.emc-enable-in",
        "net tool-prepare iocontrol.0.tool-prepare => iocontrol.0.tool-prepared",
        "net tool-change iocontrol.0.tool-change => iocontrol.0.tool-changed",
    ]
    for i, row in enumerate(rows):
        lines += [
            f"setp genserkins.A-{i} {row.a_mm:.9g}",
            f"setp genserkins.ALPHA-{i} {row.alpha_rad:.12g}",
            f"setp genserkins.D-{i} {row.d_mm:.9g}",
            f"net motor-{i} joint.{i}.motor-pos-cmd => joint.{i}.motor-pos-fb",
        ]
    return "\n".join(lines) + "\n"


def without_tcp(nml: str) -> str:
    """Return an NML file without TCP ports: LinuxCNC then listens at none. Its own is 5005, on every network."""
    return re.sub(r"[ \t]+TCP=\d+", "", nml)
