"""Strangers' rows that are not independent: ten readings at each place, a stream that brings no times."""

import numpy as np

from armsight.ops.calibrate_robot import calibrate_arm
from reports import case


def calibrated(name, points, model, **more):
    return calibrate_arm(model, case(name) / points, **more)


def test_ten_readings_of_a_place_are_worth_their_mean():
    means = calibrated("arms-09", "means-0.csv", "irb120", scale=False)
    first, second = (calibrated("arms-09", f"ten-readings-{k}.csv", "irb120", scale=False) for k in (0, 1))
    assert (first.n, first.n_effective, means.n_effective) == (700, 70, None)
    assert abs(first.deviations["j2.theta_rad"] / means.deviations["j2.theta_rad"] - 1.0) < 1e-3
    both = set(first.free) & set(second.free)
    z = [
        (first.change(name) - second.change(name)) / np.hypot(first.deviations[name], second.deviations[name])
        for name in sorted(both)
    ]
    assert np.sqrt(np.mean(np.square(z))) < 1.3  # 3.1 where ten readings are ten rows


def test_a_stream_without_times_accuses_no_good_arm():
    found = calibrated("arms-16", "points.csv", "ur10e")
    assert not found.gain and found.other_arm is None
    assert found.n_effective < 30
