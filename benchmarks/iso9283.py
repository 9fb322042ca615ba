"""ISO 9283: whether the standard deviations beside the figures are the real ones, over many simulated tests.

Run with --quick for a tenth of the trials. A robot with known repeatability visits a pose, seen by a camera with known
noise and a systematic part that is drawn anew for every test. claimed / real: the root mean square of the claimed
standard deviations over the standard deviation of the figure from test to test; 1 is right. covered: how often the
corrected figure and 1.96 of its standard deviations hold the robot's true one; 95 % is right.
"""

from __future__ import annotations

import argparse
from functools import partial

import numpy as np
from scipy.spatial.transform import Rotation

import bench
from armsight.units import MM
from armsight.verify.iso9283 import CommandedPath, Iso9283Test, PathRun, PathTest, PoseVisits, evaluate
from armsight.verify.iso9283.figure import radial

STEP_M = np.array([0.5, 0.3, 0.1])
OFFSET_M = np.array([150e-6, -80e-6, 40e-6])
SYSTEMATIC = np.diag([10e-6, 10e-6, 15e-6]) ** 2
SCENES = {
    "round scatter, good camera": (np.diag([30e-6] * 3) ** 2, np.diag([10e-6] * 3) ** 2),
    "long scatter, good camera": (np.diag([50e-6, 20e-6, 10e-6]) ** 2, np.diag([10e-6] * 3) ** 2),
    "long scatter, camera as noisy as the robot": (
        np.diag([50e-6, 20e-6, 10e-6]) ** 2,
        np.diag([20e-6, 20e-6, 60e-6]) ** 2,
    ),
}
"""Robot's and camera's covariance of one position, m^2."""


def visits(rng: np.random.Generator, n: int, robot: np.ndarray, camera: np.ndarray, sign: float) -> PoseVisits:
    at = np.zeros(3) if sign > 0 else STEP_M
    error = rng.multivariate_normal(np.zeros(3), robot + camera, n) + rng.multivariate_normal(np.zeros(3), SYSTEMATIC)
    return PoseVisits(
        pose="P2" if sign > 0 else "P4",
        xyz_m=at + sign * OFFSET_M + error,
        visit=np.arange(n),
        covariance=np.tile(camera + SYSTEMATIC, (n, 1, 1)),
        systematic=SYSTEMATIC,
        approach=("x",) * n,
        commanded_xyz_m=at,
    )


def poses(trials: int) -> list[list[object]]:
    along = STEP_M / np.linalg.norm(STEP_M)
    rows: list[list[object]] = []
    for scene, (robot, camera) in SCENES.items():
        truth = {
            "AP_m P2": float(np.linalg.norm(OFFSET_M)),
            "RP_m P2": radial(robot).repeatability,
            "AD_m P2-P4": float(np.linalg.norm(STEP_M - 2 * OFFSET_M) - np.linalg.norm(STEP_M)),
            "RD_m P2-P4": 3.0 * float(np.sqrt(2.0 * along @ robot @ along)),
        }
        for n in (5, 10, 30):
            found: dict[str, list[list[float | None]]] = {key: [] for key in truth}
            for trial in range(trials):
                rng = np.random.default_rng([n, trial])
                pair = tuple(visits(rng, n, robot, camera, sign) for sign in (1.0, -1.0))
                figures = evaluate(Iso9283Test(poses=pair))
                for key, values in found.items():
                    f = figures[key]
                    values.append([f.value, f.std, f.corrected, f.corrected_std])
            for key, true in truth.items():
                value, std, corrected, corrected_std = np.array(found[key], float).T
                rows.append(
                    [
                        scene,
                        key.split("_")[0],
                        n,
                        true / MM,
                        float(value.mean()) / MM,
                        float(corrected.mean()) / MM,
                        float(np.sqrt(np.mean(std**2)) / value.std(ddof=1)),
                        float(100.0 * np.mean(np.abs(corrected - true) <= 1.96 * corrected_std)),
                    ]
                )
    return rows


def path_test(rng: np.random.Generator, n: int) -> Iso9283Test:
    t = np.linspace(-0.1, 3.1, 161)
    path = CommandedPath(xyz_m=np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0]]), speed_m_s=0.1)
    runs = []
    for _ in range(n):
        y, z = np.array([1e-3, 0.0]) + rng.normal(0.0, 1e-4, 2)
        x = 0.15 + (0.101 + rng.normal(0.0, 1e-3)) * (t - 1.5)
        track = np.stack([x, np.full_like(t, y), np.full_like(t, z)], axis=1) + rng.normal(0.0, 2e-5, (len(t), 3))
        runs.append(PathRun(t_s=t, xyz_m=track))
    return Iso9283Test(paths=(PathTest(name="line", runs=tuple(runs), commanded=path),))


def paths(trials: int) -> list[list[object]]:
    rows: list[list[object]] = []
    for n in (5, 10):
        found: dict[str, list[list[float | None]]] = {key: [] for key in ("AT_m", "RT_m", "AV_ratio", "RV_ratio")}
        for trial in range(trials):
            figures = evaluate(path_test(np.random.default_rng([n, trial]), n))
            for key, values in found.items():
                values.append([figures[key].value, figures[key].std])
        for key, values in found.items():
            value, std = np.array(values, float).T
            rows.append([key, n, float(value.mean()), float(np.sqrt(np.mean(std**2)) / value.std(ddof=1))])
    return rows


def turned(rng: np.random.Generator) -> PoseVisits:
    quat = Rotation.from_rotvec(rng.normal(0.0, 1e-3, (30, 3))).as_quat()
    return PoseVisits(pose="P1", xyz_m=rng.normal(0.0, 1e-4, (30, 3)), quat_xyzw=quat, visit=np.arange(30))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the trials")
    trials = 100 if parser.parse_args().quick else 1000
    print(bench.machine())
    bench.table(
        f"Figures of poses, {trials} tests each",
        ["scene", "figure", "visits", "true, mm", "mean, mm", "corrected, mm", "claimed / real", "covered, %"],
        poses(trials),
    )
    few = max(trials // 5, 20)
    bench.table(
        f"Figures of a path, {few} tests each; AT and RT are the largest of 50 planes",
        ["figure", "runs", "mean", "claimed / real"],
        paths(few),
    )
    rng = np.random.default_rng(0)
    runs = {
        "one pose, 30 visits with orientations": partial(evaluate, Iso9283Test(poses=(turned(rng),))),
        "one path, 10 runs": partial(evaluate, path_test(rng, 10)),
    }
    times = bench.interleaved_ms(runs, 10)
    bench.table("Time", ["evaluated", "median ms"], [[k, float(np.median(v))] for k, v in times.items()])


if __name__ == "__main__":
    main()
