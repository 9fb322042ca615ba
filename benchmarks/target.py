"""A lit target's geometry: error against the Cramer-Rao bound, intervals, and the mean of triangulated frames.

Run with --quick for a tenth of the trials. Two 1280x720 webcams 120 mm apart that look at one point see a scalene
target of 62 to 81 mm sides at 0.5 to 0.7 m, tilted by 25 degrees RMS, spots with 0.05 px of noise. Peer: every frame's
triangle triangulated, the distances averaged; the lights' names are given to it. The bound is taken from
OpenCV's projection by differences, at the true shape and poses.
"""

from __future__ import annotations

import argparse
from functools import partial

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

import bench
from armsight.calibrate.light_target import LitFrame, TargetResult, calibrate_target
from armsight.optics import Camera, converged_rig, triangulate
from armsight.records import Spots
from armsight.units import DEG, MM

CAMERA = Camera.pinhole(1280, 720, 1131.0, 1127.0, 643.5, 352.25, distortion=(-0.28, 0.09, 8e-4, -5e-4, -0.012))
RIG = converged_rig(CAMERA, CAMERA, 0.12, 0.08, -0.08)
SIGMA_PX = 0.05
SHAPE = np.array([[-0.045, 0.0, 0.0], [0.03, 0.03, 0.0], [0.015, -0.03, 0.0]])
EDGES = ((0, 1), (0, 2), (1, 2))
STEP = 1e-6


def look(points: np.ndarray) -> np.ndarray:
    """Return pixels (2, n, 2) of both views."""
    return np.stack(
        [
            cv2.projectPoints(
                np.ascontiguousarray(points), T.rotation.as_rotvec(), T.translation, camera.matrix, camera.distortion
            )[0][:, 0]
            for camera, T in ((RIG.left, RIG.T_rig_left.inv()), (RIG.right, RIG.T_rig_right.inv()))
        ]
    )


def simulate(rng: np.random.Generator, n: int) -> tuple[list[RigidTransform], list[LitFrame]]:
    poses, frames = [], []
    for i in range(n):
        turn = Rotation.from_rotvec(rng.normal(0, 25 * DEG / np.sqrt(3), 3))
        poses.append(RigidTransform.from_components(rng.uniform([-0.1, -0.08, 0.5], [0.1, 0.08, 0.7]), turn))
        uv = look(poses[-1].apply(SHAPE))
        left, right = (spots(view + rng.normal(0, SIGMA_PX, view.shape)) for view in uv)
        frames.append(LitFrame(name=str(i), left=left, right=right))
    return poses, frames


def spots(uv: np.ndarray) -> Spots:
    n = len(uv)
    return Spots(
        uv_px=uv,
        covariance_px2=np.tile(SIGMA_PX**2 * np.eye(2), (n, 1, 1)),
        peak=np.full(n, 100.0),
        size_px=np.full(n, 2.0),
        model=("gaussian",) * n,
    )


def bound(poses: list[RigidTransform]) -> np.ndarray:
    """Return the least variances (3,) of the three distances: information of all frames, the poses eliminated."""
    free = SHAPE[:, :2].copy()  # a flat shape: two coordinates each, three of which the poses take over

    def pixels(T: RigidTransform, flat: np.ndarray, p: np.ndarray) -> np.ndarray:
        moved = RigidTransform.from_components(T.translation + p[:3], Rotation.from_rotvec(p[3:]) * T.rotation)
        return look(moved.apply(np.column_stack([flat.reshape(3, 2), np.zeros(3)]))).ravel()

    S = np.zeros((6, 6))
    for T in poses:
        by_shape = np.stack(
            [(pixels(T, free.ravel() + d, np.zeros(6)) - pixels(T, free.ravel() - d, np.zeros(6))) / (2 * STEP)
             for d in STEP * np.eye(6)], axis=1)  # fmt: skip
        by_pose = np.stack(
            [(pixels(T, free.ravel(), d) - pixels(T, free.ravel(), -d)) / (2 * STEP) for d in STEP * np.eye(6)], axis=1
        )
        rest = by_shape - by_pose @ np.linalg.lstsq(by_pose, by_shape, rcond=None)[0]
        S += rest.T @ rest / SIGMA_PX**2
    values, vectors = np.linalg.eigh(S)
    C = (vectors[:, 3:] / values[3:]) @ vectors[:, 3:].T  # three directions are the poses' own
    out = []
    for i, j in EDGES:
        J = np.zeros((3, 2))
        v = (free[i] - free[j]) / np.linalg.norm(free[i] - free[j])
        J[i], J[j] = v, -v
        out.append(J.ravel() @ C @ J.ravel())
    return np.array(out)


def averaged(frames: list[LitFrame]) -> np.ndarray:
    """Return the mean of the distances (3,) of every frame's triangulated lights."""
    lengths = []
    for frame in frames:
        left, right = frame.left, frame.right
        X = triangulate(RIG, left.uv_px, right.uv_px, left.covariance_px2, right.covariance_px2).xyz_m
        lengths.append([np.linalg.norm(X[i] - X[j]) for i, j in EDGES])
    return np.mean(lengths, axis=0)


def by_edge(done: TargetResult) -> tuple[np.ndarray, np.ndarray]:
    """Return distances and standard deviations (3,)."""
    found = done.distances_m.values()
    return np.array([d.value_m for d in found]), np.array([d.std_m for d in found])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a tenth of the trials")
    trials = 30 if parser.parse_args().quick else 300
    print(bench.machine())
    truth = np.array([np.linalg.norm(SHAPE[i] - SHAPE[j]) for i, j in EDGES])
    rows: list[list[object]] = []
    for n in (5, 10, 30):
        ours, peer, least, inside, refused = [], [], [], [], 0
        for trial in range(trials):
            poses, frames = simulate(np.random.default_rng([n, trial]), n)
            done = calibrate_target(RIG, frames)
            refused += done.n_used < n
            value, std = by_edge(done)
            ours.append(value - truth)
            peer.append(averaged(frames) - truth)
            least.append(bound(poses))
            inside.append(np.abs(value - truth) < 1.959964 * std)
        floor = np.sqrt(np.mean(least))
        for name, errors in (("bundle", ours), ("mean of triangulated", peer)):
            rms = float(np.sqrt(np.mean(np.square(errors))))
            held = f"{100 * np.mean(inside):.1f}" if name == "bundle" else "-"
            left = refused if name == "bundle" else "-"
            bias = float(np.abs(np.mean(errors, axis=0)).max()) / MM
            rows.append([n, name, rms / MM, rms / floor, bias, held, left])
    bench.table(
        f"Distances of three lights, {trials} trials",
        ["frames", "method", "RMS mm", "RMS / bound", "bias mm", "95 % hold, %", "trials with a frame left out"],
        rows,
    )
    times = {}
    for n in (10, 100):
        frames = simulate(np.random.default_rng(0), n)[1]
        times |= bench.interleaved_ms({f"bundle, {n} frames": partial(calibrate_target, RIG, frames)}, 10)
    bench.table("Time", ["method", "median ms"], [[k, float(np.median(v))] for k, v in times.items()])


if __name__ == "__main__":
    main()
