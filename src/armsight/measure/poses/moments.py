"""One moment of any number of cameras -> the target's pose: frames, or nothing of a camera, in the rig's order.

Two cameras that expose at once go their own way, `pipeline.measure_pair`. What other numbers of cameras cannot do is
refused here.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np

from armsight.arrays import Array
from armsight.errors import Inconsistent, Unseen, UsageError
from armsight.measure.poses.board_pose import swapped
from armsight.measure.poses.board_views import measure_board_views
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.kernels import tracking as kernels
from armsight.measure.poses.lone_light import measure_light
from armsight.measure.poses.one_time import apart, measure_apart, rig_times
from armsight.measure.poses.outcome import Measured, Track, lost_moment
from armsight.measure.poses.pipeline import check_sizes, measure_pair
from armsight.measure.poses.pose import TWO
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.shortlist import MOST_UNNAMED
from armsight.measure.poses.tracking import MAX_GAP_S, half_window_px
from armsight.measure.poses.views import measure_views
from armsight.measure.spots import find_candidates, track_spots
from armsight.optics import RigKind
from armsight.records import Frame, NotSeen, PoseStatus, Spots, Target, changed

FEWEST_FOR_ROTATION = 3
"""Lights below which a target shows no rotation."""
IDLE_LOOKS, LOOK_AGAIN = 24, 30
"""Moments, one after the other, in which a camera that took no part is searched as a whole; and then one of so many."""

SWAP_LOOKS = 6
"""Busy pictures at the start, without a pose, that are looked at with left and right exchanged as well."""


def measure_moment(
    setup: Setup, frames: Sequence[Frame | None], track: Track | None = None, whole: Collection[int] = ()
) -> Measured:
    """Return the target's pose from the frames of one moment, None where a camera has none.

    whole: views that are searched as a whole where the others are looked at in windows.

    A light counts that one camera shows, but for a rig of two: see measure_pair. Raises UsageError for a target that
    needs two cameras, where the frames are not one for each camera, and as measure_pair.
    """
    require_views(setup, len(frames))
    there = [frame for frame in frames if frame is not None]
    if not there:
        raise UsageError("a moment without any frame", consequence="It has no time", cure="Leave it out")
    check_sizes(setup.rig, frames)
    if len(frames) == TWO:
        left, right = frames
        if left is None or right is None:
            why = "one of the two cameras has no picture"
            return lost_moment(there[0].t_s, (Spots.none(),) * TWO, NotSeen(why, Unseen.UNREADABLE), track)
        if not _runs_free(setup):
            return measure_pair(setup, left, right, track)
    t_s, late_s = rig_times(setup, frames)
    if setup.target.is_board:
        return measure_board_views(setup, t_s, frames)
    if track is not None and not 0.0 < t_s - track.t_s <= MAX_GAP_S:
        track = None
    measured = None
    if track is not None and track.complete and len(frames) != TWO:
        measured = _by_windows(setup, frames, (t_s, late_s), track, whole)
    if measured is None:
        seen = setup.pace.each(lambda s: _spots(setup, s, frames[s]), len(frames))
        measured = _of_spots(setup, frames, seen, (t_s, late_s), track)
    return measured


def _runs_free(setup: Setup) -> bool:
    """Tell whether the views of a pair are to be brought to one time."""
    by_itself = setup.target.model_known and not setup.target.is_board and len(setup.model) >= 3
    return setup.rig.runs_free and setup.rig.kind is not RigKind.MIRROR and by_itself


def _of_spots(
    setup: Setup,
    frames: Sequence[Frame | None],
    seen: list[Spots],
    when: tuple[float, Array],
    track: Track | None,
    *,
    in_windows: bool = False,
) -> Measured:
    """Return the pose from spots of views, of one time or brought there; when: as rig_times."""
    t_s, late_s = when
    named = setup.target.model_known and len(setup.model) >= 3
    if not named or (len(seen) != TWO and not apart(setup, late_s)):
        return measure_views(setup, t_s, seen, track, frames, in_windows=in_windows)
    # outlines lie where their own frames have them: they are not looked at
    return measure_apart(setup, t_s, seen, late_s, track, in_windows=in_windows)


def measure_chosen(setup: Setup, t_s: float, seen: Sequence[Spots]) -> Measured:
    """Return the pose of a moment by itself from spots of each view, in the rig's order, that the caller chose.

    Raises UsageError as measure_moment.
    """
    require_views(setup, len(seen))
    if len(seen) == TWO:
        return measure_spots(setup, t_s, seen[0], seen[1])
    if len(setup.model) == 1:
        return measure_light(setup, t_s, seen, alone=True)
    return measure_views(setup, t_s, seen)


def require_views(setup: Setup, n: int) -> None:
    """Raise UsageError where n frames are not the rig's, or where other than two cameras cannot measure the target."""
    v = len(setup.rig.cameras)
    if v == TWO and not setup.rig.is_pair:
        first, second = setup.rig.names
        raise UsageError(
            f"the rig's two cameras are called {first} and {second}, and two cameras are measured as left and right",
            cure=f"Write its file anew: armsight convert rig rig.yaml --name {first} --name {second} -o pair.yaml; and "
            f"give {first} as left, {second} as right",
        )
    if n != v:
        raise UsageError(f"{n} frames for a rig of {v} cameras", cure="Give one for each, None where there is none")
    named = setup.target.is_board or (setup.target.model_known and len(setup.model) >= 3)
    if v == 1 and not named:
        raise UsageError(
            "one camera does not place a light by itself: it may be anywhere along its ray",
            consequence="One camera measures boards, and four lights and more at known places",
            cure="Give two cameras and more, a printed board, or a target of four lights and more",
        )


