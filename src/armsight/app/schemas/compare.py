"""What `armsight compare` tells programs."""

from __future__ import annotations

from pydantic import Field

from armsight.app.schemas.base import Output, absent


class ComparedParameter(Output):
    """One number of two results, in the unit given beside it."""

    name: str = Field(description="Its name.")
    unit: str = Field(description="m, rad, px, m/s, s, or 1 for a plain number.")
    a: float = Field(description="In A.", json_schema_extra={"unit": "as unit says"})
    b: float = Field(description="In B.", json_schema_extra={"unit": "as unit says"})
    difference: float = Field(description="B less A.", json_schema_extra={"unit": "as unit says"})
    std: float | None = Field(
        description="Standard deviation of the difference, A and B independent; null where neither tells its own.",
        json_schema_extra={"unit": "as unit says"},
    )
    sigmas: float | None = Field(description="Difference over std; null where there is no std.")


class ComparedEffect(Output):
    """What the differences come to where the result is used."""

    name: str = Field(description="What it is.")
    value: float = Field(description="How much.", json_schema_extra={"unit": "as unit says"})
    unit: str = Field(description="m, rad, px, or 1 for a share.")


class CompareOutput(Output):
    """armsight compare."""

    kind: str = Field(description="camera, rig, handeye, arm, measure or verify.")
    a: str = Field(description="The first result.")
    b: str = Field(description="The second result.")
    agree: bool | None = Field(
        description="Whether they agree within their uncertainty; null where too little is known of it."
    )
    verdict: str = Field(description="The same in a sentence.")
    p: float | None = Field(
        description="How often chance alone would part two such results as far; null where it cannot be told."
    )
    parameters: list[ComparedParameter] = Field(description="Number by number.")
    effects: list[ComparedEffect] = Field(description="What the differences come to.")
    n: int | None = Field(None, exclude_if=absent, description="Poses that stand in both; of measurements.")
    same_rig: bool | None = Field(
        None, exclude_if=absent, description="Whether both were measured with one rig; left out where not recorded."
    )
    same_target: bool | None = Field(
        None, exclude_if=absent, description="Whether both were measured with one target; left out where not recorded."
    )
    notes: list[str] = Field(description="What to know.")
    report: str | None = Field(None, exclude_if=absent, description="The report; with -o.")
