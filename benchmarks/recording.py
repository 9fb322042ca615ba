"""Recordings: pairs a second as raw and as PNG with the process's memory, and what kill -9 costs.

    python benchmarks/recording.py [--quick] [--minutes M] [--trials N] [--folder DIR]

The frames are the simulated 1280x720 cell's with sensor noise, sent again and again at a fixed rate by a live source
that does not wait: what finds no room is dropped and counted.
"""

from __future__ import annotations

import argparse
import multiprocessing
import os
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from armsight.drivers import RecordedMoments, Skew
from armsight.errors import BadFile
from armsight.ops.recording.record import RecordJob, record_moments
from armsight.ops.simulation.cells import load_cell
from armsight.ops.sources.frames import RecordedFrames
from armsight.records import Frame
from armsight.store.recording import ImageFormat, Recording, RecordingWriter, repair
from bench import machine, table

PAGE = os.sysconf("SC_PAGE_SIZE") if hasattr(os, "sysconf") else 4096
DIFFERENT = 8
RATES = ((ImageFormat.RAW, 60.0), (ImageFormat.PNG, 30.0), (ImageFormat.PNG, 60.0), (ImageFormat.JPEG, 60.0))


class Paced:
    """Pairs at a fixed rate for some seconds, late or not; t_s is the machine's monotonic clock."""

    name = "benchmark"
    total: int | None = None
    skew: Skew | None = None

    def __init__(self, images: list[tuple[np.ndarray, np.ndarray]], rate: float, seconds_s: float) -> None:
        self._images = images
        self._rate = rate
        self._n = int(rate * seconds_s)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        start_s = time.monotonic()
        for i in range(self._n):
            wait_s = start_s + i / self._rate - time.monotonic()
            if wait_s > 0.0:
                time.sleep(wait_s)
            left, right = self._images[i % len(self._images)]
            t_s = time.monotonic()
            yield (
                Frame(image=left, t_s=t_s, sequence=i, source="left"),
                Frame(image=right, t_s=t_s, sequence=i, source="right"),
            )


def pictures(size: tuple[int, int] | None = None) -> list[tuple[np.ndarray, np.ndarray]]:
    pairs = load_cell("hand-cell", seed=1, frames=DIFFERENT).frames()
    rows, columns = size or (720, 1280)
    return [
        (np.ascontiguousarray(a.image[:rows, :columns]), np.ascontiguousarray(b.image[:rows, :columns]))
        for a, b in pairs
    ]


def resident_mb() -> float:
    return int(Path("/proc/self/statm").read_text().split()[1]) * PAGE / 1e6


class Memory:
    """The process's resident memory once a second, and its processor time."""

    def __enter__(self) -> Self:
        self.mb: list[float] = []
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._watch)
        self._cpu_s, self._wall_s = time.process_time(), time.monotonic()
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self.cores = (time.process_time() - self._cpu_s) / (time.monotonic() - self._wall_s)
        self._end.set()
        self._thread.join()

    def _watch(self) -> None:
        while not self._end.wait(1.0):
            self.mb.append(resident_mb())


def check(path: Path, images: list[tuple[np.ndarray, np.ndarray]], most: int = 200) -> int:
    """Return how many of the first pairs come back bit for bit."""
    same = 0
    with RecordedMoments(RecordedFrames(str(path), "left"), RecordedFrames(str(path), "right")) as pairs:
        for (left, right), _ in zip(pairs, range(most), strict=False):
            a, b = images[left.sequence % len(images)]
            same += bool(np.array_equal(left.image, a) and np.array_equal(right.image, b))
    return same


