"""What a rig resolves (MATH 2.3) and how parallel it stands (Kapucu's alignment)."""

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.errors import UsageError
from armsight.optics import Camera, MountedCamera, Rig, RigKind, parallel_rig, parallelism, resolution
from armsight.records import NamedCovariance

CAMERA = Camera.pinhole(1280, 720, 1130.0, 1130.0, 640.0, 360.0)


def test_the_table_of_korayems_rig() -> None:
    printed = {0.50: [3.69, 2.77, 2.21, 1.47, 1.11], 0.65: [6.23, 4.67, 3.74, 2.49, 1.87]}
    for depth, row in printed.items():
        ours = [resolution(parallel_rig(CAMERA, b), depth).depth_per_px_m for b in (0.06, 0.08, 0.10, 0.15, 0.20)]
        np.testing.assert_allclose(np.array(ours) * 1e3, row, atol=0.005)
    at = resolution(parallel_rig(CAMERA, 0.1), 0.65, sigma_px=0.1)
    assert at.lateral_per_px_m == pytest.approx(0.65 / 1130.0)
    assert at.sigma_depth_m == pytest.approx(0.53e-3, abs=0.005e-3)
    np.testing.assert_allclose(at.sigma_lateral_m, 0.041e-3, atol=0.001e-3)
    assert at.in_view
    assert not resolution(parallel_rig(CAMERA, 0.1), 0.05).in_view


def test_other_cameras_than_a_pair_resolve_what_two_of_their_kind_do() -> None:
    """Parallel cameras know depth to sqrt(2) sigma Z^2 / (B f); one more, further off, to less; one alone does not."""
    beside = [RigidTransform.from_translation([x, 0.0, 0.0]) for x in (0.0, 0.1, 0.4)]
    mounted = [MountedCamera(name=f"c{i}", camera=CAMERA, T_rig_camera=T) for i, T in enumerate(beside)]
    two, three = (resolution(Rig(cameras=mounted[:n]), 2.0, sigma_px=0.1) for n in (2, 3))
    assert two.sigma_depth_m == pytest.approx(np.sqrt(2.0) * 0.1 * 4.0 / (0.1 * CAMERA.intrinsics[0]), rel=1e-4)
    assert two.in_view and two.depth_per_px_m is None
    assert three.sigma_depth_m < 0.3 * two.sigma_depth_m
    np.testing.assert_allclose(three.point_m, [0.0, 0.0, 2.0])
    with pytest.raises(UsageError, match="one camera"):
        resolution(Rig(cameras=mounted[:1]), 2.0)


def pair(rotvec: tuple[float, float, float], covariance: NamedCovariance | None = None) -> Rig:
    T = RigidTransform.from_components([0.126, 0.002, -0.003], Rotation.from_rotvec(rotvec))
    return Rig(
        kind=RigKind.STEREO,
        left=CAMERA,
        right=CAMERA,
        T_rig_left=RigidTransform.identity(),
        T_rig_right=T,
        covariance=covariance,
    )


def test_each_misalignment_shows_in_its_own_figure() -> None:
    straight = parallelism(pair((0.0, 0.0, 0.0)))
    assert max(abs(straight.convergence_rad), abs(straight.vertical_px), abs(straight.roll_rad)) == 0.0
    assert (straight.height_m, straight.advance_m) == (0.002, -0.003)
    np.testing.assert_allclose(straight.gap_px, 0.0, atol=1e-12)
    assert parallelism(pair((0.0, -0.01, 0.0))).convergence_rad == pytest.approx(0.01)
    assert parallelism(pair((0.0, 0.0, 0.02))).roll_rad == pytest.approx(0.02)
    tilted = parallelism(pair((-0.01, 0.0, 0.0)))  # the right camera looks down: its picture of infinity moves up
    assert tilted.vertical_rad == pytest.approx(0.01)
    assert tilted.vertical_px == pytest.approx(-1130.0 * np.tan(0.01))
    assert tilted.std is None
