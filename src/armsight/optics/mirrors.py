"""The mirror rig of Pachidis 2005 (PSVS): one camera, four mirrors; its closed forms, its exact form, its alignment.

Rig axes are those of the real camera O: x right, y down, z forward. The right view leaves by mirror 1 (the coated
front of a thin half-silvered plate) and mirror 2, the left one through the plate, by mirrors 3 and 4; all stand at 45
degrees.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Annotated

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.arrays import Array
from armsight.columns import POSITION
from armsight.defaults import MIRROR_GAP_M, PLATE_NEAR_M
from armsight.errors import Inconsistent, NotConverged
from armsight.fields import Doc
from armsight.fitting import Evaluation, Problem, solve
from armsight.optics.camera import INTRINSICS, SIDES, Camera, Plate
from armsight.optics.kernels.camera import plate_shift
from armsight.optics.rig import Rig, RigKind
from armsight.records.output import Output, output

HALF_RIGHT_ANGLE = 0.25 * np.pi
SLANT = np.sqrt(0.5)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Mirrors:
    """How the mirrors were built: what the rig would be if all stood at 45 degrees.

    baseline_m: b, between the virtual cameras. plate: mirror 1. near_m: from the lens to the plate along the axis;
    gap_m: from there to mirror 3. tilts_rad (4, 2): of mirrors 1 to 4, about the vertical y, and about the line in its
    face square to y; each about the place where the chief ray meets it.
    """

    baseline_m: float
    plate: Plate = field(default_factory=lambda: Plate(thickness_m=1e-3))
    near_m: float = PLATE_NEAR_M
    gap_m: float = MIRROR_GAP_M
    tilts_rad: Array | None = None

    def __post_init__(self) -> None:
        if not (self.baseline_m > 0.0 and self.near_m > 0.0 and self.gap_m > 0.0):
            raise Inconsistent(
                f"mirrors with a baseline of {self.baseline_m:g} m, {self.near_m:g} m before the lens and "
                f"{self.gap_m:g} m apart cannot be",
                consequence="There is no rig",
                cure="Give lengths above zero, in m",
            )

    def rig(self, camera: Camera) -> Rig:
        """Return the rig that the mirrors make of a camera: exact per ray (MATH 3.1)."""
        poses = {side: self.pose(side) for side in SIDES}
        return Rig(
            kind=RigKind.MIRROR,
            left=replace(camera, plate=self.plate),
            right=replace(camera, plate=None),
            T_rig_left=poses["left"],
            T_rig_right=poses["right"],
        )

    def pose(self, side: str) -> RigidTransform:
        """Return T_rig_left or T_rig_right: the camera reflected by two mirrors, the left one shifted by the plate."""
        T = np.eye(4)
        for point, normal in self._mirrors(side):
            reflect = np.eye(4)
            reflect[:3, :3] -= 2.0 * np.outer(normal, normal)
            reflect[:3, 3] = 2.0 * (point @ normal) * normal
            T = reflect @ T
        if side == "left":
            mu = plate_shift(self.plate.thickness_m, self.plate.index, 0.0, 0.0)
            T[:3, 3] += T[:3, :3] @ np.array([-mu, 0.0, mu])
        return RigidTransform.from_matrix(T)

    def _mirrors(self, side: str) -> list[tuple[Array, Array]]:
        tilts = np.zeros((4, 2)) if self.tilts_rad is None else np.asarray(self.tilts_rad, float)
        away = 1.0 if side == "right" else -1.0
        upright = np.array([away * SLANT, 0.0, -SLANT])
        across = np.array([-upright[2], 0.0, upright[0]])
        at = np.array([0.0, 0.0, self.near_m + (0.0 if side == "right" else self.gap_m)])
        out = np.array([away * 0.5 * self.baseline_m, 0.0, 0.0])
        first = 0 if side == "right" else 2
        normals = [
            Rotation.from_rotvec(turn * np.array([0.0, 1.0, 0.0]) + tilt * across).apply(upright)
            for turn, tilt in tilts[first : first + 2]
        ]
        return [(at, normals[0]), (at + out, normals[1])]


@dataclass(frozen=True, slots=True, kw_only=True)
class PaperForm:
    """Eqs. (2)-(4) of Pachidis 2005: two pinholes, the left one moved sideways by m and forwards by l (m)."""

    baseline_m: float
    m_m: float
    l_m: float


def plate_constants(plate: Plate, omega_rad: float = HALF_RIGHT_ANGLE) -> tuple[float, float]:
    """Return m and l (m) as eqs. (5) and (6) print them; omega: between the optical axis and the plate.

    m is the chief ray's shift. The printed l adds the excess glass path to it, which is no optical shift (MATH 3.1):
    see corrected_l.
    """
    d, refracted = plate.thickness_m, float(np.arcsin(np.cos(omega_rad) / plate.index))
    m = d * np.cos(omega_rad + refracted) / np.cos(refracted)
    turned = omega_rad + refracted
    length = d / np.cos(refracted) * (1.0 - np.sin(turned) + np.cos(turned) * np.tan(omega_rad))
    return float(m), float(length)


def corrected_l(plate: Plate) -> tuple[float, float]:
    """Return where pencils seem to come from, in m along the axis: for rows (sagittal) and for columns (tangential)."""
    d, n = plate.thickness_m, plate.index
    sine = cosine = SLANT
    q = np.sqrt(n * n - sine * sine)
    m = d * (sine - sine * cosine / q)
    tangential = d * (cosine - np.cos(2.0 * HALF_RIGHT_ANGLE) / q - (sine * cosine) ** 2 / q**3)
    return float(m * cosine / sine), float(tangential)


def paper_form(mirrors: Mirrors, which_l: str = "printed") -> PaperForm:
    """Return the paper's form with l 'printed' (6), 'sagittal', 'tangential', or 'none'."""
    m, printed = plate_constants(mirrors.plate)
    sagittal, tangential = corrected_l(mirrors.plate)
    choices = {"printed": printed, "sagittal": sagittal, "tangential": tangential, "none": 0.0}
    return PaperForm(baseline_m=mirrors.baseline_m, m_m=m, l_m=choices[which_l])


