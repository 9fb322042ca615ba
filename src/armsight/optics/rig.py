"""Two cameras and where they stand, as plain arrays for compiled code as well, and the papers' rigs by name."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from types import NoneType

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform

from armsight.arrays import Array
from armsight.errors import Inconsistent, UsageError
from armsight.geometry import pose_from_rotvec
from armsight.optics.camera import INTRINSICS, SIDES, Camera
from armsight.optics.kernels.camera import project_many
from armsight.optics.zoom import ZoomLens
from armsight.records import (
    CameraTiming,
    NamedCovariance,
    NoiseModel,
    Saveable,
    checked_rows,
    frozen_array,
    one_of,
    require_kind,
    require_numbers,
)

RIGHT_POSE = tuple(f"right.{name}" for name in ("tx", "ty", "tz", "rx", "ry", "rz"))
"""Names of the pose parameters in a rig's covariance: T_rig_right moved as t + dt, Exp(dw) R."""

RIG_PARAMETERS = tuple(f"{side}.{name}" for side in SIDES for name in INTRINSICS) + RIGHT_POSE
"""All 26 parameters that a rig of two pinholes may name in its covariance, in the order of moved_rig; of any rig see
Rig.parameters."""


class RigKind(StrEnum):
    """Two real cameras, or one camera that sees twice through mirrors."""

    STEREO = "stereo"
    MIRROR = "mirror"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MountedZoom:
    """The zoom lens of a rig's camera; at: the zoom that the rig was calibrated at and its `left` or `right` is of."""

    lens: ZoomLens
    at: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rig(Saveable):
    """Left and right camera, each with its pose in the rig's axes.

    covariance: of the calibration, named '<side>.<intrinsic>' (px) and 'right.tx|ty|tz' (m), 'right.rx|ry|rz'
    (rad) for the pose T_rig_right of a rig whose reference is the left camera; None where not known. noise: of the grey
    levels of the left and the right camera, where known; timing: when their lines are exposed. Optics makes no use of
    either. zoom: the lenses' settings, where they zoom; optics.zoom_rig.at_zoom gives the rig at one of each.
    found: what was worked out once from the fields above (its packed form); never part of the rig's value.
    """

    kind: RigKind
    left: Camera
    right: Camera
    T_rig_left: RigidTransform
    T_rig_right: RigidTransform
    covariance: NamedCovariance | None = None
    rms_px: float | None = None
    noise: tuple[NoiseModel | None, NoiseModel | None] = (None, None)
    timing: tuple[CameraTiming | None, CameraTiming | None] = (None, None)
    zoom: tuple[MountedZoom | None, MountedZoom | None] = (None, None)
    found: dict[str, object] = field(init=False, repr=False, default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "kind", one_of(RigKind, "kind", self.kind))
        for name in SIDES:
            require_kind(name, self.camera(name), Camera)
            require_kind(f"T_rig_{name}", self.T_rig_camera(name), RigidTransform)
        require_kind("covariance", self.covariance, NamedCovariance, NoneType)
        require_numbers(self, "rms_px")
        for name, kind in (("noise", NoiseModel), ("timing", CameraTiming), ("zoom", MountedZoom)):
            pair = getattr(self, name)
            require_kind(name, pair, tuple, cure="Give (left, right), None where not known")
            if len(pair) != len(SIDES):
                raise UsageError(
                    f"{name} has {len(pair)} entries", consequence="A rig has two cameras", cure="Give two"
                )
            for side, each in zip(SIDES, pair, strict=True):
                require_kind(f"{name} of the {side} camera", each, kind, NoneType)

    @property
    def parameters(self) -> tuple[str, ...]:
        """The 26 parameters that its covariance may name, in the order of moved_rig: the places of RIG_PARAMETERS."""
        return tuple(f"{side}.{name}" for side in SIDES for name in self.camera(side).names) + RIGHT_POSE

    @property
    def baseline_m(self) -> float:
        """Distance between the two centres of projection in m."""
        return float(np.linalg.norm(self.T_rig_right.translation - self.T_rig_left.translation))

    def camera(self, side: str) -> Camera:
        """Return the camera of 'left' or 'right'."""
        _require_side(side)
        return self.left if side == "left" else self.right

    def T_rig_camera(self, side: str) -> RigidTransform:
        """Return the pose of the 'left' or 'right' camera in rig axes."""
        _require_side(side)
        return self.T_rig_left if side == "left" else self.T_rig_right

    def project(self, points_m: ArrayLike) -> tuple[Array, Array]:
        """Return the left and right pixels (n, 2) of points (n, 3) or one (3,) in rig axes, in m.

        NaN behind a camera, beyond its widest_rad and where a point is NaN. Raises Inconsistent for any other shape.
        """
        X = checked_rows("points_m", points_m, 3, nan=True)
        packed = PackedRig.of(self)
        left, right = np.empty((len(X), 2)), np.empty((len(X), 2))
        project_many(packed.k[0], packed.R[0], packed.t[0], X, left)
        project_many(packed.k[1], packed.R[1], packed.t[1], X, right)
        return left, right