def rates(folder: Path, seconds_s: float) -> None:
    images = pictures()
    rows = []
    for kind, rate in RATES:
        path = folder / f"{kind.value}.mcap"
        with Memory() as memory:
            done = record_moments(
                RecordJob(out=path, kind=kind, overwrite=True), Paced(images, rate, seconds_s), live=True
            )
        with Recording(path) as recording:
            counts = {recording.count(f"/{side}/image") for side in ("left", "right")} | {done.n_pairs}
            if not recording.finished or len(counts) != 1:
                raise BadFile(f"{path}: {counts} frames, finished: {recording.finished}")
        checked = min(200, done.n_pairs)
        same = f"{check(path, images)} of {checked}" if kind is not ImageFormat.JPEG else "lossy"
        settled = memory.mb[len(memory.mb) // 4 :] or [resident_mb()]
        rows.append(
            [
                f"{kind.value}, {rate:.0f} asked",
                f"{done.n_pairs / done.duration_s:.1f}",
                done.n_dropped,
                f"{done.size_bytes / done.duration_s / 1e6:.1f}",
                f"{memory.cores:.2f}",
                f"{min(settled):.0f} to {max(settled):.0f}",
                same,
            ]
        )
        path.unlink()
    header = ["frames", "pairs/s kept", "dropped", "MB/s", "cores", "memory MB (last 3/4)", "bit for bit"]
    table(f"1280x720 pairs, {seconds_s:.0f} s each", header, rows)


def peer(folder: Path, n: int) -> None:
    """Write the same raw pairs with the mcap package's own writer and with ours, as fast as they go."""
    images = pictures()

    def ours() -> None:
        with RecordingWriter(folder / "ours.mcap", overwrite=True) as writer:
            for i in range(n):
                a, b = images[i % len(images)]
                frames = (Frame(image=x, t_s=i / 60.0, sequence=i, source="") for x in (a, b))
                writer.moment(dict(zip(("left", "right"), frames, strict=True)))

    def theirs() -> None:
        with (folder / "theirs.mcap").open("wb") as file:
            writer = Writer(file, compression=CompressionType.NONE, chunk_size=8_000_000)
            writer.start()
            channels = [writer.register_channel(f"/{side}/image", "raw", 0) for side in ("left", "right")]
            for i in range(n):
                for channel, image in zip(channels, images[i % len(images)], strict=True):
                    writer.add_message(channel, i, image.tobytes(), i, i)
            writer.finish()
            file.flush()
            os.fsync(file.fileno())

    cpu: dict[str, list[float]] = {"armsight": [], "mcap package": []}
    for _ in range(3):
        for name, run in (("armsight", ours), ("mcap package", theirs)):
            start = time.process_time()
            run()
            cpu[name].append(1e3 * (time.process_time() - start) / n)
    rows = [[name, float(np.median(values))] for name, values in cpu.items()]
    table("Processor time to write one raw pair (1.8 MB), checksummed", ["writer", "ms a pair (median of 3)"], rows)


def _child(path: Path, kind: ImageFormat, images: list[tuple[np.ndarray, np.ndarray]]) -> None:
    record_moments(RecordJob(out=path, kind=kind), Paced(images, 60.0, 3600.0), live=True)


def killed(path: Path, kind: ImageFormat, images: list[tuple[np.ndarray, np.ndarray]], after_s: float) -> float:
    """Record in another process, kill it, mend the file; return the seconds lost. Raises where it cannot be read."""
    child = multiprocessing.get_context("fork").Process(target=_child, args=(path, kind, images), daemon=True)
    child.start()
    while not path.exists() or path.stat().st_size < 5000:
        time.sleep(0.005)
        if not child.is_alive():
            raise RuntimeError("the recording process ended by itself")
    time.sleep(after_s)
    kill_s = time.monotonic()
    os.kill(child.pid or 0, signal.SIGKILL)
    child.join()
    with Recording(path) as recording:
        if recording.finished:
            raise BadFile(f"{path} was closed before it was killed")
        lasts = [list(recording.frames(side))[-1] for side in ("left", "right")]
    if lasts[0].sequence != lasts[1].sequence:
        raise BadFile("the views do not end together")
    mended = path.with_suffix(".mended.mcap")
    repair(path, mended)
    with mended.open("rb") as file:
        summary = make_reader(file, validate_crcs=True).get_summary()
        n = sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages())
        if summary is None or summary.statistics is None or summary.statistics.message_count != n:
            raise BadFile(f"{mended}: the stock reader finds another count")
    path.unlink()
    mended.unlink()
    return kill_s - lasts[0].t_s


def kills(folder: Path, trials: int) -> None:
    rng = np.random.default_rng(4)
    images = pictures((360, 640))
    lost: dict[ImageFormat, list[float]] = {ImageFormat.RAW: [], ImageFormat.PNG: []}
    unreadable = 0
    for i in range(trials):
        kind = (ImageFormat.RAW, ImageFormat.PNG)[i % 2]
        try:
            lost[kind].append(killed(folder / f"killed{i}.mcap", kind, images, float(rng.uniform(0.3, 2.0))))
        except (BadFile, IndexError) as error:
            unreadable += 1
            print(f"trial {i}: {error}", file=sys.stderr)
    rows = [
        [kind.value, len(it), float(np.median(it)), float(np.max(it)), sum(one > 1.0 for one in it)]
        for kind, it in lost.items()
    ]
    header = ["frames", "readable", "lost s, median", "lost s, largest", "over 1 s"]
    table(f"kill -9 while recording 640x360 pairs at 60/s, {trials} times, {unreadable} unreadable", header, rows)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few seconds and trials")
    parser.add_argument("--minutes", type=float, default=None, help="of each rate [10 s]")
    parser.add_argument("--trials", type=int, default=50)
    parser.add_argument("--folder", type=Path, default=None, help="where to record [the system's temporary folder]")
    given = parser.parse_args()
    seconds_s = 60.0 * given.minutes if given.minutes else (3.0 if given.quick else 10.0)
    print(machine())
    with tempfile.TemporaryDirectory(dir=given.folder) as name:
        folder = Path(name)
        kills(folder, 6 if given.quick else given.trials)
        peer(folder, 60 if given.quick else 240)
        rates(folder, seconds_s)


if __name__ == "__main__":
    main()
