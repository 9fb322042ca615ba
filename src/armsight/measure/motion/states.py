"""What the estimator of a moving target takes and gives."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise

import numpy as np

from armsight.arrays import Array, Index
from armsight.measure.motion.kernels import state as kernels
from armsight.records import CameraTiming, freeze, frozen_array, trusted
from armsight.records.camera import CLOCK, PPM

BEGIN_POSITION_M, BEGIN_ROTATION_RAD = 0.02, 0.15
"""Standard deviations added to the pose with which a track begins: its views may not be of one moment."""
BEGIN_SPEED_M_S, BEGIN_TURN_RAD_S = 1.0, 4.0
BEGIN_ACCELERATION_M_S2, BEGIN_ANGULAR_ACCELERATION_RAD_S2 = 10.0, 40.0
"""Standard deviations of the motion with which a track begins: what a hand does."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class View:
    """The named spots of one frame of one camera.

    t_s: the rig's time of the frame (middle line). side: the camera, in the rig's order. lights (n,): rows of the
    target's positions; uv_px (n, 2), cov_px2 (n, 2, 2); tau_s (n,): each spot's line after the middle one.
    """

    t_s: float
    side: int
    lights: Index
    uv_px: Array
    cov_px2: Array
    tau_s: Array

    def __post_init__(self) -> None:
        n = len(self.lights)
        for name, shape in (("uv_px", (n, 2)), ("cov_px2", (n, 2, 2)), ("tau_s", (n,))):
            object.__setattr__(self, name, frozen_array(name, getattr(self, name), shape))


NO_TIMING = np.zeros((kernels.N, 0))
NO_TIMING.setflags(write=False)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MotionState:
    """Pose and motion of a target at t_s, in rig axes.

    x (24,), C (18, 18): as measure.motion.kernels orders them. jerk: level in m^2/s^5 that the data set. by_timing
    (18, q): how the state depends on q unknowns of the cameras' timing, whose uncertainty C leaves out.
    """

    t_s: float
    x: Array
    C: Array
    jerk: float
    by_timing: Array = field(default_factory=lambda: NO_TIMING)

    def __post_init__(self) -> None:
        freeze(self, x=(kernels.STATE,), C=(kernels.N, kernels.N), by_timing=(kernels.N, None))

    @property
    def T_rig_target(self) -> Array:
        """The pose (4, 4)."""
        T = np.eye(4)
        T[:3, :3] = self.x[kernels.R : kernels.V].reshape(3, 3)
        T[:3, 3] = self.x[kernels.P : kernels.R]
        return T

    @property
    def covariance(self) -> Array:
        """Of the pose (6, 6): translation (m), rotation vector (rad)."""
        return np.array(self.C[:6, :6])

    @property
    def velocity(self) -> Array:
        """Velocity (3,) in m/s of the target's origin and angular velocity (3,) in rad/s."""
        return np.array(self.x[kernels.V : kernels.A])

    @property
    def velocity_covariance(self) -> Array:
        """Of velocity (6, 6)."""
        return np.array(self.C[6:12, 6:12])

    def at(self, t_s: float, angular_ratio: float) -> MotionState:
        """Return the state expected at another time, later or a little earlier, with what jerk leaves open by then."""
        out, D, F = np.empty(kernels.STATE), np.empty((kernels.N, kernels.N)), np.empty((kernels.N, kernels.N))
        tau, x, C = t_s - self.t_s, np.array(self.x), np.array(self.C)  # writeable, as the kernels' own states
        if tau >= 0.0:
            kernels.predict(x, C, tau, self.jerk, angular_ratio * self.jerk, out, D, F)
        else:
            kernels.transition(x, tau, F)
            kernels.state_at(x, tau, out)
            D = F @ C @ F.T
            kernels.add_jerk(D, -tau, self.jerk, angular_ratio * self.jerk)
        by_timing = F @ self.by_timing if self.by_timing.size else NO_TIMING
        return trusted(MotionState, t_s=t_s, x=out, C=D, jerk=self.jerk, by_timing=by_timing)


def state_of(t_s: float, T: Array, covariance: Array) -> tuple[Array, Array]:
    """Return x (24,) and C (18, 18) of a target at the pose T (4, 4), of whose motion nothing is known."""
    x = np.zeros(kernels.STATE)
    x[kernels.P : kernels.R] = T[:3, 3]
    x[kernels.R : kernels.V] = T[:3, :3].ravel()
    spread = (
        BEGIN_POSITION_M,
        BEGIN_ROTATION_RAD,
        BEGIN_SPEED_M_S,
        BEGIN_TURN_RAD_S,
        BEGIN_ACCELERATION_M_S2,
        BEGIN_ANGULAR_ACCELERATION_RAD_S2,
    )
    C = np.diag(np.repeat(np.square(spread), 3))
    C[:6, :6] += covariance
    return x, C


