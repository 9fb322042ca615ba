"""What `armsight calibrate cell-plan` is told."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

from armsight.defaults import CAMERA_HZ, MOTION_HZ, MOTION_S, SPOT_STD_PX
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.flags import AN_ARM, KNOWN_ARM
from armsight.ops.requests.motion import GuardLimits, Speed
from armsight.units import DEG, MM
from armsight_lab.design.request import Box, mount_of, volume_of

KNOWN, MOTION = "What is known beforehand; without it reaches about --start", "The motion"


@dataclass(frozen=True, kw_only=True)
class CellPlanJob:
    """An arm, and what is known of the cell; rig, world, target and volume together, or none of them.

    mount (3,) or (6,): of the target on the flange, m and degrees; None: at the arm's tool.
    """

    model: Annotated[str, Doc(f"The arm: {KNOWN_ARM}; its tool is the tip."), AN_ARM]
    start: Annotated[
        str,
        Doc("Where the arm stands, as 0,-1.2,0.4, or a joints.csv: the motion begins and ends there."),
        Flag(metavar="READINGS"),
    ]
    out: Annotated[Path, Doc("The motion to write."), Flag("-o --out", metavar="MOTION.csv")]
    after: Annotated[
        Path | None,
        Doc("Folder of `calibrate cell` from a first recording: its files count, in place of --model too."),
        Flag(metavar="FOLDER", panel=KNOWN),
    ] = None
    rig: Annotated[Path | None, Doc("rig.yaml, as roughly as it is known."), Flag(panel=KNOWN)] = None
    world: Annotated[Path | None, Doc("world.yaml: where that rig stands to the arm, about."), Flag(panel=KNOWN)] = None
    target: Annotated[Path | None, Doc("target.yaml of the lights on the flange."), Flag(panel=KNOWN)] = None
    volume: Annotated[
        Box | None,
        Doc("Where the tip is to be known: XMIN:XMAX,YMIN:YMAX,ZMIN:ZMAX in m, in the arm's base."),
        Flag(metavar="BOX", read=volume_of, panel=KNOWN),
    ] = None
    mount: Annotated[
        tuple[float, ...] | None,
        Doc("The target on the flange: X,Y,Z[,RX,RY,RZ] in m and degrees. [default: at the tool]"),
        Flag(metavar="POSE", read=mount_of, panel=KNOWN),
    ] = None
    rough_m: Annotated[
        float,
        Doc("How far the cameras may stand from where --world has them."),
        Bounds(least=0.0),
        Flag(unit=MM, panel=KNOWN),
    ] = 20.0 * MM
    rough_rad: Annotated[
        float, Doc("How far they may be turned."), Bounds(least=0.0, most=30.0 * DEG), Flag(unit=DEG, panel=KNOWN)
    ] = 2.0 * DEG
    facing_rad: Annotated[
        float,
        Doc("How far the target's z axis may be turned from the way to each camera."),
        Bounds(above=0.0, most=180.0 * DEG),
        Flag(unit=DEG, panel=KNOWN),
    ] = 50.0 * DEG
    limits: GuardLimits = None
    duration_s: Annotated[float, Doc("How long the motion takes, s."), Bounds(least=20.0, most=3600.0)] = MOTION_S
    rate_hz: Annotated[float, Doc("Rows a second."), Bounds(least=10.0, most=2000.0), Flag(panel=MOTION)] = MOTION_HZ
    speed: Speed = 1.0
    swing_rad: Annotated[
        float,
        Doc("How far a joint may turn from where it stands: with which links the arm hits itself is not known."),
        Bounds(above=0.0, most=720.0 * DEG),
        Flag(unit=DEG, panel=MOTION),
    ] = 90.0 * DEG
    clearance_m: Annotated[
        float,
        Doc("What tool, flange and lights keep from walls and boxes beside the guard's own margin."),
        Bounds(least=0.0),
        Flag(unit=MM, panel=MOTION),
    ] = 20.0 * MM
    link_radius_m: Annotated[
        float,
        Doc("How thick the arm's links are about the lines from joint to joint; 0: they are not looked at."),
        Bounds(least=0.0),
        Flag(unit=MM, panel=MOTION),
    ] = 60.0 * MM
    frames_hz: Annotated[
        float, Doc("Frames a second of each camera."), Bounds(least=1.0, most=1000.0), Flag(panel=KNOWN)
    ] = CAMERA_HZ
    spot_noise_px: Annotated[
        float, Doc("Standard deviation of a spot's coordinate."), Bounds(least=1e-4), Flag(panel=KNOWN)
    ] = SPOT_STD_PX
    seed: Annotated[int, Doc("The same seed gives the same motion."), Bounds(least=0), Flag(panel=MOTION)] = 1
