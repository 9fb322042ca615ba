"""Three frames of the simulated cell with a hand, in the dark: made by the first test that asks, and kept."""

from __future__ import annotations

from functools import cache
from typing import Any

import armsight


@cache
def hand_cell() -> Any:
    return armsight.simulate("hand-cell", frames=3, room="dark")


@cache
def pictures(side: str) -> list[Any]:
    return [getattr(frame, side) for frame in hand_cell()]
