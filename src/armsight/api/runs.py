"""verify, as the command of that name does it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from armsight.app.requests.verify import PlanJob, VerifyJob
from armsight.app.verify.plan import VerifyPlanOutput, run_plan
from armsight.app.verify.run import run_verify
from armsight.file_names import ERRORS
from armsight.ops.checks import speaks_python
from armsight.ops.given import (
    ArmLike,
    Given,
    PathText,
    PoseLike,
    TableLike,
)
from armsight.records import Progress
from armsight.records.output import extended, output
from armsight.store.interpret import TableFormat
from armsight.store.tables import Columns, read_columns
from armsight.verify.results import VerifyOutput

if TYPE_CHECKING:
    import plotly.graph_objects as go


@output
class VerifyResult(VerifyOutput):
    """What `verify` found: the figures of verify.json, and `errors`, columns by row of what was compared."""

    errors: Columns

    def plot(self) -> go.Figure:
        """Return a plotly figure of each row's error of place, mm."""
        import plotly.graph_objects as go

        figure = go.Figure(go.Scatter(x=self.errors["row"], y=1e3 * self.errors["error_m"], mode="markers"))
        figure.update_layout(title=self.verdict, xaxis_title="row", yaxis_title="error, mm")
        return figure


@speaks_python(VerifyJob)
def verify(
    measured: TableLike,
    *,
    arm: ArmLike | None = None,
    joints: TableLike | None = None,
    commanded: TableLike | None = None,
    world: PoseLike | None = None,
    align: Literal["none", "base", "tool", "both"] | None = None,
    compare: PathText | None = None,
    band_m: float | None = None,
    table: TableFormat | None = None,
    out: PathText | None = None,
) -> VerifyResult:
    """Return how measured poses differ from where the arm says it is, and what the difference comes from.

    Parameters
    ----------
    measured
        Poses or points: a file, a PoseTrack, columns by name, (t_s, T). With columns pose and visit, or run, also the
        figures of ISO 9283, in `iso9283`.
    arm, joints
        Where the arm says it is: an Arm, a preset's name or a file, and the controller's readings (t_s, q).
    commanded
        Instead of an arm: the poses that were commanded.
    world
        T_base_rig, where the measuring rig stands: nothing is then aligned.
    align
        What is laid where it fits best; else both, and none with world.
    compare
        The folder of an earlier run.
    band_m
        The limit band of arrivals at a pose.
    table
        What is said of a foreign table: units, columns, the robot's maker.
    out
        A folder for verify.json, errors.csv and report.html; None writes nothing.

    Raises
    ------
    NotEnoughData, Inconsistent, Degenerate
        Rows that cannot carry the answer.
    UsageError
        Parameters that mean nothing together.

    Examples
    --------
    >>> arm = armsight.presets.ur10()
    >>> q = np.random.default_rng(1).uniform(-1.5, 1.5, (40, 6))
    >>> armsight.verify(arm.fk(q), arm=arm, joints=q, align="none").after.rms_m < 1e-9
    True
    """
    with Given(out) as given:
        done = run_verify(given.job(VerifyJob, locals(), out=given.out))
        return extended(done, VerifyResult, errors=read_columns((given.out / ERRORS).read_bytes()))


@speaks_python(PlanJob)
def plan_verification(
    arm: ArmLike,
    out: PathText,
    part: str = PlanJob.part,
    *,
    side_m: float | None = None,
    speed_m_s: float | None = None,
    progress: Progress | None = None,
) -> VerifyPlanOutput:
    """Write plan.csv, the test of ISO 9283 for an arm, into a folder, and return what it holds.

    part: cube (all), poses, paths, or a motion's name. side_m: of the cube; else the largest that fits. speed_m_s:
    along the paths. Raises UsageError, DataRefused where no cube fits.

    Examples
    --------
    >>> armsight.plan_verification("irb120", folder / "plan", "poses", side_m=0.1).cube.side_m
    0.1
    """
    with Given(out) as given:
        job = given.job(PlanJob, {"arm": arm, "part": part, "side_m": side_m, "speed_m_s": speed_m_s})
        return run_plan(job, progress)
