"""A camera from the distortion coefficients that OpenCV's programs write: 4, 5, 8, 12 or 14 of them.

In OpenCV's order (calib3d, "Detailed description"): k1, k2, p1, p2, k3, k4, k5, k6, s1, s2, s3, s4, tau_x, tau_y. Where
k4, k5, k6 are zero it is a pinhole with Brown-Conrady distortion, else a rational lens. Thin prisms s and a tilted
sensor tau are not modelled here: of such a lens the nearest one without them is taken, and none further than
FURTHEST_PX.
"""

from __future__ import annotations

import cv2
import numpy as np

from armsight.arrays import Array
from armsight.errors import BadFile
from armsight.optics import Camera
from armsight.optics.camera import NO_SHIFT, NO_TURN, with_step
from armsight.optics.kernels.light_image import see_points
from armsight.store.codec import named
from armsight.store.foreign.numbers import TOLD_PX

Intrinsics = tuple[float, float, float, float, float]

SIZES = (0, 4, 5, 8, 12, 14)
FIVE, EIGHT = 5, 8
FURTHEST_PX = 0.05
"""By which the nearest lens may differ anywhere in the picture: half of what corners scatter by."""
WHOLE = 0.9
"""Share of the picture that must have rays: of lenses made for it a corner may fold over."""
ROUNDS = 12


def opencv_lens(
    values: Array,
    intrinsics: Intrinsics,
    size: tuple[int, int],
    where: str,
    told: list[str] | None = None,
    *,
    approximate: bool = False,
) -> Camera:
    """Return the camera of OpenCV's coefficients; intrinsics: fx, fy, cx, cy, skew; size: width, height; all px.

    told: takes what is to be said of it. approximate: take the nearest lens, however far it is. Raises BadFile for
    another number of coefficients, a lens that leaves much of the picture without rays, and one that is too far from
    those that are modelled.
    """
    flat = values.ravel()
    if flat.size not in SIZES:
        raise BadFile(
            f"{where}: the distortion holds {flat.size} coefficients; OpenCV's models have 4, 5, 8, 12 or 14",
            cure="Correct it there",
        )
    first = np.concatenate([flat[:EIGHT], np.zeros(max(0, EIGHT - flat.size))])
    with named(where):
        if first[FIVE:].any():
            camera = Camera.rational(*size, *intrinsics[:4], skew=intrinsics[4], distortion=first)
        else:
            camera = Camera.pinhole(*size, *intrinsics[:4], skew=intrinsics[4], distortion=first[:FIVE])
    uv = _pixels(size)
    if flat[EIGHT:].any():
        camera = _nearest(camera, flat, uv, where, told, approximate=approximate)
    if flat[FIVE:].any():
        _require_rays(camera, uv, where, told)
    return camera


def _pixels(size: tuple[int, int]) -> Array:
    """Return pixels (n, 2) over a picture, its corners among them."""
    u, v = np.meshgrid(np.linspace(0.0, size[0] - 1.0, 41), np.linspace(0.0, size[1] - 1.0, 31))
    return np.stack([u.ravel(), v.ravel()], axis=1)


def _require_rays(camera: Camera, uv: Array, where: str, told: list[str] | None) -> None:
    """Raise BadFile where too much of the picture has no ray, and tell where some has none."""
    share = float(np.isfinite(camera.rays(uv)[:, 0]).mean())
    if share < WHOLE:
        raise BadFile(
            f"{where}: {100.0 * (1.0 - share):.0f} % of the picture has no ray by this lens, which folds over or has a "
            f"pole at {np.degrees(camera.widest_rad):.1f} degrees from its axis",
            consequence="Lights there would be lost, or taken for others",
            cure="Calibrate it with armsight calibrate camera or stereo, of a very wide lens with --lens fisheye",
        )
    if share < 1.0 and told is not None:
        told.append(
            f"{where}: {100.0 * (1.0 - share):.1f} % of the picture has no ray: the lens folds over or has a pole at "
            f"{np.degrees(camera.widest_rad):.1f} degrees from its axis"
        )


def _nearest(
    camera: Camera, flat: Array, uv: Array, where: str, told: list[str] | None, *, approximate: bool
) -> Camera:
    """Return the lens of camera's kind that is nearest over pixels uv (n, 2) to one with thin prisms and tilt.

    All its intrinsics move, by least squares. Raises BadFile where it is further than FURTHEST_PX, unless approximate.
    """
    stop = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 200, 1e-12)
    rays = cv2.undistortPointsIter(uv[:, None], camera.matrix, flat, np.eye(3), np.eye(3), stop).reshape(-1, 2)
    X = np.column_stack([rays, np.ones(len(rays))])
    back = cv2.projectPoints(X, np.zeros(3), np.zeros(3), camera.matrix, flat)[0].reshape(-1, 2)
    X, uv = (part[np.abs(back - uv).max(axis=1) < TOLD_PX] for part in (X, uv))  # the others have no ray
    nearest, most_px = nearest_like(camera, X, uv)
    if not (most_px <= FURTHEST_PX or (approximate and np.isfinite(most_px))):
        raise BadFile(
            f"{where}: thin prism s1 to s4 or tilt tau are not zero, and the nearest lens without them is "
            f"{most_px:.2g} px off where it is furthest",
            consequence=f"Beyond {FURTHEST_PX} px it would be another lens",
            cure="Take the nearest lens all the same with --approximate, or calibrate anew here",
        )
    if most_px > TOLD_PX and told is not None:
        told.append(
            f"{where}: the nearest lens without thin prism and tilt is taken, {most_px:.2g} px apart at most over the "
            "picture"
        )
    return nearest


def nearest_like(camera: Camera, X: Array, uv: Array) -> tuple[Camera, float]:
    """Return the camera of a camera's kind that sees points X (n, 3) nearest to pixels uv (n, 2), and the largest
    distance in px; all its intrinsics move, by least squares from where they are.
    """
    nearest, apart = camera, _apart(camera, X, uv)
    for _ in range(ROUNDS):
        found = with_step(nearest, _step(nearest, X, uv))
        far = _apart(found, X, uv)
        if not np.sum(far**2) < np.sum(apart**2):
            break
        nearest, apart = found, far
    return nearest, float(np.max(apart, initial=0.0)) if len(uv) else np.inf


def _apart(camera: Camera, X: Array, uv: Array) -> Array:
    """Return the distances (n,) px of pixels uv from where a camera sees points X; infinite where it does not."""
    apart = np.linalg.norm(camera.project(X) - uv, axis=1)
    return np.where(np.isfinite(apart), apart, np.inf)


def _step(camera: Camera, X: Array, uv: Array) -> Array:
    """Return the least-squares step of a camera's intrinsics towards seeing points X (n, 3) at pixels uv (n, 2)."""
    seen, J, D = np.empty_like(uv), np.empty((len(uv), 2, 3)), np.empty((len(uv), 2, len(camera.names)))
    see_points(camera.packed, NO_TURN, NO_SHIFT, np.ascontiguousarray(X), seen, J, D)
    there = np.isfinite(seen[:, 0])
    A = D[there].reshape(-1, D.shape[2])
    scale = np.maximum(np.linalg.norm(A, axis=0), 1e-12)
    return np.asarray(np.linalg.lstsq(A / scale, (uv - seen)[there].ravel(), rcond=1e-10)[0] / scale)
