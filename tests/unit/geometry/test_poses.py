"""Pose conventions, and covariance propagation against a Monte Carlo of the perturbation's definition."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Degenerate, Inconsistent, NotEnoughData
from armsight.geometry import (
    align_points,
    compose_covariance,
    euler_rad,
    inverse_covariance,
    is_close,
    pose_difference,
    pose_from_euler,
    pose_from_quat,
    pose_from_rotvec,
    quat_of_matrix,
    xyz_quat,
)
from armsight.geometry.kernels import rotate_left, rotation_from_rotvec
from refusals import refuses


def random_pose(rng: np.random.Generator) -> RigidTransform:
    return pose_from_rotvec(rng.uniform(-1, 1, 3), rng.normal(size=3))


def perturbed(pose: RigidTransform, d: np.ndarray) -> RigidTransform:
    return RigidTransform.from_components(
        pose.translation + d[..., :3], Rotation.from_rotvec(d[..., 3:]) * pose.rotation
    )


def spread(samples: RigidTransform, about: RigidTransform) -> np.ndarray:
    d = np.hstack([samples.translation - about.translation, (samples.rotation * about.rotation.inv()).as_rotvec()])
    np.testing.assert_array_equal(d[:9], [pose_difference(s, about) for s in samples[:9]])
    return d.T @ d / len(d)


def sample_covariance(rng: np.random.Generator) -> np.ndarray:
    A = rng.normal(size=(6, 6)) * 1e-4
    return A @ A.T


def test_composed_and_inverted_covariances_are_those_of_a_monte_carlo() -> None:
    rng = np.random.default_rng(7)
    T_ab, T_bc = random_pose(rng), random_pose(rng)
    C_ab, C_bc = sample_covariance(rng), sample_covariance(rng)
    n = 6000
    d_ab = rng.multivariate_normal(np.zeros(6), C_ab, n)
    d_bc = rng.multivariate_normal(np.zeros(6), C_bc, n)
    composed = perturbed(T_ab, d_ab) * perturbed(T_bc, d_bc)
    expected = compose_covariance(T_ab, C_ab, T_bc, C_bc)
    # an element of a sample covariance scatters by sqrt((C_ii C_jj + C_ij^2) / n)
    sigma = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / n)
    assert (np.abs(spread(composed, T_ab * T_bc) - expected) < 5 * sigma).all()
    inverted = perturbed(T_ab, d_ab).inv()
    expected = inverse_covariance(T_ab, C_ab)
    sigma = np.sqrt((np.outer(np.diag(expected), np.diag(expected)) + expected**2) / n)
    assert (np.abs(spread(inverted, T_ab.inv()) - expected) < 5 * sigma).all()


def test_quaternions_are_renormalised_or_refused() -> None:
    quat = np.array([0.0, 0.0, np.sin(0.3), np.cos(0.3)])
    pose = pose_from_quat([1, 2, 3], quat * 1.0005)
    assert np.allclose(xyz_quat(pose)[1], quat, atol=1e-15)
    with pytest.raises(Inconsistent, match="length"):
        pose_from_quat([1, 2, 3], quat * 1.01)
    with pytest.raises(Inconsistent, match="finite"):
        pose_from_quat([np.nan, 2, 3], quat)


def test_euler_angles_are_rz_ry_rx() -> None:
    rx, ry, rz = 0.3, -0.2, 1.1
    R = (
        Rotation.from_rotvec([0, 0, rz]) * Rotation.from_rotvec([0, ry, 0]) * Rotation.from_rotvec([rx, 0, 0])
    ).as_matrix()
    pose = pose_from_euler([0, 0, 0], [rx, ry, rz])
    assert np.allclose(pose.rotation.as_matrix(), R, atol=1e-15)
    assert np.allclose(euler_rad(pose.rotation), [rx, ry, rz], atol=1e-15)


def test_compiled_rotations_agree_with_scipy_also_near_zero() -> None:
    rng = np.random.default_rng(1)
    out, turned = np.empty((3, 3)), np.empty((3, 3))
    for size in (0.0, 1e-12, 1e-7, 1e-6, 1e-3, 1.0, 3.0):
        w = rng.normal(size=3)
        w *= size / np.linalg.norm(w)
        rotation_from_rotvec(w, out)
        assert np.allclose(out, Rotation.from_rotvec(w).as_matrix(), atol=2e-16 + 1e-15)
        R = Rotation.random(rng=rng)
        rotate_left(w, R.as_matrix(), turned)
        assert np.allclose(turned, (Rotation.from_rotvec(w) * R).as_matrix(), atol=1e-15)


def test_alignment_recovers_a_motion_and_refuses_lines_and_reflections() -> None:
    rng = np.random.default_rng(3)
    b = rng.normal(size=(5, 3))
    T_a_b = random_pose(rng)
    found = align_points(T_a_b.apply(b), b, rng.uniform(0.5, 2, 5))
    assert is_close(found.T_a_b, T_a_b, tol_m=1e-14, tol_rad=1e-14)
    assert found.rms_m < 1e-14
    mirrored = align_points(b * [1, 1, -1], b)
    assert np.linalg.det(mirrored.T_a_b.rotation.as_matrix()) > 0
    with refuses(Degenerate, "one line"):
        align_points(np.outer(np.arange(4), [1, 2, 3]), np.outer(np.arange(4), [1, 2, 3]))
    with pytest.raises(NotEnoughData):
        align_points(b[:2], b[:2])


def test_quaternions_of_matrices_are_scipys_for_any_turn() -> None:
    turns = Rotation.concatenate(
        [
            Rotation.random(500, rng=np.random.default_rng(4)),
            Rotation.from_rotvec(np.pi * np.vstack([np.eye(3), [[0.6, 0.8, 0.0], [0.0, 0.6, -0.8]]])),
            Rotation.from_rotvec(np.vstack([np.zeros((1, 3)), 1e-9 * np.eye(3), (np.pi - 1e-9) * np.eye(3)])),
        ]
    )
    for turn in turns:
        ours, theirs = np.array(quat_of_matrix(turn.as_matrix())), turn.as_quat(canonical=True)
        assert (
            min(np.abs(ours - theirs).max(), np.abs(ours + theirs).max()) < 1e-15
        )  # at half a turn both signs are one
        assert ours[3] >= 0.0
