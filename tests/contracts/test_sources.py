"""One suite for every source of frames and of pairs: files, videos, live cameras on a fake wire."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import closing
from itertools import islice
from pathlib import Path

import cv2
import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight.drivers import FileMoments, ImageFolder, OneImage, OpenCvCamera, TimedMoments, VideoFile
from armsight.drivers.protocols import FrameSource, MomentSource
from armsight.errors import ArmsightError

COUNT = 12
SHAPE = (48, 64)


def picture(number: int) -> np.ndarray:
    """A flat frame whose grey level is its number times ten, plus a light that no codec smooths away."""
    image = np.full(SHAPE, number * 10, np.uint8)
    image[16:32, 16:32] = 255
    return image


class FakeCapture:
    """A camera that never ends and whose clock moves by one frame per read; held: not while this is true."""

    def __init__(self, clock: ManualClock, held: Callable[[], bool] = lambda: False) -> None:
        self.clock = clock
        self.held = held
        self.released = False

    def isOpened(self) -> bool:
        return True

    def read(self) -> tuple[bool, np.ndarray]:
        while self.held():
            os.sched_yield()
        self.clock.advance(1.0 / 30.0)
        return True, np.dstack([picture(1)] * 3)

    def get(self, key: int, /) -> float:
        return 0.0

    def release(self) -> None:
        self.released = True


def make_folder(folder: Path) -> ImageFolder:
    folder.mkdir()
    for number in range(COUNT):
        cv2.imwrite(str(folder / f"frame{number}.png"), picture(number))
    return ImageFolder(str(folder))


def make_pattern(folder: Path) -> ImageFolder:
    make_folder(folder)
    cv2.imwrite(str(folder / "other1.png"), picture(0)[:10])
    return ImageFolder(str(folder / "frame*.png"))


def make_video(folder: Path) -> VideoFile:
    folder.mkdir()
    path = folder / "film.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, SHAPE[::-1])
    for number in range(COUNT):
        writer.write(np.dstack([picture(number)] * 3))
    writer.release()
    return VideoFile(str(path))


def make_camera(folder: Path) -> OpenCvCamera:
    clock = ManualClock()

    def held() -> bool:  # a reader that is late would miss the first frames, as it must
        return camera._frames.full() and not camera._stop.is_set()

    camera = OpenCvCamera(folder.name, clock=clock, open_capture=lambda _: FakeCapture(clock, held))
    return camera


SOURCES: dict[str, Callable[[Path], FrameSource]] = {
    "folder": make_folder,
    "pattern": make_pattern,
    "video": make_video,
    "camera": make_camera,
}


@pytest.fixture(params=SOURCES)
def source(request: pytest.FixtureRequest, tmp_path: Path) -> FrameSource:
    return SOURCES[request.param](tmp_path / "source")


def test_frames_carry_rising_time_and_number_and_their_origin(source: FrameSource) -> None:
    with source, closing(iter(source)) as frames:
        got = list(islice(frames, COUNT))
    assert len(got) == COUNT
    assert (np.diff([frame.t_s for frame in got]) > 0.0).all()
    assert (np.diff([frame.sequence for frame in got]) > 0).all()
    assert all(frame.source for frame in got)
    assert {frame.image.shape for frame in got} == {SHAPE}


def test_files_give_every_frame_once_in_natural_order_and_can_be_read_again(source: FrameSource) -> None:
    with source:
        if source.total is None:
            pytest.skip("a live camera has no total and cannot be rewound")
        assert source.total == COUNT
    for _ in range(2):
        with source:
            got = list(source)
        assert [frame.sequence for frame in got] == list(range(COUNT))
        levels = [float(frame.image[:, 40:].mean()) for frame in got]
        np.testing.assert_allclose(levels, 10.0 * np.arange(COUNT), atol=3.0)  # a codec may be off by a grey level


def test_closing_is_legal_at_any_time_and_early(source: FrameSource) -> None:
    source.__exit__(None, None, None)
    with source:
        frames = iter(source)
        next(frames)
        frames.close()  # type: ignore[attr-defined]
    source.__exit__(None, None, None)


def test_constructors_open_nothing() -> None:
    def never(_: str) -> FakeCapture:
        raise AssertionError("opened by the constructor")

    ImageFolder("/no/such/folder")
    VideoFile("/no/such/video.avi", open_capture=never)
    OpenCvCamera("7", open_capture=never)


@pytest.mark.parametrize("lost", [ImageFolder("/no/such"), VideoFile("/no/such.avi"), OpenCvCamera("/no/such")])
def test_what_is_not_there_is_said_on_opening(lost: FrameSource) -> None:
    with pytest.raises(ArmsightError) as info, lost:
        pass
    assert "/no/such" in info.value.cause
    assert info.value.consequence
    assert info.value.cure


def files_in_pairs(folder: Path) -> FileMoments:
    folder.mkdir()
    return FileMoments(make_folder(folder / "left"), make_folder(folder / "right"))


def videos_in_pairs(folder: Path) -> FileMoments:
    folder.mkdir()
    return FileMoments(make_video(folder / "left"), make_video(folder / "right"))


def cameras_in_pairs(folder: Path) -> TimedMoments:
    return TimedMoments(make_camera(folder / "0"), make_camera(folder / "1"), max_skew_s=1e9)


def halves(folder: Path) -> OneImage:
    return OneImage(make_folder(folder), (24, SHAPE[0]), (40, SHAPE[0]))


PAIRS: dict[str, Callable[[Path], MomentSource]] = {
    "files": files_in_pairs,
    "videos": videos_in_pairs,
    "cameras": cameras_in_pairs,
    "halves": halves,
}


@pytest.fixture(params=PAIRS)
def pairs(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[MomentSource]:
    yield PAIRS[request.param](tmp_path / "pairs")


def test_pairs_are_in_step(pairs: MomentSource) -> None:
    with pairs, closing(iter(pairs)) as both:
        total = pairs.total
        got = list(islice(both, COUNT))
        skew = pairs.skew
    assert len(got) == COUNT
    assert total in (COUNT, None)
    for left, right in got:
        assert skew is not None or (left.t_s, left.sequence) == (right.t_s, right.sequence)
        assert left.image.shape[0] == right.image.shape[0] == SHAPE[0]
    assert (np.diff([left.t_s for left, _ in got]) > 0.0).all()
    if skew is not None:
        assert skew.n_pairs == COUNT
