"""Poses foretold: as the product states them, as they follow rig and target, their laws, and where there is none."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.measure.poses.pose import NamedSpots, solve_pose
from armsight.measure.poses.setup import Setup
from armsight.optics import Camera, parallel_rig
from armsight.records import NamedCovariance
from armsight.records.target import spot_target
from armsight.store import parse_board
from armsight_lab.design.expected_poses import expected_poses, look

CAMERA = Camera.pinhole(1280, 720, 950.0, 950.0, 639.5, 359.5)
LIGHTS = {"A": (-0.040, 0.0, 0.0), "B": (0.030, 0.032, 0.0), "C": (0.030, -0.032, 0.0)}
TARGET = spot_target(LIGHTS, diameter_m=0.006)
CLOSE = spot_target({"A": (-0.004, 0.0, 0.0), "B": (0.004, 0.0, 0.0), "C": (0.0, 0.05, 0.0)}, diameter_m=0.006)
TINY = spot_target({"A": (-0.006, 0.0, 0.0), "B": (0.005, 0.0, 0.0), "C": (0.0, 0.009, 0.0)})
TURN = Rotation.from_rotvec([0.25, 0.15, 0.3])


def known_rig():
    rig = parallel_rig(CAMERA, 0.12)
    std = np.array([0.3, 0.3, 0.4, 0.4, 0.0, 1e-3, 3e-3, 1e-4, 1e-4, 0.0])
    every = np.concatenate([std, std, [2e-5, 2e-5, 8e-5, 3e-4, 4e-4, 4e-5]])
    free = every > 0.0
    names = tuple(name for name, use in zip(rig.parameters, free, strict=True) if use)
    return replace(rig, covariance=NamedCovariance(names=names, matrix=np.diag(every[free] ** 2)))


def noise(sigma_px):
    return lambda size, side: np.full(size.shape, sigma_px)


def at(*places, turn=TURN):
    return RigidTransform.from_components(np.array(places, float), Rotation.concatenate([turn] * len(places)))


def solved(setup, pose, sigma_px, uv):
    spots = NamedSpots(
        names=setup.model.names,
        xyz_m=np.ascontiguousarray(setup.target.xyz_m),
        uv_px=np.ascontiguousarray(uv),
        cov_px2=np.tile(sigma_px**2 * np.eye(2), (3, 2, 1, 1)),
        radius_m=np.zeros((3, 2)),
        normal=setup.model.normal,
    )
    return solve_pose(setup.packed, 0.0, spots, limit=np.inf, covariance=setup.covariance).pose


def test_deviations_are_those_that_the_product_states() -> None:
    off = 1e-4 * np.random.default_rng(2).normal(size=(9, 9))
    setup = Setup(rig=known_rig(), target=replace(TARGET, covariance=off @ off.T))
    places = at((0.0, 0.0, 0.5), (0.15, -0.1, 0.7), (-0.1, 0.12, 0.9))
    found = expected_poses(setup, places, noise(0.1), least_px=2.0)
    uv = look(setup.rig, setup.target, places, 2.0).uv_px
    carried = found.slopes @ setup.covariance @ found.slopes.transpose(0, 2, 1)
    assert found.whole.all()
    for k in range(3):
        pose = solved(setup, places[k], 0.1, uv[k])
        np.testing.assert_allclose(found.random[k] + carried[k], pose.covariance, rtol=2e-4, atol=1e-12)
        np.testing.assert_allclose(carried[k], pose.systematic_covariance, rtol=2e-4, atol=1e-12)


@pytest.mark.parametrize(
    ("place", "target", "least_px", "why"),
    [
        ((0.0, 0.0, -0.5), TARGET, 2.0, "behind the left camera"),
        ((-0.4, 0.0, 0.7), TARGET, 2.0, "outside the right image"),
        ((0.6, 0.0, 0.7), TARGET, 2.0, "outside the left image"),
        ((0.0, 0.0, 2.0), TARGET, 4.0, "smaller than 4 px"),
        ((0.06, 0.0, 0.7), CLOSE, 2.0, "lights run into each other"),
        ((0.06, 0.0, 3.0), TINY, 2.0, "lights run into each other"),
        ((0.06, 0.0, 3.0), parse_board("checkerboard:7x5:0.02"), 2.0, "too close together"),
        ((0.06, 0.0, 2.5), parse_board("charuco:8x5:0.04:0.03:DICT_4X4_50"), 2.0, "too close together"),
        ((0.06, 0.0, 3.0), parse_board("aprilgrid:4x3:0.044:0.3"), 2.0, "too close together"),
    ],
)
def test_what_is_not_seen_is_told_with_the_reason(place, target, least_px: float, why: str) -> None:
    found = expected_poses(Setup(rig=known_rig(), target=target), at(place), noise(0.1), least_px=least_px)
    assert not found.placed[0] and why in found.why[0]
    assert np.isnan(found.random[0]).all()


def test_a_target_turned_away_and_one_that_looks_the_same_turned_are_told() -> None:
    setup = Setup(rig=known_rig(), target=TARGET)
    away = at((0.06, 0.0, 0.7), turn=Rotation.from_rotvec([0.0, np.deg2rad(80.0), 0.0]))
    assert "turned away" in expected_poses(setup, away, noise(0.1), least_px=2.0).why[0]
    angles = 2.0 * np.pi / 3.0 * np.arange(3)
    alike = {name: (0.04 * np.cos(a), 0.04 * np.sin(a), 0.0) for name, a in zip("ABC", angles, strict=True)}
    found = expected_poses(
        Setup(rig=known_rig(), target=spot_target(alike)), at((0.0, 0.0, 0.6)), noise(0.1), least_px=2.0
    )
    assert found.placed[0] and not found.whole[0] and "the same" in found.why[0]
