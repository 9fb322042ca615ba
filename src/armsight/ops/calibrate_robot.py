"""Where the end of a tool is: from poses, or live while it rests on a point."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, TypeAlias

from armsight.app.requests.shared import Cameras, Table, point_of
from armsight.defaults import TIP_GOAL_M, TIP_POINT_STD_M
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.action import action
from armsight.ops.kinds import Left, PosesLike, Right, RigLike, TargetLike

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from armsight.calibrate.tooltip import MeasuredPoint
    from armsight.calibrate.tooltip_result import PivotCalibration, ToolTipResult
    from armsight.records import Progress

Point: TypeAlias = Annotated[
    "ArrayLike | None",
    Doc("The point, m or with units (200mm), if it was measured."),
    Flag("--point", metavar="X,Y,Z", read=point_of),
]
PointStd: TypeAlias = Annotated[
    float,
    Doc("Standard deviation of one coordinate of the measured point."),
    Bounds(least=1e-9),
    Flag("--point-sigma", quantity="m"),
]
TipOut: TypeAlias = Annotated[Path | None, Doc("tip.yaml to write."), Flag("-o --out", needed=True)]


@action("calibrate tooltip")
def calibrate_tool_tip(
    T_world_target: Annotated[
        PosesLike, Doc("poses.csv of the target (or flange) while the tool pivots on a point."), Flag("--poses")
    ],
    covariances: ArrayLike | None = None,
    *,
    point_m: Point = None,
    point_std_m: PointStd = TIP_POINT_STD_M,
    t_s: ArrayLike | None = None,
    table: Table | None = None,
    out: TipOut = None,
) -> ToolTipResult:
    """Find where the end of a tool is, from poses recorded while it was turned about its end.

    Parameters
    ----------
    T_world_target
        N poses (n, 4, 4) in m, RigidTransform, or a table's path, which brings covariances and times.
    covariances
        (n, 6, 6) in m and rad, where known.
    point_m, point_std_m
        (3,) in m, where the tip rests in the world, if that was measured, and how well.
    t_s
        (n,) in s, where the poses are of one recording: how long their errors are alike is estimated, and they are
        weighed and believed by it.
    out
        tip.yaml to write.

    Raises
    ------
    NotEnoughData
        Too few poses.
    Degenerate
        Too little turning.
    Inconsistent
        The poses have no common point.

    Examples
    --------
    >>> turn = Rotation.from_rotvec(np.random.default_rng(1).normal(0.0, 0.4, (20, 3)))
    >>> poses = RigidTransform.from_components(-turn.apply([0.0, 0.0, 0.2]), turn)
    >>> armsight.calibrate_tool_tip(poses).tip_m.round(6) + 0.0
    array([0. , 0. , 0.2])
    """
    from armsight.calibrate.tooltip import calibrate_tooltip
    from armsight.records import checked_array

    poses = T_world_target
    n = len(poses.T)
    known = poses.covariances if covariances is None else checked_array("covariances", covariances, (n, 6, 6))
    times = poses.t_s if t_s is None else checked_array("t_s", t_s, (n,))
    found = calibrate_tooltip(poses.T, known, _measured(point_m, point_std_m), times)
    return replace(found, remarks=(poses.remark,)) if poses.remark else found


@action("calibrate pivot", working="pivoting")
def calibrate_pivot(
    rig: Annotated[RigLike, Doc("rig.yaml of the two cameras.")],
    target: Annotated[TargetLike, Doc("target.yaml of the target on the tool.")],
    left: Left,
    right: Right = None,
    *,
    goal_m: Annotated[
        float,
        Doc("Stop where the tip is known so well (one standard deviation)."),
        Bounds(least=1e-6),
        Flag(quantity="m"),
    ] = TIP_GOAL_M,
    point_m: Point = None,
    point_std_m: PointStd = TIP_POINT_STD_M,
    camera_settings: Cameras | None = None,
    out: TipOut = None,
    progress: Progress | None = None,
) -> PivotCalibration:
    """Find a tool's tip while you pivot it before the cameras; ends when it is known well enough.

    Parameters
    ----------
    rig, target
        Records or files; the target is on the tool.
    left, right
        Frames, as `measure` takes them.
    goal_m
        Standard deviation of the tip's position at which to stop.
    point_m, point_std_m
        Where it rests in rig axes, if measured, and how well.
    out
        tip.yaml to write; the poses taken go beside it.

    Raises
    ------
    NotEnoughData
        The poses do not tell the tip.
    """
    from armsight.app.calibrate.pivot import pivot
    from armsight.app.live.pace import pace_of
    from armsight.app.sources.frames import open_pairs
    from armsight.calibrate.tooltip import TipRecording
    from armsight.drivers import AUTOMATIC
    from armsight.measure.poses.pipeline import Setup
    from armsight.measure.settings import SpotSettings
    from armsight.records import Silent

    settings = SpotSettings(colour=target.colour)
    setup = Setup(rig=rig, target=target, settings=settings, pace=pace_of(left, right))
    pairs = open_pairs(left, right, colour=target.colour is not None, settings=camera_settings or AUTOMATIC)
    recording = TipRecording(point=_measured(point_m, point_std_m), good_m=goal_m)
    return pivot(setup, pairs, recording, progress or Silent())


def _measured(point_m: ArrayLike | None, std_m: float) -> MeasuredPoint | None:
    """Return where the tip rests, if that was measured."""
    from armsight.calibrate.tooltip import MeasuredPoint
    from armsight.records import checked_array

    return None if point_m is None else MeasuredPoint(xyz_m=checked_array("point_m", point_m, (3,)), sigma_m=std_m)
