"""What belongs to an arm: its geometry, where a rig stands to it, and where the end of its tool is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from armsight.defaults import ANGLE_RAD, LENGTH_M, TIP_GOAL_M, TIP_POINT_STD_M
from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.action import Input, action
from armsight.ops.flags import AN_ARM, KNOWN_ARM, Base, Cameras, Table, Tip, lengths_of, point_of
from armsight.ops.kinds import (
    CHAIN,
    READERS,
    AnyRigLike,
    CamerasLike,
    HeldPointsLike,
    Left,
    PointsLike,
    PosesLike,
    Right,
    TargetLike,
    TouchesLike,
    WorldLike,
)
from armsight.units import DEG, MM

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from armsight.calibrate.arm import ArmResult, RobotWorldResult
    from armsight.calibrate.tooltip import MeasuredPoint
    from armsight.calibrate.tooltip_result import PivotCalibration, ToolTipResult
    from armsight.records import Progress

__all__ = ["calibrate_arm", "calibrate_pivot", "calibrate_robot_world", "calibrate_tool_tip"]

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
Lengths: TypeAlias = Annotated[
    Sequence[Any],
    Doc("With --touch: a known distance of two features, or a ball's radius; repeated."),
    Flag("--length", metavar="A,B,LENGTH", read=lengths_of, repeated=True),
]
TipOut: TypeAlias = Annotated[Path | None, Doc("tip.yaml to write."), Flag("-o --out", needed=True)]


@action(
    "calibrate tooltip",
    examples=("--poses poses.csv -o tip.yaml",),
    filed=True,
    judged=True,
    writes="armsight.store.handeye_file:write_tip",
)
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


@action(
    "calibrate pivot",
    working="pivoting",
    beside=(".poses.csv",),
    examples=("--left camera:0 --right camera:1 --rig rig.yaml --target target.yaml -o tip.yaml",),
    filed=True,
    judged=True,
    writes="write_pivot",
)
def calibrate_pivot(
    rig: Annotated[AnyRigLike, Doc("rig.yaml of the cameras.")],
    target: Annotated[TargetLike, Doc("target.yaml of the target on the tool.")],
    left: Left = None,
    right: Right = None,
    *,
    cameras: CamerasLike = None,
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
    left, right, cameras
        Frames, as `measure` takes them.
    goal_m
        Standard deviation of the tip's position at which to stop.
    point_m, point_std_m
        Where it rests in rig axes, if measured, and how well.
    out
        tip.yaml to write; the poses taken go beside it.

    Raises
    ------
    NotEnoughData, Inconsistent
        The poses do not tell the tip, or a camera is not where the rig's file says.
    """
    from armsight.calibrate.tooltip import TipRecording
    from armsight.drivers import AUTOMATIC
    from armsight.measure.poses.pipeline import Setup
    from armsight.measure.settings import SpotSettings
    from armsight.ops.calibration.pivot import pivot
    from armsight.ops.sources.cameras import named_cameras, open_rig, told_apart
    from armsight.ops.sources.pace import pace_of
    from armsight.records import Silent

    named = named_cameras(cameras or {}, left, right)
    settings = SpotSettings(colour=target.colour)
    setup = Setup(rig=rig, target=target, settings=settings, pace=pace_of(*named.values()))
    asked, colour = camera_settings or AUTOMATIC, target.colour is not None
    moments = told_apart(open_rig(rig.names, cameras=named, colour=colour, settings=asked), rig)
    recording = TipRecording(point=_measured(point_m, point_std_m), good_m=goal_m)
    return pivot(setup, moments, recording, progress or Silent())


def _measured(point_m: ArrayLike | None, std_m: float) -> MeasuredPoint | None:
    from armsight.calibrate.tooltip import MeasuredPoint
    from armsight.records import checked_array

    return None if point_m is None else MeasuredPoint(xyz_m=checked_array("point_m", point_m, (3,)), sigma_m=std_m)


