"""pairs.csv and robot_poses.csv in; handeye.yaml and tip.yaml out and in."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.handeye import HandEyeResult, ImageComparison, LeftOutErrors, PosePairs, Setup
from armsight.calibrate.tooltip_result import ToolTipResult
from armsight.columns import POSITION, QUATERNION
from armsight.errors import BadFile, Inconsistent
from armsight.geometry import pose_from_quat
from armsight.records import NamedCovariance
from armsight.store import codec
from armsight.store.atomic import write_text
from armsight.store.covariances import CAMERA_COVARIANCE, above_diagonal, all_covariances
from armsight.store.interpret import OURS, TableFormat
from armsight.store.interpret.read import check_positions, standard_bytes
from armsight.store.lost import without_lost
from armsight.store.rigs import write_camera
from armsight.store.schema import Kind, Origin, write_document
from armsight.store.tables import Table, cells, parse_table

CELLS = (*POSITION, *QUATERNION)
PAIR_COLUMNS = tuple(f"{who}_{cell}" for who in ("base_flange", "camera_target") for cell in CELLS)


class ImagesModel(codec.Strict):
    """What a result from images rests on, and the errors of all that were compared."""

    kept: Literal["poses", "corners", "corners and camera"]
    n_images: int
    errors: dict[str, codec.structure(LeftOutErrors)]  # type: ignore[valid-type]  # made of the record's fields


class HandEyeModel(Origin):
    """handeye.yaml: the poses that its setup names."""

    format: Literal["armsight/handeye"] = "armsight/handeye"
    setup: Literal["eye-in-hand", "eye-to-hand"]
    T_flange_camera: codec.PoseModel | None = None
    T_base_target: codec.PoseModel | None = None
    T_base_camera: codec.PoseModel | None = None
    T_flange_target: codec.PoseModel | None = None
    covariance: codec.CovarianceModel | None = None
    residual_rms_m: codec.Finite | None = None
    residual_rms_rad: codec.Finite | None = None
    loo_rms_m: codec.Finite | None = None
    loo_rms_rad: codec.Finite | None = None
    n_used: int | None = None
    crossval: ImagesModel | None = None
    verdict: str | None = None


class TipModel(Origin):
    """tip.yaml: where the tool's end is in the turned frame, and where it rested."""

    format: Literal["armsight/tip"] = "armsight/tip"
    tip_m: codec.Vector3
    point_m: codec.Vector3 | None = None
    covariance: codec.CovarianceModel | None = None
    residual_rms_m: codec.Finite | None = None
    loo_rms_m: codec.Finite | None = None
    n_used: int | None = None
    n_effective: codec.Finite | None = None
    correlation_time_s: codec.Finite | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class HandEyeFile:
    """What a handeye.yaml says: EYE_IN_HAND: T_flange_camera, T_base_target; EYE_TO_HAND: T_base_camera,
    T_flange_target; covariance (12, 12) of both."""

    setup: Setup
    T_parent_camera: RigidTransform
    T_parent_target: RigidTransform
    covariance: NamedCovariance | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TipFile:
    """What a tip.yaml says: tip_m (3,) in the turned frame's axes; covariance of tip and point, where known."""

    tip_m: NDArray[np.float64]
    covariance: NamedCovariance | None


def read_pairs(path: Path, format_: TableFormat = OURS) -> PosePairs:
    """Return the pose pairs of a pairs.csv, or of a file that can be understood as one.

    Raises BadFile that names line and column, Inconsistent where units contradict the numbers, NotEnoughData.
    """
    data = standard_bytes(path, "pairs", format_)
    file = parse_table(
        data, str(path), PAIR_COLUMNS, optional=CAMERA_COVARIANCE, blank=(*PAIR_COLUMNS, *CAMERA_COVARIANCE)
    )
    table = without_lost(file, format_.notify)
    row = {line: k for k, line in enumerate(file.lines, 1)}
    for who in ("base_flange", "camera_target"):
        names = [f"{who}_{name}" for name in POSITION]
        check_positions(table.stacked(names), names, str(path), format_)
    robot, camera = (_poses(table, f"{who}_") for who in ("base_flange", "camera_target"))
    covariance, note = all_covariances(table, path, 6, "the camera's poses", "camera_target_")
    pairs = PosePairs.of(robot, camera, [f"row {row[line]}" for line in table.lines], covariance)
    return replace(pairs, unweighed=note)


