"""Folders, videos and pairs of them with planted faults."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from armsight.drivers import Ahead, FileMoments, ImageFolder, VideoFile, ahead, open_source, sources
from armsight.errors import BadImage, Inconsistent
from armsight.ops.sources.cameras import open_rig
from armsight.optics import SIDES
from refusals import refuses

BLACK = np.zeros((40, 60), np.uint8)


def folder_of(path: Path, names: list[str]) -> ImageFolder:
    path.mkdir()
    for name in names:
        cv2.imwrite(str(path / name), BLACK)
    return ImageFolder(str(path))


def video_of(path: Path, count: int) -> Path:
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (60, 40))
    for _ in range(count):
        writer.write(np.zeros((40, 60, 3), np.uint8))
    writer.release()
    return path


def numbered(*numbers: int) -> list[str]:
    return [f"shot{number}.png" for number in numbers]


def test_an_image_of_another_size_stops_the_source_and_names_both(tmp_path: Path) -> None:
    source = folder_of(tmp_path / "a", numbered(1, 2, 3))
    cv2.imwrite(str(tmp_path / "a" / "shot2.png"), BLACK[:20])
    with source:
        frames = iter(source)
        next(frames)
        with refuses(Inconsistent, "shot2.png", "60x20", "shot1.png", "60x40"):
            next(frames)


@pytest.mark.parametrize(
    ("left", "right", "text"),
    [((1, 2, 3), (1, 2), ("3 images", "2", "shot3.png")), ((1, 2, 4), (1, 2, 3), ("partner", "shot3.png"))],
)
def test_unpaired_images_are_refused_before_anything_is_read(tmp_path: Path, left, right, text) -> None:
    pairs = FileMoments(folder_of(tmp_path / "left", numbered(*left)), folder_of(tmp_path / "right", numbered(*right)))
    with refuses(Inconsistent, text), pairs:
        pass


def test_a_video_shorter_than_its_partner_ends_the_pairs_with_a_reason(tmp_path: Path) -> None:
    left, right = video_of(tmp_path / "l.avi", 9), video_of(tmp_path / "r.avi", 14)
    count = 0
    with open_rig(SIDES, str(left), str(right)) as pairs, refuses(Inconsistent, "l.avi", "9 frames"):
        for _ in pairs:
            count += 1
    assert count == 9


def test_a_video_that_breaks_off_is_told_from_one_that_ends(tmp_path: Path) -> None:
    path = video_of(tmp_path / "film.avi", 40)

    class Broken:
        def __init__(self, name: str) -> None:
            self.capture, self.left = cv2.VideoCapture(name), 25

        def isOpened(self) -> bool:
            return self.capture.isOpened()

        def read(self):
            self.left -= 1
            return self.capture.read() if self.left >= 0 else (False, None)

        def get(self, key: int, /) -> float:
            return self.capture.get(key)

        def release(self) -> None:
            self.capture.release()

    with VideoFile(str(path)) as whole:
        assert len(list(whole)) == 40
    got = []
    broken = VideoFile(str(path), open_capture=Broken)
    with refuses(BadImage, "25 frames", "40"), broken:
        got.extend(frame.t_s for frame in broken)
    np.testing.assert_allclose(got, np.arange(25) / 25.0, atol=1e-6)


def test_times_replace_the_rate_and_must_be_as_many_as_the_frames(tmp_path: Path) -> None:
    source = folder_of(tmp_path / "a", numbered(1, 2, 3))
    with open_source(source.name, times_s=[5.0, 6.0, 9.0]) as frames:
        assert [frame.t_s for frame in frames] == [5.0, 6.0, 9.0]
    with open_source(source.name, fps=10.0) as frames:
        assert [frame.t_s for frame in frames] == [0.0, 0.1, 0.2]
    for count in (2, 4):
        with refuses(Inconsistent, f"{count} time stamps"), open_source(source.name, times_s=np.arange(count)):
            pass
    video = video_of(tmp_path / "film.avi", 5)
    for count in (4, 6):
        with open_source(str(video), times_s=np.arange(count)) as frames, refuses(Inconsistent, "time stamps"):
            list(frames)


def test_Ahead_keeps_order_bounds_what_waits_and_raises_in_place() -> None:
    begun: list[int] = []

    def work(number: int) -> int:
        begun.append(number)
        if number == 7:
            raise ValueError("seven")
        return number

    results = Ahead(work, range(1000), workers=3, ahead=4)
    assert [next(results) for _ in range(7)] == list(range(7))
    assert len(begun) <= 7 + 5
    with pytest.raises(ValueError, match="seven"):
        next(results)


def test_what_the_items_raise_comes_behind_the_results_before_it() -> None:
    def items() -> Iterator[int]:
        yield from range(5)
        raise ValueError("six")

    results = Ahead(lambda number: number, items(), ahead=20)
    assert [next(results) for _ in range(5)] == list(range(5))
    with pytest.raises(ValueError, match="six"):
        next(results)


class Watched:
    """A capture that tells when its first picture is asked for, and whether it was released while one was read."""

    def __init__(self) -> None:
        self.begun, self.busy, self.released = threading.Event(), False, ""

    def isOpened(self) -> bool:
        return True

    def set(self, key: int, value: float, /) -> bool:
        return True

    def get(self, key: int, /) -> float:
        return 0.0

    def read(self):
        self.begun.set()
        self.busy = True
        for _ in range(20):
            os.sched_yield()
        self.busy = False
        return True, BLACK

    def release(self) -> None:
        self.released = "while a picture was read" if self.busy else "at rest"


def test_a_video_is_read_from_iter_on_and_released_when_its_reader_rests(tmp_path: Path) -> None:
    (tmp_path / "film.mp4").touch()
    wires = [Watched(), Watched()]
    videos = [VideoFile(str(tmp_path / "film.mp4"), open_capture=lambda _, wire=wire: wire) for wire in wires]
    with FileMoments(*videos) as moments:
        frames = iter(moments)
        assert all(wire.begun.wait(30.0) for wire in wires)  # nothing was asked for
        next(frames)
    assert [wire.released for wire in wires] == ["at rest", "at rest"]


def test_a_wait_for_a_file_is_told_once_and_nothing_is_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    source, told, mended = folder_of(tmp_path / "a", numbered(1, 2, 3)), [], threading.Event()

    def hear(text: str, **_: object) -> None:
        told.append(text)
        mended.set()

    def stalled(path: Path, **_: object) -> np.ndarray:
        assert mended.wait(30.0)
        return BLACK

    monkeypatch.setattr(ahead, "STALLED_S", 0.0)
    monkeypatch.setattr(sources, "read_pixels", stalled)
    monkeypatch.setattr(ahead.warnings, "warn", hear)
    with source:
        assert len(list(source)) == 3
    assert len(told) == 1 and source.name in told[0] and "waited for" in told[0]
