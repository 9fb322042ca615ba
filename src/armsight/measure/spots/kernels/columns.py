"""What all kernels of spots share: columns of the tables that they hand on, the picture that they read, small loops.

`row[col.S_U]` is a spot's u. Of areas `comps` (n, COLUMNS) has their sums, `state` (n, STATE) what became of them,
`fits` (n, FIT) their models and `rows` (n, MOST_LIGHTS, SPOT) their lights. And the settings `options`, and the survey
of the background.

Rows are copied by loops: assigning slices would compile numba's formatting of shape errors into every kernel.
Constants and first values of counters are passed on as np.int64: a plain 0 would compile the callee a second time, for
that value.
"""

from __future__ import annotations

from typing import Any, NamedTuple

from armsight._numba import lean_kernel

# columns of the components' table
AREA, WEIGHT, SUM_X, SUM_Y, PEAK, CLIPPED, X_MIN, X_MAX, Y_MIN, Y_MAX, LEVEL, BACKGROUND, SLOPE = range(13)
COLUMNS = 13
"""LEVEL: grey level that the area's pixels exceed. BACKGROUND: background's level. SLOPE: how far the background may
change per px; negative where the tiles of the survey tell both."""

# order of the numbers in `options` (see settings.SpotSettings)
O_THRESHOLD, O_FLIP, O_SATURATION, O_MIN_PIXELS, O_MAX_RADIUS, O_MAX_SPOTS, O_MODEL, O_GAIN = range(8)

# columns of the areas' state (n, STATE), integers
STATUS, OWNER, CROWDED, KIND, SIZE, LIGHTS = range(6)
STATE = 6

# columns of a measured spot; 2..4 and 5..7 are C_H and C_G (see leastsquares.uncertainty); S_FLOOR: variance (px^2)
# added
S_U, S_V, S_CH, S_CG = 0, 1, 2, 5
S_PEAK, S_SIZE, S_MODEL, S_DOF, S_RSS, S_SIGNAL, S_FOURTH, S_SQUARE, S_B, S_OF, S_FLOOR = range(8, 19)
SPOT = 19
MOST_LIGHTS = 6
"""Lights that are told apart within one bright area."""
MOST_PARAMETERS = 2 + 3 * MOST_LIGHTS
FIT = MOST_PARAMETERS + 4
"""Columns of a fit: the model's parameters, and the prior of the background's slope."""

# the survey (SURVEY, GRID): levels of the tiles, then backgrounds, then one row that begins with these
GRID = 8
"""Tiles per image side for the background."""
NOISE, NUMBER, PROCESSED = 0, 1, 2
SURVEY = 2 * GRID + 1


class Picture(NamedTuple):
    """An image: grey (h, w) uint8, contiguous, whose levels are grey ^ flip: flip 255 where lights are dark.

    saturation: the level from which a pixel is clipped. mask (h, w) uint8: 0 where pixels do not count; (0, 0): all do.
    """

    grey: Any
    flip: Any
    saturation: Any
    mask: Any


@lean_kernel
def copy_to(a, b):
    """Copy a (n,) to the first n entries of b."""
    for i in range(a.shape[0]):
        b[i] = a[i]


@lean_kernel
def insertion_sort(a, n):
    """Sort the first n entries of a in place (short lists only)."""
    for i in range(1, n):
        v = a[i]
        j = i - 1
        while j >= 0 and a[j] > v:
            a[j + 1] = a[j]
            j -= 1
        a[j + 1] = v
