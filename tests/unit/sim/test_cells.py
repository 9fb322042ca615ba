"""Simulated cells: truth, seeds, faults, and boards, checked with OpenCV's projection and detectors."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from armsight_sim import LedCellOptions, Sensor, board_cell, led_cell

QUIET = Sensor(electrons_per_level=np.inf, read_noise_level=0.0)


DARK = {"room": "dark", "pipeline": "ideal"}
"""Nothing behind the target, nothing but noise in the cameras."""


def small(seed=3, frames=4, **options):
    chosen = LedCellOptions(**{"width": 320, "height": 180, "sigma_px": 1.2} | options)
    return led_cell(seed, frames, chosen, **DARK)


def opencv_pixels(rig, side, points_m):
    """Pixels (n, 2) of points in rig axes, from the rig.yaml structure alone."""
    c = rig["cameras"][side]
    pose = c["T_rig_camera"]
    R = Rotation.from_quat(pose["quat_xyzw"]).as_matrix().T
    K = np.array([[c["fx"], c["skew"], c["cx"]], [0, c["fy"], c["cy"]], [0, 0, 1]])
    t = -R @ np.array(pose["xyz_m"])
    return cv2.projectPoints(np.asarray(points_m), cv2.Rodrigues(R)[0], t, K, np.array(c["distortion"]))[0][:, 0]


def true_points(cell, index):
    _, xyz, quat = cell.truth[index]
    return Rotation.from_quat(quat).apply(np.array(list(cell.target["spots_m"].values()))) + xyz


def centroid(light, uv, half):
    """Centre of the light in a window about uv."""
    i, j = np.round(uv).astype(int)
    window = light[j - half : j + half + 1, i - half : i + half + 1].astype(float)
    v, u = np.mgrid[j - half : j + half + 1, i - half : i + half + 1]
    return np.array([(window * u).sum(), (window * v).sum()]) / window.sum()


@pytest.mark.parametrize(("diameter_m", "tolerance_px"), [(None, 2e-3), (0.012, 0.02)])
def test_the_light_falls_where_the_true_poses_say(diameter_m, tolerance_px):
    """Tolerance: the path's curvature within the exposure; for discs the perspective shift of their centre."""
    cell = small(frames=40, diameter_m=diameter_m, width=640, height=360, sigma_px=1.5)
    for index in (0, 20, 39):
        points, t_s = true_points(cell, index), cell.truth[index][0]
        assert t_s == index / 60.0
        for side, camera in cell.cameras.items():
            want = opencv_pixels(cell.rig, side, points)
            visible = cell.centres_px(index, side)
            light = (camera.light(cell.lights, cell.path, t_s) - camera.backdrop)[:, :, 0]
            for name, uv in zip("ABC", want, strict=True):
                np.testing.assert_allclose(centroid(light, uv, 11), uv, atol=tolerance_px)
                assert name not in visible or np.allclose(visible[name], uv, atol=1e-9)


def test_faults_happen_when_they_are_planned():
    cell = small(frames=200, sensor=QUIET, hot_pixels=0)
    covered = {side: [3 - len(cell.centres_px(k, side)) for k in range(200)] for side in ("left", "right")}
    both = np.array(covered["left"]) + np.array(covered["right"])
    assert (both == 6).sum() == 4
    assert 0.05 < (both > 0).mean() < 0.15
    assert (both[:25] == 0).all()
    lost = int(np.argmax(both == 6))
    assert cell.pair(lost)[0].image.max() < 15
    ghost = next(e for e in cell.events if e.ghosts)
    u, v = np.round(ghost.ghosts[0].uv_px).astype(int)
    assert cell.pair(ghost.first)[1].image[v, u] > 100
    assert cell.pair(ghost.last)[1].image[v, u] < 15
    assert all(any(e.note in text for text in cell.assumptions) for e in cell.events)
    assert small(frames=200, faults=False).events == ()
    assert small(frames=10).events == ()


def test_boards_are_found_where_they_are():
    cell = board_cell(5, 3, width=640, height=360, **DARK)
    corners = np.array([[c * 0.025, r * 0.025, 0.0] for r in range(6) for c in range(9)])
    for index, frames in enumerate(cell.frames()):
        _, xyz, quat = cell.truth[index]
        for side, frame in zip(("left", "right"), frames, strict=True):
            want = opencv_pixels(cell.rig, side, Rotation.from_quat(quat).apply(corners) + xyz)
            assert cv2.findChessboardCornersSB(frame.image, (9, 6))[0]
            start = want.astype(np.float32)[:, None].copy()
            seen = cv2.cornerSubPix(frame.image, start, (4, 4), (-1, -1), (3, 100, 1e-6))[:, 0]
            assert np.sqrt(((seen - want) ** 2).mean()) < 0.07  # OpenCV's own scatter is 0.04 px
            assert np.abs((seen - want).mean(axis=0)).max() < 0.02  # no shift of the pixel grid
    assert cell.board == "checkerboard:9x6:0.025"
