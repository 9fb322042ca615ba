"""Offset, tilt, reversal and joining of paths, against numbers worked out by hand."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import RigidTransform, Rotation

from armsight.control.paths import joined, offset_along_tool, reversed_path, tilted
from armsight.errors import Inconsistent
from armsight.records import TaughtPath

DOWN = Rotation.from_rotvec([math.pi, 0.0, 0.0])
TAGS = ("", "weld_on", "weld_off")


def path_through(xyz, rotation=DOWN):
    turns = Rotation.from_quat(np.tile(rotation.as_quat(), (len(xyz), 1)))
    path = TaughtPath.of_poses(RigidTransform.from_components(np.asarray(xyz, float), turns))
    return replace(path, tags=TAGS[: len(xyz)])


ALONG_X = path_through([[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0]])


def test_offset_goes_along_the_tool():
    made = offset_along_tool(ALONG_X, -0.01)  # the tool points down: back is up
    assert np.allclose(made.xyz_m, np.add(ALONG_X.xyz_m, [0, 0, 0.01])) and made.tags == TAGS


def test_a_travel_angle_points_the_tool_ahead_and_keeps_the_tip():
    made = tilted(ALONG_X, travel_rad=math.radians(15))
    assert np.allclose(made.T_world_tip[:, :3, 2], [math.sin(math.radians(15)), 0, -math.cos(math.radians(15))])
    assert np.array_equal(made.xyz_m, ALONG_X.xyz_m) and made.tags == TAGS


def test_a_work_angle_turns_about_the_path():
    made = tilted(ALONG_X, work_rad=math.radians(30))  # about +x: -z goes to +y
    assert np.allclose(made.T_world_tip[:, :3, 2], [0, 0.5, -math.sqrt(0.75)])


def test_reversal_welds_the_same_stretch_at_the_same_speed():
    path = replace(ALONG_X, speed_m_s=np.array([0.1, 0.02, 0.1]), t_s=np.array([0.0, 1.0, 2.0]))
    made = reversed_path(path)
    assert made.tags == ("weld_on", "weld_off", "")
    assert made.speed_m_s[:2].tolist() == [0.02, 0.1]  # the stretch from 0.1 to 0.2 m is still passed at 0.02 m/s
    assert np.array_equal(made.xyz_m, path.xyz_m[::-1]) and np.isnan(made.t_s).all()


def test_joining_leaves_the_double_row_out():
    second = replace(path_through([[0.2, 0, 0], [0.2, 0.1, 0]]), tags=("", "end"))
    made = joined(ALONG_X, second)
    assert made.xyz_m.tolist() == [[0, 0, 0], [0.1, 0, 0], [0.2, 0, 0], [0.2, 0.1, 0]]
    assert made.tags == (*TAGS, "end")


@pytest.mark.parametrize(
    "second",
    [
        path_through([[0.202, 0, 0], [0.3, 0, 0]]),
        path_through([[0.2, 0, 0], [0.3, 0, 0]], Rotation.identity()),
        replace(path_through([[0.2, 0, 0], [0.3, 0, 0]]), parent="base"),
        replace(path_through([[0.2, 0, 0], [0.3, 0, 0]]), tags=("weld_on", "")),
    ],
    ids=["apart", "turned", "other frame", "two tags"],
)
def test_ends_that_do_not_meet_are_refused(second):
    with pytest.raises(Inconsistent):
        joined(ALONG_X, second)
