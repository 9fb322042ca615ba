"""The spots in the frames of one camera that runs free, with its own stamps and without names."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field

import numpy as np

from armsight.app.sources.frames import camera_source
from armsight.arrays import Array
from armsight.drivers import AUTOMATIC, CameraSettings
from armsight.errors import Cancelled
from armsight.measure.poses.beacon import without_standing
from armsight.measure.settings import SpotSettings
from armsight.measure.spots import find_spots
from armsight.records import Frame, Progress, Spots, SpotTrack

LIVE_S = 20.0
"""For how long live cameras are watched where --frames says nothing."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SpotSearch:
    """How lights are looked for in frames, and in how many.

    origin_of: the left camera's text, whose bag's start is t_s = 0; origin_s: of live cameras, with settings.
    """

    threshold: float | None
    inverted: bool
    fps: float | None
    limit: int | None
    origin_of: str | None = None
    origin_s: float | None = None
    settings: CameraSettings = field(default=AUTOMATIC)


def spots_of_frames(
    search: SpotSearch, side: str, text: str, progress: Progress, check: Callable[[Frame], None]
) -> SpotTrack:
    """Return the spots of one camera's frames, those that stand still left out; of a live one those of LIVE_S.

    check: of each frame, may refuse it. Raises Cancelled.
    """
    settings = SpotSettings(threshold=search.threshold, inverted=search.inverted)
    stamps, found = [], []
    with camera_source(
        text, side, fps=search.fps, origin_of=search.origin_of, origin_s=search.origin_s, settings=search.settings
    ) as source:
        for frame in source:
            check(frame)
            stamps.append(frame.t_s)
            found.append(find_spots(frame.image, settings))
            progress.update(len(found), source.total or 0, f"looking for lights, {side}")
            if progress.cancelled():
                raise Cancelled(f"stopped after {len(found)} frames", consequence="Nothing was written")
            if len(found) >= search.limit if search.limit is not None else source.total is None and _over(stamps):
                break
    return spot_track(np.array(stamps), without_standing(found))


def _over(stamps_s: Sequence[float]) -> bool:
    return stamps_s[-1] - stamps_s[0] > LIVE_S


def spot_track(stamps_s: Array, found: list[Spots]) -> SpotTrack:
    """Return the spots of frames without names."""
    counts = [len(spots) for spots in found]
    return SpotTrack(
        t_s=stamps_s,
        frame=np.repeat(np.arange(len(found)), counts),
        names=("",) * sum(counts),
        uv_px=np.concatenate([spots.uv_px for spots in found]) if found else np.empty((0, 2)),
        covariance_px2=np.concatenate([spots.covariance_px2 for spots in found]) if found else np.empty((0, 2, 2)),
    )
