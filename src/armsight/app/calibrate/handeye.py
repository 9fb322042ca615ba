"""Pose pairs, images or streams in, where the camera is on the arm out; poses of a pivoting tool in, its tip out."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight._files import real_path
from armsight.app.calibrate.board_images import Seen, count_again, in_parallel, require_counts, see_board
from armsight.app.calibrate.board_pictures import BoardPictures, hand_boards
from armsight.app.calibrate.cameras import report_path
from armsight.app.calibrate.euler_orders import ViewsOfHand, calibrated_pairs, solve_pose_pairs
from armsight.app.requests.calibrate_robot import HandEyeJob
from armsight.calibrate.handeye import (
    HandEye,
    RejectedPair,
    Setup,
    pairs_of_streams,
    propose,
)
from armsight.calibrate.handeye.board_turns import turned_views
from armsight.drivers import ImageReading, list_images, open_source
from armsight.errors import Cancelled, Inconsistent, NotEnoughData, UsageError
from armsight.optics import Camera
from armsight.records import BoardView, NotSeen, PoseStatus, Progress, Silent, Target
from armsight.records.measured import covariances_of
from armsight.report.handeye_report import handeye_report
from armsight.report.run import BoardViews
from armsight.store import parse_board, read_camera, read_poses, write_camera, write_text
from armsight.store.covariances import uncorrelated_note
from armsight.store.handeye_file import (
    read_robot_poses,
    write_handeye,
)
from armsight.store.interpret import TableFormat


@dataclass(frozen=True, slots=True, kw_only=True)
class Solved:
    """A hand-eye calibration and what stands beside it: the files read, the images seen, the camera that was freed."""

    result: HandEye
    inputs: Sequence[Path]
    boards: BoardViews | None = None
    freed: Camera | None = None


def calibrate_handeye(job: HandEyeJob, progress: Progress | None = None) -> HandEye:
    """Calibrate, write handeye.yaml and its report; return the figures as --json gives them.

    Raises UsageError for a call with none or several kinds of input, DataRefused for data that cannot carry the answer,
    Cancelled.
    """
    solved = solve_handeye(job, progress)
    proposed = propose(solved.result, job.propose) if job.propose else None
    camera_file = _write_camera(freed_camera_path(job.out), solved)
    write_handeye(job.out, solved.result, inputs=solved.inputs)
    files = [("file", item.name) for item in solved.inputs[:20]]
    write_text(report_path(job.out), handeye_report(solved.result, inputs=files, boards=solved.boards))
    return replace(solved.result, camera_file=camera_file, proposals=proposed)


def solve_handeye(job: HandEyeJob, progress: Progress | None = None) -> Solved:
    """Calibrate from what the job names, and write nothing. Raises as calibrate_handeye."""
    progress = progress or Silent()
    kinds = [job.pairs is not None, bool(job.images), job.robot_stream is not None]
    if sum(kinds) != 1:
        raise UsageError(
            "give --pairs, or --images (with --camera, --board and --robot), or --robot-stream with --camera-stream"
        )
    if job.pairs is not None:
        return Solved(result=calibrated_pairs(job.pairs, _of_setup(job), job.setup), inputs=[job.pairs])
    if job.images:
        _check_names(job)
        return _from_images(job, progress)
    return _from_streams(job)


def freed_camera_path(out: Path) -> Path:
    """Return where the freed camera goes beside a handeye.yaml."""
    return out.with_suffix(".camera.yaml")


def _write_camera(path: Path, solved: Solved) -> str | None:
    """Write the camera that was freed and kept, beside the result that belongs to it; return its path."""
    if solved.freed is None:
        return None
    write_camera(path, solved.freed, rms_px=solved.result.reprojection_rms_px, inputs=solved.inputs)
    return str(path)


def _of_setup(job: HandEyeJob) -> TableFormat:
    """Return what is said of tables, with where the camera is: some programs save other poses for each."""
    return replace(job.table, on_hand=job.setup is Setup.EYE_IN_HAND)


def _robot_poses(job: HandEyeJob) -> dict[str, RigidTransform]:
    """Return T_base_flange by the image's name."""
    if job.robot is None:
        raise UsageError("--images needs --robot robot_poses.csv")
    return read_robot_poses(job.robot, job.table, images=[path.name for path in list_images(job.images)])


def _require_named(images: set[str], robot: Mapping[str, RigidTransform], file: Path) -> None:
    """Raise Inconsistent where no image has a robot pose."""
    if not images & set(robot):
        raise Inconsistent(
            f"none of the images is named in {file}, which begins with {next(iter(robot), 'nothing')!r}",
            consequence="No image has a robot pose",
            cure="Write the images' file names into the column file",
        )


