"""What the commands are told that make files of files: compare, join, path from-picks and path export."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from armsight.app.requests.shared import AN_ARM, KNOWN_ARM, TwoTables, on_hand, ours, setup_called
from armsight.defaults import PICK_STD_PX
from armsight.fields import Bounds, Doc, Flag
from armsight.units import DEG

if TYPE_CHECKING:
    from armsight.calibrate.handeye import Setup
    from armsight.measure.correspondence import PatchSettings

PathFile: TypeAlias = Annotated[Path, Doc("path.csv."), Flag(positional=True, metavar="PATH")]
PathOut: TypeAlias = Annotated[Path, Doc("path.csv to write."), Flag("-o --out", metavar="FILE")]
ToolTip: TypeAlias = Annotated[
    Path | None, Doc("tip.yaml of the tool, in flange axes. [default: the arm's tool frame]")
]


@dataclass(frozen=True, kw_only=True)
class CompareJob:
    """Two results of one kind; distance_m: of rigs."""

    a: Annotated[
        Path, Doc("A result: a folder of measure or verify, or a calibration."), Flag(positional=True, metavar="A")
    ]
    b: Annotated[Path, Doc("Another of the same kind."), Flag(positional=True, metavar="B")]
    out: Annotated[Path | None, Doc("Write compare.json and report.html here."), Flag("-o --out", metavar="FOLDER")] = (
        None
    )
    distance_m: Annotated[
        float | None,
        Doc("Distance at which rigs are compared. [default: 8 baselines]"),
        Bounds(least=0.01),
        Flag(quantity="m"),
    ] = None


@dataclass(frozen=True, kw_only=True)
class JoinJob:
    """Measurements, and joints with arm or robot_stream (T_base_flange) on another clock. kind: one of KINDS."""

    measured: Annotated[Path, Doc("Measured poses or points, with t_s."), Flag(metavar="FILE")]
    out: Annotated[Path, Doc("The table to write."), Flag("-o --out")]
    kind: Annotated[
        str, Doc("points (for calibrate arm), observed (robot-world) or pairs (hand-eye)."), Flag("--as")
    ] = "points"
    joints: Annotated[Path | None, Doc("The controller's joint log, with t_s on its own clock.")] = None
    arm: Annotated[str | None, Doc(f"With --joints: {KNOWN_ARM}; nominal is enough."), AN_ARM] = None
    robot_stream: Annotated[Path | None, Doc("Instead of joints: poses of the flange, with t_s.")] = None
    setup: Annotated[
        Setup, Doc("Of pairs: eye-in-hand or eye-to-hand."), Flag(default="eye-in-hand", read=setup_called)
    ] = field(default_factory=on_hand)
    offset_s: Annotated[float | None, Doc("Add this to measured times. [default: it is found]"), Flag(metavar="S")] = (
        None
    )
    still: Annotated[bool, Doc("One row for each rest of the arm: the mean of it.")] = False
    table: TwoTables = field(default_factory=ours)


@dataclass(frozen=True, kw_only=True)
class SmoothJob:
    """A path whose noise is taken out, within bounds."""

    source: PathFile
    out: PathOut
    bound_m: Annotated[float, Doc("No row moves further, m."), Bounds(above=0.0)] = 5e-4
    bound_rad: Annotated[
        float, Doc("No row turns further, degrees."), Bounds(above=0.0, most=180.0 * DEG), Flag(unit=DEG)
    ] = DEG
    on_outliers: Annotated[
        str, Doc("Rows off the path: refuse, drop, or keep (smooth over them)."), Flag("--outliers")
    ] = "refuse"


@dataclass(frozen=True, kw_only=True)
class JoinPathsJob:
    """Paths that are put one after the other."""

    sources: Annotated[
        list[Path], Doc("Two path.csv or more, in their order."), Flag(positional=True, metavar="PATH...")
    ]
    out: PathOut
    gap_m: Annotated[float, Doc("Widest gap between two ends, m."), Bounds(least=0.0)] = 1e-3
    gap_rad: Annotated[
        float, Doc("Largest turn between them, degrees."), Bounds(least=0.0, most=180.0 * DEG), Flag(unit=DEG)
    ] = 5.0 * DEG


@dataclass(frozen=True, kw_only=True)
class PicksJob:
    """Two pictures of a rig, and places picked in one of them."""

    left: Annotated[Path, Doc("Picture of the left camera.")]
    right: Annotated[Path, Doc("Picture of the right camera, of the same scene at rest.")]
    rig: Annotated[Path, Doc("rig.yaml of the two cameras.")]
    picks: Annotated[Path, Doc("picks.csv: u_px,v_px[,edge] of one view.")]
    out: PathOut
    side: Annotated[str, Doc("The view that the picks are of: left or right."), Flag("--view")] = "left"
    world: Annotated[Path | None, Doc("world.yaml. [default: the path is in the rig's axes]")] = None
    near_m: Annotated[float | None, Doc("Nearest depth. [default: 3 baselines]"), Flag(quantity="m")] = None
    far_m: Annotated[float | None, Doc("Furthest depth. [default: 300 baselines]"), Flag(quantity="m")] = None
    step_px: Annotated[float, Doc("Between points on an edge, px.")] = 10.0
    patch_px: Annotated[int, Doc("Side of a patch, px.")] = 15
    pick_std_px: Annotated[float, Doc("Standard deviation of a pick, px.")] = PICK_STD_PX
    tool_axis: Annotated[str | None, Doc("The tool's z. [default: the view's optical axis]"), Flag(metavar="X,Y,Z")] = (
        None
    )
    skip: Annotated[bool, Doc("Leave out what is not found, instead of refusing all.")] = False

    @property
    def settings(self) -> PatchSettings:
        """How a picked place is looked for in the other view. Raises UsageError."""
        from armsight.measure.correspondence import PatchSettings

        return PatchSettings(
            half_px=self.patch_px // 2, near_m=self.near_m, far_m=self.far_m, pick_std_px=self.pick_std_px
        )


@dataclass(frozen=True, kw_only=True)
class ExportJob:
    """A path and the program it becomes; parent: the frame of the path. arm, tip, limits, start: for the check."""

    source: PathFile
    out: Annotated[Path, Doc("program.script, .src, .mod, path.csv or .py."), Flag("-o --out", metavar="FILE")]
    to: Annotated[str | None, Doc("urscript, krl, rapid, csv or python. [default: by the file's ending]")] = None
    arm: Annotated[str | None, Doc(f"{KNOWN_ARM}: the path is checked for it, or refused."), AN_ARM] = None
    tip: ToolTip = None
    limits: Annotated[Path | None, Doc("limits.yaml for the check. [default: the guard's own]")] = None
    parent: Annotated[str, Doc("Frame of the path: world (needs --arm) or base."), Flag("--frame")] = "world"
    start: Annotated[str | None, Doc("Readings near which the arm begins, as 0,-1.2,0.4, or a joints.csv.")] = None
    name: Annotated[str | None, Doc("Name of the program. [default: the file's]")] = None
    speed_m_s: Annotated[float | None, Doc("Where the path leaves it open, m/s.")] = None
    blend_m: Annotated[float, Doc("Radius of blends or zones, m; 0 stops at rows.")] = 0.0
    acceleration_m_s2: Annotated[float, Doc("Of the tool, m/s^2.")] = 0.5
    approach_m: Annotated[float, Doc("How far back along the tool it begins and ends, m.")] = 0.05
    tool: Annotated[str | None, Doc("KRL: number of TOOL_DATA; RAPID: name of the tooldata.")] = None
    weld_output: Annotated[str | None, Doc("Digital output of weld_on and weld_off. [default: comments alone]")] = None
    turn_rad_s: float = math.pi / 3.0
