"""Strangers' ChArUco boards of the layout before OpenCV 4.6, and boards whose counts are exchanged."""

import numpy as np
import pytest

from armsight.errors import DataRefused
from armsight.ops.calibrate_cameras import calibrate_stereo
from refusals import names_it
from reports import case


def calibrated(board):
    return calibrate_stereo(case("cameras-14") / "left", case("cameras-14") / "right", board)


def test_the_old_layout_is_read():
    done = calibrated("charuco:8x6:0.025:0.018:DICT_4X4_50")
    assert 1e3 * np.linalg.norm(done.rig.T_rig_right.translation) == pytest.approx(120.07, abs=0.1)


def test_counts_that_are_exchanged_are_named_as_they_are():
    with pytest.raises(DataRefused) as caught:
        calibrated("charuco:6x8:0.025:0.018:DICT_4X4_50")
    assert names_it(caught.value, "board charuco:8x6:0.025:0.018:DICT_4X4_50", "squares")  # as the test above gives
