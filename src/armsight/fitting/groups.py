"""Groups of a fit's rows: which hang together, what they are worth, and the fit without each of them.

Readings of one place share what is wrong there (a gear, a hand, a mount), which no number of them averages out. A fit
to them takes each place as one row: its noise is then what differs between places, and few places have Student's
intervals.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any, TypeVar

import numpy as np
import scipy  # loads its spatial search where it is used

from armsight.arrays import Array, Index, Mask

Record = TypeVar("Record")

GAP = 4.0
"""Places are further apart than readings of one place by this factor at least: of 1000 recordings of 10 to 60 rows
without repeats 1 shows such a gap."""
LEAST_REPEATED = 0.25
"""Share of the rows that must repeat others: two rows that happen to be near are no readings of one place."""
MOST_PLACES = 4000
"""Different rows up to which readings of one place are looked for; more are a stream, whose rows follow each other."""
HALVINGS = 3
"""Eight regions: each takes an eighth away from what determines an answer."""
LEAST_SPARE = 1e-9
"""Least share of a group's noise that the other groups must leave to it."""


def repeats(values: Array, near: float) -> Index:
    """Return (n,), from 0 in the order of the rows, which place each row of values (n, k) is of; each its own where
    nothing repeats.

    near: no readings of one place are further apart than this. Places need not follow each other in the file.
    """
    n = len(values)
    _, first, of = np.unique(values, axis=0, return_index=True, return_inverse=True)
    of = of.reshape(-1)
    if (
        2 <= len(first) <= MOST_PLACES
        and np.asarray(scipy.spatial.cKDTree(values[first]).query(values[first], 2)[0])[:, 1].min() <= near
    ):
        of = _joined(values[first], near, n)[of]
    if n - (int(of.max(initial=-1)) + 1) < LEAST_REPEATED * n:
        return np.arange(n)
    return _numbered(of)


def means(values: Array, of: Index) -> Array:
    """Return the mean (G, ...) of the values (n, ...) of each place."""
    out = np.zeros((int(of.max()) + 1, *values.shape[1:]))
    np.add.at(out, of, values)
    return np.asarray(out / np.bincount(of).reshape(-1, *[1] * (values.ndim - 1)))


def regions(values: Array) -> Index:
    """Return (m,) which part of their space each row of values (m, n) is in, of 2^HALVINGS about equal ones.

    Halved again and again across the value that spreads most, so that a part is near in all of them.
    """
    out = np.zeros(len(values), dtype=np.intp)
    size = np.maximum(np.ptp(values, axis=0), 1e-300)
    for _ in range(HALVINGS):
        for part in range(out.max() + 1):
            rows = np.flatnonzero(out == part)
            if len(rows) < 2:
                continue
            own = values[rows, int(np.argmax((values[rows] / size).std(axis=0)))]
            out[rows[own > np.median(own)]] += len(values)  # the upper half, numbered anew below
        out = np.unique(out, return_inverse=True)[1].astype(np.intp)
    return out


