"""Both cameras recorded beside a motion, in a process of their own: from before it until after it, or it stops."""

from __future__ import annotations

import os
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight.errors import ArmsightError, Cancelled, DeviceFailed, DeviceLost, DeviceNotFound, UsageError
from armsight.ops import robots
from armsight.ops.recording import free_cameras
from armsight.ops.recording.free_cameras import SILENT_S, CameraRecorded, FreeCameras, FreeJob, record_free
from armsight.ops.robot import run_motion as run_motion_module
from armsight.ops.robot.opening import ClockedRobot, open_robot
from armsight.ops.robot.run_motion import RunMotionOutput
from armsight.ops.sources.frames import camera_source
from armsight.records import Frame, Motion, Silent
from armsight.store.recording import Recording
from armsight.store.tracks import read_joints, write_joints
from refusals import refuses
from robot_runs import acted

AHEAD_S = 1000.0
PATIENCE_S = 60.0
DRIVER = f"""
import itertools
from pathlib import Path
import numpy as np
from armsight.clock import SystemClock
from armsight.errors import DeviceLost, DeviceNotFound
from armsight.ops import robots
from armsight.records import Frame

class Camera:
    '''A camera of one's own. ahead: by a clock of its own. /FILE: until that is there. absent: cannot be opened.'''
    total = None

    def __init__(self, device, *, colour, clock, origin_s):
        self.name, self.device, self.clock = f"camera:trial:{{device}}", device, SystemClock()

    def __enter__(self):
        if self.device == "absent":
            raise DeviceNotFound("camera:trial:absent cannot be opened")
        return self

    def __exit__(self, *_):
        pass

    def __iter__(self):
        ahead_s = {AHEAD_S} if self.device == "ahead" else 0.0
        hz = 100.0 if self.device == "ahead" else 60.0
        begun_s = self.clock.now_s()
        for n in itertools.count():
            self.clock.sleep_until(begun_s + n / hz)
            if self.device.startswith("/") and Path(self.device).exists():
                raise DeviceLost(f"{{self.name}} was pulled")
            image = np.full((24, 32), n % 256, np.uint8)
            yield Frame(image=image, t_s=self.clock.now_s() + ahead_s, sequence=n, source=self.name)
"""


