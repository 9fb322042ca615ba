"""Boards that are others than they are said to be: named by what fits, and the cure works."""

import cv2
import numpy as np
import pytest

from armsight.calibrate.cameras import BoardOptions, calibrate_camera
from armsight.errors import Inconsistent
from armsight.records import BoardView
from armsight.store import parse_board
from refusals import names_it, refuses

K = np.array([[800.0, 0.0, 645.0], [0.0, 802.0, 355.0], [0.0, 0.0, 1.0]])
BENT = np.array([-0.1, 0.05, 2e-4, -3e-4, 0.0])
QUICK = BoardOptions(folds=0)


def views(xyz_m, seed=3, n=14, turn=3.0):
    """Return views by OpenCV of points (n, 3), good to 0.03 px."""
    rng, out = np.random.default_rng(seed), []
    while len(out) < n:
        w, t = rng.uniform(-0.5, 0.5, 3) * [1.0, 1.0, turn], rng.uniform([-0.35, -0.2, 0.5], [0.35, 0.2, 1.0])
        t = t - cv2.Rodrigues(w)[0] @ xyz_m.mean(axis=0)
        uv = cv2.projectPoints(xyz_m, w, t, K, BENT)[0].reshape(-1, 2)
        if (uv > 2.0).all() and (uv < [1277.0, 717.0]).all():
            uv = uv + rng.normal(0.0, 0.03, uv.shape)
            name = f"{len(out)}.png"
            out.append(
                BoardView(uv_px=uv, index=np.arange(len(uv)), sigma_px=0.03, width=1280, height=720, source=name)
            )
    return out


def test_squares_that_are_none_are_named_and_squares_are_the_cure():
    board = parse_board("checkerboard:9x6:0.025")
    with refuses(Inconsistent, "1.040", "25 x 26 mm", "calliper"):
        calibrate_camera(views(board.xyz_m * [1.0, 1.04, 1.0]), board, QUICK)
    assert calibrate_camera(views(board.xyz_m), board, QUICK).rms_px < 0.06


def test_squares_that_are_none_pass_for_pixels_where_the_board_is_never_turned_and_that_is_told():
    board = parse_board("checkerboard:9x6:0.025")
    done = calibrate_camera(views(board.xyz_m * [1.0, 1.04, 1.0], turn=0.0), board, QUICK)
    assert [text for text in done.advice if names_it(text, "fx", "fy", "calliper")]
    verdict = done.verdict_
    assert verdict.level == "care" and names_it(verdict.reasons[0], "fx", "fy")
    assert names_it(verdict.next[0], "calliper")
    plain = calibrate_camera(views(board.xyz_m, turn=0.0), board, QUICK)
    assert not [text for text in plain.advice if names_it(text, "calliper")]
    assert not names_it(plain.verdict_.reasons[0], "fx")


@pytest.mark.parametrize(("true", "said"), [(0.3, 0.2), (0.25, 0.3), (0.2, 0.5)])
def test_gaps_of_an_aprilgrid_are_named_and_the_cure_works(true, said):
    right = parse_board(f"aprilgrid:6x5:0.04:{true}")
    with refuses(Inconsistent, f"--board aprilgrid:6x5:0.04:{true:.3f}") as caught:
        calibrate_camera(views(right.xyz_m), parse_board(f"aprilgrid:6x5:0.04:{said}"), QUICK)
    text = caught.value.cure.split("--board ")[1].split(" ")[0]
    found = calibrate_camera(views(right.xyz_m), parse_board(text), QUICK)
    assert found.rms_px < 0.06
    assert found.camera.intrinsics[0] == pytest.approx(800.0, rel=5e-3)


def test_points_that_are_no_such_board_are_refused_by_what_they_miss():
    board = parse_board("checkerboard:9x6:0.03")
    bent = board.xyz_m + np.random.default_rng(1).normal(0.0, 0.005, board.xyz_m.shape) * [1.0, 1.0, 0.0]
    with refuses(Inconsistent, "--board", "0.03 px"):
        calibrate_camera(views(bent), board, QUICK)
    assert calibrate_camera(views(board.xyz_m), board, QUICK).rms_px < 0.06
