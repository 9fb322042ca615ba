"""The lights that calibrations see: of free-running cameras with their own stamps, and of a target in pairs."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Mapping, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from threading import Event
from typing import TypeVar

import numpy as np

from armsight.arrays import Array, Index
from armsight.calibrate.light_target import (
    LitFrame,
    LitMoment,
    NamedSights,
    TargetResult,
    calibrate_lights,
    calibrate_target,
)
from armsight.clock import SystemClock
from armsight.drivers import AUTOMATIC, CameraSettings, MomentSource, is_live, moments_of, pairs_of
from armsight.errors import Cancelled, DataRefused, NotEnoughData, UsageError
from armsight.measure.poses.beacon import without_standing
from armsight.measure.poses.board_pose import swapped
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.pairs import pair_spots
from armsight.measure.poses.pipeline import check_size, check_sizes
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.views import measure_views
from armsight.measure.settings import SpotSettings
from armsight.measure.spots import find_spots
from armsight.ops.sources.cameras import cameras_of
from armsight.ops.sources.frames import camera_source
from armsight.optics import PackedRig, Rig
from armsight.records import Frame, NotSeen, PoseStatus, Progress, Silent, Spots, SpotTrack, Target

Moment = TypeVar("Moment")
OTHER_FRAMES = "The calibration says nothing about such frames; no target is given"
LIVE_S = 20.0
"""For how long live cameras are watched where --frames says nothing."""
LOOSE = 2.0
"""Residuals, in the spots' own standard deviations, from which left and right may be exchanged, and by how many times
exchanged ones must fit better: as many as 3.5 where they are, in a cell of two webcams."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SpotSearch:
    """How lights are looked for in frames, and in how many.

    origin_of: the first camera's text, whose bag's start is t_s = 0; origin_s: of live cameras, with settings.
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


# What free-running cameras saw of waved lights: live, from frames, or from tables.


def seen_tracks(
    rig: Rig,
    frames: Mapping[str, str],
    tables: Mapping[str, SpotTrack],
    search: SpotSearch,
    progress: Progress,
) -> dict[str, SpotTrack]:
    """Return the spots of each of a rig's cameras. frames, tables: by camera; one of the two kinds.

    Raises UsageError, DataRefused (frames of another size), DeviceFailed, Cancelled.
    """
    given = frames or tables
    if (frames and tables) or set(given) != set(rig.names):
        if not rig.is_pair and not tables and frames:
            cameras_of(rig.names, frames)
        if not rig.is_pair:
            raise UsageError("which frames?", cure=f"Give {' '.join(f'--camera {name}=SRC' for name in rig.names)}")
        raise UsageError(
            "which frames?", cure="Give --left and --right, or --left-spots and --right-spots, one of each camera"
        )
    if tables:
        return {name: tables[name] for name in rig.names}
    texts = {name: frames[name] for name in rig.names}
    live = [is_live(text) for text in texts.values()]
    if any(live):
        _require_all(live)
        return _of_rig(texts, rig, replace(search, origin_s=SystemClock().now_s()), progress)
    search = replace(search, origin_of=texts[rig.names[0]])
    return _of_rig(texts, rig, search, progress)


def _require_all(live: Sequence[bool]) -> None:
    if not all(live):
        pair = len(live) == 2
        raise UsageError(
            "one camera is live and the other one is not" if pair else "some cameras are live, and others are not",
            consequence="Their stamps have no clock in common",
            cure="Give both live, or record both first: armsight record --left ... --right ... -o wave.mcap"
            if pair
            else "Give all live, or none",
        )


class _OneOfMany(Silent):
    """What one of several jobs side by side is asked: all stop together, and the first shows how far they are."""

    def __init__(self, progress: Progress, ended: Event, *, shown: bool) -> None:
        self._progress, self._ended, self._shown = progress, ended, shown

    def update(self, done: float, total: float, note: str = "") -> None:
        """Show how far the first job is."""
        if self._shown:
            self._progress.update(done, total, note)

    def cancelled(self) -> bool:
        """Tell whether all were to stop, or have: the spots of some cameras are of no use."""
        return self._ended.is_set() or self._progress.cancelled()


def side_by_side(
    look: Callable[[str, str, Progress], SpotTrack], texts: Mapping[str, str], progress: Progress
) -> dict[str, SpotTrack]:
    """Return what look(name, text, progress) finds in each camera's source, all read at once."""
    ended = Event()
    with ThreadPoolExecutor(len(texts)) as pool:
        try:
            jobs = {
                name: pool.submit(look, name, text, _OneOfMany(progress, ended, shown=k == 0))
                for k, (name, text) in enumerate(texts.items())
            }
            return {name: job.result() for name, job in jobs.items()}
        finally:
            ended.set()


def _of_rig(texts: Mapping[str, str], rig: Rig, search: SpotSearch, progress: Progress) -> dict[str, SpotTrack]:
    """Return the spots of a rig's cameras, whose frames must be of their sizes; stamps count from one moment."""

    def look(side: str, text: str, progress: Progress) -> SpotTrack:
        return spots_of_frames(
            search, side, text, progress, lambda frame: check_size(rig, side, frame, "No timing is given")
        )

    return side_by_side(look, texts, progress)


