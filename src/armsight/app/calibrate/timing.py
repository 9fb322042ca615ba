"""A waved target of lights in, the timing of both cameras out: rig.yaml with `timing`."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from armsight.app.calibrate.spots_of_frames import SpotSearch, spots_of_frames
from armsight.app.requests.calibrate_cameras import TimingJob
from armsight.calibrate.timing import TimingCalibration, calibrate_timing
from armsight.clock import SystemClock
from armsight.drivers import is_live
from armsight.errors import UsageError
from armsight.measure.poses.pipeline import check_size
from armsight.optics import SIDES, Rig
from armsight.records import Progress, Silent, SpotTrack, Target
from armsight.store import read_rig, read_spot_track, read_target, write_rig

Array = NDArray[np.float64]


def calibrate_cameras_timing(job: TimingJob, progress: Progress | None = None) -> TimingCalibration:
    """Find the timing, write rig.yaml with it, and return the figures as --json gives them.

    Raises UsageError, DataRefused (as calibrate_timing, and frames of another size), DeviceFailed, Cancelled.
    """
    rig = read_rig(job.rig)
    target = None if job.target is None else read_target(job.target)
    left, right = _tracks(job, rig, progress or Silent())
    done = calibrate_timing(rig, left, right, _positions(target))
    timing = tuple(
        found if before is None else replace(found, exposure_s=before.exposure_s)
        for found, before in zip(done.cameras(), rig.timing, strict=True)
    )
    write_rig(job.out, replace(rig, timing=(timing[0], timing[1])), inputs=[job.rig])
    return done


def _positions(target: Target | None) -> dict[str, Array] | None:
    if target is None or not target.model_known:
        return None
    return dict(zip(target.names, target.xyz_m, strict=True))


def _tracks(job: TimingJob, rig: Rig, progress: Progress) -> tuple[SpotTrack, SpotTrack]:
    frames, tables = (job.left, job.right), (job.left_spots, job.right_spots)
    if all(frames) and not any(tables):
        live = [is_live(text or "") for text in frames]
        if any(live):
            _require_both(live)
            return _waved(job, rig, progress)
        sides = [_seen(job, rig, side, text or "", progress) for side, text in zip(SIDES, frames, strict=True)]
        return sides[0], sides[1]
    if all(tables) and not any(frames):
        read = [read_spot_track(path) for path in tables if path is not None]
        return read[0], read[1]
    raise UsageError(
        "which frames?", cure="Give --left and --right, or --left-spots and --right-spots, one of each camera"
    )


def _require_both(live: Sequence[bool]) -> None:
    if not all(live):
        raise UsageError(
            "one camera is live and the other one is not",
            consequence="Their stamps have no clock in common",
            cure="Give both live, or record both first: armsight record --left ... --right ... -o wave.mcap",
        )


class _Behind(Silent):
    """Shows nothing of a second job beside the first one, and stops with it."""

    def __init__(self, progress: Progress) -> None:
        self._progress = progress

    def cancelled(self) -> bool:
        """Tell whether the first job was to stop."""
        return self._progress.cancelled()


def _waved(job: TimingJob, rig: Rig, progress: Progress) -> tuple[SpotTrack, SpotTrack]:
    """Return the spots of both live cameras, read side by side; their stamps count from one moment."""
    origin_s = SystemClock().now_s()
    with ThreadPoolExecutor(len(SIDES)) as pool:
        sides = [
            pool.submit(
                _seen, job, rig, side, text or "", progress if side == SIDES[0] else _Behind(progress), origin_s
            )
            for side, text in zip(SIDES, (job.left, job.right), strict=True)
        ]
        left, right = (one.result() for one in sides)
    return left, right


def _seen(
    job: TimingJob, rig: Rig, side: str, text: str, progress: Progress, origin_s: float | None = None
) -> SpotTrack:
    search = SpotSearch(
        threshold=job.threshold,
        inverted=job.inverted,
        fps=job.fps,
        limit=job.limit,
        origin_of=job.left,
        origin_s=origin_s,
        settings=job.camera_settings,
    )
    return spots_of_frames(
        search, side, text, progress, lambda frame: check_size(rig, side, frame, "No timing is given")
    )
