"""Compiled parts of the renderer: spread functions, noise, board.

Light is float32 (h, w, c) in grey levels, c = 1 (grey) or 3 (BGR); the centre of the top-left pixel is (0, 0).
"""

from __future__ import annotations

from math import floor, isfinite
from typing import Any, NamedTuple

import numpy as np
from scipy.special import ndtr

from armsight._numba import inner_kernel, kernel
from armsight.geometry.kernels import copy_1

REACH_SIGMA = 5.5
"""The spread function is drawn this many sigma (and a pixel) far: less than 1e-7 of its flux lies outside."""


TABLE_REACH = 7.0
"""The Gaussian's integrals are tabulated this many sigma far; 1e-12 lies beyond."""

TABLE_DENSITY = 64
"""Entries per sigma: cubics through values and slopes are then right to 1.4 / 384 / 64^4 = 2e-10, and several times
faster than erf."""


def _cubics(value, slope):
    """Return coefficients 0..3 (4, n-1), read-only, of the cubics through values and slopes at n entries."""
    # Hermite: with values y0, y1 and slopes a, b (times the step), c2 = 3 (y1 - y0) - 2 a - b, c3 = a + b - 2 (y1 - y0)
    rise, a, b = np.diff(value), slope[:-1] / TABLE_DENSITY, slope[1:] / TABLE_DENSITY
    coefficients = np.stack([value[:-1], a, 3.0 * rise - 2.0 * a - b, a + b - 2.0 * rise])
    coefficients.setflags(write=False)
    return coefficients


def _tabulate():
    """Return the cubics of the unit Gaussian's integral and of that integral's integral."""
    t = np.arange(-TABLE_REACH * TABLE_DENSITY, TABLE_REACH * TABLE_DENSITY + 1.0) / TABLE_DENSITY
    # Phi integrates to t Phi + phi, so that both tables come from scipy's ndtr and their slopes are exact
    bell = np.exp(-0.5 * t * t) / np.sqrt(2.0 * np.pi)
    return _cubics(ndtr(t), bell), _cubics(t * ndtr(t) + bell, ndtr(t))


_STEP, _RAMP = _tabulate()


@inner_kernel
def _gauss_step(t):
    """Return the integral of the unit Gaussian from minus infinity to t."""
    if t <= -TABLE_REACH:
        return 0.0
    if t >= TABLE_REACH:
        return 1.0
    # cubic Hermite between entries: c0 + c1 s + c2 s^2 + c3 s^3 of the share s of the step
    at = (t + TABLE_REACH) * TABLE_DENSITY
    k = int(at)
    s = at - k
    return _STEP[0, k] + s * (_STEP[1, k] + s * (_STEP[2, k] + s * _STEP[3, k]))


@inner_kernel
def _gauss_ramp(t):
    """Return the integral of _gauss_step from minus infinity to t."""
    if t <= -TABLE_REACH:
        return 0.0
    if t >= TABLE_REACH:  # t Phi(t) + phi(t), of which all but t is below 1e-12 here
        return t
    at = (t + TABLE_REACH) * TABLE_DENSITY
    k = int(at)
    s = at - k
    return _RAMP[0, k] + s * (_RAMP[1, k] + s * (_RAMP[2, k] + s * _RAMP[3, k]))


@inner_kernel
def _span(low, high, size):
    """Return the first pixel and one past the last that touch [low, high] in an image of size pixels."""
    return int(min(max(np.floor(low), 0.0), size)), int(min(max(np.ceil(high) + 1.0, 0.0), size))


@inner_kernel
def _fill_steps(out, first, last, centre, sigma, factor):
    """Fill out[:last-first] with factor times the share of a Gaussian that falls on each of the pixels."""
    # a pixel reaches half a pixel to either side of its middle, and shares its edge with the next
    before = _gauss_step((first - 0.5 - centre) / sigma)
    for i in range(first, last):
        after = _gauss_step((i + 0.5 - centre) / sigma)
        out[i - first] = factor * (after - before)
        before = after


@inner_kernel
def _fill_ramps(out, first, last, centre, sigma):
    """Fill out[:last-first] with the mean over each of the pixels of the Gaussian's integral from the left."""
    before = _gauss_ramp((first - 0.5 - centre) / sigma)
    for i in range(first, last):
        after = _gauss_ramp((i + 0.5 - centre) / sigma)
        out[i - first] = sigma * (after - before)
        before = after


