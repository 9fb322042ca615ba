"""The target's pose from its named spots in both views, with covariance."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import compress
from typing import NamedTuple

import numpy as np

from armsight.arrays import Array
from armsight.errors import Unseen
from armsight.measure.poses.kernels import pose as kernels
from armsight.measure.poses.kernels import rig_covariance
from armsight.measure.poses.setup import SLACK_PX
from armsight.optics import PackedRig
from armsight.records import NotSeen, Points, PoseStatus, Spots, TargetPose, changed, frozen_array, trusted

PARENT = "rig"

TWO = 2
"""Cameras of a pair, of which both must see a light. With any other number a sight of one camera counts too."""

BEYOND_CLAIMS = 9.0
"""From this factor of misfit (residuals of three times what noise may do, which is no noise model's slip: VERY_NOISY of
consistency) the pose is doubtful, widened as it is."""

_WHY = {
    kernels.NO_WEIGHT: "the covariance of a spot is not positive",
    kernels.NO_POINT: "the rays of a named spot do not meet in front of both cameras",
    kernels.BEHIND_CAMERA: "the fit put the target behind a camera",
    kernels.OPEN: "the spots leave some direction of the pose open",
    kernels.ENDLESS: "the fit did not settle",
}
_CAUSE = {
    kernels.OPEN: Unseen.ROTATION_OPEN,
    kernels.ENDLESS: Unseen.MISFIT,
}
ONLY_POSITION = "only the position is known"
_MISFIT = f"one of the spots is off, and it is not clear which: {ONLY_POSITION}"
_FOLDED = f"the spots fit tilts to either side of the line of sight: {ONLY_POSITION}"
_DOUBT = {
    rig_covariance.NO_DOUBT: (_WHY[kernels.OPEN], Unseen.ROTATION_OPEN),
    rig_covariance.ONE_OFF: (_MISFIT, Unseen.ONE_OFF),
    rig_covariance.FOLDED: (_FOLDED, Unseen.ROTATION_OPEN),
}


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseSolution:
    """A pose with the points it came from; its matrix T (4, 4), None where it is not complete.

    fits: whether the residuals agree with the target, slack allowed. cause: of what the pose says is not known.
    """

    pose: TargetPose
    points: Points
    T: Array | None = None
    fits: bool = True
    cause: Unseen = Unseen.OTHER

    @property
    def missed(self) -> NotSeen:
        """Why the pose is not whole."""
        return NotSeen(self.pose.why, self.cause)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Placed:
    """Points by themselves, their joint covariance (3 n, 3 n) and residuals (n, v, 2) in px.

    systematic_m2 (3 n, 3 n): the rig's part of it, None where the rig is taken as exact.
    """

    points: Points
    joint_m2: Array
    residual_px: Array
    systematic_m2: Array | None = None


class NamedSpots(NamedTuple):
    """n >= 3 lights of a target and their spots in v views; a tuple, made anew for every frame within a microsecond.

    xyz_m: (n, 3) in target axes. uv_px: (n, v, 2), cov_px2: (n, v, 2, 2) as [light, view], NaN and infinite where a
    view does not show the light. radius_m: (n, v) of the flat light where the spot is the outline of one, else 0;
    normal: (3,) of the lights' plane in target axes.
    """

    names: tuple[str, ...]
    xyz_m: Array
    uv_px: Array
    cov_px2: Array
    radius_m: Array
    normal: Array


class Fit(NamedTuple):
    """What solve_whole made of n spots: state, factor of misfit, doubt, then the arrays that it filled."""

    state: int
    factor: float
    doubt: int
    P: Array
    S: Array
    T: Array
    C: Array
    residual: Array
    systematic: Array


UNKNOWN = frozen_array("UNKNOWN", np.zeros((4, 4)), (4, 4))
"""A pose that is not known: it tells nothing of how lights lean, nor where a fit may begin."""


def stack_spots(views: Sequence[Spots]) -> tuple[Array, Array]:
    """Return pixels (n, v, 2) and covariances (n, v, 2, 2) [light, view] of each view's spots in the lights' order."""
    n = len(views[0])
    uv, cov = np.empty((n, len(views), 2)), np.empty((n, len(views), 2, 2))
    for s, spots in enumerate(views):
        kernels.stack_view(spots.uv_px, spots.covariance_px2, s, uv, cov)
    return uv, cov


def fit_pose(
    packed: PackedRig, spots: NamedSpots, limit: float, slack_px: float, covariance: Array, start: Array = UNKNOWN
) -> Fit:
    """Return the pose of greatest likelihood as numbers; arguments as solve_pose takes them."""
    _, xyz_m, uv_px, cov_px2, radius_m, normal = spots
    n, xyz_m = len(xyz_m), xyz_m[:]
    xyz_m.setflags(write=False)  # lights left out or not: one compilation serves both
    P, S, residual = np.empty((n, 3)), np.empty((n, 3, 3)), np.zeros(uv_px.shape)
    T, C, systematic = np.empty((4, 4)), np.empty((6, 6)), np.empty((6, 6))
    state, factor, doubt = rig_covariance.solve_whole(
        packed.arrays,
        (uv_px, cov_px2),
        (slack_px**2, limit),
        (xyz_m, radius_m, normal),
        start,
        covariance,
        (P, S),
        (T, C, systematic),
        residual,
    )
    return Fit(state, factor, doubt, P, S, T, C, residual, systematic)


def solve_pose(
    packed: PackedRig,
    t_s: float,
    spots: NamedSpots,
    *,
    limit: float,
    slack_px: float = SLACK_PX,
    covariance: Array | None = None,
    start: Array = UNKNOWN,
) -> PoseSolution:
    """Return the pose of greatest likelihood on all images from n >= 3 named spots.

    start (4, 4): a pose to begin with; lights then count that have no point by themselves, which the points leave out.
    UNKNOWN: by Kabsch from the points of all. limit: largest chi-square, slack included, that is believed (fit_limit).
    covariance (q + m, q + m): of the rig's parameters and, m = 3 n or 0, of xyz_m; that of the rig where None.
    Status LOST, with the reason, where the spots do not fit the target; POSITION_ONLY where they fit but leave
    the rotation open. Covariances hold the spots' noise, widened where the residuals are larger (misfit_factor), and
    what rig and target bring, which is the same in every frame: systematic_covariance.
    """
    carried = packed.covariance if covariance is None else covariance
    fit = fit_pose(packed, spots, limit, slack_px, carried, start)
    state, factor, doubt, P, S, T, C, residual, systematic = fit
    names, cov = spots.names, spots.cov_px2
    if cov.shape[1] != TWO:
        residual = residual[np.isfinite(cov[..., 0, 0])]
        placed = np.isfinite(P[:, 0])
        if not placed.all():
            names, cov, P, S = tuple(compress(names, placed.tolist())), cov[placed], P[placed], S[placed]
    if state == rig_covariance.UNLIKE:
        return _lost(t_s, _not_the_target(residual), Unseen.MISFIT)
    if state == rig_covariance.UNCERTAIN:
        return _position(packed, t_s, (names, P, S, cov, residual), *_DOUBT[doubt])
    if state in (kernels.NO_WEIGHT, kernels.NO_POINT):
        return _lost(t_s, _WHY[state], Unseen.NO_POINT)
    if state != kernels.SOLVED:
        why, cause = _WHY[state], _CAUSE.get(state, Unseen.NO_POINT)
        solved = _position(packed, t_s, (names, P, S, cov, residual), why, cause)
        return replace(solved, fits=state == kernels.OPEN)
    if packed.covariance.size:
        A = _slopes(packed, cov, P, S)
        S += A @ packed.covariance @ A.transpose(0, 2, 1)
    points = trusted(Points, names=names, xyz_m=P, covariance_m2=S)
    return _full_pose(t_s, spots.names, points, T, C, residual, systematic if carried.size else None, factor)


def _position(
    packed: PackedRig, t_s: float, points: tuple[tuple[str, ...], Array, Array, Array, Array], why: str, cause: Unseen
) -> PoseSolution:
    """Return what is left where there is no whole pose: the position of the points, if there are any; see _placed."""
    if not points[0]:
        return _lost(t_s, why.replace(ONLY_POSITION, "and no light has a place of its own"), cause)
    seen = _placed(packed, *points)
    return PoseSolution(pose=position_only(t_s, seen, why), points=seen.points, cause=cause)


def _not_the_target(residual: Array) -> str:
    """Return why there is no pose with such residuals (n, v, 2) in px."""
    return (
        f"the spots do not fit the target: residuals of {float(np.sqrt(np.mean(residual**2))):.2f} px; "
        "the target's measures, the calibration or the moment of the two exposures is off"
    )


def solve_frame(packed: PackedRig, t_s: float, names: tuple[str, ...], uv_px: Array, cov_px2: Array) -> PoseSolution:
    """Return the frame of three lights A, B, C nobody has measured (Pachidis 2005, eqs. 7-8), with its covariance.

    uv_px, cov_px2: as in NamedSpots. The lights' own triangle is not assumed to keep its shape.
    """
    seen = solve_points(packed, names, uv_px, cov_px2)
    if isinstance(seen, NotSeen):
        return _lost(t_s, seen.why, seen.cause)
    T, C = np.eye(4), np.empty((6, 6))
    if (
        not kernels.pachidis_frame(seen.points.xyz_m, seen.joint_m2, T, C)
        or not max(C[3, 3], C[4, 4], C[5, 5]) <= rig_covariance.MAX_ROTATION_SIGMA**2
    ):
        pose = position_only(t_s, seen, "the three lights lie on one line")
        return PoseSolution(pose=pose, points=seen.points, cause=Unseen.ROTATION_OPEN)
    systematic = None
    if seen.systematic_m2 is not None:
        systematic = np.empty((6, 6))
        kernels.pachidis_frame(seen.points.xyz_m, seen.systematic_m2, np.eye(4), systematic)
    return _full_pose(t_s, names, seen.points, T, C, seen.residual_px, systematic)


def solve_points(packed: PackedRig, names: tuple[str, ...], uv_px: Array, cov_px2: Array) -> Placed | NotSeen:
    """Return the points by themselves, or why there are none; arguments as solve_frame."""
    n = len(names)
    P, S, residual = np.empty((n, 3)), np.empty((n, 3, 3)), np.zeros(uv_px.shape)
    if not kernels.triangulate_all(packed.arrays, uv_px, cov_px2, P, S):
        return NotSeen(_WHY[kernels.NO_POINT], Unseen.NO_POINT)
    if not kernels.point_residuals(packed.arrays, uv_px, P, residual):
        return NotSeen(_WHY[kernels.NO_POINT], Unseen.NO_POINT)
    if cov_px2.shape[1] != TWO:
        residual = residual[np.isfinite(cov_px2[..., 0, 0])]
    return _placed(packed, names, P, S, cov_px2, residual)


def position_only(t_s: float, seen: Placed, why: str) -> TargetPose:
    """Return the position of the mean of the points, with its covariance (3, 3)."""
    n = len(seen.points)
    T = np.eye(4)
    T[:3, 3] = seen.points.xyz_m.mean(axis=0)
    return TargetPose(
        t_s=t_s,
        status=PoseStatus.POSITION_ONLY,
        parent=PARENT,
        spots=seen.points.names,
        T_parent_target=T,
        covariance=_of_mean(seen.joint_m2, n),
        residual_px=seen.residual_px.ravel(),
        why=why,
        systematic_covariance=None if seen.systematic_m2 is None else _of_mean(seen.systematic_m2, n),
    )


def _of_mean(joint_m2: Array, n: int) -> Array:
    """Return the covariance (3, 3) of the mean of n points with this joint one (3 n, 3 n)."""
    return np.asarray(joint_m2.reshape(n, 3, n, 3).sum(axis=(0, 2)) / n**2)


def _full_pose(
    t_s: float,
    names: tuple[str, ...],
    points: Points,
    T: Array,
    C: Array,
    residual: Array,
    systematic: Array | None = None,
    factor: float = 1.0,
) -> PoseSolution:
    """Return the pose T (4, 4) of the named lights with its covariance C (6, 6), widened for its residuals."""
    pose = trusted(
        TargetPose,
        t_s=t_s,
        status=PoseStatus.OK,
        parent=PARENT,
        spots=names,
        T_parent_target=T,
        covariance=C,
        residual_px=residual.ravel(),
        why="",
        systematic_covariance=systematic,
        origin_known=True,
    )
    return PoseSolution(
        pose=pose, points=points, T=T, cause=Unseen.BEYOND_CLAIMS if factor > BEYOND_CLAIMS else Unseen.OTHER
    )


def _placed(packed: PackedRig, names: tuple[str, ...], P: Array, S: Array, cov_px2: Array, residual: Array) -> Placed:
    """Return the points with their joint covariance: independent spots, one common calibration."""
    n = len(names)
    blocks = np.zeros((n, 3, n, 3))
    blocks[np.arange(n), :, np.arange(n), :] = S
    joint, systematic = blocks.reshape(3 * n, 3 * n), None
    if packed.covariance.size:
        A = _slopes(packed, cov_px2, P, S).reshape(3 * n, -1)
        systematic = A @ packed.covariance @ A.T
        joint = joint + systematic
    own = joint.reshape(n, 3, n, 3)[np.arange(n), :, np.arange(n), :]
    points = Points(names=names, xyz_m=P, covariance_m2=own)
    return Placed(points=points, joint_m2=joint, residual_px=residual, systematic_m2=systematic)


def _slopes(packed: PackedRig, cov_px2: Array, P: Array, S: Array) -> Array:
    """Return (n, 3, q): how the points follow the rig's parameters."""
    A = np.empty((len(P), 3, len(packed.covariance)))
    rig_covariance.point_slopes(packed.arrays, cov_px2, P, S, A)
    return A


def with_covariance(solved: PoseSolution, C: Array) -> PoseSolution:
    """Return a solved pose with another covariance (6, 6), which is used by nobody else."""
    return changed(solved, pose=changed(solved.pose, covariance=C))


def lost(t_s: float, why: str) -> TargetPose:
    """Return the record of a moment without any pose."""
    return TargetPose(t_s=t_s, status=PoseStatus.LOST, parent=PARENT, why=why)


def _lost(t_s: float, why: str, cause: Unseen) -> PoseSolution:
    return PoseSolution(pose=lost(t_s, why), points=no_points(), fits=False, cause=cause)


def no_points() -> Points:
    """Return the record of no points."""
    return Points(names=(), xyz_m=np.empty((0, 3)), covariance_m2=np.empty((0, 3, 3)))
