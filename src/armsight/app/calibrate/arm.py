"""Measurements of an arm in; its corrected geometry, or where the rig stands to it, out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray

from armsight._files import real_path
from armsight.app.arm_files import arm_file, load_arm
from armsight.app.calibrate.cameras import report_path
from armsight.app.requests.calibrate_robot import ArmJob
from armsight.arrays import Array
from armsight.calibrate.arm import (
    ArmCalibration,
    ArmPoints,
    Proposal,
    Tolerance,
    WorldCalibration,
    calibrate_arm,
    calibrate_world,
    propose,
)
from armsight.errors import Inconsistent, UsageError
from armsight.fields import Doc
from armsight.kinematics import Arm, JointType
from armsight.kinematics.derivatives import nearest_rigid
from armsight.optics import Rig
from armsight.records.output import extended, output
from armsight.report.arm_report import arm_report
from armsight.store import World, read_rig, read_world, write_text
from armsight.store.arm_file import write_arm
from armsight.store.arm_points import read_arm_points
from armsight.store.atomic import disk_errors
from armsight.store.interpret import OURS, TableFormat
from armsight.store.tables import cells
from armsight.store.urdf_writer import delete_urdf, urdf_text
from armsight.store.worlds import write_world
from armsight.units import displayed

BESIDE = (".corrections.csv", ".urdf", ".proposed.csv", ".report.html")
"""Endings of what is written beside arm.yaml."""


@output
class ArmOutput(ArmCalibration):
    """armsight calibrate arm."""

    proposals: Annotated[
        list[list[float]] | None, Doc("Further joint readings to measure at, rad or m; with --propose.")
    ] = None
    expected_std: Annotated[dict[str, float] | None, Doc("Standard deviations to expect with those measured too.")] = (
        None
    )
    urdf: Annotated[str | None, Doc("The URDF written; null for scales and couplings, which it cannot hold.")]


def run_calibrate_arm(job: ArmJob) -> ArmOutput:
    """Calibrate; write arm.yaml, the URDF and the table of corrections beside it, and the report; return the figures.

    What an earlier run wrote beside it and this one does not goes. Raises UsageError, DataRefused.
    """
    _check_names(job)
    if (job.rig is None) != (job.world is None):
        raise UsageError("for proposals in view give both --rig and --world: where the rig stands to the measurements")
    nominal = load_arm(job.model)
    points = _measurements(nominal, job.points, job.table)
    holdout = None if job.holdout is None else _measurements(nominal, job.holdout, job.table)
    seen = in_view(read_rig(job.rig), read_world(job.world)) if job.propose and job.rig and job.world else None
    tolerance = Tolerance(length_m=job.tolerance_m, angle_rad=job.tolerance_rad)
    result = calibrate_arm(nominal, points, holdout=holdout, tolerance=tolerance, scale=job.scale)
    proposal = (
        propose(result.model, result.fitted, points, job.propose, tolerance=tolerance, visible=seen)
        if job.propose
        else None
    )
    _write_proposal(job.out, result.nominal, proposal)
    inputs = [job.points] if job.holdout is None else [job.points, job.holdout]
    write_arm(job.out, result.arm, inputs=inputs)
    write_text(job.out.with_suffix(".corrections.csv"), corrections(result))
    urdf, lost = _write_urdf(job.out.with_suffix(".urdf"), result.arm)
    files = [("model", job.model), *(("measurements", path.name) for path in inputs)]
    write_text(report_path(job.out), arm_report(result, points, inputs=files))
    return extended(
        result,
        ArmOutput,
        proposals=None if proposal is None else nominal.readings(proposal.q).tolist(),
        expected_std=None if proposal is None else proposal.expected_std,
        urdf=None if urdf is None else str(urdf),
        notes=(*result.notes, *lost),
    )


def _check_names(job: ArmJob) -> None:
    """Raise UsageError where a file to write is one of those to read."""
    given = (arm_file(job.model), job.points, job.holdout, job.rig, job.world)
    read = {real_path(path) for path in given if path is not None}
    written = (job.out, *(job.out.with_suffix(ending) for ending in BESIDE))
    for path in written:
        if real_path(path) in read:
            raise UsageError(
                f"{path} is to be read, and would be written over",
                consequence="Nothing is written",
                cure="Give another name with -o",
            )


def _write_proposal(out: Path, nominal: Arm, proposal: Proposal | None) -> None:
    """Write further joint positions to measure at beside an arm; without any, no such file of an earlier run stays."""
    path = out.with_suffix(".proposed.csv")
    if proposal is None:
        with disk_errors(out):
            path.unlink(missing_ok=True)
        return
    names = ",".join(f"q{i + 1}" for i in range(nominal.n))
    write_text(path, "\n".join([names, *(cells(row) for row in nominal.readings(proposal.q).tolist())]) + "\n")


def _write_urdf(path: Path, arm: Arm) -> tuple[Path | None, tuple[str, ...]]:
    """Write the arm as a URDF, one that gives way as the nearest rigid one; return its path, and what is lost.

    None where joint scales or couplings have no place in one. An earlier run's URDF is deleted then: it is of another
    arm than the arm.yaml beside it.
    """
    rigid = nearest_rigid(arm) if arm.compliant else None
    try:
        write_text(path, urdf_text(arm if rigid is None else rigid.arm))
    except Inconsistent:
        delete_urdf(path)
        return None, ()
    return path, () if rigid is None else (f"{path.name}: {rigid.lost}",)


def _measurements(arm: Arm, path: Path, format_: TableFormat) -> ArmPoints:
    """Return points.csv with the controller's coupled readings parted into what each joint is driven to."""
    points = read_arm_points(path, format_.of_arm(arm))
    return replace(points, q=points.q @ arm.gearing.T) if arm.couplings and points.q.shape[1] == arm.n else points


