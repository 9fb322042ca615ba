"""The history of cells, as `armsight history` has it: `armsight.history.add(result, "weld-3")`, `.trend("weld-3")`."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from armsight.errors import UsageError
from armsight.kinematics import Arm
from armsight.ops.arrays import as_path
from armsight.ops.checks import speaks_python
from armsight.ops.given import Given, PathText
from armsight.store.atomic import write_json
from armsight_lab.history.adding import AddedOutput
from armsight_lab.history.adding import add as run_add
from armsight_lab.history.looking import (
    HistoryCompareOutput,
    HistoryExportOutput,
    HistoryListOutput,
    HistoryShowOutput,
    compare_runs,
    export_runs,
    list_runs,
    show_run,
)
from armsight_lab.history.request import (
    AddJob,
    CompareRunsJob,
    ExportRunsJob,
    ListJob,
    ShowJob,
    TrendJob,
)
from armsight_lab.history.trend import TrendOutput
from armsight_lab.history.trend import trend as run_trend

__all__ = ["add", "compare", "export", "runs", "show", "trend"]


@speaks_python(AddJob)
def add(
    result: Any,
    cell: str,
    *,
    arm_file: PathText | None = None,
    created: str | None = None,
    history: str | None = None,
) -> AddedOutput:
    """File a result: what a calibration, identification or verification returned, or its file.

    arm_file: with the JSON file of `calibrate_arm`, the arm that it wrote. created: when it was made, ISO 8601; else as
    its file says, or now. history: a file or postgresql:// URL; else as the environment says. Raises UsageError,
    BadFile, DeviceFailed.

    Examples
    --------
    >>> turn = Rotation.from_rotvec(np.random.default_rng(1).normal(0.0, 0.4, (20, 3)))
    >>> found = armsight.calibrate_tool_tip(RigidTransform.from_components(-turn.apply([0.0, 0.0, 0.2]), turn))
    >>> armsight.history.add(found, "weld-3", history=str(folder / "history.sqlite")).command
    'calibrate tooltip'
    """
    with Given() as given:
        path, arm = result, arm_file
        if hasattr(result, "to_dict"):
            path = given.folder / "result.json"
            write_json(path, result.to_dict())
            created = created or datetime.now(UTC).isoformat()
            held = getattr(result, "arm", None)
            arm = given.file("arm", held) if isinstance(held, Arm) else arm
        file = None if arm is None else as_path(arm, "arm_file")
        job = AddJob(result=as_path(path, "result"), cell=cell, arm_file=file, created=created, history=history)
        return run_add(job)


@speaks_python(ListJob)
def runs(
    cell: str | None = None,
    *,
    command: str | None = None,
    since: str | None = None,
    until: str | None = None,
    most: int = ListJob.most,
    history: str | None = None,
) -> HistoryListOutput:
    """Return runs, the newest first: of a cell, a command ('calibrate' or 'calibrate arm'), a time (ISO 8601, UTC).

    Raises UsageError for a cell or command that is none, BadFile, DeviceFailed.
    """
    return list_runs(ListJob(cell=cell, command=command, since=since, until=until, most=most, history=history))


@speaks_python(ShowJob)
def show(run: int, *, history: str | None = None) -> HistoryShowOutput:
    """Return a run with its inputs and all its numbers. Raises UsageError, BadFile, DeviceFailed."""
    return show_run(ShowJob(run=run, history=history))


@speaks_python(CompareRunsJob)
def compare(a: int, b: int, *, history: str | None = None) -> HistoryCompareOutput:
    """Return two runs side by side. Raises UsageError, Inconsistent for two kinds, BadFile, DeviceFailed."""
    return compare_runs(CompareRunsJob(a=a, b=b, history=history))


@speaks_python(TrendJob)
def trend(
    cell: str,
    *,
    figure: Any = None,
    command: str | None = None,
    since: str | None = None,
    until: str | None = None,
    false_alarms: float = TrendJob.false_alarms,
    out: PathText | None = None,
    history: str | None = None,
) -> TrendOutput:
    """Return whether figures of a cell have drifted: what, since when, by how much.

    figure: names or groups of figures; else joint zeros, hand-eye, rig, tool tip and world. false_alarms: one in so
    many cell-years. out: a folder for the report. Raises UsageError, NotEnoughData, Inconsistent for two arms, BadFile,
    DeviceFailed.
    """
    named = [figure] if isinstance(figure, str) else figure
    if named is not None and not (isinstance(named, list | tuple) and all(isinstance(one, str) for one in named)):
        raise UsageError(f"figure is {figure!r}", cure="Give a name or a list of names, such as 'joint-zeros'")
    with Given(out) as given:
        job = TrendJob(
            cell=cell,
            out=given.out,
            figure=None if named is None else list(named),
            command=command,
            since=since,
            until=until,
            false_alarms=false_alarms,
            history=history,
        )
        return run_trend(job)


@speaks_python(ExportRunsJob)
def export(
    out: PathText,
    *,
    cell: str | None = None,
    command: str | None = None,
    since: str | None = None,
    until: str | None = None,
    history: str | None = None,
) -> HistoryExportOutput:
    """Write every number of every run as a table: .csv, .parquet or .jsonl. Raises UsageError, NotEnoughData, BadFile,
    DeviceFailed.
    """
    path = as_path(out, "out")
    return export_runs(ExportRunsJob(out=path, cell=cell, command=command, since=since, until=until, history=history))
