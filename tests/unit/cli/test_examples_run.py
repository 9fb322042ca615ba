"""The examples below each command's help are run to their end, on small files that other commands made.

What is not here is stood in for: simulated cameras and robots for real ones, and a few seconds for 'until Ctrl-C'.
"""

from __future__ import annotations

import re
import shlex
import shutil
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from typer.testing import CliRunner

import histories
from action_cases import make_paths, write_sweep
from armsight.cli.commands import app
from armsight.cli.examples import every_example
from armsight.ops.print_report import BROWSERS
from armsight.ops.simulation.run import simulate
from armsight_lab.history.adding import file_entry
from armsight_lab.history.place import place_of

NOT_HERE = {
    "serve": "serves until Ctrl-C: tests/unit/server runs it",
    "twin": "serves until Ctrl-C: tests/contracts run it",
    "console": "serves until Ctrl-C: tests/browser runs it",
    "calibrate timing": "two cameras before which a target is waved: tests/unit/cli/test_timing.py draws their spots",
    "calibrate cell --robot-log joints.csv --left left.mp4": "videos of a moving arm: tests/unit/cli/test_cell.py",
    "robot run": "takes as long as its motion: tests/unit/app/test_cell_plan.py runs one by a clock of its own",
    "rsi:": "a robot's controller",
    "gamepad": "a gamepad",
}
"""Beginning of an example, or part of it -> what it needs that is not here."""
STAND_INS = (
    ("calibrate pivot", "camera:0", "left"),
    ("calibrate pivot", "camera:1", "right"),
    ("calibrate handeye", "checkerboard:9x6:0.025", "checkerboard:9x6:0.02"),
    ("", "checkerboard:9x6:0.025", "checkerboard:7x5:0.02"),
    ("", "circles:7x11:0.02", "checkerboard:7x5:0.02"),
    ("report", "rig.report.html", "rig-before.report.html"),
    ("design --rig", "rig.yaml", "rig-before.yaml"),
    ("", "camera:0", "camera:sim:webcam-cell:left"),
    ("", "camera:1", "camera:sim:webcam-cell:right"),
    ("", "--robot rtde:192.168.1.10", "--robot sim:webcam-cell --play"),
)
"""Beginning of an example, what it says, and what stands for that here."""
REAL_TIME = ("robot jog", "servo", "teach --robot", "play")
"""May be held by their guard on a machine that is late, and say so."""
ENDS = {
    "record --left": "--frames 3",
    "verify --live": "--frames 12",
    "measure --left camera": "--frames 3",
    "identify --live": "--yes --propose --model arm.yaml --world world.yaml",
    "teach --robot": "--yes --hand circle --seconds 2",
    "teach --left": "--seconds 3",
    "servo": "--yes --seconds 1",
    "play": "--yes",
    "robot jog": "--yes",
    "demo": "--frames 2 --no-pictures",
    "simulate webcam-cell": "--frames 1",
    "simulate handeye": "--frames 8",
}
"""Beginning of an example -> what keeps it short here, and answers whether the arm may move."""
FROM = {
    "calibrate camera": "one-camera",
    "calibrate zoom-rig": "boards",
    "calibrate stereo": "boards",
    "calibrate mirrors": "mirrors",
    "calibrate handeye": "handeye",
    "calibrate arm": "arm-points",
    "calibrate cell": "cell",
    "calibrate robot-world": "robot-world",
    "calibrate pivot": "pivot",
    "calibrate tooltip": "pivot",
    "sim:pachidis2005-static": "pachidis2005-static",
    "sim:pachidis2005-circle": "pachidis2005-static",
    "sim:kapucu2005-rrp": "kapucu2005-rrp",
}
"""Beginning of an example, or a robot in it -> the folder whose files it finds in place of the webcam cell's."""


if not any(map(shutil.which, BROWSERS)):
    NOT_HERE["report"] = "no browser that prints"


def run(words: str, *, late: bool = False) -> None:
    done = CliRunner().invoke(app, shlex.split(words))
    held = late and done.exit_code == 3 and "late" in done.output
    assert done.exit_code == 0 or held, f"armsight {words}\n{done.output}"


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory, boards, mirror_boards) -> Path:
    """Return a folder with every file that an example names, made by other commands, or drawn by conftest."""
    folder = tmp_path_factory.mktemp("given")
    sets = {
        "webcam-cell": 12,
        "pachidis2005-static": 2,
        "kapucu2005-rrp": 2,
        "handeye": 8,
        "arm-points": 40,
        "cell": 700,
        "pivot": 16,
    }
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        for name, frames in sets.items():
            simulate(name, folder / name, frames=frames)
        make_tables()
        make_pictures(boards.folder, mirror_boards.straight)
        make_foreign()
        make_paths("webcam-cell")
        Path("taught").mkdir()
        shutil.copy("path.csv", "taught")
        Path("limits.yaml").write_text("format: armsight/limits\nversion: 1\nspeed_m_s: 0.2\n")
        make_history()
        make_batch()
    return folder


