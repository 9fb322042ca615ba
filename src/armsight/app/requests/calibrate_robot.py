"""What the commands of `armsight calibrate` are told that find how a camera, a tool or an arm stands."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

from armsight.app.requests.shared import (
    AN_ARM,
    KNOWN_ARM,
    OUT,
    Table,
    ours,
)
from armsight.defaults import ANGLE_RAD, LENGTH_M
from armsight.fields import Bounds, Doc, Flag
from armsight.units import DEG, MM


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
