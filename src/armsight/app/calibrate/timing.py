"""What two free-running cameras saw of waved lights: live, from frames, or from tables."""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

from armsight.app.calibrate.spots_of_frames import SpotSearch, spots_of_frames
from armsight.clock import SystemClock
from armsight.drivers import is_live
from armsight.errors import UsageError
from armsight.measure.poses.pipeline import check_size
from armsight.optics import SIDES, Rig
from armsight.records import Progress, Silent, SpotTrack


def seen_tracks(
    frames: Sequence[str | None],
    tables: Sequence[SpotTrack | None],
    rig: Rig,
    search: SpotSearch,
    progress: Progress,
) -> tuple[SpotTrack, SpotTrack]:
    """Return the spots of the left and the right camera. frames, tables: of each; one of the two kinds.

    Raises UsageError, DataRefused (frames of another size), DeviceFailed, Cancelled.
    """
    if all(frames) and not any(table is not None for table in tables):
        texts = [text or "" for text in frames]
        live = [is_live(text) for text in texts]
        if any(live):
            _require_both(live)
            return _waved(texts, rig, search, progress)
        sides = [_seen(text, side, rig, search, progress) for side, text in zip(SIDES, texts, strict=True)]
        return sides[0], sides[1]
    left, right = tables
    if left is not None and right is not None and not any(frames):
        return left, right
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


def _waved(texts: Sequence[str], rig: Rig, search: SpotSearch, progress: Progress) -> tuple[SpotTrack, SpotTrack]:
    """Return the spots of both live cameras, read side by side; their stamps count from one moment."""
    search = replace(search, origin_s=SystemClock().now_s())
    shown = (progress, _Behind(progress))
    with ThreadPoolExecutor(len(SIDES)) as pool:
        sides = [
            pool.submit(_seen, text, side, rig, search, one)
            for side, text, one in zip(SIDES, texts, shown, strict=True)
        ]
        left, right = (one.result() for one in sides)
    return left, right


def _seen(text: str, side: str, rig: Rig, search: SpotSearch, progress: Progress) -> SpotTrack:
    return spots_of_frames(
        search, side, text, progress, lambda frame: check_size(rig, side, frame, "No timing is given")
    )
