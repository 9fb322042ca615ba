"""Denavit-Hartenberg links from axes in space."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight.kinematics import link_to_line

PARALLEL = {"same sense": 1.0, "opposite": -1.0}


def frame(rng: np.random.Generator) -> np.ndarray:
    T = np.eye(4)
    T[:3, :3] = Rotation.random(rng=rng).as_matrix()
    T[:3, 3] = rng.normal(size=3)
    return T


def check(T: np.ndarray, point: np.ndarray, direction: np.ndarray, case: str, tolerance: float = 1e-9) -> None:
    link = link_to_line(T, point, direction)
    far = T @ link.matrix()
    assert link.case == case
    np.testing.assert_allclose(far[:3, 2], direction, atol=1e-11)
    assert np.linalg.norm(np.cross(direction, far[:3, 3] - point)) < tolerance
    assert far[:3, 0] @ T[:3, 0] > -1e-9  # x on the side of the near x


def test_random_lines() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        check(frame(rng), rng.normal(size=3), Rotation.random(rng=rng).as_matrix()[:, 0], "skew", 1e-11)


@pytest.mark.parametrize("sense", PARALLEL)
def test_parallel_lines(sense: str) -> None:
    rng = np.random.default_rng(1)
    for _ in range(50):
        T, point = frame(rng), rng.normal(size=3)
        check(T, point, PARALLEL[sense] * T[:3, 2], "parallel", 1e-11)
        link = link_to_line(T, point, PARALLEL[sense] * T[:3, 2])
        assert link.d_m == pytest.approx((point - T[:3, 3]) @ T[:3, 2])  # d is free: that of the point


def test_coincident_lines_keep_the_direction_asked_for() -> None:
    rng = np.random.default_rng(2)
    T = frame(rng)
    link = link_to_line(T, T[:3, 3] + 0.3 * T[:3, 2], T[:3, 2], x_hint=T[:3, 1])
    assert (link.case, link.a_m) == ("coincident", 0.0)
    assert link.theta_rad == pytest.approx(np.pi / 2)
    assert link.d_m == pytest.approx(0.3)


@pytest.mark.parametrize("angle", [1e-10, 1e-6, 1e-3, 0.019])
@pytest.mark.parametrize("sense", PARALLEL)
def test_nearly_parallel_lines_get_a_beta_and_no_runaway_d(angle: float, sense: str) -> None:
    rng = np.random.default_rng(4)
    for _ in range(50):
        T = frame(rng)
        side = rng.normal(size=2)
        side *= angle / np.linalg.norm(side)
        direction = PARALLEL[sense] * T[:3, :3] @ np.array([*side, np.sqrt(1 - angle**2)])
        point = rng.normal(size=3)
        check(T, point, direction, "nearly parallel")
        link = link_to_line(T, point, direction)
        assert link.d_m == 0.0
        assert abs(link.a_m) < 10.0
        assert abs(link.beta_rad) <= 1.01 * angle
