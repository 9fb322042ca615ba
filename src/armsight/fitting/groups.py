"""Rows whose errors are not independent: which of them are readings of one place.

Readings of one place share what is wrong there (a gear, a hand, a mount), which no number of them averages out. A fit
to them takes each place as one row: its noise is then what differs between places, and few places have Student's
intervals.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from armsight.arrays import Array, Index

GAP = 4.0
"""Places are further apart than readings of one place by this factor at least: of 1000 recordings of 10 to 60 rows
without repeats 1 shows such a gap."""
LEAST_REPEATED = 0.25
"""Share of the rows that must repeat others: two rows that happen to be near are no readings of one place."""
MOST_PLACES = 4000
"""Different rows up to which readings of one place are looked for; more are a stream, whose rows follow each other."""


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
        and np.asarray(cKDTree(values[first]).query(values[first], 2)[0])[:, 1].min() <= near
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


def _joined(values: Array, near: float, n: int) -> Index:
    """Return which place each of the different rows (m, k) is of; n: rows with those equal to the last digit."""
    first, second, length = _spanning_tree(values)
    order = np.argsort(length)
    length = length[order]
    # cut below the widest gap in the tree's edges: shorter edges join readings, longer ones places
    ratio = length[1:] / np.maximum(length[:-1], 1e-300)
    possible = (length[:-1] <= near) & (n - len(values) + np.arange(1, len(length)) >= LEAST_REPEATED * n)
    ratio = np.where(possible, ratio, 0.0)
    of = np.arange(len(values))
    if not len(ratio) or ratio.max() < GAP:
        return of
    for edge in order[: int(ratio.argmax()) + 1].tolist():
        of[of == of[second[edge]]] = of[first[edge]]
    return np.unique(of, return_inverse=True)[1].reshape(-1)


def _spanning_tree(values: Array) -> tuple[Index, Index, Array]:
    """Return the ends and lengths of the edges (m - 1,) of the shortest tree that joins all rows (Prim 1957)."""
    m = len(values)
    distance, nearest = np.full(m, np.inf), np.zeros(m, np.intp)
    first, second, length = np.empty(m - 1, np.intp), np.empty(m - 1, np.intp), np.empty(m - 1)
    outside, last = np.ones(m, bool), 0
    for k in range(m - 1):
        outside[last] = False
        to_last = np.sqrt(((values - values[last]) ** 2).sum(axis=1))
        nearer = outside & (to_last < distance)
        distance[nearer], nearest[nearer] = to_last[nearer], last
        last = int(np.argmin(np.where(outside, distance, np.inf)))
        first[k], second[k], length[k] = nearest[last], last, distance[last]
    return first, second, length


def _numbered(of: Index) -> Index:
    """Return the places numbered in the order in which they come first."""
    _, first, inverse = np.unique(of, return_index=True, return_inverse=True)
    rank = np.empty(len(first), np.intp)
    rank[np.argsort(first)] = np.arange(len(first))
    return np.asarray(rank[inverse.reshape(-1)])
