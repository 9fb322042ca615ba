"""What LinuxCNC tells of its machine when the link is opened: units, limits, and what is wrong there."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from pydantic import BaseModel, Field, ValidationError

from armsight.arrays import Array
from armsight.drivers.goals import JointLimits
from armsight.errors import DeviceFailed, Inconsistent
from armsight.units import DEG, MM

VERSION = 2
"""The bridge's version that this driver speaks to."""

SPEED_SHARE = 0.95
"""Of a joint's MAX_VELOCITY: faster, and LinuxCNC would fall behind without end."""

SPARE = 0.01
"""Goals keep so far within LinuxCNC's ranges, in degrees or mm: on their very end jogs are dropped."""

CONTRADICTS_RAD = math.radians(1.0)
"""Ranges of the arm's file and of the INI that differ by more at one end are of another arm, zero or direction."""

INCH_M = 0.0254

AXES_ONLY = "trivkins"


OFFSET_AXES = "XYZABC"


class AxisOfIni(BaseModel):
    """A joint, or the external offset of an axis, as the INI has it: degrees, or its length unit; speed 0: none."""

    linear: bool
    lower: float
    upper: float
    speed: float = Field(ge=0.0)
    acceleration: float = Field(ge=0.0)


class JointOfIni(AxisOfIni):
    """A joint, which moves."""

    speed: float = Field(gt=0.0)
    acceleration: float = Field(gt=0.0)


class Machine(BaseModel):
    """What the bridge tells of the machine of its INI."""

    bridge: int
    ini: str
    joints: list[JointOfIni]
    offsets: list[AxisOfIni]
    servo_s: float = Field(gt=0.0)
    kinematics: str
    linear_units: str
    angular_units: str
    jog_acceleration: float = Field(gt=0.0)
    listens: bool
    driver: str
    watchdog: bool

    @property
    def in_inches(self) -> bool:
        """Whether lengths are in inches."""
        return self.linear_units.lower() in ("inch", "in", "imperial")

    @property
    def unit(self) -> Array:
        """One of each joint's units (n,) in rad or m."""
        return self._units(self.joints)

    @property
    def offset_unit(self) -> Array:
        """One of each axis' units (6,) in rad or m."""
        return self._units(self.offsets)

    def _units(self, axes: Sequence[AxisOfIni]) -> Array:
        length_m = INCH_M if self.in_inches else MM
        return np.array([length_m if axis.linear else DEG for axis in axes])

    def limits(self) -> JointLimits:
        """Return the ranges and speeds that goals keep, in rad or m."""
        values = np.array([[joint.lower + SPARE, joint.upper - SPARE, joint.speed] for joint in self.joints])
        lower, upper, speed = (values * self.unit[:, None]).T
        return JointLimits(lower=lower, upper=upper, max_speed=SPEED_SHARE * speed)

    def notes(self) -> tuple[str, ...]:
        """Return what is not as it should be there and refuses nothing."""
        capped = [i for i, one in enumerate(self.joints) if self.jog_acceleration < one.acceleration]
        found = []
        if capped:
            found.append(
                f"[TRAJ]DEFAULT_LINEAR_ACCELERATION ({self.jog_acceleration:g}) is below MAX_ACCELERATION of "
                f"{_joints(capped)}, and limits their jogs: raise it to {max(j.acceleration for j in self.joints):g}"
            )
        if self.listens:
            found.append(
                "its NML file opens TCP port 5005 on every network: give [EMC]NML_FILE a copy without TCP=5005"
            )
        if not self.watchdog:
            found.append("its HAL file loads no watchdog: a bridge that dies leaves the machine on")
        return tuple(found)


def parse(data: bytes) -> Machine:
    """Return what the bridge told. Raises DeviceFailed for another version, Inconsistent for what is none."""
    try:
        told: Any = json.loads(data)
        if isinstance(told, dict) and isinstance(told.get("bridge"), int) and told["bridge"] != VERSION:
            raise DeviceFailed(
                f"the bridge beside LinuxCNC is of version {told['bridge']}, and this driver of {VERSION}",
                cure="Copy this version's there: python -m armsight.drivers.linuxcnc INI",
            )
        return Machine.model_validate(told)
    except (ValueError, ValidationError) as error:
        raise Inconsistent(f"what the bridge beside LinuxCNC tells cannot be read: {error}") from error


