"""The examples below each command's help are run to their end, on small files that other commands made.

What is not here is stood in for: simulated cameras and robots for real ones, and a few seconds for 'until Ctrl-C'. What
a page of the documentation shows with the same flags runs there (tests/unit/test_docs.py), and what is an action's case
in tests/unit/ops/test_all_actions.py; neither is run here once more.
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
from tests.unit.test_docs import PAGES, blocks
from typer.testing import CliRunner

import histories
from action_cases import CASES, write_rows
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
    ("calibrate handeye", "checkerboard:9x6:0.025", "checkerboard:9x6:0.02"),
    ("", "circles:7x11:0.02", "checkerboard:7x5:0.02"),
    ("calibrate cameras", "charuco:7x5:0.04:0.03:DICT_4X4_50", "checkerboard:7x5:0.02"),
    ("calibrate cameras", "left.mp4 --camera right=right.mp4", "boards/left"),
    ("calibrate cameras", "top.mp4", "boards/right"),
    ("report", "rig.report.html", "rig-before.report.html"),
    ("design --rig", "rig.yaml", "rig-before.yaml"),
    ("", "camera:0", "camera:sim:webcam-cell:left"),
    ("", "camera:1", "camera:sim:webcam-cell:right"),
)
"""Beginning of an example, what it says, and what stands for that here."""
REAL_TIME = ("teach --robot",)
"""May be held by their guard on a machine that is late, and say so."""
ENDS = {
    "record --left": "--frames 3",
    "teach --robot": "--yes --hand circle --seconds 2",
    "teach --left": "--seconds 3",
    "demo": "--frames 2 --no-pictures",
    "design --rig": "--cells 3",
}
"""Beginning of an example -> what keeps it short here, and answers whether the arm may move."""
FROM = {
    "calibrate mirrors": "mirrors",
    "calibrate handeye": "handeye",
    "sim:pachidis2005-circle": "pachidis2005-static",
}
"""Beginning of an example, or a robot in it -> the folder whose files it finds in place of the webcam cell's."""


if not any(map(shutil.which, BROWSERS)):
    NOT_HERE["report"] = "no browser that prints"


def asked(command: str) -> tuple[str, frozenset[str]]:
    """Return the name of the command of a line, and its flags."""
    names = [name for name in every_example() if f"{command} ".startswith(f"armsight {name} ")]
    return max(names, key=len, default=""), frozenset(re.findall(r"(?<= )--?[a-z][a-z-]*", command))


def left_to_run() -> list[str]:
    """Return the examples whose command neither a page nor the tests of all actions run with all of their flags."""
    texts = [text for page in PAGES for kind, text in blocks(page) if kind == "bash"]
    lines = [line for text in texts for line in text.replace("\\\n", " ").splitlines()]
    shown = [asked(line) for line in (*lines, *(f"armsight {words}" for words in CASES.values()))]
    examples = {text: asked(text) for texts in every_example().values() for text in texts}
    return [text for text, (name, flags) in examples.items() if not any(name == n and flags <= f for n, f in shown)]


def run(words: str, *, late: bool = False) -> None:
    done = CliRunner().invoke(app, shlex.split(words))
    held = late and done.exit_code == 3 and "late" in done.output
    assert done.exit_code == 0 or held, f"armsight {words}\n{done.output}"


@pytest.fixture(scope="module")
def given(tmp_path_factory: pytest.TempPathFactory, boards, mirror_boards) -> Path:
    """Return a folder with every file that an example names, made by other commands, or drawn by conftest."""
    folder = tmp_path_factory.mktemp("given")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        simulate("webcam-cell", folder / "webcam-cell", frames=3, room="dark")
        simulate("pachidis2005-static", folder / "pachidis2005-static", frames=1, room="dark")
        simulate("handeye", folder / "handeye", frames=8)
        make_tables()
        make_pictures(boards.folder, mirror_boards.straight)
        make_history()
        make_batch()
    return folder


def make_tables() -> None:
    for name in ("arm", "rig", "target", "world", "handeye"):
        shutil.copy(f"webcam-cell/{name}.yaml", ".")
    run("measure --rig rig.yaml --target target.yaml --left webcam-cell/left --right webcam-cell/right -o measured")
    turns = Rotation.from_rotvec(np.random.default_rng(1).normal(0.0, 0.4, (20, 3)))
    rows = np.column_stack([np.arange(20.0), -turns.apply([0.0, 0.0, 0.1]), turns.as_quat()])
    write_rows("turns.csv", "t_s,x_m,y_m,z_m,qx,qy,qz,qw", rows)
    run("calibrate tooltip --poses turns.csv -o tip.yaml")


def make_pictures(boards: Path, mirrors: Path) -> None:
    board = "--board checkerboard:7x5:0.02"
    run(f"calibrate stereo --left {boards}/left --right {boards}/right {board} -o rig-before.yaml")
    run(f"calibrate camera {boards}/right {board} -o top.yaml")
    Path("boards").symlink_to(boards)
    Path("handeye/images").symlink_to("photos")
    Path("mirrors").mkdir()
    Path("mirrors/board").symlink_to(mirrors)
    run(f"calibrate mirrors --image mirrors/board {board} -o mirrors/rig.yaml")
    run("record --left webcam-cell/left --right webcam-cell/right --frames 3 -o recording.mcap")


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
    Path("joints.csv").write_text("q1,q2,q3,q4,q5,q6\n0,0,0,0,0,0\n")
    Path("jobs.csv").write_text("name,command,arm,joints\nmonday,kinematics fk,ur10,joints.csv\n")


@pytest.mark.parametrize("example", left_to_run())
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
