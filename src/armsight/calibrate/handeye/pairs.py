"""Pose pairs: where the robot said its flange was, where the camera saw the target, and how much the hand turned."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum

import numpy as np
import scipy  # loads its spatial search where it is used
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.errors import Degenerate, Inconsistent, NotEnoughData
from armsight.fitting.groups import taken
from armsight.records import frozen_array
from armsight.records.checks import FAR_M, check_metres, freeze
from armsight.units import DEG

Arrays = tuple[Array, Array, Array, Array]
"""RF (n, 3, 3), tF (n, 3), RB (n, 3, 3), tB (n, 3) of F X B = Z: what the kernels work on."""
Poses = tuple[Array, Array, Array, Array]
"""RX (3, 3), tX (3,), RZ (3, 3), tZ (3,) of F X B = Z: T_parent_camera and T_parent_target."""

MIN_PAIRS = 4
"""Three pairs fix the answer; the fourth is the first that can contradict it."""

SAME = 1e-9
"""Poses whose matrices (m, and directions) agree so closely are copies: no robot or camera repeats itself to a
nanometre."""

ROUNDED = 1e-8
"""Of a correlation, what rounding in a file explains."""


class Setup(StrEnum):
    """Who carries the camera."""

    EYE_IN_HAND = "eye-in-hand"
    EYE_TO_HAND = "eye-to-hand"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PosePairs:
    """n poses T_base_flange of the robot and n poses T_camera_target of the camera, row by row, and the rows' names.

    t_s (n,): when, of poses of one recording; None of poses that were taken one by one. camera_covariance (n, 6, 6): of
    T_camera_target in the camera's axes, by which the pairs are weighed; None where it is not known. unweighed: why
    covariances that were given are not used, or not as they are; "" where there is nothing to say.

    Raises NotEnoughData below MIN_PAIRS rows, Inconsistent for tables of different length and what is no covariance.
    """

    T_base_flange: RigidTransform
    T_camera_target: RigidTransform
    names: tuple[str, ...]
    t_s: Array | None = None
    camera_covariance: Array | None = None
    unweighed: str = ""

    def __post_init__(self) -> None:
        n, m = _count(self.T_base_flange), _count(self.T_camera_target)
        if n != m or n != len(self.names):
            raise Inconsistent(
                f"{n} robot poses, {m} camera poses and {len(self.names)} names",
                consequence="Nobody knows which belong together",
                cure="Give one robot pose and one camera pose per row",
            )
        if n < MIN_PAIRS:
            raise NotEnoughData(
                f"{n} pose pairs, of which {MIN_PAIRS} are the fewest that can be checked",
                consequence="No calibration is given",
                cure="Record 15 to 30 poses that turn the hand about at least two axes",
            )
        for what, poses in (("robot", self.T_base_flange), ("camera", self.T_camera_target)):
            if not np.isfinite(poses.as_matrix()).all():
                row = int(np.argmax(~np.isfinite(poses.as_matrix()).all(axis=(1, 2))))
                raise Inconsistent(f"the {what} pose of {self.names[row]} is not finite")
        if self.camera_covariance is not None:
            object.__setattr__(self, "camera_covariance", self._checked(self.camera_covariance))

    def _checked(self, covariance: Array) -> Array:
        """Return covariances (n, 6, 6) that are such; Inconsistent with the row of the first that is none."""
        C = frozen_array("camera_covariance", covariance, (len(self), 6, 6))
        std = np.sqrt(np.maximum(np.diagonal(C, axis1=1, axis2=2), 0.0))
        bad = ~(std > 0.0).all(axis=1)
        scale = np.where(std > 0.0, std, 1.0)
        correlation = C / (scale[:, :, None] * scale[:, None, :])
        bad |= np.abs(correlation - correlation.transpose(0, 2, 1)).max(axis=(1, 2)) > ROUNDED
        bad |= np.linalg.eigvalsh(correlation)[:, 0] < -ROUNDED
        if bad.any():
            raise Inconsistent(
                f"the covariance of the camera's pose in {self.names[int(np.argmax(bad))]} is none",
                consequence="Nobody knows how much to trust that pose",
                cure="Give symmetric, positive 6 x 6 matrices: translation (m) then rotation vector (rad), in the "
                "camera's axes",
            )
        return C

    @classmethod
    def of(
        cls,
        T_base_flange: Sequence[RigidTransform],
        T_camera_target: Sequence[RigidTransform],
        names: Sequence[str] | None = None,
        camera_covariance: Array | None = None,
    ) -> PosePairs:
        """Return the pairs of two sequences of single poses; rows are called 'row 1', 'row 2' ... unless named."""
        return cls(
            T_base_flange=stack(T_base_flange),
            T_camera_target=stack(T_camera_target),
            names=tuple(names) if names is not None else tuple(f"row {i + 1}" for i in range(len(T_base_flange))),
            camera_covariance=camera_covariance,
        )

    def __len__(self) -> int:
        return len(self.names)

    def take(self, index: Sequence[int] | NDArray[np.intp]) -> PosePairs:
        """Return the rows at the given positions."""
        i = np.asarray(index, dtype=np.intp)
        return taken(self, i, "T_base_flange", "T_camera_target", "names", "t_s", "camera_covariance")

    def canonical_order(self) -> NDArray[np.intp]:
        """Return the order that depends on the poses alone, so that no answer depends on the order of the rows."""
        table = np.concatenate([_columns(self.T_base_flange), _columns(self.T_camera_target)], axis=1)
        return np.lexsort(table.T[::-1])

    def duplicates(self) -> tuple[tuple[int, int, str], ...]:
        """Return (row, earlier row, why) of rows whose camera pose repeats an earlier one to the last digit."""
        found: list[tuple[int, int, str]] = []
        camera, robot = self.T_camera_target.as_matrix(), self.T_base_flange.as_matrix()
        moved = _copies(robot)
        for i, seen in _copies(camera).items():
            both = [k for k in seen if k in moved.get(i, [])]
            first = both[0] if both else seen[0]
            why = "repeats" if both else "has the same camera pose (a stale image?) as"
            found.append((i, first, f"{why} {self.names[first]}"))
        return tuple(found)

    def arrays(self, setup: Setup) -> Arrays:
        """Return the arrays of F X B = Z: F is T_base_flange eye-in-hand, its inverse eye-to-hand."""
        F = self.T_base_flange if setup is Setup.EYE_IN_HAND else self.T_base_flange.inv()
        return (*components(F), *components(self.T_camera_target))


def stack(poses: Sequence[RigidTransform]) -> RigidTransform:
    """Return single poses as one stack."""
    if not len(poses):
        return RigidTransform.from_matrix(np.empty((0, 4, 4)))
    return RigidTransform.from_matrix(np.stack([pose.as_matrix() for pose in poses]))


def components(poses: RigidTransform) -> tuple[Array, Array]:
    """Return rotation matrices (n, 3, 3) and translations (n, 3) of a stack, contiguous."""
    M = poses.as_matrix()
    return np.ascontiguousarray(M[..., :3, :3]), np.ascontiguousarray(M[..., :3, 3])


def pose(R: Array, t: Array) -> RigidTransform:
    """Return the pose of one rotation matrix and translation."""
    return RigidTransform.from_components(t, Rotation.from_matrix(R))


def _count(poses: RigidTransform) -> int:
    return 1 if poses.single else len(poses)


def _columns(poses: RigidTransform) -> Array:
    return np.concatenate([poses.translation, poses.rotation.as_quat(canonical=True)], axis=1)


def _copies(matrices: Array) -> dict[int, list[int]]:
    """Return the rows of matrices (n, 4, 4) that are copies of earlier ones, in order, and which earlier ones."""
    found: dict[int, list[int]] = {}
    for first, row in sorted(scipy.spatial.cKDTree(matrices.reshape(-1, 16)).query_pairs(SAME, p=np.inf)):
        found.setdefault(row, []).append(first)
    return dict(sorted(found.items()))


# How much the hand turned: what the poses can determine, before anything is solved.

LEAST_TURN_RAD = 2.5 * DEG
"""Least root-mean-square turn about the second axis: errors of orientation are blown up by its inverse, here 23
times (0.05 degrees seen become more than a degree in the answer). Poses spread evenly over +-4.3 degrees reach it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RotationExcitation:
    """Turns of the hand about its mean orientation.

    rotvecs_rad (n, 3): in the mean orientation's axes. rms_rad (3,): about the principal axes, falling. axes (3, 3):
    those axes in rows.
    """

    rotvecs_rad: Array
    rms_rad: Array
    axes: Array

    def __post_init__(self) -> None:
        freeze(self, rotvecs_rad=(None, 3), rms_rad=(3,), axes=(3, 3))