def check_machine(
    machine: Machine, *, joints: int, cycle_s: float, linear: list[int], units: str, kinematics: str
) -> None:
    """Refuse a machine that is not the one expected. Raises DeviceFailed.

    linear: numbers of the joints that are declared as linear, from 1. units: mm or inch. kinematics: the module that
    is expected, empty for any that is an arm's.
    """
    n = len(machine.joints)
    if n != joints:
        raise _refused(machine, f"has {n} joints, not {joints}", f"Set joints to {n} where that is the arm")
    found = [i for i, one in enumerate(machine.joints) if one.linear]
    if undeclared := sorted(set(found) ^ {i - 1 for i in linear}):
        raise _refused(
            machine,
            f"has {_joints(found) if found else 'no joint'} as TYPE = LINEAR, and not as set here "
            f"({_joints(undeclared)})",
            f"Set linear to {[i + 1 for i in found]}, or correct TYPE in the INI",
        )
    if machine.in_inches != (units == "inch"):
        raise _refused(
            machine,
            f"has [TRAJ]LINEAR_UNITS {machine.linear_units}, not {units}: its kinematics' lengths are taken so",
            "Turn the INI to mm, or set units to inch where its lengths are in inches",
        )
    if machine.angular_units.lower() not in ("deg", "degree", "degrees"):
        raise _refused(machine, f"has [TRAJ]ANGULAR_UNITS {machine.angular_units}", "Set them to deg there")
    if machine.kinematics != (kinematics or machine.kinematics) or (machine.kinematics == AXES_ONLY and not kinematics):
        raise _refused(
            machine,
            f"has [KINS]KINEMATICS {machine.kinematics}"
            + (f", not {kinematics}" if kinematics else ", which takes every joint for an axis of its own: no arm"),
            f"Take the arm's there (genserkins), or set kinematics to {machine.kinematics}: its joints alone are used",
        )
    samples = cycle_s / machine.servo_s
    if round(samples) < 1 or abs(samples - round(samples)) > 1e-3 * samples:
        raise _refused(
            machine,
            f"has a servo period of {1e3 * machine.servo_s:g} ms, of which {1e3 * cycle_s:g} ms are no multiple",
            "Set cycle_s to a multiple of it",
        )


def check_offsets(machine: Machine) -> None:
    """Refuse a machine whose axes' external offsets cannot correct a pose. Raises DeviceFailed."""
    if machine.kinematics == AXES_ONLY or not machine.offsets:
        raise _refused(
            machine,
            f"has {len(machine.joints)} joints of {machine.kinematics}: external offsets correct the pose of an arm of "
            "six joints whose kinematics LinuxCNC has",
            "Leave motion=offsets out",
        )
    missing = [f"AXIS_{axis}" for axis, one in zip(OFFSET_AXES, machine.offsets, strict=True) if one.speed <= 0.0]
    if missing:
        raise _refused(
            machine,
            f"has no OFFSET_AV_RATIO in {', '.join(missing)}, so that its axes take no external offsets",
            f"Add the line OFFSET_AV_RATIO = 0.1 to {', '.join(f'[{name}]' for name in missing)}: a tenth of the axis' "
            "speed and acceleration is then the corrections'",
        )


def check_ranges(machine: Machine, ranges: Array) -> None:
    """Refuse ranges that contradict the INI's: (2, n) in rad, infinite where nothing is said. Raises DeviceFailed."""
    unit = machine.unit
    wrong = []
    for key, given in zip(("lower", "upper"), ranges, strict=True):
        if len(given) != len(unit):
            continue
        told = unit * np.array([getattr(one, key) for one in machine.joints])
        wrong += [
            f"joint {i + 1} {key} {given[i] / unit[i]:.1f} here and {told[i] / unit[i]:.1f} there"
            for i in np.flatnonzero(np.isfinite(given) & (np.abs(given - told) > CONTRADICTS_RAD))
        ]
    if wrong:
        raise _refused(
            machine,
            f"has other ranges than the arm's file: {'; '.join(wrong)}",
            "Make both the same: another range is mostly another zero, direction or arm",
        )


def _joints(which: list[int]) -> str:
    return f"joint{'s' * (len(which) > 1)} {', '.join(str(i + 1) for i in which)}"


def _refused(machine: Machine, why: str, cure: str) -> DeviceFailed:
    return DeviceFailed(f"LinuxCNC with {machine.ini} {why}", cure=cure)