def inflation(residual: Array) -> float:
    """Return how many rows of residuals (m, k) are worth one independent row, at least 1.

    One plus twice the sum of the autocorrelation up to where it first falls below zero (Geyer's initial sequence).
    """
    m = len(residual)
    if m < 8:
        return 1.0
    centred = residual - residual.mean(axis=0)
    size = 1 << (2 * m - 1).bit_length()
    power = np.abs(np.fft.rfft(centred, size, axis=0)) ** 2
    correlation = np.fft.irfft(power.sum(axis=1), size)[: m // 2]
    if not correlation[0] > 0.0:
        return 1.0
    correlation = correlation / correlation[0]
    noise = 2.0 / np.sqrt(m * residual.shape[1])
    end = int(np.argmax(np.append(correlation, -1.0) < noise))
    return float(max(1.0, 1.0 + 2.0 * correlation[1:end].sum()))


def whitener(covariance: Array, condition: float = 0.0) -> Array:
    """Return W (..., k, k), lower triangular, that makes errors of covariances (..., k, k) independent, of unit size.

    condition: share of each variance that is added to it, so that an error without noise in some direction can be
    whitened. Raises numpy's LinAlgError where a covariance is not positive definite.
    """
    added = condition * covariance * np.eye(covariance.shape[-1])
    return np.asarray(np.linalg.inv(np.linalg.cholesky(covariance + added)))


def without(information: Array, own: Array, gradient: Array, ridge: float = 0.0) -> Array:
    """Return the steps (..., m) from the fit to all rows to the fits without some: (H - H_k)^-1 g_k.

    information H (m, m): J'J of all whitened rows and of what is known beforehand. own (..., m, m), gradient (..., m):
    J'J and J'r of the rows left out. At the minimum all gradients add up to zero: without these rows minus theirs is
    left, and one Gauss-Newton step is the refit to second order. ridge: added to H scaled to a unit diagonal.
    """
    scale = np.sqrt(np.diag(information))
    scale = np.where(scale > 0.0, scale, 1.0)
    rest = (information - own) / np.outer(scale, scale) + ridge * np.eye(len(scale))
    return np.asarray(np.linalg.solve(rest, (gradient / scale)[..., None])[..., 0] / scale)


def leave_one_out(e: Array, J: Array, C: Array, kept: Mask) -> tuple[Array, Array]:
    """Return the steps (n, m) to the fit without each group, zero for groups that are not in the fit, and the squared
    length (n,) of its error by that fit, against its own noise and that of the unknowns. Both are NaN where a group
    alone fixes some unknown.

    e (n, k), J (n, k, m): whitened residuals and derivatives of all groups at the fit to those kept (n,). C (m, m): the
    unknowns' covariance. Without a kept group the information is C^-1 - J'J: by the matrix inversion lemma (Woodbury
    1950) the step is C J' S^-1 e and the length e' S^-1 e with S = 1 - J C J'; of another group S is 1 + J C J'.
    """
    M = J @ C @ J.transpose(0, 2, 1)
    S = np.eye(e.shape[1]) + np.where(kept[:, None, None], -M, M)
    told = np.linalg.eigvalsh(S)[:, 0] > LEAST_SPARE
    y = np.full_like(e, np.nan)
    y[told] = np.linalg.solve(S[told], e[told, :, None])[:, :, 0]
    steps = np.einsum("ab,nkb,nk->na", C, J, y)
    return np.where(kept[:, None] | ~told[:, None], steps, 0.0), np.einsum("nk,nk->n", e, y)


def taken(record: Record, rows: Any, *names: str, **others: object) -> Record:
    """Return a frozen record with these rows (k,) alone of the arrays and tuples named, where it has them.

    others: further fields that are to differ.
    """
    held: Any = record
    found = {name: getattr(held, name) for name in names}
    some = {
        name: tuple(each[i] for i in rows) if isinstance(each, tuple) else each[rows]
        for name, each in found.items()
        if each is not None
    }
    kept: Record = replace(held, **some, **others)
    return kept


def _joined(values: Array, near: float, n: int) -> Index:
    """Return which place each of the different rows (m, k) is of; n: rows with those equal to the last digit."""
    from scipy.cluster.hierarchy import fcluster, linkage  # imported here: few commands need it

    tree = linkage(values, "single")  # the edges of the shortest tree that joins all rows, by their lengths
    length = tree[:, 2]
    # cut below the widest gap in the tree's edges: shorter edges join readings, longer ones places
    ratio = length[1:] / np.maximum(length[:-1], 1e-300)
    possible = (length[:-1] <= near) & (n - len(values) + np.arange(1, len(length)) >= LEAST_REPEATED * n)
    ratio = np.where(possible, ratio, 0.0)
    if not len(ratio) or ratio.max() < GAP:
        return np.arange(len(values))
    return np.asarray(fcluster(tree, length[int(ratio.argmax())], "distance") - 1, np.intp)


def _numbered(of: Index) -> Index:
    """Return the places numbered in the order in which they come first."""
    _, first, inverse = np.unique(of, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.intp)
    rank[np.argsort(first)] = np.arange(len(first))
    return np.asarray(rank[inverse.reshape(-1)])
