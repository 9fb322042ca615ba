"""What cameras saw: one image, a printed board in it, spots over time."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from armsight.arrays import Array, Index
from armsight.errors import BadImage, Inconsistent
from armsight.records.checks import freeze, require_numbers
from armsight.records.target import Target, TargetKind


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BoardView:
    """The points of a board found in one image.

    uv_px: (n, 2). index: (n,) position of each in the board's xyz_m; a ChArUco board may be seen in part.
    sigma_px: standard deviation of one coordinate of one point, as the detector believes it. source: the
    image's name. width, height: of the image in px.
    """

    uv_px: NDArray[np.float64]
    index: Index
    sigma_px: float
    width: int
    height: int
    source: str

    def __post_init__(self) -> None:
        index = np.array(self.index, dtype=np.intp)
        freeze(self, uv_px=(len(index), 2))
        if len(set(index.tolist())) != len(index) or (len(index) and index.min() < 0):
            raise Inconsistent(f"{self.source}: a point of the board is named twice")
        index.setflags(write=False)
        object.__setattr__(self, "index", index)
        if not self.sigma_px > 0.0:
            raise Inconsistent(f"{self.source}: a detector without noise ({self.sigma_px} px) is not believed")

    def __len__(self) -> int:
        return len(self.index)


def grid_turns(board: Target) -> dict[int, Index]:
    """Return the quarter turns (0..3, about z) that carry the board's points onto its points, colours aside.

    Each comes with its renumbering: point i of the turned board lies where point turn[i] was.
    """
    grid = board.xyz_m[:, :2] / board.pitch_m
    halves = np.rint(2.0 * grid - grid.min(axis=0) - grid.max(axis=0)).astype(np.intp)  # centred, in half steps
    order = np.lexsort(halves.T)
    turned = halves
    found: dict[int, Index] = {}
    for quarter in range(4):
        order_turned = np.lexsort(turned.T)
        if (turned[order_turned] == halves[order]).all():
            turn = np.empty(len(order), dtype=np.intp)
            turn[order_turned] = order
            found[quarter] = turn
        turned = np.stack([-turned[:, 1], turned[:, 0]], axis=1)
    return found


def symmetries(board: Target) -> tuple[Index, ...]:
    """Return the renumberings that leave the print unchanged, the identity first.

    A checkerboard's colours count: a 9x6 board (inner corners) has only the identity, an 8x6 one may be
    half a turn off without a trace. Markers and tags have names and lights are no print: only the identity.
    """
    identity = np.arange(len(board.names), dtype=np.intp)
    if board.kind in (TargetKind.CHARUCO, TargetKind.APRILGRID, TargetKind.SPOTS):
        return (identity,)
    turns = grid_turns(board)
    if board.kind is TargetKind.CHECKERBOARD:
        parity = np.rint(board.xyz_m[:, :2].sum(axis=1) / board.pitch_m).astype(int) % 2
        # a quarter turn moves the square beyond a corner to the side, where the colour is the other
        turns = {q: turn for q, turn in turns.items() if ((parity[turn] + q) % 2 == parity).all()}
    return tuple(turns.values())


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SpotTrack:
    """Stamps of one camera's frames in s (n,), growing, and the spots (m,) seen in them.

    frame (m,): the row of t_s that each spot belongs to, not falling. names (m,): which light it is; "" where nobody
    said. uv_px (m, 2), covariance_px2 (m, 2, 2): in the frame's own pixels, with the lens's distortion.
    """

    t_s: Array
    frame: Index
    names: tuple[str, ...]
    uv_px: Array
    covariance_px2: Array

    def __post_init__(self) -> None:
        m = len(self.names)
        object.__setattr__(self, "names", tuple(self.names))
        freeze(self, t_s=(None,), uv_px=(m, 2), covariance_px2=(m, 2, 2))
        frame = np.array(self.frame, dtype=np.intp)
        frame.setflags(write=False)
        object.__setattr__(self, "frame", frame)
        if frame.shape != (m,) or (
            m and not (frame[0] >= 0 and frame[-1] < len(self.t_s) and (np.diff(frame) >= 0).all())
        ):
            raise Inconsistent("each spot belongs to one of the frames, and spots come in the order of frames")
        if (np.diff(self.t_s) <= 0.0).any():
            raise Inconsistent(
                "the stamps of a camera's frames do not grow",
                consequence="The frames have no order",
                cure="Give each frame once, in the order of time",
            )

    def __len__(self) -> int:
        return len(self.t_s)

    @property
    def alone(self) -> bool:
        """Whether no frame holds more than one spot."""
        return len(np.unique(self.frame)) == len(self.frame)

    def light(self, name: str) -> Index:
        """Return the rows of the spots of one light."""
        return np.flatnonzero([each == name for each in self.names])

    def renamed(self, name: str) -> SpotTrack:
        """Return it with this name for all of its spots."""
        return SpotTrack(
            t_s=self.t_s,
            frame=self.frame,
            names=(name,) * len(self.names),
            uv_px=self.uv_px,
            covariance_px2=self.covariance_px2,
        )
