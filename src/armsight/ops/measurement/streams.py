"""Where the frames of a measurement are: as pairs, or each camera's frames or spots with stamps freed of jitter."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import islice
from pathlib import Path

import numpy as np

from armsight.arrays import Array
from armsight.drivers import (
    AS_THEY_ARE,
    AUTOMATIC,
    MAX_SKEW_S,
    CameraSettings,
    FileSource,
    ImageReading,
    MomentSource,
    PairSettings,
    by_side,
    is_live,
)
from armsight.errors import Inconsistent, UsageError
from armsight.measure.begin import AnyFrame, SpotFrame
from armsight.ops.sources.cameras import open_cameras, open_rig, told_apart
from armsight.ops.sources.frames import camera_source, complex_pairs, is_recording, open_source
from armsight.optics import SIDES, Camera, Rig, RigKind
from armsight.records import AT_ONCE, CameraTiming, Frame, Spots, SpotTrack
from armsight.store import read_spot_track


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Stream:
    """One camera's frames: their stamps in s (n,), freed of jitter, and how to read them once, in that order.

    clock_covariance: of what jitter leaves open of the offset (s) and the rate (ppm) of its clock at a stamp.
    """

    t_s: Array
    read: Callable[[], Iterator[AnyFrame]]
    clock_covariance: Callable[[float], Array]

    def first(self, n: int) -> Stream:
        """Return the stream of its first n frames."""
        return replace(self, t_s=self.t_s[:n], read=lambda: islice(self.read(), n))


TIMINGS = ("auto", "pairs", "free")


@dataclass(frozen=True, slots=True, kw_only=True)
class FrameSources:
    """The frames to measure, as they are named: left and right, images of both views, or tables of spots.

    cameras: of a rig that is no pair, by name.
    times: table of their times. fps: of folders. limit: how many. settings: asked of live cameras, or of each.
    """

    left: str | None = None
    right: str | None = None
    cameras: Mapping[str, str] = field(default_factory=dict)
    image: str | None = None
    left_spots: Path | None = None
    right_spots: Path | None = None
    times: Path | None = None
    fps: float | None = None
    limit: int | None = None
    max_skew_s: float | None = None
    settings: PairSettings = AUTOMATIC
    reading: ImageReading = AS_THEY_ARE

    @property
    def named(self) -> tuple[str, ...]:
        """All sources of images."""
        return tuple(text for text in (self.left, self.right, self.image, *self.cameras.values()) if text is not None)

    def of_rig(self, rig: Rig, times_s: list[float] | None, *, colour: bool) -> tuple[MomentSource, bool]:
        """Return the pairs of a pair of cameras, else the moments; see pairs."""
        if rig.is_pair:
            pairs, overlaid = self.pairs(rig, times_s, colour=colour)
            return told_apart(pairs, rig), overlaid
        return told_apart(self.moments(times_s, colour=colour), rig), False

    def moments(self, times_s: list[float] | None, *, colour: bool) -> MomentSource:
        """Return the moments of a rig that is no pair. Raises UsageError for what only pairs have."""
        self._require_cameras()
        return open_cameras(
            self.cameras,
            colour=colour,
            fps=self.fps,
            times_s=times_s,
            max_skew_s=MAX_SKEW_S if self.max_skew_s is None else self.max_skew_s,
            settings=dict.fromkeys(self.cameras, one_setting(self.settings)),
            reading=self.reading,
        )

    def _require_cameras(self) -> None:
        """Raise UsageError for what only pairs have."""
        pairs_only = (self.image, self.left_spots, self.right_spots)
        if any(one is not None for one in pairs_only):
            raise UsageError(
                "--image, --left-spots and --right-spots are for rigs of the cameras left and right",
                cure="Give each camera's frames: --camera NAME=SRC",
            )
        one_setting(self.settings)

    def run_free(
        self, rig: Rig, timing: str, *, stills: bool, rate_hz: float | None = None, at: Path | None = None
    ) -> bool:
        """Tell whether each view is to be taken at its own time. Raises UsageError where that cannot be."""
        if timing not in TIMINGS:
            raise UsageError(f"--timing {timing}", cure=f"Give one of {', '.join(TIMINGS)}")
        tables = self.left_spots is not None or self.right_spots is not None
        one_exposure = self.image is not None or rig.kind is RigKind.MIRROR
        apart = not (one_exposure or stills or self.times is not None)
        free = timing == "free" or (timing == "auto" and apart and (tables or rig.runs_free))
        if free and not apart:
            raise UsageError(
                "both views are one exposure"
                if one_exposure
                else "--stills and --times are for frames that belong in pairs",
                cure="Leave --timing free away",
            )
        if free:
            require_timing(rig)
        elif tables or rate_hz is not None or at is not None:
            raise UsageError(
                "--left-spots, --right-spots, --rate and --at are for cameras that run free",
                cure="Run armsight calibrate timing, and measure with the rig.yaml it writes",
            )
        if rate_hz is not None and at is not None:
            raise UsageError("--rate and --at both say at which times poses are wanted", cure="Give one of them")
        if free and self.reading.bits is not None:
            raise UsageError("--bits is for frames in pairs, and these cameras run free", cure="Give --timing pairs")
        return free

    def pairs(self, rig: Rig, times_s: list[float] | None, *, colour: bool) -> tuple[MomentSource, bool]:
        """Return the source of pairs, and whether both views are in one image, one upon the other."""
        if self.image is not None:
            if self.left is not None or self.right is not None:
                raise UsageError("--image goes with neither --left nor --right", cure="Give the one or the others")
            asked = _settings_of_one(self.settings, self.image)
            more = {"colour": colour, "fps": self.fps, "times_s": times_s, "settings": asked, "reading": self.reading}
            return complex_pairs(partial(open_source, self.image, **more), rig)  # type: ignore[arg-type]  # by name
        if rig.kind is RigKind.MIRROR and self.left is not None and self.left == self.right:
            raise UsageError(
                f"left and right are both {self.left}, and the rig has mirrors: both of its views are in one image",
                cure=f"Give --image {self.left} in place of --left and --right",
            )
        if self.left is self.right is None:
            raise UsageError(
                "there are no frames to measure", cure="Give --left and --right, one recording as --left, or --image"
            )
        pairs = open_rig(
            rig.names,
            self.left,
            self.right,
            colour=colour,
            fps=self.fps,
            times_s=times_s,
            max_skew_s=MAX_SKEW_S if self.max_skew_s is None else self.max_skew_s,
            settings=self.settings,
            reading=self.reading,
        )
        return pairs, False

    def streams(self, rig: Rig, *, colour: bool) -> tuple[Stream, ...]:
        """Return each camera's frames with its own times. Raises UsageError also for settings of no camera."""
        sources, tables = (self.left, self.right), (self.left_spots, self.right_spots)
        if not rig.is_pair:
            self._require_cameras()
        if not any(map(is_live, self.named)):
            for asked in by_side(self.settings):
                asked.require_none(self.named[0] if self.named else "a table of spots")
        if rig.is_pair:
            streams = streams_of(rig, sources, tables, colour=colour, fps=self.fps)
        else:
            streams = streams_of_cameras(self.cameras, colour=colour, fps=self.fps)
        return tuple(one if self.limit is None else one.first(self.limit) for one in streams)


