"""Strangers' points that were touched again and again: refused by their cause, and measured positions are the cure."""

import numpy as np
import pytest

from armsight.errors import Inconsistent
from armsight.kinematics import fk, preset
from armsight.ops.calibrate_robot import calibrate_arm
from refusals import refuses
from reports import case


@pytest.mark.parametrize(("file", "places"), [("touch.csv", 2), ("one.csv", 1)])
def test_touched_points_are_named_and_measured_ones_are_the_cure(file, places, tmp_path):
    path = case("arms-13") / file
    with (
        refuses(Inconsistent, f"{places} position", "touched") if places == 1 else refuses(Inconsistent, "2 positions")
    ):
        calibrate_arm("irb120", path, out=tmp_path / "a.yaml")
    rows = np.loadtxt(path, delimiter=",", skiprows=1)
    rows[:, 6:] = fk(preset("irb120"), rows[:, :6])[:, :3, 3] + np.random.default_rng(1).normal(
        0.0, 1e-4, (len(rows), 3)
    )
    head = path.read_text().splitlines()[0]
    np.savetxt(tmp_path / "measured.csv", rows, delimiter=",", header=head, comments="", fmt="%.9f")
    done = calibrate_arm("irb120", tmp_path / "measured.csv", out=tmp_path / "a.yaml")
    assert done.after.mean_m < 3e-4
