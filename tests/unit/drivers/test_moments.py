"""Moments of three cameras and more: a missing frame is a missing view, a lost camera is told and the rest go on."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import cv2
import numpy as np
import pytest

from armsight.drivers import (
    MAX_SKEW_S,
    FileMoments,
    ImageFolder,
    ImageReading,
    Moment,
    RecordedMoments,
    TimedMoments,
    news_of,
    open_moments,
)
from armsight.errors import DeviceLost, Inconsistent
from armsight.ops.flags import cameras_of as read_cameras
from armsight.ops.sources.cameras import cameras_of, named_cameras, open_cameras
from armsight.records import Frame
from refusals import names_it, refuses

NAMES = ("a", "b", "c")


class Camera:
    """A source whose frames come at given times, and which is then lost where `lost` says so."""

    total = None

    def __init__(self, name: str, times_s: list[float], *, lost: bool = False) -> None:
        self.name, self.times_s, self.lost = name, times_s, lost

    def __enter__(self) -> Camera:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __iter__(self) -> Iterator[Frame]:
        for sequence, t_s in enumerate(self.times_s):
            yield Frame(image=np.zeros((4, 6), np.uint8), t_s=t_s, sequence=sequence, source=self.name)
        if self.lost:
            raise DeviceLost(f"{self.name} stopped sending")


def ticks(n: int, late_s: float = 0.0, leave_out: tuple[int, ...] = ()) -> list[float]:
    return [k / 30.0 + late_s for k in range(n) if k not in leave_out]


def read(moments, told: list[str] | None = None) -> list[tuple[int | None, ...]]:
    """Return for each moment which tick of the clock each camera's frame is of."""
    with moments:
        return [tuple(None if frame is None else round(frame.t_s * 30.0) for frame in one) for one in moments]


def test_a_frame_that_is_missing_is_a_missing_view() -> None:
    told: list[str] = []
    cameras = Camera("0", ticks(6)), Camera("1", ticks(6, 0.004, (2, 3))), Camera("2", ticks(6, -0.003, (0, 3)))
    moments = TimedMoments(*cameras, names=NAMES, tell=told.append)
    assert read(moments) == [(0, 0, None), (1, 1, 1), (2, None, 2), (4, 4, 4), (5, 5, 5)]
    assert moments.n_dropped == 1  # of tick 3, which the first camera alone has
    assert told == []
    skew = moments.skew
    assert skew is not None
    assert skew.largest_s == pytest.approx(0.007)
    assert skew.n_pairs == 5


@pytest.mark.parametrize("k", [0, 1, 2])
def test_a_camera_that_is_lost_is_told_at_once_and_the_others_go_on(k: int) -> None:
    told: list[str] = []
    cameras = [Camera(str(j), ticks(4 if j == k else 9), lost=j == k) for j in range(3)]
    moments = TimedMoments(*cameras, names=NAMES, tell=told.append)
    with moments:
        at = [(len(told), tuple(frame is not None for frame in one)) for one in moments]
    rest = tuple(j != k for j in range(3))
    assert at == [(0, (True,) * 3)] * 4 + [(1, rest)] * 5
    assert list(moments.lost) == [NAMES[k]]
    assert NAMES[k] in told[0] and "stopped sending" in told[0]


def test_the_run_ends_where_too_few_are_left_and_of_a_pair_at_once() -> None:
    told: list[str] = []
    cameras = [Camera(str(j), ticks(n), lost=True) for j, n in enumerate((9, 4, 6))]
    moments = TimedMoments(*cameras, names=NAMES, tell=told.append)
    got: list[Moment] = []
    with refuses(DeviceLost, "2", "stopped"), moments:
        got.extend(moments)
    assert (len(got), len(told)) == (6, 1)
    pair = TimedMoments(Camera("0", ticks(9)), Camera("1", ticks(4), lost=True), tell=told.append)
    with refuses(DeviceLost, "1", "stopped"), pair:
        list(pair)
    assert len(told) == 1
    alone = TimedMoments(Camera("0", ticks(3)), names=("a",))
    assert read(alone) == [(0,), (1,), (2,)]


