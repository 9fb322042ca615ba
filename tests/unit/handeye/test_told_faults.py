"""Faults of pose pairs that are told by their cause: readings that stand still, mirrored axes; the cures work."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.handeye import PosePairs, calibrate_eye_in_hand
from armsight.errors import Inconsistent
from refusals import refuses

FLANGE_CAMERA = RigidTransform.from_components([0.05, -0.03, 0.11], Rotation.from_rotvec([0.3, -0.2, 1.4]))
BASE_TARGET = RigidTransform.from_components([0.6, 0.2, -0.1], Rotation.from_rotvec([0.1, 0.4, -2.0]))


def poses(n=18, seed=4):
    """Return T_base_flange and T_camera_target (n, 4, 4), the latter good to 0.2 mm and 0.05 degrees."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec([np.pi, 0, 0]) * Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (n, 3)))
    camera = RigidTransform.from_components(rng.uniform([-0.1, -0.1, 0.4], [0.1, 0.1, 0.7], (n, 3)), turn)
    robot = BASE_TARGET * camera.inv() * FLANGE_CAMERA.inv()
    small = Rotation.from_rotvec(rng.normal(0, 9e-4, (n, 3)))
    seen = RigidTransform.from_components(camera.translation + rng.normal(0, 2e-4, (n, 3)), camera.rotation * small)
    return robot.as_matrix(), seen.as_matrix()


def calibrate(robot, camera):
    stacks = [RigidTransform.from_matrix(T) for T in (robot, camera)]
    return calibrate_eye_in_hand(PosePairs.of(*stacks))


def right(result):
    off = result.T_parent_camera.translation - FLANGE_CAMERA.translation
    return np.linalg.norm(off) < 2e-3


@pytest.mark.parametrize("mirrored", ["camera", "robot"])
def test_a_table_with_y_up_is_named_and_the_other_signs_are_the_cure(mirrored):
    robot, camera = poses()
    y_up = np.diag([1.0, -1.0, 1.0, 1.0])
    given = (robot, y_up @ camera @ y_up) if mirrored == "camera" else (y_up @ robot @ y_up, camera)
    with refuses(Inconsistent, "left-handed", "y", "qx", "qz"):
        calibrate(*given)

    def undone(T):
        pose = RigidTransform.from_matrix(T)
        quat = pose.rotation.as_quat() * [-1, 1, -1, 1]
        return RigidTransform.from_components(pose.translation * [1, -1, 1], Rotation.from_quat(quat)).as_matrix()

    robot, camera = (given[0], undone(given[1])) if mirrored == "camera" else (undone(given[0]), given[1])
    assert right(calibrate(robot, camera))
