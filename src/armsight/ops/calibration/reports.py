"""Reports of the calibrations of cameras and rigs."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from armsight.arrays import Array
from armsight.calibrate.cameras import CameraCalibration, StereoCalibration
from armsight.calibrate.mirrors.result import MirrorsOutput
from armsight.ops.calibration.board_pictures import BoardPictures, camera_boards, rig_boards
from armsight.optics import INTRINSICS, SIDES, Camera
from armsight.records import NamedCovariance, Target
from armsight.report import CalibrationRun, CameraFit, Parameter, calibration_report
from armsight.report.run import BoardViews
from armsight.store import write_text
from armsight.store.cell_file import CellMirrors
from armsight.store.targets import board_text
from armsight.units import MM, with_deviation


def camera_run(done: CameraCalibration, board: str, boards: BoardViews | None = None) -> CalibrationRun:
    """Return one camera's calibration as its report shows it."""
    return CalibrationRun(
        title="Calibration of a camera",
        board=board,
        cameras=[_fit("camera", done.camera, done.uv_px, done.residual_px, done.sources, done.view_rms_px)],
        parameters=_parameters("", done.camera, done.covariance),
        n_images=done.n_images,
        n_used=done.n_used,
        rms_px=done.rms_px,
        verdict=done.verdict_,
        holdout_rms_px=done.holdout_rms_px,
        rejected=done.rejected,
        advice=done.advice,
        boards=boards,
    )


def write_camera_report(out: Path, done: CameraCalibration, board: Target, pictures: BoardPictures) -> None:
    """Write the report of one camera's calibration beside its file; each setting of a zoom lens has one of its own."""
    run = camera_run(done, board_text(board), camera_boards(done, board, pictures))
    setting = "" if done.setting is None else f".zoom-{done.setting.zoom:g}"
    write_text(out.with_suffix(f"{setting}.report.html"), calibration_report(run))


def stereo_run(done: StereoCalibration, board: str, boards: BoardViews, **more: Any) -> CalibrationRun:
    """Return a rig's calibration as its report shows it; more: of CalibrationRun."""
    rig = done.pair_rig()
    parameters = [Parameter(name="baseline", value=rig.baseline_m * 1e3, std=done.baseline_std_m * 1e3, unit="mm")]
    for side in SIDES:
        parameters += _parameters(f"{side}.", rig.camera(side), rig.covariance)
    return CalibrationRun(
        board=board,
        thing=done.thing,
        cameras=[
            _fit(
                side,
                rig.camera(side),
                done.uv_px[side],
                done.residual_px[side],
                tuple(names[i] for names in done.sources),
                done.view_rms_px,
            )
            for i, side in enumerate(SIDES)
        ],
        parameters=parameters,
        n_images=done.n_pairs,
        n_used=done.n_used,
        rms_px=done.rms_px,
        verdict=done.verdict_,
        holdout_rms_px=done.holdout_rms_px,
        epipolar_rms_px=done.epipolar_rms_px,
        holdout_epipolar_rms_px=done.holdout_epipolar_rms_px,
        baseline_m=rig.baseline_m,
        metric={name: m for name, m in done.metric.items() if m is not None} if done.metric_is_left_out else {},
        rejected=done.rejected,
        advice=done.advice,
        boards=boards,
        **{"title": "Calibration of a pair of cameras", "alignment": alignment_lines(done), **more},
    )


def write_stereo_report(
    out: Path, done: StereoCalibration, board: Target, pictures: BoardPictures, *, shown: str = "", **more: Any
) -> None:
    """Write the report of a rig's calibration beside its file.

    shown: what the images show, where that is not the board's text. more: of CalibrationRun, title and alignment in
    place of a pair's.
    """
    run = stereo_run(done, shown or board_text(board), rig_boards(done, board, pictures), **more)
    write_text(out.with_suffix(".report.html"), calibration_report(run))


def write_mirrors_report(
    out: Path, done: MirrorsOutput, shown: Target, pictures: BoardPictures, built: CellMirrors
) -> None:
    """Write the report of a mirror rig's calibration beside its file; built: as designed, told where lights tell it."""
    facts = []
    if done.lit and built.baseline_m is not None:
        lens = done.rig.left
        facts = [
            ("lens", f"{lens.width}x{lens.height} px, focal length {lens.intrinsics[0]:.6g} px"),
            ("baseline as designed", f"{built.baseline_m / MM:g} mm"),
        ]
    write_stereo_report(
        out,
        done,
        shown,
        pictures,
        shown=", ".join(shown.names) if done.lit else "",
        title="Calibration of a mirror rig",
        alignment=[*alignment_lines(done), *done.plate_words()],
        facts=facts,
    )


def alignment_lines(done: StereoCalibration) -> list[tuple[str, str]]:
    """Return how parallel the pair stands, in words (Kapucu's alignment); as many digits as the standard deviations
    allow."""
    found = done.alignment
    std = found.std or {}

    def line(words: str, name: str, unit: str, scale: float) -> tuple[str, str]:
        value, deviation = with_deviation(scale * getattr(found, name), scale * std[name] if name in std else None)
        return words, f"{value} +- {deviation} {unit}" if name in std else f"{value} {unit}"

    return [
        line("axes turn towards each other by", "convergence_rad", "mrad", 1e3),
        line("right axis points below the left one by", "vertical_rad", "mrad", 1e3),
        line("right image lower at infinity by", "vertical_px", "px", 1.0),
        line("right image turned by", "roll_rad", "mrad", 1e3),
        line("right camera lower by", "height_m", "mm", 1e3),
        line("right camera further forward by", "advance_m", "mm", 1e3),
    ]


def _fit(
    name: str, camera: Camera, uv_px: Array, residual_px: Array, sources: Sequence[str], view_rms_px: Sequence[float]
) -> CameraFit:
    return CameraFit(
        name=name,
        camera=camera,
        uv_px=uv_px,
        residual_px=-residual_px,  # the report speaks of measured minus model
        sources=tuple(sources),
        view_rms_px=np.asarray(view_rms_px, float),
    )


def _parameters(prefix: str, camera: Camera, covariance: NamedCovariance | None) -> list[Parameter]:
    std: Mapping[str, float] = covariance.std() if covariance else {}
    return [
        Parameter(
            name=f"{prefix}{name}", value=float(value), std=std.get(f"{prefix}{name}"), unit="px" if i < 5 else ""
        )
        for i, (name, value) in enumerate(zip(INTRINSICS, camera.intrinsics, strict=True))
    ]
