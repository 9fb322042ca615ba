"""What a result comes to, in the same words on the terminal, the page, the report, in JSON and in Python."""

from __future__ import annotations

from typing import Annotated

from armsight.fields import Doc
from armsight.records.output import Output, output

MEANING = "What it comes to: the words of the report."
"""Of the key `verdict_` of a result; results of versions before it lack it."""
MANY_REJECTED = 0.1
"""Share of the rows left out beyond which those that agree are only a part of what happened."""


@output
class Verdict(Output):
    """Whether a result may be relied on, why, and what to do next."""

    level: Annotated[str, Doc("good, care, bad or refused.")]
    headline: Annotated[str, Doc("In a word or two.")]
    reasons: Annotated[list[str], Doc("Why, in sentences.")]
    next: Annotated[list[str], Doc("What to do.")]
