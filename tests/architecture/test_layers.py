"""The import contract holds, and each planted violation trips it."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
OTHERS = {"armsight_sim": "sim/src", "armsight_plant": "plant/src", "armsight_lab": "lab/src"}
PARTS = ("src", *OTHERS.values())

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
    "a world runs armsight": ("armsight_sim/sets/planted.py", "import armsight.ops.measurement.run"),
    "a world sees what runs armsight on it": ("armsight_sim/twins/planted.py", "import armsight_sim.reproduce.run"),
    "server imports what plants use by name": ("server/planted.py", "import armsight_plant.options"),
    "what plants use serves pages": ("armsight_plant/opcua/planted.py", "import armsight.server"),
    "a publisher sees what feeds it": ("armsight_plant/opcua/planted.py", "import armsight_plant.publishing"),
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
        env={**os.environ, "PYTHONPATH": os.pathsep.join(str(folder / part) for part in PARTS), "COLUMNS": "200"},
        capture_output=True,
        text=True,
        check=False,
    )


def place(name: str) -> str:
    """Return the file of a planted module, in its distribution: the number tells one from the next."""
    path = PLANTED[name][0].replace("planted", f"planted_{[*PLANTED].index(name)}")
    return path if path.split("/")[0] in OTHERS else f"armsight/{path}"


@pytest.fixture(scope="module")
def told(tmp_path_factory: pytest.TempPathFactory) -> str:
    """What is told of a copy with every violation planted."""
    folder = tmp_path_factory.mktemp("house")
    for part in PARTS:
        shutil.copytree(ROOT / part, folder / part, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", folder)
    for name, (_, text) in PLANTED.items():
        planted = folder / OTHERS.get(place(name).split("/")[0], "src") / place(name)
        planted.parent.mkdir(exist_ok=True)
        planted.write_text(text + "\n")
    done = lint(folder)
    assert done.returncode != 0
    return done.stdout


def test_the_clean_tree_passes() -> None:
    done = lint(ROOT)
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("name", PLANTED)
def test_a_planted_violation_is_found(told: str, name: str) -> None:
    module = place(name).removesuffix(".py").removesuffix("/__init__").replace("/", ".")
    assert re.search(rf"{re.escape(module)}( ->|$)", told, re.MULTILINE), told
