"""kill -9 in the middle of recording: what was given to the system is readable, in whole pairs, and can be mended.

Here it is checked that the file is good; how much is lost, benchmarks/recording.py measures over many trials.
"""

import multiprocessing
import os
import signal
import sys
from collections.abc import Iterator
from multiprocessing.connection import Connection
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
import pytest
from mcap.reader import make_reader

from armsight.drivers import Skew
from armsight.ops.recording.record import RecordJob, record_moments
from armsight.records import Frame
from armsight.store.recording import ImageFormat, Recording, repair

IMAGES = np.random.default_rng(0).integers(0, 256, (5, 2, 60, 80), dtype=np.uint8)

TOLD_AT = 2500
"""Pairs of 9.6 kB: three chunks full, however quick the machine is; what waits in memory is less than one."""


class Endless:
    """Pairs without end, as fast as they are taken; tells through a pipe when a number of them was."""

    name = "endless"
    total: int | None = None
    skew: Skew | None = None

    def __init__(self, pipe: Connection, tell_at: int) -> None:
        self._pipe = pipe
        self._tell_at = tell_at

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        i = 0
        while True:
            left, right = (Frame(image=image, t_s=i / 100.0, sequence=i, source="") for image in IMAGES[i % 5])
            yield left, right
            i += 1
            if i == self._tell_at:
                self._pipe.send(i)


def _child(path: Path, kind: ImageFormat, pipe: Connection, tell_at: int) -> None:
    record_moments(RecordJob(out=path, kind=kind), Endless(pipe, tell_at), live=False)


@pytest.mark.skipif(sys.platform == "win32", reason="there is no kill -9")
@pytest.mark.parametrize("kind", [ImageFormat.RAW])
def test_killed_while_recording(tmp_path: Path, kind: ImageFormat) -> None:
    path = tmp_path / "a.mcap"
    here, there = multiprocessing.Pipe(duplex=False)
    child = multiprocessing.get_context("fork").Process(target=_child, args=(path, kind, there, TOLD_AT), daemon=True)
    child.start()
    assert here.poll(60.0)
    os.kill(child.pid or 0, signal.SIGKILL)
    child.join()
    with Recording(path) as recording:
        assert not recording.finished
        views = [list(recording.frames(side)) for side in ("left", "right")]
    numbers = [frame.sequence for frame in views[0]]
    assert numbers == list(range(len(numbers)))
    assert numbers == [frame.sequence for frame in views[1]]
    assert len(numbers) > 0
    for frame in views[1][::97]:
        np.testing.assert_array_equal(frame.image, IMAGES[frame.sequence % 5, 1])
    done = repair(path, tmp_path / "b.mcap")
    assert done.messages == {"/left/image": len(numbers), "/right/image": len(numbers)}
    with (tmp_path / "b.mcap").open("rb") as file:
        assert sum(1 for _ in make_reader(file, validate_crcs=True).iter_messages()) == 2 * len(numbers)
