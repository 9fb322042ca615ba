"""A board in the images of some cameras, each by its name, and what they are calibrated beside."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Any, NamedTuple

from scipy.spatial.transform import RigidTransform

from armsight.calibrate.cameras import BoardOptions, CamerasCalibration
from armsight.calibrate.cameras.many import extend_rig, solve_cameras
from armsight.calibrate.cameras.many_result import result_of
from armsight.calibrate.cameras.preconditions import KnownLens
from armsight.calibrate.cameras.two_sides import TwoSided
from armsight.drivers import AUTOMATIC, ImageReading, is_live, is_video
from armsight.errors import Cancelled, Inconsistent, NotEnoughData, UsageError
from armsight.measure.settings import SpotSettings
from armsight.ops.calibration.board_images import Keeper, Seen, in_parallel
from armsight.ops.calibration.shown import Eye, Glimpse, look_again, require_lenses, require_shown, words_of
from armsight.ops.sources.cameras import require_own_sources
from armsight.ops.sources.frames import is_recording, open_source
from armsight.optics import Rig
from armsight.optics.mounted import MOST_CAMERAS, MountedCamera, require_camera_name
from armsight.records import BoardView, Frame, NotSeen, Progress, Silent, Target
from armsight.store import CameraFile
from armsight.store.bags import is_bag


class Reading(NamedTuple):
    """How images are read: frames a second of numbered images of a film, every n-th, so many, on so many threads; how a
    board or lights are looked for in them."""

    fps: float | None
    every: int
    limit: int | None
    workers: int | None
    bits: int | None
    strict: bool
    detector: str
    settings: SpotSettings


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Wanted:
    """What is asked for: images by the cameras' names, lenses known before, and a rig that is extended or mended."""

    rig: Rig | None
    cameras: Mapping[str, str | Sequence[Frame]]
    add: Mapping[str, str | Sequence[Frame]] | None
    again: str | None
    lenses: Mapping[str, CameraFile]
    hold_lenses: bool

    @property
    def new(self) -> str | None:
        """The camera that joins the rig, or is placed anew."""
        return next(iter(self.add)) if self.add else self.again

    @property
    def sources(self) -> dict[str, str | Sequence[Frame]]:
        """The images of all cameras by name."""
        return {**self.cameras, **(self.add or {})}

    def require(self) -> None:
        """Raise UsageError where this cannot be what is meant."""
        known = () if self.rig is None else self.rig.names
        require_names(self.sources, known)
        if self.rig is None:
            if self.add or self.again:
                raise UsageError("--add and --again change a rig, and none is given", cure="Give --rig rig.yaml")
            return
        if (self.again is None) == (not self.add) or len(self.add or {"": ""}) > 1:
            raise UsageError(
                "with --rig one camera is added or placed anew",
                cure="Give one --add NAME=SRC for one that joins it, or --again NAME for one that was knocked",
            )
        if self.again is not None and self.again not in self.cameras:
            raise UsageError(
                f"the images of {self.again} are not given", cure=f"Give --camera {self.again}=SRC beside the others"
            )
        twice = set(self.add or {}) & set(known)
        if twice:
            raise UsageError(
                f"the rig has a camera {next(iter(twice))} already",
                cure=f"Use --again {next(iter(twice))} with its images as --camera, or another name",
            )
        strangers = [name for name in self.cameras if name not in known]
        if strangers:
            raise UsageError(
                f"the rig has no camera {strangers[0]}; it has {', '.join(known)}",
                cure=f"Use the rig's names, or --add {strangers[0]}=SRC for one that joins it",
            )

    def lens(self, name: str) -> KnownLens | None:
        """Return the lens given for a camera."""
        if name not in self.lenses:
            return None
        file = self.lenses[name]
        return KnownLens(camera=file.camera, covariance=None if self.hold_lenses else file.covariance)

    @property
    def cameras_known(self) -> dict[str, MountedCamera]:
        """The cameras whose lens is known before, each in axes of its own."""
        known = {} if self.rig is None else {name: self.rig.camera(name) for name in self.rig.names}
        known |= {name: file.camera for name, file in self.lenses.items()}
        back = RigidTransform.identity()
        return {name: MountedCamera(name=name, camera=one, T_rig_camera=back) for name, one in known.items()}


class SeenByAll(NamedTuple):
    """What each camera saw at each moment, None where nothing; its times, None where there are none; n: moments."""

    views: dict[str, list[BoardView | None]]
    times_s: dict[str, list[float]] | None
    n: int


