"""ChArUco boards: markers name the corners, so a part of the board is enough; corners are fitted here."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadImage, Inconsistent
from armsight.measure.boards.marker_corners import MarkerCorners
from armsight.records import BoardView, Target

Array = NDArray[np.float64]

CORNERS = MarkerCorners(
    board="ChArUco board",
    least=6,  # four corners fix a homography with nothing left to check it; six leave something
    explained=0.6,
    off_grid=0.15,
    cure="Hold the board still, focus the lens and avoid reflections",
)


def find_charuco(image: NDArray[np.uint8], board: Target, source: str) -> BoardView:
    """Return those corners of a ChArUco board that are seen and verified; raises BadImage with the reason."""
    detector = _detector(board)
    corners, ids, _, markers = detector.detectBoard(image)
    if ids is None or len(ids) < CORNERS.least:
        seen = 0 if markers is None else len(markers)
        mirrored = detector.detectBoard(np.ascontiguousarray(image[:, ::-1]))[1]
        CORNERS.refuse_mirrored(0 if mirrored is None else len(mirrored), source)
        raise BadImage(
            f"{source}: {0 if ids is None else len(ids)} corners of the ChArUco board were found ({seen} markers), "
            f"{CORNERS.least} are needed",
            consequence="The image is not used",
            cure="Show more of the board, sharper and larger, and check its size and dictionary",
        )
    index = np.asarray(ids, dtype=np.intp).ravel()
    order = np.argsort(index)
    return _refined(image, board, index[order], np.asarray(corners, float).reshape(-1, 2)[order], source)


def _detector(board: Target) -> Any:
    """Return OpenCV's detector for the board; raises Inconsistent where the description is not a board."""
    code = getattr(cv2.aruco, board.dictionary, None)
    if code is None or not board.dictionary.startswith("DICT_"):
        known = ", ".join(name for name in sorted(dir(cv2.aruco)) if name.startswith("DICT_"))
        raise Inconsistent(f"no marker dictionary is called {board.dictionary!r}; there are {known}")
    if not 0.0 < board.marker_m < board.pitch_m:
        raise Inconsistent(f"a marker of {board.marker_m} m does not fit into a square of {board.pitch_m} m")
    dictionary = cv2.aruco.getPredefinedDictionary(code)
    charuco = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_m, board.marker_m, dictionary)
    return cv2.aruco.CharucoDetector(charuco)


def _refined(image: NDArray[np.uint8], board: Target, index: NDArray[np.intp], uv: Array, source: str) -> BoardView:
    """Fit the corners in windows that stop short of the markers."""
    grid = board.xyz_m[index, :2] / board.pitch_m
    return CORNERS.fit(
        image,
        index,
        uv,
        grid=grid,
        margin=0.5 * (1.0 - board.marker_m / board.pitch_m),
        signs=lambda places, E: _signs(image, places, E, grid),
        source=source,
    )


def _signs(image: NDArray[np.uint8], uv: Array, E: Array, grid: Array) -> Array:
    """Return for each corner +1 where the square beyond it is white, by a vote over all corners."""
    parity = np.where(np.rint(grid.sum(axis=1)).astype(int) % 2 == 0, 1.0, -1.0)
    vote = 0.0
    near = 0.12  # of a square: inside the margin around the marker
    for place, direction, step in zip(uv, parity, E, strict=True):
        levels = []
        for s, t in ((1, 1), (-1, -1), (1, -1), (-1, 1)):
            u, v = place + step @ np.array([s * near, t * near])
            col = int(np.clip(np.rint(u), 0, image.shape[1] - 1))
            row = int(np.clip(np.rint(v), 0, image.shape[0] - 1))
            levels.append(float(image[row, col]))
        vote += direction * (levels[0] + levels[1] - levels[2] - levels[3])
    return np.asarray(parity if vote >= 0.0 else -parity)
