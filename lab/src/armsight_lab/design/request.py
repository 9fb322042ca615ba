"""What `armsight design` is told: cameras that are there or planned, a target, a volume, and what is wanted."""

from __future__ import annotations

from dataclasses import dataclass
from math import isfinite
from pathlib import Path
from typing import Annotated, TypeAlias

from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.flags import BOARD, KNOWN_ARM, OutFolder, size_of
from armsight.units import DEG, MM, read_quantity

VIEWS, POSES, CELLS = 20, 20, 9
"""Pictures of the board, poses of the arm, and cells along the volume's longest edge, where nobody says."""
UM = 1e-6

Range: TypeAlias = tuple[float, float]
Box: TypeAlias = tuple[Range, Range, Range]
"""From and to along x, y and z, m."""

RIG = "The rig: cameras that are there, or planned"
CALIBRATION = "Its calibration"
ARM = "With --arm"


def volume_of(text: str) -> Box:
    """Return the box of 'X:X,Y:Y,Z:Z', m or with units. Raises UsageError."""
    edges, why = [part.split(":") for part in text.split(",")], ""
    try:
        ends = [[read_quantity(end, "m") for end in edge] for edge in edges]
    except ValueError as error:
        ends, why = [], f" ({error})"
    if [len(edge) for edge in ends] != [2, 2, 2]:
        raise UsageError(
            f"the volume {text!r} is not XMIN:XMAX,YMIN:YMAX,ZMIN:ZMAX{why}",
            consequence="It is not known where the target will be",
            cure="Write for instance --volume=-0.2:0.2,-0.1:0.1,0.6:1.0, in m, or with units as 600mm",
        )
    (x0, x1), (y0, y1), (z0, z1) = ends
    return (x0, x1), (y0, y1), (z0, z1)


def mount_of(text: str) -> tuple[float, ...]:
    """Return the pose of 'X,Y,Z' or 'X,Y,Z,RX,RY,RZ': m, then degrees about x, y, z. Raises UsageError."""
    try:
        values = tuple(float(part) for part in text.split(","))
    except ValueError:
        values = ()
    if len(values) not in (3, 6) or not all(map(isfinite, values)):
        raise UsageError(
            f"{text!r} is not X,Y,Z or X,Y,Z,RX,RY,RZ",
            consequence="It is not known where the target is on the flange",
            cure="Write for instance --mount=0,0,0.1 in m, or --mount=0,0,0.1,0,90,0 with degrees",
        )
    return values


