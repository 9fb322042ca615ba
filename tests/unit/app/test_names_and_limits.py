"""What is known by name and lies here as a file too; limits that leave something open; a disk that is full."""

from __future__ import annotations

import errno
import os
from pathlib import Path

import numpy as np
import pytest

from armsight.clock import ManualClock
from armsight.control.guard import Box, Guard, JointLimit, Limits
from armsight.errors import RecordingFailed, UsageError
from armsight.ops.arm_files import load_arm
from armsight.ops.requests.motion import RobotJob
from armsight.ops.robot.opening import left_open, noted
from armsight.ops.robot.recorder import RecordingLog, require_recorded
from armsight.ops.simulation.cells import load_cell
from armsight.ops.simulation.scenarios import load_scenario
from armsight.records import JointReading
from armsight.store.recording import RecordingWriter
from refusals import names_it, refuses


@pytest.mark.parametrize(
    ("name", "load"),
    [
        ("ur10", load_arm),
        ("puma761", load_arm),
        ("webcam-cell", load_scenario),
        ("hand-cell", lambda name: load_cell(name, seed=1, frames=1)),
    ],
)
def test_a_file_that_has_a_known_name_is_refused_and_a_folder_is_none(
    name: str, load, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(name).mkdir()  # results are kept under such names
    assert load(name) is not None
    Path(name).rmdir()
    Path(name).write_text("format: armsight/arm\n")
    with refuses(UsageError, name, f"{name}.yaml"):
        load(name)
    Path(name).rename(f"{name}.yaml")  # with its ending it is another name
    assert load(name) is not None


def test_what_limits_leave_open_is_told_with_what_holds_instead() -> None:
    box = Box(lower_m=[-1.0, -1.0, 0.0], upper_m=[1.0, 1.0, 1.0])
    told = left_open(Limits(), "limits.yaml")
    assert names_it(told, "limits.yaml", "no joints", "60 deg/s", "no workspace")
    assert names_it(left_open(Limits(forbidden=(box,)), "l"), "forbidden")
    rows = (JointLimit(speed=0.5), JointLimit(), JointLimit(speed=0.5))
    told = left_open(Limits(joints=rows, workspace=box), "l")
    assert names_it(told, "joint 2", "60 deg/s") and "workspace" not in told
    assert left_open(Limits(joints=(JointLimit(speed=0.5),) * 3, workspace=box), "l") == ""


@pytest.mark.parametrize("settings", [None, {"cycle_s": 0.012}, {"controller": "192.168.0.10"}, {"bind": "127.0.0.1"}])
def test_before_a_motion_it_is_told_that_a_link_listens_on_every_network(settings: dict[str, object] | None) -> None:
    guard = Guard(load_arm("ur10"), Limits(), 0.004)
    narrowed = settings is not None and "cycle_s" not in settings
    for robot in ("rsi:49152", "egm:6510", "rtde:192.168.0.10", "sim:webcam-cell"):
        told = noted("", guard, RobotJob(robot=robot, robot_settings=settings), None)
        listens = robot[:3] in ("rsi", "egm") and not narrowed
        assert names_it(told, robot, "every network", "controller=ADDRESS") if listens else told == ""


def test_a_full_disk_ends_the_recording_with_a_word_and_a_code_of_its_own(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    log = RecordingLog(tmp_path / "serve.mcap", clock=ManualClock())

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    from armsight.store.atomic import disk_errors

    def joints(self: RecordingWriter, reading: JointReading) -> None:
        with disk_errors(tmp_path / "serve.mcap"):
            full()

    monkeypatch.setattr(RecordingWriter, "joints", joints)
    with log:
        log.joints(JointReading(q=np.zeros(6), t_s=0.0, sequence=0, source="robot"))
    assert names_it(log.failed, "serve.mcap", os.strerror(errno.ENOSPC))
    with refuses(RecordingFailed, "serve.mcap", exit_code=5):
        require_recorded(log.failed)
    require_recorded("")
