"""When the images of a folder were exposed: by a table that was given, by the one beside them, or assumed."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from armsight._files import real_path
from armsight.drivers import FPS, list_images
from armsight.store import read_times

TIMES = "times.csv"


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
