"""Arms known by name, each with the source of its numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from math import inf, pi
from types import MappingProxyType

import numpy as np

from armsight.errors import UsageError
from armsight.kinematics.arm import Arm
from armsight.kinematics.derivatives import parameter_jacobian
from armsight.kinematics.forward_kinematics import fk, fk_jacobian, link_frames
from armsight.kinematics.inverse_kinematics import ik, ik_many, in_range
from armsight.kinematics.joints import Convention, Joint, JointType
from armsight.kinematics.numeric import Method, solve_numeric, solve_numeric_many
from armsight.kinematics.so_arms import so100, so101
from armsight.records import require_kind
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


UR_ARTICLE = "Universal Robots, 'DH parameters for calculations of kinematics and dynamics'"
UR_ALPHA = (1, 0, 0, 1, -1, 0)
"""Quarter turns of alpha, the same for every arm of Universal Robots."""
UR_SPEED = {
    "ur3": (180, 180, 180, 360, 360, 360),
    "ur5": (180,) * 6,
    "ur10": (120, 120, 180, 180, 180, 180),
}
"""Degrees/s, by the arm's size in its CB3 name."""
UR_TORQUE = {
    "ur3": (56.0, 56.0, 28.0, 12.0, 12.0, 12.0),
    "ur5": (150.0, 150.0, 150.0, 28.0, 28.0, 28.0),
    "ur10": (330.0, 330.0, 150.0, 56.0, 56.0, 56.0),
}
"""N m, by the arm's size in its CB3 name."""


def _universal_robots(name: str, size: str, a_m: tuple[float, float], d_m: tuple[float, ...], *, endless: bool) -> Arm:
    """Return an arm of Universal Robots. a_m: of joints 2 and 3; d_m: of 1, 4, 5, 6; endless: joint 6 has no limits."""
    joints = tuple(
        Joint(
            name=f"j{i + 1}",
            a_m=(0.0, *a_m, 0.0, 0.0, 0.0)[i],
            alpha_rad=UR_ALPHA[i] * pi / 2,
            d_m=(d_m[0], 0.0, 0.0, *d_m[1:])[i],
            lower=-inf if endless and i == 5 else -2 * pi,
            upper=inf if endless and i == 5 else 2 * pi,
            max_speed=UR_SPEED[size][i] * DEG,
            stall_effort=UR_TORQUE[size][i],
        )
        for i in range(6)
    )
    source = (
        f"{UR_ARTICLE} ({name.replace('ur', 'UR')}): nominal values, each arm has its own calibration; limits, speeds "
        f"and torques of the {name.replace('ur', 'UR')} data sheet and of its public URDF"
    )
    return Arm(name=name, joints=joints, source=source)


def ur3() -> Arm:
    """Return the Universal Robots UR3 (CB3)."""
    return _universal_robots("ur3", "ur3", (-0.24365, -0.21325), (0.1519, 0.11235, 0.08535, 0.0819), endless=True)


def ur5() -> Arm:
    """Return the Universal Robots UR5 (CB3)."""
    return _universal_robots("ur5", "ur5", (-0.425, -0.39225), (0.089159, 0.10915, 0.09465, 0.0823), endless=False)


def ur10() -> Arm:
    """Return the Universal Robots UR10 (CB3)."""
    return _universal_robots("ur10", "ur10", (-0.612, -0.5723), (0.1273, 0.163941, 0.1157, 0.0922), endless=False)


def ur3e() -> Arm:
    """Return the Universal Robots UR3e."""
    return _universal_robots("ur3e", "ur3", (-0.24355, -0.2132), (0.15185, 0.13105, 0.08535, 0.0921), endless=True)


def ur5e() -> Arm:
    """Return the Universal Robots UR5e."""
    return _universal_robots("ur5e", "ur5", (-0.425, -0.3922), (0.1625, 0.1333, 0.0997, 0.0996), endless=False)


def ur10e() -> Arm:
    """Return the Universal Robots UR10e."""
    return _universal_robots("ur10e", "ur10", (-0.6127, -0.57155), (0.1807, 0.17415, 0.11985, 0.11655), endless=False)


def ur16e() -> Arm:
    """Return the Universal Robots UR16e."""
    return _universal_robots("ur16e", "ur10", (-0.4784, -0.36), (0.1807, 0.17415, 0.11985, 0.11655), endless=False)


def kr6() -> Arm:
    """Return the KUKA KR 6 R900 sixx (KR AGILUS), its base and flange as the controller's ROBROOT and FLANGE."""
    table = (  # a, alpha, d in mm and degrees, theta, sign, lower, upper in degrees, speed in degrees/s
        (25.0, -90, 400.0, 0, -1, -170, 170, 360),
        (455.0, 0, 0.0, 0, 1, -190, 45, 300),
        (35.0, -90, 0.0, -90, 1, -120, 156, 360),
        (0.0, 90, 420.0, 0, -1, -185, 185, 381),
        (0.0, -90, 0.0, 0, 1, -120, 120, 388),
        (0.0, 0, 80.0, 180, -1, -350, 350, 615),
    )
    joints = tuple(
        Joint(
            name=f"j{i}",
            a_m=a / PER_M,
            alpha_rad=alpha * DEG,
            d_m=d / PER_M,
            theta_rad=theta * DEG,
            sign=sign,
            lower=low * DEG,
            upper=high * DEG,
            max_speed=speed * DEG,
        )
        for i, (a, alpha, d, theta, sign, low, high, speed) in enumerate(table, start=1)
    )
    source = (
        "KUKA, specification KR AGILUS sixx, KR 6 R900 sixx: dimensions 400, 25, 455, 35, 420, 80 mm, ranges and "
        "speeds; the sense of the axes as in kuka_experimental's URDF. Another KR 6 (R700 sixx, R1820, KR 6-2) has "
        "other lengths"
    )
    return Arm(name="kr6", joints=joints, source=source)


