"""Pairs of frames measured at the cameras' pace, and told as a screen shows them."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np

from armsight.app.live.views import Counts, LiveView, RunView, live_view, side_view
from armsight.arrays import Mask
from armsight.clock import Clock
from armsight.control.session.channels import JointTrack
from armsight.drivers import AUTOMATIC, MomentSource, OneImage, PairSettings, Skew, by_side, is_live, pairs_of
from armsight.errors import Inconsistent, UsageError
from armsight.measure.poses.moments import lost_frames
from armsight.measure.poses.pipeline import Measured, Setup, Track, measure_pair
from armsight.measure.settings import SpotSettings
from armsight.measure.spots import find_spots
from armsight.ops.measurement.outputs import moved_pose
from armsight.ops.measurement.run import target_of
from armsight.ops.simulation.following import when_heard
from armsight.ops.simulation.scenarios import live_cell
from armsight.ops.sources.cameras import open_rig
from armsight.ops.sources.frames import open_source
from armsight.ops.sources.pace import live_pace
from armsight.optics import SIDES, Rig, RigKind
from armsight.records import Frame, PoseStatus, Spots, TargetPose
from armsight.store import World, read_rig, read_world

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

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        origin_s = float(self._cell.origin_s)
        for left, right in self._cell.pairs:
            yield replace(left, t_s=origin_s + left.t_s), replace(right, t_s=origin_s + right.t_s)


Pair = tuple[Frame, Frame]
Rectangle = tuple[float, float, float, float]

NOT_CALIBRATED = "the cameras are not calibrated yet, or no target is chosen: lights are found, not measured"

COMPLEX = "complex"
"""The one picture of a mirror rig, which holds both views."""

RATE_S = 1.0
"""Time over which pairs a second are counted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveJob:
    """What is measured live: rig.yaml, target.yaml, two sources; live cameras, or files played at their own pace.

    right: empty where left is the one camera of a mirror rig, whose image holds both views (Pachidis 2005). Without
    rig or target lights are found and pictures shown, for aiming cameras that are not calibrated yet. again: files
    begin anew at their end. camera_settings: what is asked of live cameras. followed: a simulated cell whose cameras
    left and right are, and whose robot another process moves.
    """

    left: str
    right: str = ""
    rig: Path | None = None
    target: Path | None = None
    world: Path | None = None
    fps: float | None = None
    again: bool = False
    camera_settings: PairSettings = AUTOMATIC
    followed: FollowedCell | None = None

    @property
    def live(self) -> bool:
        """Whether the sources are cameras."""
        return is_live(self.left)

    @property
    def complex(self) -> bool:
        """Whether one picture holds both views."""
        return not self.right


