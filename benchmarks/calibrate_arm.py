"""Calibration of a known arm: real measurements, a simulated one against its Cramer-Rao prediction, time beside peers.

    python benchmarks/calibrate_arm.py [--quick]

Peers: scipy's least_squares with finite differences on the same arm and parameters, and pybotics (pip install
pybotics), which is left out where it is not installed.
"""

from __future__ import annotations

import argparse
import importlib
import sys
import time
from pathlib import Path

import numpy as np
from scipy.optimize import least_squares
from scipy.spatial.transform import RigidTransform, Rotation
from scipy.stats import chi2

from armsight.calibrate.arm import ArmPoints, calibrate_arm
from armsight.kinematics import Arm, Joint, fk, moved, preset
from armsight.store.arm_points import read_arm_points
from bench import machine, table

DATA = Path(__file__).resolve().parents[2] / "shared" / "data"
NOISE_M = 1.3e-4
REACH = np.array([1.5, 0.8, 0.8, 2.0, 1.5, 2.5])


def real() -> None:
    """Print the two real sets."""
    if not DATA.is_dir():
        print(f"\nThe real measurements are not there and skipped: {DATA.name}")
        return
    base = RigidTransform.from_components([2.2, 0.0, 1.6], Rotation.from_euler("x", 90, degrees=True))
    joints = (Joint(name="j1", alpha_rad=-np.pi / 2), Joint(name="j2", d_m=-0.475, theta_rad=-np.pi / 2))
    positioner = Arm(name="positioner", joints=joints, T_world_base=base)
    links = (
        (0.1807, 0.0, 1),
        (0.0, -0.6127, 0),
        (0.0, -0.57155, 0),
        (0.17415, 0.0, 1),
        (0.11985, 0.0, -1),
        (0.11655, 0.0, 0),
    )
    ur = tuple(Joint(name=f"j{i}", d_m=d, a_m=a, alpha_rad=k * np.pi / 2) for i, (d, a, k) in enumerate(links, 1))
    train, holdout = (read_arm_points(DATA / "positioner" / f"{name}.csv") for name in ("train", "holdout"))
    rows = []
    for name, scale in (("positioner, geometry (wanted 0.39)", False), ("positioner, scales too (wanted 0.365)", True)):
        result = calibrate_arm(positioner, train, holdout=holdout, scale=scale)
        rows.append([name, 1e3 * result.left_before.mean_m, 1e3 * result.left_after.mean_m, result.level, result.gain])
    points = read_arm_points(DATA / "ur10_positions" / "points.csv")
    result = calibrate_arm(Arm(name="ur10e", joints=ur), points)
    name = "ur10_positions (wanted: no gain)"
    rows.append([name, 1e3 * result.left_before.mean_m, 1e3 * result.left_after.mean_m, result.level, result.gain])
    table("Mean error of rows left out, mm", ["set", "nominal", "kept", "model kept", "gain claimed"], rows)


def simulated(rng: np.random.Generator, n: int, tools: int) -> tuple[Arm, ArmPoints, ArmPoints]:
    """Return a nominal irb120, measurements of the true one, and further ones."""
    arm = preset("irb120")
    changes = {f"{j.name}.theta_rad": rng.normal() * np.deg2rad(2.0) for j in arm.joints}
    changes |= {f"{j.name}.{key}": rng.normal() * 5e-4 for j in arm.joints for key in ("a_m", "d_m")}
    true, at = moved(arm, changes), rng.normal([0.0, 0.0, 0.1], 0.08, (tools, 3))

    def measured(m: int) -> ArmPoints:
        q = rng.uniform(-1.0, 1.0, (m, 6)) * REACH
        T = fk(true, q)
        xyz = (np.einsum("mij,kj->mki", T[:, :3, :3], at) + T[:, None, :3, 3]).reshape(-1, 3)
        names = tuple(f"P{k}" for k in range(tools)) * m
        return ArmPoints(q=np.repeat(q, tools, axis=0), xyz_m=xyz + rng.normal(0.0, NOISE_M, xyz.shape), point=names)

    return arm, measured(n), measured(100)