def iiwa14() -> Arm:
    """Return the KUKA LBR iiwa 14 R820 with its bare flange: a media flange adds its own length to the tool."""
    table = (  # alpha, d in degrees and mm, limit in degrees to both sides, speed in degrees/s
        (-90, 360.0, 170, 85),
        (90, 0.0, 120, 85),
        (90, 420.0, 170, 100),
        (-90, 0.0, 120, 75),
        (-90, 400.0, 170, 130),
        (90, 0.0, 120, 135),
        (0, 126.0, 175, 135),
    )
    joints = tuple(
        Joint(
            name=f"j{i}",
            alpha_rad=alpha * DEG,
            d_m=d / PER_M,
            lower=-limit * DEG,
            upper=limit * DEG,
            max_speed=speed * DEG,
        )
        for i, (alpha, d, limit, speed) in enumerate(table, start=1)
    )
    source = (
        "KUKA, specification LBR iiwa 14 R820: dimensions 360, 420, 400, 126 mm (without a media flange), ranges and "
        "speeds; the sense of the axes as in the public URDF (iiwa_stack)"
    )
    return Arm(name="iiwa14", joints=joints, source=source)


def panda() -> Arm:
    """Return the Franka Emika Panda up to its flange, without the hand; Craig's parameters, as its maker gives them."""
    table = (  # a, alpha, d in mm and degrees, lower, upper in rad, speed in rad/s, torque in N m
        (0.0, 0, 333.0, -2.8973, 2.8973, 2.175, 87.0),
        (0.0, -90, 0.0, -1.7628, 1.7628, 2.175, 87.0),
        (0.0, 90, 316.0, -2.8973, 2.8973, 2.175, 87.0),
        (82.5, 90, 0.0, -3.0718, -0.0698, 2.175, 87.0),
        (-82.5, -90, 384.0, -2.8973, 2.8973, 2.61, 12.0),
        (0.0, 90, 0.0, -0.0175, 3.7525, 2.61, 12.0),
        (88.0, 90, 107.0, -2.8973, 2.8973, 2.61, 12.0),
    )
    joints = tuple(
        Joint(
            name=f"j{i}",
            a_m=a / PER_M,
            alpha_rad=alpha * DEG,
            d_m=d / PER_M,
            lower=low,
            upper=high,
            max_speed=speed,
            stall_effort=torque,
        )
        for i, (a, alpha, d, low, high, speed, torque) in enumerate(table, start=1)
    )
    source = (
        "Franka Emika, FCI documentation, 'Robot and interface specifications': Denavit-Hartenberg parameters (Craig), "
        "limits, speeds and torques of the Panda; the flange's 107 mm are joint 7's d. The hand turns by -45 degrees "
        "and adds 103.4 mm to its centre, which is a tool's"
    )
    return Arm(name="panda", joints=joints, convention=Convention.CRAIG, source=source)


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
    {
        "korayem6r": korayem6r,
        "puma761": puma761,
        "stanford-rrp": stanford_rrp,
        "ur3": ur3,
        "ur5": ur5,
        "ur10": ur10,
        "ur3e": ur3e,
        "ur5e": ur5e,
        "ur10e": ur10e,
        "ur16e": ur16e,
        "kr6": kr6,
        "iiwa14": iiwa14,
        "panda": panda,
        "irb120": irb120,
        "so100": so100,
        "so101": so101,
    }
)


def preset(name: str) -> Arm:
    """Return the arm of that name; UsageError with the known names for another one."""
    known = f"Use one of: {', '.join(PRESETS)}"
    require_kind("name", name, str, cure=known)
    if name not in PRESETS:
        raise UsageError(f"there is no arm named {name!r}", consequence="There is nothing to move", cure=known)
    return PRESETS[name]()


def warm_up() -> None:
    """Compile, or load from the cache, everything that this package runs but the kernels for all cores.

    Half a minute the first time, a second from the cache. Kernels do not depend on the arm.
    """
    arm = ur10()
    q = np.array([0.3, -1.0, 1.2, 0.4, 0.9, 0.1])
    T = fk(arm, q)
    fk(arm, q[None])
    fk_jacobian(arm, q)
    fk_jacobian(arm, q[None])
    link_frames(arm, q)
    parameter_jacobian(arm, q)
    ik(arm, T, q)
    ik_many(arm, T)
    in_range(arm, q, q)
    solve_numeric_many(arm, T, q[None])
    for method in Method:
        solve_numeric(arm, T, q, method=method)
