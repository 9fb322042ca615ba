"""The symbols of ISO 9283 in words, and their figures as they are shown."""

from __future__ import annotations

from collections.abc import Mapping

from armsight.units import DEG, MM

FIGURES: Mapping[str, str] = {
    "AP": "accuracy of a pose: the mean of the visits less what was commanded",
    "RP": "repeatability of a pose: distance from the mean, mean and three standard deviations",
    "vAP": "variation of accuracy between directions of approach",
    "dAP": "drift of accuracy, from the first visits of a pose to the last",
    "dRP": "drift of repeatability, from the first visits of a pose to the last",
    "AD": "accuracy of a distance",
    "RD": "repeatability of a distance",
    "AT": "accuracy of a path",
    "RT": "repeatability of a path",
    "CR": "rounding of a corner",
    "CO": "overshoot at a corner",
    "AV": "accuracy of the speed",
    "RV": "repeatability of the speed",
    "FV": "fluctuation of the speed",
    "t": "time to come to rest",
    "OV": "overshoot at a pose",
    "E": "exchangeability of robots",
}
"""What the norm's symbols mean."""


def symbol_of(name: str) -> tuple[str, str, float]:
    """Return a figure's symbol, the unit it is shown in, and that unit in SI."""
    for tail, unit, factor in (("_m_s", "mm/s", MM), ("_rad", "°", DEG), ("_ratio", "%", 0.01), ("_s", "s", 1.0)):
        if name.endswith(tail):
            return name.removesuffix(tail), unit, factor
    return name.removesuffix("_m"), "mm", MM
