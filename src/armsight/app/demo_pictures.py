"""The second part of the demo: real pictures of a board, calibrated and measured."""

from __future__ import annotations

from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

from armsight.app.calibrate.cameras import CalibrateJob, calibrate_stereo
from armsight.app.measure.run import MeasureJob, measure
from armsight.records import Progress
from armsight.records.fields import Doc
from armsight.records.output import Output, output

PICTURES, BOARD = "opencv_stereo", "checkerboard:9x6:0.025"
FOLDER = "pictures"


@output
class PicturesOutput(Output):
    """The demo's real pictures of a checkerboard, calibrated and measured."""

    n_pairs: Annotated[int, Doc("Pairs of pictures.")]
    rms_px: Annotated[float, Doc("Reprojection residual of the calibration, RMS, px.")]
    baseline_m: Annotated[float, Doc("Distance of the two cameras, m.")]
    square_error_m: Annotated[
        float | None, Doc("Error of the board's squares in pairs that the calibration did not see, RMS, m.")
    ]
    n_ok: Annotated[int, Doc("Pairs in which the board's pose was measured.")]
    out: Annotated[str, Doc("Where its results are.")]


def measure_pictures(out: Path, progress: Progress) -> PicturesOutput:
    """Calibrate two cameras from OpenCV's sample pictures, and measure the board in them; write out.

    Raises what calibrating and measuring raise.
    """
    with as_file(files("armsight.app") / "pictures" / PICTURES) as folder:
        left, right = str(folder / "left*.jpg"), str(folder / "right*.jpg")
        rig = out / "rig.yaml"
        calibrated = calibrate_stereo(CalibrateJob(board=BOARD, out=rig, left=left, right=right), progress)
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