def triangulate_paper(camera: Camera, form: PaperForm, left_px: ArrayLike, right_px: ArrayLike) -> Array:
    """Return points (n, 3) in rig axes by eq. (4), y the mean of both of its equations; NaN where they do not meet."""
    return _closed(camera, left_px, right_px, form.baseline_m, form.m_m, form.l_m)


def triangulate_exact(camera: Camera, mirrors: Mirrors, left_px: ArrayLike, right_px: ArrayLike) -> Array:
    """Return points (n, 3) in rig axes by eq. (4), m = l = mu of each left ray: exact without noise (MATH 3.1)."""
    left = camera.rays(left_px)
    mu = np.array([plate_shift(mirrors.plate.thickness_m, mirrors.plate.index, U, V) for U, V in left])
    return _closed(camera, left_px, right_px, mirrors.baseline_m, mu, mu)


def _closed(
    camera: Camera, left_px: ArrayLike, right_px: ArrayLike, b: float, m: ArrayLike, length: ArrayLike
) -> Array:
    """Return eq. (4): rays (U, V) of both views, skew and distortion taken out of the pixels before."""
    (UL, VL), (UR, VR) = camera.rays(left_px).T, camera.rays(right_px).T
    disparity = np.where(UL - UR > 0.0, UL - UR, np.nan)
    depth = (b + np.asarray(m) + np.asarray(length) * UL) / disparity  # z + b / 2
    x = depth * UR + 0.5 * b
    y = 0.5 * (depth * VR + (depth - np.asarray(length)) * VL)
    return np.column_stack([x, y, depth - 0.5 * b])


@output
class FormError(Output):
    """How far one form of the paper's equations is off with this rig, largest from 0.4 to 0.8 m."""

    name: Annotated[str, Doc("Which form.")]
    x_m: Annotated[float, Doc("Along x, m.")]
    y_m: Annotated[float, Doc("Along y, m.")]
    z_m: Annotated[float, Doc("In depth, m.")]
    epipolar_px: Annotated[float, Doc("Distance from the epipolar line, px.")]


