"""Figures typed into fields: what is none is refused by the field's name, and never taken for zero."""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any

import pytest

from armsight.console.numbers import number, whole_number
from armsight.errors import UsageError


def field(value: object, low: float = -math.inf, high: float = math.inf) -> Any:
    return SimpleNamespace(value=value, min=low, max=high, props={"label": "From (deg)"})


@pytest.mark.parametrize("value", [None, "", "ten", "1,5", math.nan, math.inf, 1e9, -1e9, "1e999"])
def test_what_is_no_figure_is_refused_by_name(value: object) -> None:
    with pytest.raises(UsageError, match=r"Joint 3 From \(deg\)"):
        number(field(value), of="Joint 3")


def test_an_empty_field_is_zero_only_where_that_is_meant() -> None:
    assert number(field(None), empty=0.0) == 0.0
    assert number(field(-12.5)) == -12.5


def test_limits_of_a_field_hold_before_it_is_left() -> None:
    assert whole_number(field(10, 4, 100)) == 10
    for value in (3, 101, -10):
        with pytest.raises(UsageError, match="it takes 4 to 100"):
            whole_number(field(value, 4, 100))
    with pytest.raises(UsageError, match="whole"):
        whole_number(field(10.5, 4, 100))
