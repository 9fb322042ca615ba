"""The second part of the demo: real pictures of a board, calibrated and measured."""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path

from armsight.app.calibrate.cameras import calibrate_stereo
from armsight.app.measure.run import measure
from armsight.app.requests.calibrate_cameras import StereoJob
from armsight.app.requests.measure import MeasureJob
from armsight.app.schemas.measure import PicturesOutput
from armsight.records import Progress

PICTURES, BOARD = "opencv_stereo", "checkerboard:9x6:0.025"
FOLDER = "pictures"


def measure_pictures(out: Path, progress: Progress) -> PicturesOutput:
    """Calibrate two cameras from OpenCV's sample pictures, and measure the board in them; write out.

    Raises what calibrating and measuring raise.
    """
    with as_file(files("armsight.app") / "pictures" / PICTURES) as folder:
        left, right = str(folder / "left*.jpg"), str(folder / "right*.jpg")
        rig = out / "rig.yaml"
        calibrated = calibrate_stereo(StereoJob(board=BOARD, out=rig, left=left, right=right), progress)
        job = MeasureJob(rig=rig, target=Path(BOARD), out=out, left=left, right=right, stills=True)
        measured = measure(job, progress)
    return PicturesOutput(
        n_pairs=calibrated.n_pairs,
        rms_px=calibrated.rms_px,
        baseline_m=calibrated.baseline_m,
        square_error_m=calibrated.metric["rms_m"],
        n_ok=measured.n_ok,
        out=str(out),
    )
