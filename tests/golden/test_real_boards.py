"""Real pictures of boards made by other people; see the data's README for where they come from."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

from armsight.calibrate.cameras import BoardOptions, calibrate_camera, calibrate_stereo
from armsight.errors import BadImage, Inconsistent
from armsight.measure.boards import find_board
from armsight.ops.calibrate_cameras import calibrate_camera as calibrate_images
from armsight.records import BoardView, TargetKind, board_target
from refusals import refuses

DATA = Path(__file__).resolve().parents[3] / "shared" / "data"
STEREO, DOTS = DATA / "opencv_stereo", DATA / "dots_10x10_handeye" / "images"
PAIRS = (1, 2, 3, 4, 5, 6, 7, 8, 9, 11, 12, 13, 14)
BOARD = board_target(TargetKind.CHECKERBOARD, 9, 6, 0.025)
SHEET = board_target(TargetKind.CIRCLES, 10, 10, 0.0254)

needs_stereo = pytest.mark.skipif(not STEREO.exists(), reason=f"{STEREO.name} is not beside the repository")
needs_dots = pytest.mark.skipif(not DOTS.exists(), reason=f"{DOTS.parent.name} is not beside the repository")


def picture(path: Path) -> np.ndarray:
    return cv2.imread(str(path), cv2.IMREAD_GRAYSCALE)


@pytest.fixture(scope="module")
def views() -> tuple[list[BoardView], list[BoardView]]:
    sides = ([STEREO / f"{side}{n:02d}.jpg" for n in PAIRS] for side in ("left", "right"))
    left, right = ([find_board(picture(p), BOARD, source=p.name) for p in side] for side in sides)
    return left, right


@needs_stereo
def test_all_pairs_are_used_and_left_out_pairs_are_measured_better_than_by_opencv(
    views: tuple[list[BoardView], list[BoardView]],
) -> None:
    assert all(len(view) == 54 for side in views for view in side)
    found = calibrate_stereo(*views, BOARD, BoardOptions(folds=13))
    assert found.n_used == 13
    assert found.rejected == ()
    assert max(np.linalg.norm(r, axis=1).max() for r in found.residual_px.values()) < 1.0  # no wrong corner
    # OpenCV 4.14 at window 5: 0.206 mm, 0.427 mm, 0.181 px
    assert found.metric_is_left_out
    assert found.metric["rms_m"] < 0.20e-3
    assert found.metric["board_rms_m"] < 0.42e-3
    assert found.holdout_epipolar_rms_px < 0.18
    assert found.rms_px < 0.21
    assert abs(found.rig.baseline_m - 83.19e-3) < 0.1e-3


@needs_stereo
def test_swapped_sides_are_recognised(views: tuple[list[BoardView], list[BoardView]]) -> None:
    with pytest.raises(Inconsistent, match="swapped"):
        calibrate_stereo(views[1], views[0], BOARD)


@needs_stereo
def test_wrong_size_is_told_with_the_right_one() -> None:
    with refuses(BadImage, "7x7", size=(9, 6)):
        find_board(picture(STEREO / "left01.jpg"), board_target(TargetKind.CHECKERBOARD, 7, 7, 0.025))


@needs_stereo
@pytest.mark.parametrize(
    ("name", "columns", "seen"), [("right06", 8, (9, 6)), ("right11", 8, (9, 6)), ("left13", 10, None)]
)
def test_a_wrong_count_is_refused_where_the_board_ends_in_half_squares(
    name: str, columns: int, seen: tuple[int, int] | None
) -> None:
    with refuses(BadImage, f"{columns}x6", "column", size=seen):
        find_board(picture(STEREO / f"{name}.jpg"), board_target(TargetKind.CHECKERBOARD, columns, 6, 0.025))


@needs_dots
def test_all_dots_are_found_from_the_big_one_on() -> None:
    views = [find_board(picture(DOTS / f"{n}.png"), SHEET, source=f"{n}.png") for n in range(15)]
    assert [len(view) for view in views] == [100] * 15
    found = calibrate_camera(views, SHEET, BoardOptions(reject=False))
    assert found.n_used == 15
    assert found.rms_px < 0.187  # OpenCV 4.14, all points
    assert calibrate_camera(views, SHEET).rms_px < 0.18
    # the sheet lay on the table, lettering upright: its origin, the big dot, is low on the left of most images
    first = np.array([view.uv_px[view.index == 0][0] for view in views])
    middle = np.array([view.uv_px.mean(0) for view in views])
    assert (first[:, 1] > middle[:, 1]).all()


@needs_stereo
def test_a_miscounted_board_is_refused_with_the_size_that_most_images_show(tmp_path: Path) -> None:
    with refuses(Inconsistent, "9x6", "6 images") as refusal:
        calibrate_images(str(STEREO / "left0[1-6].jpg"), "checkerboard:8x6:0.025", out=tmp_path / "c.yaml")
    assert "board checkerboard:9x6:0.025" in refusal.value.cure
    assert not list(tmp_path.iterdir())
