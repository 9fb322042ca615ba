"""Do the left and the right images belong together? The two cameras stand still against each other, so all pairs must
give one relative pose; and from that to the rig.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array, Index
from armsight.calibrate.cameras.bundle_adjustment import Bundle
from armsight.calibrate.cameras.initial_guess import board_poses, homographies
from armsight.calibrate.cameras.kernels import matrices_of
from armsight.calibrate.cameras.observations import Observations
from armsight.errors import Inconsistent
from armsight.geometry.kernels import rotvec
from armsight.optics import PLACE, Camera, LensKind, Rig, RigKind
from armsight.optics.camera import INTRINSICS_OF
from armsight.records import NamedCovariance, Target
from armsight.records.views import symmetries

SAME_ANGLE_RAD = 0.12
"""Relative orientations closer than this agree: starting poses without distortion are off by up to 0.05 rad."""
SAME_SHARE = 0.12
"""... and relative positions closer than this share of the distance to the board."""
AGREEING = 0.6
"""With fewer agreeing pairs than this share, the fault is in the whole set."""
LARGEST_SHIFT = 3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Paired:
    """T_left_right (6,) as (t m, rotation vector), agreeing (G,) pairs, and the symmetry chosen for each right view."""

    side_pose: Array
    agreeing: NDArray[np.bool_]
    turn: Index


def pair_views(
    observations: Observations, poses: Sequence[Array], board: Target, *, final: bool = True
) -> tuple[Observations, Paired]:
    """Return the observations with right views renumbered where the print is symmetric, and what the pairs agree on.

    poses: T_left_board and T_right_board (G, 6). final: these are the best poses to be had. Raises Inconsistent
    then where no common relative pose is found, saying whether the right images come late, or one camera is mirrored.
    """
    turns = symmetries(board)
    spins = spins_of(observations.X, turns)
    paired = consensus(poses[0], poses[1], spins)
    if final and paired.agreeing.mean() < AGREEING:
        _refuse(observations, poses, spins)
    if (paired.turn == 0).all():
        return observations, paired
    uv, weight = observations.uv.copy(), observations.weight.copy()
    for g, s in enumerate(paired.turn):
        uv[g, 1], weight[g, 1] = uv[g, 1, turns[s]], weight[g, 1, turns[s]]
    return replace(observations, uv=uv, weight=weight), paired


def turns_of(target: Target) -> Array:
    """Return (s, 4, 4): how the axes of a target may be turned so that it looks the same; of most one, not at all."""
    turns = symmetries(target)
    middle = target.xyz_m.mean(axis=0)
    out = np.tile(np.eye(4), (len(turns), 1, 1))
    out[:, :3, :3] = spins_of(target.xyz_m - middle, turns)
    out[:, :3, 3] = middle - out[:, :3, :3] @ middle
    return out


def spins_of(X: Array, turns: Sequence[Index]) -> Array:
    """Return the rotations (S, 3, 3) that carry a symmetric print's points onto each other."""
    return np.stack([_spin(X, turn) for turn in turns])


def _spin(X: Array, turn: Index) -> Array:
    """Return the rotation about z (3, 3) with X[turn] = spin X."""
    a, b = X[:, :2], X[turn, :2]
    angle = np.arctan2((a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]).sum(), (a * b).sum())
    c, s = np.cos(angle), np.sin(angle)
    return np.array([[c, -s, 0.0], [s, c, 0.0], [0.0, 0.0, 1.0]])