def form_errors(camera: Camera, mirrors: Mirrors, points_m: ArrayLike) -> tuple[FormError, ...]:
    """Return what each form makes of points (n, 3) that the rig sees exactly; points outside the image do not count."""
    rig = mirrors.rig(camera)
    X = np.atleast_2d(np.asarray(points_m, float))
    left, right = rig.project(X)
    size = np.array([camera.width, camera.height]) - 0.5
    inside = ((left > -0.5) & (left < size) & (right > -0.5) & (right < size)).all(axis=1)
    X, left, right = X[inside], left[inside], right[inside]
    if not len(X):
        raise Inconsistent("no point of the workspace is in both views", cure="Give a workspace before the rig")
    rows = [
        _off(f"paper, l {name}", camera, paper_form(mirrors, name), X, left, right)
        for name in ("printed", "tangential", "sagittal", "none")
    ]
    bare = PaperForm(baseline_m=mirrors.baseline_m, m_m=0.0, l_m=0.0)
    rows.append(_off("no plate", camera, bare, X, left, right))
    found = triangulate_exact(camera, mirrors, left, right)
    rows.append(FormError(name="exact per ray", **_largest(found - X), epipolar_px=0.0))
    return tuple(rows)


def _off(name: str, camera: Camera, form: PaperForm, X: Array, left: Array, right: Array) -> FormError:
    found = triangulate_paper(camera, form, left, right)
    depth = found[:, 2] + 0.5 * form.baseline_m
    VL, VR = camera.rays(left)[:, 1], camera.rays(right)[:, 1]
    mismatch = camera.intrinsics[1] * (VL * (depth - form.l_m) / depth - VR)
    return FormError(name=name, **_largest(found - X), epipolar_px=float(np.nanmax(np.abs(mismatch))))


def _largest(off: Array) -> dict[str, float]:
    return dict(zip(POSITION, np.nanmax(np.abs(off), axis=0).tolist(), strict=True))


def pinhole_pair(rig: Rig, depths_m: ArrayLike = (0.4, 0.6, 0.8)) -> tuple[Rig, float]:
    """Return the general pair of pinholes nearest to a mirror rig over its images, and its RMS misfit in px.

    Of the left view centre, focal lengths, principal point and distortion are fitted to the exact form at some depths
    before the rig; for programs that know no plate. Raises NotConverged.
    """
    camera = rig.left
    if camera.plate is None:
        return rig, 0.0
    share = np.linspace(0.03, 0.97, 9)
    u, v = np.meshgrid(share * (camera.width - 1), share * (camera.height - 1))
    rays = camera.rays(np.column_stack([u.ravel(), v.ravel()]))
    rays = rays[np.isfinite(rays).all(axis=1)]
    ahead = np.column_stack([rays, np.ones(len(rays))])
    X = np.concatenate([depth * ahead for depth in np.atleast_1d(np.asarray(depths_m, float))])
    seen = camera.project(X)
    plain = replace(camera, plate=None)
    scale = np.array([1e-4, 1e-4, 1e-4, 1.0, 1.0, 1.0, 1.0, 1e-3, 1e-3, 1e-4, 1e-4])
    free = [INTRINSICS.index(name) for name in ("fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")]

    def moved(p: Array) -> tuple[Camera, Array]:
        k = plain.intrinsics.copy()
        k[free] += (p * scale)[3:]
        return replace(plain, intrinsics=k), (p * scale)[:3]

    def misses(p: Array) -> Array:
        lens, centre = moved(p)
        return (lens.project(X - centre) - seen).ravel()

    def evaluate(p: Array, _: Array) -> Evaluation:
        step = 1e-3
        J = np.column_stack([(misses(p + step * e) - misses(p - step * e)) / (2 * step) for e in np.eye(len(p))])
        r = misses(p)
        return Evaluation(residuals=r[None], shared=J[None], local=np.empty((1, r.size, 0)))

    names = (*POSITION, "fx", "fy", "cx", "cy", "k1", "k2", "p1", "p2")
    fit = solve(Problem(names=names, guess=np.zeros(11), evaluate=evaluate, n_residuals=seen.size))
    lens, centre = moved(fit.shared)
    if not np.isfinite(misses(fit.shared)).all():
        raise NotConverged("no pair of pinholes is near this mirror rig", cure="Check the plate's thickness and index")
    T_rig_left = rig.T_rig_left * RigidTransform.from_translation(centre)
    rms = float(np.sqrt(np.mean((misses(fit.shared).reshape(-1, 2) ** 2).sum(axis=1))))
    cameras = (replace(rig.cameras[0], camera=lens, T_rig_camera=T_rig_left), rig.cameras[1])
    return replace(rig, cameras=cameras, covariance=None), rms