@kernel
def add_gaussians(light, uv, weight, sigma, bgr):
    """Add to light (h, w, c) a Gaussian at each uv (n, 2), integrated over every pixel.

    weight: (n,) flux of each in grey levels x px^2. bgr: (c,) share of each channel. Centres that are not
    finite are skipped, those outside the image shine in as far as they reach.
    """
    height, width, channels = light.shape
    reach = REACH_SIGMA * sigma + 1.0
    wx, wy = np.empty(int(2.0 * reach) + 5), np.empty(int(2.0 * reach) + 5)
    for k in range(uv.shape[0]):
        u, v = uv[k, 0], uv[k, 1]
        if not (isfinite(u) and isfinite(v)):
            continue
        i0, i1 = _span(u - reach, u + reach, width)
        j0, j1 = _span(v - reach, v + reach, height)
        # a Gaussian is the product of one along each axis, and so is its integral over a pixel
        _fill_steps(wx, i0, i1, u, sigma, weight[k])
        _fill_steps(wy, j0, j1, v, sigma, 1.0)
        for j in range(j0, j1):
            for i in range(i0, i1):
                for c in range(channels):
                    light[j, i, c] += np.float32(bgr[c] * wy[j - j0] * wx[i - i0])


@inner_kernel
def _add_cover(cover, i0, j0, outline, dv, sigma, factor):
    """Add factor times the share of each pixel that a blurred region covers to cover (h, w), whose corner is i0, j0."""
    height, width = cover.shape
    reach = REACH_SIGMA * sigma + 1.0
    if (outline[:, 0] * dv).sum() < 0.0:  # the signed area: the curve runs the other way round
        factor = -factor
    wx, wy = np.empty(width), np.empty(int(2.0 * reach) + 5)
    for k in range(outline.shape[0]):
        u, v = outline[k, 0] - i0, outline[k, 1] - j0
        near_i0, near_i1 = _span(u - reach, u + reach, width)
        near_j0, near_j1 = _span(v - reach, v + reach, height)
        # pixels far left of a node have none of its spread to their left, those far right all of it
        wx[:near_i0] = 0.0
        _fill_ramps(wx[near_i0:], near_i0, near_i1, u, sigma)
        wx[near_i1:] = 1.0
        _fill_steps(wy, near_j0, near_j1, v, sigma, factor * dv[k])
        for j in range(near_j0, near_j1):
            for i in range(width):
                # Green: the integral of (1 - wx) dv round the curve, of which the 1 adds up to nothing
                cover[j, i] -= wy[j - near_j0] * wx[i]


@kernel
def add_regions(light, outlines, dv, share, sigma, bgr):
    """Add to light (h, w, c) uniformly lit regions, blurred by a Gaussian, integrated over every pixel.

    outlines: (m, n, 2) px, each n nodes of a smooth closed curve, evenly spaced in its parameter; dv: (m, n)
    derivative of the curve's v times the step of the parameter. share: (m,) of the exposure for each. bgr: (c,)
    plateau of each channel in grey levels.
    Green's theorem turns the area integral of the spread function into one along the outline, of the
    spread function already integrated to the left; the periodic trapezoid rule converges exponentially as
    long as the nodes lie no further apart than about sigma. Outlines that are not finite are skipped.
    """
    reach = REACH_SIGMA * sigma + 1.0
    for m in range(outlines.shape[0]):
        if not np.isfinite(outlines[m]).all():
            continue
        u, v = outlines[m, :, 0], outlines[m, :, 1]
        i0, i1 = _span(u.min() - reach, u.max() + reach, light.shape[1])
        j0, j1 = _span(v.min() - reach, v.max() + reach, light.shape[0])
        if i0 >= i1 or j0 >= j1:
            continue
        cover = np.zeros((j1 - j0, i1 - i0))
        _add_cover(cover, i0, j0, outlines[m], dv[m], sigma, share[m])
        for j in range(j0, j1):
            for i in range(i0, i1):
                for c in range(light.shape[2]):
                    light[j, i, c] += np.float32(bgr[c] * cover[j - j0, i - i0])


@inner_kernel
def _draw_bits(s0, s1, s2, s3, bits):
    """Fill bits (n,) uint64 with one step of n generators xoshiro256++ (Blackman, Vigna 2019) side by side.

    s0..s3: (n,) uint64, the generators' states, which move on. Side by side they fill the vector registers.
    """
    for i in range(bits.size):
        a, b, c, d = s0[i], s1[i], s2[i], s3[i]
        r = a + d
        bits[i] = ((r << np.uint64(23)) | (r >> np.uint64(41))) + a
        t = b << np.uint64(17)
        c ^= a
        d ^= b
        b ^= c
        a ^= d
        c ^= t
        s0[i], s1[i], s2[i] = a, b, c
        s3[i] = (d << np.uint64(45)) | (d >> np.uint64(19))


