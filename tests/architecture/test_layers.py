"""The import contract holds, and each planted violation trips it."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]

PARTS = ("src", "sim/src", "lab/src")
BESIDE = {"armsight_sim": "sim/src", "armsight_lab": "lab/src"}
PLANTED = {
    "geometry sees records": ("geometry/planted.py", "import armsight.records"),
    "optics sees kinematics": ("optics/planted.py", "import armsight.kinematics"),
    "calibrate sees measure": ("calibrate/planted.py", "import armsight.measure"),
    "verify sees control": ("verify/planted.py", "import armsight.control"),
    "verify opens files": ("verify/planted.py", "import pathlib"),
    "measure sees the simulation": ("measure/planted.py", "import armsight_sim"),
    "the simulation projects with optics": ("armsight_sim/twins/planted.py", "import armsight.optics"),
    "the simulation measures": ("armsight_sim/rooms/planted.py", "import armsight.measure"),
    "the simulation calibrates": ("armsight_sim/sets/planted.py", "import armsight.calibrate"),
    "the simulation's papers measure": ("armsight_sim/papers/planted.py", "import armsight.measure"),
    "a room sees a cell": ("armsight_sim/rooms/planted.py", "import armsight_sim.cell"),
    "a cell sees a paper": ("armsight_sim/sets/planted.py", "import armsight_sim.papers.kapucu2005"),
    "a module outside the simulation's plan": ("armsight_sim/planted.py", '"""Nobody knows what this is."""'),
    "the batch sees the commands": ("armsight_lab/batch/planted.py", "import armsight_lab.cli.batch"),
    "app imports the laboratory by name": ("app/planted.py", "import armsight_lab.batch.run"),
    "store sees config": ("store/planted.py", "import armsight.config"),
    "app imports the simulation by name": ("app/planted.py", "import armsight_sim.cells"),
    "drivers see testing": ("drivers/planted.py", "import armsight.testing"),
    "maths opens files": ("fitting/planted.py", "import pathlib"),
    "maths draws": ("optics/planted.py", "import plotly"),
    "maths starts threads": ("measure/planted.py", "import threading"),
    "a room outside the plan": ("attic/__init__.py", '"""Nobody knows what this is."""'),
}


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [str(Path(sys.executable).with_name("lint-imports")), "--no-cache"],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join(str(folder / part) for part in PARTS)},
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def copy(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("house")
    for part in PARTS:
        shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    return folder


def test_the_clean_tree_passes(copy: Path) -> None:
    done = lint(copy)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_violation_fails(copy: Path, name: str) -> None:
    path, text = PLANTED[name]
    planted = copy / BESIDE.get(path.partition("/")[0], "src/armsight") / path
    new_folder = not planted.parent.exists()
    planted.parent.mkdir(exist_ok=True)
    planted.write_text(text + "\n")
    try:
        done = lint(copy)
    finally:
        planted.unlink()
        if new_folder:
            planted.parent.rmdir()
    assert done.returncode != 0, f"{name} went unseen:\n{done.stdout}"
