"""How results are written into files, and which file each record is written to: the ending of the name decides."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from armsight import file_names
from armsight.arrays import Array
from armsight.calibrate.camera_noise.photon_transfer import NoiseCalibration
from armsight.errors import Inconsistent, UsageError
from armsight.kinematics import Arm, JointType
from armsight.kinematics.rigid import as_rigid
from armsight.records import require_kind
from armsight.store.arm_file import write_arm
from armsight.store.atomic import disk_errors, write_json, write_text
from armsight.store.rigs import World, write_camera, write_rig, write_world
from armsight.store.tables import cells, table_text, word
from armsight.store.targets import write_target
from armsight.store.tracks import write_poses
from armsight.store.urdf import delete_urdf, urdf_text, write_urdf
from armsight.store.zoom import with_setting, write_zoom_camera
from armsight.units import displayed

if TYPE_CHECKING:
    from armsight.calibrate.arm import ArmResult, RobotWorldResult
    from armsight.calibrate.cameras import CameraCalibration, CamerasCalibration, StereoCalibration
    from armsight.calibrate.cameras.zoom import ZoomRigResult
    from armsight.calibrate.cell import CellResult
    from armsight.calibrate.identify import Identification
    from armsight.calibrate.light_target import TargetResult
    from armsight.calibrate.timing import CamerasTiming, TimingResult
    from armsight.calibrate.tooltip_result import PivotCalibration
    from armsight.verify.iso9283.plan import VerifyPlanOutput
    from armsight.verify.live import VerifyLiveOutput
    from armsight.verify.results import MasteringOutput, MasteringPlanOutput, VerifyResult

CORRECTIONS, URDF, PROPOSED = ".corrections.csv", ".urdf", ".proposed.csv"
"""Endings of what is written beside arm.yaml."""


def write_calibrated_arm(path: Path, result: ArmResult, *, inputs: Sequence[Path] = ()) -> None:
    """Write arm.yaml and what belongs beside it; what an earlier run wrote there and this one does not goes."""
    _write_proposal(path, result)
    write_arm(path, result.arm, inputs=inputs)
    write_text(path.with_suffix(CORRECTIONS), corrections(result))
    text, _ = as_urdf(result.arm)
    if text:
        write_text(path.with_suffix(URDF), text)
    else:  # an earlier run's is of another arm than the arm.yaml beside it
        delete_urdf(path.with_suffix(URDF))


def as_urdf(arm: Arm) -> tuple[str, str]:
    """Return the arm as a URDF, one that is not rigid as the nearest that is, and what is lost by that.

    '' where no rigid arm is near.
    """
    try:
        rigid = as_rigid(arm)
        return urdf_text(rigid.arm), rigid.lost
    except Inconsistent:
        return "", ""


def _write_proposal(out: Path, result: ArmResult) -> None:
    """Write further joint positions to measure at; without any, no such file of an earlier run stays."""
    path = out.with_suffix(PROPOSED)
    if result.proposals is None:
        with disk_errors(out):
            path.unlink(missing_ok=True)
        return
    names = ",".join(f"q{i + 1}" for i in range(result.nominal.n))
    write_text(path, "\n".join([names, *map(cells, result.proposals)]) + "\n")


def corrections(result: ArmResult) -> str:
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


def _zero_covariance(result: ArmResult, names: Sequence[str]) -> Array:
    free = tuple(name for name in names if name in result.free)
    C = np.zeros((len(names), len(names)))
    if result.covariance is not None and free:
        at = [names.index(name) for name in free]
        C[np.ix_(at, at)] = result.covariance.block(free)
    return C


YAML = (".yaml", ".yml")


def write_pivot(path: Path, result: PivotCalibration, *, inputs: Sequence[Path] = ()) -> None:
    """Write tip.yaml, and beside it the poses that were taken."""
    from armsight.store.handeye_file import write_tip  # each kind of file when one is written: all take long to load

    write_poses(path.with_suffix(".poses.csv"), result.taken)
    write_tip(path, result, inputs=inputs)


def write_identified(path: Path, result: Identification, *, inputs: Sequence[Path] = ()) -> None:
    """Write arm.yaml, and beside it the sweeps that have no file yet; those made live are the first of its inputs."""
    from armsight.store.arm_points import write_sweeps

    live, kept = result.plan is not None, path.with_suffix(".sweep.csv")
    if result.from_frames or (live and not kept.exists()):
        write_sweeps(kept, result.sweeps)
    write_arm(path, result.arm, inputs=[kept, *inputs] if live else inputs)


def write_identified_urdf(path: Path, result: Identification) -> None:
    """Write the arm as a URDF."""
    write_urdf(path, result.arm)


def write_lights(path: Path, result: TargetResult, *, inputs: Sequence[Path] = ()) -> None:
    """Write target.yaml with the lights' standard deviations."""
    write_target(path, result.target, inputs=inputs, std_m={name: list(std) for name, std in result.std.items()})


