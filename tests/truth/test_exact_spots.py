"""Spots without any error give the pose without any error, on any rig: no kernel divides by what has become zero."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.pipeline import Setup
from armsight.optics import Camera, Rig, RigKind
from armsight.records import PoseStatus, Spots, spot_target

RIGS, POSES = 20, 30


def random_rig(rng: np.random.Generator) -> Rig:
    def camera() -> Camera:
        f = rng.uniform(600.0, 1500.0)
        k = rng.normal(0.0, [0.1, 0.05, 5e-4, 5e-4, 0.01])
        return Camera.pinhole(
            1280, 720, f, f * rng.uniform(0.99, 1.01), *rng.normal((640.0, 360.0), 10.0), distortion=k
        )

    baseline, toe = rng.uniform(0.05, 0.3), rng.uniform(0.0, 0.15)
    right = Rotation.from_rotvec(rng.normal((0.0, -toe, 0.0), 0.01))
    return Rig(
        kind=RigKind.STEREO,
        left=camera(),
        right=camera(),
        T_rig_left=RigidTransform.identity(),
        T_rig_right=RigidTransform.from_components([baseline, *rng.normal(0.0, 0.003, 2)], right),
    )


def spots(uv: np.ndarray) -> Spots:
    n = len(uv)
    return Spots(
        uv_px=uv,
        covariance_px2=np.tile(0.03**2 * np.eye(2), (n, 1, 1)),
        peak=np.full(n, 100.0),
        size_px=np.full(n, 2.0),
        model=("gaussian",) * n,
    )


def seen(rig: Rig, points: np.ndarray) -> list[np.ndarray]:
    views = []
    for camera, T in ((rig.left, rig.T_rig_left.inv()), (rig.right, rig.T_rig_right.inv())):
        rotvec, t = T.rotation.as_rotvec(), np.asarray(T.translation)
        uv, _ = cv2.projectPoints(np.ascontiguousarray(points), rotvec, t, camera.matrix, camera.distortion)
        views.append(uv[:, 0])
    return views


def test_exact_spots_of_random_poses_on_random_rigs_give_the_exact_pose() -> None:
    worst_m = worst_rad = 0.0
    for seed in range(RIGS):
        rng = np.random.default_rng([21, seed])
        rig = random_rig(rng)
        n = int(rng.integers(3, 5))
        while True:  # lights well off one line, and no two distances alike
            lights = rng.uniform(-0.06, 0.06, (n, 3)) * (1.0, 1.0, 0.4)
            apart = np.sort(np.linalg.norm(lights[:, None] - lights[None], axis=2)[np.triu_indices(n, 1)])
            if np.linalg.svd(lights - lights.mean(axis=0))[1][1] > 0.03 and np.diff(apart).min() > 0.01:
                break
        setup = Setup(rig, spot_target({f"L{i}": tuple(x) for i, x in enumerate(lights.tolist())}))
        for _ in range(POSES):
            T = RigidTransform.from_components(
                rng.uniform((-0.05, -0.08, 0.5), (0.12, 0.08, 1.0)), Rotation.from_rotvec(rng.normal(0.0, 0.3, 3))
            )
            left, right = seen(rig, T.apply(lights))
            found = measure_spots(setup, 0.0, spots(left), spots(right[rng.permutation(n)]))
            assert found.pose.status is PoseStatus.OK, f"rig {seed}: {found.pose.why}"
            difference = T.inv() * found.pose.pose
            worst_m = max(worst_m, float(np.linalg.norm(found.pose.pose.translation - T.translation)))
            worst_rad = max(worst_rad, float(difference.rotation.magnitude()))
    assert worst_m < 1e-9 and worst_rad < 1e-8
