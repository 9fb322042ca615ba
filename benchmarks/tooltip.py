"""The tool's tip: pivoting, with and without a measured point, against the mean of Pachidis eq. (13).

Run with --quick for a tenth of the trials. Poses are tilted up to 25 degrees about each axis; the point is measured
with 0.2 mm a coordinate. Noise of the poses: 0.02, 0.05, 0.12 mm and 0.2 degrees (a lit target at 0.6 m).
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import bench
from armsight.calibrate.tooltip import MeasuredPoint, calibrate_tooltip, mean_tip
from armsight.units import DEG, MM

TIP_M = np.array([0.0, 0.0, 0.08])
POINT_M = np.array([0.2, 1.2, 0.08])
SIGMA_M = np.array([0.02, 0.05, 0.12]) * MM
SIGMA_RAD = 0.2 * DEG
POINT_SIGMA_M = 0.2 * MM


def simulate(rng: np.random.Generator, n: int) -> RigidTransform:
    R = Rotation.from_rotvec(rng.uniform(-25 * DEG, 25 * DEG, (n, 3)))
    t = POINT_M - R.apply(TIP_M)
    noise = Rotation.from_rotvec(rng.normal(0, SIGMA_RAD, (n, 3)))
    return RigidTransform.from_components(t + rng.normal(0, 1, (n, 3)) * SIGMA_M, noise * R)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the trials")
    trials = 100 if parser.parse_args().quick else 1000
    print(bench.machine())
    rows: list[list[object]] = []
    covariance = np.diag([*SIGMA_M**2, *[SIGMA_RAD**2] * 3])
    for n in (10, 20, 50):
        off: dict[str, list[np.ndarray]] = {}
        inside = []
        for trial in range(trials):
            rng = np.random.default_rng([n, trial])
            poses = simulate(rng, n)
            point = POINT_M + rng.normal(0, POINT_SIGMA_M, 3)
            measured = MeasuredPoint(xyz_m=point, sigma_m=POINT_SIGMA_M)
            M = poses.as_matrix()
            given = np.tile(covariance, (n, 1, 1))
            pivot = calibrate_tooltip(poses)
            off.setdefault("mean, eq. (13)", []).append(mean_tip(M[:, :3, :3], M[:, :3, 3], point) - TIP_M)
            off.setdefault("pivot", []).append(pivot.tip_m - TIP_M)
            off.setdefault("pivot, noise of the poses given", []).append(calibrate_tooltip(poses, given).tip_m - TIP_M)
            both = calibrate_tooltip(poses, given, measured)
            off.setdefault("pivot and the point as measured", []).append(both.tip_m - TIP_M)
            inside.append(np.abs(pivot.tip_m - TIP_M) < 1.96 * np.array(list(pivot.std.values())))
        for name, values in off.items():
            rms = np.sqrt(np.mean(np.square(values), axis=0)) / MM
            held = float(100.0 * np.mean(inside)) if name == "pivot" else "-"
            rows.append([n, name, *(float(v) for v in rms), held])
    bench.table(
        f"Error of the tip, mm RMS, {trials} trials", ["poses", "method", "x", "y", "z", "95 % intervals hold, %"], rows
    )
    poses = simulate(np.random.default_rng(0), 50)
    M = poses.as_matrix()
    times = bench.interleaved_ms(
        {
            "pivot": partial(calibrate_tooltip, poses),
            "mean, eq. (13)": partial(mean_tip, M[:, :3, :3], M[:, :3, 3], POINT_M),
        },
        30,
    )
    bench.table("Time, 50 poses", ["method", "median ms"], [[k, float(np.median(v))] for k, v in times.items()])


if __name__ == "__main__":
    main()
