"""What the console says of measuring: pictures that stop coming are never shown as how it is now."""

from pathlib import Path

import pytest
from typer.testing import CliRunner

from armsight.app.live.measurement import LiveJob
from armsight.app.live.station import MeasurementProcess, Snapshot
from armsight.app.live.views import Counts, LiveView, SideView
from armsight.cli.commands import app
from armsight.clock import ManualClock
from armsight.console.layout import level_of
from armsight.console.state import Console
from armsight.errors import BadFile
from armsight.records import PoseStatus, Spots, TargetPose
from armsight.server.waiting import listening
from armsight.store.cell_file import CellFile, write_cell
from refusals import names_it, refuses

SIDE = SideView(width=4, height=3, spots=[], epipolar=[], advice="good", background=0.0, brightest=None, sigma_px=None)

UNSEEN = TargetPose(t_s=0.0, status=PoseStatus.LOST, parent="rig")
NO_SPOTS = (Spots.none(), Spots.none())


def view(fps: float) -> LiveView:
    return LiveView(
        sequence=1, t_s=0.0, fps=fps, latency_s=0.01, measuring_s=0.001, status="ok", why="", parent="rig",
        xyz_m=(0.0, 0.0, 1.0), euler_rad=(0.0, 0.0, 0.0), quat_xyzw=(0.0, 0.0, 0.0, 1.0), std=None, residual_px=0.1,
        counts=Counts(ok=1, doubtful=0, position_only=0, lost=0), cameras={"left": SIDE, "right": SIDE},
    )  # fmt: skip


@pytest.mark.parametrize(("fps", "silent_after_s"), [(30.0, 2.0), (0.0, 2.0), (1.0, 4.0)])
def test_pictures_that_stop_are_told_and_their_pose_is_not_current(
    tmp_path: Path, fps: float, silent_after_s: float
) -> None:
    clock = ManualClock()
    station = MeasurementProcess(LiveJob(cameras={"left": "a", "right": "b"}), clock)
    console = Console(folder=tmp_path, station=station)
    station.shown = Snapshot(pose=UNSEEN, spots=NO_SPOTS, view=view(fps), jpegs={})
    clock.advance(silent_after_s - 0.1)
    assert console.current and level_of(console).level == "good"
    clock.advance(0.2)
    assert not console.current
    assert level_of(console).level == "bad" and "new picture" in level_of(console).words


def test_a_failure_ends_the_pose_and_a_source_that_ended_keeps_its_last(tmp_path: Path) -> None:
    clock = ManualClock()
    station = MeasurementProcess(LiveJob(cameras={"left": "a", "right": "b"}), clock)
    console = Console(folder=tmp_path, station=station)
    assert not console.current and level_of(console).level == "idle"
    station.shown = Snapshot(pose=UNSEEN, spots=NO_SPOTS, view=view(30.0), jpegs={})
    clock.advance(60.0)
    station.ended = True
    assert console.current and "ended" in level_of(console).words
    station.ended, station.failure = False, "the left camera is gone"
    assert not console.current and names_it(level_of(console).words, "left camera", "gone")


def test_a_cell_whose_files_went_missing_is_served_and_the_reason_shown(tmp_path: Path) -> None:
    write_cell(tmp_path, CellFile(rig="rig.yaml"))
    console = Console.of_folder(tmp_path)
    assert "rig.yaml" in console.begin({})
    assert level_of(console).level == "bad" and "rig.yaml" in level_of(console).words
    console.apply(CellFile())
    assert level_of(console).level == "idle"


def test_what_is_given_with_the_command_and_wrong_is_refused(tmp_path: Path) -> None:
    with refuses(BadFile, "target.yaml"):
        Console.of_folder(tmp_path).begin({"target": "target.yaml"})
    assert not (tmp_path / "cell.yaml").exists()


def test_a_port_in_use_is_told_before_anything_is_opened(tmp_path: Path) -> None:
    with listening("127.0.0.1", 0) as taken:
        done = CliRunner().invoke(
            app,
            ["console", "--robot", "sim:webcam-cell", "--folder", str(tmp_path / "cell"),
             "--port", str(taken.getsockname()[1])],
        )  # fmt: skip
    assert done.exit_code == 4 and "another port" in done.output
    assert not (tmp_path / "cell").exists()
