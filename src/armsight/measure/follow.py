"""Frames of cameras that no wire joins -> named views of a target: each frame by itself, at its own time.

And what repeats from pose to pose: the uncertainty of rig and target, carried to a moving target's pose.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from math import sqrt

import numpy as np

from armsight.arrays import Array, Index
from armsight.measure.begin import AnyFrame, Beginner, Beginning
from armsight.measure.motion.estimate import MAX_GAP_S, MotionFilter, Start
from armsight.measure.motion.kernels import state as kernels
from armsight.measure.motion.kernels.views import observe_all
from armsight.measure.motion.states import MotionState, View
from armsight.measure.poses.expected import GATE_SIGMA, Shutter, expect
from armsight.measure.poses.kernels import rig_covariance
from armsight.measure.poses.setup import Setup
from armsight.measure.settings import SpotSettings
from armsight.measure.spots import track_spots
from armsight.records import AT_ONCE, CameraTiming, Frame, Spots

LEAST_WINDOW_PX, MOST_WINDOW_PX = 8.0, 64.0
SPOT_REACH = 4.0
"""A spot's light reaches about this many of its sigmas."""
WAITING_FRAMES = 60
"""Frames before a beginning through which the target is followed backwards: a second of both cameras."""
LOST_VIEWS = 6
"""Views in a row that do not fit, or in which nothing is seen, after which the target is looked for anew."""
MAX_WITHOUT_WHOLE_S = 0.05
"""Nothing is said of the target further from a view of three lights: how it turns about two is guesswork."""
MAX_PARTIAL_S = 0.15
"""Without three lights in a view for longer, how the target turns is guesswork, and it is looked for anew."""
FEWEST_VIEWS = 10
"""Views between a start and the next one below which it was none: what was followed was not the target."""


