"""Cameras and where they stand, each by its name, as arrays for compiled code as well."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from enum import StrEnum
from types import NoneType
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from armsight import records
from armsight.arrays import Array
from armsight.errors import Inconsistent, UsageError
from armsight.geometry import pose_from_rotvec
from armsight.geometry.poses import skew
from armsight.optics.camera import INTRINSICS, PACKED, RATIONAL_INTRINSICS, SIDES, Camera, names_beside, with_step
from armsight.optics.kernels.camera import project_many
from armsight.optics.kernels.wide import RATIONAL
from armsight.optics.mounted import MountedCamera, MountedZoom, place_of, require_names, with_each

PLACE = ("tx", "ty", "tz", "rx", "ry", "rz")
"""A mounted camera's pose in a rig's covariance: T_rig_camera moved as t + dt (m), Exp(dw) R (rad)."""

RIGHT_POSE = tuple(f"right.{name}" for name in PLACE)
"""Names of the pose parameters in a pair's covariance."""

RIG_PARAMETERS = tuple(f"{side}.{name}" for side in SIDES for name in INTRINSICS) + RIGHT_POSE
"""All 26 parameters that a pair of pinholes may name in its covariance, in the order of moved_rig; of any rig see
Rig.parameters."""


class RigKind(StrEnum):
    """Two real cameras, left and right; one camera that sees twice through mirrors; or any other cameras."""

    STEREO = "stereo"
    MIRROR = "mirror"
    CAMERAS = "cameras"


