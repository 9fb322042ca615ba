"""Factory calibrations of arms: a Universal Robot's calibration.conf and the YAML of its ROS driver, an xArm's YAML,
the tables of a Techman.

calibration.conf, [mounting]: delta_theta, delta_a, delta_d, delta_alpha of six joints, rad and m, are added to the
nominal Denavit-Hartenberg table (ros-industrial/universal_robot #357; ur_calibration's own test adds them so);
calibration_status 2 is "Linearised", the only one in which they hold. On nearly parallel axes d runs to hundreds of
metres that cancel: Hayati's beta takes their place.

kinematics YAML (ur_calibration, calibration.cpp): six frames, each before the turn of its joint about z, as x, y, z, m,
and roll, pitch, yaw of Eigen's eulerAngles(0, 1, 2): R = Rx(roll) Ry(pitch) Rz(yaw). A URDF reads its rpy the other way
round, so that a description made of the file is off by the small angles beside a quarter turn, some 0.02 mm.

xArm's kinematics YAML (xarm_ros, gen_kinematics_params.py, which reads it from the controller): joint1 .. of 5 to 7
joints, x, y, z, roll, pitch, yaw in m and rad, which xarm_description takes as the origins of a URDF: turns about
standing x, y, z. The flange is the last joint's frame.

Techman (tmr_ros2, tm_mod_urdf: what its service ask_item answers): DHTable={..} of seven numbers a joint, theta, alpha,
a, d, kind, lower, upper, and DeltaDH={..} of five, of theta, alpha, a, d, beta, in degrees and mm, to be added:
T = Rz(theta) Tz(d) Tx(a) Rx(alpha) Ry(beta).
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import BadFile, Inconsistent, UsageError
from armsight.kinematics import Arm, Convention, Joint, JointType, fk
from armsight.kinematics.axes import AxisJoint, arm_from_axes
from armsight.kinematics.rigid import drawn_postures
from armsight.store.arm_file import in_metres
from armsight.store.atomic import read_bytes
from armsight.store.tables import decoded, plain_float
from armsight.store.yamls import read_yaml
from armsight.units import DEG, MM

DELTAS: Mapping[str, str] = {"delta_theta": "theta_rad", "delta_a": "a_m", "delta_d": "d_m", "delta_alpha": "alpha_rad"}
LINKS: Sequence[str] = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
ROS_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
FACTORY = "factory calibration"
MOST_BYTES = 1_000_000
FARTHEST_M = 2.0
"""No link of theirs is longer."""
FARTHEST_OFF_M = 0.03
"""Those seen are up to 8 mm from their nominal arm; of another size most are 100 mm off, but not all."""
SHORTEST_M, LONGEST_M = 0.03, 0.15
"""From the last but one joint of an xArm to its flange, of all: 62 to 124 mm. A file that ends earlier differs."""
XARM_JOINTS = (5, 6, 7)
KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
TECHMAN = re.compile(r"\b(DHTable|DeltaDH)\s*=\s*\{([^}]*)\}")
_LIST = re.compile(r"^[ \t]*(\w+)\s*=\s*\[([^\]\n]*)\]", re.MULTILINE)
_STATUS = re.compile(r"^[ \t]*calibration_status\s*=\s*(\d+)", re.MULTILINE)


def is_factory_file(path: Path) -> bool:
    """Whether a file is a factory calibration, by its content."""
    if path.suffix.lower() == ".conf":
        return True
    if path.suffix.lower() == ".txt" and path.is_file():
        return TECHMAN.search(read_bytes(path, limit=MOST_BYTES).decode("utf-8", errors="replace")) is not None
    if path.suffix.lower() not in (".yaml", ".yml") or not path.is_file():
        return False
    content = read_yaml(path)
    return isinstance(content, Mapping) and isinstance(content.get("kinematics"), Mapping)


def read_factory_arm(path: Path, nominal: Arm | None) -> Arm:
    """Return the arm of a factory calibration; nominal: the arm as its maker draws it, which calibration.conf needs.

    Raises UsageError, BadFile, Inconsistent.
    """
    if path.suffix.lower() in (".yaml", ".yml"):
        return _from_frames(read_yaml(path)["kinematics"], path, nominal)
    text = decoded(read_bytes(path, limit=MOST_BYTES), str(path))
    return _techman(text, path) if path.suffix.lower() == ".txt" else _from_deltas(text, path, nominal)


def _techman(text: str, path: Path) -> Arm:
    """Return a Techman's arm of its two tables. Raises BadFile, Inconsistent."""
    tables = TECHMAN.findall(text)
    said = [name for name, _ in tables]
    if sorted(said) != ["DHTable", "DeltaDH"]:
        raise BadFile(
            f"{path}: holds {', '.join(said)}; DHTable and DeltaDH are needed, once each",
            consequence="The arm is not known",
            cure="Keep what ask_item answers to DHTable and to DeltaDH of one robot in one file",
        )
    cells = dict(tables)
    table = _numbers(cells["DHTable"], 42, f"{path}: DHTable").reshape(6, 7)
    delta = _numbers(cells["DeltaDH"], 30, f"{path}: DeltaDH").reshape(6, 5)
    longest_mm = np.abs(table[:, 2:4]).max()
    if table[:, 4].any() or (table[:, :2] % 90.0).any() or not SHORTEST_M / MM < longest_mm < FARTHEST_M / MM:
        raise Inconsistent(
            f"{path}: DHTable is not of six turning joints in degrees and mm",
            consequence="The arm would be of another size",
            cure="Keep the answer as the robot gave it",
        )

    def arm(change: Array) -> Arm:
        joints = tuple(
            Joint(
                name=f"joint_{k}",
                theta_rad=DEG * (row[0] + by[0]),
                alpha_rad=DEG * (row[1] + by[1]),
                a_m=MM * (row[2] + by[2]),
                d_m=MM * (row[3] + by[3]),
                beta_rad=DEG * by[4],
                lower=DEG * row[5],
                upper=DEG * row[6],
            )
            for k, (row, by) in enumerate(zip(table.tolist(), change.tolist(), strict=True), 1)
        )
        return Arm(name=path.stem, joints=joints, source=f"{path.name}: {FACTORY} as the robot's DeltaDH has it")

    found = arm(delta)
    _require_near(found, arm(np.zeros_like(delta)), path, cure="Keep both answers of one robot")
    return found


