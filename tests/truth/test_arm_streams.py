"""`calibrate arm` from one recording whose errors drift: deviations, kinds of model and left-out errors hold."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armsight.calibrate.arm import ArmResult, calibrate_arm
from armsight.store.arm_points import read_arm_points

sys.path.insert(0, str(Path(__file__).parent))
from arm_streams import JUDGED, NOMINAL, stream

SEED = 0


@pytest.fixture(scope="module")
def timed() -> ArmResult:
    return calibrate_arm(NOMINAL, stream(SEED).points, scale=False)


@pytest.fixture(scope="module")
def untimed() -> ArmResult:
    return calibrate_arm(NOMINAL, replace(stream(SEED).points, t_s=None), scale=False)


@pytest.fixture(scope="module")
def mixed() -> ArmResult:
    points = stream(SEED).points
    order = np.random.default_rng(1).permutation(len(points))
    return calibrate_arm(NOMINAL, replace(points, t_s=None).take(order), scale=False)


def errors_over_claims(found: ArmResult) -> np.ndarray:
    true, std = stream(SEED).true, found.std()
    return np.array([(found.change(name) - true[name]) / std[name] for name in JUDGED])


def test_a_drift_is_no_geometry_and_widens_what_is_claimed(
    timed: ArmResult, untimed: ArmResult, mixed: ArmResult
) -> None:
    assert timed.gain and timed.level == "joint zeros"
    assert np.abs(errors_over_claims(timed)).max() < 2.5
    assert np.abs(errors_over_claims(mixed)).max() > 3.0  # what the times, or the order, are for
    assert timed.correlation is not None and timed.correlation.n_effective < 0.1 * len(timed.error_m)
    assert mixed.correlation is None and not any("stream" in note for note in mixed.notes)
    assert untimed.n_effective == pytest.approx(timed.n_effective, rel=0.1)  # rows that follow one motion are in order
    assert untimed.std() == pytest.approx(timed.std(), rel=0.1)
    assert untimed.correlation_time_s is None and any("rows are worth" in note for note in untimed.notes)


def test_it_is_said_in_the_output(timed: ArmResult) -> None:
    told = timed
    assert any("samples of a stream" in note for note in told.notes)
    assert told.n_effective is not None and told.correlation_time_s is not None and told.correlation_time_s > 0.5
    names = timed.arm.covariance
    assert names is not None and names.std()["j2.theta_rad"] == pytest.approx(told.deviations["j2.theta_rad"])


def test_blocks_of_time_are_left_out_with_what_is_near(timed: ArmResult, mixed: ArmResult) -> None:
    made = stream(SEED)
    whole = 3**0.5 * made.sigma_m  # of a place, all three coordinates
    assert 0.7 * whole < timed.cross_after.rms_m < 1.8 * whole
    assert mixed.cross_after.rms_m < timed.cross_after.rms_m
    block = np.repeat(np.arange(len(made.points) // 50 + 1), 50)[: len(made.points)]
    points = replace(made.points, block=block, gap_s=1.0)
    assert points.group.max() == block[-1]
    rest = points.away(block == 2)
    assert points.t_s is not None
    apart = np.abs(points.t_s[rest][:, None] - points.t_s[block == 2]).min()
    assert apart > 1.0 and rest.sum() >= len(points) - 50 - 22


def test_times_are_read_and_may_be_missing(tmp_path: Path) -> None:
    file = tmp_path / "points.csv"
    file.write_text("q1,q2,x_m,y_m,z_m,t_s\n0.1,0.2,0.3,0.4,0.5,12.5\n0.2,0.2,0.3,0.5,0.5,12.6\n", encoding="utf-8")
    assert np.asarray(read_arm_points(file).t_s).tolist() == [12.5, 12.6]
    file.write_text("q1,q2,x_m,y_m,z_m\n0.1,0.2,0.3,0.4,0.5\n", encoding="utf-8")
    assert read_arm_points(file).t_s is None
