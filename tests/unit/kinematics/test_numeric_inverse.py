"""Numeric inverse kinematics: convergence, limits, restarts, reasons."""

import dataclasses

import numpy as np
import pytest

from armsight.kinematics import Arm, Effort, Joint, Stop, fk, ik, preset, solve_numeric, solve_numeric_many
from armsight.kinematics.presets import PRESETS


@pytest.mark.parametrize("name", sorted(PRESETS))
def test_warm_starts_converge_to_the_joint_values_they_came_from(name: str) -> None:
    rng = np.random.default_rng(0)
    arm = preset(name)
    q = rng.uniform(np.maximum(arm.lower, -2), np.minimum(arm.upper, 2), (300, arm.n))
    T = fk(arm, q)
    found, solved, errors = solve_numeric_many(arm, T, q + rng.normal(size=q.shape) * 0.05)
    assert solved.mean() > 0.99
    assert errors[solved].max() <= 1e-6
    rows = slice(0, 3) if arm.n < 6 else slice(0, 4)
    np.testing.assert_allclose(fk(arm, found[solved])[:, :3, 3], T[solved][:, :3, 3], atol=1.01e-6)
    if arm.n == 6:
        np.testing.assert_allclose(fk(arm, found[solved])[:, rows], T[solved][:, rows], atol=2e-6)


def test_newton_raphson_solves_the_rrp_arm_of_kapucu() -> None:
    """Kapucu 2005 sections 1 and 3: three joints, position only, quadratic convergence."""
    arm = preset("stanford-rrp")
    q = np.array([0.4, 1.1, 0.8])
    attempt = solve_numeric(arm, fk(arm, q), q + np.array([0.1, -0.1, 0.05]), method="newton")
    assert attempt.converged
    assert attempt.steps <= 5
    np.testing.assert_allclose(attempt.q, q, atol=1e-5)


def test_the_position_alone_leaves_the_orientation_free() -> None:
    arm = preset("ur10")
    T = fk(arm, [0.3, -1.0, 1.2, 0.4, 0.9, 0.1])
    attempt = solve_numeric(arm, T, np.full(6, 0.2), task="position")
    np.testing.assert_allclose(fk(arm, attempt.q)[:3, 3], T[:3, 3], atol=1e-6)


def limited(lower: float) -> Arm:
    arm = preset("korayem6r")
    joints = tuple(dataclasses.replace(joint, lower=lower, upper=3.0) for joint in arm.joints)
    return dataclasses.replace(arm, joints=joints)


def test_limits_are_kept_and_named_as_the_reason() -> None:
    arm = limited(-3.0)
    T = fk(arm, [0.3, -0.5, 0.8, 0.2, 0.6, 0.7])
    attempt = solve_numeric(arm, T)
    assert attempt.converged
    assert arm.within_limits(attempt.q)
    tight = limited(2.9)  # 0.1 rad of room for each joint
    blocked = solve_numeric(tight, T, effort=Effort(restarts=2))
    assert blocked.stopped is Stop.LIMITS
    assert tight.within_limits(blocked.closest_q)


@pytest.mark.parametrize("room", [(0.2, 3.0), (3.0, 0.2)], ids=["below", "above"])
def test_the_closed_forms_answers_beyond_either_limit_are_told_apart(room: tuple[float, float]) -> None:
    arm, q = preset("irb120"), np.array([0.3, -0.5, 0.6, 0.4, 0.7, 0.3])
    joints = (dataclasses.replace(j, lower=v - room[0], upper=v + room[1]) for j, v in zip(arm.joints, q, strict=True))
    tight = dataclasses.replace(arm, joints=tuple(joints))
    answer = ik(tight, fk(tight, q))
    assert answer.solutions and answer.beyond_limits
    assert tight.within_limits(np.array([one.q for one in answer.solutions])).all()
    assert not tight.within_limits(np.array([one.q for one in answer.beyond_limits])).any()


def test_restarts_find_a_pose_far_from_the_start_and_the_same_seed_gives_the_same_answer() -> None:
    arm = preset("irb120")
    q = np.array([-2.0, 1.2, -1.4, 2.0, -1.5, 3.0])
    first = solve_numeric(arm, fk(arm, q), [2.5, -1.5, 1.0, -2.0, 1.5, -3.0])
    second = solve_numeric(arm, fk(arm, q), [2.5, -1.5, 1.0, -2.0, 1.5, -3.0])
    assert first.converged
    np.testing.assert_array_equal(first.q, second.q)


def test_an_arm_with_too_many_joints_gets_one_solution() -> None:
    joints = tuple(
        Joint(name=f"j{k}", a_m=0.1, d_m=0.2 * (k % 2), alpha_rad=(-1) ** k * np.pi / 2, lower=-2.5, upper=2.5)
        for k in range(7)
    )
    arm = Arm(name="seven", joints=joints)
    q = np.array([0.3, -0.5, 0.8, 0.2, 0.6, 0.7, -0.4])
    answer = ik(arm, fk(arm, q), q + 0.05)
    assert len(answer.solutions) == 1
    assert not answer.complete
    assert answer.solutions[0].error_m <= 1e-6


def test_half_a_turn_of_error_is_solved() -> None:
    """The rotation error at exactly pi has no unique axis; the solver must still move."""
    arm = preset("ur10")
    q = np.array([0.3, -1.0, 1.2, 0.4, 0.9, 0.1])
    start = q + np.array([0, 0, 0, 0, 0, np.pi])
    attempt = solve_numeric(arm, fk(arm, q), start)
    assert attempt.converged


def test_nothing_is_left_to_compile_after_the_warm_up() -> None:
    from armsight.kinematics import warm_up
    from armsight.kinematics.kernels import chain, closed, derivatives, numeric

    warm_up()
    used = (
        chain.one_pose,
        chain.one_pose_jacobian,
        chain.many_poses,
        chain.many_poses_jacobians,
        chain.joint_frames,
        numeric.check_poses,
        numeric.farthest,
        closed.solve_closed,
        closed.solve_closed_many,
        closed.settle,
        closed.nearest_turns,
        derivatives.many_parameter_columns,
        numeric.solve_damped_least_squares,
        numeric.solve_newton,
        numeric.solve_many,
    )
    before = [len(kernel.signatures) for kernel in used]
    assert min(before) >= 1
    arm = preset("irb120")
    q = np.array([0.3, -0.5, 0.4, 0.2, 0.5, 0.7])
    ik(arm, fk(arm, q), q)
    solve_numeric(arm, fk(arm, q), q)
    fk(arm, np.tile(q, (3, 1)))
    assert [len(kernel.signatures) for kernel in used] == before
