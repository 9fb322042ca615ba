"""The key `noise` of camera.yaml and rig.yaml."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import Field

from armsight.records import LinearNoise, NoiseModel
from armsight.records.noise import LAGS
from armsight.store.schema import Count, Finite, Origin, Strict, write_document
from armsight.store.yamls import read_yaml

OfLags = Annotated[list[Finite], Field(min_length=len(LAGS), max_length=len(LAGS))]
Levels = Annotated[list[Finite], Field(min_length=1, max_length=256)]


class CorrelationModel(Strict):
    """Correlation with the neighbours at 1 and 2 px along x and along y, and at 1 px along the diagonals."""

    x: OfLags
    y: OfLags
    diagonal: Finite = 0.0
    std_x: OfLags = [0.0] * len(LAGS)
    std_y: OfLags = [0.0] * len(LAGS)
    std_diagonal: Finite = 0.0


class LinearModel(Strict):
    """The line of a linear camera."""

    read_noise_levels: Finite
    gain_levels: Finite


class NoiseKey(Strict):
    """A camera's noise: variance and its standard deviation in grey levels squared at some grey levels."""

    levels: Levels
    variance_levels2: Levels
    std_levels2: Levels
    correlation: CorrelationModel
    n_frames: Count
    linear: LinearModel | None = None

    def noise(self) -> NoiseModel:
        """Return the record; Inconsistent where no noise can be like this."""
        near = self.correlation
        return NoiseModel(
            levels=np.array(self.levels),
            variance_levels2=np.array(self.variance_levels2),
            std_levels2=np.array(self.std_levels2),
            correlation=np.array([near.x, near.y]),
            correlation_std=np.array([near.std_x, near.std_y]),
            diagonal=near.diagonal,
            diagonal_std=near.std_diagonal,
            n_frames=self.n_frames,
            linear=None if self.linear is None else LinearNoise(**self.linear.model_dump()),
        )


def noise_mapping(noise: NoiseModel) -> dict[str, Any]:
    """Return a camera's noise as files hold it."""
    linear = noise.linear
    content: dict[str, Any] = {
        "levels": noise.levels.tolist(),
        "variance_levels2": noise.variance_levels2.tolist(),
        "std_levels2": noise.std_levels2.tolist(),
        "correlation": {
            "x": noise.correlation[0].tolist(),
            "y": noise.correlation[1].tolist(),
            "diagonal": noise.diagonal,
            "std_x": noise.correlation_std[0].tolist(),
            "std_y": noise.correlation_std[1].tolist(),
            "std_diagonal": noise.diagonal_std,
        },
        "n_frames": noise.n_frames,
    }
    if linear is not None:
        content["linear"] = {"read_noise_levels": linear.read_noise_levels, "gain_levels": linear.gain_levels}
    return content


def add_noise(path: Path, noise: Mapping[str, NoiseModel], *, inputs: Sequence[Path] = ()) -> None:
    """Write the noise into a camera.yaml (side "") or a rig.yaml (sides left, right); all else in it stays.

    The file must have been read before, as what it is: nothing is checked here.
    """
    content = read_yaml(path)
    for side, one in noise.items():
        place = content["cameras"][side] if side else content
        place["noise"] = noise_mapping(one)
    origin = {name: content.pop(name, None) for name in ("format", "version", *Origin.model_fields)}
    write_document(path, str(origin["format"]), content, inputs, earlier=origin["inputs"] or ())
