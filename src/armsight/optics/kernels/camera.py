"""Compiled projection with Brown-Conrady distortion, by OpenCV's rational model or through a fisheye, and derivatives.

A camera's intrinsics travel as one vector k (10,): fx, fy, cx, cy, skew, k1, k2, p1, p2, k3; of a view through a glass
plate with the plate's thickness (m) and refractive index behind them; as Camera.packed, k (15,), with three zeros more.
Of a fisheye lens the vector is fx, fy, cx, cy, skew, k1, k2, k3, k4, 0, FISHEYE and the widest tangent: a point with
r = hypot(x, y) / z beyond it has no image. Fisheye: theta = atan(r), theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3
theta^6 + k4 theta^8) (Kannala and Brandt 2006, equation 6 divided by its k1). Of a rational lens it is a pinhole's ten,
RATIONAL, the widest tangent, k4, k5, k6: Brown-Conrady, the radial factor divided by 1 + k4 r^2 + k5 r^4 + k6 r^6
(OpenCV, calib3d, "Detailed description").
"""

from __future__ import annotations

from math import atan, sqrt, tan
from typing import Any, NamedTuple

import numpy as np

from armsight._numba import borrowing_kernel, inline_kernel, kernel, lean_kernel

UNDISTORT_STEPS = 30
UNDISTORT_TOLERANCE = 1e-13
START_TOLERANCE = 1e-6
"""Share to which the radial terms' ray is found, from where all terms lead on."""

FISHEYE = -1.0
"""Stands where a plate's thickness would. Functions of a fisheye take scalars: with an array, numba would count the
references to it in every pinhole's loop as well, which doubles its time."""
RATIONAL = -2.0
"""Stands there for a rational lens."""
NEAR_AXIS = 1e-12
"""Square of the tangent below which the fisheye's series about the axis is exact to rounding."""


class CameraK(NamedTuple):
    """A camera as kernels take it: k its vector of intrinsics, R (3, 3) and t (3,) m with p_camera = R p_rig + t."""

    k: Any
    R: Any
    t: Any


class RigK(NamedTuple):
    """Both cameras of a rig, left one first: k (2, 15), R (2, 3, 3), t (2, 3) m; see CameraK and PackedRig.

    Kernels that Python calls take a plain tuple, in the same order, and make this of it: that costs nothing there.
    """

    k: Any
    R: Any
    t: Any


@inline_kernel
def is_wide(k):
    """Tell whether a vector of intrinsics is of a fisheye or a rational lens, which have a widest tangent."""
    return k.shape[0] > 10 and k[10] < 0.0


@inline_kernel
def n_intrinsics(k):
    """Return how many parameters the calibration of cameras k (V, 15) has of each lens: 13 where one is rational."""
    for s in range(k.shape[0]):
        if k[s, 10] == RATIONAL:
            return 13
    return 10


@borrowing_kernel
def lens_of(k):
    """Return the coefficients of a fisheye or rational lens as scalars, as see_wide takes them."""
    return k[10], k[5], k[6], k[7], k[8], k[9], k[11], k[12], k[13], k[14]


@lean_kernel
def fisheye_angle(k1, k2, k3, k4, theta):
    """Return theta_d and d theta_d / d theta."""
    q = theta * theta
    image = theta * (1.0 + q * (k1 + q * (k2 + q * (k3 + q * k4))))
    return image, 1.0 + q * (3.0 * k1 + q * (5.0 * k2 + q * (7.0 * k3 + q * 9.0 * k4)))


@lean_kernel
def fisheye_radial(k1, k2, k3, k4, r2):
    """Return theta_d / r and its derivative by r^2, for a point with the square r2 of its tangent."""
    if r2 < NEAR_AXIS:
        slope = k1 - 1.0 / 3.0
        return 1.0 + slope * r2, slope
    r = sqrt(r2)
    image, rate = fisheye_angle(k1, k2, k3, k4, atan(r))
    return image / r, 0.5 * (rate / (1.0 + r2) - image / r) / r2


@lean_kernel
def fisheye_sees(k1, k2, k3, k4, widest, r2):
    """Tell whether a point with the square r2 of its tangent is within the widest one and the lens does not fold."""
    return r2 <= widest * widest and fisheye_angle(k1, k2, k3, k4, atan(sqrt(r2)))[1] > 0.0


