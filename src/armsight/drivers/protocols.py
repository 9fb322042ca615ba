"""What every source of frames offers, whether files, a video, a live camera, a simulation or a recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol, Self

from armsight.records import Frame


class FrameSource(Protocol):
    """Frames of one camera in the order of time. Its constructor opens nothing; `with` opens and closes it.

    Frames carry increasing t_s, sequence 0, 1, 2 ... and the source's name or file. A source may be opened and
    read again, unless it is live.
    """

    @property
    def name(self) -> str:
        """What the person called it: folder, pattern, video file, camera."""
        ...

    @property
    def total(self) -> int | None:
        """How many frames there will be; None where that cannot be known (live, some videos)."""
        ...

    def __enter__(self) -> Self:
        """Open it. Raises DataRefused or DeviceFailed where that cannot be done."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it; legal at any time."""
        ...

    def __iter__(self) -> Iterator[Frame]:
        """Yield the frames. Raises BadImage, Inconsistent or DeviceLost at the frame that fails."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class Skew:
    """How far apart in time the frames of pairs were: right minus left, in s."""

    mean_s: float
    largest_s: float
    n_pairs: int
    n_dropped: int


class PairSource(Protocol):
    """Pairs (left, right) of frames in step; opened and closed like a FrameSource."""

    @property
    def name(self) -> str:
        """What the person called it."""
        ...

    @property
    def total(self) -> int | None:
        """How many pairs there will be; None where that cannot be known."""
        ...

    @property
    def skew(self) -> Skew | None:
        """How far apart the pairs read so far were; None where both views share one time stamp."""
        ...

    def __enter__(self) -> Self:
        """Open it. Raises DataRefused or DeviceFailed where that cannot be done."""
        ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        """Close it; legal at any time."""
        ...

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        """Yield the pairs. Raises BadImage, Inconsistent or DeviceLost at the pair that fails."""
        ...
