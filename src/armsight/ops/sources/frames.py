"""Recordings and bags as sources of frames, beside folders, videos and cameras.

A source's text may be REC.mcap, or REC.mcap:CAMERA for one of its cameras. As a camera's source the recording's camera
of this name is meant; one recording alone gives all cameras. Or it is bag:FILE:/topic for a topic of a ROS bag.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Self

import cv2
import numpy as np

from armsight import drivers
from armsight._files import real_path
from armsight.clock import Clock
from armsight.drivers import (
    AS_THEY_ARE,
    AUTOMATIC,
    FPS,
    CameraSettings,
    FileSource,
    FrameSource,
    ImageReading,
    Moments,
    OneImage,
    list_images,
)
from armsight.errors import Inconsistent, UsageError
from armsight.ops.sources.bags import BagFrames
from armsight.optics import Rig, RigKind
from armsight.records import Frame
from armsight.store import read_times
from armsight.store.bags import is_bag

if TYPE_CHECKING:
    from armsight.store.recording import Recording

TIMES = "times.csv"
SOURCE = re.compile(r"(.+\.mcap)(?::([\w-]+))?", re.IGNORECASE | re.DOTALL)
"""REC.mcap or REC.mcap:CAMERA."""


def recordings_in(*sources: str | None) -> tuple[str, ...]:
    """Return the recordings that sources name, each once."""
    found = [SOURCE.fullmatch(source) for source in sources if source]
    return tuple(dict.fromkeys(match[1] for match in found if match))


def is_recording(text: str) -> bool:
    """Tell whether a source's text names a recording."""
    return SOURCE.fullmatch(text) is not None


def recording_path(text: str) -> Path:
    """Return the file of a recording's text, without its camera."""
    match = SOURCE.fullmatch(text)
    return Path(match[1] if match else text)


class RecordedFrames(FileSource):
    """The frames of one camera of a recording, with the times and numbers they were recorded with.

    camera: which one where the text does not say it; None: the only one. colour: None leaves it as it is. Opening
    raises BadFile, and Inconsistent where it is open which camera is meant.
    """

    def __init__(self, text: str, camera: str | None = None, *, colour: bool | None = False) -> None:
        super().__init__(text)
        match = SOURCE.fullmatch(text)
        self._camera = (match[2] if match else None) or camera
        self._colour = colour
        self._recording: Recording | None = None

    @property
    def total(self) -> int | None:
        """How many frames there are; None before it is opened."""
        return self._recording.count(f"/{self._camera}/image") if self._recording and self._camera else None

    def __enter__(self) -> Self:
        from armsight.store.recording import Recording  # here, as every measurement imports this

        recording = Recording(recording_path(self.name))
        if self._camera is None:
            if len(recording.cameras) > 1:
                recording.close()
                raise Inconsistent(
                    f"{self.name} holds frames of the cameras {', '.join(recording.cameras)}",
                    consequence="It is open which are meant",
                    cure=f"Write {self.name}:{recording.cameras[0]}",
                )
            self._camera = recording.cameras[0] if recording.cameras else "image"
        self._recording = recording
        return self

    def stamps_s(self) -> Iterator[float]:
        """Yield the frames' times."""
        if self._recording is None or self._camera is None:
            return iter(())
        return (t_s for t_s, *_ in self._recording.images(self._camera))

    def _close(self) -> None:
        if self._recording is not None:
            self._recording.close()
            self._recording = None

    def _frames(self) -> Iterator[Frame]:
        if self._recording is None or self._camera is None:
            return
        for frame in self._recording.frames(self._camera):
            yield _converted(frame, self._colour)


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
    """Return the source that a text names as drivers.open_source does, or one camera of a recording."""
    if is_recording(text):
        require_as_recorded(text, fps, times_s, settings)
        reading.require_none(text)
        return RecordedFrames(text, colour=colour)
    if is_bag(text):
        require_as_recorded(text, fps, times_s, settings)
        reading.require_none(text)
        return BagFrames(text, colour=colour)
    return drivers.open_source(
        text,
        colour=colour,
        fps=fps,
        times_s=times_s,
        clock=clock,
        origin_s=origin_s,
        settings=settings,
        reading=reading,
    )


