"""What the commands are told that stand alone: simulate, reproduce and doctor."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, TypeAlias

from armsight.app.simulate import MOST_FRAMES
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.flags import OutFolder
from armsight.units import MM

Room: TypeAlias = Annotated[
    str | None, Doc("Behind the target: dark, workshop, office, plain or a picture. [default: its own]")
]
SIGMA_PX = 0.1
"""Standard deviation of a spot's centre, where nobody says."""


@dataclass(frozen=True, kw_only=True)
class SimulateJob:
    """A simulated cell, or a set for one calibration."""

    scenario: Annotated[str, Doc("A scenario's name or file; or the name of a cell or set."), Flag(positional=True)]
    out: OutFolder
    seed: Annotated[int | None, Doc("The same seed gives the same run. [default: the file's]"), Bounds(least=0)] = None
    frames: Annotated[
        int | None, Doc("How many frames, or rows. [default: the file's]"), Bounds(least=1, most=MOST_FRAMES)
    ] = None
    room: Room = None
    zoom: Annotated[
        float | None, Doc("Zoom lenses before the cameras, at this setting, 100 to 500 where not said.")
    ] = None


@dataclass(frozen=True, kw_only=True)
class ReproduceJob:
    """A paper's experiment."""

    paper: Annotated[str, Doc("korayem2018, pachidis2005 or kapucu2005."), Flag(positional=True)]
    out: OutFolder
    seed: Annotated[int, Doc("Of the simulated frames' noise."), Bounds(least=0)] = 1
    frames: Annotated[
        int | None, Doc("Fewer frames than the paper took, to try it. [default: the paper's]"), Bounds(least=1)
    ] = None


@dataclass(frozen=True, kw_only=True)
class DoctorJob:
    """What is to be told of a machine, and of a rig."""

    rig: Annotated[Path | None, Doc("Tell what this rig can tell apart at distances.")] = None
    depths_m: Annotated[
        list[float] | None,
        Doc("Distance for the rig's table; may be repeated."),
        Bounds(least=1e-6),
        Flag("--depth", quantity="m"),
    ] = None
    sigma_px: Annotated[
        float, Doc("Standard deviation of a spot's centre in px."), Bounds(least=1e-6), Flag("--sigma")
    ] = SIGMA_PX
    accuracy_m: Annotated[
        float | None,
        Doc("With --rig and --depth: what reaches this standard deviation of a point."),
        Bounds(least=1e-6 * MM),
        Flag("--accuracy", metavar="MM", unit=MM),
    ] = None
    compile_ahead: Annotated[
        bool, Doc("First compile all that is not compiled yet: no command then waits for it."), Flag("--compile")
    ] = False
