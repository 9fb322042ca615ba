"""The key `timing` of camera.yaml and rig.yaml."""

from __future__ import annotations

from typing import Any

import numpy as np
from pydantic import Field

from armsight.records import NamedCovariance
from armsight.records.timing import TIMING, CameraTiming
from armsight.store.schema import CovarianceModel, Finite, Strict, covariance_mapping


class TimingStdModel(Strict):
    """Standard deviations of a camera's timing, each by itself."""

    readout_s: Finite | None = Field(default=None, ge=0.0)
    exposure_s: Finite | None = Field(default=None, ge=0.0)
    delay_s: Finite | None = Field(default=None, ge=0.0)
    drift_ppm: Finite | None = Field(default=None, ge=0.0)
    jitter_s: Finite | None = Field(default=None, ge=0.0)


class TimingKey(Strict):
    """A camera's timing; times in s. covariance counts before std."""

    readout_s: Finite = 0.0
    exposure_s: Finite = 0.0
    delay_s: Finite = 0.0
    drift_ppm: Finite = 0.0
    jitter_s: Finite = 0.0
    std: TimingStdModel | None = None
    covariance: CovarianceModel | None = None

    def timing(self) -> CameraTiming:
        """Return the record; Inconsistent where no camera can be like this."""
        return CameraTiming(**{name: getattr(self, name) for name in TIMING}, covariance=self._covariance())

    def _covariance(self) -> NamedCovariance | None:
        if self.covariance is not None:
            return self.covariance.covariance()
        given = {} if self.std is None else self.std.model_dump(exclude_none=True)
        return NamedCovariance(names=tuple(given), matrix=np.diag(np.square([*given.values()]))) if given else None


def timing_mapping(timing: CameraTiming) -> dict[str, Any]:
    """Return a camera's timing as files hold it."""
    content: dict[str, Any] = {name: getattr(timing, name) for name in TIMING}
    if timing.covariance is not None:
        content["std"] = timing.std
        content["covariance"] = covariance_mapping(timing.covariance)
    return content
