"""Images of a board in, cameras and rigs out."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import islice
from pathlib import Path

from armsight.app.calibrate.board_images import Seen, count_again, in_parallel, require_counts, see_board
from armsight.app.calibrate.board_pictures import BoardPictures, camera_boards, rig_boards
from armsight.app.calibrate.camera_noise import find_noise, input_files, require_size
from armsight.app.calibrate.reports import RigData, write_camera_report, write_stereo_report
from armsight.app.calibrate.results import CameraOutput, ZoomOutput
from armsight.app.calibrate.zoom import add_setting, zoom_file, zoom_output
from armsight.app.requests.calibrate_cameras import CameraJob, StereoJob
from armsight.app.sources.frames import open_pairs, open_source
from armsight.calibrate.camera_noise.photon_transfer import NoiseResult
from armsight.calibrate.cameras import CameraCalibration, StereoCalibration
from armsight.calibrate.cameras import calibrate_camera as solve_camera
from armsight.calibrate.cameras import calibrate_stereo as solve_stereo
from armsight.drivers import AUTOMATIC, is_live
from armsight.errors import Cancelled, NotEnoughData
from armsight.file_names import report_path as report_path
from armsight.records import BoardView, Frame, NotSeen, Progress, Silent
from armsight.records.output import extended
from armsight.records.result_parts import RejectedFile
from armsight.store import parse_board, write_camera, write_rig


def calibrate_camera(job: CameraJob, progress: Progress | None = None) -> CameraOutput:
    """Calibrate one camera and write its camera.yaml, or one setting of it; return the figures as --json gives them.

    Raises UsageError, DataRefused or DeviceFailed, Cancelled.
    """
    options, board = job.options, parse_board(job.board)
    progress = progress or Silent()
    views: list[BoardView] = []
    rejected: list[RejectedFile] = []
    every: list[Seen] = []
    pictures = BoardPictures()
    if job.zoom is not None:
        zoom_file(job.out)
    found = None if job.noise is None else _noise(job, job.noise, progress)
    with open_source(job.source, settings=job.asked, reading=job.reading) as source:
        frames = islice(source, 0, _stop(job), job.every)
        total = _total(source.total, job)
        for frame, seen in in_parallel(
            lambda frame: (frame, see_board(frame, board, job.detector, pictures)), frames, workers=job.workers
        ):
            every.append(seen)
            _sort(frame, seen, views, rejected)
            _show_progress(progress, len(views) + len(rejected), total)
    require_counts(every, board, job.board)
    _require(views, rejected, job.board)
    if found is not None:
        require_size(found, (views[0].width, views[0].height), job.source)
    progress.update(0, 0, "solving")
    done = solve_camera(views, board, options, progress)
    done = replace(done, rejected=(*rejected, *done.rejected))
    zoom = _write(job, done, found)
    boards = camera_boards(done, board, pictures)
    write_camera_report(_report_of(job), done, board=job.board, boards=boards)
    return extended(done, CameraOutput, noise=found.noise if found else None, zoom=zoom)


def _write(job: CameraJob, done: CameraCalibration, found: NoiseResult | None) -> ZoomOutput | None:
    """Write camera.yaml; of a zoom lens return all its settings."""
    noise = None if found is None else found.model
    inputs = [*input_files(job.source), *(found.inputs if found else ())]
    if job.zoom is None:
        write_camera(job.out, done.camera, covariance=done.covariance, rms_px=done.rms_px, noise=noise, inputs=inputs)
        return None
    lens = add_setting(job.out, job.zoom, done, noise=noise, inputs=inputs)
    return zoom_output(lens, job.zoom.zoom)


def _report_of(job: CameraJob) -> Path:
    """Return where the report goes: each setting of a zoom lens has one of its own."""
    if job.zoom is None:
        return report_path(job.out)
    return job.out.with_name(f"{job.out.stem}.zoom-{job.zoom.zoom:g}.report.html")


def _noise(job: CameraJob, frames: str, progress: Progress) -> NoiseResult:
    asked = job.asked if is_live(frames) else AUTOMATIC  # still frames may be files beside a live camera
    return find_noise(frames, settings=asked, progress=progress)


def calibrate_stereo(job: StereoJob, progress: Progress | None = None) -> StereoCalibration:
    """Calibrate a pair of cameras and write its rig.yaml; return the figures as --json gives them.

    Raises UsageError, DataRefused or DeviceFailed, Cancelled.
    """
    options, board = job.options, parse_board(job.board)
    progress = progress or Silent()
    views: tuple[list[BoardView], list[BoardView]] = ([], [])
    rejected: list[RejectedFile] = []
    every: list[Seen] = []
    done = 0
    pictures = BoardPictures()

    def see(pair: tuple[Frame, Frame]) -> tuple[tuple[Frame, Seen], ...]:
        return tuple((frame, see_board(frame, board, job.detector, pictures)) for frame in pair)

    with open_pairs(job.left, job.right, settings=job.camera_settings, reading=job.reading) as pairs:
        chosen = islice(pairs, 0, _stop(job), job.every)
        total = _total(pairs.total, job)
        for both in in_parallel(see, chosen, workers=job.workers):
            lost = [RejectedFile(frame.source, seen.why) for frame, seen in both if isinstance(seen, NotSeen)]
            rejected += lost
            every += [seen for _, seen in both]
            if not lost:
                for side, (_, seen) in zip(views, both, strict=True):
                    if isinstance(seen, BoardView):
                        side.append(seen)
            done += 1
            _show_progress(progress, done, total)
    require_counts(every, board, job.board)
    _require(views[0], rejected, job.board)
    progress.update(0, 0, "solving")
    result = solve_stereo(views[0], views[1], board, options, progress)
    result = replace(result, n_pairs=done, rejected=(*rejected, *result.rejected))
    write_rig(job.out, result.rig, inputs=[*input_files(job.left), *input_files(job.right)])
    boards = rig_boards(result, board, pictures)
    write_stereo_report(report_path(job.out), result, RigData(board=job.board, boards=boards))
    return result


def _sort(frame: Frame, seen: Seen, views: list[BoardView], rejected: list[RejectedFile]) -> None:
    if isinstance(seen, NotSeen):
        rejected.append(RejectedFile(frame.source, seen.why))
    else:
        views.append(seen)


def _show_progress(progress: Progress, done: int, total: int) -> None:
    progress.update(done, total, "finding the board")
    if progress.cancelled():
        raise Cancelled(f"stopped after {done} images", consequence="Nothing was written")


def _require(views: Sequence[BoardView], rejected: Sequence[RejectedFile], board: str) -> None:
    """Raise NotEnoughData where the board was seen nowhere."""
    if views or not rejected:
        return
    file, why = rejected[0]
    raise NotEnoughData(
        f"the board {board} was found in none of the images; in the first, {file}: {why}",
        consequence="Nothing was calibrated",
        cure=count_again(parse_board(board)),
    )


def _stop(job: CameraJob | StereoJob) -> int | None:
    return None if job.limit is None else job.limit * job.every


def _total(total: int | None, job: CameraJob | StereoJob) -> int:
    stop = _stop(job)
    if total is None:
        return job.limit or 0
    return -(-min(total, stop or total) // job.every)
