"""Spots of one camera at a time between two of its frames: they go on in straight lines."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from armsight.records import Spots

Array = NDArray[np.float64]
Index = NDArray[np.intp]

MAX_SPOTS = 16
"""Among more it is guesswork which of them went where."""
FEWEST_SPOTS = 3
ALIKE_PX = 12.0
"""By how much the ways of one target's lights differ: it turns and comes nearer, which its shift leaves out."""
MOST_WAYS = 3


def spots_between(earlier: Spots, later: Spots, share: float) -> Iterator[Spots]:
    """Yield the spots as they were when this share of the time between two frames was over, the likeliest way first.

    Spots that move alike are taken for one target's; its spots are linked by their common shift.
    """
    for before, after in _links(earlier.uv_px, later.uv_px):
        a, b = earlier.take(before), later.take(after)
        yield Spots.of_centres(
            (1.0 - share) * a.uv_px + share * b.uv_px,
            (1.0 - share) ** 2 * a.covariance_px2 + share**2 * b.covariance_px2,
        )


def _links(a: Array, b: Array) -> list[tuple[Index, Index]]:
    """Return which of the spots a (n, 2) are which of b (m, 2), under the shifts that explain most of them best."""
    if not (FEWEST_SPOTS <= len(a) <= MAX_SPOTS and FEWEST_SPOTS <= len(b) <= MAX_SPOTS):
        return []
    found: dict[tuple[int, ...], tuple[int, float, Index, Index]] = {}
    for shift in (b[None] - a[:, None]).reshape(-1, 2):
        off = np.linalg.norm(a[:, None] + shift - b[None], axis=2)
        nearest = off.argmin(axis=1)
        rows = np.arange(len(a))
        mutual = (off.argmin(axis=0)[nearest] == rows) & (off[rows, nearest] < ALIKE_PX)
        before, after = np.flatnonzero(mutual), nearest[mutual]
        if len(before) >= FEWEST_SPOTS:
            misfit = float(np.linalg.norm((b[after] - a[before]) - (b[after] - a[before]).mean(axis=0)))
            found[(*before.tolist(), -1, *after.tolist())] = (-len(before), misfit, before, after)
    ways = sorted(found.values(), key=lambda way: way[:2])
    return [(before, after) for _, _, before, after in ways[:MOST_WAYS]]
