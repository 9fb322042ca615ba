"""The symbols of ISO 9283 in words."""

from __future__ import annotations

from collections.abc import Mapping

FIGURES: Mapping[str, str] = {
    "AP": "accuracy of a pose: the mean of the visits less what was commanded",
    "RP": "repeatability of a pose: distance from the mean, mean and three standard deviations",
    "vAP": "variation of accuracy between directions of approach",
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
