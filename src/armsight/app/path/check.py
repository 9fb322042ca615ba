"""A path.csv checked for an arm before any motion."""

from __future__ import annotations

from collections import Counter
from dataclasses import replace
from pathlib import Path
from typing import Annotated

from armsight.app.arm_files import load_arm
from armsight.app.kinematics import reading_values
from armsight.app.play.play_job import tipped
from armsight.arrays import Array
from armsight.control.guard import Limits
from armsight.control.paths import PathIssue, check_path
from armsight.control.paths.check import SLOWED
from armsight.control.play import PathPlan, PlaySettings, plan_path
from armsight.errors import ArmsightError
from armsight.fields import Doc
from armsight.kinematics import Arm
from armsight.records import TaughtPath
from armsight.records.output import Output, output
from armsight.report.path_report import path_report
from armsight.store.atomic import write_text
from armsight.store.limits_file import read_limits
from armsight.store.path_file import read_path


@output
class PathCheckOutput(Output):
    """armsight path check."""

    arm: Annotated[str, Doc("The arm's name.")]
    ok: Annotated[bool, Doc("Whether play runs the whole path, slower where it must; the exit code is 3 where not.")]
    refused: Annotated[str, Doc("Why play does not run it; empty where it does.")]
    n: Annotated[int, Doc("Rows of the path.")]
    n_reached: Annotated[int, Doc("Rows from the start that are reached.")]
    length_m: Annotated[float, Doc("Length of the path, m.")]
    duration_s: Annotated[float, Doc("How long it takes at its speeds, s.")]
    play_s: Annotated[
        float | None, Doc("How long play takes from where the arm stands, s; null where it does not run.")
    ]
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
    keep_rotation: bool = False,
    out: Path | None = None,
    name: str,
) -> PathCheckOutput:
    """Tell what is wrong with a path of this name for an arm that stands at start (n,), as check does.

    Whether it can be run is what play's own plan says, from start, or from the path's first row where that is None.
    """
    if keep_rotation and start is not None:
        path = _turned_as(path, arm, start)
    found = check_path(path, arm, limits, speed_m_s=speed_m_s, start=start)
    stand = start if start is not None or not len(found.q) else found.q[0]
    settings = PlaySettings(speed_m_s=speed_m_s or limits.speed_m_s, keep_rotation=keep_rotation)
    if start is None:
        settings = replace(settings, retract_m=0.0)
    plan, refused = _planned(path, arm, limits, stand, settings)
    if plan is not None:
        found = replace(found, issues=tuple(issue for issue in found.issues if issue.trouble in SLOWED))
    if out is not None:
        write_text(out, path_report(path, arm, limits, found, name=name, refused=refused))
    return PathCheckOutput(
        arm=arm.name,
        ok=plan is not None,
        refused=refused,
        n=found.rows,
        n_reached=len(found.q),
        length_m=float(path.length_m[-1]),
        duration_s=float(found.t_s[-1]),
        play_s=None if plan is None else plan.time_s,
        troubles=dict(Counter(issue.trouble.value for issue in found.issues)),
        issues=found.issues,
        start_q=found.q[0].tolist() if len(found.q) else None,
    )


def _turned_as(path: TaughtPath, arm: Arm, q: Array) -> TaughtPath:
    """Return the path with the rotation in all its rows that the tool has at readings q (n,)."""
    T_world_tip = arm.fk(arm.values(q))
    here = T_world_tip if path.parent == "world" else arm.T_world_base.inv().as_matrix() @ T_world_tip
    T = path.T_world_tip.copy()
    T[:, :3, :3] = here[:3, :3]
    return replace(path, T_world_tip=T)


def _planned(
    path: TaughtPath, arm: Arm, limits: Limits, stand: Array | None, settings: PlaySettings
) -> tuple[PathPlan | None, str]:
    """Return play's plan from where the arm stands, or why there is none."""
    if stand is None:
        return None, "its first row is not reached"
    try:
        return plan_path(path, arm, limits, stand, settings), ""
    except ArmsightError as error:
        return None, error.cause
