"""The main jobs: measure, record, verify; each as the command of that name does it."""

from __future__ import annotations

from typing import TYPE_CHECKING, Literal

from numpy.typing import ArrayLike

from armsight.api.tracks import PoseTrack
from armsight.app.measure.run import measure as run_measure
from armsight.app.record.record import RecordOutput, mend
from armsight.app.record.record import record as run_record
from armsight.app.requests.measure import MeasureJob, RecordJob
from armsight.drivers import CameraSettings, PairSettings
from armsight.file_names import POSES
from armsight.measure.results import MeasureOutput
from armsight.ops.arrays import as_path
from armsight.ops.checks import speaks_python
from armsight.ops.given import (
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
from armsight.store.recording import ImageFormat, Repaired
from armsight.store.saving import file_to_write

if TYPE_CHECKING:
    import plotly.graph_objects as go


@output
class MeasureResult(MeasureOutput):
    """What `measure` found: the figures of measure.json, and `poses`, the track."""

    poses: PoseTrack

    def plot(self) -> go.Figure:
        """Return a plotly figure of the poses over time."""
        return self.poses.plot()


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
