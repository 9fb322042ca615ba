"""One figure of the standard with its own standard deviation, or the reason why it is withheld; and all of them."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace
from math import exp, lgamma, pi, sqrt
from typing import Annotated

import numpy as np

from armsight.arrays import Array
from armsight.errors import UsageError
from armsight.fields import Doc
from armsight.records.output import Output, output
from armsight.units import displayed, figure_of, with_deviation

UNITS = {"m": "m", "rad": "rad", "m/s": "m_s", "s": "s", "1": "ratio"}
"""Units of figures, and how keys spell them."""


def unit_of(name: str) -> tuple[str, str]:
    """Return symbol and unit of a figure's or a joint error's key: ('RP', 'm') of 'RP_m'; without one the unit is 1."""
    for unit, tail in sorted(UNITS.items(), key=lambda one: -len(one[1])):
        if name.endswith(f"_{tail}"):
            return name.removesuffix(f"_{tail}"), unit
    return name, "1"


def symbol_of(name: str) -> tuple[str, str, float]:
    """Return a figure's symbol, the unit it is shown in, and that unit in SI."""
    symbol, unit = unit_of(name)
    shown, size = displayed(unit)
    return (symbol, "%", 0.01) if unit == "1" else (symbol, "°" if shown == "deg" else shown, size)


@output
class IsoFigure(Output):
    """A figure of ISO 9283.

    symbol, unit, place: what it is and where it holds; "" where it was read. value: by the standard's formula from the
    data as measured. std: from the repeats and from the measurement's covariance. corrected: what remains for the robot
    where the measurement's own scatter and the few repeats are taken out.
    """

    symbol: str = ""
    unit: str = "1"
    place: str = ""
    value: Annotated[float | None, Doc("The figure; null where withheld.")]
    n: Annotated[int, Doc("Visits that it rests on.")]
    wanted: Annotated[int, Doc("Visits that the norm asks for.")]
    withheld: Annotated[str | None, Doc("Why it is not given; null where it is.")]
    std: Annotated[float | None, Doc("Its standard deviation.")]
    corrected: Annotated[float | None, Doc("Without the measurement's own scatter; null where not known.")]
    corrected_std: Annotated[float | None, Doc("Its standard deviation.")]
    note: Annotated[str, Doc("What else to know of it; empty where nothing.")] = ""

    def __post_init__(self) -> None:
        if self.unit not in UNITS:
            raise UsageError(f"the unit {self.unit!r} is not known", cure=f"Use one of: {', '.join(UNITS)}")
        if self.symbol and (self.value is None) == (self.withheld is None):
            raise UsageError(f"{self.symbol} needs either a value or the reason why it is withheld")

    @property
    def name(self) -> str:
        """Symbol and unit as one key: RP_m, AP_a_rad, AV_ratio."""
        return f"{self.symbol}_{UNITS[self.unit]}"

    @property
    def key(self) -> str:
        """The name, with the pose behind it: 'RP_m P1'."""
        return f"{self.name} {self.place}".strip()

    def shown(self, factor: float) -> str:
        """Return it ± its standard deviation, where it has one, both to the same digit; a dash where withheld."""
        if self.value is None or not self.std:
            return figure_of(None if self.value is None else self.value / factor)
        return " ± ".join(with_deviation(self.value / factor, self.std / factor))


@dataclass(frozen=True, slots=True, kw_only=True)
class Figures:
    """All figures of a test, in the standard's order."""

    figures: tuple[IsoFigure, ...]

    def __iter__(self) -> Iterator[IsoFigure]:
        return iter(self.figures)

    def __len__(self) -> int:
        return len(self.figures)

    def __getitem__(self, key: str) -> IsoFigure:
        """Return the figure of a key: 'RP_m P1', or 'RP_m' for the worst of all poses; KeyError for another one."""
        for figure in self.figures:
            if figure.key == key:
                return figure
        worst = self.worst()
        if key in worst:
            return worst[key]
        raise KeyError(f"there is no figure {key!r}; there are {', '.join(figure.key for figure in self.figures)}")

    def worst(self) -> dict[str, IsoFigure]:
        """Return by name the figure of the place at which it is largest in size.

        Where it is withheld everywhere, that of the place with the most repeats, whose reason says most.
        """
        groups: dict[str, list[IsoFigure]] = {}
        for figure in self.figures:
            groups.setdefault(figure.name, []).append(figure)
        return {
            name: max(group, key=lambda one: (-1.0 if one.value is None else abs(one.value), one.n))
            for name, group in groups.items()
        }

    def results(self) -> dict[str, IsoFigure]:
        """Return the worst of each figure by name and, where there are several poses, each of them by key."""
        out = self.worst()
        several = {name for name in out if sum(figure.name == name for figure in self.figures) > 1}
        return out | {figure.key: figure for figure in self.figures if figure.name in several}


