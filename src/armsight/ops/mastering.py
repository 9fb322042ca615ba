"""Which joint's zero moved in a crash: poses to measure at, and the judgement of those measured."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeAlias

from armsight.defaults import MASTERING_SPAN_RAD
from armsight.fields import Doc, Flag
from armsight.file_names import MASTERING as POSES_TO_MEASURE
from armsight.file_names import REPORT, VERIFY
from armsight.ops.action import action
from armsight.ops.flags import MASTERING
from armsight.ops.kinds import JointsFile, MeasuredFile, Readings, WorldFile
from armsight.ops.verify import OneArm, Out, RigFile, TargetFile
from armsight.units import DEG

if TYPE_CHECKING:
    from armsight.verify.results import MasteringOutput, MasteringPlanOutput

__all__ = ["check_mastering", "propose_mastering_poses"]

Tool: TypeAlias = Annotated[
    Literal["fixed", "free"] | None,
    Doc("Whether the tool is known from before. [default: fixed with --world, else free]"),
    Flag(metavar="fixed|free", read=str, panel=MASTERING),
]


@action("verify", keeps=(POSES_TO_MEASURE,), writes="write_poses_to_measure")
def propose_mastering_poses(
    arm: OneArm,
    around: Annotated[
        Readings,
        Doc("Propose poses about these joints, rad or m (or 90deg)."),
        Flag(metavar="Q1,..,QN", panel=MASTERING),
    ],
    *,
    span_rad: Annotated[
        float,
        Doc("How far joints may go from there, deg. [default: 30]"),
        Flag("--span", unit=DEG, default=None, panel=MASTERING),
    ] = MASTERING_SPAN_RAD,
    tool: Tool = None,
    world: WorldFile = None,
    rig: RigFile = None,
    target: TargetFile = None,
    out: Out = None,
) -> MasteringPlanOutput:
    """Return ten joint positions at which to measure an arm after a crash.

    around: readings (n,) about which they are, within span_rad. tool: whether it is known from before. rig, target,
    world: only poses that the cameras see. out: a folder for mastering.csv. Raises UsageError, DataRefused.

    Examples
    --------
    >>> len(armsight.propose_mastering_poses("ur10", [0.0, -1.0, 1.0, 1.0, 2.0, 0.0]).poses)
    10
    """
    from armsight.ops.measurement.run import target_of
    from armsight.ops.verification import mastering
    from armsight.store import read_rig, read_world

    stand = None if world is None else read_world(world)
    placed, how = mastering.in_measured_frame(arm, stand, tool)
    view = None
    if rig is not None and target is not None and stand is not None:
        view = (read_rig(rig, any_cameras=True), target_of(target), stand)
    q = mastering.drawn_about(placed, around, span_rad, view)
    return mastering.propose_poses(placed, how, q, view, "" if out is None else str(Path(out) / POSES_TO_MEASURE))


@action("verify", keeps=(VERIFY, REPORT), writes="write_verified", page="verify_pages:mastering_report")
def check_mastering(
    measured: MeasuredFile,
    joints: JointsFile,
    arm: OneArm,
    *,
    tool: Tool = None,
    world: WorldFile = None,
    out: Out = None,
) -> MasteringOutput:
    """Return which joint's zero moved in a crash, from poses measured at joint positions.

    measured, joints, arm, world: as `verify` takes them. tool: whether it is known from before. out: a folder for the
    report. Raises UsageError, DataRefused.

    Examples
    --------
    >>> arm = armsight.presets.ur10()
    >>> q = np.array([pose.q for pose in armsight.propose_mastering_poses(arm, [0.0, -1.0, 1.0, 1.0, 2.0, 0.0]).poses])
    >>> armsight.check_mastering(arm.fk(q), q, arm, tool="fixed").cause
    'none'
    """
    from armsight.ops.verification import mastering
    from armsight.ops.verification.run import in_world
    from armsight.store import read_world
    from armsight.store.verify_files import read_measured

    stand = None if world is None else read_world(world)
    placed, how = mastering.in_measured_frame(arm, stand, tool)
    file = read_measured(measured)
    file = file if stand is None else replace(file, measured=in_world(file.measured, stand))
    return mastering.judge_poses(placed, how, file, mastering.readings_of(placed, file, measured, joints))
