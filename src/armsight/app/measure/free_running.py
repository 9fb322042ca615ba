"""Frames or spots of two cameras that no wire joins -> poses of a moving target at any times, smoothed."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from heapq import merge
from itertools import islice
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.app.schemas.measure import FreeRunning
from armsight.app.schemas.timing import BothCounts, BothSeconds
from armsight.app.sources.frames import camera_source, is_recording
from armsight.calibrate.timing.stamps import FEWEST_FRAMES, steady
from armsight.drivers import is_live
from armsight.errors import Cancelled, Inconsistent, NotEnoughData, UsageError
from armsight.measure.follow import AnyFrame, Follower, SpotFrame
from armsight.measure.motion.estimate import MAX_GAP_S, Start, smooth
from armsight.measure.motion.residuals import fitting_stretches, motion_residuals
from armsight.measure.motion.states import MotionState, View
from armsight.measure.poses.setup import Setup
from armsight.measure.systematic import systematic_covariance
from armsight.optics import SIDES, Camera, Rig
from armsight.records import AT_ONCE, CameraTiming, Frame, PoseStatus, Progress, Spots, SpotTrack, TargetPose
from armsight.store import read_spot_track

Array = NDArray[np.float64]

FOLLOWING = "measuring"
MAX_ROTATION_STD_RAD = 0.3
"""A rotation less certain than this is none."""
DOUBTFUL_CHI2, MOST_CHI2 = 1.5, 4.0
"""Chi-square per degree of freedom of the spots about the motion from which it is doubted, and refused: cameras' noise
is off by up to a factor of two."""
MOST_JERK = 3000.0
"""m^2/s^5: a target that is knocked all the time is none; cameras that are out of step look like it."""
MOST_UNFIT, FEW_UNFIT = 0.5, 20
"""Share of one camera's frames with lights near the target that do not fit its motion, and how many of them say
nothing."""
DOUBTFUL = (
    "the spots lie further from the target's motion than their noise: the timing, the rig or the target's measures are "
    "off, and the poses may be by more than they claim"
)
BEFORE_S = 0.05
"""How long before its first view something is said of the target."""
GONE = f"the target was lost, or not found yet, or seen by no camera for {MAX_GAP_S:g} s"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stream:
    """One camera's frames: their stamps in s (n,), freed of jitter, and how to read them once, in that order."""

    t_s: Array
    read: Callable[[], Iterator[AnyFrame]]

    def first(self, n: int) -> Stream:
        """Return the stream of its first n frames."""
        return Stream(t_s=self.t_s[:n], read=lambda: islice(self.read(), n))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingPose:
    """A pose with the velocity (6,) of the target and its standard deviations; None where there is no whole pose."""

    pose: TargetPose
    velocity: Array | None = None
    velocity_std: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FreeRun:
    """Poses at the times asked for, the views they come from, their residuals per side (m, 3): view, u, v in px."""

    poses: Sequence[MovingPose]
    views: Sequence[View]
    residuals: dict[str, Array]
    figures: FreeRunning


def streams_of(
    rig: Rig, sources: Sequence[str | None], tables: Sequence[Path | None], *, colour: bool, fps: float | None
) -> tuple[Stream, Stream]:
    """Return both cameras' frames, from sources as on the command line, or from tables of spots. Raises UsageError."""
    left, right = sources
    if all(tables) and not any(sources):
        read = [_table(path, rig.camera(side)) for path, side in zip(tables, SIDES, strict=True) if path is not None]
        return read[0], read[1]
    if any(tables) or (left is None and right is None):
        raise UsageError(
            "which frames?", cure="Give --left and --right, or --left-spots and --right-spots, one of each camera"
        )
    alone = left or right or ""
    if (left is None or right is None) and not is_recording(alone):
        raise UsageError("one view is missing", cure="Give --left and --right, or one recording for both")
    texts = (left or alone, right or alone)
    live = [text for text in texts if is_live(text)]
    if live:
        raise UsageError(
            f"{live[0]} is a live camera, and views of free-running cameras are put together afterwards",
            cure="Record first: armsight record --left ... --right ... -o wave.mcap, and give --left wave.mcap",
        )
    read = [
        _images(text, side, colour=colour, fps=fps, origin_of=texts[0]) for text, side in zip(texts, SIDES, strict=True)
    ]
    return read[0], read[1]


