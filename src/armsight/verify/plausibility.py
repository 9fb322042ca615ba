"""Rows that cannot be what they claim: a measurement repeated while the arm moved."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from armsight.units import MM
from armsight.verify.records import Measured, Rejected

Array = NDArray[np.float64]

MOVED_M, MOVED_RAD = 5e-4, 2e-3
"""An arm that moved by so much does not measure the same to the last digit."""


def repeated(F: Array, measured: Measured) -> Rejected:
    """Return the rows that repeat the row before of their point, digit by digit, though the arm moved between.

    F (m, 4, 4): base to flange as expected at each row.
    """
    found: list[tuple[int, str]] = []
    for label in measured.labels:
        rows = np.flatnonzero([point == label for point in measured.point])
        first = rows[0] if len(rows) else 0
        for i in rows[1:].tolist():
            if not _same(measured, i, first):
                first = i
                continue
            moved = float(np.linalg.norm(F[i, :3, 3] - F[first, :3, 3]))
            turned = float(np.abs(F[i, :3, :3] - F[first, :3, :3]).max())
            if moved > MOVED_M or turned > MOVED_RAD:
                why = (
                    f"repeats row {measured.rows[first]} to the last digit though the arm moved by {moved / MM:.3g} mm"
                )
                found.append((int(measured.rows[i]), why))
    return tuple(sorted(found))


def _same(measured: Measured, i: int, k: int) -> bool:
    if not np.array_equal(measured.xyz_m[i], measured.xyz_m[k]):
        return False
    return measured.rotation is None or np.array_equal(measured.rotation[i], measured.rotation[k])
