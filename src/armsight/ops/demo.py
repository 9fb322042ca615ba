"""The main job on a simulated cell, and how far its poses are from the truth."""

from __future__ import annotations

import time
from importlib.resources import as_file, files
from pathlib import Path
from typing import Annotated

import numpy as np

from armsight.arrays import Array
from armsight.columns import POSE6
from armsight.fields import Doc
from armsight.file_names import DEMO, RIG
from armsight.geometry import pose_from_quat
from armsight.measure.poses.pipeline import Setup
from armsight.measure.results import MeasureResult
from armsight.measure.series import INSIDE_95, SCALE, errors_of
from armsight.measure.settings import SpotSettings
from armsight.ops.calibrate_cameras import calibrate_stereo
from armsight.ops.measure import measure
from armsight.ops.measurement.collector import About
from armsight.ops.measurement.run import run
from armsight.ops.measurement.warm_up import prepare
from armsight.ops.simulation.cells import CellPairs, load_cell, write_cell_files
from armsight.records import Progress, Silent
from armsight.records.output import Output, extended, output
from armsight.store import rig_from_mapping, target_from_mapping
from armsight.store.atomic import write_json

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
    with as_file(files("armsight.ops") / "pictures" / PICTURES) as folder:
        left, right = str(folder / "left*.jpg"), str(folder / "right*.jpg")
        rig = out / RIG
        calibrated = calibrate_stereo(left, right, BOARD, out=rig, progress=progress)
        measured = measure(rig, BOARD, left, right, stills=True, out=out, progress=progress)
    return PicturesOutput(
        n_pairs=calibrated.n_pairs,
        rms_px=calibrated.rms_px,
        baseline_m=calibrated.baseline_m,
        square_error_m=calibrated.metric["rms_m"],
        n_ok=measured.n_ok,
        out=str(out),
    )


@output
class TruthError(Output):
    """Error of one coordinate of the poses against the truth, in the unit of its key."""

    rms: Annotated[float, Doc("Root mean square error.")]
    max: Annotated[float, Doc("Largest absolute error.")]
    claimed: Annotated[float, Doc("Root mean square of the claimed standard deviations.")]


@output
class PoseErrors(Output):
    """Errors of the poses by coordinate."""

    x_m: Annotated[TruthError, Doc("Of x, m.")]
    y_m: Annotated[TruthError, Doc("Of y, m.")]
    z_m: Annotated[TruthError, Doc("Of z, m.")]
    rx_rad: Annotated[TruthError, Doc("Of the rotation about x, rad.")]
    ry_rad: Annotated[TruthError, Doc("Of the rotation about y, rad.")]
    rz_rad: Annotated[TruthError, Doc("Of the rotation about z, rad.")]


@output
class DemoOutput(MeasureResult):
    """armsight demo; also OUT/demo.json."""

    truth: Annotated[PoseErrors, Doc("Errors against the simulated truth, in rig axes.")]
    inside_95: Annotated[float | None, Doc("Share of the poses, 0 to 1, inside their own 95 % ellipsoid.")]
    seconds_s: Annotated[float, Doc("How long the whole command took, s.")]
    assumptions: Annotated[list[str], Doc("What the simulated cell takes for granted.")]
    pictures: Annotated[PicturesOutput | None, Doc("The real pictures; null where they were left out.")]


def demo(
    out: Path,
    *,
    seed: int,
    frames: int,
    cell: str,
    room: str | None = None,
    keep_frames: bool = False,
    pictures: bool = True,
    progress: Progress | None = None,
) -> DemoOutput:
    """Measure a simulated cell's frames into the folder out and compare with the truth.

    room: a room's name or a picture's path instead of the cell's own. pictures: calibrate and measure real pictures of
    a board too. Raises DeviceNotFound for an unknown cell,
    UsageError for an unknown room, what `run` raises, and Cancelled.
    """
    start_s = time.perf_counter()
    progress = progress or Silent()
    made = load_cell(cell, seed=seed, frames=frames, room=room)
    prepare(progress, cell=cell)
    rig, target = rig_from_mapping(made.rig, f"{cell}'s rig"), target_from_mapping(made.target, f"{cell}'s target")
    setup = Setup(rig=rig, target=target, settings=SpotSettings())
    write_cell_files(made, out, seed=seed, frames=frames)
    truth = [pose_from_quat(xyz_m, quat_xyzw) for _, xyz_m, quat_xyzw in made.truth]
    about = About(
        title=f"Demonstration: {cell}",
        facts=[("frames", f"simulated, {made.fps:g} a second, seed {seed}")],
        assumptions=made.assumptions,
        truth=truth,
    )
    pairs = CellPairs(made, frames, folder=out if keep_frames else None)
    summary = run(setup, pairs, out, progress=progress, about=about)
    errors = errors_of(summary.poses.poses, truth)
    compared = np.isfinite(errors.distance2)
    result = extended(
        summary,
        DemoOutput,
        truth=_pose_errors(errors.values[compared] * SCALE, errors.std[compared] * SCALE),
        inside_95=float(np.mean(errors.distance2[compared] <= INSIDE_95)) if compared.any() else None,
        seconds_s=time.perf_counter() - start_s,
        assumptions=list(made.assumptions),
        pictures=measure_pictures(out / FOLDER, progress) if pictures else None,
    )
    write_json(out / DEMO, result.to_dict())
    return result


def _pose_errors(errors: Array, claimed: Array) -> PoseErrors:
    """Return the figures of errors (n, 6) in m and rad and of the standard deviations (n, 6) that the poses claim."""
    return PoseErrors(
        **{
            name: TruthError(
                rms=_rms(errors[:, i]),
                max=float(np.abs(errors[:, i]).max(initial=0.0)),
                claimed=_rms(claimed[:, i]),
            )
            for i, name in enumerate(POSE6)
        }
    )


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2))) if len(values) else float("nan")
