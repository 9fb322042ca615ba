"""Which source is which camera's of a rig, as `--camera NAME=SRC` and Python's `cameras` say it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

from armsight import drivers
from armsight._files import real_path
from armsight.drivers import (
    AS_THEY_ARE,
    AUTOMATIC,
    CAMERA,
    MAX_SKEW_S,
    CameraSettings,
    FrameSource,
    ImageReading,
    Moments,
    PairSettings,
    RecordedMoments,
    VideoFile,
    frame_period_s,
    is_live,
    is_video,
)
from armsight.errors import UsageError
from armsight.ops.sources.frames import camera_source, is_recording, require_as_recorded
from armsight.optics import MOST_CAMERAS, SIDES, Rig, require_camera_name
from armsight.store.bags import is_bag

S = TypeVar("S")

VIDEO = "/dev/video"

KINDS = (is_recording, is_bag, is_live, bool)
"""What tells sources apart whose times are of different clocks; the last is of files."""


def named_cameras(cameras: Mapping[str, str], left: str | None = None, right: str | None = None) -> dict[str, str]:
    """Return the sources by their camera's name; left and right are short for cameras of these names.

    Raises UsageError for a camera that is given twice, two of one source and more than a rig has, Inconsistent for what
    is no name.
    """
    short = {side: text for side, text in zip(SIDES, (left, right), strict=True) if text is not None}
    for name in cameras:
        require_camera_name(name)
        if name in short:
            raise UsageError(
                f"the camera {name} is given twice, {short[name]} and {cameras[name]}",
                consequence="It is open which are its frames",
                cure=f"Leave --{name} or --camera {name}= away",
            )
    given = short | dict(cameras)
    if len(given) > MOST_CAMERAS:
        raise UsageError(
            f"{len(given)} cameras are given",
            consequence="Nothing was opened",
            cure=f"A rig has one to {MOST_CAMERAS}: leave those away that see least",
        )
    require_own_sources(given)
    return given


def require_own_sources(given: Mapping[str, str]) -> None:
    """Raise UsageError for one source by two names, but a recording, which has one for each."""
    of: dict[str, str] = {}
    for name, text in given.items():
        same = of.setdefault(_device(text), name)
        if same != name and not is_whole_recording(text):
            both = text if given[same] == text else f"{text}, as {given[same]} is"
            raise UsageError(
                f"{same} and {name} are both {both}",
                consequence="The same image twice has no depth",
                cure="Give each camera's own source; where a command has --image, one that holds both views goes there",
            )


def require_watching(sources: Iterable[str], what: str) -> None:
    """Raise UsageError for sources that are no live cameras: they do not see what moves."""
    for text in sources:
        if not is_live(text) or text.startswith(f"{CAMERA}sim:"):
            raise UsageError(
                f"{text} does not see {what} now",
                consequence="Nothing is moved",
                cure="Give live cameras, such as --left camera:0 --right camera:2, or --camera top=camera:4",
            )


def _device(text: str) -> str:
    """Return a source's text; of a live camera with OpenCV's number as the file it stands for, links followed."""
    if not is_live(text):
        return text
    name = text.removeprefix(CAMERA).removeprefix("opencv:")
    if name.isdecimal():
        name = f"{VIDEO}{int(name)}"
    return str(real_path(Path(name))) if name.startswith("/") else text


def is_whole_recording(text: str) -> bool:
    """Tell whether a source's text names a recording without one of its cameras."""
    return is_recording(text) and text.lower().endswith(".mcap")


def cameras_of(names: Sequence[str], given: Mapping[str, str]) -> dict[str, str]:
    """Return the sources in the order of a rig's cameras; one recording alone is of them all.

    Raises UsageError for others than the rig has, and where one is missing.
    """
    if len(given) == 1 and is_whole_recording(alone := next(iter(given.values()))):
        return dict.fromkeys(names, alone)
    unknown = [name for name in given if name not in names]
    if unknown:
        raise UsageError(
            f"frames are given of {', '.join(unknown)}, and the rig's cameras are {', '.join(names)}",
            consequence="Where these cameras stand is not known",
            cure="Name each as in the rig's file, or give the rig.yaml that has them",
        )
    missing = [name for name in names if name not in given]
    if missing:
        raise UsageError(
            f"no frames are given of the rig's {'camera' if len(missing) == 1 else 'cameras'} {', '.join(missing)}",
            consequence="Nothing was opened",
            cure=f"Add {' '.join(map(_flag, missing))}; or give one recording that has all",
        )
    return {name: given[name] for name in names}