@action(
    "calibrate arm",
    beside=(".corrections.csv", ".urdf", ".proposed.csv", ".report.html"),
    examples=(
        "--model ur10e --points points.csv -o calibrated.yaml",
        "--propose 20 --model arm.yaml --points points.csv -o calibrated.yaml",
        "--model two_arms.urdf --tip left_tool0 --points points.csv -o left.yaml",
    ),
    filed=True,
    judged=True,
    writes="write_calibrated_arm",
    page="arm_report:arm_report",
)
def calibrate_arm(
    nominal: Annotated[Any, Doc(f"The nominal arm: {KNOWN_ARM}."), CHAIN, Flag("--model", metavar="ARM")],
    q: Annotated[
        PointsLike, Doc("points.csv: q1..qn,x_m,y_m,z_m[,qx,qy,qz,qw][,point][,t_s]."), Flag("--points")
    ] = None,
    xyz_m: ArrayLike | None = None,
    *,
    rotation: ArrayLike | None = None,
    point: Sequence[str] = (),
    length: Lengths = (),
    touch: Annotated[
        TouchesLike, Doc("In place of points touch.csv: q1..qn,feature[,kind][,tip][,reading_m][,sigma_m].")
    ] = None,
    holdout: Annotated[HeldPointsLike, Doc("Further points, only for judging.")] = None,
    scale: Annotated[bool, Doc("Try joint scales too."), Flag("--scale/--no-scale")] = True,
    tolerance_m: Annotated[
        float, Doc("Standard deviation of nominal lengths."), Bounds(least=1e-6 * MM), Flag(unit=MM)
    ] = LENGTH_M,
    tolerance_rad: Annotated[
        float, Doc("Standard deviation of nominal angles."), Bounds(least=1e-6 * DEG), Flag(unit=DEG)
    ] = ANGLE_RAD,
    propose: Annotated[int, Doc("Propose so many further joint positions."), Bounds(least=0)] = 0,
    rig: Annotated[
        Any, Doc("rig.yaml, for proposals two cameras see; with --world."), Input(f"{READERS}:any_rig")
    ] = None,
    world: Annotated[WorldLike, Doc("world.yaml: where that rig stands.")] = None,
    tip: Tip = None,
    base: Base = None,
    table: Table | None = None,
    out: Annotated[Path | None, Doc("arm.yaml to write."), Flag("-o --out", needed=True)] = None,
) -> ArmResult:
    """Correct a known arm's geometry from measured positions or touched points, where a gain can be proved.

    Parameters
    ----------
    nominal
        The arm as its data sheet says: an Arm, its file, or a known arm's name.
    q
        (m, n) joint readings in rad and m; or a table's path, which brings positions, rotations and points.
    xyz_m
        (m, 3) where the tool's point was, in m, in any fixed frame.
    rotation
        (m, 3, 3) of the tool in that frame, where measured.
    point
        (m,) names which of the tool's points a row is of.
    length
        (a, b, m[, standard deviation]) of touched points or balls that far apart; of a ball's radius b is ''.
    touch
        In place of q: (q, feature[, kind[, tip]]) while the tip, or the one of several that is named, rested on spikes
        ('point'), flats ('plane') or balls ('sphere'); or a table's path, which may have dial gauges ('gauge') too.
    holdout
        (q, xyz_m) of further rows, or their table, only for judging.
    scale
        Whether joint scales are tried too.
    tolerance_m, tolerance_rad
        Standard deviation of nominal lengths and angles.
    propose
        So many further joint readings go into `proposals`; `propose` of the result gives them too.
    rig, world
        Only proposals that two cameras of a rig that stands there see, or its only one.
    tip, base
        Of a URDF: the last link of the arm and its base link.
    out
        arm.yaml to write; a URDF, the corrections, the proposals and a report go beside it.

    Raises
    ------
    NotEnoughData
        Too few measurements for anything to be freed.
    Inconsistent
        The measurements are not of this arm.

    Examples
    --------
    >>> arm = armsight.presets.ur10()
    >>> q = np.random.default_rng(2).uniform(-1.5, 1.5, (30, 6))
    >>> noise = np.random.default_rng(3).normal(0.0, 1e-4, (30, 3))
    >>> armsight.calibrate_arm(arm, q, arm.fk(q)[:, :3, 3] + noise).gain
    False
    """
    from armsight.calibrate.arm import Tolerance, calibrate_arm
    from armsight.calibrate.arm import propose as propose_positions
    from armsight.calibrate.arm.propose import in_view

    if (rig is None) != (world is None):
        raise UsageError("for proposals in view give both --rig and --world: where the rig stands to the measurements")
    tolerance = Tolerance(length_m=tolerance_m, angle_rad=tolerance_rad)
    if (q is None) == (touch is None):
        raise UsageError(
            "measured positions (--points) and what was touched (--touch) are both given, or neither",
            cure="Give one of them",
        )
    if touch is not None:
        from armsight.calibrate.arm.touch import calibrate_touched

        if holdout is not None or propose:
            raise UsageError("--holdout and --propose go with --points", cure="Leave them away with --touch")
        found = calibrate_touched(nominal, touch, tolerance=tolerance, scale=scale)
        return found if out is None else _with_urdf(found, Path(out).with_suffix(".urdf"))
    if length:
        raise UsageError("--length goes with --touch", cure="Leave it away, or give what was touched")
    found = calibrate_arm(nominal, q, holdout=holdout, tolerance=tolerance, scale=scale)
    if propose:
        seen = None if rig is None else in_view(rig, world.T_parent_rig)
        more = propose_positions(found.model, found.fitted, q, propose, tolerance=tolerance, visible=seen)
        found = replace(found, proposals=nominal.readings(more.q).tolist(), expected_std=more.expected_std)
    return found if out is None else _with_urdf(found, Path(out).with_suffix(".urdf"))


