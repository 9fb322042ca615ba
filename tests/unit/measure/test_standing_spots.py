"""Spots that stand still in one camera's frames: lamps and reflections, each frame counted once."""

import numpy as np

from armsight.measure.poses.beacon import without_standing
from armsight.records import Spots


def frames_of(places: list[list[tuple[float, float]]]) -> list[Spots]:
    return [Spots.of_centres(np.array(each, float).reshape(-1, 2), np.eye(2)) for each in places]


def test_a_lamp_is_left_out_and_what_moves_stays() -> None:
    made = frames_of([[(100.0, 50.0 + 0.1 * (k % 3)), (10.0 * k, 5.0)] for k in range(10)])
    assert [spots.uv_px.tolist() for spots in without_standing(made)] == [[[10.0 * k, 5.0]] for k in range(10)]


def test_a_frame_counts_once_at_a_place() -> None:
    # two spots at one place in four of ten frames are eight spots, and yet in fewer than six frames
    twice = [(100.0, 50.0), (100.4, 50.0)]
    made = frames_of([[*(twice if k < 4 else []), (10.0 * k, 5.0)] for k in range(10)])
    assert [len(spots) for spots in without_standing(made)] == [3] * 4 + [1] * 6