def require_rotation(target: Target, consequence: str) -> None:
    """Raise UsageError for a target that is never seen with a rotation, for what needs whole poses."""
    if not target.is_board and len(target.names) < FEWEST_FOR_ROTATION:
        raise UsageError(
            f"a target of {len(target.names)} light{'s' * (len(target.names) > 1)} shows no rotation, and whole poses "
            "are needed",
            consequence=consequence,
            cure="Give a target of three lights and more, or a printed board",
        )


def _spots(setup: Setup, s: int, frame: Frame | None) -> Spots:
    """Return the spots of a view: all, or the strongest where much is bright."""
    if frame is None:
        return Spots.none()
    found = find_candidates(frame.image, setup.sides[s], setup.pace)
    return found.measure(found.positions() if found.quiet else found.positions(MOST_UNNAMED))


def _by_windows(
    setup: Setup, frames: Sequence[Frame | None], when: tuple[float, Array], track: Track, whole: Collection[int]
) -> Measured | None:
    """Return the pose from what is found in windows around the predicted spots; None where that is too little.

    Windows are where a light is expected inside a picture: what is not found there need not be, it may be hidden, and
    what is found may be another light's. So the spots are named as those of whole pictures are.
    """
    n, v, (t_s, late_s) = len(track.names), len(frames), when
    at = np.empty((v, n, 2))
    for late in set(late_s.tolist()):
        of = late_s == late
        at[of] = _predicted(setup, track, t_s - track.t_s + late)[of]

    last = np.array([[one.camera.width - 1.0, one.camera.height - 1.0] for one in setup.rig.cameras])
    inside = np.asarray(((at > 0.0) & (at < last[:, None])).all(axis=2))

    def look(s: int) -> Spots:
        frame = frames[s]
        if frame is None or s in whole:
            return _spots(setup, s, frame)
        near = at[s][inside[s]]
        return track_spots(frame.image, near, track.half_window_px, setup.sides[s])[0] if len(near) else Spots.none()

    seen = setup.pace.each(look, v)
    measured = _of_spots(setup, frames, seen, when, track, in_windows=True)
    if measured.pose.status is not PoseStatus.OK or measured.track is None or measured.sights is None:
        return None
    lights, innovation = np.array([track.names.index(name) for name in measured.names]), 0.0
    at = _predicted(setup, track, t_s - track.t_s)
    for s, spots in enumerate(measured.spots):
        if len(spots):
            there = np.ascontiguousarray(at[s][lights[measured.sights[:, s]]])
            innovation = max(innovation, kernels.largest_innovation(spots.uv_px, there))
    window = half_window_px(measured.spots, innovation)
    return changed(measured, tracked=True, track=changed(measured.track, half_window_px=window))