def runs_free(rig: Rig) -> bool:
    """Tell whether the rig's file says that its cameras do not expose at once."""
    return any(one.rolling or one.delay_s != 0.0 or one.drift_ppm != 0.0 for one in _timing(rig))


def _timing(rig: Rig) -> tuple[CameraTiming, CameraTiming]:
    left, right = rig.timing
    return left or AT_ONCE, right or AT_ONCE


def require_timing(rig: Rig) -> None:
    """Raise UsageError where nothing is known of when the rig's cameras expose."""
    if all(one is None for one in rig.timing):
        raise UsageError(
            "the rig's file says nothing of its cameras' timing",
            consequence="When each view was taken is not known, so views of a moving target cannot be put together",
            cure="Run armsight calibrate timing with 15 s of a waved target, or use --timing pairs",
        )


def measure_free_running(
    setup: Setup, streams: tuple[Stream, Stream], at_s: Array | None, rate_hz: float | None, progress: Progress
) -> FreeRun:
    """Return poses at at_s (k,) in the rig's time, at a steady rate, or (both None) at the times of the left frames.

    Raises UsageError for a target that has no three known lights, NotEnoughData where it was never found, Inconsistent
    where the spots fit no motion of it, Cancelled.
    """
    if setup.target.is_board or not setup.target.model_known or len(setup.model) < 3:
        raise UsageError(
            "free-running cameras need a target of three or more lights of known positions",
            cure="Measure the target first (armsight calibrate target), or use --timing pairs",
        )
    timing = _timing(setup.rig)
    times = [timing[side].rig_time(stream.t_s) for side, stream in enumerate(streams)]
    views, starts = _that_fit(setup, *_follow(setup, streams, times, progress))
    if at_s is None:
        at_s = times[0] if rate_hz is None else np.arange(times[0][0], times[0][-1] + 0.5 / rate_hz, 1.0 / rate_hz)
    seen_s = np.array([view.t_s for view in views])
    all_s, rows = np.unique(np.concatenate([at_s, seen_s]), return_inverse=True)
    states = smooth(setup.packed, setup.model.xyz_m, views, starts, all_s)
    states = [None if lost else one for one, lost in zip(states, _between(all_s, seen_s, starts), strict=True)]
    found = motion_residuals(setup.packed, setup.model.xyz_m, views, [states[k] for k in rows[len(at_s) :]])
    chi2 = found.chi2_per_dof()
    asked = [states[k] for k in rows[: len(at_s)]]
    heights = tuple(setup.rig.camera(side).height for side in SIDES)
    poses = [
        _pose(setup, float(t), state, max(chi2 or 1.0, 1.0), heights, _names(setup, views, seen_s, float(t)))
        for t, state in zip(at_s, asked, strict=True)
    ]
    figures = _figures(setup, views, len(starts), chi2, asked, times)
    residuals = {
        name: np.column_stack([found.view[found.side == side], found.residual_px[found.side == side]])
        for side, name in enumerate(SIDES)
    }
    return FreeRun(poses=poses, views=views, residuals=residuals, figures=figures)


def _that_fit(setup: Setup, views: list[View], starts: list[Start]) -> tuple[list[View], list[Start]]:
    """Return the stretches that a target's motion explains. Raises Inconsistent where that is less than half."""
    seen_s = np.array([view.t_s for view in views])
    at_s, rows = np.unique(seen_s, return_inverse=True)
    states = smooth(setup.packed, setup.model.xyz_m, views, starts, at_s)
    found = motion_residuals(setup.packed, setup.model.xyz_m, views, [states[k] for k in rows])
    kept, begun = fitting_stretches(found, views, starts, MOST_CHI2)
    if len(kept) < 0.5 * len(views):
        times = np.sqrt(found.chi2_per_dof() or np.inf)
        raise _out_of_step(f"the spots are {times:.1f} times further from the target's motion than their noise")
    if np.median([state.jerk for state in states if state is not None] or [0.0]) > MOST_JERK:
        raise _out_of_step("only a target that is knocked all the time would be seen like this")
    return kept, begun


