"""Joints at a moment; levels raised only beyond what noise explains, and held."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.calibrate.cameras.pairing import turns_of
from armsight.errors import StaleData, UsageError
from armsight.kinematics import fk, preset
from armsight.records import JointReading, PoseStatus, TargetPose
from armsight.records.motion import JointHistory, JointsAt
from armsight.store.targets import parse_board
from armsight.verify.supervision import CALM, Compared, Level, Limits, PredictedPose, Watch

ARM = preset("irb120")
Q = np.array([0.1, 0.2, -0.1, 0.3, 0.8, 0.2])
RIG = RigidTransform.from_components([1.0, 0.2, 0.5], Rotation.from_rotvec([0.3, 1.0, -2.0]))
STILL = JointsAt(q=Q, speed=np.zeros(6), bend=np.zeros(6))


def history(count: int = 6, cycle_s: float = 0.01) -> JointHistory:
    """Readings of a joint that speeds up at 2 rad/s^2."""
    kept = JointHistory(cycle_s)
    for k in range(count):
        t_s = k * cycle_s
        kept.add(JointReading(q=[t_s**2], t_s=t_s, sequence=k, source="r"))
    return kept


def test_joints_lie_between_their_readings_and_say_how_well() -> None:
    for t_s in (0.013, 0.0251, 0.05, 0.055):
        found = history().at(t_s)
        assert abs(found.q[0] - t_s**2) <= found.bend[0] * (1.0 + 1e-6) + 1e-15
    assert abs(history().at(0.025).speed[0] - 0.05) < 1e-12


def test_joints_that_are_not_known_are_not_made_up() -> None:
    for kept, t_s in ((history(), 0.09), (history(), -0.01), (history(1), 0.0)):
        with pytest.raises(StaleData):
            kept.at(t_s)
    kept = history()
    assert not kept.add(JointReading(q=[0.0], t_s=0.05, sequence=9, source="r"))
    kept.add(JointReading(q=[0.0], t_s=0.2, sequence=10, source="r"))
    with pytest.raises(StaleData, match=r"0\.150 s"):
        kept.at(0.1)


def seen(shift_m: float, t_s: float = 0.0, std_m: float = 1e-4) -> Compared:
    """A comparison whose place is off along x."""
    T = RIG.inv() * RigidTransform.from_translation([shift_m, 0.0, 0.0]) * RigidTransform.from_matrix(fk(ARM, Q))
    covariance = np.diag([std_m**2] * 3 + [1e-6] * 3)
    pose = TargetPose(t_s=t_s, status=PoseStatus.OK, parent="rig", T_parent_target=T.as_matrix(), covariance=covariance)
    return PredictedPose(arm=ARM, T_parent_rig=RIG).compare(pose, STILL)


def test_errors_are_measured_minus_expected_in_the_bases_axes() -> None:
    found = seen(0.002)
    np.testing.assert_allclose(found.error, [0.002, 0, 0, 0, 0, 0], atol=1e-12)
    np.testing.assert_allclose(found.std_m, 1e-4, rtol=1e-9)


def test_what_the_cameras_leave_open_is_turned_into_the_bases_axes() -> None:
    """Depth is known worst: the covariance's long axes are those of the camera's z, as the base has it."""
    own, lasting = np.diag([1e-8, 1e-8, 4e-6, 1e-6, 4e-6, 1e-6]), np.diag([0.0, 0.0, 1e-6, 0.0, 0.0, 0.0])
    T = (RIG.inv() * RigidTransform.from_matrix(fk(ARM, Q))).as_matrix()
    pose = TargetPose(
        t_s=0.0, status=PoseStatus.OK, parent="rig", T_parent_target=T, covariance=own, systematic_covariance=lasting
    )
    found = PredictedPose(arm=ARM, T_parent_rig=RIG).compare(pose, STILL)
    turned = np.kron(np.eye(2), RIG.rotation.as_matrix())
    np.testing.assert_allclose(found.systematic, turned @ lasting @ turned.T, atol=1e-18)
    np.testing.assert_allclose(found.random, turned @ (own - lasting) @ turned.T, atol=1e-18)


def test_a_board_that_looks_the_same_after_half_a_turn_is_taken_as_the_arm_has_it() -> None:
    """Counted from its other end, where its place is known exactly and its rotation to 1 mrad about x and y."""
    board = parse_board("checkerboard:7x5:0.02")
    assert len(turns_of(parse_board("checkerboard:9x6:0.02"))) == 1 and len(turns_of(board)) == 2
    expected = RIG.inv() * RigidTransform.from_matrix(fk(ARM, Q))
    half = RigidTransform.from_components([0.12, 0.08, 0.0], Rotation.from_euler("z", 180.0, degrees=True))
    R = expected.rotation.as_matrix()
    covariance = np.zeros((6, 6))
    covariance[3:, 3:] = R @ np.diag([1e-6, 1e-6, 0.0]) @ R.T
    pose = TargetPose(
        t_s=0.0,
        status=PoseStatus.OK,
        parent="rig",
        T_parent_target=(expected * half).as_matrix(),
        covariance=covariance,
    )
    found = PredictedPose(arm=ARM, T_parent_rig=RIG, turns=turns_of(board)).compare(pose, STILL)
    np.testing.assert_allclose(found.error, np.zeros(6), atol=1e-9)
    along = R.T @ RIG.rotation.as_matrix().T @ found.random[:3, :3] @ RIG.rotation.as_matrix() @ R
    np.testing.assert_allclose(along, np.diag([0.0, 0.0, 1e-6 * (0.12**2 + 0.08**2)]), atol=1e-14)
    other = PredictedPose(arm=ARM, T_parent_rig=RIG).compare(pose, STILL)
    assert other.error_rad > 3.0 and other.error_m > 0.1


def test_a_doubtful_pose_is_not_compared() -> None:
    T = (RIG.inv() * RigidTransform.from_matrix(fk(ARM, Q))).as_matrix()
    pose = TargetPose(t_s=0.0, status=PoseStatus.DOUBTFUL, parent="rig", T_parent_target=T, covariance=1e-8 * np.eye(6))
    with pytest.raises(UsageError):
        PredictedPose(arm=ARM, T_parent_rig=RIG).compare(pose, STILL)


def test_a_moving_arm_makes_an_unsure_moment_an_unsure_pose() -> None:
    expectation = PredictedPose(arm=ARM, T_parent_rig=RIG, time_std_s=0.01)
    moving = replace(STILL, speed=np.array([1.0, 0, 0, 0, 0, 0]))
    pose = TargetPose(
        t_s=0.0, status=PoseStatus.OK, parent="rig", covariance=1e-12 * np.eye(6),
        T_parent_target=(RIG.inv() * RigidTransform.from_matrix(fk(ARM, Q))).as_matrix(),
    )  # fmt: skip
    reach = np.linalg.norm(fk(ARM, Q)[:2, 3])
    assert abs(np.linalg.norm(expectation.compare(pose, moving).expected_std[:3]) - 0.01 * reach) < 1e-6
    assert expectation.compare(pose, STILL).expected_std.max() < 1e-6


def test_a_level_is_raised_only_beyond_what_noise_explains() -> None:
    limits = Limits(warn_m=0.001, stop_m=0.002)
    assert Watch(limits).add(seen(0.0015)) is None
    alarm = Watch(limits).add(seen(0.0018))
    assert alarm is not None and alarm.level is Level.WARN and "1.8 +- 0.1 mm" in alarm.why
    alarm = Watch(limits).add(seen(0.004))
    assert alarm is not None and alarm.level is Level.STOP
    assert Watch(Limits()).add(seen(1.0)) is None


def test_a_warning_ends_and_a_stop_holds() -> None:
    watch = Watch(Limits(warn_m=0.001, stop_m=0.01))
    watch.add(seen(0.005))
    for k in range(3 * CALM):
        watch.add(seen(0.0, 0.016 * (k + 1)))
    assert watch.level is Level.GOOD
    watch.add(seen(0.1, 2.0))
    for k in range(3 * CALM):
        watch.add(seen(0.0, 2.1 + 0.016 * k))
    assert watch.level is Level.STOP
