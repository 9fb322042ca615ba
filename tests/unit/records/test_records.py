"""Records copy, check and freeze what they are given."""

import numpy as np
import pytest

from armsight.errors import BadImage, Inconsistent
from armsight.records import Frame, LinearNoise, NoiseModel, Points, PoseStatus, Spots, TargetPose
from armsight.records.camera import NeighbourCorrelation
from refusals import refuses


def test_a_record_neither_shares_nor_yields_its_arrays() -> None:
    xyz = np.zeros((1, 3))
    points = Points(names=("A",), xyz_m=xyz, covariance_m2=np.eye(3)[None])
    xyz[0, 0] = 5.0
    assert points.xyz_m[0, 0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        points.xyz_m[0, 0] = 1.0


def test_wrong_shapes_and_nan_are_refused_by_name() -> None:
    with refuses(Inconsistent, "xyz_m", "shape"):
        Points(names=("A", "B"), xyz_m=np.zeros((1, 3)), covariance_m2=np.zeros((2, 3, 3)))
    with refuses(Inconsistent, "uv_px", "value"):
        Spots(
            uv_px=np.array([[np.nan, 0.0]]),
            covariance_px2=np.eye(2)[None],
            peak=np.ones(1),
            size_px=np.ones(1),
            model=("gaussian",),
        )


def test_a_frame_is_8_bit_grey_or_bgr() -> None:
    frame = Frame(image=np.zeros((4, 6), np.uint8), t_s=0.0, sequence=0, source="a.png")
    assert (frame.width, frame.height) == (6, 4)
    with pytest.raises(ValueError, match="read-only"):
        frame.image[0, 0] = 1
    for image in (np.zeros((4, 6)), np.zeros((4, 6, 4), np.uint8), np.zeros((0, 6), np.uint8)):
        with pytest.raises(BadImage):
            Frame(image=image, t_s=0.0, sequence=0, source="a.png")  # type: ignore[arg-type]


def test_a_pose_carries_what_its_status_promises() -> None:
    lost = TargetPose(t_s=0.0, status=PoseStatus.LOST, parent="rig", why="no spot found")
    assert lost.pose is None
    with pytest.raises(Inconsistent, match="both"):
        TargetPose(t_s=0.0, status=PoseStatus.OK, parent="rig")


def make_noise(linear: LinearNoise | None = None, near: float = 0.0) -> NoiseModel:
    return NoiseModel(
        levels=np.array([10.0, 20.0, 120.0]),
        variance_levels2=np.array([2.0, 3.0, 13.0]),
        std_levels2=np.full(3, 0.1),
        correlation=NeighbourCorrelation(x=[near, near / 4], y=[near, near / 4], diagonal=near**2),
        n_frames=20,
        linear=linear,
    )


def test_noise_is_told_at_any_level() -> None:
    noise = make_noise()
    assert noise.variance_at([[10.0, 15.0], [70.0, 120.0]]) == pytest.approx(np.array([[2.0, 2.5], [8.0, 13.0]]))
    assert noise.variance_at([0.0, 255.0]) == pytest.approx([2.0, 13.0])
    assert noise.table().shape == (256,)
    assert noise.table()[70] == pytest.approx(8.0)
    line = make_noise(LinearNoise(read_noise_levels=1.0, gain_levels=0.1))
    assert line.variance_at(220.0) == pytest.approx(23.0)
    with pytest.raises(Inconsistent, match="gain"):
        LinearNoise(read_noise_levels=1.0, gain_levels=0.0)


def test_correlated_noise_widens() -> None:
    assert make_noise().widening(2.0) == pytest.approx([1.0, 1.0])
    noise = make_noise(near=0.4)
    assert noise.widening() == pytest.approx([(1.0 + 0.8 + 0.2) ** 2] * 2)
    along = 1.0 + 0.8 * (1.0 - 1.0 / 8.0) * np.exp(-1.0 / 16.0) + 0.2 * (1.0 - 4.0 / 8.0) * np.exp(-4.0 / 16.0)
    across = 1.0 + 0.8 * np.exp(-1.0 / 16.0) + 0.2 * np.exp(-4.0 / 16.0)
    assert noise.widening(2.0) == pytest.approx([along * across] * 2)