def _check_names(job: HandEyeJob) -> None:
    """Raise UsageError where the freed camera would be written over a file that is to be read."""
    freed = freed_camera_path(job.out)
    if job.free_camera and real_path(freed) in {
        real_path(path) for path in (job.camera, job.robot) if path is not None
    }:
        raise UsageError(
            f"{freed} is to be read, and the freed camera would be written over it",
            consequence="Nothing is written",
            cure="Give another name with -o",
        )


def _from_images(job: HandEyeJob, progress: Progress) -> Solved:
    if job.camera is None or job.robot is None or not job.board:
        raise UsageError("--images needs --camera camera.yaml, --board BOARD and --robot robot_poses.csv")
    board, camera, robot = parse_board(job.board), read_camera(job.camera), _robot_poses(job)
    views: list[BoardView] = []
    met = {path.name for path in list_images(job.images)}
    _require_named(met, robot, job.robot)
    unseen = [(name, f"no row of {job.robot.name} names this image") for name in sorted(met - set(robot))]
    reading = ImageReading(bits=job.bits, strict=job.strict, only=frozenset(robot))
    every: list[Seen] = []
    pictures = BoardPictures()
    with open_source(job.images, reading=reading) as source:
        for frame, seen in in_parallel(
            lambda frame: (frame, see_board(frame, board, pictures=pictures)), source, workers=job.workers
        ):
            name = Path(frame.source).name
            every.append(seen)
            if isinstance(seen, NotSeen):
                unseen.append((name, seen.why))
            else:
                views.append(seen)
            progress.update(len(every), source.total or 0, "finding the board")
            if progress.cancelled():
                raise Cancelled(f"stopped after {len(every)} images", consequence="Nothing was written")
    require_counts(every, board, job.board)
    unseen += [(name, "there is no such image") for name in robot if name not in met]
    if not views:
        raise NotEnoughData(
            f"the board {job.board} was found in none of the images; {unseen[0][0]}: {unseen[0][1]}",
            consequence="Nothing was calibrated",
            cure=count_again(board),
        )
    progress.update(0, 0, "solving")
    solved = _solved(job, views, camera, board, robot, pictures)
    missed = tuple(RejectedPair(row=None, name=name, why=why) for name, why in unseen)
    return replace(solved, result=replace(solved.result, unseen=missed))


def _solved(
    job: HandEyeJob,
    views: list[BoardView],
    camera: Camera,
    board: Target,
    robot: Mapping[str, RigidTransform],
    pictures: BoardPictures,
) -> Solved:
    """Return the calibration from the board's views."""
    views, n_turned = turned_views(views, [robot[Path(view.source).name] for view in views], camera, board, job.setup)
    hand = ViewsOfHand(views=views, camera=camera, board=board, setup=job.setup, free_camera=job.free_camera)
    done = hand.calibrated(robot, job.table, lambda other: _robot_poses(replace(job, table=other)))
    return Solved(
        result=replace(done.result, advice=(*_of_turned(n_turned, views, board), *done.result.advice)),
        inputs=[path for path in (job.camera, job.robot) if path is not None] + list(list_images(job.images)),
        boards=hand_boards(done.result, views, done.camera, board, pictures),
        freed=None if done.camera is camera else done.camera,
    )


def _of_turned(n_turned: int, views: Sequence[BoardView], board: Target) -> list[str]:
    """Return what to say of images in which a board that looks the same turned was the other way round."""
    if not n_turned:
        return []
    return [
        f"A board of {board.columns}x{board.rows} looks the same turned: {n_turned} of {len(views)} images are read "
        "the other way round, as the robot's poses say. A board with an odd and an even count (9x6) leaves no choice."
    ]


def _from_streams(job: HandEyeJob) -> Solved:
    if job.robot_stream is None or job.camera_stream is None:
        raise UsageError("--robot-stream needs --camera-stream, both as poses.csv")
    times, poses, covariances = [], [], []
    for path, format_ in ((job.robot_stream, job.table), (job.camera_stream, job.table.of_camera)):
        read = [p for p in read_poses(path, format_=format_, stream=True) if p.status is PoseStatus.OK]
        if len(read) < 2:
            raise NotEnoughData(f"{path}: fewer than two poses of status ok", cure="Record the streams again")
        times.append(np.array([p.t_s for p in read]))
        poses.append(RigidTransform.from_matrix(np.stack([p.pose.as_matrix() for p in read if p.pose is not None])))
        covariances.append(covariances_of(read))
    pairs, offset = pairs_of_streams(
        times[0], poses[0], times[1], poses[1], within_s=job.clocks_within_s, camera_covariance=covariances[1]
    )
    pairs = replace(pairs, unweighed=uncorrelated_note(job.camera_stream, covariances[1]))
    result = replace(solve_pose_pairs(pairs, job.setup), offset=offset)
    return Solved(result=result, inputs=[job.robot_stream, job.camera_stream])