@pytest.fixture(scope="module")
def driver(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A package with a driver, as anybody may install one."""
    folder = tmp_path_factory.mktemp("driver")
    (folder / "trial_camera.py").write_text(DRIVER)
    about = folder / "trial_camera-1.0.dist-info"
    about.mkdir()
    (about / "METADATA").write_text("Metadata-Version: 2.1\nName: trial-camera\nVersion: 1.0\n")
    (about / "entry_points.txt").write_text("[armsight.cameras]\ntrial = trial_camera:Camera\n")
    return folder


def moved(folder: Path, progress: Silent | None = None, begun: Any = lambda _: None, **more: object) -> RunMotionOutput:
    clock = ManualClock()
    robot = open_robot("sim:webcam-cell", clock)
    with robot:
        q = robot.read().q
    t = np.arange(500) / 100.0
    swing = Motion(t_s=t, q=np.tile(q, (500, 1)) + 0.05 * np.sin(2.0 * np.pi * t / 5.0)[:, None] ** 2)
    write_joints(folder / "motion.csv", swing)
    given = ClockedRobot(robot=robot, clock=clock, called="sim:webcam-cell")
    asked = {"confirm": lambda _: True, "progress": progress, "begun": begun, **more}
    return acted(robots.run_motion, robot=given, motion=folder / "motion.csv", out=folder / "out", **asked)


def test_both_cameras_are_recorded_from_before_a_motion_until_after_it_each_with_its_own_times(
    driver: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(driver)
    begun_s: list[float] = []
    asked_s = time.monotonic()
    done = moved(
        tmp_path,
        begun=lambda _: begun_s.append(time.monotonic()),
        left="camera:trial:plain",
        right="camera:trial:ahead",
    )
    assert done.finished and done.stopped_by == "end"
    found: dict[str, np.ndarray] = {}
    for side in ("left", "right"):  # as armsight calibrate cell reads them
        with camera_source(done.frames, side) as source:
            frames = list(source)
        assert [int(frame.image[0, 0]) for frame in frames] == [frame.sequence % 256 for frame in frames]
        found[side] = np.array([frame.t_s for frame in frames])
    told = {one.camera: one for one in done.cameras}
    assert {side: len(t_s) for side, t_s in found.items()} == {side: one.n_frames for side, one in told.items()}
    assert told["left"].duration_s == pytest.approx(np.ptp(found["left"]))
    # by the machine's clock, and by the right camera's own
    for t_s, ahead_s in ((found["left"], 0.0), (found["right"], AHEAD_S)):
        assert asked_s < t_s[0] - ahead_s < begun_s[0] < t_s[-1] - ahead_s


def test_a_camera_that_is_lost_on_the_way_brings_the_arm_to_rest_and_is_named(
    driver: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.syspath_prepend(driver)
    opened: list[FreeCameras] = []

    class Kept(FreeCameras):
        def __enter__(self) -> Self:
            opened.append(self)
            return super().__enter__()

    class Pulls(Silent):
        """Pulls a plug after a while, and lets no further one pass before that is known."""

        looks = 0

        def cancelled(self) -> bool:
            self.looks += 1
            if self.looks == 1000:
                (tmp_path / "pull").touch()
                until_s = time.monotonic() + PATIENCE_S
                while opened[0].failed is None and time.monotonic() < until_s:
                    os.sched_yield()
            return False

    monkeypatch.setattr(run_motion_module, "FreeCameras", Kept)
    done = moved(tmp_path, Pulls(), left="camera:trial:plain", right=f"camera:trial:{tmp_path / 'pull'}")
    assert "was pulled" in done.stopped_by and "no longer recorded" in done.stopped_by
    assert not done.finished and 0.0 < done.share < 0.9
    assert np.ptp(read_joints(tmp_path / "out" / "joints.csv").q, axis=0).max() > 0.005
    with Recording(tmp_path / "out" / "motion.mcap") as recording:
        sent = np.array([command.values["q"] for command in recording.commands()])
    step = np.abs(np.diff(sent, axis=0)).max(axis=1)
    assert step.max() > 1e-4 and step[-1] < 0.01 * step.max() and (np.diff(step[-4:]) <= 0.0).all(), "it slowed down"
    with camera_source(done.frames, "left") as source:
        assert len(list(source)) > 0, "what was seen until then is kept"


@pytest.mark.parametrize(
    ("more", "kind", "names"),
    [
        ({"left": "camera:0"}, UsageError, "--right"),
        ({"left": "camera:0", "right": "camera:0"}, UsageError, "both camera:0"),
        ({"left": "camera:0", "right": "camera:/dev/video0"}, UsageError, ("camera:0", "/dev/video0")),
        ({"left": "camera:0", "right": "frames.mcap"}, UsageError, ("frames.mcap", "camera:2")),
        ({"left": "camera:sim:webcam-cell:left", "right": "camera:0"}, UsageError, "camera:sim"),
        ({"left": "camera:trial:plain", "right": "camera:trial:absent"}, DeviceNotFound, "absent"),
    ],
)
def test_cameras_that_cannot_be_recorded_are_refused_before_anything_moves(
    driver: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, more: dict, kind: type[ArmsightError], names: Any
) -> None:
    monkeypatch.syspath_prepend(driver)
    with refuses(kind, names):
        moved(tmp_path, **more)
    assert not (tmp_path / "out").exists(), "no loop was run, and no file made"


def test_who_lets_go_while_the_cameras_begin_has_moved_nothing(
    driver: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class LetsGo(Silent):
        def cancelled(self) -> bool:
            return True

    monkeypatch.syspath_prepend(driver)
    with refuses(Cancelled):
        moved(tmp_path, LetsGo(), left="camera:trial:plain", right="camera:trial:ahead")
    assert not (tmp_path / "out" / "motion.mcap").exists()


def test_a_folder_with_frames_is_kept(tmp_path: Path) -> None:
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / "frames.mcap").write_bytes(b"of another run")
    with refuses(UsageError, "out"):
        moved(tmp_path, left="camera:0", right="camera:1")


class Held:
    """A camera that sends a few frames, and then nothing, or breaks in a way of its own."""

    total = None

    def __init__(self, name: str, frames: int, end: Exception | None = None) -> None:
        self.name, self.frames, self.end = name, frames, end
        self.spent, self.closed = threading.Event(), threading.Event()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.closed.set()

    def __iter__(self) -> Iterator[Frame]:
        for n in range(self.frames):
            yield Frame(image=np.zeros((8, 8), np.uint8), t_s=float(n), sequence=n, source=self.name)
        if self.end is not None:
            raise self.end
        self.spent.set()
        self.closed.wait()


def recorded(cameras: dict[str, Held], out: Path, monkeypatch: pytest.MonkeyPatch) -> tuple[CameraRecorded, ...]:
    """Record until a camera fails; a second goes by between two looks once both have nothing more to send."""
    monkeypatch.setattr(free_cameras, "camera_source", lambda text, side, **_: cameras[side])
    clock, until_s = ManualClock(), time.monotonic() + PATIENCE_S

    def ended() -> bool:
        os.sched_yield()
        if all(camera.spent.is_set() for camera in cameras.values()):
            clock.advance(1.0)
        return clock.now_s() > 100.0 or time.monotonic() > until_s

    return record_free(FreeJob(cameras={"left": "camera:1", "right": "camera:2"}, out=out), lambda: None, ended, clock)


def test_a_camera_that_falls_silent_is_lost_though_its_driver_says_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cameras = {"left": Held("one", 3), "right": Held("two", 2)}
    with refuses(DeviceLost, f"no frame for {SILENT_S:g} s"):
        recorded(cameras, tmp_path / "frames.mcap", monkeypatch)
    with camera_source(str(tmp_path / "frames.mcap"), "left") as source:
        assert [frame.t_s for frame in source] == [0.0, 1.0, 2.0]


def test_a_driver_that_breaks_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cameras = {"left": Held("one", 3), "right": Held("two", 2, RuntimeError("odd"))}
    with refuses(DeviceFailed, "odd"):
        recorded(cameras, tmp_path / "frames.mcap", monkeypatch)
