"""armsight path, as a user calls it: files in, files out, one JSON object, exit codes."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform
from typer.testing import CliRunner

from armsight.cli.commands import app
from armsight.kinematics import pose, preset
from armsight.records import TaughtPath
from armsight.store.path_file import read_path, write_path

ARM, HOME = preset("irb120"), np.array([0.1, 0.2, 0.1, 0.2, 0.9, 0.3])
START = "0.1,0.2,0.1,0.2,0.9,0.3"


@pytest.fixture
def taught(tmp_path):
    """A right angle of 0.1 m and 0.08 m taught with noise of 0.05 mm, 2 mm a row."""
    way = np.zeros((91, 3))
    way[:, 1] = np.clip(0.002 * np.arange(91), 0, 0.1)
    way[:, 2] = np.clip(0.002 * np.arange(91) - 0.1, 0, 0.08)
    T = np.repeat(pose(ARM, HOME).as_matrix()[None], 91, axis=0)
    T[:, :3, 3] += way + np.random.default_rng(2).normal(0, 5e-5, (91, 3))
    file = tmp_path / "path.csv"
    write_path(file, TaughtPath.of_poses(RigidTransform.from_matrix(T)))
    return file


def run(*arguments):
    done = CliRunner().invoke(app, ["path", *map(str, arguments), "--json"])
    return done.exit_code, json.loads(done.stdout)


def test_a_taught_path_becomes_a_program(taught, tmp_path):
    a, b, c, d = (tmp_path / f"{name}.csv" for name in "abcd")
    code, smooth = run("smooth", taught, "-o", a)
    assert code == 0 and smooth["n"] == 91 and smooth["corners"] == [50] and 0 < smooth["moved_max_m"] <= 5e-4
    assert run("resample", a, "-o", b, "--step-m", 0.005)[1]["n"] in (37, 38, 39)  # legs of 0.1 and 0.08 m
    assert run("fillet", b, "-o", c, "--radius-m", 0.02)[1]["corners"] == []
    assert run("angle", c, "-o", d, "--work-deg", 5)[0] == 0
    code, check = run("check", d, "--arm", "irb120", "--start", START, "--speed-m-s", 0.01)
    assert code == 0 and check["ok"] and check["n_reached"] == check["n"] and check["troubles"] == {}
    code, made = run("export", d, "-o", tmp_path / "seam.script", "--arm", "irb120", "--speed-m-s", 0.01)
    assert code == 0 and made["checked"] and made["n"] == check["n"] + 2
    assert (tmp_path / "seam.script").read_text().count("movel(") == made["n"] - 1


def test_an_outlier_is_named_and_refused_until_told(taught, tmp_path):
    path = read_path(taught)
    T = path.T_world_tip.copy()
    T[20, :3, 3] += 0.01
    write_path(taught, TaughtPath.of_poses(RigidTransform.from_matrix(T)))
    out = tmp_path / "smooth.csv"
    code, told = run("smooth", taught, "-o", out)
    assert code == 3 and "row 20" in told["error"]["cause"] and not out.exists()
    code, told = run("smooth", taught, "-o", out, "--outliers", "drop")
    assert code == 0 and told["n"] == 90 and [found["row"] for found in told["outliers"]] == [20]


def test_a_path_the_arm_cannot_run_is_told_and_not_exported(taught, tmp_path):
    far, out = tmp_path / "far.csv", tmp_path / "seam.script"
    run("offset", taught, "-o", far, "--by-m", 0.6)
    code, told = run("check", far, "--arm", "irb120", "--start", START)
    assert code == 3 and not told["ok"] and told["troubles"]["unreached"] > 0
    assert all("row" in issue for issue in told["issues"])
    code, told = run("export", far, "-o", out, "--arm", "irb120", "--speed-m-s", 0.05)
    assert code == 3 and "cannot run" in told["error"]["cause"] and not out.exists()


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (["export", "PATH", "-o", "OUT.script", "--speed-m-s", "0.1"], 2),  # world, and no arm
        (["export", "PATH", "-o", "OUT.script", "--frame", "base"], 2),  # no speed
        (["export", "PATH", "-o", "OUT.script", "--frame", "camera", "--speed-m-s", "0.1"], 2),
        (["check", "PATH", "--arm", "irb120", "--frame", "camera"], 2),
        (["check", "PATH", "--arm", "irb120", "--start", "1,2"], 2),
        (["join", "PATH", "-o", "OUT.csv"], 2),
        (["fillet", "PATH", "-o", "OUT.csv", "--radius-m", "1"], 3),
    ],
)
def test_wrong_input_is_refused(arguments, code, taught, tmp_path):
    words = [w.replace("PATH", str(taught)).replace("OUT", str(tmp_path / "out")) for w in arguments]
    got, told = run(*words)
    assert got == code and told["error"]["cause"]
    assert not list(tmp_path.glob("out*"))


def test_the_tip_is_the_one_that_is_given(taught, tmp_path):
    tip, out = tmp_path / "tip.yaml", tmp_path / "seam.script"
    tip.write_text("format: armsight/tip\nversion: 1\ntip_m: [0.0, 0.0, 0.05]\n")
    words = ("check", taught, "--arm", "irb120", "--start", START, "--speed-m-s", 0.01)
    bare, tipped = run(*words)[1], run(*words, "--tip", tip)[1]
    far = pose(ARM, np.array(tipped["start_q"])).as_matrix() @ [0.0, 0.0, 0.05, 1.0]
    assert np.allclose(far[:3], read_path(taught).xyz_m[0], atol=1e-6)  # the bare tool stands 50 mm back
    assert not np.allclose(bare["start_q"], tipped["start_q"], atol=1e-3)
    code, _ = run("export", taught, "-o", out, "--arm", "irb120", "--tip", tip, "--start", START, "--speed-m-s", 0.001)
    assert code == 0 and "set_tcp(p[0.000000, 0.000000, 0.050000, 0.000000" in out.read_text()
    assert run("export", taught, "-o", out, "--tip", tip, "--frame", "base", "--speed-m-s", 0.01)[0] == 2
