"""Hand-eye calibrations from files: tables of pairs, images of a board, streams of poses on clocks of their own."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace
from functools import partial
from itertools import permutations
from os import PathLike, fspath
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight._files import real_path
from armsight.calibrate.handeye import (
    HandEyeResult,
    PosePairs,
    RejectedPair,
    Setup,
    TargetHeight,
    calibrate_eye_in_hand,
    calibrate_eye_to_hand,
    calibrate_from_views,
    pairs_of_streams,
)
from armsight.calibrate.handeye.consensus import RIGHT, consensus
from armsight.calibrate.handeye.image_model import poses_of_views
from armsight.calibrate.handeye.images import turned_views
from armsight.drivers import ImageReading, list_images, open_source
from armsight.errors import ArmsightError, Cancelled, Inconsistent, NotEnoughData, UsageError
from armsight.ops.action import Given
from armsight.ops.arrays import as_poses
from armsight.ops.calibration.board_images import Seen, count_again, in_parallel, require_counts, see_board
from armsight.ops.calibration.board_pictures import BoardPictures, hand_boards
from armsight.ops.inputs import table
from armsight.optics import Camera
from armsight.records import BoardView, NotSeen, PoseStatus, Progress, Target, real_array, require_kind, require_texts
from armsight.records.measured import covariances_of
from armsight.store import parse_board, read_camera, read_poses
from armsight.store.covariances import uncorrelated_note
from armsight.store.handeye_file import freed_camera_path, read_pairs, read_robot_poses
from armsight.store.interpret import TableFormat
from armsight.store.targets import board_text

SAME = 1e-9
"""Rotation matrices that differ by less are of one reading."""


def given_camera(name: str, value: Any, given: Given, undo: ExitStack) -> Camera:
    """Return a camera, or that of a camera.yaml, over which the freed one must not be written.

    Raises BadFile, UsageError.
    """
    out, read = given.get("out"), [given.get("camera"), given.get("robot")]
    files = {real_path(Path(fspath(one))) for one in read if isinstance(one, str | PathLike)}
    if given.get("free_camera") and out is not None and real_path(freed_camera_path(Path(out))) in files:
        raise UsageError(
            f"{freed_camera_path(Path(out))} is to be read, and the freed camera would be written over it",
            consequence="Nothing is written",
            cure="Give another name with -o",
        )
    if isinstance(value, str | PathLike):
        return read_camera(Path(fspath(value)))
    require_kind(name, value, Camera, cure="Give a record or a file")
    return value  # type: ignore[no-any-return]  # a Camera


def given_board(name: str, value: Any, given: Given, undo: ExitStack) -> Target:
    """Return a board, or that of a text or file. Raises UsageError, BadFile."""
    require_kind(name, value, Target, str, PathLike)
    return value if isinstance(value, Target) else parse_board(fspath(value))


def given_pairs(name: str, value: Any, given: Given, undo: ExitStack) -> PosePairs | Path:
    """Return pairs, or the file of a table of them; of columns by name one that goes again. Raises UsageError."""
    return value if isinstance(value, PosePairs) else table(name, value, given, undo)


def pairs_of(
    T_base_flange: Any, T_camera_target: Any, names: Sequence[str] | None, camera_covariance: Any
) -> PosePairs:
    """Return the pairs of poses (n, 4, 4). Raises Inconsistent, UsageError."""
    robot, camera = as_poses(T_base_flange, "T_base_flange"), as_poses(T_camera_target, "T_camera_target")
    rows = require_texts("names", names) if names is not None else tuple(f"row {i}" for i in range(len(robot)))
    covariance = None if camera_covariance is None else real_array("camera_covariance", camera_covariance)
    return PosePairs(T_base_flange=robot, T_camera_target=camera, names=rows, camera_covariance=covariance)


def from_pairs(
    pairs: PosePairs | Path, setup: Setup, format_: TableFormat, height: TargetHeight | None = None
) -> HandEyeResult:
    """Return the calibration from pairs, or a pairs.csv; height: of the target, for a hand that cannot tilt.

    Raises as calibrate_eye_in_hand; Inconsistent with the order of Euler angles that fits where one does.
    """
    calibrate = calibrate_eye_in_hand if setup is Setup.EYE_IN_HAND else calibrate_eye_to_hand
    if isinstance(pairs, PosePairs):
        return calibrate(pairs, target_height=height)
    format_ = replace(format_, on_hand=setup is Setup.EYE_IN_HAND)  # some programs save other poses for each
    try:
        return calibrate(read_pairs(pairs, format_), target_height=height)
    except Inconsistent as error:
        raise _with_order(error, lambda other: read_pairs(pairs, other), setup, format_) from error


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardsAtPoses:
    """Views of a board, each at a pose of the robot by its image's name; again: reads these in another format.

    unseen: (name, why) of images and poses that make no pair. pictures: of the images, for the report.
    """

    views: Sequence[BoardView]
    T_base_flange: Mapping[str, RigidTransform]
    again: Callable[[TableFormat], Mapping[str, RigidTransform]]
    unseen: Sequence[tuple[str, str]]
    pictures: BoardPictures


def see_boards(
    images: str,
    board: Target,
    robot: Path,
    format_: TableFormat,
    reading: ImageReading,
    progress: Progress,
    workers: int | None = None,
) -> BoardsAtPoses:
    """Return the board in the images that a robot_poses.csv names. Raises Inconsistent, NotEnoughData, Cancelled."""
    met = [path.name for path in list_images(images)]
    poses = read_robot_poses(robot, format_, images=met)
    _require_named(met, poses, robot)
    pictures, text = BoardPictures(), board_text(board)
    reading, every = replace(reading, only=frozenset(poses)), list[tuple[str, Seen]]()
    with open_source(images, reading=reading) as source:
        for name, seen in in_parallel(
            lambda frame: (Path(frame.source).name, see_board(frame, board, pictures=pictures)), source, workers=workers
        ):
            every.append((name, seen))
            progress.update(len(every), source.total or 0, "finding the board")
            if progress.cancelled():
                raise Cancelled(f"stopped after {len(every)} images", consequence="Nothing was written")
    require_counts([seen for _, seen in every], board, text)
    unseen = [(name, f"no row of {robot.name} names this image") for name in sorted(set(met) - set(poses))]
    unseen += [(name, seen.why) for name, seen in every if isinstance(seen, NotSeen)]
    unseen += [(name, "there is no such image") for name in poses if name not in met]
    views = [seen for _, seen in every if isinstance(seen, BoardView)]
    if not views:
        raise NotEnoughData(
            f"the board {text} was found in none of the images; {unseen[0][0]}: {unseen[0][1]}",
            consequence="Nothing was calibrated",
            cure=count_again(board),
        )
    progress.update(0, 0, "solving")
    again = partial(read_robot_poses, robot, images=met)
    return BoardsAtPoses(views=views, T_base_flange=poses, again=again, unseen=unseen, pictures=pictures)


def _require_named(images: Sequence[str], robot: Mapping[str, RigidTransform], file: Path) -> None:
    if not set(images) & set(robot):
        raise Inconsistent(
            f"none of the images is named in {file}, which begins with {next(iter(robot), 'nothing')!r}",
            consequence="No image has a robot pose",
            cure="Write the images' file names into the column file",
        )


def from_boards(
    seen: BoardsAtPoses, camera: Camera, board: Target, setup: Setup, format_: TableFormat, *, free_camera: bool = False
) -> HandEyeResult:
    """Return the calibration from images of a board. Raises as calibrate_from_views, and as from_pairs."""
    names = [Path(view.source).name for view in seen.views]
    poses = [seen.T_base_flange[name] for name in names]
    views, n_turned = turned_views(seen.views, poses, camera, board, setup)
    try:
        done = calibrate_from_views(views, poses, camera, board, setup, free_camera=free_camera)
    except Inconsistent as error:
        at = poses_of_views(views, camera, board).T_camera_target
        targets = [at[i] for i in range(len(names))]

        def read(other: TableFormat) -> PosePairs:
            found = seen.again(other)
            return PosePairs.of([found[name] for name in names], targets)

        raise _with_order(error, read, setup, format_) from error
    return replace(
        done.result,
        advice=(*_of_turned(n_turned, views, board), *done.result.advice),
        unseen=tuple(RejectedPair(row=None, name=name, why=why) for name, why in seen.unseen),
        camera=None if done.camera is camera else done.camera,
        boards=hand_boards(done.result, views, done.camera, board, seen.pictures),
    )


def _of_turned(n_turned: int, views: Sequence[BoardView], board: Target) -> list[str]:
    """Return what to say of images in which a board that looks the same turned was the other way round."""
    if not n_turned:
        return []
    return [
        f"A board of {board.columns}x{board.rows} looks the same turned: {n_turned} of {len(views)} images are read "
        "the other way round, as the robot's poses say. A board with an odd and an even count (9x6) leaves no choice."
    ]


def from_streams(
    robot: Path, camera: Path, setup: Setup, format_: TableFormat, clocks_within_s: float | None = None
) -> HandEyeResult:
    """Return the calibration from poses.csv of flange and target on clocks of their own. Raises as from_pairs."""
    times, poses, covariances = [], [], []
    for path, its in ((robot, format_), (camera, format_.of_camera)):
        read = [p for p in read_poses(path, format_=its, stream=True) if p.status is PoseStatus.OK]
        if len(read) < 2:
            raise NotEnoughData(f"{path}: fewer than two poses of status ok", cure="Record the streams again")
        times.append(np.array([p.t_s for p in read]))
        poses.append(RigidTransform.from_matrix(np.stack([p.pose.as_matrix() for p in read if p.pose is not None])))
        covariances.append(covariances_of(read))
    pairs, offset = pairs_of_streams(
        times[0], poses[0], times[1], poses[1], within_s=clocks_within_s, camera_covariance=covariances[1]
    )
    pairs = replace(pairs, unweighed=uncorrelated_note(camera, covariances[1]))
    return replace(from_pairs(pairs, setup, format_), offset=offset)


def _with_order(
    error: Inconsistent, read: Callable[[TableFormat], PosePairs], setup: Setup, format_: TableFormat
) -> Inconsistent:
    """Return the refusal of poses, with the order of Euler angles that makes them agree where one does.

    read: gives the pairs of the same file in another format. Tables without Euler angles are the same in every order.
    """
    tried: list[np.ndarray] = []
    fits = []
    given = read(replace(format_, notify=lambda text: None)).T_base_flange.rotation.as_matrix()
    for order in orders():
        try:
            pairs = read(replace(format_, euler=order, notify=lambda text: None))
        except ArmsightError:  # out of the range of this order, or columns that it does not have
            continue
        R = pairs.T_base_flange.rotation.as_matrix()
        if any(np.abs(R - other).max() < SAME for other in tried):
            continue
        tried.append(R)
        found = consensus(pairs.arrays(setup))
        if found.share < RIGHT:
            fits.append((found.score, order, bool(np.abs(R - given).max() < SAME)))
    if len(tried) < 2 or not fits:
        return error
    _, order, as_given = min(fits)
    if as_given:  # what is wrong is not the order
        return error
    stated = f" read as {format_.order}" if format_.order else ""
    return Inconsistent(
        f"the robot's Euler angles{stated} contradict the camera's poses; read as {order} they agree",
        consequence="Read as they are, they are other rotations; no calibration is given",
        cure=f"Give --euler {order}",
    )


def orders() -> Iterator[str]:
    """Yield the twelve orders of Euler angles, each about axes that stand and about axes carried along."""
    for kind in ("", "-fixed"):
        for axes in permutations("xyz"):
            yield "".join(axes) + kind
        for first, second in permutations("xyz", 2):
            yield first + second + first + kind
