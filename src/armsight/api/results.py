"""How results show themselves: one screen of text, a table in a notebook, a dictionary, columns."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

from armsight.records import ByValue
from armsight.records.output import Row as Row
from armsight.records.output import as_html, as_text
from armsight.records.output import pose_rows as pose_rows

if TYPE_CHECKING:
    from armsight.records.result_parts import Verdict


class Result(ByValue):
    """A result that prints itself. Subclasses give `title`, `rows` and `to_dict`."""

    __slots__ = ()

    @property
    def title(self) -> str:
        """What it is, in a few words."""
        raise NotImplementedError

    def rows(self) -> Sequence[Row]:
        """Return (name, value with unit and standard deviation) as people read them."""
        raise NotImplementedError

    @property
    def verdict_(self) -> Verdict | None:
        """What it comes to, in the words of terminal, page and report; None of what gives no verdict."""
        found: Verdict | None = getattr(getattr(self, "detail", None), "verdict_", None)
        return found

    def to_dict(self) -> dict[str, Any]:
        """Return plain numbers, lists and texts in SI units, as the command line's --json gives them."""
        raise NotImplementedError

    def __repr__(self) -> str:
        return as_text(self.title, self.rows())

    def _repr_html_(self) -> str:
        return as_html(self.title, self.rows())
