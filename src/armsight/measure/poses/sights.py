"""The spots of any number of cameras as one table, and which of them is which light."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import compress
from typing import NamedTuple

import numpy as np

from armsight.arrays import Array, Index
from armsight.measure.poses.correspondence import OUTLINE
from armsight.measure.poses.kernels.completion import gather
from armsight.measure.poses.setup import Setup
from armsight.measure.poses.solving import Views, outline_shifts, take_spots
from armsight.records import Spots, changed


class Sights(NamedTuple):
    """The spots of all views, one view after the other: uv_px (c, 2), cov_px2 (c, 2, 2), radius_m (c,) as Views has it.

    first (v + 1,): where a view's own begin. by_view: the same as they were found.
    """

    uv_px: Array
    cov_px2: Array
    radius_m: Array
    first: Index
    by_view: tuple[Spots, ...]

    @classmethod
    def of(cls, setup: Setup, seen: Sequence[Spots]) -> Sights:
        """Put the spots of each view one after the other."""
        uv, cov = (np.concatenate([getattr(spots, name) for spots in seen]) for name in ("uv_px", "covariance_px2"))
        if setup.model.radius_m > 0.0:
            radius = np.array([setup.model.radius_m * (kind == OUTLINE) for spots in seen for kind in spots.model])
        else:
            radius = np.zeros(len(uv))
            if any(OUTLINE in spots.model for spots in seen):
                shifts = map(outline_shifts, seen, setup.packed.k[:, 0].tolist())
                cov += np.concatenate(list(shifts))[:, None, None] * np.eye(2)
        return cls(uv, cov, radius, np.cumsum([0, *map(len, seen)]), tuple(seen))

    def named(self, setup: Setup, rows: Index, start: Array) -> tuple[tuple[str, ...], Views]:
        """Return the names and the spots of the lights that some view shows: rows (m, v) as Hypothesis has them."""
        names, seen = setup.model.names, rows.max(axis=1) >= 0
        if not seen.all():
            rows, names = rows[seen], tuple(compress(names, seen.tolist()))
        n, v = (rows := np.ascontiguousarray(rows, np.intp)).shape
        uv, cov, radius = np.empty((n, v, 2)), np.empty((n, v, 2, 2)), np.empty((n, v))
        gather(rows, (self.uv_px, self.cov_px2, self.radius_m), self.first, uv, cov, radius)
        start = np.array(start)
        start.setflags(write=False)  # as UNKNOWN: one compilation serves both
        return names, Views(uv, cov, radius, start)

    def taken(self, rows: Index) -> tuple[Spots, ...]:
        """Return each view's spots of lights in the order of rows (n, v), of size 0 where it shows none."""
        out = []
        for spots, at in zip(self.by_view, rows.T, strict=True):
            none = at < 0
            if not none.any():
                out.append(take_spots(spots, at))
                continue
            shown = spots.take(np.maximum(at, 0)) if len(spots) else _NO_SPOT.take(np.zeros(len(at), np.intp))
            out.append(changed(shown, size_px=np.where(none, 0.0, shown.size_px)))
        return tuple(out)


_NO_SPOT = Spots.of_centres(np.zeros((1, 2)), np.eye(2))
