"""Absolute and relative pose errors against evo's own numbers on exported TUM files (data/evo/README.md)."""

import json
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform

from armsight.errors import Inconsistent, NotEnoughData, UsageError
from armsight.store import read_tum
from armsight.verify.trajectory import absolute_pose_error, aligned, relative_pose_error
from refusals import refuses

DATA = Path(__file__).parent / "data" / "evo"
EVO = json.loads((DATA / "evo.json").read_text())
TOLERANCE = 1e-9  # m and rad


def tracks():
    files = (read_tum(DATA / f"{name}.tum") for name in ("reference", "estimate"))
    return (RigidTransform.concatenate([pose.pose for pose in poses]) for poses in files)


def same(error, key, suffix=""):
    for part, values, rms in (
        ("translation", error.distance_m, error.rms_m),
        ("angle", error.angle_rad, error.rms_rad),
    ):
        golden = EVO[f"{key}_{part}{suffix}"]
        np.testing.assert_allclose(values, golden["errors"], rtol=0, atol=TOLERANCE)
        assert rms == pytest.approx(golden["rmse"], abs=TOLERANCE)


def test_absolute_errors_are_evos():
    reference, estimate = tracks()
    same(absolute_pose_error(reference, estimate), "ape")


def test_absolute_errors_after_alignment_are_evos():
    reference, estimate = tracks()
    same(absolute_pose_error(reference, aligned(reference, estimate)), "ape", "_aligned")


@pytest.mark.parametrize("step", [1, 3])
def test_relative_errors_are_evos(step):
    reference, estimate = tracks()
    same(relative_pose_error(reference, estimate, step=step), "rpe", f"_{step}")


def test_what_does_not_belong_together_is_refused():
    reference, estimate = tracks()
    with pytest.raises(Inconsistent, match="12 and 11"):
        absolute_pose_error(reference, estimate[:-1])
    with refuses(NotEnoughData, "13"):
        relative_pose_error(reference, estimate, step=12)
    with refuses(UsageError, "motion"):
        relative_pose_error(reference, estimate, step=0)
    with pytest.raises(UsageError, match="single"):
        aligned(reference[0], estimate[0])
