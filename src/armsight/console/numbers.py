"""Numbers typed into a page's fields: what is none, or cannot be meant, is refused by the field's own name."""

from __future__ import annotations

import math

from nicegui import ui

from armsight.console import texts
from armsight.errors import UsageError

LARGEST = 1e6
"""Of any figure of a page, in its unit: mm, deg, mm/s, a count."""


def number(field: ui.number, *, of: str = "", empty: float | None = None) -> float:
    """Return a field's number; empty: what an empty field means, None where it means nothing. of: whose field it is.

    Raises UsageError for what is no number, or not within the field's limits.
    """
    value = field.value
    name = " ".join(part for part in (of, str(field.props.get("label", ""))) if part)
    if value is None or value == "":
        if empty is None:
            raise _refused(texts.FIELD_EMPTY.format(field=name))
        return empty
    try:
        figure = float(value)
    except (TypeError, ValueError):
        raise _refused(texts.FIELD_NO_NUMBER.format(field=name, value=str(value)[:40])) from None
    low, high = max(float(field.min), -LARGEST), min(float(field.max), LARGEST)
    if not (math.isfinite(figure) and low <= figure <= high):
        raise _refused(texts.FIELD_BEYOND.format(field=name, value=figure, low=low, high=high))
    return figure


def whole_number(field: ui.number, *, of: str = "") -> int:
    """Return a field's whole number. Raises UsageError for another, and as number."""
    figure = number(field, of=of)
    if not figure.is_integer():
        raise _refused(texts.FIELD_NOT_WHOLE.format(field=str(field.props.get("label", "")), value=figure))
    return int(figure)


def _refused(cause: str) -> UsageError:
    return UsageError(cause, consequence=texts.FIELD_CONSEQUENCE, cure=texts.FIELD_CURE)
