"""What this machine can do, and the papers' experiments on it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Literal

from armsight.app.doctor import DoctorOutput
from armsight.app.doctor import doctor as look_at_machine
from armsight.app.requests.simulate import DoctorJob, ReproduceJob
from armsight.app.simulate.reproduced import ReproduceOutput
from armsight.drivers import PAPERS, load
from armsight.ops.arrays import as_path
from armsight.ops.checks import speaks_python
from armsight.ops.given import Given, PathText, RigLike, as_text
from armsight.records import Progress, checked_array


@speaks_python(DoctorJob)
def doctor(
    rig: RigLike | None = None,
    *,
    depths_m: Sequence[float] = (),
    sigma_px: float = DoctorJob.sigma_px,
    accuracy_m: float | None = None,
    compile_ahead: bool = False,
    progress: Progress | None = None,
) -> DoctorOutput:
    """Return what this machine can do (versions, cameras, drivers, compiled code), and what a rig can tell apart.

    depths_m: distances for the rig. sigma_px: of a spot's centre. accuracy_m: tell also what reaches this standard
    deviation of a point. compile_ahead: first compile all that is not compiled yet. Raises UsageError, BadFile,
    Cancelled.

    Examples
    --------
    >>> "rtde" in armsight.doctor().drivers["robots"]
    True
    """
    depths = checked_array("depths_m", depths_m, (None,)).tolist()
    with Given() as given:
        file = None if rig is None else given.file("rig", rig)
        return look_at_machine(
            file,
            depths_m=depths,
            sigma_px=sigma_px,
            accuracy_m=accuracy_m,
            compile_ahead=compile_ahead,
            progress=progress,
        )


@speaks_python(ReproduceJob)
def reproduce(
    paper: Literal["korayem2018", "pachidis2005", "kapucu2005"],
    out: PathText,
    *,
    seed: int = ReproduceJob.seed,
    frames: int | None = None,
    progress: Progress | None = None,
) -> ReproduceOutput:
    """Do a paper's experiment on its simulated cell, by its method and by ours, and write report and tables into out.

    seed: of the noise. frames: fewer than the paper has. Raises UsageError with the papers there are, DeviceFailed.
    """
    run: Callable[..., ReproduceOutput] = load(PAPERS, "reproduce")
    return run(as_text("paper", paper), as_path(out, "out"), seed=seed, frames=frames, progress=progress)
