"""The rig on a rotary base: pose by angle, and axis and mount from views of a fixed target."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Degenerate, Inconsistent, NotEnoughData
from armsight.geometry import pose_difference
from armsight.optics import Camera, parallel_rig
from armsight.papers.korayem2018.rotary_base import RotaryBase, rig_on_base, rotary_from_mount
from armsight.papers.korayem2018.rotary_calibration import calibrate_rotary
from armsight.records import PoseStatus, TargetPose

AXIS = Rotation.from_rotvec([0.05, -0.03, 0.0]).apply([0.0, 1.0, 0.0])
BASE = RotaryBase(direction=AXIS, point_m=[0.06, 0.0, -0.12], T_world_home=RigidTransform.identity())
TARGET = RigidTransform.from_components([0.1, -0.05, 0.7], Rotation.from_rotvec([0.3, 2.0, -0.4]))
COVARIANCE = np.diag([1e-4, 1e-4, 4e-4, 2e-3, 2e-3, 1e-3]) ** 2


def homogeneous(T: RigidTransform) -> np.ndarray:
    return np.asarray(T.as_matrix())


def turn(angle: float) -> np.ndarray:
    """The base's motion written out by Rodrigues' formula about a line, without the product's classes."""
    n, p = np.asarray(BASE.direction), np.asarray(BASE.point_m)
    K = np.array([[0, -n[2], n[1]], [n[2], 0, -n[0]], [-n[1], n[0], 0]])
    R = np.eye(3) + np.sin(angle) * K + (1 - np.cos(angle)) * K @ K
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, p - R @ p
    return T


def views(angles: np.ndarray, rng: np.random.Generator | None) -> list[TargetPose]:
    out = []
    for angle in angles:
        T = RigidTransform.from_matrix(np.linalg.inv(turn(angle)) @ homogeneous(TARGET))
        if rng is not None:
            d = rng.multivariate_normal(np.zeros(6), COVARIANCE)
            T = RigidTransform.from_components(T.translation + d[:3], Rotation.from_rotvec(d[3:]) * T.rotation)
        out.append(
            TargetPose(
                t_s=0.0, status=PoseStatus.OK, parent="rig", T_parent_target=T.as_matrix(), covariance=COVARIANCE
            )
        )
    return out


ANGLES = np.radians([-40.0, -20.0, 0.0, 15.0, 30.0, 45.0])


def test_pose_of_the_rig_by_the_angle() -> None:
    for angle in ANGLES:
        np.testing.assert_allclose(homogeneous(BASE.T_home_rig(angle)), turn(angle), atol=1e-12)
    mount = RigidTransform.from_components([0.1, 0.02, 0.03], Rotation.from_rotvec([0.4, -0.2, 0.9]))
    world = RigidTransform.from_components([1.0, 2.0, 3.0], Rotation.from_rotvec([-0.3, 0.1, 0.2]))
    base = rotary_from_mount(world, mount)
    z = np.eye(4)
    z[:3, :3] = Rotation.from_rotvec([0.0, 0.0, 0.7]).as_matrix()
    np.testing.assert_allclose(
        homogeneous(base.T_world_rig(0.7)), homogeneous(world) @ z @ homogeneous(mount), atol=1e-12
    )


def test_a_point_seen_from_the_turned_rig_stays_where_it_is() -> None:
    camera = Camera.pinhole(1280, 720, 1100.0, 1100.0, 640.0, 360.0)
    rig, p = parallel_rig(camera, 0.1), np.array([[0.05, 0.02, 0.8]])
    turned = rig_on_base(rig, BASE, 0.3)
    in_rig = (np.linalg.inv(turn(0.3)) @ np.append(p[0], 1.0))[None, :3]
    for a, b in zip(turned.project(p), rig.project(in_rig), strict=True):
        np.testing.assert_allclose(a, b, atol=1e-9)


def test_exact_views_give_the_exact_axis() -> None:
    found = calibrate_rotary(ANGLES, views(ANGLES, None))
    np.testing.assert_allclose(found.base.direction, BASE.direction, atol=1e-9)
    np.testing.assert_allclose(found.base.point_m, BASE.point_m, atol=1e-9)
    assert np.abs(pose_difference(found.T_home_target, TARGET)).max() < 1e-9
    assert found.n_used == 6 and found.dof == 26


def test_deviations_agree_with_the_spread() -> None:
    rng, steps, claimed, scales = np.random.default_rng(1), [], [], []
    for _ in range(100):
        found = calibrate_rotary(ANGLES, views(ANGLES, rng))
        off = found.base.direction - BASE.direction
        place = found.base.point_m - BASE.point_m
        steps.append([off @ found.e1, off @ found.e2, place @ found.e1, place @ found.e2])
        claimed.append([found.std[name] for name in ("axis.tilt1", "axis.tilt2", "axis.p1", "axis.p2")])
        scales.append(found.scale)
    spread = np.sqrt(np.mean(np.array(steps) ** 2, axis=0))
    np.testing.assert_allclose(
        spread / np.mean(claimed, axis=0), 1.0, atol=0.28
    )  # 4 standard deviations of 100 repeats
    assert np.mean(scales) == pytest.approx(1.0, abs=0.05)


def test_the_angles_own_doubt_is_counted() -> None:
    rng, sigma = np.random.default_rng(2), 0.01
    scales = []
    for _ in range(50):
        off = rng.normal(0.0, sigma, len(ANGLES))
        scales.append(calibrate_rotary(ANGLES, views(ANGLES + off, rng), sigma_angle_rad=sigma).scale)
    assert np.mean(scales) == pytest.approx(1.0, abs=0.08)
    assert calibrate_rotary(ANGLES, views(ANGLES + rng.normal(0.0, sigma, 6), rng)).scale > 1.5


def test_too_few_or_too_close_angles_are_refused() -> None:
    with pytest.raises(NotEnoughData, match="2 different angles"):
        calibrate_rotary([0.0, 0.5], views(np.array([0.0, 0.5]), None))
    with pytest.raises(NotEnoughData, match="1 different"):
        calibrate_rotary([0.1, 0.1, 0.1], views(np.array([0.1, 0.1, 0.1]), None))
    close = np.radians([0.0, 3.0, 6.0])
    with pytest.raises(Degenerate, match="span 6"):
        calibrate_rotary(close, views(close, None))
    lost = TargetPose(t_s=0.0, status=PoseStatus.LOST, parent="rig")
    with pytest.raises(NotEnoughData):
        calibrate_rotary(ANGLES[:3], [*views(ANGLES[:2], None), lost])


@pytest.mark.parametrize("wrong", [np.degrees(ANGLES), -ANGLES + 0.3 * ANGLES**2, ANGLES[[1, 0, 2, 4, 3, 5]]])
def test_angles_that_do_not_belong_to_the_views(wrong: np.ndarray) -> None:
    with pytest.raises(Inconsistent):
        calibrate_rotary(wrong, views(ANGLES, None))


def test_the_other_sense_of_turning_is_the_other_axis() -> None:
    found = calibrate_rotary(-ANGLES, views(ANGLES, None))
    np.testing.assert_allclose(found.base.direction, -np.asarray(BASE.direction), atol=1e-9)
