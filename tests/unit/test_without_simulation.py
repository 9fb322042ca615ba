"""armsight without its other distributions: its own work goes on, and what they would do is refused with the cure.

The environment is a new one that holds links to all that is installed here, those distributions excepted.
"""

import json
import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tomllib
import venv
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import armsight
from armsight._version import __version__
from armsight.kinematics import fk, presets
from simulated import simulated

ROOT = Path(__file__).resolve().parents[2]

OTHERS = ("sim", "plant", "lab")
EXTRAS = {"plant": ("foxglove",), "lab": ("batch", "history", "postgresql")}
"""Further extras that bring them."""

WORKS = (
    "--help",
    "verify --help",
    "measure --rig cell/rig.yaml --target cell/target.yaml --left cell/left --right cell/right -o measured --json",
    "calibrate robot-world --arm arm/arm_true.yaml --points arm/observed.csv -o world.yaml --json",
    "identify --sweep sweep.csv -o found.yaml --json",
    "doctor --json",
)
SIMULATED = (
    "demo -o none --json",
    "simulate webcam-cell -o none --json",
    "reproduce kapucu2005 -o none --json",
    "twin rsi",
    "measure --rig cell/rig.yaml --target cell/target.yaml --left camera:sim:webcam-cell:left "
    "--right camera:sim:webcam-cell:right -o none --json",
)
LIVE = (
    "verify --live --robot rsi:49152 --left camera:0 --right camera:1 --rig cell/rig.yaml --target cell/target.yaml "
    "--arm ur10 --world cell/world.yaml -o none --json"
)
PUBLISHED = ("serve --robot rsi:49152 --foxglove 0", f"{LIVE} --mqtt mqtts://broker/cell")
LABORATORY = (
    "batch jobs.csv -o none --json",
    "design --rig cell/rig.yaml --target cell/target.yaml --volume=0:1,0:1,0:1 -o none --json",
    "history list --json",
    "verify --measured measured.csv --commanded commanded.csv -o filed --cell weld-3 --json",
    "calibrate cell --plan --model ur5e --start=0,0,0,0,0,0 -o none.csv --json",
)
REFUSED = {**dict.fromkeys(SIMULATED, "sim"), **dict.fromkeys(PUBLISHED, "plant"), **dict.fromkeys(LABORATORY, "lab")}

CODE = """
import importlib.util, json, sys
from typer.testing import CliRunner
import armsight
from armsight.cli.commands import app

there = [name for name in ("armsight_sim", "armsight_plant", "armsight_lab") if importlib.util.find_spec(name)]
out = {"there": there, "scenarios": armsight.scenarios()}
for line in json.load(sys.stdin):
    done = CliRunner().invoke(app, line.split())
    out[line] = [done.exit_code, done.stdout, done.stderr]
try:
    armsight.simulate("webcam-cell")
except armsight.ArmsightError as error:
    out["simulate"] = [type(error).__name__, error.cure]
for name in ("batch", "design", "history.runs"):
    try:
        eval(f"armsight.{name}()")
    except armsight.ArmsightError as error:
        out[name] = [type(error).__name__, error.cure]
print(json.dumps(out))
"""


@pytest.fixture(scope="module")
def bare(tmp_path_factory: pytest.TempPathFactory) -> dict[str, Any]:
    """Return what every command does there: exit code, stdout, stderr."""
    work = tmp_path_factory.mktemp("bare")
    for name, made in (
        ("cell", simulated("hand-cell", seed=1, frames=4, room="dark")),
        ("arm", simulated("arm-points", seed=1)),
    ):
        shutil.copytree(made, work / name)
    write_sweep(work)
    write_track(work)
    venv.create(work / "venv")
    here = Path(sysconfig.get_path("purelib"))
    packages = work / "venv" / here.relative_to(sys.prefix)
    for path in here.iterdir():
        if not any(f"armsight_{name}" in path.name for name in OTHERS):
            (packages / path.name).symlink_to(path)
    done = subprocess.run(
        [str(work / "venv" / "bin" / "python"), "-c", CODE],
        cwd=work,
        env={**os.environ, "PYTHONPATH": str(ROOT / "src")},
        input=json.dumps([*WORKS, *REFUSED]),
        capture_output=True,
        text=True,
        check=True,
    )
    found: dict[str, Any] = json.loads(done.stdout.splitlines()[-1])
    return found


