"""Frames from files: a folder or pattern of images, or a video."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import closing
from itertools import chain, islice
from pathlib import Path
from typing import Any, Protocol, Self

import cv2
import numpy as np
from numpy.typing import NDArray

from armsight._files import is_utf8
from armsight.drivers.ahead import Ahead, FileSource, cores
from armsight.drivers.images import AS_THEY_ARE, ImageReading, image_of_8_bits, list_images, read_pixels
from armsight.errors import BadFile, BadImage, DataRefused, Inconsistent
from armsight.records import Frame

FPS = 30.0
"""Frames a second where neither time stamps nor a rate are given."""

VIDEO_SUFFIXES = (".avi", ".mp4", ".mkv", ".mov", ".m4v", ".webm", ".mjpeg", ".mjpg", ".mpg", ".mpeg", ".wmv")

HEADER_TOLERANCE = 0.02
"""A video's header counts frames from duration and rate, so it is off by a frame or a percent; beyond this the file
is taken as broken off."""


FIRST = 5
"""Frames that tell whether a video has time stamps at all: some begin with two alike."""


class Capture(Protocol):
    """The part of cv2.VideoCapture that is used, so that tests can put their own in its place."""

    def isOpened(self) -> bool:
        """Tell whether it can be read."""

    def read(self) -> tuple[bool, Any]:
        """Return (True, image) or (False, None)."""

    def get(self, key: int, /) -> float:
        """Return a property."""

    def set(self, key: int, value: float, /) -> bool:
        """Set a property; False where the driver says that it cannot."""

    def release(self) -> None:
        """Close it."""


def open_video(path: str) -> Capture:
    """Open a video file with OpenCV. Raises BadFile for a name that it crashes at."""
    if not is_utf8(path):
        raise BadFile(
            f"the name of the video {path} is not UTF-8",
            consequence="OpenCV cannot open it",
            cure="Rename it, and the folders that it is in",
        )
    # two views share the cores; pictures that a decoder has on its way beyond that cost memory, and save no time
    capture: Capture = cv2.VideoCapture(path, cv2.CAP_ANY, [cv2.CAP_PROP_N_THREADS, max(1, cores() // 2)])
    if not capture.isOpened():
        capture = cv2.VideoCapture(path)  # readers beside FFmpeg refuse what they do not know
    # a camera is calibrated as its sensor sees, and OpenCV turns by what the file says of the player's screen
    capture.set(cv2.CAP_PROP_ORIENTATION_AUTO, 0)
    return capture


def frame_period_s(path: str) -> float:
    """Return the time from frame to frame that a video's header states, FPS' where it states none. Raises BadFile."""
    capture = open_video(path)
    rate = capture.get(cv2.CAP_PROP_FPS)
    capture.release()
    return 1.0 / (rate if np.isfinite(rate) and rate > 0.0 else FPS)


class ImageFolder(FileSource):
    """The images of a folder or pattern, decoded ahead in threads.

    times_s: the time of each, else index / fps. reading: which files and bits are meant, and what becomes of a file
    that cannot be read. Raises Inconsistent on opening where the times are not as many as the images, and at the first
    image of another size than the first one's.
    """

    def __init__(
        self,
        text: str,
        *,
        colour: bool = False,
        fps: float = FPS,
        times_s: Sequence[float] | None = None,
        reading: ImageReading = AS_THEY_ARE,
    ) -> None:
        super().__init__(text)
        self._reading = reading
        self._colour = colour
        self._fps = fps
        self._times_s = times_s
        self._paths: tuple[Path, ...] = ()
        self.moments: Sequence[int] = ()
        """Which moment each image is of, where some have none: without given times these tell the time."""

    @property
    def paths(self) -> tuple[Path, ...]:
        """The files in order; empty before it is opened."""
        return self._paths

    @property
    def total(self) -> int | None:
        """How many images there are; None before it is opened."""
        return len(self._paths) or None

    def __enter__(self) -> Self:
        only = self._reading.only
        self._paths = tuple(path for path in list_images(self.name) if only is None or path.name in only)
        if self._times_s is not None and len(self._times_s) != len(self._paths):
            raise wrong_times(self._times_s, self.name, len(self._paths))
        return self

    def stamps_s(self) -> Iterator[float]:
        """Yield the images' times."""
        return map(self._time_s, range(len(self._paths)))

    def _close(self) -> None:
        pass

    def _frames(self) -> Iterator[Frame]:
        shape: tuple[int, ...] | None = None
        with closing(Ahead(self._read, self._paths)) as images:  # on all cores
            for sequence, (path, image) in enumerate(zip(self._paths, images, strict=True)):
                if isinstance(image, DataRefused):
                    shape = shape or self._first_shape(image)
                    yield Frame(
                        image=np.zeros(shape, np.uint8),
                        t_s=self._time_s(sequence),
                        sequence=sequence,
                        source=str(path),
                        unreadable=image.cause.removeprefix(f"{path} "),
                    )
                    continue
                shape = shape or image.shape
                if image.shape != shape:
                    raise Inconsistent(
                        f"{path} is {size_text(image.shape)} px, {self._paths[0]} is {size_text(shape)} px",
                        consequence="Images of one camera must all be of one size, so reading stops here",
                        cure="Give each camera a folder of its own, without cropped or scaled images",
                    )
                yield Frame(image=image, t_s=self._time_s(sequence), sequence=sequence, source=str(path))

    def _time_s(self, sequence: int) -> float:
        if self._times_s is not None:
            return float(self._times_s[sequence])
        return (self.moments[sequence] if self.moments else sequence) / self._fps

    def _read(self, path: Path) -> NDArray[np.uint8] | DataRefused:
        try:
            pixels = read_pixels(path, colour=self._colour)
        except (BadFile, BadImage) as error:
            if self._reading.strict:
                raise
            return error
        return image_of_8_bits(pixels, self._reading.bits, str(path))

    def _first_shape(self, error: DataRefused) -> tuple[int, ...]:
        for path in self._paths:
            image = self._read(path)
            if not isinstance(image, DataRefused):
                return image.shape
        raise error


