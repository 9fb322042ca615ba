"""All numbers of a result by dotted names, each with the standard deviation that the result tells of it."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from armsight.columns import POSE6, POSITION
from armsight_lab.history.entry import Quantity, deviation, number

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
