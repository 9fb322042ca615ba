"""Where a camera is on the arm, or beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal, TypeAlias

from armsight.defaults import HEIGHT_STD_M
from armsight.errors import UsageError
from armsight.fields import Bounds, Doc, Flag
from armsight.ops.action import Input, action
from armsight.ops.flags import BOARD, SRC, Bits, Strict, TwoTables, Workers, setup_called
from armsight.ops.kinds import READERS

if TYPE_CHECKING:
    from numpy.typing import ArrayLike

    from armsight.calibrate.handeye import HandEyeResult, Setup
    from armsight.ops.arrays import Poses
    from armsight.records import Progress

__all__ = ["calibrate_hand_eye"]

HERE = "armsight.ops.calibration.handeye"
TableFile: TypeAlias = Annotated[Any, Input(f"{READERS}:table", hashed=True)]
"""Columns by name, (t_s, T), poses (n, 4, 4), a PoseTrack, or the path of a table."""
PairsFile: TypeAlias = Annotated[Any, Input(f"{HERE}:given_pairs", hashed=True)]
CameraLike: TypeAlias = Annotated[Any, Input(f"{HERE}:given_camera", hashed=True)]
BoardLike: TypeAlias = Annotated[Any, Input(f"{HERE}:given_board", kind=str)]
Images: TypeAlias = Annotated[
    Any, Input(f"{READERS}:frames", kind=str, hashed=True, files="armsight.drivers:list_images")
]
AtSetup: TypeAlias = Annotated[
    "Literal['eye-in-hand', 'eye-to-hand'] | Setup",
    Doc("eye-in-hand or eye-to-hand."),
    Flag(read=setup_called),
]


@action(
    "calibrate handeye",
    working="calibrating",
    examples=(
        "--pairs pairs.csv -o handeye.yaml",
        "--images images/ --camera camera.yaml --board checkerboard:9x6:0.025 --robot robot_poses.csv -o handeye.yaml",
    ),
    filed=True,
    judged=True,
    writes="armsight.store.handeye_file:write_handeye",
    page="handeye_report:handeye_report",
)
def calibrate_hand_eye(
    T_base_flange: Poses | None = None,
    T_camera_target: Poses | None = None,
    *,
    names: Sequence[str] | None = None,
    camera_covariance: ArrayLike | None = None,
    pairs: Annotated[PairsFile, Doc("pairs.csv: robot pose and camera pose in every row.")] = None,
    camera: Annotated[CameraLike, Doc("camera.yaml of the camera that took the images.")] = None,
    robot: Annotated[TableFile, Doc("robot_poses.csv: file,x_m,..,qw, T_base_flange per image.")] = None,
    images: Annotated[Images, Doc(f"Images of the board: {SRC}."), Flag(metavar="SRC")] = None,
    board: Annotated[BoardLike, Doc(BOARD), Flag(metavar="BOARD")] = None,
    robot_stream: Annotated[TableFile, Doc("poses.csv of the flange, time-stamped.")] = None,
    camera_stream: Annotated[TableFile, Doc("poses.csv of the target in the camera.")] = None,
    clocks_within_s: Annotated[
        float | None,
        Doc("With streams: their clocks differ by this at most; else by any."),
        Bounds(least=0.0),
        Flag(metavar="SECONDS"),
    ] = None,
    setup: AtSetup = "eye-in-hand",
    target_height_m: Annotated[
        float | None,
        Doc("Of a SCARA, palletiser or the like: the target's measured z in the base (eye-to-hand: in the flange)."),
        Flag("--target-height", quantity="m"),
    ] = None,
    target_height_std_m: Annotated[
        float,
        Doc("Standard deviation of that height."),
        Bounds(least=1e-7),
        Flag("--target-height-sigma", quantity="m"),
    ] = HEIGHT_STD_M,
    free_camera: Annotated[bool, Doc("With images: refine the camera, if left-out images get better.")] = False,
    propose: Annotated[int, Doc("Propose so many further poses."), Bounds(least=0)] = 0,
    workers: Workers = None,
    bits: Bits = None,
    strict: Strict = False,
    table: TwoTables | None = None,
    out: Annotated[Path | None, Doc("handeye.yaml to write."), Flag("-o --out", needed=True)] = None,
    progress: Progress | None = None,
) -> HandEyeResult:
    """Find where the camera is on the hand (or beside the robot), and say whether the answer is right.

    Parameters
    ----------
    T_base_flange
        N poses (n, 4, 4) in m, or RigidTransform: the flange in the robot's base, as its controller says. Or give
        pairs; or images with camera, board and robot; or robot_stream with camera_stream.
    T_camera_target
        N poses alike, at the same moments: the target in the camera's frame.
    names
        Of the rows, for messages.
    camera_covariance
        Of T_camera_target (n, 6, 6), translation (m) then rotation vector (rad) in the camera's axes: pairs are weighed
        by it, as far as their residuals bear it out.
    pairs
        The same as one table.
    camera, board, images
        The camera, the board as calibrate_camera takes it, and the camera's images of it.
    robot
        T_base_flange in the order of the images, or robot_poses.csv.
    robot_stream, camera_stream
        T_base_flange and T_camera_target over time, each (t_s, T), a PoseTrack or a file, on clocks of their own.
    clocks_within_s
        By how much the clocks differ at most; else any offset is looked for.
    setup
        The camera is on the arm ('eye-in-hand') or beside it ('eye-to-hand').
    target_height_m, target_height_std_m
        z of the target in the base (eye-in-hand) or flange (eye-to-hand), m, as measured, and how well: with pairs of a
        hand that turned about one axis, which cannot tell it.
    free_camera
        Refine the camera too, where images left out get better by it: `camera` of the result.
    propose
        Further poses to propose.
    out
        handeye.yaml to write; its report and the freed camera go beside it.

    Raises
    ------
    NotEnoughData
        Fewer rows than the answer has directions; too few images with the board.
    Degenerate
        Too little turning, or about one axis only.
    Inconsistent
        Wrong units, inverted poses, rows that do not belong together, or streams that do not show one motion.
    NotConverged
        The fit found no answer.

    Examples
    --------
    >>> turn = Rotation.from_rotvec(np.random.default_rng(1).normal(0.0, 0.5, (12, 3)))
    >>> T_base_flange = RigidTransform.from_components(np.random.default_rng(2).normal(0.0, 0.2, (12, 3)), turn)
    >>> T_flange_camera = RigidTransform.from_translation([0.0, 0.05, 0.1])
    >>> T_camera_target = (T_base_flange * T_flange_camera).inv() * RigidTransform.from_translation([0.5, 0.0, 0.0])
    >>> armsight.calibrate_hand_eye(T_base_flange, T_camera_target).T_flange_camera[1:3, 3].round(6).tolist()
    [0.05, 0.1]
    """
    from armsight.calibrate.handeye import Setup, TargetHeight
    from armsight.drivers import ImageReading
    from armsight.ops.calibration.handeye import from_boards, from_pairs, from_streams, pairs_of, see_boards
    from armsight.records import Silent, one_of
    from armsight.store.handeye_file import freed_camera_path
    from armsight.store.interpret import OURS

    at, format_ = one_of(Setup, "setup", setup), table or OURS
    if sum(one is not None for one in (T_base_flange, pairs, images, robot_stream)) != 1:
        raise UsageError(
            "give --pairs, or --images (with --camera, --board and --robot), or --robot-stream with --camera-stream"
        )
    height = None
    if target_height_m is not None:
        if (pairs is None and T_base_flange is None) or propose:
            raise UsageError(
                "--target-height goes with --pairs alone, without --propose",
                cure="Give the poses as --pairs, or no height",
            )
        height = TargetHeight(z_m=target_height_m, sigma_m=target_height_std_m)
    if images is not None:
        if camera is None or robot is None or board is None:
            raise UsageError("--images needs --camera camera.yaml, --board BOARD and --robot robot_poses.csv")
        reading = ImageReading(bits=bits, strict=strict)
        seen = see_boards(images, board, robot, format_, reading, progress or Silent(), workers)
        found = from_boards(seen, camera, board, at, format_, free_camera=free_camera)
    elif robot_stream is not None:
        if camera_stream is None:
            raise UsageError("--robot-stream needs --camera-stream, both as poses.csv")
        found = from_streams(robot_stream, camera_stream, at, format_, clocks_within_s)
    else:
        given = pairs or pairs_of(T_base_flange, T_camera_target, names, camera_covariance)
        found = from_pairs(given, at, format_, height)
    camera_file = None if out is None or found.camera is None else str(freed_camera_path(Path(out)))
    return replace(
        found,
        camera_file=camera_file,
        proposals=found.propose(propose) if propose else None,
    )
