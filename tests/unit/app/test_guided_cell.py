"""A whole cell, guided: what is recorded, what is asked for next, the command's result, and what is refused."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.app.guided.cell import CellStep, used_files
from armsight.app.guided.cell_recorder import FRAMES, LOG, CellRecorder, CellWatch
from armsight.app.guided.step import Next
from armsight.app.guided.step_runner import GuidedStepRunner
from armsight.app.live.views import SideView
from armsight.clock import SystemClock
from armsight.console.state import Console
from armsight.defaults import LOST_LOOKS
from armsight.errors import DeviceFailed, DeviceLost, NotEnoughData, UsageError
from armsight.ops.recording.recorder import RecordingState
from armsight.records import Frame, JointReading, Silent, Spots
from armsight.store import read_rig, read_world
from armsight.store.cell_file import CellFile
from armsight.store.handeye_file import read_handeye
from armsight.store.recording import ImageFormat, RecordingWriter, encode
from armsight.store.tracks import read_joints
from drawn_cell import FPS, SIDES, DrawnCell, drawn_cell
from refusals import refuses

SIDE = SideView(
    width=300, height=300, spots=[], epipolar=[], advice="good", background=0.0, brightest=None, sigma_px=None
)
FRAMES_OF_SET = 720
"""24 s: 20 s are the least."""


def shown(t_s: float, left: Any, right: Any = None) -> Any:
    spots = [np.asarray(uv, float).reshape(-1, 2) for uv in (left, left if right is None else right)]
    return SimpleNamespace(
        spots=tuple(Spots.of_centres(uv, np.tile(np.eye(2), (len(uv), 1, 1))) for uv in spots),
        view=SimpleNamespace(t_s=t_s, cameras={"left": SIDE, "right": SIDE}, fps=30.0),
    )


def reading(t_s: float, *q: float) -> JointReading:
    return JointReading(q=np.array(q), t_s=t_s, sequence=0, source="arm")


@dataclass
class FakeStation:
    """Stands for a station: begins and ends a file at once, and writes what it is given into it."""

    write: Callable[[Path], object] = lambda _: None
    shown: Any = field(default_factory=lambda: shown(0.0, []))
    recording: RecordingState = field(default_factory=RecordingState)
    failure: str = ""
    ended: bool = False
    begun: list[Path] = field(default_factory=list)

    def record(self, file: Path | None) -> None:
        if file is not None:
            file.parent.mkdir(parents=True)
            self.write(file)
            self.begun.append(file)
        self.recording = RecordingState(file=file)


def step_of(folder: Path, read: Callable[[], JointReading] | None = None, **files: Path) -> CellStep:
    return CellStep(folder=folder, file_of=files.get, read_joints=read)


CROSS = np.array([[-9.0, 0.0], [9.0, 0.0], [0.0, -9.0], [0.0, 9.0]])


def lights(u: float, v: float, n: int = 4) -> np.ndarray:
    """Return spots about a place."""
    return CROSS[:n] + np.array([u, v])


def test_moving_lights_cover_a_picture_and_lamps_that_stand_do_not() -> None:
    watch = CellWatch(n_lights=4)
    lamp = [[290.0, 290.0]]
    for k, x in enumerate((50.0, 60.0, 150.0)):
        watch.add_pictures(shown(float(k), [*lights(x, 50.0), *lamp], lights(150.0, 150.0)))
    assert watch.cells["left"].tolist() == [[1, 1, 0], [0, 0, 0], [0, 0, 0]]
    assert not watch.cells["right"].any(), "a target at rest"
    assert (watch.seconds, watch.n_pictures, watch.seen_share("left")) == (2.0, 3, 1.0)
    for k in range(LOST_LOOKS):
        assert not watch.lost_side
        watch.add_pictures(shown(3.0 + k, lights(50.0, 50.0), lights(150.0, 150.0, 3)))
    assert watch.lost_side == "right"


def test_of_cameras_by_name_lights_are_lost_when_none_sees_them() -> None:
    watch = CellWatch(n_lights=4, sides=("east", "top", "west"))
    side, few, every = SIDE, lights(50.0, 50.0, 2), lights(50.0, 50.0)

    def moment(t_s: float, *seen: Any) -> Any:
        spots = tuple(Spots.of_centres(uv, np.tile(np.eye(2), (len(uv), 1, 1))) for uv in seen)
        cameras = dict.fromkeys(watch.sides, side)
        return SimpleNamespace(spots=spots, view=SimpleNamespace(t_s=t_s, cameras=cameras, fps=30.0))

    for k in range(2 * LOST_LOOKS):
        watch.add_pictures(moment(float(k), few, every, few))
    assert not watch.lost_side and watch.seen_share("top") == 1.0 and set(watch.cells) == {"east", "top", "west"}
    for k in range(LOST_LOOKS):
        watch.add_pictures(moment(100.0 + k, few, few, few))
    assert watch.lost_side == "top"


def test_pressed_twice_is_one_recording_with_the_readings_beside_it(tmp_path: Path) -> None:
    clock, station = iter(range(10_000)), FakeStation()
    step = step_of(tmp_path, lambda: reading(1e-2 * next(clock), 0.1, 0.2))
    runner = GuidedStepRunner(step)
    for _ in range(2):
        runner.do("record", lambda: step.begin(station))  # type: ignore[arg-type]
    assert step.recording and len(station.begun) == 1 and not runner.state.refused
    for _ in range(2):
        runner.do("end", step.end)
    assert not step.recording and not runner.state.refused
    (folder,) = tmp_path.glob("cell-*")
    assert read_joints(folder / LOG).q[0].tolist() == [0.1, 0.2]
    step.drop(0)
    assert not folder.exists() and step.samples == ()


def test_a_recording_that_cannot_begin_says_why(tmp_path: Path) -> None:
    step = step_of(tmp_path)
    other = FakeStation(recording=RecordingState(file=tmp_path / "recording-1.mcap"))
    with refuses(UsageError, "recording-1.mcap"):
        step.begin(other)  # type: ignore[arg-type]
    for gone, why in (
        (FakeStation(failure="the left camera is gone"), "left camera"),
        (FakeStation(shown=None), "no pictures come"),
        (FakeStation(ended=True), "frames have ended"),
    ):
        with refuses(DeviceFailed, why):
            step.begin(gone)  # type: ignore[arg-type]

    def lost() -> JointReading:
        raise DeviceLost("the robot is gone", consequence="Nothing is known", cure="Look at it")

    with refuses(DeviceLost, "robot is gone"):
        step_of(tmp_path, lost).begin(FakeStation())  # type: ignore[arg-type]
    assert not list(tmp_path.iterdir()) and not step.recording


def test_a_recording_that_ends_by_itself_is_told_with_its_cause_and_keeps_its_readings(tmp_path: Path) -> None:
    station, times = FakeStation(), iter(range(100))

    def read() -> JointReading:
        t_s = float(next(times))
        if t_s == 5.0:  # the measuring process ends while readings go on
            station.failure, station.recording = "the left camera is gone", RecordingState()
        return reading(t_s, 0.1)

    made = CellRecorder(station, tmp_path / "cell-x", read, SystemClock(), n_lights=4)  # type: ignore[arg-type]
    made.begin()
    made._thread.join(10.0)
    assert not made.running and "left camera" in made.failure
    assert len(read_joints(tmp_path / "cell-x" / LOG).t_s) == 5


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> DrawnCell:
    return drawn_cell(tmp_path_factory.mktemp("set"), frames=FRAMES_OF_SET)


@pytest.fixture(scope="module")
def frames(drawn: DrawnCell) -> Path:
    """A recording of both cameras, each with its own times, as a station writes it."""
    file = drawn.folder / FRAMES
    with RecordingWriter(file) as writer:
        for k, pair in enumerate(zip(*(drawn.images(side) for side in SIDES), strict=True)):
            left, right = (
                Frame(image=image, t_s=5.0 + k / FPS + late_s, sequence=k, source=side)
                for image, side, late_s in zip(pair, SIDES, (0.0, 0.0), strict=True)
            )
            views = {"left": left, "right": right}
            writer.moment(views, {name: encode(one.image, ImageFormat.PNG) for name, one in views.items()})
    return file


def recorded(folder: Path, drawn: DrawnCell, frames: Path, seconds: float = 24.0, **files: Path) -> CellStep:
    """Return a step that has recorded the drawn cell; the log stands beside it."""
    known = {name: folder / f"{name}.yaml" for name in ("target", "arm")} | files
    folder.mkdir(exist_ok=True)
    for name in ("target.yaml", "arm.yaml", "joints.csv"):
        shutil.copy(drawn.folder / name, folder / name)
    step = step_of(folder, **known)
    station: Any = FakeStation(write=lambda file: shutil.copy(frames, file))
    step.begin(station)
    step.watch.add_pictures(shown(0.0, []))
    step.watch.add_pictures(shown(seconds, []))
    step.end()
    step.log = folder / "joints.csv"
    return step


def test_the_result_is_the_commands_and_all_of_it_is_used_at_once(
    drawn: DrawnCell, frames: Path, tmp_path: Path
) -> None:
    step = recorded(tmp_path, drawn, frames)
    assert step.hint().what is Next.RUN
    verdict = step.run(Silent())
    assert verdict.verdict.level == "good", verdict.verdict.reasons
    assert verdict.rows[0][0].startswith("tip") and "mm" in verdict.rows[0][1]
    titles = dict(verdict.lists)
    assert any("joint j1" in line for line in titles["What it cannot tell"])
    assert any(line.startswith("arm: ") for line in titles["What was learned"])
    assert verdict.report is not None and verdict.report.exists()
    out = verdict.file.parent
    assert abs(read_rig(verdict.file).baseline_m - 0.55) < 0.005, "the cameras stand 550 mm apart"
    placed, hand = read_world(out / "world.yaml"), read_handeye(out / "handeye.yaml")
    np.testing.assert_allclose(hand.T_parent_camera.as_matrix(), placed.T_parent_rig.as_matrix(), atol=1e-12)
    console = Console(folder=tmp_path)
    used = {key: file.relative_to(tmp_path).as_posix() for key, file in verdict.use if file is not None}
    assert set(used) == {"rig", "world", "target", "arm", "handeye"}
    console.apply(CellFile(**used))
    step.file_of = dict(verdict.use).get
    with refuses(UsageError, "result", "twice"):
        step.run(Silent())
    step.drop(0)
    assert not (out / FRAMES).exists() and verdict.file.exists(), "what the cell measures with stays"


def test_an_arm_whose_base_is_elsewhere_does_without_a_world_that_base_axes_would_be_taken_for() -> None:
    assert used_files(RigidTransform.identity())["world"] == "world.yaml"
    elsewhere = used_files(RigidTransform.from_translation([0.5, 0.0, 0.0]))
    assert elsewhere["world"] == "" and elsewhere["handeye"] == "handeye.yaml"


def test_a_console_that_ends_closes_the_recording_and_keeps_the_readings(tmp_path: Path) -> None:
    times, station = iter(range(100_000)), FakeStation()
    read = SimpleNamespace(reading=lambda: reading(1e-2 * next(times), 0.1))
    console = Console(folder=tmp_path, robot=read, station=SimpleNamespace(stop=lambda: None))  # type: ignore[arg-type]
    step: Any = console.step("cell").step
    step.begin(station)
    console.close()
    assert not step.recording and station.recording.file is None
    (log,) = tmp_path.glob("cell-*/joints.csv")
    assert len(read_joints(log).t_s) > 0


def test_too_little_and_what_is_missing_are_told_before_anything_is_looked_for(
    drawn: DrawnCell, frames: Path, tmp_path: Path
) -> None:
    with refuses(NotEnoughData, "nothing was recorded"):
        step_of(tmp_path).run(Silent())
    with refuses(NotEnoughData, "5 s were recorded"):
        recorded(tmp_path / "short", drawn, frames, seconds=5.0).run(Silent())
    step = recorded(tmp_path / "bare", drawn, frames)
    step.log = None
    assert step.hint().what is Next.BRING_LOG
    with refuses(NotEnoughData, "log", "missing"):
        step.run(Silent())
    step.log, step.file_of = tmp_path / "bare" / "joints.csv", lambda _: None
    with refuses(NotEnoughData, "target.yaml"):
        step.run(Silent())