def rotation_excitation(rotations: Rotation) -> RotationExcitation:
    """Return how far a stack of orientations turns, and about which axes."""
    w = (rotations.mean().inv() * rotations).as_rotvec()
    w = w - w.mean(axis=0)
    values, vectors = np.linalg.eigh(w.T @ w / len(w))
    rms = np.sqrt(np.maximum(values[::-1], 0.0))
    return RotationExcitation(rotvecs_rad=w, rms_rad=rms, axes=vectors.T[::-1])


STALE = 2.0
"""Turns that the camera sees and the robot does not say, by this factor: both turn alike, whatever is mounted where."""
STALE_SHARE = 0.4
"""Of the pairs: fewer readings of an earlier pose are left out as what the others contradict."""
FRESH = "Read the robot's pose anew at every image, once the hand stands"
TURN_CURE = (
    "Add poses that tilt the hand by 15 to 30 degrees about at least two axes that are not parallel. Where the arm "
    "cannot tilt (SCARA, palletiser, gantry), let the camera stand beside it and use `armsight calibrate robot-world`, "
    "which needs joint readings and places, and no tilt"
)


def require_turning(pairs: PosePairs) -> RotationExcitation:
    """Return how far the hand turned; raise Degenerate where it turned too little, or about one axis only.

    Raises Inconsistent where the camera saw it turn and the robot's poses do not say so.
    """
    found, seen = (rotation_excitation(poses.rotation) for poses in (pairs.T_base_flange, pairs.T_camera_target))
    first, second, _ = found.rms_rad
    if second >= LEAST_TURN_RAD:
        _require_own_poses(pairs)
        return found
    _require_fresh(pairs, found, seen)
    if first < LEAST_TURN_RAD:
        raise Degenerate(
            f"the hand turns by only {first / DEG:.2g} degrees (root mean square) over all poses",
            consequence="Noise would decide where the camera is, by centimetres; no calibration is given",
            cure=TURN_CURE,
        )
    x, y, z = found.axes[0]
    raise Degenerate(
        f"the hand turns about one axis only, ({x:.2f}, {y:.2f}, {z:.2f}) in its own frame: {first / DEG:.3g} degrees "
        f"about it, {second / DEG:.2g} across it (root mean square)",
        consequence="Where the camera is along that axis cannot be known",
        cure=TURN_CURE,
    )