def write_sweep(folder: Path) -> None:
    """Write the track of a beacon on an arm whose three joints move in turn, and one reading of its joints."""
    n, home = 10, np.array([0.2, 0.3, 0.5])
    joint, q = np.repeat([1, 2, 3], n), np.tile(home, (3 * n, 1))
    for number, travel in enumerate((1.2, 1.0, 0.4)):
        q[joint == number + 1, number] += np.linspace(-0.5, 0.5, n) * travel
    xyz_m = fk(presets.stanford_rrp(), q)[:, :3, 3] + np.random.default_rng(1).normal(0.0, 1e-4, (3 * n, 3))
    rows = [",".join(map(repr, [int(j), *map(float, values)])) for j, *values in np.column_stack([joint, q, xyz_m])]
    (folder / "sweep.csv").write_text("\n".join(["joint,q1,q2,q3,x_m,y_m,z_m", *rows]) + "\n")
    (folder / "joints.csv").write_text("q1,q2,q3\n0.2,0.3,0.5\n")


def write_track(folder: Path) -> None:
    """Write commanded and measured poses, in one order and without times."""
    rng = np.random.default_rng(2)
    poses = np.column_stack([rng.uniform(-0.2, 0.2, (20, 3)), Rotation.random(20, rng=rng).as_quat()])
    for name, off in (("commanded", np.zeros(7)), ("measured", 1e-3 * np.eye(7)[0])):
        rows = [",".join(map(repr, row)) for row in (poses + off).tolist()]
        (folder / f"{name}.csv").write_text("\n".join(["x_m,y_m,z_m,qx,qy,qz,qw", *rows]) + "\n")


def test_the_other_distributions_are_not_there(bare: dict[str, Any]) -> None:
    assert bare["there"] == []
    assert bare["scenarios"] == []
    assert "webcam-cell" in armsight.scenarios(), "... and it is here"


@pytest.mark.parametrize("line", WORKS)
def test_armsights_own_work_goes_on(bare: dict[str, Any], line: str) -> None:
    code, stdout, stderr = bare[line]
    assert code == 0, stderr or stdout
    if line.startswith("measure"):
        assert json.loads(stdout)["n_ok"] == 4
    if line in ("serve --help", "verify --help"):
        assert all(flag in stdout for flag in ("--opcua", "--mqtt-user", "--foxglove", "--stale-after"))
    if line.startswith("doctor"):
        assert json.loads(stdout)["drivers"]["cells"] == [] and "egm" in json.loads(stdout)["drivers"]["robots"]


@pytest.mark.parametrize("line", REFUSED)
def test_what_they_would_do_is_refused_with_the_cure(bare: dict[str, Any], line: str) -> None:
    code, stdout, stderr = bare[line]
    cure = f"armsight[{REFUSED[line]}]"
    assert code == 4, stderr or stdout
    if "--json" in line:
        error = json.loads(stdout)["error"]
        assert (error["kind"], error["exit_code"]) == ("DeviceNotFound", 4)
        assert error["consequence"] and cure in error["cure"]
    else:
        assert cure in stderr


def test_the_python_face_refuses_it_too(bare: dict[str, Any]) -> None:
    for name, extra in {"simulate": "sim", "batch": "lab", "design": "lab", "history.runs": "lab"}.items():
        kind, cure = bare[name]
        assert kind == "DeviceNotFound" and f"armsight[{extra}]" in cure


def project(folder: str) -> dict[str, Any]:
    return tomllib.loads((ROOT / folder / "pyproject.toml").read_text(encoding="utf-8"))


@pytest.mark.parametrize("other", OTHERS)
def test_distributions_have_one_version_and_ask_for_each_other_by_it(other: str) -> None:
    extras = project("")["project"]["optional-dependencies"]
    for extra in (other, *EXTRAS.get(other, ())):
        assert f"armsight-{other}=={__version__}" in extras[extra]
    assert f"armsight=={__version__}" in project(other)["project"]["dependencies"]
    for folder in ("", other):
        assert project(folder)["project"]["dynamic"] == ["version"]
        version = ROOT / folder / project(folder)["tool"]["hatch"]["version"]["path"]
        assert version.resolve() == ROOT / "src/armsight/_version.py"


@pytest.mark.parametrize("other", OTHERS)
def test_a_distribution_asks_for_no_other_version_of_what_both_need(other: str) -> None:
    core, its = (
        {re.split(r"[<>=]", need)[0]: need for need in project(folder)["project"]["dependencies"]}
        for folder in ("", other)
    )
    its.pop("armsight")
    assert its and its.items() <= core.items()
