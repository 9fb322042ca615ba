"""Boards with markers, ChArUco and Kalibr's AprilGrid: markers name the corners, so that a part of the board is enough.

Corners are fitted here; a smooth map of all verifies where each was fitted. An AprilGrid's tags are of the family
36h11, and black squares touch their corners.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Index
from armsight.errors import Inconsistent, unused_image
from armsight.measure.boards.checkerboard import LOW_CONTRAST
from armsight.measure.boards.gridmap import fit_map, levels_at
from armsight.measure.boards.kernels.subpixel import ALONE, EVERYTHING, LAST_STEP_PX, TRIALS, fit_corners
from armsight.records import BoardView, Target, TargetKind
from armsight.records.target import board_target

Grey = NDArray[np.uint8]

MARGIN_SHARE = 0.9
"""The window ends before the next mark in a white or black field begins, at this share of the margin."""
LEAST_HALF_PX, MOST_HALF_PX = 3.0, 24.0
PAST_MARKS_PX, REACH = 8.0, 0.5
"""Where all marks lie in white fields, a window runs on past them: no smaller than this, nor larger than so much of a
field. Of squares of 24 px, what lies between the marks is too few pixels to place a corner by."""
BLUR_PX, LEAST_SHARE = 1.0, 0.5
"""Left out are the marks and so much round them, for their edges' blur, but no more than this share of the margin."""
ALIKE = 2.0
"""A view has one deviation for all its corners: one whose own is so many times the usual is left out. On a shadow's rim
it is 1.9 to 10 times, and corners are off by up to 40 of the usual ones; elsewhere it is below 2 in 98 %."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MarkerCorners:
    """What the corners of one kind of board must fulfil.

    `least` corners are needed; a corner explains at least the share `explained` of its grey levels and lies within
    `off_grid` (in grid steps) of the smooth map of all others.
    """

    board: str
    least: int
    explained: float
    off_grid: float
    cure: str

    def refuse_mirrored(self, found: int, source: str) -> None:
        """Raise BadImage where the mirrored picture holds the board: `found` corners are seen there."""
        if found >= self.least:
            raise unused_image(
                f"{source}: the board is mirrored",
                cure="Switch off the camera's mirror mode, or print the board as it is",
            )

    def fit(
        self,
        image: Grey,
        index: Index,
        uv: Array,
        *,
        grid: Array,
        margin: float,
        signs: Callable[[Array, Array], Array],
        source: str,
        in_white: bool = False,
    ) -> BoardView:
        """Fit the corners `index` (n,) near uv (n, 2) in windows within `margin` (in grid steps).

        grid: (n, 2) their places in grid steps. signs(uv, E) gives for each corner +1 where the field beyond it is
        white, from its place and the picture's step per grid step (n, 2, 2). in_white: the marks lie in the white
        fields, all of them behind the margin, and a window may run past it. Raises BadImage where too few are sharp.
        """
        for _ in range(2):
            smooth = fit_map(grid, uv)[0]
            E, Q = smooth.derivatives(grid)
            size, reach, clear = _windows(E, margin, in_white)
            start = smooth(grid)
            among = signs(start, E), ALONE, LAST_STEP_PX, TRIALS, clear
            uv, covariance, quality, _ = fit_corners(image, start, E, Q, reach, *among)
        _, distance = fit_map(grid, uv)
        good = (quality[:, 0] > self.explained) & (distance < self.off_grid * size)
        if good.any():
            good &= quality[:, 1] > LOW_CONTRAST * np.median(quality[good, 1])
        variance = 0.5 * np.trace(covariance, axis1=1, axis2=2)
        if in_white and good.any():
            good &= variance < ALIKE**2 * np.median(variance[good])
        if np.count_nonzero(good) < self.least:
            raise unused_image(
                f"{source}: {np.count_nonzero(good)} of {len(good)} corners of the {self.board} are sharp enough to be "
                "placed",
                cure=self.cure,
            )
        return BoardView(
            uv_px=uv[good],
            index=index[good],
            sigma_px=float(np.sqrt((np.mean if in_white else np.median)(variance[good]))),
            width=image.shape[1],
            height=image.shape[0],
            source=source,
        )


CHARUCO = MarkerCorners(
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
    if _few(ids) and not _few(markers):
        corners, ids = _of_old_layout(image, board)
    if _few(ids):
        seen = 0 if markers is None else len(markers)
        mirrored = detector.detectBoard(np.ascontiguousarray(image[:, ::-1]))[1]
        CHARUCO.refuse_mirrored(0 if mirrored is None else len(mirrored), source)
        raise unused_image(
            f"{source}: {0 if ids is None else len(ids)} corners of the ChArUco board were found ({seen} markers), "
            f"{CHARUCO.least} are needed",
            cure="Show more of the board, sharper and larger, and check its size and dictionary",
            size=_exchanged(image, board) if not _few(markers) else None,
        )
    index = np.asarray(ids, dtype=np.intp).ravel()
    order = np.argsort(index)
    return _refined(image, board, index[order], np.asarray(corners, float).reshape(-1, 2)[order], source)


def _few(found: Any) -> bool:
    return found is None or len(found) < CHARUCO.least


def _of_old_layout(image: Grey, board: Target) -> tuple[Any, Any]:
    """Return corners and ids of the layout before OpenCV 4.6, which some vendors print: of even rows it is another.

    No image shows both: the markers stand on the other colour's squares.
    """
    corners, ids, *_ = _detector(board, old_layout=True).detectBoard(image)
    return corners, ids


def _exchanged(image: Grey, board: Target) -> tuple[int, int] | None:
    """Return rows and columns where the board with these exchanged is there."""
    other = board_target(
        TargetKind.CHARUCO,
        board.rows,
        board.columns,
        board.pitch_m,
        marker_m=board.marker_m,
        dictionary=board.dictionary,
    )
    found = [_detector(other, old_layout=old).detectBoard(image)[1] for old in (False, True)]
    return None if all(_few(ids) for ids in found) else (board.rows, board.columns)


def _detector(board: Target, *, old_layout: bool = False) -> Any:
    """Return OpenCV's detector for the board; raises Inconsistent where the description is not a board."""
    code = getattr(cv2.aruco, board.dictionary, None)
    if code is None or not board.dictionary.startswith("DICT_"):
        known = ", ".join(name for name in sorted(dir(cv2.aruco)) if name.startswith("DICT_"))
        raise Inconsistent(f"no marker dictionary is called {board.dictionary!r}; there are {known}")
    if not 0.0 < board.marker_m < board.pitch_m:
        raise Inconsistent(f"a marker of {board.marker_m} m does not fit into a square of {board.pitch_m} m")
    dictionary = cv2.aruco.getPredefinedDictionary(code)
    charuco = cv2.aruco.CharucoBoard((board.columns, board.rows), board.pitch_m, board.marker_m, dictionary)
    charuco.setLegacyPattern(old_layout)
    return cv2.aruco.CharucoDetector(charuco)


