"""A verification as programs get it: the summary's keys."""

from __future__ import annotations

import numpy as np

from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.kinematics import Arm
from armsight.records.result_parts import RejectedRow
from armsight.store.verify_files import MeasuredFile
from armsight.units import DEG, MM, figure_of
from armsight.verify import Cause, Figures, JointVerdict, Verification
from armsight.verify.iso9283.drift import DRIFTING
from armsight.verify.iso9283.figure import IsoFigure
from armsight.verify.results import (
    CauseParameter,
    Explained,
    PoseError,
    VerifyAlignment,
    VerifyJoint,
    VerifyResult,
    VerifyTime,
)


def verify_output(
    result: Verification, arm: Arm | None, file: MeasuredFile, iso: dict[str, IsoFigure], notes: tuple[str, ...] = ()
) -> VerifyResult:
    """Return the figures of a verification as --json gives them; told: what to know of the figures of ISO 9283."""
    cause, found = result.cause, result.configurations
    rejected = sorted({*result.rejected, *file.rejected})
    return VerifyResult(
        n=len(result.task),
        time=_time(result),
        alignment=_alignment(result, arm),
        before=_pose_error(result.before),
        after=_pose_error(result.task),
        task=_task(result.task),
        measurement_std=_measurement(result),
        joints=[] if arm is None or cause is None else _joints(result, arm, cause),
        cause="undecided" if cause is None else cause.cause,
        kind=None if cause is None or cause.kind is None else cause.kind.value,
        parameters=_parameters(cause),
        explained=_explained(cause),
        configurations=found,
        decide_by=None if result.deciding is None or arm is None else arm.readings(result.deciding).tolist(),
        iso9283=iso,
        rejected=[RejectedRow(row=row, why=why) for row, why in rejected],
        doubts=[*file.notes, *result.doubts, *notes],
        verdict=_verdict(result),
        verification=result,
        model=arm,
    )


def repeats_output(file: MeasuredFile, iso: dict[str, IsoFigure], notes: tuple[str, ...]) -> VerifyResult:
    """Return what repeats alone tell, without an arm or a command for each row."""
    given = {name: item for name, item in iso.items() if item.value is not None and " " not in name}
    worst = given.get("RP_m", given.get("RT_m"))
    name = "RP" if "RP_m" in given else "RT"
    shown = (
        "no figure can be given"
        if worst is None or worst.value is None
        else f"{name} {figure_of(worst.value / MM, 'mm')}"
    )
    return VerifyResult(
        n=len(file.measured),
        time=VerifyTime(offset_s=None, std_s=None, drift_ppm=None, bursts=False),
        alignment=VerifyAlignment(free=[], T_measured_base=None, T_flange_tool=None, std={}, undetermined=[]),
        before=None,
        after=None,
        task={},
        measurement_std={},
        joints=[],
        cause="undecided",
        kind=None,
        parameters={},
        explained=Explained(measurement=None, joint=None, zeros=None, model=None),
        iso9283=iso,
        rejected=[RejectedRow(row=row, why=why) for row, why in file.rejected],
        doubts=[*file.notes, *notes],
        verdict=" ".join(
            [
                f"Repeats alone, {len(file.measured)} rows: {shown}. Where the tool should be was not told row by row.",
                *(f"{note}." for note in notes if DRIFTING in note),
            ]
        ),
        repeated=(file.measured, file.repeats),
    )


def _time(result: Verification) -> VerifyTime:
    clock, times = result.paired.clock, result.paired.times
    return VerifyTime(
        offset_s=None if clock is None else clock.offset_s,
        std_s=None if clock is None else clock.std_s,
        drift_ppm=None if clock is None else clock.drift_ppm,
        bursts=times is not None and times.bursts,
    )


def _alignment(result: Verification, arm: Arm | None) -> VerifyAlignment:
    zeros = []
    if arm is not None and result.cause is not None:
        kinds = ["theta_rad" if turns else "d_m" for turns in arm.revolute]
        named = zip(arm.joints, kinds, result.cause.joints, strict=True)
        zeros = [f"{joint.name}.{kind}" for joint, kind, verdict in named if not verdict.judged]
    return VerifyAlignment(
        free=list(result.how.parts),
        T_measured_base=result.mounts.base,
        T_flange_tool=result.mounts.tools[0],
        std={name: value if np.isfinite(value) else None for name, value in result.std.items()},
        undetermined=[*result.undetermined, *zeros],
        hidden_m=hidden_m(result),
    )