@inner_kernel
def _draw_normals(bits, table, z):
    """Fill z (n,) with standard normals: each the sum of two entries of table (4096,), chosen by 24 of 32 bits."""
    low, shift = np.uint32(0xFFF), np.uint32(12)
    for i in range(z.size):
        # entries of variance 1/2, so that the sum of two has variance 1; bits 0 to 11 and 12 to 23 are independent
        r = bits[i]
        z[i] = table[r & low] + table[(r >> shift) & low]


class Noise(NamedTuple):
    """What a sensor makes of light: grey levels per electron, read noise and clipping in grey levels."""

    gain: float
    read_noise: float
    saturation: float


class Over(NamedTuple):
    """A patch (h, w) or (h, w, c) that replaces light from [row, column] on."""

    patch: Any
    row: int
    column: int


@inner_kernel
def _digitise(light, z, noise, out):
    """Fill out (n,) uint8 with the grey levels of light (n,) under the standard normals z (n,).

    Mean, variance and third moment are those of Poisson electrons plus Gaussian read noise (Cornish-Fisher).
    """
    gain, variance0 = np.float32(noise.gain), np.float32(noise.read_noise * noise.read_noise + 1e-12)
    skew = np.float32(noise.gain * noise.gain / 6.0)
    half, one, zero, top = np.float32(0.5), np.float32(1.0), np.float32(0.0), np.float32(noise.saturation)
    for i in range(light.size):
        mean, q = light[i], z[i]
        # m / gain electrons have the variance and the third moment m / gain: in grey levels gain m and gain^2 m
        variance = variance0 + gain * mean
        # Cornish and Fisher (1938), first term: q + (q^2 - 1) mu3 / (6 sigma^3), times sigma
        value = mean + np.sqrt(variance) * q + skew * mean / variance * (q * q - one) + half
        value = value if value > zero else zero
        value = value if value < top else top
        out[i] = np.uint8(np.int32(value))


@kernel
def develop(light, over, noise, table, state, out):
    """Fill out (h, n) uint8 with what the sensor makes of light (h, n) float32 >= 0 in grey levels.

    over, noise: the fields of Over and Noise as plain tuples. state: (4, (n+1)//2) uint64, one generator for every two
    columns; it moves on by a step per row.
    """
    over, noise = Over(*over), Noise(*noise)
    height, width = light.shape
    row, column, (high, wide) = over.row, over.column, over.patch.shape
    bits = np.empty(state.shape[1], np.uint64)
    halves = bits.view(np.uint32)  # each number gives the bits of two neighbours
    z = np.empty(width, np.float32)
    mixed = np.empty(width, np.float32)
    for j in range(height):
        _draw_bits(state[0], state[1], state[2], state[3], bits)
        _draw_normals(halves, table, z)
        if row <= j < row + high:
            copy_1(light[j], mixed)
            mixed[column : column + wide] = over.patch[j - row]
            _digitise(mixed, z, noise, out[j])
        else:
            _digitise(light[j], z, noise, out[j])


@inner_kernel
def _count(light, z, noise, steps, out):
    """Fill out (n,) uint16 as _digitise does, in `steps` steps a grey level."""
    gain, variance0 = np.float32(noise.gain), np.float32(noise.read_noise * noise.read_noise + 1e-12)
    skew = np.float32(noise.gain * noise.gain / 6.0)
    half, one, zero, fine = np.float32(0.5), np.float32(1.0), np.float32(0.0), np.float32(steps)
    most = np.float32(steps * noise.saturation)
    for i in range(light.size):
        mean, q = light[i], z[i]
        variance = variance0 + gain * mean
        value = fine * (mean + np.sqrt(variance) * q + skew * mean / variance * (q * q - one)) + half
        value = value if value > zero else zero
        value = value if value < most else most
        out[i] = np.uint16(np.int32(value))


@inner_kernel
def _behind_mosaic(light, j, over, mixed):
    """Fill mixed (w,) with row j of light (h, w, 3) as the filters of the pattern RGGB let it pass, the patch over it.

    Channels are blue, green, red: even rows begin with red, odd ones with green.
    """
    even, odd = (2, 1) if j % 2 == 0 else (1, 0)
    for i in range(0, light.shape[1], 2):
        mixed[i] = light[j, i, even]
    for i in range(1, light.shape[1], 2):
        mixed[i] = light[j, i, odd]
    if over.row <= j < over.row + over.patch.shape[0]:
        for i in range(over.patch.shape[1]):
            # the pattern is the sensor's and goes by the column in the image, not in the patch
            mixed[over.column + i] = over.patch[j - over.row, i, even if (over.column + i) % 2 == 0 else odd]


