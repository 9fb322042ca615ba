"""One recording of a moving arm in; its cell out: rig.yaml with timing, world.yaml, target.yaml, arm.yaml, a report."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np

from armsight._files import real_path
from armsight.app.arm_files import arm_file, load_arm
from armsight.app.calibrate.cell_priors import read_priors
from armsight.app.calibrate.spots_of_frames import SpotSearch, spots_of_frames
from armsight.app.requests.calibrate_cell import CellJob
from armsight.app.requests.shared import point_of
from armsight.app.sources.frames import is_recording, recording_path
from armsight.arrays import Array
from armsight.calibrate.cell import ArmTolerance, CellCalibration, CellOptions, calibrate_cell
from armsight.drivers import is_live
from armsight.errors import Inconsistent, UsageError
from armsight.file_names import ARM, CELL, CELL_CALIBRATED, REPORT, RIG, TARGET, WORLD
from armsight.kinematics import Arm
from armsight.optics import SIDES
from armsight.records import Frame, Motion, Progress, Silent, SpotTrack
from armsight.report.cell_report import cell_report
from armsight.store import World, read_spot_track, read_target, write_json, write_rig, write_target, write_text
from armsight.store.arm_file import write_arm
from armsight.store.handeye_file import read_tip
from armsight.store.recording import Recording
from armsight.store.tracks import read_joints
from armsight.store.worlds import write_world

Size = tuple[int, int]

OFF_CENTRE = 0.1
"""Of the image's size: webcams' lenses are within 0.05 of its middle; 1280x720 taken for 1920x1080 is 0.16 off."""


def run_calibrate_cell(job: CellJob, progress: Progress | None = None) -> CellCalibration:
    """Calibrate a cell, write its files into the folder out, and return the figures as --json gives them.

    Nothing is written before all is known. Raises UsageError, BadFile, DataRefused with what speaks against the
    recording, Cancelled.
    """
    _check(job)
    arm = load_arm(job.model)
    target = read_target(job.target)
    tip = _tip_m(job.tool)
    joints = _joints(job, arm)
    tracks, sizes = _tracks(job, progress or Silent())
    _require_two(tracks)
    options = CellOptions(
        tip_m=tip,
        tolerance=ArmTolerance(length_m=job.tolerance_m, zero_rad=job.tolerance_rad, angle_rad=job.tolerance_rad),
        compliance=job.compliance,
        priors=read_priors(job.prior or (), sizes),
    )
    done = calibrate_cell(arm, joints, tracks, target, sizes=sizes, options=options, progress=progress)
    if job.size is not None:
        _require_centred(done)
    _write(job, done)
    return done


def _require_centred(done: CellCalibration) -> None:
    """Raise Inconsistent where a lens's middle is far from that of the images whose size was typed."""
    for side in SIDES:
        camera = done.rig.camera(side)
        size = np.array([camera.width, camera.height])
        off = camera.intrinsics[2:4] - (size - 1.0) / 2.0
        if (np.abs(off) > OFF_CENTRE * size).any():
            raise Inconsistent(
                f"the {side} lens's middle is ({off[0]:.0f}, {off[1]:.0f}) px from that of images of "
                f"{size[0]}x{size[1]} px",
                consequence="The size is hardly that of the images, and no cell is calibrated",
                cure="Give the size of the images in which the spots were found: --size, or --right-size of the right "
                "one; give frames where images are cut out of larger ones",
            )


def _write(job: CellJob, done: CellCalibration) -> None:
    parts, out = done.parts, job.out
    given = (job.robot_log, job.target, job.left_spots, job.right_spots, *(job.prior or ()))
    inputs = [path for path in given if path is not None]
    files = [("arm", job.model), ("target", str(job.target)), ("robot's log", str(job.robot_log))]
    files += [
        (f"{side} camera", str(given))
        for side, given in zip(SIDES, (job.left or job.left_spots, job.right or job.right_spots), strict=True)
    ]
    page = cell_report(done, load_arm(job.model), inputs=files)
    write_rig(out / RIG, parts.rig, inputs=inputs)
    world = World(
        parent="base",
        T_parent_rig=parts.T_base_rig,
        covariance=parts.base_covariance,
    )
    write_world(out / WORLD, world, inputs=inputs)
    write_target(out / TARGET, parts.target, inputs=inputs)
    write_arm(out / ARM, parts.arm, inputs=inputs)
    write_text(out / REPORT, page)
    write_json(out / CELL, done.to_dict())