@lean_kernel
def distort_fisheye(k1, k2, k3, k4, x, y):
    """As distort, of a fisheye lens."""
    radial, slope = fisheye_radial(k1, k2, k3, k4, x * x + y * y)
    turn = 2.0 * slope
    return x * radial, y * radial, radial + turn * x * x, turn * x * y, radial + turn * y * y


@lean_kernel
def see_fisheye(k1, k2, k3, k4, widest, x, y):
    """Return whether a fisheye lens sees a normalised point, and what distort_fisheye does."""
    if not fisheye_sees(k1, k2, k3, k4, widest, x * x + y * y):
        return False, x, y, 0.0, 0.0, 0.0
    xd, yd, dxx, dxy, dyy = distort_fisheye(k1, k2, k3, k4, x, y)
    return True, xd, yd, dxx, dxy, dyy


@inline_kernel
def decentre(radial, slope, p1, p2, x, y, r2):
    """As distort, from the radial factor at r2 = x^2 + y^2 and its derivative by that; p1, p2: the tangential terms."""
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    dxx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    dxy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    dyy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return xd, yd, dxx, dxy, dyy


@inline_kernel
def distort_pinhole(k1, k2, p1, p2, k3, x, y):
    """As distort, of a pinhole; within its caller, as a call takes longer than it does."""
    r2 = x * x + y * y
    radial = 1.0 + r2 * (k1 + r2 * (k2 + r2 * k3))
    slope = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)  # d radial / d r2
    return decentre(radial, slope, p1, p2, x, y, r2)


@inline_kernel
def rational_radial(k1, k2, k3, k4, k5, k6, r2):
    """Return a rational lens's radial factor, its derivative by r2, and one over its denominator."""
    over = 1.0 / (1.0 + r2 * (k4 + r2 * (k5 + r2 * k6)))
    radial = over * (1.0 + r2 * (k1 + r2 * (k2 + r2 * k3)))
    by_top = k1 + r2 * (2.0 * k2 + 3.0 * r2 * k3)
    by_bottom = k4 + r2 * (2.0 * k5 + 3.0 * r2 * k6)
    return radial, over * (by_top - radial * by_bottom), over


@lean_kernel
def distort_rational(k1, k2, p1, p2, k3, k4, k5, k6, x, y):
    """As distort, of a rational lens."""
    r2 = x * x + y * y
    radial, slope, _ = rational_radial(k1, k2, k3, k4, k5, k6, r2)
    return decentre(radial, slope, p1, p2, x, y, r2)


@lean_kernel
def see_wide(kind, k1, k2, p1, p2, k3, widest, k4, k5, k6, x, y):
    """Return whether a fisheye or rational lens (lens_of) sees a normalised point, and what distort does.

    A rational lens does up to the widest tangent, where its radial factor has no pole and the image grows outwards.
    """
    if kind != RATIONAL:
        return see_fisheye(k1, k2, p1, p2, widest, x, y)
    r2 = x * x + y * y
    radial, slope, over = rational_radial(k1, k2, k3, k4, k5, k6, r2)
    xd, yd, dxx, dxy, dyy = decentre(radial, slope, p1, p2, x, y, r2)
    seen = r2 <= widest * widest and over > 0.0 and radial > 0.0 and radial + 2.0 * r2 * slope > 0.0
    return seen, xd, yd, dxx, dxy, dyy


@lean_kernel
def distort_wide(kind, k1, k2, p1, p2, k3, widest, k4, k5, k6, x, y):
    """As distort, of a fisheye or rational lens (lens_of)."""
    if kind != RATIONAL:
        return distort_fisheye(k1, k2, p1, p2, x, y)
    return distort_rational(k1, k2, p1, p2, k3, k4, k5, k6, x, y)


@lean_kernel
def distort(k, x, y):
    """Return the distorted normalised point and its derivative (xx, xy, yy) by (x, y); xy is symmetric."""
    if is_wide(k):
        kind, k1, k2, p1, p2, k3, widest, k4, k5, k6 = lens_of(k)
        return distort_wide(kind, k1, k2, p1, p2, k3, widest, k4, k5, k6, x, y)
    return distort_pinhole(k[5], k[6], k[7], k[8], k[9], x, y)


PLATE_ROUNDS = 4
"""Steps to the ray that meets a point through the plate; each gains a factor of a thousand (shift over depth)."""


