"""What the residuals of a run say about its setup, summed frame by frame in bounded memory."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from math import sqrt
from statistics import median

import numpy as np

from armsight.arrays import Array, Index
from armsight.measure.consistency import kernels
from armsight.measure.poses.outcome import Measured
from armsight.measure.poses.pose import stack_spots
from armsight.measure.poses.setup import Setup, n_parameters
from armsight.measure.poses.tracking import positions_of
from armsight.optics import PackedRig
from armsight.records import frozen_array

MOST_LIGHTS = 12
"""Lights up to which each one's place is a parameter; of larger targets and boards only the scale is."""

MAX_GAP_S = 0.2
"""Frames further apart than this tell no velocity."""

BIAS_PX = 0.02
"""What a spot's centre keeps of its place within the pixel and does not lose by averaging, at least."""

STILL_PX, STRAY = 1.0, 4.0
"""Lights that moved less than this since they were first seen there stand still, or less than so many of their standard
deviations: a light half hidden scatters by pixels."""

OUTLIER = 3.0
"""A frame whose chi-square is this many times the usual one counts less, by the square of what is beyond: a spot far
beyond its claim is no fault of rig or target. One of 240 that was off by 0.54 px and claimed 0.037 had a camera moved
by 0.094 +- 0.053 degrees, over a true rig."""

WINDOW = 9
"""Frames over whose median the usual chi-square is taken, as many before the frame as behind it: a median follows a
lasting change at once, and passes over what is stray in up to four of them."""

HALF = WINDOW // 2

BLOCKS = 16
"""Stretches of the run that are kept apart, so that a change shows; when full, neighbours are merged."""

FINE = 4
"""Parts of a stretch that are kept apart where a change is dated within it: single frames at first."""


class StillLights:
    """What one more look at lights is worth that have not moved since they were first seen there.

    They are looks at one and the same error: n count n / (1 + n bias^2 / sigma^2). What is claimed is mostly bias, of
    an edge behind the light or a light half hidden, where the scatter is 0.03 px: in rendered rooms the bias of lights
    at rest is 0.7 of the claim (RMS), over claims from 0.014 to 1.3 px. A light that comes or goes moves no other.
    """

    def __init__(self, lights: int, views: int) -> None:
        self._uv_px = np.full((lights, views, 2), np.nan)
        self._looks = np.zeros((lights, views))

    def weight(self, lights: Index, uv_px: Array, cov_px2: Array) -> float:
        """Return the worth, 0 to 1, of pixels (n, views, 2) of lights (n,) with covariances; NaN: not seen."""
        seen = np.isfinite(uv_px[..., 0]) & np.isfinite(cov_px2[..., 0, 0])
        variance = 0.5 * (cov_px2[..., 0, 0] + cov_px2[..., 1, 1])
        way = np.abs(self._uv_px[lights] - uv_px).max(axis=2)
        if (seen & (way > np.maximum(STILL_PX, STRAY * np.sqrt(np.where(seen, variance, 1.0))))).any():
            self._uv_px[:], self._looks[:] = np.nan, 0.0
        rows, views = np.nonzero(seen)
        at = (lights[rows], views)
        new = np.isnan(self._uv_px[at][:, 0])
        self._uv_px[at] = np.where(new[:, None], uv_px[rows, views], self._uv_px[at])
        worth = 1.0 / (1.0 + self._looks[at] * np.maximum(1.0, BIAS_PX**2 / variance[rows, views])) ** 2
        self._looks[at] += 1.0
        return float(worth.mean())


@dataclass(slots=True, eq=False)
class Block:
    """Sums over a stretch of the run that began at start_s; information (q, q) and score (q,) of all parameters."""

    start_s: float
    information: Array
    score: Array
    chi2: float = 0.0
    dof: float = 0.0
    frames: int = 0

    def add(self, other: Block) -> None:
        """Take what another stretch holds."""
        self.information += other.information
        self.score += other.score
        self.chi2 += other.chi2
        self.dof += other.dof
        self.frames += other.frames


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """One frame with a complete pose: lights (n,) as rows of the model, their pixels and residuals, positions (m, 3).

    [light, view] are of the rig by which it is judged (rig_of). claimed: what the pose's covariance says, trace of the
    position and of the rotation.
    """

    t_s: float
    lights: Index
    T: Array
    uv_px: Array
    cov_px2: Array
    residual_px: Array
    positions_m: Array
    claimed: tuple[float, float]


@dataclass(frozen=True, slots=True, eq=False)
class FrameStatistics:
    """A frame's own sums: time, chi-square, degrees of freedom, N (q, q), b (q,), and what one more look is worth."""

    t_s: float
    chi2: float
    dof: float
    information: Array
    score: Array
    weight: float


