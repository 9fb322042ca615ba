"""Frames into a recording; a broken recording mended."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Annotated, TypeAlias

from armsight._files import real_path
from armsight.clock import Clock, SystemClock
from armsight.drivers import (
    AUTOMATIC,
    MAX_SKEW_S,
    CameraSettings,
    MomentSource,
    Views,
    by_name,
    is_live,
    moments_of,
    news_of,
)
from armsight.errors import ArmsightError, NotEnoughData, UsageError
from armsight.fields import Doc
from armsight.file_names import RIG, TARGET
from armsight.measure.poses.pipeline import check_sizes
from armsight.ops.recording.recorder import Recorder
from armsight.ops.simulation.cells import CellPairs, load_cell, write_cell_files
from armsight.ops.sources.cameras import cameras_of, is_whole_recording, open_cameras
from armsight.ops.sources.frames import is_recording, recording_path
from armsight.optics import SIDES, Rig
from armsight.records import Frame, Progress, Silent
from armsight.records.output import Output, output
from armsight.shown import Shown
from armsight.store import read_rig, read_target
from armsight.store.atomic import disk_errors
from armsight.store.recording import ImageFormat, Recording, RecordingWriter, Repaired, repair

CELL_FRAMES = 300
"""Moments of a simulated cell where no limit is given: five seconds at 60 a second."""


@output
class RecordedSkew(Output):
    """Time between the frames of pairs, right minus left."""

    mean: Annotated[float, Doc("Mean, s.")]
    largest: Annotated[float, Doc("Largest, s.")]


Named: TypeAlias = dict[str, int] | None


@output
class RecordOutput(Output):
    """armsight record."""

    file: Annotated[str, Doc("The recording.")]
    format: Annotated[str, Doc("How frames are kept: png, raw or jpeg.")]
    n_pairs: Annotated[int, Doc("Pairs recorded.")]
    n_dropped: Annotated[int, Doc("Pairs that found no room: the disk or the processor is too slow.")]
    n_missed: Annotated[int, Doc("Frames lost by the cameras or without a partner.")]
    n_late: Annotated[int, Doc("Frames that newer ones displaced before they were taken up: this machine is too slow.")]
    duration_s: Annotated[float, Doc("From the first pair to the last, s.")]
    pairs_per_s: Annotated[float | None, Doc("Pairs a second.", unit="1/s")]
    size_bytes: Annotated[int, Doc("Size of the file, bytes.")]
    skew_s: Annotated[RecordedSkew | None, Doc("Time between the frames of live pairs; null of other sources.")]
    n_frames: Annotated[Named, Doc("Frames recorded of each camera; left out of a pair's, which are n_pairs.")] = None
    lost: Annotated[dict[str, str] | None, Doc("Cameras that were lost on the way, and why.")] = None

    def summary(self) -> Iterator[Shown]:
        """Yield what a terminal shows of it."""
        kept = "" if self.pairs_per_s is None else f" and kept up with {self.pairs_per_s:.1f} a second"
        lost = (
            f", {self.n_dropped} dropped because the disk or the processor is too slow{kept}" if self.n_dropped else ""
        )
        lost += f", {self.n_late} displaced by newer ones because this machine is too slow" if self.n_late else ""
        lost += f", {self.n_missed} missed by the cameras" if self.n_missed else ""
        size = f"{self.size_bytes / 1e6:.1f} MB as {self.format}"
        what = "pairs" if self.n_frames is None else "moments"
        each = "" if self.n_frames is None else f" ({', '.join(f'{k} {n}' for k, n in self.n_frames.items())})"
        yield f"{self.n_pairs} {what}{each} in {self.duration_s:.1f} s{lost}; {size} in {self.file}"
        yield from (f"lost: {name}, {why}" for name, why in (self.lost or {}).items())


def image_format(text: str) -> ImageFormat:
    """Return how frames are kept, by its name. Raises UsageError."""
    try:
        return ImageFormat(text.lower())
    except ValueError:
        known = ", ".join(kind.value for kind in ImageFormat)
        raise UsageError(f"frames are not kept as {text!r}", cure=f"Choose one of {known}") from None


@dataclass(frozen=True, kw_only=True)
class RecordJob:
    """What to record: cameras by name, or a simulated cell; rig and target go into the recording. limit: moments."""

    out: Path
    cameras: Mapping[str, str] = field(default_factory=dict)
    cell: str | None = None
    seed: int = 0
    rig: Path | None = None
    target: Path | None = None
    kind: ImageFormat = ImageFormat.PNG
    colour: bool = False
    fps: float | None = None
    limit: int | None = None
    seconds_s: float | None = None
    max_skew_s: float | None = None
    overwrite: bool = False
    camera_settings: CameraSettings = AUTOMATIC


def record(job: RecordJob, progress: Progress | None = None, *, clock: Clock | None = None) -> RecordOutput:
    """Record moments until the source ends, the limit is reached or the person stops, which is no error here.

    Raises UsageError, DataRefused and DeviceFailed; what was recorded until then is readable.
    """
    _check(job)
    with _files(job) as (files, rig):
        moments, live = _source(job, rig)
        names = getattr(moments, "names", SIDES)
        return record_moments(job, moments, names, live=live, files=files, rig=rig, progress=progress, clock=clock)


def record_moments(
    job: RecordJob,
    moments: MomentSource,
    names: Sequence[str] = SIDES,
    *,
    live: bool,
    files: Mapping[str, Path] | None = None,
    rig: Rig | None = None,
    progress: Progress | None = None,
    clock: Clock | None = None,
) -> RecordOutput:
    """Record the moments of a source not yet open; live: what finds no room is dropped. See record."""
    tally = Tally(names, moments)
    with moments, closing(moments_of(moments)) as source:
        first = next(source, None)
        if first is None:
            raise NotEnoughData(f"{moments.name} gave no pair", consequence="Nothing was recorded")
        if rig is not None:
            readable = [None if frame is None or frame.unreadable else frame for frame in first]
            why = "The rig would stand in the recording as that of its frames; nothing was recorded"
            check_sizes(rig, readable, why)
        start_s = next(frame.t_s for frame in first if frame is not None)
        origin_ns = time.time_ns() - (round(start_s * 1e9) if live else 0)
        writer = RecordingWriter(job.out, origin_ns=origin_ns, overwrite=job.overwrite)
        recorder = Recorder(writer, job.kind, live=live)
        try:
            with writer:
                _attach(writer, files or {}, rig, start_s)
                with recorder:
                    lost, told = partial(news_of, moments), progress or Silent()
                    _pump(job, chain([first], source), lost, recorder, tally, told, clock or SystemClock())
        except ArmsightError as error:
            kept = f"What was recorded until then is in {job.out}"
            error.consequence = ". ".join(part.rstrip(".") for part in (error.consequence, kept) if part)
            raise
    return _output(job, recorder, tally, moments, live=live)


def _output(job: RecordJob, recorder: Recorder, tally: Tally, source: MomentSource, *, live: bool) -> RecordOutput:
    """Return what was recorded: what found no room, and what the cameras lost or had no partner, is counted apart."""
    skew = source.skew
    duration_s = tally.last_s - tally.first_s
    return RecordOutput(
        file=str(job.out),
        format=job.kind.value,
        n_pairs=recorder.written,
        n_dropped=recorder.dropped,
        n_missed=tally.missed if live else 0,
        n_late=tally.n_late,
        duration_s=duration_s,
        pairs_per_s=(recorder.written - 1) / duration_s if duration_s > 0.0 else None,
        size_bytes=job.out.stat().st_size,
        skew_s=RecordedSkew(mean=skew.mean_s, largest=skew.largest_s) if skew else None,
        n_frames=None if tuple(tally.names) == SIDES else tally.n_frames,
        lost=getattr(source, "lost", None) or None,
    )


def _attach(writer: RecordingWriter, files: Mapping[str, Path], rig: Rig | None, start_s: float) -> None:
    for name, path in files.items():
        writer.attach(name, path.read_bytes())
    if rig is not None:
        writer.rig(start_s, rig)


class Tally:
    """What went through: n moments, frames of each camera by name, first and last time; missed frames by the gaps in
    the numbers of the first camera that is there and those without a partner, where n_late, frames of the source that
    newer ones displaced meanwhile, do not explain them."""

    def __init__(self, names: Sequence[str], source: MomentSource) -> None:
        self.names, self._source = names, source
        self.n = self.missed = self.n_late = 0
        self._before = 0, 0
        self.n_frames = dict.fromkeys(names, 0)
        self.first_s = self.last_s = 0.0
        self._last: tuple[str, int] | None = None

    def add(self, frames: Mapping[str, Frame]) -> None:
        """Count a moment; its time and number are those of its first frame."""
        name, first = next(iter(frames.items()))
        now = getattr(self._source, "n_late", 0), getattr(self._source, "n_dropped", 0)
        late, lost = (after - before for after, before in zip(now, self._before, strict=True))
        if self.n == 0:
            self.first_s, late = first.t_s, 0  # those before the first moment are none of it
        elif self._last is not None and self._last[0] == name:
            lost += max(0, first.sequence - self._last[1] - 1)
        self.missed += max(0, lost - 2 * late)  # one displaced leaves a gap, and a frame without a partner
        self.n_late += late
        self._before, self.last_s, self._last = now, first.t_s, (name, first.sequence)
        for each in frames:
            self.n_frames[each] += 1
        self.n += 1


def _pump(
    job: RecordJob,
    source: Iterable[Views],
    lost: Callable[[list[str]], list[str]],
    recorder: Recorder,
    tally: Tally,
    progress: Progress,
    clock: Clock,
) -> None:
    told: list[str] = []
    end_s = clock.now_s() + job.seconds_s if job.seconds_s is not None else float("inf")
    for moment in source:
        frames = by_name(tally.names, moment)
        tally.add(frames)
        recorder.put(frames)
        for message in lost(told):
            recorder.add(partial(RecordingWriter.event, t_s=tally.last_s, message=message, level="warning"))
        notes = [f"{recorder.dropped} dropped"] if recorder.dropped else []
        progress.update(tally.n, job.limit or 0, ", ".join([*notes, *(f"{name} is lost" for name in told)]))
        if tally.n == job.limit or clock.now_s() >= end_s or progress.cancelled():
            return


def _check(job: RecordJob) -> None:
    """Raise UsageError for sources that contradict each other, and for a result that no reader would take."""
    if job.cell is not None and job.cameras:
        raise UsageError("--cell goes with no named cameras", cure="Give the one or the others")
    if job.out.suffix.lower() != ".mcap":
        raise UsageError(
            f"{job.out.name} does not end in .mcap",
            consequence="No command would take it for a recording; nothing is recorded",
            cure="Give FILE.mcap (-o)",
        )


def _source(job: RecordJob, rig: Rig | None) -> tuple[MomentSource, bool]:
    if job.cell is not None:
        n = job.limit or CELL_FRAMES
        return CellPairs(load_cell(job.cell, seed=job.seed, frames=n), n), False
    sources = list(job.cameras.values())
    if not sources:
        raise UsageError("there is nothing to record", cure="Give --left and --right, --camera NAME=SRC, or --cell")
    if rig is not None:
        cameras = cameras_of(rig.names, job.cameras)
    elif len(sources) == 1 and is_whole_recording(sources[0]):
        with Recording(recording_path(sources[0])) as recording:
            cameras = dict.fromkeys(recording.cameras, sources[0])
    else:
        cameras = dict(job.cameras)
    if any(is_recording(text) and real_path(recording_path(text)) == real_path(job.out) for text in sources):
        raise UsageError(f"{job.out} is both source and result", cure="Choose another name for the result")
    if len(cameras) == 1 and cameras.keys() <= set(SIDES):
        cameras = cameras_of(SIDES, cameras)
    moments = open_cameras(
        cameras,
        colour=job.colour,
        fps=job.fps,
        max_skew_s=MAX_SKEW_S if job.max_skew_s is None else job.max_skew_s,
        settings=job.camera_settings,
        tell=lambda _: None,  # told by who records: in the progress, the file and the result
    )
    return moments, is_live(sources[0])


@contextmanager
def _files(job: RecordJob) -> Iterator[tuple[dict[str, Path], Rig | None]]:
    """Give the files to attach, checked, and the rig; a cell brings its own."""
    with TemporaryDirectory() as folder:
        rig_path, target_path = job.rig, job.target
        if job.cell is not None:
            write_cell_files(load_cell(job.cell, seed=job.seed, frames=1), Path(folder), seed=job.seed, frames=1)
            rig_path = rig_path or Path(folder) / RIG
            target_path = target_path or Path(folder) / TARGET
        files = {name: path for name, path in ((RIG, rig_path), (TARGET, target_path)) if path is not None}
        if target_path is not None:
            read_target(target_path)
        yield files, read_rig(rig_path, any_cameras=True) if rig_path is not None else None


def mend(source: Path, out: Path | None = None, *, overwrite: bool = False) -> Repaired:
    """Make a readable file of a broken recording: in out, or in its own place with the broken one kept beside it.

    Raises BadFile, NotEnoughData, UsageError, DeviceFailed; then source is as it was.
    """
    if out is not None:
        if real_path(out) == real_path(source):
            raise UsageError(f"{out} is both source and result", cure="Leave -o away to mend a file in its place")
        return repair(source, out, overwrite=overwrite)
    made = source.with_name(f".{source.name}.part")
    kept = source.with_name(f"{source.stem}.broken{source.suffix}")
    if kept.exists():
        raise UsageError(f"{kept} is there already", consequence="Nothing was mended", cure="Move it away, or give -o")
    try:
        done = repair(source, made, overwrite=True)
        with disk_errors(source):
            source.rename(kept)
            made.rename(source)
    finally:
        made.unlink(missing_ok=True)
    return replace(done, file=str(source))