def against_the_bound(runs: int) -> None:
    """Print left-out errors over their Cramer-Rao prediction, and how often the claimed intervals hold."""
    size, predicted, inside, total = [], [], 0, 0
    for seed in range(runs):
        arm, points, far = simulated(np.random.default_rng(seed), 36, 3)
        result = calibrate_arm(arm, points, holdout=far, scale=False)
        if result.covariance is None:
            raise RuntimeError("no covariance")
        _, J = result.model.predict(result.fitted.p, far)
        A = J[:, :3, [result.model.names.index(name) for name in result.covariance.names]]
        C = np.einsum("mij,jk,mlk->mil", A, result.covariance.matrix, A) + NOISE_M**2 * np.eye(3)
        draws = np.linalg.cholesky(C) @ np.random.default_rng(1).normal(size=(3, 400))
        e = result.model.errors(result.fitted.p, far)[0]
        size.append(np.linalg.norm(e, axis=1).mean())
        predicted.append(np.linalg.norm(draws, axis=1).mean())
        inside += int(np.sum(np.einsum("mi,mij,mj->m", e, np.linalg.inv(C), e) < chi2.ppf(0.95, 3)))
        total += len(e)
    table(
        f"irb120, 36 configurations of 3 points, 0.13 mm, zeros off by 2 deg, lengths by 0.5 mm: {runs} runs",
        ["", "value", "wanted"],
        [
            ["mean left-out error, mm", 1e3 * float(np.mean(size)), ""],
            ["over its Cramer-Rao prediction", float(np.mean(size) / np.mean(predicted)), "1.1"],
            ["places in their 95 % regions", f"{100.0 * inside / total:.1f} %", "93-97 %"],
        ],
    )


def speed(repeats: int) -> None:
    """Print the time to calibrate with 1,000 poses, beside scipy with finite differences and pybotics."""
    arm, points, _ = simulated(np.random.default_rng(0), 1000, 1)
    result = calibrate_arm(arm, points, scale=False)
    model, free = result.model, [result.model.names.index(name) for name in result.fitted.free]
    first = model.vector(model.pose(result.fitted.p, 0), [model.pose(result.fitted.p, 1)])

    def residuals(x: np.ndarray) -> np.ndarray:
        p = first.copy()
        p[free] = x
        return model.errors(p, points)[0].ravel() / NOISE_M

    def timed(call: object) -> float:
        start = time.perf_counter()
        call()  # type: ignore[operator]
        return time.perf_counter() - start

    ours = [timed(lambda: calibrate_arm(arm, points, scale=False)) for _ in range(repeats)]
    scipy_s = [timed(lambda: least_squares(residuals, first[free], x_scale="jac")) for _ in range(max(repeats // 3, 1))]
    rows = [
        [f"armsight: three models, {len(free)} parameters, left-out errors (wanted 1)", float(np.median(ours)), 1.0],
        [
            "scipy, finite differences: the one fit",
            float(np.median(scipy_s)),
            float(np.median(scipy_s) / np.median(ours)),
        ],
    ]
    peer = pybotics_s(arm, points)
    if peer is not None:
        rows.append(["pybotics, DH parameters, finite differences: five steps", peer, peer / float(np.median(ours))])
    table("1,000 poses, s", ["what", "median", "over ours"], rows)
    if peer is None:
        print("\npybotics is not installed and left out.")


def pybotics_s(arm: Arm, points: ArmPoints) -> float | None:
    """Return the time pybotics takes for the DH parameters alone (base and tool held); None where it is not there."""
    try:
        robot_module, optimization, chain = (
            importlib.import_module(f"pybotics.{name}") for name in ("robot", "optimization", "kinematic_chain")
        )
    except ImportError:
        return None
    rows = np.array([[j.alpha_rad, j.a_m, j.theta_rad, j.d_m] for j in arm.joints])
    robot = robot_module.Robot(chain.MDHKinematicChain(rows))
    places = np.array([robot.fk(q)[:3, 3] for q in points.q])
    places += np.random.default_rng(0).normal(0.0, NOISE_M, places.shape)
    handler = optimization.OptimizationHandler(robot, kinematic_chain_mask=True)
    start = time.perf_counter()
    least_squares(
        optimization.optimize_accuracy, handler.generate_optimization_vector(), args=(handler, points.q, places),
        max_nfev=5,
    )  # fmt: skip
    return time.perf_counter() - start


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few runs")
    quick = parser.parse_args().quick
    print(machine())
    real()
    against_the_bound(20 if quick else 400)
    speed(2 if quick else 9)


if __name__ == "__main__":
    sys.exit(main())
