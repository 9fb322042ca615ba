"""Tools for taught paths, as `armsight path` has them: `armsight.paths.smooth(path)` and so on, paths in, paths out."""

from __future__ import annotations

from typing import Literal

from numpy.typing import ArrayLike

from armsight.app.path.check import PathCheckOutput
from armsight.app.path.check import check as run_check
from armsight.app.path.export import PathExportOutput, export_path
from armsight.app.path.picks import PathPicksOutput, path_from_picks
from armsight.app.path.tools import smooth_path
from armsight.app.requests.files import ExportJob, JoinPathsJob, PicksJob, SmoothJob
from armsight.control import paths as tools
from armsight.control.guard import Limits
from armsight.ops.arrays import as_path
from armsight.ops.checks import speaks_python
from armsight.ops.given import ArmLike, Given, PathText, PoseLike, RigLike, Source, TableLike
from armsight.records import Progress, Silent, TaughtPath, checked_array, require_kind
from armsight.records.output import extended, output
from armsight.store.path_file import read_path

__all__ = ["angle", "check", "export", "fillet", "from_picks", "join", "offset", "resample", "reverse", "smooth"]


@output
class PicksResult(PathPicksOutput):
    """What `from_picks` found: its figures, and `taught`, the path."""

    taught: TaughtPath


@speaks_python(SmoothJob)
def smooth(
    path: TaughtPath,
    *,
    bound_m: float = SmoothJob.bound_m,
    bound_rad: float = SmoothJob.bound_rad,
    outliers: Literal["refuse", "drop", "keep"] = "refuse",
) -> TaughtPath:
    """Return a path smoothed, no row moved or turned by more than the bounds.

    outliers: what becomes of rows that do not belong to it. Raises Inconsistent, with the rows, where they are refused.

    Examples
    --------
    >>> T = np.tile(np.eye(4), (9, 1, 1))
    >>> T[:, 0, 3] = np.linspace(0.0, 0.1, 9)
    >>> len(armsight.paths.smooth(armsight.TaughtPath.of_poses(T)))
    9
    """
    _check(path)
    return smooth_path(path, bound_m=bound_m, bound_rad=bound_rad, on_outliers=outliers, where="the path")[0]


@speaks_python()
def resample(path: TaughtPath, step_m: float, *, spline: bool = False) -> TaughtPath:
    """Return a path with rows at most step_m apart; spline: on splines between corners, not on lines."""
    _check(path)
    return tools.resampled(path, step_m, spline=spline)


@speaks_python()
def fillet(path: TaughtPath, radius_m: float) -> TaughtPath:
    """Return a path with its corners rounded to arcs of radius_m."""
    _check(path)
    return tools.filleted(path, radius_m)


@speaks_python()
def offset(path: TaughtPath, by_m: float) -> TaughtPath:
    """Return a path moved along the tool's z axis by by_m; negative: back from the work."""
    _check(path)
    return tools.offset_along_tool(path, by_m)


@speaks_python()
def angle(path: TaughtPath, *, travel_rad: float = 0.0, work_rad: float = 0.0) -> TaughtPath:
    """Return a path with the tool tilted about its tip: toward the direction of travel, and about it."""
    _check(path)
    return tools.tilted(path, travel_rad=travel_rad, work_rad=work_rad)


@speaks_python()
def reverse(path: TaughtPath) -> TaughtPath:
    """Return a path from its end to its start."""
    _check(path)
    return tools.reversed_path(path)


@speaks_python(JoinPathsJob)
def join(
    first: TaughtPath, second: TaughtPath, *, gap_m: float = JoinPathsJob.gap_m, gap_rad: float = JoinPathsJob.gap_rad
) -> TaughtPath:
    """Return two paths one after the other. Raises Inconsistent where their ends are further apart than the gap."""
    _check(first)
    _check(second)
    return tools.joined(first, second, gap_m=gap_m, gap_rad=gap_rad)


@speaks_python()
def check(
    path: TaughtPath | PathText,
    arm: ArmLike,
    *,
    tip: PoseLike | None = None,
    limits: Limits | PathText | None = None,
    frame: Literal["world", "base"] = "world",
    speed_m_s: float | None = None,
    start: ArrayLike | None = None,
    out: PathText | None = None,
) -> PathCheckOutput:
    """Return whether an arm can run the whole path, and what is wrong where.

    tip: in flange axes; else the arm's tool. frame: of a path.csv. speed_m_s: where the path leaves it open. start:
    readings (n,) where the arm stands. out: a page with the picture. Raises UsageError, BadFile, NotEnoughData.
    """
    with Given() as given:
        q = None if start is None else checked_array("start", start, (None,)).tolist()
        return run_check(
            given.file("path", path),
            given.arm("arm", arm),
            tip=None if tip is None else given.file("tip", tip),
            limits=None if limits is None else given.file("limits", limits),
            parent=path.parent if isinstance(path, TaughtPath) else frame,
            speed_m_s=speed_m_s,
            start=None if q is None else ",".join(map(repr, q)),
            out=None if out is None else as_path(out, "out"),
        )


@speaks_python(ExportJob)
def export(
    path: TaughtPath | PathText,
    out: PathText,
    *,
    to: str | None = None,
    arm: ArmLike | None = None,
    tip: PoseLike | None = None,
    limits: Limits | PathText | None = None,
    frame: Literal["world", "base"] = "world",
    start: ArrayLike | None = None,
    name: str | None = None,
    speed_m_s: float | None = None,
    blend_m: float = ExportJob.blend_m,
    acceleration_m_s2: float = ExportJob.acceleration_m_s2,
    approach_m: float = ExportJob.approach_m,
    tool: str | None = None,
    weld_output: str | None = None,
) -> PathExportOutput:
    """Write a path as a robot's program, checked for the arm before, as CSV or as a Python module.

    to: which, else by the ending of out. arm, tip, limits, frame, start: as `check` takes them. name: of the program.
    The others are written into it. Raises Inconsistent where the arm cannot run it, UsageError, BadFile.
    """
    with Given(out) as given:
        q = None if start is None else ",".join(map(repr, checked_array("start", start, (None,)).tolist()))
        source = given.file("path", path)
        parent = path.parent if isinstance(path, TaughtPath) else frame
        return export_path(given.job(ExportJob, locals(), start=q, parent=parent, source=source))


@speaks_python(PicksJob)
def from_picks(
    left: Source,
    right: Source,
    rig: RigLike,
    picks: TableLike,
    *,
    view: Literal["left", "right"] = "left",
    world: PoseLike | None = None,
    step_px: float = PicksJob.step_px,
    tool_axis: str | None = None,
    skip: bool = False,
    out: PathText | None = None,
    progress: Progress | None = None,
) -> PicksResult:
    """Return the path through places that were picked in one picture of a pair.

    picks: columns u_px, v_px of the places; or a file. view: of which picture. world: T_base_rig; else the path is in
    the rig's axes. step_px: between points on an edge. tool_axis: of the tool's z. skip: places that are not found.
    Raises NotEnoughData, BadImage, UsageError.
    """
    with Given(out, name="path.csv") as given:
        pictures = {"left": given.picture("left", left), "right": given.picture("right", right)}
        job = given.job(PicksJob, {**locals(), **pictures}, side=view, out=given.out)
        done = path_from_picks(job, progress or Silent())
        return extended(done, PicksResult, taught=read_path(given.out))


def _check(path: object) -> None:
    require_kind("path", path, TaughtPath, cure="Give a TaughtPath: read_path(file), or teach(...).taught")