def _from_deltas(text: str, path: Path, nominal: Arm | None) -> Arm:
    lists = dict(_LIST.findall(text))
    missing = [key for key in DELTAS if key not in lists]
    if missing:
        raise BadFile(
            f"{path}: no {', '.join(missing)}: it is no calibration.conf of a Universal Robot",
            consequence="The arm is not known",
            cure="Give calibration.conf of the controller's folder .urcontrol",
        )
    status = _STATUS.search(text)
    if status is None or status[1] != "2":
        raise Inconsistent(
            f"{path}: calibration_status is {status[1] if status else 'missing'}, and 2 is linearised",
            consequence="Whether its deltas hold is not known",
            cure="Give the file of a controller whose arm is calibrated and linearised",
        )
    nominal = _plain_table(path, nominal)
    changes = {key: _numbers(lists[key], 6, f"{path}: {key}") for key in DELTAS}
    joints = tuple(
        replace(joint, **{name: getattr(joint, name) + float(changes[key][i]) for key, name in DELTAS.items()})
        for i, joint in enumerate(nominal.joints)
    )
    source = (
        f"{path.name}: {FACTORY}, added to the nominal {nominal.name}, which the file does not name: compare one pose "
        "with the controller's"
    )
    arm = in_metres(replace(nominal, name=path.stem, joints=joints, source=source))
    _require_near(arm, nominal, path, cure="Give --nominal with the arm that the controller is of")
    return arm


def _require_near(arm: Arm, nominal: Arm, path: Path, *, cure: str) -> None:
    """Raise Inconsistent for differences that are too large for those of one arm."""
    q = drawn_postures(nominal)
    most_m = float(np.linalg.norm((fk(arm, q) - fk(nominal, q))[:, :3, 3], axis=1).max())
    if most_m > FARTHEST_OFF_M:
        raise Inconsistent(
            f"{path}: with these differences the arm is up to {most_m / MM:.3g} mm from the nominal {nominal.name}",
            consequence="They are of another arm: a factory calibration is some mm",
            cure=cure,
        )