def make_tables() -> None:
    for name in ("arm", "rig", "target", "world", "handeye"):
        shutil.copy(f"webcam-cell/{name}.yaml", ".")
    t = np.arange(0.0, 12.0, 0.1)
    start = np.loadtxt("webcam-cell/joints.csv", delimiter=",", skiprows=1)[0, 1:]
    q = start + 0.2 * np.sin(np.outer(t, [0.7, 1.1, 0.9, 1.7, 1.3, 2.1]) + np.arange(6))
    rows = [",".join(map(str, row)) for row in np.column_stack([t, q]).tolist()]
    Path("joints.csv").write_text("\n".join(["t_s,q1,q2,q3,q4,q5,q6", *rows]))
    run("kinematics fk --arm arm.yaml --joints joints.csv -o poses.csv")
    for name in ("measured", "measured-monday", "measured-friday"):
        run(f"measure --rig rig.yaml --target target.yaml --left webcam-cell/left --right webcam-cell/right -o {name}")
    shutil.copy("pivot/flange.csv", "pivot/poses.csv")
    run("calibrate tooltip --poses pivot/poses.csv -o tip.yaml")
    write_sweep()


def make_pictures(boards: Path, mirrors: Path) -> None:
    Path("frames").symlink_to("webcam-cell")
    for side in ("left", "right"):
        shutil.copy(f"webcam-cell/{side}/000000.png", f"{side}.png")
    Path("picks.csv").write_text("u_px,v_px,edge\n222,158,label\n252,192,label\n71,579,\n")
    Path("handeye/images").symlink_to("photos")
    Path("boards").mkdir()
    Path("boards/images").symlink_to(boards)
    Path("one-camera").mkdir()
    Path("one-camera/images").symlink_to(boards / "left")
    Path("mirrors").mkdir()
    Path("mirrors/board").symlink_to(mirrors)
    for name in ("rig-before", "rig-after"):
        run(
            f"calibrate stereo --left boards/images/left --right boards/images/right --board checkerboard:7x5:0.02 "
            f"-o {name}.yaml"
        )
    run("calibrate camera boards/images/left --board checkerboard:7x5:0.02 -o camera.yaml")
    run("calibrate camera boards/images/left --board checkerboard:7x5:0.02 --zoom 35 -o boards/left-zoom.yaml")
    shutil.copy("rig-before.yaml", "boards/rig.yaml")
    run("calibrate mirrors --image mirrors/board --board checkerboard:7x5:0.02 -o mirrors/rig.yaml")
    run("record --left webcam-cell/left --right webcam-cell/right --frames 3 -o recording.mcap")


def make_foreign() -> None:
    run("convert camera camera.yaml --to kalibr -o camchain.yaml")
    run("convert rig rig.yaml --to opencv -o stereo.yml")
    run("convert arm arm.yaml -o robot.urdf")
    urdf = Path("robot.urdf").read_text()
    Path("robot.urdf").write_text(urdf.replace('"tool"', '"tool0"'))
    head = (
        '<link name="head"/><joint name="neck" type="fixed"><parent link="base"/><child link="head"/></joint></robot>'
    )
    Path("two_arms.urdf").write_text(urdf.replace('"tool"', '"left_tool0"').replace("</robot>", head))
    Path("log.txt").write_text("X,Y,Z,A,B,C\n" + "500.0,20.0,300.0,10.0,20.0,170.0\n" * 3)
    Path("robot-world").mkdir()
    shutil.copy("arm-points/arm_tool.yaml", "robot-world/arm.yaml")
    shutil.copy("arm-points/observed.csv", "robot-world")


def make_history() -> None:
    place = place_of("history.sqlite")
    for entry in histories.runs("weld-3", 6):
        file_entry(place, entry)
    for week in range(6):
        when = histories.START + timedelta(days=7 * week, hours=1)
        file_entry(place, histories.handeye_run("weld-3", (0.1, 0.0, 0.05), Rotation.identity(), when))


def make_batch() -> None:
    Path("recordings").mkdir()
    shutil.copy("recording.mcap", "recordings/monday.mcap")
    Path("jobs.csv").write_text("name,command,arm,joints\nmonday,kinematics fk,ur10,joints.csv\n")


@pytest.mark.parametrize("example", [text for texts in every_example().values() for text in texts])
def test_an_example_runs(example: str, given: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    words = example.removeprefix("armsight ")
    monkeypatch.setenv("ARMSIGHT_HISTORY", "history.sqlite")
    if why := next((why for part, why in NOT_HERE.items() if f" {part}" in f" {words}"), ""):
        pytest.skip(why)
    for begin, said, stands in STAND_INS:
        words = words.replace(said, stands) if words.startswith(begin) else words
    own = [folder for begin, folder in FROM.items() if words.startswith(begin) or f" {begin} " in words]
    for folder in (given, *(given / name for name in own)):
        for item in folder.iterdir():
            (tmp_path / item.name).unlink(missing_ok=True)
            (tmp_path / item.name).symlink_to(item)
    for out in re.findall(r"-o (\S+)", words):
        (tmp_path / out).unlink(missing_ok=True)
    monkeypatch.chdir(tmp_path)
    words = " ".join((words, *(more for begin, more in ENDS.items() if words.startswith(begin))))
    run(words, late=words.startswith(REAL_TIME))
