"""Arms known by name, each with the source of its numbers."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from math import inf, pi
from types import MappingProxyType

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import UsageError
from armsight.kinematics.arm import Arm
from armsight.kinematics.axes import AxisJoint, arm_from_axes
from armsight.kinematics.forward_kinematics import fk, fk_jacobian, link_frames, parameter_jacobian
from armsight.kinematics.inverse_kinematics import ik, ik_many, in_range
from armsight.kinematics.joints import Convention, Joint, JointType
from armsight.kinematics.numeric import Method, solve_numeric, solve_numeric_many
from armsight.records import require_kind
from armsight.units import DEG

PER_M = 1000.0
"""Millimetres in a metre: dividing by it gives the float64 nearest to the printed number."""


def _arm(
    name: str, columns: str, rows: Sequence[Sequence[float]], source: str, convention: Convention = Convention.STANDARD
) -> Arm:
    """Return an arm of joints j1, j2 ...; columns: fields of Joint, such as d_m:mm and lower:deg where so printed."""
    joints = (
        Joint(name=f"j{i}", **dict(map(_si, columns.split(), row)))  # type: ignore[arg-type]  # numbers all
        for i, row in enumerate(rows, start=1)
    )
    return Arm(name=name, joints=tuple(joints), convention=convention, source=source)


def _si(column: str, value: float) -> tuple[str, float]:
    field, _, unit = column.partition(":")
    return field, value / PER_M if unit == "mm" else value * DEG if unit == "deg" else value


def korayem6r() -> Arm:
    """Return the 6R arm of Korayem 2018: geometry of Table 2, motors of Table 3. Limits are not given there."""
    rows = (
        (36.5, -90, 438.0, 114.0, 1.3),
        (251.5, 0, 0.0, 98.0, 1.04),
        (125.0, 0, 0.0, 382.2, 0.73),
        (92.0, 90, 0.0, 40.4, 0.9),
        (0.0, -90, 0.0, 40.4, 0.9),
        (0.0, 0, 152.8, 40.4, 0.9),
    )
    source = "Korayem et al. 2018, Tables 2 and 3; no limits are given"
    return _arm("korayem6r", "a_m:mm alpha_rad:deg d_m:mm stall_effort max_speed", rows, source)


def puma761() -> Arm:
    """Return the Puma 761 of Pachidis 2005 with assumed lengths; base height zero (it is free)."""
    rows = (  # after Paul and Zhang's frames of the Puma family
        (0.0, -90, 0.0),
        (650.0, 0, 190.0),
        (0.0, 90, 0.0),
        (0.0, -90, 600.0),
        (0.0, 90, 0.0),
        (0.0, 0, 125.0),
    )
    source = (
        "ASSUMED: no public source gives the Puma 761's lengths; these are commonly printed for its sister, the "
        "Puma 762 (a2 650, d3 190, d4 600, d6 125 mm, spherical wrist; d3 is entered at joint 2, whose axis is "
        "parallel). The base height is free and zero here; limits are not known"
    )
    return _arm("puma761", "a_m:mm alpha_rad:deg d_m:mm", rows, source)


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
    rows = (
        (25.0, -90, 400.0, 0, -1, -170, 170, 360),
        (455.0, 0, 0.0, 0, 1, -190, 45, 300),
        (35.0, -90, 0.0, -90, 1, -120, 156, 360),
        (0.0, 90, 420.0, 0, -1, -185, 185, 381),
        (0.0, -90, 0.0, 0, 1, -120, 120, 388),
        (0.0, 0, 80.0, 180, -1, -350, 350, 615),
    )
    source = (
        "KUKA, specification KR AGILUS sixx, KR 6 R900 sixx: dimensions 400, 25, 455, 35, 420, 80 mm, ranges and "
        "speeds; the sense of the axes as in kuka_experimental's URDF. Another KR 6 (R700 sixx, R1820, KR 6-2) has "
        "other lengths"
    )
    columns = "a_m:mm alpha_rad:deg d_m:mm theta_rad:deg sign lower:deg upper:deg max_speed:deg"
    return _arm("kr6", columns, rows, source)


def iiwa14() -> Arm:
    """Return the KUKA LBR iiwa 14 R820 with its bare flange: a media flange adds its own length to the tool."""
    rows = (
        (-90, 360.0, -170, 170, 85),
        (90, 0.0, -120, 120, 85),
        (90, 420.0, -170, 170, 100),
        (-90, 0.0, -120, 120, 75),
        (-90, 400.0, -170, 170, 130),
        (90, 0.0, -120, 120, 135),
        (0, 126.0, -175, 175, 135),
    )
    source = (
        "KUKA, specification LBR iiwa 14 R820: dimensions 360, 420, 400, 126 mm (without a media flange), ranges and "
        "speeds; the sense of the axes as in the public URDF (iiwa_stack)"
    )
    columns = "alpha_rad:deg d_m:mm lower:deg upper:deg max_speed:deg"
    return _arm("iiwa14", columns, rows, source)


def panda() -> Arm:
    """Return the Franka Emika Panda up to its flange, without the hand; Craig's parameters, as its maker gives them."""
    rows = (
        (0.0, 0, 333.0, -2.8973, 2.8973, 2.175, 87.0),
        (0.0, -90, 0.0, -1.7628, 1.7628, 2.175, 87.0),
        (0.0, 90, 316.0, -2.8973, 2.8973, 2.175, 87.0),
        (82.5, 90, 0.0, -3.0718, -0.0698, 2.175, 87.0),
        (-82.5, -90, 384.0, -2.8973, 2.8973, 2.61, 12.0),
        (0.0, 90, 0.0, -0.0175, 3.7525, 2.61, 12.0),
        (88.0, 90, 107.0, -2.8973, 2.8973, 2.61, 12.0),
    )
    source = (
        "Franka Emika, FCI documentation, 'Robot and interface specifications': Denavit-Hartenberg parameters (Craig), "
        "limits, speeds and torques of the Panda; the flange's 107 mm are joint 7's d. The hand turns by -45 degrees "
        "and adds 103.4 mm to its centre, which is a tool's"
    )
    columns = "a_m:mm alpha_rad:deg d_m:mm lower upper max_speed stall_effort"
    return _arm("panda", columns, rows, source, Convention.CRAIG)


