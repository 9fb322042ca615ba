"""A calibration foretold: what the fit of noisy views finds, how it follows the number of views, what is refused."""

import numpy as np
import pytest

from armsight.calibrate.cameras import calibrate_stereo
from armsight.optics import Camera, RigKind, parallel_rig
from armsight.optics.camera import Plate
from armsight.optics.mirrors import Mirrors
from armsight.records import BoardView
from armsight.store import parse_board
from armsight_lab.design.planned_calibrations import planned_rig, planned_views

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
