"""What people read (mm, degrees, so many digits) and what the program computes in (m, rad, s)."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping

MM = 1e-3
"""One millimetre in metres."""

DEG = math.pi / 180.0
"""One degree in radians."""

MS = 1e-3
"""One millisecond in seconds."""

NOTHING = 1e-9
"""Below this no figure that people read says anything, in mm, degrees or px: 64-bit numbers are no finer."""

DISPLAY: Mapping[str, tuple[str, float]] = {
    "m": ("mm", MM),
    "rad": ("deg", DEG),
    "m/s": ("mm/s", MM),
    "1": ("", 1.0),
}
"""The unit in which people read what is computed in an SI unit, and what one of it is in SI."""
NAMED = ("m", "rad")
"""Units of DISPLAY that a name may end in."""
DIGITS = 3
"""Significant digits of a number that people read, where nothing else is said."""

WRITTEN = {"m": 1.0, "mm": MM, "rad": 1.0, "deg": DEG, "m/s": 1.0, "mm/s": MM}
"""Units that people may write behind a number, in SI."""


MOST = {"m": 20.0, "m/s": 20.0, "rad or m": 2.0 * math.pi}
"""Largest number without a unit: cells are metres wide, joints turn once. What is beyond was meant in mm or degrees."""
UNITS_OF = {"m": ("m", "mm"), "m/s": ("m/s", "mm/s"), "rad or m": ("rad", "deg", "m", "mm")}
"""The units that may be written behind a quantity."""


def read_value(text: str) -> tuple[float, str]:
    """Return a number in SI and the unit written behind it: (0.6, 'mm') of '600mm', (0.6, '') of '0.6'.

    Raises ValueError.
    """
    match = re.fullmatch(r"\s*([-+0-9.eE]+?)\s*(deg|rad|mm/s|m/s|mm|m|)\s*", text)
    if match is None:
        raise ValueError(text)
    return float(match[1]) * WRITTEN.get(match[2], 1.0), match[2]


def read_quantity(text: str, quantity: str) -> float:
    """Return a quantity of UNITS_OF in SI, SI where no unit is written behind it.

    Raises ValueError, with the ways to write it: also for a number that another unit was meant by.
    """
    units = UNITS_OF[quantity]
    try:
        value, unit = read_value(text)
    except ValueError:
        raise ValueError(f"{text!r} is no number of {quantity}; its units are {', '.join(units)}") from None
    if unit and unit not in units:
        raise ValueError(f"{text!r} is not in {' or '.join(units)}")
    if not unit and abs(value) > MOST[quantity]:
        raise ValueError(f"{text} {quantity} cannot be meant: write {' or '.join(text + unit for unit in units)}")
    return value


def displayed(unit: str) -> tuple[str, float]:
    """Return the unit in which people read a quantity of an SI unit, and its size in SI; others as they are."""
    return DISPLAY.get(unit, (unit, 1.0))


def displayed_name(name: str) -> tuple[str, str, float]:
    """Return a quantity's name without its unit, the unit in which people read it, and what one of it is in SI.

    'j2.d_m' is ('j2.d', 'mm', 1e-3); a name without a unit of NAMED is as it is, also one that is numbered: 'light_1'.
    """
    stem, _, unit = name.rpartition("_")
    return (stem, *DISPLAY[unit]) if stem and unit in NAMED else (name, "", 1.0)


def figure_of(value: float | None, unit: str = "", *, digits: int = DIGITS) -> str:
    """Return a number for people with so many significant digits; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    if abs(value) < NOTHING:
        shown = "0"
    elif 1e-4 <= abs(value) < 1e7:
        decimals = max(0, digits - 1 - math.floor(math.log10(abs(value))))
        shown = f"{value:.{decimals}f}"
    else:
        shown = f"{value:.{digits - 1}e}"
    return f"{shown}{unit}" if unit == "°" else f"{shown} {unit}".strip()


MOST_DECIMALS = 7
"""A figure with more is not read: 0.00000000 ms."""


def with_deviation(value: float, std: float | None) -> tuple[str, str]:
    """Return a value and its standard deviation, both to the standard deviation's second digit."""
    if std is None or not math.isfinite(std) or std <= 0.0:
        return figure_of(value, digits=7), "–"
    decimals = max(0, 1 - math.floor(math.log10(std)))
    if decimals > MOST_DECIMALS:
        return figure_of(value, digits=4), figure_of(std, digits=2)
    return f"{value:.{decimals}f}", f"{std:.{decimals}f}"


def pair_of(value: float | None, std: float | None) -> tuple[str, str]:
    """Return a value and its standard deviation to the same digit, or as they are where one is missing or zero."""
    return (figure_of(value), figure_of(std)) if value is None or not std else with_deviation(value, std)
