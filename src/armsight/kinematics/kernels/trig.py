"""Sine, cosine and arc tangent without branches, so that the compiler can run several of them at once.

Range reduction after Cody and Waite, polynomials of fdlibm (Sun Microsystems 1993, k_sin.c, k_cos.c, s_atan.c), exact
to about one unit in the last place for angles up to 1e6 rad. The arguments must be finite.
"""

from __future__ import annotations

from math import pi

import numpy as np

from armsight._numba import inner_fast_kernel, inner_kernel

TWO_PI = 2.0 * pi
PER_TURN = 1.0 / TWO_PI
TAN_PI_8 = 0.41421356237309503
QUARTER = 0.25 * pi
HALF = 0.5 * pi


@inner_fast_kernel
def sin_cos(x):
    """Return (sin x, cos x) of a finite angle in radians."""
    k = np.floor(x * 0.6366197723675814 + 0.5)
    r = x - k * 1.5707963267341256  # pi / 2 in three parts of 33 bits
    r = r - k * 6.077100506303966e-11
    r = r - k * 2.0222662487959506e-21
    z = r * r
    p = -2.50507602534068634195e-08 + z * 1.58969099521155010221e-10
    p = 8.33333333332248946124e-03 + z * (-1.98412698298579493134e-04 + z * (2.75573137070700676789e-06 + z * p))
    s = r + r * z * (-1.66666666666666324348e-01 + z * p)
    p = -2.75573143513906633035e-07 + z * (2.08757232129817482790e-09 - z * 1.13596475577881948265e-11)
    p = 4.16666666666666019037e-02 + z * (-1.38888888888741095749e-03 + z * (2.48015872894767294178e-05 + z * p))
    c = 1.0 - 0.5 * z + z * z * p
    n = np.int64(k)
    odd = (n & 1) != 0
    sine = c if odd else s
    cosine = s if odd else c
    if n & 2:
        sine = -sine
    if (n + 1) & 2:
        cosine = -cosine
    return sine, cosine


@inner_fast_kernel
def arc_tangent(y, x):
    """Return the angle of the direction (x, y) in (-pi, pi]; zero where both are zero."""
    ax = abs(x)
    ay = abs(y)
    large = max(ax, ay)
    small = min(ax, ay)
    steep = small > TAN_PI_8 * large
    top = small - large if steep else small
    bottom = small + large if steep else large
    t = top / bottom if bottom > 0.0 else 0.0
    z = t * t
    p = 4.97687799461593236017e-02 + z * (-3.65315727442169155270e-02 + z * 1.62858201153657823623e-02)
    p = 6.66107313738753120669e-02 + z * (-5.83357013379057348645e-02 + z * p)
    p = 9.09088713343650656196e-02 + z * (-7.69187620504482999495e-02 + z * p)
    p = 1.42857142725034663711e-01 + z * (-1.11111104054623557880e-01 + z * p)
    p = 3.33333333333329318027e-01 + z * (-1.99999999998764832476e-01 + z * p)
    angle = t - t * z * p
    if steep:
        angle += QUARTER
    if ay > ax:
        angle = HALF - angle
    if x < 0.0:
        angle = pi - angle
    return -angle if y < 0.0 else angle


@inner_kernel
def wrap(x):
    """Return the angle x brought into [-pi, pi]."""
    return x - TWO_PI * np.floor(x * PER_TURN + 0.5)
