"""What installed packages register by name: drivers, and what distributions beside armsight bring."""

from __future__ import annotations

from importlib.metadata import EntryPoint, entry_points
from importlib.util import find_spec
from pathlib import Path
from typing import Any

from armsight.errors import DeviceNotFound

CAMERAS = "armsight.cameras"
"""Group of callables (device: str, *, colour: bool, clock: Clock, origin_s: float[, settings: CameraSettings]) ->
FrameSource; settings is given only where a person asks for one."""

ROBOTS = "armsight.robots"
"""Group of callables (device: str, *, settings: Mapping[str, Any], clock: Clock) -> Robot."""

TRACKERS = "armsight.trackers"
"""Group of callables (device: str, *, body: str, std_m: float, std_rad: float) -> drivers.trackers.BodyStream."""

CELLS = "armsight.cells"
"""Group of callables (seed: int, frames: int) -> a simulated cell."""

SETS = "armsight.sets"
"""Group of callables (seed: int, size: int | None) -> a simulated set of pictures and tables for one calibration."""

SCENARIOS = "armsight.scenarios"
"""Group of what scenarios need: the pydantic model of their files, what builds a world or a live cell of one, and the
folder of the built-in ones."""

TWINS = "armsight.twins"
"""Group of callables (*, port, connect, arm, cycle_s, clock) -> Twin: emulated controllers, see armsight_sim.twins."""

PAPERS = "armsight.papers"
"""Group of `reproduce`: (paper: str, out: Path, *, seed, frames, progress) -> ReproduceOutput."""

COMMANDS = "armsight.commands"
"""Group of cli.command.Command, by the command's words with a dot between them."""

PLANT = "armsight.plant"
"""Group of what armsight-plant brings: `publishing`: (PlantFlags, notify, users) -> Publishing; `make-pair`."""

FILING = "armsight.history"
"""Group of a callable (command, cell, history, given) -> what has `file`, a cli.command.Filing, named `filing`."""

SIMULATION = (CELLS, SETS, SCENARIOS, TWINS, PAPERS)
"""Groups that armsight-sim fills, a distribution of its own; it also brings the name `sim` of ROBOTS and CAMERAS."""


def known(group: str) -> tuple[str, ...]:
    """Return the names registered in a group, sorted."""
    return tuple(sorted({point.name for point in entry_points(group=group)}))


def load(group: str, name: str) -> Any:
    """Return what is registered under a name. Raises DeviceNotFound that lists the known names."""
    point = _point(group, name)
    try:
        return point.load()
    except ImportError as error:
        raise DeviceNotFound(
            f"the driver {name} ({point.value}) cannot be loaded: {error}",
            consequence="It cannot be used",
            cure="Install what it needs",
        ) from error


def extension(group: str, name: str, extra: str) -> Any:
    """Return what the distribution armsight-EXTRA registers. Raises DeviceNotFound that says what to install."""
    if name not in known(group):
        raise not_installed(name.replace(".", " "), extra)
    return load(group, name)


def not_installed(what: str, extra: str) -> DeviceNotFound:
    """Return the refusal of what the distribution armsight-EXTRA would bring."""
    return DeviceNotFound(
        f"{what} is part of armsight-{extra}, which is not installed",
        consequence="Nothing was done",
        cure=f"Install it: pip install 'armsight[{extra}]'",
    )


def folder(group: str, name: str) -> Path:
    """Return the folder that is registered under a name by its dotted path; raises DeviceNotFound as load.

    The package that holds it is not imported: it may take longer than to read what is in the folder.
    """
    point = _point(group, name)
    package, *inside = point.value.split(".")
    spec = find_spec(package)
    if spec is None or not spec.submodule_search_locations:
        raise DeviceNotFound(
            f"{package}, which holds {name} of {group}, is registered and not there",
            consequence="It cannot be used",
            cure="Install it anew",
        )
    return Path(spec.submodule_search_locations[0]).joinpath(*inside)


def _point(group: str, name: str) -> EntryPoint:
    for point in entry_points(group=group):
        if point.name == name:
            return point
    names = known(group)
    if (group in SIMULATION or name == "sim") and not known(SCENARIOS):
        raise DeviceNotFound(
            "the simulation (armsight-sim) is not installed",
            consequence="There are no simulated cells, robots, cameras and controllers, and no paper's experiment",
            cure="Install it: pip install 'armsight[sim]'",
        )
    raise DeviceNotFound(
        f"nothing is registered under the name {name!r} in {group}",
        consequence="It cannot be used",
        cure=f"Known are: {', '.join(names)}"
        if names
        else "None is installed; `make install` registers the built-in ones",
    )