@dataclass(frozen=True, slots=True, kw_only=True, eq=False, init=False)
class Rig(records.Saveable):
    """One to eight cameras in an order, each by its name, with its pose in the rig's axes.

    covariance: of the calibration, named '<name>.<intrinsic>' (px) and '<name>.tx|ty|tz' (m), '<name>.rx|ry|rz' (rad)
    for the poses of all cameras but the first, which is held: its pose need not be the identity; None where not known.
    Names that are missing were held too. Optics makes no use of the cameras' noise and timing;
    optics.zoom_rig.at_zoom gives the rig at one setting of each zoom lens. found: what was worked out once from the
    fields above (its packed form); never part of the rig's value.
    """

    kind: RigKind
    cameras: tuple[MountedCamera, ...]
    covariance: records.NamedCovariance | None = None
    rms_px: float | None = None
    found: dict[str, object] = field(init=False, repr=False, default_factory=dict)

    def __init__(  # noqa: PLR0913  # a pair's, each by its keyword
        self,
        *,
        kind: RigKind | str | None = None,
        cameras: Sequence[MountedCamera] | None = None,
        covariance: records.NamedCovariance | None = None,
        rms_px: float | None = None,
        left: Camera | None = None,
        right: Camera | None = None,
        T_rig_left: RigidTransform | None = None,
        T_rig_right: RigidTransform | None = None,
        noise: Sequence[records.NoiseModel | None] | None = None,
        timing: Sequence[records.CameraTiming | None] | None = None,
        zoom: Sequence[MountedZoom | None] | None = None,
    ) -> None:
        """Take the cameras; or of a pair left, right and their poses.

        What is given beside cameras takes the place of theirs: noise, timing and zoom of all, in their order. Raises
        Inconsistent for other than one to eight names, each once, a kind that is not of these cameras, and a covariance
        of other parameters.
        """
        pair = zip(SIDES, (left, right), (T_rig_left, T_rig_right), strict=True)
        given = {side: {"camera": camera, "T_rig_camera": T} for side, camera, T in pair}
        records.require_kind(
            "cameras", cameras, tuple, list, NoneType, cure="Give a tuple of MountedCamera, or left and right"
        )
        if cameras is None:
            cameras = [MountedCamera(name=side, **own) for side, own in given.items()]  # type: ignore[arg-type]  # checked there
        else:
            for one in cameras:
                records.require_kind("one of cameras", one, MountedCamera)
            for side, own in given.items():
                some = {name: value for name, value in own.items() if value is not None}
                if some:
                    k = place_of(cameras, side)
                    cameras = (*cameras[:k], replace(cameras[k], **some), *cameras[k + 1 :])  # type: ignore[arg-type]
        mounted = with_each(cameras, {"noise": noise, "timing": timing, "zoom": zoom})
        values: dict[str, object] = {"cameras": mounted, "kind": _kind(kind, tuple(one.name for one in mounted))}
        values |= {"covariance": covariance, "rms_px": rms_px, "found": {}}
        for name, value in values.items():
            object.__setattr__(self, name, value)
        self._check()

    def _check(self) -> None:
        require_names(self.names)
        records.require_kind("covariance", self.covariance, records.NamedCovariance, NoneType)
        records.require_numbers(self, "rms_px")
        unknown = set(self.covariance.names if self.covariance else ()) - set(self.parameters)
        if unknown:
            raise Inconsistent(
                f"the rig's covariance names {', '.join(sorted(unknown)[:3])}, and its cameras {', '.join(self.names)} "
                "have no such parameter",
                consequence="The rig would be taken as better known than it is",
                cure="Name each NAME.fx ... of its camera, and NAME.tx ... NAME.rz of every camera but the first",
            )
        plate = next((one.name for one in self.cameras if one.camera.plate is not None), None)
        if plate is not None and self.kind is RigKind.CAMERAS:
            raise Inconsistent(
                f"the camera {plate} looks through a glass plate, and the rig is no mirror rig",
                cure="Leave the plate away; a mirror rig has the views left and right alone",
            )

    @property
    def names(self) -> tuple[str, ...]:
        """The cameras' names, in their order."""
        return tuple(one.name for one in self.cameras)

    @property
    def is_pair(self) -> bool:
        """Whether its cameras are left and right, in this order."""
        return self.names == SIDES

    @property
    def parameters(self) -> tuple[str, ...]:
        """The 16 V - 6 parameters that the covariance of V cameras may name, in the order of moved_rig.

        Of a pair the places of RIG_PARAMETERS. Where one lens is rational they are 19 V - 6, some of them empty places.
        """
        lenses = zip(self.names, names_beside([one.camera.lens for one in self.cameras]), strict=True)
        return (
            *(f"{one}.{name}" for one, names in lenses for name in names),
            *(f"{one.name}.{name}" for one in self.cameras[1:] for name in PLACE),
        )

    @property
    def left(self) -> Camera:
        """The camera called left. Raises UsageError where there is none."""
        return self.camera("left")

    @property
    def right(self) -> Camera:
        """The camera called right. Raises UsageError where there is none."""
        return self.camera("right")

    @property
    def T_rig_left(self) -> RigidTransform:
        """The left camera's pose in rig axes. Raises UsageError where there is none."""
        return self.T_rig_camera("left")

    @property
    def T_rig_right(self) -> RigidTransform:
        """The right camera's pose in rig axes. Raises UsageError where there is none."""
        return self.T_rig_camera("right")

    @property
    def baseline_m(self) -> float:
        """Distance of left's and right's centres of projection in m. Raises UsageError where there are none."""
        return float(np.linalg.norm(self.T_rig_right.translation - self.T_rig_left.translation))

    @property
    def noise(self) -> tuple[records.NoiseModel | None, ...]:
        """The noise of each camera's grey levels, where known."""
        return tuple(one.noise for one in self.cameras)

    @property
    def timing(self) -> tuple[records.CameraTiming | None, ...]:
        """When each camera's lines are exposed, where known."""
        return tuple(one.timing for one in self.cameras)

    @property
    def runs_free(self) -> bool:
        """Whether its cameras are known not to expose at once."""
        known = [one for one in self.timing if one is not None]
        return any(one.rolling or one.delay_s != 0.0 or one.drift_ppm != 0.0 for one in known)

    @property
    def zoom(self) -> tuple[MountedZoom | None, ...]:
        """The settings of each camera's lens, where it zooms."""
        return tuple(one.zoom for one in self.cameras)

    def camera(self, side: str) -> Camera:
        """Return the camera of a name, such as 'left'. Raises UsageError where there is none."""
        return self.cameras[place_of(self.cameras, side)].camera

    def T_rig_camera(self, side: str) -> RigidTransform:
        """Return the pose in rig axes of the camera of a name. Raises UsageError where there is none."""
        return self.cameras[place_of(self.cameras, side)].T_rig_camera

    def with_each(self, **values: Sequence[Any]) -> Rig:
        """Return the rig with other values of its cameras: fields of MountedCamera, by camera in the rig's order."""
        return replace(self, cameras=with_each(self.cameras, values))

    def only(self, *names: str) -> Rig:
        """Return the rig of these cameras in this order, its axes as they are. Raises UsageError for an unknown one."""
        if names == self.names:
            return self
        cameras = tuple(self.cameras[place_of(self.cameras, name)] for name in names)
        rig = Rig(cameras=cameras, rms_px=self.rms_px)
        return replace(rig, covariance=None if self.covariance is None else _held(self, self.covariance, rig))

    def pair(self) -> Rig:
        """Return the rig of its cameras left and right alone. Raises UsageError where it has none."""
        if self.is_pair:
            return self
        found = self.found.get("pair")
        if not isinstance(found, Rig):
            found = self.found["pair"] = self.only(*SIDES)
        return found

    def require_pair(self, what: str) -> Rig:
        """Return itself; raise UsageError, beginning with `what`, where its cameras are not left and right alone."""
        records.require_kind("what", what, str)
        if self.is_pair:
            return self
        raise UsageError(
            f"{what}: a rig of the cameras left and right is wanted, and this one has {', '.join(self.names)}",
            cure="Give the rig.yaml of a pair: `armsight calibrate stereo` makes one",
        )

    def project(self, points_m: ArrayLike) -> tuple[Array, ...]:
        """Return the pixels (n, 2) in each camera, in their order, of points (n, 3) or one (3,) in rig axes, in m.

        NaN behind a camera, beyond its widest_rad and where a point is NaN. Raises Inconsistent for any other shape.
        """
        X = records.checked_rows("points_m", points_m, 3, nan=True)
        packed, out = PackedRig.of(self), tuple(np.empty((len(X), 2)) for _ in self.cameras)
        for k, pixels in enumerate(out):
            project_many(*packed.camera(k), X, pixels)
        return out


