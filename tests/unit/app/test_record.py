"""record, mend, export, and recordings as sources: what was recorded is what is measured."""

from __future__ import annotations

import threading
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from types import TracebackType
from typing import Self

import cv2
import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight.drivers import ImageFolder, Skew, Views
from armsight.errors import DeviceFailed, DeviceLost, Inconsistent, NotEnoughData, UsageError
from armsight.ops.recording import recorder as recorder_module
from armsight.ops.recording.export import export
from armsight.ops.recording.record import RecordJob, mend, record, record_moments
from armsight.ops.recording.recorder import Recorder
from armsight.ops.sources.cameras import open_rig
from armsight.ops.sources.frames import RecordedFrames, open_source
from armsight.optics import SIDES
from armsight.records import Frame, JointReading
from armsight.store import read_rig, read_target, read_times
from armsight.store.recording import ImageFormat, Recording, RecordingWriter, reader
from refusals import refuses


def frame(number: int, side: int = 0, t_s: float | None = None) -> Frame:
    image = np.random.default_rng([number, side]).integers(0, 256, (30, 40), dtype=np.uint8)
    return Frame(image=image, t_s=number / 60.0 if t_s is None else t_s, sequence=number, source="fake")


class Fake:
    """Pairs as a live source would send them, and what it does at its end."""

    name = "fake"
    total: int | None = None
    skew: Skew | None = None

    def __init__(self, pairs: list[tuple[Frame, Frame]], end: Exception | None = None) -> None:
        self._pairs = pairs
        self._end = end

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        pass

    def __iter__(self) -> Iterator[tuple[Frame, Frame]]:
        yield from self._pairs
        if self._end:
            raise self._end


def fakes(n: int) -> list[tuple[Frame, Frame]]:
    return [(frame(i), frame(i, 1)) for i in range(n)]


