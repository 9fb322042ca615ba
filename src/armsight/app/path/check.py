"""A path.csv checked for an arm before any motion."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np

from armsight.app.kinematics import load_arm, reading_values
from armsight.app.play.play_job import tipped
from armsight.app.schemas.paths import PathCheckOutput, PathIssueOutput
from armsight.control.guard import Limits
from armsight.control.paths import PathCheck, PathIssue, check_path
from armsight.kinematics import Arm
from armsight.records import TaughtPath
from armsight.report.path_report import path_report
from armsight.store.atomic import write_text
from armsight.store.limits_file import read_limits
from armsight.store.path_file import read_path


def check(
    source: Path,
    arm: str,
    *,
    tip: Path | None = None,
    limits: Path | None = None,
    parent: str = "world",
    speed_m_s: float | None = None,
    start: str | None = None,
    out: Path | None = None,
) -> PathCheckOutput:
    """Tell what is wrong with a path for an arm; out: a page with the picture of it.

    tip: tip.yaml, in flange axes; None: the arm's tool. parent: the frame of the path, world or base. speed_m_s: where
    the path leaves it open. start: readings where the arm stands, as 0,-1.2,0.4 or a joints.csv. Raises BadFile,
    UsageError, NotEnoughData.
    """
    path = read_path(source, parent=parent)
    model = tipped(load_arm(arm), tip)
    kept = Limits() if limits is None else read_limits(limits)
    first = None if start is None else reading_values(model, start)
    found = check_path(path, model, kept, speed_m_s=speed_m_s, start=first)
    if out is not None:
        write_text(out, path_report(path, model, kept, found, name=source.name))
    return _output(path, model, found)


def _output(path: TaughtPath, arm: Arm, found: PathCheck) -> PathCheckOutput:
    return PathCheckOutput(
        arm=arm.name,
        ok=found.ok,
        n=found.rows,
        n_reached=len(found.q),
        length_m=float(path.length_m[-1]),
        duration_s=float(found.t_s[-1]),
        troubles=dict(Counter(issue.trouble.value for issue in found.issues)),
        issues=[_issue(issue) for issue in found.issues],
        start_q=found.q[0].tolist() if len(found.q) else None,
    )


def _issue(issue: PathIssue) -> PathIssueOutput:
    value, limit = (x if np.isfinite(x) else None for x in (issue.value, issue.limit))
    return PathIssueOutput(row=issue.row, trouble=issue.trouble.value, value=value, limit=limit, text=issue.text)
