"""Small results that several results hold."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np
from numpy.typing import NDArray

from armsight.fields import Doc
from armsight.records.checks import frozen_array
from armsight.records.output import Output, figure, output


@output
class Refusal(Output):
    """Why a command gave no result."""

    kind: Annotated[str, Doc("The class of the error, one of `armsight.errors`.")]
    cause: Annotated[str, Doc("What is wrong.")]
    consequence: Annotated[str, Doc("What was not done; may be empty.")]
    cure: Annotated[str, Doc("What the operator can do; may be empty.")]
    exit_code: Annotated[int, Doc("The exit code of the command: 2 usage, 3 data, 4 device, 130 stopped, 1 else.")]


@output
class RefusalOutput(Output):
    """Any command, where it fails."""

    error: Annotated[Refusal, Doc("Why there is no result.")]


class BothSeconds(NamedTuple):
    """A time of each camera."""

    left: Annotated[float, Doc("Of the left camera, s.", unit="s")]
    right: Annotated[float, Doc("Of the right camera, s.", unit="s")]


class BothCounts(NamedTuple):
    """A number of frames of each camera."""

    left: Annotated[int, Doc("Of the left camera.")]
    right: Annotated[int, Doc("Of the right camera.")]


class BothPixels(NamedTuple):
    """A distance in the image of each camera."""

    left: Annotated[float, Doc("Of the left camera, px.", unit="px")]
    right: Annotated[float, Doc("Of the right camera, px.", unit="px")]


@output
class PointStd(Output):
    """Standard deviations of a point."""

    x_m: Annotated[float, Doc("Of x, m.")]
    y_m: Annotated[float, Doc("Of y, m.")]
    z_m: Annotated[float, Doc("Of z, m.")]

    @property
    def translation_m(self) -> tuple[float, float, float]:
        """Those of x, y and z in m."""
        return self.x_m, self.y_m, self.z_m


@output
class PoseStd(PointStd):
    """Standard deviations of a pose: of its position, and of a small rotation about each axis."""

    rx_rad: Annotated[float, Doc("Of the rotation about x, rad.")]
    ry_rad: Annotated[float, Doc("Of the rotation about y, rad.")]
    rz_rad: Annotated[float, Doc("Of the rotation about z, rad.")]

    @property
    def rotation_rad(self) -> tuple[float, float, float]:
        """Those about x, y and z in rad."""
        return self.rx_rad, self.ry_rad, self.rz_rad


class RejectedFile(NamedTuple):
    """An image that was left out."""

    file: Annotated[str, Doc("The image's file or source.")]
    why: Annotated[str, Doc("Why it was left out, in words.")]


@output
class RejectedRow(Output):
    """A row that was left out."""

    row: Annotated[int, Doc("The row of the input table, from 1.")]
    why: Annotated[str, Doc("Why it was left out, in words.")]


@output
class Difference(Output):
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

    @figure("Difference over std; null where there is no std.")
    def sigmas(self) -> float | None:
        return None if self.std is None else self.difference / self.std

    def in_unit(self, unit: str, size: float) -> Difference:
        """Return it in another unit; size: of that one, in the unit it is in."""
        a, b, difference = (value / size for value in (self.a, self.b, self.difference))
        std = None if self.std is None else self.std / size
        return Difference(name=self.name, unit=unit, a=a, b=b, difference=difference, std=std)


@output
class Skew(Output):
    """How far apart in time the frames of live pairs were: right minus left."""

    mean_s: Annotated[float, Doc("Mean, s.")]
    largest_s: Annotated[float, Doc("Largest, s.")]
    n_pairs: int
    n_dropped: Annotated[int, Doc("Frames without a partner.")]


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


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NamedCovariance:
    """Covariance (n, n) of the named parameters, in the parameters' own units squared."""

    names: tuple[str, ...]
    matrix: NDArray[np.float64]

    def __post_init__(self) -> None:
        n = len(self.names)
        object.__setattr__(self, "names", tuple(self.names))
        object.__setattr__(self, "matrix", frozen_array("covariance", self.matrix, (n, n)))

    def std(self) -> dict[str, float]:
        """Return the standard deviation by name."""
        return dict(zip(self.names, np.sqrt(np.diag(self.matrix)).tolist(), strict=True))

    def block(self, names: tuple[str, ...]) -> NDArray[np.float64]:
        """Return the covariance of the given names in their order; KeyError for an unknown one."""
        index = [self._position(name) for name in names]
        return np.asarray(self.matrix[np.ix_(index, index)])

    def _position(self, name: str) -> int:
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(f"no covariance for {name!r}; there is one for {', '.join(self.names)}") from None
