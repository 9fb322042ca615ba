"""A whole cell calibrated from one recording of its moving arm."""

from __future__ import annotations

from collections.abc import Sequence

from armsight.app.calibrate.cell import run_calibrate_cell
from armsight.app.requests.calibrate_cell import CellJob
from armsight.calibrate.cell import CellCalibration
from armsight.ops.checks import speaks_python
from armsight.ops.given import ArmLike, Given, PathText, Source, TableLike, TargetLike
from armsight.records import Progress, checked_array, require_count
from armsight.records.output import extended, output
from armsight.store.interpret import TableFormat


@output
class CellResult(CellCalibration):
    """What `calibrate_cell` found: its figures; `rig` with timing, `T_base_rig`, `target`, `arm`; `parts` holds all."""


@speaks_python(CellJob)
def calibrate_cell(
    robot_log: TableLike,
    target: TargetLike,
    model: ArmLike,
    left: Source | None = None,
    right: Source | None = None,
    *,
    left_spots: TableLike | None = None,
    right_spots: TableLike | None = None,
    size: tuple[int, int] | None = None,
    right_size: tuple[int, int] | None = None,
    tip: PathText | Sequence[float] | None = None,
    tolerance_m: float = CellJob.tolerance_m,
    tolerance_rad: float = CellJob.tolerance_rad,
    compliance: bool | None = None,
    fps: float | None = None,
    frames: int | None = None,
    threshold: float | None = None,
    inverted: bool = False,
    table: TableFormat | None = None,
    out: PathText | None = None,
    progress: Progress | None = None,
) -> CellResult:
    """Return cameras, clocks, base, target and arm, all from one recording of the arm that moves lights on its flange.

    Parameters
    ----------
    robot_log
        (t_s, q) of the motion, or its file; also a recording that holds the robot's joints.
    target
        The lights on the flange, as built.
    model
        The arm as its data sheet says.
    left, right
        Frames of both cameras, each with its camera's stamps.
    left_spots, right_spots
        Instead of frames: columns t_s, u_px, v_px of each camera; size, right_size: of their images (w, h) px.
    tip
        Of the tool in target axes: (x, y, z) m, or tip.yaml.
    tolerance_m, tolerance_rad
        Standard deviation of nominal lengths, and of nominal zeros and angles.
    compliance
        Whether joints give way under the arm's weight; None: where the recording shows it, and else the
        deviations count what they may.
    out
        A folder to write rig.yaml, world.yaml, target.yaml, arm.yaml, cell.json and report.html into.

    Raises
    ------
    NotEnoughData, Degenerate
        Too little motion, or light.
    Inconsistent, Ambiguous, NotConverged
        Another arm, log or target; or something changed on the way, with what and when.

    Examples
    --------
    >>> made = armsight.write_simulation("cell", folder / "cell", frames=700)
    >>> found = armsight.calibrate_cell(
    ...     folder / "cell/joints.csv", folder / "cell/target.yaml", folder / "cell/arm.yaml",
    ...     left_spots=folder / "cell/left.csv", right_spots=folder / "cell/right.csv", size=(1280, 720))
    >>> found.tip.measured_m < 0.002
    True
    """
    if tip is not None and not isinstance(tip, str) and not hasattr(tip, "__fspath__"):
        tip = ",".join(map(repr, checked_array("tip", tip, (3,)).tolist()))
    for name, value in (("size", size), ("right_size", right_size)):
        if value is not None:
            for pixels in checked_array(name, value, (2,)).tolist():
                require_count(name, int(pixels) if pixels == int(pixels) else pixels, least=1)
    with Given(out) as given:
        values = {name: value for name, value in locals().items() if name != "given"}
        done = run_calibrate_cell(
            given.job(CellJob, values, limit=frames, tool="" if tip is None else str(tip), out=given.out), progress
        )
        return extended(done, CellResult)