@dataclass(frozen=True, kw_only=True)
class DesignJob:
    """A rig, a target and a volume, and how the rig will be calibrated.

    rig and what changes it, or planned cameras alone (size, focal length, baseline). mount (3,) or (6,): of the target
    on the flange, m and degrees; None: at the arm's tool.
    """

    out: OutFolder
    target: Annotated[Path, Doc(f"target.yaml of the lights, or a board: {BOARD}."), Flag(metavar="TARGET")]
    volume: Annotated[
        Box,
        Doc("Where the target's origin will be: XMIN:XMAX,YMIN:YMAX,ZMIN:ZMAX in m, in the rig's axes or --world's."),
        Flag(metavar="BOX", read=volume_of),
    ]
    rig: Annotated[
        Path | None, Doc("rig.yaml: of a rig that is there, or written from data sheets."), Flag(panel=RIG)
    ] = None
    size: Annotated[
        tuple[int, int] | None,
        Doc("Image size such as 1280x720. [default: the rig's]"),
        Flag(metavar="WxH", read=size_of, panel=RIG),
    ] = None
    focal_m: Annotated[
        float | None,
        Doc("Focal length of both lenses, with --pixel-um."),
        Bounds(least=1e-3 * MM),
        Flag(unit=MM, panel=RIG),
    ] = None
    pixel_m: Annotated[
        float | None,
        Doc("Width of a pixel, in micrometres."),
        Bounds(least=1e-3 * UM),
        Flag("--pixel-um", unit=UM, panel=RIG),
    ] = None
    focal_px: Annotated[float | None, Doc("Or the focal length in px."), Bounds(least=1.0), Flag(panel=RIG)] = None
    baseline_m: Annotated[
        float | None,
        Doc("Distance of the cameras. [default: the rig's]"),
        Bounds(least=1e-4),
        Flag(quantity="m", panel=RIG),
    ] = None
    toe_in_rad: Annotated[
        float | None, Doc("How far each planned camera turns towards the other."), Flag(unit=DEG, panel=RIG)
    ] = None
    world: Annotated[Path | None, Doc("world.yaml: where the rig stands; the volume is then in its frame.")] = None
    tilt_rad: Annotated[float, Doc("How far the target is turned from facing the rig."), Flag(unit=DEG)] = 0.0
    relative: Annotated[
        bool,
        Doc("Deviations within the volume: without what moves or turns all of it alike, which an alignment removes."),
    ] = False
    average: Annotated[int, Doc("Frames of which each measured pose is the mean."), Bounds(least=1)] = 1
    wanted_m: Annotated[
        float | None,
        Doc("Wanted deviation of the position in 95 % of the volume: tell what to change."),
        Bounds(least=1e-6 * MM),
        Flag(unit=MM),
    ] = None
    spot_noise_px: Annotated[
        float | None,
        Doc("Standard deviation of a spot's or corner's coordinate. [default: from the cameras' noise, else 0.1]"),
        Bounds(least=1e-4),
    ] = None
    least_spot_px: Annotated[float, Doc("Lights that look smaller are not found, px across."), Bounds(least=0.5)] = 2.0
    board: Annotated[
        str | None,
        Doc("What the rig will be calibrated with. [default: as rig.yaml says it was]"),
        Flag(metavar="BOARD", panel=CALIBRATION),
    ] = None
    views: Annotated[int, Doc("How many pictures of it."), Bounds(most=500), Flag(panel=CALIBRATION)] = VIEWS
    corner_noise_px: Annotated[
        float, Doc("Standard deviation of its corners' coordinates."), Bounds(least=1e-4), Flag(panel=CALIBRATION)
    ] = 0.1
    arm: Annotated[
        str | None, Doc(f"{KNOWN_ARM}: deviations of its tool tip in its base."), Flag(metavar="ARM", panel=ARM)
    ] = None
    mount: Annotated[
        tuple[float, ...] | None,
        Doc("The target on the flange: X,Y,Z[,RX,RY,RZ] in m and degrees. [default: at the tool]"),
        Flag(metavar="POSE", read=mount_of, panel=ARM),
    ] = None
    poses: Annotated[
        int, Doc("Poses of the arm from which the rig's place in its base is found."), Bounds(most=500), Flag(panel=ARM)
    ] = POSES
    link_radius_m: Annotated[
        float,
        Doc("How thick the arm's links are about the lines from joint to joint; 0: they hide nothing."),
        Bounds(least=0.0, most=0.5),
        Flag(unit=MM, panel=ARM),
    ] = 0.0
    one_more: Annotated[
        bool, Doc("Try one more camera: at which place of a grid about the volume it helps most."), Flag(panel=RIG)
    ] = False
    arm_noise_m: Annotated[
        float, Doc("How far the arm is from where it says, each axis."), Bounds(least=0.0), Flag(unit=MM, panel=ARM)
    ] = 0.05 * MM
    arm_turn_rad: Annotated[
        float, Doc("The same of its orientation."), Bounds(least=0.0), Flag("--arm-turn-deg", unit=DEG, panel=ARM)
    ] = 0.01 * DEG
    cells: Annotated[int, Doc("Cells along the volume's longest edge."), Bounds(least=1, most=40)] = CELLS
    simulate: Annotated[
        int, Doc("Confirm it by so many simulated calibrations and measurements."), Bounds(least=0, most=10_000)
    ] = 0
    seed: Annotated[int, Doc("Of the simulation."), Bounds(least=0)] = 1
    workers: Annotated[
        int | None, Doc("Processes that simulate. [default: one for each core]"), Bounds(least=1, most=1024)
    ] = None