def require_names(given: Mapping[str, object], known: Sequence[str] = ()) -> None:
    """Raise UsageError for names that are none, one source by two names, and too many or too few cameras.

    known: names that a rig has already.
    """
    for name in given:
        require_camera_name(name)
    n = len(set(given) | set(known))
    if not 1 < n <= MOST_CAMERAS:
        raise UsageError(
            f"{n} camera{'s are' if n != 1 else ' is'} given",
            consequence=f"A rig is of 2 to {MOST_CAMERAS} cameras",
            cure="Repeat --camera NAME=SRC for each; one alone is for armsight calibrate camera"
            if n < 2
            else "Leave some away; further ones make a second rig",
        )
    require_own_sources({name: source for name, source in given.items() if isinstance(source, str)})


def see_all(
    wanted: Wanted, shown: Target | TwoSided, reading: Reading, pictures: Keeper, progress: Progress | None
) -> SeenByAll:
    """Return what is shown as every camera's images show it, moment by moment.

    Raises NotEnoughData, naming the camera, where none of its images shows it; Inconsistent for lists of different
    length; UsageError for live cameras, and for lights before lenses that are not known; Cancelled.
    """
    progress, views, times = progress or Silent(), dict[str, list[BoardView | None]](), dict[str, list[float]]()
    sources, known = wanted.sources, wanted.cameras_known
    require_lenses(tuple(sources), known, shown)
    for name, source in sources.items():
        eye = Eye(shown, reading.detector, pictures, known.get(name), reading.settings)
        seen, times[name] = _see(name, source, eye, reading, progress)
        require_shown(seen, shown)
        if seen and all(isinstance(one, NotSeen) for one in seen):
            why = next(one.why for one in seen if isinstance(one, NotSeen))
            raise NotEnoughData(
                f"the {eye.noun} {words_of(shown)} is in none of the {len(seen)} images of {name}; in the first: {why}",
                consequence=f"Where {name} stands is open, and nothing was calibrated",
                cure=f"{look_again(shown, why)}; or leave the camera {name} away",
            )
        views[name] = [one if isinstance(one, BoardView) else None for one in seen]
    counts = {name: len(each) for name, each in views.items()}
    if len(set(counts.values())) > 1:
        raise Inconsistent(
            f"the cameras have different numbers of images: {', '.join(f'{name} {n}' for name, n in counts.items())}",
            consequence="Nobody knows which belong together",
            cure="Give one image of every camera for each moment, in the same order",
        )
    timed = all(_has_times(source, reading) for source in sources.values())
    return SeenByAll(views=views, times_s=times if timed else None, n=next(iter(counts.values())))


def _has_times(source: str | Sequence[Frame], reading: Reading) -> bool:
    """Tell whether images of a source say when they were taken: films do, and numbered images of one."""
    if not isinstance(source, str):
        return False
    return reading.fps is not None or is_video(source) or is_recording(source) or is_bag(source)


def _see(
    name: str, source: str | Sequence[Frame], eye: Eye, reading: Reading, progress: Progress
) -> tuple[list[Seen], list[float]]:
    """Return what one camera saw in each image, and the images' times."""
    if isinstance(source, str) and is_live(source):
        raise UsageError(
            f"{name} is a live camera, {source}",
            consequence="Several are not read in step",
            cure="Record them first (armsight record, or a program of theirs), and give the films or folders",
        )
    stop = None if reading.limit is None else reading.limit * reading.every
    seen, times = list[Seen | Glimpse](), list[float]()

    def see(frame: Frame) -> tuple[float, Seen | Glimpse]:
        return frame.t_s, eye.see(frame)

    def read(frames: Any) -> None:
        for t_s, one in in_parallel(see, islice(frames, 0, stop, reading.every), workers=reading.workers):
            seen.append(one)
            times.append(t_s)
            progress.update(len(seen), 0, f"finding the {eye.noun}, {name}")
            if progress.cancelled():
                raise Cancelled(f"stopped after {len(seen)} images of {name}", consequence="Nothing was written")

    if not isinstance(source, str):
        read(source)
        return eye.told(seen), times
    files = ImageReading(bits=reading.bits, strict=reading.strict)
    fps = None if is_video(source) or is_recording(source) or is_bag(source) else reading.fps
    with open_source(source, fps=fps, settings=AUTOMATIC, reading=files) as frames:
        read(frames)
    return eye.told(seen), times


def solved(
    wanted: Wanted, seen: SeenByAll, shown: Target | TwoSided, options: BoardOptions, progress: Progress | None
) -> CamerasCalibration:
    """Return the rig that is wanted; raises as solve_cameras and extend_rig."""
    if progress is not None:
        progress.update(0, 0, "solving")
    lenses = {name: lens for name in seen.views if (lens := wanted.lens(name)) is not None}
    name, rig = wanted.new, wanted.rig
    times = seen.times_s
    if rig is None or name is None:
        done = solve_cameras(seen.views, shown, options, lenses=lenses, times_s=times, progress=progress)
        return result_of(done, seen.n)
    own = lenses.get(name)
    done, whole = extend_rig(rig, name, seen.views, shown, options, lens=own, times_s=times, progress=progress)
    return result_of(done, seen.n, whole, frozenset(rig.names) - {name})
