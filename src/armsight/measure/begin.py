"""How a track of a moving target begins: in frames of cameras that are nearly, or made to be, of one moment.

They are made so by spots of one camera at a time between two of its frames: they go on in straight lines.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from armsight.arrays import Array
from armsight.errors import Inconsistent
from armsight.measure.motion.states import View
from armsight.measure.poses.expected import links
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.moments import measure_moment
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.pose import TWO
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.views import measure_views
from armsight.records import CameraTiming, Frame, PoseStatus, Spots

SLACKS_PX = (1.0, 3.0)
"""What views of two moments may add to a spot's standard deviation when a track begins, tried after the setup's own
slack: 0.1 and 0.3 m/s for 8 ms at 0.8 m."""
BETWEEN_SLACK_PX = 2.0
"""By how much a light leaves the straight line between two frames: 10 m/s^2 for 33 ms at 0.8 m."""
APART_S = 0.1
"""Frames further apart than this do not begin a track."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpotFrame:
    """The spots of one frame, found elsewhere, in the camera's own pixels."""

    t_s: float
    spots: Spots
    width: int
    height: int


AnyFrame: TypeAlias = Frame | SpotFrame


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Beginning:
    """A pose T (4, 4) with covariance (6, 6), and the views in the order of time of which it is; it is the first's."""

    views: tuple[View, ...]
    T: Array
    covariance: Array


@dataclass(slots=True, kw_only=True, eq=False)
class Beginner:
    """Takes frames until the target is found in them. why: why it is not. timing: of each camera."""

    setup: Setup
    timing: tuple[CameraTiming, ...]
    why: str = "no frames of two cameras yet"
    _latest: list[AnyFrame | None] = field(default_factory=list)
    _seen: list[tuple[float, Spots] | None] = field(default_factory=list)

    def __post_init__(self) -> None:
        none = [None] * len(self.timing)
        self._latest, self._seen = [*none], [*none]
        self.setup = replace(self.setup, rig=self.setup.rig.with_each(timing=none))  # as if of one moment

    def add(self, frame: AnyFrame, side: int) -> Beginning | None:
        """Bring in a frame of a camera (side, in the rig's order); return what begins with it."""
        self._latest[side], t_s = frame, self._time(frame, side)
        frames = [
            one if one is not None and abs(self._time(one, k) - t_s) <= APART_S else None
            for k, one in enumerate(self._latest)
        ]
        if sum(one is not None for one in frames) < min(2, len(frames)):
            return None
        measured = _measured(self.setup, frames)
        seen = measured.seen
        for slack_px in SLACKS_PX:
            if measured.pose.status is PoseStatus.OK:
                break
            measured = _measured(replace(self.setup, slack_px=slack_px), frames)
        if measured.pose.status is PoseStatus.OK:
            views = [self._view(measured, k, one) for k, one in enumerate(frames) if one is not None]
            return _beginning(tuple(sorted((v for v in views if len(v.lights)), key=lambda v: v.t_s)), measured)
        self.why = measured.pose.why
        earlier, self._seen[side] = self._seen[side], (t_s, seen[side])
        return None if earlier is None else self._between(earlier, frames, seen, side)

    def _time(self, frame: AnyFrame, side: int) -> float:
        return float(self.timing[side].rig_time(frame.t_s))

    def _between(
        self, earlier: tuple[float, Spots], frames: Sequence[AnyFrame | None], seen: Sequence[Spots], side: int
    ) -> Beginning | None:
        """Look for the target at another camera's frame, between this camera's last two."""
        before_s, before = earlier
        now_s = self._time(frames[side], side)  # type: ignore[arg-type]  # it has just come
        setup = replace(self.setup, slack_px=BETWEEN_SLACK_PX)
        for k, other in enumerate(frames):
            if k == side or other is None or not before_s < self._time(other, k) < now_s <= before_s + APART_S:
                continue
            at_s = self._time(other, k)
            for spots in spots_between(before, seen[side], (at_s - before_s) / (now_s - before_s)):
                views = {side: spots, k: seen[k]}
                measured = _of_spots(setup, at_s, [views.get(s, Spots.none()) for s in range(len(frames))])
                if measured.pose.status is PoseStatus.OK:
                    return _beginning((self._view(measured, k, other),), measured)
        return None

    def _view(self, measured: Measured, side: int, frame: AnyFrame) -> View:
        """Return what a camera shows of what was measured."""
        spots, shown = measured.spots[side], np.ones(len(measured.names), bool)
        if measured.sights is not None:
            shown = measured.sights[:, side]
        names = [name for name, is_shown in zip(measured.names, shown.tolist(), strict=True) if is_shown]
        return View(
            t_s=self._time(frame, side),
            side=side,
            lights=np.array([self.setup.model.names.index(name) for name in names], dtype=np.intp),
            uv_px=spots.uv_px,
            cov_px2=spots.covariance_px2,
            tau_s=self.timing[side].line_time(spots.uv_px[:, 1], frame.height),
        )


def _beginning(views: tuple[View, ...], measured: Measured) -> Beginning:
    return Beginning(
        views=views, T=np.asarray(measured.pose.T_parent_target), covariance=np.asarray(measured.pose.covariance)
    )


def _measured(setup: Setup, frames: Sequence[AnyFrame | None]) -> Measured:
    """Return the target's pose in frames as if they were of one moment."""
    there = [frame for frame in frames if frame is not None]
    if all(isinstance(frame, Frame) for frame in there):
        return measure_moment(setup, frames)  # type: ignore[arg-type]
    if any(isinstance(frame, Frame) for frame in there):
        raise Inconsistent("one camera gives images and another one spots", cure="Give all alike")
    t_s = sum(frame.t_s for frame in there) / len(there)
    seen = [frame.spots if isinstance(frame, SpotFrame) else Spots.none() for frame in frames]
    return _of_spots(setup, t_s, seen)


def _of_spots(setup: Setup, t_s: float, seen: Sequence[Spots]) -> Measured:
    return measure_spots(setup, t_s, seen[0], seen[1]) if len(seen) == TWO else measure_views(setup, t_s, seen)


def spots_between(earlier: Spots, later: Spots, share: float) -> Iterator[Spots]:
    """Yield the spots as they were when this share of the time between two frames was over, the likeliest way first.

    Spots that move alike are taken for one target's; its spots are linked by their common shift.
    """
    for before, after in links(earlier.uv_px, later.uv_px):
        a, b = earlier.take(before), later.take(after)
        yield Spots.of_centres(
            (1.0 - share) * a.uv_px + share * b.uv_px,
            (1.0 - share) ** 2 * a.covariance_px2 + share**2 * b.covariance_px2,
        )
