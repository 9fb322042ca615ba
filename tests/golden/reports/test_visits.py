"""Strangers' visits of two poses by an arm that warms up."""

import pytest

from armsight.ops.verify import verify
from refusals import names_it
from reports import case


def test_visits_that_drift_are_told_and_their_deviation_is_withheld(tmp_path):
    done = verify(measured=case("arms-25") / "visits.csv", out=tmp_path / "v")
    rp = done.iso9283["RP_m"]
    assert rp.value == pytest.approx(0.372e-3, abs=2e-6)  # by formula, as the case gives it
    assert rp.std is None and names_it(rp.note, "drift", "independent")
    without_mm = float(rp.note.split("RP is ")[-1].split(" mm")[0])
    assert without_mm == pytest.approx(0.131, abs=0.02)
    assert done.verdict_.level == "care" and names_it(done.verdict, "P1", "P2", "drift")