def _refined(image: NDArray[np.uint8], board: Target, index: Index, uv: Array, source: str) -> BoardView:
    """Fit the corners in windows that stop short of the markers."""
    grid = board.xyz_m[index, :2] / board.pitch_m
    return CHARUCO.fit(
        image,
        index,
        uv,
        grid=grid,
        margin=0.5 * (1.0 - board.marker_m / board.pitch_m),
        signs=lambda positions, E: _signs(image, positions, E, grid),
        source=source,
        in_white=True,
    )


def _signs(image: NDArray[np.uint8], uv: Array, E: Array, grid: Array) -> Array:
    """Return for each corner +1 where the square beyond it is white, by a vote over all corners."""
    parity = np.where(np.rint(grid.sum(axis=1)).astype(int) % 2 == 0, 1.0, -1.0)
    near = 0.12 * np.array([[1.0, 1.0], [-1.0, -1.0], [1.0, -1.0], [-1.0, 1.0]])  # of a square: before the marker
    levels = levels_at(image, (uv[:, None] + near @ E.transpose(0, 2, 1)).reshape(-1, 2)).reshape(-1, 4)
    vote = float(parity @ (levels @ [1.0, 1.0, -1.0, -1.0]))
    return np.asarray(parity if vote >= 0.0 else -parity)


