"""Where a pixel of one camera may be in the other one."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.optics import Camera, Rig, RigKind
from armsight.optics.triangulate import epipolar_curve

LENS = (0.08, -0.17, 0.0007, -0.0004, 0.04)
DEPTHS_M = np.geomspace(0.2, 10.0, 12)


def rig(place: RigidTransform | None = None) -> Rig:
    left = Camera.pinhole(1280, 720, 948.0, 949.0, 645.0, 355.0, distortion=LENS)
    right = Camera.pinhole(1280, 720, 953.0, 952.0, 635.0, 365.0, distortion=LENS)
    if place is None:
        place = RigidTransform.from_components([0.12, 0.001, -0.002], Rotation.from_euler("y", -5.0, degrees=True))
    return Rig(kind=RigKind.STEREO, left=left, right=right, T_rig_left=RigidTransform.identity(), T_rig_right=place)


@pytest.mark.parametrize("side", ["left", "right"])
def test_every_point_of_a_ray_lies_on_its_curve(side: str) -> None:
    """Points at the depths along a pixel's ray, projected by both cameras: the pixel in one, the curve in the other."""
    made = rig()
    px = np.array([700.0, 300.0])
    curve = epipolar_curve(made, side, px, DEPTHS_M)
    x, y = made.camera(side).rays(px[None])[0]
    points = made.T_rig_camera(side).apply(DEPTHS_M[:, None] * np.array([x, y, 1.0]))
    views = dict(zip(("left", "right"), made.project(points), strict=True))
    np.testing.assert_allclose(views[side], np.tile(px, (len(DEPTHS_M), 1)), atol=1e-6)
    np.testing.assert_allclose(curve, views["right" if side == "left" else "left"], atol=1e-6)


def test_behind_the_other_camera_there_is_nothing() -> None:
    ahead = RigidTransform.from_components([0.0, 0.0, 1.0], Rotation.identity())
    made = rig(ahead)
    curve = epipolar_curve(made, "left", [645.0, 355.0], [0.5, 2.0])
    assert np.isnan(curve[0]).all()
    assert np.isfinite(curve[1]).all()
