"""No limit is passed behind a link that loses, delays and bunches packets; and what keeps it so can be seen to fail."""

from __future__ import annotations

import pytest
from tests.truth.lossy_links import SPEED_TOLERANCE, Found, history

KINDS = ("alter", "egm", "rsi", "rtde")
SEEDS = {"alter": (6, 8), "egm": (4, 10), "rsi": (3, 4), "rtde": (5, 7)}
"""With losses, late packets and both, so that each rule is needed in one of them."""


def run(kind: str, fault: str = "") -> Found:
    found = Found()
    for seed in SEEDS[kind]:
        history(kind, seed, found, cycles=200, fault=fault)
        if fault and found.too_fast:
            break
    return found


@pytest.mark.parametrize("kind", KINDS)
def test_no_speed_range_or_wall_is_passed(kind: str) -> None:
    found = run(kind)
    assert found.moved > 100
    assert max(found.joint_ratio, found.tool_ratio) <= 1.0 + SPEED_TOLERANCE
    assert found.beyond == 0
