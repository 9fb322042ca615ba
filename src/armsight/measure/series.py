"""The poses of a run as columns in the units people read, with their standard deviations; what was lost, in groups."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import scipy  # loads its special functions where they are used
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array, Mask
from armsight.geometry import euler_rad
from armsight.records import PoseStatus, TargetPose
from armsight.units import DEG, MM

SCALE = np.array([MM] * 3 + [DEG] * 3)
"""From m and rad to mm and degrees, by division."""

GIMBAL = 1e-3
"""cos(ry) below which rx and rz cannot be told apart, and a band around either would say nothing."""
INSIDE_95 = 12.591587243743977
"""95 % point of chi-square with six degrees of freedom: the squared size of a pose's 95 % ellipsoid."""
TRUE_CLAIM = 0.999
"""The claim is doubted where the share inside falls out of this central range of what chance alone would give."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Series:
    """Columns over the n frames: t_s (n,), values and standard deviations (n, 6) of x, y, z in mm and rx, ry, rz in
    degrees.

    NaN where a frame does not say. Angles are unwrapped: they run on beyond 180 degrees. timed: whether the times are
    known; where they are not, t_s counts frames. apart: single shots, of which one tells nothing of the next.
    """

    t_s: Array
    status: tuple[PoseStatus, ...]
    values: Array
    std: Array
    timed: bool = True
    apart: bool = False

    @property
    def time_label(self) -> str:
        """What an axis of t_s is called."""
        return "time, s" if self.timed else "frame"

    def where(self, status: PoseStatus) -> Mask:
        """Return the mask (n,) of the frames with this status."""
        return np.array([s is status for s in self.status], dtype=bool)

    @property
    def whole(self) -> Mask:
        """The mask (n,) of the frames with a full pose, doubtful ones too."""
        return self.where(PoseStatus.OK) | self.where(PoseStatus.DOUBTFUL)

    def full(self) -> tuple[Array, Array]:
        """Return values and standard deviations with NaN wherever the pose is not full.

        A position alone is that of the mean of the spots seen, another point than the target's origin.
        """
        whole = self.whole[:, None]
        return np.where(whole, self.values, np.nan), np.where(whole, self.std, np.nan)


def series_of(poses: Sequence[TargetPose], *, timed: bool = True, apart: bool = False) -> Series:
    """Return the columns of poses; rotations become the angles of R = Rz Ry Rx, their covariance with them.

    timed: whether the poses' times are more than an assumption. apart: whether they are single shots.
    """
    n = len(poses)
    t_s, values, std = np.arange(float(n)), np.full((n, 6), np.nan), np.full((n, 6), np.nan)
    R, C, status, ok = np.empty((n, 3, 3)), np.empty((n, 3, 3)), list[PoseStatus](), list[int]()
    for i, pose in enumerate(poses):
        status.append(pose.status)
        if timed:
            t_s[i] = pose.t_s
        if pose.T_parent_target is not None and pose.covariance is not None:
            values[i, :3] = pose.T_parent_target[:3, 3]
            std[i, :3] = np.sqrt(np.diag(pose.covariance)[:3])
            if pose.status.size == 6:
                R[len(ok)], C[len(ok)] = pose.T_parent_target[:3, :3], pose.covariance[3:, 3:]
                ok.append(i)
    if ok:
        angles = euler_rad(Rotation.from_matrix(R[: len(ok)]))  # (m, 3)
        values[ok, 3:] = angles if apart else np.unwrap(angles, axis=0)
        std[ok, 3:] = _euler_std(angles, C[: len(ok)])
    values /= SCALE
    std /= SCALE
    return Series(
        t_s=t_s,
        timed=timed,
        apart=apart,
        status=tuple(status),
        values=values,
        std=std,
    )


def _euler_std(angles: Array, covariance: Array) -> Array:
    """Return standard deviations (m, 3) of rx, ry, rz from covariances (m, 3, 3) of rotation vectors in the parent's
    axes.

    With R = Rz Ry Rx a small change turns the body by w = Rz Ry ex drx + Rz ey dry + ez drz = J d(rx, ry, rz).
    NaN where ry is within GIMBAL of a right angle.
    """
    (cy, cz), (sy, sz) = np.cos(angles[:, 1:].T), np.sin(angles[:, 1:].T)
    cy = np.where(np.abs(cy) < GIMBAL, np.nan, cy)
    zero = np.zeros(len(angles))
    # the inverse of J = [[cz cy, -sz, 0], [sz cy, cz, 0], [-sy, 0, 1]]
    rows = [[cz / cy, sz / cy, zero], [-sz, cz, zero], [cz * sy / cy, sz * sy / cy, zero + 1.0]]
    inverse = np.moveaxis(np.array(rows), -1, 0)  # (m, 3, 3)
    return np.asarray(np.sqrt(np.einsum("mij,mjk,mik->mi", inverse, covariance, inverse)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Errors:
    """Measured minus true (n, 6), mm and degrees, rotation as a vector in the parent's axes; NaN where not ok.

    std: the claimed standard deviations of the same. distance2: (n,) squared Mahalanobis distance of each error.
    """

    values: Array
    std: Array
    distance2: Array

    def inside(self) -> tuple[float, float, float]:
        """Return the share of errors inside their 95 % ellipsoid, and the range in which chance would leave it."""
        distance2 = self.distance2[np.isfinite(self.distance2)]
        n = len(distance2)
        if n == 0:
            return float("nan"), 0.0, 1.0
        chance = scipy.special.bdtr(np.arange(n + 1), n, 0.95)  # binomial: this many or fewer inside
        low, high = np.searchsorted(chance, [0.5 - 0.5 * TRUE_CLAIM, 0.5 + 0.5 * TRUE_CLAIM])
        return float(np.mean(distance2 <= INSIDE_95)), float(low) / n, float(min(high, n)) / n


def errors_of(poses: Sequence[TargetPose], truth: Sequence[RigidTransform]) -> Errors:
    """Return the errors of the poses of status ok against the true ones, in step."""
    n, ok = len(poses), np.array([i for i, pose in enumerate(poses) if pose.status.size == 6], dtype=np.intp)
    values, std, distance2 = np.full((n, 6), np.nan), np.full((n, 6), np.nan), np.full(n, np.nan)
    if len(ok):
        true = np.array([truth[i].as_matrix() for i in ok])  # (m, 4, 4)
        seen = np.array([poses[i].T_parent_target for i in ok], dtype=float)
        turn = seen[:, :3, :3] @ np.swapaxes(true[:, :3, :3], 1, 2)
        error = np.hstack([seen[:, :3, 3] - true[:, :3, 3], Rotation.from_matrix(turn).as_rotvec()])  # (m, 6)
        covariance = np.array([poses[i].covariance for i in ok], dtype=float)
        values[ok], std[ok] = error / SCALE, np.sqrt(np.diagonal(covariance, axis1=1, axis2=2)) / SCALE
        full = np.linalg.matrix_rank(covariance, hermitian=True) == 6  # an exact pose claims nothing to be checked
        whitened = np.linalg.solve(covariance[full], error[full][:, :, None])[:, :, 0]
        distance2[ok[full]] = np.sum(error[full] * whitened, axis=1)
    return Errors(values=values, std=std, distance2=distance2)


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """Frames without a full pose for one reason: the first frame's wording, and which frames they were."""

    status: PoseStatus
    why: str
    frames: tuple[int, ...]


def losses_of(poses: Sequence[TargetPose]) -> list[Loss]:
    """Return the frames without a full pose, grouped by reason (numbers in it aside), the largest group first."""
    groups: dict[tuple[PoseStatus, str], list[int]] = {}
    for i, pose in enumerate(poses):
        if pose.status is not PoseStatus.OK:
            groups.setdefault((pose.status, re.sub(r"\d+(?:\.\d+)?", "#", pose.why)), []).append(i)
    out = [
        Loss(status=status, why=poses[frames[0]].why or "no reason was given", frames=tuple(frames))
        for (status, _), frames in groups.items()
    ]
    return sorted(out, key=lambda loss: -len(loss.frames))


def median_columns(values: Array) -> Array:
    """Return the median of each column, NaN aside; NaN for a column without numbers."""
    known = [column[np.isfinite(column)] for column in values.T]
    return np.array([np.median(column) if len(column) else np.nan for column in known])
