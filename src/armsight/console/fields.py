"""What is typed into a page's fields: what cannot be meant is refused by the field's own name.

A browser may send what it likes in a field's place, so its type is checked here as well.
"""

from __future__ import annotations

import math
import os
from pathlib import Path
from typing import Any

from nicegui import ui

from armsight.console import texts
from armsight.errors import UsageError

LARGEST = 1e6
"""Of any figure of a page, in its unit: mm, deg, mm/s, a count."""
LONGEST = 1000
"""Characters of a text: a source of frames is a path, of which systems take 4096 bytes."""


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
        figure = math.nan if isinstance(value, bool) else float(value)
    except (TypeError, ValueError, OverflowError):
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


def text(field: Any) -> str:
    """Return a field's text without blanks about it, empty where it holds none.

    Raises UsageError for what is no text, is too long, or has signs in it that cannot be seen.
    """
    value = "" if field.value is None else field.value
    if not isinstance(value, str) or len(value) > LONGEST or not value.isprintable():
        raise _refused(texts.FIELD_NO_TEXT.format(field=field.props.get("label", "")))
    return value.strip()


def file_name(field: Any, kept: str = "") -> str:
    """Return the name of a file in the cell's folder, or below it; kept: what stands there already stays.

    Raises UsageError for a name that leads out of it, and as text.
    """
    name = text(field)
    path = Path(os.path.normpath(name))  # without following links, of which the folder may hold some
    if name != kept and (path.is_absolute() or os.pardir in path.parts):
        raise _refused(texts.FIELD_OUTSIDE.format(field=field.props.get("label", ""), value=name[:40]))
    return name


def ticked(box: Any) -> bool:
    """Return whether a box is ticked: true alone is."""
    return box.value is True


def _refused(cause: str) -> UsageError:
    return UsageError(cause, consequence=texts.FIELD_CONSEQUENCE, cure=texts.FIELD_CURE)
