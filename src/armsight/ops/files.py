"""What is made of results: two of them compared, measurements joined with what the robot did."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.file_names import COMPARED
from armsight.ops.action import Input, action
from armsight.ops.flags import KNOWN_ARM, TwoTables, setup_called
from armsight.ops.kinds import ArmLike, AsFile

if TYPE_CHECKING:
    from armsight.calibrate.handeye import Setup
    from armsight.ops.compare.run import CompareOutput
    from armsight.ops.join import JoinResult

__all__ = ["compare", "join"]

A: TypeAlias = Annotated[Any, Input("armsight.ops.compare.run:given_result"), Flag(positional=True, metavar="A")]
B: TypeAlias = Annotated[Any, Input("armsight.ops.compare.run:given_result"), Flag(positional=True, metavar="B")]


@action(
    "compare",
    keeps=COMPARED,
    examples=("measured-monday measured-friday -o compared", "rig-before.yaml rig-after.yaml --distance 1.2"),
    judged=True,
)
def compare(
    a: Annotated[A, Doc("A result: a folder of measure or verify, or a calibration.")],
    b: Annotated[B, Doc("Another of the same kind.")],
    *,
    out: Annotated[
        Path | None, Doc("Write compare.json and report.html here."), Flag("-o --out", metavar="FOLDER")
    ] = None,
    distance_m: Annotated[
        float | None,
        Doc("Distance at which rigs are compared. [default: 8 baselines]"),
        Bounds(least=0.01),
        Flag(quantity="m"),
    ] = None,
) -> CompareOutput:
    """Tell whether two results of one kind agree within their uncertainty, and what the difference comes to.

    Parameters
    ----------
    a, b
        Rigs, cameras, hand-eye calibrations or arms; or their files, or the folders of two runs of measure or verify.

    Raises
    ------
    Inconsistent
        Two kinds.

    Examples
    --------
    >>> rig = armsight.simulate("hand-cell", frames=1).rig
    >>> armsight.compare(rig, rig).verdict
    'Neither result tells how sure it is: whether they agree cannot be told...'
    """
    from armsight.ops.compare.run import compared

    return compared(a, b, distance_m, None if out is None else Path(out))


@action(
    "join",
    examples=("--measured poses.csv --joints joints.csv --arm arm.yaml --as points -o points.csv",),
    streamed=True,
)
def join(
    measured: Annotated[AsFile, Doc("Measured poses or points, with t_s."), Flag(metavar="FILE")],
    *,
    out: Annotated[Path | None, Doc("The table to write."), Flag("-o --out", needed=True)] = None,
    kind: Annotated[
        Literal["points", "observed", "pairs", "visits"],
        Doc("points (for calibrate arm), observed (robot-world), pairs (hand-eye) or visits (verify: ISO 9283)."),
        Flag("--as", read=str),
    ] = "points",
    joints: Annotated[AsFile, Doc("The controller's joint log, with t_s on its own clock.")] = None,
    arm: Annotated[ArmLike, Doc(f"With --joints: {KNOWN_ARM}; nominal is enough.")] = None,
    robot_stream: Annotated[AsFile, Doc("Instead of joints: poses of the flange, with t_s.")] = None,
    setup: Annotated[
        Literal["eye-in-hand", "eye-to-hand"] | Setup,
        Doc("Of pairs: eye-in-hand or eye-to-hand."),
        Flag(read=setup_called),
    ] = "eye-in-hand",
    offset_s: Annotated[
        float | None, Doc("Add this to measured times. [default: it is found]"), Flag(metavar="S")
    ] = None,
    still: Annotated[bool, Doc("One row for each rest of the arm: the mean of it.")] = False,
    table: TwoTables | None = None,
) -> JoinResult:
    """Join a joint log and measurements on different clocks into points.csv, observed.csv or pairs.csv.

    Parameters
    ----------
    measured
        Poses or points with times: a PoseTrack, (t_s, T), columns, or a file.
    kind
        Which table: points (for calibrate_arm), observed (calibrate_robot_world), pairs (calibrate_hand_eye) or visits
        (verify): a row for each rest with pose and visit, rests with the same joints being of one pose.
    joints, arm
        The controller's readings (t_s, q) on its own clock, and the arm; nominal is enough.

    Returns
    -------
    JoinResult
        `table`: its columns by name; offset_s and what was left out.

    Examples
    --------
    >>> arm, t_s = armsight.presets.ur10(), np.linspace(0.0, 4.0, 400)
    >>> q = np.outer(np.sin(1.3 * t_s), np.linspace(0.2, 0.5, 6)) + [0.0, -1.0, 1.0, 1.0, 2.0, 0.0]
    >>> round(armsight.join((t_s + 0.3, arm.fk(q)), joints=(t_s, q), arm=arm).offset_s, 4)
    -0.3
    """
    from armsight.calibrate.handeye import Setup
    from armsight.ops.join import Join, flange_poses, joint_log, require_sources
    from armsight.records import one_of
    from armsight.store.interpret import OURS
    from armsight.store.verify_files import read_measured

    tables = table or OURS
    require_sources(kind, joints, arm, robot_stream)
    in_hand = one_of(Setup, "setup", setup) is Setup.EYE_IN_HAND
    file = read_measured(measured, tables.of_camera)
    if kind == "pairs" and file.measured.rotation is None:
        raise UsageError(f"{measured} has no rotations, and pairs need them", cure="Give poses, not points")
    told = flange_poses(robot_stream, tables) if joints is None else joint_log(joints, arm, tables)
    inside = kind == "pairs" and in_hand
    resting = still or kind == "visits"
    work = Join(kind=kind, file=file, reported=told, arm=arm, inside=inside, offset_s=offset_s, still=resting)
    return work.result(None if out is None else Path(out))
