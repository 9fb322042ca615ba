"""How results show themselves: one screen of text, or a table in a notebook."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from html import escape
from typing import Any

Row = tuple[str, str]

FEW = 6
"""Values of a list that are shown; of a longer one their number is."""


def as_text(title: str, rows: Sequence[Row]) -> str:
    """Return title and rows as lines, the values below each other."""
    width = max((len(name) for name, _ in rows), default=0)
    return "\n".join([title, *(f"  {name:<{width}}  {value}".rstrip() for name, value in rows)])


def as_html(title: str, rows: Sequence[Row]) -> str:
    """Return title and rows as a table."""
    cells = "".join(f"<tr><th>{escape(name)}</th><td>{escape(value)}</td></tr>" for name, value in rows)
    return f"<table><caption>{escape(title)}</caption>{cells}</table>"


def flat_rows(content: Mapping[str, Any], prefix: str = "") -> Iterator[Row]:
    """Yield each figure of a nested dictionary under its dotted name, in SI units as the name says."""
    for name, value in content.items():
        if isinstance(value, Mapping):
            yield from flat_rows(value, f"{prefix}{name}.")
        elif isinstance(value, list) and (len(value) > FEW or any(isinstance(one, list | dict) for one in value)):
            yield f"{prefix}{name}", f"({len(value)})"
        elif value not in (None, "", []):
            yield f"{prefix}{name}", ", ".join(map(_shown, value)) if isinstance(value, list) else _shown(value)


def _shown(value: object) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