# What the views of one recording tell of its cameras' timing, beyond what was calibrated before.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimingPrior:
    """What is known of the timing of v cameras before a recording is looked at, as 3 v - 2 unknowns: delay (s) and
    drift (ppm) of each camera but the first, then the read-out (s) of each.

    mid_s: the rig's time at which the delays are meant. covariance (3 v - 2, 3 v - 2). readout_s: of each camera.
    """

    mid_s: float
    covariance: Array
    readout_s: tuple[float, ...]

    def __post_init__(self) -> None:
        q = 3 * len(self.readout_s) - 2
        freeze(self, covariance=(q, q))

    @classmethod
    def of(cls, timing: Sequence[CameraTiming], mid_s: float, stamps: Sequence[Array]) -> TimingPrior:
        """Return what the cameras' files say at mid_s, with what this recording's stamps leave open of their clocks.

        stamps: covariance (2, 2) of the offset (s) at mid_s and the rate (ppm) of each camera's clock.
        """
        q = 3 * len(timing) - 2
        C, move = np.zeros((q, q)), np.array([[1.0, PPM * mid_s], [0.0, 1.0]])
        for k, one in enumerate(timing):
            C[q - len(timing) + k, q - len(timing) + k] = one.std.get("readout_s", 0.0) ** 2
            names = tuple(name for name in CLOCK if name in one.names)
            if k == 0:
                continue
            own = np.zeros((2, 2))
            if one.covariance is not None and names:
                own[np.ix_(*[[CLOCK.index(name) for name in names]] * 2)] = one.covariance.block(names)
            at = slice(2 * k - 2, 2 * k)
            C[at, at] = move @ own @ move.T + stamps[k]
        for k, n in np.ndindex(len(timing) - 1, len(timing) - 1):  # all count from the first camera's clock
            C[2 * k : 2 * k + 2, 2 * n : 2 * n + 2] += stamps[0]
        return cls(mid_s=mid_s, covariance=C, readout_s=tuple(one.readout_s for one in timing))

    def lines(self, views: Sequence[View]) -> Array:
        """Return how much later each spot of the views is for each of the unknowns (m, 3 v - 2)."""
        v = len(self.readout_s)
        parts = [np.zeros((0, 3 * v - 2))]
        for view in views:
            part = np.zeros((len(view.lights), 3 * v - 2))
            readout_s = self.readout_s[view.side]
            if view.side:
                part[:, 2 * view.side - 2] = 1.0
                part[:, 2 * view.side - 1] = PPM * (view.t_s - self.mid_s)
            if readout_s:
                part[:, 2 * v - 2 + view.side] = view.tau_s / readout_s
            parts.append(part)
        return np.concatenate(parts)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TimingEstimate:
    """What a recording's views make of its timing: change (q,) of TimingPrior's unknowns, its covariance (q, q).

    prior: what was known before.
    """

    prior: TimingPrior
    change: Array
    covariance: Array

    def __post_init__(self) -> None:
        q = len(self.prior.covariance)
        freeze(self, change=(q,), covariance=(q, q))

    @property
    def mahalanobis2(self) -> float:
        """Squared Mahalanobis distance of the change from none, by how much of it chance explains."""
        gained = self.prior.covariance - self.covariance
        scale = np.sqrt(np.maximum(np.diag(self.prior.covariance), 1e-300))
        return float(
            self.change / scale @ np.linalg.pinv(gained / np.outer(scale, scale), 1e-9) @ (self.change / scale)
        )

    def retimed(self, views: Sequence[View]) -> list[View]:
        """Return the views with their spots' times as they are now known."""
        late = self.prior.lines(views) @ self.change
        ends = np.concatenate([[0], np.cumsum([len(view.lights) for view in views])])
        return [
            replace(view, tau_s=view.tau_s + late[a:b])
            for view, (a, b) in zip(views, pairwise(ends.tolist()), strict=True)
        ]


def estimate_timing(prior: TimingPrior, L: Array, g: Array, change: Array) -> TimingEstimate:
    """Return the estimate from the innovations' equations L (q, q), g (q,), taken as linear about a change (q,)."""
    scale = np.sqrt(np.maximum(np.diag(prior.covariance), 1e-300))
    values, axes = np.linalg.eigh(prior.covariance / np.outer(scale, scale))
    root = scale[:, None] * axes * np.sqrt(np.maximum(values, 0.0))  # what is exact stays so
    half = np.linalg.solve(np.linalg.cholesky(np.eye(len(L)) + root.T @ L @ root), root.T)
    C = half.T @ half
    return TimingEstimate(prior=prior, change=C @ (g + L @ change), covariance=C)
