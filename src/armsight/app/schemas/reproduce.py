"""reproduce."""

from __future__ import annotations

Values = dict[str, float | None]
