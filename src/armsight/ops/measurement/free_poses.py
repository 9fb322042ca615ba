"""What the states of a moving target, seen by cameras that no wire joins, are as poses and figures."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from armsight.arrays import Array
from armsight.errors import Unseen
from armsight.fitting.quantiles import chi2_isf
from armsight.measure.consistency.check import DOUBT, MovingCheck, finalise
from armsight.measure.consistency.diagnosis import INCONSISTENT_M, INCONSISTENT_RAD
from armsight.measure.follow import systematic_covariance
from armsight.measure.motion.states import MotionState, TimingEstimate, View
from armsight.measure.poses.setup import Setup
from armsight.measure.results import FreeCamera, FreeRunning
from armsight.ops.measurement.streams import timing_of
from armsight.records import CameraTiming, PoseStatus, TargetPose
from armsight.records.camera import PPM
from armsight.records.result_parts import BothCounts, BothSeconds
from armsight.units import MS

MAX_POSITION_STD_M, MAX_ROTATION_STD_RAD = 0.05, 0.3
"""A position or a rotation less certain than this is none."""
DOUBTFUL_CHI2 = 1.5
"""Chi-square per degree of freedom of the spots about the motion from which it is doubted: cameras' noise is off by up
to a factor of two."""
DOUBTFUL = (
    "the spots lie further from the target's motion than their noise: the timing, the rig or the target's measures are "
    "off, and the poses may be by more than they claim"
)
OTHER_TIMING = (
    "the delay between the cameras is no longer what was calibrated, and the poses may be off by more than they claim; "
    "calibrate the timing anew: this recording's own differs"
)
TIMING_CHANCE = 1e-5
"""Chance below which what a recording says of its timing is not what was calibrated."""
SURPRISING = 0.01
"""Chance from which on what is left open of the timing is as much wider as the recording's own is surprising."""
TOO_LITTLE = "too few lights were seen about that time to say where the target was"
GONE = "the target was lost or not found yet, no camera saw three of its lights, or its spots left its motion"
OLD = "no view for so long that only the position is known"
KINDS = {TOO_LITTLE: Unseen.LIGHTS_MISSING, GONE: Unseen.GAP, OLD: Unseen.GAP, DOUBT: Unseen.INCONSISTENT}
"""Kind of each reason, as files count them."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MovingPose:
    """A pose with the velocity (6,) of the target and its standard deviations; None where there is no whole pose."""

    pose: TargetPose
    velocity: Array | None = None
    velocity_std: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseBuilder:
    """Turns states into poses: their uncertainty widened by what the spots do not fit the motion, and with what rig,
    target and timing leave open, and may have wrong by the check of the views, which are of seen_s.

    first_clock: covariance of the clock that the poses' times are of. doubted: the run does not fit its claims.
    """

    setup: Setup
    wider: float
    timing: TimingEstimate | None
    first_clock: Callable[[float], Array]
    check: MovingCheck
    seen_s: Array
    doubted: bool

    def pose(self, t_s: float, state: MotionState | None, names: tuple[str, ...]) -> MovingPose:
        """Return the pose of a state at t_s, seen by the lights of these names."""
        if state is None:
            return MovingPose(pose=TargetPose(t_s=t_s, status=PoseStatus.LOST, parent="rig", why=GONE))
        systematic = self._systematic(state)
        C = self.wider * state.covariance + systematic
        T = state.T_rig_target
        if np.sqrt(np.trace(C[:3, :3])) > MAX_POSITION_STD_M:
            return MovingPose(pose=TargetPose(t_s=t_s, status=PoseStatus.LOST, parent="rig", why=TOO_LITTLE))
        if np.sqrt(np.trace(C[3:, 3:])) > MAX_ROTATION_STD_RAD:
            T[:3, :3] = np.eye(3)
            return MovingPose(
                pose=TargetPose(
                    t_s=t_s,
                    status=PoseStatus.POSITION_ONLY,
                    parent="rig",
                    spots=names,
                    T_parent_target=T,
                    covariance=C[:3, :3],
                    why=OLD,
                    systematic_covariance=systematic[:3, :3],
                    origin_known=True,
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
        std = np.sqrt(self.wider * np.diag(state.velocity_covariance))
        return MovingPose(pose=finalise(pose, inconsistent=self.doubted), velocity=state.velocity, velocity_std=std)

    def _systematic(self, state: MotionState) -> Array:
        """Return the covariance (6, 6) of what repeats from pose to pose."""
        v = state.velocity
        out = float(self.first_clock(state.t_s)[0, 0]) * np.outer(v, v)
        if self.timing is not None:
            D = state.by_timing[:6]
            excess = self.timing.mahalanobis2 / float(chi2_isf(SURPRISING, len(self.timing.change)))
            out += max(excess, 1.0) * (D @ self.timing.covariance @ D.T)
        fault = self.check.verdict.second_moment
        if fault is not None:
            S = self.check.slopes[np.abs(self.seen_s - state.t_s).argmin()]
            out += S @ fault @ S.T
        fixed = systematic_covariance(self.setup, state)
        return out if fixed is None else out + fixed


def lights_near(setup: Setup, views: Sequence[View], seen_s: Array, t_s: float) -> tuple[str, ...]:
    """Return the lights seen in the view of each camera nearest in time."""
    k, v = int(np.searchsorted(seen_s, t_s)), len(setup.rig.cameras)
    lights: set[int] = set()
    for side in range(v):
        near = [one for one in views[max(k - 2 * v, 0) : k + 2 * v] if one.side == side]
        if near:
            lights |= set(min(near, key=lambda one: abs(one.t_s - t_s)).lights.tolist())
    return tuple(name for i, name in enumerate(setup.model.names) if i in lights)


def figures_of(
    setup: Setup,
    timing: TimingEstimate | None,
    views: Sequence[View],
    n_starts: int,
    chi2: float | None,
    states: Sequence[MotionState | None],
    times: Sequence[Array],
) -> FreeRunning:
    """Return the figures of a run by its smoothed states, all views and the cameras' frame times (n,) each."""
    speed = [float(np.linalg.norm(state.velocity[:3])) for state in states if state is not None]
    rms = float(np.sqrt(np.mean(np.square(speed)))) if speed else None
    clocks = dict(zip(setup.rig.names, _clocks(timing_of(setup.rig), timing, views), strict=True))
    note = DOUBTFUL if chi2 is not None and chi2 > DOUBTFUL_CHI2 else None
    if note is None and contradicts(timing, states):
        late = max(clocks.values(), key=lambda one: abs(one.delay_change_s) / (one.delay_std_s or np.inf))
        note = f"{OTHER_TIMING} by {late.delay_change_s / MS:+.2f} ms"
    pair = clocks if setup.rig.is_pair else {}
    second = pair.get("right")
    first, *others = [one for one in times if len(one)]
    apart = np.concatenate([np.empty(0), *(_nearest(first, other) for other in others)])
    return FreeRunning(
        delay_s=second.delay_s if second else None,
        drift_ppm=second.drift_ppm if second else None,
        readout_s=BothSeconds(**{name: one.readout_s for name, one in pair.items()}) if pair else None,
        delay_change_s=second.delay_change_s if second else None,
        delay_std_s=second.delay_std_s if second else None,
        n_views=BothCounts(**{name: one.n_views for name, one in pair.items()}) if pair else None,
        by_camera=None if pair else clocks,
        n_starts=n_starts,
        note=note,
        chi2_per_dof=chi2,
        speed_m_s=rms,
        nearest_pairs_m=rms * float(np.sqrt(np.mean(apart**2))) if rms is not None and len(apart) else None,
    )


