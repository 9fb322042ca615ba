"""Pairs of frames from files, drivers by their name, and from what a person writes to a source of frames."""

from __future__ import annotations

import re
from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing
from dataclasses import replace
from inspect import Parameter, signature
from pathlib import Path
from types import TracebackType
from typing import Any, Self, cast

from armsight.clock import Clock, SystemClock
from armsight.drivers.camera_settings import AUTOMATIC, CameraSettings, PairSettings, by_side
from armsight.drivers.images import AS_THEY_ARE, ImageReading
from armsight.drivers.live import MAX_SKEW_S, LivePairs
from armsight.drivers.protocols import FrameSource, PairSource
from armsight.drivers.sources import FPS, VIDEO_SUFFIXES, ImageFolder, VideoFile
from armsight.errors import Inconsistent, UsageError
from armsight.records import Frame
from armsight.records.result_parts import Skew
from armsight.registry import CAMERAS, load


class FilePairs:
    """Left and right frames paired by position in their sorted order.

    Raises Inconsistent on opening where the counts differ or file numbers show that a partner is missing, and at
    the end where one video is shorter than the other.
    """

    def __init__(self, left: FrameSource, right: FrameSource) -> None:
        self._left = left
        self._right = right
        self._stack = ExitStack()

    @property
    def name(self) -> str:
        """Both sources' names."""
        return f"{self._left.name} + {self._right.name}"

    @property
    def total(self) -> int | None:
        """The smaller of both counts."""
        counts = [count for count in (self._left.total, self._right.total) if count is not None]
        return min(counts) if len(counts) == 2 else None

    @property
    def skew(self) -> Skew | None:
        """None: files carry one time per pair."""
        return None

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            stack.enter_context(self._left)
            stack.enter_context(self._right)
            if isinstance(self._left, ImageFolder) and isinstance(self._right, ImageFolder):
                check_partners(self._left.paths, self._right.paths)
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        with closing(_generator(self._left)) as lefts, closing(_generator(self._right)) as rights:
            count = 0
            while True:
                left, right = next(lefts, None), next(rights, None)
                if left is None or right is None:
                    break
                yield left, right
                count += 1
            if (left is None) != (right is None):
                short, long = (self._left, self._right) if left is None else (self._right, self._left)
                raise ended_early(short, long, count)


def ended_early(short: FrameSource, long: FrameSource, count: int) -> Inconsistent:
    """Return the refusal of two sources of which one ended, after so many pairs, before the other."""
    return Inconsistent(
        f"{short.name} ends after {count} frames, {long.name} goes on",
        consequence=f"The {count} pairs until there were read, and none behind them",
        cure="Give two recordings of the same length",
    )


class ComplexImages(ABC):
    """One image per moment that holds both views: the pairs of one source."""

    def __init__(self, source: FrameSource) -> None:
        self._source = source

    @property
    def name(self) -> str:
        """The source's name."""
        return self._source.name

    @property
    def total(self) -> int | None:
        """The source's count."""
        return self._source.total

    @property
    def skew(self) -> Skew | None:
        """None: both views are of one exposure."""
        return None

    def __enter__(self) -> Self:
        self._source.__enter__()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._source.__exit__(kind, error, trace)

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        with closing(_generator(self._source)) as frames:
            for frame in frames:
                yield self._views(frame)

    @abstractmethod
    def _views(self, frame: Frame) -> tuple[Frame, Frame]:
        """Return the left and the right view in a frame."""


class Overlaid(ComplexImages):
    """Complex images that hold both views one upon the other (a mirror rig's): each is its own pair."""

    def _views(self, frame: Frame) -> tuple[Frame, Frame]:
        return frame, frame


class SplitImages(ComplexImages):
    """Complex images that hold the left view in their left part and the right view in their right.

    left_size, right_size: (width, height) of the rig's cameras in px. Raises Inconsistent at the first frame whose
    size is not theirs side by side.
    """

    def __init__(self, source: FrameSource, left_size: tuple[int, int], right_size: tuple[int, int]) -> None:
        super().__init__(source)
        self._left_size = left_size
        self._right_size = right_size

    def _views(self, frame: Frame) -> tuple[Frame, Frame]:
        (left_width, left_height), (right_width, right_height) = self._left_size, self._right_size
        if frame.width != left_width + right_width or not frame.height == left_height == right_height:
            raise Inconsistent(
                f"{frame.source} is {frame.width}x{frame.height} px, the rig's views side by side are "
                f"{left_width + right_width}x{max(left_height, right_height)} px",
                consequence="The image cannot be split into its two views",
                cure="Give the rig that was calibrated with this camera at this resolution",
            )
        return self._part(frame, 0, left_width), self._part(frame, left_width, right_width)

    @staticmethod
    def _part(frame: Frame, start: int, width: int) -> Frame:
        return replace(frame, image=frame.image[:, start : start + width])


class _Closing(Iterator[Frame]):
    """An iterator that can be closed; a source may hand out one that cannot."""

    def __init__(self, iterator: Iterator[Frame]) -> None:
        self._iterator = iterator

    def __next__(self) -> Frame:
        return next(self._iterator)

    def close(self) -> None:
        """Close the generator below, where it is one."""
        close = getattr(self._iterator, "close", None)
        if close is not None:
            close()