def _plain_table(path: Path, nominal: Arm | None) -> Arm:
    """Return the nominal arm. Raises UsageError where none is given, or one that has no table like a UR's."""
    if nominal is None:
        raise UsageError(
            f"{path}: holds differences to the arm's nominal table, and which arm it is it does not say",
            consequence="The arm is not known",
            cure="Give --nominal with the arm's name, such as ur10e",
        )
    plain = nominal.convention is Convention.STANDARD and not any(joint.beta_rad for joint in nominal.joints)
    if nominal.n != 6 or not plain or (nominal.T_base_frame0.as_matrix() != np.eye(4)).any():
        raise UsageError(
            f"--nominal {nominal.name} has no plain Denavit-Hartenberg table of six joints from its base",
            consequence="Differences to another table say nothing",
            cure="Give a Universal Robot by its name: ur3, ur5, ur10, ur3e, ur5e, ur10e, ur16e",
        )
    return nominal


def _numbers(text: str, count: int, where: str) -> Array:
    """Return so many numbers apart by commas. Raises BadFile."""
    try:
        values = np.array([plain_float(cell) for cell in text.split(",")])
    except ValueError:
        values = np.full(0, np.nan)
    if values.shape != (count,) or not np.isfinite(values).all():
        raise BadFile(
            f"{where} is no list of {count} numbers with decimal points",
            consequence="The arm is not known",
            cure="Copy the file from the controller again",
        )
    return values


def _from_frames(content: Mapping[str, Any], path: Path, nominal: Arm | None) -> Arm:
    """Return the arm of a frame before each joint, of ur_calibration or of an xArm. Raises BadFile, Inconsistent."""
    links, names, turn, writer = LINKS, tuple(f"{name}_joint" for name in ROS_JOINTS), "XYZ", "ur_calibration"
    if "joint1" in content:
        links = names = tuple(f"joint{k}" for k in range(1, 1 + len(content)))
        turn, writer = "xyz", "gen_kinematics_params.py"
    joints = []
    for i, (link, name) in enumerate(zip(links, names, strict=True)):
        frame = content.get(link)
        if not isinstance(frame, Mapping) or not all(
            isinstance(frame.get(key), int | float) and np.isfinite(frame[key]) for key in KEYS
        ):
            raise BadFile(
                f"{path}: kinematics has no {link} with numbers {', '.join(KEYS)}",
                consequence="The arm is not known",
                cure=f"Give the file that {writer} wrote",
            )
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler(turn, [frame[key] for key in KEYS[3:]]).as_matrix()
        T[:3, 3] = [frame[key] for key in KEYS[:3]]
        if np.abs(T[:3, 3]).max() > FARTHEST_M or np.abs([frame[key] for key in KEYS[3:]]).max() > 2.0 * np.pi:
            raise Inconsistent(
                f"{path}: the frame of {link} is not in m and rad",
                consequence="The arm would be of another size",
                cure=f"Give the file that {writer} wrote, unchanged",
            )
        model = None if nominal is None or nominal.n != len(links) else nominal.joints[i]
        joint = AxisJoint(name=name, type=JointType.REVOLUTE, T_parent_joint=T, axis=np.array([0.0, 0.0, 1.0]))
        if model is not None:
            joint = replace(joint, lower=model.lower, upper=model.upper, max_speed=model.max_speed)
        joints.append(joint)
    last_m = float(np.linalg.norm(joints[-1].T_parent_joint[:3, 3]))
    if links is not LINKS and not (len(links) in XARM_JOINTS and SHORTEST_M < last_m < LONGEST_M):
        raise Inconsistent(
            f"{path}: {len(links)} joints, the last one {last_m / MM:.3g} mm from the one before: of no xArm",
            consequence="A joint may be missing, or the lengths are not in m",
            cure=f"Give the file that {writer} wrote, unchanged",
        )
    arm = arm_from_axes(path.stem, np.eye(4), joints, np.eye(4), np.eye(4))
    return replace(arm, source=f"{path.name}: {FACTORY} as {writer} wrote it")
