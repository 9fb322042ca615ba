"""Frames of a rig's cameras at one time each, from files by their order; or from images that hold all views."""

from __future__ import annotations

import re
import warnings
from abc import ABC, abstractmethod
from collections.abc import Callable, Generator, Iterable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import repeat
from pathlib import Path
from typing import Self, TypeVar

import numpy as np

from armsight.drivers.protocols import FrameSource, Views
from armsight.drivers.sources import ImageFolder
from armsight.errors import DeviceFailed, Inconsistent
from armsight.records import Frame
from armsight.records.result_parts import Skew

PAIR = ("left", "right")

FEWEST = 2
"""Views that make a moment of three cameras and more: one alone tells no depth."""


class Moment(Views):
    """One frame of each camera at one time, in the rig's order; None where one has none. A pair always has both."""

    __slots__ = ()

    @property
    def there(self) -> tuple[Frame, ...]:
        """The frames that there are."""
        return tuple(frame for frame in self if frame is not None)

    @property
    def t_s(self) -> float:
        """The mean of their times."""
        return float(np.mean([frame.t_s for frame in self.there]))


def by_name(names: Sequence[str], moment: Views) -> dict[str, Frame]:
    """Return the frames that a moment has, by their cameras' names."""
    return {name: frame for name, frame in zip(names, moment, strict=True) if frame is not None}


M = TypeVar("M")


def moments_of(source: Iterable[M]) -> Generator[M, None, None]:
    """Yield a source's moments, as a generator, which can be closed."""
    yield from source


def news_of(source: object, told: list[str]) -> list[str]:
    """Return what to tell of a source since it was last told, which it notes: cameras that were lost, frames apart."""
    lost: Mapping[str, str] = getattr(source, "lost", {})
    apart: str = getattr(source, "apart", "")
    news = {name: f"the camera {name} is lost: {why}" for name, why in lost.items()} | ({apart: apart} if apart else {})
    fresh = [key for key in news if key not in told]
    told += fresh
    return [news[key] for key in fresh]


def pairs_of(moments: Iterable[Views]) -> Generator[tuple[Frame, Frame], None, None]:
    """Yield the two frames of each moment of a pair of cameras."""
    for left, right in moments:
        if left is not None and right is not None:
            yield left, right


class Moments(ABC):
    """The moments of some sources, in the order of the rig's cameras; opened and closed like a FrameSource.

    Of one or two cameras every moment has every frame: what fails ends it. Of more a frame that is missing or cannot be
    read is a missing view, and a camera that is lost is told at once and left out, as long as `fewest` are left.
    lost: why, by name. n_dropped: frames so far that had no partner. untimed: whether nothing is known of when cameras
    expose, so that it is told where their stamps are apart; apart: what was told of that.
    """

    def __init__(
        self,
        *sources: FrameSource,
        names: Sequence[str] = PAIR,
        fewest: int | None = None,
        tell: Callable[[str], None] = warnings.warn,
    ) -> None:
        self.sources = sources
        self.names = tuple(names)
        self.fewest = fewest or min(FEWEST, len(sources))
        self.lost: dict[str, str] = {}
        self.untimed, self.apart = False, ""
        self.n_dropped = 0
        self._partial = len(sources) > len(PAIR)
        self._tell = tell
        self._stack = ExitStack()

    @property
    def name(self) -> str:
        """All sources' names."""
        return " + ".join(source.name for source in self.sources)

    @property
    def total(self) -> int | None:
        """The smallest count; of more than two the largest, since views may be missing."""
        counts = [count for count in (source.total for source in self.sources) if count is not None]
        if len(counts) < len(self.sources):
            return None
        return max(counts) if self._partial else min(counts)

    @property
    def n_late(self) -> int:
        """Frames of live cameras that newer ones displaced before they were asked for: what reads them is too slow."""
        return sum(getattr(source, "n_late", 0) for source in self.sources)

    @property
    def skew(self) -> Skew | None:
        """How far apart the frames of a moment were so far; None where they share one time stamp."""
        return None

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            for source in self.sources:
                stack.enter_context(source)
            self._check()
            self._stack = stack.pop_all()
        return self

    def __exit__(self, *_: object) -> None:
        self._stack.close()

    def _check(self) -> None:  # noqa: B027  # most have nothing to check
        """Refuse sources, all open, that do not belong together."""

    def __iter__(self) -> Iterator[Moment]:
        """Yield the moments; files are read from now on. Raises BadImage, Inconsistent, DeviceLost where one fails."""
        return self._moments([iter(source) for source in self.sources])

    @abstractmethod
    def _moments(self, streams: Sequence[Iterator[Frame]]) -> Iterator[Moment]:
        """Yield the moments of the sources' frames."""

    def _lose(self, k: int, why: DeviceFailed | Inconsistent) -> None:
        """Go on without a camera and tell it; raise why where too few are left."""
        if not self._partial or len(self.sources) - len(self.lost) - 1 < self.fewest:
            raise why
        self._leave(k, why.cause, why.cure)

    def _leave(self, k: int, cause: str, cure: str = "") -> None:
        """Tell that a camera shows nothing more, and what would keep it."""
        self.lost[self.names[k]] = cause
        left = ", ".join(name for name in self.names if name not in self.lost)
        self._tell(f"the camera {self.names[k]} is lost: {cause}; left are {left}" + (f". {cure}" if cure else ""))


