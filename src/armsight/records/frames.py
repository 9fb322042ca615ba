"""One image with what must be known about it."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.errors import BadImage
from armsight.records.checks import require_numbers


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Frame:
    """An 8-bit image, grey (h, w) or BGR (h, w, 3), with time, number and origin.

    t_s is the middle of the exposure of the middle line, on the recording's clock. The image is not
    copied (a frame is large); it is made read-only instead. Centre of the top-left pixel: (0, 0); image[row, column].
    unreadable: why a file among others gave no picture; the image is then black, and nothing may be measured in it.
    """

    image: NDArray[np.uint8]
    t_s: float
    sequence: int
    source: str
    exposure_s: float = 0.0
    unreadable: str = ""

    def __post_init__(self) -> None:
        image = self.image
        if not isinstance(image, np.ndarray):
            raise BadImage(
                f"{self.source}: the image is of type {type(image).__name__}",
                consequence="The frame cannot be searched",
                cure="Give an array (h, w) or (h, w, 3) of uint8",
            )
        require_numbers(self, "t_s", "sequence", "exposure_s")
        if image.dtype != np.uint8 or image.ndim not in (2, 3) or (image.ndim == 3 and image.shape[2] != 3):
            raise BadImage(
                f"{self.source}: an image of type {image.dtype} and shape {image.shape} is not 8-bit grey or BGR",
                consequence="The frame cannot be searched",
                cure="Convert it to 8-bit grey or BGR",
            )
        if image.size == 0:
            raise BadImage(f"{self.source}: the image is empty")
        view = np.ascontiguousarray(image).view()
        view.setflags(write=False)
        object.__setattr__(self, "image", view)

    @property
    def height(self) -> int:
        """Rows of the image."""
        return int(self.image.shape[0])

    @property
    def width(self) -> int:
        """Columns of the image."""
        return int(self.image.shape[1])