def withheld(figures: Iterable[tuple[str, str]], why: str, *, n: int, wanted: int, place: str = "") -> list[IsoFigure]:
    """Return the figures of the given (symbol, unit), all withheld for one reason."""
    none = dict.fromkeys(("value", "std", "corrected", "corrected_std"))
    return [
        IsoFigure(symbol=s, unit=u, n=n, wanted=wanted, place=place, withheld=why, note="", **none) for s, u in figures
    ]


def too_few(what: str, n: int, needed: int, wanted: int) -> str:
    """Return the reason for withholding a figure of too few repeats."""
    return f"{n} of the {needed} {what} that are needed at least; ISO 9283 asks for {wanted}"


def noted(figure: IsoFigure, note: str) -> IsoFigure:
    """Return the figure with a note added."""
    return replace(figure, note="; ".join(part for part in (figure.note, note) if part))


# How far a figure of few repeats may be off: distances of Gaussian points, and what the measurement adds to them.


NODES = 24
"""Gauss-Legendre nodes per angle: the moments are exact to 1e-4 even for points on a line or in a plane."""

SIGMAS = 3.0
"""The standard's factor before every standard deviation."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Radial:
    """Moments of the distance of a Gaussian point from its mean: mean and std in the point's unit, skewness, kurtosis.

    kurtosis: 3 for a normal distribution.
    """

    mean: float
    std: float
    skewness: float
    kurtosis: float

    @property
    def repeatability(self) -> float:
        """Mean and three standard deviations: RP of endless visits."""
        return self.mean + SIGMAS * self.std


@dataclass(frozen=True, slots=True, kw_only=True)
class Estimate:
    """A value with its standard deviation, and what remains without the measurement's own part."""

    value: float
    std: float
    corrected: float | None = None
    corrected_std: float | None = None


def radial(covariance: Array) -> Radial:
    """Return the moments of |x|, x normal with mean zero and covariance (3, 3); all zero for no spread.

    |x| is the product of a chi variable with 3 degrees of freedom and of sqrt(u' C u), u uniform on the sphere and
    independent of it, so that moments are products of known numbers and of integrals over an eighth of the sphere.
    """
    size = np.sort(np.maximum(np.linalg.eigvalsh(covariance), 0.0))  # the largest on the pole, where sqrt is smooth
    if size[-1] == 0.0:
        return Radial(mean=0.0, std=0.0, skewness=0.0, kurtosis=3.0)
    node, weight = np.polynomial.legendre.leggauss(NODES)
    z, phi = 0.5 * (node + 1.0), 0.25 * pi * (node + 1.0)
    rim = 1.0 - z[:, None] ** 2
    squared = rim * np.cos(phi) ** 2 * size[0] + rim * np.sin(phi) ** 2 * size[1] + z[:, None] ** 2 * size[2]
    share = 0.25 * np.outer(weight, weight)
    trace = float(size.sum())
    first = 2.0 * sqrt(2.0 / pi) * float((share * np.sqrt(squared)).sum())
    third = 8.0 * sqrt(2.0 / pi) * float((share * squared**1.5).sum())
    fourth = trace**2 + 2.0 * float((size**2).sum())
    variance = trace - first**2
    skewness = (third - 3.0 * first * trace + 2.0 * first**3) / variance**1.5
    kurtosis = (fourth - 4.0 * first * third + 6.0 * first**2 * trace - 3.0 * first**4) / variance**2
    return Radial(mean=first, std=sqrt(variance), skewness=skewness, kurtosis=kurtosis)


def unbiasing(n: int) -> float:
    """Return c4(n): the mean of the sample standard deviation of n normal numbers over the true one."""
    return sqrt(2.0 / (n - 1)) * exp(lgamma(0.5 * n) - lgamma(0.5 * (n - 1)))


def deviation_std(std: float, n: int) -> float:
    """Return the standard deviation of a sample standard deviation of n normal numbers (chi distribution)."""
    return std * sqrt(1.0 / unbiasing(n) ** 2 - 1.0)


def three_sigma(values: Array, noise_variance: float | None) -> Estimate:
    """Return 3 S of values (n,), n >= 2; noise_variance: of the measurement in one value, None if not known."""
    n = len(values)
    value = SIGMAS * float(np.std(values, ddof=1))
    std = deviation_std(value, n)
    scale = 1.0 / unbiasing(n)
    noise = None if noise_variance is None else SIGMAS * sqrt(max(noise_variance, 0.0))
    return _less_noise(value, std, value * scale, std * scale, noise)


