"""What a result says of the cell itself, under names that are the same whatever found it: what may drift.

`joint2.theta_rad`, `joint3.d_m`, `joint1.offset_rad` (a zero held against the controller's), `baseline_m`, `tip.x_m`,
`camera.fx_px`; and the poses `handeye` (the camera on its carrier) and `world` (the rig in the arm's base).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from armsight.columns import DH_ROW, POSE6, POSITION
from armsight.kinematics import Arm, JointType
from armsight.records import NamedCovariance
from armsight_lab.history.entry import Quantity, StoredPose, deviation, number, stored_pose
from armsight_lab.history.figures import Content, unit_of

CAMERA = ("fx_px", "fy_px", "cx_px", "cy_px")


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameters:
    """Numbers and poses of a cell; arm: its name; joints: R or P each, from the base on; '' of no arm."""

    quantities: tuple[Quantity, ...] = ()
    poses: tuple[StoredPose, ...] = ()
    arm: str = ""
    joints: str = ""


def parameters_of(result: Content, arm: Arm | None) -> Parameters:
    """Return what a result says, as its JSON object holds it; arm: the one that was calibrated, where one was."""
    found = [*_scalars(result), *_tip(result)]
    poses = tuple(_poses(result))
    if arm is not None:
        own = of_arm(arm)
        return replace(own, quantities=(*own.quantities, *found), poses=poses)
    found += _joints(result)
    kinds = [str(one.get("type", "")) for one in _rows(result)]
    joints = "".join(kind[:1].upper() for kind in kinds) if all(kinds) else "?" * len(kinds)
    return Parameters(quantities=tuple(found), poses=poses, joints=joints)


def of_arm(arm: Arm) -> Parameters:
    """Return the table of an arm; deviations of what was calibrated."""
    stds = _stds(arm.covariance)
    rows = [
        _quantity(f"joint{i}.{key}", getattr(joint, key), stds.get(f"{joint.name}.{key}"))
        for i, joint in enumerate(arm.joints, 1)
        for key in DH_ROW
    ]
    joints = "".join("R" if joint.type is JointType.REVOLUTE else "P" for joint in arm.joints)
    return Parameters(quantities=tuple(rows), arm=arm.name, joints=joints)


def pose_named(name: str, pose: Content, stds: Mapping[str, Any], prefix: str = "") -> Parameters:
    """Return one pose ({xyz_m, quat_xyzw}) with deviations by name."""
    std = [deviation(stds.get(f"{prefix}{axis}")) for axis in POSE6]
    return Parameters(poses=(stored_pose(name, pose, std),))


def point_named(name: str, xyz_m: Sequence[float], stds: Mapping[str, Any], prefix: str = "") -> Parameters:
    """Return the coordinates of a point with deviations by name."""
    rows = (
        _quantity(f"{name}.{axis}", value, stds.get(f"{prefix}{axis}"))
        for axis, value in zip(POSITION, xyz_m, strict=True)
    )
    return Parameters(quantities=tuple(rows))


def _stds(covariance: NamedCovariance | None) -> Mapping[str, float]:
    return {} if covariance is None else covariance.std()


def _scalars(result: Content) -> Iterator[Quantity]:
    stds = result.get("std")
    if not isinstance(stds, Mapping):
        return
    if "baseline_m" in result:
        yield _quantity("baseline_m", result["baseline_m"], stds.get("baseline_m", result.get("baseline_std_m")))
    for key in CAMERA:
        if key in result:
            yield _quantity(f"camera.{key}", result[key], stds.get(key))


def _tip(result: Content) -> Iterator[Quantity]:
    tip, stds = result.get("tip_m"), result.get("std")
    if isinstance(tip, list) and len(tip) == len(POSITION) and isinstance(stds, Mapping):
        yield from point_named("tip", tip, stds).quantities


def _poses(result: Content) -> Iterator[StoredPose]:
    stds = result.get("std")
    of = stds if isinstance(stds, Mapping) else {}
    for key, name in (("T_flange_camera", "handeye"), ("T_base_camera", "handeye"), ("T_base_rig", "world")):
        pose = result.get(key)
        if isinstance(pose, Mapping):
            yield from pose_named(name, pose, of).poses


def _rows(result: Content) -> list[Content]:
    rows = result.get("joints")
    return [one for one in rows if isinstance(one, Mapping)] if isinstance(rows, list) else []


def _joints(result: Content) -> Iterator[Quantity]:
    """Yield the entries of joints that were identified, and errors of zeros that were verified."""
    for i, joint in enumerate(_rows(result), 1):
        stds = joint.get("std")
        if isinstance(stds, Mapping):
            for key in DH_ROW:
                if key in joint:
                    yield _quantity(f"joint{i}.{key}", joint[key], stds.get(key))
        if "offset_rad" in joint and joint["offset_rad"] is not None:
            yield _quantity(f"joint{i}.offset_rad", joint["offset_rad"], joint.get("std_rad"))


def _quantity(name: str, value: object, std: object) -> Quantity:
    return Quantity(name=name, value=number(value), std=deviation(std), unit=unit_of(name))
