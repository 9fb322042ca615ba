"""What one moment of both cameras gave, and what the next one may expect."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Unseen
from armsight.measure.motion.estimate import MotionFilter
from armsight.records import NotSeen, Points, Spots, TargetPose, frozen_array

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Track:
    """Where the lights were and how fast: hand it to the next call.

    names: of the lights; xyz_m, velocity_m_s (n, 3) in rig axes at t_s. whole_t_s: when all of the target's lights were
    last placed. complete: all of them were seen at t_s, so that windows around the predictions may replace the
    search of the whole frame. half_window_px: of these windows. motion: what the poses before say of the next one; None
    where there was none of a target of known geometry. doubted: the latest pose was refused because it does not go on
    from the motion; the next one is believed.
    """

    t_s: float
    whole_t_s: float
    names: tuple[str, ...]
    xyz_m: Array
    velocity_m_s: Array
    half_window_px: int
    complete: bool
    motion: MotionFilter | None = None
    doubted: bool = False

    def __post_init__(self) -> None:
        n = len(self.names)
        object.__setattr__(self, "xyz_m", frozen_array("xyz_m", self.xyz_m, (n, 3)))
        object.__setattr__(self, "velocity_m_s", frozen_array("velocity_m_s", self.velocity_m_s, (n, 3)))

    def predict(self, t_s: float) -> Array:
        """Return the lights' positions (n, 3) at t_s: constant velocity."""
        return np.asarray(self.xyz_m + (t_s - self.t_s) * self.velocity_m_s)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """Everything found in one pair of frames.

    points: in rig axes, each triangulated by itself. left, right: the matched spots, in the order of names.
    left_seen, right_seen: all that were found (in the windows only, where tracked). track: for the next call.
    alternatives: the poses of all assignments that fit, where names are ambiguous. notes: what was left out, and why.
    busy: more than lights was bright, and the spots were chosen from many candidates. cause: of a pose that is not
    whole, as far as something of its own helps against it; the pose has the words.
    """

    pose: TargetPose
    points: Points
    left: Spots
    right: Spots
    names: tuple[str, ...]
    left_seen: Spots
    right_seen: Spots
    track: Track | None = None
    alternatives: tuple[TargetPose, ...] = ()
    notes: tuple[str, ...] = ()
    tracked: bool = False
    busy: bool = False
    cause: Unseen = Unseen.OTHER

    @property
    def missed(self) -> NotSeen:
        """Why the pose is not whole."""
        return NotSeen(self.pose.why, self.cause)