@dataclass(slots=True, eq=False)
class Evidence:
    """The sums. basis (m, 3, p): how the lights' positions follow the target's p parameters; size q: of all parameters.

    rig: see rig_of.
    shift_m2, shift_rad2 (q, q): x' shift x is the sum over frames of the squared move of the position (rotation) that
    an error x of the parameters makes. claimed_m2, claimed_rad2: sums of the claimed variances.
    residual_px2: sum of the squared 2-D residuals, of which there are so many.
    """

    setup: Setup
    basis: Array
    rig: PackedRig
    blocks: list[Block] = field(default_factory=list)
    shift_m2: Array = field(init=False)
    shift_rad2: Array = field(init=False)
    claimed_m2: float = 0.0
    claimed_rad2: float = 0.0
    residual_px2: float = 0.0
    residuals: int = 0
    frames: int = 0
    _per_block: int = field(init=False)
    _before: Frame | None = None
    _last: Frame | None = None
    _still: StillLights = field(init=False)
    _window: deque[FrameStatistics] = field(default_factory=lambda: deque(maxlen=WINDOW))
    _waiting: int = 0

    def __post_init__(self) -> None:
        q = n_parameters(self.rig) + int(self.basis.shape[2]) + len(self.rig.k) - 1
        self.shift_m2, self.shift_rad2 = np.zeros((q, q)), np.zeros((q, q))
        self._still = StillLights(len(self.basis), len(self.rig.k))
        self._per_block = 4 // self.fine

    @classmethod
    def of(cls, setup: Setup) -> Evidence:
        """Return the empty sums of a setup."""
        return cls(setup, target_basis(setup), rig_of(setup))

    @property
    def fine(self) -> int:
        """How many of the blocks are a stretch: of a pair, which knows but one camera that moved, each is one."""
        return 1 if self.setup.rig.is_pair else FINE

    @property
    def size(self) -> int:
        """How many parameters there are."""
        return len(self.shift_m2)

    def add(self, measured: Measured) -> None:
        """Take one moment, in the order of time. A frame is counted when the next one has told how fast it moved."""
        frame = frame_of(self.setup, measured)
        if self._last is not None:
            self._count(self._last, velocity_of(self._before, self._last, frame))
        self._before, self._last = (self._last, frame) if frame is not None else (None, None)

    def finish(self) -> None:
        """Count the last frame."""
        if self._last is not None:
            self._count(self._last, velocity_of(None, self._last, None))
        self._before = self._last = None
        self._weigh(0)

    def slopes(self, frame: Frame, velocity: Array) -> tuple[float, Array, Array, Array, Array] | None:
        """Return chi-square, N (q, q), b (q,), S (6, q) and the covariance (6, 6) by the spots' noise of a frame."""
        N, b, S = np.empty((self.size, self.size)), np.empty(self.size), np.empty((6, self.size))
        C = np.empty((6, 6))
        chi2 = kernels.frame_evidence(
            self.rig.arrays,
            (self.setup.model.xyz_m[frame.lights], self.basis[frame.lights]),
            frame.T,
            frame.cov_px2,
            frame.residual_px,
            velocity[frame.lights],
            N,
            b,
            S,
            C,
        )
        return None if chi2 < 0.0 else (chi2, N, b, S, C)

    def backward(self, frame: Frame) -> Array:
        """Return the velocities (m, 3) of a frame that comes after the last one added before it."""
        before = self._before
        if before is None or not 0.0 < frame.t_s - before.t_s <= MAX_GAP_S:
            return np.zeros_like(frame.positions_m)
        return np.asarray((frame.positions_m - before.positions_m) / (frame.t_s - before.t_s))

    def _count(self, frame: Frame, velocity: Array) -> None:
        found = self.slopes(frame, velocity)
        if found is None:
            return
        chi2, N, b, S, _ = found
        dof = 2.0 * int(np.isfinite(frame.cov_px2[..., 0, 0]).sum()) - 6.0
        if dof <= 0.0:
            return
        worth = self._still.weight(frame.lights, frame.uv_px, frame.cov_px2)
        seen = FrameStatistics(frame.t_s, chi2, dof, N, b, worth)
        self.shift_m2 += S[:3].T @ S[:3]
        self.shift_rad2 += S[3:].T @ S[3:]
        self.claimed_m2 += frame.claimed[0]
        self.claimed_rad2 += frame.claimed[1]
        self.residual_px2 += float((frame.residual_px**2).sum())
        self.residuals += int(0.5 * dof) + 3
        self.frames += 1
        self._window.append(seen)
        self._waiting += 1
        if len(self._window) == WINDOW:
            self._weigh(HALF)

    def _weigh(self, behind: int) -> None:
        """Add the waiting frames but the last so many to their stretches, less where their chi-square is unusual."""
        if not self._window:
            return
        usual = max(median([seen.chi2 / seen.dof for seen in self._window]), 1.0)
        frames = list(self._window)
        for seen in frames[len(frames) - self._waiting : len(frames) - behind]:
            self._add(seen, usual * seen.dof)
        self._waiting = behind

    def _add(self, seen: FrameStatistics, usual: float) -> None:
        """Add a frame to its stretch, less where its chi-square is beyond the usual one."""
        weight = seen.weight * min(1.0, OUTLIER * usual / max(seen.chi2, usual)) ** 2
        block = self._block(seen.t_s)
        block.information += weight * seen.information
        block.score += weight * seen.score
        block.chi2 += weight * seen.chi2
        block.dof += weight * seen.dof
        block.frames += 1

    def _block(self, t_s: float) -> Block:
        if self.blocks and self.blocks[-1].frames < self._per_block:
            return self.blocks[-1]
        if len(self.blocks) == BLOCKS * self.fine:
            for first, second in zip(self.blocks[::2], self.blocks[1::2], strict=True):
                first.add(second)
            self.blocks = self.blocks[::2]
            self._per_block *= 2
        self.blocks.append(Block(t_s, np.zeros((self.size, self.size)), np.zeros(self.size)))
        return self.blocks[-1]


