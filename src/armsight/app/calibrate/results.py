"""What the calibrations of cameras and mirror rigs come to, and the noise of a camera."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Annotated

from armsight.calibrate.camera_noise.photon_transfer import NoiseCalibration
from armsight.fields import Doc
from armsight.records import NoiseModel
from armsight.records.output import Output, output
from armsight.shown import WRITTEN, Shown


@output
class NoiseOutput(Output):
    """armsight calibrate camera --noise, without a board."""

    noise: Annotated[
        NoiseCalibration | NoiseModel,
        Doc("The camera's noise; the keys from n_given on of still frames, not of a file."),
    ]

    def summary(self) -> Iterator[Shown]:
        """Yield the noise."""
        yield from self.noise.summary()
        yield WRITTEN