def consensus(left: Array, right: Array, spins: Array, slack: float = 1.0) -> Paired:
    """Return the relative pose that most pairs agree on, each with the symmetry that suits it best.

    slack: how many times further apart they may be, where the board moved between the two images.
    """
    G, S = len(left), len(spins)
    R_left, R_right = np.empty((G, 3, 3)), np.empty((G, 3, 3))
    matrices_of(np.ascontiguousarray(left[:, 3:]), R_left)
    matrices_of(np.ascontiguousarray(right[:, 3:]), R_right)
    R_right = R_right[:, None] @ spins[None]  # (G, S, 3, 3)
    R = R_left[:, None] @ R_right.transpose(0, 1, 3, 2)  # of T_left_right
    t = left[:, None, :3] - np.einsum("gsij,gj->gsi", R, right[:, :3])  # (G, S, 3)
    flat_R, flat_t = R.reshape(G * S, 3, 3), t.reshape(G * S, 3)
    trace = np.einsum("aij,bij->ab", flat_R, flat_R)
    angle = np.arccos(np.clip(0.5 * (trace - 1.0), -1.0, 1.0))
    reach = 0.5 * (np.linalg.norm(left[:, :3], axis=1) + np.linalg.norm(right[:, :3], axis=1))
    share = np.linalg.norm(flat_t[:, None] - flat_t[None], axis=2) / np.repeat(reach, S)[None]
    score = np.maximum(angle / SAME_ANGLE_RAD, share / SAME_SHARE).reshape(G * S, G, S) / slack
    best = score.min(axis=2)  # (hypothesis, pair)
    hypothesis = int(np.argmin(np.minimum(best, 1.0).sum(axis=1) + 1e-9 * (np.arange(G * S) % S)))
    agreeing = best[hypothesis] < 1.0
    turn = score[hypothesis].argmin(axis=1).astype(np.intp)
    chosen = np.flatnonzero(agreeing)
    U, _, Vt = np.linalg.svd(R[chosen, turn[chosen]].sum(axis=0))  # the mean rotation: nearest to the sum
    side_pose = np.empty(6)
    side_pose[:3] = np.median(t[chosen, turn[chosen]], axis=0)
    side_pose[3:] = rotvec(U @ Vt)
    return Paired(side_pose=side_pose, agreeing=agreeing, turn=turn)


def _refuse(observations: Observations, poses: Sequence[Array], spins: Array) -> None:
    """Raise Inconsistent with the likeliest reason why the pairs do not agree."""
    n = observations.n_views
    for shift in (s for k in range(1, LARGEST_SHIFT + 1) for s in (k, -k) if n - k >= 4):
        a, b = slice(max(0, -shift), n - max(0, shift)), slice(max(0, shift), n - max(0, -shift))
        if consensus(poses[0][a], poses[1][b], spins).agreeing.mean() >= AGREEING:
            raise Inconsistent(
                f"left and right images are out of step: each left image fits the right one "
                f"{abs(shift)} {'later' if shift > 0 else 'earlier'}",
                consequence="Nothing was calibrated",
                cure="Remove the images that have no partner, so that both lists begin with the same moment",
            )
    flipped = mirrored(observations, poses, spins)
    if flipped is not None:
        side = "right" if flipped.side_pose[0] > 0.0 else "left"
        raise Inconsistent(
            f"the images of the {side} camera are mirrored",
            consequence="Nothing was calibrated",
            cure="Switch off that camera's mirror mode",
        )
    raise Inconsistent(
        "left and right images do not belong together: their pairs give no common pose of the cameras",
        consequence="Nothing was calibrated",
        cure="Check that both lists are in the same order and from the same moments, and the cameras fixed",
    )


def mirrored(observations: Observations, poses: Sequence[Array], spins: Array) -> Paired | None:
    """Return what two cameras agree on once the second one's images are mirrored; None where they do not even then."""
    width = observations.sizes[1][0]
    half_turn = np.stack([*spins, *(spins @ np.diag([-1.0, -1.0, 1.0]))])
    for axis in (0, 1):
        flip = _flip(observations.X, axis)
        if flip is None:
            continue
        right = observations.camera(1)
        uv = right.uv.copy()
        uv[..., 0] = width - 1.0 - uv[..., 0]
        right = replace(right, uv=uv[:, :, flip], weight=right.weight[:, :, flip])
        H = homographies(right)
        focal = _focal_of(poses[1], observations, 1)
        paired = consensus(poses[0], board_poses(H, focal, width), half_turn)
        if paired.agreeing.mean() >= AGREEING:
            return paired
    return None