@kernel
def plate_shift(thickness, index, U, V):
    """Return mu (m) of MATH 3.1: the ray (U, V, 1) through a plate at 45 degrees seems to start at (-mu, 0, +mu)."""
    c = (1.0 - U) / np.sqrt(2.0 * (1.0 + U * U + V * V))
    return thickness * np.sqrt(0.5) * (1.0 - c / np.sqrt(index * index - 1.0 + c * c))


@lean_kernel
def behind_plate(thickness, index, x, y, z):
    """Return x and z of a point as a pinhole without the plate would have it, whose centre the chief ray points to."""
    chief = plate_shift(thickness, index, 0.0, 0.0)
    shift = 0.0
    for _ in range(PLATE_ROUNDS):
        depth = z - shift
        shift = plate_shift(thickness, index, (x + shift) / depth, y / depth) - chief
    return x + shift, z - shift


@lean_kernel
def project_point(k, x, y, z, uv, J):
    """Fill uv (2,) and J (2, 3) = d uv / d (x, y, z) for a point in camera axes; False where z <= 0.

    False also beyond the angle that a fisheye or rational lens is known to. Through a plate J leaves out how the shift
    changes with the point: a thousandth of J.
    """
    if not z > 0.0:
        return False
    if k.shape[0] > 10 and k[10] > 0.0:
        x, z = behind_plate(k[10], k[11], x, y, z)
    iz = 1.0 / z
    a = x * iz
    b = y * iz
    if is_wide(k):
        kind, k1, k2, p1, p2, k3, widest, k4, k5, k6 = lens_of(k)
        seen, xd, yd, dxx, dxy, dyy = see_wide(kind, k1, k2, p1, p2, k3, widest, k4, k5, k6, a, b)
        if not seen:
            return False
    else:
        xd, yd, dxx, dxy, dyy = distort_pinhole(k[5], k[6], k[7], k[8], k[9], a, b)
    fx, fy, skew = k[0], k[1], k[4]
    uv[0] = fx * xd + skew * yd + k[2]
    uv[1] = fy * yd + k[3]
    ua = fx * dxx + skew * dxy
    ub = fx * dxy + skew * dyy
    va = fy * dxy
    vb = fy * dyy
    # a = x / z, b = y / z: by z they change by -a / z, -b / z
    J[0, 0] = ua * iz
    J[0, 1] = ub * iz
    J[0, 2] = -(ua * a + ub * b) * iz
    J[1, 0] = va * iz
    J[1, 1] = vb * iz
    J[1, 2] = -(va * a + vb * b) * iz
    return True


@lean_kernel
def intrinsics_jacobian(k, x, y, z, D):
    """Fill D (2, 10) = d uv / d intrinsics for a point in camera axes with z > 0; of a rational lens D (2, 13)."""
    a = x / z
    b = y / z
    xd, yd, _, _, _ = distort(k, a, b)
    fx, fy, skew = k[0], k[1], k[4]
    r2 = a * a + b * b
    D[:] = 0.0
    D[0, 0] = xd
    D[1, 1] = yd
    D[0, 2] = 1.0
    D[1, 3] = 1.0
    D[0, 4] = yd
    power = r2
    if is_wide(k) and k[10] == RATIONAL:
        radial, _, over = rational_radial(k[5], k[6], k[9], k[12], k[13], k[14], r2)
        power *= over
        for j in range(10, 13):  # k4, k5, k6
            D[0, j] = -radial * power * (fx * a + skew * b)
            D[1, j] = -radial * power * fy * b
            power *= r2
        power = over * r2
    elif is_wide(k):
        theta = atan(sqrt(r2))
        power = theta**3 / sqrt(r2) if r2 > NEAR_AXIS else r2
        for j in range(5, 9):
            D[0, j] = fx * a * power + skew * b * power
            D[1, j] = fy * b * power
            power *= theta * theta
        return
    # k1, k2, k3 go with r^2, r^4, r^6; k3 stands behind p1 and p2 (OpenCV's order)
    for j in (5, 6, 9):
        D[0, j] = fx * a * power + skew * b * power
        D[1, j] = fy * b * power
        power *= r2
    px, py = 2.0 * a * b, r2 + 2.0 * b * b  # by p1
    D[0, 7] = fx * px + skew * py
    D[1, 7] = fy * py
    px, py = r2 + 2.0 * a * a, 2.0 * a * b  # by p2
    D[0, 8] = fx * px + skew * py
    D[1, 8] = fy * py


