"""What one moment of both cameras gave, what the next one may expect, and what the lights may be called."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from armsight.arrays import Array, Index, Mask
from armsight.errors import Unseen
from armsight.measure.motion.estimate import MotionFilter
from armsight.measure.poses.pose import lost, no_points
from armsight.measure.poses.setup import TargetModel
from armsight.records import NotSeen, Points, PoseStatus, Spots, TargetPose, freeze


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
        freeze(self, xyz_m=(n, 3), velocity_m_s=(n, 3))

    def predict(self, t_s: float) -> Array:
        """Return the lights' positions (n, 3) at t_s: constant velocity."""
        return np.asarray(self.xyz_m + (t_s - self.t_s) * self.velocity_m_s)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Measured:
    """Everything found at one moment, by view in the rig's order.

    points: in rig axes, each triangulated by itself; a light that one view alone shows has none. spots: the matched
    ones of each view, in the order of names; sights (n, v): which view shows which light, None where each shows all.
    seen: all that were found (in the windows only, where tracked). track: for the next call.
    alternatives: the poses of all assignments that fit, where names are ambiguous. notes: what was left out, and why.
    busy: more than lights was bright, and the spots were chosen from many candidates. cause: of a pose that is not
    whole, as far as something of its own helps against it; the pose has the words.
    """

    pose: TargetPose
    points: Points
    spots: tuple[Spots, ...]
    names: tuple[str, ...]
    seen: tuple[Spots, ...]
    sights: Mask | None = None
    track: Track | None = None
    alternatives: tuple[TargetPose, ...] = ()
    notes: tuple[str, ...] = ()
    tracked: bool = False
    busy: bool = False
    cause: Unseen = Unseen.OTHER

    @property
    def left(self) -> Spots:
        """The matched spots of a pair's left view."""
        return self.spots[0]

    @property
    def right(self) -> Spots:
        """The matched spots of a pair's right view."""
        return self.spots[1]

    @property
    def left_seen(self) -> Spots:
        """All spots of a pair's left view."""
        return self.seen[0]

    @property
    def right_seen(self) -> Spots:
        """All spots of a pair's right view."""
        return self.seen[1]

    def names_in(self, s: int) -> tuple[str, ...]:
        """Return the names of the lights that view s shows, in the order of its spots."""
        if self.sights is None:
            return self.names
        return tuple(name for name, there in zip(self.names, self.sights[:, s].tolist(), strict=True) if there)

    def residuals_px(self, s: int) -> Array:
        """Return the residuals (n, 2) of view s, model minus measured, in the order of its spots."""
        if self.sights is None:
            return self.pose.residual_px.reshape(-1, len(self.spots), 2)[:, s]
        views = np.nonzero(self.sights)[1]
        return np.asarray(self.pose.residual_px.reshape(-1, 2)[views == s])

    def judged_px(self, s: int) -> Array:
        """Return of the residuals of view s those by which a run is judged: see judged_by."""
        residuals = self.residuals_px(s)
        counts = judged_by(self.spots[s].covariance_px2)
        return residuals[counts] if len(residuals) == len(counts) else residuals

    @property
    def missed(self) -> NotSeen:
        """Why the pose is not whole."""
        return NotSeen(self.pose.why, self.cause)


JUDGED_PX = 1.0
"""Standard deviation up to which a sight counts for what a run leaves, as its user reads it: half-hidden lights claim
some px, leave as many where all is right, and weigh a thousandth of a whole one in the pose."""


def judged_by(covariance_px2: Array) -> Mask:
    """Return which sights of covariance_px2 (n, 2, 2) are known to JUDGED_PX in their worst direction."""
    uu, uv, vv = covariance_px2[:, 0, 0], covariance_px2[:, 0, 1], covariance_px2[:, 1, 1]
    return np.asarray(0.5 * (uu + vv) + np.hypot(0.5 * (uu - vv), uv) <= JUDGED_PX**2)


def lost_moment(t_s: float, seen: tuple[Spots, ...], missed: NotSeen, track: Track | None = None) -> Measured:
    """Return a lost moment; the track, as old as it is, may still help the next one."""
    return Measured(
        pose=lost(t_s, missed.why),
        points=no_points(),
        spots=(Spots.none(),) * len(seen),
        names=(),
        seen=seen,
        track=track,
        cause=missed.cause,
    )


def doubted(measured: Measured) -> Measured:
    """Return what was measured; doubtful where the spots fit the target by far not as well as they claim."""
    if measured.pose.status is not PoseStatus.OK or measured.cause is not Unseen.BEYOND_CLAIMS:
        return measured
    why = "the spots fit the target, but by far not as well as they claim"
    return replace(measured, pose=replace(measured.pose, status=PoseStatus.DOUBTFUL, why=why))


PREDICTION_RATIO = 3.0
"""A prediction decides between assignments where the next one is this many times further from it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Assignment:
    """One hypothesis: names, the pair that each is (rows of Pairs), its chi-square, and the pose behind it.

    R (3, 3), t_m (3,): T_rig_target of the fit with slack; None for lights without a measured arrangement.
    """

    names: tuple[str, ...]
    pair: Index
    chi2: float
    R: Array | None = None
    t_m: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Prediction:
    """Where the lights are expected: xyz_m (m, 3) in rig axes, NaN where nothing is known; within_m: how far off it
    may be; turned_m: how far off each light may be from the others, by the target's turning. It breaks ties, and only
    between assignments of which one is that near."""

    xyz_m: Array
    within_m: float
    turned_m: float = float("inf")

    def _far_m(self, model: TargetModel, a: Assignment) -> float:
        """Return the root mean square distance of the lights from where they are expected."""
        if a.R is None or a.t_m is None or not np.isfinite(self.xyz_m).any():
            return float("inf")
        return float(np.sqrt(np.nanmean(((model.xyz_m @ a.R.T + a.t_m) - self.xyz_m) ** 2) * 3.0))

    def _turned_far(self, model: TargetModel, a: Assignment) -> bool:
        """Whether a light is further from its place among the others than the target can have turned."""
        if a.R is None or a.t_m is None or np.isfinite(self.xyz_m[:, 0]).sum() < 2:
            return False
        off = model.xyz_m @ a.R.T + a.t_m - self.xyz_m
        return bool(np.nanmax(np.linalg.norm(off - np.nanmean(off, axis=0), axis=1)) > self.turned_m)

    def holds(self, model: TargetModel, a: Assignment) -> bool:
        """Whether an assignment is where the lights are expected."""
        return self._far_m(model, a) <= self.within_m and not self._turned_far(model, a)

    def choice(self, model: TargetModel, found: list[Assignment]) -> Assignment | None:
        """Return the assignment that is as expected where the next one is much further off."""
        far = np.array([self._far_m(model, a) for a in found])
        order = np.argsort(far)
        first = far[order[0]]
        if first <= self.within_m and far[order[1]] > PREDICTION_RATIO * first:
            return found[int(order[0])]
        return None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Match:
    """The assignment that holds, or none, why and by which cause; alternatives that fit as well.

    predicted: it is where it was expected. chance: expected number of others that fit as well by chance.
    """

    best: Assignment | None
    alternatives: tuple[Assignment, ...] = ()
    why: str = ""
    predicted: bool = False
    chance: float = 0.0
    cause: Unseen = Unseen.OTHER

    @property
    def missed(self) -> NotSeen:
        """Why no assignment holds."""
        return NotSeen(self.why, self.cause)
