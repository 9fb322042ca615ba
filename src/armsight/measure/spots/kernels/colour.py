"""A beacon of a given colour: the signal in which it stands out, and which pixels are of the colour."""

from __future__ import annotations

from math import sqrt

import numpy as np

from armsight._numba import inner_kernel, kernel, lean_kernel
from armsight.measure.spots.kernels.scan import brightest

# a colour as the kernels see it: hue from, to (degrees, wrapping), least saturation (0..1), least value (0..255)
HUE_FROM, HUE_TO, LEAST_SATURATION, LEAST_VALUE = range(4)

SHIFT = np.int32(12)
ONE = 4096
"""Unit of the weights of the channels: the sum is in integers."""
SPARSE = 8
PALE = 0.75
NEARLY = 0.97
"""Shares of the clipping level that all channels of a nearly white pixel reach, and the brightest one at the least:
compression leaves some of a clipped area a little below."""
HALO = 3
HALO_LEVEL = 48
HALO_SHARE = 0.4
"""Frame in px about something white, and the signal that this share of it has round a light that is too bright."""
FEWEST_UNCLIPPED = 6.0
FRAME_GAP = 4
NEIGHBOURHOOD = 90
LOCAL_SHARE = 0.75
CLIPPED_FROM = 250
"""Pixels about a light that tell how bright the room is there."""

# what measure_colour sees: by how much blue, green, red are brighter than the background; own level; level of what is
# round it; blue, green, red as they are
BRIGHT, LOCAL, OWN = 3, 4, 5
LOOK = 8

OCTANTS = 8


STRETCH = 192
"""Channels that are looked at together: of 64 pixels."""
ONE_ON, TWO_ON = np.uint64(1), np.uint64(2)


