"""All numbers of a result by dotted names, each with the standard deviation that the result tells of it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

from armsight.columns import DH_ROW, POSE6, POSITION
from armsight.kinematics import Arm, JointType
from armsight.records import NamedCovariance
from armsight_lab.history.entry import Quantity, StoredPose, deviation, number, stored_pose

LONGEST_LIST = 64
"""Entries of a list whose numbers are figures; longer ones, such as rows left out, stay in the result alone."""
LONGEST_NAME = 200
UNITS = re.compile(r"_(m_s|m|rad_s|rad|px|s|hz|ppm|deg|mm)$")
POSES_STD: Mapping[str, str] = {
    "T_flange_camera": "std",
    "T_base_camera": "std",
    "T_base_target": "std_target",
    "T_flange_target": "std_target",
    "T_base_rig": "std",
}
"""Poses of results by the key beside them that tells their deviations."""
STDS = ("std", "std_target")

Content = Mapping[str, Any]


def figures_of(result: Content) -> tuple[Quantity, ...]:
    """Return the numbers of a result as its JSON object holds it; lists count from 1. Keys of std become deviations."""
    named: dict[str, Quantity] = {}
    for one in _walked(result, "", {}):
        if len(one.name) <= LONGEST_NAME:
            named.setdefault(one.name, one)
    return tuple(named.values())


def unit_of(name: str) -> str:
    """Return the unit that a name ends in, '' for none."""
    found = UNITS.search(name)
    return "" if found is None else found[1].replace("m_s", "m/s").replace("rad_s", "rad/s")


def _walked(content: Content, prefix: str, above: Content) -> Iterator[Quantity]:
    """Yield the numbers of a mapping; above: deviations that stand beside it, by its keys."""
    own = content.get("std")
    stds: Content = own if isinstance(own, Mapping) else {}
    for key, value in content.items():
        name = f"{prefix}{key}"
        if key in STDS and isinstance(value, Mapping):
            yield from _left_over(content, value, name)
        elif isinstance(value, Mapping) and "quat_xyzw" in value:
            beside = content.get(POSES_STD.get(key, ""), {})
            yield from _pose(name, value, beside if isinstance(beside, Mapping) else {})
        elif isinstance(value, Mapping):
            yield from _walked(value, f"{name}.", stds)
        elif isinstance(value, list):
            yield from _listed(name, value, [stds.get(axis) for axis in POSITION] if key == "tip_m" else [])
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield _quantity(name, value, _beside(content, key, {**above, **stds}))


def _beside(content: Content, key: str, stds: Content) -> object:
    """Return the deviation of a number: under std by its name, or beside it as results write it.

    time_offset_s has time_offset_std_s, offset_rad has std_rad, and value and factor have std.
    """
    if key in stds:
        return stds[key]
    unit = UNITS.search(key)
    if unit is not None:
        stem = key[: unit.start()]
        for other in (f"{stem}_std{unit[0]}", *([f"std{unit[0]}"] if stem == "offset" else [])):
            if other in content:
                return content[other]
    return content.get("std") if key in ("value", "factor") else None


def _left_over(content: Content, stds: Content, name: str) -> Iterator[Quantity]:
    """Yield deviations of what the result holds no number of beside them, as numbers of their own."""
    beside = [part for key, part in content.items() if key not in STDS and isinstance(part, Mapping)]
    told = {key for part in (content, *beside) for key in part}
    told |= {*POSE6}
    for key, value in stds.items():
        if key not in told and number(value) is not None:
            yield _quantity(f"{name}.{key}", value, None)


def _pose(name: str, pose: Content, stds: Content) -> Iterator[Quantity]:
    for axis, value in zip(POSITION, pose["xyz_m"], strict=True):
        yield _quantity(f"{name}.{axis}", value, stds.get(axis))
    for part, value in zip("xyzw", pose["quat_xyzw"], strict=True):
        yield _quantity(f"{name}.q{part}", value, None)


def _listed(name: str, values: Sequence[Any], stds: Sequence[Any]) -> Iterator[Quantity]:
    if len(values) > LONGEST_LIST:
        return
    for i, value in enumerate(values, 1):
        if isinstance(value, Mapping):
            yield from _walked(value, f"{name}.{i}.", {})
        elif isinstance(value, list):
            yield from _listed(f"{name}.{i}", value, [])
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield _quantity(f"{name}.{i}", value, stds[i - 1] if stds else None, unit_of(name))


def _quantity(name: str, value: object, std: object, unit: str | None = None) -> Quantity:
    return Quantity(name=name, value=number(value), std=deviation(std), unit=unit_of(name) if unit is None else unit)


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
    found = [*_scalars(result), *_tip(result), *_of_the_norm(result)]
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


def of_cameras(places_m: Mapping[str, Any], stds: Mapping[str, Any]) -> Parameters:
    """Return the places of a rig's cameras in its axes, but of the one that is held there, which has no deviations."""
    named = {name: f"{name}.t" for name in places_m if f"{name}.tx_m" in stds}
    rows = (point_named(f"camera.{name}", places_m[name], stds, prefix).quantities for name, prefix in named.items())
    return Parameters(quantities=tuple(one for row in rows for one in row))


def _stds(covariance: NamedCovariance | None) -> Mapping[str, float]:
    return {} if covariance is None else covariance.std()


def _scalars(result: Content) -> Iterator[Quantity]:
    stds = result.get("std")
    if not isinstance(stds, Mapping):
        return
    if result.get("baseline_m") is not None:  # null of other cameras than a pair
        yield _quantity("baseline_m", result["baseline_m"], stds.get("baseline_m", result.get("baseline_std_m")))
    if isinstance(places := result.get("position_m"), Mapping):
        yield from of_cameras(places, stds).quantities
    for key in CAMERA:
        if key in result:
            yield _quantity(f"camera.{key}", result[key], stds.get(key))


def _tip(result: Content) -> Iterator[Quantity]:
    tip, stds = result.get("tip_m"), result.get("std")
    if isinstance(tip, list) and len(tip) == len(POSITION) and isinstance(stds, Mapping):
        yield from point_named("tip", tip, stds).quantities


def _of_the_norm(result: Content) -> Iterator[Quantity]:
    """Yield accuracy and repeatability of pose (ISO 9283), worst place; none whose visits drift, as it has no std."""
    figures = result.get("iso9283")
    if not isinstance(figures, Mapping):
        return
    for key in ("AP_m", "RP_m"):
        one = figures.get(key)
        if isinstance(one, Mapping) and number(one.get("value")) is not None and number(one.get("std")) is not None:
            yield _quantity(key, one["value"], one["std"])


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