@kernel
def develop_raw(light, over, bayer, noise, steps, table, state, out):
    """Fill out uint16 with the raw signal of light (h, w, c) float32 >= 0, in `steps` steps a grey level.

    over, noise: the fields of Over and Noise as plain tuples. bayer: out is (h, w), each pixel behind one filter of the
    pattern RGGB of light in blue, green, red; otherwise out is (h, w c). state: as in develop, for rows of out.
    """
    over, noise = Over(*over), Noise(*noise)
    height, channels = light.shape[0], light.shape[2]
    row, (high, wide, _) = over.row, over.patch.shape
    bits = np.empty(state.shape[1], np.uint64)
    halves = bits.view(np.uint32)
    z, mixed = np.empty(out.shape[1], np.float32), np.empty(out.shape[1], np.float32)
    for j in range(height):
        _draw_bits(state[0], state[1], state[2], state[3], bits)
        _draw_normals(halves, table, z)
        if bayer:
            _behind_mosaic(light, j, over, mixed)
        else:
            copy_1(light[j].ravel(), mixed)
            if row <= j < row + high:
                first = over.column * channels
                copy_1(over.patch[j - row].ravel(), mixed[first : first + wide * channels])
        _count(mixed, z, noise, steps, out[j])


@kernel
def apply_curve(raw, curve, out):
    """Fill out (n,) uint8 with the entries of curve (m,) uint8 that raw (n,) uint16 names."""
    for i in range(raw.size):
        out[i] = curve[raw[i]]


@inner_kernel
def _cell(H, x, y, columns, rows):
    """Return column and row of the board's square that the ray (x, y, 1) meets, both clamped to one beyond the edge."""
    # the plane-to-plane map of a pinhole: (a w, b w, w) = H (x, y, 1); w <= 0 is behind the camera
    w = H[2, 0] * x + H[2, 1] * y + H[2, 2]
    if not w > 0.0:
        return -3, -3
    a = (H[0, 0] * x + H[0, 1] * y + H[0, 2]) / w
    b = (H[1, 0] * x + H[1, 1] * y + H[1, 2]) / w
    return floor(min(max(a, -3.0), columns + 2.0)), floor(min(max(b, -3.0), rows + 2.0))


@inner_kernel
def _shade(a, b, columns, rows, shades):
    """Return the shade of square (a, b): black, white (also one square of margin round the board), or beyond."""
    if a < -2 or b < -2 or a > columns or b > rows:
        return shades[2]
    if a < -1 or b < -1 or a > columns - 1 or b > rows - 1:
        return shades[1]
    return shades[(a + b) & 1]  # neighbours differ by one, so that the sum's last bit is the colour


@kernel
def cast_board(corner_rays, H, columns, rows, shades, lattice, out):
    """Fill out (h, w) float32 with the mean shade of a checkerboard over each pixel, by casting rays.

    corner_rays: (h+1, w+1, 2) rays through the pixels' corners. H: (3, 3) takes a ray (x, y, 1) to the
    board's plane in squares, origin at the first of columns x rows inner corners. shades: black, white, beyond the
    board. lattice: (n, 2) sample places in the unit square. A pixel whose corners lie in one square is taken
    as uniform; in the others n rays are cast, interpolated between those of the corners.
    """
    for j in range(out.shape[0]):
        for i in range(out.shape[1]):
            r00, r01 = corner_rays[j, i], corner_rays[j, i + 1]
            r10, r11 = corner_rays[j + 1, i], corner_rays[j + 1, i + 1]
            first = _cell(H, r00[0], r00[1], columns, rows)
            same = first == _cell(H, r11[0], r11[1], columns, rows)
            same = same and first == _cell(H, r01[0], r01[1], columns, rows)
            # a square is convex, and so is a pixel: with all four corners in one square all of it is
            if same and first == _cell(H, r10[0], r10[1], columns, rows):
                out[j, i] = _shade(first[0], first[1], columns, rows, shades)
                continue
            total = 0.0
            for k in range(lattice.shape[0]):
                s, t = lattice[k, 0], lattice[k, 1]
                x = (1.0 - t) * ((1.0 - s) * r00[0] + s * r01[0]) + t * ((1.0 - s) * r10[0] + s * r11[0])
                y = (1.0 - t) * ((1.0 - s) * r00[1] + s * r01[1]) + t * ((1.0 - s) * r10[1] + s * r11[1])
                a, b = _cell(H, x, y, columns, rows)
                total += _shade(a, b, columns, rows, shades)
            out[j, i] = np.float32(total / lattice.shape[0])
