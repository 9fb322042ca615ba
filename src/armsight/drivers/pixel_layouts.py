"""Pictures as sensors and other programs' messages bring them, as 8-bit grey or BGR."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

CHANNELS = {"mono": 1, "bgr": 3, "rgb": 3, "bgra": 4, "rgba": 4, "rggb": 1, "bggr": 1, "gbrg": 1, "grbg": 1}
"""Bytes of a pixel by its layout; a Bayer mosaic is named by its first two rows, two pixels each."""

_CODES: dict[tuple[str, bool], int] = {
    ("mono", True): cv2.COLOR_GRAY2BGR,
    ("bgr", False): cv2.COLOR_BGR2GRAY,
    ("rgb", False): cv2.COLOR_RGB2GRAY,
    ("rgb", True): cv2.COLOR_RGB2BGR,
    ("bgra", False): cv2.COLOR_BGRA2GRAY,
    ("bgra", True): cv2.COLOR_BGRA2BGR,
    ("rgba", False): cv2.COLOR_RGBA2GRAY,
    ("rgba", True): cv2.COLOR_RGBA2BGR,
    ("rggb", False): cv2.COLOR_BayerRGGB2GRAY,
    ("rggb", True): cv2.COLOR_BayerRGGB2BGR,
    ("bggr", False): cv2.COLOR_BayerBGGR2GRAY,
    ("bggr", True): cv2.COLOR_BayerBGGR2BGR,
    ("gbrg", False): cv2.COLOR_BayerGBRG2GRAY,
    ("gbrg", True): cv2.COLOR_BayerGBRG2BGR,
    ("grbg", False): cv2.COLOR_BayerGRBG2GRAY,
    ("grbg", True): cv2.COLOR_BayerGRBG2BGR,
}


def unpack_image(data: Any, height: int, width: int, step: int, layout: str) -> NDArray[np.uint8] | None:
    """Return the pixels of a buffer, (h, w) or (h, w, channels) as laid out; None where the buffer is too short.

    data: bytes, or an array of them. step: bytes from one row to the next, at least those of a row.
    """
    row = width * CHANNELS[layout]
    flat = np.frombuffer(data, np.uint8)
    if not height or not width or step < row or len(flat) < step * (height - 1) + row:
        return None
    rows = np.lib.stride_tricks.as_strided(flat, (height, row), (step, 1), writeable=False)
    pixels = rows if CHANNELS[layout] == 1 else rows.reshape(height, width, CHANNELS[layout])
    return np.ascontiguousarray(pixels)


def grey_or_bgr(pixels: NDArray[np.uint8], layout: str, *, colour: bool) -> NDArray[np.uint8]:
    """Return pixels (h, w) or (h, w, channels) of a layout as BGR (h, w, 3), or as grey (h, w)."""
    code = _CODES.get((layout, colour))
    return pixels if code is None else np.asarray(cv2.cvtColor(pixels, code), dtype=np.uint8)
