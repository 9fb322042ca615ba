"""Units as headers name them."""

from __future__ import annotations

from collections.abc import Mapping

from armsight.units import DEG, MM

UNITS: Mapping[str, tuple[str, float]] = {
    "m": ("length", 1.0),
    "mm": ("length", MM),
    "cm": ("length", 1e-2),
    "um": ("length", 1e-6),
    "in": ("length", 0.0254),
    "inch": ("length", 0.0254),
    "rad": ("angle", 1.0),
    "mrad": ("angle", 1e-3),
    "deg": ("angle", DEG),
    "degree": ("angle", DEG),
    "degrees": ("angle", DEG),
    "°": ("angle", DEG),
    "s": ("time", 1.0),
    "sec": ("time", 1.0),
    "ms": ("time", 1e-3),
    "us": ("time", 1e-6),
    "ns": ("time", 1e-9),
}
"""Kind of quantity, and the SI unit's part."""
