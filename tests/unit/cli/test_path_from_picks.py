"""armsight path from-picks on two pictures of a textured plane, drawn here by rays."""

import json
import math

import numpy as np
import pytest
from typer.testing import CliRunner

from action_cases import make_plane
from armsight.cli.commands import app
from armsight.store.path_file import read_path

WORLD = "format: armsight/world\nversion: 1\nT_base_rig: {xyz_m: [0.3, 0.0, 1.0], quat_xyzw: [1, 0, 0, 0]}\n"
DEPTH = 0.5


@pytest.fixture
def run(tmp_path):
    make_plane(tmp_path)
    (tmp_path / "world.yaml").write_text(WORLD)

    def call(picks, *more):
        (tmp_path / "picks.csv").write_text(picks)
        names = {"--left": "left.png", "--right": "right.png", "--rig": "rig.yaml", "--picks": "picks.csv"}
        words = [word for flag, name in names.items() for word in (flag, tmp_path / name)]
        done = CliRunner().invoke(
            app, ["path", "from-picks", *map(str, words), "-o", str(tmp_path / "path.csv"), *more, "--json"]
        )
        return done.exit_code, json.loads(done.stdout)

    return call


EDGE = "u_px,v_px,edge\n60,40,seam\n100,40,seam\n100,70,\n"


def test_an_edge_becomes_a_path_with_its_uncertainty(run, tmp_path):
    code, told = run(EDGE)
    assert code == 0 and told["n"] == 6 and told["n_picks"] == 3  # 40 px of edge in steps of 10, then a point alone
    assert [point["pick"] for point in told["points"]] == [0, 0, 0, 0, 1, 2]
    path = read_path(tmp_path / "path.csv")
    u, v = np.array([60.0, 70, 80, 90, 100, 100]), np.array([40.0, 40, 40, 40, 40, 70])
    truth = np.stack([(u - 99.5) * DEPTH / 300, (v - 59.5) * DEPTH / 300, np.full(6, DEPTH)], axis=1)
    std = np.array([[point["std"][f"{k}_m"] for k in "xyz"] for point in told["points"]])
    assert (np.abs(path.xyz_m - truth)[:, 2] < 4 * std[:, 2]).all() and np.abs(path.xyz_m - truth).max() < 1e-3
    assert np.allclose(std[:, 0], 0.5 * DEPTH / 300, rtol=0.1)  # half a pixel of picking
    assert np.allclose(path.T_world_tip[:, :3, :3], np.eye(3))  # along the view


def test_a_world_and_a_tool_axis_are_taken(run, tmp_path):
    code, told = run(EDGE, "--world", str(tmp_path / "world.yaml"), "--tool-axis", "0,1,-1")
    path = read_path(tmp_path / "path.csv")
    assert code == 0 and told["frame"] == "base"
    # half a turn about x: (x, y, z) -> (x, -y, -z), then the place of the rig
    assert np.allclose(path.xyz_m[0], [0.3 - 39.5 / 600, 19.5 / 600, 0.5], atol=1e-3)
    assert np.allclose(path.T_world_tip[:, :3, 2], [0, math.sqrt(0.5), -math.sqrt(0.5)])


def test_the_right_view_can_be_picked_too(run, tmp_path):
    code, told = run("u_px,v_px\n70,40\n90,50\n", "--view", "right")
    assert code == 0 and np.allclose([p["other_px"] for p in told["points"]], [[100, 40], [120, 50]], atol=0.1)
    assert np.allclose(read_path(tmp_path / "path.csv").xyz_m[:, 2], DEPTH, atol=2e-3)


def test_what_is_not_found_is_named_and_left_out_only_when_asked(run, tmp_path):
    picks = "u_px,v_px\n60,40\n3,40\n100,70\n"  # the second is at the border
    code, told = run(picks)
    assert code == 3 and "pick 1" in told["error"]["cause"] and "border" in told["error"]["cause"]
    assert not (tmp_path / "path.csv").exists()
    code, told = run(picks, "--skip")
    assert code == 0 and told["n"] == 2
    assert [(one["pick"], one["kind"]) for one in told["refused"]] == [(1, "Inconsistent")]


@pytest.mark.parametrize(
    ("picks", "more", "code"),
    [
        ("u_px\n60\n", (), 3),
        ("u_px,v_px,edge\n60,40,a\n70,40,b\n80,40,a\n", (), 3),
        ("u_px,v_px\n60,40\n", (), 3),  # one point is no path
        (EDGE, ("--view", "top"), 2),
        (EDGE, ("--tool-axis", "0,0,0"), 2),
        (EDGE, ("--step-px", "0"), 2),
        (EDGE, ("--near", "2", "--far", "1"), 2),
    ],
)
def test_wrong_input_is_refused(picks, more, code, run, tmp_path):
    got, told = run(picks, *more)
    assert got == code and told["error"]["cause"]
    assert not (tmp_path / "path.csv").exists()