@dataclass(slots=True, kw_only=True, eq=False)
class Follower:
    """Takes frames in the order of the rig's time and names their spots; keeps views and starts for smoothing.

    timing: of each camera; where none is given all expose at once. views, starts: what was found so far. unfit: frames
    of each camera in which lights were near where the target was expected, and did not fit its motion.
    """

    setup: Setup
    timing: tuple[CameraTiming, ...] = ()
    views: list[View] = field(default_factory=list)
    starts: list[Start] = field(default_factory=list)
    unfit: list[int] = field(default_factory=list)
    _filter: MotionFilter | None = None
    _beginner: Beginner | None = None
    _waiting: deque[tuple[AnyFrame, int]] = field(default_factory=lambda: deque(maxlen=WAITING_FRAMES))
    _lost: str = ""
    _missed: int = 0
    _near: bool = False
    _complete_s: float = -np.inf

    def __post_init__(self) -> None:
        v = len(self.setup.packed.k)
        self.timing, self.unfit = self.timing or (AT_ONCE,) * v, [0] * v

    @property
    def why(self) -> str:
        """Why the target is not followed."""
        return self._lost if self._beginner is None else self._beginner.why

    def time_of(self, frame: AnyFrame, side: int) -> float:
        """Return the rig's time of a frame."""
        return float(self.timing[side].rig_time(frame.t_s))

    def add(self, frame: AnyFrame, side: int) -> MotionState | None:
        """Return the state after a frame of a camera (side, in the rig's order); None while nothing is sure of it."""
        t_s = self.time_of(frame, side)
        if self._filter is not None and t_s - self._filter.seen_s > MAX_GAP_S:
            self._lose("the target was out of sight")
        if self._filter is None:
            return self._begin(frame, side)
        view = self._find(self._filter, frame, side, t_s)
        self._missed = 0 if view is not None else self._missed + 1
        if self._missed >= LOST_VIEWS:
            self._lose("what is seen no longer moves as the target did")
            return None
        if view is None:
            return self._sure(self._filter.at(t_s))
        if len(view.lights) >= 3:
            self._complete_s = t_s
        if t_s - self._complete_s > MAX_PARTIAL_S:
            self._lose("too few of the target's lights are in sight")
            return None
        self.views.append(view)
        self._filter = self._filter.add(view)
        return self._sure(self._filter.state)

    def _sure(self, state: MotionState) -> MotionState | None:
        return state if state.t_s - self._complete_s <= MAX_WITHOUT_WHOLE_S else None

    def _lose(self, why: str) -> None:
        self._filter, self._beginner, self._lost = None, None, why
        self._waiting.clear()

    def tracks(self) -> tuple[list[View], list[Start]]:
        """Return the views and starts of all stretches that were followed for a while."""
        views: list[View] = []
        starts: list[Start] = []
        ends = [start.view for start in self.starts[1:]] + [len(self.views)]
        for start, end in zip(self.starts, ends, strict=False):  # no start, no stretch
            stretch = self.views[start.view : end]
            while stretch and len(stretch[-1].lights) < 3:  # nothing holds how the target turned from there on
                stretch.pop()
            if len(stretch) >= FEWEST_VIEWS and self._of_enough(stretch):
                starts.append(replace(start, view=len(views)))
                views += stretch
        return views, starts

    def _of_enough(self, views: Sequence[View]) -> bool:
        """Tell whether views are of two cameras, or of the rig's only one."""
        return len({view.side for view in views}) >= min(2, len(self.timing))

    def _begin(self, frame: AnyFrame, side: int) -> MotionState | None:
        """Look for the target; a track that begins also goes back through the frames in which it was not yet found."""
        if self._beginner is None:
            self._beginner = Beginner(setup=self.setup, timing=self.timing)
        found = self._beginner.add(frame, side)
        last_s = self.views[-1].t_s if self.views else -np.inf
        if found is None or found.views[0].t_s < last_s:
            self._waiting.append((frame, side))
            return None
        earlier = self._before(found, last_s)
        self._start(found if earlier is None else earlier)
        if earlier is not None:
            self.views += found.views
        self._filter = self._filter_from(found)
        self._missed, self._complete_s = 0, found.views[-1].t_s
        self._waiting.clear()
        self._beginner = None
        is_used = any(view.side == side and view.t_s == self.time_of(frame, side) for view in found.views)
        return self._filter.state if is_used else self.add(frame, side)

    def _start(self, found: Beginning) -> None:
        self.starts.append(Start(view=len(self.views), T=found.T, covariance=found.covariance))
        self.views += found.views

    def _filter_from(self, found: Beginning) -> MotionFilter:
        first_s = found.views[0].t_s
        after = MotionFilter.begin(self.setup.packed, self.setup.model.xyz_m, first_s, found.T, found.covariance)
        for view in found.views:
            after = after.add(view)
        return after

    def _before(self, found: Beginning, last_s: float) -> Beginning | None:
        """Return what is seen of the target before a beginning: time runs backwards, and the target is followed."""
        back = Follower(setup=self.setup, timing=tuple(map(_reversed, self.timing)))
        back._filter = back._filter_from(replace(found, views=tuple(_mirrored(view) for view in found.views[::-1])))
        back._complete_s = -found.views[0].t_s
        earliest, whole = None, 0
        for frame, side in reversed(self._waiting):
            if not last_s < self.time_of(frame, side) < found.views[0].t_s:
                continue
            n = len(back.views)
            state = back.add(replace(frame, t_s=-frame.t_s), side)
            if back._filter is None:
                break
            if len(back.views) > n and self._firm(back.views[-2:]):
                earliest, whole = state, len(back.views)
        if earliest is None:
            return None
        views = tuple(_mirrored(view) for view in back.views[:whole][::-1])
        return Beginning(views=views, T=earliest.T_rig_target, covariance=earliest.covariance)

    def _firm(self, views: Sequence[View]) -> bool:
        """Tell whether views are of two cameras and show three lights each: a smoother may begin with them."""
        return self._of_enough(views) and all(len(view.lights) >= 3 for view in views)

    def _find(self, follows: MotionFilter, frame: AnyFrame, side: int, t_s: float) -> View | None:
        """Return the target's spots in a frame: where it is expected, or where a knock would have put it."""
        self._near = False
        view = self._look(frame, side, t_s, follows.at(t_s)) or self._look(frame, side, t_s, follows.after_a_knock(t_s))
        self.unfit[side] += view is None and self._near
        return view

    def _look(self, frame: AnyFrame, side: int, t_s: float, state: MotionState) -> View | None:
        """Return the target's spots in a frame, looked for where they are expected; None where they are not there."""
        shutter = Shutter(side=side, timing=self.timing[side], height=frame.height)
        expected = expect(self.setup, state, shutter)
        if expected is None:
            return None
        h, w = frame.height, frame.width
        inside = ((expected.uv_px >= 0.0) & (expected.uv_px <= (w - 1.0, h - 1.0))).all(axis=1)
        if not inside.any():
            return None
        sigma = sqrt(expected.S.diagonal().reshape(-1, 2)[inside].max())
        half = min(GATE_SIGMA * sigma + LEAST_WINDOW_PX, MOST_WINDOW_PX)
        spots, of = _spots_near(frame, expected.uv_px[inside], half, self.setup.sides[side])
        self._near |= len(spots) > 0
        return expected.named(t_s, spots, np.flatnonzero(inside)[of])


