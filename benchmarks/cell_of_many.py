"""A cell calibrated by two, three and four cameras of one scene, its errors beside what each calibration claims.

    python benchmarks/cell_of_many.py [SEEDS] [SECONDS]

The world is tests/truth/cell_world.py: an arm that strays, webcams with clocks of their own, lights that shine to one
side alone. The third and the fourth camera look from 50 degrees beside the first two, and see the lights seldom or in
part. Off is what the tip is off as the cameras then measure it with exact spots, over 60 positions; within are the
shares of the tips' and the cameras' errors in the ellipsoids that are claimed to hold 95 %.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from scipy.spatial.transform import RigidTransform

sys.path.insert(0, str(Path(__file__).parents[1] / "tests" / "truth"))
from cell_calibrated import calibrated, camera_squares
from cell_cameras import HIDDEN_DEG, WebCam
from cell_world import NAMED, CellWorld, watched_by_four

from armsight.calibrate.cell import CellResult
from armsight.calibrate.cell.result import tip_slopes
from armsight.errors import ArmsightError
from armsight.fitting.quantiles import chi2_isf
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.views import measure_views
from armsight.records import PoseStatus, Spots

EXACT_PX = 1e-3


def tips(world: CellWorld, cameras: tuple[WebCam, ...], done: CellResult) -> tuple[np.ndarray, np.ndarray]:
    """Return errors (k, 3) of the tip as it is then measured, and the covariances (k, 3, 3) that are claimed."""
    truth, setup = world.truth, Setup(rig=done.rig, target=done.target)
    q = truth.samples
    T = truth.flange(q)
    points = np.einsum("mij,lj->mli", T[:, :3, :3], truth.lights) + T[:, None, :3, 3]
    axes = np.einsum("mij,lj->mli", T[:, :3, :3], truth.normals)
    uv = [camera.project(points) for camera in cameras]
    looked = np.stack(
        [
            camera.inside(px) & (camera.facing(points, axes) < np.radians(HIDDEN_DEG))
            for camera, px in zip(cameras, uv, strict=True)
        ],
        axis=1,
    )
    model = done.solved.model
    pair = model.recording.is_pair
    sigma = [camera.noise_px for camera in cameras]
    at = (done.solved.fit.x, q, done.parts.T_flange_target, truth.tip_target_m, sigma)
    slopes = tip_slopes(model, *at, None if pair else looked)
    off, claimed, C = [], [], slopes.spread_m(slopes.measured, done.covariance)
    for k in np.flatnonzero(slopes.seen):
        seen = [Spots.of_centres(px[k][looked[k, s]], EXACT_PX**2 * np.eye(2)) for s, px in enumerate(uv)]
        found = measure_spots(setup, 0.0, *seen) if pair else measure_views(setup, 0.0, seen)
        pose = found.pose.T_parent_target
        if pose is not None and found.pose.status is PoseStatus.OK:
            T_rig = RigidTransform.from_matrix(np.asarray(pose))
            off.append((done.T_base_rig * T_rig).apply(truth.tip_target_m) - truth.tips(q[k : k + 1])[0])
            claimed.append(C[k])
    return np.array(off), np.array(claimed)


def main(seeds: int, seconds: float) -> None:
    """Print the table, a line after each seed."""
    rows: dict[int, list[tuple[float, float, np.ndarray, list[float], int]]] = {2: [], 3: [], 4: []}
    for seed in range(1, seeds + 1):
        world, cameras, tracks = watched_by_four(seed, seconds)
        for V, kept in rows.items():
            try:
                done = calibrated(world, dict(zip(NAMED[:V], tracks, strict=False)))
            except ArmsightError as error:
                print(f"seed {seed}, {V} cameras: {error}", flush=True)
                continue
            off, C = tips(world, cameras[:V], done)
            chi2 = np.einsum("ki,ki->k", off, np.linalg.solve(C, off[:, :, None])[:, :, 0])
            rms, claimed = np.sqrt((off**2).sum(axis=1).mean()), np.sqrt(np.trace(C, axis1=1, axis2=2).mean())
            squares = camera_squares(dict(zip(NAMED, cameras, strict=True)), done)
            kept.append((rms, claimed, chi2, squares, len(off)))
            print(
                f"seed {seed}, {V} cameras: tip off by {1e3 * rms:.2f} mm, claimed {1e3 * claimed:.2f}, at {len(off)} "
                f"of 60; cameras' chi2/6 {' '.join(f'{one / 6:.2f}' for one in kept[-1][3])}; {'; '.join(done.notes)}",
                flush=True,
            )
    print(
        "cameras  seeds  tip off, mm  claimed, mm  off/claimed  tips within 95 %  cameras within 95 %  measured of 60"
    )
    for V, kept in rows.items():
        if not kept:
            continue
        off, claimed = (np.sqrt(np.mean(np.square([one[k] for one in kept]))) for k in (0, 1))
        tip = np.mean(np.concatenate([one[2] for one in kept]) < chi2_isf(0.05, 3))
        camera = np.mean(np.concatenate([one[3] for one in kept]) < chi2_isf(0.05, 6))
        print(
            f"{V:7d}  {len(kept):5d}  {1e3 * off:11.2f}  {1e3 * claimed:11.2f}  {off / claimed:11.2f}  {tip:16.1%}  "
            f"{camera:19.1%}  {np.mean([one[4] for one in kept]):14.1f}"
        )


if __name__ == "__main__":
    given = [float(text) for text in sys.argv[1:]]
    main(int(given[0]) if given else 20, given[1] if given[1:] else 60.0)
