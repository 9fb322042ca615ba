"""What is measured: spots in an image, points in space, the target's pose.

Spots and points come in columns (one record for all of a frame): hundreds of frames a second leave no time
for an object per spot.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from enum import StrEnum

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Index
from armsight.errors import Inconsistent, Unseen, UsageError
from armsight.records import checks


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Spots:
    """The spots of one image.

    uv_px: (n, 2) centres. covariance_px2: (n, 2, 2). peak: (n,) fitted height above the background in grey
    levels. size_px: (n,) Gaussian sigma or mean radius of the disc. model: 'gaussian', 'ellipse', 'joint',
    'streak' or 'centroid' per spot. rejected: (u, v, why) of what was seen and not accepted. point: (n,) which point of
    a printed board each is, None where the picture does not say.
    """

    uv_px: NDArray[np.float64]
    covariance_px2: NDArray[np.float64]
    peak: NDArray[np.float64]
    size_px: NDArray[np.float64]
    model: tuple[str, ...]
    rejected: tuple[tuple[float, float, str], ...] = ()
    point: Index | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "model", checks.require_texts("model", self.model))
        checks.require_kind("rejected", self.rejected, tuple, cure="Give a tuple of (u, v, why)")
        n = len(self.model)
        checks.freeze(self, uv_px=(n, 2), covariance_px2=(n, 2, 2), peak=(n,), size_px=(n,))
        if self.point is not None:
            checks.checked_array("point", self.point, (n,))

    def __len__(self) -> int:
        return len(self.model)

    @classmethod
    def none(cls, rejected: tuple[tuple[float, float, str], ...] = ()) -> Spots:
        """Return the record of an image in which no spot was accepted."""
        return cls(
            uv_px=np.empty((0, 2)),
            covariance_px2=np.empty((0, 2, 2)),
            peak=np.empty(0),
            size_px=np.empty(0),
            model=(),
            rejected=rejected,
        )

    @classmethod
    def of_centres(cls, uv_px: NDArray[np.float64], covariance_px2: NDArray[np.float64]) -> Spots:
        """Return spots at uv_px (n, 2) of which only centres are known. covariance_px2: (n, 2, 2), or (2, 2)."""
        uv_px = checks.checked_array("uv_px", uv_px, (None, 2))
        n, covariance_px2 = len(uv_px), checks.real_array("covariance_px2", covariance_px2)
        if covariance_px2.ndim < 2 or (np.diagonal(covariance_px2, axis1=-2, axis2=-1) < 0.0).any():
            raise Inconsistent(
                "covariance_px2 is no covariance",
                consequence="Nobody can weigh the spots",
                cure="Give (n, 2, 2) or (2, 2) in px^2, such as 0.1**2 * np.eye(2)",
            )
        return cls(
            uv_px=uv_px,
            covariance_px2=np.tile(covariance_px2, (n, 1, 1)) if covariance_px2.ndim == 2 else covariance_px2,
            peak=np.zeros(n),
            size_px=np.ones(n),
            model=("gaussian",) * n,
        )

    def take(self, index: Index | list[int]) -> Spots:
        """Return the spots at the given positions, in that order."""
        i = np.asarray(index)
        at = i.tolist() if i.ndim == 1 and (not i.size or i.dtype.kind in "iu") else [-1]
        if at and not 0 <= min(at) <= max(at) < len(self):
            raise UsageError(f"{index!r} are not positions of {len(self)} spots", cure="Give whole numbers from 0")
        i = i.astype(np.intp)
        return checks.trusted(
            Spots,
            uv_px=self.uv_px[i],
            covariance_px2=self.covariance_px2[i],
            peak=self.peak[i],
            size_px=self.size_px[i],
            model=tuple([self.model[k] for k in at]),
            rejected=self.rejected,
            point=None if self.point is None else self.point[i],
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Points:
    """Triangulated spots: names, xyz_m (n, 3) and covariance_m2 (n, 3, 3) in the rig's axes."""

    names: tuple[str, ...]
    xyz_m: NDArray[np.float64]
    covariance_m2: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = len(self.names)
        checks.freeze(self, xyz_m=(n, 3), covariance_m2=(n, 3, 3))

    def __len__(self) -> int:
        return len(self.names)


class PoseStatus(StrEnum):
    """How much of the pose is known."""

    OK = "ok"
    DOUBTFUL = "doubtful"
    """A whole pose that does not fit the claims, or of a run that does not: not to be acted on."""
    POSITION_ONLY = "position_only"
    LOST = "lost"

    @property
    def size(self) -> int:
        """Coordinates that are known: 6 of a whole pose, 3 of a position, 0."""
        return {PoseStatus.POSITION_ONLY: 3, PoseStatus.LOST: 0}.get(self, 6)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TargetPose:
    """The target at one moment.

    status OK: T_parent_target (4, 4) and covariance (6, 6) are there. DOUBTFUL: they are there as well, and the frame
    or its run does not fit what is claimed: whoever acts on a pose takes OK alone. POSITION_ONLY: T_parent_target
    carries the position of the mean of the spots seen, or where origin_known that of the target's origin (its rotation
    is the identity and means nothing), covariance is its (3, 3). LOST: both None.
    why: the reason where the status is not OK. residual_px: (m,) reprojection residuals used. covariance holds all
    that is known of: the spots' noise and, where rig or target bring a covariance, theirs. systematic_covariance, of
    the same shape: the part of it that repeats from frame to frame (rig and target); None where there is none.
    """

    t_s: float
    status: PoseStatus
    parent: str
    spots: tuple[str, ...] = ()
    T_parent_target: NDArray[np.float64] | None = None
    covariance: NDArray[np.float64] | None = None
    residual_px: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))
    why: str = ""
    systematic_covariance: NDArray[np.float64] | None = None
    origin_known: bool = False

    def __post_init__(self) -> None:
        if not np.isfinite(self.t_s):
            raise Inconsistent(f"the time {self.t_s} is not finite")
        size = self.status.size
        if (size == 0) != (self.T_parent_target is None) or (size == 0) != (self.covariance is None):
            raise Inconsistent(f"a pose of status {self.status} must have both pose and covariance, or neither")
        for name in ("covariance", "systematic_covariance"):
            if getattr(self, name) is not None:
                object.__setattr__(self, name, checks.frozen_array(name, getattr(self, name), (size, size)))
        if self.T_parent_target is not None:
            checks.freeze(self, T_parent_target=(4, 4))
        checks.freeze(self, residual_px=(None,))

    @property
    def pose(self) -> RigidTransform | None:
        """T_parent_target as a rigid transform, made anew: 40 us that no frame needs."""
        if self.T_parent_target is None:
            return None
        return RigidTransform(self.T_parent_target, normalize=False, copy=True)


@dataclass(frozen=True, slots=True)
class NotSeen:
    """What stands in the place of a view that there is none of: why, in words for people, and the cause for code.

    size: larger and smaller count of the points of the board that is seen instead, where one is.
    """

    why: str
    cause: Unseen = Unseen.OTHER
    size: tuple[int, int] | None = None


def covariances_of(poses: Sequence[TargetPose]) -> NDArray[np.float64] | None:
    """Return (n, 6, 6) of poses, or None where not every one brings standard deviations."""
    found = [p.covariance for p in poses if p.covariance is not None and (np.diag(p.covariance) > 0.0).all()]
    return np.stack(found) if len(found) == len(poses) else None
