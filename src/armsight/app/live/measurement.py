"""Moments of frames measured at the cameras' pace, and told as a screen shows them."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Generator, Iterator, Mapping
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from armsight.app.live.views import Counts, LiveView, RunView, SideView, live_view, side_view
from armsight.arrays import Mask
from armsight.clock import Clock
from armsight.control.session.channels import JointTrack
from armsight.drivers import MomentSource, OneImage, Skew, Views, by_name, is_live, moments_of
from armsight.errors import Inconsistent, UsageError
from armsight.measure.consistency.findings import LeftOut
from armsight.measure.consistency.run_of_cameras import CamerasCheck
from armsight.measure.poses.moments import TargetTracker, lost_frames
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.setup import SLACK_PX, Setup, rig_slack_px
from armsight.measure.settings import SpotSettings
from armsight.measure.spots import find_spots
from armsight.ops.measurement.outputs import moved_pose
from armsight.ops.measurement.run import target_of
from armsight.ops.simulation.following import when_heard
from armsight.ops.simulation.scenarios import live_cell
from armsight.ops.sources.cameras import cameras_of, open_cameras, told_apart, told_later
from armsight.ops.sources.frames import open_source
from armsight.ops.sources.pace import live_pace
from armsight.optics import SIDES, Rig, RigKind
from armsight.records import Frame, PoseStatus, Spots, TargetPose
from armsight.report.residuals import distance_rms
from armsight.store import World, read_rig, read_world
from armsight.store.cell_file import COMPLEX

ROOM = "plain"
"""What stands behind a target that is led about: before a workshop's hundreds of bright things three lights seen askew
cannot always be told, and a person would mask them."""


@dataclass(frozen=True, slots=True)
class FollowedCell:
    """scenario: its name or file. track: where the loop's process says the joints are, on the machine's clock."""

    scenario: str
    track: JointTrack
    room: str = ROOM


class FollowedPairs:
    """What the cell's cameras see of an arm that stands where the track says; frames are stamped with the clock."""

    skew: Skew | None = None
    total: int | None = None

    def __init__(self, cell: FollowedCell, clock: Clock) -> None:
        """Open nothing yet. Raises DeviceNotFound, BadFile, Inconsistent for the scenario."""
        self._cell: Any = live_cell(cell.scenario, clock, room=cell.room)
        self._cell.robot.follow(when_heard(cell.track, clock))
        self.name = str(self._cell.pairs.name)

    def __enter__(self) -> Self:
        self._cell.pairs.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._cell.pairs.__exit__(kind, error, trace)

    def __iter__(self) -> Iterator[Views]:
        origin_s = float(self._cell.origin_s)
        for frames in self._cell.pairs:
            yield tuple(replace(frame, t_s=origin_s + frame.t_s) for frame in frames)


Rectangle = tuple[float, float, float, float]

NOT_CALIBRATED = "the cameras are not calibrated yet, or no target is chosen: lights are found, not measured"

RATE_S = 1.0
"""Time over which moments a second are counted."""

JUDGED, JUDGE_S = 100, 0.1
"""Moments by which it is judged, as by a whole run, whether a camera has moved, before that begins anew; and the time
between two of them: a look at them takes 30 to 260 ms, with four cameras."""