def irb120() -> Arm:
    """Return the ABB IRB 120-3/0.6."""
    rows = (
        (0.0, -90, 290.0, 0, -165, 165, 250),
        (270.0, 0, 0.0, -90, -110, 110, 250),
        (70.0, -90, 0.0, 0, -110, 70, 250),
        (0.0, 90, 302.0, 0, -160, 160, 320),
        (0.0, -90, 0.0, 0, -120, 120, 320),
        (0.0, 0, 72.0, 180, -400, 400, 420),
    )
    source = "ABB, product specification IRB 120 (3HAC035960): dimensions 290, 270, 70, 302, 72 mm, ranges and speeds"
    columns = "a_m:mm alpha_rad:deg d_m:mm theta_rad:deg lower:deg upper:deg max_speed:deg"
    return _arm("irb120", columns, rows, source)


SO_NAMES = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")

Row = tuple[tuple[float, float, float], tuple[float, float, float], tuple[int, int, int], tuple[float, float]]
"""Of a joint: its place in the link before, x y z in m and roll pitch yaw in rad; its axis; its range in rad."""

SO101: tuple[Row, ...] = (
    ((0.0388353, 0.0, 0.0624), (pi, 0.0, -pi), (0, 0, 1), (-1.91986, 1.91986)),
    ((-0.0303992, -0.0182778, -0.0542), (-pi / 2, -pi / 2, 0.0), (0, 0, 1), (-1.74533, 1.74533)),
    ((-0.11257, -0.028, 0.0), (0.0, 0.0, pi / 2), (0, 0, 1), (-1.69, 1.69)),
    ((-0.1349, 0.0052, 0.0), (0.0, 0.0, -pi / 2), (0, 0, 1), (-1.65806, 1.65806)),
    ((0.0, -0.0611, 0.0181), (pi / 2, 0.0486795, pi), (0, 0, 1), (-2.74385, 2.84121)),
)
SO101_TOOL = ((-0.0079, -0.000218121, -0.0981274), (0.0, pi, 0.0))

