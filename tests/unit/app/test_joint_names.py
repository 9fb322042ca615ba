"""Joints by the names that drivers publish: their own order, alphabetical, prefixed, with a gripper's beside them."""

from __future__ import annotations

import pytest

from armsight.errors import Inconsistent
from armsight.ops.sources.bags import UNIVERSAL_ROBOTS, columns_of
from refusals import refuses

J6 = [f"j{i}" for i in range(1, 7)]


@pytest.mark.parametrize(
    ("names", "columns"),
    [
        (sorted(UNIVERSAL_ROBOTS), [2, 1, 0, 3, 4, 5]),
        ([f"left_{name}" for name in sorted(UNIVERSAL_ROBOTS)] + ["finger_joint"], [2, 1, 0, 3, 4, 5]),
        ([f"joint_{i}" for i in (3, 1, 2, 6, 5, 4)], [1, 2, 0, 5, 4, 3]),
        ([f"joint_a{i}" for i in range(1, 7)], [0, 1, 2, 3, 4, 5]),
        ([f"arm/axis{i}_motor" for i in range(6)], [0, 1, 2, 3, 4, 5]),
        (["panda_finger_joint1", *(f"panda_joint{i}" for i in range(1, 7)), "panda_finger_joint2"], [1, 2, 3, 4, 5, 6]),
        (["j6", "j5", "j4", "j3", "j2", "j1"], [5, 4, 3, 2, 1, 0]),
    ],
)
def test_the_order_from_the_base_on(names, columns):
    assert columns_of(J6, names) == columns


@pytest.mark.parametrize(
    "names",
    [
        [f"joint_{i}" for i in range(1, 6)],
        [*(f"left_joint_{i}" for i in range(1, 7)), *(f"right_joint_{i}" for i in range(1, 7))],
        ["base", "shoulder", "elbow", "roll", "pitch", "yaw"],
    ],
)
def test_what_does_not_tell_is_refused(names):
    with refuses(Inconsistent, "j1", names[0]):
        columns_of(J6, names)


def test_an_arm_with_words_for_names_is_not_numbered():
    with refuses(Inconsistent, "elbow"):
        columns_of(["pan", "lift", "elbow"], ["joint_1", "joint_2", "joint_3"])
    assert columns_of(["pan", "lift"], ["lift", "pan"]) == [1, 0]