def radial_repeatability(residuals: Array, noise: Array | None) -> Estimate:
    """Return l + 3 S_l of residuals (n, 3) from their barycentre, n >= 3; noise (3, 3): of one measurement.

    The standard deviation is the delta method's for mean and standard deviation of distances with the moments of a
    normal scatter of the sample's covariance. Taken out in `corrected`: the residuals are from their own barycentre
    and S_l of few distances is low (both make the value low), and the noise's share.
    """
    n = len(residuals)
    distance = np.linalg.norm(residuals, axis=1)  # (n,)
    value = float(distance.mean() + SIGMAS * distance.std(ddof=1))
    scatter = _without_chance(residuals.T @ residuals / (n - 1), n)  # (3, 3)
    shape = radial(scatter)
    if shape.std == 0.0:
        return Estimate(value=value, std=0.0, corrected=value, corrected_std=0.0)
    spread = shape.kurtosis / n - (n - 3) / (n * (n - 1))  # variance of S_l^2 over sigma_l^4
    factor = 1.0 / n + 0.25 * SIGMAS**2 * spread + SIGMAS * shape.skewness / n
    own_centre = sqrt(1.0 - 1.0 / n)
    std = own_centre * shape.std * sqrt(factor)
    low = own_centre * (shape.mean + SIGMAS * shape.std * (1.0 - spread / 8.0)) / shape.repeatability
    if noise is None:
        return Estimate(value=value, std=std, corrected=value / low, corrected_std=std / low)
    share = min(radial(_difference(scatter, noise)).repeatability / shape.repeatability, 1.0)
    kept = value / low * share
    return Estimate(value=value, std=std, corrected=kept, corrected_std=_grown(value / low, std / low, kept))


def _without_chance(scatter: Array, n: int) -> Array:
    """Return a sample covariance (3, 3) of n points, its eigenvalues brought as close together as chance parted them.

    Few points of a round scatter look long. From the sample's traces the unbiased ones of the squared covariance and
    of the squared trace are known (Wishart moments); their ratio says how far the eigenvalues really differ.
    """
    free, trace, squared = n - 1, float(np.trace(scatter)), float((scatter**2).sum())
    if trace == 0.0:
        return scatter
    true_squared = free**2 / ((free - 1) * (free + 2)) * (squared - trace**2 / free)
    true_trace_squared = trace**2 - 2.0 * true_squared / free
    seen, true = squared / trace**2 - 1.0 / 3.0, true_squared / true_trace_squared - 1.0 / 3.0
    keep = sqrt(min(max(true / seen, 0.0), 1.0)) if seen > 0.0 else 1.0
    return keep * scatter + (1.0 - keep) * trace / 3.0 * np.eye(3)


def _difference(scatter: Array, noise: Array) -> Array:
    """Return scatter - noise (3, 3) with no negative variance and, as far as that goes, with its trace."""
    value, vector = np.linalg.eigh(scatter - noise)
    kept = np.maximum(value, 0.0)
    if kept.sum() > 0.0:
        kept *= max(float(value.sum()), 0.0) / kept.sum()
    return np.asarray((vector * kept) @ vector.T)


def magnitude(vector: Array, covariance: Array) -> Estimate:
    """Return |vector| (3,) whose covariance (3, 3) is known, to first order.

    corrected: the length of a noisy vector is too long on average, by the trace of its covariance in its square.
    """
    value = float(np.linalg.norm(vector))
    if value > 0.0:
        along = vector / value
        std = sqrt(max(float(along @ covariance @ along), 0.0))
    else:
        std = sqrt(max(float(np.linalg.eigvalsh(covariance)[-1]), 0.0))
    return _less_noise(value, std, value, std, sqrt(max(float(np.trace(covariance)), 0.0)))


def _less_noise(value: float, std: float, full: float, full_std: float, noise: float | None) -> Estimate:
    """Return the estimate with noise taken out in squares of full, which stands for value without its bias."""
    if noise is None:
        return Estimate(value=value, std=std, corrected=full, corrected_std=full_std)
    kept = sqrt(max(full**2 - noise**2, 0.0))
    return Estimate(value=value, std=std, corrected=kept, corrected_std=_grown(full, full_std, kept))


def _grown(full: float, std: float, kept: float) -> float:
    """Return the standard deviation of what is kept of full after a subtraction in squares.

    First order while enough is kept; where next to nothing is, the root of the square's own uncertainty bounds it.
    """
    if std == 0.0 or full == 0.0:
        return std
    return std * max(1.0, full / max(kept, sqrt(full * std)))
