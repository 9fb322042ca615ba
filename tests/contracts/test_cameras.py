"""The shipped contract of cameras: every source of frames passes it, and each planted fault fails it by name."""

from __future__ import annotations

import os
import subprocess
import sys
from collections.abc import Callable, Iterator
from dataclasses import replace
from functools import cache
from importlib.resources import files
from pathlib import Path
from types import TracebackType
from typing import Any

import cv2
import numpy as np
import pytest
import yaml

from armsight.clock import ManualClock
from armsight.drivers import (
    DeviceLock,
    FileMoments,
    ImageFolder,
    OneImage,
    OpenCvCamera,
    Replay,
    ReplayRobot,
    RobotState,
    VideoFile,
    open_source,
)
from armsight.drivers.aravis import AravisCamera
from armsight.errors import DeviceFailed, DeviceNotFound, Inconsistent, StaleData, UsageError
from armsight.ops.sources.bags import BagFrames
from armsight.records import Frame, Motion
from armsight.testing import CameraCase, CameraContract, RobotCase, RobotReadingContract, contract_tests
from armsight.testing.genicam import ADDRESS, fake_genicam_camera, missing
from armsight_sim.devices import SimCameraView
from armsight_sim.scenario_builder import build_world
from armsight_sim.scenario_schema import Scenario
from armsight_sim.world import World
from refusals import refuses

COUNT = 9


def pictures(count: int = COUNT) -> list[np.ndarray]:
    rng = np.random.default_rng(2)
    return [rng.integers(0, 255, (48, 64), dtype=np.uint8) for _ in range(count)]


def folder(where: Path) -> ImageFolder:
    where.mkdir(exist_ok=True)
    for number, image in enumerate(pictures()):
        cv2.imwrite(str(where / f"{number}.png"), image)
    return ImageFolder(str(where))


@cache
def small_stage(name: str, frames: int = COUNT) -> World:
    content = yaml.safe_load((files("armsight_sim") / "scenarios" / f"{name}.yaml").read_text())
    world: World = build_world(Scenario.model_validate(content), frames=frames)
    return world


class FakeCapture:
    """A wire on which frames come a clock's tick apart, as fast as they are asked for; held: not while this is true."""

    def __init__(self, clock: ManualClock, held: Callable[[], bool] = lambda: False) -> None:
        self.clock = clock
        self.held = held
        self.released = False
        self.images = iter(pictures(10_000))

    def isOpened(self) -> bool:
        return not self.released

    def read(self) -> tuple[bool, np.ndarray]:
        while self.held():
            os.sched_yield()
        self.clock.advance(1.0 / 30.0)
        return True, np.dstack([next(self.images)] * 3)

    def get(self, key: int, /) -> float:
        return 0.0

    def release(self) -> None:
        self.released = True


class TestFolder(CameraContract):
    @pytest.fixture(autouse=True)
    def _place(self, tmp_path: Path) -> None:
        self.place = tmp_path

    def make(self) -> CameraCase:
        return CameraCase(source=folder(self.place / "left"), moves=True)


class TestFilePairs(TestFolder):
    def make(self) -> CameraCase:
        return CameraCase(source=FileMoments(folder(self.place / "left"), folder(self.place / "right")), moves=True)


class TestSplitImages(TestFolder):
    def make(self) -> CameraCase:
        return CameraCase(source=OneImage(folder(self.place / "both"), (32, 48), (32, 48)), moves=True)


class TestVideo(TestFolder):
    def make(self) -> CameraCase:
        path = self.place / "film.avi"
        writer = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 25.0, (64, 48))
        for image in pictures():
            writer.write(np.dstack([image] * 3))
        writer.release()
        return CameraCase(source=VideoFile(str(path)), moves=True)


class TestOpenCvCamera(CameraContract):
    def make(self) -> CameraCase:
        clock = ManualClock()
        wires: list[FakeCapture] = []

        def wire(_: str) -> FakeCapture:
            wires.append(FakeCapture(clock, held))
            return wires[-1]

        def held() -> bool:  # a reader that is late would miss the first frames, as it must
            return camera._frames.full() and not camera._stop.is_set()

        camera = OpenCvCamera("0", clock=clock, open_capture=wire)
        opened = lambda: bool(wires) and not wires[-1].released  # noqa: E731
        return CameraCase(source=camera, opened=opened, moves=True, again=False)


MISSING = missing()


class HeldCamera(AravisCamera):
    """Drops no frame of a reader that is late, as the contract's must not be."""

    def _put(self, item: Any) -> None:
        while self._frames.full() and not self._stop.is_set():
            os.sched_yield()
        super()._put(item)


@pytest.fixture(scope="class")
def played(tmp_path_factory: pytest.TempPathFactory) -> Iterator[None]:
    """Aravis's fake camera, showing the pictures in turn."""
    with folder(tmp_path_factory.mktemp("genicam")) as shown, fake_genicam_camera(shown.paths):
        yield


@pytest.mark.skipif(bool(MISSING), reason=f"no GenICam camera can be played here: {MISSING}")
@pytest.mark.usefixtures("played")
class TestAravisCamera(CameraContract):
    def make(self) -> CameraCase:
        source = HeldCamera(ADDRESS)
        return CameraCase(source=source, opened=lambda: source._camera is not None, moves=True, again=False)


