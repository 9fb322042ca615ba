"""A beacon of a given colour: the signal in which it stands out, and which pixels are of the colour."""

from __future__ import annotations

import numpy as np

from armsight.measure.spots.kernels.compiled import kernel
from armsight.measure.spots.kernels.scan import brightest

# a colour as the kernels see it: hue from, to (degrees, wrapping), least saturation (0..1), least value (0..255)
HUE_FROM, HUE_TO, LEAST_SATURATION, LEAST_VALUE = range(4)


STRETCH = 192
"""Channels that are looked at together: of 64 pixels."""


@kernel
def whiten_clipped(channels, saturation, grey):
    """Set grey (n,) to 255 where any of a pixel's channels (3 n,), side by side, is clipped."""
    for start in range(0, channels.size, STRETCH):
        n = min(STRETCH, channels.size - start)
        if brightest(channels, np.uint8(0), start, n) < saturation:
            continue
        for i in range(start, start + n):
            if channels[i] >= saturation:
                grey[i // 3] = np.uint8(255)


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
def colour_signal(image, weights, floor, saturation, signal):
    """Fill signal (h, w) with floor and the weighted sum of BGR, kept in 0..255; 255 where two channels are clipped.

    Where one is, the sum is a little too small, as of a light with a flat top; where two are, it falls to the middle.
    """
    w0 = weights[0]
    w1 = weights[1]
    w2 = weights[2]
    for y in range(signal.shape[0]):
        for x in range(signal.shape[1]):
            b = image[y, x, 0]
            g = image[y, x, 1]
            r = image[y, x, 2]
            s = w0 * b + w1 * g + w2 * r + floor
            if s > floor + 0.5 and int(b >= saturation) + int(g >= saturation) + int(r >= saturation) > 1:
                s = 255.0
            signal[y, x] = np.uint8(min(max(s + 0.5, 0.0), 255.0))