def _clocks(
    cameras: Sequence[CameraTiming], timing: TimingEstimate | None, views: Sequence[View]
) -> Iterator[FreeCamera]:
    """Yield what each camera's clock is by its file and by this recording's views."""
    v = len(cameras)
    change, mid_s = (np.zeros(3 * v - 2), 0.0) if timing is None else (timing.change, timing.prior.mid_s)
    for k, one in enumerate(cameras):
        late, drift = change[2 * k - 2 : 2 * k].tolist() if k else (0.0, 0.0)
        known = timing is not None and k > 0
        yield FreeCamera(
            delay_s=one.delay_s + late - PPM * drift * mid_s,
            drift_ppm=one.drift_ppm + drift,
            readout_s=one.readout_s + float(change[2 * v - 2 + k]),
            delay_change_s=late,
            delay_std_s=float(np.sqrt(timing.covariance[2 * k - 2, 2 * k - 2])) if known and timing else None,
            n_views=n_of_side(views, k),
        )


def contradicts(timing: TimingEstimate | None, states: Sequence[MotionState | None]) -> bool:
    """Tell whether what a recording says of its timing is beyond chance not what was calibrated, and moves the poses.

    By as much as a fault of rig or target must before a run is called inconsistent.
    """
    moved = [state.by_timing[:6] @ timing.change for state in states if state is not None] if timing else []
    if timing is None or not moved or not timing.mahalanobis2 > chi2_isf(TIMING_CHANCE, len(timing.change)):
        return False
    square = np.mean(np.square(moved), axis=0)
    return bool(square[:3].sum() > INCONSISTENT_M**2 or square[3:].sum() > INCONSISTENT_RAD**2)


def n_of_side(views: Iterable[View], side: int) -> int:
    """Return how many views are of a camera."""
    return sum(view.side == side for view in views)


def _nearest(left_s: Array, right_s: Array) -> Array:
    """Return how far each left frame is from the right frame nearest in time, s."""
    after = np.searchsorted(right_s, left_s).clip(1, max(len(right_s) - 1, 1))
    return np.asarray(
        np.minimum(np.abs(right_s[after - 1] - left_s), np.abs(right_s[after.clip(max=len(right_s) - 1)] - left_s))
    )
