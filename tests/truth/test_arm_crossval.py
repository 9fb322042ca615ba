"""What `calibrate arm` claims for rows left out, against explicit refits and the true arm; tolerances that bind.

The arms are simulated here, by Denavit-Hartenberg matrices of the test's own.
"""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.arm import ArmPoints, Tolerance, calibrate_arm
from armsight.report.arm_report import arm_report
from refusals import names_it

sys.path.insert(0, str(Path(__file__).parent))
from arm_streams import LINKS, NOMINAL, place

Array = NDArray[np.float64]

OFF = np.zeros((5, 4))
OFF[1:, 0], OFF[:4, 2], OFF[2, 1] = (-0.01, 0.006, 0.008, 0.0), (3e-4, 6e-4, -4e-4, 3e-4), -5e-4


def measured(rows: Array, m: int, seed: int, noise_m: float = 2e-4) -> ArmPoints:
    """Return the tool's place at m joint positions of the arm with rows (theta, d, a, alpha)."""
    rng = np.random.default_rng(seed)
    q = rng.uniform(-1.3, 1.3, (m, len(rows)))
    return ArmPoints(q=q, xyz_m=place(rows, q) + rng.normal(0.0, noise_m, (m, 3)))


def rms(size: Array) -> float:
    return float(np.sqrt(np.mean(size**2)))


def test_what_is_claimed_for_rows_left_out_is_what_refits_and_fresh_positions_give() -> None:
    points, fresh = measured(LINKS + OFF, 25, 0), measured(LINKS + OFF, 200, 1)
    result = calibrate_arm(NOMINAL, points)
    by_hand, unseen = np.empty(25), []
    for k in range(5):
        rows, rest = np.arange(k, 25, 5), np.flatnonzero(np.arange(25) % 5 != k)
        again = calibrate_arm(NOMINAL, points.take(rest))
        by_hand[rows] = np.linalg.norm(again.model.errors(again.fitted.p, points.take(rows))[0], axis=1)
        unseen.append(np.linalg.norm(again.model.errors(again.fitted.p, fresh)[0], axis=1))
    assert result.gain
    assert abs(result.cross_after.rms_m / rms(by_hand) - 1.0) < 0.1
    assert abs(result.cross_after.rms_m / rms(np.concatenate(unseen)) - 1.0) < 0.3  # 75 coordinates: 8 %, of few rows


def test_rows_of_a_point_seen_once_are_not_judged_and_that_is_said() -> None:
    points = measured(LINKS + OFF, 15, 2)
    alone = replace(points, point=("A",) * 14 + ("B",))
    result = calibrate_arm(NOMINAL, alone)
    assert any(names_it(note, "1 of 15", "B") for note in result.notes)
    assert result.to_dict()["notes"] == list(result.notes)


def test_a_tolerance_that_binds_is_said_with_the_option_that_raises_it() -> None:
    off = np.zeros((5, 4))
    off[3, 1] = 5e-3  # j4's d
    points = measured(LINKS + off, 30, 3)
    result = calibrate_arm(NOMINAL, points)
    assert [(item.name, item.limit, item.flag) for item in result.at_limit] == [("j4.d_m", 2e-3, "--tolerance-mm")]
    said = "j4.d_m stands at its limit of 2 mm"
    assert said in result.verdict and said in result.notes[0] and said in arm_report(result)
    assert "--tolerance-mm" in result.verdict
    told = result
    assert told.notes and told.at_limit[0].flag == "--tolerance-mm" and abs(told.at_limit[0].change - 5e-3) < 1e-3
    wide = calibrate_arm(NOMINAL, points, tolerance=Tolerance(length_m=10e-3))
    assert wide.gain and wide.at_limit == () and wide.notes == () and "limit" not in wide.verdict
