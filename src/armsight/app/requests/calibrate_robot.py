"""What `armsight calibrate handeye` is told."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armsight.app.requests.shared import (
    A_SRC,
    OUT,
    SRC,
    ABoard,
    Bits,
    Strict,
    TwoTables,
    Workers,
    on_hand,
    ours,
    setup_called,
)
from armsight.fields import Bounds, Doc, Flag

if TYPE_CHECKING:
    from armsight.calibrate.handeye import Setup


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