def one_setting(settings: PairSettings) -> CameraSettings:
    """Return what is asked of each camera alike. Raises UsageError for the zooms of a pair."""
    if not isinstance(settings, CameraSettings):
        raise UsageError("--zoom-left and --zoom-right are for rigs of left and right", cure="Leave them away")
    return settings


def _settings_of_one(settings: PairSettings, image: str) -> CameraSettings:
    """Return what is asked of the camera whose images hold both views. Raises UsageError for two different zooms."""
    left, right = by_side(settings)
    if left != right:
        raise UsageError(
            f"{image} is one camera, and two different zooms are to be set",
            cure="Give --zoom-left and --zoom-right the same value; or leave --set-zoom away, and set the lenses first",
        )
    return left


def streams_of(
    rig: Rig, sources: Sequence[str | None], tables: Sequence[Path | None], *, colour: bool, fps: float | None
) -> tuple[Stream, ...]:
    """Return both cameras' frames, from sources as on the command line, or from tables of spots. Raises UsageError."""
    left, right = sources
    if all(tables) and not any(sources):
        read = [_table(path, rig.camera(side)) for path, side in zip(tables, SIDES, strict=True) if path is not None]
        return tuple(read)
    if any(tables) or (left is None and right is None):
        raise UsageError(
            "which frames?", cure="Give --left and --right, or --left-spots and --right-spots, one of each camera"
        )
    alone = left or right or ""
    if (left is None or right is None) and not is_recording(alone):
        raise UsageError("one view is missing", cure="Give --left and --right, or one recording for both")
    return streams_of_cameras({"left": left or alone, "right": right or alone}, colour=colour, fps=fps)


