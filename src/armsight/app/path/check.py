"""A path.csv checked for an arm before any motion."""

from __future__ import annotations

from collections import Counter
from pathlib import Path
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from armsight.app.arm_files import load_arm
from armsight.app.kinematics import reading_values
from armsight.app.play.play_job import tipped
from armsight.control.guard import Limits
from armsight.control.paths import PathIssue, check_path
from armsight.fields import Doc
from armsight.kinematics import Arm
from armsight.records import TaughtPath
from armsight.records.output import Output, output
from armsight.report.path_report import path_report
from armsight.store.atomic import write_text
from armsight.store.limits_file import read_limits
from armsight.store.path_file import read_path

Array = NDArray[np.float64]


@output
class PathCheckOutput(Output):
    """armsight path check."""

    arm: Annotated[str, Doc("The arm's name.")]
    ok: Annotated[bool, Doc("Whether the arm can run the whole path; the exit code is 3 where it cannot.")]
    n: Annotated[int, Doc("Rows of the path.")]
    n_reached: Annotated[int, Doc("Rows from the start that are reached.")]
    length_m: Annotated[float, Doc("Length of the path, m.")]
    duration_s: Annotated[float, Doc("How long it takes at its speeds, s.")]
    troubles: Annotated[dict[str, int], Doc("How many issues there are of each kind.")]
    issues: Annotated[tuple[PathIssue, ...], Doc("All trouble, row by row.")]
    start_q: Annotated[list[float] | None, Doc("Readings at the first row, rad or m; null where not reached.")]


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
    return checked(path, model, kept, speed_m_s=speed_m_s, start=first, out=out, name=source.name)


def checked(
    path: TaughtPath,
    arm: Arm,
    limits: Limits,
    *,
    speed_m_s: float | None = None,
    start: Array | None = None,
    out: Path | None = None,
    name: str,
) -> PathCheckOutput:
    """Tell what is wrong with a path of this name for an arm that stands at start (n,), as check does."""
    found = check_path(path, arm, limits, speed_m_s=speed_m_s, start=start)
    if out is not None:
        write_text(out, path_report(path, arm, limits, found, name=name))
    return PathCheckOutput(
        arm=arm.name,
        ok=found.ok,
        n=found.rows,
        n_reached=len(found.q),
        length_m=float(path.length_m[-1]),
        duration_s=float(found.t_s[-1]),
        troubles=dict(Counter(issue.trouble.value for issue in found.issues)),
        issues=found.issues,
        start_q=found.q[0].tolist() if len(found.q) else None,
    )