def _require_side(side: str) -> None:
    if side not in SIDES:
        raise UsageError(
            f"there is no camera {side!r}", consequence="None is given", cure=f"Use one of: {', '.join(SIDES)}"
        )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PackedRig:
    """Intrinsics and plates k (2, 12); R (2, 3, 3), t (2, 3) with p_camera = R p_rig + t; baseline (3,) m.

    First index: left, right. covariance: (26, 26) of Rig.parameters where the calibration brings one, zero for the
    parameters it held fixed; (0, 0) where the rig is taken as exact.
    """

    k: Array
    R: Array
    t: Array
    baseline: Array
    covariance: Array

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """The cameras as compiled code takes them, a RigK: a plain tuple is handed to it in half the time."""
        return self.k, self.R, self.t

    def camera(self, side: int) -> tuple[Array, Array, Array]:
        """Return one of them, a CameraK; side 0: left, 1: right."""
        return self.k[side], self.R[side], self.t[side]

    @classmethod
    def of(cls, rig: Rig) -> PackedRig:
        """Return a rig packed, which is done once and kept with it."""
        found = rig.found.get("packed")
        if not isinstance(found, PackedRig):
            found = rig.found["packed"] = cls._pack(rig)
        return found

    @classmethod
    def _pack(cls, rig: Rig) -> PackedRig:
        poses = [rig.T_rig_camera(side).inv() for side in SIDES]
        return cls(
            k=frozen_array("k", [rig.camera(side).packed for side in SIDES], (2, 12)),
            R=frozen_array("R", [pose.rotation.as_matrix() for pose in poses], (2, 3, 3)),
            t=frozen_array("t", [pose.translation for pose in poses], (2, 3)),
            baseline=frozen_array("baseline", rig.T_rig_right.translation - rig.T_rig_left.translation, (3,)),
            covariance=frozen_array("covariance", _covariance(rig), (None, None)),
        )


def _covariance(rig: Rig) -> Array:
    if rig.covariance is None:
        return np.empty((0, 0))
    names = rig.parameters
    named = [i for i, name in enumerate(names) if name in rig.covariance.names]
    out = np.zeros((len(names), len(names)))
    out[np.ix_(named, named)] = rig.covariance.block(tuple(names[i] for i in named))
    return out


def parallel_rig(camera: Camera, baseline_m: float, right: Camera | None = None) -> Rig:
    """Return a pair with parallel axes, the right camera baseline_m along the left one's x (Kapucu 2005).

    The rig's axes are the left camera's. Raises Inconsistent where the baseline is not positive.
    """
    if not baseline_m > 0.0:
        raise Inconsistent(
            f"a baseline of {baseline_m} m is not positive",
            consequence="Two views from one place tell no distance",
            cure="Give the distance between the cameras; the right one stands at +x of the left",
        )
    return Rig(
        kind=RigKind.STEREO,
        left=camera,
        right=right or camera,
        T_rig_left=RigidTransform.identity(),
        T_rig_right=RigidTransform.from_translation([baseline_m, 0.0, 0.0]),
    )


def converged_rig(
    left: Camera,
    right: Camera,
    baseline_m: float,
    beta1_rad: float,
    beta2_rad: float,
) -> Rig:
    """Return Korayem's rig: cameras at x = -B/2 and +B/2, optical axes (sin beta, 0, cos beta) in rig axes.

    Both angles count in the same sense, about the rig's y; cameras that look at one point in front have
    beta1 > 0 > beta2 (MATH A16). The focal lengths F1, F2 are those of the cameras. The rig's origin is midway
    between the centres of projection. Raises Inconsistent for a baseline that is not positive.
    """
    if not baseline_m > 0.0:
        raise Inconsistent(f"a baseline of {baseline_m} m is not positive", cure="Give the distance between the lenses")
    half = 0.5 * baseline_m
    return Rig(
        kind=RigKind.STEREO,
        left=left,
        right=right,
        T_rig_left=pose_from_rotvec([-half, 0.0, 0.0], [0.0, beta1_rad, 0.0]),
        T_rig_right=pose_from_rotvec([half, 0.0, 0.0], [0.0, beta2_rad, 0.0]),
    )