def _predicted(setup: Setup, track: Track, after_s: float) -> Array:
    """Return where the lights of a track are expected (v, n, 2) some time after it."""
    n = len(track.names)
    predicted, at = np.empty((n, 3)), np.empty((len(setup.packed.k), n, 2))
    kernels.predict_views(setup.packed.arrays, track.xyz_m, track.velocity_m_s, after_s, predicted, at)
    return at


# A target followed over moments: each tells the next where to look, and what shows nothing is lost.


class TargetTracker:
    """Measures moment after moment. track: where the lights are looked for next; swapped: of the latest moment, where
    the views of a pair look exchanged, which one moment cannot decide. without: cameras that are not looked at."""

    def __init__(self, setup: Setup) -> None:
        self._setup = setup
        self.track: Track | None = None
        self.swapped: Inconsistent | None = None
        self.without: tuple[str, ...] = ()
        self._idle = [0] * len(setup.rig.cameras)
        self._looks = SWAP_LOOKS

    def take(self, *frames: Frame | None) -> Measured:
        """Return what is measured; a pose that is lost, with the reason, where a frame cannot be read or the views look
        exchanged. Of other cameras than two a frame that cannot be read is a missing view. Raises Inconsistent where a
        frame is not of the size of the rig's camera, UsageError as measure_moment."""
        check_sizes(self._setup.rig, frames)
        self.swapped = None
        broken = [frame for frame in frames if frame is not None and frame.unreadable]
        seen = [
            None if frame is None or frame.unreadable or name in self.without else frame
            for name, frame in zip(self._setup.rig.names, frames, strict=True)
        ]
        if broken and (len(frames) == TWO or not any(seen)):
            measured = lost_frames(frames, f"{broken[0].source}: {broken[0].unreadable}", Unseen.UNREADABLE)
        elif not any(seen):
            measured = lost_frames(frames, "no camera has a picture", Unseen.UNREADABLE)
        else:
            whole = [s for s, n in enumerate(self._idle) if 0 < n <= IDLE_LOOKS or n % LOOK_AGAIN == LOOK_AGAIN - 1]
            try:
                measured = measure_moment(self._setup, seen, self.track, whole)
                self._refuse_swapped(measured, seen)
            except Inconsistent as error:
                self.swapped = error
                measured = lost_frames(frames, error.cause, Unseen.SWAPPED)
            self._idle = [0 if len(one) else n + 1 for one, n in zip(measured.spots, self._idle, strict=True)]
        self.track = measured.track
        return measured

    def _refuse_swapped(self, measured: Measured, seen: Sequence[Frame | None]) -> None:
        """Raise Inconsistent where a pair shows the target among much that is bright only with its views exchanged.

        Which of it is measured is chosen for one order of the views, so that its spots tell nothing of the other.
        """
        if measured.pose.status is PoseStatus.OK:
            self._looks = 0
        left, right = (*seen, None, None)[:TWO]
        if not (self._looks and measured.busy and left is not None and right is not None):
            return
        self._looks -= 1
        alike = left.image.shape[:2] == right.image.shape[:2]
        if alike and measure_pair(self._setup, right, left).pose.status is PoseStatus.OK:
            raise swapped()


def lost_frames(frames: Sequence[Frame | None], why: str, cause: Unseen = Unseen.OTHER) -> Measured:
    """Return the record of a moment that gave nothing."""
    t_s = float(np.mean([frame.t_s for frame in frames if frame is not None]))
    return lost_moment(t_s, (Spots.none(),) * len(frames), NotSeen(why, cause))
