"""Several pairs at one pose of the robot share its error there: they are believed as one."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.handeye import HandEye, PosePairs, calibrate_eye_in_hand

X = RigidTransform.from_components([0.03, 0.05, 0.1], Rotation.from_rotvec([0.1, 0.2, 0.3]))
Z = RigidTransform.from_components([0.6, 0.1, 0.0], Rotation.from_rotvec([3.0, 0.1, 0.0]))


def calibrated(seed: int, places: int, readings: int) -> HandEye:
    """The robot errs by 0.2 mm and 0.5 mrad a place, each image by a tenth of it."""
    rng = np.random.default_rng(seed)
    turn = Rotation.from_rotvec(rng.uniform(-0.5, 0.5, (places, 3))) * Rotation.from_rotvec([3.1, 0.0, 0.0])
    F = RigidTransform.from_components(rng.uniform([0.4, -0.2, 0.4], [0.8, 0.3, 0.7], (places, 3)), turn)
    i = np.repeat(np.arange(places), readings)

    def errors(n: int, share: float) -> RigidTransform:
        turned = Rotation.from_rotvec(rng.normal(0, 5e-4 * share, (n, 3)))
        return RigidTransform.from_components(rng.normal(0, 2e-4 * share, (n, 3)), turned)

    seen = ((F * errors(places, 1.0))[i] * X).inv() * Z * errors(len(i), 0.1)
    return calibrate_eye_in_hand(PosePairs.of(list(F[i]), list(seen), [str(k) for k in range(len(i))]))


def test_five_images_at_each_pose_are_believed_as_one() -> None:
    z = []
    for seed in range(10):
        found = calibrated(seed, 12, 5)
        X_found = found.T_parent_camera
        off = np.r_[X_found.translation - X.translation, (X_found.rotation * X.rotation.inv()).as_rotvec()]
        z.append(off / np.sqrt(np.diag(found.covariance.matrix)[:6]))
        assert found.used.sum() == 60
    assert np.sqrt(np.mean(np.square(z))) == pytest.approx(1.0, abs=0.25)  # 2.5 where each image is a pair of its own