def in_view(rig: Rig, world: World) -> Any:
    """Return the test whether positions (m, 3) in the world's frame are in both images."""

    def seen(xyz_m: Array) -> NDArray[np.bool_]:
        local = world.T_parent_rig.inv().apply(xyz_m)
        with np.errstate(invalid="ignore", divide="ignore"):
            views = rig.project(local)
        inside = np.ones(len(xyz_m), bool)
        for camera, uv in zip((rig.left, rig.right), views, strict=True):
            inside &= np.isfinite(uv).all(axis=1)
            inside &= ((uv >= 0.0) & (uv <= [camera.width - 1, camera.height - 1])).all(axis=1)
        return inside

    return seen


def corrections(result: ArmCalibration) -> str:
    """Return a CSV text in a controller's terms: per joint the zero to add to its reading, its standard deviation, the
    scale.

    Where readings are coupled, value = gearing @ reading: zeros of the readings give those of the values by it.
    """
    joints = result.nominal.joints
    names = [f"{j.name}.{'theta_rad' if j.type is JointType.REVOLUTE else 'd_m'}" for j in joints]
    sign = np.array([joint.sign for joint in joints])
    to_readings = result.arm.gearing_back / sign  # (n, n): of changes of theta or d
    zeros = to_readings @ [result.change(name) for name in names]
    doubts = np.sqrt(np.diag(to_readings @ _zero_covariance(result, names) @ to_readings.T))
    rows = ["joint,zero_correction,unit,std,scale"]
    for joint, zero, std in zip(joints, zeros.tolist(), doubts.tolist(), strict=True):
        unit, size = displayed("rad" if joint.type is JointType.REVOLUTE else "m")
        uncertainty = f"{std / size:.6g}" if std > 0.0 else ""
        scale = 1.0 + result.change(f"{joint.name}.scale")
        rows.append(f"{joint.name},{zero / size + 0.0:.6g},{unit},{uncertainty},{scale:.8g}")
    return "\n".join(rows) + "\n"


def _zero_covariance(result: ArmCalibration, names: Sequence[str]) -> Array:
    """Return the covariance (n, n) of the joints' zeros, 0 where one is not corrected."""
    free = tuple(name for name in names if name in result.free)
    C = np.zeros((len(names), len(names)))
    if result.covariance is not None and free:
        at = [names.index(name) for name in free]
        C[np.ix_(at, at)] = result.covariance.block(free)
    return C


def run_calibrate_world(arm: str, points: Path, out: Path, format_: TableFormat = OURS) -> WorldCalibration:
    """Find where the rig stands to the arm's base, write world.yaml; return the figures. Raises DataRefused."""
    model = load_arm(arm)
    result = calibrate_world(model, _measurements(model, points, format_))
    write_world(out, world_of(result), inputs=[points])
    return result


def world_of(result: WorldCalibration) -> World:
    """Return where the rig stands as world.yaml holds it."""
    return World(
        parent="base",
        T_parent_rig=result.T_base_rig,
        covariance=result.covariance,
        residual_rms_m=result.residual_rms_m,
        n_used=result.n_used,
    )
