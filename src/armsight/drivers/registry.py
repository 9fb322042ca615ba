"""Drivers by name, from the entry points of every installed package: a new driver is a new package or file."""

from __future__ import annotations

from importlib.metadata import entry_points
from typing import Any

from armsight.errors import DeviceNotFound

CAMERAS = "armsight.cameras"
"""Group of callables (device: str, *, colour: bool, clock: Clock, origin_s: float[, settings: CameraSettings]) ->
FrameSource; settings is given only where a person asks for one."""

ROBOTS = "armsight.robots"
"""Group of callables (device: str, *, settings: Mapping[str, Any], clock: Clock) -> Robot."""

CELLS = "armsight.cells"
"""Group of callables (seed: int, frames: int) -> a simulated cell."""

SETS = "armsight.sets"
"""Group of callables (seed: int, size: int | None) -> a simulated set of pictures and tables for one calibration."""

SCENARIOS = "armsight.scenarios"
"""Group of pydantic models of scenario files, with cell(seed=, frames=) and robot(device, clock)."""


def known(group: str) -> tuple[str, ...]:
    """Return the names registered in a group, sorted."""
    return tuple(sorted({point.name for point in entry_points(group=group)}))


def load(group: str, name: str) -> Any:
    """Return what is registered under a name. Raises DeviceNotFound that lists the known names."""
    for point in entry_points(group=group):
        if point.name == name:
            try:
                return point.load()
            except ImportError as error:
                raise DeviceNotFound(
                    f"the driver {name} ({point.value}) cannot be loaded: {error}",
                    consequence="It cannot be used",
                    cure="Install what it needs",
                ) from error
    names = known(group)
    raise DeviceNotFound(
        f"nothing is registered under the name {name!r} in {group}",
        consequence="It cannot be used",
        cure=f"Known are: {', '.join(names)}"
        if names
        else "None is installed; `make install` registers the built-in ones",
    )