def _flip(X: Array, axis: int) -> Index | None:
    """Return the renumbering with X[flip] = X mirrored along the axis, or None where the board has none."""
    mirrored = X.copy()
    mirrored[:, axis] *= -1.0
    distance = np.linalg.norm(mirrored[:, None] - X[None], axis=2)
    if distance.min(axis=1).max() > 1e-6 * float(np.ptp(X)):
        return None
    return np.asarray(distance.argmin(axis=1), dtype=np.intp)


def _focal_of(poses: Array, observations: Observations, c: int) -> Array:
    """Return the focal lengths (2,) px that go with the poses, from where they put the points."""
    width, height = observations.sizes[c]
    R = Rotation.from_rotvec(poses[:, 3:]).as_matrix()
    P = observations.X @ R.transpose(0, 2, 1) + poses[:, None, :3]  # (G, n, 3)
    seen = observations.weight[:, c] > 0.0
    rays = (P[..., :2] / P[..., 2:])[seen]
    offset = observations.uv[:, c][seen] - 0.5 * np.array([width - 1.0, height - 1.0])
    return np.asarray((rays * offset).sum(axis=0) / (rays**2).sum(axis=0))


def as_pose(side_pose: Array) -> RigidTransform:
    """Return T_left_right from (t, rotation vector) (6,)."""
    return RigidTransform.from_components(side_pose[:3], Rotation.from_rotvec(side_pose[3:]))


# From the adjustment's numbers to cameras and rigs.


def camera_of(k: Array, size: tuple[int, int], lens: LensKind = LensKind.PINHOLE) -> Camera:
    """Return the camera of intrinsics k (n,), empty places behind its own, and image size (width, height)."""
    return Camera(width=size[0], height=size[1], intrinsics=k[: len(INTRINSICS_OF[lens])], lens=lens)


def rig_of(
    state: Bundle,
    sizes: tuple[tuple[int, int], ...],
    *,
    covariance: NamedCovariance | None = None,
    rms_px: float | None = None,
    lenses: tuple[LensKind, ...] = (LensKind.PINHOLE, LensKind.PINHOLE),
) -> Rig:
    """Return the rig, its reference the left camera."""
    return Rig(
        kind=RigKind.STEREO,
        left=camera_of(state.k[0], sizes[0], lenses[0]),
        right=camera_of(state.k[1], sizes[1], lenses[1]),
        T_rig_left=RigidTransform.identity(),
        T_rig_right=as_pose(state.sides[0]),
        covariance=covariance,
        rms_px=rms_px,
    )


def baseline_std(rig: Rig) -> float:
    """Return the standard deviation of the baseline in m, from the covariance of T_rig_right; NaN without one."""
    if rig.covariance is None:
        return float("nan")
    t = np.asarray(rig.T_rig_right.translation)
    direction = t / np.linalg.norm(t)
    return float(np.sqrt(direction @ rig.covariance.block(("right.tx", "right.ty", "right.tz")) @ direction))


def of_one_lens(covariance: NamedCovariance) -> NamedCovariance:
    """Return the covariance of both views' intrinsics from that of the left one's, which are the right one's too."""
    shared = [i for i, name in enumerate(covariance.names) if name.startswith("left.")]
    rows = [*range(len(covariance.names)), *shared]
    names = (*covariance.names, *(covariance.names[i].replace("left.", "right.") for i in shared))
    return NamedCovariance(names=names, matrix=covariance.matrix[np.ix_(rows, rows)])


def in_frame(rig: Rig, T_new_rig: RigidTransform) -> Rig:
    """Return the rig with its axes moved: the poses, and their covariance."""
    covariance = rig.covariance
    if covariance is not None:
        turn = np.eye(len(covariance.names))
        R = T_new_rig.rotation.as_matrix()
        for one in rig.cameras[1:]:
            for block in (PLACE[:3], PLACE[3:]):
                at = [covariance.names.index(f"{one.name}.{name}") for name in block]
                turn[np.ix_(at, at)] = R
        covariance = NamedCovariance(names=covariance.names, matrix=turn @ covariance.matrix @ turn.T)
    moved = rig.with_each(T_rig_camera=[T_new_rig * one.T_rig_camera for one in rig.cameras])
    return replace(moved, covariance=covariance)
