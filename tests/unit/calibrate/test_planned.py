"""A calibration foretold: what the fit of noisy views finds, how it follows the number of views, what is refused."""

from dataclasses import replace

import numpy as np
import pytest

from armsight.calibrate.cameras import calibrate_stereo
from armsight.errors import NotEnoughData
from armsight.geometry import pose_from_rotvec
from armsight.optics import Camera, RigKind, parallel_rig
from armsight.optics.camera import Plate
from armsight.optics.mirrors import Mirrors
from armsight.records import BoardView
from armsight.store import parse_board
from armsight_lab.design.planned_calibrations import planned_rig, planned_views
from refusals import refuses

CAMERA = Camera.pinhole(1280, 720, 950.0, 950.0, 639.5, 359.5)
RIG = parallel_rig(CAMERA, 0.12)
BOARD = parse_board("checkerboard:9x6:0.025")


def seen(rig, views, rng):
    both = ([], [])
    for k in range(len(views)):
        points = views.T_rig_board[k].apply(BOARD.xyz_m)
        for side, uv in zip(both, rig.project(points), strict=True):
            noisy = uv + rng.normal(0.0, views.sigma_px, uv.shape)
            index = np.arange(len(uv))
            side.append(BoardView(uv_px=noisy, index=index, sigma_px=0.1, width=1280, height=720, source=f"view {k}"))
    return both


def test_it_is_what_the_fit_of_such_views_states() -> None:
    views = planned_views(RIG, BOARD, 20, 0.1)
    foretold = planned_rig(RIG, views).covariance.std()
    found = calibrate_stereo(*seen(RIG, views, np.random.default_rng(4)), BOARD).rig.covariance.std()
    assert set(found) == set(foretold)
    for name, value in found.items():  # the fit scales by its residuals: 2 % of 4320 numbers
        assert value == pytest.approx(foretold[name], rel=0.1), name


@pytest.mark.parametrize("name", ["left.fx", "left.cx", "right.tz", "right.ry"])
def test_deviations_fall_with_the_root_of_the_number_of_views(name: str) -> None:
    few, many = (planned_rig(RIG, planned_views(RIG, BOARD, n, 0.1)).covariance.std()[name] for n in (50, 450))
    assert few / many == pytest.approx(3.0, rel=0.2)


def test_deviations_are_those_of_the_corners() -> None:
    views = planned_views(RIG, BOARD, 15, 0.1)
    one = planned_rig(RIG, views).covariance.matrix
    two = planned_rig(RIG, replace(views, sigma_px=0.2)).covariance.matrix
    np.testing.assert_allclose(two, 4.0 * one, rtol=1e-6)


def test_a_large_last_distortion_term_is_found_and_costs_sureness() -> None:
    k = CAMERA.intrinsics.copy()
    k[9] = 0.2
    bent = parallel_rig(replace(CAMERA, intrinsics=k), 0.12)
    assert "left.k3" not in planned_rig(RIG, planned_views(RIG, BOARD, 20, 0.1)).covariance.names
    assert "left.k3" in planned_rig(bent, planned_views(bent, BOARD, 20, 0.1)).covariance.names


def test_both_views_of_a_mirror_rig_are_of_one_lens() -> None:
    rig = Mirrors(baseline_m=0.12, plate=Plate(thickness_m=1e-3)).rig(CAMERA)
    assert rig.kind is RigKind.MIRROR
    std = planned_rig(rig, planned_views(rig, parse_board("checkerboard:7x5:0.015"), 20, 0.1)).covariance
    assert std.std()["left.fx"] == std.std()["right.fx"]
    assert std.block(("left.fx", "right.fx"))[0, 1] == pytest.approx(std.std()["left.fx"] ** 2)


def test_the_board_is_whole_in_every_planned_view() -> None:
    views = planned_views(RIG, BOARD, 30, 0.1)
    for k in range(len(views)):
        for uv in RIG.project(views.T_rig_board[k].apply(BOARD.xyz_m)):
            assert ((uv > 0.0) & (uv < [1279.0, 719.0])).all()


def test_too_few_views_and_a_board_that_fits_nowhere_are_refused() -> None:
    with refuses(NotEnoughData, "2 views", "3"):
        planned_views(RIG, BOARD, 2, 0.1)
    apart = parallel_rig(CAMERA, 0.12)
    turned = replace(apart, T_rig_right=apart.T_rig_right * pose_from_rotvec([0.0, 0.0, 0.0], [0.0, np.pi / 2, 0.0]))
    with refuses(NotEnoughData, "both cameras"):
        planned_views(turned, BOARD, 10, 0.1)