def _spots_near(frame: AnyFrame, uv_px: Array, half_px: float, settings: SpotSettings) -> tuple[Spots, Index]:
    """Return the spots in windows about uv_px (n, 2), and the row of uv_px that each belongs to."""
    if isinstance(frame, Frame):
        return track_spots(frame.image, uv_px, half_px, settings)
    off = np.abs(frame.spots.uv_px[None] - uv_px[:, None]).max(axis=2)
    of, which = np.nonzero(off <= half_px)
    return frame.spots.take(which), of


def _reversed(timing: CameraTiming) -> CameraTiming:
    """Return the timing of a camera whose stamps count backwards."""
    return replace(timing, delay_s=-timing.delay_s, readout_s=-timing.readout_s)


def _mirrored(view: View) -> View:
    """Return a view as it is where time runs backwards."""
    return replace(view, t_s=-view.t_s, tau_s=-view.tau_s)


def systematic_covariance(setup: Setup, state: MotionState) -> Array | None:
    """Return the covariance (6, 6) that rig and target leave in a pose; None where both are exact.

    All lights count as seen in all views that have them before them, all spots as equally good.
    """
    if not setup.covariance.size:
        return None
    slopes = _slopes(setup, state)
    seeing = slopes.any(axis=(1, 2, 3))
    if not seeing.any():
        return None
    C = np.linalg.inv(np.einsum("sica,sicb->ab", slopes, slopes))
    X, packed = setup.model.xyz_m, setup.packed
    unit, out = np.tile(np.eye(2), (len(X), len(slopes), 1, 1)), np.zeros((6, 6))
    unit[:, ~seeing] = np.inf
    rig_covariance.carry_to_pose(
        packed.arrays,
        unit,
        X,
        state.T_rig_target,
        setup.covariance,
        C,
        np.zeros((len(X), len(slopes), 2)),
        out,
    )
    return out if out.any() else None


def _slopes(setup: Setup, state: MotionState) -> Array:
    """Return d pixel / d pose [view, light, 2, 6]; 0 of a camera that has a light behind it."""
    packed, X = setup.packed, setup.model.xyz_m
    v = len(packed.k)
    H, uv = np.zeros((v, 2 * len(X), kernels.N)), np.empty((len(X), 2))
    for side in range(v):
        if not observe_all(state.x, packed.camera(side), X, np.zeros(len(X)), uv, H[side]):
            H[side] = 0.0
    return H.reshape(v, len(X), 2, kernels.N)[..., :6]
