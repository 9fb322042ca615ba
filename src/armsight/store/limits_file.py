"""limits.yaml: what the guard keeps a robot within."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal

from pydantic import Field

from armsight.control.guard import Box, JointLimit, Limits
from armsight.errors import Inconsistent
from armsight.store.schema import Finite, Origin, Strict, Vector3, named, read_document, validated, write_document
from armsight.units import DEG, MM, MS

LIMITS_FORMAT = "armsight/limits"
Positive = Annotated[float, Field(gt=0.0, allow_inf_nan=False, le=1e6)]
NotNegative = Annotated[float, Field(ge=0.0, allow_inf_nan=False, le=1e6)]


@dataclasses.dataclass(frozen=True, slots=True)
class Plausible:
    """most: the largest value of a key that is meant as it stands, in unit; beyond it, it is taken for one in small.

    one: one of those in the key's own unit. small is empty where no other unit is likely.
    """

    most: float
    unit: str
    small: str
    one: float


PLAUSIBLE = {
    # a delta arm's tool goes 10 m/s at 150 m/s^2; a SCARA's last joint turns at 2,600 deg/s, which is 45 rad/s
    "speed_m_s": Plausible(20.0, "m/s", "mm/s", MM),
    "turn_rad_s": Plausible(50.0, "rad/s", "deg/s", DEG),
    "acceleration_m_s2": Plausible(500.0, "m/s^2", "mm/s^2", MM),
    "turn_acceleration_rad_s2": Plausible(1000.0, "rad/s^2", "deg/s^2", DEG),
    # those accelerations within 10 to 20 ms
    "jerk_m_s3": Plausible(50_000.0, "m/s^3", "mm/s^3", MM),
    "turn_jerk_rad_s3": Plausible(50_000.0, "rad/s^3", "deg/s^3", DEG),
    # a tenth and more of most arms' reach; a path at 10 m/s goes 0.12 m in a cycle of 12 ms, one at 50 rad/s 0.6 rad
    "margin_m": Plausible(0.5, "m", "mm", MM),
    "jump_m": Plausible(0.5, "m", "mm", MM),
    "jump_rad": Plausible(1.0, "rad", "degrees", DEG),
    "following": Plausible(0.5, "rad", "degrees", DEG),
    "following_m": Plausible(0.5, "m", "mm", MM),
    # a least singular value, lengths in mean links, is below 1 for every preset
    "singularity": Plausible(1.0, "", "percent", 0.01),
    # ten frames or commands of one second; a target may be waited for during minutes
    "target_age_s": Plausible(10.0, "s", "ms", MS),
    "lost_s": Plausible(10.0, "s", "ms", MS),
    "lag_s": Plausible(10.0, "s", "ms", MS),
    "retreat_after_s": Plausible(900.0, "s", "ms", MS),
    # shares and counts of cycles: beyond a second of the fastest link, of 1 ms, they watch nothing
    "silent_cycles": Plausible(1000.0, "cycles", "", 1.0),
    "late_cycles": Plausible(1000.0, "cycles", "", 1.0),
}
MOST_M = 30.0
"""Of a corner: no arm stands so far from its box, a linear axis of 10 m is a long one; millimetres go beyond it."""


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
    joints: Annotated[list[JointLimitModel], Field(min_length=1)] | None = None
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
    with named(where):
        _check_values(content)
    model = validated(LimitsModel, content, where)
    names = {field.name for field in dataclasses.fields(Limits)}
    given = {name: getattr(model, name) for name in names if getattr(model, name) is not None}
    with named(where):
        _check_units(given)
        if model.joints is not None:
            given["joints"] = tuple(_joint(joint, k + 1) for k, joint in enumerate(model.joints))
        if model.workspace is not None:
            given["workspace"] = _box(model.workspace, "workspace")
        if model.forbidden is not None:
            given["forbidden"] = tuple(_box(box, f"forbidden[{k}]") for k, box in enumerate(model.forbidden))
        return Limits(**given)


def _check_units(given: Mapping[str, Any]) -> None:
    """Raise Inconsistent for values that no arm has: they are in another unit, and would keep nothing."""
    for key, plausible in PLAUSIBLE.items():
        value = given.get(key)
        if value is None or value <= plausible.most:
            continue
        unit, small = plausible.unit, plausible.small
        like = f": it looks like {small}" if small else ""
        raise Inconsistent(
            " ".join(f"{key} is {value:g} {unit}".split()) + f", more than any arm needs ({plausible.most:g}){like}",
            consequence="As it stands it would not keep what is meant, and nothing is moved",
            cure=f"{value:g} {small} would be {key}: {value * plausible.one:.4g}" if small else f"Give {unit}",
        )


def _check_values(content: Any, key: str = "") -> None:
    """Raise Inconsistent for a key without a value: what was to stand there would not be kept."""
    parts = content.items() if isinstance(content, Mapping) else enumerate(content) if isinstance(content, list) else ()
    for part, value in parts:
        at = f"{key}[{part}]" if isinstance(part, int) else f"{key}.{part}" if key else str(part)
        if value is None:
            raise Inconsistent(
                f"{at[:80]} has no value",
                consequence="What should stand there would not be kept, and nothing is moved",
                cure="Give one, or leave the key away for the default",
            )
        _check_values(value, at)


def _joint(model: JointLimitModel, number: int) -> JointLimit:
    with named(f"joint {number}"):
        return JointLimit(**model.model_dump(exclude_none=True))


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


def _box(model: BoxModel, key: str) -> Box:
    """Return a box of the file; Inconsistent, with its key, where it is inside out or its corners are in mm."""
    called = key if model.name == BoxModel.model_fields["name"].default else f"{key} {model.name}"
    corners = [*model.lower_m, *model.upper_m]
    furthest = max(corners, key=abs)
    if abs(furthest) > MOST_M:
        lower, upper = ([float(f"{v * MM:.4g}") for v in corner] for corner in (model.lower_m, model.upper_m))
        raise Inconsistent(
            f"{called}: a corner at {furthest:g} m is further away than any arm: it looks like mm",
            consequence="As it stands it would limit nothing, and nothing is moved",
            cure=f"Write m (from mm: lower_m: {lower}, upper_m: {upper}); an endless wall may be {MOST_M:g} m off",
        )
    with named(called):
        return Box(lower_m=model.lower_m, upper_m=model.upper_m, name=model.name)  # type: ignore[arg-type]  # it copies


def _box_mapping(box: Box) -> dict[str, Any]:
    return {"name": box.name, "lower_m": box.lower_m.tolist(), "upper_m": box.upper_m.tolist()}


def _joint_mapping(joint: JointLimit) -> dict[str, Any]:
    rows = {field.name: getattr(joint, field.name) for field in dataclasses.fields(joint)}
    return {key: value for key, value in rows.items() if value is not None and abs(value) != float("inf")}