def write_calibrated_camera(path: Path, result: CameraCalibration, *, inputs: Sequence[Path] = ()) -> None:
    """Write camera.yaml with the covariance and noise; of a zoom lens keep its other settings."""
    noise = result.noise.noise if isinstance(result.noise, NoiseCalibration) else result.noise
    if result.setting is None:
        write_camera(
            path, result.camera, covariance=result.covariance, rms_px=result.rms_px, noise=noise, inputs=inputs
        )
    else:
        write_zoom_camera(path, with_setting(path, result.setting, noise), inputs=inputs)


def write_rig_of(
    path: Path,
    result: StereoCalibration | CamerasCalibration | TimingResult | CamerasTiming | ZoomRigResult,
    *,
    inputs: Sequence[Path] = (),
) -> None:
    """Write rig.yaml with what the result adds to it."""
    write_rig(path, result.rig, inputs=inputs)


def write_cell(folder: Path, result: CellResult, *, inputs: Sequence[Path] = ()) -> None:
    """Write rig.yaml, world.yaml, target.yaml, arm.yaml and cell.json into a folder."""
    parts = result.parts
    world = World(parent="base", T_parent_rig=parts.T_base_rig, covariance=parts.base_covariance)
    write_rig(folder / file_names.RIG, parts.rig, inputs=inputs)
    write_world(folder / file_names.WORLD, world, inputs=inputs)
    write_target(folder / file_names.TARGET, parts.target, inputs=inputs)
    write_arm(folder / file_names.ARM, parts.arm, inputs=inputs)
    write_json(folder / file_names.CELL, result.to_dict())


def write_placed_rig(path: Path, result: RobotWorldResult, *, inputs: Sequence[Path] = ()) -> None:
    """Write world.yaml: where the rig stands to the arm's base."""
    world = World(
        parent="base",
        T_parent_rig=result.pose,
        covariance=result.covariance,
        residual_rms_m=result.residual_rms_m,
        n_used=result.n_used,
    )
    write_world(path, world, inputs=inputs)


def write_verified(
    folder: Path, result: VerifyResult | VerifyLiveOutput | MasteringOutput, *, inputs: Sequence[Path] = ()
) -> None:
    """Write verify.json into a folder, and errors.csv where the result has rows."""
    from armsight.verify.results import MasteringOutput

    write_json(folder / file_names.VERIFY, result.to_dict())
    if not isinstance(result, MasteringOutput):
        write_text(folder / file_names.ERRORS, table_text(result.table))


def write_poses_to_measure(folder: Path, result: MasteringPlanOutput, *, inputs: Sequence[Path] = ()) -> None:
    """Write mastering.csv into a folder: the joint readings to drive to."""
    n = len(result.poses[0].q)
    lines = [",".join(["pose", *(f"q{i + 1}" for i in range(n)), "decides"])]
    lines += [f"{k},{cells(pose.q)},{word(' '.join(pose.decides))}" for k, pose in enumerate(result.poses, 1)]
    write_text(folder / file_names.MASTERING, "\n".join(lines) + "\n")


def write_planned_test(folder: Path, result: VerifyPlanOutput, *, inputs: Sequence[Path] = ()) -> None:
    """Write plan.csv and plan.json into a folder."""
    from armsight.store.path_file import write_test_plan

    write_test_plan(folder / file_names.PLAN, result)
    write_json(folder / file_names.PLAN_SUMMARY, result.to_dict())


WRITERS: Mapping[str, Mapping[str, str]] = {
    "Camera": dict.fromkeys(YAML, "rigs:write_camera"),
    "Rig": dict.fromkeys(YAML, "rigs:write_rig"),
    "Target": dict.fromkeys(YAML, "targets:write_target"),
    "Arm": {**dict.fromkeys(YAML, "arm_file:write_arm"), ".urdf": "urdf:write_urdf", ".mjcf": "mjcf:write_mjcf"},
    "TaughtPath": {".csv": "path_file:write_path"},
    "PoseTrack": {".csv": "tracks:write_poses", ".tum": "tracks:write_tum", ".txt": "tracks:write_tum"},
    "World": dict.fromkeys(YAML, "rigs:write_world"),
    "Limits": dict.fromkeys(YAML, "limits_file:write_limits"),
    "Identification": {".urdf": "saving:write_identified_urdf"},
}
"""By class and ending, the function of `store` that writes it: what is no action's result, and what a result is written
as beside its YAML file."""


def file_to_write(path: str | PathLike[str], *endings: str) -> Path:
    """Return the path of a file with one of these endings in a folder that is there; raises UsageError for another."""
    require_kind("path", path, str, PathLike, cure="Give a file's path as text or pathlib.Path")
    file = Path(path)
    if file.suffix.lower() not in endings:
        raise UsageError(f"{file} ends in {file.suffix or 'nothing'}", cure=f"End it in {' or '.join(endings)}")
    if not file.parent.is_dir():
        raise UsageError(f"there is no folder {file.parent}", cure="Make it, or give another path")
    return file
