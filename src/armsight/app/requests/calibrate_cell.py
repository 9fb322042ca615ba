"""What `armsight calibrate cell` is told."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from armsight.app.requests.shared import (
    A_SRC,
    AN_ARM,
    KNOWN_ARM,
    SRC,
    Fps,
    Inverted,
    Limit,
    OutFolder,
    Table,
    Threshold,
    ours,
    size_of,
)
from armsight.defaults import ANGLE_RAD, CELL_LENGTH_M
from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.units import DEG, MM

SPOTS = "table t_s,u_px,v_px[,su_px,sv_px]"
COMPLIANCE = {"auto": None, "on": True, "off": False}


def compliance_called(name: str) -> bool | None:
    """Return whether joints may give way, None where the recording shall show it. Raises UsageError."""
    if name not in COMPLIANCE:
        raise UsageError(f"--compliance {name!r} is none of {', '.join(COMPLIANCE)}")
    return COMPLIANCE[name]


@dataclass(frozen=True, kw_only=True)
class CellJob:
    """One recording of a moving arm: its joints' log, and frames of two cameras that run free, or tables of spots."""

    robot_log: Annotated[
        Path,
        Doc("joints.csv of the motion: t_s, q1, ... by the robot's clock; or the recording.mcap."),
        Flag(metavar="LOG"),
    ]
    target: Annotated[Path, Doc("target.yaml of the lights on the flange, as built.")]
    model: Annotated[str, Doc(f"The nominal arm: {KNOWN_ARM}."), AN_ARM]
    out: OutFolder
    left: Annotated[str | None, Doc(f"Left frames, each with its camera's stamp: {SRC}."), A_SRC] = None
    right: Annotated[str | None, Doc("Right frames, each with its camera's stamp."), A_SRC] = None
    left_spots: Annotated[Path | None, Doc(f"Instead of frames: {SPOTS}; with --size."), Flag(metavar="CSV")] = None
    right_spots: Annotated[Path | None, Doc("The same of the right camera."), Flag(metavar="CSV")] = None
    size: Annotated[
        tuple[int, int] | None, Doc("With tables of spots: size of the images, px."), Flag(metavar="WxH", read=size_of)
    ] = None
    right_size: Annotated[
        tuple[int, int] | None, Doc("That of the right camera, where it is another."), Flag(metavar="WxH", read=size_of)
    ] = None
    tool: Annotated[
        str, Doc("The tool's tip in target axes, X,Y,Z in m or with units, or tip.yaml."), Flag("--tip", metavar="TIP")
    ] = ""
    tolerance_m: Annotated[
        float, Doc("Standard deviation of nominal lengths."), Bounds(least=1e-6 * MM), Flag(unit=MM)
    ] = CELL_LENGTH_M
    tolerance_rad: Annotated[
        float, Doc("Standard deviation of nominal zeros and angles."), Bounds(least=1e-6 * DEG), Flag(unit=DEG)
    ] = ANGLE_RAD
    prior: Annotated[
        list[Path] | None,
        Doc("rig.yaml, world.yaml or handeye.yaml of earlier calibrations, to count with their covariance; repeated."),
        Flag(metavar="FILE"),
    ] = None
    compliance: Annotated[
        bool | None,
        Doc(
            "Whether joints give way under the arm's weight: on fits how far, off says they do not, auto fits where "
            "the recording shows it and else counts in the deviations what they may."
        ),
        Flag(metavar="WHETHER", default="auto", read=compliance_called),
    ] = None
    threshold: Threshold = None
    inverted: Inverted = False
    fps: Fps = None
    limit: Limit = None
    table: Table = field(default_factory=ours)