BLANK = SideView(
    width=640, height=480, spots=[], epipolar=[], advice="nothing_seen", background=0.0, brightest=None, sigma_px=None
)
"""Of a camera that has not given any picture yet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveJob:
    """What is measured live: rig.yaml, target.yaml, cameras; live ones, or files played at their own pace.

    cameras: sources by name, in the rig's order; COMPLEX alone is the one camera of a mirror rig, whose image holds
    both views (Pachidis 2005). Without rig or target lights are found and pictures shown, for aiming cameras that are
    not calibrated yet. again: files begin anew at their end. followed: a simulated cell whose cameras these are, and
    whose robot another process moves.
    """

    cameras: Mapping[str, str]
    rig: Path | None = None
    target: Path | None = None
    world: Path | None = None
    fps: float | None = None
    again: bool = False
    followed: FollowedCell | None = None

    @property
    def live(self) -> bool:
        """Whether the sources are cameras."""
        return any(map(is_live, self.cameras.values()))

    @property
    def complex(self) -> bool:
        """Whether one picture holds both views."""
        return COMPLEX in self.cameras


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionSettings:
    """How spots are looked for, as the person sets it on the picture.

    threshold, inverted: as SpotSettings has them. masked: per picture (a camera's name, or complex), rectangles
    (u0, v0, u1, v1) in px in which nothing is looked for.
    """

    threshold: float | None = None
    inverted: bool = False
    masked: dict[str, tuple[Rectangle, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredMoment:
    """One moment measured: its frames by picture, the spots of each view with their covariances, and what a screen says
    of it."""

    frames: Mapping[str, Frame]
    pose: TargetPose
    spots: tuple[Spots, ...]
    view: LiveView


class LiveMeasurement:
    """Measures moment after moment; `look` may be exchanged between two of them."""

    def __init__(self, job: LiveJob, clock: Clock, source: MomentSource | None = None) -> None:
        """Read rig, target and place; source: in place of the job's. Raises UsageError, DataRefused."""
        self._job, self._clock = job, clock
        self.rig: Rig | None = read_rig(job.rig, any_cameras=True) if job.rig else None
        self.target = target_of(job.target) if job.target else None
        self._world: World | None = read_world(job.world) if job.world else None
        colour = self.target is not None and self.target.colour is not None
        if source is None and job.followed is not None:
            source = FollowedPairs(job.followed, clock)
        require_kind(job, self.rig)
        self.source = source or _opened(job, colour)
        """Where the frames come from; to be opened with `with`."""
        if self.rig is not None:
            told_apart(self.source, self.rig)
        self._paced = source is None and not job.live
        self.views: tuple[str, ...] = SIDES if job.complex else tuple(job.cameras)
        """The rig's cameras."""
        self._look = DetectionSettings()
        self._setup: Setup | None = None
        self._tracker: TargetTracker | None = None
        self._check: CamerasCheck | None = None
        self._n_judged, self._judged_s = 0, -np.inf
        self._left_out: list[LeftOut] = []
        self._settings: tuple[SpotSettings, ...] = (SpotSettings(),) * len(self.views)
        self._sizes: tuple[tuple[int, int] | None, ...] = (None,) * len(self.views)
        self._anew = True
        self._shown = dict.fromkeys(self.views, BLANK)
        self._counts = dict.fromkeys(PoseStatus, 0)
        self._done_s: deque[float] = deque()

    def look(self, how: DetectionSettings) -> None:
        """Look for spots in another way from the next moment on. Raises UsageError for what cannot be."""
        self._asked(how)  # refused here, not in the loop
        self._look, self._anew = how, True

    def moments(self) -> Generator[MeasuredMoment, None, None]:
        """Yield every moment as it is measured; the source must be open. Raises as it does, and UsageError."""
        while True:
            origin_s = self._clock.now_s()
            with closing(moments_of(self.source)) as source:
                for frames in source:
                    yield self._measured(self._played(frames, origin_s))
            if not (self._paced and self._job.again):
                return
            if self._tracker is not None:
                self._tracker.track = None

    def _played(self, frames: Views, origin_s: float) -> Views:
        """Return a moment of live cameras as it is; one of files at its time after origin_s, stamped with it."""
        if not self._paced:
            return frames
        self._clock.sleep_until(origin_s + _first(frames).t_s)
        return tuple(None if frame is None else replace(frame, t_s=origin_s + frame.t_s) for frame in frames)

    def _measured(self, frames: Views) -> MeasuredMoment:
        self._prepare(frames)
        start_s = time.perf_counter()
        measured = self._checked(self._found(frames))
        took_s = time.perf_counter() - start_s
        world = self._world
        pose = moved_pose(measured.pose, world.T_parent_rig, world.parent) if world else measured.pose
        self._counts[pose.status] += 1
        judged = [measured.judged_px(s) for s in range(len(measured.spots))]
        run = RunView(
            fps=self._fps(),
            latency_s=self._clock.now_s() - _first(frames).t_s,
            measuring_s=took_s,
            counts=Counts(**{status.value: n for status, n in self._counts.items()}),
            residual_px=distance_rms(judged),
        )
        self._show(frames, measured)
        n_lights = None if self.target is None else len(self.target.names)
        view = live_view(pose, run, self._shown, n_lights)
        pictures = by_name(self.views, frames)
        if self._job.complex:
            pictures = {COMPLEX: pictures[SIDES[0]]}  # of one picture both are the same
        return MeasuredMoment(frames=pictures, pose=pose, spots=measured.seen, view=view)

    def _show(self, frames: Views, measured: Measured) -> None:
        """Keep what a screen shows of each camera; of one without a picture how it was, without lights."""
        lost: Mapping[str, str] = getattr(self.source, "lost", {})
        why = {name: f"{one.words}. {one.cure}." for one in self._left_out for name in one.names}
        for s, (name, frame) in enumerate(zip(self.views, frames, strict=True)):
            if frame is None:
                self._shown[name] = replace(self._shown[name], spots=[], epipolar=[], lost=lost.get(name))
                continue
            shown = side_view(self.rig, self._settings[s], s, frame, measured, overlaid=self._job.complex)
            self._shown[name] = replace(shown, left_out=why.get(name))

    def _found(self, frames: Views) -> Measured:
        """Return what is measured in a moment; without rig or target the lights alone."""
        if self._tracker is None:
            pace = live_pace()

            def seen(s: int) -> Spots:
                frame = frames[s]
                return Spots.none() if frame is None else find_spots(frame.image, self._settings[s], pace)

            if self._job.complex:
                spots: tuple[Spots, ...] = (seen(0),) * 2
            else:
                spots = tuple(pace.each(seen, len(frames)))
            return replace(lost_frames(frames, NOT_CALIBRATED), seen=spots)
        try:
            measured = self._tracker.take(*frames)
        except Inconsistent as error:
            return lost_frames(frames, str(error))
        swapped = self._tracker.swapped
        return measured if swapped is None else lost_frames(frames, str(swapped))

    def _checked(self, measured: Measured) -> Measured:
        """Return a moment without the cameras that have moved by what the others show, which are left out from now on.

        A pair does not tell which of its two it is.
        """
        t_s = measured.pose.t_s
        if self._tracker is None or self._check is None or 0.0 <= t_s - self._judged_s < JUDGE_S:
            return measured
        measured, self._judged_s = self._check.add(measured), t_s
        self._n_judged += 1
        if self._n_judged >= JUDGED:
            self._check.finish()
        self._left_out = list(self._check.left_out)
        self._tracker.without, self._tracker.track = self._check.without, measured.track
        if self._n_judged >= JUDGED:
            self._judge()
        return measured

    def _judge(self) -> None:
        """Begin to judge the cameras of a rig that is no pair, but those that are left out already."""
        if self._setup is not None and not self._setup.rig.is_pair:
            self._check, self._n_judged = CamerasCheck(self._setup), 0
            self._check.left_out = list(self._left_out)

    def _fps(self) -> float:
        now_s = self._clock.now_s()
        self._done_s.append(now_s)
        while now_s - self._done_s[0] > RATE_S:
            self._done_s.popleft()
        return len(self._done_s) / RATE_S

    def _prepare(self, frames: Views) -> None:
        """Prepare what frames of these sizes are measured with, where they are not as before, or after a `look`."""
        now = zip(frames, self._sizes, strict=True)
        sizes = tuple(before if frame is None else (frame.width, frame.height) for frame, before in now)
        if sizes == self._sizes and not self._anew:
            return
        self._sizes, self._anew = sizes, False
        masks = tuple(
            mask_of(*size, boxes) if (boxes := self._look.masked.get(name)) and size is not None else None
            for name, size in zip((COMPLEX,) * 2 if self._job.complex else self.views, sizes, strict=True)
        )
        asked = self._asked(self._look)
        if self.rig is None or self.target is None:
            self._settings = tuple(replace(asked, mask=mask) for mask in masks)
            return
        self._setup = Setup(
            rig=self.rig,
            target=self.target,
            settings=asked,
            masks=masks,
            overlaid=self._job.complex,
            pace=live_pace(),
            slack_px=SLACK_PX if self.rig.is_pair else rig_slack_px(self.rig),
        )
        before, self._tracker, self._settings = self._tracker, TargetTracker(self._setup), self._setup.sides
        if before is not None:
            self._tracker.track, self._tracker.without = before.track, before.without
        self._judge()

    def _asked(self, look: DetectionSettings) -> SpotSettings:
        colour = None if self.target is None else self.target.colour
        return SpotSettings(threshold=look.threshold, inverted=look.inverted, colour=colour)


def _first(frames: Views) -> Frame:
    return next(frame for frame in frames if frame is not None)


def require_kind(job: LiveJob, rig: Rig | None) -> None:
    """Raise UsageError where the rig's cameras are not those of the job."""
    if rig is None:
        return
    if job.complex and rig.kind is not RigKind.MIRROR:
        raise UsageError(
            f"one picture is given, and the rig has the cameras {', '.join(rig.names)}",
            consequence="Nothing is measured",
            cure="Give all cameras; or, for one camera with mirrors, the rig.yaml of `armsight calibrate mirrors`",
        )
    if not job.complex and rig.kind is RigKind.MIRROR:
        raise UsageError(
            "the rig has mirrors: both of its views are in one camera's picture",
            consequence="Nothing is measured",
            cure="Give that camera as the left one, and leave the right one empty",
        )
    if not job.complex:
        cameras_of(rig.names, job.cameras)


def _opened(job: LiveJob, colour: bool) -> MomentSource:
    if not job.complex:
        return open_cameras(job.cameras, colour=colour, fps=job.fps, tell=told_later)  # it is shown
    return OneImage(open_source(job.cameras[COMPLEX], colour=colour, fps=job.fps))


def mask_of(width: int, height: int, rectangles: tuple[Rectangle, ...]) -> Mask:
    """Return (h, w): True where a picture's spots may be, outside of rectangles (u0, v0, u1, v1) in px."""
    allowed = np.ones((height, width), dtype=np.bool_)
    for u0, v0, u1, v1 in rectangles:
        columns, rows = sorted((round(u0), round(u1))), sorted((round(v0), round(v1)))
        allowed[max(rows[0], 0) : max(rows[1], 0) + 1, max(columns[0], 0) : max(columns[1], 0) + 1] = False
    return allowed