class FileMoments(Moments):
    """Files by position in their sorted order.

    Raises Inconsistent on opening where the counts differ or file numbers show that a partner is missing, and at the
    end where one video is shorter than the other. Of three cameras and more the images are put together by the numbers
    in their names, where all folders number them alike.
    """

    _rows: Sequence[tuple[bool, ...]] = ()

    def _check(self) -> None:
        folders = [source for source in self.sources if isinstance(source, ImageFolder)]
        if len(folders) < len(self.sources) or len(folders) < len(PAIR):
            return
        if self._partial:
            self._rows = _rows([one.paths for one in folders], self.names)
            for k, folder in enumerate(folders):
                folder.moments = [j for j, row in enumerate(self._rows) if row[k]]
        else:
            check_partners(folders[0].paths, folders[1].paths)

    def _moments(self, streams: Sequence[Iterator[Frame]]) -> Iterator[Moment]:
        count = 0
        for row in self._rows or repeat((True,) * len(streams)):
            frames = [next(stream, None) if there else None for stream, there in zip(streams, row, strict=True)]
            ended = [k for k, frame in enumerate(frames) if frame is None and row[k]]
            if len(ended) == len(frames) or (ended and self._rows):
                return
            for k in ended:
                longer = next(source for j, source in enumerate(self.sources) if j not in ended)
                early = ended_early(self.sources[k], longer, count)
                if not self._partial:
                    raise early
                if self.names[k] not in self.lost:
                    self._leave(k, early.cause)
            if len(frames) - len(self.lost) < self.fewest:
                return
            if self._partial:  # what cannot be read is a view that is missing
                frames = [None if frame is None or frame.unreadable else frame for frame in frames]
            if sum(frame is not None for frame in frames) >= self.fewest:
                yield Moment(frames)
                count += 1
            else:
                self.n_dropped += sum(frame is not None for frame in frames)


def ended_early(short: FrameSource, long: FrameSource, count: int) -> Inconsistent:
    """Return the refusal of sources of which one ended, after so many moments, before another."""
    return Inconsistent(
        f"{short.name} ends after {count} frames, {long.name} goes on",
        consequence=f"The {count} pairs until there were read, and none behind them",
        cure="Give two recordings of the same length",
    )


def check_partners(left: Sequence[Path], right: Sequence[Path]) -> None:
    """Refuse image files that do not pair up: Inconsistent with both counts and the first without a partner.

    The last number in the files' names tells partners where both folders number them alike; time stamps or other
    names that have nothing in common are paired by position.
    """
    lefts, rights = _numbers(left), _numbers(right)
    common = lefts.keys() & rights.keys()
    numbered_alike = 2 * len(common) >= min(len(left), len(right))
    unpaired = [(number, path) for number, path in lefts.items() if number not in rights]
    unpaired += [(number, path) for number, path in rights.items() if number not in lefts]
    if len(left) == len(right) and not (numbered_alike and unpaired):
        return
    if numbered_alike and unpaired:
        first = f"; the first without a partner is {min(unpaired)[1]}"
    elif len(left) != len(right):
        longer, shorter = (left, right) if len(left) > len(right) else (right, left)
        first = f"; {longer[len(shorter)]} is the first without a partner, counted from the start"
    raise Inconsistent(
        f"the left camera has {len(left)} images, the right one {len(right)}{first}",
        consequence="Nobody can say which images were taken together, so nothing was measured",
        cure="Remove the image whose partner is missing, or give the folders that belong together",
    )


def _rows(paths: Sequence[Sequence[Path]], names: Sequence[str]) -> list[tuple[bool, ...]]:
    """Return for each moment which folders have an image of it: by number where all number alike, else by position."""
    numbers = [_numbers(each) for each in paths]
    common = set(numbers[0]).intersection(*numbers[1:])
    if 2 * len(common) >= max(map(len, paths)) and all(numbers):
        in_order = all(list(each) == sorted(each) for each in numbers)
        if in_order:
            return [tuple(n in each for each in numbers) for n in sorted(set().union(*numbers))]
    if len({len(each) for each in paths}) == 1:
        return []
    counts = ", ".join(f"{name} {len(each)}" for name, each in zip(names, paths, strict=True))
    raise Inconsistent(
        f"the cameras have different numbers of images, {counts}, and their names do not tell which belong together",
        consequence="Nobody can say which images were taken together, so nothing was measured",
        cure="Number the files of one moment alike in all folders, or give folders of as many images",
    )


def _numbers(paths: Sequence[Path]) -> dict[int, Path]:
    """Return file by the last number in its name; empty where a file has none or two share one."""
    found: dict[int, Path] = {}
    for path in paths:
        digits = re.findall(r"\d+", path.stem)
        if not digits or int(digits[-1]) in found:
            return {}
        found[int(digits[-1])] = path
    return found


class OneImage(Moments):
    """One image per moment that holds all views: one upon the other, or of these sizes side by side.

    sizes: (width, height) of the rig's cameras in px, () where the views lie one upon the other (a mirror rig's: each
    image is its own pair). Raises Inconsistent at the first image whose size is not theirs side by side.
    """

    def __init__(self, source: FrameSource, *sizes: tuple[int, int]) -> None:
        super().__init__(source)
        self._sizes = sizes

    def _moments(self, streams: Sequence[Iterator[Frame]]) -> Iterator[Moment]:
        for frame in streams[0]:
            yield Moment(self._parts(frame)) if self._sizes else Moment((frame,) * len(PAIR))

    def _parts(self, frame: Frame) -> list[Frame]:
        widths, heights = zip(*self._sizes, strict=True)
        if frame.width != sum(widths) or {frame.height} != set(heights):
            raise Inconsistent(
                f"{frame.source} is {frame.width}x{frame.height} px, the rig's views side by side are "
                f"{sum(widths)}x{max(heights)} px",
                consequence="The image cannot be split into its two views",
                cure="Give the rig that was calibrated with this camera at this resolution",
            )
        ends = np.cumsum(widths).tolist()
        return [
            replace(frame, image=frame.image[:, end - width : end]) for end, width in zip(ends, widths, strict=True)
        ]