def hidden_m(result: Verification) -> float | None:
    """Return what base and tool, laid best, may have taken up of the arm's own errors of place (RMS, m)."""
    off = None if result.cause is None or not result.how.parts else result.cause.arm_off_m
    return None if off is None else float(np.sqrt(max(off**2 - _pose_error(result.task).rms_m ** 2, 0.0)))


def _pose_error(residual: Array) -> PoseError:
    distance = np.linalg.norm(residual[:, :3], axis=1)
    turned = residual.shape[1] == 6
    turn = float(np.sqrt((residual[:, 3:] ** 2).sum(axis=1).mean())) if turned else None
    return PoseError(rms_m=float(np.sqrt(np.mean(distance**2))), rms_rad=turn, max_m=float(distance.max()))


def _task(task: Array) -> dict[str, Figures]:
    return {name: Figures.of(task[:, k]) for k, name in enumerate(POSE6[: task.shape[1]])}


def _measurement(result: Verification) -> dict[str, float | None]:
    std = result.paired.measured.std
    names = POSE6[: result.task.shape[1]]
    if std is None:
        return dict.fromkeys(names)
    rms = np.sqrt(np.mean(std[result.kept] ** 2, axis=0))
    return {name: float(value) for name, value in zip(names, rms, strict=False)}


def _joints(result: Verification, arm: Arm, cause: Cause) -> list[VerifyJoint]:
    return [_joint(result, i, joint.name, cause.joints[i]) for i, joint in enumerate(arm.joints)]


def _joint(result: Verification, i: int, name: str, verdict: JointVerdict) -> VerifyJoint:
    figures, std = None, None
    if result.joints is not None and result.joints.known.any():
        known = result.joints.known
        figures = Figures.of(result.joints.dq[known, i])
        own = result.joints.std[known, i]
        std = float(np.sqrt(np.mean(own**2))) if own.any() else None
    return VerifyJoint(
        index=i + 1,
        name=name,
        me=None if figures is None else figures.me,
        mae=None if figures is None else figures.mae,
        max=None if figures is None else figures.max,
        sd=None if figures is None else figures.sd,
        rms=None if figures is None else figures.rms,
        measurement_std=std,
        offset_rad=verdict.offset,
        std_rad=verdict.std,
        judged=verdict.judged,
        why=verdict.why,
        gain_heldout=verdict.gain_heldout,
        kind=None if verdict.kind is None else verdict.kind.value,
        backlash_rad=None if verdict.backlash is None else verdict.backlash[0],
        backlash_std_rad=None if verdict.backlash is None else verdict.backlash[1],
    )


def _parameters(cause: Cause | None) -> dict[str, CauseParameter]:
    found = {} if cause is None else cause.parameters
    return {name: CauseParameter(value=value, std=std) for name, (value, std) in found.items()}


def _explained(cause: Cause | None) -> Explained:
    gains = {} if cause is None else cause.gains
    return Explained(
        measurement=None if cause is None else cause.measurement_share,
        joint=gains.get("joint"),
        zeros=gains.get("zeros"),
        model=gains.get("model"),
    )


def _verdict(result: Verification) -> str:
    error = _pose_error(result.task)
    turn = "" if error.rms_rad is None else f" and {figure_of(error.rms_rad / DEG, 'deg')}"
    laid = f" with {' and '.join(result.how.parts)} laid best" if result.how.parts else ""
    off = f"{figure_of(error.rms_m / MM, 'mm')}{turn} (RMS)"
    hidden = hidden_m(result)
    taken = (
        "" if hidden is None else f"; that may hide {figure_of(hidden / MM, 'mm', digits=2)} of the arm's own errors"
    )
    text = f"The tool is {off} from where it should be{laid}, {len(result.task)} rows{taken}."
    if result.cause is None:
        return f"{text} Without an arm's model no cause is looked for."
    return f"{text} {result.cause.sentence}"