def write_pairs(path: Path, pairs: PosePairs) -> None:
    """Write pairs.csv."""
    write_text(path, pairs_text(pairs))


def pairs_text(pairs: PosePairs) -> str:
    """Return a pairs.csv, with the covariances of the camera's poses where they are known."""
    columns = [
        np.concatenate([poses.translation, poses.rotation.as_quat(canonical=True)], axis=1)
        for poses in (pairs.T_base_flange, pairs.T_camera_target)
    ]
    header = PAIR_COLUMNS
    if pairs.camera_covariance is not None:
        header = (*header, *CAMERA_COVARIANCE)
        columns.append(np.sqrt(np.diagonal(pairs.camera_covariance, axis1=1, axis2=2)))
        columns.append(np.array([above_diagonal(each) for each in pairs.camera_covariance]))
    rows = (cells(row) for row in np.concatenate(columns, axis=1))
    return "\n".join([",".join(header), *rows]) + "\n"


def read_robot_poses(
    path: Path, format_: TableFormat = OURS, *, images: Sequence[str] = ()
) -> dict[str, RigidTransform]:
    """Return T_base_flange by the image's file name from a robot_poses.csv, or a file that can be understood as one.

    images: names of the images in their order. A file that names none of them gives them the poses by the numbers in
    both names, or in order where it names no file at all and there are as many; format_.tell says so. Raises BadFile
    that names line and column, Inconsistent where units contradict the numbers or the counts differ.
    """
    data = standard_bytes(path, "robot_poses", format_)
    file = parse_table(data, str(path), CELLS, optional=("file",), text=("file",), blank=CELLS)
    table = without_lost(file, format_.notify)
    check_positions(table.stacked(POSITION), POSITION, str(path), format_)
    poses = _poses(table, "")
    if "file" not in table.text:
        ordered = dict(zip(file.lines, _in_order(path, len(file), images, format_), strict=True))
        return dict(zip([ordered[line] for line in table.lines], poses, strict=True))
    files = [Path(name).name for name in table.text["file"]]
    for row, name in enumerate(files):
        if not name or name in files[:row]:
            raise BadFile(
                f"{table.location(row)}, column file: {name[:40]!r} is empty or stands twice",
                consequence="Nobody knows which pose belongs to the image",
                cure="Give every image one row",
            )
    return dict(zip(_by_number(path, files, images, format_), poses, strict=True))


def _in_order(path: Path, n: int, images: Sequence[str], format_: TableFormat) -> Sequence[str]:
    """Return the images' names for poses that name none; Inconsistent where their numbers differ."""
    if n != len(images):
        raise Inconsistent(
            f"{path}: no column file, and {n} poses for {len(images)} images",
            consequence="Nobody knows which pose belongs to which image",
            cure="Add a column file with the images' names",
        )
    format_.notify(f"{path.name}: no column file: the poses are those of the {n} images in the order of their names")
    return images


def _by_number(path: Path, files: Sequence[str], images: Sequence[str], format_: TableFormat) -> Sequence[str]:
    """Return the images' names for files that name none of them but carry the same numbers; else the files."""
    if not images or set(files) & set(images):
        return files
    numbers = [[re.findall(r"\d+", Path(name).stem) for name in names] for names in (files, images)]
    if not all(part for part in numbers[0]) or not all(part for part in numbers[1]):
        return files
    ours, theirs = ([int(part[-1]) for part in side] for side in numbers)
    if len(set(ours)) < len(ours) or len(set(theirs)) < len(theirs) or not set(ours) & set(theirs):
        return files
    format_.notify(f"{path.name}: images and poses belong together by the numbers in their names")
    named_by = dict(zip(theirs, images, strict=True))
    return [named_by.get(number, name) for number, name in zip(ours, files, strict=True)]


def freed_camera_path(out: Path) -> Path:
    """Return where the freed camera goes beside a handeye.yaml."""
    return out.with_suffix(".camera.yaml")


def write_handeye(path: Path, result: HandEyeResult, *, inputs: Sequence[Path] = ()) -> None:
    """Write handeye.yaml with the hashes of what it was made from, and beside it the camera that was freed and kept."""
    if result.camera is not None:
        write_camera(freed_camera_path(path), result.camera, rms_px=result.reprojection_rms_px, inputs=inputs)
    HANDEYE_YAML.write(path, result, inputs=inputs)


