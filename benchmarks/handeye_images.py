"""What `calibrate handeye --images` keeps of few images, against truth: the result from poses, or from the corners.

    python benchmarks/handeye_images.py [--runs N] [--images 5 6 8 12 20] [--free-camera] [--cells NAME ..]

Boards, robots and pictures are simulated by tests/truth/handeye_scenes.py, with a pinhole projection of its own. Error:
where the calibration, with the camera it comes with, puts the points of a board in 20 fresh images for the robot, RMS
in mm. So no choice of the camera's axes can flatter a result. Per run, from the same images:

poses: from the target's poses in the images, weighed by what the corners know of each, the camera as given; all alike:
not weighed. left out: the board's points in images left out, mm RMS (with the robot's own error in these).
corners: the bundle adjustment, kept always, as before cross-validation chose.
kept: what the command keeps. Wanted: in no run worse than poses, or within noise.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from typing import Any

import numpy as np

import bench
from armsight.calibrate.handeye import (
    HandEyeResult,
    ObservationModel,
    Setup,
    calibrate_eye_in_hand,
    calibrate_from_views,
)
from armsight.calibrate.handeye.image_model import ImageModel, camera_of, poses_of, poses_of_views
from armsight.calibrate.handeye.pairs import pose
from armsight.errors import ArmsightError
from armsight.units import MM

scenes = bench.test_scene("handeye_scenes")


def corners_mm(from_poses: HandEyeResult, s: Any, *, free_camera: bool) -> float:
    """Return the error of the bundle adjustment; infinite where its camera sees nothing any more."""
    model = ImageModel.of(from_poses, poses_of_views(s.views, scenes.CAMERA, scenes.BOARD))
    try:
        fit = model.reproject(model.variances().V[from_poses.used], scenes.CAMERA, free_camera)
        at = poses_of(fit)
        return scenes.error_mm(pose(at[0], at[1]), camera_of(fit, scenes.CAMERA) if free_camera else scenes.CAMERA, s)
    except ArmsightError:
        return float("inf")


def one_row(name: str, n: int, runs: int, *, free_camera: bool) -> list[object]:
    """Return the table's row of a cell and a number of images."""
    found, left, refused, taken = [], [], 0, 0
    for seed in range(runs):
        s = scenes.scene(scenes.CELLS[name], n, seed)
        try:
            done = calibrate_from_views(
                s.views, list(s.robot), scenes.CAMERA, scenes.BOARD, Setup.EYE_IN_HAND, free_camera=free_camera
            )
        except ArmsightError as error:
            refused += 1
            print(f"{name}, {n} images, run {seed}: {error}", file=sys.stderr)
            continue
        comparison = done.result.comparison
        taken += comparison is not None and comparison.kept is not ObservationModel.POSES
        if comparison is not None and ObservationModel.CORNERS in comparison.errors:
            left.append(
                [comparison.errors[b].points_m / MM for b in (ObservationModel.POSES, ObservationModel.CORNERS)]
            )
        alike = calibrate_eye_in_hand(replace(done.from_poses.pairs, camera_covariance=None))
        found.append(
            [
                scenes.error_mm(alike.T_parent_camera, scenes.CAMERA, s),
                scenes.error_mm(done.from_poses.T_parent_camera, scenes.CAMERA, s),
                corners_mm(done.from_poses, s, free_camera=free_camera),
                scenes.error_mm(done.result.T_parent_camera, done.camera, s),
            ]
        )
    alike_mm, poses, corners, kept = np.array(found).T
    row: list[object] = [name, n, len(found), refused, *(float(np.median(x)) for x in (poses, corners, kept)), taken]
    for x in (corners, kept):
        row += [int((x > poses * (1 + 1e-9)).sum()), int((x > 1.2 * poses).sum()), float((x / poses).max())]
    missed = np.sqrt(np.mean(np.square(left), axis=0)).tolist() if left else ["", ""]
    return [*row, float(np.median(alike_mm)), *missed]


def main() -> None:
    """Print the errors and in how many runs a result is worse than that from the poses."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--runs", type=int, default=12)
    parser.add_argument("--images", type=int, nargs="*", default=[5, 6, 8, 12, 20])
    parser.add_argument("--free-camera", action="store_true")
    parser.add_argument("--cells", nargs="*", default=list(scenes.CELLS), choices=list(scenes.CELLS))
    given = parser.parse_args()
    print(bench.machine())
    rows = []
    for name in given.cells:
        for n in given.images:
            rows.append(one_row(name, n, given.runs, free_camera=given.free_camera))
            print(*rows[-1], file=sys.stderr, flush=True)
    few = [row for row in rows if row[1] <= 12]
    for told, some in (("all of up to 12", few), ("all of more", [row for row in rows if row[1] > 12])):
        if some:
            sums = [sum(row[k] for row in some) for k in (2, 3, 7, 8, 9, 11, 12)]
            worst = [max(row[k] for row in some) for k in (10, 13)]
            rows.append(
                [told, "", *sums[:2], "", "", "", sums[2], *sums[3:5], worst[0], *sums[5:], worst[1], "", "", ""]
            )
    bench.table(
        f"Few images{', camera freed' * given.free_camera}: error against truth, mm (median), and runs in which it is "
        "worse than from poses",
        [
            "cell", "images", "runs", "refused", "poses", "corners", "kept", "corners taken", "corners worse",
            "by > 20 %", "most, x poses", "kept worse", "by > 20 %", "most, x poses",
            "poses all alike", "left out, poses", "left out, corners",
        ],
        rows,
    )  # fmt: skip


if __name__ == "__main__":
    main()
