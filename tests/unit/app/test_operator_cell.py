"""A simulated cell for a page: its files, the arm that its cameras see, places, ranges and the path's editor."""

from __future__ import annotations

import threading

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.app.live.measurement import FollowedCell, FollowedPairs
from armsight.app.operator.job_runner import JobRunner
from armsight.app.operator.path_editor import PathEditor
from armsight.app.operator.robot_cell import prepare_simulated, read_placement
from armsight.clock import ManualClock
from armsight.control.session.channels import JointTrack
from armsight.errors import DeviceFailed, DeviceLost, NotEnoughData, StaleData, UsageError
from armsight.ops.requests.motion import RobotJob
from armsight.ops.simulation.scenarios import live_cell
from armsight.records import TaughtPath
from armsight.store.arm_file import read_arm
from armsight.store.cell_file import read_cell
from armsight.store.path_file import write_path
from refusals import refuses

HOME = np.deg2rad([0.0, -60.0, 90.0, -30.0, 90.0, 0.0])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    made = tmp_path_factory.mktemp("operator") / "cell"
    assert prepare_simulated(RobotJob(robot="sim:webcam-cell"), made) == read_cell(made)
    return made


def test_a_simulated_cell_brings_its_files_along(folder):
    cell = read_cell(folder)
    assert (cell.left, cell.right) == ("camera:sim:webcam-cell:left", "camera:sim:webcam-cell:right")
    assert cell.cameras == "standing"
    for name in (cell.rig, cell.target, cell.arm, cell.handeye):
        assert (folder / name).is_file()


def test_a_track_tells_joints_between_and_none_beyond():
    track = JointTrack(2, slots=128)
    with pytest.raises(StaleData):
        track.at(0.0)
    for i in range(300):
        track.write(0.01 * i, np.array([i, -2.0 * i]))
    assert track.at(2.985) == pytest.approx([298.5, -597.0])
    assert track.reaches(2.99) and not track.reaches(3.0)
    for unknown in (99.0, 0.0):  # not heard yet; forgotten
        with pytest.raises(StaleData):
            track.at(unknown)
    track.write(2.9, np.zeros(2))
    assert track.at(2.9) == pytest.approx([290.0, -580.0]), "an older reading changes nothing"


def test_the_pictures_show_the_arm_that_another_process_moves(folder):
    """A joint turned in the track moves the lights in the picture; where it stands they stay."""
    clock, track = ManualClock(), JointTrack(6)
    pairs = FollowedPairs(FollowedCell("webcam-cell", track, room="dark"), clock)
    track.write(0.0, HOME)
    track.write(0.06, HOME)
    moved = HOME + np.deg2rad([3.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    with pairs:
        frames = iter(pairs)
        first, again = next(frames)[0], next(frames)[0]
        track.write(clock.now_s() + 1e-3, moved)
        track.write(clock.now_s() + 0.2, moved)
        clock.advance(0.1)
        last = next(frames)[0]
        clock.advance(0.2)
        with refuses(DeviceLost, "told no joints"):
            next(frames)
    assert first.t_s <= clock.now_s() and last.t_s > again.t_s, "stamped with the clock"
    assert np.abs(brightest(first) - brightest(again)).max() < 3.0, "noise"
    assert np.abs(brightest(first) - brightest(last)).max() > 20.0


def brightest(frame):
    """Return the mean place (row, column) of what shines."""
    rows, columns = np.nonzero(np.asarray(frame.image) > 100)
    return np.array([rows.mean(), columns.mean()])


def test_the_rig_is_where_hand_eye_says(folder):
    cell, arm = read_cell(folder), read_arm(folder / "arm.yaml")
    truth = live_cell("webcam-cell", ManualClock(), room="dark").T_mount_rig
    found = read_placement(folder, cell).rig_pose(arm, None)
    assert np.asarray(found.as_matrix()) == pytest.approx(truth.as_matrix(), abs=1e-9)
    unplaced = cell.model_copy(update={"handeye": ""})
    assert read_placement(folder, unplaced).rig_pose(arm, HOME) is None
    assert read_placement(folder, cell).rig_pose(None, HOME) is None, "without an arm a base has no place"


def line(n: int = 11) -> TaughtPath:
    places = np.stack([np.linspace(0.0, 0.1, n), np.zeros(n), np.zeros(n)], axis=1)
    poses = RigidTransform.from_translation(places) * RigidTransform.from_rotation(down())
    return TaughtPath.of_poses(poses)


def down():
    from scipy.spatial.transform import Rotation

    return Rotation.from_euler("x", 180.0, degrees=True)


def test_every_change_of_a_path_can_be_taken_back(tmp_path):
    editor = PathEditor(tmp_path)
    with pytest.raises(NotEnoughData):
        editor.require()
    write_path(tmp_path / "taught.csv", line())
    editor.load(tmp_path / "taught.csv")
    editor.delete([3, 4])
    editor.change("resample", 5.0)
    editor.change("offset", 10.0)
    assert editor.require().xyz_m[:, 2] == pytest.approx(-0.01)
    before = editor.changes
    for _ in range(before):
        editor.undo()
    assert len(editor.require()) == 11 and editor.changes == 0
    assert len(PathEditor(tmp_path).require()) == 11, "the file follows"


def test_a_wrong_change_leaves_the_path_as_it_is(tmp_path):
    editor = PathEditor(tmp_path)
    write_path(tmp_path / "taught.csv", line())
    editor.load(tmp_path / "taught.csv")
    for tool, value, error in (("resample", -1.0, UsageError), ("fold", 1.0, UsageError), ("angle", 400.0, UsageError)):
        with pytest.raises(error):
            editor.change(tool, value)
    assert len(editor.require()) == 11 and editor.changes == 0


def test_one_piece_of_work_at_a_time_and_its_question_waits_for_an_answer():
    jobs, go = JobRunner(), threading.Event()
    work = jobs.begin("play", "a", lambda work: (go.wait(10.0), work.ask("Move?"))[1])
    with refuses(DeviceFailed, "play"):
        jobs.begin("identify", "b", lambda work: None)
    go.set()
    while not work.question:
        pass
    work.answer(True, "b")
    work.wait(10.0)
    assert work.result is True and work.browser == "b" and not work.failure
    assert jobs.named("play") is work and jobs.named("identify") is None


def test_work_that_fails_says_why_and_a_question_that_is_cancelled_is_a_no():
    jobs = JobRunner()

    def fail(_):
        raise UsageError("this cannot be", cure="Do otherwise")

    failed = jobs.begin("play", "a", fail)
    failed.wait(10.0)
    assert "this cannot be" in failed.failure
    asked = jobs.begin("play", "a", lambda work: work.ask("Move?"))
    jobs.close()
    assert asked.result is False