def _kind(kind: RigKind | str | None, names: tuple[str, ...]) -> RigKind:
    """Return the kind of a rig of these cameras; Inconsistent where it cannot be the one that is given."""
    own = RigKind.STEREO if names == SIDES else RigKind.CAMERAS
    if kind is None:
        return own
    given = records.one_of(RigKind, "kind", kind)
    if (given is RigKind.CAMERAS) is (own is RigKind.CAMERAS):
        return given
    raise Inconsistent(
        f"a rig of kind {given.value} whose cameras are {', '.join(names)}",
        consequence="It is open which rig is meant",
        cure="A stereo or mirror rig has left and right, in this order, any other is of kind cameras; or leave it away",
    )


def _held(rig: Rig, known: records.NamedCovariance, new: Rig) -> records.NamedCovariance:
    """Return a rig's covariance as that of some of its cameras, whose first one is held in place of the rig's first.

    With all axes as they are: the whole is moved back by what the new first camera b is moved, dt_i - dt_b -
    dw_b x (t_i - t_b) and dw_i - dw_b of each.
    """
    names, wanted = rig.parameters, new.parameters
    J = np.zeros((len(wanted), len(names)))
    for row, name in enumerate(wanted):
        if name in names:
            J[row, names.index(name)] = 1.0
    first = new.cameras[0]
    if first.name != rig.cameras[0].name:
        b = names.index(f"{first.name}.tx")
        for one in new.cameras[1:]:
            row = wanted.index(f"{one.name}.tx")
            apart = np.asarray(one.T_rig_camera.translation) - np.asarray(first.T_rig_camera.translation)
            J[row : row + 6, b : b + 6] -= np.eye(6)
            J[row : row + 3, b + 3 : b + 6] += skew(apart)
    J = J[:, [names.index(name) for name in known.names]]
    free = np.flatnonzero(J.any(axis=1))
    return records.NamedCovariance(names=tuple(wanted[i] for i in free), matrix=J[free] @ known.matrix @ J[free].T)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PackedRig:
    """Intrinsics and plates k (V, 15); R (V, 3, 3), t (V, 3) with p_camera = R p_rig + t; first index: the camera.

    baseline (3,): from the first camera to the second in rig axes, in m; zero where there is one alone. covariance:
    (q, q) of the q Rig.parameters where the calibration brings one, zero for the parameters it held fixed;
    (0, 0) where the rig is taken as exact.
    """

    k: Array
    R: Array
    t: Array
    baseline: Array
    covariance: Array

    @property
    def n_intrinsics(self) -> int:
        """How many parameters the calibration has of each lens."""
        return len(RATIONAL_INTRINSICS if (self.k[:, len(INTRINSICS)] == RATIONAL).any() else INTRINSICS)

    @property
    def arrays(self) -> tuple[Array, Array, Array]:
        """The cameras as compiled code takes them, a RigK: a plain tuple is handed to it in half the time."""
        return self.k, self.R, self.t

    def camera(self, index: int) -> tuple[Array, Array, Array]:
        """Return one of them, a CameraK."""
        return self.k[index], self.R[index], self.t[index]

    @classmethod
    def of(cls, rig: Rig) -> PackedRig:
        """Return a rig packed, which is done once and kept with it."""
        found = rig.found.get("packed")
        if not isinstance(found, PackedRig):
            found = rig.found["packed"] = cls._pack(rig)
        return found

    @classmethod
    def _pack(cls, rig: Rig) -> PackedRig:
        poses, V = [one.T_rig_camera.inv() for one in rig.cameras], len(rig.cameras)
        first, second = rig.cameras[0].T_rig_camera, rig.cameras[min(1, V - 1)].T_rig_camera
        return cls(
            k=records.frozen_array("k", [one.camera.packed for one in rig.cameras], (V, PACKED)),
            R=records.frozen_array("R", [pose.rotation.as_matrix() for pose in poses], (V, 3, 3)),
            t=records.frozen_array("t", [pose.translation for pose in poses], (V, 3)),
            baseline=records.frozen_array("baseline", second.translation - first.translation, (3,)),
            covariance=records.frozen_array("covariance", _covariance(rig), (None, None)),
        )


