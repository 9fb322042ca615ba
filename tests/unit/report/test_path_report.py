"""The page of a checked path: what is wrong stands in it, in the picture and by the row's number."""

import base64
import gzip
import json
import re

import numpy as np
from scipy.spatial.transform import RigidTransform

from armsight.control.guard import Box, Limits
from armsight.control.paths import check_path
from armsight.kinematics import pose, preset
from armsight.records import TaughtPath
from armsight.report.path_report import path_report

ARM, HOME = preset("irb120"), np.array([0.1, 0.2, 0.1, 0.2, 0.9, 0.3])


def line(length=0.1, rows=21):
    T = np.repeat(pose(ARM, HOME).as_matrix()[None], rows, axis=0)
    T[:, 1, 3] += np.linspace(0, length, rows)
    return TaughtPath.of_poses(RigidTransform.from_matrix(T))


def figures_of(text):
    return json.loads(gzip.decompress(base64.b64decode(re.search(r'id="figures">(.*?)</script>', text)[1])))


def page_of(path, limits=None):
    limits = Limits() if limits is None else limits
    text = path_report(path, ARM, limits, check_path(path, ARM, limits, start=HOME), name="<seam>")
    figures = figures_of(text)
    return text, [{trace.get("name"): trace for trace in figure["data"]} for figure in figures]


def test_a_good_path_is_green_all_along():
    text, (around, alone, place, speed) = page_of(line())
    assert "can be run" in text and "Rows in trouble" not in text and "&lt;seam&gt;" in text
    xyz = np.array([[*around["no trouble"][axis]] for axis in "xyz"]).T
    assert np.allclose(xyz, 1e3 * line().xyz_m, atol=1e-4)
    assert set(alone) == {"no trouble", "rows"} and alone["rows"]["text"] == ["start", "end"]
    assert {"j1", "j6"} <= set(place) and max(speed["j1"]["y"]) < 1.0


def test_a_fence_in_the_way_is_drawn_and_its_rows_are_named():
    tip = line().xyz_m[0]
    fence = Box(lower_m=np.add(tip, [-0.1, 0.04, -0.1]), upper_m=np.add(tip, [0.1, 0.06, 0.1]), name="fence")
    text, (around, alone, *_) = page_of(line(), Limits(forbidden=(fence,)))
    # 5 mm a row, and a margin of 5 mm: from between rows 6 and 7 (0.03, 0.035) to 0.065 m, row 13; flange beside
    assert "cannot be run" in text and "forbidden box" in text
    coloured = alone["forbidden box"]
    assert len(coloured["text"]) >= 6 and any("row 8" in told for told in coloured["text"])
    named = [label for label in alone["rows"]["text"] if label.startswith("row ")]
    assert named and f"rows {named[0].split()[1]} to" in text
    y = [value for value in around["fence"]["y"] if value is not None]
    assert abs(min(y) - 1e3 * fence.lower_m[1]) < 1e-3