def _check(job: CellJob) -> None:
    """Raise UsageError for frames that are none, live ones, and files that would be written over."""
    frames, tables = (job.left, job.right), (job.left_spots, job.right_spots)
    if not (all(frames) and not any(tables)) and not (all(tables) and not any(frames)):
        raise UsageError(
            "which frames?", cure="Give --left and --right, or --left-spots and --right-spots, one of each camera"
        )
    if any(is_live(text or "") for text in frames):
        raise UsageError(
            "a cell is not calibrated from live cameras: they and the robot's log are of one motion",
            consequence="Nothing is calibrated",
            cure="Record first, while the robot moves and logs its joints: armsight record --left ... --right ... "
            "-o cell.mcap; then give --left cell.mcap --right cell.mcap",
        )
    if all(tables) and job.size is None:
        raise UsageError(
            "tables of spots do not tell how large the images are",
            consequence="Nothing is calibrated",
            cure="Add --size 1280x720, and --right-size where the right camera's is another",
        )
    tip = Path(job.tool) if _is_file(job.tool) else None
    given = (arm_file(job.model), job.target, job.robot_log, *tables, *(job.prior or ()), tip)
    read = {real_path(path) for path in given if path is not None}
    for name in CELL_CALIBRATED:
        if real_path(job.out / name) in read:
            raise UsageError(
                f"{job.out / name} is to be read, and would be written over",
                consequence="Nothing is written",
                cure="Give another folder with -o",
            )


def _is_file(text: str) -> bool:
    return text.lower().endswith((".yaml", ".yml"))


def _tip_m(text: str) -> Array | None:
    """Return the tip (3,) in target axes of 'X,Y,Z' or a tip.yaml, None where none is named."""
    if not text:
        return None
    return read_tip(Path(text)).tip_m if _is_file(text) else np.array(point_of(text))


def _joints(job: CellJob, arm: Arm) -> Motion:
    """Return the log; of a recording the readings of its robot."""
    if not is_recording(str(job.robot_log)):
        return read_joints(job.robot_log, job.table.of_arm(arm), measured=True)
    with Recording(recording_path(str(job.robot_log))) as recording:
        readings = list(recording.joints())
    return Motion(t_s=np.array([one.t_s for one in readings]), q=np.array([one.q for one in readings]))


def _tracks(job: CellJob, progress: Progress) -> tuple[tuple[SpotTrack, SpotTrack], tuple[Size, Size]]:
    """Return the spots of both cameras, and the sizes of their images."""
    if job.left_spots is not None and job.right_spots is not None and job.size is not None:
        sizes = (job.size, job.right_size or job.size)
        left, right = read_spot_track(job.left_spots), read_spot_track(job.right_spots)
        for track, path, size in ((left, job.left_spots, sizes[0]), (right, job.right_spots, sizes[1])):
            _require_inside(track, path, size)
        return (left, right), sizes
    search = SpotSearch(
        threshold=job.threshold, inverted=job.inverted, fps=job.fps, limit=job.limit, origin_of=job.left
    )
    tracks, found = [], []
    for side, text in zip(SIDES, (job.left, job.right), strict=True):
        seen: list[Size] = []
        tracks.append(spots_of_frames(search, side, text or "", progress, _one_size(seen)))
        if not seen:
            raise UsageError(f"{text} holds no frames", cure="Give the frames of the recording")
        found.append(seen[0])
    return (tracks[0], tracks[1]), (found[0], found[1])


def _one_size(seen: list[Size]) -> Callable[[Frame], None]:
    """Return what keeps the size of the first frame, and refuses one of another."""

    def check(frame: Frame) -> None:
        size = (frame.width, frame.height)
        if not seen:
            seen.append(size)
        if size != seen[0]:
            raise Inconsistent(
                f"{frame.source} is {size[0]}x{size[1]} px, the frames before are {seen[0][0]}x{seen[0][1]} px",
                consequence="No cell is calibrated",
                cure="Record at one resolution",
            )

    return check


def _require_two(tracks: tuple[SpotTrack, SpotTrack]) -> None:
    """Raise Inconsistent where both cameras are one."""
    left, right = tracks
    if left.uv_px.shape == right.uv_px.shape and len(left.uv_px) and (left.uv_px == right.uv_px).all():
        raise Inconsistent(
            "left and right hold the same spots: they are one camera",
            consequence="Nothing is known of a second one, and no cell is calibrated",
            cure="Give each side the frames or spots of its own camera",
        )


def _require_inside(track: SpotTrack, path: Path, size: Size) -> None:
    """Raise Inconsistent where spots are outside of images of a size."""
    most = track.uv_px.max(axis=0)
    if (most > np.array(size) - 0.5).any() or track.uv_px.min() < -0.5:
        raise Inconsistent(
            f"{path} has spots up to ({most[0]:.0f}, {most[1]:.0f}) px, outside of images of {size[0]}x{size[1]} px",
            consequence="No cell is calibrated",
            cure="Give the size of the images in which the spots were found: --size, or --right-size of the right one",
        )