def rig_of(setup: Setup) -> PackedRig:
    """Return the rig by whose parameters a run is judged: a pair itself, the left camera held.

    Of any other the poses of all cameras may be wrong, and none is held: a camera that sees nothing stands before them.
    """
    rig = setup.packed
    if setup.rig.is_pair:
        return rig
    v = len(rig.k) + 1
    return PackedRig(
        k=frozen_array("k", rig.k[[0, *range(v - 1)]], (v, None)),
        R=frozen_array("R", rig.R[[0, *range(v - 1)]], (v, 3, 3)),
        t=frozen_array("t", rig.t[[0, *range(v - 1)]], (v, 3)),
        baseline=rig.baseline,
        covariance=rig.covariance,
    )


def target_basis(setup: Setup) -> Array:
    """Return (m, 3, p): every coordinate of every light, or, for many lights and for boards, the scale alone."""
    X = setup.model.xyz_m
    if setup.target.is_board or len(X) > MOST_LIGHTS:
        return np.ascontiguousarray(X[:, :, None])
    return np.eye(3 * len(X)).reshape(len(X), 3, 3 * len(X))


def frame_of(setup: Setup, measured: Measured) -> Frame | None:
    """Return what a moment with a complete pose of a measured target says; None for any other."""
    pose = measured.pose
    if pose.status.size < 6 or pose.T_parent_target is None or pose.covariance is None:
        return None
    if not setup.target.model_known:
        return None
    names = setup.model.names
    if measured.names == names:
        lights = np.arange(len(names))
    else:
        index_of = {name: i for i, name in enumerate(names)}
        lights = np.array([index_of[name] for name in measured.names])
    uv, cov, residual = _views(setup, measured)
    variances = np.diag(pose.covariance)
    return Frame(
        t_s=pose.t_s,
        lights=lights,
        T=np.array(pose.T_parent_target),
        uv_px=uv,
        cov_px2=cov,
        residual_px=residual,
        positions_m=positions_of(setup, pose.T_parent_target),
        claimed=(float(variances[:3].sum()), float(variances[3:].sum())),
    )


def _views(setup: Setup, measured: Measured) -> tuple[Array, Array, Array]:
    """Return pixels, covariances and residuals [light, view] of the rig by which a moment is judged, see rig_of."""
    residual_px = np.array(measured.pose.residual_px)
    if setup.rig.is_pair:
        return *stack_spots(measured.spots), residual_px.reshape(-1, 2, 2)
    n, v = len(measured.names), len(measured.spots) + 1
    shown = np.zeros((n, v), bool)
    shown[:, 1:] = True if measured.sights is None else measured.sights
    uv, cov, residual = np.full((n, v, 2), np.nan), np.full((n, v, 2, 2), np.inf), np.zeros((n, v, 2))
    for s, spots in enumerate(measured.spots, start=1):
        uv[shown[:, s], s], cov[shown[:, s], s] = spots.uv_px, spots.covariance_px2
    residual[shown] = residual_px.reshape(-1, 2)
    return uv, cov, residual


def velocity_of(before: Frame | None, frame: Frame, after: Frame | None) -> Array:
    """Return the lights' velocities (m, 3) in m/s by the frames before and after; zero where these do not tell.

    A target that is put from place to place between frames has none: there the two differences disagree.
    """
    none = np.zeros_like(frame.positions_m)
    if before is None or after is None:
        return none
    back, ahead = frame.t_s - before.t_s, after.t_s - frame.t_s
    if not (0.0 < back <= MAX_GAP_S and 0.0 < ahead <= MAX_GAP_S):
        return none
    came, goes = (frame.positions_m - before.positions_m) / back, (after.positions_m - frame.positions_m) / ahead
    middle = (after.positions_m - before.positions_m) / (back + ahead)
    steady = sqrt(float(((goes - came) ** 2).sum())) <= sqrt(float((middle**2).sum()))
    return np.asarray(middle) if steady else none