@kernel
def whiten_clipped(channels, saturation, grey):
    """Set grey (n,) to 255 where any of a pixel's channels (3 n,), side by side, is clipped."""
    for first in range(0, grey.size, STRETCH // 3):
        n = min(STRETCH // 3, grey.size - first)
        if brightest(channels, np.uint8(0), 3 * first, 3 * n) < saturation:
            continue
        for i in range(first, first + n):
            at = np.uint64(3 * i)  # unsigned and without a branch: vector code
            clipped = max(max(channels[at], channels[at + ONE_ON]), channels[at + TWO_ON]) >= np.uint8(saturation)
            grey[np.uint64(i)] |= np.uint8(255) * np.uint8(clipped)


@kernel
def matches(b, g, r, colour):
    """Tell whether a pixel of integer channels lies within the colour (hue, saturation and value as usual in HSV)."""
    high = max(max(b, g), r)
    spread = high - min(min(b, g), r)
    if high < colour[LEAST_VALUE] or spread <= 0 or spread < colour[LEAST_SATURATION] * high:
        return False
    if high == r:
        hue = 60.0 * (g - b) / spread
    elif high == g:
        hue = 120.0 + 60.0 * (b - r) / spread
    else:
        hue = 240.0 + 60.0 * (r - g) / spread
    if hue < 0.0:
        hue += 360.0
    # a range of hues may go over 360 degrees, as that of red does
    if colour[HUE_FROM] <= colour[HUE_TO]:
        return colour[HUE_FROM] <= hue <= colour[HUE_TO]
    return hue >= colour[HUE_FROM] or hue <= colour[HUE_TO]


@kernel
def coloured_pixels(image, colour, box):
    """Return how many pixels of box (x first, x last, y first, y last) lie within the colour."""
    n = 0
    for y in range(box[2], box[3] + 1):
        for x in range(box[0], box[1] + 1):
            if matches(np.int64(image[y, x, 0]), np.int64(image[y, x, 1]), np.int64(image[y, x, 2]), colour):
                n += 1
    return n


@kernel
def colour_signal(image, weights, floor, saturation, signal, levels):
    """Fill signal (h, w) with floor and the weighted sum of BGR, kept in 0..255; 255 where two channels are clipped.

    weights (3,): in units of 1 / ONE. Where one channel is clipped, the sum is a little too small, as of a light with a
    flat top; where two are, it falls to the middle. levels (256,): how often the brightest channel has each level, of
    every SPARSE-th pixel of every SPARSE-th row. Returns how many pixels are clipped and nearly white: what is under
    them the sum does not tell.
    """
    w0 = np.int32(weights[0])
    w1 = np.int32(weights[1])
    w2 = np.int32(weights[2])
    top = np.int32(saturation)
    pale = np.int32(PALE * saturation)
    start = np.int32(floor * ONE + ONE // 2)
    positive = np.int32(floor * ONE + ONE)
    white = np.int64(0)
    for y in range(signal.shape[0]):
        for x in range(signal.shape[1]):
            b = np.int32(image[y, x, 0])
            g = np.int32(image[y, x, 1])
            r = np.int32(image[y, x, 2])
            s = start + w0 * b + w1 * g + w2 * r
            clipped = np.int32(b >= top) + np.int32(g >= top) + np.int32(r >= top)
            if clipped > 0:
                if min(b, min(g, r)) >= pale:
                    white += 1
                elif clipped > 1 and s > positive:
                    s = np.int32(255 * ONE)
            signal[y, x] = np.uint8(min(max(s, np.int32(0)) >> SHIFT, np.int32(255)))
        if y % SPARSE == 0:
            for x in range(0, signal.shape[1], SPARSE):
                levels[max(max(image[y, x, 0], image[y, x, 1]), image[y, x, 2])] += 1
    return white


@kernel
def white_pixels(image, saturation, white):
    """Fill white with 255 where every second pixel of every second row is clipped and nearly white, else 0."""
    for y in range(white.shape[0]):
        for x in range(white.shape[1]):
            white[y, x] = 255 if _pale(image, 2 * y, 2 * x, saturation) else 0


@kernel
def fill_white(image, saturation, box, signal):
    """Set signal to 255 in the clipped, nearly white pixels of box (x first, x last, y first, y last) where what is
    round them is coloured: the middle of a light that is too bright. Tells whether it is."""
    h, w = signal.shape
    n = np.int64(0)
    coloured = np.int64(0)
    for y in range(max(box[2] - HALO, 0), min(box[3] + HALO, h - 1) + 1):
        for x in range(max(box[0] - HALO, 0), min(box[1] + HALO, w - 1) + 1):
            if not _pale(image, y, x, saturation):
                n += 1
                coloured += signal[y, x] >= HALO_LEVEL
    if n == 0 or coloured < HALO_SHARE * n:
        return False
    for y in range(max(box[2] - 1, 0), min(box[3] + 1, h - 1) + 1):
        for x in range(max(box[0] - 1, 0), min(box[1] + 1, w - 1) + 1):
            if _pale(image, y, x, saturation):
                signal[y, x] = 255
    return True


@lean_kernel
def _pale(image, y, x, saturation):
    b = image[y, x, 0]
    g = image[y, x, 1]
    r = image[y, x, 2]
    return max(max(b, g), r) >= NEARLY * saturation and min(min(b, g), r) >= PALE * saturation


@kernel
def measure_colour(image, signal, box, level, floor, saturation, seen):
    """Fill seen (LOOK,) with what the pixels of box (x first, x last, y first, y last) above level of signal show.

    How much brighter they are than the median of a frame about the box, by channel, of the upper half of their height
    and without clipped pixels where those are enough: what a light adds is of its own colour, whatever stands behind
    it. How bright the upper half is in its brightest channel. And the level that LOCAL_SHARE of the pixels about it
    stay below, no clipped ones.
    """
    h, w = signal.shape
    x0, x1, y0, y1 = box[0], box[1], box[2], box[3]
    sums = np.zeros((3, 4))  # of unclipped pixels of the upper half, of the others and the halo, of clipped ones
    peak = np.int64(0)
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            peak = max(peak, np.int64(signal[y, x]))
    high = 0.5 * (max(level, floor) + peak)
    bright = 0.0
    n_bright = 0.0
    least = min(level, float(HALO_LEVEL))
    for y in range(max(y0 - HALO, 0), min(y1 + HALO, h - 1) + 1):
        for x in range(max(x0 - HALO, 0), min(x1 + HALO, w - 1) + 1):
            if signal[y, x] <= least:
                continue
            top = max(max(image[y, x, 0], image[y, x, 1]), image[y, x, 2])
            k = 2 if top >= saturation else 0 if signal[y, x] >= high else 1
            for c in range(3):
                sums[k, c] += image[y, x, c]
            sums[k, 3] += 1.0
            if signal[y, x] >= high:
                bright += top
                n_bright += 1.0
    for k in range(1, 3):
        # too few: those further out as well, then clipped ones, which are paler than the light
        if sums[0, 3] < FEWEST_UNCLIPPED:
            for c in range(4):
                sums[0, c] += sums[k, c]
    gap = FRAME_GAP + max(x1 - x0, y1 - y0) // 4
    x0, x1, y0, y1 = max(x0 - gap, 0), min(x1 + gap, w - 1), max(y0 - gap, 0), min(y1 + gap, h - 1)
    counts = _frame_levels(image, x0, x1, y0, y1)
    for c in range(3):
        seen[OWN + c] = sums[0, c] / max(sums[0, 3], 1.0)
        seen[c] = seen[OWN + c] - histogram_quantile(counts[c], np.int64(256), 0.5)
    seen[BRIGHT] = bright / max(n_bright, 1.0)
    seen[LOCAL] = histogram_quantile(_levels_about(image, x0, x1, y0, y1), np.int64(CLIPPED_FROM), LOCAL_SHARE)


@inner_kernel
def _frame_levels(image, x0, x1, y0, y1):
    """Return how often each channel has each level (3, 256) in the outer two pixels of a box."""
    counts = np.zeros((3, 256), np.int64)
    for y in range(y0, y1 + 1):
        for x in range(x0, x1 + 1):
            if y < y0 + 2 or y > y1 - 2 or x < x0 + 2 or x > x1 - 2:
                for c in range(3):
                    counts[c, image[y, x, c]] += 1
    return counts


@inner_kernel
def _levels_about(image, x0, x1, y0, y1):
    """Return how often the brightest channel has each level (256,) about a box."""
    counts = np.zeros(256, np.int64)
    for y in range(max(y0 - NEIGHBOURHOOD, 0), min(y1 + NEIGHBOURHOOD, image.shape[0]), 4):
        for x in range(max(x0 - NEIGHBOURHOOD, 0), min(x1 + NEIGHBOURHOOD, image.shape[1]), 4):
            counts[max(max(image[y, x, 0], image[y, x, 1]), image[y, x, 2])] += 1
    return counts


@kernel
def histogram_quantile(counts, end, share):
    """Return the level that the share of all counted levels below end stays below; 0 where there are none."""
    n = np.int64(0)
    for i in range(end):
        n += counts[i]
    below = np.int64(0)
    for i in range(end):
        below += counts[i]
        if below > share * n:
            return float(i)
    return 0.0


@kernel
def background_unevenness(signal, u, v, radius):
    """Return how uneven the background about a light at (u, v) is: standard deviation of the means over the OCTANTS of
    a frame about it, over half of the light's height."""
    h, w = signal.shape
    x, y = int(u + 0.5), int(v + 0.5)
    inner = int(radius + 0.5)
    outer = inner + FRAME_GAP + inner // 2
    peak = np.int64(0)
    sums = np.zeros(OCTANTS)
    counts = np.zeros(OCTANTS)
    for j in range(max(y - outer, 0), min(y + outer, h - 1) + 1):
        for i in range(max(x - outer, 0), min(x + outer, w - 1) + 1):
            away = max(abs(i - x), abs(j - y))
            if away <= inner:
                peak = max(peak, np.int64(signal[j, i]))
            elif away > outer - 2:
                # which eighth of the frame: the signs of both ways from the centre, and which is longer
                k = (1 if i > x else 0) + (2 if j > y else 0) + (4 if abs(i - x) > abs(j - y) else 0)
                sums[k] += signal[j, i]
                counts[k] += 1.0
    n = 0.0
    mean = 0.0
    square = 0.0
    for k in range(OCTANTS):
        if counts[k] > 0.0:
            level = sums[k] / counts[k]
            n += 1.0
            mean += level
            square += level * level
    if n < 2.0:
        return 1.0
    mean /= n
    return sqrt(max(square / n - mean * mean, 0.0)) / max(0.5 * (peak - mean), 1.0)
