"""Hand-eye by poses of one to four cameras that stand beside the robot: errors as claimed, smaller with each camera."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation
from tests.truth import camera_ring as world
from tests.truth.test_views import setup_of, spots

import armsight
from armsight.measure.poses.from_spots import measure_spots
from armsight.measure.poses.views import measure_views
from armsight.records import PoseStatus

T_BASE_RIG = RigidTransform.from_components([0.4, -0.9, 0.7], Rotation.from_rotvec([-1.9, 0.3, 0.2]))
T_FLANGE_TARGET = RigidTransform.from_components([0.02, -0.03, 0.11], Rotation.from_rotvec([0.4, -0.2, 0.9]))


def errors_over_claims(views: int, seed: int, n: int = 25) -> tuple[np.ndarray, np.ndarray]:
    """Squares of the errors of T_base_rig over those claimed, of place and rotation (2,); and the error of place, m."""
    rng, cameras = np.random.default_rng(seed), world.ring(views)
    setup = setup_of(cameras)
    robot, seen, covariance = [], [], []
    while len(seen) < n:
        T = world.pose(rng)
        look = world.look(cameras, world.LIGHTS, T, rng, hidden=0.0 if views == 1 else 0.15, reflections=0)
        found = [spots(uv) for uv in look.uv]
        measured = measure_spots(setup, 0.0, *found) if views == 2 else measure_views(setup, 0.0, found)
        if measured.pose.status is not PoseStatus.OK:
            continue
        seen.append(measured.pose.T_parent_target)
        covariance.append(measured.pose.covariance)
        robot.append((T_BASE_RIG * RigidTransform.from_matrix(T) * T_FLANGE_TARGET.inv()).as_matrix())
    done = armsight.calibrate_hand_eye(
        np.array(robot), np.array(seen), camera_covariance=np.array(covariance), setup="eye-to-hand"
    )
    off = RigidTransform.from_matrix(done.T_base_camera) * T_BASE_RIG.inv()
    moved = np.asarray(done.T_base_camera)[:3, 3] - np.asarray(T_BASE_RIG.translation)
    std = np.array([done.std[name] for name in ("x_m", "y_m", "z_m", "rx_rad", "ry_rad", "rz_rad")])
    sizes = np.array([moved @ moved, off.rotation.magnitude() ** 2])
    return sizes / [(std[:3] ** 2).sum(), (std[3:] ** 2).sum()], moved


@pytest.mark.parametrize("views", [1, 2, 3])
def test_errors_are_as_claimed(views: int) -> None:
    found = [errors_over_claims(views, seed) for seed in range(5)]
    over = np.sqrt(np.mean([one for one, _ in found], axis=0))
    off_m = np.sqrt(np.mean([moved @ moved for _, moved in found]))
    assert ((over > 0.55) & (over < 1.5)).all()  # of 15 squares: 1 +- 0.18
    assert off_m < {1: 2e-4, 2: 1.3e-4, 3: 1.3e-4}[views]
