"""armsight design on the command line: what the person is told, what programs get, and how refusals end."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from typer.testing import CliRunner, Result

from armsight.cli.commands import app
from armsight.records.target import spot_target
from armsight.store import write_target

LIGHTS = {"A": (-0.040, 0.0, 0.0), "B": (0.030, 0.032, 0.0), "C": (0.030, -0.032, 0.0)}
CAMERAS = ("--size", "1280x720", "--focal-mm", "4", "--pixel-um", "4", "--baseline", "120mm", "--cells", "3")
BOARD = ("--board", "checkerboard:9x6:0.025", "--views", "20")
VOLUME = "--volume=-0.1:0.2,-100mm:100mm,0.5:0.8"


@pytest.fixture
def design(tmp_path: Path):
    write_target(tmp_path / "target.yaml", spot_target(LIGHTS, diameter_m=0.006))

    def run(*words: str) -> Result:
        given = ["design", "--target", str(tmp_path / "target.yaml"), "-o", str(tmp_path / "out"), *words]
        return CliRunner().invoke(app, given)

    return run


def test_a_plan_is_told_and_given_to_programs(design, tmp_path: Path) -> None:
    done = design(*CAMERAS, *BOARD, VOLUME, "--wanted-mm", "0.5")
    assert done.exit_code == 0
    for word in ("position", "orientation", "calibration of the rig", "suffices", "report.html"):
        assert word in done.output
    again = design(*CAMERAS, *BOARD, VOLUME, "--wanted-mm", "0.5")
    assert again.exit_code == 2  # another run's results are left as they are
    told = json.loads(design(*CAMERAS, *BOARD, VOLUME, "--wanted-mm", "0.5", "--json", "--overwrite").stdout)
    assert told == json.loads((tmp_path / "out" / "design.json").read_text())
    assert told["focal_px"] == pytest.approx(1000.0) and told["wanted_m"] == 5e-4
