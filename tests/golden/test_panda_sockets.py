"""A real arm's ball in sockets: `calibrate tooltip` on poses of the nominal arm names the rows of another socket."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.arm import ArmPoints, calibrate_arm
from armsight.calibrate.tooltip import calibrate_tooltip
from armsight.calibrate.tooltip_result import ToolTipResult
from armsight.errors import Inconsistent
from armsight.kinematics import preset
from refusals import refuses

Array = NDArray[np.float64]
FILE = Path(__file__).parent / "panda_sockets" / "joints.csv"


def joints(name: str, socket: str) -> Array:
    with FILE.open() as file:
        rows = [row for row in csv.DictReader(file) if (row["set"], row["socket"]) == (name, socket)]
    return np.array([[float(row[f"q{i}"]) for i in range(1, 8)] for row in rows])


def tip(name: str, socket: str) -> ToolTipResult:
    return calibrate_tooltip(RigidTransform.from_matrix(preset("panda").fk(joints(name, socket))))


def test_rows_of_the_other_socket_are_named_and_no_others() -> None:
    first, second, left = tip("front", "0"), tip("front", "1"), tip("left", "0")
    assert not first.rejected
    assert not second.rejected
    assert [row for row, _ in left.rejected_rows] == list(range(30, 36))
    off = np.linalg.norm(left.residuals_m[30:], axis=1)
    assert np.abs(off - 0.05).max() < 5e-3  # the sockets are 50 mm apart
    assert np.linalg.norm(first.point_m - second.point_m) == pytest.approx(0.05, abs=1e-3)
    for found in (first, second, left):
        assert 3e-3 < found.residual_rms_m < 5e-3  # the nominal arm's errors


def test_deviations_hold_that_the_nominal_arm_errs_alike_where_poses_are_alike() -> None:
    tips = [tip("front", "0"), tip("front", "1"), tip("left", "0")]
    off = []
    for i, j in ((0, 1), (0, 2), (1, 2)):
        std = np.hypot(list(tips[i].std.values()), list(tips[j].std.values()))
        off.append(np.abs(tips[i].tip_m - tips[j].tip_m) / std)
    assert np.max(off) < 4.0  # 6 with rows counted as independent
    assert max(max(found.std.values()) for found in tips) < 2e-3


def test_two_points_are_no_places_to_calibrate_an_arm_by() -> None:
    q = np.concatenate([joints("front", "0"), joints("front", "1")])
    xyz_m = np.where(np.arange(len(q))[:, None] < 31, [0.0, 0.0, 0.0], [0.0, 0.05, 0.0])
    with refuses(Inconsistent, "2 positions", "touched", "--touch"):
        calibrate_arm(preset("panda"), ArmPoints(q=q, xyz_m=xyz_m))