def _out_of_step(cause: str) -> Inconsistent:
    return Inconsistent(
        cause,
        consequence="The poses would be wrong by more than they claim, and none is given",
        cure="Calibrate the timing anew with these cameras, check the target's measures and the rig",
    )


def _follow(
    setup: Setup, streams: Sequence[Stream], times: Sequence[Array], progress: Progress
) -> tuple[list[View], list[Start]]:
    """Return the named views of all frames, and where the target was found. See measure_free_running."""
    follower, total = Follower(setup=setup, timing=_timing(setup.rig)), sum(len(one) for one in times)
    sides = [_timed(stream, t_s, side) for side, (stream, t_s) in enumerate(zip(streams, times, strict=True))]
    for done, (_, side, frame) in enumerate(merge(*sides, key=_when)):
        follower.add(frame, side)
        progress.update(done + 1, total, FOLLOWING)
        if progress.cancelled():
            raise Cancelled(f"stopped after {done + 1} frames", consequence="Nothing was written")
    views, starts = follower.tracks()
    if not starts:
        raise NotEnoughData(
            f"the target was followed in none of the {total} frames: {follower.why}",
            consequence="There is no pose",
            cure="Begin with the target at rest, before a background that is darker than its lights",
        )
    for side, name in enumerate(SIDES):
        seen = follower.unfit[side] + _of_side(views, side)
        if follower.unfit[side] > max(FEW_UNFIT, MOST_UNFIT * seen):
            raise _out_of_step(
                f"{follower.unfit[side]} of the {seen} frames of the {name} camera show lights that do not fit the "
                "motion that the other one sees"
            )
    return views, starts


def _between(t_s: Array, seen_s: Array, starts: Sequence[Start]) -> NDArray[np.bool_]:
    """Tell of times whether they lie before the target was found, or between a stretch that was lost and the next."""
    out = np.asarray(t_s < seen_s[0] - BEFORE_S)
    for start in starts[1:]:
        out |= (t_s > seen_s[start.view - 1]) & (t_s < seen_s[start.view])
    return out


def _when(item: tuple[float, int, AnyFrame]) -> tuple[float, int]:
    return item[:2]


def _timed(stream: Stream, t_s: Array, side: int) -> Iterator[tuple[float, int, AnyFrame]]:
    """Yield the rig's time, the side and the frame with its steady stamp."""
    for t, stamp, frame in zip(t_s.tolist(), stream.t_s.tolist(), stream.read(), strict=True):
        yield t, side, replace(frame, t_s=stamp)


def _table(path: Path, camera: Camera) -> Stream:
    track = read_spot_track(path)
    return Stream(t_s=_steady(track.t_s, str(path)), read=lambda: _spot_frames(track, camera))


def _spot_frames(track: SpotTrack, camera: Camera) -> Iterator[SpotFrame]:
    for k, t_s in enumerate(track.t_s.tolist()):
        rows = np.flatnonzero(track.frame == k)
        spots = Spots.of_centres(track.uv_px[rows], track.covariance_px2[rows])
        yield SpotFrame(t_s=t_s, spots=spots, width=camera.width, height=camera.height)


def _images(text: str, side: str, *, colour: bool, fps: float | None, origin_of: str) -> Stream:
    """Return the frames of a source that can be read again; the first time for its stamps."""

    def read() -> Iterator[Frame]:
        with camera_source(text, side, colour=colour, fps=fps, origin_of=origin_of) as source:
            yield from source

    return Stream(t_s=_steady(np.array([frame.t_s for frame in read()]), side), read=read)


