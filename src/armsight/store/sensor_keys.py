"""The keys noise and timing of camera.yaml and rig.yaml."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from armsight.errors import Inconsistent
from armsight.records import CameraTiming, NamedCovariance, NoiseModel
from armsight.records.camera import TIMING
from armsight.store.codec import (
    Finite,
    mapping,
    record_of,
    structure,
)


class TimingKey(structure(CameraTiming)):  # type: ignore[misc]  # made of the record's fields
    """A camera's timing; times in s. std: standard deviations, each by itself; covariance counts before it."""

    record = CameraTiming
    std: dict[str, Finite | None] | None = None

    def timing(self) -> CameraTiming:
        """Return the record; Inconsistent where no camera can be like this."""
        timing: CameraTiming = record_of(self)
        given = {name: value for name, value in (self.std or {}).items() if value is not None}
        unknown = [name for name in self.std or () if name not in TIMING]
        if unknown or any(value < 0.0 for value in given.values()):
            raise Inconsistent(f"timing.std: of {', '.join(TIMING)}, none negative, not {self.std}")
        if timing.covariance is not None or not given:
            return timing
        covariance = NamedCovariance(names=tuple(given), matrix=np.diag(np.square([*given.values()])))
        return replace(timing, covariance=covariance)


def timing_mapping(timing: CameraTiming) -> dict[str, Any]:
    """Return a camera's timing as files hold it."""
    content = mapping(timing)
    return content if timing.covariance is None else content | {"std": timing.std}


NoiseKey = structure(NoiseModel)
