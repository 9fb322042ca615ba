"""A board in images of one camera or two, the calibration that it gives, and where its report goes."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from itertools import islice
from pathlib import Path
from typing import NamedTuple, cast

from armsight.calibrate import cameras as solvers
from armsight.calibrate.camera_noise.photon_transfer import NoiseResult
from armsight.calibrate.cameras import BoardOptions, CameraCalibration, StereoCalibration
from armsight.calibrate.cameras.result import as_setting
from armsight.calibrate.cameras.zoom import settings_of
from armsight.drivers import AUTOMATIC, CameraSettings, FrameSource, ImageReading, MomentSource, is_live
from armsight.errors import Cancelled, Inconsistent, NotEnoughData
from armsight.ops.calibration.board_images import Seen, count_again, in_parallel, require_counts, see_board
from armsight.ops.calibration.board_pictures import BoardPictures
from armsight.ops.calibration.camera_noise import find_noise, require_size
from armsight.ops.sources.cameras import open_rig
from armsight.ops.sources.frames import open_source
from armsight.optics import SIDES
from armsight.records import BoardView, Frame, NoiseModel, NotSeen, Progress, Silent, Target
from armsight.records.result_parts import RejectedFile
from armsight.store.targets import board_text
from armsight.store.zoom import with_setting

Moment = Frame | tuple[Frame, Frame]
"""An image of one camera, or those of two."""
Moments = FrameSource | MomentSource | Sequence[Moment]


class FoundBoards(NamedTuple):
    """The board's views of each moment in which all cameras see it, what was left out, and how many were read.

    source: what the images were called.
    """

    views: list[tuple[BoardView, ...]]
    rejected: list[RejectedFile]
    n: int
    source: str


def open_images(
    *images: str | Sequence[Frame],
    settings: CameraSettings,
    bits: int | None = None,
    strict: bool = True,
    colour: bool = False,
) -> AbstractContextManager[Moments]:
    """Return the images of one camera, or of two in pairs, of a source's text or in memory, not yet open.

    colour: of one camera alone. Raises UsageError, Inconsistent where there are not as many left as right ones.
    """
    reading = ImageReading(bits=bits, strict=strict)
    first, *others = images
    if not others:
        if isinstance(first, str):
            return open_source(first, colour=colour, settings=settings, reading=reading)
        return nullcontext(first)
    if isinstance(first, str) and isinstance(others[0], str):
        return open_rig(SIDES, first, others[0], settings=settings, reading=reading)
    ready = [_in_memory(one, settings, reading) for one in images]
    if len(ready[0]) != len(ready[1]):
        raise Inconsistent(
            f"{len(ready[0])} left images and {len(ready[1])} right images",
            consequence="Nobody knows which belong together",
            cure="Give one left and one right image of each moment, in the same order",
        )
    return nullcontext(list(zip(*ready, strict=True)))


def _in_memory(images: str | Sequence[Frame], settings: CameraSettings, reading: ImageReading) -> Sequence[Frame]:
    if not isinstance(images, str):
        return images
    with open_source(images, settings=settings, reading=reading) as source:
        return list(source)


def count(moments: Moments) -> int | None:
    """Return how many there are; None where that cannot be known."""
    return len(moments) if isinstance(moments, Sequence) else moments.total


def find_boards(
    moments: Moments,
    board: Target,
    pictures: BoardPictures,
    progress: Progress | None,
    detector: str,
    every: int,
    limit: int | None,
    workers: int | None,
) -> FoundBoards:
    """Return the board in every n-th moment, so many at most; pictures: keeps where it is.

    Raises NotEnoughData where it is in no image, Inconsistent where most show a board of another size, Cancelled.
    """
    progress, each = progress or Silent(), list[Seen]()
    found = FoundBoards([], [], 0, getattr(moments, "name", "the images"))
    stop = None if limit is None else limit * every
    known = count(moments)
    total = limit or 0 if known is None else -(-min(known, stop or known) // every)

    def see(moment: Moment) -> list[tuple[Frame, Seen]]:
        frames = (moment,) if isinstance(moment, Frame) else moment
        return [(frame, see_board(frame, board, detector, pictures)) for frame in frames]

    chosen = islice(cast(Iterable[Moment], moments), 0, stop, every)
    for n, both in enumerate(in_parallel(see, chosen, workers=workers), 1):
        each += [seen for _, seen in both]
        found.rejected.extend(RejectedFile(one.source, seen.why) for one, seen in both if isinstance(seen, NotSeen))
        views = tuple(seen for _, seen in both if isinstance(seen, BoardView))
        found.views.extend([views] if len(views) == len(both) else [])
        found = found._replace(n=n)
        progress.update(n, total, "finding the board")
        if progress.cancelled():
            raise Cancelled(f"stopped after {n} images", consequence="Nothing was written")
    require_counts(each, board, board_text(board))
    if found.rejected and not found.views:
        file, why = found.rejected[0]
        raise NotEnoughData(
            f"the board {board_text(board)} was found in none of the images; in the first, {file}: {why}",
            consequence="Nothing was calibrated",
            cure=count_again(board),
        )
    return found


def noise_of(
    given: NoiseModel | str | None, settings: CameraSettings, progress: Progress | None
) -> NoiseResult | NoiseModel | None:
    """Return a camera's noise, or what still frames or a file tell of it; settings: of live cameras."""
    if not isinstance(given, str):
        return given
    asked = settings if is_live(given) else AUTOMATIC  # still frames may be files beside a live camera
    return find_noise(given, settings=asked, progress=progress)


def solved_camera(
    seen: FoundBoards,
    board: Target,
    options: BoardOptions,
    progress: Progress | None,
    noise: NoiseResult | NoiseModel | None,
) -> CameraCalibration:
    """Return the camera that saw the board, with its noise. Raises Inconsistent for noise of another size, and as
    calibrate_camera."""
    views = [view for (view,) in seen.views]
    if isinstance(noise, NoiseResult) and views:
        require_size(noise, (views[0].width, views[0].height), seen.source)
    if progress is not None:
        progress.update(0, 0, "solving")
    done = solvers.calibrate_camera(views, board, options, progress)
    known = noise.noise if isinstance(noise, NoiseResult) else noise
    return replace(done, rejected=(*seen.rejected, *done.rejected), noise=known)


def solved_pair(
    seen: FoundBoards, board: Target, options: BoardOptions, progress: Progress | None
) -> StereoCalibration:
    """Return the rig whose cameras saw the board; raises as calibrate_stereo."""
    if progress is not None:
        progress.update(0, 0, "solving")
    sides = [left for left, _ in seen.views], [right for _, right in seen.views]
    done = solvers.calibrate_stereo(*sides, board, options, progress)
    return replace(done, n_pairs=seen.n, rejected=(*seen.rejected, *done.rejected))


def with_zoom(
    done: CameraCalibration, zoom: float, pupil_m: float | None, pupil_std_m: float, out: Path | None
) -> CameraCalibration:
    """Return the calibration as a setting of the zoom lens that the file `out` holds, if there is one."""
    setting = as_setting(done, zoom, pupil_m, pupil_std_m)
    lens = with_setting(out, setting).lens
    return replace(done, setting=setting, zoom=settings_of(lens, setting.zoom))
