"""Pairs of frames measured at the cameras' pace, and told as a screen shows them."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Generator, Iterator
from contextlib import closing
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import cast

import numpy as np
from numpy.typing import NDArray

from armsight.app.measure.outputs import moved_pose
from armsight.app.measure.run import lost_pair, target_of
from armsight.app.schemas.live import Counts, LiveView, SideView, SpotView
from armsight.app.sources.frames import open_pairs
from armsight.clock import Clock
from armsight.drivers import AUTOMATIC, PairSettings, PairSource, is_live
from armsight.errors import Inconsistent, UsageError
from armsight.geometry import euler_rad
from armsight.measure.aiming import aiming_hint
from armsight.measure.poses.pipeline import Measured, Setup, Track, measure_pair
from armsight.measure.settings import SpotSettings
from armsight.optics import SIDES, Rig
from armsight.optics.epipolar import epipolar_curve
from armsight.records import Frame, PoseStatus, Spots, TargetPose
from armsight.store import World, read_rig, read_world

Pair = tuple[Frame, Frame]
Mask = NDArray[np.bool_]

DEPTHS_M = np.geomspace(0.15, 30.0, 24)
"""Where along a pixel's ray its epipolar curve is drawn: from a hand before the lens to a hall's other end."""
RATE_S = 1.0
"""Time over which pairs a second are counted."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveJob:
    """What is measured live: rig.yaml, target.yaml, two sources; live cameras, or files played at their own pace.

    again: files begin anew at their end. camera_settings: what is asked of live cameras.
    """

    rig: Path
    target: Path
    left: str
    right: str
    world: Path | None = None
    fps: float | None = None
    again: bool = False
    camera_settings: PairSettings = AUTOMATIC

    @property
    def live(self) -> bool:
        """Whether the sources are cameras."""
        return is_live(self.left)


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """How spots are looked for, as the person sets it on the picture.

    threshold, inverted: as SpotSettings has them. masked: per side, rectangles (u0, v0, u1, v1) in px in which nothing
    is looked for.
    """

    threshold: float | None = None
    inverted: bool = False
    masked: dict[str, tuple[tuple[float, float, float, float], ...]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Moment:
    """One pair measured: its frames, and what a screen says of it."""

    pair: Pair
    pose: TargetPose
    view: LiveView


class LiveMeasurement:
    """Measures pair after pair; `look` may be exchanged between two of them."""

    def __init__(self, job: LiveJob, clock: Clock, pairs: PairSource | None = None) -> None:
        """Read rig, target and place; pairs: in place of the job's sources. Raises UsageError, DataRefused."""
        self._job, self._clock = job, clock
        self.rig: Rig = read_rig(job.rig)
        self.target = target_of(job.target)
        self._world: World | None = read_world(job.world) if job.world else None
        colour = self.target.colour is not None
        self._pairs = pairs or open_pairs(job.left, job.right, colour=colour, fps=job.fps, settings=job.camera_settings)
        self._paced = pairs is None and not job.live
        self._setup = self._setup_of(Look())
        self._counts = dict.fromkeys(PoseStatus, 0)
        self._done_s: deque[float] = deque()

    @property
    def pairs(self) -> PairSource:
        """Where the frames come from; to be opened with `with`."""
        return self._pairs

    def look(self, how: Look) -> None:
        """Look for spots in another way from the next pair on. Raises UsageError for what cannot be."""
        self._setup = self._setup_of(how)

    def moments(self) -> Generator[Moment, None, None]:
        """Yield every pair as it is measured; the source must be open. Raises as the source does, and Inconsistent."""
        track: Track | None = None
        while True:
            origin_s = self._clock.now_s()
            with closing(cast(Generator[Pair, None, None], iter(self._pairs))) as source:
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

    def _measured(self, pair: Pair, track: Track | None) -> tuple[Moment, Track | None]:
        setup, start_s = self._setup, time.perf_counter()
        try:
            measured = measure_pair(setup, *pair, track)
        except Inconsistent as error:
            measured = lost_pair(pair, str(error))
        took_s = time.perf_counter() - start_s
        world = self._world
        pose = moved_pose(measured.pose, world.T_parent_rig, world.parent) if world else measured.pose
        self._counts[pose.status] += 1
        view = self._view(setup, pair, measured, pose, took_s, self._clock.now_s() - pair[0].t_s)
        return Moment(pair=pair, pose=pose, view=view), measured.track

    def _view(
        self, setup: Setup, pair: Pair, measured: Measured, pose: TargetPose, took_s: float, latency_s: float
    ) -> LiveView:
        T, covariance = pose.pose, pose.covariance
        whole = pose.status is PoseStatus.OK and T is not None
        sides = [side_view(setup, side, pair[i], measured) for i, side in enumerate(SIDES)]
        return LiveView(
            sequence=sum(self._counts.values()),
            t_s=pose.t_s,
            fps=self._fps(),
            latency_s=latency_s,
            measuring_s=took_s,
            status=pose.status.value,
            why=pose.why,
            parent=pose.parent,
            xyz_m=None if T is None else _three(T.translation),
            euler_rad=_three(euler_rad(T.rotation)) if whole and T is not None else None,
            quat_xyzw=cast("tuple[float, float, float, float]", tuple(T.rotation.as_quat(canonical=True).tolist()))
            if whole and T is not None
            else None,
            std=None if covariance is None else tuple(np.sqrt(np.diag(covariance)).tolist()),
            residual_px=float(np.sqrt(np.mean(pose.residual_px**2))) if len(pose.residual_px) else None,
            counts=Counts(**{status.value: n for status, n in self._counts.items()}),
            left=sides[0],
            right=sides[1],
        )

    def _fps(self) -> float:
        now_s = self._clock.now_s()
        self._done_s.append(now_s)
        while now_s - self._done_s[0] > RATE_S:
            self._done_s.popleft()
        return len(self._done_s) / RATE_S

    def _setup_of(self, look: Look) -> Setup:
        first = SpotSettings(threshold=look.threshold, inverted=look.inverted, colour=self.target.colour)
        if not look.masked:
            return Setup(rig=self.rig, target=self.target, settings=first)
        masks = [mask_of(self.rig, side, look.masked.get(side, ())) for side in SIDES]
        if masks[0].shape != masks[1].shape:
            raise UsageError("the cameras differ in size", cure="Mask the lights of the room at their place instead")
        return Setup(rig=self.rig, target=self.target, settings=replace(first, mask=masks[0] & masks[1]))


def mask_of(rig: Rig, side: str, rectangles: tuple[tuple[float, float, float, float], ...]) -> Mask:
    """Return (h, w): True where a side's spots may be, outside of rectangles (u0, v0, u1, v1) in px."""
    camera = rig.camera(side)
    allowed = np.ones((camera.height, camera.width), dtype=np.bool_)
    for u0, v0, u1, v1 in rectangles:
        columns, rows = sorted((round(u0), round(u1))), sorted((round(v0), round(v1)))
        allowed[max(rows[0], 0) : max(rows[1], 0) + 1, max(columns[0], 0) : max(columns[1], 0) + 1] = False
    return allowed


def side_view(setup: Setup, side: str, frame: Frame, measured: Measured) -> SideView:
    """Return what a screen shows of one camera's picture."""
    i = SIDES.index(side)
    matched, seen = (measured.left, measured.left_seen) if i == 0 else (measured.right, measured.right_seen)
    hint = aiming_hint(frame, seen, setup.settings)
    return SideView(
        width=frame.width,
        height=frame.height,
        spots=list(_spots(measured, i, matched, seen)),
        epipolar=[_curve(setup.rig, SIDES[1 - i], px) for px in (measured.right if i == 0 else measured.left).uv_px],
        advice=hint.advice.value,
        background=hint.background,
        brightest=hint.brightest,
        sigma_px=hint.sigma_px,
    )


def _spots(measured: Measured, side: int, matched: Spots, seen: Spots) -> Iterator[SpotView]:
    """Yield the named spots with their residuals, then those that nobody named."""
    residuals = np.full((len(matched), 2), np.nan)
    vectors = measured.pose.residual_px.reshape(-1, len(SIDES), 2)
    if len(vectors) == len(matched):
        residuals = -vectors[:, side]  # the record has model minus measured
    for name, (u, v), (du, dv) in zip(measured.names, matched.uv_px, residuals, strict=True):
        known = bool(np.isfinite(du))
        yield SpotView(name=name, u_px=float(u), v_px=float(v), residual_px=(float(du), float(dv)) if known else None)
    named = {(float(u), float(v)) for u, v in matched.uv_px}
    for u, v in seen.uv_px:
        if (float(u), float(v)) not in named:
            yield SpotView(name="", u_px=float(u), v_px=float(v), residual_px=None)


def _curve(rig: Rig, side: str, px: NDArray[np.float64]) -> list[tuple[float, float]]:
    uv = epipolar_curve(rig, side, px, DEPTHS_M)
    return [(round(float(u), 1), round(float(v), 1)) for u, v in uv[np.isfinite(uv).all(axis=1)]]


def _three(values: NDArray[np.float64]) -> tuple[float, float, float]:
    x, y, z = (float(v) for v in values)
    return x, y, z
