"""What was seen of a printed board in one image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.errors import Inconsistent
from armsight.records.checks import frozen_array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardView:
    """The points of a board found in one image.

    uv_px: (n, 2). index: (n,) position of each in the board's xyz_m; a ChArUco board may be seen in part.
    sigma_px: standard deviation of one coordinate of one point, as the detector believes it. source: the
    image's name. width, height: of the image in px.
    """

    uv_px: NDArray[np.float64]
    index: NDArray[np.intp]
    sigma_px: float
    width: int
    height: int
    source: str

    def __post_init__(self) -> None:
        index = np.array(self.index, dtype=np.intp)
        object.__setattr__(self, "uv_px", frozen_array("uv_px", self.uv_px, (len(index), 2)))
        if len(set(index.tolist())) != len(index) or (len(index) and index.min() < 0):
            raise Inconsistent(f"{self.source}: a point of the board is named twice")
        index.setflags(write=False)
        object.__setattr__(self, "index", index)
        if not self.sigma_px > 0.0:
            raise Inconsistent(f"{self.source}: a detector without noise ({self.sigma_px} px) is not believed")

    def __len__(self) -> int:
        return len(self.index)
