"""Strangers' points that were touched again and again: as positions refused by their cause, as touches calibrated."""

import pytest

from armsight.errors import Inconsistent, UsageError
from armsight.ops.calibrate_robot import calibrate_arm
from refusals import refuses
from reports import case


@pytest.mark.parametrize(("file", "places"), [("touch.csv", "2 positions"), ("one.csv", "1 position")])
def test_touched_points_are_named_and_touching_is_the_cure(file, places, tmp_path):
    path = case("arms-13") / file
    with refuses(Inconsistent, places, "touched", "touch") as caught:
        calibrate_arm("irb120", path, out=tmp_path / "a.yaml")
    assert "touch" in caught.value.cure
    with refuses(UsageError, "holdout", "touch"):
        calibrate_arm("irb120", touch=path, propose=2)
    done = calibrate_arm("irb120", touch=path, out=tmp_path / "a.yaml")
    assert done.gain
    # the nominal arm scatters by 2 mm about a spike
    assert done.cross_before.mean_m > 1e-3
    assert done.cross_after.mean_m < 1e-4
    lengths = {name for name in done.free if name in ("j2.a_m", "j3.a_m", "j4.d_m")}
    assert len(lengths) == (3 if places.startswith("2") else 0)
    assert "j3.theta_rad" in done.free
    assert "j1.theta_rad" not in done.corrections