# The lights of a target in pairs of frames.


def lit_frame(packed: PackedRig, name: str, left: Spots, right: Spots, *, overlaid: bool = False) -> LitFrame:
    """Return the pairs of a moment's spots that agree with the epipolar lines; overlaid: see pair_spots."""
    index = pair_spots(packed, left, right, overlaid=overlaid).index
    return LitFrame(name=name, left=left.take(index[:, 0]), right=right.take(index[:, 1]))


def lights_of_pairs(rig: Rig, pairs: Sequence[LitMoment], lights: int, *, overlaid: bool) -> TargetResult:
    """Return where the lights of a target are, by the pairs that show all of them twice; of too few by every sight.

    overlaid: see pair_spots. Raises as calibrate_target.
    """
    packed = PackedRig.of(rig)

    def by_pairs(order: slice) -> TargetResult:
        frames = [lit_frame(packed, one.name, *one.views[order], overlaid=overlaid) for one in pairs]
        return calibrate_target(rig, frames, lights, overlaid=overlaid)

    exchanged = partial(by_pairs, slice(None, None, -1))
    try:
        found = by_pairs(slice(None))
    except DataRefused as error:
        if overlaid:
            raise
        refuse_swapped(exchanged, lambda other: other.scale < LOOSE)
        if isinstance(error, NotEnoughData):
            with suppress(DataRefused):
                return calibrate_lights(rig, pairs, lights, paired=paired, naming=naming)
        raise
    if found.scale > LOOSE and not overlaid:
        refuse_swapped(exchanged, lambda other: LOOSE * other.scale < found.scale)
    return found


def refuse_swapped(exchanged: Callable[[], Moment], better: Callable[[Moment], bool] = lambda _: True) -> None:
    """Raise Inconsistent where what was refused, or fits badly, is given, and better, with left and right exchanged."""
    try:
        if not better(exchanged()):
            return
    except DataRefused:
        return
    raise swapped()


def lit_pairs(
    rig: Rig, pairs: MomentSource, settings: SpotSettings, limit: int | None, progress: Progress
) -> list[LitMoment]:
    """Return the lights in pairs of frames, those that stand still left out. Raises DataRefused, Cancelled."""
    seen, overlaid = [], False
    for left, right in _counted(pairs_of(pairs), pairs.total, limit, progress):
        check_sizes(rig, (left, right), OTHER_FRAMES)
        overlaid = left is right
        at_left = find_spots(left.image, settings)
        seen.append((left.source, at_left, at_left if overlaid else find_spots(right.image, settings)))
    names, lefts, rights = zip(*seen, strict=True) if seen else ((), (), ())
    moving = without_standing(lefts)
    others = moving if overlaid else without_standing(rights)
    views = zip(moving, others, strict=True)
    return [LitMoment(name=name, views=pair) for name, pair in zip(names, views, strict=True)]


def lit_moments(
    rig: Rig, moments: MomentSource, settings: SpotSettings, limit: int | None, progress: Progress
) -> list[LitMoment]:
    """Return the lights of each camera in moments, those that stand still left out. Raises DataRefused, Cancelled."""
    names, seen = [], []
    for frames in _counted(moments_of(moments), moments.total, limit, progress):
        check_sizes(rig, frames, OTHER_FRAMES)
        names.append(next((frame.source for frame in frames if frame is not None), ""))
        there = [None if frame is None or frame.unreadable else frame for frame in frames]
        seen.append([Spots.none() if frame is None else find_spots(frame.image, settings) for frame in there])
    moving = [without_standing(view) for view in zip(*seen, strict=True)]
    return [LitMoment(name=name, views=views) for name, views in zip(names, zip(*moving, strict=True), strict=True)]


def _counted(
    moments: Generator[Moment, None, None], total: int | None, limit: int | None, progress: Progress
) -> Iterator[Moment]:
    """Yield moments up to a limit, telling after each. Raises Cancelled."""
    most = min(limit or total, total) if total else limit or 0
    for count, moment in enumerate(islice(moments, limit), 1):
        yield moment
        progress.update(count, most, "looking for lights")
        if progress.cancelled():
            raise Cancelled(f"stopped after {count} pairs", consequence="No target was written")


def paired(two: Rig, left: Spots, right: Spots) -> Index:
    """Return the spots (p, 2) of two views that agree with the epipolar lines."""
    return pair_spots(PackedRig.of(two), left, right).index


def naming(rig: Rig, target: Target) -> Callable[[Sequence[Spots]], NamedSights | NotSeen]:
    """Return what finds a target in the views of a moment, as measuring does."""
    setup = Setup(rig=rig, target=target)

    def look(views: Sequence[Spots]) -> NamedSights | NotSeen:
        found = measure_spots(setup, 0.0, views[0], views[1]) if rig.is_pair else measure_views(setup, 0.0, views)
        T = found.pose.T_parent_target
        if found.pose.status is not PoseStatus.OK or T is None:
            return found.missed
        shown = tuple(found.names_in(side) for side in range(len(views)))
        return NamedSights(T_rig_target=np.asarray(T), spots=found.spots, names=shown)

    return look
