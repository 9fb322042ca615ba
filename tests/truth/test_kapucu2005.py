"""Kapucu and Baysec 2005, corrected: circles, places and tables known in advance."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Degenerate, NotEnoughData
from armsight.optics import Camera, Rig, RigKind
from armsight_sim.papers.kapucu2005 import (
    beacon_centroid,
    camera_places,
    from_world,
    joint_of_path,
    plane_frame,
    rrp_links,
    to_world,
)
from refusals import refuses


def circle(rng: np.random.Generator, angles_rad: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """Points on a random circle in the order of a positive turn, its centre, axis and radius."""
    R, centre, radius = Rotation.random(rng=rng), rng.normal(0.0, 2.0, 3), float(rng.uniform(0.05, 1.5))
    flat = np.stack([np.cos(angles_rad), np.sin(angles_rad), np.zeros(len(angles_rad))], axis=1)
    return centre + radius * R.apply(flat), centre, R.as_matrix()[:, 2], radius


def test_the_corrected_steps_find_circles_without_noise_exactly() -> None:
    rng = np.random.default_rng(0)
    for _ in range(200):
        points, centre, axis, radius = circle(rng, np.linspace(0.0, rng.uniform(2.0, 6.0), 10))
        found = joint_of_path(points)
        assert found.revolute
        assert found.point_m == pytest.approx(centre, abs=1e-8)
        assert found.direction == pytest.approx(axis, abs=1e-8)
        assert found.radius_m == pytest.approx(radius, abs=1e-8)


def test_the_plane_of_three_points_becomes_x_y() -> None:
    rng = np.random.default_rng(1)
    for _ in range(100):
        P = rng.normal(size=(3, 3))
        T = plane_frame(*P)
        local = P @ T[:3, :3].T + T[:3, 3]
        assert local[0] == pytest.approx(np.zeros(3), abs=1e-12)
        assert local[1, 1:] == pytest.approx(np.zeros(2), abs=1e-12)
        assert local[1, 0] > 0.0 and local[2, 1] > 0.0
        assert local[2, 2] == pytest.approx(0.0, abs=1e-12)
        assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)


def test_a_straight_path_is_a_slide_and_bad_paths_are_named() -> None:
    line = np.linspace(0.0, 0.46, 10)[:, None] * np.array([0.6, 0.0, 0.8])
    found = joint_of_path(line + np.random.default_rng(2).normal(0.0, 0.01, (10, 3)))
    assert not found.revolute
    assert found.direction == pytest.approx([0.6, 0.0, 0.8], abs=0.1)
    with pytest.raises(NotEnoughData, match="2 places"):
        joint_of_path(line[:2])
    with refuses(Degenerate, "begins"):
        joint_of_path(np.vstack([line, line[:1]]))


def rig() -> Rig:
    camera = Camera.pinhole(640, 480, 757.6, 748.9, 319.5, 239.5)
    apart = RigidTransform.from_translation([0.126, 0.0, 0.0])
    return Rig(kind=RigKind.STEREO, left=camera, right=camera, T_rig_left=RigidTransform.identity(), T_rig_right=apart)


def test_places_come_back_from_their_pixels_and_from_the_world() -> None:
    rng = np.random.default_rng(3)
    stereo = rig()
    in_rig = rng.uniform([-1.0, -1.0, 3.0], [1.0, 1.0, 5.0], (50, 3))
    left, right = stereo.left.project(in_rig), stereo.right.project(in_rig - [0.126, 0.0, 0.0])
    places = camera_places(stereo, left, right)
    assert places == pytest.approx((in_rig - [0.126, 0.0, 0.0]) * [1.0, -1.0, 1.0], abs=1e-9)
    T = RigidTransform.from_components([1.0, 2.0, 3.0], Rotation.random(rng=rng)).as_matrix()
    world = to_world(stereo, T, places)
    assert world == pytest.approx(in_rig @ T[:3, :3].T + T[:3, 3], abs=1e-9)
    assert from_world(stereo, T, world) == pytest.approx(places, abs=1e-9)
    with pytest.raises(Degenerate, match="disparity"):
        camera_places(stereo, right, left)


def test_the_centroid_of_a_red_disc_and_none_without_red() -> None:
    image = np.full((480, 640, 3), 30, np.uint8)
    rows, columns = np.mgrid[0:480, 0:640]
    image[np.hypot(columns - 200.0, rows - 101.0) < 9.0] = (20, 20, 200)
    image[300:310, 500:510] = (200, 200, 220)  # white is not red
    assert beacon_centroid(image) == pytest.approx([200.0, 101.0], abs=1e-9)
    with refuses(NotEnoughData, "pixel"):
        beacon_centroid(np.full((480, 640, 3), 200, np.uint8))


def test_table_one_from_the_axes_of_the_rig_itself() -> None:
    z = np.array([0.0, 0.0, 1.0])
    # d1 = 127 cm, a2 = 10, d2 = -5: axis 2 along -y, the slide 10 cm off it and 5 cm aside
    beacon = np.array([0.95, 0.05, 1.37])
    axes = [(np.zeros(3), z), (np.array([0.0, 0.7, 1.27]), -np.eye(3)[1]), (beacon, np.eye(3)[0])]
    first, second, d3 = rrp_links(axes, beacon, np.eye(3)[0])
    assert (first.a_m, first.d_m, first.alpha_rad) == pytest.approx((0.0, 1.27, np.pi / 2.0), abs=1e-12)
    assert (abs(second.a_m), second.d_m, second.alpha_rad) == pytest.approx((0.1, -0.05, np.pi / 2.0), abs=1e-12)
    assert d3 == pytest.approx(0.95)
