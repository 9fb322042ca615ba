"""Poses of one recording are not independent: the tip claimed of them holds where their errors drift."""

from __future__ import annotations

import sys
from pathlib import Path
from unittest.mock import patch

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.tooltip import MeasuredPoint, calibrate_tooltip
from armsight.calibrate.tooltip_result import ToolTipResult
from armsight.errors import Inconsistent
from armsight.ops.calibrate_robot import calibrate_tool_tip
from armsight.records import PoseStatus, TargetPose
from armsight.store import write_poses

sys.path.insert(0, str(Path(__file__).parent))
from drifting_pivot import POINT_M, TIP_M, pivot

from refusals import refuses

SEEDS = range(12)


@pytest.fixture(scope="module")
def found() -> list[ToolTipResult]:
    return [calibrate_tooltip(pivot(seed).poses, t_s=pivot(seed).t_s) for seed in SEEDS]


def test_the_deviations_claimed_hold(found: list[ToolTipResult]) -> None:
    """36 coordinates: 95 % are held by 1.96 deviations; below 30 with a chance of 0.6 %, were they independent."""
    z = np.array([(one.tip_m - TIP_M) / list(one.std.values()) for one in found])
    assert (np.abs(z) < 1.96).sum() >= 30
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.4
    with patch("armsight.calibrate.tooltip.widened", lambda covariance, *_: covariance):
        alone = [calibrate_tooltip(pivot(seed).poses) for seed in SEEDS]
    proud = np.array([(one.tip_m - TIP_M) / list(one.std.values()) for one in alone])
    assert np.sqrt(np.mean(proud**2)) > 1.25 * np.sqrt(np.mean(z**2))
    assert all(one.correlation is None and one.notes == () for one in alone)


def test_left_out_are_blocks_of_time(found: list[ToolTipResult]) -> None:
    drift = np.array([pivot(seed).drift_s for seed in SEEDS])
    worth = np.array([one.correlation.n_effective / one.n_used for one in found if one.correlation is not None])
    assert len(worth) == len(found) and np.corrcoef(np.log(drift), np.log(worth))[0, 1] < -0.6
    slow = int(np.argmin(worth))
    made = pivot(slow)
    alone = calibrate_tooltip(made.poses)
    assert found[slow].loo_rms_m is not None and alone.loo_rms_m is not None
    assert found[slow].loo_rms_m > 1.03 * alone.loo_rms_m > 0.0


def test_left_out_poses_are_what_fits_without_them_say() -> None:
    poses = pivot(3).poses[np.arange(0, 60, 3)]
    whole = calibrate_tooltip(poses)
    rest = calibrate_tooltip(poses[np.arange(1, 20)])
    expected = poses[0].apply(np.array(rest.tip_m)) - rest.point_m
    assert np.linalg.norm(whole.left_out_m[0] - expected) < 0.1 * np.linalg.norm(expected)


def test_the_order_plays_no_part_and_a_measured_point_counts() -> None:
    made = pivot(5)
    order = np.random.default_rng(0).permutation(len(made.t_s))
    one, other = calibrate_tooltip(made.poses, t_s=made.t_s), calibrate_tooltip(made.poses[order], t_s=made.t_s[order])
    assert one.tip_m == pytest.approx(other.tip_m, abs=1e-9)
    point = MeasuredPoint(xyz_m=np.add(POINT_M, [5e-5, 0.0, 0.0]), sigma_m=5e-5)
    sure = calibrate_tooltip(made.poses, point=point, t_s=made.t_s)
    assert max(sure.std.values()) < max(one.std.values())
    assert (np.abs(sure.tip_m - TIP_M) < 4.0 * np.array(list(sure.std.values()))).all()
    with refuses(Inconsistent, "one moment"):
        calibrate_tooltip(made.poses, t_s=np.zeros(len(made.t_s)))


def test_the_files_times_are_used_and_counted_rows_are_not(tmp_path: Path) -> None:
    made = pivot(0)
    outputs = {}
    for name, t_s in {"timed": made.t_s, "counted": np.arange(len(made.t_s)), "still": 0.0 * made.t_s}.items():
        rows = [_target_pose(t, pose) for t, pose in zip(t_s.tolist(), made.poses, strict=True)]
        write_poses(tmp_path / "poses.csv", rows)
        outputs[name] = calibrate_tool_tip(tmp_path / "poses.csv", out=tmp_path / f"{name}.yaml")
    timed = outputs["timed"]
    assert timed.n_effective is not None and timed.n_effective < 0.7 * timed.n_used and timed.correlation_time_s
    assert outputs["counted"].n_effective is None and outputs["still"].to_dict().get("correlation_time_s") is None
    assert "n_effective" in (tmp_path / "timed.yaml").read_text(encoding="utf-8")
    assert "n_effective" not in (tmp_path / "counted.yaml").read_text(encoding="utf-8")


def _target_pose(t_s: float, pose: RigidTransform) -> TargetPose:
    return TargetPose(
        t_s=t_s,
        status=PoseStatus.OK,
        parent="rig",
        spots=("A", "B", "C"),
        T_parent_target=pose.as_matrix(),
        covariance=np.zeros((6, 6)),
    )
