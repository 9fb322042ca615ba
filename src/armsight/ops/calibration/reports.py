"""Reports of the calibrations of cameras and rigs."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from armsight.calibrate.cameras import CameraCalibration, CamerasCalibration, StereoCalibration
from armsight.calibrate.cameras.two_sides import TwoSided
from armsight.ops.calibration.board_pictures import BoardPictures, camera_boards, many_boards, rig_boards
from armsight.ops.calibration.shown import front_of, words_of
from armsight.records import Target
from armsight.report.calibration import calibration_report
from armsight.store import write_text
from armsight.store.targets import board_text
from armsight.units import MM

if TYPE_CHECKING:
    from armsight.calibrate.mirrors.result import MirrorsOutput
    from armsight.store.cell_file import CellMirrors


def write_camera_report(out: Path, done: CameraCalibration, board: Target, pictures: BoardPictures) -> None:
    """Write the report of one camera's calibration beside its file; each setting of a zoom lens has one of its own."""
    setting = "" if done.setting is None else f".zoom-{done.setting.zoom:g}"
    page = calibration_report(done, board_text(board), camera_boards(done, board, pictures))
    write_text(out.with_suffix(f"{setting}.report.html"), page)


def write_stereo_report(out: Path, done: StereoCalibration, board: Target, pictures: BoardPictures) -> None:
    """Write the report of a rig's calibration beside its file."""
    page = calibration_report(done, board_text(board), rig_boards(done, board, pictures))
    write_text(out.with_suffix(".report.html"), page)


def write_cameras_report(
    out: Path, done: CamerasCalibration, shown: Target | TwoSided, pictures: BoardPictures
) -> None:
    """Write the report of the calibration of some cameras beside its file."""
    page = calibration_report(done, words_of(shown), many_boards(done, front_of(shown), pictures))
    write_text(out.with_suffix(".report.html"), page)


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
    words = ", ".join(shown.names) if done.lit else board_text(shown)
    page = calibration_report(done, words, rig_boards(done, shown, pictures), facts=facts)
    write_text(out.with_suffix(".report.html"), page)
