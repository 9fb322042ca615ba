"""The check after a crash: ten joint positions proposed, and what the poses measured there say."""

from __future__ import annotations

from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array, Index
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.file_names import MASTERING
from armsight.kinematics import Arm, fk
from armsight.optics import Rig
from armsight.records import Target
from armsight.records.result_parts import RejectedRow
from armsight.store import World
from armsight.store.verify_files import MeasuredFile, read_reported_joints
from armsight.units import read_value
from armsight.verify import Align
from armsight.verify.mastering import CANDIDATES, SPAN_M, Mastering, Proposal, check_mastering, propose
from armsight.verify.model import Mounts
from armsight.verify.pairing import Reported, pair
from armsight.verify.results import MasteringJoint, MasteringOutput, MasteringPlanOutput, MasteringPose

DRAWN, SEED = 40_000, 7
"""Joint positions drawn about the middle one, candidates are those in view; the same call proposes the same."""
TOOLS = ("fixed", "free")
NOISE = np.array([2e-4, 1e-3])
"""Of a measured pose, m and rad, for the accuracy told beforehand: two webcams a metre away."""
TILT_RAD = np.deg2rad(40.0)
"""By how much the target may be turned away from how it stands in the middle pose: lights shine one way."""


View = tuple[Rig, Target, World]
"""The cameras, the target on the tool, and where the cameras stand."""


def propose_poses(arm: Arm, how: Align, q: Array, view: View | None, file: str) -> MasteringPlanOutput:
    """Return the poses to measure, of joint values (m, n) that may be taken; file: what is written of them."""
    notes = ["nobody looked for obstacles: check every pose before driving to it"]
    if view is None:
        notes.append("without --rig, --target and --world nobody knows whether the cameras see the target there")
    found = propose(arm, q[:CANDIDATES], how, NOISE)
    names = [joint.name for joint in arm.joints]
    return MasteringPlanOutput(
        poses=[
            MasteringPose(q=row, decides=[names[i] for i in which])
            for row, which in zip(arm.readings(found.q).tolist(), found.decides, strict=True)
        ],
        expected_std_rad=[float(s) if np.isfinite(s) else None for s in found.expected],
        file=file,
        notes=[*notes, *_unjudged(arm, found)],
    )


def judge_poses(arm: Arm, how: Align, file: MeasuredFile, reported: Reported) -> MasteringOutput:
    """Return what the poses measured at joint values say."""
    nominal = Mounts(base=arm.T_world_base, tools=(arm.T_flange_tool,))
    paired = pair(arm, reported, file.measured, nominal, how)
    result = check_mastering(arm, cast(Array, paired.q), paired.measured, how)  # of joints: readings_of refuses others
    return _output(result, arm, [*file.rejected, *paired.rejected, *result.rejected], [*file.notes, *paired.notes])


def in_measured_frame(arm: Arm, world: World | None, tool: str | None) -> tuple[Arm, Align]:
    """Return the arm in the frame of the measurements, and what is free of base and tool. Raises UsageError."""
    if tool is not None and tool not in TOOLS:
        raise UsageError(f"--tool {tool}", cure=f"Give one of {', '.join(TOOLS)}")
    if world is None:
        return arm, Align.BASE if tool == "fixed" else Align.BOTH
    return arm.based() if world.parent == "base" else arm, Align.TOOL if tool == "free" else Align.NONE


def readings_of(arm: Arm, file: MeasuredFile, measured: Path, joints: Path | None) -> Reported:
    """Return the joints' own values, row by row. Raises UsageError, Inconsistent."""
    found = file.reported if joints is None else read_reported_joints(joints)
    if found is None or found.q is None:
        raise UsageError(
            f"{measured} has no columns q1 .. qn, and no --joints were given",
            cure=f"Give --joints with q1,...,qn row by row: {MASTERING} where each of its poses was measured, in order",
        )
    if found.q.shape[1] != arm.n:
        raise Inconsistent(
            f"{joints or measured} has {found.q.shape[1]} joints, {arm.name} has {arm.n}",
            consequence="Nothing is checked",
            cure="Give the file of this arm, with q1 .. qn in the order of its joints",
        )
    return Reported(q=found.q if arm.direct else arm.values(found.q))


def drawn_about(arm: Arm, around: str | None, span_rad: float, view: View | None) -> Array:
    """Return joint values (m, n) drawn about those readings, within the limits; of a view those that it sees whole."""
    middle = _middle(arm, around, span_rad)
    q = _drawn(arm, middle, span_rad)
    return q if view is None else q[_in_view(arm, q, middle, *view)]


