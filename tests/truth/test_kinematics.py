"""Forward and inverse kinematics against a chain of matrix products written here, and against known answers."""

from __future__ import annotations

import dataclasses
from collections import Counter

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.geometry import pose_difference
from armsight.kinematics import (
    Arm,
    Convention,
    Joint,
    JointType,
    fk,
    fk_jacobian,
    ik,
    ik_many,
    in_convention,
    jacobian,
    link_frames,
    moved,
    near_singularities,
    parameter_jacobian,
    parameter_names,
    pose,
    preset,
    singularity_distance,
)

ALL = ("iiwa14", "irb120", "korayem6r", "puma761", "stanford-rrp", "ur10")  # every kind of chain
CLOSED = ("korayem6r", "puma761", "ur10", "irb120")


def rotation(axis: int, angle: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(angle * np.eye(3)[axis]).as_matrix()
    return T


def shift(x: float, y: float, z: float) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def chain_by_hand(arm: Arm, q: np.ndarray) -> np.ndarray:
    """The product of elementary motions, in the convention the arm is written in."""
    T = arm.T_world_base.as_matrix() @ arm.T_base_frame0.as_matrix()
    for joint, value in zip(arm.joints, q, strict=True):
        turns = joint.type is JointType.REVOLUTE
        theta = joint.theta_rad + (joint.sign * value if turns else 0.0)
        d = joint.d_m + (0.0 if turns else joint.sign * value)
        move = rotation(2, theta) @ shift(0, 0, d)
        link = shift(joint.a_m, 0, 0) @ rotation(0, joint.alpha_rad) @ rotation(1, joint.beta_rad)
        T = T @ (move @ link if arm.convention is Convention.STANDARD else link @ move)
    return T @ arm.T_flange_tool.as_matrix()


def random_pose(rng: np.random.Generator) -> RigidTransform:
    return RigidTransform.from_components(rng.normal(size=3), Rotation.random(rng=rng))


def scrambled(arm: Arm, rng: np.random.Generator, size: float = 0.05) -> Arm:
    """The arm with base, tool, beta, a sign and every parameter off: nothing is zero any more."""
    joints = tuple(
        dataclasses.replace(
            joint,
            a_m=joint.a_m + rng.normal() * size,
            alpha_rad=joint.alpha_rad + rng.normal() * size,
            d_m=joint.d_m + rng.normal() * size,
            theta_rad=joint.theta_rad + rng.normal() * size,
            beta_rad=rng.normal() * size,
            sign=-1.01 if k % 2 else 1.0,
        )
        for k, joint in enumerate(arm.joints)
    )
    return dataclasses.replace(arm, joints=joints, T_world_base=random_pose(rng), T_flange_tool=random_pose(rng))


def joint_values(arm: Arm, rng: np.random.Generator, rows: int) -> np.ndarray:
    return rng.uniform(np.maximum(arm.lower, -np.pi), np.minimum(arm.upper, np.pi), (rows, arm.n))


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("convention", list(Convention))
def test_forward_kinematics_is_the_product_of_the_elementary_motions(name: str, convention: Convention) -> None:
    rng = np.random.default_rng(1)
    for arm in (
        in_convention(preset(name), convention),
        dataclasses.replace(scrambled(preset(name), rng), convention=convention),
    ):
        q = joint_values(arm, rng, 70)  # more than two blocks, the last one not full
        T = fk(arm, q)
        expected = np.array([chain_by_hand(arm, row) for row in q])
        np.testing.assert_allclose(T, expected, atol=5e-15)
        np.testing.assert_allclose([fk(arm, row) for row in q[:5]], expected[:5], atol=5e-15)


def test_korayem_forward_kinematics_as_printed_with_the_erratum_corrected() -> None:
    """Korayem 2018 section 4; a_y with the sign of MATH A2. The printed sign must not fit."""
    rng = np.random.default_rng(3)
    a1, a2, a3, a4, d1, d6 = 0.0365, 0.2515, 0.125, 0.092, 0.438, 0.1528
    for q in rng.uniform(-3, 3, (20, 6)):
        c1, c2, _, _, c5, c6 = np.cos(q)
        s1, s2, _, _, s5, s6 = np.sin(q)
        c23, s23 = np.cos(q[1] + q[2]), np.sin(q[1] + q[2])
        c, s = np.cos(q[1:4].sum()), np.sin(q[1:4].sum())
        reach = a1 + a2 * c2 + a3 * c23 + c * (a4 - d6 * s5)
        T = fk(preset("korayem6r"), q)
        n = [
            -c6 * s1 * s5 + c1 * (c * c5 * c6 - s * s6),
            c * c5 * c6 * s1 + c1 * c6 * s5 - s1 * s * s6,
            -c5 * c6 * s - c * s6,
        ]
        p = [-d6 * c5 * s1 + c1 * reach, d6 * c1 * c5 + s1 * reach, d1 - a2 * s2 - a3 * s23 + s * (-a4 + d6 * s5)]
        np.testing.assert_allclose(T[:3, 0], n, atol=1e-14)
        np.testing.assert_allclose(T[:3, 2], [-c5 * s1 - c1 * c * s5, c1 * c5 - c * s1 * s5, s * s5], atol=1e-14)
        np.testing.assert_allclose(T[:3, 3], p, atol=1e-14)
        assert abs(T[1, 2] - (c1 * c5 + c * s1 * s5)) > 1e-3  # the print


@pytest.mark.parametrize("name", ALL)
def test_the_jacobian_is_the_derivative_of_the_pose(name: str) -> None:
    rng = np.random.default_rng(4)
    arm = scrambled(preset(name), rng)
    h = 1e-6
    q = joint_values(arm, rng, 40)
    T, J = fk_jacobian(arm, q)
    for k in (0, 17, 39):
        numeric = np.stack(
            [pose_difference(pose(arm, q[k] + h * e), pose(arm, q[k] - h * e)) / (2 * h) for e in np.eye(arm.n)], axis=1
        )
        np.testing.assert_allclose(J[k], numeric, atol=2e-9)
        np.testing.assert_allclose(jacobian(arm, q[k]), J[k], atol=1e-14)
        for axes, R in (("tool", T[k, :3, :3]), ("base", arm.T_world_base.rotation.as_matrix())):
            np.testing.assert_allclose(jacobian(arm, q[k], axes=axes), np.kron(np.eye(2), R.T) @ J[k], atol=1e-14)


@pytest.mark.parametrize("name", ALL)
@pytest.mark.parametrize("convention", list(Convention))
def test_parameter_derivatives_against_finite_differences(name: str, convention: Convention) -> None:
    rng = np.random.default_rng(5)
    h = 1e-5  # error of a central difference: h^2 + eps / h, about 1e-10
    for arm in (
        in_convention(preset(name), convention),
        dataclasses.replace(scrambled(preset(name), rng), convention=convention),
    ):
        q = joint_values(arm, rng, 1)[0]
        T, J = parameter_jacobian(arm, q)
        np.testing.assert_allclose(T, fk(arm, q), atol=1e-14)
        for column, parameter in enumerate(parameter_names(arm)):
            plus, minus = (pose(moved(arm, {parameter: step}), q) for step in (h, -h))
            np.testing.assert_allclose(
                J[:, column], pose_difference(plus, minus) / (2 * h), atol=2e-9, err_msg=parameter
            )


def turned(angles: np.ndarray) -> np.ndarray:
    return np.abs((angles + np.pi) % (2 * np.pi) - np.pi)


@pytest.mark.parametrize("name", CLOSED)
def test_closed_form_gives_every_solution_and_the_original_among_them(name: str) -> None:
    """10,000 poses; MATH 2.2: korayem6r has 8, 6, 4, 2 solutions for 34.2, 27.0, 27.9, 10.9 % of them."""
    rng = np.random.default_rng(6)
    arm, m = preset(name), 10_000
    q = rng.uniform(-np.pi, np.pi, (m, 6))
    T = fk(arm, q)
    Q, code, count = ik_many(arm, T)
    real = np.arange(8) < count[:, None]
    assert np.isnan(Q[~real]).all()
    worst = np.abs(fk(arm, Q[real]) - np.repeat(T, count, axis=0)).max()
    assert worst < 1e-9
    nearest = np.where(real, turned(Q - q[:, None]).max(axis=2), np.inf).min(axis=1)
    assert nearest.max() < 1e-8
    assert all(len(set(row[:k].tolist())) == k for row, k in zip(code, count, strict=True))  # branches differ
    shares = {k: v / m for k, v in Counter(count.tolist()).items()}
    if name == "korayem6r":
        expected = {8: 0.342, 6: 0.270, 4: 0.279, 2: 0.109}
        sigma = {k: np.sqrt(p * (1 - p) / m) for k, p in expected.items()}
        assert all(abs(shares[k] - p) < 5 * sigma[k] for k, p in expected.items())
    else:
        assert set(shares) <= {2, 4, 6, 8}


@pytest.mark.parametrize("name", CLOSED)
def test_closed_form_behind_any_base_and_tool_with_signs_and_offsets(name: str) -> None:
    rng = np.random.default_rng(7)
    arm = preset(name)
    joints = tuple(
        dataclasses.replace(
            joint, theta_rad=rng.uniform(-3, 3), sign=rng.choice([-1.0, 1.0, 1.02]), lower=-9.0, upper=9.0
        )
        for joint in arm.joints
    )
    arm = dataclasses.replace(arm, joints=joints, T_world_base=random_pose(rng), T_flange_tool=random_pose(rng))
    for q in rng.uniform(-3, 3, (20, 6)):
        answer = ik(arm, pose(arm, q), q)
        assert answer.complete
        assert np.abs(answer.solutions[0].q - q).max() < 1e-7
        assert max(max(s.error_m, s.error_rad) for s in answer.solutions) < 1e-9


def parallel_flipped(rng: np.random.Generator, wrist: str) -> Arm:
    """A made-up member of each family with half turns between the parallel axes and every offset the family allows."""
    h = np.pi / 2
    if wrist == "offset":
        rows = [
            (0.05, h, 0.3, 0.2),
            (0.4, np.pi, 0.07, -1.0),
            (-0.3, np.pi, -0.02, 0.5),
            (0.06, -h, 0.11, 0.1),
            (0.0, -h, 0.09, 2.0),
            (0.03, 0.4, 0.08, 1.0),
        ]
    else:
        rows = [
            (0.05, h, 0.3, 0.2),
            (-0.4, np.pi, 0.07, -1.0),
            (0.06, h, -0.02, 0.5),
            (0.0, -h, 0.35, 0.1),
            (0.0, -h, 0.0, 2.0),
            (0.03, 0.4, 0.08, 1.0),
        ]
    joints = tuple(
        Joint(name=f"j{k}", a_m=a, alpha_rad=alpha, d_m=d, theta_rad=theta)
        for k, (a, alpha, d, theta) in enumerate(rows)
    )
    return Arm(name=wrist, joints=joints, T_world_base=random_pose(rng), T_flange_tool=random_pose(rng))


@pytest.mark.parametrize("wrist", ["offset", "spherical"])
def test_closed_form_with_flipped_parallel_axes_is_complete(wrist: str) -> None:
    """Every root that a numeric search finds from random starts is in the closed-form set."""
    from armsight.kinematics import solve_numeric_many

    rng = np.random.default_rng(8)
    arm = parallel_flipped(rng, wrist)
    for q in rng.uniform(-3, 3, (15, 6)):
        T = fk(arm, q)
        Q, _, count = ik_many(arm, T)
        assert turned(Q[0, : count[0]] - q).max(axis=1).min() < 1e-8
        starts = rng.uniform(-3, 3, (60, 6))
        found, solved, _ = solve_numeric_many(arm, np.tile(T, (60, 1, 1)), starts)
        assert solved.sum() > 10
        for root in found[solved]:
            assert turned(Q[0, : count[0]] - root).max(axis=1).min() < 1e-3


@pytest.mark.parametrize("name", CLOSED)
def test_a_calibrated_arm_close_to_a_family_keeps_its_branches(name: str) -> None:
    rng = np.random.default_rng(9)
    arm = preset(name)
    changes = {parameter: rng.normal() * 1e-3 for parameter in parameter_names(arm)}
    real = moved(arm, changes)
    for q in joint_values(arm, rng, 4):
        answer = ik(real, pose(real, q), q)
        assert not answer.complete
        assert np.abs(answer.solutions[0].q - q).max() < 1e-6
        assert max(max(s.error_m, s.error_rad) for s in answer.solutions) < 1e-6


WRIST = [0.3, -0.5, 0.8, 0.2, 0.0, 0.7]


def test_wrist_singularity_keeps_the_previous_sum_of_angles() -> None:
    """MATH 2.2: with s5 = 0 theta 2 + 3 + 4 is a free family; the previous one is taken."""
    arm = preset("korayem6r")
    for fifth in (0.0, np.pi):
        q = np.array([*WRIST[:4], fifth, 0.7])
        T = pose(arm, q)
        answer = ik(arm, T, q)
        assert answer.status == "singular"
        assert answer.why == "singular: wrist"
        assert turned(answer.solutions[0].q - q).max() < 1e-8
        near = q + np.array([0, 0.1, 0.05, 0.03, 0, 0])
        other = ik(arm, T, near).solutions[0]
        assert other.q[1:4].sum() == pytest.approx(near[1:4].sum(), abs=1e-9)
        assert other.error_m < 1e-9


def test_wrist_singularity_of_a_spherical_wrist_keeps_the_previous_fourth_joint() -> None:
    for name in ("puma761", "irb120"):
        arm = preset(name)
        q = np.array([0.3, -0.5, 0.4, 0.2, 0.0, 0.7])
        answer = ik(arm, pose(arm, q), q)
        assert answer.solutions[0].singular == ("wrist",)
        assert turned(answer.solutions[0].q - q).max() < 1e-8
        near = q + np.array([0, 0, 0, 0.3, 0, 0])
        other = ik(arm, pose(arm, q), near).solutions[0]
        assert other.q[3] == pytest.approx(0.5, abs=1e-9)
        assert other.error_rad < 1e-9


def test_shoulder_singularity_keeps_the_previous_first_joint() -> None:
    """The wrist on axis 1: theta 1 is free (MATH 2.2)."""
    from scipy.optimize import brentq

    arm = preset("korayem6r")
    q2, q3 = -1.9, 1.0

    def wrist_radius(fourth: float) -> float:
        angles = np.cumsum([q2, q3, fourth])
        return float(0.0365 + np.array([0.2515, 0.125, 0.092]) @ np.cos(angles))

    fourth = brentq(wrist_radius, 0, 3, xtol=1e-15)
    q = np.array([0.3, q2, q3, fourth, 0.6, 0.7])
    T = pose(arm, q)
    answer = ik(arm, T, q)
    assert all("shoulder" in solution.singular for solution in answer.solutions)
    assert min(turned(s.q - q).max() for s in answer.solutions) < 1e-6
    for first in (-1.0, 2.0):
        solutions = ik(arm, T, [first, *q[1:]]).solutions
        assert all(s.q[0] == pytest.approx(first) and s.error_m < 1e-9 for s in solutions)


@pytest.mark.parametrize(
    ("name", "q", "which"),
    [
        ("korayem6r", WRIST, "wrist"),
        ("korayem6r", [0.3, -0.5, 0.0, 0.2, 0.9, 0.7], "elbow"),
        ("ur10", [0.3, -0.5, 0.8, 0.2, np.pi, 0.7], "wrist"),
        ("ur10", [0.3, -0.5, 0.0, 0.2, 0.9, 0.7], "elbow"),
        ("irb120", [0.3, -0.5, 0.4, 0.2, 0.0, 0.7], "wrist"),
        ("irb120", [0.3, -0.5, -np.arctan2(302, 70), 0.2, 0.5, 0.7], "elbow"),
        ("puma761", [0.3, -0.5, np.pi / 2, 0.2, 0.5, 0.7], "elbow"),
        ("stanford-rrp", [0.3, 0.7, 0.0], "singular"),
        ("stanford-rrp", [0.3, -0.3, 0.1 / np.tan(0.3)], "singular"),
    ],
)
def test_singularities_by_name(name: str, q: list[float], which: str) -> None:
    """The RRP arm has no names: it is singular with the slide at zero, and with the tool over axis 1."""
    arm = preset(name)
    assert which in near_singularities(arm, q)
    assert singularity_distance(arm, q) < 1e-9
    away = np.array(q) + 0.2
    assert which not in near_singularities(arm, away)
    assert singularity_distance(arm, away) > 1e-3


@pytest.mark.parametrize("name", CLOSED)
def test_branch_names_are_what_the_eye_sees(name: str) -> None:
    """The elbow is up where it stands above the line from shoulder to wrist, the shoulder right where the wrist is on
    the side to which joint 1 points."""
    rng = np.random.default_rng(12)
    arm = preset(name)
    seen = set()
    for q in joint_values(arm, rng, 40):
        for solution in ik(arm, pose(arm, q), q).solutions:
            frames = link_frames(arm, solution.q)
            x1 = np.array([np.cos(solution.q[0]), np.sin(solution.q[0]), 0.0])
            shoulder, elbow = frames[1][:3, 3], frames[2][:3, 3]
            forearm_end = frames[3][:3, 3] if name in ("korayem6r", "ur10") else frames[5][:3, 3]
            right = frames[5][:3, 3] @ x1 > 0
            out = x1 if right else -x1  # seen from the side on which the wrist is
            to_end, to_elbow = forearm_end - shoulder, elbow - shoulder
            above = (to_end @ out) * to_elbow[2] - to_end[2] * (to_elbow @ out) > 0
            words = ("shoulder right" if right else "shoulder left", "elbow up" if above else "elbow down")
            assert solution.branch[:2] == words
            assert solution.branch[2] == ("wrist no flip" if np.sin(solution.q[4]) >= 0 else "wrist flip")
            seen.add(solution.branch)
    assert len(seen) == 8