def _steady(stamps_s: Array, where: str) -> Array:
    """Return stamps freed of jitter, as given where they are too few to tell."""
    back = np.flatnonzero(np.diff(stamps_s) <= 0.0)
    if len(back):
        raise Inconsistent(
            f"{where}: the stamp of frame {back[0] + 1}, {stamps_s[back[0] + 1]:g} s, is not after the one before",
            consequence="There is no time for its view",
            cure="Give the frames in the order of time, each with a stamp of its own",
        )
    return stamps_s if len(stamps_s) < FEWEST_FRAMES else steady(stamps_s, where).t_s


def _pose(
    setup: Setup, t_s: float, state: MotionState | None, wider: float, heights: Sequence[int], names: tuple[str, ...]
) -> MovingPose:
    """Return the pose of a state, its uncertainty widened by what the spots do not fit the motion."""
    if state is None:
        return MovingPose(pose=TargetPose(t_s=t_s, status=PoseStatus.LOST, parent="rig", why=GONE))
    systematic = systematic_covariance(setup, state, _timing(setup.rig), heights)
    C = wider * state.covariance + (0.0 if systematic is None else systematic)
    T = state.T_rig_target
    if np.sqrt(np.trace(C[3:, 3:])) > MAX_ROTATION_STD_RAD:
        T[:3, :3] = np.eye(3)
        why = "no view for so long that only the position is known"
        return MovingPose(
            pose=TargetPose(
                t_s=t_s,
                status=PoseStatus.POSITION_ONLY,
                parent="rig",
                spots=names,
                T_parent_target=T,
                covariance=C[:3, :3],
                why=why,
                systematic_covariance=None if systematic is None else systematic[:3, :3],
            )
        )
    pose = TargetPose(
        t_s=t_s,
        status=PoseStatus.OK,
        parent="rig",
        spots=names,
        T_parent_target=T,
        covariance=C,
        systematic_covariance=systematic,
    )
    std = np.sqrt(wider * np.diag(state.velocity_covariance))
    return MovingPose(pose=pose, velocity=state.velocity, velocity_std=std)


def _names(setup: Setup, views: Sequence[View], seen_s: Array, t_s: float) -> tuple[str, ...]:
    """Return the lights seen in the view of each side nearest in time."""
    k = int(np.searchsorted(seen_s, t_s))
    lights: set[int] = set()
    for side in range(2):
        near = [v for v in views[max(k - 4, 0) : k + 4] if v.side == side]
        if near:
            lights |= set(min(near, key=lambda v: abs(v.t_s - t_s)).lights.tolist())
    return tuple(name for i, name in enumerate(setup.model.names) if i in lights)


def _figures(
    setup: Setup,
    views: Sequence[View],
    n_starts: int,
    chi2: float | None,
    states: Sequence[MotionState | None],
    times: Sequence[Array],
) -> FreeRunning:
    left, right = _timing(setup.rig)
    speed = [float(np.linalg.norm(state.velocity[:3])) for state in states if state is not None]
    rms = float(np.sqrt(np.mean(np.square(speed)))) if speed else None
    return FreeRunning(
        delay_s=right.delay_s,
        drift_ppm=right.drift_ppm,
        readout_s=BothSeconds(left=left.readout_s, right=right.readout_s),
        n_views=BothCounts(left=_of_side(views, 0), right=_of_side(views, 1)),
        n_starts=n_starts,
        note=DOUBTFUL if chi2 is not None and chi2 > DOUBTFUL_CHI2 else None,
        chi2_per_dof=chi2,
        speed_m_s=rms,
        nearest_pairs_m=None if rms is None else rms * float(np.sqrt(np.mean(_nearest(*times) ** 2))),
    )


def _of_side(views: Iterable[View], side: int) -> int:
    return sum(view.side == side for view in views)


def _nearest(left_s: Array, right_s: Array) -> Array:
    """Return how far each left frame is from the right frame nearest in time, s."""
    after = np.searchsorted(right_s, left_s).clip(1, max(len(right_s) - 1, 1))
    return np.asarray(
        np.minimum(np.abs(right_s[after - 1] - left_s), np.abs(right_s[after.clip(max=len(right_s) - 1)] - left_s))
    )
