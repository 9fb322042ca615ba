"""Poses of one recording are not independent: what is claimed of them holds where their errors drift."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.calibrate.handeye import HandEyeResult, PosePairs, calibrate_eye_in_hand, pairs_of_streams
from armsight.errors import Inconsistent
from refusals import refuses

sys.path.insert(0, str(Path(__file__).parent))
from drifting_streams import error, streams

SEEDS = range(5)


@pytest.fixture(scope="module")
def found() -> list[HandEyeResult]:
    out = []
    for seed in SEEDS:
        made = streams(seed)
        out.append(calibrate_eye_in_hand(pairs_of_streams(made.t_s, made.flange, made.t_s, made.camera)[0]))
    return out


def test_the_deviations_claimed_hold(found: list[HandEyeResult]) -> None:
    """30 parameters: 95 % are held by 1.96 deviations; below 24 with a chance of 0.3 %, were they independent."""
    z = np.array([error(one.T_parent_camera) / list(one.std.values()) for one in found])
    assert (np.abs(z) < 1.96).sum() >= 24
    assert 0.6 < np.sqrt(np.mean(z**2)) < 1.5


def test_a_drift_is_told_and_counted(found: list[HandEyeResult]) -> None:
    drift = np.array([streams(seed).drift_s for seed in SEEDS])
    worth = np.array([one.correlation.n_effective for one in found if one.correlation is not None])
    assert len(worth) == len(found)
    assert np.corrcoef(np.log(drift), np.log(worth))[0, 1] < -0.6  # the longer the drift, the less they are worth
    assert (worth < 60.0).all()
    slow = found[int(np.argmin(worth))]
    assert "independent ones" in slow.verdict and any("record longer" in one for one in slow.concerns)


def test_poses_taken_one_by_one_are_claimed_as_before(found: list[HandEyeResult]) -> None:
    from dataclasses import replace

    alone = calibrate_eye_in_hand(replace(found[0].pairs, t_s=None))
    assert alone.correlation is None and "independent" not in alone.verdict
    assert alone.std["x_m"] < found[0].std["x_m"]


def test_a_mount_that_slipped_in_a_stream_is_told() -> None:
    """By 8 mm, beside drifts of up to 1 mm, of which streams as they are (above) are not accused."""
    made = streams(5)
    late = np.arange(len(made.t_s))[:, None] >= len(made.t_s) // 2
    seen = RigidTransform.from_translation(np.where(late, [0.0, 8e-3, 0.0], 0.0)) * made.camera
    rows = slice(None, None, 5)
    pairs = PosePairs(
        T_base_flange=made.flange[rows],
        T_camera_target=seen[rows],
        names=tuple(map(str, range(len(made.t_s[rows])))),
        t_s=made.t_s[rows],
    )
    with refuses(Inconsistent, "camera elsewhere", "slipped"):
        calibrate_eye_in_hand(pairs)