def _flag(name: str) -> str:
    return f"--{name} SRC" if name in SIDES else f"--camera {name}=SRC"


def _kind_of(texts: Sequence[str]) -> Callable[[str], bool]:
    """Return what tells the kind of all sources. Raises UsageError for sources of unlike kinds."""
    kinds = [next(kind for kind in KINDS if kind(text)) for text in texts]
    other = next((text for text, one in zip(texts, kinds, strict=True) if one is not kinds[0]), None)
    if other is not None:
        raise UsageError(
            f"{texts[0]} and {other} cannot be put together: one is live, recorded or of a bag, the other is not",
            consequence="Their times are of different clocks",
            cure="Give sources of one kind",
        )
    return kinds[0]


def open_rig(
    names: Sequence[str],
    left: str | None = None,
    right: str | None = None,
    cameras: Mapping[str, str] = MappingProxyType({}),
    **more: Any,
) -> Moments:
    """Return the moments of a rig's cameras, as named_cameras, cameras_of and open_cameras have them."""
    return open_cameras(cameras_of(names, named_cameras(cameras, left, right)), **more)


def told_apart(source: S, rig: Rig) -> S:
    """Return a source of a rig that tells where frames of a moment are apart, and the rig's file has no timing."""
    if isinstance(source, Moments):
        source.untimed = not any(rig.timing)
    return source


def told_later(message: str) -> None:
    """Leave it to who takes the moments to tell what a source has to tell: news_of."""


def open_cameras(
    cameras: Mapping[str, str],
    *,
    colour: bool = False,
    fps: float | None = None,
    times_s: Sequence[float] | None = None,
    max_skew_s: float = MAX_SKEW_S,
    settings: PairSettings | Mapping[str, CameraSettings] = AUTOMATIC,
    reading: ImageReading = AS_THEY_ARE,
    tell: Callable[[str], None] = warnings.warn,
) -> Moments:
    """Return the moments of cameras' sources, in their order; nothing is opened yet.

    Recordings, bags and videos that bring their times are put together by these, folders by position, live cameras by
    their stamps. A recording that names no camera gives each its own. settings: of all live cameras, in their order, or
    by name. Raises UsageError for sources of unlike kinds.
    """
    if not isinstance(settings, Mapping):
        each = settings if isinstance(settings, tuple) else (settings,) * len(cameras)
        settings = dict(zip(cameras, each, strict=True))
    texts, names = list(cameras.values()), tuple(cameras)
    first, kind = texts[0], _kind_of(texts)
    videos = fps is None and times_s is None and len(texts) > 1 and all(map(is_video, texts))
    if kind in (is_live, bool) and not videos:
        return drivers.open_moments(
            cameras,
            colour=colour,
            fps=fps,
            times_s=times_s,
            max_skew_s=max_skew_s,
            settings=settings,
            reading=reading,
            tell=tell,
        )
    for name, text in cameras.items():
        reading.require_none(text)
        require_as_recorded(text, fps, times_s, settings.get(name, AUTOMATIC))
    sources: list[FrameSource]
    if videos:
        max_skew_s = min(max_skew_s, *(0.5 * frame_period_s(text) for text in texts))
        sources = [VideoFile(text, colour=colour) for text in texts]
    else:
        zero = {text: None if text == first else first for text in texts}
        sources = [camera_source(text, name, colour=colour, origin_of=zero[text]) for name, text in cameras.items()]
    return RecordedMoments(*sources, names=names, max_skew_s=max_skew_s, end_together=videos, tell=tell)
