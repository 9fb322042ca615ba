"""What is said where most images show a board of another size."""

from __future__ import annotations

import numpy as np
import pytest

from armsight.errors import Inconsistent
from armsight.ops.calibration.board_images import require_counts
from armsight.records import BoardView, NotSeen, TargetKind, board_target
from refusals import refuses

BOARD = board_target(TargetKind.CHECKERBOARD, 8, 6, 0.025)
TEXT = "checkerboard:8x6:0.025"
VIEW = BoardView(uv_px=np.zeros((1, 2)), index=np.array([0]), sigma_px=0.1, width=640, height=480, source="a.png")
OTHER = NotSeen("goes on beyond", size=(9, 6))


def test_more_images_of_another_size_are_refused_with_it() -> None:
    with refuses(Inconsistent, "9x6", "3 of 6") as refusal:
        require_counts([VIEW, VIEW, OTHER, OTHER, OTHER, NotSeen("dark")], BOARD, TEXT)
    assert "--board checkerboard:9x6:0.025" in refusal.value.cure


@pytest.mark.parametrize("others", [0, 1, 2])
def test_a_few_images_of_something_else_are_only_left_out(others: int) -> None:
    require_counts([VIEW, VIEW, NotSeen("dark"), *[OTHER] * others], BOARD, TEXT)