def test_times_are_read_without_a_picture(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    record_moments(RecordJob(out=tmp_path / "a.mcap"), Fake(fakes(4)), live=False)
    with RecordedFrames(str(tmp_path / "a.mcap"), "right") as frames:
        times_s = [one.t_s for one in frames]
        monkeypatch.setattr(reader, "decode", None)
        assert list(frames.stamps_s()) == times_s
    assert times_s == pytest.approx([n / 60.0 for n in range(4)])
    (tmp_path / "images").mkdir()
    for n in range(3):
        (tmp_path / "images" / f"{n}.png").touch()
    with ImageFolder(str(tmp_path / "images"), fps=10.0) as images:
        assert list(images.stamps_s()) == [0.0, 0.1, 0.2]


def test_the_rate_that_can_be_kept_is_said_beside_what_was_dropped(tmp_path: Path) -> None:
    done = record_moments(RecordJob(out=tmp_path / "a.mcap"), Fake(fakes(4)), live=False)
    (said,) = replace(done, n_dropped=7).summary()
    assert "7 dropped" in str(said) and "60.0 a second" in str(said)
    (said,) = done.summary()
    assert "a second" not in str(said)


def test_a_cell_is_recorded_with_its_rig_and_target_and_exported(tmp_path: Path) -> None:
    path = tmp_path / "cell.mcap"
    record(RecordJob(out=path, cell="hand-cell", seed=3, limit=3))
    done = export(path, tmp_path / "out")
    assert done.n == {"rig.yaml": 1, "target.yaml": 1, "left": 3, "right": 3, "times.csv": 3}
    assert read_rig(tmp_path / "out" / "rig.yaml").left.width == 1280
    assert not read_target(tmp_path / "out" / "target.yaml").is_board
    assert len(read_times(tmp_path / "out" / "times.csv")) == 3
    with RecordedFrames(str(path), "right") as source:
        for i, seen in enumerate(source):
            image = cv2.imread(str(tmp_path / "out" / "right" / f"{i:06d}.png"), cv2.IMREAD_UNCHANGED)
            np.testing.assert_array_equal(image, seen.image)
    with Recording(path) as recording:
        assert recording.count("/left/calibration") == 1
    rig = read_rig(tmp_path / "out" / "rig.yaml")
    with refuses(Inconsistent, "1280x720", "recorded"):
        record_moments(RecordJob(out=tmp_path / "b.mcap"), Fake(fakes(2)), live=False, rig=rig)
    assert not (tmp_path / "b.mcap").exists()


def test_live_frames_that_find_no_room_are_dropped_and_counted(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gate = threading.Event()
    monkeypatch.setattr(recorder_module, "QUEUE_BYTES", 5 * 2 * frame(0).image.nbytes)
    writer = RecordingWriter(tmp_path / "a.mcap")
    whole = writer.moment

    def slow(*args: object) -> None:
        gate.wait()
        whole(*args)  # type: ignore[arg-type]  # handed through as they came

    monkeypatch.setattr(writer, "moment", slow)
    with Recorder(writer, ImageFormat.RAW, live=True, clock=ManualClock()) as recorder:
        taken = [recorder.put(dict(zip(SIDES, pair, strict=True))) for pair in fakes(12)]
        gate.set()
    assert taken == [True] * 5 + [False] * 7
    assert (recorder.written, recorder.dropped) == (5, 7)
    with Recording(tmp_path / "a.mcap") as recording:
        assert sum("7 pairs dropped" in event.message for event in recording.events()) == 1


def test_live_frames_that_would_wait_too_long_are_dropped(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    gate, clock = threading.Semaphore(0), ManualClock()
    done = threading.Semaphore(0)
    writer = RecordingWriter(tmp_path / "a.mcap", clock=clock)
    whole = writer.moment

    def slow(*args: object) -> None:
        clock.advance(recorder_module.PACE_LIMIT_S)  # what each pair takes
        whole(*args)  # type: ignore[arg-type]  # handed through as they came
        done.release()
        gate.acquire()

    monkeypatch.setattr(writer, "moment", slow)
    pairs = fakes(60)
    with Recorder(writer, ImageFormat.RAW, live=True, clock=clock) as recorder:
        for pair in pairs[:30]:  # one at a time: all have room, and the pace is learnt
            assert recorder.put(dict(zip(SIDES, pair, strict=True)))
            assert done.acquire(timeout=60.0)
            gate.release()
        taken = [recorder.put(dict(zip(SIDES, pair, strict=True))) for pair in pairs[30:]]
        for _ in pairs:
            gate.release()
    room = recorder_module.QUEUE_S / recorder_module.PACE_LIMIT_S
    assert room - 1 <= sum(taken) <= room + 2
    assert recorder.dropped == 30 - sum(taken)
    with Recording(tmp_path / "a.mcap") as recording:
        assert recording.count("/left/image") == 30 + sum(taken)


def test_a_camera_that_goes_leaves_what_was_recorded(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with refuses(DeviceLost, "a.mcap"):
        record_moments(RecordJob(out=path), Fake(fakes(7), DeviceLost("camera:0 is gone")), live=True)
    with Recording(path) as recording:
        assert recording.finished
        assert recording.count("/right/image") == 7


def test_a_file_size_limit_ends_it_with_exit_code_4(tmp_path: Path) -> None:
    resource = pytest.importorskip("resource")
    path = tmp_path / "a.mcap"
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (60_000, before[1]))
    try:
        with refuses(DeviceFailed, "written") as caught:
            record_moments(RecordJob(out=path, kind=ImageFormat.RAW), Fake(fakes(300)), live=False)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert caught.value.exit_code == 4
    with Recording(path) as recording:
        assert recording.finished


def test_a_broken_recording_is_mended_in_its_place(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    record_moments(RecordJob(out=path), Fake(fakes(30)), live=False)
    whole = path.read_bytes()
    path.write_bytes(whole[:-300])
    done = mend(path)
    assert done.messages["/left/image"] == 30
    assert (tmp_path / "a.broken.mcap").read_bytes() == whole[:-300]
    with Recording(path) as recording:
        assert recording.finished
    with refuses(UsageError, "already"):
        mend(path)
    with refuses(UsageError, "source", "result", "-o"):
        mend(path, path)


def test_which_camera_is_meant_must_be_said(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    record_moments(RecordJob(out=path), Fake(fakes(3)), live=False)
    with refuses(Inconsistent, "left, right"), open_source(str(path)):
        pass
    with open_source(f"{path}:right") as source:
        assert source.total == 3
        np.testing.assert_array_equal(next(iter(source)).image, frame(0, 1).image)
    with refuses(UsageError, "put together", "recorded"):
        open_rig(SIDES, str(path), str(tmp_path))
    with refuses(UsageError, "own times"):
        open_rig(SIDES, str(path), fps=30.0)
    with refuses(UsageError, "source", "result", "another name"):
        record(RecordJob(out=path, cameras={"left": str(path)}))


class Ring:
    """Moments of three cameras, the last of which is lost after some; the second lacks a frame now and then."""

    name, total, skew = "ring", None, None
    names = ("west", "east", "top")

    def __init__(self, n: int, last: int) -> None:
        self.lost: dict[str, str] = {}
        self._n, self._last = n, last

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __iter__(self) -> Iterator[Views]:
        for i in range(self._n):
            if i == self._last:
                self.lost["top"] = "it was pulled out"
            yield frame(i), None if i % 4 == 2 else frame(i, 1), None if i >= self._last else frame(i, 2)


def same(got: Sequence[Views], wanted: Sequence[Views]) -> None:
    """Hold moments to those that were recorded: the same views, bit for bit."""
    for here, there in zip(got, wanted, strict=True):
        for one, two in zip(here, there, strict=True):
            assert (one is None) == (two is None)
            if one is not None and two is not None:
                np.testing.assert_array_equal(one.image, two.image)


def test_three_cameras_are_recorded_by_name_and_read_again_moment_by_moment(tmp_path: Path) -> None:
    path, ring = tmp_path / "a.mcap", Ring(9, 5)
    done = record_moments(RecordJob(out=path), ring, ring.names, live=False)
    assert (done.n_pairs, done.n_frames) == (9, {"west": 9, "east": 7, "top": 5})
    assert done.lost == {"top": "it was pulled out"}
    assert any("top" in line and "pulled out" in line for line in map(str, done.summary()))
    with Recording(path) as recording:
        assert recording.cameras == ring.names
        (event,) = recording.events()
        assert "top" in event.message and event.t_s == pytest.approx(5 / 60.0)
    wanted = [moment for moment in Ring(9, 5) if sum(one is not None for one in moment) > 1]
    assert len(wanted) == 8  # one view alone tells no depth
    with open_rig(ring.names, str(path), tell=lambda _: None) as back:
        same(list(back), wanted)


def test_a_recording_without_frames_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.mcap"
    with RecordingWriter(path) as writer:
        writer.joints(JointReading(q=np.zeros(2), t_s=0.5, sequence=0, source="robot"))
    with refuses(NotEnoughData, "/left/image"), open_rig(SIDES, str(path), str(path)) as pairs:
        list(pairs)
    with refuses(NotEnoughData, "/target/measured"):
        export(path, tmp_path / "poses.csv")
    assert not (tmp_path / "poses.csv").exists()
    assert export(path, tmp_path / "out").n == {"joints.csv": 1}
    assert (tmp_path / "out" / "joints.csv").read_text() == "t_s,q1,q2\n0.5,0.0,0.0\n"
