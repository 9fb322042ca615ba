"""Kalibr's AprilGrid by its own description; nothing of OpenCV's markers or of armsight draws."""

import numpy as np

CODES = (
    *(0xD5D628584, 0xD97F18B49, 0xDD280910E, 0xE479E9C98, 0xEBCBCA822, 0xF31DAB3AC),
    *(0x056A5D085, 0x10652E1D4, 0x22B1DFEAD, 0x265AD0472, 0x34FE91B86, 0x3FF962CD5),
)
"""Of 36h11, the first twelve: 36 bits row by row from the upper left, 1 is white."""
COLUMNS, ROWS, TAG_M, SPACING = 4, 3, 0.04, 0.3


def ink(x: np.ndarray, y: np.ndarray, border: int) -> np.ndarray:
    """Return the reflectance at places on the sheet, in tags' sides, y up."""
    pitch, cells = 1.0 + SPACING, 6 + 2 * border
    column, row = np.floor(x / pitch).astype(int), np.floor(y / pitch).astype(int)
    s, t = x - column * pitch, y - row * pitch
    on_tag = (column >= 0) & (column < COLUMNS) & (row >= 0) & (row < ROWS) & (s < 1.0) & (t < 1.0)
    # from the left and from the top of a tag
    i, j = np.floor(s * cells).astype(int) - border, np.floor((1.0 - t) * cells).astype(int) - border
    code = np.array(CODES)[np.clip(row * COLUMNS + column, 0, len(CODES) - 1)]
    bit = (code >> np.clip(35 - (6 * j + i), 0, 35)) & 1
    white = (i >= 0) & (i < 6) & (j >= 0) & (j < 6) & (bit == 1)
    square = (s >= 1.0) & (t >= 1.0) & (column >= -1) & (column < COLUMNS) & (row >= -1) & (row < ROWS)
    return np.where((on_tag & ~white) | square, 0.06, 0.86)