class TestBag(TestFolder):
    """One topic of a ROS 2 bag; tests/unit/cli/test_bags.py tries every kind of bag."""

    def make(self) -> CameraCase:
        rosbag2 = pytest.importorskip("rosbags.rosbag2", reason="the extra armsight[bags] is not installed")
        from rosbags.typesys import Stores, get_typestore

        types, kind = get_typestore(Stores.ROS2_HUMBLE), "sensor_msgs/msg/CompressedImage"
        path = self.place / "bag"
        with rosbag2.Writer(path, version=9) as writer:
            topic = writer.add_connection("/left", kind, typestore=types)
            for number, image in enumerate(pictures()):
                stamp = types.types["builtin_interfaces/msg/Time"](sec=1_700_000_000, nanosec=33_000_000 * number)
                message = types.types[kind](
                    header=types.types["std_msgs/msg/Header"](stamp=stamp, frame_id="left"),
                    format="png",
                    data=cv2.imencode(".png", image)[1].ravel(),
                )
                written_ns = 1_700_000_000 * 10**9 + 33_000_000 * number
                writer.write(topic, written_ns, types.serialize_cdr(message, kind))
        source = BagFrames(f"bag:{path}:/left")
        return CameraCase(source=source, opened=lambda: source.opened, moves=True)


class TestReplay(CameraContract):
    def make(self) -> CameraCase:
        def items() -> Iterator[Frame]:
            for number, image in enumerate(pictures()):
                yield Frame(image=image, t_s=7.0 + 0.1 * number, sequence=number, source="recording")

        source: Replay[Frame] = Replay("recording", items, speed=2.0, clock=ManualClock(), total=COUNT)
        return CameraCase(source=source, opened=lambda: source.opened, moves=True)


class TestSimulatedCamera(CameraContract):
    def make(self) -> CameraCase:
        source = SimCameraView(small_stage("webcam-cell"), ManualClock(50.0), "left")
        return CameraCase(source=source, opened=lambda: source.opened, moves=True)


class TestSimulatedMirrorCamera(CameraContract):
    def make(self) -> CameraCase:
        source = SimCameraView(small_stage("pachidis2005-static"), ManualClock(), "image")
        return CameraCase(source=source, opened=lambda: source.opened, moves=True)


class Sound:
    """A source that keeps the contract; the faulty ones below differ in one thing each."""

    name = "sound"
    total: int | None = COUNT

    def __init__(self) -> None:
        self.open = False
        self.images = pictures()

    def __enter__(self) -> Any:
        self.open = True
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.open = False

    def frame(self, number: int) -> Frame:
        return Frame(image=self.images[number], t_s=0.1 * number, sequence=number, source=self.name)

    def __iter__(self) -> Iterator[Frame]:
        for number in range(COUNT):
            yield self.frame(number)


class OpensAtOnce(Sound):
    def __init__(self) -> None:
        super().__init__()
        self.open = True


class TimeRunsBackwards(Sound):
    def frame(self, number: int) -> Frame:
        return replace(super().frame(number), t_s=-0.1 * number)


class NumberStandsStill(Sound):
    def frame(self, number: int) -> Frame:
        return replace(super().frame(number), sequence=0)


class CountsFromOne(Sound):
    def frame(self, number: int) -> Frame:
        return replace(super().frame(number), sequence=number + 1)


class NoSource(Sound):
    def frame(self, number: int) -> Frame:
        return replace(super().frame(number), source="")


class NegativeExposure(Sound):
    def frame(self, number: int) -> Frame:
        return replace(super().frame(number), exposure_s=-1.0)


class ChangesItsSize(Sound):
    def frame(self, number: int) -> Frame:
        return replace(super().frame(number), image=self.images[number][: 48 - number])


class OneBuffer(Sound):
    def frame(self, number: int) -> Frame:
        self.images[0][:] = self.images[number]
        return replace(super().frame(number), image=self.images[0])


class FrozenPicture(Sound):
    def frame(self, number: int) -> Frame:
        return replace(super().frame(number), image=self.images[0])


class StaysOpen(Sound):
    def __exit__(self, *error: object) -> None:
        pass


class GoesOnWhereItStopped(Sound):
    def __init__(self) -> None:
        super().__init__()
        self.rest = iter(range(COUNT))

    def __iter__(self) -> Iterator[Frame]:
        for number in self.rest:
            yield replace(self.frame(number), sequence=number)


class PromisesMore(Sound):
    total = COUNT + 1


FAULTS: dict[type[Sound], str] = {
    OpensAtOnce: "test_the_constructor_opens_nothing",
    TimeRunsBackwards: "test_frames_carry_time_number_and_source",
    NumberStandsStill: "test_frames_carry_time_number_and_source",
    NoSource: "test_frames_carry_time_number_and_source",
    NegativeExposure: "test_frames_carry_time_number_and_source",
    CountsFromOne: "test_numbers_begin_at_zero",
    ChangesItsSize: "test_all_frames_are_of_one_shape",
    OneBuffer: "test_a_frame_is_not_written_over",
    FrozenPicture: "test_the_picture_is_not_frozen",
    StaysOpen: "test_reading_may_stop_half_way",
    GoesOnWhereItStopped: "test_it_can_be_read_again",
    PromisesMore: "test_the_total_is_right",
}


