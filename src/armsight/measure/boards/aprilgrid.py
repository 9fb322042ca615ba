"""Kalibr's AprilGrid: tags of the family 36h11 whose corners black squares touch; corners are fitted here."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadImage
from armsight.measure.boards.marker_corners import MarkerCorners
from armsight.records import BoardView, Target

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

BORDERS = (2, 1)
"""Cells of black round a tag's 6 x 6: Kalibr prints two, AprilTag's own printouts have one."""
CELLS = 6
DILATIONS_PX = (0, 1)
"""By how much black is shrunk before OpenCV looks for quadrangles that stand alone: the squares touch the tags at their
corners, which its own thresholds part in a sharp picture."""
OF_KALIBR = (1, 0, 3, 2)
"""OpenCV's corners of a tag (its own top left, then clockwise) as Kalibr's lower left, lower right, upper right, upper
left: the two read the family's codes half a turn apart, and Kalibr's y is up."""
CORNERS = MarkerCorners(
    board="AprilGrid",
    least=8,  # two tags: four corners fix a homography with nothing left to check it
    # a whole corner has 0.998 at a noise of 2 of 190 levels; one that an edge cuts has 0.85 at most, and is off by up
    # to 9 px (tests/unit/boards/test_aprilgrid.py)
    explained=0.93,
    off_grid=0.08,
    cure="Hold the board still, focus the lens and avoid reflections; black squares belong at the tags' corners",
)


def find_aprilgrid(image: Grey, board: Target, source: str) -> BoardView:
    """Return those corners of an AprilGrid that are seen and verified; raises BadImage with the reason."""
    found, border = _tags(image, board)
    if 4 * len(found) < CORNERS.least:
        mirrored, _ = _tags(np.ascontiguousarray(image[:, ::-1]), board)
        CORNERS.refuse_mirrored(4 * len(mirrored), source)
        raise BadImage(
            f"{source}: {len(found)} tags of the AprilGrid were found, {CORNERS.least // 4} are needed",
            consequence="The image is not used",
            cure="Show more of the board, sharper and larger; its tags are of the family 36h11, from 0",
        )
    across = 2 * board.columns
    index, uv = [], []
    for tag, corners in sorted(found.items()):
        first = tag // board.columns * 2 * across + tag % board.columns * 2
        index += [first, first + 1, first + across + 1, first + across]
        uv += list(corners)
    order = np.argsort(index)
    return _refined(image, board, np.array(index, np.intp)[order], np.array(uv)[order], border, source)


def _tags(image: Grey, board: Target) -> tuple[dict[int, Array], int]:
    """Return the corners (4, 2) of each tag found, in Kalibr's order, and the tags' border in cells."""
    best, of_best = dict[int, Array](), BORDERS[0]
    for border in BORDERS:
        detector, found = _detector(border), dict[int, Array]()
        for reach in DILATIONS_PX:
            kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
            corners, ids, _ = detector.detectMarkers(cv2.dilate(image, kernel))
            for tag, quad in zip([] if ids is None else ids.ravel().tolist(), corners, strict=True):
                if tag < board.columns * board.rows:
                    found.setdefault(tag, _grown(np.asarray(quad, float).reshape(4, 2), reach)[list(OF_KALIBR)])
        if len(found) > len(best):
            best, of_best = found, border
    return best, of_best


def _detector(border: int) -> Any:
    settings = cv2.aruco.DetectorParameters()
    settings.markerBorderBits = border
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    return cv2.aruco.ArucoDetector(dictionary, settings)


def _grown(quad: Array, px: float) -> Array:
    """Return the corners (4, 2) of a quadrangle whose sides are moved outward by so much."""
    out = quad - quad.mean(axis=0)
    return np.asarray(quad + np.sqrt(2.0) * px * out / np.linalg.norm(out, axis=1)[:, None])


def _refined(image: Grey, board: Target, index: NDArray[np.intp], uv: Array, border: int, source: str) -> BoardView:
    """Fit the corners, where two black corners meet, in windows within the gap and the tag's border."""
    across = 2 * board.columns
    # black lies along the diagonal from a tag's lower left and upper right corners, white along that from the others
    sign = np.where((index % across + index // across) % 2 == 0, -1.0, 1.0)
    return CORNERS.fit(
        image,
        index,
        uv,
        grid=board.xyz_m[index, :2] / board.marker_m,
        margin=min(board.pitch_m / board.marker_m - 1.0, border / (CELLS + 2.0 * border)),
        signs=lambda *_: sign,
        source=source,
    )
