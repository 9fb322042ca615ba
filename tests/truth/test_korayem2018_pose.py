"""Korayem et al. 2018, corrected: inverse kinematics, a LED's centroid, the pose that three lights span."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import Degenerate, NotEnoughData
from armsight.kinematics import preset
from armsight_sim.papers.korayem2018 import led_centroid, nearest_solution, solutions
from armsight_sim.papers.pachidis2005 import frame_of_three, pose_of_three
from refusals import refuses


def test_the_corrected_inverse_holds_the_original_and_only_true_solutions() -> None:
    rng = np.random.default_rng(0)
    arm = preset("korayem6r")
    for q in rng.uniform(-np.pi, np.pi, (200, 6)):
        T = arm.fk(q)
        found = solutions(T)
        assert len(found) in (2, 4, 6, 8)
        assert np.abs(arm.fk(found) - T).max() < 1e-9
        assert nearest_solution(T, q + 1e-3) == pytest.approx(q, abs=1e-6)


def test_out_of_reach_is_told() -> None:
    T = np.eye(4)
    T[:3, 3] = [3.0, 0.0, 0.0]
    with pytest.raises(NotEnoughData, match="reach"):
        nearest_solution(T, np.zeros(6))


def test_three_points_give_back_the_pose() -> None:
    rng = np.random.default_rng(1)
    model = np.array([[-0.04, 0.0, 0.0], [0.03, 0.032, 0.0], [0.03, -0.032, 0.0]])
    for _ in range(50):
        T = RigidTransform.from_components(rng.normal(size=3), Rotation.random(rng=rng))
        assert pose_of_three(T.apply(model), model) == pytest.approx(T.as_matrix(), abs=1e-12)
    with refuses(Degenerate, "one line"):
        frame_of_three(np.outer([0.0, 1.0, 3.0], [1.0, 2.0, 3.0]))


def test_lights_as_the_paper_wants_them_look_away_from_the_camera() -> None:
    """A left, B lower right, C upper right in the image: w along the camera's z (MATH 3.2)."""
    abc = np.array([[-0.008, 0.0, 0.6], [0.006, 0.0064, 0.6], [0.006, -0.0064, 0.6]])
    assert frame_of_three(abc)[:3, 2] == pytest.approx([0.0, 0.0, 1.0], abs=1e-12)
    assert frame_of_three(abc[[0, 2, 1]])[:3, 2] == pytest.approx([0.0, 0.0, -1.0], abs=1e-12)


def test_the_centroid_of_a_bright_disc() -> None:
    rows, columns = np.mgrid[0:60, 0:80]
    image = np.where(np.hypot(columns - 40.0, rows - 31.0) < 5.0, 220, 10).astype(np.uint8)
    image[2, 2] = 255  # outside the window
    image[40:44, 50:54] = 180  # another area in it
    assert led_centroid(image, (42.0, 30.0)) == pytest.approx([40.0, 31.0])
    with refuses(NotEnoughData, "surroundings"):
        led_centroid(np.zeros((60, 80), np.uint8), (40.0, 30.0))
