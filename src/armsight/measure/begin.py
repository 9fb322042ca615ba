"""How a track of a moving target begins: in frames of both cameras that are nearly, or made to be, of one moment.

They are made so by spots of one camera at a time between two of its frames: they go on in straight lines.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from typing import TypeAlias

import numpy as np

from armsight.arrays import Array, Index
from armsight.errors import Inconsistent
from armsight.measure.motion.states import View
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.pipeline import measure_pair
from armsight.measure.poses.setup import Setup
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
    """Takes frames until the target is found in them. why: why it is not.

    timing: of the left and the right camera.
    """

    setup: Setup
    timing: tuple[CameraTiming, CameraTiming]
    why: str = "no frame of both cameras yet"
    _latest: list[AnyFrame | None] = field(default_factory=lambda: [None, None])
    _seen: list[tuple[float, Spots] | None] = field(default_factory=lambda: [None, None])

    def add(self, frame: AnyFrame, side: int) -> Beginning | None:
        """Bring in a frame of the left (0) or right (1) camera; return what begins with it."""
        self._latest[side] = frame
        left, right = self._latest
        if left is None or right is None:
            return None
        times = tuple(float(self.timing[k].rig_time(one.t_s)) for k, one in enumerate((left, right)))
        if abs(times[0] - times[1]) > APART_S:
            return None
        measured = _measured(self.setup, left, right)
        seen = (measured.left_seen, measured.right_seen)
        for slack_px in SLACKS_PX:
            if measured.pose.status is PoseStatus.OK:
                break
            measured = _measured(replace(self.setup, slack_px=slack_px), left, right)
        if measured.pose.status is PoseStatus.OK:
            spots = (measured.left, measured.right)
            pair = [self._view(spots[k], measured.names, k, one) for k, one in enumerate((left, right))]
            pair.sort(key=lambda view: view.t_s)
            return _beginning(tuple(pair), measured)
        self.why = measured.pose.why
        earlier, self._seen[side] = self._seen[side], (times[side], seen[side])
        return self._between(earlier, times, seen, side)

    def _between(
        self, earlier: tuple[float, Spots] | None, times: tuple[float, ...], seen: tuple[Spots, Spots], side: int
    ) -> Beginning | None:
        """Look for the target at the other camera's frame, between this camera's last two."""
        other = self._latest[1 - side]
        if earlier is None or other is None:
            return None
        t_s, before = earlier
        if not (t_s < times[1 - side] < times[side] <= t_s + APART_S):
            return None
        setup = replace(self.setup, slack_px=BETWEEN_SLACK_PX)
        for spots in spots_between(before, seen[side], (times[1 - side] - t_s) / (times[side] - t_s)):
            both = (spots, seen[1]) if side == 0 else (seen[0], spots)
            measured = measure_spots(setup, times[1 - side], *both)
            if measured.pose.status is PoseStatus.OK:
                found = (measured.left, measured.right)[1 - side]
                return _beginning((self._view(found, measured.names, 1 - side, other),), measured)
        return None

    def _view(self, spots: Spots, names: tuple[str, ...], side: int, frame: AnyFrame) -> View:
        lights = np.array([self.setup.model.names.index(name) for name in names], dtype=np.intp)
        return View(
            t_s=float(self.timing[side].rig_time(frame.t_s)),
            side=side,
            lights=lights,
            uv_px=spots.uv_px,
            cov_px2=spots.covariance_px2,
            tau_s=self.timing[side].line_time(spots.uv_px[:, 1], frame.height),
        )


def _beginning(views: tuple[View, ...], measured: Measured) -> Beginning:
    return Beginning(
        views=views, T=np.asarray(measured.pose.T_parent_target), covariance=np.asarray(measured.pose.covariance)
    )


def _measured(setup: Setup, left: AnyFrame, right: AnyFrame) -> Measured:
    """Return the target's pose in two frames as if they were of one moment."""
    if isinstance(left, Frame) and isinstance(right, Frame):
        return measure_pair(setup, left, right)
    if isinstance(left, SpotFrame) and isinstance(right, SpotFrame):
        return measure_spots(setup, 0.5 * (left.t_s + right.t_s), left.spots, right.spots)
    raise Inconsistent("one camera gives images and the other one spots", cure="Give both alike")


MAX_SPOTS = 16
"""Among more it is guesswork which of them went where."""
FEWEST_SPOTS = 3
ALIKE_PX = 12.0
"""By how much the ways of one target's lights differ: it turns and comes nearer, which its shift leaves out."""
MOST_WAYS = 3


def spots_between(earlier: Spots, later: Spots, share: float) -> Iterator[Spots]:
    """Yield the spots as they were when this share of the time between two frames was over, the likeliest way first.

    Spots that move alike are taken for one target's; its spots are linked by their common shift.
    """
    for before, after in _links(earlier.uv_px, later.uv_px):
        a, b = earlier.take(before), later.take(after)
        yield Spots.of_centres(
            (1.0 - share) * a.uv_px + share * b.uv_px,
            (1.0 - share) ** 2 * a.covariance_px2 + share**2 * b.covariance_px2,
        )


def _links(a: Array, b: Array) -> list[tuple[Index, Index]]:
    """Return which of the spots a (n, 2) are which of b (m, 2), under the shifts that explain most of them best."""
    if not (FEWEST_SPOTS <= len(a) <= MAX_SPOTS and FEWEST_SPOTS <= len(b) <= MAX_SPOTS):
        return []
    found: dict[tuple[int, ...], tuple[int, float, Index, Index]] = {}
    for shift in (b[None] - a[:, None]).reshape(-1, 2):
        off = np.linalg.norm(a[:, None] + shift - b[None], axis=2)
        nearest = off.argmin(axis=1)
        rows = np.arange(len(a))
        mutual = (off.argmin(axis=0)[nearest] == rows) & (off[rows, nearest] < ALIKE_PX)
        before, after = np.flatnonzero(mutual), nearest[mutual]
        if len(before) >= FEWEST_SPOTS:
            misfit = float(np.linalg.norm((b[after] - a[before]) - (b[after] - a[before]).mean(axis=0)))
            found[(*before.tolist(), -1, *after.tolist())] = (-len(before), misfit, before, after)
    ways = sorted(found.values(), key=lambda way: way[:2])
    return [(before, after) for _, _, before, after in ways[:MOST_WAYS]]