class VideoFile(FileSource):
    """The frames of a video file, decoded ahead in a thread of its own.

    Time stamps are times_s where given, else the file's where it has any, else index / fps (the file's rate, or the
    given one). A frame whose stamp does not increase has no time, and comes as one that cannot be read. Raises BadImage
    where the file breaks off before the length its header states.
    """

    def __init__(
        self,
        text: str,
        *,
        colour: bool = False,
        fps: float | None = None,
        times_s: Sequence[float] | None = None,
        open_capture: Callable[[str], Capture] = open_video,
    ) -> None:
        super().__init__(text)
        self._colour = colour
        self._fps = fps
        self._times_s = times_s
        self._open_capture = open_capture
        self._capture: Capture | None = None
        self._said, self._read = 0, False

    @property
    def total(self) -> int | None:
        """The number of times given, else the count in the file's header, if any: an estimate."""
        return len(self._times_s) if self._times_s is not None else self._said or None

    def __enter__(self) -> Self:
        if not Path(self.name).is_file():
            raise BadFile(f"there is no file {self.name}", consequence="There are no frames", cure="Check the path")
        self._capture = self._open_capture(self.name)
        if not self._capture.isOpened():
            self._capture = None
            raise BadFile(
                f"{self.name} cannot be opened as a video",
                consequence="There are no frames",
                cure="Check that it plays; a file cut off while recording lacks its index (ffmpeg can rebuild it)",
            )
        self._read = False
        count = self._capture.get(cv2.CAP_PROP_FRAME_COUNT)
        self._said = int(count) if np.isfinite(count) and 0 < count < 1e9 else 0
        return self

    def _close(self) -> None:
        if self._capture is not None:
            self._capture.release()
            self._capture = None

    def _frames(self) -> Iterator[Frame]:
        capture = self._capture
        if capture is None:
            return
        if self._read:  # read anew
            capture.set(cv2.CAP_PROP_POS_FRAMES, 0.0)
        self._read = True
        rate = capture.get(cv2.CAP_PROP_FPS)
        rate = rate if np.isfinite(rate) and rate > 0.0 else FPS
        fps = self._fps or rate
        # made grey in a thread of its own: the larger of two views' pictures would hold up both
        with closing(Ahead(self._convert, _stamped_images(capture, rate), workers=1, ahead=1)) as read:
            first = list(islice(read, FIRST))
            stamps = [stamp_s for stamp_s, _ in first]
            stamped = self._fps is None and self._times_s is None and stamps[-1:] > stamps[:1]
            sequence, last_s, end_s, images = 0, -np.inf, 0.0, chain(first, read)
            del first
            for stamp_s, image in images:
                why, end_s = "", max(end_s, stamp_s, 0.0 if stamps[-1:] > stamps[:1] else sequence / rate)
                if stamped and stamp_s <= last_s:
                    why = f"its time stamp of {stamp_s:.6f} s is none: the frame before it has {last_s:.6f} s"
                    stamp_s = float(np.nextafter(last_s, np.inf))
                last_s = stamp_s
                t_s = self._time_s(sequence, stamp_s if stamped else sequence / fps)
                yield Frame(image=image, t_s=t_s, sequence=sequence, source=f"{self.name}:{sequence}", unreadable=why)
                sequence += 1
        self._check_end(sequence, end_s, self._said / rate)

    def _time_s(self, sequence: int, else_s: float) -> float:
        if self._times_s is None:
            return else_s
        if sequence >= len(self._times_s):
            raise wrong_times(self._times_s, self.name, sequence + 1)
        return float(self._times_s[sequence])

    def _convert(self, seen: tuple[float, NDArray[np.uint8]]) -> tuple[float, NDArray[np.uint8]]:
        stamp_s, image = seen
        if image.ndim == 3 and not self._colour:
            image = np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2GRAY), dtype=np.uint8)
        if image.ndim == 2 and self._colour:
            image = np.asarray(cv2.cvtColor(image, cv2.COLOR_GRAY2BGR), dtype=np.uint8)
        return stamp_s, image

    def _check_end(self, count: int, last_s: float, length_s: float) -> None:
        if self._times_s is not None and count < len(self._times_s):
            raise wrong_times(self._times_s, self.name, count)
        # of a rate that varies the header's count is the length times a mean rate: what is missing is missing in time
        tolerance = max(2.0, HEADER_TOLERANCE * self._said)
        if count < self._said - tolerance and last_s < length_s * (1.0 - tolerance / self._said):
            raise BadImage(
                f"the video {self.name} ends after {count} frames, its header states {self._said}",
                consequence="The frames behind that are lost; those before it were read",
                cure="Copy the file again from where it was recorded",
            )


def _stamped_images(capture: Capture, fps: float) -> Iterator[tuple[float, NDArray[np.uint8]]]:
    """Yield the images of a video with their stamps in s, on the container's own clock.

    OpenCV counts milliseconds from the first frame, and tells where that stands in frames (from 4.11 on).
    """
    began_s = None
    while True:
        good, image = capture.read()
        if not good or image is None:
            return
        if began_s is None:
            first = capture.get(getattr(cv2, "CAP_PROP_PTS", -1))
            began_s = first / fps if np.isfinite(first) and first > 0.0 else 0.0
        yield began_s + capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3, image


def wrong_times(times_s: Sequence[float], name: str, count: int) -> Inconsistent:
    """Return the error for a list of times that does not belong to the frames."""
    return Inconsistent(
        f"{len(times_s)} time stamps are given, {name} has {count} frames",
        consequence="Nobody can say which time belongs to which frame",
        cure="Give one time per frame, in the order of the sorted files",
    )


def size_text(shape: Sequence[int]) -> str:
    """Return 'WIDTHxHEIGHT' of an image's shape."""
    return f"{shape[1]}x{shape[0]}"
