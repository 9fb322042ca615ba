"""The renderer's lens against OpenCV's."""

import cv2
import numpy as np
import pytest

from armsight_sim import Lens

LENSES = {
    "no distortion": (0.0, 0.0, 0.0, 0.0, 0.0),
    "radial": (-0.28, 0.09, 0.0, 0.0, -0.013),
    "decentred": (0.0, 0.0, 0.004, -0.006, 0.0),
    "all": (0.09, -0.18, 0.0011, -0.0007, 0.05),
}


def opencv_pixels(lens, points_m):
    """cv2 has no skew: distort on the unit plane there, apply the camera matrix here."""
    xd, _ = cv2.projectPoints(points_m, np.zeros(3), np.zeros(3), np.eye(3), np.array(lens.distortion))
    (fx, fy), (cx, cy) = lens.focal_px, lens.centre_px
    K = np.array([[fx, lens.skew_px, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    return (np.concatenate([xd[:, 0], np.ones((len(xd), 1))], axis=1) @ K.T)[:, :2]


@pytest.mark.parametrize("name", LENSES)
@pytest.mark.parametrize("skew", [0.0, 3.5])
def test_pixels_agree_with_opencv_and_rays_lead_back(name, skew):
    lens = Lens(
        width=1280, height=720, focal_px=(948.0, 951.5), centre_px=(646.0, 355.0), skew_px=skew, distortion=LENSES[name]
    )
    rng = np.random.default_rng(0)
    points = rng.uniform([-0.6, -0.35, 0.9], [0.6, 0.35, 1.1], (500, 3))
    uv = lens.project(points)
    np.testing.assert_allclose(uv, opencv_pixels(lens, points), atol=1e-9)
    np.testing.assert_allclose(lens.rays(uv), points[:, :2] / points[:, 2:], atol=1e-12)


def test_what_is_not_in_front_has_no_pixel():
    lens = Lens(width=10, height=10, focal_px=(10.0, 10.0), centre_px=(5.0, 5.0))
    uv = lens.project([[[0.0, 0.0, -1.0], [0.0, 0.0, 0.0]], [[0.0, 0.0, 1.0], [0.1, 0.0, 1.0]]])
    assert np.isnan(uv[0]).all()
    np.testing.assert_allclose(uv[1], [[5.0, 5.0], [6.0, 5.0]])
