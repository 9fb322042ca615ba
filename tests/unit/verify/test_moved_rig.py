"""A verification whose rows are of two placements of the rig, or of a few poses many times, names no cause."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.kinematics import fk, preset
from armsight.verify import Align, Measured, Reported, verify

ARM = preset("irb120")


def measured_at(q: np.ndarray, rng: np.random.Generator, noise_m: float = 1e-4) -> tuple[np.ndarray, np.ndarray]:
    T = RigidTransform.from_matrix(fk(ARM, q))
    turn = Rotation.from_rotvec(rng.normal(0.0, 2e-4, (len(q), 3)))
    return T.translation + rng.normal(0.0, noise_m, (len(q), 3)), (turn * T.rotation).as_matrix()


@pytest.mark.parametrize("turned", [True, False])
def test_a_rig_that_moved_between_two_rows_is_told_and_not_laid_to_the_measurement(turned: bool) -> None:
    rng = np.random.default_rng(3)
    q = rng.uniform(-0.9, 0.9, (60, 6))
    xyz, R = measured_at(q, rng)
    move = RigidTransform.from_components([0.01, 0.0, 0.004], Rotation.from_rotvec([0.0, 0.0, 0.03]))
    xyz[30:], R[30:] = move.apply(xyz[30:]), move.rotation.as_matrix() @ R[30:]
    found = verify(ARM, Reported(q=q), Measured(xyz_m=xyz, rotation=R if turned else None), Align.BOTH)
    assert found.cause is not None and found.cause.cause == "undecided"
    assert "row 31" in found.cause.sentence


def test_large_errors_that_follow_nothing_are_not_laid_to_a_measurement_of_unknown_deviation() -> None:
    rng = np.random.default_rng(4)
    q = rng.uniform(-0.9, 0.9, (60, 6))
    xyz, R = measured_at(q, rng, noise_m=0.01)
    found = verify(ARM, Reported(q=q), Measured(xyz_m=xyz, rotation=R), Align.BOTH)
    assert found.cause is not None and found.cause.cause == "undecided"
    assert "too large" in found.cause.sentence
    std = np.tile([0.01] * 3 + [2e-4] * 3, (60, 1))
    told = verify(ARM, Reported(q=q), Measured(xyz_m=xyz, rotation=R, std=std), Align.BOTH)
    assert told.cause is not None and told.cause.cause == "measurement"