def contract_on(kind: Callable[[], Sound]) -> CameraContract:
    def make() -> CameraCase:
        source = kind()
        return CameraCase(source=source, opened=lambda: source.open, moves=True)

    contract = CameraContract()
    contract.make = make  # type: ignore[method-assign]
    return contract


@pytest.mark.parametrize("kind", FAULTS, ids=lambda kind: kind.__name__)
def test_a_planted_fault_is_found(kind: type[Sound]) -> None:
    with refuses(AssertionError, "contract"):
        getattr(contract_on(kind), FAULTS[kind])()


def test_every_test_of_the_contract_finds_a_fault_and_lets_a_sound_driver_pass() -> None:
    assert set(contract_tests(CameraContract)) == set(FAULTS.values())
    for name in contract_tests(CameraContract):
        getattr(contract_on(Sound), name)()


def test_a_replay_waits_as_the_recording_did() -> None:
    frames = [Frame(image=pictures(1)[0], t_s=t, sequence=i, source="r") for i, t in enumerate((5.0, 5.5, 7.0))]
    for speed, times in ((1.0, [10.0, 10.5, 12.0]), (4.0, [10.0, 10.125, 10.5]), (0.0, [10.0, 10.0, 10.0])):
        clock = ManualClock(10.0)
        with Replay("r", lambda: frames, speed=speed, clock=clock) as replay:
            assert [clock.now_s() for _ in replay] == pytest.approx(times)


def test_a_replay_whose_time_runs_backwards_is_refused() -> None:
    frames = [Frame(image=pictures(1)[0], t_s=t, sequence=i, source="r") for i, t in enumerate((5.0, 5.5, 5.2))]
    seen: list[float] = []
    with Replay("r", lambda: frames, clock=ManualClock()) as replay, pytest.raises(Inconsistent, match="backwards"):
        seen.extend(frame.t_s for frame in replay)
    with pytest.raises(UsageError):
        Replay("r", lambda: frames, speed=-1.0)


def recorded() -> Motion:
    t_s = 3.0 + 0.028 * np.arange(2000)
    return Motion(t_s=t_s, q=np.stack([np.sin(t_s), np.cos(t_s)], axis=1))


class TestReplayedRobot(RobotReadingContract):
    def make(self) -> RobotCase:
        clock = ManualClock(40.0)
        return RobotCase(robot=ReplayRobot("arm", recorded(), clock=clock), advance=clock.advance)


def test_a_replayed_robot_ends_with_its_recording_and_can_be_held() -> None:
    clock = ManualClock()
    with ReplayRobot("arm", recorded(), speed=2.0, clock=clock) as robot:
        clock.advance(0.5)
        assert robot.read().t_s == pytest.approx(4.0, abs=0.029)
        robot.stop()
        clock.advance(100.0)
        assert robot.read().t_s == pytest.approx(4.0, abs=0.029)
        robot.reset()
        clock.advance(0.5)
        assert robot.read().t_s == pytest.approx(5.0, abs=0.029)
        clock.advance(1000.0)
        assert robot.state is RobotState.LOST
        with pytest.raises(StaleData):
            robot.read()


def test_a_camera_that_another_process_holds_is_refused_by_its_number(tmp_path: Path) -> None:
    script = (
        "import sys; from pathlib import Path; from armsight.drivers import DeviceLock\n"
        f"with DeviceLock('camera:0', folder=Path({str(tmp_path)!r})):\n"
        "    print('held', flush=True); sys.stdin.read()\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", script], stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
    ) as other:
        assert other.stdout is not None and other.stdout.readline().strip() == "held"
        lock = DeviceLock("camera:0", folder=tmp_path)
        with refuses(DeviceFailed, "in use", other.pid):
            lock.__enter__()
        with DeviceLock("camera:1", folder=tmp_path):
            pass
        other.communicate("")
    with lock:
        pass


def test_a_camera_whose_lock_is_held_stays_closed_and_frees_it_when_it_closes(tmp_path: Path) -> None:
    clock = ManualClock()

    def camera() -> OpenCvCamera:
        return OpenCvCamera(
            "0", clock=clock, open_capture=lambda _: FakeCapture(clock), lock=DeviceLock("camera:0", folder=tmp_path)
        )

    with camera(), refuses(DeviceFailed, "in use"):
        camera().__enter__()
    with camera():
        pass


def test_a_scenario_s_camera_is_opened_by_name() -> None:
    source = open_source("camera:sim:webcam-cell:right", clock=ManualClock(50.0))
    with source:
        frame = next(iter(source))
    assert frame.image.shape == (720, 1280) and frame.source.endswith("right")
    for unknown in ("webcam-cell", "webcam-cell:image", "nothing:left"):
        with pytest.raises(DeviceNotFound):
            open_source(f"camera:sim:{unknown}")
