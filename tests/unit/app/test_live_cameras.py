"""Four cameras live: what a screen is told of each, one that is unplugged, one that is knocked, and what is refused."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests.truth.camera_ring import Ring, pose, ring
from tests.truth.test_knocked_camera import knocked
from tests.truth.test_views import draw, setup_of

from armsight import drivers
from armsight.app.live import measurement
from armsight.app.live.measurement import LiveJob, LiveMeasurement, MeasuredMoment
from armsight.app.live.station import _News, _Worker
from armsight.clock import ManualClock
from armsight.console.layout import level_of
from armsight.console.pages.live import camera_state
from armsight.console.state import Console, steps_of
from armsight.drivers import AUTOMATIC, TimedMoments, news_of
from armsight.errors import DeviceLost, Inconsistent, NotEnoughData, UsageError
from armsight.ops.calibrate_robot import calibrate_pivot
from armsight.ops.requests.motion import RobotJob
from armsight.ops.verification.live import open_supervised
from armsight.records import CameraTiming, Frame
from armsight.store import read_target, write_rig, write_target
from armsight.store.cell_file import CellFile
from refusals import names_it, refuses

NAMES = ("c0", "c1", "c2", "c3")
MOMENTS, UNPLUGGED = 12, 5


class Webcam:
    """A camera that gives pictures until it is unplugged."""

    total = None

    def __init__(self, name: str, frames: list[Frame], *, unplugged: bool) -> None:
        self.name, self.frames, self.unplugged = name, frames, unplugged

    def __enter__(self) -> Webcam:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def __iter__(self) -> Iterator[Frame]:
        yield from self.frames[:UNPLUGGED] if self.unplugged else self.frames
        if self.unplugged:
            raise DeviceLost(f"{self.name} stopped sending")


def filmed(world: Ring) -> dict[str, list[Frame]]:
    """Return what each camera sees of a target that moves on, by a world that shares no code."""
    rng = np.random.default_rng(4)
    T, out = pose(rng, tilt_rad=0.1), dict[str, list[Frame]]({name: [] for name in NAMES})
    for i in range(MOMENTS):
        T[:2, 3] += [0.004, -0.003]
        for name, frame in zip(NAMES, draw(world, T, rng), strict=True):
            out[name].append(replace(frame, t_s=0.2 * i, sequence=i))
    return out


@pytest.fixture(scope="module")
def cell(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder, setup = tmp_path_factory.mktemp("cell"), setup_of(ring(4))
    write_rig(folder / "rig.yaml", setup.rig)
    write_target(folder / "target.yaml", setup.target)
    return folder


def dark(number: int) -> Frame:
    return Frame(image=np.zeros((720, 1280), np.uint8), t_s=0.2 * number, sequence=number, source="dark")


def job(cell: Path) -> LiveJob:
    return LiveJob(cameras=dict.fromkeys(NAMES, "camera:0"), rig=cell / "rig.yaml", target=cell / "target.yaml")


def live(cell: Path, world: Ring, unplugged: str = "") -> list[MeasuredMoment]:
    films = filmed(world)
    webcams = [Webcam(name, films[name], unplugged=name == unplugged) for name in NAMES]
    made = LiveMeasurement(job(cell), ManualClock(), TimedMoments(*webcams, names=NAMES, tell=lambda _: None))
    with made.source:
        return list(made.moments())


@pytest.fixture(scope="module")
def unplugged(cell: Path) -> list[MeasuredMoment]:
    return live(cell, ring(4), unplugged="c1")


def test_each_camera_tells_what_it_sees(unplugged: list[MeasuredMoment]) -> None:
    first = unplugged[0].view
    assert first.status == "ok" and tuple(first.cameras) == NAMES and first.n_lights == 6
    for name, one in first.cameras.items():
        assert 3 <= len(one.names) <= 6 and one.epipolar == [], name
        residuals = np.array([spot.residual_px for spot in one.spots if spot.name])
        assert np.sqrt((residuals**2).sum(axis=1).mean()) < 0.3
        words, level = camera_state(one, first.n_lights)
        assert names_it(words, f"{len(one.names)} of 6") and level in ("good", "warn")


def test_a_camera_that_is_unplugged_is_told_once_and_the_others_go_on(
    unplugged: list[MeasuredMoment], tmp_path: Path
) -> None:
    last = unplugged[-1]
    assert len(unplugged) == MOMENTS and [one.view.status for one in unplugged] == ["ok"] * MOMENTS
    assert [name for name, one in last.view.cameras.items() if one.lost] == ["c1"]
    assert tuple(last.frames) == ("c0", "c2", "c3") and last.view.cameras["c1"].spots == []
    assert last.view.cameras["c1"].width == unplugged[0].view.cameras["c1"].width
    words, level = camera_state(last.view.cameras["c1"], 6)
    assert level == "bad" and names_it(words, "stopped sending", "start anew")
    told: list[Any] = []
    pipe: Any = SimpleNamespace(send=told.append)
    worker = _Worker(LiveJob(cameras=dict.fromkeys(NAMES, "camera:0")), pipe, pipe, ManualClock())
    for one in unplugged:
        worker._take(one)
    assert [names_it(one.text, "c1", "lost") for one in told if isinstance(one, _News)] == [True]
    station: Any = SimpleNamespace(shown=last, failure="", ended=False, silent_s=0.0)
    lamp = level_of(Console(folder=tmp_path, station=station))
    assert lamp.level == "warn" and names_it(lamp.words, "Measuring", "c1")


def test_a_camera_that_is_knocked_is_named_and_left_out(cell: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """By 5 px: before it is told, no pose takes any of its lights."""
    monkeypatch.setattr(measurement, "JUDGED", MOMENTS - 1)
    seen = live(cell, knocked(ring(4), 2, np.random.default_rng(4), np.radians(0.3)))
    last = seen[-1].view
    assert [name for name, one in last.cameras.items() if one.left_out] == ["c2"]
    assert last.status == "ok" and last.cameras["c2"].names == set() and len(last.cameras["c0"].names) >= 3
    words, level = camera_state(last.cameras["c2"], 6)
    assert level == "bad" and names_it(words, "c2", "--again c2")


def late_cameras(cameras: Any, *, tell: Any, **_: Any) -> TimedMoments:
    """Cameras in the dark, each 4 ms after the one before it."""
    films = [[replace(dark(k), t_s=0.2 * k + 0.004 * i) for k in range(40)] for i in range(len(cameras))]
    webcams = [Webcam(name, film, unplugged=False) for name, film in zip(cameras, films, strict=True)]
    return TimedMoments(*webcams, names=tuple(cameras), tell=tell)


@pytest.mark.parametrize("timed", [False, True])
def test_cameras_that_run_freely_are_told_by_all_that_watch_them(
    cell: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, timed: bool
) -> None:
    monkeypatch.setattr(drivers, "open_moments", late_cameras)
    rig, target = setup_of(ring(4)).rig, read_target(cell / "target.yaml")
    rig = replace(rig, timing=(CameraTiming(),) * 4) if timed else rig
    write_rig(tmp_path / "rig.yaml", rig)
    sources = {name: f"camera:{k}" for k, name in enumerate(NAMES)}
    told: list[Any] = []
    pipe: Any = SimpleNamespace(send=told.append)
    worker = _Worker(replace(job(cell), rig=tmp_path / "rig.yaml", cameras=sources), pipe, pipe, ManualClock())
    with worker._measurement.source:
        for moment in worker._measurement.moments():
            worker._take(moment)
    on_page = [one.text for one in told if isinstance(one, _News)]
    link, settings = RobotJob(robot="egm:6510"), {"play": False, "camera_settings": AUTOMATIC}
    devices: Any = open_supervised(link, rig, sources, target, ManualClock(), None, **settings)
    news: list[str] = []
    with devices.pairs as moments:
        supervised = [text for _ in moments for text in news_of(moments, news)]
    with warnings.catch_warnings(record=True) as caught, refuses(NotEnoughData, "tip"):
        warnings.simplefilter("always")
        calibrate_pivot(rig, target, cameras=sources)
    pivoted = [str(one.message) for one in caught]
    assert on_page == supervised == pivoted and len(pivoted) == (not timed)
    assert timed or names_it(pivoted[0], *NAMES, "calibrate timing")


WRONG = {
    "one is missing": (CellFile(cameras={"c0": "camera:0", "c1": "camera:1", "c2": "camera:2"}), "c3"),
    "another name": (CellFile(cameras={**{name: f"camera:{name}" for name in NAMES[:3]}, "top": "camera:9"}), "top"),
    "one source twice": (CellFile(cameras=dict.fromkeys(NAMES, "camera:0")), "c1"),
    "given twice": (CellFile(left="camera:0", right="camera:1", cameras={"left": "camera:2"}), "left"),
    "a reserved name": (CellFile(cameras={"complex": "camera:0"}), "complex"),
    "a recording alone": (CellFile(cameras={"c0": "all.mcap"}), "by its name"),
}


@pytest.mark.parametrize("case", WRONG)
def test_cameras_that_are_not_the_rigs_are_refused(cell: Path, case: str) -> None:
    file, told = WRONG[case]
    with refuses(Inconsistent if case == "a reserved name" else UsageError, told):
        Console(folder=cell).job_of(file.model_copy(update={"rig": "rig.yaml"}))


def test_cameras_are_measured_in_the_rigs_order_and_have_their_steps(cell: Path) -> None:
    file = CellFile(cameras={name: f"camera:{name}" for name in reversed(NAMES)}, rig="rig.yaml")
    console = Console(folder=cell, cell=file)
    made = console.job_of(file)
    assert made is not None and tuple(made.cameras) == NAMES and not made.complex and made.live
    steps = steps_of(console)
    assert steps[4] == "cameras" and set(steps[:4]) == {f"camera-{name}" for name in NAMES}
    assert not {"stereo", "mirrors"} & set(steps)
    assert console.step("camera-c3").step.name == "camera-c3" and console.step("cameras").step.name == "cameras"
