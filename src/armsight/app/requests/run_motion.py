"""What `armsight robot run` is told: a motion of the joints that is to be run."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from armsight.app.requests.motion import LIVE_SRC, GuardLimits, Override, RobotJob, Speed
from armsight.fields import Doc, Flag, Flags
from armsight.ops.flags import AN_ARM, KNOWN_ARM, CameraFlags, OutFolder, automatic

if TYPE_CHECKING:
    from armsight.drivers import PairSettings


@dataclass(frozen=True, kw_only=True)
class RunMotionJob(RobotJob):
    """A motion of the joints, and the robot that runs it; both cameras that are recorded meanwhile, or none."""

    motion: Annotated[Path, Doc("joints.csv of the motion: t_s,q1,...,qn."), Flag(metavar="MOTION.csv")]
    out: OutFolder
    arm: Annotated[Path | None, Doc(f"{KNOWN_ARM}; needed unless the robot tells it."), AN_ARM] = None
    limits: GuardLimits = None
    override: Override = 1.0
    speed: Speed = 1.0
    left: Annotated[str | None, Doc("Left camera, camera:NAME, recorded meanwhile: frames.mcap."), LIVE_SRC] = None
    right: Annotated[str | None, Doc("Right camera; both, or none."), LIVE_SRC] = None
    camera_settings: Annotated[PairSettings, Flags(CameraFlags)] = field(default_factory=automatic)
