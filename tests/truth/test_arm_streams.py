"""`calibrate arm` from one recording whose errors drift: deviations, kinds of model and left-out errors hold."""

from __future__ import annotations

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from armsight.calibrate.arm import ArmResult, calibrate_arm
from armsight.calibrate.arm.covariance import HeldGeometry, believed, drift_of, in_blocks
from armsight.calibrate.arm.fit import ArmFit, Tolerance, fit_arm
from armsight.calibrate.arm.initial_guess import start
from armsight.calibrate.arm.model import ArmModel
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


def zeros_of(
    seed: int, built_m: np.ndarray | None, off_rad: float = 0.005
) -> tuple[np.ndarray, ArmFit, ArmFit, HeldGeometry | None]:
    """Return what the zeros are off by, their fit with lengths held, as it is to be believed, and what is held."""
    made = stream(seed, rate_hz=4.0, built_m=built_m, off_rad=off_rad)
    model, tolerance = ArmModel(arm=NOMINAL, labels=made.points.labels, turned=False), Tolerance()
    fitted = fit_arm(model, made.points, start(model, made.points), JUDGED, tolerance)
    drift = drift_of(model, made.points, fitted)
    assert drift is not None
    points = in_blocks(made.points, drift.correlation)
    assert points.block is not None
    off = np.array([fitted.fit.value(name) - made.true[name] for name in JUDGED])
    fit, _, held = believed(model, points, fitted, tolerance)
    return off, fitted, fit, held


def claims(fit: ArmFit) -> np.ndarray:
    return np.array([fit.fit.std()[name] for name in JUDGED])


def test_lengths_that_are_held_and_off_widen_what_zeros_claim() -> None:
    lengths = np.random.default_rng(4).normal(0.0, 1e-3, (6, 5, 2))
    found = [zeros_of(seed, built) for seed, built in enumerate(lengths)]
    z = np.array([off / claims(fit) for off, _, fit, _ in found])
    assert np.sqrt(np.mean(z**2)) < 1.3 and np.abs(z).max() < 3.0
    assert max(np.abs(off / claims(own)).max() for off, own, _, _ in found) > 10.0


def test_lengths_that_are_right_cost_zeros_next_to_nothing() -> None:
    off, _, fit, held = zeros_of(1, None)
    assert held is not None and fit.fit.covariance is not None and not held.doubt(fit, JUDGED)
    added = np.linalg.norm(held.moved, axis=1)[[fit.fit.covariance.names.index(name) for name in JUDGED]]
    assert (added < 0.5 * claims(fit)).all() and np.abs(off / claims(fit)).max() < 3.0


def test_one_length_off_is_told_beside_zeros_that_stand_for_it() -> None:
    built = np.zeros((5, 2))
    built[1, 1] = 2e-3
    off, _, fit, held = zeros_of(0, built, off_rad=0.0)
    assert held is not None and np.abs(off / claims(fit)).max() < 2.0
    k = held.names.index("j2.a_m")
    assert abs(held.off[k] - 2e-3) < 3.0 * held.std[k] < 2e-3
    doubt = held.doubt(fit, JUDGED)
    assert "j3.theta_rad cannot be told" in doubt and "j2.a_m off by +" in doubt


def test_times_are_read_and_may_be_missing(tmp_path: Path) -> None:
    file = tmp_path / "points.csv"
    file.write_text("q1,q2,x_m,y_m,z_m,t_s\n0.1,0.2,0.3,0.4,0.5,12.5\n0.2,0.2,0.3,0.5,0.5,12.6\n", encoding="utf-8")
    assert np.asarray(read_arm_points(file).t_s).tolist() == [12.5, 12.6]
    file.write_text("q1,q2,x_m,y_m,z_m\n0.1,0.2,0.3,0.4,0.5\n", encoding="utf-8")
    assert read_arm_points(file).t_s is None
