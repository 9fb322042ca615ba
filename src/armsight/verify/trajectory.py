"""How far one trajectory is from another: absolute and relative pose errors, as evo defines them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.geometry.poses import align_points
from armsight.records import frozen_array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TrajectoryError:
    """Error of each pose, or of each step: distance_m (n,) and angle_rad (n,)."""

    distance_m: Array
    angle_rad: Array

    def __post_init__(self) -> None:
        for name in ("distance_m", "angle_rad"):
            object.__setattr__(self, name, frozen_array(name, getattr(self, name), (len(self.distance_m),)))

    @property
    def rms_m(self) -> float:
        """Root mean square of the distances in m."""
        return float(np.sqrt(np.mean(self.distance_m**2)))

    @property
    def rms_rad(self) -> float:
        """Root mean square of the angles in rad."""
        return float(np.sqrt(np.mean(self.angle_rad**2)))


def aligned(reference: RigidTransform, estimate: RigidTransform) -> RigidTransform:
    """Return the estimated poses (n) moved rigidly so that their positions fit the reference's best (Umeyama 1991).

    Raises Inconsistent where the numbers of poses differ, NotEnoughData and Degenerate as `align_points`.
    """
    _check(reference, estimate, least=3)
    fit = align_points(reference.translation, estimate.translation)
    return fit.T_a_b * estimate


def absolute_pose_error(reference: RigidTransform, estimate: RigidTransform) -> TrajectoryError:
    """Return the error of each of n poses in one frame: the motion from the reference pose to the estimated one.

    Raises Inconsistent where the numbers of poses differ, NotEnoughData for none.
    """
    _check(reference, estimate, least=1)
    return _size(reference.inv() * estimate)


def relative_pose_error(reference: RigidTransform, estimate: RigidTransform, *, step: int = 1) -> TrajectoryError:
    """Return the error of each motion over step poses, frame by frame: n - step of them; no alignment is needed.

    step counts poses, and motions overlap where it is more than one (evo's all pairs). Raises UsageError for a step
    below one, Inconsistent where the numbers of poses differ, NotEnoughData for fewer than step + 1 poses.
    """
    if step < 1:
        raise UsageError(f"a step of {step} poses is no motion", cure="Give 1 or more")
    _check(reference, estimate, least=step + 1)
    moved = [track[:-step].inv() * track[step:] for track in (reference, estimate)]
    return _size(moved[0].inv() * moved[1])


def _size(error: RigidTransform) -> TrajectoryError:
    return TrajectoryError(
        distance_m=np.linalg.norm(error.translation, axis=1), angle_rad=np.asarray(error.rotation.magnitude())
    )


def _check(reference: RigidTransform, estimate: RigidTransform, *, least: int) -> None:
    if reference.single or estimate.single:
        raise UsageError("a trajectory is a stack of poses, not a single one")
    if len(reference) != len(estimate):
        raise Inconsistent(
            f"the trajectories have {len(reference)} and {len(estimate)} poses",
            consequence="Their rows do not belong together",
            cure="Pair them by time first",
        )
    if len(reference) < least:
        raise NotEnoughData(f"{len(reference)} poses; at least {least} are needed", consequence="No error can be given")
