"""A zoom lens: a camera at several settings, and at the settings between them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from typing import Annotated

import numpy as np

from armsight.arrays import Array
from armsight.errors import Inconsistent, NotEnoughData
from armsight.fields import Doc
from armsight.optics.camera import INTRINSICS, Camera, LensKind
from armsight.optics.zoom_curves import Curves, curves
from armsight.records import NamedCovariance
from armsight.records.output import Output, output

N = len(INTRINSICS)

GROUPS = ((0,), (1, 4), (2, 3), (5, 6, 9), (7, 8), (10,))
"""Parameters of _shape that share the length over which they bend: focal length; pixels' form; centre; radial and
tangential distortion; pupil. One set of weights for the radial terms, which calibrations can hardly tell apart, mixes
distortions and not single coefficients."""

SAME_SETTING = 1e-9
"""Settings nearer than this share of the range are one: what rounding in a file leaves."""

SURE = 5.0
"""Standard deviations beyond which two settings contradict each other."""

SAME_PIXELS = 2e-3
"""Pixels' height over width that two calibrations of one sensor may differ by beyond their claims: 0.2 %."""

CENTRE_WANDER = 0.15
"""Of the image's diagonal: lenses' centres wander by up to 5 % of it over their whole range."""

IMAGE_GRID = 9
"""Points along each side of the image at which two cameras are compared."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ZoomSetting:
    """A camera calibrated at one value of its zoom, in whatever unit the lens is set in.

    covariance: of the calibration, names of INTRINSICS; None: taken as exact. pupil_m: where the centre of projection
    stands along the optical axis, forward positive, from any one origin for all settings; pupil_std_m its standard
    deviation; None where not known.
    """

    zoom: float
    camera: Camera
    covariance: NamedCovariance | None = None
    rms_px: float | None = None
    pupil_m: float | None = None
    pupil_std_m: float = 0.0

    def __post_init__(self) -> None:
        if self.camera.lens is not LensKind.PINHOLE:
            raise Inconsistent(
                f"zoom {self.zoom:g}: a {self.camera.lens} lens as a setting of a zoom lens",
                consequence="Curves between settings are of pinholes",
                cure="Calibrate a fisheye without --zoom",
            )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ZoomState:
    """The camera at a zoom. covariance: of all INTRINSICS, calibration and interpolation.

    interpolated: whether the zoom lies between settings. interpolation: the part of the standard deviations by name
    that the interpolation brings. pupil_m, pupil_std_m: as of a setting; 0 where the settings do not say it.
    """

    zoom: float
    camera: Camera
    covariance: NamedCovariance
    interpolated: bool
    interpolation: dict[str, float]
    pupil_m: float
    pupil_std_m: float


@output
class LeftOut(Output):
    """A setting predicted from the others: error (predicted minus calibrated) and what was claimed for it.

    focal_error_px: of fx; focal_std_px: claimed, of prediction and calibration together; None where too few others are
    left to claim anything. image_rms_px: how far the pixels of equal rays are apart, over the image.
    """

    zoom: Annotated[float, Doc("The setting.")]
    focal_error_px: Annotated[float, Doc("Focal length along x, predicted minus calibrated, px.")]
    focal_std_px: Annotated[float | None, Doc("What was claimed for it, px; null where two others are left.")]
    image_rms_px: Annotated[float, Doc("Distance of the pixels of equal rays over the image, RMS, px.")]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ZoomLens:
    """Settings of one lens before one sensor, sorted by their zoom.

    Raises Inconsistent for settings that cannot be of one camera: unequal image sizes or pixels, a focal length that
    does not go one way, a centre that jumps; or one zoom twice.
    """

    settings: tuple[ZoomSetting, ...]
    _shapes: Array = field(init=False, repr=False)
    _covariances: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        settings = tuple(sorted(self.settings, key=lambda one: one.zoom))
        object.__setattr__(self, "settings", settings)
        _require_one_camera(settings)
        object.__setattr__(self, "_shapes", np.array([_shape(one) for one in settings]))
        object.__setattr__(self, "_covariances", np.array([_shape_covariance(one) for one in settings]))

    @property
    def zooms(self) -> Array:
        """The calibrated values of the zoom (n,), increasing."""
        return np.array([one.zoom for one in self.settings])

    @property
    def size(self) -> tuple[int, int]:
        """Width and height of the images in px."""
        return self.settings[0].camera.width, self.settings[0].camera.height

    def setting(self, zoom: float) -> ZoomSetting | None:
        """Return the setting calibrated at a zoom; None where there is none."""
        tolerance = SAME_SETTING * max(float(np.ptp(self.zooms)), abs(zoom))
        return next((one for one in self.settings if abs(one.zoom - zoom) <= tolerance), None)

    def at(self, zoom: float) -> ZoomState:
        """Return the camera at a zoom, calibrated or interpolated between three. Raises NotEnoughData outside."""
        found = self.setting(zoom)
        if found is not None:
            return _as_calibrated(found)
        self._require_within(zoom)
        return self._between(zoom)

    def left_out(self) -> tuple[LeftOut, ...]:
        """Predict each setting but the first and last from all others; empty with fewer than three."""
        out = []
        for i in range(1, len(self.settings) - 1):
            here = self.settings[i]
            others = replace(self, settings=(*self.settings[:i], *self.settings[i + 1 :]))
            if len(others.settings) >= 3:
                state = others.at(here.zoom)
                known = 0.0 if here.covariance is None else here.covariance.std().get("fx", 0.0)
                claimed = float(np.hypot(state.covariance.std()["fx"], known))
                out.append(_compared(here, state.camera, claimed))
            else:
                out.append(_compared(here, others._straight(here.zoom), None))
        return tuple(out)

    def with_setting(self, setting: ZoomSetting) -> ZoomLens:
        """Return the lens with one setting more, in place of the one at its zoom if there is one."""
        old = self.setting(setting.zoom)
        return ZoomLens(settings=(*(one for one in self.settings if one is not old), setting))

    def _require_within(self, zoom: float) -> None:
        low, high = self.zooms[[0, -1]]
        values = ", ".join(f"{value:g}" for value in self.zooms)
        if len(self.settings) < 3:
            raise NotEnoughData(
                f"zoom {zoom:g} is asked for, and the lens is calibrated at {values} only",
                consequence="What lies between settings is told by three of them or more, so there is no camera for it",
                cure=f"Set the lens to {values.replace(', ', ' or ')}, or calibrate more settings "
                "(armsight calibrate camera --zoom)",
            )
        if not low <= zoom <= high:
            raise NotEnoughData(
                f"zoom {zoom:g} is outside the calibrated range, {low:g} to {high:g}",
                consequence="Nothing is known of the lens there, and nothing is extrapolated",
                cure=f"Set the lens within {low:g} to {high:g}, or calibrate a setting at or beyond {zoom:g} "
                "(armsight calibrate camera --zoom)",
            )

    def _between(self, zoom: float) -> ZoomState:
        x, low = self.zooms, self.zooms[0]
        span = x[-1] - low
        unit, at = (x - low) / span, np.array([(zoom - low) / span])
        weights, own = np.zeros((N + 1, len(x))), np.zeros(N + 1)
        for group in GROUPS:
            index = list(group)
            variance = self._covariances[:, index, index].T
            found: Curves = curves(unit, self._shapes[:, index].T, variance, at)
            weights[index], own[index] = found.weights[0], found.variance[:, 0]
        shape = np.einsum("pn,np->p", weights, self._shapes)
        covariance = np.einsum("pn,npq,qn->pq", weights, self._covariances, weights)
        camera = _camera(shape, self.settings[0].camera)
        J = np.linalg.inv(_slopes(camera.intrinsics, _half_diagonal(camera)))
        of_own = J @ np.diag(own[:N]) @ J.T
        both = J @ covariance[:N, :N] @ J.T + of_own
        return ZoomState(
            zoom=zoom,
            camera=camera,
            covariance=NamedCovariance(names=INTRINSICS, matrix=0.5 * (both + both.T)),
            interpolated=True,
            interpolation=dict(zip(INTRINSICS, np.sqrt(np.maximum(np.diag(of_own), 0.0)).tolist(), strict=True)),
            pupil_m=float(shape[N]),
            pupil_std_m=float(np.sqrt(covariance[N, N] + own[N])),
        )

    def _straight(self, zoom: float) -> Camera:
        """Return the camera on straight lines between the first and the last setting."""
        x = self.zooms
        share = (zoom - x[0]) / (x[-1] - x[0])
        return _camera((1.0 - share) * self._shapes[0] + share * self._shapes[-1], self.settings[0].camera)


def image_distance(one: Camera, other: Camera) -> float:
    """Return the RMS distance in px, over the first camera's image, between both cameras' pixels of equal rays."""
    u, v = np.meshgrid(np.linspace(0.0, one.width - 1.0, IMAGE_GRID), np.linspace(0.0, one.height - 1.0, IMAGE_GRID))
    uv = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = one.rays(uv)
    seen = np.isfinite(rays).all(axis=1)
    moved = other.project(np.column_stack([rays[seen], np.ones(int(seen.sum()))])) - uv[seen]
    return float(np.sqrt((moved**2).sum(axis=1).mean()))


def _as_calibrated(setting: ZoomSetting) -> ZoomState:
    matrix = np.zeros((N, N))
    if setting.covariance is not None:
        known = [i for i, name in enumerate(INTRINSICS) if name in setting.covariance.names]
        matrix[np.ix_(known, known)] = setting.covariance.block(tuple(INTRINSICS[i] for i in known))
    return ZoomState(
        zoom=setting.zoom,
        camera=setting.camera,
        covariance=NamedCovariance(names=INTRINSICS, matrix=matrix),
        interpolated=False,
        interpolation=dict.fromkeys(INTRINSICS, 0.0),
        pupil_m=setting.pupil_m or 0.0,
        pupil_std_m=setting.pupil_std_m,
    )


def _compared(here: ZoomSetting, camera: Camera, claimed_px: float | None) -> LeftOut:
    return LeftOut(
        zoom=here.zoom,
        focal_error_px=float(camera.intrinsics[0] - here.camera.intrinsics[0]),
        focal_std_px=claimed_px,
        image_rms_px=image_distance(here.camera, camera),
    )


def _half_diagonal(camera: Camera) -> float:
    return 0.5 * float(np.hypot(camera.width, camera.height))


def _shape(setting: ZoomSetting) -> Array:
    """Return what changes smoothly with zoom (11,): ln fx, ln fy/fx, cx, cy, skew/fx, distortion, pupil.

    Distortion is counted in half diagonals of the image and not in rays' slopes: k1 grows with f^2 in a lens whose
    picture is bent alike at all settings.
    """
    camera = setting.camera
    fx, fy, cx, cy, skew, k1, k2, p1, p2, k3 = camera.intrinsics
    s = _half_diagonal(camera) / fx
    bent = (k1 * s**2, k2 * s**4, p1 * s, p2 * s, k3 * s**6)
    return np.array([np.log(fx), np.log(fy / fx), cx, cy, skew / fx, *bent, setting.pupil_m or 0.0])


def _camera(shape: Array, like: Camera) -> Camera:
    fx = np.exp(shape[0])
    s = _half_diagonal(like) / fx
    d1, d2, e1, e2, d3 = shape[5:N]
    k = [fx, fx * np.exp(shape[1]), shape[2], shape[3], shape[4] * fx, d1 / s**2, d2 / s**4, e1 / s, e2 / s, d3 / s**6]
    return replace(like, intrinsics=np.array(k))


def _slopes(k: Array, half_px: float) -> Array:
    """Return d shape / d intrinsics (10, 10) at intrinsics k (10,)."""
    fx, fy, skew = k[0], k[1], k[4]
    s = half_px / fx
    J = np.eye(N)
    J[0, 0], J[1, 0], J[1, 1] = 1.0 / fx, -1.0 / fx, 1.0 / fy
    J[4, 0], J[4, 4] = -skew / fx**2, 1.0 / fx
    for i, power in ((5, 2), (6, 4), (7, 1), (8, 1), (9, 6)):
        J[i, i] = s**power
        J[i, 0] = -power * k[i] * s**power / fx
    return J


def _shape_covariance(setting: ZoomSetting) -> Array:
    """Return the covariance (11, 11) of a setting's _shape."""
    k = setting.camera.intrinsics
    J = _slopes(k, _half_diagonal(setting.camera))
    out = np.zeros((N + 1, N + 1))
    out[:N, :N] = J @ _as_calibrated(setting).covariance.matrix @ J.T
    out[N, N] = setting.pupil_std_m**2
    return out