SO100: tuple[Row, ...] = (
    ((0.0, -0.0452, 0.0165), (pi / 2, 0.0, 0.0), (0, 1, 0), (-2.0, 2.0)),
    ((0.0, 0.1025, 0.0306), (-1.8, 0.0, 0.0), (1, 0, 0), (0.0, 3.5)),
    ((0.0, 0.11257, 0.028), (pi / 2, 0.0, 0.0), (1, 0, 0), (-pi, 0.0)),
    ((0.0, 0.0052, 0.1349), (-1.0, 0.0, 0.0), (1, 0, 0), (-2.5, 1.2)),
    ((0.0, -0.0601, 0.0), (0.0, pi / 2, 0.0), (0, 1, 0), (-pi, pi)),
)

SO_MAKERS = "TheRobotStudio, SO-ARM100 (Apache-2.0)"


def so101() -> Arm:
    """Return the SO-101 with its tool between the jaws; zero of every joint is the middle of its range."""
    source = (
        f"{SO_MAKERS}, Simulation/SO101/so101_new_calib.urdf, right angles as such: zero is the middle of each joint's "
        "range, the tool link is gripper_frame_link between the jaws; the ranges are its makers' approximations, no "
        "speeds are known. LeRobot's degrees have their zero in the middle of what was swept by hand: find it with "
        "armsight calibrate arm"
    )
    return _so_arm("so101", SO101, _place(*SO101_TOOL), ("base_link", "gripper_frame_link"), source)


def so100() -> Arm:
    """Return the SO-100 with its fixed jaw's frame as tool, on the axis of the wrist's roll."""
    source = (
        f"{SO_MAKERS}, Simulation/SO100/so100.urdf, right angles as such: zero of lift and elbow is the end of their "
        "range, where the arm is folded; the tool link is gripper, the fixed jaw's frame on the last joint's axis; no "
        "speeds are known. LeRobot's degrees have another zero: find it with armsight calibrate arm"
    )
    return _so_arm("so100", SO100, np.eye(4), ("base", "gripper"), source)


def _so_arm(name: str, rows: Sequence[Row], T_last_tool: Array, links: tuple[str, str], source: str) -> Arm:
    joints = [
        AxisJoint(
            name=called,
            type=JointType.REVOLUTE,
            T_parent_joint=_place(xyz, rpy),
            axis=np.array(axis, dtype=float),
            lower=lower,
            upper=upper,
        )
        for called, (xyz, rpy, axis, (lower, upper)) in zip(SO_NAMES, rows, strict=True)
    ]
    arm = arm_from_axes(name, np.eye(4), joints, T_last_tool, np.eye(4))
    return replace(arm, source=source, base_link=links[0], tool_link=links[1])


def _place(xyz: tuple[float, float, float], rpy: tuple[float, float, float]) -> Array:
    """Return (4, 4) of a URDF's origin: R = Rz(yaw) Ry(pitch) Rx(roll)."""
    return np.asarray(RigidTransform.from_components(np.array(xyz), Rotation.from_euler("xyz", rpy)).as_matrix())


PRESETS: Mapping[str, Callable[[], Arm]] = MappingProxyType(
    {"korayem6r": korayem6r, "puma761": puma761, "stanford-rrp": stanford_rrp}
    | {
        make.__name__: make
        for make in (ur3, ur5, ur10, ur3e, ur5e, ur10e, ur16e, kr6, iiwa14, panda, irb120, so100, so101)
    }
)


def preset(name: str) -> Arm:
    """Return the arm of that name; UsageError with the known names for another one."""
    known = f"Use one of: {', '.join(PRESETS)}"
    require_kind("name", name, str, cure=known)
    if name not in PRESETS:
        raise UsageError(f"there is no arm named {name!r}", cure=known)
    return PRESETS[name]()


def warm_up() -> None:
    """Load all that this package compiles, but for all cores: half a minute the first time, then a second."""
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
