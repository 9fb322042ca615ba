"""arm.yaml."""

from __future__ import annotations

import contextlib
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from pydantic import Field

from armsight.errors import BadFile, Inconsistent
from armsight.kinematics import Arm, Coupling, Joint, JointType, ToolPoint
from armsight.kinematics.axes import in_short_rows
from armsight.records import NamedCovariance
from armsight.store import codec
from armsight.store.interpret import limits_look_like_degrees, looks_like_degrees, looks_like_mm
from armsight.store.schema import Kind, Origin


class JointModel(codec.structure(Joint)):  # type: ignore[misc]  # made of the record's fields
    """One joint; a limit that is missing or null is none."""

    record = Joint
    coupled: dict[str, codec.Finite] | None = None
    std: dict[str, codec.Finite] | None = None


def _long(joints: Sequence[Joint]) -> dict[str, float]:
    """Return the lengths that look like millimetres, by joint and key."""
    lengths = {f"{joint.name}.{key}": getattr(joint, key) for joint in joints for key in ("a_m", "d_m")}
    return {name: value for name, value in lengths.items() if looks_like_mm(value)}


def in_metres(arm: Arm) -> Arm:
    """Return the arm; with beta on nearly parallel axes where d of a plain table runs away there.

    A controller's own calibration has such d, of some hundred metres that cancel (universal_robot's calibration.conf).
    Raises Inconsistent where lengths are millimetres.
    """
    long = _long(arm.joints)
    if not long:
        return arm
    with contextlib.suppress(Inconsistent):
        short = in_short_rows(arm)
        if all(name.endswith(".d_m") for name in long) and not _long(short.joints):
            told = (
                f"{', '.join(long)} run to {max(map(abs, long.values())):.3g} m on axes that are nearly parallel: beta"
            )
            return replace(short, source="; ".join(part for part in (arm.source, f"{told} takes their place") if part))
    listed = ", ".join(f"{name} {value:g}" for name, value in long.items())
    raise Inconsistent(
        f"lengths look like millimetres: {listed}",
        consequence="Taken as metres the arm would be a thousand times its size",
        cure="Write metres: " + ", ".join(f"{name.split('.')[-1]}: {1e-3 * value:.9g}" for name, value in long.items()),
    )


def _check_units(joint: Joint) -> None:
    """Raise Inconsistent where angles in radians are degrees."""
    angles = {"alpha_rad": joint.alpha_rad, "theta_rad": joint.theta_rad, "beta_rad": joint.beta_rad}
    limits = [value for value in (joint.lower, joint.upper) if math.isfinite(value)]
    wrong = [name for name, value in angles.items() if looks_like_degrees(value)]
    if joint.type is JointType.REVOLUTE and limits_look_like_degrees(limits):
        wrong += ["lower and upper"]
    if wrong:
        raise Inconsistent(
            f"joint {joint.name}: {', '.join(wrong)} look like degrees",
            consequence="Taken as radians they would be other angles",
            cure="Write radians; a joint without end has no lower and upper",
        )


ToolPointModel = codec.structure(ToolPoint)


class ArmModel(Origin):
    """arm.yaml."""

    format: Literal["armsight/arm"] = "armsight/arm"
    name: str = "arm"
    convention: Literal["standard", "craig"]
    T_world_base: codec.PoseModel | None = None
    T_base_frame0: codec.PoseModel | None = None
    T_flange_tool: codec.PoseModel | None = None
    base_link: str = ""
    tool_link: str = ""
    joints: list[JointModel]
    source: str = ""
    covariance: codec.CovarianceModel | None = None
    tool_points: list[ToolPointModel] = Field(default_factory=list)  # type: ignore[valid-type]  # of the record
    down_in_base: list[codec.Finite] | None = Field(default=None, min_length=3, max_length=3)


def _arm(model: ArmModel) -> Arm:
    poses = {
        key: pose.pose()
        for key in ("T_world_base", "T_base_frame0", "T_flange_tool")
        if (pose := getattr(model, key)) is not None
    }
    joints = tuple(map(codec.record_of, model.joints))
    for joint in joints:
        _check_units(joint)
    arm = Arm(
        name=model.name,
        joints=joints,
        convention=model.convention,  # type: ignore[arg-type]  # the record turns the word into its enum
        source=model.source,
        covariance=_covariance(model),
        couplings=tuple(
            Coupling(joint=joint.name, by=by, share=share)
            for joint in model.joints
            for by, share in (joint.coupled or {}).items()
        ),
        tool_points=tuple(map(codec.record_of, model.tool_points)),
        down_in_base=None if model.down_in_base is None else np.array(model.down_in_base),
        base_link=model.base_link,
        tool_link=model.tool_link,
        **poses,
    )
    return in_metres(arm)


def _covariance(model: ArmModel) -> NamedCovariance | None:
    """Return the covariance in the file, or the one its standard deviations make."""
    if model.covariance is not None:
        return model.covariance.covariance()
    std = {f"{joint.name}.{key}": value for joint in model.joints for key, value in (joint.std or {}).items()}
    if not std:
        return None
    if min(std.values()) < 0.0:
        raise BadFile("a standard deviation is negative")
    return NamedCovariance(names=tuple(std), matrix=np.diag(np.square(list(std.values()))))


def arm_mapping(arm: Arm) -> dict[str, Any]:
    """Return the arm as arm.yaml's structure, without format, version, origin and what it does not tell."""
    std, frame0 = arm.covariance.std() if arm.covariance else {}, arm.T_base_frame0.as_matrix()
    told = {
        "name": arm.name,
        "convention": arm.convention.value,
        "base_link": arm.base_link or None,
        "tool_link": arm.tool_link or None,
        "T_world_base": codec.pose_mapping(arm.T_world_base),
        "T_base_frame0": codec.pose_mapping(arm.T_base_frame0) if (frame0 != np.eye(4)).any() else None,
        "T_flange_tool": codec.pose_mapping(arm.T_flange_tool),
        "down_in_base": None if arm.down_in_base is None else arm.down_in_base.tolist(),
        "tool_points": [_tool_point_mapping(point) for point in arm.tool_points] or None,
        "joints": [joint_mapping(joint, std, arm.couplings) for joint in arm.joints],
        "source": arm.source or None,
        "covariance": codec.covariance_mapping(arm.covariance) if arm.covariance else None,
    }
    return {key: value for key, value in told.items() if value is not None}


def _tool_point_mapping(point: ToolPoint) -> dict[str, Any]:
    std = [value if math.isfinite(value) else None for value in point.std_m.tolist()]
    return {"name": point.name, "xyz_m": point.xyz_m.tolist(), "std_m": std}


def joint_mapping(joint: Joint, std: Mapping[str, float], couplings: Sequence[Coupling]) -> dict[str, Any]:
    """Return one joint as arm.yaml holds it; std: standard deviations by '<joint>.<key>'."""
    own = {key.removeprefix(f"{joint.name}."): value for key, value in std.items() if key.startswith(f"{joint.name}.")}
    content = codec.mapping(joint)
    if not joint.mass_kg:
        del content["com_m"]
    for key in ("compliance", "mass_kg"):
        if not content[key]:
            del content[key]
    if joint.driven:
        del content["driven"]
    coupled = {c.by: c.share for c in couplings if c.joint == joint.name}
    return content | ({"coupled": coupled} if coupled else {}) | ({"std": own} if own else {})


ARM_YAML: Kind[Arm] = Kind(name="arm", model=ArmModel, record=_arm, content=arm_mapping)
arm_from_mapping, read_arm, write_arm = ARM_YAML.parse, ARM_YAML.read, ARM_YAML.write