def streams_of_cameras(cameras: Mapping[str, str], *, colour: bool, fps: float | None) -> tuple[Stream, ...]:
    """Return the frames of cameras' sources, in their order. Raises UsageError for live ones."""
    live = [text for text in cameras.values() if is_live(text)]
    if live:
        record = "--left ... --right ..." if tuple(cameras) == SIDES else "--camera NAME=... for each"
        raise UsageError(
            f"{live[0]} is a live camera, and views of free-running cameras are put together afterwards",
            cure=f"Record first: armsight record {record} -o wave.mcap, and give --left wave.mcap",
        )
    first = next(iter(cameras.values()))
    return tuple(_images(text, name, colour=colour, fps=fps, origin_of=first) for name, text in cameras.items())


def timing_of(rig: Rig) -> tuple[CameraTiming, ...]:
    """Return the timing of each camera; one of which nothing is known exposes at once."""
    return tuple(one or AT_ONCE for one in rig.timing)


def require_timing(rig: Rig) -> None:
    """Raise UsageError where nothing is known of when the rig's cameras expose."""
    if all(one is None for one in rig.timing):
        raise UsageError(
            "the rig's file says nothing of its cameras' timing",
            consequence="When each view was taken is not known, so views of a moving target cannot be put together",
            cure="Run armsight calibrate timing with 15 s of a waved target, or use --timing pairs",
        )


def _table(path: Path, camera: Camera) -> Stream:
    track = read_spot_track(path)
    return _steady(track.t_s, str(path), lambda: _spot_frames(track, camera))


def _spot_frames(track: SpotTrack, camera: Camera) -> Iterator[SpotFrame]:
    for k, t_s in enumerate(track.t_s.tolist()):
        rows = np.flatnonzero(track.frame == k)
        spots = Spots.of_centres(track.uv_px[rows], track.covariance_px2[rows])
        yield SpotFrame(t_s=t_s, spots=spots, width=camera.width, height=camera.height)


def _images(text: str, side: str, *, colour: bool, fps: float | None, origin_of: str) -> Stream:
    """Return the frames of a source that can be read again; the first time for its stamps."""
    opened = partial(camera_source, text, side, colour=colour, fps=fps, origin_of=origin_of)

    def read() -> Iterator[Frame]:
        with opened() as source:
            yield from source

    with opened() as source:
        stamps_s = source.stamps_s() if isinstance(source, FileSource) else (frame.t_s for frame in source)
        return _steady(np.fromiter(stamps_s, float), side, read)


def _steady(stamps_s: Array, where: str, read: Callable[[], Iterator[AnyFrame]]) -> Stream:
    """Return the stream of stamps freed of jitter, as given where they are too few to tell."""
    back = np.flatnonzero(np.diff(stamps_s) <= 0.0)
    if len(back):
        raise Inconsistent(
            f"{where}: the stamp of frame {back[0] + 1}, {stamps_s[back[0] + 1]:g} s, is not after the one before",
            consequence="There is no time for its view",
            cure="Give the frames in the order of time, each with a stamp of its own",
        )
    from armsight.calibrate.timing.stamps import FEWEST_FRAMES, camera_clock  # with all of the clocks

    if len(stamps_s) < FEWEST_FRAMES:
        return Stream(t_s=stamps_s, read=read, clock_covariance=lambda at_s: np.zeros((2, 2)))
    clock = camera_clock(stamps_s, where)
    return Stream(t_s=clock.t_s, read=read, clock_covariance=clock.clock_covariance)
