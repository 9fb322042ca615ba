"""limits.yaml: what the guard keeps a robot within."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

from armsight.control.guard import Box, Limits
from armsight.errors import Inconsistent
from armsight.store.codec import mapping, named, record_of, structure, validated
from armsight.store.schema import Origin, read_document, write_document
from armsight.units import DEG, MM, MS

LIMITS_FORMAT = "armsight/limits"


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
    # half a second: controllers end a guidance that is silent for 0.1 to 1 s
    "stall_s": Plausible(0.5, "s", "ms", MS),
    "lost_s": Plausible(10.0, "s", "ms", MS),
    "lag_s": Plausible(10.0, "s", "ms", MS),
    "retreat_after_s": Plausible(900.0, "s", "ms", MS),
    # shares and counts of cycles: beyond a second of the fastest link, of 1 ms, they watch nothing
    "silent_cycles": Plausible(1000.0, "cycles", "", 1.0),
    "late_cycles": Plausible(1000.0, "cycles", "", 1.0),
}
MOST_M = 30.0
"""Of a corner: no arm stands so far from its box, a linear axis of 10 m is a long one; millimetres go beyond it."""


Limit = structure(Limits)


class LimitsModel(Origin, Limit):  # type: ignore[valid-type, misc]  # made of the record's fields
    """limits.yaml; every key but the format may be left out for its default."""

    record = Limits
    format: Literal["armsight/limits"] = "armsight/limits"


def limits_from_mapping(content: Mapping[str, Any], where: str = "limits") -> Limits:
    """Return the limits that limits.yaml's structure describes; BadFile, with the key, where they cannot be."""
    with named(where):
        _check_values(content)
    model = validated(LimitsModel, content, where)
    with named(where):
        limits: Limits = record_of(model)
        _check_units(limits)
        for key, boxes in (("workspace", [limits.workspace]), ("forbidden", limits.forbidden)):
            for k, box in enumerate(boxes):
                if box is not None:
                    _check_corners(box, key if key == "workspace" else f"{key}[{k}]")
        return limits


def _check_units(limits: Limits) -> None:
    """Raise Inconsistent for values that no arm has: they are in another unit, and would keep nothing."""
    for key, plausible in PLAUSIBLE.items():
        value = getattr(limits, key)
        if value <= plausible.most:
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


def limits_mapping(limits: Limits) -> dict[str, Any]:
    """Return limits as limits.yaml has them, all of them written out."""
    content = mapping(limits)
    return content if limits.joints else {key: value for key, value in content.items() if key != "joints"}


def read_limits(path: Path) -> Limits:
    """Return what a limits.yaml says; BadFile where it is none."""
    return limits_from_mapping(read_document(path, LIMITS_FORMAT), str(path))


def write_limits(path: Path, limits: Limits, *, inputs: Sequence[Path] = ()) -> None:
    """Write limits.yaml with the hashes of the files it was made from."""
    write_document(path, LIMITS_FORMAT, limits_mapping(limits), inputs)


def _check_corners(box: Box, key: str) -> None:
    """Raise Inconsistent, with the box's key, where its corners are in mm."""
    called = key if box.name == "box" else f"{key} {box.name}"
    furthest = max((*box.lower_m.tolist(), *box.upper_m.tolist()), key=abs)
    if abs(furthest) > MOST_M:
        lower, upper = ([float(f"{v * MM:.4g}") for v in corner] for corner in (box.lower_m, box.upper_m))
        raise Inconsistent(
            f"{called}: a corner at {furthest:g} m is further away than any arm: it looks like mm",
            consequence="As it stands it would limit nothing, and nothing is moved",
            cure=f"Write m (from mm: lower_m: {lower}, upper_m: {upper}); an endless wall may be {MOST_M:g} m off",
        )