def _middle(arm: Arm, around: str | None, span_rad: float) -> Array:
    """Return the joints' values (n,) about which poses are drawn."""
    if around is None:
        raise UsageError(
            "where the poses shall be is not said",
            cure="Give --around q1,...,qn (rad or m, or as 90deg), a pose in the middle of what the cameras see; or "
            "--measured with the poses measured",
        )
    try:
        q = np.array([read_value(part)[0] for part in around.split(",")])
    except ValueError:
        raise UsageError(f"--around {around} is not q1,...,qn", cure="Write numbers with commas") from None
    if not (np.isfinite(span_rad) and 0.0 < span_rad <= np.pi):
        raise UsageError(f"--span {np.rad2deg(span_rad):g} deg", cure="Give degrees above 0, 180 at most")
    return arm.values(q)


def _drawn(arm: Arm, middle: Array, span_rad: float) -> Array:
    """Return joint values (DRAWN, n) evenly about the middle, within the limits."""
    span = np.where(arm.revolute, span_rad, SPAN_M)
    low, high = np.maximum(arm.lower, middle - span), np.minimum(arm.upper, middle + span)
    if (low > high).any():
        raise UsageError("--around is outside the joints' limits", cure="Give a pose that the arm can reach")
    return np.random.default_rng(SEED).uniform(low, high, (DRAWN, arm.n))


def _in_view(arm: Arm, q: Array, middle: Array, rig: Rig, target: Target, world: World) -> Index:
    """Return the places (k,) of the joint values at which both cameras see the whole target, turned to them."""
    T = (world.T_parent_rig.inv() * RigidTransform.from_matrix(fk(arm, np.vstack([middle, q])))).as_matrix()
    seen = np.arccos(np.clip(T[:, :3, 2] @ T[0, :3, 2], -1.0, 1.0)) < TILT_RAD
    seen &= seen_whole(rig, target, T)
    if not seen[0]:
        raise NotEnoughData(
            "the cameras do not see the whole target at --around",
            consequence="No poses are proposed",
            cure="Give a pose before both cameras; check --world and the arm's tool",
        )
    return np.flatnonzero(seen[1:])


def _unjudged(arm: Arm, found: Proposal) -> list[str]:
    open_ = [f"{i} ({arm.joints[i - 1].name})" for i in range(1, arm.n + 1) if not np.isfinite(found.expected[i - 1])]
    caveat = "a bent tool, or a base that is not known, does the same"
    return [f"not told by any poses: joint {', joint '.join(open_)}; {caveat}"] if open_ else []


def _output(result: Mastering, arm: Arm, rejected: list[tuple[int, str]], notes: list[str]) -> MasteringOutput:
    moved = result.T_tool
    return MasteringOutput(
        n=len(result.before),
        cause=result.cause,
        offset_rad=result.offset,
        std_rad=result.std,
        rms_before_m=_rms(result.before),
        rms_after_m=_rms(result.after),
        tool_moved=moved,
        joints=[
            MasteringJoint(
                index=i, name=joint.name, judged=one.judged, why=one.why, offset_rad=one.offset, std_rad=one.std
            )
            for i, (joint, one) in enumerate(zip(arm.joints, result.joints, strict=True), start=1)
        ],
        rejected=[RejectedRow(row=row, why=why) for row, why in sorted(rejected)],
        doubts=[*notes, *result.doubts],
        verdict=result.sentence,
        model=arm,
    )


def _rms(error: Array) -> float:
    return float(np.sqrt(np.mean((error[:, :3] ** 2).sum(axis=1))))


BORDER = 0.03
"""Share of the image's width that lights keep from its border."""


def seen_whole(rig: Rig, target: Target, T_rig_target: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell for poses (m, 4, 4) whether all lights of the target fall into the images of two cameras, or into that of
    the only one, whichever way they shine."""
    points = np.einsum("mij,pj->mpi", T_rig_target[:, :3, :3], target.xyz_m) + T_rig_target[:, None, :3, 3]
    views = np.zeros(len(T_rig_target), dtype=np.intp)
    for one, uv in zip(rig.cameras, rig.project(points.reshape(-1, 3)), strict=True):
        border = BORDER * one.camera.width
        limit = np.array([one.camera.width, one.camera.height]) - border
        views += ((uv > border) & (uv < limit)).all(axis=1).reshape(len(T_rig_target), -1).all(axis=1)
    return np.asarray(views >= min(len(rig.cameras), 2))