def _covariance(rig: Rig) -> Array:
    if rig.covariance is None:
        return np.empty((0, 0))
    names = rig.parameters
    named = [i for i, name in enumerate(names) if name in rig.covariance.names]
    out = np.zeros((len(names), len(names)))
    out[np.ix_(named, named)] = rig.covariance.block(tuple(names[i] for i in named))
    return out


def moved_rig(rig: Rig, step: Array) -> Rig:
    """Return the rig, without covariance, its Rig.parameters moved by step; poses as t + dt, Exp(dw) R."""
    V = len(rig.cameras)
    split = len(step) - len(PLACE) * (V - 1)
    lenses, places = step[:split].reshape(V, -1), step[split:].reshape(V - 1, 6)
    poses = [rig.cameras[0].T_rig_camera]
    for one, move in zip(rig.cameras[1:], places, strict=True):
        T = one.T_rig_camera
        turned = Rotation.from_rotvec(move[3:]) * T.rotation
        poses.append(RigidTransform.from_components(np.asarray(T.translation) + move[:3], turned))
    every = zip(rig.cameras, lenses, poses, strict=True)
    cameras = [MountedCamera(name=one.name, camera=with_step(one.camera, k), T_rig_camera=T) for one, k, T in every]
    return Rig(kind=rig.kind, cameras=cameras)


def as_pair(rig: Rig, a: int, b: int) -> Rig:
    """Return the rig of the cameras a and b (from 0) of a rig as left and right, its axes as they are; exact."""
    if rig.is_pair and (a, b) == (0, 1):
        return rig
    return Rig(cameras=[replace(rig.cameras[i], name=side) for i, side in zip((a, b), SIDES, strict=True)])


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


def converged_rig(left: Camera, right: Camera, baseline_m: float, beta1_rad: float, beta2_rad: float) -> Rig:
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
