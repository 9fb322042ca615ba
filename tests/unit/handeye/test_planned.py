"""A robot-world calibration foretold: slopes by differences, deviations as calibrations of drawn poses scatter."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.handeye import PosePairs, calibrate_eye_to_hand
from armsight.geometry import pose_from_rotvec
from armsight_lab.design.planned_calibrations import PlannedHandEye, RobotNoise, planned_handeye, tool_slopes

X = pose_from_rotvec([1.2, -0.1, 0.5], [1.1, -1.3, 0.9])
Z = pose_from_rotvec([0.02, 0.01, 0.12], [0.2, -0.1, 0.4])
TOOL = pose_from_rotvec([0.0, 0.05, 0.2], [0.0, 0.3, 0.0])
NOISE = RobotNoise(position_m=1e-4, orientation_rad=2e-4)
CAMERA = np.diag([1e-4, 1e-4, 3e-4, 4e-3, 4e-3, 1e-3]) ** 2


def moved(pose: RigidTransform, step: np.ndarray) -> RigidTransform:
    return RigidTransform.from_components(pose.translation + step[:3], Rotation.from_rotvec(step[3:]) * pose.rotation)


def seen_poses(n: int, rng: np.random.Generator) -> RigidTransform:
    turns = Rotation.from_rotvec(rng.uniform(-0.6, 0.6, (n, 3)))
    return RigidTransform.from_components(rng.uniform([-0.2, -0.2, 0.6], [0.2, 0.2, 1.0], (n, 3)), turns)


def test_the_tool_follows_what_it_hangs_on() -> None:
    B = seen_poses(2, np.random.default_rng(1))
    known = PlannedHandEye(T_base_rig=X, T_flange_target=Z, covariance=np.eye(12), slopes=np.zeros((12, 1)))
    of_camera, of_known = tool_slopes(known, B, TOOL)
    h = 1e-6
    for k in range(2):
        there = X * B[k] * Z.inv() * TOOL

        def off(tool: RigidTransform, there: RigidTransform = there) -> np.ndarray:
            return np.concatenate(
                [tool.translation - there.translation, (tool.rotation * there.rotation.inv()).as_rotvec()]
            )

        camera = [off(X * moved(B[k], h * e) * Z.inv() * TOOL) / h for e in np.eye(6)]
        both = [off(moved(X, h * e[:6]) * B[k] * moved(Z, h * e[6:]).inv() * TOOL) / h for e in np.eye(12)]
        np.testing.assert_allclose(of_camera[k], np.column_stack(camera), atol=1e-5)
        np.testing.assert_allclose(of_known[k], np.column_stack(both), atol=1e-5)


def test_calibrations_scatter_as_foretold() -> None:
    rng = np.random.default_rng(7)
    B = seen_poses(20, rng)
    flange = X * B * Z.inv()
    known = planned_handeye(X, Z, flange, (np.tile(CAMERA, (20, 1, 1)), np.zeros((20, 6, 1))), NOISE)
    errors = []
    for _ in range(30):
        said = [
            moved(flange[k], np.concatenate([rng.normal(0.0, 1e-4, 3), rng.normal(0.0, 2e-4, 3)])) for k in range(20)
        ]
        camera = [moved(B[k], rng.normal(size=6) * np.sqrt(np.diag(CAMERA))) for k in range(20)]
        found = calibrate_eye_to_hand(PosePairs.of(said, camera, camera_covariance=np.tile(CAMERA, (20, 1, 1))))
        for pose, true in ((found.T_parent_camera, X), (found.T_parent_target, Z)):
            errors.append(
                np.concatenate([pose.translation - true.translation, (pose.rotation * true.rotation.inv()).as_rotvec()])
            )
    rms = np.sqrt(np.mean(np.array(errors).reshape(30, 12) ** 2, axis=0))
    ratio = rms / np.sqrt(np.diag(known.covariance))
    assert np.sqrt(np.mean(ratio**2)) == pytest.approx(1.0, abs=0.2)  # 30 draws of 12 numbers, hanging together
    assert (np.abs(ratio - 1.0) < 0.45).all()  # each 13 %