@pytest.mark.parametrize("views", [2, 3])
def test_cameras_that_run_free_are_told_once_where_nothing_says_when_they_expose(views: int) -> None:
    def told(late_s: float, *, untimed: bool = True, jitter_s: float = 0.0) -> list[str]:
        out: list[str] = []
        rng, late = np.random.default_rng(views), (0.0, late_s, 0.5 * late_s)[:views]
        cameras = [Camera(str(k), [t + rng.normal(0.0, jitter_s) for t in ticks(90, at)]) for k, at in enumerate(late)]
        moments = TimedMoments(*cameras, names=NAMES[:views], tell=out.append)
        moments.untimed = untimed
        news: list[str] = []
        with moments:
            said = [text for _ in moments for text in news_of(moments, news)]
        assert said == out
        return out

    (one,) = told(0.009)
    assert names_it(one, *NAMES[:views]) and names_it(one, "calibrate timing")
    assert not told(0.009, untimed=False)
    assert not told(0.0, jitter_s=1.5e-3)  # of triggered cameras


def test_a_clock_seconds_apart_is_told_or_refused() -> None:
    told: list[str] = []

    def cameras() -> list[Camera]:
        return [Camera("0", ticks(100)), Camera("1", ticks(100, 0.002)), Camera("2", ticks(100, 5.0))]

    live = TimedMoments(*cameras(), names=NAMES, tell=told.append)
    assert len(read(live)) == 100
    assert list(live.lost) == ["c"]
    assert "from theirs" in told[0]
    with refuses(Inconsistent, "2", "60 moments", "one clock"):
        read(RecordedMoments(*cameras(), names=NAMES))


def test_a_camera_apart_is_told_with_its_cure_and_each_cure_keeps_it() -> None:
    def lost(late_s: float, max_skew_s: float = MAX_SKEW_S) -> list[str]:
        told: list[str] = []
        times = ([0.1 * k + late for k in range(100)] for late in (0.0, 0.002, late_s))
        cameras = [Camera(str(j), each) for j, each in enumerate(times)]
        read(TimedMoments(*cameras, names=NAMES, tell=told.append, max_skew_s=max_skew_s))
        return told

    (told,) = lost(0.04)
    assert "camera c" in told
    assert names_it(told, "frame rate", "--max-skew")
    assert not lost(0.004)
    assert not lost(0.04, max_skew_s=0.05)


def folder_of(path: Path, numbers: tuple[int, ...], broken: tuple[int, ...] = ()) -> ImageFolder:
    path.mkdir()
    for number in numbers:
        cv2.imwrite(str(path / f"shot{number}.png"), np.full((40, 60), number, np.uint8))
        if number in broken:
            (path / f"shot{number}.png").write_bytes(b"\x89PNG")
    return ImageFolder(str(path), reading=ImageReading(strict=False))


def test_images_are_put_together_by_their_numbers(tmp_path: Path) -> None:
    numbers = (range(1, 8), (1, 2, 3, 5, 6, 7), (2, 3, 4, 5, 6, 7))
    folders = [folder_of(tmp_path / name, tuple(each)) for name, each in zip(NAMES, numbers, strict=True)]
    with FileMoments(*folders, names=NAMES) as moments:
        read = list(moments)
    got = [tuple(None if frame is None else int(frame.image[0, 0]) for frame in one) for one in read]
    assert [{frame.t_s for frame in one.there} for one in read] == [{k / 30.0} for k in range(7)]
    assert got == [(1, 1, None), (2, 2, 2), (3, 3, 3), (4, None, 4), (5, 5, 5), (6, 6, 6), (7, 7, 7)]


def test_cameras_are_taken_by_name_in_the_rigs_order(tmp_path: Path) -> None:
    given = named_cameras(read_cameras(["top=t", "left=rec.mcap"]), right="rec.mcap")
    assert cameras_of(("left", "right", "top"), given) == {"left": "rec.mcap", "right": "rec.mcap", "top": "t"}
    for name in NAMES:
        folder_of(tmp_path / name, (1, 2))
    with open_cameras({name: str(tmp_path / name) for name in NAMES}) as moments:
        assert (moments.names, moments.total) == (NAMES, 2)
        assert isinstance(moments, FileMoments)
    assert isinstance(open_moments({"a": "camera:0", "b": "camera:1", "c": "camera:2"}), TimedMoments)
