"""Sets simulated for one calibration: their own commands read them, and find the truth that stands beside them."""

import shlex
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from typer.testing import CliRunner

from armsight.cli.commands import app
from armsight.store.handeye_file import read_handeye

SIZES = {"handeye": 8}


def run(*arguments: str) -> str:
    done = CliRunner().invoke(app, list(arguments))
    assert done.exit_code == 0, done.output
    return done.output


def made(name: str, folder: Path, monkeypatch: pytest.MonkeyPatch, *, but: str = "-") -> None:
    """Simulate a set and run the commands that it names, without those that hold a word."""
    said = run("simulate", name, "-o", str(folder), "--frames", str(SIZES[name]))
    monkeypatch.chdir(folder)
    commands = [line.strip() for line in said.splitlines() if line.startswith("  armsight ")]
    assert commands
    for command in commands:
        if but not in shlex.split(command):
            run(*shlex.split(command)[1:])


def truth(file: Path) -> dict[str, Any]:
    content = yaml.safe_load(file.read_text())
    assert isinstance(content, dict)
    return content


def test_the_camera_on_the_hand_is_found(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    made("handeye", tmp_path, monkeypatch)
    true = truth(tmp_path / "handeye_true.yaml")["T_flange_camera"]["xyz_m"]
    for name in ("handeye.yaml", "from-pairs.yaml", "from-streams.yaml"):
        found = read_handeye(tmp_path / name).T_parent_camera
        assert np.asarray(found.translation) == pytest.approx(true, abs=1.5e-3)


@pytest.mark.parametrize(
    ("flags", "says"), [(["--frames", "3"], "too few"), (["--room", "dark"], "room and lenses of its own")]
)
def test_what_a_set_cannot_be_is_refused(flags: list[str], says: str, tmp_path: Path) -> None:
    done = CliRunner().invoke(app, ["simulate", "pivot", "-o", str(tmp_path / "set"), *flags])
    assert done.exit_code == 2
    assert says in done.output
