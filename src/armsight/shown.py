"""Numbers and tables as people read them, on a terminal and wherever text is shown."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from typing import NamedTuple

from armsight.units import DEG, DIGITS, MM, NOTHING, displayed_name

REJECTED_SHOWN = 8
"""Lines of what was left out; the report and JSON have all."""
WRITTEN = "Written: {out}"
"""The line of the file that was written: a result does not know its name, and who shows it fills it in."""
RESULTS = "Results: {out}; open {report}"
"""The line of a folder that was written, and of its page."""


class Table(NamedTuple):
    """A table of text; the first column is words, the others are numbers."""

    title: str
    header: Sequence[str]
    rows: Sequence[Sequence[str]]


class Bars(NamedTuple):
    """A plot of one number a row. x, y: what the axes are called."""

    title: str
    names: Sequence[str]
    values: Sequence[float]
    x: str
    y: str


Shown = Table | str
"""What a result shows of itself: tables, and lines between them."""


def digits(value: float | None, digits: int = DIGITS) -> str:
    """Return a number with so many significant digits, never in powers of ten; '-' for none."""
    if value is None or not math.isfinite(value):
        return "-"
    if abs(value) < NOTHING:
        return "0"
    decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
    return f"{value:.{min(decimals, 9)}f}"


def rejected_lines(rejected: Sequence[tuple[str, str]]) -> Iterator[str]:
    """Yield the first of what was left out, by name and reason, and how many more there are."""
    yield from (f"  left out {name}: {why}" for name, why in rejected[:REJECTED_SHOWN])
    if len(rejected) > REJECTED_SHOWN:
        yield f"  ... and {len(rejected) - REJECTED_SHOWN} more"


def point_rows(xyz_m: Iterable[float], std_m: Iterable[float]) -> list[list[str]]:
    """Return the rows of a point: axis, position and standard deviation in mm."""
    named = zip("xyz", xyz_m, std_m, strict=True)
    return [[axis, digits(value / MM, 6), digits(deviation / MM, 2)] for axis, value, deviation in named]


def parameter_row(name: str, *values: float) -> list[str]:
    """Return the row of a parameter such as j2.theta_rad: its name with the unit people read, and values in it."""
    stem, unit, factor = displayed_name(name)
    return [f"{stem}, {unit}" if unit else stem, *(digits(value / factor, 4) for value in values)]


def pose_rows(
    xyz_m: Iterable[float], rotvec_rad: Iterable[float], std_m: Iterable[float], std_rad: Iterable[float]
) -> list[list[str]]:
    """Return the rows of a pose: position in mm and rotation vector in degrees, each with its standard deviation."""
    rows = [[f"{axis}, mm", *rest] for axis, *rest in point_rows(xyz_m, std_m)]
    return rows + rotation_rows(rotvec_rad, std_rad)


def rotation_rows(rotvec_rad: Iterable[float], std_rad: Iterable[float]) -> list[list[str]]:
    """Return the rows of a rotation vector: component and standard deviation in degrees."""
    named = zip("xyz", rotvec_rad, std_rad, strict=True)
    return [
        [f"rotation vector {axis}, deg", digits(value / DEG, 6), digits(deviation / DEG, 2)]
        for axis, value, deviation in named
    ]