def _with_urdf(found: ArmResult, path: Path) -> ArmResult:
    """Return a result with the URDF that is written for it, and what that has no place for."""
    from armsight.store.saving import as_urdf

    text, lost = as_urdf(found.arm)
    notes = (*found.notes, f"{path.name}: {lost}") if lost else found.notes
    return replace(found, urdf=str(path) if text else None, notes=notes)


@action(
    "calibrate robot-world",
    examples=("--arm arm.yaml --points observed.csv -o world.yaml",),
    filed=True,
    judged=True,
    writes="write_placed_rig",
)
def calibrate_robot_world(
    arm: Annotated[Any, Doc(f"{KNOWN_ARM}, its tool the beacon."), CHAIN, AN_ARM],
    q: Annotated[PointsLike, Doc("observed.csv: q1..qn,x_m,y_m,z_m in rig axes."), Flag("--points")],
    xyz_m: ArrayLike | None = None,
    *,
    point: Sequence[str] = (),
    tip: Tip = None,
    base: Base = None,
    table: Table | None = None,
    out: Annotated[Path | None, Doc("world.yaml to write."), Flag("-o --out", needed=True)] = None,
) -> RobotWorldResult:
    """Find where the rig stands to the arm's base, from observed points at joint readings.

    Parameters
    ----------
    arm
        As calibrate_arm takes it; its tool is the beacon.
    q
        (m, n) joint readings in rad and m; or a table's path, which brings positions and points.
    xyz_m
        (m, 3) where the beacon was in rig axes, in m.
    point
        (m,) names which of the arm's tool points a row is of.
    tip, base
        As calibrate_arm takes them.
    out
        world.yaml to write.

    Raises
    ------
    NotEnoughData, Inconsistent, Ambiguous, Degenerate
        The points do not tell the place.

    Examples
    --------
    >>> arm = armsight.presets.ur10()
    >>> q = np.random.default_rng(2).uniform(-1.5, 1.5, (20, 6))
    >>> seen = arm.fk(q)[:, :3, 3] - [0.0, 0.0, 1.0]
    >>> armsight.calibrate_robot_world("ur10", q, seen).T_base_rig[:3, 3].round(6).tolist()
    [0.0, 0.0, 1.0]
    """
    from armsight.calibrate.arm import calibrate_world

    return calibrate_world(arm, q)
