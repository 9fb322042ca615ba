"""A path.csv checked for an arm before any motion."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import replace
from typing import Annotated

from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.control.guard import Limits
from armsight.control.paths import PathIssue, check_path
from armsight.control.paths.check import SLOWED
from armsight.control.play import PathPlan, PlaySettings, plan_path
from armsight.errors import ArmsightError
from armsight.fields import Doc
from armsight.kinematics import Arm
from armsight.records import TaughtPath
from armsight.records.output import output
from armsight.report.path_report import path_report
from armsight.shown import Shown
from armsight.store.atomic import TextOutput

SHOWN = 20
"""Issues that a terminal tells."""


def with_tip(arm: Arm, tip_m: Array) -> Arm:
    """Return the arm with its tool's frame moved to tip_m (3,), in flange axes."""
    return replace(arm, T_flange_tool=RigidTransform.from_components(tip_m, arm.T_flange_tool.rotation))


@output
class PathCheckOutput(TextOutput):
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

    @property
    def exit_code(self) -> int:
        """With which a command ends."""
        return 0 if self.ok else 3

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        for issue in self.issues[:SHOWN]:
            yield f"  {issue.text}"
        if len(self.issues) > SHOWN:
            yield f"  ... and {len(self.issues) - SHOWN} more"
        verdict = "can run the path" if self.ok else f"cannot run the path as it is ({self.refused})"
        if self.ok and self.issues:
            verdict += ", slower than asked where that is told"
        yield f"{self.arm} {verdict}: {self.n_reached} of {self.n} rows reached, {self.duration_s:.2f} s"


def checked(
    path: TaughtPath,
    arm: Arm,
    limits: Limits,
    *,
    speed_m_s: float | None = None,
    start: Array | None = None,
    keep_rotation: bool = False,
    page_of: str | None = None,
) -> PathCheckOutput:
    """Tell what is wrong with a path for an arm that stands at start (n,); page_of: its name, where a page shows it.

    speed_m_s: where the path leaves it open. Whether it can be run is what play's own plan says, from start, or from
    the path's first row where that is None. Raises UsageError, NotEnoughData.
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
    page = "" if page_of is None else path_report(path, arm, limits, found, name=page_of, refused=refused)
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
        content=page,
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
