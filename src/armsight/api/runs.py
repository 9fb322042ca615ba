"""The main jobs: measure, record, verify; each as the command of that name does it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from numpy.typing import ArrayLike

from armsight.app.measure.run import measure as run_measure
from armsight.app.record.record import RecordOutput, mend
from armsight.app.record.record import record as run_record
from armsight.app.requests.measure import MeasureJob, RecordJob
from armsight.app.requests.verify import PlanJob, VerifyJob
from armsight.app.verify.plan import VerifyPlanOutput, run_plan
from armsight.app.verify.run import run_verify
from armsight.drivers import CameraSettings, PairSettings
from armsight.file_names import ERRORS, POSES
from armsight.measure.results import MeasureOutput
from armsight.measure.track import PoseTrack
from armsight.ops.arrays import as_path
from armsight.ops.checks import speaks_python
from armsight.ops.given import (
    ArmLike,
    Given,
    PathText,
    PoseLike,
    RigLike,
    Source,
    TableLike,
    TargetLike,
)
from armsight.records import Progress, one_of
from armsight.records.output import extended, output
from armsight.store import read_poses
from armsight.store.interpret import TableFormat
from armsight.store.recording import ImageFormat, Repaired
from armsight.store.saving import file_to_write
from armsight.store.tables import Columns, read_columns
from armsight.verify.results import VerifyOutput

if TYPE_CHECKING:
    import plotly.graph_objects as go


@output
class MeasureResult(MeasureOutput):
    """What `measure` found: the figures of measure.json, and `poses`, the track."""

    poses: PoseTrack

    def plot(self) -> go.Figure:
        """Return a plotly figure of the poses over time."""
        return self.poses.plot()


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


@speaks_python(MeasureJob)
def measure(
    rig: RigLike,
    target: TargetLike,
    left: Source | None = None,
    right: Source | None = None,
    *,
    image: Source | None = None,
    times: TableLike | None = None,
    world: PoseLike | None = None,
    fps: float | None = None,
    frames: int | None = None,
    threshold: float | None = None,
    inverted: bool = False,
    stills: bool = False,
    bits: int | None = None,
    strict: bool = False,
    mask: ArrayLike | PathText | None = None,
    max_skew_s: float | None = None,
    method: Literal["likelihood", "seed"] = "likelihood",
    timing: Literal["auto", "pairs", "free"] = "auto",
    rate_hz: float | None = None,
    at: TableLike | None = None,
    left_spots: TableLike | None = None,
    right_spots: TableLike | None = None,
    zoom_left: float | None = None,
    zoom_right: float | None = None,
    camera_settings: PairSettings | None = None,
    out: PathText | None = None,
    progress: Progress | None = None,
) -> MeasureResult:
    """Return the target's pose in every pair of frames.

    Parameters
    ----------
    rig, target
        Records, or their files; of a printed board also 'checkerboard:9x6:0.025'.
    left, right
        Folders, patterns, videos, one recording as left, 'camera:NAME', lists of images, or iterables of Frame.
    image
        Instead: images that hold both views of a mirror rig.
    times
        t_s of the frames, {'t_s': [...]}; else counted by fps.
    world
        T_base_rig (4, 4) or world.yaml: poses are then in this frame.
    stills
        The frames are single shots, not a motion.
    bits
        Of the light in 16-bit images.
    out
        A folder for poses.csv, report.html and the rest; None writes nothing.

    Raises
    ------
    DataRefused
        Frames of another size, left and right swapped, nothing found at all.
    UsageError
        Parameters that mean nothing together.

    Examples
    --------
    >>> cell = armsight.simulate("hand-cell", frames=3)
    >>> done = armsight.measure(cell.rig, cell.target, [f.left for f in cell], [f.right for f in cell])
    >>> done.n_ok, done.poses.T_parent_target.shape
    (3, (3, 4, 4))
    """
    with Given(out) as given:
        job = given.job(MeasureJob, locals(), limit=frames, zoom=(zoom_left, zoom_right), out=given.out)
        done = run_measure(job, progress)
        poses = PoseTrack(poses=read_poses(given.out / POSES))
        return extended(done, MeasureResult, poses=poses)


@speaks_python(RecordJob)
def record(
    out: PathText,
    left: Source | None = None,
    right: Source | None = None,
    *,
    cell: str | None = None,
    seed: int = RecordJob.seed,
    rig: RigLike | None = None,
    target: TargetLike | None = None,
    format: Literal["png", "raw", "jpeg"] | ImageFormat = "png",
    colour: bool = False,
    fps: float | None = None,
    frames: int | None = None,
    seconds_s: float | None = None,
    max_skew_s: float | None = None,
    overwrite: bool = False,
    camera_settings: CameraSettings | None = None,
    progress: Progress | None = None,
) -> RecordOutput:
    """Write frames of both cameras into a recording (.mcap), with rig and target, and return what was recorded.

    Parameters
    ----------
    out
        FILE.mcap.
    left, right
        As `measure` takes them; or cell, a simulated one such as 'hand-cell', in their place.
    format
        png (bit for bit, small), raw (bit for bit, quick) or jpeg (smallest).
    frames, seconds_s
        When to stop; else with the frames.

    Raises
    ------
    UsageError
        The file is there already and overwrite is False, or there is nothing to record.
    DeviceFailed
        A camera or the disk; what was recorded until then is readable.

    Examples
    --------
    >>> cell = armsight.simulate("hand-cell", frames=2)
    >>> sides = [f.left for f in cell], [f.right for f in cell]
    >>> armsight.record(folder / "run.mcap", *sides, rig=cell.rig, target=cell.target).n_pairs
    2
    """
    file_to_write(out, ".mcap")
    with Given(out) as given:
        kind = one_of(ImageFormat, "format", format)
        return run_record(given.job(RecordJob, locals(), kind=kind, limit=frames, out=given.out), progress)


@speaks_python()
def repair_recording(path: PathText, out: PathText | None = None, *, overwrite: bool = False) -> Repaired:
    """Make a readable recording of one that was cut off: as out, or in its place with the broken one kept beside it.

    Raises BadFile for what is no recording, UsageError where a file would be lost.

    Examples
    --------
    >>> done = armsight.record(folder / "run.mcap", cell="hand-cell", frames=2)
    >>> armsight.repair_recording(folder / "run.mcap", folder / "whole.mcap").lost_bytes
    0
    """
    return mend(as_path(path), None if out is None else as_path(out, "out"), overwrite=overwrite)


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
