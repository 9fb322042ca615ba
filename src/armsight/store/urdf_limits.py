"""The limits of a URDF's joints: what is written where there are none, and degrees taken for radians."""

from __future__ import annotations

import math
from collections.abc import Sequence

from armsight.errors import BadFile
from armsight.store.interpret import limits_look_like_degrees, looks_like_mm
from armsight.store.urdf_elements import numbers
from armsight.store.urdf_tree import UrdfJoint

NO_LIMIT = 1e9
"""What a limit without end is written as: URDF has no word for it on one side."""

ENDLESS = 800.0
"""rad: beyond 127 turns (and, were it degrees, more than two) a limit is none; 1e3 to 1e16 are written."""

ENDLESS_SLIDE_M = 1e4
"""m: ten kilometres are no slide, nor ten metres in thousandths of a mm."""

Limits = tuple[float, float]


def limits_of(joints: Sequence[UrdfJoint]) -> tuple[list[Limits], list[str]]:
    """Return lower and upper of moving joints, infinite for none, and what was taken otherwise than it is written.

    0 to 0, which exporters write where nothing was filled in, is no limit. Raises BadFile for limits swapped or equal,
    in degrees, or in mm.
    """
    found: list[Limits] = []
    unset: list[str] = []
    for joint in joints:
        if joint.type == "continuous":
            found.append((-math.inf, math.inf))
            continue
        lower, upper = (_end(joint, key) for key in ("lower", "upper"))
        if lower == upper == 0.0:
            unset.append(joint.name)
            lower, upper = -math.inf, math.inf
        if not lower < upper:
            what = "swapped" if lower > upper else "equal"
            raise BadFile(
                f"{joint.at}: its limits are {what}: lower {lower:g}, upper {upper:g}",
                consequence="The joint could not move",
                cure="Give the smaller one as lower; of a joint that stands still write type fixed",
            )
        _check_unit(joint, lower, upper)
        found.append((lower, upper))
    notes = [f"no limits of {', '.join(unset)}: written are 0 to 0"] if unset else []
    return found, notes


def _end(joint: UrdfJoint, key: str) -> float:
    """Return one limit in rad or m; infinite beyond what is one."""
    limit = joint.element.find("limit")
    text = None if limit is None else limit.get(key)
    value = float(numbers(text, "0", 1, f"{joint.at}: {key} limit", endless=True)[0])
    return math.copysign(math.inf, value) if abs(value) >= _endless(joint) else value


def _endless(joint: UrdfJoint) -> float:
    return ENDLESS_SLIDE_M if joint.type == "prismatic" else ENDLESS


def _check_unit(joint: UrdfJoint, lower: float, upper: float) -> None:
    """Raise BadFile for a turning joint's limits in degrees, a sliding one's in mm."""
    ends = [value for value in (lower, upper) if math.isfinite(value)]
    if joint.type == "prismatic":
        if looks_like_mm(ends):
            raise BadFile(
                f"{joint.at}: its limits {lower:g} to {upper:g} look like millimetres",
                consequence="Taken as URDF means it the joint would slide a thousand times as far",
                cure=f'Write metres: lower="{1e-3 * lower:.9g}" upper="{1e-3 * upper:.9g}"',
            )
        return
    if limits_look_like_degrees(ends):
        raise BadFile(
            f"{joint.at}: its limits {lower:g} to {upper:g} look like degrees",
            consequence="Taken as URDF means it the joint would turn many times round",
            cure=f'Write radians: lower="{math.radians(lower):.9g}" upper="{math.radians(upper):.9g}"; of a joint that '
            "turns without end write type continuous",
        )