def _handeye_content(result: HandEyeResult) -> dict[str, Any]:
    return {
        "setup": str(result.setup),
        **{name: codec.pose_mapping(pose) for name, pose in named_poses(result).items()},
        "covariance": codec.covariance_mapping(result.covariance),
        "residual_rms_m": result.residual_rms_m,
        "residual_rms_rad": result.residual_rms_rad,
        "loo_rms_m": result.loo_rms_m,
        "loo_rms_rad": result.loo_rms_rad,
        "n_used": result.n_used,
        **({} if result.comparison is None else {"crossval": _crossval(result.comparison)}),
        "verdict": result.verdict,
    }


def _crossval(comparison: ImageComparison) -> dict[str, object]:
    """Return what the result rests on, and the errors at images left out by what it could have rested on."""
    return {
        "kept": str(comparison.kept),
        "n_images": comparison.n_judged,
        "errors": {str(basis): errors.to_dict() for basis, errors in comparison.errors.items()},
    }


def write_handeye_poses(
    path: Path, setup: Setup, T_parent_camera: RigidTransform, T_parent_target: RigidTransform
) -> None:
    """Write handeye.yaml of poses that are known without a calibration, such as those of a simulated cell."""
    camera, target = ("flange", "base") if setup is Setup.EYE_IN_HAND else ("base", "flange")
    content = {
        "setup": str(setup),
        f"T_{camera}_camera": codec.pose_mapping(T_parent_camera),
        f"T_{target}_target": codec.pose_mapping(T_parent_target),
        "verdict": "known, not calibrated",
    }
    write_document(path, HANDEYE_YAML.format, content, ())


def named_poses(result: HandEyeResult) -> dict[str, RigidTransform]:
    """Return the two poses under the names that their setup gives them."""
    return {
        f"T_{result.camera_parent}_camera": result.T_parent_camera,
        f"T_{result.target_parent}_target": result.T_parent_target,
    }


def _handeye(model: HandEyeModel) -> HandEyeFile:
    setup = Setup(model.setup)
    inside = setup is Setup.EYE_IN_HAND
    camera, target = (
        (model.T_flange_camera, model.T_base_target) if inside else (model.T_base_camera, model.T_flange_target)
    )
    if camera is None or target is None:
        wanted = "T_flange_camera and T_base_target" if inside else "T_base_camera and T_flange_target"
        raise BadFile(f"{setup} needs {wanted}", cure="Calibrate it again")
    return HandEyeFile(
        setup=setup,
        T_parent_camera=camera.pose(),
        T_parent_target=target.pose(),
        **codec.values(model, "covariance"),
    )


HANDEYE_YAML: Kind[HandEyeFile] = Kind(name="handeye", model=HandEyeModel, record=_handeye, content=_handeye_content)
"""Of a HandEyeResult in, which tells more than is read."""
read_handeye = HANDEYE_YAML.read


def _tip_content(result: ToolTipResult) -> dict[str, Any]:
    return {
        "tip_m": result.tip_m.tolist(),
        "point_m": result.point_m.tolist(),
        "covariance": codec.covariance_mapping(result.covariance),
        "residual_rms_m": result.residual_rms_m,
        "n_used": result.n_used,
        "loo_rms_m": result.loo_rms_m,
        "n_effective": result.n_effective,
        "correlation_time_s": None if result.correlation is None else result.correlation.time_s,
    }


def _tip(model: TipModel) -> TipFile:
    return TipFile(tip_m=np.array(model.tip_m), **codec.values(model, "covariance"))


TIP_YAML: Kind[TipFile] = Kind(name="tip", model=TipModel, record=_tip, content=_tip_content)
"""Of a ToolTipResult in, which tells more than is read."""
read_tip, write_tip = TIP_YAML.read, TIP_YAML.write


def _poses(table: Table, prefix: str) -> list[RigidTransform]:
    xyz = table.stacked([f"{prefix}{cell}" for cell in POSITION])
    quat = table.stacked([f"{prefix}{cell}" for cell in QUATERNION])
    out = []
    for row in range(len(table)):
        with codec.named(table.location(row)):
            out.append(pose_from_quat(xyz[row], quat[row]))
    return out