@dataclass(frozen=True, slots=True, kw_only=True)
class DetectionSettings:
    """How spots are looked for, as the person sets it on the picture.

    threshold, inverted: as SpotSettings has them. masked: per picture (left, right, or complex), rectangles
    (u0, v0, u1, v1) in px in which nothing is looked for.
    """

    threshold: float | None = None
    inverted: bool = False
    masked: dict[str, tuple[Rectangle, ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MeasuredPair:
    """One pair measured: its frames, the spots in both with their covariances, and what a screen says of it."""

    pair: Pair
    pose: TargetPose
    spots: tuple[Spots, Spots]
    view: LiveView


class LiveMeasurement:
    """Measures pair after pair; `look` may be exchanged between two of them."""

    def __init__(self, job: LiveJob, clock: Clock, pairs: MomentSource | None = None) -> None:
        """Read rig, target and place; pairs: in place of the job's sources. Raises UsageError, DataRefused."""
        self._job, self._clock = job, clock
        self.rig: Rig | None = read_rig(job.rig) if job.rig else None
        self.target = target_of(job.target) if job.target else None
        self._world: World | None = read_world(job.world) if job.world else None
        colour = self.target is not None and self.target.colour is not None
        if pairs is None and job.followed is not None:
            pairs = FollowedPairs(job.followed, clock)
        require_kind(job, self.rig)
        self._pairs = pairs or _opened(job, colour)
        self._paced = pairs is None and not job.live
        self._look = DetectionSettings()
        self._setup: Setup | None = None
        self._sides: tuple[SpotSettings, ...] = (SpotSettings(), SpotSettings())
        self._sizes: tuple[tuple[int, int], ...] = ()
        self._counts = dict.fromkeys(PoseStatus, 0)
        self._done_s: deque[float] = deque()

    @property
    def pairs(self) -> MomentSource:
        """Where the frames come from; to be opened with `with`."""
        return self._pairs

    def look(self, how: DetectionSettings) -> None:
        """Look for spots in another way from the next pair on. Raises UsageError for what cannot be."""
        self._settings(how)  # refused here, not in the loop
        self._look, self._sizes = how, ()

    def moments(self) -> Generator[MeasuredPair, None, None]:
        """Yield every pair as it is measured; the source must be open. Raises as the source does, and Inconsistent."""
        track: Track | None = None
        while True:
            origin_s = self._clock.now_s()
            with closing(pairs_of(self._pairs)) as source:
                for pair in source:
                    moment, track = self._measured(self._played(pair, origin_s), track)
                    yield moment
            if not (self._paced and self._job.again):
                return
            track = None

    def _played(self, pair: Pair, origin_s: float) -> Pair:
        """Return a pair of live cameras as it is; one of files at its time after origin_s, stamped with it."""
        if not self._paced:
            return pair
        self._clock.sleep_until(origin_s + pair[0].t_s)
        left, right = (replace(frame, t_s=origin_s + frame.t_s) for frame in pair)
        return left, right

    def _measured(self, pair: Pair, track: Track | None) -> tuple[MeasuredPair, Track | None]:
        setup, start_s = self._prepared(pair), time.perf_counter()
        measured = self._found(setup, pair, track)
        took_s = time.perf_counter() - start_s
        world = self._world
        pose = moved_pose(measured.pose, world.T_parent_rig, world.parent) if world else measured.pose
        self._counts[pose.status] += 1
        run = RunView(
            fps=self._fps(),
            latency_s=self._clock.now_s() - pair[0].t_s,
            measuring_s=took_s,
            counts=Counts(**{status.value: n for status, n in self._counts.items()}),
        )
        sides = [
            side_view(self.rig, self._sides[i], i, pair[i], measured, overlaid=self._job.complex)
            for i in range(len(SIDES))
        ]
        spots = measured.left_seen, measured.right_seen
        return MeasuredPair(pair=pair, pose=pose, spots=spots, view=live_view(pose, run, sides)), measured.track

    def _found(self, setup: Setup | None, pair: Pair, track: Track | None) -> Measured:
        """Return what is measured in a pair; without rig or target the lights alone."""
        if setup is None:
            pace = live_pace()
            if self._job.complex:
                left = right = find_spots(pair[0].image, self._sides[0], pace)
            else:
                left, right = pace.both(lambda side: find_spots(pair[side].image, self._sides[side], pace))
            return replace(lost_frames(pair, NOT_CALIBRATED), seen=(left, right))
        try:
            return measure_pair(setup, *pair, track)
        except Inconsistent as error:
            return lost_frames(pair, str(error))

    def _fps(self) -> float:
        now_s = self._clock.now_s()
        self._done_s.append(now_s)
        while now_s - self._done_s[0] > RATE_S:
            self._done_s.popleft()
        return len(self._done_s) / RATE_S

    def _prepared(self, pair: Pair) -> Setup | None:
        """Return what frames of this size are measured with, None without rig or target; made anew after a `look`."""
        sizes = tuple((frame.width, frame.height) for frame in pair)
        if sizes != self._sizes:
            self._setup, self._sides = self._setup_of(self._look, sizes)
            self._sizes = sizes
        return self._setup

    def _settings(self, look: DetectionSettings) -> SpotSettings:
        colour = None if self.target is None else self.target.colour
        return SpotSettings(threshold=look.threshold, inverted=look.inverted, colour=colour)

    def _setup_of(
        self, look: DetectionSettings, sizes: tuple[tuple[int, int], ...]
    ) -> tuple[Setup | None, tuple[SpotSettings, ...]]:
        settings, overlaid = self._settings(look), self._job.complex
        names = (COMPLEX, COMPLEX) if overlaid else SIDES
        left, right = (
            mask_of(*size, look.masked[name]) if look.masked.get(name) else None
            for name, size in zip(names, sizes, strict=True)
        )
        if self.rig is None or self.target is None:
            return None, (replace(settings, mask=left), replace(settings, mask=right))
        setup = Setup(
            rig=self.rig,
            target=self.target,
            settings=settings,
            masks=(left, right),
            overlaid=overlaid,
            pace=live_pace(),
        )
        return setup, setup.sides


def require_kind(job: LiveJob, rig: Rig | None) -> None:
    """Raise UsageError where the rig has another number of cameras than the job."""
    if rig is None:
        return
    if job.complex and rig.kind is not RigKind.MIRROR:
        raise UsageError(
            "one camera is missing: the rig has two",
            consequence="Nothing is measured",
            cure="Give both cameras; or, for one camera with mirrors, the rig.yaml of `armsight calibrate mirrors`",
        )
    if not job.complex and rig.kind is RigKind.MIRROR:
        raise UsageError(
            "the rig has mirrors: both of its views are in one camera's picture",
            consequence="Nothing is measured",
            cure="Give that camera as the left one, and leave the right one empty",
        )


def _opened(job: LiveJob, colour: bool) -> MomentSource:
    if not job.complex:
        return open_rig(SIDES, job.left, job.right, colour=colour, fps=job.fps, settings=job.camera_settings)
    asked, _ = by_side(job.camera_settings)
    return OneImage(open_source(job.left, colour=colour, fps=job.fps, settings=asked))


def mask_of(width: int, height: int, rectangles: tuple[Rectangle, ...]) -> Mask:
    """Return (h, w): True where a picture's spots may be, outside of rectangles (u0, v0, u1, v1) in px."""
    allowed = np.ones((height, width), dtype=np.bool_)
    for u0, v0, u1, v1 in rectangles:
        columns, rows = sorted((round(u0), round(u1))), sorted((round(v0), round(v1)))
        allowed[max(rows[0], 0) : max(rows[1], 0) + 1, max(columns[0], 0) : max(columns[1], 0) + 1] = False
    return allowed
