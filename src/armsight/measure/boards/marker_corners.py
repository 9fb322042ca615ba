"""Corners of a board with markers: markers name them, a smooth map of all verifies where each was fitted."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadImage
from armsight.measure.boards.checkerboard import LOW_CONTRAST
from armsight.measure.boards.gridmap import fit_map
from armsight.measure.boards.kernels.subpixel import fit_corners
from armsight.records import BoardView

Array = NDArray[np.float64]
Grey = NDArray[np.uint8]

MARGIN_SHARE = 0.9
"""The window ends before the next mark in a white or black field begins, at this share of the margin."""
LEAST_HALF_PX, MOST_HALF_PX = 3.0, 24.0


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
            raise BadImage(
                f"{source}: the board is mirrored",
                consequence="The image is not used",
                cure="Switch off the camera's mirror mode, or print the board as it is",
            )

    def fit(
        self,
        image: Grey,
        index: NDArray[np.intp],
        uv: Array,
        *,
        grid: Array,
        margin: float,
        signs: Callable[[Array, Array], Array],
        source: str,
    ) -> BoardView:
        """Fit the corners `index` (n,) near uv (n, 2) in windows within `margin` (in grid steps).

        grid: (n, 2) their places in grid steps. signs(uv, E) gives for each corner +1 where the field beyond it is
        white, from its place and the picture's step per grid step (n, 2, 2). Raises BadImage where too few are sharp.
        """
        n = len(index)
        covariance, quality, size = np.empty((n, 2, 2)), np.empty((n, 4)), np.ones(n)
        for _ in range(2):
            smooth, _ = fit_map(grid, uv)
            E, Q = (np.ascontiguousarray(part) for part in smooth.derivatives(grid))
            size = np.linalg.norm(E, axis=1).max(axis=1)
            reach = np.clip(MARGIN_SHARE * margin, LEAST_HALF_PX / size, MOST_HALF_PX / size)
            start, uv = np.ascontiguousarray(smooth(grid)), np.empty((n, 2))
            fit_corners(image, start, E, Q, reach, signs(start, E), uv, covariance, quality)
        _, distance = fit_map(grid, uv)
        good = (quality[:, 0] > self.explained) & (distance < self.off_grid * size)
        if good.any():
            good &= quality[:, 1] > LOW_CONTRAST * np.median(quality[good, 1])
        if np.count_nonzero(good) < self.least:
            raise BadImage(
                f"{source}: {np.count_nonzero(good)} of {n} corners of the {self.board} are sharp enough to be placed",
                consequence="The image is not used",
                cure=self.cure,
            )
        return BoardView(
            uv_px=uv[good],
            index=index[good],
            sigma_px=float(np.sqrt(np.median(np.trace(covariance[good], axis1=1, axis2=2)) / 2.0)),
            width=image.shape[1],
            height=image.shape[0],
            source=source,
        )