def camera_source(
    text: str,
    side: str,
    *,
    colour: bool = False,
    fps: float | None = None,
    origin_of: str | None = None,
    origin_s: float | None = None,
    settings: CameraSettings = AUTOMATIC,
) -> FrameSource:
    """Return the frames of the camera on one side; of a recording that names no camera, of the one on this side.

    origin_of: the left camera's text, whose bag's start is t_s = 0. origin_s, settings: of live cameras.
    """
    if is_recording(text):
        settings.require_none(text)
        return RecordedFrames(text, side if text.lower().endswith(".mcap") else None, colour=colour)
    if is_bag(text):
        settings.require_none(text)
        return BagFrames(text, colour=colour, origin_of=origin_of)
    return open_source(text, colour=colour, fps=fps, origin_s=origin_s, settings=settings)


def require_as_recorded(text: str, fps: float | None, times_s: Sequence[float] | None, asked: CameraSettings) -> None:
    """Raise UsageError where times are given for a recording or a bag, or settings for a camera in it."""
    asked.require_none(text)
    if fps is not None or times_s is not None:
        raise UsageError(f"{text} brings its own times", cure="Leave --times and --fps away")


def _converted(frame: Frame, colour: bool | None) -> Frame:
    if colour is None or (frame.image.ndim == 3) == colour:
        return frame
    code = cv2.COLOR_GRAY2BGR if colour else cv2.COLOR_BGR2GRAY
    return Frame(
        image=np.asarray(cv2.cvtColor(frame.image, code), dtype=np.uint8),
        t_s=frame.t_s,
        sequence=frame.sequence,
        source=frame.source,
        exposure_s=frame.exposure_s,
    )


def complex_pairs(open_images: Callable[[], FrameSource], rig: Rig) -> tuple[Moments, bool]:
    """Return the pairs in complex images, not yet open, and whether both views lie one upon the other in them.

    With a mirror rig they always do. With two cameras the first image's size tells: that of one camera, or that of both
    side by side. Raises Inconsistent for any other size.
    """
    if rig.kind is RigKind.MIRROR:
        return OneImage(open_images()), True
    left, right = ((camera.width, camera.height) for camera in (rig.left, rig.right))
    with open_images() as frames:
        first = next(iter(frames), None)
    if first is not None and left == right == (first.width, first.height):
        return OneImage(open_images()), True
    if first is not None:
        _require_both(first, left, right)
    return OneImage(open_images(), left, right), False


def _require_both(frame: Frame, left: tuple[int, int], right: tuple[int, int]) -> None:
    width = left[0] + right[0]
    if (frame.width, frame.height) == (width, left[1]) and left[1] == right[1]:
        return
    one = f"{left[0]}x{left[1]} px with one view upon the other, or " if left == right else ""
    raise Inconsistent(
        f"{frame.source} is {frame.width}x{frame.height} px; an image of both views of this rig is {one}"
        f"{width}x{max(left[1], right[1])} px with the views side by side",
        consequence="The image cannot be taken for its two views",
        cure="Give the rig that was calibrated with this camera at this resolution",
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameTimes:
    """times_s: of each image, or none. assumed_fps: frames a second where nothing tells. told: in a few words."""

    times_s: list[float] | None = None
    assumed_fps: float | None = None
    source: str = ""


def frame_times(source: str | None, given: Path | None, fps: float | None) -> FrameTimes:
    """Return the times of a source's frames; given: the table that the person named, fps: the rate.

    Without either, a folder's images have the times of a times.csv in the folder, or of one beside it with as many
    rows as there are images; else their rate is assumed. Sources that bring their own times keep them. Raises BadFile.
    """
    if given is not None:
        return FrameTimes(times_s=read_times(given).tolist(), source=str(given))
    if fps is not None:
        return FrameTimes(source=f"{fps:g} frames a second, as given")
    folder = None if source is None else Path(source)
    if folder is None or not folder.is_dir():
        return FrameTimes()
    if (folder / TIMES).is_file():
        return FrameTimes(times_s=read_times(folder / TIMES).tolist(), source=str(folder / TIMES))
    beside = real_path(folder).parent / TIMES
    if beside.is_file():
        times_s = read_times(beside).tolist()
        if len(times_s) == len(list_images(str(folder))):
            return FrameTimes(times_s=times_s, source=str(beside))
    return FrameTimes(assumed_fps=FPS, source=f"assumed, {FPS:g} frames a second")
