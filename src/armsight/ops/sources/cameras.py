"""Which source is which camera's of a rig, as `--camera NAME=SRC` and Python's `cameras` say it."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

from armsight import drivers
from armsight.drivers import (
    AS_THEY_ARE,
    AUTOMATIC,
    MAX_SKEW_S,
    CameraSettings,
    FrameSource,
    ImageReading,
    Moments,
    RecordedMoments,
    VideoFile,
    frame_period_s,
    is_live,
    is_video,
)
from armsight.errors import UsageError
from armsight.ops.sources.bags import BagFrames
from armsight.ops.sources.frames import RecordedFrames, is_recording, require_as_recorded
from armsight.optics import MOST_CAMERAS, SIDES, require_camera_name
from armsight.store.bags import is_bag

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
    of: dict[str, str] = {}
    for name, text in given.items():
        if text in of and not (is_recording(text) and text.lower().endswith(".mcap")):
            raise UsageError(
                f"{of[text]} and {name} are both {text}",
                consequence="The same image twice has no depth",
                cure="Give each camera's own source",
            )
        of[text] = name
    return given


def cameras_of(names: Sequence[str], given: Mapping[str, str]) -> dict[str, str]:
    """Return the sources in the order of a rig's cameras. Raises UsageError for others than it has."""
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
            cure=f"Add {' '.join(f'--camera {name}=SRC' for name in missing)}",
        )
    return {name: given[name] for name in names}


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


def open_cameras(
    cameras: Mapping[str, str],
    *,
    colour: bool = False,
    fps: float | None = None,
    times_s: Sequence[float] | None = None,
    max_skew_s: float = MAX_SKEW_S,
    settings: Mapping[str, CameraSettings] | None = None,
    reading: ImageReading = AS_THEY_ARE,
) -> Moments:
    """Return the moments of cameras' sources, in their order; nothing is opened yet.

    Recordings, bags and videos that bring their times are put together by these, folders by position, live cameras by
    their stamps. A recording that names no camera gives each its own. Raises UsageError for sources of unlike kinds.
    """
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
            settings=settings or {},
            reading=reading,
        )
    for name, text in cameras.items():
        reading.require_none(text)
        require_as_recorded(text, fps, times_s, (settings or {}).get(name, AUTOMATIC))
    sources: list[FrameSource]
    if videos:
        max_skew_s = min(max_skew_s, *(0.5 * frame_period_s(text) for text in texts))
        sources = [VideoFile(text, colour=colour) for text in texts]
    elif kind is is_bag:
        sources = [BagFrames(text, colour=colour, origin_of=None if text == first else first) for text in texts]
    else:
        sources = [RecordedFrames(text, name, colour=colour) for name, text in cameras.items()]
    return RecordedMoments(*sources, names=names, max_skew_s=max_skew_s, end_together=videos)
