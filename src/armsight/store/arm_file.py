"""arm.yaml."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from armsight.errors import BadFile, Inconsistent
from armsight.kinematics import Arm, Coupling, Joint, JointType, ToolPoint
from armsight.records import NamedCovariance
from armsight.store.interpret import limits_look_like_degrees, looks_like_degrees, looks_like_mm
from armsight.store.schema import (
    CovarianceModel,
    Finite,
    Origin,
    PoseModel,
    Strict,
    covariance_mapping,
    named,
    pose_mapping,
    read_document,
    validated,
    write_document,
)

ARM_FORMAT = "armsight/arm"


class JointModel(Strict):
    """One joint; a limit that is missing or null is none."""

    name: str
    type: str
    a_m: Finite = 0.0
    alpha_rad: Finite = 0.0
    d_m: Finite = 0.0
    theta_rad: Finite = 0.0
    beta_rad: Finite = 0.0
    lower: float | None = None
    upper: float | None = None
    sign: Finite = 1.0
    max_speed: Finite | None = None
    stall_effort: Finite | None = None
    compliance: Finite = 0.0
    mass_kg: Finite = 0.0
    com_m: list[Finite] = Field(default=[0.0, 0.0, 0.0], min_length=3, max_length=3)
    coupled: dict[str, Finite] | None = None
    std: dict[str, Finite] | None = None

    def joint(self) -> Joint:
        """Return the record; Inconsistent where no joint can be like this."""
        values = self.model_dump(exclude={"coupled", "std", "lower", "upper"})
        self._check_units()
        return Joint(
            **values,
            lower=-math.inf if self.lower is None else self.lower,
            upper=math.inf if self.upper is None else self.upper,
        )

    def _check_units(self) -> None:
        """Raise Inconsistent where angles in radians are degrees, or lengths in metres millimetres."""
        lengths = [name for name, value in (("a_m", self.a_m), ("d_m", self.d_m)) if looks_like_mm(value)]
        if lengths:
            raise Inconsistent(
                f"joint {self.name}: {' and '.join(lengths)} look like millimetres",
                consequence="Taken as metres the arm would be a thousand times its size",
                cure="Write metres",
            )
        angles = {"alpha_rad": self.alpha_rad, "theta_rad": self.theta_rad, "beta_rad": self.beta_rad}
        limits = [value for value in (self.lower, self.upper) if value is not None]
        wrong = [name for name, value in angles.items() if looks_like_degrees(value)]
        if self.type == JointType.REVOLUTE.value and limits_look_like_degrees(limits):
            wrong += ["lower and upper"]
        if wrong:
            raise Inconsistent(
                f"joint {self.name}: {', '.join(wrong)} look like degrees",
                consequence="Taken as radians they would be other angles",
                cure="Write radians; a joint without end has no lower and upper",
            )


class ToolPointModel(Strict):
    """A named point of the tool in flange axes; a standard deviation that is null is not known."""

    name: str
    xyz_m: list[Finite] = Field(min_length=3, max_length=3)
    std_m: list[Finite | None] = Field(default=[None, None, None], min_length=3, max_length=3)

    def point(self) -> ToolPoint:
        """Return the record; Inconsistent where no point can be like this."""
        std = np.array([math.inf if value is None else value for value in self.std_m])
        return ToolPoint(name=self.name, xyz_m=np.array(self.xyz_m), std_m=std)


class ArmModel(Origin):
    """arm.yaml."""

    format: Literal["armsight/arm"] = "armsight/arm"
    name: str = "arm"
    convention: Literal["standard", "craig"]
    T_world_base: PoseModel | None = None
    T_flange_tool: PoseModel | None = None
    joints: list[JointModel]
    source: str = ""
    covariance: CovarianceModel | None = None
    tool_points: list[ToolPointModel] = Field(default_factory=list)
    down_in_base: list[Finite] | None = Field(default=None, min_length=3, max_length=3)


def arm_from_mapping(content: Mapping[str, Any], where: str = "arm") -> Arm:
    """Return the arm that arm.yaml's structure describes; BadFile, with where and the key, where it cannot be."""
    model = validated(ArmModel, content, where)
    with named(where):
        poses = {
            key: pose.pose() for key in ("T_world_base", "T_flange_tool") if (pose := getattr(model, key)) is not None
        }
        joints = tuple(joint.joint() for joint in model.joints)
        return Arm(
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
            tool_points=tuple(point.point() for point in model.tool_points),
            down_in_base=None if model.down_in_base is None else np.array(model.down_in_base),
            **poses,
        )


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
    """Return the arm as arm.yaml's structure, without format, version and origin."""
    std = arm.covariance.std() if arm.covariance else {}
    return {
        "name": arm.name,
        "convention": arm.convention.value,
        "T_world_base": pose_mapping(arm.T_world_base),
        "T_flange_tool": pose_mapping(arm.T_flange_tool),
        "down_in_base": None if arm.down_in_base is None else arm.down_in_base.tolist(),
        "tool_points": [_tool_point_mapping(point) for point in arm.tool_points] or None,
        "joints": [joint_mapping(joint, std, arm.couplings) for joint in arm.joints],
        "source": arm.source or None,
        "covariance": covariance_mapping(arm.covariance) if arm.covariance else None,
    }


def _tool_point_mapping(point: ToolPoint) -> dict[str, Any]:
    std = [value if math.isfinite(value) else None for value in point.std_m.tolist()]
    return {"name": point.name, "xyz_m": point.xyz_m.tolist(), "std_m": std}


def joint_mapping(joint: Joint, std: Mapping[str, float], couplings: Sequence[Coupling]) -> dict[str, Any]:
    """Return one joint as arm.yaml holds it; std: standard deviations by '<joint>.<key>'."""
    own = {key.removeprefix(f"{joint.name}."): value for key, value in std.items() if key.startswith(f"{joint.name}.")}
    content = {
        "name": joint.name,
        "type": JointType(joint.type).value,
        "a_m": joint.a_m,
        "alpha_rad": joint.alpha_rad,
        "d_m": joint.d_m,
        "theta_rad": joint.theta_rad,
        "beta_rad": joint.beta_rad,
        "lower": joint.lower if math.isfinite(joint.lower) else None,
        "upper": joint.upper if math.isfinite(joint.upper) else None,
        "sign": joint.sign,
        "max_speed": joint.max_speed,
        "stall_effort": joint.stall_effort,
        "compliance": joint.compliance or None,
        "mass_kg": joint.mass_kg or None,
        "com_m": list(joint.com_m) if joint.mass_kg else None,
        "coupled": {c.by: c.share for c in couplings if c.joint == joint.name} or None,
        "std": own or None,
    }
    return {key: value for key, value in content.items() if value is not None}


def read_arm(path: Path) -> Arm:
    """Return the arm in an arm.yaml; BadFile where it is none."""
    return arm_from_mapping(read_document(path, ARM_FORMAT), str(path))


def write_arm(path: Path, arm: Arm, *, inputs: Sequence[Path] = ()) -> None:
    """Write arm.yaml, with full precision and the hashes of what it was made from."""
    write_document(path, ARM_FORMAT, arm_mapping(arm), inputs)
