"""What the pages show: standard deviations of angles, thinned curves and bands, numbers for people, JSON."""

import json

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.measure.series import Series, series_of
from armsight.records import PoseStatus, TargetPose
from armsight.report.figures import MAX_PLOTTED, json_text, spread, thinned
from armsight.report.track import scatter_of
from armsight.units import DEG, MM, displayed_name, figure_of, with_deviation

STD = np.array([2e-5, 2e-5, 1e-4, 3e-4, 2e-4, 1e-4])


def test_bands_of_the_angles_by_finite_differences():
    """Standard deviations of rx, ry, rz from a correlated covariance of the rotation vector, against numeric
    derivatives."""
    rng = np.random.default_rng(3)
    A = 1e-3 * rng.standard_normal((6, 6))
    covariance = A @ A.T
    R = Rotation.from_euler("xyz", [0.4, -0.9, 2.2])
    pose = TargetPose(
        t_s=0.0,
        status=PoseStatus.OK,
        parent="rig",
        T_parent_target=RigidTransform.from_components([0.1, 0.2, 0.3], R).as_matrix(),
        covariance=covariance,
    )
    series = series_of([pose])
    h = 1e-6
    J = np.column_stack(
        [
            (
                (Rotation.from_rotvec(h * axis) * R).as_euler("xyz")
                - (Rotation.from_rotvec(-h * axis) * R).as_euler("xyz")
            )
            / (2 * h)
            for axis in np.eye(3)
        ]
    )
    want = np.sqrt(np.diag(J @ covariance[3:, 3:] @ J.T))
    assert np.allclose(np.deg2rad(series.std[0, 3:]), want, rtol=1e-6)
    assert np.allclose(series.std[0, :3], 1e3 * np.sqrt(np.diag(covariance))[:3])
    assert np.allclose(np.deg2rad(series.values[0, 3:]), [0.4, -0.9, 2.2])


def test_angles_run_on_and_gimbal_lock_has_no_band():
    def turned(angles):
        return TargetPose(
            t_s=0.0,
            status=PoseStatus.OK,
            parent="rig",
            T_parent_target=RigidTransform.from_rotation(Rotation.from_euler("xyz", angles, degrees=True)).as_matrix(),
            covariance=np.diag(STD**2),
        )

    track = series_of([turned([0, 0, angle]) for angle in (170, 179, 188, 197)])
    assert np.allclose(track.values[:, 5], (170, 179, 188, 197))
    assert np.isnan(series_of([turned([0, 90, 0])]).std[0, 3:]).any()


def test_thinning_keeps_extremes_and_ends():
    values = np.sin(np.arange(100_000) / 1000.0)
    values[[31_415, 77_777]] = 9.0, -9.0
    values[500:600] = np.nan
    keep = thinned(values)
    assert len(keep) <= MAX_PLOTTED + 2
    assert {0, 31_415, 77_777, 99_999} <= set(keep.tolist())
    points = np.zeros((50_000, 2))
    points[123] = 0.0, 7.0
    assert 123 in spread(points)
    assert len(spread(points)) <= 3000
    assert thinned(np.full(100_000, np.nan)).tolist() == [0, 99_999]


def test_numbers_for_people():
    assert figure_of(0.0, "px") == "0 px"
    assert figure_of(123.456) == "123"
    assert figure_of(0.0312345, "mm") == "0.0312 mm"
    assert figure_of(0.02, "°", digits=2) == "0.020°"
    assert figure_of(None) == figure_of(float("nan")) == "–"
    assert figure_of(3.2e-7) == "3.20e-07"
    assert figure_of(4.5e-14, "mm") == "0 mm"
    assert with_deviation(533.47509, 0.4123) == ("533.48", "0.41")
    assert with_deviation(1234.5, 23.0) == ("1234", "23")
    assert with_deviation(0.1, None) == ("0.1000000", "–")
    assert with_deviation(0.5, 1e-14) == ("0.5000", "0")


def test_json_cannot_leave_its_script():
    text = json_text({"a": ["</script>&", np.float64(np.nan), np.arange(2.0) / 3]})
    assert not set("<>&") & set(text)
    assert json.loads(text) == {"a": ["</script>&", None, [0.0, 0.333333]]}


@pytest.mark.parametrize("moves", [True, False])
def test_scatter_without_truth_is_the_noise(moves):
    rng = np.random.default_rng(3)
    t_s = np.arange(600) / 30.0
    std = np.array([0.02, 0.03, 0.1, 0.01, 0.02, 0.03])
    way = np.sin(0.5 * t_s)[:, None] * np.array([50.0, 20.0, 90.0, 5.0, 8.0, 3.0]) if moves else 0.0
    values = way + std * rng.standard_normal((600, 6))
    status = [PoseStatus.LOST if 200 <= i < 204 else PoseStatus.OK for i in range(600)]
    series = Series(t_s=t_s, status=tuple(status), values=values, std=np.tile(std, (600, 1)))
    values, resting = scatter_of(series)
    assert resting is not moves
    known = np.isfinite(values[:, 0])
    assert known.sum() == (576 if moves else 596)  # five at each end of a stretch have no full neighbourhood
    assert np.allclose(values[known].std(axis=0) / std, 1.0, atol=0.1)


def test_too_few_frames_in_a_row_say_nothing_of_scatter():
    status = tuple(PoseStatus.OK if i % 10 else PoseStatus.LOST for i in range(60))
    series = Series(t_s=np.arange(60.0), status=status, values=np.zeros((60, 6)), std=np.ones((60, 6)))
    assert scatter_of(series) is None


def test_a_name_loses_its_unit_and_keeps_its_number() -> None:
    assert displayed_name("j2.d_m") == ("j2.d", "mm", MM) and displayed_name("rx_rad") == ("rx", "deg", DEG)
    assert [displayed_name(name) for name in ("light_1", "m", "k1")] == [(n, "", 1.0) for n in ("light_1", "m", "k1")]
