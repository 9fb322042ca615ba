"""Where the rig stands, from rows that are not independent: what is claimed must hold."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.arm import ArmPoints
from armsight.calibrate.arm.world import calibrate_world
from armsight.kinematics import fk, preset

ARM = preset("irb120")
RIG = RigidTransform.from_components([1.1, -0.4, 0.3], Rotation.from_rotvec([0.4, -0.2, 2.1]))
"""T_base_rig."""


def rows(q, errors, t_s=None):
    seen = RIG.inv().apply(fk(ARM, q)[:, :3, 3]) + errors
    return ArmPoints(q=q, xyz_m=seen, t_s=t_s)


def read_again(rng):
    """Twelve readings at each of nine places, which share an error of 0.6 mm."""
    q = np.repeat(rng.uniform(-0.8, 0.8, (9, 6)), 12, axis=0)
    return rows(q, np.repeat(rng.normal(0, 6e-4, (9, 3)), 12, axis=0) + rng.normal(0, 2e-5, (108, 3)))


def stream(rng):
    """Four hundred rows of one motion, whose error of 0.8 mm wanders over forty of them."""
    q = 0.6 * np.sin(np.linspace(0, 19, 400)[:, None] * rng.uniform(0.6, 1.4, 6) + rng.uniform(0, 6, 6))
    errors = np.zeros((400, 3))
    for k in range(1, 400):
        errors[k] = np.exp(-1 / 40) * errors[k - 1] + rng.normal(0, 8e-4 * np.sqrt(1 - np.exp(-2 / 40)), 3)
    return rows(q, errors + rng.normal(0, 3e-5, (400, 3)))


def alone(rng):
    return rows(rng.uniform(-0.8, 0.8, (30, 6)), rng.normal(0, 6e-4, (30, 3)))


@pytest.mark.parametrize(("world", "most"), [(read_again, 1.8), (stream, 1.8), (alone, 1.4)])
def test_claims_hold_where_rows_share_errors(world, most):
    z = []
    for seed in range(5):
        found = calibrate_world(ARM, world(np.random.default_rng(seed)))
        error = found.pose * RIG.inv()
        z.append((found.pose.translation - RIG.translation) / np.sqrt(np.diag(found.covariance.matrix))[:3])
        assert np.rad2deg(error.rotation.magnitude()) < 1.0
    assert 0.6 < np.sqrt(np.mean(np.square(z))) < most  # 5 for both where every row counted


def test_a_stream_says_what_its_rows_are_worth():
    found = calibrate_world(ARM, stream(np.random.default_rng(3)))
    assert any("worth" in note and "in their order" in note for note in found.notes)
