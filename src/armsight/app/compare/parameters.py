"""Numbers of two results held against the uncertainty of both."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.special import chdtrc, ndtr

from armsight.arrays import Array
from armsight.records import NamedCovariance
from armsight.records.result_parts import Difference

BY_CHANCE = 0.01
"""Two results disagree where chance alone would part them so far less often than this."""

RIDGE = 1e-9
"""Added to correlations: a direction that both claim to know without any doubt is held against rounding only."""

SAME = 1e-12
"""Relative difference that is none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Value:
    """One number of a result: its name, value, and the unit that both are in."""

    name: str
    value: float
    unit: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """agree: None where it cannot be told; p: how often chance alone parts two results so far."""

    agree: bool | None
    p: float | None


def differences(
    a: Sequence[Value], b: Sequence[float], of_a: NamedCovariance | None, of_b: NamedCovariance | None
) -> list[Difference]:
    """Return the numbers of A beside those of B (same order); standard deviations as of independent results."""
    stds = [covariance.std() if covariance else {} for covariance in (of_a, of_b)]
    out = []
    for value, other in zip(a, b, strict=True):
        variance = sum(std.get(value.name, 0.0) ** 2 for std in stds)
        known = variance > 0.0 and bool(np.isfinite(variance))
        out.append(
            Difference(
                name=value.name,
                unit=value.unit,
                a=value.value,
                b=other,
                difference=other - value.value,
                std=float(np.sqrt(variance)) if known else None,
            )
        )
    return out


def judged(found: Sequence[Difference], of_a: NamedCovariance | None, of_b: NamedCovariance | None) -> Judgement:
    """Return whether all numbers agree, by chi-square with the sum of both covariances.

    A number that differs and of which neither result tells a standard deviation leaves it open.
    """
    known = [one for one in found if one.std is not None]
    silent = [one for one in found if one.std is None and abs(one.difference) > SAME * max(abs(one.a), abs(one.b))]
    if not known:
        return Judgement(agree=None, p=None)
    names = [one.name for one in known]
    total = _covariance(names, of_a) + _covariance(names, of_b)
    std = np.sqrt(np.diag(total))
    z = np.array([one.difference for one in known]) / std
    correlation = total / np.outer(std, std) + RIDGE * np.eye(len(z))
    p = float(chdtrc(len(z), float(z @ np.linalg.solve(correlation, z))))
    if p < BY_CHANCE:
        return Judgement(agree=False, p=p)
    return Judgement(agree=None if silent else True, p=p)


def judged_singly(found: Sequence[Difference]) -> Judgement:
    """Return whether all numbers agree where nobody tells how they hang together: by the worst one, which chance brings
    at most as often as one of so many (Bonferroni)."""
    worst = max((abs(one.sigmas) for one in found if one.sigmas is not None), default=None)
    if worst is None:
        return Judgement(agree=None, p=None)
    count = sum(one.sigmas is not None for one in found)
    p = min(1.0, count * 2.0 * float(ndtr(-worst)))
    return Judgement(agree=p >= BY_CHANCE, p=p)


def _covariance(names: Sequence[str], covariance: NamedCovariance | None) -> Array:
    """Return the covariance of the names (n, n), zero where the result holds a number as exact."""
    out = np.zeros((len(names), len(names)))
    if covariance is None:
        return out
    position = {name: i for i, name in enumerate(covariance.names)}
    at = [(k, position[name]) for k, name in enumerate(names) if name in position]
    here, there = [k for k, _ in at], [i for _, i in at]
    out[np.ix_(here, here)] = covariance.matrix[np.ix_(there, there)]
    return out
