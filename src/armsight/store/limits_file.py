"""limits.yaml: what the guard keeps a robot within."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from armsight.control.guard import Box, JointLimit, Limits
from armsight.store.schema import Finite, Origin, Strict, Vector3, named, read_document, validated, write_document

LIMITS_FORMAT = "armsight/limits"
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False, le=1e6)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False, le=1e6)]


class BoxModel(Strict):
    """A box in base axes."""

    lower_m: Vector3
    upper_m: Vector3
    name: str = "box"


class JointLimitModel(Strict):
    """One joint, in rad or m and per s, s^2, s^3; what is not there is the arm's own, or the guard's default."""

    lower: Finite | None = None
    upper: Finite | None = None
    speed: Positive | None = None
    acceleration: Positive | None = None
    jerk: Positive | None = None


class LimitsModel(Origin):
    """limits.yaml; every key but the format may be left out for its default."""

    format: Literal["armsight/limits"] = "armsight/limits"
    speed_m_s: Positive | None = None
    turn_rad_s: Positive | None = None
    acceleration_m_s2: Positive | None = None
    turn_acceleration_rad_s2: Positive | None = None
    jerk_m_s3: Positive | None = None
    turn_jerk_rad_s3: Positive | None = None
    joints: list[JointLimitModel] | None = None
    workspace: BoxModel | None = None
    forbidden: list[BoxModel] | None = None
    margin_m: NotNegative | None = None
    singularity: NotNegative | None = None
    enable_age_s: Positive | None = None
    target_age_s: Positive | None = None
    silent_cycles: Positive | None = None
    late_cycles: Positive | None = None
    lost_s: Positive | None = None
    calm_cycles: Annotated[int, Field(ge=0, le=100_000)] | None = None
    lag_s: Positive | None = None
    following: Positive | None = None
    following_m: Positive | None = None
    jump_m: Positive | None = None
    jump_rad: Positive | None = None
    retreat: list[Finite] | None = None
    retreat_after_s: NotNegative | None = None
    retreat_speed: Positive | None = None


def limits_from_mapping(content: Mapping[str, Any], where: str = "limits") -> Limits:
    """Return the limits that limits.yaml's structure describes; BadFile, with the key, where they cannot be."""
    model = validated(LimitsModel, content, where)
    names = {field.name for field in dataclasses.fields(Limits)}
    given = {name: getattr(model, name) for name in names if getattr(model, name) is not None}
    with named(where):
        if model.joints is not None:
            rows = [joint.model_dump(exclude_none=True) for joint in model.joints]
            given["joints"] = tuple(JointLimit(**row) for row in rows)
        if model.workspace is not None:
            given["workspace"] = _box(model.workspace)
        if model.forbidden is not None:
            given["forbidden"] = tuple(_box(box) for box in model.forbidden)
        return Limits(**given)


def limits_mapping(limits: Limits) -> dict[str, Any]:
    """Return limits as limits.yaml has them, all of them written out."""
    content = {field.name: getattr(limits, field.name) for field in dataclasses.fields(limits)}
    content["joints"] = [_joint_mapping(joint) for joint in limits.joints] or None
    content["workspace"] = None if limits.workspace is None else _box_mapping(limits.workspace)
    content["forbidden"] = [_box_mapping(box) for box in limits.forbidden]
    content["retreat"] = None if limits.retreat is None else limits.retreat.tolist()
    return content


def read_limits(path: Path) -> Limits:
    """Return what a limits.yaml says; BadFile where it is none."""
    return limits_from_mapping(read_document(path, LIMITS_FORMAT), str(path))


def write_limits(path: Path, limits: Limits, *, inputs: Sequence[Path] = ()) -> None:
    """Write limits.yaml with the hashes of the files it was made from."""
    write_document(path, LIMITS_FORMAT, limits_mapping(limits), inputs)


def _box(model: BoxModel) -> Box:
    return Box(lower_m=model.lower_m, upper_m=model.upper_m, name=model.name)  # type: ignore[arg-type]  # it copies


def _box_mapping(box: Box) -> dict[str, Any]:
    return {"name": box.name, "lower_m": box.lower_m.tolist(), "upper_m": box.upper_m.tolist()}


def _joint_mapping(joint: JointLimit) -> dict[str, Any]:
    rows = {field.name: getattr(joint, field.name) for field in dataclasses.fields(joint)}
    return {key: value for key, value in rows.items() if value is not None and abs(value) != float("inf")}
