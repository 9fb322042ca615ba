"""Finding a printed board in an image, or saying why not."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadImage, Inconsistent, UsageError
from armsight.measure.boards.aprilgrid import find_aprilgrid
from armsight.measure.boards.charuco import find_charuco
from armsight.measure.boards.checkerboard import find_checkerboard
from armsight.measure.boards.circles import find_circles
from armsight.measure.boards.kernels.subpixel import fit_corners, fit_dots
from armsight.records import BoardView, Target, TargetKind

DETECTORS = ("auto", "classic", "sectors", "xcorner")
"""How checkerboards are first looked for: auto tries classic and sectors, OpenCV's two; xcorner is the one of Pachidis
et al. 2005. The corners are fitted the same way afterwards."""

DARK_LEVEL = 40.0
WHITE_LEVEL = 215.0
LEAST_CONTRAST = 15.0
"""Grey levels between the image's darkest and brightest percent: below this no print can be told from noise."""
SMALLEST_PX = 32


def find_board(image: NDArray[np.uint8], board: Target, *, source: str = "", detector: str = "auto") -> BoardView:
    """Return the board's points in an image, uint8 (h, w) grey or (h, w, 3) BGR, to sub-pixel precision.

    Points are numbered as in board.xyz_m: x along the columns, y to the right hand of it as the camera sees the
    printed side, of an AprilGrid to the left as Kalibr has it. A checkerboard begins at a black square where its
    colours tell; a circle grid with one bigger dot begins there; where the print leaves a choice, x points right in it
    (see same_way_up for pairs). detector: one of DETECTORS. Raises BadImage, saying why: dark, white, blurred, another
    size, mirrored, not there; Inconsistent where the target is not a board; UsageError for an unknown detector.
    """
    if detector not in DETECTORS:
        raise UsageError(f"no detector is called {detector!r}; there are {', '.join(DETECTORS)}")
    source = source or "the image"
    grey = grey_image(image, source)
    check_exposure(grey, source)
    if board.kind is TargetKind.CHECKERBOARD:
        return find_checkerboard(grey, board, source, detector)
    if board.kind is TargetKind.CHARUCO:
        return find_charuco(grey, board, source)
    if board.kind is TargetKind.APRILGRID:
        return find_aprilgrid(grey, board, source)
    if board.kind in (TargetKind.CIRCLES, TargetKind.ACIRCLES):
        return find_circles(grey, board, source)
    raise Inconsistent(f"a target of kind {board.kind.value} is not a printed board", cure="Give a board")


def warm_up() -> None:
    """Compile the fits, or load them from the cache, so that the first image does not wait for it."""
    image = grey_image(np.zeros((SMALLEST_PX, SMALLEST_PX), np.uint8), "")
    middle, axes, one = np.full((1, 2), 16.0), np.eye(2)[None] * 4.0, np.ones(1)
    uv, covariance, quality = np.empty((1, 2)), np.empty((1, 2, 2)), np.empty((1, 4))
    fit_corners(image, middle, axes, np.zeros((1, 2, 3)), one, one, uv, covariance, quality)
    fit_dots(image, middle, axes, one, 0.0, uv, covariance, quality)


def grey_image(image: NDArray[np.uint8], source: str) -> NDArray[np.uint8]:
    """Return the image as contiguous uint8 (h, w)."""
    if image.dtype != np.uint8 or image.ndim not in (2, 3) or min(image.shape[:2]) < SMALLEST_PX:
        raise BadImage(
            f"{source}: an image of type {image.dtype} and shape {image.shape} cannot show a board",
            consequence="The image is not used",
            cure="Give 8-bit grey or BGR images",
        )
    grey = cv2.cvtColor(image, cv2.COLOR_BGR2GRAY) if image.ndim == 3 else image
    contiguous: NDArray[np.uint8] = np.ascontiguousarray(grey, dtype=np.uint8).view()
    contiguous.setflags(write=False)  # as a frame's image is: one compilation serves all
    return contiguous


def check_exposure(grey: NDArray[np.uint8], source: str) -> None:
    """Raise BadImage for an image that is black, white or grey all over."""
    low, middle, high = np.percentile(grey[::2, ::2], [1.0, 50.0, 99.0])
    if high - low >= LEAST_CONTRAST:
        return
    if middle < DARK_LEVEL:
        what, cure = "is dark all over", "Light the board, lengthen the exposure or take the lens cap off"
    elif middle > WHITE_LEVEL:
        what, cure = "is white all over", "Shorten the exposure"
    else:
        what, cure = "has no contrast", "Light the board and focus the lens"
    raise BadImage(
        f"{source}: {what} (grey levels {low:.0f} to {high:.0f})", consequence="The image is not used", cure=cure
    )
