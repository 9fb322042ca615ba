"""Two cameras and where they stand, as arrays for compiled code as well, at one zoom, and the papers' rigs by name."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
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
from armsight.optics.zoom import SURE, ZoomLens, ZoomState
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


SAME_FOCAL = 2e-3
"""Share by which a lens's focal length may differ from the rig's at the same zoom, beyond what both claim: motors come
back to a setting to about a thousandth."""

Zooms = tuple[float | None, float | None]
"""The zoom of the left and of the right camera; None for a camera without zoom."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class RigAtZoom:
    """A rig without zoom settings, as it is at one setting of each lens; states: left and right, None without zoom."""

    rig: Rig
    states: tuple[ZoomState | None, ZoomState | None]


def with_zoom(rig: Rig, lenses: tuple[ZoomLens | None, ZoomLens | None], at: Zooms) -> Rig:
    """Return a rig that was calibrated at the zooms `at`, with the settings of its lenses.

    Raises Inconsistent for a mirror rig, a lens of another image size, and a setting at which the lens has clearly
    another focal length than the rig; NotEnoughData for one outside a lens's range.
    """
    if rig.kind is RigKind.MIRROR:
        raise Inconsistent("a mirror rig is one camera that sees twice; it takes no zoom settings")
    mounted = tuple(
        None if lens is None else _mounted(rig, side, lens, value)
        for side, lens, value in zip(SIDES, lenses, at, strict=True)
    )
    return replace(rig, zoom=(mounted[0], mounted[1]))


def at_zoom(rig: Rig, zoom: Zooms) -> RigAtZoom:
    """Return the rig at one setting of each lens.

    A side that stands where the rig was calibrated keeps that calibration. Of the others the intrinsics are the lens's,
    with its covariance, independent of the rig's; the place of the right camera keeps the rig's covariance, and moves
    with the pupils where the settings tell these. Raises UsageError where a zoom is missing, or given for a camera that
    has none; NotEnoughData as ZoomLens.at.
    """
    states: list[ZoomState | None] = []
    moved: dict[str, ZoomState] = {}
    for side, mounted, value in zip(SIDES, rig.zoom, zoom, strict=True):
        state = None if mounted is None else mounted.lens.at(_required(side, mounted, value))
        if mounted is None and value is not None:
            raise UsageError(
                f"a zoom is given for the {side} camera, and the rig's file has no zoom settings of it",
                consequence="Nobody knows what the lens does there",
                cure=f"Leave --zoom-{side} away, or add the settings with armsight calibrate zoom-rig",
            )
        states.append(state)
        if state is not None and mounted is not None and not _is_at(mounted, state.zoom):
            moved[side] = state
    return RigAtZoom(rig=_moved(rig, moved), states=(states[0], states[1]))


def _required(side: str, mounted: MountedZoom, value: float | None) -> float:
    if value is not None:
        return value
    low, high = mounted.lens.zooms[[0, -1]]
    raise UsageError(
        f"the rig's {side} camera has a zoom lens, and its zoom is not given",
        consequence="Its focal length is open",
        cure=f"Give --zoom-{side} with the value that the lens stood at, {low:g} to {high:g}; for a command that takes "
        "none, make the file of one setting with armsight convert rig --zoom-left --zoom-right",
    )


def _is_at(mounted: MountedZoom, zoom: float) -> bool:
    """Tell whether a zoom is the one at which the rig was calibrated."""
    return abs(zoom - mounted.at) <= 1e-9 * max(abs(zoom), float(np.ptp(mounted.lens.zooms)))


def _mounted(rig: Rig, side: str, lens: ZoomLens, at: float | None) -> MountedZoom:
    if at is None:
        raise UsageError(
            f"it is not said at which zoom the {side} camera stood when the rig was calibrated",
            cure=f"Give --zoom-{side}",
        )
    camera, state = rig.camera(side), lens.at(at)
    if lens.size != (camera.width, camera.height):
        raise Inconsistent(
            f"the {side} lens's settings are of {lens.size[0]}x{lens.size[1]} px, the rig's camera has "
            f"{camera.width}x{camera.height} px",
            consequence="They are not of one camera",
            cure="Calibrate lens and rig at one resolution",
        )
    name = f"{side}.fx"
    known = 0.0 if rig.covariance is None else rig.covariance.std().get(name, 0.0)
    doubt = float(np.hypot(state.covariance.std()["fx"], known))
    gap = abs(float(state.camera.intrinsics[0] - camera.intrinsics[0]))
    if gap > SURE * doubt + SAME_FOCAL * camera.intrinsics[0]:
        raise Inconsistent(
            f"at zoom {at:g} the {side} lens's focal length is {state.camera.intrinsics[0]:.1f} px, in the rig it is "
            f"{camera.intrinsics[0]:.1f} px (standard deviation of the difference {doubt:.2g} px)",
            consequence="The settings are of another camera, or the rig was calibrated at another zoom",
            cure=f"Check the file of the {side} lens, left and right, and --zoom-{side}",
        )
    return MountedZoom(lens=lens, at=at)


def _moved(rig: Rig, moved: dict[str, ZoomState]) -> Rig:
    """Return the rig without settings, the sides in moved as their states say."""
    plain = replace(rig, zoom=(None, None))
    if not moved:
        return plain
    cameras = {side: moved[side].camera if side in moved else rig.camera(side) for side in SIDES}
    poses = {side: rig.T_rig_camera(side) for side in SIDES}
    pupils = np.zeros((3, 3))
    for side, mounted in zip(SIDES, rig.zoom, strict=True):
        if side in moved and mounted is not None:
            there = mounted.lens.at(mounted.at)
            shift = RigidTransform.from_translation([0.0, 0.0, moved[side].pupil_m - there.pupil_m])
            axis = poses[side].rotation.as_matrix()[:, 2]
            pupils += (moved[side].pupil_std_m ** 2 + there.pupil_std_m**2) * np.outer(axis, axis)
            poses[side] = poses[side] * shift
    return replace(
        plain,
        left=cameras["left"],
        right=cameras["right"],
        T_rig_left=poses["left"],
        T_rig_right=poses["right"],
        covariance=_zoomed_covariance(rig.covariance, moved, pupils),
    )


def _zoomed_covariance(known: NamedCovariance | None, moved: dict[str, ZoomState], pupils_m2: Array) -> NamedCovariance:
    """Return the covariance of what the rig keeps, of the lenses at their zooms, and of the pupils' way."""
    names = () if known is None else known.names
    kept = tuple(name for name in names if name.split(".")[0] not in moved or name in RIGHT_POSE)
    kept += tuple(name for name in RIGHT_POSE[:3] if name not in kept)
    both = kept + tuple(f"{side}.{name}" for side in moved for name in INTRINSICS)
    matrix = np.zeros((len(both), len(both)))
    if known is not None:
        here = [i for i, name in enumerate(kept) if name in names]
        matrix[np.ix_(here, here)] = known.block(tuple(kept[i] for i in here))
    rows = [kept.index(name) for name in RIGHT_POSE[:3]]
    matrix[np.ix_(rows, rows)] += pupils_m2
    for i, state in enumerate(moved.values()):
        at = slice(len(kept) + i * len(INTRINSICS), len(kept) + (i + 1) * len(INTRINSICS))
        matrix[at, at] = state.covariance.matrix
    return NamedCovariance(names=both, matrix=matrix)