@lean_kernel
def fisheye_tangent(k1, k2, k3, k4, widest, image):
    """Return tan(theta) / theta_d of the ray whose theta_d is image; negative where the lens has none.

    Newton's iteration within a bracket that shrinks: theta_d grows up to the widest angle.
    """
    low, high = 0.0, atan(widest)
    if not image <= fisheye_angle(k1, k2, k3, k4, high)[0]:
        return -1.0
    if image * image < NEAR_AXIS:
        return 1.0 + (1.0 / 3.0 - k1) * image * image
    theta = min(image, high)
    for _ in range(UNDISTORT_STEPS):
        found, rate = fisheye_angle(k1, k2, k3, k4, theta)
        error = found - image
        if abs(error) < UNDISTORT_TOLERANCE:
            return tan(theta) / image
        if error > 0.0:
            high = theta
        else:
            low = theta
        theta = theta - error / rate if rate > 0.0 else low
        # Newton has left the bracket: halve it, which cannot fail
        if not low < theta < high:
            theta = 0.5 * (low + high)
    return -1.0


@lean_kernel
def undistort_fisheye(k1, k2, k3, k4, widest, xd, yd):
    """As undistort_pinhole, of a fisheye lens."""
    stretch = fisheye_tangent(k1, k2, k3, k4, widest, sqrt(xd * xd + yd * yd))
    x = stretch * xd
    y = stretch * yd
    _, _, dxx, dxy, dyy = distort_fisheye(k1, k2, k3, k4, x, y)
    return stretch > 0.0, x, y, dxx, dxy, dyy


@lean_kernel
def rational_start(k1, k2, k3, k4, k5, k6, widest, image):
    """Return tan(theta) over image of the ray that a rational lens without tangential terms shows at image.

    Newton's iteration within a bracket that shrinks: the image grows up to the widest tangent. Where that shows less
    than image, the ray there.
    """
    low, high = 0.0, widest
    r = image if image < high else 0.5 * high  # at the widest one there may be a pole
    for _ in range(UNDISTORT_STEPS):
        radial, slope, _ = rational_radial(k1, k2, k3, k4, k5, k6, r * r)
        error = r * radial - image
        if abs(error) < START_TOLERANCE * image or high - low < START_TOLERANCE * high:
            break
        if error > 0.0:
            high = r
        else:
            low = r
        r -= error / (radial + 2.0 * r * r * slope)
        # Newton has left the bracket: halve it, which cannot fail
        if not low < r < high:
            r = 0.5 * (low + high)
    return r / image if image > 0.0 else 1.0


@lean_kernel
def undistort_rational(k1, k2, p1, p2, k3, k4, k5, k6, widest, xd, yd):
    """As undistort_pinhole, of a rational lens, from the ray that the radial terms alone give."""
    image = sqrt(xd * xd + yd * yd)
    stretch = rational_start(k1, k2, k3, k4, k5, k6, widest, image)
    x = stretch * xd
    y = stretch * yd
    for _ in range(UNDISTORT_STEPS):
        fx, fy, dxx, dxy, dyy = distort_rational(k1, k2, p1, p2, k3, k4, k5, k6, x, y)
        det = dxx * dyy - dxy * dxy
        if not det > 0.0:
            break
        ex = fx - xd
        ey = fy - yd
        x -= (dyy * ex - dxy * ey) / det
        y -= (dxx * ey - dxy * ex) / det
        if abs(ex) + abs(ey) < UNDISTORT_TOLERANCE * (1.0 + image):  # near a pole the image has no end
            return x * x + y * y <= widest * widest, x, y, dxx, dxy, dyy
    return False, x, y, 0.0, 0.0, 0.0


@lean_kernel
def undistort_wide(kind, k1, k2, p1, p2, k3, widest, k4, k5, k6, xd, yd):
    """As undistort_pinhole, of a fisheye or rational lens (lens_of)."""
    if kind != RATIONAL:
        return undistort_fisheye(k1, k2, p1, p2, widest, xd, yd)
    return undistort_rational(k1, k2, p1, p2, k3, k4, k5, k6, widest, xd, yd)