def _require_fresh(pairs: PosePairs, found: RotationExcitation, seen: RotationExcitation) -> None:
    """Raise Inconsistent where the camera's poses turn and the robot's, read along with them, do not."""
    if not seen.rms_rad[1] >= max(LEAST_TURN_RAD, STALE * found.rms_rad[1]):
        return
    copies = len(_copies(pairs.T_base_flange.as_matrix()))
    turns = [float(each.rms_rad[0]) / DEG for each in (found, seen)]
    cause = f"the robot's poses turn by {turns[0]:.2g} degrees (root mean square) and the camera's by {turns[1]:.2g}"
    if copies:
        cause += f"; {copies} of {len(pairs)} robot poses repeat another to the last digit"
    raise Inconsistent(
        cause,
        consequence="The hand turned and its readings do not say so: they are stale, or in another unit of angle",
        cure=f"{FRESH}, and check the unit of its angles",
    )


def _require_own_poses(pairs: PosePairs) -> None:
    """Raise Inconsistent where many robot poses are copies of earlier ones, from which the camera's turn away."""
    camera = pairs.T_camera_target.rotation
    copies = {i: same[0] for i, same in _copies(pairs.T_base_flange.as_matrix()).items()}
    turn = {i: float((camera[first].inv() * camera[i]).magnitude()) for i, first in copies.items()}
    stale = [i for i in copies if turn[i] > LEAST_TURN_RAD]
    if len(stale) > STALE_SHARE * len(pairs):
        raise Inconsistent(
            f"the robot's pose of {len(stale)} of {len(pairs)} pairs ({pairs.names[stale[0]]} to "
            f"{pairs.names[stale[-1]]}) repeats an earlier one, such as {pairs.names[copies[stale[0]]]}, to the last "
            f"digit, and the camera's turns by up to {max(turn.values()) / DEG:.3g} degrees from there",
            consequence="These readings are stale, and the others are too few to outvote them",
            cure=f"{FRESH}; or leave these rows out where ten others are left",
        )


def require_metres(pairs: PosePairs) -> None:
    """Raise Inconsistent where distances are so large that they must be millimetres."""
    for what, t in (
        ("the robot's poses lie from the base by", pairs.T_base_flange.translation),
        ("the camera sees the target from", pairs.T_camera_target.translation),
    ):
        check_metres(np.linalg.norm(t, axis=1), FAR_M, what)
