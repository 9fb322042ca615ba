"""What `armsight compare` tells programs."""

from __future__ import annotations

from typing import Annotated

from armsight.records.fields import Doc
from armsight.records.output import Output, output


@output
class ComparedParameter(Output):
    """One number of two results, in the unit given beside it."""

    name: Annotated[str, Doc("Its name.")]
    unit: Annotated[str, Doc("m, rad, px, m/s, s, or 1 for a plain number.")]
    a: Annotated[float, Doc("In A.", unit="as unit says")]
    b: Annotated[float, Doc("In B.", unit="as unit says")]
    difference: Annotated[float, Doc("B less A.", unit="as unit says")]
    std: Annotated[
        float | None,
        Doc(
            "Standard deviation of the difference, A and B independent; null where neither tells its own.",
            unit="as unit says",
        ),
    ]
    sigmas: Annotated[float | None, Doc("Difference over std; null where there is no std.")]


@output
class ComparedEffect(Output):
    """What the differences come to where the result is used."""

    name: Annotated[str, Doc("What it is.")]
    value: Annotated[float, Doc("How much.", unit="as unit says")]
    unit: Annotated[str, Doc("m, rad, px, or 1 for a share.")]


@output
class CompareOutput(Output):
    """armsight compare."""

    kind: Annotated[str, Doc("camera, rig, handeye, arm, measure or verify.")]
    a: Annotated[str, Doc("The first result.")]
    b: Annotated[str, Doc("The second result.")]
    agree: Annotated[
        bool | None, Doc("Whether they agree within their uncertainty; null where too little is known of it.")
    ]
    verdict: Annotated[str, Doc("The same in a sentence.")]
    p: Annotated[
        float | None, Doc("How often chance alone would part two such results as far; null where it cannot be told.")
    ]
    parameters: Annotated[list[ComparedParameter], Doc("Number by number.")]
    effects: Annotated[list[ComparedEffect], Doc("What the differences come to.")]
    n: Annotated[int | None, Doc("Poses that stand in both; of measurements.")] = None
    same_rig: Annotated[bool | None, Doc("Whether both were measured with one rig; left out where not recorded.")] = (
        None
    )
    same_target: Annotated[
        bool | None, Doc("Whether both were measured with one target; left out where not recorded.")
    ] = None
    notes: Annotated[list[str], Doc("What to know.")]
    report: Annotated[str | None, Doc("The report; with -o.")] = None