BORDERS = (2, 1)
"""Cells of black round a tag's 6 x 6: Kalibr prints two, AprilTag's own printouts have one."""
CELLS = 6
DILATIONS_PX = (0, 1)
"""By how much black is shrunk before OpenCV looks for quadrangles that stand alone: the squares touch the tags at their
corners, which its own thresholds part in a sharp picture."""
OF_KALIBR = (1, 0, 3, 2)
"""OpenCV's corners of a tag (its own top left, then clockwise) as Kalibr's lower left, lower right, upper right, upper
left: the two read the family's codes half a turn apart, and Kalibr's y is up."""
APRILGRID = MarkerCorners(
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
    if 4 * len(found) < APRILGRID.least:
        mirrored, _ = _tags(np.ascontiguousarray(image[:, ::-1]), board)
        APRILGRID.refuse_mirrored(4 * len(mirrored), source)
        raise unused_image(
            f"{source}: {len(found)} tags of the AprilGrid were found, {APRILGRID.least // 4} are needed",
            cure="Show more of the board, sharper and larger; its tags are of the family 36h11, from 0",
        )
    across = 2 * board.columns
    index, uv = [], []
    for tag, corners in sorted(found.items()):
        first = tag // board.columns * 2 * across + tag % board.columns * 2
        index += [first, first + 1, first + across + 1, first + across]
        uv += list(corners)
    order = np.argsort(index)
    return _refined_tags(image, board, np.array(index, np.intp)[order], np.array(uv)[order], border, source)


def _tags(image: Grey, board: Target) -> tuple[dict[int, Array], int]:
    """Return the corners (4, 2) of each tag found, in Kalibr's order, and the tags' border in cells."""
    best, of_best = dict[int, Array](), BORDERS[0]
    for border in BORDERS:
        detector, found = _tag_detector(border), dict[int, Array]()
        for reach in DILATIONS_PX:
            kernel = np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)
            corners, ids, _ = detector.detectMarkers(cv2.dilate(image, kernel))
            for tag, quad in zip([] if ids is None else ids.ravel().tolist(), corners, strict=True):
                if tag < board.columns * board.rows:
                    found.setdefault(tag, _grown(np.asarray(quad, float).reshape(4, 2), reach)[list(OF_KALIBR)])
        if len(found) > len(best):
            best, of_best = found, border
    return best, of_best


def _tag_detector(border: int) -> Any:
    settings = cv2.aruco.DetectorParameters()
    settings.markerBorderBits = border
    dictionary = cv2.aruco.getPredefinedDictionary(cv2.aruco.DICT_APRILTAG_36h11)
    return cv2.aruco.ArucoDetector(dictionary, settings)


def _grown(quad: Array, px: float) -> Array:
    """Return the corners (4, 2) of a quadrangle whose sides are moved outward by so much."""
    out = quad - quad.mean(axis=0)
    return np.asarray(quad + np.sqrt(2.0) * px * out / np.linalg.norm(out, axis=1)[:, None])


def _refined_tags(image: Grey, board: Target, index: Index, uv: Array, border: int, source: str) -> BoardView:
    """Fit the corners, where two black corners meet, in windows within the gap and the tag's border."""
    across = 2 * board.columns
    # black lies along the diagonal from a tag's lower left and upper right corners, white along that from the others
    sign = np.where((index % across + index // across) % 2 == 0, -1.0, 1.0)
    return APRILGRID.fit(
        image,
        index,
        uv,
        grid=board.xyz_m[index, :2] / board.marker_m,
        margin=min(board.pitch_m / board.marker_m - 1.0, border / (CELLS + 2.0 * border)),
        signs=lambda *_: sign,
        source=source,
    )


def _windows(E: Array, margin: float, in_white: bool) -> tuple[Array, Array, float]:
    """Return each corner's largest step in px, how far its window reaches, and what lies clear of marks (steps)."""
    steps, clear = np.linalg.norm(E, axis=1), EVERYTHING
    size, short = steps.max(axis=1), steps.min(axis=1)
    reach = np.clip(MARGIN_SHARE * margin, LEAST_HALF_PX / size, MOST_HALF_PX / size)
    if in_white:
        reach = np.maximum(reach, np.minimum(REACH, PAST_MARKS_PX / short))
        clear = max(LEAST_SHARE * margin, margin - BLUR_PX / float(np.median(short)))
    return size, reach, clear
