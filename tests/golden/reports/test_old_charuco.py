"""Strangers' ChArUco boards of the layout before OpenCV 4.6, and boards whose counts are exchanged."""

import numpy as np
import pytest

from armsight.app.calibrate.cameras import calibrate_stereo
from armsight.app.requests.calibrate_cameras import StereoJob
from armsight.errors import DataRefused
from refusals import names_it
from reports import case


def job(board, tmp_path):
    folder = case("cameras-14")
    return StereoJob(left=str(folder / "left"), right=str(folder / "right"), board=board, out=tmp_path / "rig.yaml")


def test_the_old_layout_is_read(tmp_path):
    done = calibrate_stereo(job("charuco:8x6:0.025:0.018:DICT_4X4_50", tmp_path))
    assert 1e3 * np.linalg.norm(done.rig.T_rig_right.translation) == pytest.approx(120.07, abs=0.1)


def test_counts_that_are_exchanged_are_named_as_they_are(tmp_path):
    with pytest.raises(DataRefused) as caught:
        calibrate_stereo(job("charuco:6x8:0.025:0.018:DICT_4X4_50", tmp_path))
    assert names_it(caught.value, "--board charuco:8x6:0.025:0.018:DICT_4X4_50", "squares")  # as the test above gives