@lean_kernel
def undistort_pinhole(k1, k2, p1, p2, k3, xd, yd):
    """Return whether a distorted normalised point has a ray, found by Newton's iteration, the ray (x, y) and the
    derivative (xx, xy, yy) of the distortion there.
    """
    x = xd
    y = yd
    for _ in range(UNDISTORT_STEPS):
        fx, fy, dxx, dxy, dyy = distort_pinhole(k1, k2, p1, p2, k3, x, y)
        det = dxx * dyy - dxy * dxy
        # the distortion folds over here: beyond, two rays have one pixel
        if not det > 0.0:
            break
        ex = fx - xd
        ey = fy - yd
        x -= (dyy * ex - dxy * ey) / det
        y -= (dxx * ey - dxy * ex) / det
        if abs(ex) + abs(ey) < UNDISTORT_TOLERANCE:
            return True, x, y, dxx, dxy, dyy  # the step was too short to change them
    return False, x, y, 0.0, 0.0, 0.0


@lean_kernel
def ray_of(k, u, v):
    """Return whether a pixel has a ray under this model, the ray (x/z, y/z) and the distortion's derivative there.

    It has none where Newton's iteration does not converge, where the distortion folds over, and beyond the angle that a
    fisheye or rational lens is known to.
    """
    yd = (v - k[3]) / k[1]
    xd = (u - k[2] - k[4] * yd) / k[0]
    if is_wide(k):
        kind, k1, k2, p1, p2, k3, widest, k4, k5, k6 = lens_of(k)
        found, x, y, dxx, dxy, dyy = undistort_wide(kind, k1, k2, p1, p2, k3, widest, k4, k5, k6, xd, yd)
    else:
        found, x, y, dxx, dxy, dyy = undistort_pinhole(k[5], k[6], k[7], k[8], k[9], xd, yd)
    return found and dxx * dyy - dxy * dxy > 0.0 and dxx > 0.0, x, y, dxx, dxy, dyy


@lean_kernel
def undistort_point(k, u, v, xy, J):
    """Fill xy (2,) with the ray (x/z, y/z) of a pixel, J (2, 2) = d xy / d (u, v); False where it has none (ray_of)."""
    found, x, y, dxx, dxy, dyy = ray_of(k, u, v)
    if not found:
        return False
    det = dxx * dyy - dxy * dxy
    xy[0] = x
    xy[1] = y
    # d(xd, yd)/d(u, v) = [[1/fx, -skew/(fx fy)], [0, 1/fy]]
    a = 1.0 / k[0]
    b = -k[4] / (k[0] * k[1])
    c = 1.0 / k[1]
    J[0, 0] = dyy * a / det
    J[0, 1] = (dyy * b - dxy * c) / det
    J[1, 0] = -dxy * a / det
    J[1, 1] = (-dxy * b + dxx * c) / det
    return True


@kernel
def project_many(k, R, t, X, uv):
    """Fill uv (n, 2) with the pixels of points X (n, 3) seen through p_camera = R X + t; NaN where there is none."""
    J = np.empty((2, 3))
    for i in range(X.shape[0]):
        x = R[0, 0] * X[i, 0] + R[0, 1] * X[i, 1] + R[0, 2] * X[i, 2] + t[0]
        y = R[1, 0] * X[i, 0] + R[1, 1] * X[i, 1] + R[1, 2] * X[i, 2] + t[1]
        z = R[2, 0] * X[i, 0] + R[2, 1] * X[i, 1] + R[2, 2] * X[i, 2] + t[2]
        if not project_point(k, x, y, z, uv[i], J):
            uv[i, 0] = np.nan
            uv[i, 1] = np.nan


@kernel
def undistort_many(k, uv, xy):
    """Fill xy (n, 2) with the normalised rays of pixels uv (n, 2); NaN where a pixel has no ray."""
    for i in range(uv.shape[0]):
        found, x, y, _, _, _ = ray_of(k, uv[i, 0], uv[i, 1])
        xy[i, 0] = x if found else np.nan
        xy[i, 1] = y if found else np.nan


@lean_kernel
def see_point(k, R, t, X, uv, J):
    """Fill uv (2,) and J (2, 3) = d uv / d X for a point X (3,) in rig axes, p_camera = R X + t; False behind it."""
    x = R[0, 0] * X[0] + R[0, 1] * X[1] + R[0, 2] * X[2] + t[0]
    y = R[1, 0] * X[0] + R[1, 1] * X[1] + R[1, 2] * X[2] + t[1]
    z = R[2, 0] * X[0] + R[2, 1] * X[1] + R[2, 2] * X[2] + t[2]
    if not project_point(k, x, y, z, uv, J):
        return False
    for i in range(2):
        a, b, c = J[i, 0], J[i, 1], J[i, 2]
        for j in range(3):
            J[i, j] = a * R[0, j] + b * R[1, j] + c * R[2, j]
    return True
