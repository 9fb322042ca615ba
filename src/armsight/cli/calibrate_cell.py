"""armsight calibrate cell."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from armsight.app import requests
from armsight.cli.command import calibrate, command
from armsight.cli.command_ui import CommandUI
from armsight.cli.tables import figure, parameter, pose_rows
from armsight.file_names import CELL, CELL_CALIBRATED
from armsight.units import MM

if TYPE_CHECKING:
    from armsight.calibrate.cell import CellCalibration


@command(calibrate, keeps=CELL_CALIBRATED, own=CELL, filed="calibrate cell", judged=True)
def cell(face: CommandUI, job: requests.calibrate_cell.CellJob) -> None:
    """Calibrate cameras, clocks, base, target and arm at once, from one recording of the moving arm.

    With --plan nothing is calibrated: it is `calibrate cell-plan`, with that command's flags.
    """
    from armsight.app.calibrate.cell import run_calibrate_cell

    done = run_calibrate_cell(job, face.progress("calibrating"))
    cell_tables(face, done, job.out)
    face.result(done)


def cell_tables(face: CommandUI, done: CellCalibration, out: Path) -> None:
    """Print a cell's calibration."""
    tip = done.tip
    rows = [
        ["as both cameras measure it", figure(tip.measured_m / MM, 2), figure(tip.measured_worst_m / MM, 2)],
        ["as the arm's joints say", figure(tip.commanded_m / MM, 2), figure(tip.commanded_worst_m / MM, 2)],
        ["added by the noise of one pair", figure(tip.noise_m / MM, 2), ""],
    ]
    face.table("The tip in base axes, +- mm", ["", "typical", "worst"], rows)
    face.table("T_base_rig", ["", "value", "+-"], pose_rows(done.T_base_rig, done.std))
    arm = [
        parameter(one.name, one.value, one.std)
        for one in done.learned
        if one.name in done.solved.model.arm.geometry or one.name.endswith(".sag")
    ]
    face.table("Changes of the arm", ["", "by", "+-"], arm)
    face.say(done.verdict)
    left, right = done.residual_px
    face.say(
        f"{done.n_frames} frames, {done.n_spots} spots, {done.n_left_out} of no light; residual {figure(left)} and "
        f"{figure(right)} px RMS, in stretches left out {figure(done.left_out_px[0])} and "
        f"{figure(done.left_out_px[1])} px"
    )
    face.say(
        f"Size of the target by the arm's lengths over its file's: {done.scale.ratio:.4f} +- {done.scale.std:.4f}; "
        f"the {done.scale.set_by} sets the scale"
    )
    for note in done.notes:
        face.say(note)
    for text in done.advice:
        face.say(f"- {text}")
    face.say(f"Result: {out}; open {out / 'report.html'}")
