"""Corrections that stand at the limit of what the nominal arm is believed to."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Annotated

import numpy as np
from numpy.typing import NDArray

from armsight.calibrate.arm.fit import Tolerance
from armsight.calibrate.arm.model import ArmModel
from armsight.records.fields import Doc
from armsight.records.output import Output, output

Array = NDArray[np.float64]

BINDS = 0.9
"""Share of its tolerance from which a correction stands at the limit. What is freed is known to half its tolerance, so
the tolerance holds a correction back by a fifth at most: one that is really beyond it is not missed."""


@output
class LimitReached(Output):
    """A correction as large as the nominal arm is believed to."""

    name: Annotated[str, Doc("The parameter.")]
    change: Annotated[float, Doc("Its change to the nominal arm, unit in the name.")]
    limit: Annotated[float, Doc("What the nominal arm is believed to, unit in the name.")]
    flag: Annotated[str | None, Doc("The option that raises it; null where there is none.")]

    @property
    def sentence(self) -> str:
        """What to tell the person, without a full stop."""
        factor, unit = (1e3, " mm") if self.name.endswith("_m") else (float(np.rad2deg(1.0)), " degrees")
        if self.flag is None:
            factor, unit = 1.0, ""
        said = f"{self.name} stands at its limit of {self.limit * factor:.3g}{unit} (it changed by "
        said += f"{self.change * factor:.3g}{unit}): "
        if self.name.endswith(".sag"):
            return said + "check the links' masses, or whether the tool is heavier than they say"
        if self.flag is None:
            return said + "check the gear ratio and the unit of the joint's readings"
        return said + f"raise {self.flag} if the arm may be so far off"


def limits_reached(model: ArmModel, p: Array, free: Sequence[str], tolerance: Tolerance) -> tuple[LimitReached, ...]:
    """Return the freed parameters whose change in p (P,) stands at the limit of its tolerance, or beyond."""
    found = []
    for name in free:
        change, limit = float(p[model.names.index(name)]), tolerance.of(name)
        if abs(change) >= BINDS * limit:
            found.append(LimitReached(name=name, change=change, limit=limit, flag=_flag(name)))
    return tuple(found)


def _flag(name: str) -> str | None:
    if name.endswith("_m"):
        return "--tolerance-mm"
    return "--tolerance-deg" if name.endswith("_rad") else None