def _require_one_camera(settings: Sequence[ZoomSetting]) -> None:
    """Raise Inconsistent for settings that cannot be of one camera."""
    if not settings:
        raise NotEnoughData("a zoom lens without settings is none", cure="Calibrate it at one zoom or more")
    for one, following in pairwise(settings):
        if following.zoom - one.zoom <= SAME_SETTING * max(abs(one.zoom), abs(settings[-1].zoom - settings[0].zoom)):
            raise Inconsistent(f"the zoom {one.zoom:g} stands twice among the settings", cure="Leave one of them out")
        _require_alike(one, following)
    if any(one.camera.plate is not None for one in settings):
        raise Inconsistent("a view through a mirror rig's glass plate has no zoom settings")
    if len({one.pupil_m is None for one in settings}) > 1:
        raise Inconsistent(
            "some settings say where the pupil stands, others do not",
            consequence="It cannot be followed from one to the other",
            cure="Give pupil_m (--pupil) for all settings or for none",
        )
    _require_one_way(settings)


def _require_alike(one: ZoomSetting, other: ZoomSetting) -> None:
    """Raise Inconsistent where sizes, pixels or centres of two neighbouring settings contradict each other."""
    a, b = one.camera, other.camera
    pair = f"the settings {one.zoom:g} and {other.zoom:g}"
    if (a.width, a.height) != (b.width, b.height):
        raise Inconsistent(
            f"{pair} are of images of {a.width}x{a.height} and {b.width}x{b.height} px",
            consequence="One lens before one sensor has one size of image",
            cure="Calibrate all settings at the resolution that is measured with",
        )
    two_cameras = "These are not settings of one lens before one sensor"
    cure = "Give each camera a file of its own, and calibrate the setting anew that is not this camera's"
    forms = [camera.intrinsics[1] / camera.intrinsics[0] for camera in (a, b)]
    doubt = np.hypot(*(np.sqrt(_shape_covariance(setting)[1, 1]) for setting in (one, other)))
    if abs(np.log(forms[1] / forms[0])) > SAME_PIXELS + SURE * doubt:
        raise Inconsistent(
            f"{pair} have pixels {forms[0]:.4f} and {forms[1]:.4f} times as high as wide (fy / fx)",
            consequence=two_cameras,
            cure=cure,
        )
    moved = float(np.linalg.norm(b.intrinsics[2:4] - a.intrinsics[2:4]))
    std = np.sqrt(sum(np.trace(_as_calibrated(setting).covariance.matrix[2:4, 2:4]) for setting in (one, other)))
    if moved > 2.0 * CENTRE_WANDER * _half_diagonal(a) + SURE * std:
        raise Inconsistent(f"between {pair} the centre moves by {moved:.0f} px", consequence=two_cameras, cure=cure)


def _require_one_way(settings: Sequence[ZoomSetting]) -> None:
    """Raise Inconsistent where the focal length surely both rises and falls with the zoom."""
    f = np.array([one.camera.intrinsics[0] for one in settings])
    std = np.array([np.sqrt(_as_calibrated(one).covariance.matrix[0, 0]) for one in settings])
    step, doubt = np.diff(f), SURE * np.hypot(std[1:], std[:-1])
    if (step > doubt).any() and (step < -doubt).any():
        wrong = int(np.flatnonzero(np.sign(step) != np.sign(f[-1] - f[0]))[0])
        listed = ", ".join(f"{one.zoom:g}: {value:.1f}" for one, value in zip(settings, f, strict=True))
        raise Inconsistent(
            f"the focal length does not go one way with the zoom (fx by zoom: {listed} px)",
            consequence="These are not settings of one lens before one sensor, or one bears the wrong zoom",
            cure=f"Check the settings {settings[wrong].zoom:g} and {settings[wrong + 1].zoom:g}, and calibrate the "
            "wrong one anew",
        )
