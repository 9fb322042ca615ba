"""Strangers' pivots: four poses as robots' manuals have them, and one that is too narrow for its noise."""

import numpy as np

from armsight.errors import Degenerate
from armsight.ops.calibrate_robot import calibrate_tool_tip
from refusals import refuses
from reports import case


def test_four_poses_know_the_tip_as_far_as_they_go(tmp_path):
    found = calibrate_tool_tip(case("cameras-23") / "four.csv", out=tmp_path / "tip.yaml")
    off = np.abs(found.tip_m - [0.0, 0.005, 0.145])
    assert (off < 2.5 * np.array(list(found.std.values()))).all()
    assert max(off) < 1e-3


def test_a_narrow_pivot_is_refused_for_its_tilt(tmp_path):
    with refuses(Degenerate, "turns by only", "scatter", "25 degrees"):
        calibrate_tool_tip(case("cameras-22") / "narrow.csv", out=tmp_path / "tip.yaml")
    assert not (tmp_path / "tip.yaml").exists()
