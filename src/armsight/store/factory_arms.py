"""A Universal Robot's factory calibration: calibration.conf of its controller, or the YAML of its ROS driver.

calibration.conf, [mounting]: delta_theta, delta_a, delta_d, delta_alpha of six joints, rad and m, are added to the
nominal Denavit-Hartenberg table (ros-industrial/universal_robot #357; ur_calibration's own test adds them so);
calibration_status 2 is "Linearised", the only one in which they hold. On nearly parallel axes d runs to hundreds of
metres that cancel: Hayati's beta takes their place.

kinematics YAML (ur_calibration, calibration.cpp): six frames, each before the turn of its joint about z, as x, y, z, m,
and roll, pitch, yaw of Eigen's eulerAngles(0, 1, 2): R = Rx(roll) Ry(pitch) Rz(yaw). A URDF reads its rpy the other way
round, so that a description made of the file is off by the small angles beside a quarter turn, some 0.02 mm.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from armsight.arrays import Array
from armsight.errors import BadFile, Inconsistent, UsageError
from armsight.kinematics import Arm, Convention, JointType, fk
from armsight.kinematics.axes import AxisJoint, arm_from_axes
from armsight.kinematics.rigid import drawn_postures
from armsight.store.arm_file import in_metres
from armsight.store.atomic import read_bytes
from armsight.store.tables import decoded
from armsight.store.yamls import read_yaml
from armsight.units import MM

DELTAS: Mapping[str, str] = {"delta_theta": "theta_rad", "delta_a": "a_m", "delta_d": "d_m", "delta_alpha": "alpha_rad"}
LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
ROS_JOINTS = ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
FACTORY = "factory calibration"
MOST_BYTES = 1_000_000
FARTHEST_M = 2.0
"""No link of theirs is longer."""
FARTHEST_OFF_M = 0.03
"""Those seen are up to 8 mm from their nominal arm; of another size most are 100 mm off, but not all."""
_LIST = re.compile(r"^[ \t]*(\w+)\s*=\s*\[([^\]\n]*)\]", re.MULTILINE)
_STATUS = re.compile(r"^[ \t]*calibration_status\s*=\s*(\d+)", re.MULTILINE)


def is_factory_file(path: Path) -> bool:
    """Whether a file is a factory calibration, by its content."""
    if path.suffix.lower() == ".conf":
        return True
    if path.suffix.lower() not in (".yaml", ".yml") or not path.is_file():
        return False
    content = read_yaml(path)
    return isinstance(content, Mapping) and isinstance(content.get("kinematics"), Mapping)


def read_factory_arm(path: Path, nominal: Arm | None) -> Arm:
    """Return the arm of a factory calibration; nominal: the arm as its maker draws it, which calibration.conf needs.

    Raises UsageError, BadFile, Inconsistent.
    """
    if path.suffix.lower() == ".conf":
        return _from_deltas(decoded(read_bytes(path, limit=MOST_BYTES), str(path)), path, nominal)
    return _from_frames(read_yaml(path)["kinematics"], path, nominal)


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
    changes = {key: _six(lists[key], f"{path}: {key}") for key in DELTAS}
    joints = tuple(
        replace(joint, **{name: getattr(joint, name) + float(changes[key][i]) for key, name in DELTAS.items()})
        for i, joint in enumerate(nominal.joints)
    )
    source = (
        f"{path.name}: {FACTORY}, added to the nominal {nominal.name}, which the file does not name: compare one pose "
        "with the controller's"
    )
    arm = in_metres(replace(nominal, name=path.stem, joints=joints, source=source))
    q = drawn_postures(nominal)
    most_m = float(np.linalg.norm((fk(arm, q) - fk(nominal, q))[:, :3, 3], axis=1).max())
    if most_m > FARTHEST_OFF_M:
        raise Inconsistent(
            f"{path}: with these differences the arm is up to {most_m / MM:.3g} mm from the nominal {nominal.name}",
            consequence="They are of another arm: a factory calibration is some mm",
            cure="Give --nominal with the arm that the controller is of",
        )
    return arm


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


def _six(text: str, where: str) -> Array:
    try:
        values = np.array([float(cell) for cell in text.split(",")])
    except ValueError:
        values = np.full(0, np.nan)
    if values.shape != (6,) or not np.isfinite(values).all():
        raise BadFile(
            f"{where} is no list of six numbers with decimal points",
            consequence="The arm is not known",
            cure="Copy the file from the controller again",
        )
    return values


def _from_frames(content: Mapping[str, Any], path: Path, nominal: Arm | None) -> Arm:
    joints = []
    for i, (link, name) in enumerate(zip(LINKS, ROS_JOINTS, strict=True)):
        frame = content.get(link)
        keys = ("x", "y", "z", "roll", "pitch", "yaw")
        if not isinstance(frame, Mapping) or not all(
            isinstance(frame.get(key), int | float) and np.isfinite(frame[key]) for key in keys
        ):
            raise BadFile(
                f"{path}: kinematics has no {link} with numbers {', '.join(keys)}",
                consequence="The arm is not known",
                cure="Give the file that ur_calibration wrote",
            )
        T = np.eye(4)
        T[:3, :3] = Rotation.from_euler("XYZ", [frame[key] for key in keys[3:]]).as_matrix()
        T[:3, 3] = [frame[key] for key in keys[:3]]
        if np.abs(T[:3, 3]).max() > FARTHEST_M or np.abs([frame[key] for key in keys[3:]]).max() > 2.0 * np.pi:
            raise Inconsistent(
                f"{path}: the frame of {link} is not in m and rad",
                consequence="The arm would be of another size",
                cure="Give the file that ur_calibration wrote, unchanged",
            )
        model = None if nominal is None or nominal.n != len(LINKS) else nominal.joints[i]
        axis = np.array([0.0, 0.0, 1.0])
        joint = AxisJoint(name=f"{name}_joint", type=JointType.REVOLUTE, T_parent_joint=T, axis=axis)
        if model is not None:
            joint = replace(joint, lower=model.lower, upper=model.upper, max_speed=model.max_speed)
        joints.append(joint)
    arm = arm_from_axes(path.stem, np.eye(4), joints, np.eye(4), np.eye(4))
    return replace(arm, source=f"{path.name}: {FACTORY} as ur_calibration wrote it")
