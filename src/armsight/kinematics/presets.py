"""Arms known by name, each with the source of its numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf, pi
from types import MappingProxyType

from armsight.errors import UsageError
from armsight.kinematics.arm import Arm, Joint, JointType
from armsight.units import DEG

PER_M = 1000.0
"""Millimetres in a metre: dividing by it gives the float64 nearest to the printed number."""


def korayem6r() -> Arm:
    """Return the 6R arm of Korayem 2018: geometry of Table 2, motors of Table 3. Limits are not given there."""
    table = (  # a, alpha, d in mm and degrees; stall torque in N m, no-load speed in rad/s
        (36.5, -90, 438.0, 114.0, 1.3),
        (251.5, 0, 0.0, 98.0, 1.04),
        (125.0, 0, 0.0, 382.2, 0.73),
        (92.0, 90, 0.0, 40.4, 0.9),
        (0.0, -90, 0.0, 40.4, 0.9),
        (0.0, 0, 152.8, 40.4, 0.9),
    )
    joints = tuple(
        Joint(name=f"j{i}", a_m=a / PER_M, alpha_rad=alpha * DEG, d_m=d / PER_M, max_speed=speed, stall_effort=torque)
        for i, (a, alpha, d, torque, speed) in enumerate(table, start=1)
    )
    return Arm(name="korayem6r", joints=joints, source="Korayem et al. 2018, Tables 2 and 3; no limits are given")


def puma761() -> Arm:
    """Return the Puma 761 of Pachidis 2005 with assumed lengths; base height zero (it is free)."""
    table = (  # a, alpha, d in mm and degrees, after Paul and Zhang's frames of the Puma family
        (0.0, -90, 0.0),
        (650.0, 0, 190.0),
        (0.0, 90, 0.0),
        (0.0, -90, 600.0),
        (0.0, 90, 0.0),
        (0.0, 0, 125.0),
    )
    joints = tuple(
        Joint(name=f"j{i}", a_m=a / PER_M, alpha_rad=alpha * DEG, d_m=d / PER_M)
        for i, (a, alpha, d) in enumerate(table, start=1)
    )
    source = (
        "ASSUMED: no public source gives the Puma 761's lengths; these are commonly printed for its sister, the "
        "Puma 762 (a2 650, d3 190, d4 600, d6 125 mm, spherical wrist; d3 is entered at joint 2, whose axis is "
        "parallel). The base height is free and zero here; limits are not known"
    )
    return Arm(name="puma761", joints=joints, source=source)


def stanford_rrp() -> Arm:
    """Return the hydraulic RRP arm of Kapucu and Baysec 2005, Table 1b."""
    joints = (
        Joint(name="j1", d_m=1.27, alpha_rad=pi / 2),
        Joint(name="j2", a_m=0.10, d_m=-0.05, alpha_rad=pi / 2),
        Joint(name="j3", type=JointType.PRISMATIC, lower=0.0, upper=inf),
    )
    source = (
        "Kapucu and Baysec 2005, Table 1b (measured on the rig). The slide has 1 m of travel at an unknown place, so "
        "only d >= 0 is assumed"
    )
    return Arm(name="stanford-rrp", joints=joints, source=source)


def ur10() -> Arm:
    """Return the Universal Robots UR10 (CB3)."""
    table = (  # a, alpha, d in m and quarter turns; speed in degrees/s, torque in N m
        (0.0, 1, 0.1273, 120, 330.0),
        (-0.612, 0, 0.0, 120, 330.0),
        (-0.5723, 0, 0.0, 180, 150.0),
        (0.0, 1, 0.163941, 180, 56.0),
        (0.0, -1, 0.1157, 180, 56.0),
        (0.0, 0, 0.0922, 180, 56.0),
    )
    joints = tuple(
        Joint(
            name=f"j{i}",
            a_m=a,
            alpha_rad=quarters * pi / 2,
            d_m=d,
            lower=-2 * pi,
            upper=2 * pi,
            max_speed=speed * DEG,
            stall_effort=torque,
        )
        for i, (a, quarters, d, speed, torque) in enumerate(table, start=1)
    )
    source = (
        "Universal Robots, 'DH parameters for calculations of kinematics and dynamics' (UR10): nominal values, each "
        "arm has its own calibration; limits, speeds and torques of the UR10 data sheet and of its public URDF"
    )
    return Arm(name="ur10", joints=joints, source=source)


def irb120() -> Arm:
    """Return the ABB IRB 120-3/0.6."""
    table = (  # a, alpha, d in mm and degrees, theta, lower, upper in degrees, speed in degrees/s
        (0.0, -90, 290.0, 0, -165, 165, 250),
        (270.0, 0, 0.0, -90, -110, 110, 250),
        (70.0, -90, 0.0, 0, -110, 70, 250),
        (0.0, 90, 302.0, 0, -160, 160, 320),
        (0.0, -90, 0.0, 0, -120, 120, 320),
        (0.0, 0, 72.0, 180, -400, 400, 420),
    )
    joints = tuple(
        Joint(
            name=f"j{i}",
            a_m=a / PER_M,
            alpha_rad=alpha * DEG,
            d_m=d / PER_M,
            theta_rad=theta * DEG,
            lower=low * DEG,
            upper=high * DEG,
            max_speed=speed * DEG,
        )
        for i, (a, alpha, d, theta, low, high, speed) in enumerate(table, start=1)
    )
    source = "ABB, product specification IRB 120 (3HAC035960): dimensions 290, 270, 70, 302, 72 mm, ranges and speeds"
    return Arm(name="irb120", joints=joints, source=source)


PRESETS: Mapping[str, Callable[[], Arm]] = MappingProxyType(
    {"korayem6r": korayem6r, "puma761": puma761, "stanford-rrp": stanford_rrp, "ur10": ur10, "irb120": irb120}
)


def preset(name: str) -> Arm:
    """Return the arm of that name; UsageError with the known names for another one."""
    if name not in PRESETS:
        raise UsageError(f"there is no arm named {name!r}", cure=f"Use one of: {', '.join(PRESETS)}")
    return PRESETS[name]()
