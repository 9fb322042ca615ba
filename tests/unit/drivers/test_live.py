"""Live cameras on a fake wire: unplugged, silent, out of step."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from threading import Event

import numpy as np
import pytest

from armsight import simulate
from armsight.clock import ManualClock
from armsight.drivers import FileMoments, Moment, OpenCvCamera, TimedMoments
from armsight.drivers.live import DEPTH
from armsight.errors import DeviceLost
from armsight.measure.poses.setup import Setup
from armsight.ops.measurement.run import run
from armsight.ops.recording.record import RecordJob, record_moments
from armsight.optics import SIDES
from armsight.records import Frame, Silent
from refusals import refuses


class Wire:
    """A camera that sends a number of frames and is then pulled out."""

    def __init__(self, count: int, opened: bool = True) -> None:
        self.count, self.opened, self.released = count, opened, False

    def isOpened(self) -> bool:
        return self.opened

    def read(self):
        self.count -= 1
        return (True, np.zeros((4, 6, 3), np.uint8)) if self.count >= 0 else (False, None)

    def get(self, key: int, /) -> float:
        return 0.0

    def release(self) -> None:
        self.released = True


class Scripted:
    """A source whose frames come at given times."""

    total = None

    def __init__(self, name: str, times_s: list[float]) -> None:
        self.name, self.times_s = name, times_s

    def __enter__(self):
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __iter__(self) -> Iterator[Frame]:
        for sequence, t_s in enumerate(self.times_s):
            yield Frame(image=np.zeros((4, 6), np.uint8), t_s=t_s, sequence=sequence, source=self.name)


class Held(Scripted):
    """A source of given frames."""

    def __init__(self, name: str, frames: list[Frame]) -> None:
        super().__init__(name, [])
        self.frames = frames

    def __iter__(self) -> Iterator[Frame]:
        yield from self.frames


def test_a_camera_unplugged_midway_is_lost_after_its_last_frames() -> None:
    wire = Wire(6)
    got = []
    camera = OpenCvCamera("3", clock=ManualClock(), open_capture=lambda _: wire)
    with refuses(DeviceLost, "camera:3", "6 frames") as info, camera:
        got.extend(frame.sequence for frame in camera)
    assert got[-1] == 5
    assert wire.released
    assert "cable" in info.value.cure


def test_frames_that_newer_ones_displace_are_counted_anew_at_every_opening() -> None:
    camera = OpenCvCamera("3", clock=ManualClock(), open_capture=lambda _: Wire(9))
    for _ in range(2):
        with TimedMoments(camera, Scripted("right", [])) as pairs:  # opens its cameras
            assert camera._thread is not None
            camera._thread.join()  # all has come before any frame is asked for, the end of it as well
            assert pairs.n_late == 9 + 1 - DEPTH


class Burst(Wire):
    """A camera of 20 frames a second that sends frame 0, twelve more once `taken` is set, and goes on at `ended`."""

    def __init__(self) -> None:
        super().__init__(100)
        self.clock, self.taken, self.sent, self.ended = ManualClock(), Event(), Event(), Event()

    def read(self):
        if self.count == 99:
            self.taken.wait()
        if self.count == 99 - 12:
            self.sent.set()
            self.ended.wait()
        self.clock.advance(0.05)
        return super().read()


def test_frames_that_newer_ones_displace_while_recording_are_not_missed_by_the_cameras(tmp_path: Path) -> None:
    wires = Burst(), Burst()

    class Slow(TimedMoments):
        def __iter__(self) -> Iterator[Moment]:
            for moment in super().__iter__():
                yield moment
                for wire in wires:
                    wire.taken.set()
                    wire.sent.wait()

        def __exit__(self, *args: object) -> None:
            for wire in wires:
                wire.ended.set()
            super().__exit__(*args)

    sides = (OpenCvCamera("3", clock=wire.clock, origin_s=0.0, open_capture=lambda _, w=wire: w) for wire in wires)
    done = record_moments(RecordJob(out=tmp_path / "a.mcap", limit=1 + DEPTH), Slow(*sides), live=True)
    assert (done.n_pairs, done.n_missed, done.n_late) == (1 + DEPTH, 0, 2 * (12 - DEPTH))


def test_the_rate_that_measuring_keeps_is_said_where_live_frames_were_displaced() -> None:
    class Hasty(FileMoments):
        n_late = 7

    cell = simulate("hand-cell", frames=3)
    sides = [
        Held(side, [Frame(image=image, t_s=n / 20.0, sequence=n, source=side) for n, image in enumerate(images)])
        for side, images in zip(SIDES, zip(*((views.left, views.right) for views in cell), strict=True), strict=True)
    ]
    with pytest.warns(UserWarning, match=r"7 frames came faster .* kept up with 20\.0 pairs a second"):
        run(Setup(cell.rig, cell.target), Hasty(*sides), None, progress=Silent())


def test_frames_are_paired_with_the_nearest_and_the_skew_is_told() -> None:
    left = Scripted("left", [0.000, 0.033, 0.066, 0.100, 0.133])
    right = Scripted("right", [0.003, 0.036, 0.103, 0.136])  # one frame was dropped
    with TimedMoments(left, right, max_skew_s=0.010) as pairs:
        got = [(one.t_s, two.t_s) for one, two in pairs]
        skew = pairs.skew
    assert got == [(0.000, 0.003), (0.033, 0.036), (0.100, 0.103), (0.133, 0.136)]
    assert skew is not None
    assert skew.mean_s == pytest.approx(0.003)
    assert skew.largest_s == pytest.approx(0.003)
    assert (skew.n_pairs, skew.n_dropped) == (4, 1)


@pytest.mark.parametrize("lost", [0, 1, 40])
def test_a_lost_frame_at_60_a_second_does_not_shift_all_later_pairs(lost: int) -> None:
    times = [k / 60.0 for k in range(200)]
    right = Scripted("right", [t_s + 0.001 for k, t_s in enumerate(times) if k != lost])
    with TimedMoments(Scripted("left", times), right) as pairs:
        late = [one.t_s for one, two in pairs if two.t_s - one.t_s > 0.002]
    assert len(late) <= 2 and all(t_s <= times[2] for t_s in late)  # until the period is known
