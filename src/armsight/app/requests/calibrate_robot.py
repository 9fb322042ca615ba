"""What the commands of `armsight calibrate` are told that find how a camera, a tool or an arm stands."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from armsight.app.requests.shared import (
    A_SRC,
    AN_ARM,
    KNOWN_ARM,
    OUT,
    SRC,
    ABoard,
    Bits,
    Cameras,
    Right,
    Strict,
    Table,
    TwoTables,
    Workers,
    automatic,
    on_hand,
    ours,
    point_of,
    setup_called,
)
from armsight.defaults import ANGLE_RAD, GOOD_ENOUGH_M, LENGTH_M
from armsight.fields import Bounds, Doc, Flag
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from armsight.calibrate.handeye import Setup

POINT_STD_M = 0.2 * MM
"""Standard deviation believed of a measured point unless another is given: a dot measured by two cameras at 0.6 m."""

PointStd: TypeAlias = Annotated[
    float,
    Doc("Standard deviation of one coordinate of the measured point."),
    Bounds(least=1e-9),
    Flag("--point-sigma", quantity="m"),
]


@dataclass(frozen=True, kw_only=True)
class HandEyeJob:
    """One of: pairs; images with camera, board and robot; robot_stream with camera_stream."""

    out: Annotated[Path, Doc("handeye.yaml to write."), OUT]
    pairs: Annotated[Path | None, Doc("pairs.csv: robot pose and camera pose in every row.")] = None
    images: Annotated[str, Doc(f"Images of the board: {SRC}."), A_SRC] = ""
    camera: Annotated[Path | None, Doc("camera.yaml of the camera that took the images.")] = None
    board: ABoard = ""
    robot: Annotated[Path | None, Doc("robot_poses.csv: file,x_m,..,qw, T_base_flange per image.")] = None
    robot_stream: Annotated[Path | None, Doc("poses.csv of the flange, time-stamped.")] = None
    camera_stream: Annotated[Path | None, Doc("poses.csv of the target in the camera.")] = None
    clocks_within_s: Annotated[
        float | None,
        Doc("With streams: their clocks differ by this at most; else by any."),
        Bounds(least=0.0),
        Flag(metavar="SECONDS"),
    ] = None
    setup: Annotated[Setup, Doc("eye-in-hand or eye-to-hand."), Flag(default="eye-in-hand", read=setup_called)] = field(
        default_factory=on_hand
    )
    free_camera: Annotated[bool, Doc("With images: refine the camera, if left-out images get better.")] = False
    propose: Annotated[int, Doc("Propose so many further poses."), Bounds(least=0)] = 0
    workers: Workers = None
    bits: Bits = None
    strict: Strict = False
    table: TwoTables = field(default_factory=ours)


@dataclass(frozen=True, kw_only=True)
class PivotJob:
    """A target on a tool that is turned about its end before the cameras."""

    rig: Annotated[Path, Doc("rig.yaml of the two cameras.")]
    target: Annotated[Path, Doc("target.yaml of the target on the tool.")]
    left: Annotated[str, Doc(f"Left frames: {SRC}."), A_SRC]
    out: Annotated[Path, Doc("tip.yaml to write."), OUT]
    right: Right = None
    goal_m: Annotated[
        float,
        Doc("Stop where the tip is known so well (one standard deviation)."),
        Bounds(least=1e-6),
        Flag(quantity="m"),
    ] = GOOD_ENOUGH_M
    point: Annotated[
        tuple[float, float, float] | None,
        Doc("The point in rig axes, m or with units (200mm), if measured."),
        Flag(metavar="X,Y,Z", read=point_of),
    ] = None
    sigma_m: PointStd = POINT_STD_M
    camera_settings: Cameras = field(default_factory=automatic)


@dataclass(frozen=True, kw_only=True)
class ArmJob:
    """A nominal arm and what was measured of it; rig and world: for proposals that both cameras see."""

    model: Annotated[str, Doc(f"The nominal arm: {KNOWN_ARM}."), AN_ARM]
    points: Annotated[Path, Doc("points.csv: q1..qn,x_m,y_m,z_m[,qx,qy,qz,qw][,point][,t_s].")]
    out: Annotated[Path, Doc("arm.yaml to write."), OUT]
    holdout: Annotated[Path | None, Doc("Further points, only for judging.")] = None
    scale: Annotated[bool, Doc("Try joint scales too."), Flag("--scale/--no-scale")] = True
    tolerance_m: Annotated[
        float, Doc("Standard deviation of nominal lengths."), Bounds(least=1e-6 * MM), Flag(unit=MM)
    ] = LENGTH_M
    tolerance_rad: Annotated[
        float, Doc("Standard deviation of nominal angles."), Bounds(least=1e-6 * DEG), Flag(unit=DEG)
    ] = ANGLE_RAD
    propose: Annotated[int, Doc("Propose so many further joint positions."), Bounds(least=0)] = 0
    rig: Annotated[Path | None, Doc("rig.yaml, for proposals both cameras see; with --world.")] = None
    world: Annotated[Path | None, Doc("world.yaml: where that rig stands.")] = None
    table: Table = field(default_factory=ours)
