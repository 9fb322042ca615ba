"""Compiled lenses that end at a widest angle: fisheyes and OpenCV's rational model, with their inverses.

Of a fisheye lens the vector is fx, fy, cx, cy, skew, k1, k2, k3, k4, 0, FISHEYE and the widest tangent: a point with
r = hypot(x, y) / z beyond it has no image. Fisheye: theta = atan(r), theta_d = theta (1 + k1 theta^2 + k2 theta^4 + k3
theta^6 + k4 theta^8) (Kannala and Brandt 2006, equation 6 divided by its k1). Of a rational lens it is a pinhole's ten,
RATIONAL, the widest tangent, k4, k5, k6: Brown-Conrady, the radial factor divided by 1 + k4 r^2 + k5 r^4 + k6 r^6
(OpenCV, calib3d, "Detailed description").
"""

from __future__ import annotations

from math import atan, sqrt, tan
from typing import Any, NamedTuple

from armsight._numba import borrowing_kernel, inline_kernel, lean_kernel

UNDISTORT_STEPS = 30
UNDISTORT_TOLERANCE = 1e-13
START_TOLERANCE = 1e-6
"""Share to which the radial terms' ray is found, from where all terms lead on."""

FISHEYE = -1.0
"""Stands where a plate's thickness would."""
RATIONAL = -2.0
"""Stands there for a rational lens."""
NEAR_AXIS = 1e-12
"""Square of the tangent below which the fisheye's series about the axis is exact to rounding."""


class Wide(NamedTuple):
    """A fisheye or rational lens in scalars: k1 to k4 of a fisheye in the first four, widest its widest tangent.

    An array would have its references counted in every pinhole's loop as well, which doubles its time.
    """

    kind: Any
    k1: Any
    k2: Any
    p1: Any
    p2: Any
    k3: Any
    widest: Any
    k4: Any
    k5: Any
    k6: Any


@borrowing_kernel
def wide_of(k):
    """Return the Wide of a vector of intrinsics."""
    return Wide(k[10], k[5], k[6], k[7], k[8], k[9], k[11], k[12], k[13], k[14])


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


@inline_kernel
def decentre(radial, slope, p1, p2, x, y, r2):
    """As distort, from the radial factor at r2 = x^2 + y^2 and its derivative by that; p1, p2: the tangential terms."""
    xd = x * radial + 2.0 * p1 * x * y + p2 * (r2 + 2.0 * x * x)
    yd = y * radial + p1 * (r2 + 2.0 * y * y) + 2.0 * p2 * x * y
    dxx = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x
    dxy = 2.0 * x * y * slope + 2.0 * p1 * x + 2.0 * p2 * y
    dyy = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x
    return xd, yd, dxx, dxy, dyy


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


@inline_kernel
def rational_radial(lens, r2):
    """Return a rational lens's radial factor, its derivative by r2, and one over its denominator."""
    over = 1.0 / (1.0 + r2 * (lens.k4 + r2 * (lens.k5 + r2 * lens.k6)))
    radial = over * (1.0 + r2 * (lens.k1 + r2 * (lens.k2 + r2 * lens.k3)))
    by_top = lens.k1 + r2 * (2.0 * lens.k2 + 3.0 * r2 * lens.k3)
    by_bottom = lens.k4 + r2 * (2.0 * lens.k5 + 3.0 * r2 * lens.k6)
    return radial, over * (by_top - radial * by_bottom), over


@lean_kernel
def distort_rational(lens, x, y):
    """As distort, of a rational lens."""
    r2 = x * x + y * y
    radial, slope, _ = rational_radial(lens, r2)
    return decentre(radial, slope, lens.p1, lens.p2, x, y, r2)


@lean_kernel
def see_wide(lens, x, y):
    """Return whether a fisheye or rational lens sees a normalised point, and what distort does.

    A rational lens does up to the widest tangent, where its radial factor has no pole and the image grows outwards.
    """
    if lens.kind != RATIONAL:
        return see_fisheye(lens.k1, lens.k2, lens.p1, lens.p2, lens.widest, x, y)
    r2 = x * x + y * y
    radial, slope, over = rational_radial(lens, r2)
    xd, yd, dxx, dxy, dyy = decentre(radial, slope, lens.p1, lens.p2, x, y, r2)
    seen = r2 <= lens.widest * lens.widest and over > 0.0 and radial > 0.0 and radial + 2.0 * r2 * slope > 0.0
    return seen, xd, yd, dxx, dxy, dyy


@lean_kernel
def distort_wide(lens, x, y):
    """As distort, of a fisheye or rational lens."""
    if lens.kind != RATIONAL:
        return distort_fisheye(lens.k1, lens.k2, lens.p1, lens.p2, x, y)
    return distort_rational(lens, x, y)


@lean_kernel
def rational_start(lens, image):
    """Return tan(theta) over image of the ray that a rational lens without tangential terms shows at image.

    Newton's iteration within a bracket that shrinks: the image grows up to the widest tangent. Where that shows less
    than image, the ray there.
    """
    low, high = 0.0, lens.widest
    r = image if image < high else 0.5 * high  # at the widest one there may be a pole
    for _ in range(UNDISTORT_STEPS):
        radial, slope, _ = rational_radial(lens, r * r)
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
def undistort_rational(lens, xd, yd):
    """As undistort_pinhole, of a rational lens, from the ray that the radial terms alone give."""
    image = sqrt(xd * xd + yd * yd)
    stretch = rational_start(lens, image)
    x = stretch * xd
    y = stretch * yd
    for _ in range(UNDISTORT_STEPS):
        fx, fy, dxx, dxy, dyy = distort_rational(lens, x, y)
        det = dxx * dyy - dxy * dxy
        if not det > 0.0:
            break
        ex = fx - xd
        ey = fy - yd
        x -= (dyy * ex - dxy * ey) / det
        y -= (dxx * ey - dxy * ex) / det
        if abs(ex) + abs(ey) < UNDISTORT_TOLERANCE * (1.0 + image):  # near a pole the image has no end
            return x * x + y * y <= lens.widest * lens.widest, x, y, dxx, dxy, dyy
    return False, x, y, 0.0, 0.0, 0.0


@lean_kernel
def undistort_wide(lens, xd, yd):
    """As undistort_pinhole, of a fisheye or rational lens."""
    if lens.kind != RATIONAL:
        return undistort_fisheye(lens.k1, lens.k2, lens.p1, lens.p2, lens.widest, xd, yd)
    return undistort_rational(lens, xd, yd)
