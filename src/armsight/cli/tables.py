"""Results as people read them: millimetres, degrees, pixels, rounded to what they are worth."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from armsight import shown
from armsight.cli.actions import show_lines
from armsight.cli.command_ui import CommandUI, own_command
from armsight.columns import POSITION, ROTATION_VECTOR
from armsight.shown import digits
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from scipy.spatial.transform import RigidTransform

    from armsight.ops.demo import DemoOutput, PoseErrors
    from armsight.records.result_parts import PoseStd

figure = digits
parameter = shown.parameter_row


def pose_rows(pose: RigidTransform, std: PoseStd) -> list[list[str]]:
    """Return the rows of a pose: position in mm and rotation vector in degrees, each with its standard deviation."""
    rotation = pose.rotation.as_rotvec()
    return shown.pose_rows(pose.translation.tolist(), rotation.tolist(), std.translation_m, std.rotation_rad)


def demo_tables(face: CommandUI, result: DemoOutput, out: Path) -> None:
    """Print how far the demo's poses are from the truth."""
    show_lines(face, result.summary(), out)
    face.table("Error against the truth", ["", "RMS", "largest", "claimed +-"], _truth_rows(result.truth))
    if result.inside_95 is not None:
        face.say(f"{figure(100.0 * result.inside_95, 3)} % of the poses lie inside their own 95 % ellipsoid.")
    real = result.pictures
    if real is not None:
        square = "-" if real.square_error_m is None else f"{figure(real.square_error_m / MM, 2)} mm RMS"
        face.say(
            f"Real pictures of a board, {real.n_pairs} pairs: calibrated to {figure(real.rms_px, 2)} px, the cameras "
            f"{figure(real.baseline_m / MM, 4)} mm apart, its squares of 25 mm measured to {square}; its pose in "
            f"{real.n_ok} of {real.n_pairs}: {real.out}"
        )
    face.say(f"All in {figure(result.seconds_s, 2)} s.")
    command = own_command()
    face.say(f"The operator's page of a simulated cell: {command} console --robot sim:webcam-cell")
    if command != "armsight":
        folder = Path(command.split()[0]).parent
        face.say(f"The shell does not know armsight yet: call {command}, or first type: . {folder / 'activate'}")


def _truth_rows(truth: PoseErrors) -> list[list[str]]:
    """Return name, RMS, largest and claimed standard deviation (RMS) of each coordinate, in mm and degrees."""
    named = [(f"{name.removesuffix('_m')}, mm", getattr(truth, name), MM) for name in POSITION]
    named += [(f"{name.removesuffix('_rad')}, deg", getattr(truth, name), DEG) for name in ROTATION_VECTOR]
    return [
        [name, *(figure(value / unit) for value in (error.rms, error.max, error.claimed))]
        for name, error, unit in named
    ]