def _generator(source: FrameSource) -> _Closing:
    return _Closing(iter(source))


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


def _numbers(paths: Sequence[Path]) -> dict[int, Path]:
    """Return file by the last number in its name; empty where a file has none or two share one."""
    found: dict[int, Path] = {}
    for path in paths:
        digits = re.findall(r"\d+", path.stem)
        if not digits or int(digits[-1]) in found:
            return {}
        found[int(digits[-1])] = path
    return found


CAMERA = "camera:"
DEFAULT_CAMERA = "opencv"


def is_live(text: str) -> bool:
    """Tell whether the text names a live camera."""
    return text.startswith(CAMERA)


def is_video(text: str) -> bool:
    """Tell whether the text names a video file."""
    return Path(text).suffix.lower() in VIDEO_SUFFIXES and not Path(text).is_dir()


def open_source(
    text: str,
    *,
    colour: bool = False,
    fps: float | None = None,
    times_s: Sequence[float] | None = None,
    clock: Clock | None = None,
    origin_s: float | None = None,
    settings: CameraSettings = AUTOMATIC,
    reading: ImageReading = AS_THEY_ARE,
) -> FrameSource:
    """Return the source that a person's text names; nothing is opened yet.

    camera:0 or camera:/dev/video0 is a camera of OpenCV's, camera:DRIVER or camera:DRIVER:DEVICE one of a registered
    driver; settings: what is asked of it. reading: of image files. Raises UsageError, or DeviceNotFound for an
    unknown driver.
    """
    if is_live(text):
        reading.require_none(text)
        if times_s is not None:
            raise UsageError("a live camera brings its own time stamps", cure="Leave --times away")
        driver, device = _driver(text.removeprefix(CAMERA))
        make = load(CAMERAS, driver)
        asked = _asked(make, settings, text)
        return cast(FrameSource, make(device, colour=colour, clock=clock, origin_s=origin_s, **asked))
    settings.require_none(text)
    suffix = Path(text).suffix.lower()
    if suffix == ".mcap":
        raise UsageError(
            f"{text} is a recording, and only frames of cameras, images and videos are taken here",
            cure="Turn it into images first: armsight convert recording",
        )
    if is_video(text):
        reading.require_none(text)
        return VideoFile(text, colour=colour, fps=fps, times_s=times_s)
    return ImageFolder(text, colour=colour, fps=fps or FPS, times_s=times_s, reading=reading)


def open_pairs(
    left: str,
    right: str,
    *,
    colour: bool = False,
    fps: float | None = None,
    times_s: Sequence[float] | None = None,
    max_skew_s: float = MAX_SKEW_S,
    settings: PairSettings = AUTOMATIC,
    reading: ImageReading = AS_THEY_ARE,
) -> PairSource:
    """Return the pairs of two sources; nothing is opened yet. Raises UsageError for one live and one not.

    settings: what is asked of live cameras, of both or of each.
    """
    if is_live(left) != is_live(right):
        raise UsageError(f"{left} and {right} cannot be paired: one is live, the other is not")
    if left == right:
        raise UsageError(
            f"left and right are both {left}",
            consequence="The same image twice has no depth",
            cure="Give each camera's own source; where a command has --image, one that holds both views goes there",
        )
    left_settings, right_settings = by_side(settings)
    if is_live(left):
        reading.require_none(left)
        clock = SystemClock()
        origin_s = clock.now_s()
        return LivePairs(
            open_source(left, colour=colour, clock=clock, origin_s=origin_s, settings=left_settings),
            open_source(right, colour=colour, clock=clock, origin_s=origin_s, settings=right_settings),
            max_skew_s=max_skew_s,
        )
    return FilePairs(
        open_source(left, colour=colour, fps=fps, times_s=times_s, settings=left_settings, reading=reading),
        open_source(right, colour=colour, fps=fps, times_s=times_s, settings=right_settings, reading=reading),
    )


def open_split(
    image: str,
    left_size: tuple[int, int],
    right_size: tuple[int, int],
    *,
    colour: bool = False,
    fps: float | None = None,
    times_s: Sequence[float] | None = None,
) -> PairSource:
    """Return the pairs in a source whose images hold both views side by side, each of the given (width, height)."""
    return SplitImages(open_source(image, colour=colour, fps=fps, times_s=times_s), left_size, right_size)


def _driver(text: str) -> tuple[str, str]:
    if text.isdecimal() or text.startswith("/"):
        return DEFAULT_CAMERA, text
    driver, _, device = text.partition(":")
    return driver, device


def _asked(make: Any, settings: CameraSettings, text: str) -> dict[str, CameraSettings]:
    """Return the driver's argument for the settings; none where nothing is asked, so that simple drivers need none."""
    if settings == AUTOMATIC:
        return {}
    parameters = signature(make).parameters
    if "settings" not in parameters and all(one.kind is not Parameter.VAR_KEYWORD for one in parameters.values()):
        settings.require_only((), text)
    return {"settings": settings}
